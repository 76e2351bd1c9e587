//! A harmonic model as a map: one scalar of it on a level surface, wherever a matcher takes a field.

use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::evaluate::{Evaluation, norm};
use super::gridded::MAX_NODES;
use super::{Positions, RectangularHarmonicModel};
use crate::bounds::require_heights;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::{LocalFrame, metres_per_degree, wrap_longitude};
use crate::grid::{Axis, GridMap, GridValues, MapHeight, MapSigma};
use crate::stack::MapStack;

/// Nodes to a shortest wavelength at which the model counts as known: the step of a search over it.
const NODES_A_WAVELENGTH: f64 = 8.0;
/// Heights that differ by less are one, metres.
const SAME_LEVEL_M: f64 = 0.1;
/// Most levels between two heights.
const MOST_LEVELS: f64 = 64.0;
/// Places along each axis at which it is seen whether a scalar is determined.
const DETERMINED_AT: usize = 4;
/// Samples along each axis from which the mean level is taken.
const MEAN_SAMPLES: usize = 24;

/// Which scalar of the field.
///
/// Main fields are north, east, down in the axes of the model's frame, in the unit of the model.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Quantity {
    /// The northward component, at the point's own north.
    North,
    /// The eastward component, at the point's own east.
    East,
    /// The downward component, at the point's own vertical.
    Down,
    /// The component along a main field.
    Projection([f64; 3]),
    /// The total-field anomaly as a scalar magnetometer has it: `|main + B| - |main|`.
    Anomaly([f64; 3]),
    /// The total intensity `|main + B|`.
    Intensity([f64; 3]),
    /// The total intensity to first order, `|main|` and the component along it: all that a fit to anomalies knows of it.
    ProjectedIntensity([f64; 3]),
}

impl Quantity {
    /// What it is called.
    pub const fn name(self) -> &'static str {
        match self {
            Self::North => "north",
            Self::East => "east",
            Self::Down => "down",
            Self::Projection(_) => "projection",
            Self::Anomaly(_) => "anomaly",
            Self::Intensity(_) | Self::ProjectedIntensity(_) => "intensity",
        }
    }

    pub(crate) fn validate(self) -> Result<Self> {
        if let Self::Projection(main) | Self::Anomaly(main) | Self::Intensity(main) | Self::ProjectedIntensity(main) =
            self
        {
            crate::bounds::require_values("main_field", &main)?;
            if norm(main) == 0.0 {
                return Err(Error::invalid("main_field", "a vector of length > 0", "a zero vector"));
            }
        }
        Ok(self)
    }

    /// Value, and the direction of the field to which it is sensitive, for a field in the axes of the frame. `own` turns
    /// north, east and down of the point into those axes.
    pub(crate) fn of(self, field: [f64; 3], own: impl Fn([f64; 3]) -> [f64; 3]) -> (f64, [f64; 3]) {
        let along = |direction: [f64; 3]| (dot(field, direction), direction);
        match self {
            Self::North => along(own([1.0, 0.0, 0.0])),
            Self::East => along(own([0.0, 1.0, 0.0])),
            Self::Down => along(own([0.0, 0.0, 1.0])),
            Self::Projection(main) => {
                let length = norm(main);
                along(main.map(|c| c / length))
            }
            Self::ProjectedIntensity(main) => {
                let length = norm(main);
                let (value, direction) = along(main.map(|c| c / length));
                (length + value, direction)
            }
            Self::Anomaly(main) | Self::Intensity(main) => {
                let total = [main[0] + field[0], main[1] + field[1], main[2] + field[2]];
                let (length, main_length) = (norm(total), norm(main));
                let value = if matches!(self, Self::Intensity(_)) {
                    length
                } else {
                    // The difference of two lengths of 50,000 nT would lose four digits.
                    (2.0 * dot(main, field) + dot(field, field)) / (length + main_length)
                };
                (value, total.map(|c| c / length))
            }
        }
    }
}

/// One scalar of a harmonic model on a level surface.
///
/// Geographic: x and y are degrees of longitude and latitude, the level is a height above the frame's Earth. Otherwise x
/// is east and y north of the frame's origin in metres, and the level a constant `down`.
///
/// Gradients leave out that north and east turn from point to point, which matters only to the three components and
/// there by the field over the Earth's radius (1e-5 nT/km for 75 nT).
#[derive(Debug, Clone)]
pub struct HarmonicMap {
    model: Arc<RectangularHarmonicModel>,
    /// As it was asked for, and as the model has it.
    asked: Quantity,
    quantity: Quantity,
    level: Altitude,
    spacing: [f64; 2],
    mean: f64,
}

/// Where the scalar is taken.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(crate) enum Altitude {
    /// A height above the Earth of a frame; geographic coordinates.
    Height(LocalFrame, f64),
    /// A plane of the frame.
    Down(f64),
}

