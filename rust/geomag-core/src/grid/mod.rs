//! The stored map: a regular grid of field values with interpolation, gradient, holes and error.

mod axis;
mod continued;
mod ground;
mod nodes;
mod sample;

pub use axis::Axis;
pub(crate) use axis::split_position;
pub(crate) use continued::{HEIGHTS_M, at_height};
pub use nodes::{GridValues, MapHeight, MapSigma};
pub use sample::Interpolation;

use std::ops::Range;

use axis::unwrap_longitudes;
use ground::GroundScale;
use nodes::{Holes, part};

use crate::bounds::{MOST_VALUE, require_distance_m, require_spread};
use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::{metres_per_degree, wrap_longitude};
use crate::map_error::{DistanceLayer, MapErrorModel};

/// Degrees that a map of the whole circle may repeat beyond either of its ends.
const MOST_SEAM_DEG: f64 = 10.0;

/// A regular grid of field values: the map that matchers compare with.
///
/// Stored with both axes ascending, whatever direction they came in. A NaN is a hole: any interpolation that would need
/// it gives NaN. Infinite values are refused.
///
/// ```
/// use geomag_core::grid::{GridMap, GridValues, Interpolation};
/// let map = GridMap::new(GridValues::F64(vec![0.0, 1.0, 10.0, 11.0]), &[0.0, 100.0], &[0.0, 100.0], false)?;
/// assert_eq!(map.sample(50.0, 50.0, Interpolation::Bilinear), 5.5);
/// assert!(map.sample(101.0, 0.0, Interpolation::Bilinear).is_nan());
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct GridMap {
    x: Axis,
    y: Axis,
    values: GridValues,
    geographic: bool,
    holes: Holes,
    mean: f64,
    sigma: Option<MapSigma>,
    correlation_m: Option<f64>,
    error_model: Option<MapErrorModel>,
    height: Option<MapHeight>,
    ground: Option<GroundScale>,
    continued: continued::Continued,
}

impl GridMap {
    /// A map from values (row-major, row = y, column = x, in the order of the given axes) and its axes.
    ///
    /// Geographic maps have x = longitude and y = latitude in degrees; longitudes may jump by 360 degrees where the map
    /// crosses the date line.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Invalid`] (uneven axes, latitudes beyond the poles, more than one turn of longitude),
    /// [`Error::NotFiniteNode`] (infinite value), [`Error::TooFewSamples`] (an axis of one node).
    pub fn new(values: GridValues, x: &[f64], y: &[f64], geographic: bool) -> Result<Self> {
        Self::with_resolution(values, x, y, geographic, 0.0)
    }

    /// [`GridMap::new`] for axes whose coordinates are themselves rounded to `resolution`.
    ///
    /// # Errors
    /// As [`GridMap::new`].
    pub fn with_resolution(
        mut values: GridValues,
        x: &[f64],
        y: &[f64],
        geographic: bool,
        resolution: f64,
    ) -> Result<Self> {
        let needed = x.len().checked_mul(y.len());
        if needed != Some(values.len()) {
            return Err(Error::shape(
                "map values",
                format!("{} rows (y) x {} columns (x)", y.len(), x.len()),
                format!("{} values", values.len()),
            ));
        }
        refuse_blanks(&values, |row, column| [x[column], y[row]], x.len())?;
        let (x, reverse_columns) = match Axis::from_coordinates("x", x, resolution) {
            Err(Error::Invalid { .. }) if geographic => Axis::from_coordinates("x", &unwrap_longitudes(x), resolution)?,
            other => other?,
        };
        let (y, reverse_rows) = Axis::from_coordinates("y", y, resolution)?;
        values.flip(x.len(), reverse_rows, reverse_columns);
        Self::from_axes(values, x, y, geographic)
    }

