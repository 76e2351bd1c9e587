//! The iteration from one start: closest contour points, transform, again until the points rest.

use super::anderson::Anderson;
use super::constrained::Pairs;
use super::options::ContourOptions;
use crate::error::{Error, Result, require_positive};
use crate::fix::{Fix, Status};
use crate::grid::Interpolation;
use crate::matching::closest::closest_in_cells;
use crate::matching::scene::{Motion, Scene};
use crate::matching::transform::{Transform, TransformKind};
use crate::monitor::Monitor;

/// Spread of a track across its own line over the spread along it, under which an affine transform means nothing.
const STRAIGHT: f64 = 5e-3;
/// The motion about the newest point that a transform in metres from the newest point amounts to.
pub(crate) fn motion_of(t: &Transform) -> Motion {
    Motion { offset_m: t.shift, heading_rad: -t.rotation_rad(), stretch: t.scale() - 1.0 }
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    Converged,
    IterationLimit,
    OutOfReach,
}

/// Where an iteration ended.
#[derive(Debug, Clone)]
pub(crate) struct Converged {
    /// From indicated to moved points, metres from the newest indicated point.
    pub transform: Transform,
    pub end: End,
    pub iterations: usize,
    /// Points with a contour in reach at the end.
    pub reached: usize,
    /// Mean square distance of the moved points from their contours, square metres.
    pub distance_squared: f64,
    /// Mean square of measured minus map value, where enough of the track is on the map.
    pub misfit: Option<f64>,
}

/// One look at the contours from one place.
struct Look {
    next: Transform,
    objective: f64,
    reached: usize,
    distance_squared: f64,
}

/// The iteration: one scene, one set of options, any number of starts.
pub(crate) struct Iccp<'a> {
    scene: &'a Scene<'a>,
    pub(super) options: &'a ContourOptions,
    min_points: usize,
    channel_weights: Vec<f64>,
    /// Inverse variance of the distance to a contour, where sigma says it; what the priors are weighed against.
    distance_information: Option<f64>,
    /// Length that makes an angle comparable with a shift.
    lever_m: f64,
}

impl<'a> Iccp<'a> {
    pub fn new(scene: &'a Scene<'a>, options: &'a ContourOptions) -> Result<Self> {
        let n = scene.len();
        let kind = options.transform;
        if n < kind.min_points() {
            return Err(Error::TooFewSamples {
                what: format!("track for a {} transform", kind.as_str()),
                needed: kind.min_points(),
                got: n,
            });
        }
        if kind != TransformKind::Translation {
            require_spread(scene, kind)?;
        }
        let min_points = options.min_points.unwrap_or(n.div_ceil(2)).max(kind.min_points());
        if min_points > n {
            return Err(Error::invalid("min_points", format!("at most the {n} points of the track"), min_points));
        }
        let gradients: Vec<f64> = (0..scene.channels.len()).map(|c| scene.rms_gradient(c, [0.0; 2])).collect();
        let information = |c: usize| {
            scene.channels[c].sigma.filter(|&s| s > 0.0 && gradients[c] > 0.0).map(|s| (gradients[c] / s).powi(2))
        };
        let (channel_weights, distance_information) = if scene.channels.len() == 1 {
            (vec![1.0], information(0))
        } else {
            let mut weights = Vec::with_capacity(scene.channels.len());
            for c in 0..scene.channels.len() {
                let sigma = scene.channels[c].sigma.ok_or_else(|| {
                    Error::invalid(format!("channel {c} sigma"), "a sigma for every one of several channels", "none")
                })?;
                require_positive(&format!("channel {c} sigma"), sigma)?;
                weights.push(information(c).unwrap_or(0.0));
            }
            let total: f64 = weights.iter().sum();
            if total > 0.0 {
                for w in &mut weights {
                    *w /= total;
                }
            } else {
                weights.fill(1.0 / scene.channels.len() as f64);
            }
            (weights, (total > 0.0).then_some(total))
        };
        let square: f64 = scene.levers.iter().map(|l| l[0] * l[0] + l[1] * l[1]).sum();
        let lever_m = (square / n as f64).sqrt().max(1.0);
        Ok(Self { scene, options, min_points, channel_weights, distance_information, lever_m })
    }