impl Altitude {
    /// The point of the frame under map coordinates.
    pub(crate) fn point(self, x: f64, y: f64) -> [f64; 3] {
        match self {
            Self::Height(frame, height) => frame.forward(y, x, height),
            Self::Down(down) => [y, x, down],
        }
    }

    /// A vector in the axes of the frame as north, east, down at a place.
    pub(crate) fn to_own(self, x: f64, y: f64, vector: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Height(frame, _) => frame.rotate_from_origin(y, x, vector),
            Self::Down(_) => vector,
        }
    }

    /// Refuses levels that no sensor has.
    fn validate(&self) -> Result<()> {
        match self {
            Self::Height(_, height_m) => require_heights("height_m", &[*height_m]),
            Self::Down(down_m) => require_heights("down_m", &[*down_m]),
        }
    }

    /// North, east, down at a place as a vector in the axes of the frame.
    #[allow(clippy::wrong_self_convention)] // "from" is the direction of the rotation
    pub(crate) fn from_own(self, x: f64, y: f64, vector: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Height(frame, _) => frame.rotate_to_origin(y, x, vector),
            Self::Down(_) => vector,
        }
    }
}

impl HarmonicMap {
    /// On a surface of constant height (metres) above the frame's Earth; coordinates in degrees.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a model without a frame or a main field of length zero; [`Error::NotFinite`].
    pub fn at_height(model: Arc<RectangularHarmonicModel>, quantity: Quantity, height_m: f64) -> Result<Self> {
        let Some(frame) = model.frame().copied() else {
            return Err(Error::invalid("height_m", "a model with a frame on the Earth", "a model without one"));
        };
        Self::on(model, quantity, Altitude::Height(frame, height_m))
    }

    /// On a plane of the frame, `down_m` below its origin; coordinates in metres.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a main field of length zero; [`Error::NotFinite`].
    pub fn at_down(model: Arc<RectangularHarmonicModel>, quantity: Quantity, down_m: f64) -> Result<Self> {
        Self::on(model, quantity, Altitude::Down(down_m))
    }

    pub(crate) fn on(model: Arc<RectangularHarmonicModel>, quantity: Quantity, level: Altitude) -> Result<Self> {
        level.validate()?;
        let asked = quantity.validate()?;
        let quantity = model.as_fitted(asked);
        let order = model.order().max(1) as f64;
        let [north, east] = model.periods_m().map(|p| p / order / NODES_A_WAVELENGTH);
        let spacing = match level {
            Altitude::Down(_) => [east, north],
            Altitude::Height(frame, _) => {
                let [east_scale, north_scale] = metres_per_degree(frame.latitude_deg());
                [east / east_scale.max(1.0), north / north_scale]
            }
        };
        let mut map = Self { model, asked, quantity, level, spacing, mean: 0.0 };
        map.require_determined()?;
        map.mean = map.mean_over_region();
        Ok(map)
    }

    /// The model behind the map.
    pub fn model(&self) -> &Arc<RectangularHarmonicModel> {
        &self.model
    }

    /// The scalar that the map gives.
    #[allow(clippy::misnamed_getters)] // what was asked for; the field `quantity` is how it is computed
    pub fn quantity(&self) -> Quantity {
        self.asked
    }

    /// Refuses a scalar that the observations do not determine: one along a uniform field that none of them senses, or one that
    /// is less well known than it is large.
    fn require_determined(&self) -> Result<()> {
        let refuse =
            |got: String| Err(Error::invalid("quantity", "a scalar of the field that the observations determine", got));
        let (mut points, mut directions, mut signals) = (Vec::new(), Vec::new(), Vec::new());
        for [x, y] in self.places(DETERMINED_AT) {
            let point = self.level.point(x, y);
            let field = self.model.field_at(point);
            let e = Evaluation { potential: 0.0, field, gradient: [[0.0; 3]; 3] };
            let direction = self.scalar(x, y, &e).1;
            if let Some(unsensed) = self.model.unsensed(direction) {
                return refuse(format!("{}: nothing observed senses a {unsensed}", self.asked.name()));
            }
            points.push(point);
            directions.push(direction);
            signals.push(dot(direction, field));
        }
        if !self.model.has_covariance() {
            return Ok(());
        }
        let axis = |i: usize| points.iter().map(|p| p[i]).collect::<Vec<_>>();
        let (north, east, down) = (axis(0), axis(1), axis(2));
        let sigma = self.model.sigma_along(&Positions::new(&north, &east, &down)?, &directions, false)?;
        let (mut values, mut variances, mut count) = (0.0, 0.0, 0.0);
        for (signal, sigma) in signals.iter().zip(&sigma) {
            if signal.is_finite() && sigma.is_finite() {
                values += signal * signal;
                variances += sigma * sigma;
                count += 1.0;
            }
        }
        if count > 0.0 && variances > values && values > 0.0 {
            let rms = |sum: f64| (sum / count).sqrt();
            return refuse(format!(
                "{}, known to {:.3} {unit} where it is {:.3} {unit} rms",
                self.asked.name(),
                rms(variances),
                rms(values),
                unit = self.model.unit()
            ));
        }
        Ok(())
    }

