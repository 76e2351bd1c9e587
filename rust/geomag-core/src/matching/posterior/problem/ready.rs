//! Everything of a search that does not depend on the candidate.

use std::sync::Arc;

use super::super::kernel::Setup;
use super::super::noise::{Interpolant, Noise, bias_prior};
use super::super::nuisance::{HEIGHT_NARROWED, HEIGHTS, Nuisance, legs, reach_m};
use super::super::options::PosteriorOptions;
use super::super::patch::{Patch, PatchPlace};
use super::channel::PreparedChannel;
use super::interruption::Interruption;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::matching::scene::Channel;
use crate::stack::Storey;
use crate::track::Track;

/// Mean square over a cell of what a curve leaves a straight line by, in squares of the second difference: 1/120, more along two axes.
const BETWEEN_SHARE: f64 = 1.0 / 90.0;
/// Sum over a track of those squares, in variances of the sensor, up to which no reading tells one surface from another.
const ALIKE: f64 = 2.0;

/// A problem made ready: everything that does not depend on the candidate.
pub(in super::super) struct Problem<'a> {
    pub options: &'a PosteriorOptions,
    pub field: &'a dyn Field,
    /// The maps of all channels.
    pub fields: Vec<&'a dyn Field>,
    pub channels: Vec<PreparedChannel>,
    pub samples: usize,
    pub nuisance: Nuisance,
    /// Which straight leg every sample belongs to, and its age from 1 (first) to 0 (newest).
    pub legs: Vec<usize>,
    pub age: Vec<f64>,
    /// Displacement of every sample from the newest, metres `[east, north]`.
    pub away_m: Vec<[f64; 2]>,
    /// Metres per map unit.
    pub scale_m: [f64; 2],
    pub cell: [f64; 2],
    pub tolerance_m: f64,
    pub spacing_m: f64,
    pub interruption: Interruption<'a>,
}

/// Whether no reading along these positions tells one surface through the nodes of a map from another.
fn alike(patch: &Patch, positions: &[[f64; 2]], noise: &Noise) -> bool {
    let square = |p: &[f64; 2]| {
        let [u, v] = patch.position(p[0], p[1]);
        f64::from(patch.at(u, v, Storey::GROUND).bend).powi(2)
    };
    let bent: f64 = positions.iter().map(square).sum();
    BETWEEN_SHARE * bent < ALIKE * noise.sensor_variance
}

/// The box around these places with that much room on every side: its low and its high corner.
fn around(places: &[[f64; 2]], room: [f64; 2]) -> ([f64; 2], [f64; 2]) {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for p in places {
        for d in 0..2 {
            low[d] = low[d].min(p[d] - room[d]);
            high[d] = high[d].max(p[d] + room[d]);
        }
    }
    (low, high)
}

