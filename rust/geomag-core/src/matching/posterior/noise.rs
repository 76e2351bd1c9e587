//! What the map's error may be like: the levels of its size, its tails, the surface between the nodes, its correlation.

use super::options::PosteriorOptions;
use super::patch::DEFAULT_DISTANCE_CELLS;
use crate::bounds::require_spread;
use crate::error::Result;
use crate::field::Field;
use crate::grid::{GridMap, Interpolation, MapSigma};
use crate::map_error::{Forecast, Lapses, Recalibration};
use crate::matching::scene::Channel;

/// Tails of the map's error at one sample where no error model says otherwise.
const DEFAULT_NU: f64 = 3.0;
/// Tails of the sensor's own error where it has any: nearly normal, for one that is noisier than stated.
const SENSOR_NU: f64 = 10.0;
/// Tails of a sensor without any, and the prior probability that a track's is such: the normal distribution is worth some percent of
/// all fixes. More degrees of freedom are normal too, and beyond single precision.
const NORMAL_NU: f64 = 1000.0;
const NORMAL: f64 = 0.97;
/// Fewest degrees of freedom: heavier tails than these tell nothing of a place.
const LEAST_NU: f64 = 0.01;
/// Standard deviation of a bias, in units of a sample's, below which there is none.
const NO_BIAS: f64 = 1e-6;
/// How the field may run between the nodes of a map whose nodes are exact: the interpolation that was named; the other one; the cubic
/// spline; near that, and anyhow. Prior probabilities, and the standard deviation about the spline in units of the second difference's
/// part there: a spline and cubic convolution through the same nodes differ by a tenth of that on smooth fields (features of 8
/// cells) and by half on rough ones (4 cells).
const AS_NAMED: f64 = 0.5;
const THE_OTHER: f64 = 0.15;
const SPLINE: f64 = 0.15;
const NEAR_SPLINE: (f64, f64) = (0.12, 0.2);
const ANYHOW: (f64, f64) = (0.08, 0.8);
/// The same for a map whose error is stated, or that says nothing of it: the whole difference.
const STATED_BETWEEN: f64 = 1.0;
/// And for a map with a learnt error model, whose sigma holds most of it.
const LEARNT_BETWEEN: f64 = 0.577_350_269;
/// Correlation length of the errors of a map with a stated sigma and no word on it, in cells: neighbouring nodes share an error.
const STATED_CORRELATION_CELLS: f64 = 1.0;
/// Where the sensor's error is all there is: the greatest loss of a sample, of one outlier in a hundred spread over a hundred standard
/// deviations. Tails that go on falling would let an outlier choose between places.
const MOST_LOSS: f64 = 8.0;
/// What an error model says where there is none, all from the two surveys of docs/calibration-report.md, taken together: the
/// spread of the error level of one track,
const DEFAULT_SPREAD: f64 = 0.35;
/// the correlation length of map errors in distances to the data, towards the longer ones that were learnt,
const DEFAULT_CORRELATION: f64 = 1.75;
/// and the registration error in distances to the data.
const DEFAULT_REGISTRATION: f64 = 0.15;
/// Levels of the default map error, in units of the default of patch.rs, and the logarithms of their prior weights, found
/// on bare grids of the same two surveys and on EMM2017 ("With less than the lines" of the report): a map with no word about its error may
/// as well be a field known exactly as a sparse survey, and hardly anything between.
const UNKNOWN_LEVELS: [(f64, f64); 5] = [(0.0, 0.0), (0.1, -2.0), (0.33, -1.0), (1.0, 0.0), (3.0, -1.0)];

/// Standard deviations of the error level over which residuals are checked, and the spread for that over the posterior's own:
/// the posterior's is how most tracks fare, but one in twenty of a survey's is worse than three of it (docs/calibration-report.md),
/// and most of these are matched rightly.
const CHECKED: i32 = 4;
const CHECKED_SPREAD: f64 = 2.0;

/// Most error levels of one channel.
pub(super) const LEVELS: usize = UNKNOWN_LEVELS.len() + 1;

/// A surface through the nodes of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Interpolant {
    Bilinear,
    Bicubic,
    Spline,
}

impl Interpolant {
    /// Shares of what the bicubic surface and the spline add to the bilinear one.
    pub fn parts(self) -> (f32, f32) {
        match self {
            Self::Bilinear => (0.0, 0.0),
            Self::Bicubic => (1.0, 0.0),
            Self::Spline => (0.0, 1.0),
        }
    }
}

/// One hypothesis on the error of the map along a track.
#[derive(Debug, Clone, Copy)]
pub(super) struct ErrorLevel {
    /// Factor on the map's sigma.
    pub factor: f64,
    /// Degrees of freedom.
    pub nu: f64,
    /// Greatest loss of one sample, infinite where there is none.
    pub most_loss: f64,
    /// The surface through the nodes about which the field is expected.
    pub surface: Interpolant,
    /// Standard deviation about it, in units of what a straight line between nodes leaves out.
    pub between: f64,
    /// Logarithm of its prior probability.
    pub log_prior: f64,
}