    /// Iterates from a start.
    pub fn run(&self, start: Transform, monitor: &dyn Monitor) -> Result<Converged> {
        let mut pairs = Pairs::with_capacity(self.scene.len() * self.scene.channels.len());
        let mut hints = self.no_hints();
        let mut now = start;
        let mut anderson = Anderson::new(self.options.acceleration);
        let mut last_objective = f64::INFINITY;
        let mut fallback = None;
        let mut iterations = 0;
        let mut end = End::IterationLimit;
        let (mut reached, mut distance_squared) = (0, f64::NAN);
        // Without a radius the whole map is in reach of any place: a track off the map would be drawn onto it from anywhere.
        if self.options.radius_m.is_infinite() {
            reached = (0..self.scene.len()).filter(|&k| self.on_map(&now, k)).count();
            if reached < self.min_points {
                return Ok(Converged {
                    transform: now,
                    end: End::OutOfReach,
                    iterations,
                    reached,
                    distance_squared,
                    misfit: None,
                });
            }
        }
        while iterations < self.options.max_iterations {
            monitor.advance(iterations as u64, self.options.max_iterations as u64)?;
            iterations += 1;
            let look = match self.look(&now, &mut pairs, &mut hints) {
                Ok(look) => look,
                Err(seen) => {
                    if let Some(plain) = fallback.take() {
                        now = plain;
                        anderson.clear();
                        continue;
                    }
                    (reached, end) = (seen, End::OutOfReach);
                    break;
                }
            };
            if look.objective > last_objective
                && let Some(plain) = fallback.take()
            {
                // The extrapolation overshot: back to the plain step, which never raises the objective.
                now = plain;
                anderson.clear();
                continue;
            }
            (last_objective, reached, distance_squared) = (look.objective, look.reached, look.distance_squared);
            if self.greatest_move(&now, &look.next) < self.options.converged_m {
                now = look.next;
                end = End::Converged;
                break;
            }
            if let Some(coordinates) = anderson.next(self.coordinates(&now), self.coordinates(&look.next)) {
                fallback = Some(look.next);
                now = self.transform(coordinates);
            } else {
                fallback = None;
                now = look.next;
            }
        }
        let misfit = self.scene.misfit(&|k| self.displacement(&now, k), &self.options.judgement(self.scene.len()));
        Ok(Converged { transform: now, end, iterations, reached, distance_squared, misfit })
    }

    fn no_hints(&self) -> Vec<Hint> {
        vec![Hint::NONE; self.scene.len() * self.scene.channels.len()]
    }

    /// Mean square distance of the points that `t` gives from their contours; `None` where too few have one in reach.
    pub fn distance_squared(&self, t: &Transform) -> Option<f64> {
        self.look(t, &mut Pairs::with_capacity(self.scene.len()), &mut self.no_hints())
            .ok()
            .map(|look| look.distance_squared)
    }

    #[inline]
    fn displacement(&self, t: &Transform, k: usize) -> [f64; 2] {
        let lever = self.scene.levers[k];
        let [e, n] = t.apply(lever);
        [e - lever[0], n - lever[1]]
    }

    /// Whether a channel knows the place that a sample is moved to.
    fn on_map(&self, t: &Transform, k: usize) -> bool {
        let moved = self.displacement(t, k);
        let value = |c: usize| self.scene.sample(c, k, moved, Interpolation::Bilinear).0;
        (0..self.scene.channels.len()).any(|c| value(c).is_finite())
    }

    /// Whether the contours in reach are no more than it takes to determine the transform, so that nothing tells whether they fit.
    fn undetermined(&self, reached: usize) -> bool {
        let held = self.options.stiffness > 0.0 || self.options.refinement.priors.bound_motion();
        !held && reached * self.scene.channels.len() <= self.options.transform.parameters()
    }