    /// A map from values that already lie in ascending order on the given axes.
    ///
    /// # Errors
    /// As [`GridMap::new`].
    pub fn from_axes(values: GridValues, x: Axis, y: Axis, geographic: bool) -> Result<Self> {
        if x.len().checked_mul(y.len()) != Some(values.len()) {
            return Err(Error::shape(
                "map values",
                format!("{} rows (y) x {} columns (x)", y.len(), x.len()),
                format!("{} values", values.len()),
            ));
        }
        if geographic {
            let slack = 0.5 * y.step();
            if y.first() < -90.0 - slack || y.last() > 90.0 + slack {
                return Err(Error::invalid(
                    "axis y of a geographic map",
                    "latitudes in [-90, 90] degrees (is the map in metres, or are the axes swapped?)",
                    format!("{} to {}", y.first(), y.last()),
                ));
            }
            // A map of the whole circle may go on beyond its seam, so that a search about the seam stays on it.
            if x.last() - x.first() > 360.0 + (2.0 * MOST_SEAM_DEG).max(x.step())
                || x.first() < -540.0
                || x.last() > 720.0
            {
                return Err(Error::invalid(
                    "axis x of a geographic map",
                    "longitudes in degrees, at most one turn and 20 degrees of seam (is the map in metres?)",
                    format!("{} to {}", x.first(), x.last()),
                ));
            }
        }
        refuse_blanks(&values, |row, column| [x.at(column), y.at(row)], x.len())?;
        let mut sum = 0.0;
        let mut origin = f64::NAN;
        let mut holes = Holes::none(x.len());
        for i in 0..values.len() {
            let v = values.get(i);
            if v.is_nan() {
                holes.add(i / x.len(), i % x.len());
            } else {
                if origin.is_nan() {
                    origin = v;
                }
                // Summed about the first value: maps of total intensity are 50,000 nT plus a little.
                sum += v - origin;
            }
        }
        let count = values.len() - holes.count;
        if count == 0 {
            return Err(Error::invalid("map values", "at least one value that is not NaN", "only NaN"));
        }
        Ok(Self {
            x,
            y,
            values,
            geographic,
            holes,
            mean: origin + sum / count as f64,
            sigma: None,
            correlation_m: None,
            error_model: None,
            height: None,
            continued: continued::Continued::default(),
            ground: None,
        })
    }

    /// The same map with the standard deviation of its values.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a negative or infinite one, [`Error::Shape`] for a grid of another size.
    pub fn with_sigma(mut self, sigma: Option<MapSigma>) -> Result<Self> {
        match &sigma {
            None => {}
            Some(MapSigma::Constant(s)) => {
                require_spread("map sigma", *s)?;
            }
            Some(MapSigma::Grid(grid)) => {
                if grid.len() != self.values.len() {
                    return Err(Error::shape(
                        "map sigma",
                        format!("{} values as the map", self.values.len()),
                        format!("{} values", grid.len()),
                    ));
                }
                if let Some(i) = grid.iter().position(|s| !s.is_nan() && require_spread("", *s).is_err()) {
                    return Err(Error::invalid(
                        format!("map sigma[{i}]"),
                        format!("a number >= 0, at most {MOST_VALUE} (NaN where unknown)"),
                        grid[i],
                    ));
                }
            }
        }
        self.sigma = sigma;
        Ok(self)
    }

    /// The same map with the length over which the errors that its sigma states decorrelate, metres: 0 for errors of every place
    /// their own, `None` where nothing is known of it.
    ///
    /// An error model takes its place where there is one.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a negative or infinite one.
    pub fn with_correlation_m(mut self, correlation_m: Option<f64>) -> Result<Self> {
        if let Some(length) = correlation_m {
            require_distance_m("correlation_m", length)?;
        }
        self.correlation_m = correlation_m;
        Ok(self)
    }

    /// Length over which the errors that the map's sigma states decorrelate, metres.
    pub fn correlation_m(&self) -> Option<f64> {
        self.correlation_m
    }

    /// The same map with the statistics of its errors.
    ///
    /// # Errors
    /// As [`MapErrorModel::validate`].
    pub fn with_error_model(mut self, model: Option<MapErrorModel>) -> Result<Self> {
        if let Some(model) = &model {
            model.validate(self.values.len())?;
        }
        self.error_model = model;
        Ok(self)
    }