impl ErrorLevel {
    /// Whether another level differs in its tails only.
    pub fn same_surface(&self, other: &Self) -> bool {
        (self.factor, self.surface, self.between) == (other.factor, other.surface, other.between)
    }
}

/// Error statistics of one channel, settled.
#[allow(clippy::struct_excessive_bools)] // independent facts about a map
#[derive(Debug, Clone)]
pub(super) struct Noise {
    pub sensor_variance: f64,
    /// What the map's error may be.
    pub levels: Vec<ErrorLevel>,
    /// Whether the first level's bound, with what the map may do between its nodes in its reach, stands for all of them at the
    /// first stage of a search.
    pub covered: bool,
    /// Whether the first level's bound stands for all levels at every stage: they differ in their tails only.
    pub alike: bool,
    /// Whether the error model was learnt from the map's own lines.
    pub learnt: bool,
    /// The level by which places are ranked and residuals are judged.
    pub typical: usize,
    /// Whether a level is a distance to the data, so that it scales correlation and registration as well.
    pub levels_are_distances: bool,
    /// Standard deviation of the logarithm of a track's error level, 0 where the levels are no spread about the map's sigma.
    pub spread: f64,
    /// Correlation length and registration error, in distances to the data.
    pub correlation: f64,
    pub registration: f64,
    /// How computed risks are to be read.
    pub recalibration: Option<Recalibration>,
    pub lapses: Option<Lapses>,
    /// Factor from computed covariances to declared ones.
    pub covariance_factor: Option<f64>,
    /// How planned flights fare.
    pub forecast: Option<Forecast>,
}

impl Noise {
    pub fn new(channel: &Channel<'_>, options: &PosteriorOptions) -> Result<Self> {
        let grid = channel.field.layout();
        let model = grid.and_then(|g| g.error_model());
        let stated = grid.is_none_or(|g| g.map_sigma().is_some());
        let exact = match grid.and_then(|g| g.map_sigma()) {
            Some(MapSigma::Constant(s)) => *s == 0.0,
            Some(MapSigma::Grid(_)) => false,
            None => grid.is_none(),
        };
        let spread = model.map_or(DEFAULT_SPREAD, |m| m.scale_spread);
        let named = options.nu.map(|nu| nu.clamp(LEAST_NU, NORMAL_NU));
        let map_nu = named.or(model.map(|m| m.nu.clamp(LEAST_NU, NORMAL_NU))).unwrap_or(DEFAULT_NU);
        let sensor_nu = named.unwrap_or(SENSOR_NU);
        let (surface, other) = match options.interpolation {
            Interpolation::Bilinear => (Interpolant::Bilinear, Interpolant::Bicubic),
            Interpolation::Bicubic => (Interpolant::Bicubic, Interpolant::Bilinear),
        };
        let of_factor = |&(factor, log_prior): &(f64, f64)| ErrorLevel {
            factor,
            nu: if factor == 0.0 { sensor_nu } else { map_nu },
            most_loss: f64::INFINITY,
            surface,
            between: if grid.is_none() {
                0.0
            } else if model.is_some() {
                LEARNT_BETWEEN
            } else {
                STATED_BETWEEN
            },
            log_prior,
        };
        let mut levels: Vec<ErrorLevel> = if exact {
            let most_loss = if named.is_none() { MOST_LOSS } else { f64::INFINITY };
            let level = |nu: f64, surface: Interpolant, between: f64, prior: f64| ErrorLevel {
                factor: 0.0,
                nu: named.unwrap_or(nu),
                most_loss,
                surface,
                between,
                log_prior: prior.ln(),
            };
            let mut levels = if named.is_none() {
                vec![
                    level(SENSOR_NU, surface, 0.0, AS_NAMED * (1.0 - NORMAL)),
                    level(NORMAL_NU, surface, 0.0, AS_NAMED * NORMAL),
                ]
            } else {
                vec![level(sensor_nu, surface, 0.0, AS_NAMED)]
            };
            if grid.is_some() {
                levels.push(level(NORMAL_NU, other, 0.0, THE_OTHER));
                levels.push(level(NORMAL_NU, Interpolant::Spline, 0.0, SPLINE));
                levels.push(level(NORMAL_NU, Interpolant::Spline, NEAR_SPLINE.1, NEAR_SPLINE.0));
                levels.push(level(SENSOR_NU, Interpolant::Spline, ANYHOW.1, ANYHOW.0));
            }
            levels
        } else if !stated {
            UNKNOWN_LEVELS.iter().map(of_factor).collect()
        } else if spread == 0.0 {
            vec![of_factor(&(1.0, 0.0))]
        } else {
            [-2.0_f64, -1.0, 0.0, 1.0, 2.0].iter().map(|z| of_factor(&((spread * z).exp(), -0.5 * z * z))).collect()
        };
        let total = levels.iter().map(|l| l.log_prior.exp()).sum::<f64>().ln();
        for level in &mut levels {
            level.log_prior -= total;
        }
        let sensor = match channel.sigma {
            Some(s) => require_spread("sigma", s)?,
            None => 0.0,
        };
        // Without a word about the sensor a hundredth of the signal is taken: less cannot be told from a perfect map.
        let mean = channel.values.iter().sum::<f64>() / channel.values.len().max(1) as f64;
        let spread_of_values = (channel.values.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
            / channel.values.len().max(1) as f64)
            .sqrt();
        let floor = if channel.sigma.is_none() && model.is_none() { 0.01 * spread_of_values } else { 0.0 };
        let floor = floor.max(1e-6 * spread_of_values).max(f64::MIN_POSITIVE.sqrt());
        let (correlation, registration) = match (model, grid) {
            (Some(m), _) => (m.correlation, m.registration),
            // Whoever states a sigma states all of the error: nothing is displaced beside it.
            (None, Some(g)) if stated => {
                let cells = g.correlation_m().map_or(STATED_CORRELATION_CELLS, |m| m / cell_m(g));
                (cells / DEFAULT_DISTANCE_CELLS, 0.0)
            }
            _ => (DEFAULT_CORRELATION, DEFAULT_REGISTRATION),
        };
        Ok(Self {
            sensor_variance: sensor.max(floor).powi(2),
            covered: exact && grid.is_some(),
            alike: exact && grid.is_none(),
            learnt: model.is_some(),
            // The middle of a spread.
            typical: if exact { 0 } else { levels.len() / 2 },
            levels,
            levels_are_distances: !stated,
            spread: if exact || !stated { 0.0 } else { spread },
            correlation,
            registration,
            recalibration: model.and_then(|m| m.recalibration),
            lapses: model.and_then(|m| m.lapses),
            covariance_factor: model.and_then(|m| m.covariance_factor),
            forecast: model.and_then(|m| m.forecast),
        })
    }
}

