//! What a streaming matcher holds and saves: the samples, the candidates left, and the gate that drops them.

use serde::{Deserialize, Serialize};

use super::super::lattice::Lattice;
use super::super::noise::Noise;
use super::super::nuisance::reach_m;
use super::super::options::PosteriorOptions;
use super::super::patch::Patch;
use super::candidate::GateCandidate;
use crate::bounds::{require_places, require_values};
use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::field::Field;
use crate::fix::Status;
use crate::matching::scene::Channel;
use crate::stack::Storey;
use crate::state::Saved;

/// Width of the gate in standard deviations of one sample.
const GATE: f64 = 5.0;
/// Samples that may fall outside the gate, and the share of all that may beside them: with one outlier in twenty, one track
/// in a hundred thousand has more.
const FIRST_MISSES: u32 = 3;
const MISS_SHARE: f64 = 0.2;
/// Fewest samples of a fix.
pub(super) const FEWEST: usize = 3;
/// Standard deviations of heading, scale and drift by which the offset may have moved between samples.
const MOVED: f64 = 4.0;
/// What the field may do between the nodes of the map, in units of its second difference there.
const BETWEEN: f64 = 0.375;

/// The part that is saved: everything but the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Held {
    pub options: PosteriorOptions,
    pub sigma: Option<f64>,
    pub max_samples: usize,
    pub x: Vec<f64>,
    pub y: Vec<f64>,
    pub values: Vec<f64>,
    /// One a sample, or none.
    pub heights_m: Vec<f64>,
    pub seen: usize,
    /// Samples let go since the gate was last laid out.
    pub let_go: usize,
    pub lattice: Lattice,
    pub candidates: Vec<GateCandidate>,
    /// By how much the offset may have moved since the candidates were last spread, metres.
    pub moved_m: f64,
    pub next: usize,
    pub status: Status,
    pub risk: f64,
    /// The box of the map that is laid out, x from and to, y from and to: what is linear depends on it.
    pub window: Option<[f64; 4]>,
}

impl Saved for Held {
    const NAME: &'static str = "PosteriorMatcher";

    fn check(&self) -> Result<()> {
        self.options.validate()?;
        let n = self.x.len();
        if [self.y.len(), self.values.len()] != [n, n] {
            let got = format!("{} and {}", self.y.len(), self.values.len());
            return Err(Error::shape("samples: y and values", format!("({n},) as x"), got));
        }
        require_places("samples", false, &self.x, &self.y)?;
        require_values("values", &self.values)?;
        if self.max_samples < FEWEST || n > self.max_samples || n > self.seen {
            let got = format!("{n} held, {} seen, {} at most", self.seen, self.max_samples);
            return Err(Error::invalid("samples", "no more held than seen and than may be held", got));
        }
        require_not_negative("movement", self.moved_m)?;
        if self.let_go > self.max_samples {
            return Err(Error::invalid("samples let go", format!("at most {}", self.max_samples), self.let_go));
        }
        if !(0.0..=1.0).contains(&self.risk) {
            return Err(Error::invalid("risk", "a probability", self.risk));
        }
        if let Some(c) = self.candidates.iter().find(|c| !c.counts_within(self.seen)) {
            let got = format!("{c:?} of {} samples seen", self.seen);
            return Err(Error::invalid("candidate", "counts of samples that were seen", got));
        }
        if let Some([west, east, south, north]) = self.window {
            require_finite("window", &[west, east, south, north])?;
            if !(west <= east && south <= north) {
                return Err(Error::invalid("window", "from less to more", format!("{:?}", self.window)));
            }
        }
        Ok(())
    }
}

impl Held {
    /// A new window of the map that the samples held can touch, only when the track has left the one that is laid out.
    pub fn leaves_window(&self, field: &dyn Field) -> Option<[f64; 4]> {
        let s = self;
        let half = s.options.half_width;
        let (Some(&newest_x), Some(&newest_y)) = (s.x.last(), s.y.last()) else { return None };
        let newest = [newest_x, newest_y];
        let from_newest = |(x, y): (&f64, &f64)| {
            let [east, north] = field.displacement_m(newest, [*x, *y]);
            east.hypot(north)
        };
        let lever_m = s.x.iter().zip(&s.y).map(from_newest).fold(0.0, f64::max);
        let reach_m = reach_m(&s.options, lever_m);
        let scale_m = field.metres_per_unit(newest_y);
        let reach = [half[0] + reach_m / scale_m[0], half[1] + reach_m / scale_m[1]];
        let mut needed = [f64::INFINITY, f64::NEG_INFINITY, f64::INFINITY, f64::NEG_INFINITY];
        for (x, y) in s.x.iter().zip(&s.y) {
            let x = field.wrap_x(*x);
            needed[0] = needed[0].min(x - reach[0]);
            needed[1] = needed[1].max(x + reach[0]);
            needed[2] = needed[2].min(y - reach[1]);
            needed[3] = needed[3].max(y + reach[1]);
        }
        let inside =
            s.window.is_some_and(|b| needed[0] >= b[0] && needed[1] <= b[1] && needed[2] >= b[2] && needed[3] <= b[3]);
        if inside {
            return None;
        }
        // Room to go on for as long as the search is wide, and half the track again.
        let room = [half[0] + 0.25 * (needed[1] - needed[0]), half[1] + 0.25 * (needed[3] - needed[2])];
        Some([needed[0] - room[0], needed[1] + room[0], needed[2] - room[1], needed[3] + room[1]])
    }

