//! One channel made ready: its map laid out, its readings, the model of its errors.

use std::sync::Arc;

use super::super::noise::{ErrorLevel, Noise};
use super::super::nuisance::{Component, Nuisance};
use super::super::patch::{Patch, PatchPlace};
use crate::stack::Storey;

/// Curvature times half the square of a displacement, in standard deviations of a sample, up to which it is linear.
const LINEAR: f64 = 0.2;
/// Bounds of the displacement that is taken as linear, cells of the map.
const LINEAR_CELLS: [f64; 2] = [0.2, 10.0];

/// One channel, made ready.
pub(in super::super) struct PreparedChannel {
    pub patch: Arc<Patch>,
    /// The same at the heights of the nuisance's components, where the height is uncertain.
    pub(super) lifted: Vec<Arc<Patch>>,
    /// Indicated positions at every component of the nuisance parameters, in cells of the patch: `places[component][sample]`.
    pub(super) places: Vec<Vec<PatchPlace>>,
    /// Indicated positions, cells of the patch.
    pub(super) indicated: Vec<[f64; 2]>,
    /// Where their heights lie among the levels of the map.
    pub(super) storeys: Vec<Storey>,
    /// Measured values minus the patch's level, value units.
    pub values: Vec<f32>,
    pub noise: Noise,
    pub(super) cell_m: [f64; 2],
    /// Unit of the kernel's residuals, value units.
    pub unit: f64,
}

impl PreparedChannel {
    /// The map at the height of a component.
    pub fn patch_at(&self, component: &Component) -> &Arc<Patch> {
        self.lifted.get(component.height).unwrap_or(&self.patch)
    }

    /// Mean square of standard deviations in value units, kernel units squared.
    pub(super) fn mean_variance(&self, sigma: &[f64]) -> f64 {
        sigma.iter().map(|s| (s / self.unit).powi(2)).sum::<f64>() / sigma.len().max(1) as f64
    }

    /// Mean square of what the map cannot say between its nodes along the indicated track, kernel units squared.
    pub(super) fn between(&self, samples: usize) -> f64 {
        let square = |(p, storey): (&[f64; 2], &Storey)| {
            (f64::from(self.patch.at(p[0], p[1], *storey).curvature) / self.unit).powi(2)
        };
        self.indicated.iter().zip(&self.storeys).map(square).filter(|s| s.is_finite()).sum::<f64>()
            / samples.max(1) as f64
    }

    /// Length over which the map's errors decorrelate under a level, for a mean distance to the data, metres.
    pub(super) fn correlation_m(&self, level: &ErrorLevel, distance: f64) -> f64 {
        self.noise.correlation * distance * if self.noise.levels_are_distances { level.factor.min(1.0) } else { 1.0 }
    }

    /// Share of the map in the error variance under a level, and the power to which the likelihood is taken, for a mean
    /// distance to the data in metres and mean variances of the map (at factor 1) and between its nodes (kernel units squared).
    ///
    /// Errors that decorrelate over a length l are those of an AR(1) series with coefficient exp(-spacing / l), of whose samples
    /// a share (1 - rho) / (1 + rho) = tanh(spacing / 2 l) is independent. What a map cannot say between its nodes is the same over
    /// about a cell of it.
    pub fn temper(
        &self,
        level: &ErrorLevel,
        distance: f64,
        [map_variance, between]: [f64; 2],
        spacing_m: f64,
    ) -> (f64, f64) {
        let independent = |length: f64| if length > 0.0 { (0.5 * spacing_m / length).tanh().max(1e-3) } else { 1.0 };
        let map = level.factor * level.factor * map_variance;
        // A learnt sigma holds what lies between the nodes, and its correlation is the learnt one.
        let between = if self.noise.learnt { 0.0 } else { level.between * level.between * between };
        let whole = map + between + self.sensor_variance();
        let cell_m = (self.cell_m[0] * self.cell_m[1]).sqrt();
        let slowed = self.sensor_variance() / whole
            + map / whole / independent(self.correlation_m(level, distance))
            + between / whole / independent(cell_m);
        (map / whole, slowed.recip())
    }

    /// Displacement up to which the map is linear for what this channel can tell, metres.
    pub(super) fn linear_m(&self) -> f64 {
        let cells = (2.0 * LINEAR * self.unit / self.patch.typical_bend().max(f64::MIN_POSITIVE)).sqrt();
        cells.clamp(LINEAR_CELLS[0], LINEAR_CELLS[1]) * (self.cell_m[0] * self.cell_m[1]).sqrt()
    }

    /// Lays the track out at every component.
    pub(super) fn move_to(&mut self, nuisance: &Nuisance) {
        let [east, north] = self.cell_m;
        let laid_out = |component: &Component| {
            let place = |(k, p): (usize, &[f64; 2])| {
                let moved = component.moved_m.get(k).unwrap_or(&[0.0; 2]);
                PatchPlace::new([p[0] + moved[0] / east, p[1] + moved[1] / north]).in_storey(self.storeys[k])
            };
            self.indicated.iter().enumerate().map(place).collect()
        };
        self.places = nuisance.components.iter().map(laid_out).collect();
    }

    /// Map units to cells of this channel's map.
    pub fn cells(&self, offset: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.patch.step();
        [offset[0] / x, offset[1] / y]
    }

    /// In units of the kernel.
    pub fn sensor_variance(&self) -> f64 {
        (self.noise.sensor_variance / (self.unit * self.unit)).max(1e-12)
    }
}