/// Mean side of a map's cell, metres.
fn cell_m(grid: &GridMap) -> f64 {
    let [x, y] = grid.spacing();
    let [east, north] = grid.metres_per_unit(0.5 * (grid.y().first() + grid.y().last()));
    (x * east * y * north).sqrt()
}

/// The standard deviation of a bias in kernel units as the kernel takes it: none for no bias at all, infinite for one unknown
/// without bound. A prior too narrow to be told from none is none.
pub(super) fn bias_prior(sigma: Option<f64>, unit: f64) -> Option<f64> {
    match sigma.map(|s| s / unit) {
        None => Some(f64::INFINITY),
        Some(s) if s < NO_BIAS => None,
        Some(s) => Some(s),
    }
}

/// Whether matching on this map looks at curved surfaces through its nodes: one that says its nodes are exact, or one to be read so.
pub(super) fn wants_curves(field: &dyn Field, options: &PosteriorOptions) -> bool {
    let Some(grid) = field.as_grid() else { return false };
    let exact = matches!(grid.map_sigma(), Some(MapSigma::Constant(s)) if *s == 0.0);
    exact || options.interpolation == Interpolation::Bicubic
}

impl Noise {
    /// Takes all surfaces through the nodes for one where the readings cannot tell them apart: the one that was named, and what the
    /// others differ by as its error.
    pub fn with_one_surface(&mut self) {
        let named = self.levels[0].surface;
        self.levels.retain(|l| l.surface == named && l.between == 0.0);
        let total = self.levels.iter().map(|l| l.log_prior.exp()).sum::<f64>().ln();
        for level in &mut self.levels {
            level.between = STATED_BETWEEN;
            level.log_prior -= total;
        }
        (self.covered, self.alike) = (false, true);
    }

    /// The levels over which residuals are checked: every way that the field may run between exact nodes; those of a spread to its far tail;
    /// else the worst, of which a track may be without being unlikely.
    pub fn checked(&self) -> Vec<ErrorLevel> {
        if self.covered {
            return self.levels.clone();
        }
        if self.spread == 0.0 {
            let size = |l: &ErrorLevel| (l.factor, l.between);
            let worst =
                self.levels.iter().copied().fold(self.levels[0], |a, b| if size(&b) > size(&a) { b } else { a });
            return vec![ErrorLevel { log_prior: 0.0, ..worst }];
        }
        let typical = self.levels[self.typical];
        let z = (-2 * CHECKED..=2 * CHECKED).map(|i| 0.5 * f64::from(i));
        let total = z.clone().map(|z| (-0.5 * z * z).exp()).sum::<f64>().ln();
        z.map(|z| ErrorLevel {
            factor: (CHECKED_SPREAD * self.spread * z).exp(),
            log_prior: -0.5 * z * z - total,
            ..typical
        })
        .collect()
    }

    /// Displacement of features common to a whole track, per axis, metres.
    pub fn displacement(&self, distance: f64, level: &ErrorLevel) -> f64 {
        self.registration * distance * if self.levels_are_distances { level.factor.min(1.0) } else { 1.0 }
    }
}