    /// The same map with the height of its values, metres above its height datum, positive up.
    ///
    /// # Errors
    /// [`Error::NotFinite`], [`Error::NotFiniteNode`] for a node with a value but no height, [`Error::Shape`] for a grid of
    /// another size.
    pub fn with_height(mut self, height: Option<MapHeight>) -> Result<Self> {
        match &height {
            None => {}
            Some(MapHeight::Level(level)) => crate::bounds::require_heights("map height_m", &[*level])?,
            Some(MapHeight::Drape(drape)) => {
                if drape.len() != self.values.len() {
                    let needed = format!("{} values as the map", self.values.len());
                    return Err(Error::shape("map height_m", needed, format!("{} values", drape.len())));
                }
                // A hole needs no height.
                let bad = |i: &usize| {
                    let h = drape[*i];
                    h.abs() > crate::bounds::MOST_HEIGHT_M || h.is_nan() && !self.values.get(*i).is_nan()
                };
                if let Some(i) = (0..drape.len()).find(bad) {
                    let (row, column) = (i / self.x.len(), i % self.x.len());
                    let (x, y) = (self.x.at(column), self.y.at(row));
                    return Err(Error::NotFiniteNode { what: "map height_m".into(), row, column, x, y, got: drape[i] });
                }
            }
        }
        self.height = height;
        Ok(self)
    }

    /// The same projected map with the scale of its projection, so that metres are metres on the ground.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a geographic map, whose scale is known, and for a scale that is no number above zero.
    pub fn with_ground_scale(mut self, rows: Option<Vec<[f64; 2]>>) -> Result<Self> {
        if rows.is_some() && self.geographic {
            return Err(Error::invalid("map ground_scale", "none for a geographic map", "a scale"));
        }
        self.ground = rows.map(|rows| GroundScale::new(rows, self.y.len())).transpose()?;
        Ok(self)
    }

    /// Metres on the ground per map unit, a pair `[east, north]` a row, where they are known.
    pub fn ground_scale(&self) -> Option<&[[f64; 2]]> {
        self.ground.as_ref().map(GroundScale::rows)
    }

    /// The height of the values, where it is known.
    pub fn height(&self) -> Option<&MapHeight> {
        self.height.as_ref()
    }

    /// What is known of the errors beyond their standard deviation.
    pub fn error_model(&self) -> Option<&MapErrorModel> {
        self.error_model.as_ref()
    }

    /// The x axis (east), ascending.
    pub fn x(&self) -> &Axis {
        &self.x
    }

    /// The y axis (north), ascending.
    pub fn y(&self) -> &Axis {
        &self.y
    }

    /// The values, row = y ascending, column = x ascending.
    pub fn values(&self) -> &GridValues {
        &self.values
    }

    /// Number of NaN nodes.
    pub fn holes(&self) -> usize {
        self.holes.count
    }

    /// Whether a hole may lie in the block of nodes of these rows and columns; true is exact to some nodes only.
    pub(crate) fn may_have_holes(&self, rows: Range<usize>, columns: Range<usize>) -> bool {
        self.holes.may_be_in(rows, columns)
    }

    /// What is known of the error of the values.
    pub fn map_sigma(&self) -> Option<&MapSigma> {
        self.sigma.as_ref()
    }

    /// Value at node (row, column), NaN on a hole.
    #[inline]
    pub fn node(&self, row: usize, column: usize) -> f64 {
        self.values.get(row * self.x.len() + column)
    }

    /// Position of a point in cells from the first node `[column, row]`, longitude wrapped.
    #[allow(clippy::inline_always)] // as far as sample_many
    #[inline(always)]
    pub fn position(&self, x: f64, y: f64) -> [f64; 2] {
        [self.x.position(self.wrap_x(x)), self.y.position(y)]
    }

