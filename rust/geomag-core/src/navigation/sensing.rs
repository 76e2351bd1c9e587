//! What a sensor reads at a place, according to a field that geomag has.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::{metres_per_degree, wrap_longitude};
use crate::grid::{Axis, GridMap, GridValues, Interpolation};
use crate::harmonic::{Altitude, HarmonicMap, Positions, Quantity, RectangularHarmonicModel};

/// Nodes along each axis at which the standard deviation of a model is computed beforehand.
const SIGMA_NODES: usize = 9;

/// What the sensor measures of a harmonic model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Sensor {
    /// Three components: north, east, down at the vehicle's own place.
    Vector,
    /// One scalar.
    Scalar(Quantity),
}

/// A field and what is read of it.
///
/// Places are map coordinates: x east and y north in metres, or degrees of longitude and latitude.
#[derive(Debug, Clone)]
pub struct Sensing {
    source: Source,
    /// Standard deviation of the source itself, one map a component; none where it is not known.
    sigma: Vec<GridMap>,
    largest_sigma: Vec<f64>,
}

#[derive(Debug, Clone)]
enum Source {
    Harmonic {
        model: Arc<RectangularHarmonicModel>,
        sensor: Sensor,
        level: Altitude,
        /// On a plane, the model with zero there, so that a filter pays for no exponential.
        flat: Option<Arc<RectangularHarmonicModel>>,
    },
    Map {
        field: Arc<dyn Field>,
        interpolation: Interpolation,
    },
}

impl Sensing {
    /// A sensor on a plane `down_m` below the origin of a harmonic model; coordinates in metres.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] for a main field of length zero.
    pub fn at_down(model: Arc<RectangularHarmonicModel>, sensor: Sensor, down_m: f64) -> Result<Self> {
        Self::harmonic(model, sensor, Altitude::Down(down_m))
    }

    /// A sensor at a constant height above the Earth of a harmonic model's frame; coordinates in degrees.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::Invalid`] for a model without a frame or a main field of length zero.
    pub fn at_height(model: Arc<RectangularHarmonicModel>, sensor: Sensor, height_m: f64) -> Result<Self> {
        let Some(frame) = model.frame().copied() else {
            return Err(Error::invalid("height_m", "a model with a frame on the Earth", "a model without one"));
        };
        Self::harmonic(model, sensor, Altitude::Height(frame, height_m))
    }

    /// A scalar sensor over a map; `interpolation` is how a grid is read between its nodes (bicubic for smooth
    /// gradients).
    pub fn map(field: Arc<dyn Field>, interpolation: Interpolation) -> Self {
        Self { source: Source::Map { field, interpolation }, sigma: Vec::new(), largest_sigma: Vec::new() }
    }

    fn harmonic(model: Arc<RectangularHarmonicModel>, sensor: Sensor, level: Altitude) -> Result<Self> {
        let sensor = match sensor {
            Sensor::Scalar(quantity) => {
                HarmonicMap::on(Arc::clone(&model), quantity, level)?;
                Sensor::Scalar(model.as_fitted(quantity))
            }
            Sensor::Vector => {
                for axis in [Quantity::North, Quantity::East, Quantity::Down] {
                    HarmonicMap::on(Arc::clone(&model), axis, level)?;
                }
                Sensor::Vector
            }
        };
        let shared = Arc::clone(&model);
        let flat = match level {
            Altitude::Down(down) if model.region().down_m[0] <= down && model.contains(centre_of(&model, down)) => {
                Some(Arc::new(model.seen_from(down)))
            }
            _ => None,
        };
        let source = Source::Harmonic { model, sensor, level, flat };
        let mut sensing = Self { source, sigma: Vec::new(), largest_sigma: Vec::new() };
        if shared.has_covariance() {
            sensing.sigma = sensing.sigma_maps(&shared, level)?;
            sensing.largest_sigma = sensing
                .sigma
                .iter()
                .map(|map| (0..map.values().len()).map(|i| map.values().get(i)).fold(0.0, f64::max))
                .collect();
        }
        Ok(sensing)
    }

    /// How many numbers a reading has.
    pub fn len(&self) -> usize {
        match self.source {
            Source::Harmonic { sensor: Sensor::Vector, .. } => 3,
            _ => 1,
        }
    }

    /// Whether a reading has no number: never.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// Whether coordinates are degrees.
    pub fn geographic(&self) -> bool {
        match &self.source {
            Source::Harmonic { level, .. } => matches!(level, Altitude::Height(..)),
            Source::Map { field, .. } => field.geographic(),
        }
    }

