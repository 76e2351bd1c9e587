//! What the map says of its own errors, as a filter needs it; and what is taken where it says nothing.

use super::options::{NavigatorMethod, NavigatorOptions};
use crate::field::Field;
use crate::grid::{GridMap, Interpolation};
use crate::map_error::{DistanceLayer, FilterLaw};

/// Correlation length of the errors where only a standard deviation is stated, in distances to the data.
const USUAL_CORRELATION: f64 = 1.5;
/// Batches gather readings over so many correlation lengths, however many readings that are: one and a half, and what readings far apart add
/// by overshooting.
const BATCH_CORRELATIONS: f64 = 2.0;
/// Longest stretch of a batch, metres.
const LONGEST_BATCH_M: f64 = 20_000.0;
/// Range over which a map of lines is straight enough to track, in median distances to the data.
const STRAIGHT: f64 = 2.5;
/// Samples of the matcher's windows are this share of it apart.
const WINDOW_SPACING: f64 = 0.7;
/// Nodes that are looked at, along each axis, for what is typical of a map.
const LOOKS: usize = 128;

/// The errors of a map at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MapPlace {
    /// Standard deviation of one sample, value units.
    pub sigma: f64,
    /// Distance to the data, metres.
    pub distance_m: f64,
}

/// The law of a map's errors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct MapLaw {
    /// Numbers for a filter, learnt or usual.
    law: FilterLaw,
    correlation: f64,
    /// Sigma of the sample where the map states none.
    bare_sigma: f64,
    /// Distance to the data where none is kept.
    usual_distance_m: f64,
    /// Whether the map has no errors: its readings are taken one by one.
    pub exact: bool,
    /// How far a position may be out for the field to be linear over it, metres.
    pub linear_m: f64,
    batch_m: Option<f64>,
}

impl MapLaw {
    /// From what the field knows of itself and what was asked for.
    pub fn new(field: &dyn Field, options: &NavigatorOptions) -> Self {
        let grid = field.layout();
        let model = grid.and_then(GridMap::error_model);
        let looked = Looked::at(field);
        let bare = grid.is_some_and(|g| g.map_sigma().is_none() && g.error_model().is_none());
        let textbook = options.method != NavigatorMethod::Navigator;
        let exact = textbook || (!bare && model.is_none() && looked.sigma == 0.0);
        let usual_distance_m = match model.map(|m| &m.distance_m) {
            Some(DistanceLayer::Constant(d)) => *d,
            Some(DistanceLayer::Grid(_)) => looked.distance_m,
            // Maps are gridded at about a quarter of the spacing of their lines, whose mean distance is a quarter of it too.
            None => looked.cell_m,
        };
        let mut law = model.and_then(|m| m.filter).unwrap_or(FilterLaw {
            // Lines that cross disagree by about what is left where the map is at its best.
            crossover: looked.least_sigma,
            sample_factor: if model.is_some() { FilterLaw::default().sample_factor } else { 1.0 },
            ..FilterLaw::default()
        });
        if let Some(share) = options.registration {
            law.registration_m_per_d = share;
        }
        if exact {
            law.registration_m_per_d = options.registration.unwrap_or(0.0);
            law.crossover = 0.0;
            if textbook {
                law.sample_factor = 0.0;
                law.registration_m_per_d = 0.0;
            }
        }
        // A map of lines is known at their spacing; over an exact one the field itself says how far it is straight.
        let linear_m = if exact { looked.length_m } else { STRAIGHT * usual_distance_m };
        Self {
            law,
            correlation: model.map_or(USUAL_CORRELATION, |m| m.correlation),
            bare_sigma: if bare { looked.roughness } else { 0.0 },
            usual_distance_m,
            exact,
            linear_m: options.linear_m.unwrap_or(linear_m),
            batch_m: options.batch_m,
        }
    }

    /// What is known at a place; `None` where the field's error is unknown.
    pub fn at(&self, field: &dyn Field, x: f64, y: f64, height_m: Option<f64>) -> Option<MapPlace> {
        let sigma = match height_m {
            Some(height) => Some(field.sigma_at(x, y, height)).filter(|s| !s.is_nan()),
            None => field.known_sigma(x, y),
        }?;
        let sigma = if sigma == 0.0 { self.bare_sigma } else { sigma };
        Some(MapPlace { sigma: self.law.sample_factor * sigma, distance_m: self.distance_m(field, x, y) })
    }

    /// Distance to the data at a place, metres.
    pub fn distance_m(&self, field: &dyn Field, x: f64, y: f64) -> f64 {
        field.layout().and_then(|grid| distance_at(grid, x, y)).unwrap_or(self.usual_distance_m)
    }

    /// Stretch over which readings are gathered into one measurement, metres; zero takes every reading by itself.
    ///
    /// Where lines cross the distance is short and the errors are not: they are those of whole lines, whose levels disagree.
    pub fn batch_m(&self, distance_m: f64) -> f64 {
        let distance_m = distance_m.max(self.usual_distance_m);
        let natural = if self.exact { 0.0 } else { BATCH_CORRELATIONS * self.correlation * distance_m };
        self.batch_m.unwrap_or(natural).min(LONGEST_BATCH_M)
    }

