//! Iterated closest contour point: ICCP (Kamgar-Parsi 1999; Bai and Wang 2013; Duan, Xiao and Qi 2018).
//!
//! Every true position lies on the contour of its measured value. The indicated track is moved as one body onto those
//! contours: closest points, closed-form transform, again until the points rest.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::fix::{Fix, Status};
use crate::grid::GridMap;
use crate::matching::closest::{check_radius, closest_in_cells};
use crate::matching::refine::{RefineOptions, answer};
use crate::matching::scene::{Channel, Motion, Scene};
use crate::matching::starts::Starts;
use crate::matching::transform::{Transform, TransformKind};
use crate::track::Track;

/// Spread of a track across its own line over the spread along it, under which an affine transform means nothing.
const STRAIGHT: f64 = 5e-3;
/// How many times further than the plain step an extrapolation may go.
const GREATEST_EXTRAPOLATION: f64 = 20.0;

/// Settings of contour matching. The default is ICCP to the letter.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ContourOptions {
    /// What the track may do as one body.
    pub transform: TransformKind,
    /// How far from a point its contour is looked for, metres; infinity is the whole map.
    pub radius_m: f64,
    /// K of the objective: weight of the distance to the indicated points against that to the contours.
    pub stiffness: f64,
    /// The points have converged when none moves by more than this, metres.
    pub tolerance_m: f64,
    /// Greatest number of iterations from one start.
    pub max_iterations: usize,
    /// Least number of points that must have a contour in reach; `None` is half of them, or what the transform needs.
    pub min_points: Option<usize>,
    /// Depth of Anderson acceleration; 0 is the plain iteration.
    pub acceleration: usize,
    /// Greatest total rotation, degrees; `None` is no bound.
    pub max_rotation_deg: Option<f64>,
    /// Where to start.
    pub starts: Starts,
    /// Whether the misfit is minimised afterwards; without it there is no covariance.
    pub refine: bool,
    /// Priors (which also hold the transforms of ICCP) and the settings of the refinement.
    pub refinement: RefineOptions,
}

impl Default for ContourOptions {
    fn default() -> Self {
        Self {
            transform: TransformKind::Rigid,
            radius_m: f64::INFINITY,
            stiffness: 0.0,
            tolerance_m: 1.0,
            max_iterations: 300,
            min_points: None,
            acceleration: 0,
            max_rotation_deg: None,
            starts: Starts::Indicated,
            refine: false,
            refinement: RefineOptions::default(),
        }
    }
}

impl ContourOptions {
    /// The settings of the refinement: what the transform is free to do is estimated, under a flat prior where there is
    /// none.
    pub fn effective_refinement(&self) -> RefineOptions {
        let mut out = self.refinement.clone();
        if self.transform != TransformKind::Translation {
            out.priors.heading_sigma_deg.get_or_insert(f64::INFINITY);
        }
        if matches!(self.transform, TransformKind::Similarity | TransformKind::Affine) {
            out.priors.scale_sigma.get_or_insert(f64::INFINITY);
        }
        out
    }

