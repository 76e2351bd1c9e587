//! What the readings ask for that was not told: the evidence of the model as told against that of models with one effect more.
//!
//! A test at the declared place does not see a wrong height or a bias that steps: a place at which the readings happen to fit was
//! found under the model as told. What sees it is the evidence over the whole search, the likelihood summed over all offsets (Kass and
//! Raftery, J. Am. Stat. Assoc. 90 (1995) 773): the right place under the right model fits better than the wrong place under the wrong
//! one. A lattice of some twenty offsets a side is enough, because the variance of a sample contains what the map does between them;
//! the likelihood is tempered, because errors that neighbours share must not be counted for every sample.

use std::sync::Arc;

use rayon::prelude::*;

use super::kernel::{self, LANES, Scratch, Setup, Wide};
use super::nuisance::{Shape, leg_shapes, walk_shapes};
use super::patch::Patch;
use super::problem::{Prepared, Problem};
use crate::fix::Misfit;
use crate::grid::HEIGHTS_M;

/// Log evidence that an effect must gain where neither options nor map say otherwise: on left-out lines of two surveys one right fix
/// in thirty gains more by another height.
const THRESHOLD: f64 = 6.0;
/// Power to which likelihoods are taken.
const TEMPER: f64 = 0.4;
/// Lattice steps from the answer to the end of the search: this many, more where they would be longer than so many cells, but not more
/// than that.
const STEPS: f64 = 10.0;
const STEP_CELLS: f64 = 2.0;
const MOST_STEPS: f64 = 15.0;
/// Places of a model that are looked at closely.
const PLACES: usize = 4;
/// Least height in cells of the map that changes anything.
const LEAST_HEIGHT_CELLS: f64 = 0.25;
/// Standard deviations of the priors: of legs and walk in standard deviations of the readings, of their scale, of the heading in
/// degrees, of the drift in tolerances.
const BIAS_SHARE: f64 = 0.5;
/// And small ones, in standard deviations of a sample: a wide prior cannot see them.
const SMALL_BIAS: f64 = 2.0;
const READING_SCALE: f64 = 0.1;
const HEADING_DEG: f64 = 2.0;
const DRIFT_TOLERANCES: f64 = 1.0;

/// A model with one effect that was not told.
struct Alternative {
    effect: &'static str,
    /// Number of the height in [`HEIGHTS_M`].
    height: Option<usize>,
    /// What it does to the samples of every channel.
    shapes: Vec<Vec<Shape>>,
}

/// A channel as the tests look at it.
struct View<'a> {
    channel: &'a Prepared,
    /// The error level that fits the answer best, and the node of the nuisance parameters.
    level: usize,
    node: usize,
    shapes: Vec<Shape>,
    narrowed: Vec<f64>,
    patch: Arc<Patch>,
}

impl View<'_> {
    fn setup<'b>(&'b self, problem: &'b Problem<'_>, step: [f64; 2]) -> Setup<'b> {
        let setup = problem.setup(self.channel, self.node, step);
        Setup { patch: &self.patch, shapes: &self.shapes, narrowed: &self.narrowed, ..setup }
    }
}