    /// Puts one sample, indicated position and measured value, to the gate on the map that is laid out.
    pub fn gate(&mut self, field: &dyn Field, patch: &Patch, sample: [f64; 3], height_m: Option<f64>) -> Result<()> {
        let [x, y, value] = sample;
        let storey = field.as_stack().zip(height_m).and_then(|(stack, h)| stack.storey(h)).unwrap_or(Storey::GROUND);
        let x = field.wrap_x(x);
        let channel = Channel { field, values: &self.values, sigma: self.sigma };
        let noise = Noise::new(&channel, &self.options)?;
        let worst = noise.levels.iter().map(|l| l.factor).fold(0.0, f64::max).powi(2);
        let value = value - patch.level;
        let step = self.lattice.step;
        let cell = patch.step();
        let (half_x, half_y) = (0.5 * step[0] / cell[0], 0.5 * step[1] / cell[1]);
        let scale_m = field.metres_per_unit(y);
        let o = &self.options;
        let jitter = o.position_sigma_m.powi(2);
        let (per_x, per_y) = (1.0 / (cell[0] * scale_m[0]), 1.0 / (cell[1] * scale_m[1]));
        let (half_x, half_y) = (half_x + self.moved_m * per_x, half_y + self.moved_m * per_y);
        let between = if noise.levels.iter().any(|l| l.between > 0.0) { BETWEEN } else { 0.0 };
        // What a bias may step and walk by, and what a height may change: over it the map changes about as much as along it.
        let untold = GATE * o.leg_bias_sigma.hypot(o.bias_drift_sigma);
        let lift_cells = 3.0 * o.height_sigma_m * per_x.max(per_y);
        let bias_reach = match o.bias_sigma {
            None => f64::INFINITY,
            Some(s) => 4.0 * s,
        };
        let allowed = FIRST_MISSES + (MISS_SHARE * (self.x.len() + self.let_go) as f64) as u32;
        self.candidates.retain_mut(|c| {
            let [px, py] = patch.position(x + c.offset[0], y + c.offset[1]);
            let sample = patch.at(px, py, storey);
            if !sample.value.is_finite() {
                // A hole is no evidence.
                return true;
            }
            let [gx, gy] = sample.gradient.map(f64::from);
            let own = noise.sensor_variance
                + worst * f64::from(sample.variance)
                + jitter * ((gx * per_x).powi(2) + (gy * per_y).powi(2));
            let reach = GATE * own.sqrt()
                + half_x * gx.abs()
                + half_y * gy.abs()
                + (between + half_x.max(half_y).min(1.0)) * f64::from(sample.bend)
                + untold
                + lift_cells * (gx.hypot(gy) + f64::from(sample.bend));
            let residual = value - f64::from(sample.value);
            c.take([residual - reach, residual + reach], bias_reach);
            c.misses <= allowed
        });
        Ok(())
    }
    /// Counts by how much heading, scale and drift may have moved the offset since the sample before.
    pub fn note_movement(&mut self, field: &dyn Field) {
        let s = self;
        let n = s.x.len();
        if n < 2 {
            return;
        }
        let o = &s.options;
        let [east, north] = field.displacement_m([s.x[n - 2], s.y[n - 2]], [s.x[n - 1], s.y[n - 1]]);
        let turned = east.hypot(north) * o.heading_sigma_deg.to_radians().hypot(o.scale_sigma);
        // The drift is that over the samples held, however many these are.
        s.moved_m += MOVED * turned.hypot(o.drift_sigma_m / (n - 1) as f64);
    }

    /// Spreads the candidates to those that the offset may have moved to, once that is more than `share` of a lattice step.
    pub fn spread(&mut self, field: &dyn Field, share: f64) {
        let s = self;
        let (Some(&y), Some(first)) = (s.y.last(), s.candidates.first()) else { return };
        let scale_m = field.metres_per_unit(y);
        let steps = [0, 1].map(|d| s.moved_m / (s.lattice.step[d] * scale_m[d]));
        if steps[0].max(steps[1]) <= share {
            return;
        }
        s.moved_m = 0.0;
        let most = s.lattice.most;
        let index = |c: &GateCandidate| s.lattice.index(c.offset);
        let (mut low, mut high) = (index(first), index(first));
        for at in s.candidates.iter().map(index) {
            for d in 0..2 {
                low[d] = low[d].min(at[d]);
                high[d] = high[d].max(at[d]);
            }
        }
        let rings = [0, 1].map(|d| (steps[d].ceil() as i64).min(2 * most[d]));
        for d in 0..2 {
            low[d] = (low[d] - rings[d]).max(-most[d]);
            high[d] = (high[d] + rings[d]).min(most[d]);
        }
        let columns = (high[0] - low[0] + 1) as usize;
        let rows = (high[1] - low[1] + 1) as usize;
        // A box is a row of columns: one axis after the other costs the sum of its sides, not their product.
        for d in 0..2 {
            let mut wider: Vec<Option<GateCandidate>> = vec![None; columns * rows];
            for c in &s.candidates {
                let at = s.lattice.index(c.offset);
                for k in (at[d] - rings[d]).max(low[d])..=(at[d] + rings[d]).min(high[d]) {
                    let to = if d == 0 { [k, at[1]] } else { [at[0], k] };
                    let place = &mut wider[(to[1] - low[1]) as usize * columns + (to[0] - low[0]) as usize];
                    place.get_or_insert(GateCandidate { offset: s.lattice.offset(to), ..*c }).join(c);
                }
            }
            s.candidates = wider.into_iter().flatten().collect();
        }
    }

    /// Drops the candidates that the posterior has ruled out; `kept` is in the order of the candidates.
    pub fn prune(&mut self, kept: Vec<[f64; 2]>) {
        let mut kept = kept.into_iter();
        let mut wanted = kept.next();
        self.candidates.retain(|c| {
            let found = wanted == Some(c.offset);
            if found {
                wanted = kept.next();
            }
            found
        });
    }
}