    /// Refuses settings that cannot be used.
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`], [`Error::TooManyCandidates`].
    pub fn check(&self) -> Result<()> {
        check_radius(self.radius_m)?;
        require_not_negative("stiffness", self.stiffness)?;
        require_positive("tolerance_m", self.tolerance_m)?;
        if self.max_iterations == 0 {
            return Err(Error::invalid("max_iterations", "at least 1", 0));
        }
        if self.acceleration > 8 {
            return Err(Error::invalid("acceleration", "a depth from 0 (plain) to 8", self.acceleration));
        }
        if let Some(cap) = self.max_rotation_deg {
            require_not_negative("max_rotation_deg", cap)?;
        }
        self.starts.check()?;
        self.refinement.check()
    }
}

/// ICCP of one map: the indicated track moved onto the contours of its measured values.
///
/// `sigma` is the standard deviation of the measured values, map units, where it is known; it weighs the priors and the
/// refinement. The answer has a covariance, a goodness and a risk only with [`ContourOptions::refine`].
///
/// # Errors
/// Bad options ([`ContourOptions::check`]), a negative sigma, a track of fewer points than the transform needs
/// ([`Error::TooFewSamples`]), a straight track under an affine transform ([`Error::RankDeficient`]). Finding no
/// contour is a status of the fix.
///
/// ```
/// use geomag_core::grid::{GridMap, GridValues, Interpolation};
/// use geomag_core::matching::contour::{ContourOptions, match_contour};
/// use geomag_core::matching::transform::TransformKind;
/// use geomag_core::track::Track;
/// let axis: Vec<f64> = (0..61).map(|i| 100.0 * f64::from(i)).collect();
/// let field = |x: f64, y: f64| 50.0 * (x / 700.0).sin() + 40.0 * (y / 900.0).cos();
/// let values = axis.iter().flat_map(|&y| axis.iter().map(move |&x| field(x, y))).collect();
/// let map = GridMap::new(GridValues::F64(values), &axis, &axis, false)?;
/// let truth: Vec<[f64; 2]> = (0..20).map(|k| [1500.0 + 150.0 * f64::from(k), 2000.0 + 90.0 * f64::from(k)]).collect();
/// let track = Track::new(
///     truth.iter().map(|p| p[0] - 120.0).collect(),
///     truth.iter().map(|p| p[1] + 80.0).collect(),
///     truth.iter().map(|p| map.sample(p[0], p[1], Interpolation::Bilinear)).collect(),
///     None,
/// )?;
/// let options =
///     ContourOptions { transform: TransformKind::Translation, tolerance_m: 0.001, max_iterations: 3000, ..Default::default() };
/// let fix = match_contour(&map, &track, None, &options)?;
/// assert!(fix.ok() && (fix.offset_m[0] - 120.0).abs() < 5.0 && (fix.offset_m[1] + 80.0).abs() < 5.0);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
pub fn match_contour(map: &GridMap, track: &Track, sigma: Option<f64>, options: &ContourOptions) -> Result<Fix> {
    match_channels(&[Channel { map, values: track.values(), sigma }], track, None, options)
}

/// ICCP of several fields at once, weighted by their noise, with a weight a sample.
///
/// The positions come from `track`; its own values are not used, each channel brings its own. The closest points of a
/// sample on all its contours pull together, each with the inverse variance of a contour's place: (rms gradient along
/// the track / sigma)^2. With one channel that weight is 1.
///
/// # Errors
/// As [`match_contour`]; besides, channels and weights that do not fit the track, and several channels of which one has
/// no sigma.
pub fn match_channels(
    channels: &[Channel<'_>],
    track: &Track,
    weights: Option<&[f64]>,
    options: &ContourOptions,
) -> Result<Fix> {
    options.check()?;
    let scene = Scene::new(channels, track, weights)?;
    let matcher = Iccp::new(&scene, options)?;
    let n = scene.len();
    let min_on_map = ((options.refinement.min_overlap * n as f64).ceil() as usize).max(1);
    let unbiased = options.refinement.priors.bias_sigma.is_some();
    let starts = options.starts.offsets(&scene, unbiased, min_on_map);
    if options.refine
        && let Starts::Grid { half_width_m, .. } = options.starts
    {
        // After a search of the lattice the contours have nothing to add: the misfit itself is minimised from there.
        let motions: Vec<Motion> = starts.iter().map(|&o| Motion::offset(o)).collect();
        return Ok(answer(&scene, &options.effective_refinement(), &motions, 0, Some(half_width_m)));
    }
    let outcomes: Vec<Outcome> =
        starts.iter().map(|&start| matcher.run(Transform { shift: start, ..Transform::IDENTITY })).collect();
    let Some(best) = winner(&outcomes) else {
        return Ok(Fix::none(Status::Lost, n));
    };
    if options.refine {
        let motions: Vec<Motion> =
            outcomes.iter().filter(|o| o.end != End::OutOfReach).map(|o| motion_of(&o.transform)).collect();
        return Ok(answer(&scene, &options.effective_refinement(), &motions, outcomes[best].iterations, None));
    }
    Ok(matcher.fix(&outcomes, best))
}

/// The outcome of least misfit; those out of reach only where there is no other.
pub(crate) fn winner(outcomes: &[Outcome]) -> Option<usize> {
    (0..outcomes.len()).min_by(|&a, &b| {
        let key = |i: usize| (outcomes[i].end == End::OutOfReach, outcomes[i].misfit.unwrap_or(f64::INFINITY));
        let ((la, ma), (lb, mb)) = (key(a), key(b));
        la.cmp(&lb).then(ma.total_cmp(&mb)).then(a.cmp(&b))
    })
}

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
pub(crate) struct Outcome {
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
    options: &'a ContourOptions,
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
    pub fn run(&self, start: Transform) -> Outcome {
        let mut pairs = Pairs::with_capacity(self.scene.len() * self.scene.channels.len());
        let mut hints = self.no_hints();
        let mut now = start;
        let mut anderson = Anderson::new(self.options.acceleration);
        let mut last_objective = f64::INFINITY;
        let mut fallback = None;
        let mut iterations = 0;
        let mut end = End::IterationLimit;
        let (mut reached, mut distance_squared) = (0, f64::NAN);
        while iterations < self.options.max_iterations {
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
            if self.greatest_move(&now, &look.next) < self.options.tolerance_m {
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
        let misfit = self.scene.misfit(&|k| self.displacement(&now, k), false, 1);
        Outcome { transform: now, end, iterations, reached, distance_squared, misfit }
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
                let found = closest_in_cells(channel.map, at, channel.values[k], placement.cell_m, clear, reach);
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
            objective += self.prior_penalty(t) / information;
            self.fit_with_priors(pairs, &fitted, information)
        } else {
            fitted
        };
        Ok(Look { next: self.cap_rotation(next, pairs), objective, reached, distance_squared })
    }

    /// Inverse variances of east, north, rotation and scale as this kind of transform has them.
    fn prior_information(&self) -> [f64; 4] {
        let p = &self.options.refinement.priors;
        let inverse = |s: Option<f64>| s.map_or(0.0, |s| 1.0 / (s * s));
        let offset = inverse(p.offset_sigma_m);
        [offset, offset, inverse(p.heading_sigma_deg.map(f64::to_radians)), inverse(p.scale_sigma)]
    }

    fn prior_penalty(&self, t: &Transform) -> f64 {
        let q = [t.shift[0], t.shift[1], t.rotation_rad(), t.scale() - 1.0];
        q.iter().zip(self.prior_information()).map(|(q, i)| i * q * q).sum()
    }

    /// The least-squares transform with the priors as further observations: three Gauss-Newton steps from the free fit,
    /// whose only nonlinearity is the rotation's.
    fn fit_with_priors(&self, pairs: &Pairs, free: &Transform, information: f64) -> Transform {
        let prior = self.prior_information();
        let used = match self.options.transform {
            TransformKind::Translation => 2,
            TransformKind::Rigid => 3,
            TransformKind::Similarity | TransformKind::Affine => 4,
        };
        let mut q = [free.shift[0], free.shift[1], free.rotation_rad(), free.scale() - 1.0];
        for _ in 0..3 {
            let mut normal = nalgebra::Matrix4::<f64>::identity();
            let mut gradient = nalgebra::Vector4::<f64>::zeros();
            normal.view_mut((0, 0), (used, used)).fill(0.0);
            let (sin, cos) = q[2].sin_cos();
            for ((p, y), w) in pairs.from.iter().zip(&pairs.to).zip(&pairs.weights) {
                let w = w * information;
                let turned = [cos * p[0] - sin * p[1], sin * p[0] + cos * p[1]];
                let scale = 1.0 + q[3];
                let r = [q[0] + scale * turned[0] - y[0], q[1] + scale * turned[1] - y[1]];
                let columns = [[1.0, 0.0], [0.0, 1.0], [-scale * turned[1], scale * turned[0]], [turned[0], turned[1]]];
                for i in 0..used {
                    gradient[i] += w * (columns[i][0] * r[0] + columns[i][1] * r[1]);
                    for j in 0..used {
                        normal[(i, j)] += w * (columns[i][0] * columns[j][0] + columns[i][1] * columns[j][1]);
                    }
                }
            }
            for i in 0..used {
                normal[(i, i)] += prior[i];
                gradient[i] += prior[i] * q[i];
            }
            let Some(factor) = normal.cholesky() else { break };
            let step = factor.solve(&gradient);
            for i in 0..used {
                q[i] -= step[i];
            }
        }
        Transform::similarity(q[2], 1.0 + q[3], [q[0], q[1]])
    }

    /// The transform with its rotation held within the cap, the centroid of the points going where it went.
    fn cap_rotation(&self, t: Transform, pairs: &Pairs) -> Transform {
        let Some(cap) = self.options.max_rotation_deg else { return t };
        let (rotation, cap) = (t.rotation_rad(), cap.to_radians());
        if rotation.abs() <= cap || self.options.transform == TransformKind::Affine {
            return t;
        }
        let (mut weight, mut centre) = (0.0, [0.0; 2]);
        for (p, w) in pairs.from.iter().zip(&pairs.weights) {
            weight += w;
            centre = [centre[0] + w * p[0], centre[1] + w * p[1]];
        }
        let centre = centre.map(|v| v / weight);
        let held = Transform::similarity(rotation.clamp(-cap, cap), t.scale(), [0.0; 2]);
        let (goal, turned) = (t.apply(centre), held.apply(centre));
        Transform { shift: [goal[0] - turned[0], goal[1] - turned[1]], ..held }
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
    pub(crate) fn fix(&self, outcomes: &[Outcome], best: usize) -> Fix {
        let outcome = &outcomes[best];
        let n = self.scene.len();
        if outcome.end == End::OutOfReach {
            return Fix { iterations: outcome.iterations, ..Fix::none(Status::Lost, outcome.reached) };
        }
        // Further than contours were looked for from the indicated point: the track has run away along its contours.
        let run_away = outcome.transform.shift[0].hypot(outcome.transform.shift[1]) > self.options.radius_m;
        let status = match outcome.end {
            End::Converged if run_away => Status::AtEdge,
            End::Converged => Status::Fixed,
            End::IterationLimit | End::OutOfReach => Status::NotConverged,
        };
        let displacements: Vec<[f64; 2]> = (0..n).map(|k| self.displacement(&outcome.transform, k)).collect();
        let motion = motion_of(&outcome.transform);
        // Another start that came to rest elsewhere: further away than a converged iteration can stop short.
        let apart = 10.0 * self.options.tolerance_m;
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
                self.scene.channels[0].map,
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

/// Points and where they should go.
struct Pairs {
    from: Vec<[f64; 2]>,
    to: Vec<[f64; 2]>,
    weights: Vec<f64>,
}

impl Pairs {
    fn with_capacity(n: usize) -> Self {
        Self { from: Vec::with_capacity(n), to: Vec::with_capacity(n), weights: Vec::with_capacity(n) }
    }

    fn clear(&mut self) {
        self.from.clear();
        self.to.clear();
        self.weights.clear();
    }

    fn push(&mut self, from: [f64; 2], to: [f64; 2], weight: f64) {
        self.from.push(from);
        self.to.push(to);
        self.weights.push(weight);
    }
}

/// Anderson acceleration (type II; Walker and Ni 2011) of a fixed-point iteration in six coordinates.
struct Anderson {
    depth: usize,
    last: Option<([f64; 6], [f64; 6])>,
    /// Differences of images and of residuals, oldest first.
    history: Vec<([f64; 6], [f64; 6])>,
}

impl Anderson {
    const fn new(depth: usize) -> Self {
        Self { depth, last: None, history: Vec::new() }
    }

    fn clear(&mut self) {
        self.last = None;
        self.history.clear();
    }

    /// The next place from a place and its image; `None` where the plain image is to be taken.
    fn next(&mut self, place: [f64; 6], image: [f64; 6]) -> Option<[f64; 6]> {
        if self.depth == 0 {
            return None;
        }
        let difference = |a: &[f64; 6], b: &[f64; 6]| std::array::from_fn(|i| a[i] - b[i]);
        let residual: [f64; 6] = difference(&image, &place);
        if let Some((last_image, last_residual)) = self.last.replace((image, residual)) {
            if self.history.len() == self.depth {
                self.history.remove(0);
            }
            self.history.push((difference(&image, &last_image), difference(&residual, &last_residual)));
        }
        if self.history.is_empty() {
            return None;
        }
        let columns = nalgebra::DMatrix::from_fn(6, self.history.len(), |i, j| self.history[j].1[i]);
        let target = nalgebra::DVector::from_column_slice(&residual);
        let svd = columns.svd(true, true);
        let cutoff = 1e-8 * svd.singular_values.max();
        let gamma = svd.solve(&target, cutoff).ok()?;
        let mut further = [0.0; 6];
        for (j, (step, _)) in self.history.iter().enumerate() {
            for i in 0..6 {
                further[i] -= gamma[j] * step[i];
            }
        }
        let length = |v: &[f64; 6]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let shrink = (GREATEST_EXTRAPOLATION * length(&residual) / length(&further).max(f64::MIN_POSITIVE)).min(1.0);
        let next: [f64; 6] = std::array::from_fn(|i| image[i] + shrink * further[i]);
        next.iter().all(|v| v.is_finite()).then_some(next)
    }
}