impl<'a> Problem<'a> {
    /// Checks the input and lays out the maps.
    pub fn new(channels: &[Channel<'a>], track: &Track, options: &'a PosteriorOptions) -> Result<Self> {
        Self::on(channels, track, options, None)
    }

    /// The same, on a window of the first map that was laid out before and covers all candidates.
    #[allow(clippy::too_many_lines)] // every input is checked and laid out once, in the order that later ones need
    pub fn on(
        channels: &[Channel<'a>],
        track: &Track,
        options: &'a PosteriorOptions,
        laid_out: Option<&Arc<Patch>>,
    ) -> Result<Self> {
        options.validate()?;
        let Some(first) = channels.first() else {
            return Err(Error::invalid("channels", "at least one map with its values", "none"));
        };
        let field = first.field;
        track.require_on(field.geographic())?;
        let n = track.len();
        let positions: Vec<[f64; 2]> = (0..n).map(|k| [field.wrap_x(track.x()[k]), track.y()[k]]).collect();
        let middle = positions.iter().map(|p| p[1]).sum::<f64>() / n as f64;
        let scale_m = field.metres_per_unit(middle);
        let cell = field.spacing();
        let newest = positions[n - 1];
        let away: Vec<[f64; 2]> = positions.iter().map(|p| field.displacement_m(newest, *p)).collect();
        let spacing_m = positions
            .windows(2)
            .map(|w| {
                let [e, north] = field.displacement_m(w[0], w[1]);
                e.hypot(north)
            })
            .sum::<f64>()
            / (n.max(2) - 1) as f64;
        let age: Vec<f64> = match track.time_s() {
            Some(t) if t[n - 1] > t[0] => t.iter().map(|t_k| (t[n - 1] - t_k) / (t[n - 1] - t[0])).collect(),
            _ => (0..n).map(|k| (n - 1 - k) as f64 / (n.max(2) - 1) as f64).collect(),
        };
        let mut nuisance = Nuisance::new(options, &away, &age);
        let lever_m = away.iter().map(|[e, n]| e.hypot(*n)).fold(0.0, f64::max);
        let reach_m = reach_m(options, lever_m);
        let reach = [0, 1].map(|d| options.half_width[d] + reach_m / scale_m[d]);
        let mut prepared = Vec::with_capacity(channels.len());
        for (index, channel) in channels.iter().enumerate() {
            if channel.values.len() != n {
                return Err(Error::shape(
                    format!("values of channel {index}"),
                    format!("({n},) as the track"),
                    format!("({},)", channel.values.len()),
                ));
            }
            crate::error::require_finite("values", channel.values)?;
            if channel.field.geographic() != field.geographic() {
                return Err(Error::invalid(
                    format!("map of channel {index}"),
                    "the same kind of coordinates as the first map",
                    if channel.field.geographic() { "degrees" } else { "metres" },
                ));
            }
            // Every map may be on a turn of longitude of its own.
            let positions: Vec<[f64; 2]> = (0..n).map(|k| [channel.field.wrap_x(track.x()[k]), track.y()[k]]).collect();
            let mut noise = Noise::new(channel, options)?;
            let patch = match laid_out {
                Some(patch) if index == 0 => {
                    if noise.covered && alike(patch, &positions, &noise) {
                        noise.with_one_surface();
                    }
                    Arc::clone(patch)
                }
                _ => {
                    let (low, high) = around(&positions, reach);
                    let mut patch = Patch::new(channel.field, low, high, options.max_candidates, false)?;
                    if noise.covered && alike(&patch, &positions, &noise) {
                        noise.with_one_surface();
                    }
                    if noise.levels.iter().any(|l| l.surface != Interpolant::Bilinear) {
                        patch.add_curves();
                    }
                    Arc::new(patch)
                }
            };
            let values: Vec<f32> = channel.values.iter().map(|v| (v - patch.level) as f32).collect();
            let cell_m = [patch.step()[0] * scale_m[0], patch.step()[1] * scale_m[1]];
            let indicated: Vec<[f64; 2]> = positions.iter().map(|p| patch.position(p[0], p[1])).collect();
            let storeys = match (channel.field.as_stack(), track.height_m()) {
                (Some(stack), Some(heights)) => stack.storeys(heights)?,
                _ => vec![Storey::GROUND; n],
            };
            if let Some(correlation) = channel.field.as_stack().and_then(|stack| stack.correlation(&storeys)) {
                noise.correlation = correlation;
            }
            // The kernel's unit is the typical error, so that single precision has room on both sides of it.
            let there = indicated.iter().zip(&storeys);
            let variances = there.map(|(p, storey)| f64::from(patch.at(p[0], p[1], *storey).variance));
            let map_variance = variances.filter(|v| v.is_finite()).sum::<f64>() / n as f64;
            let largest = values.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            let unit = (noise.sensor_variance + map_variance).sqrt().max(1e-7 * f64::from(largest)).max(1e-30);
            let places =
                indicated.iter().zip(&storeys).map(|(p, storey)| PatchPlace::new(*p).in_storey(*storey)).collect();
            let places = vec![places];
            prepared.push(PreparedChannel {
                patch,
                lifted: Vec::new(),
                places,
                indicated,
                storeys,
                values,
                noise,
                cell_m,
                unit,
            });
        }
        if options.height_sigma_m > 0.0 {
            for (channel, of) in prepared.iter_mut().zip(channels) {
                let Some(grid) = of.field.as_grid() else {
                    let needed = "0 for a field that is no grid: only grids are continued";
                    return Err(Error::invalid("height_sigma_m", needed, options.height_sigma_m));
                };
                let sigma = options.height_sigma_m;
                let at = |z: &f64| Arc::new(channel.patch.lifted(grid, z * sigma, HEIGHT_NARROWED * sigma));
                channel.lifted = HEIGHTS.iter().map(at).collect();
            }
        }
        if !nuisance.shapes.is_empty() || options.height_sigma_m > 0.0 {
            let linear_m = prepared.iter().map(PreparedChannel::linear_m).fold(f64::INFINITY, f64::min);
            nuisance = nuisance.divided(linear_m, &away, &age);
            if options.height_sigma_m > 0.0 {
                nuisance = nuisance.at_heights();
            }
            for channel in &mut prepared {
                channel.move_to(&nuisance);
            }
        }
        let tolerance_m = options.tolerance_m.unwrap_or_else(|| (cell[0] * scale_m[0]).max(cell[1] * scale_m[1]));
        Ok(Self {
            options,
            field,
            fields: channels.iter().map(|c| c.field).collect(),
            channels: prepared,
            samples: n,
            nuisance,
            legs: legs(&away),
            age,
            away_m: away,
            scale_m,
            cell,
            tolerance_m,
            spacing_m,
            interruption: Interruption::default(),
        })
    }

    pub fn setup<'b>(&'b self, channel: &'b PreparedChannel, component: usize, step: [f64; 2]) -> Setup<'b> {
        let jitter = self.options.position_sigma_m.powi(2);
        // The lattice step is the width of a uniform distribution.
        let blur = |d: usize| ((step[d] * self.scale_m[d]).powi(2) / 12.0 + jitter) as f32;
        Setup {
            patch: channel.patch_at(&self.nuisance.components[component]),
            places: &channel.places[component],
            values: &channel.values,
            per_unit: (1.0 / channel.unit) as f32,
            cell_m: channel.cell_m.map(|m| m as f32),
            half_cells: channel.cells(step).map(|s| (0.5 * s) as f32),
            blur_m2: [blur(0), blur(1)],
            sensor_variance: channel.sensor_variance() as f32,
            lifts: !channel.lifted.is_empty(),
            cover: 0.0,
            levels: &channel.noise.levels,
            bias_sigma: bias_prior(self.options.bias_sigma, channel.unit),
            shapes: &self.nuisance.shapes,
            narrowed: &self.nuisance.narrowed,
            min_overlap: self.options.min_overlap,
        }
    }
}