    /// The map as a regular grid on given axes: upward continuation to the level, for matchers that read grids.
    ///
    /// Nodes outside the model's region are holes. The grid carries no sigma; ask the model for it.
    ///
    /// # Errors
    /// As [`GridMap::from_axes`]; [`Error::TooManyCandidates`] over 2^28 nodes, before memory is taken.
    pub fn to_grid(&self, x: Axis, y: Axis) -> Result<GridMap> {
        let needed = x.len() as u128 * y.len() as u128;
        if needed > MAX_NODES as u128 {
            return Err(Error::TooManyCandidates {
                what: "map of a harmonic model".into(),
                needed,
                limit: MAX_NODES as u64,
            });
        }
        let mut values = vec![f64::NAN; x.len() * y.len()];
        values.par_chunks_mut(x.len()).enumerate().for_each(|(row, out)| {
            let points: Vec<[f64; 3]> = (0..x.len()).map(|c| self.level.point(x.at(c), y.at(row))).collect();
            let axis = |i: usize| points.iter().map(|p| p[i]).collect::<Vec<_>>();
            let (north, east, down) = (axis(0), axis(1), axis(2));
            if let Ok(positions) = Positions::new(&north, &east, &down) {
                self.model.for_each::<false>(&positions, 0..points.len(), false, |c, found| {
                    if let Some(e) = found {
                        out[c] = self.scalar(x.at(c), y.at(row), &e).0;
                    }
                });
            }
        });
        GridMap::from_axes(GridValues::F64(values), x, y, self.geographic())
    }

    fn scalar(&self, x: f64, y: f64, e: &Evaluation) -> (f64, [f64; 3]) {
        self.quantity.of(e.field, |own| self.level.from_own(x, y, own))
    }

    /// The level at a height above the datum: the ellipsoid of the frame, or the height of the frame's origin less `down`.
    fn level_at(&self, height_m: f64) -> Altitude {
        match self.level {
            Altitude::Height(frame, _) => Altitude::Height(frame, height_m),
            Altitude::Down(_) => Altitude::Down(self.model.frame().map_or(0.0, LocalFrame::height_m) - height_m),
        }
    }

    fn at_level(&self, level: Altitude) -> Self {
        let mut map = Self { level, ..self.clone() };
        map.mean = map.mean_over_region();
        map
    }

    /// Levels from one height to another as grids on the region: between two of them the shortest wave errs by a thirtieth of itself.
    fn stack(&self, low_m: f64, high_m: f64) -> Result<MapStack> {
        let order = self.model.order().max(1) as f64;
        let shortest = self.model.periods_m().map(|p| p / order).into_iter().fold(f64::INFINITY, f64::min);
        let apart = 0.5 * shortest / std::f64::consts::TAU;
        let count = ((high_m - low_m) / apart).ceil().clamp(1.0, MOST_LEVELS) as usize;
        let region = self.model.region();
        let corner = |i: usize| {
            let (north, east) = (region.north_m[i / 2], region.east_m[i % 2]);
            match self.level {
                Altitude::Down(_) => [east, north],
                Altitude::Height(frame, _) => {
                    let [latitude, longitude, _] = frame.inverse([north, east, region.down_m[1]]);
                    [self.wrap_x(longitude), latitude]
                }
            }
        };
        let corners: Vec<[f64; 2]> = (0..4).map(corner).collect();
        let axis = |d: usize| {
            let low = corners.iter().map(|c| c[d]).fold(f64::INFINITY, f64::min);
            let high = corners.iter().map(|c| c[d]).fold(f64::NEG_INFINITY, f64::max);
            let nodes = ((high - low) / self.spacing[d]).ceil().max(1.0);
            Axis::new(low, (high - low) / nodes, nodes as usize + 1)
        };
        let (x, y) = (axis(0)?, axis(1)?);
        let level = |i: usize| {
            let height = low_m + (high_m - low_m) * i as f64 / count as f64;
            let map = self.at_level(self.level_at(height));
            let sigma = map.typical_sigma();
            map.to_grid(x, y)?.with_sigma(Some(MapSigma::Constant(sigma)))?.with_height(Some(MapHeight::Level(height)))
        };
        MapStack::new((0..=count).map(level).collect::<Result<_>>()?)
    }