/// The effect that the readings ask for most clearly where a fix at `offset` would be declared on a lattice of step `finest` (map
/// units); `None` where none gains more than the threshold.
///
/// A variance that contains what the map does between the offsets favours flat places, so the gain must hold between the two best places
/// looked at closely as well.
pub(super) fn asked_for(problem: &Problem<'_>, offset: [f64; 2], finest: [f64; 2]) -> Option<Misfit> {
    let of_map = problem.field.as_grid().and_then(|g| g.error_model()).and_then(|m| m.misfit_threshold);
    let threshold = problem.options.misfit_threshold.or(of_map).unwrap_or(THRESHOLD);
    if threshold == f64::INFINITY {
        return None;
    }
    let (offsets, step) = lattice(problem, offset);
    let told: Vec<View<'_>> = problem.channels.iter().map(|c| view(problem, c, offset, finest)).collect();
    // The model as told and the effects that leave the map as it is are looked at together; every height has a map of its own.
    let none = Alternative { effect: "none", height: None, shapes: Vec::new() };
    let (heights, others): (Vec<_>, Vec<_>) = alternatives(problem).into_iter().partition(|a| a.height.is_some());
    let mut groups: Vec<Vec<Alternative>> = heights.into_iter().map(|a| vec![a]).collect();
    groups.insert(0, std::iter::once(none).chain(others).collect());
    let searched: Vec<Vec<Found>> =
        groups.par_iter().map(|group| search(problem, &told, group, &offsets, step)).collect();
    let evidence = searched.first()?.first()?.log_evidence;
    let mut asked: Vec<(&Alternative, Found)> = (groups.iter().flatten().zip(searched.into_iter().flatten()))
        .skip(1)
        .filter(|(_, found)| found.log_evidence - evidence > threshold)
        .collect();
    asked.sort_by(|a, b| b.1.log_evidence.total_cmp(&a.1.log_evidence));
    asked.into_iter().find_map(|(effect, found)| {
        let views: Option<Vec<View<'_>>> =
            told.iter().enumerate().map(|(c, view)| with_effect(problem, view, effect, c)).collect();
        let views = views?;
        let (at, close) = refined(problem, &views, &offsets, &found.best, step, finest)?;
        let before = joint(problem, &told, &[offset], finest);
        let gain = (found.log_evidence - evidence).min(close - before.first()?);
        (gain > threshold).then(|| Misfit {
            effect: effect.effect.into(),
            estimate: estimate(problem, &views[0], &told[0], effect, at, finest),
            log_evidence: gain,
        })
    })
}

/// Tempered log-likelihoods of some offsets under a model, all channels together.
fn joint(problem: &Problem<'_>, views: &[View<'_>], offsets: &[[f64; 2]], step: [f64; 2]) -> Vec<f64> {
    let mut total = vec![0.0; offsets.len()];
    let mut scratch = Scratch::default();
    for view in views {
        let setup = view.setup(problem, step);
        let cells: Vec<[f64; 2]> = offsets.iter().map(|o| view.channel.cells(*o)).collect();
        for (block, sums) in cells.chunks(LANES).zip(total.chunks_mut(LANES)) {
            let scores = kernel::score::<false>(&setup, block, view.level..view.level + 1, &mut scratch);
            for (sum, score) in sums.iter_mut().zip(&scores.log_likelihood[view.level]) {
                *sum += TEMPER * score;
            }
        }
    }
    total
}