    /// Metres per map unit `[east, north]` at a place.
    pub fn metres_per_unit(&self, y: f64) -> [f64; 2] {
        match &self.source {
            Source::Harmonic { level: Altitude::Height(..), .. } => metres_per_degree(y),
            Source::Harmonic { .. } => [1.0, 1.0],
            Source::Map { field, .. } => field.metres_per_unit(y),
        }
    }

    /// Brings a longitude to the turn that the field is on.
    pub fn wrap_x(&self, x: f64) -> f64 {
        match &self.source {
            Source::Harmonic { level: Altitude::Height(frame, _), .. } => wrap_longitude(x, frame.longitude_deg()),
            Source::Harmonic { .. } => x,
            Source::Map { field, .. } => field.wrap_x(x),
        }
    }

    /// Whether the field is known at a place.
    pub fn covers(&self, x: f64, y: f64) -> bool {
        match &self.source {
            Source::Harmonic { model, level, .. } => model.contains(level.point(x, y)),
            Source::Map { field, .. } => !field.value(x, y).is_nan(),
        }
    }

    /// Readings at places `[x, y]`, one after the other in `out` ([`Sensing::len`] numbers each).
    ///
    /// A harmonic model is continued beyond its region; a map gives NaN off its nodes.
    pub fn read(&self, places: &[[f64; 2]], out: &mut [f64]) {
        let width = self.len();
        match &self.source {
            Source::Map { field, interpolation } => {
                for (place, out) in places.iter().zip(out.iter_mut()) {
                    *out = match field.as_grid() {
                        Some(grid) => grid.sample(place[0], place[1], *interpolation),
                        None => field.value(place[0], place[1]),
                    };
                }
            }
            Source::Harmonic { model, sensor, level, flat } => {
                let n = places.len();
                let mut axes = vec![0.0; 3 * n];
                for (i, &[x, y]) in places.iter().enumerate() {
                    [axes[i], axes[n + i], axes[2 * n + i]] = level.point(x, y);
                }
                let model = flat.as_ref().map_or(model, |flat| {
                    axes[2 * n..].fill(0.0);
                    flat
                });
                let Ok(positions) = Positions::new(&axes[..n], &axes[n..2 * n], &axes[2 * n..]) else {
                    return out.fill(f64::NAN);
                };
                model.for_each::<false>(&positions, 0..n, true, |i, found| {
                    let out = &mut out[i * width..(i + 1) * width];
                    let [x, y] = places[i];
                    match (found, sensor) {
                        (None, _) => out.fill(f64::NAN),
                        (Some(e), Sensor::Vector) => out.copy_from_slice(&level.to_own(x, y, e.field)),
                        (Some(e), Sensor::Scalar(quantity)) => {
                            out[0] = quantity.of(e.field, |own| level.from_own(x, y, own)).0;
                        }
                    }
                });
            }
        }
    }

    /// Reading at a place with its gradient per metre `[east, north]`, one a number; NaN where the field is unknown.
    pub fn read_with_gradient(&self, x: f64, y: f64) -> Vec<(f64, [f64; 2])> {
        match &self.source {
            Source::Map { field, interpolation } => vec![match field.as_grid() {
                Some(grid) => grid.sample_and_gradient(x, y, *interpolation),
                None => field.value_and_gradient(x, y),
            }],
            Source::Harmonic { model, sensor, level, .. } => {
                let e = model.evaluate_at(level.point(x, y));
                let along = |direction: [f64; 3]| {
                    let slope: [f64; 3] =
                        std::array::from_fn(|j| (0..3).map(|i| direction[i] * e.gradient[i][j]).sum());
                    let [north, east, _] = level.to_own(x, y, slope);
                    [east, north]
                };
                match sensor {
                    Sensor::Vector => {
                        let own = level.to_own(x, y, e.field);
                        (0..3)
                            .map(|k| {
                                let mut axis = [0.0; 3];
                                axis[k] = 1.0;
                                (own[k], along(level.from_own(x, y, axis)))
                            })
                            .collect()
                    }
                    Sensor::Scalar(quantity) => {
                        let (value, sensed) = quantity.of(e.field, |own| level.from_own(x, y, own));
                        vec![(value, along(sensed))]
                    }
                }
            }
        }
    }

