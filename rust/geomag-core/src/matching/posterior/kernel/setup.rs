//! What the kernel is given, what it answers, and its room to work in.

use super::super::noise::{ErrorLevel, LEVELS};
use super::super::nuisance::Shape;
pub(in super::super) use super::super::patch::LANES;
use super::super::patch::{Patch, PatchPlace};

/// Multipliers of the variance in successive reweightings.
pub(super) const WIDENING: [f32; 4] = [100.0, 9.0, 1.0, 1.0];
/// Most nuisance parameters: bias, heading, scale, drift east and north, legs, walk of the bias, and one more effect that is tested.
pub(super) const MOST_PARAMETERS: usize = 16;
/// Sizes for which there is room in less.
pub(super) const FEW_PARAMETERS: usize = 2;
pub(super) const SOME_PARAMETERS: usize = 5;

pub(super) type Lane = [f32; LANES];
pub(in super::super) type Wide = [f64; LANES];

/// What the kernel needs to know beside the map.
#[derive(Debug, Clone)]
pub(in super::super) struct Setup<'a> {
    pub patch: &'a Patch,
    /// Indicated positions in cells of the patch.
    pub places: &'a [PatchPlace],
    /// Measured values minus the patch's level, value units.
    pub values: &'a [f32],
    /// One over the unit of the residuals, value units.
    pub per_unit: f32,
    /// Metres per cell of the map, `[east, north]`.
    pub cell_m: [f32; 2],
    /// Half the lattice step in cells: the reach of a bound.
    pub half_cells: [f32; 2],
    /// The lattice step and the position jitter as one standard deviation per axis, metres squared.
    pub blur_m2: [f32; 2],
    /// In units squared.
    pub sensor_variance: f32,
    /// Whether any of the shapes is the map's change with height.
    pub lifts: bool,
    /// What the map may do between its nodes, in units of its bend, in the reach of a bound that stands for all levels.
    pub cover: f32,
    pub levels: &'a [ErrorLevel],
    /// None: no bias at all; infinite: unknown without bound. In units.
    pub bias_sigma: Option<f64>,
    /// What every other nuisance parameter does to the samples per standard deviation.
    pub shapes: &'a [Shape],
    /// Those standard deviations over the prior's, where the prior is divided.
    pub narrowed: &'a [f64],
    pub min_overlap: f64,
}

/// Log-likelihoods and mean distance to the data of `LANES` candidates.
#[derive(Debug, Clone)]
pub(in super::super) struct Scores {
    /// `[level][lane]`, minus infinity where too few samples lie on the map.
    pub log_likelihood: [Wide; LEVELS],
    pub distance: Lane,
    /// Mean map variance along the track, units squared.
    pub map_variance: Lane,
    /// Mean square of what the map cannot say between its nodes, units squared.
    pub between: Lane,
}

impl Scores {
    /// Of no candidate at all.
    pub fn nothing() -> Self {
        Self {
            log_likelihood: [[f64::NEG_INFINITY; LANES]; LEVELS],
            distance: [0.0; LANES],
            map_variance: [0.0; LANES],
            between: [0.0; LANES],
        }
    }

    /// Multiplies the likelihoods by a weight.
    pub fn weigh(&mut self, log_weight: f64) {
        for log in self.log_likelihood.iter_mut().flatten() {
            *log += log_weight;
        }
    }

    /// The largest log-likelihood of every level.
    pub fn best(&self) -> [f64; LEVELS] {
        self.log_likelihood.map(|lanes| lanes.iter().copied().fold(f64::NEG_INFINITY, f64::max))
    }

    /// Adds the likelihoods of another hypothesis on the same candidates.
    pub fn add(&mut self, other: &Self) {
        for (mine, its) in self.log_likelihood.iter_mut().flatten().zip(other.log_likelihood.iter().flatten()) {
            let (high, low) = if *mine >= *its { (*mine, *its) } else { (*its, *mine) };
            if low - high > -30.0 {
                *mine = high + (low - high).exp().ln_1p();
            } else {
                *mine = high;
            }
        }
    }
}

/// Rows of one sample for a block of candidates.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct SampleLanes {
    /// From the bilinear surface, and what the bicubic one and the spline add to that.
    pub residual: Lane,
    pub curve: Lane,
    pub spline: Lane,
    /// Change with height, per standard deviation of it.
    pub lift: Lane,
    /// From the surface of the level at hand.
    pub error: Lane,
    /// Square of what the map cannot say between its nodes: the most of it, and the least within the cell of a bound.
    pub between: Lane,
    pub least_between: Lane,
    pub map_variance: Lane,
    pub extra_variance: Lane,
    pub known: Lane,
    pub precision: Lane,
    pub distance: Lane,
    /// Per metre.
    pub gradient: [Lane; 2],
    /// What the residual may change by within the candidate's cell.
    pub reach: Lane,
}

pub(super) const EMPTY: SampleLanes = SampleLanes {
    residual: [0.0; LANES],
    curve: [0.0; LANES],
    spline: [0.0; LANES],
    lift: [0.0; LANES],
    error: [0.0; LANES],
    between: [0.0; LANES],
    least_between: [0.0; LANES],
    map_variance: [0.0; LANES],
    extra_variance: [1.0; LANES],
    known: [0.0; LANES],
    precision: [0.0; LANES],
    distance: [0.0; LANES],
    gradient: [[0.0; LANES]; 2],
    reach: [0.0; LANES],
};

/// Room for one block of candidates, reused from block to block.
#[derive(Debug, Default)]
pub(in super::super) struct KernelScratch {
    pub(super) rows: Vec<SampleLanes>,
}