/// The best place of a model near the best ones of a coarse lattice, sought by halving down to the `finest` step, and its tempered
/// log-likelihood.
fn refined(
    problem: &Problem<'_>,
    views: &[View<'_>],
    offsets: &[[f64; 2]],
    starts: &[usize],
    step: [f64; 2],
    finest: [f64; 2],
) -> Option<([f64; 2], f64)> {
    let mut step = step;
    let mut places: Vec<[f64; 2]> = starts.iter().map(|i| offsets[*i]).collect();
    loop {
        step = [0, 1].map(|d| (0.5 * step[d]).max(finest[d]));
        let around = |o: &[f64; 2]| {
            [[-0.5, -0.5], [0.5, -0.5], [-0.5, 0.5], [0.5, 0.5]].map(|[u, v]| [o[0] + u * step[0], o[1] + v * step[1]])
        };
        let some: Vec<[f64; 2]> = places.iter().flat_map(around).collect();
        let scores = joint(problem, views, &some, step);
        let mut order: Vec<usize> = (0..some.len()).filter(|i| scores[*i].is_finite()).collect();
        order.sort_by(|a, b| scores[*b].total_cmp(&scores[*a]));
        let &best = order.first()?;
        if (0..2).all(|d| step[d] <= finest[d]) {
            return Some((some[best], scores[best]));
        }
        places = order.iter().take(PLACES).map(|i| some[*i]).collect();
    }
}

/// The evidence of a model over the whole search, and the offsets at which it fits best, the very best first.
struct Found {
    log_evidence: f64,
    best: Vec<usize>,
}

/// Offsets over the whole search, one of them the answer, and their step; map units.
fn lattice(problem: &Problem<'_>, offset: [f64; 2]) -> (Vec<[f64; 2]>, [f64; 2]) {
    let half = problem.options.half_width;
    let step = [0, 1].map(|d| (half[d] / STEPS).min(STEP_CELLS * problem.cell[d]).max(half[d] / MOST_STEPS));
    let axis = |d: usize| {
        let first = ((-half[d] - offset[d]) / step[d] - 1e-9).ceil() as i64;
        let last = ((half[d] - offset[d]) / step[d] + 1e-9).floor() as i64;
        (first..=last.max(first)).map(move |i| offset[d] + i as f64 * step[d]).collect::<Vec<f64>>()
    };
    let (xs, ys) = (axis(0), axis(1));
    (ys.iter().flat_map(|y| xs.iter().map(move |x| [*x, *y])).collect(), step)
}

/// A channel under the model as told.
fn view<'a>(problem: &Problem<'_>, channel: &'a Prepared, offset: [f64; 2], step: [f64; 2]) -> View<'a> {
    let levels = &channel.noise.levels;
    let node = problem.best_node(channel, offset, channel.noise.typical, step);
    let setup = problem.setup(channel, node, step);
    let scores = kernel::score::<false>(&setup, &[channel.cells(offset)], 0..levels.len(), &mut Scratch::default());
    let merit = |v: usize| scores.log_likelihood[v][0] + levels[v].log_prior;
    let level = (0..levels.len()).fold(0, |a, b| if merit(b) > merit(a) { b } else { a });
    let (shapes, narrowed) = (problem.nuisance.shapes.clone(), problem.nuisance.narrowed.clone());
    let patch = Arc::clone(channel.patch_at(&problem.nuisance.nodes[node]));
    View { channel, level, node, shapes, narrowed, patch }
}

/// The same with one effect more; `None` where the effect says nothing to this channel.
fn with_effect<'a>(problem: &Problem<'_>, told: &View<'a>, effect: &Alternative, c: usize) -> Option<View<'a>> {
    let mut shapes = told.shapes.clone();
    let mut narrowed = told.narrowed.clone();
    shapes.extend(effect.shapes.get(c).into_iter().flatten().cloned());
    narrowed.resize(shapes.len(), 1.0);
    let patch = match effect.height {
        None => Arc::clone(&told.patch),
        Some(index) => Arc::new(told.patch.lifted(problem.fields.get(c)?.as_grid()?, HEIGHTS_M[index], 0.0)),
    };
    Some(View { channel: told.channel, level: told.level, node: told.node, shapes, narrowed, patch })
}

/// Models on the same map, each over all these offsets; none where an effect says nothing to a channel.
fn search(
    problem: &Problem<'_>,
    told: &[View<'_>],
    group: &[Alternative],
    offsets: &[[f64; 2]],
    step: [f64; 2],
) -> Vec<Found> {
    let mut totals = vec![vec![0.0; offsets.len()]; group.len()];
    for (c, view) in told.iter().enumerate() {
        let views: Option<Vec<View<'_>>> = group.iter().map(|a| with_effect(problem, view, a, c)).collect();
        let Some(views) = views else { return group.iter().map(|_| Found::none()).collect() };
        let setups: Vec<Setup<'_>> = views.iter().map(|v| v.setup(problem, step)).collect();
        let cells: Vec<[f64; 2]> = offsets.iter().map(|o| view.channel.cells(*o)).collect();
        let blocks: Vec<Vec<Wide>> = cells
            .par_chunks(LANES)
            .with_min_len(8)
            .map_init(Scratch::default, |scratch, block| kernel::compare(&setups, block, view.level, scratch))
            .collect();
        for (i, block) in blocks.iter().enumerate() {
            for (total, scores) in totals.iter_mut().zip(block) {
                for (sum, score) in total[i * LANES..].iter_mut().zip(scores) {
                    *sum += TEMPER * score;
                }
            }
        }
    }
    totals.iter().map(|total| Found::of(total)).collect()
}

impl Found {
    fn none() -> Self {
        Self { log_evidence: f64::NEG_INFINITY, best: Vec::new() }
    }

    fn of(total: &[f64]) -> Self {
        let mut best: Vec<usize> = (0..total.len()).filter(|i| total[*i].is_finite()).collect();
        best.sort_unstable_by(|a, b| total[*b].total_cmp(&total[*a]));
        best.truncate(PLACES);
        let Some(&first) = best.first() else { return Self::none() };
        let top = total[first];
        let sum: f64 = total.iter().map(|t| (t - top).exp()).filter(|p| p.is_finite()).sum();
        Self { log_evidence: top + sum.ln(), best }
    }
}

/// The models with one effect that was not told.
fn alternatives(problem: &Problem<'_>) -> Vec<Alternative> {
    let options = problem.options;
    let mut out = Vec::new();
    let cell_m = (problem.cell[0] * problem.scale_m[0] * problem.cell[1] * problem.scale_m[1]).sqrt();
    for (index, height_m) in HEIGHTS_M.iter().enumerate() {
        if options.height_sigma_m == 0.0 && *height_m >= LEAST_HEIGHT_CELLS * cell_m {
            out.push(Alternative { effect: "height", height: Some(index), shapes: Vec::new() });
        }
    }
    // Of every channel its own.
    let mut add = |effect: &'static str, shapes: &dyn Fn(&Prepared) -> Vec<Shape>| {
        let shapes = problem.channels.iter().map(shapes).collect();
        out.push(Alternative { effect, height: None, shapes });
    };
    if options.leg_bias_sigma == 0.0 && problem.legs.last().is_some_and(|l| *l > 0) {
        add("legs", &|c| leg_shapes(&problem.legs, BIAS_SHARE * spread(&c.values)));
        add("legs", &|c| leg_shapes(&problem.legs, SMALL_BIAS * c.unit));
    }
    if options.bias_walk == 0.0 {
        add("bias_walk", &|c| walk_shapes(&problem.age, BIAS_SHARE * spread(&c.values)));
    }
    add("reading_scale", &|c| {
        let mean = mean(&c.values);
        vec![Shape::Added(c.values.iter().map(|v| READING_SCALE as f32 * (v - mean)).collect())]
    });
    if options.heading_sigma_deg == 0.0 {
        let turned = HEADING_DEG.to_radians();
        let moved = |[e, n]: &[f64; 2]| [turned * n, -turned * e].map(|v| v as f32);
        add("heading", &|_| vec![Shape::Moved(problem.away_m.iter().map(moved).collect())]);
    }
    if options.drift_sigma_m == 0.0 {
        let by = (DRIFT_TOLERANCES * problem.tolerance_m) as f32;
        let along = |d: usize| {
            let one = |age: &f64| std::array::from_fn(|i| if i == d { -by * *age as f32 } else { 0.0 });
            Shape::Moved(problem.age.iter().map(one).collect())
        };
        add("drift", &|_| vec![along(0), along(1)]);
    }
    out
}

/// Size of an effect at the place where it fits best.
fn estimate(
    problem: &Problem<'_>,
    view: &View<'_>,
    told: &View<'_>,
    effect: &Alternative,
    offset: [f64; 2],
    step: [f64; 2],
) -> f64 {
    if let Some(index) = effect.height {
        return HEIGHTS_M[index];
    }
    let level = view.channel.noise.levels[view.level];
    let setup = view.setup(problem, step);
    let detail = kernel::detail(&setup, view.channel.cells(offset), level, &mut Scratch::default());
    let before = told.shapes.len();
    let theta = |i: usize| detail.theta.get(before + i).copied().unwrap_or(0.0);
    // What the effect as fitted does to a sample.
    let added = |k: usize| -> f64 {
        let of = |(i, shape): (usize, &Shape)| match shape {
            Shape::Added(by) => theta(i) * f64::from(by[k]),
            Shape::Moved(_) | Shape::Lifted => 0.0,
        };
        view.shapes[before..].iter().enumerate().map(of).sum()
    };
    match effect.effect {
        "legs" => {
            let steps = (0..problem.samples).map(added);
            steps.fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
        }
        "bias_walk" => added(problem.samples - 1) - added(0),
        "reading_scale" => (1.0 - READING_SCALE * theta(0)).recip(),
        "heading" => HEADING_DEG * theta(0),
        _ => DRIFT_TOLERANCES * problem.tolerance_m * theta(0).hypot(theta(1)),
    }
}

fn mean(values: &[f32]) -> f32 {
    (values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len().max(1) as f64) as f32
}

/// Standard deviation of the readings, value units.
fn spread(values: &[f32]) -> f64 {
    let mean = f64::from(mean(values));
    (values.iter().map(|v| (f64::from(*v) - mean).powi(2)).sum::<f64>() / values.len().max(1) as f64).sqrt()
}
