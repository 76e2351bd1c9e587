//! The effects that are looked for, and what they do to the samples.

use std::sync::Arc;

use super::super::kernel::{self, KernelScratch, Setup};
use super::super::nuisance::{Shape, drift_shapes, leg_shapes};
use super::super::patch::Patch;
use super::super::problem::{PreparedChannel, Problem};
use crate::grid::HEIGHTS_M;

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
pub(super) struct Alternative {
    pub effect: &'static str,
    /// Height above the map, metres, where that is the effect.
    pub height: Option<f64>,
    /// What it does to the samples of every channel; or the values of every channel's patch at that height.
    pub shapes: Vec<Vec<Shape>>,
    pub maps: Vec<Vec<f32>>,
}

/// A channel as the tests look at it.
pub(super) struct View<'a> {
    pub channel: &'a PreparedChannel,
    /// The error level that fits the answer best, and the component of the nuisance parameters.
    pub level: usize,
    component: usize,
    shapes: Vec<Shape>,
    narrowed: Vec<f64>,
    patch: Arc<Patch>,
}

impl<'a> View<'a> {
    /// Under the model as told, where it is declared to be.
    pub fn new(problem: &Problem<'_>, channel: &'a PreparedChannel, offset: [f64; 2], step: [f64; 2]) -> Self {
        let levels = &channel.noise.levels;
        let component = problem.best_component(channel, offset, channel.noise.typical, step);
        let setup = problem.setup(channel, component, step);
        let scores =
            kernel::score::<false>(&setup, &[channel.cells(offset)], 0..levels.len(), &mut KernelScratch::default());
        let merit = |v: usize| scores.log_likelihood[v][0] + levels[v].log_prior;
        let level = (0..levels.len()).fold(0, |a, b| if merit(b) > merit(a) { b } else { a });
        let (shapes, narrowed) = (problem.nuisance.shapes.clone(), problem.nuisance.narrowed.clone());
        let patch = Arc::clone(channel.patch_at(&problem.nuisance.components[component]));
        Self { channel, level, component, shapes, narrowed, patch }
    }

    /// The same with one effect more that leaves the map as it is.
    pub fn with(&self, effect: &Alternative, c: usize) -> Self {
        let mut shapes = self.shapes.clone();
        let mut narrowed = self.narrowed.clone();
        shapes.extend(effect.shapes.get(c).into_iter().flatten().cloned());
        narrowed.resize(shapes.len(), 1.0);
        Self { shapes, narrowed, patch: Arc::clone(&self.patch), ..*self }
    }

    pub fn setup<'b>(&'b self, problem: &'b Problem<'_>, step: [f64; 2]) -> Setup<'b> {
        let setup = problem.setup(self.channel, self.component, step);
        Setup { patch: &self.patch, shapes: &self.shapes, narrowed: &self.narrowed, ..setup }
    }
}

/// The models with one effect that was not told.
pub(super) fn alternatives(problem: &Problem<'_>, told: &[View<'_>]) -> Vec<Alternative> {
    let options = problem.options;
    let mut out = Vec::new();
    let cell_m = (problem.cell[0] * problem.scale_m[0] * problem.cell[1] * problem.scale_m[1]).sqrt();
    for height_m in HEIGHTS_M {
        if options.height_sigma_m == 0.0 && height_m >= LEAST_HEIGHT_CELLS * cell_m {
            let map =
                |(c, view): (usize, &View<'_>)| Some(view.patch.at_height(problem.fields.get(c)?.as_grid()?, height_m));
            let maps: Option<Vec<Vec<f32>>> = told.iter().enumerate().map(map).collect();
            // A field that is no grid is not continued.
            let Some(maps) = maps else { break };
            out.push(Alternative { effect: "height", height: Some(height_m), shapes: Vec::new(), maps });
        }
    }
    // Of every channel its own.
    let mut add = |effect: &'static str, shapes: &dyn Fn(&PreparedChannel) -> Vec<Shape>| {
        let shapes = problem.channels.iter().map(shapes).collect();
        out.push(Alternative { effect, height: None, shapes, maps: Vec::new() });
    };
    if options.leg_bias_sigma == 0.0 && problem.legs.last().is_some_and(|l| *l > 0) {
        add("legs", &|c| leg_shapes(&problem.legs, BIAS_SHARE * spread(&c.values)));
        add("legs", &|c| leg_shapes(&problem.legs, SMALL_BIAS * c.unit));
    }
    if options.bias_drift_sigma == 0.0 {
        add("bias_drift", &|c| drift_shapes(&problem.age, BIAS_SHARE * spread(&c.values)));
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

/// Size of an effect at a place, by the first channel.
pub(super) fn estimate(
    problem: &Problem<'_>,
    told: &View<'_>,
    effect: &Alternative,
    offset: [f64; 2],
    step: [f64; 2],
) -> f64 {
    if let Some(height_m) = effect.height {
        return height_m;
    }
    let view = told.with(effect, 0);
    let level = view.channel.noise.levels[view.level];
    let setup = view.setup(problem, step);
    let detail = kernel::detail(&setup, view.channel.cells(offset), level, &mut KernelScratch::default());
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
        "bias_drift" => added(problem.samples - 1) - added(0),
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