    /// Standard deviation of the stored field itself at a place, for one number of the reading; zero for a field that says
    /// nothing of its errors, `None` where a map that does says nothing here ([`Field::known_sigma`]).
    pub fn sigma(&self, x: f64, y: f64, number: usize) -> Option<f64> {
        match &self.source {
            Source::Map { field, .. } => field.known_sigma(x, y),
            Source::Harmonic { .. } => Some(match self.sigma.get(number) {
                None => 0.0,
                Some(map) => {
                    let sigma = map.sample(x, y, Interpolation::Bilinear);
                    // Beyond the nodes the model is no better than at its worst.
                    if sigma.is_nan() { self.largest_sigma[number] } else { sigma }
                }
            }),
        }
    }

    /// The standard deviation on a few nodes over the region: a covariance of hundreds of coefficients is too slow for
    /// every step of a filter, and what it says is smooth.
    fn sigma_maps(&self, model: &RectangularHarmonicModel, level: Altitude) -> Result<Vec<GridMap>> {
        let region = model.region();
        let (x, y) = match level {
            Altitude::Down(_) => (region.east_m, region.north_m),
            Altitude::Height(frame, _) => {
                let corner =
                    |i: usize, j: usize| frame.inverse([region.north_m[i], region.east_m[j], region.down_m[1]]);
                let corners = [corner(0, 0), corner(0, 1), corner(1, 0), corner(1, 1)];
                let range = |k: usize| {
                    corners.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], c| [a.min(c[k]), b.max(c[k])])
                };
                (range(1), range(0))
            }
        };
        let axis = |[low, high]: [f64; 2]| {
            let step = (high - low) / (SIGMA_NODES - 1) as f64;
            Axis::new(low, if step > 0.0 { step } else { 1.0 }, SIGMA_NODES)
        };
        let (x, y) = (axis(x)?, axis(y)?);
        let places: Vec<[f64; 2]> =
            (0..SIGMA_NODES * SIGMA_NODES).map(|k| [x.at(k % SIGMA_NODES), y.at(k / SIGMA_NODES)]).collect();
        let points: Vec<[f64; 3]> = places.iter().map(|&[x, y]| level.point(x, y)).collect();
        let coordinate = |i: usize| points.iter().map(|p| p[i]).collect::<Vec<_>>();
        let (north, east, down) = (coordinate(0), coordinate(1), coordinate(2));
        let positions = Positions::new(&north, &east, &down)?;
        let Source::Harmonic { sensor, .. } = &self.source else {
            return Ok(Vec::new());
        };
        let columns: Vec<Vec<f64>> = match sensor {
            Sensor::Vector => {
                let sigma = model.sigma(&positions, true)?;
                (0..3).map(|k| sigma.iter().map(|s| s[k]).collect()).collect()
            }
            Sensor::Scalar(quantity) => {
                let field = model.field(&positions, true);
                let directions: Vec<[f64; 3]> = places
                    .iter()
                    .zip(&field)
                    .map(|(&[x, y], &field)| quantity.of(field, |own| level.from_own(x, y, own)).1)
                    .collect();
                vec![model.sigma_along(&positions, &directions, true)?]
            }
        };
        columns.into_iter().map(|c| GridMap::from_axes(GridValues::F64(c), x, y, self.geographic())).collect()
    }
}

/// A place in the middle of the region, on a plane.
fn centre_of(model: &RectangularHarmonicModel, down_m: f64) -> [f64; 3] {
    let middle = |[low, high]: [f64; 2]| 0.5 * (low + high);
    [middle(model.region().north_m), middle(model.region().east_m), down_m]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::harmonic::{Region, terms};

    #[test]
    fn a_plane_reads_what_the_model_says_there() {
        let region = Region { north_m: [-1e3, 1e3], east_m: [-1e3, 1e3], down_m: [-200.0, 50.0] };
        let mut coefficients = vec![3.0, -4.0, 7.0];
        coefficients.extend(terms(9).enumerate().map(|(k, _)| 900.0 * (1.3 * k as f64).sin()));
        let model = Arc::new(RectangularHarmonicModel::new(9, [2.6e3; 2], coefficients, region).unwrap());
        for down in [0.0, -130.0, 20.0, -5e3] {
            let sensing = Sensing::at_down(Arc::clone(&model), Sensor::Vector, down).unwrap();
            let places: Vec<[f64; 2]> =
                (0..7).map(|k| [130.0 * f64::from(k) - 400.0, 90.0 * f64::from(k) - 300.0]).collect();
            let mut out = vec![0.0; 21];
            sensing.read(&places, &mut out);
            for (place, found) in places.iter().zip(out.chunks_exact(3)) {
                let expected = model.field_at([place[1], place[0], down]);
                for (f, e) in found.iter().zip(expected) {
                    assert!((f - e).abs() < 1e-11 * (1.0 + e.abs()), "{down} {f} {e}");
                }
            }
        }
    }
}