    fn greatest_move(&self, from: &Transform, to: &Transform) -> f64 {
        let squared = |k: usize| {
            let (a, b) = (self.displacement(from, k), self.displacement(to, k));
            (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
        };
        (0..self.scene.len()).map(squared).fold(0.0, f64::max).sqrt()
    }

    /// Closest contour points from the places that `t` gives, and the transform that goes there; the number of points in
    /// reach where they are too few.
    fn look(&self, t: &Transform, pairs: &mut Pairs, hints: &mut [Hint]) -> std::result::Result<Look, usize> {
        let radius = self.options.radius_m;
        pairs.clear();
        let (mut objective, mut seen_weight, mut squares) = (0.0, 0.0, 0.0);
        let mut reached = 0;
        for k in 0..self.scene.len() {
            let lever = self.scene.levers[k];
            let moved = self.displacement(t, k);
            let mut any = false;
            for (c, channel) in self.scene.channels.iter().enumerate() {
                let weight = self.scene.weight(k) * self.channel_weights[c];
                if weight == 0.0 {
                    continue;
                }
                let placement = &self.scene.placements[c][k];
                let at = placement.position(moved);
                let hint = &mut hints[c * self.scene.len() + k];
                let [clear, reach] = hint.bounds(at, placement.cell_m, radius);
                let found = closest_in_cells(channel.field, at, channel.values[k], placement.cell_m, clear, reach);
                *hint = Hint { at, distance: found.map_or(radius, |f| f.1), place: found.map(|f| f.0) };
                match found {
                    Some((place, distance)) => {
                        any = true;
                        let target = [
                            lever[0] + moved[0] + (place[0] - at[0]) * placement.cell_m[0],
                            lever[1] + moved[1] + (place[1] - at[1]) * placement.cell_m[1],
                        ];
                        pairs.push(lever, target, weight);
                        squares += weight * distance * distance;
                        seen_weight += weight;
                    }
                    None if radius.is_finite() => objective += weight * radius * radius,
                    None => {}
                }
            }
            reached += usize::from(any);
        }
        if reached < self.min_points {
            return Err(reached);
        }
        objective += squares;
        let distance_squared = squares / seen_weight;
        if self.options.stiffness > 0.0 {
            for k in 0..self.scene.len() {
                let weight = self.scene.weight(k) * self.options.stiffness;
                let moved = self.displacement(t, k);
                objective += weight * (moved[0] * moved[0] + moved[1] * moved[1]);
                pairs.push(self.scene.levers[k], self.scene.levers[k], weight);
            }
        }
        let kind = self.options.transform;
        let fitted = Transform::fit(kind, &pairs.from, &pairs.to, Some(&pairs.weights)).map_err(|_| reached)?;
        let next = if self.options.refinement.priors.bound_motion() && kind != TransformKind::Affine {
            // Where sigma is not known the contour distances themselves say how far they can be trusted.
            let information =
                self.distance_information.unwrap_or_else(|| 1.0 / distance_squared.max(f64::MIN_POSITIVE));
            objective += self.options.prior_penalty(t) / information;
            self.options.fit_with_priors(pairs, &fitted, information)
        } else {
            fitted
        };
        Ok(Look { next: self.options.cap_rotation(next, pairs), objective, reached, distance_squared })
    }

    /// Coordinates of a transform, all of them metres, in which an extrapolation stays of its kind.
    fn coordinates(&self, t: &Transform) -> [f64; 6] {
        let l = self.lever_m;
        let m = &t.matrix;
        match self.options.transform {
            TransformKind::Affine => [t.shift[0], t.shift[1], l * m[0][0], l * m[0][1], l * m[1][0], l * m[1][1]],
            _ => [t.shift[0], t.shift[1], l * t.rotation_rad(), l * t.scale(), 0.0, 0.0],
        }
    }

    fn transform(&self, c: [f64; 6]) -> Transform {
        let l = self.lever_m;
        match self.options.transform {
            TransformKind::Affine => {
                Transform { matrix: [[c[2] / l, c[3] / l], [c[4] / l, c[5] / l]], shift: [c[0], c[1]] }
            }
            _ => Transform::similarity(c[2] / l, c[3] / l, [c[0], c[1]]),
        }
    }

    /// The common answer for the outcomes of all starts.
    pub(crate) fn fix(&self, outcomes: &[Converged], best: usize) -> Fix {
        let outcome = &outcomes[best];
        let n = self.scene.len();
        let none = |status| Fix { iterations: outcome.iterations, ..Fix::none(status, outcome.reached) };
        if outcome.end == End::OutOfReach || outcome.misfit.is_none() {
            return none(Status::Lost);
        }
        if !self.on_map(&outcome.transform, n - 1) {
            return none(Status::AtEdge);
        }
        // Further than contours were looked for from the indicated point: the track has run away along its contours.
        let run_away = outcome.transform.shift[0].hypot(outcome.transform.shift[1]) > self.options.radius_m;
        let status = match outcome.end {
            End::Converged if run_away => Status::AtEdge,
            End::Converged if self.undetermined(outcome.reached) => Status::Uninformative,
            End::Converged => Status::Fixed,
            End::IterationLimit | End::OutOfReach => Status::NotConverged,
        };
        let displacements: Vec<[f64; 2]> = (0..n).map(|k| self.displacement(&outcome.transform, k)).collect();
        let motion = motion_of(&outcome.transform);
        // Another start that came to rest elsewhere: further away than a converged iteration can stop short.
        let apart = 10.0 * self.options.converged_m;
        let runner_up = outcomes
            .iter()
            .filter(|o| o.end != End::OutOfReach && self.greatest_move(&o.transform, &outcome.transform) > apart)
            .filter_map(|o| o.misfit)
            .fold(f64::NAN, f64::min);
        Fix {
            heading_deg: motion.heading_rad.to_degrees(),
            scale: 1.0 + motion.stretch,
            score: outcome.misfit.unwrap_or(f64::NAN),
            runner_up,
            n_samples: outcome.reached,
            iterations: outcome.iterations,
            track: self.scene.moved(&displacements),
            ..Fix::at_point(
                self.scene.channels[0].field,
                self.scene.track.newest(),
                self.scene.newest_offset(motion.offset_m),
                status,
            )
        }
    }
}

/// Refuses points that coincide, and (affine) a track that is straight.
fn require_spread(scene: &Scene<'_>, kind: TransformKind) -> Result<()> {
    let n = scene.len() as f64;
    let mean = scene.levers.iter().fold([0.0; 2], |m, l| [m[0] + l[0] / n, m[1] + l[1] / n]);
    let (mut ee, mut en, mut nn) = (0.0, 0.0, 0.0);
    for l in &scene.levers {
        let (e, north) = (l[0] - mean[0], l[1] - mean[1]);
        ee += e * e;
        en += e * north;
        nn += north * north;
    }
    let half = 0.5 * (ee + nn);
    let apart = (0.25 * (ee - nn).powi(2) + en * en).sqrt();
    let (along, across) = (half + apart, (half - apart).max(0.0));
    let deficient = |rank, detail: &str| Error::RankDeficient {
        what: format!("{} transform of the track", kind.as_str()),
        rank,
        needed: if kind == TransformKind::Affine { 2 } else { 1 },
        detail: detail.into(),
    };
    if along == 0.0 {
        return Err(deficient(0, "all points of the track coincide: use translation"));
    }
    if kind == TransformKind::Affine && across < STRAIGHT * STRAIGHT * along {
        return Err(deficient(
            1,
            "the track is a straight line, across which an affine transform is free: use similarity",
        ));
    }
    Ok(())
}

/// The last search of a point: what is found bounds the next search from both sides, and changes no answer.
#[derive(Debug, Clone, Copy)]
struct Hint {
    /// Where it was, cells.
    at: [f64; 2],
    /// Distance in metres within which there was no contour.
    distance: f64,
    /// The closest point, cells.
    place: Option<[f64; 2]>,
}

impl Hint {
    const NONE: Self = Self { at: [0.0; 2], distance: 0.0, place: None };

    /// The distance up to which a place is clear of the contour, and that up to which it must be searched, metres.
    fn bounds(&self, at: [f64; 2], cell_m: [f64; 2], radius_m: f64) -> [f64; 2] {
        let apart = |p: [f64; 2]| ((p[0] - at[0]) * cell_m[0]).hypot((p[1] - at[1]) * cell_m[1]);
        // A share of slack for rounding: a bound may be loose, never wrong.
        let clear = if self.distance.is_finite() { (self.distance - apart(self.at)) * (1.0 - 1e-9) } else { 0.0 };
        let reach = self.place.map_or(radius_m, |place| radius_m.min(apart(place) * (1.0 + 1e-9) + 1e-9));
        [clear.max(0.0), reach]
    }
}