    /// Root mean square of the standard deviation over the region.
    fn typical_sigma(&self) -> f64 {
        if !self.model.has_covariance() {
            return 0.0;
        }
        let places = self.places(DETERMINED_AT);
        let known: Vec<f64> = places.iter().map(|p| self.sigma(p[0], p[1]).powi(2)).filter(|s| s.is_finite()).collect();
        (known.iter().sum::<f64>() / known.len().max(1) as f64).sqrt()
    }

    /// Places spread over the region, so many along each axis.
    fn places(&self, along: usize) -> Vec<[f64; 2]> {
        let region = self.model.region();
        let at = |[low, high]: [f64; 2], k: usize| low + (high - low) * (k as f64 + 0.5) / along as f64;
        let place = |k: usize| {
            let (north, east) = (at(region.north_m, k / along), at(region.east_m, k % along));
            match self.level {
                Altitude::Down(_) => [east, north],
                Altitude::Height(frame, _) => {
                    let [latitude, longitude, _] = frame.inverse([north, east, region.down_m[1]]);
                    [longitude, latitude]
                }
            }
        };
        (0..along * along).map(place).collect()
    }

    fn mean_over_region(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for [x, y] in self.places(MEAN_SAMPLES) {
            let value = self.value(x, y);
            if value.is_finite() {
                sum += value;
                count += 1.0;
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

impl Field for HarmonicMap {
    fn value(&self, x: f64, y: f64) -> f64 {
        let field = self.model.field_at(self.level.point(x, y));
        let e = Evaluation { potential: f64::NAN, field, gradient: [[f64::NAN; 3]; 3] };
        self.scalar(x, y, &e).0
    }

    fn value_and_gradient(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let e = self.model.evaluate_at(self.level.point(x, y));
        let (value, sensed) = self.scalar(x, y, &e);
        // Along a direction of the frame: sensed . (gradient . direction).
        let slope: [f64; 3] = std::array::from_fn(|j| (0..3).map(|i| sensed[i] * e.gradient[i][j]).sum());
        let [north, east, _] = self.level.to_own(x, y, slope);
        (value, [east, north])
    }

    fn sigma(&self, x: f64, y: f64) -> f64 {
        if !self.model.has_covariance() {
            return 0.0;
        }
        let point = self.level.point(x, y);
        let e = Evaluation { potential: 0.0, field: self.model.field_at(point), gradient: [[0.0; 3]; 3] };
        let direction = self.scalar(x, y, &e).1;
        Positions::new(&point[..1], &point[1..2], &point[2..])
            .and_then(|positions| self.model.sigma_along(&positions, &[direction], false))
            .map_or(f64::NAN, |s| s[0])
    }

    fn value_at(&self, x: f64, y: f64, height_m: f64) -> f64 {
        let level = self.level_at(height_m);
        let field = self.model.field_at(level.point(x, y));
        self.quantity.of(field, |own| level.from_own(x, y, own)).0
    }

    fn value_and_gradient_at(&self, x: f64, y: f64, height_m: f64) -> (f64, [f64; 2]) {
        Self { level: self.level_at(height_m), ..self.clone() }.value_and_gradient(x, y)
    }

    fn sigma_at(&self, x: f64, y: f64, height_m: f64) -> f64 {
        Self { level: self.level_at(height_m), ..self.clone() }.sigma(x, y)
    }

    fn heights(&self) -> Option<[f64; 2]> {
        let lowest = match self.level {
            Altitude::Height(frame, _) => frame.height_m() - self.model.region().down_m[1],
            Altitude::Down(_) => self.model.frame().map_or(0.0, LocalFrame::height_m) - self.model.region().down_m[1],
        };
        Some([lowest, f64::INFINITY])
    }

    fn between(&self, low_m: f64, high_m: f64) -> Result<Option<Box<dyn Field>>> {
        let same = |level: Altitude| match (level, self.level) {
            (Altitude::Height(_, a), Altitude::Height(_, b)) | (Altitude::Down(a), Altitude::Down(b)) => {
                (a - b).abs() < SAME_LEVEL_M
            }
            _ => false,
        };
        if same(self.level_at(low_m)) && same(self.level_at(high_m)) {
            return Ok(None);
        }
        if low_m == high_m {
            return Ok(Some(Box::new(self.at_level(self.level_at(low_m)))));
        }
        Ok(Some(Box::new(self.stack(low_m, high_m)?)))
    }

    fn geographic(&self) -> bool {
        matches!(self.level, Altitude::Height(..))
    }

    fn wrap_x(&self, x: f64) -> f64 {
        match self.level {
            Altitude::Height(frame, _) => wrap_longitude(x, frame.longitude_deg()),
            Altitude::Down(_) => x,
        }
    }

    fn spacing(&self) -> [f64; 2] {
        self.spacing
    }

    fn mean(&self) -> f64 {
        self.mean
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