    /// Distance between samples of the matcher's windows, metres.
    pub fn window_spacing_m(&self) -> f64 {
        WINDOW_SPACING * self.linear_m
    }

    /// Variance of the mean error of a batch whose samples have this root-mean-square sigma.
    pub fn mean_variance(&self, sigma: f64, batched: bool) -> f64 {
        let factor = if batched { self.law.batch_factor } else { 1.0 };
        self.law.crossover.powi(2) + (factor * sigma).powi(2)
    }

    /// Least error of any mean, value units.
    pub fn crossover(&self) -> f64 {
        self.law.crossover
    }

    /// Standard deviation of the displacement of the map's features at this distance to the data, metres.
    pub fn registration_m(&self, distance_m: f64) -> f64 {
        self.law.registration_m_per_d * distance_m
    }

    /// Length over which that changes, metres.
    pub fn registration_length_m(&self, distance_m: f64) -> f64 {
        (self.law.registration_length * distance_m).max(1.0)
    }
}

/// Distance to the data at the nearest node; `None` off the map or where it is not known.
fn distance_at(grid: &GridMap, x: f64, y: f64) -> Option<f64> {
    let d = match &grid.error_model()?.distance_m {
        DistanceLayer::Constant(d) => *d,
        DistanceLayer::Grid(layer) => {
            let [px, py] = grid.position(x, y);
            let (column, row) = (px.round(), py.round());
            let inside = column >= 0.0 && row >= 0.0 && column < grid.x().len() as f64 && row < grid.y().len() as f64;
            if !inside {
                return None;
            }
            f64::from(layer[row as usize * grid.x().len() + column as usize])
        }
    };
    d.is_finite().then_some(d)
}

/// What is typical of a field, from a look at a part of its nodes.
struct Looked {
    /// Greatest stated sigma.
    sigma: f64,
    /// Stated sigma at the tenth part of the places that are known best.
    least_sigma: f64,
    /// Median distance to the data, metres.
    distance_m: f64,
    cell_m: f64,
    /// Root mean square of what the nodes between others are missed by, value units.
    roughness: f64,
    /// Standard deviation of the field over the root mean square of its slope, half of it (a twelfth of a wavelength), metres.
    length_m: f64,
}

impl Looked {
    fn at(field: &dyn Field) -> Self {
        let Some(grid) = field.layout() else {
            let spacing = field.spacing();
            let scale = field.metres_per_unit(0.0);
            let cell_m = 0.5 * (spacing[0] * scale[0] + spacing[1] * scale[1]);
            return Self { sigma: 0.0, least_sigma: 0.0, distance_m: cell_m, cell_m, roughness: 0.0, length_m: cell_m };
        };
        let (columns, rows) = (grid.x().len(), grid.y().len());
        let scale = grid.metres_per_unit(0.5 * (grid.y().first() + grid.y().last()));
        let cell_m = 0.5 * (grid.x().step() * scale[0] + grid.y().step() * scale[1]);
        let (mut sigmas, mut distances) = (Vec::new(), Vec::new());
        let (mut count, mut square, mut slope, mut missed, mut between) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for row in (0..rows).step_by(rows.div_ceil(LOOKS)) {
            for column in (0..columns).step_by(columns.div_ceil(LOOKS)) {
                let (x, y) = (grid.x().at(column), grid.y().at(row));
                let (value, gradient) = grid.sample_and_gradient(x, y, Interpolation::Bilinear);
                if value.is_nan() {
                    continue;
                }
                if let Some(sigma) = grid.known_sigma(x, y) {
                    sigmas.push(sigma);
                }
                distances.extend(distance_at(grid, x, y));
                count += 1.0;
                square += (value - grid.mean()).powi(2);
                if gradient.iter().all(|g| g.is_finite()) {
                    slope += gradient[0].powi(2) + gradient[1].powi(2);
                }
                let step = grid.x().step();
                let sides = 0.5
                    * (grid.sample(x - step, y, Interpolation::Bilinear)
                        + grid.sample(x + step, y, Interpolation::Bilinear));
                if sides.is_finite() {
                    missed += (value - sides).powi(2);
                    between += 1.0;
                }
            }
        }
        sigmas.sort_by(f64::total_cmp);
        distances.sort_by(f64::total_cmp);
        let length_m = 0.5 * (square / slope.max(f64::MIN_POSITIVE)).sqrt();
        Self {
            sigma: sigmas.last().copied().unwrap_or(0.0),
            least_sigma: sigmas.get(sigmas.len() / 10).copied().unwrap_or(0.0),
            distance_m: distances.get(distances.len() / 2).copied().unwrap_or(cell_m),
            cell_m,
            roughness: if between > 0.0 { (missed / between).sqrt() } else { 0.0 },
            length_m: if count > 0.0 { length_m.clamp(1.5 * cell_m, 1e6) } else { cell_m },
        }
    }
}