    /// Part of the map: rows and columns by index.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the ranges leave the map or hold fewer than two nodes.
    pub fn window(&self, rows: Range<usize>, columns: Range<usize>) -> Result<Self> {
        if rows.end > self.y.len() || columns.end > self.x.len() || rows.len() < 2 || columns.len() < 2 {
            return Err(Error::invalid(
                "window",
                format!("at least 2 x 2 nodes within {} x {}", self.y.len(), self.x.len()),
                format!("rows {rows:?}, columns {columns:?}"),
            ));
        }
        let width = self.x.len();
        let values = match &self.values {
            GridValues::F32(v) => GridValues::F32(part(v, width, &rows, &columns)),
            GridValues::F64(v) => GridValues::F64(part(v, width, &rows, &columns)),
        };
        let sigma = self.sigma.as_ref().map(|s| match s {
            MapSigma::Constant(s) => MapSigma::Constant(*s),
            MapSigma::Grid(g) => MapSigma::Grid(part(g, width, &rows, &columns)),
        });
        let error_model = self.error_model.as_ref().map(|model| MapErrorModel {
            distance_m: match &model.distance_m {
                DistanceLayer::Constant(d) => DistanceLayer::Constant(*d),
                DistanceLayer::Grid(layer) => DistanceLayer::Grid(part(layer, width, &rows, &columns)),
            },
            ..model.clone()
        });
        let x = Axis::new(self.x.at(columns.start), self.x.step(), columns.len())?;
        let y = Axis::new(self.y.at(rows.start), self.y.step(), rows.len())?;
        let height = self.height.as_ref().map(|h| match h {
            MapHeight::Level(level) => MapHeight::Level(*level),
            MapHeight::Drape(drape) => MapHeight::Drape(part(drape, width, &rows, &columns)),
        });
        Self::from_axes(values, x, y, self.geographic)?
            .with_sigma(sigma)?
            .with_correlation_m(self.correlation_m)?
            .with_error_model(error_model)?
            .with_ground_scale(self.ground_scale().map(|g| g[rows].to_vec()))?
            .with_height(height)
    }
}

impl Field for GridMap {
    fn value(&self, x: f64, y: f64) -> f64 {
        self.sample(x, y, Interpolation::Bilinear)
    }

    fn value_and_gradient(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        self.sample_and_gradient(x, y, Interpolation::Bilinear)
    }

    fn sigma(&self, x: f64, y: f64) -> f64 {
        match &self.sigma {
            None => 0.0,
            Some(MapSigma::Constant(s)) => *s,
            Some(MapSigma::Grid(grid)) => {
                let [px, py] = self.position(x, y);
                let (Some((ix, tx)), Some((iy, ty))) = (self.x.cell(px), self.y.cell(py)) else {
                    return f64::NAN;
                };
                // The nearest node: an error model has no business being smoother than its own grid.
                grid[(iy + usize::from(ty > 0.5)) * self.x.len() + ix + usize::from(tx > 0.5)]
            }
        }
    }

    fn geographic(&self) -> bool {
        self.geographic
    }

    fn metres_per_unit(&self, y: f64) -> [f64; 2] {
        match &self.ground {
            Some(ground) => ground.at(&self.y, y),
            None if self.geographic => metres_per_degree(y),
            None => [1.0, 1.0],
        }
    }

    #[allow(clippy::inline_always)]
    #[inline(always)]
    fn wrap_x(&self, x: f64) -> f64 {
        if self.geographic { wrap_longitude(x, 0.5 * (self.x.first() + self.x.last())) } else { x }
    }

    fn spacing(&self) -> [f64; 2] {
        [self.x.step(), self.y.step()]
    }

    fn mean(&self) -> f64 {
        self.mean
    }

    fn as_grid(&self) -> Option<&GridMap> {
        Some(self)
    }
}

/// Names the first infinite value by the row and column that the caller gave it in.
fn refuse_blanks(values: &GridValues, place: impl Fn(usize, usize) -> [f64; 2], columns: usize) -> Result<()> {
    let Some(i) = (0..values.len()).find(|&i| values.get(i).abs() > MOST_VALUE) else { return Ok(()) };
    let (row, column, got) = (i / columns, i % columns, values.get(i));
    let [x, y] = place(row, column);
    if got.is_infinite() {
        return Err(Error::NotFiniteNode { what: "map values".into(), row, column, x, y, got });
    }
    let what = format!("map values[{row}, {column}] at ({x}, {y})");
    Err(Error::invalid(what, format!("a value within +-{MOST_VALUE} (NaN where there is none)"), got))
}
