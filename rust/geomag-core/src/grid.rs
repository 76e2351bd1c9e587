//! The stored map: a regular grid of field values with interpolation, gradient, holes and error.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::{metres_per_degree, wrap_longitude};
use crate::map_error::{DistanceLayer, MapErrorModel};

/// Positions within this many cells of a node are taken to be on it, so that rounding never drags a neighbouring hole in.
pub(crate) const NODE_TOLERANCE: f64 = 1e-9;
/// Greatest departure of an axis from even spacing, in cells.
const EVENNESS_TOLERANCE: f64 = 1e-2;

/// An evenly spaced, ascending axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    first: f64,
    step: f64,
    len: usize,
}

impl Axis {
    /// An axis from its first coordinate, its spacing (> 0) and its number of nodes (>= 2).
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`], [`Error::TooFewSamples`].
    pub fn new(first: f64, step: f64, len: usize) -> Result<Self> {
        crate::error::require_finite("axis start", &[first])?;
        crate::error::require_positive("axis step", step)?;
        if len < 2 {
            return Err(Error::TooFewSamples { what: "axis".into(), needed: 2, got: len });
        }
        Ok(Self { first, step, len })
    }

    /// An axis from its coordinates, evenly spaced to within a hundredth of a cell, and whether they run downwards.
    ///
    /// `resolution` is the rounding of the coordinates themselves (zero for float64, larger for coordinates stored in
    /// fewer digits); it is allowed on top.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`], [`Error::NotFinite`], or [`Error::Invalid`] naming the first uneven node.
    pub fn from_coordinates(name: &str, coordinates: &[f64], resolution: f64) -> Result<(Self, bool)> {
        let len = coordinates.len();
        if len < 2 {
            return Err(Error::TooFewSamples { what: format!("axis {name}"), needed: 2, got: len });
        }
        crate::error::require_finite(name, coordinates)?;
        let signed = (coordinates[len - 1] - coordinates[0]) / (len - 1) as f64;
        let tolerance = signed.abs() * EVENNESS_TOLERANCE + resolution;
        for (i, &c) in coordinates.iter().enumerate() {
            let expected = coordinates[0] + signed * i as f64;
            if signed == 0.0 || (c - expected).abs() > tolerance {
                return Err(Error::invalid(
                    format!("axis {name}[{i}]"),
                    format!("evenly spaced coordinates in one direction (here {expected} for a spacing of {signed})"),
                    c,
                ));
            }
        }
        let reversed = signed < 0.0;
        let first = if reversed { coordinates[len - 1] } else { coordinates[0] };
        Ok((Self::new(first, signed.abs(), len)?, reversed))
    }

    /// Coordinate of the first node.
    pub fn first(&self) -> f64 {
        self.first
    }

    /// Coordinate of the last node.
    pub fn last(&self) -> f64 {
        self.at(self.len - 1)
    }

    /// Spacing, always positive.
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Number of nodes.
    #[allow(clippy::len_without_is_empty)] // never empty by construction
    pub fn len(&self) -> usize {
        self.len
    }

    /// Coordinate of node `i`.
    pub fn at(&self, i: usize) -> f64 {
        self.first + self.step * i as f64
    }

    /// Position of a coordinate in cells from the first node.
    pub fn position(&self, coordinate: f64) -> f64 {
        (coordinate - self.first) / self.step
    }

    /// The cell that holds a position in cells, and the fraction within it; positions on a node give fraction 0 or 1.
    pub(crate) fn cell(&self, position: f64) -> Option<(usize, f64)> {
        let last_cell = (self.len - 2) as f64;
        if !(position >= -NODE_TOLERANCE && position <= last_cell + 1.0 + NODE_TOLERANCE) {
            return None;
        }
        let (cell, fraction) = split_position(position);
        let cell = cell as f64;
        if cell > last_cell { Some((self.len - 2, 1.0)) } else { Some((cell.max(0.0) as usize, fraction)) }
    }
}

/// Whole cells and fraction in [0, 1) of a position, with positions next to a node taken to be on it.
pub(crate) fn split_position(position: f64) -> (i64, f64) {
    let nearest = position.round();
    if (position - nearest).abs() <= NODE_TOLERANCE {
        (nearest as i64, 0.0)
    } else {
        let floor = position.floor();
        (floor as i64, position - floor)
    }
}

/// Values of a map, row-major, row = y ascending, column = x ascending.
#[derive(Debug, Clone, PartialEq)]
pub enum GridValues {
    /// Single precision: half the memory, about 1e-7 of the value's size in precision.
    F32(Vec<f32>),
    /// Double precision.
    F64(Vec<f64>),
}

impl GridValues {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(v) => v.len(),
            Self::F64(v) => v.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Value `i` as double precision.
    #[inline]
    pub fn get(&self, i: usize) -> f64 {
        match self {
            Self::F32(v) => f64::from(v[i]),
            Self::F64(v) => v[i],
        }
    }

    fn flip(&mut self, columns: usize, reverse_rows: bool, reverse_columns: bool) {
        fn flip<T>(v: &mut [T], columns: usize, reverse_rows: bool, reverse_columns: bool) {
            if reverse_rows && reverse_columns {
                v.reverse();
                return;
            }
            if reverse_columns {
                v.chunks_exact_mut(columns).for_each(<[T]>::reverse);
            }
            if reverse_rows {
                let rows = v.len() / columns;
                for i in 0..rows / 2 {
                    let (upper, lower) = v.split_at_mut((rows - 1 - i) * columns);
                    upper[i * columns..(i + 1) * columns].swap_with_slice(&mut lower[..columns]);
                }
            }
        }
        match self {
            Self::F32(v) => flip(v, columns, reverse_rows, reverse_columns),
            Self::F64(v) => flip(v, columns, reverse_rows, reverse_columns),
        }
    }
}

/// How a map is read between its nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Interpolation {
    /// Bilinear: continuous, exact at nodes, gradient steps at cell borders.
    #[default]
    Bilinear,
    /// Cubic convolution (Keys 1981, a = -1/2): continuous gradient, third-order accurate, 4 x 4 nodes.
    Bicubic,
}

/// Standard deviation of a map's values against the true field.
#[derive(Debug, Clone, PartialEq)]
pub enum MapSigma {
    /// One number for the whole map, value units.
    Constant(f64),
    /// One number a node, in the map's own layout; NaN where unknown.
    Grid(Vec<f64>),
}

/// Where the holes of a map are, by blocks of nodes: one hole in a corner must not slow down the whole map.
#[derive(Debug, Clone, PartialEq)]
struct Holes {
    count: usize,
    blocks_a_row: usize,
    /// Row-major; ends with the last row of blocks that has a hole.
    blocks: Vec<bool>,
}

impl Holes {
    /// Nodes a side of a block.
    const BLOCK: usize = 32;

    fn none(columns: usize) -> Self {
        Self { count: 0, blocks_a_row: columns.div_ceil(Self::BLOCK), blocks: Vec::new() }
    }

    fn add(&mut self, row: usize, column: usize) {
        self.count += 1;
        let first = row / Self::BLOCK * self.blocks_a_row;
        if self.blocks.len() <= first {
            self.blocks.resize(first + self.blocks_a_row, false);
        }
        self.blocks[first + column / Self::BLOCK] = true;
    }

    fn may_be_in(&self, rows: Range<usize>, columns: Range<usize>) -> bool {
        let across = columns.start / Self::BLOCK..columns.end.div_ceil(Self::BLOCK).min(self.blocks_a_row);
        let mut block_rows = self
            .blocks
            .chunks(self.blocks_a_row.max(1))
            .take(rows.end.div_ceil(Self::BLOCK))
            .skip(rows.start / Self::BLOCK);
        self.count > 0 && block_rows.any(|row| row[across.clone()].contains(&true))
    }
}

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
    error_model: Option<MapErrorModel>,
}

impl GridMap {
    /// A map from values (row-major, row = y, column = x, in the order of the given axes) and its axes.
    ///
    /// Geographic maps have x = longitude and y = latitude in degrees; longitudes may jump by 360 degrees where the map
    /// crosses the date line.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Invalid`] (uneven axes, latitudes beyond the poles, more than one turn of longitude),
    /// [`Error::NotFinite`] (infinite value), [`Error::TooFewSamples`] (an axis of one node).
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
            if x.last() - x.first() > 360.0 + x.step() || x.first() < -540.0 || x.last() > 720.0 {
                return Err(Error::invalid(
                    "axis x of a geographic map",
                    "longitudes in degrees, at most one turn (is the map in metres?)",
                    format!("{} to {}", x.first(), x.last()),
                ));
            }
        }
        let mut sum = 0.0;
        let mut origin = f64::NAN;
        let mut holes = Holes::none(x.len());
        for i in 0..values.len() {
            let v = values.get(i);
            if v.is_infinite() {
                return Err(Error::NotFinite {
                    what: "map values (row-major, both axes ascending)".into(),
                    index: i,
                    got: v,
                });
            }
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
        Ok(Self { x, y, values, geographic, holes, mean: origin + sum / count as f64, sigma: None, error_model: None })
    }

    /// The same map with the standard deviation of its values.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a negative or infinite one, [`Error::Shape`] for a grid of another size.
    pub fn with_sigma(mut self, sigma: Option<MapSigma>) -> Result<Self> {
        match &sigma {
            None => {}
            Some(MapSigma::Constant(s)) => {
                crate::error::require_not_negative("map sigma", *s)?;
            }
            Some(MapSigma::Grid(grid)) => {
                if grid.len() != self.values.len() {
                    return Err(Error::shape(
                        "map sigma",
                        format!("{} values as the map", self.values.len()),
                        format!("{} values", grid.len()),
                    ));
                }
                if let Some(i) = grid.iter().position(|s| s.is_infinite() || *s < 0.0) {
                    return Err(Error::invalid(
                        format!("map sigma[{i}]"),
                        "a number >= 0 (NaN where unknown)",
                        grid[i],
                    ));
                }
            }
        }
        self.sigma = sigma;
        Ok(self)
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
    #[inline]
    pub fn position(&self, x: f64, y: f64) -> [f64; 2] {
        [self.x.position(self.wrap_x(x)), self.y.position(y)]
    }

    /// Value between the nodes; NaN off the map and next to holes.
    pub fn sample(&self, x: f64, y: f64, method: Interpolation) -> f64 {
        self.sample_and_gradient(x, y, method).0
    }

    /// Value and gradient per metre `[east, north]`; NaN off the map and next to holes.
    pub fn sample_and_gradient(&self, x: f64, y: f64, method: Interpolation) -> (f64, [f64; 2]) {
        let [px, py] = self.position(x, y);
        let (value, [dx, dy]) = self.at_position(px, py, method);
        let [east, north] = self.metres_per_unit(y);
        (value, [dx / (self.x.step() * east), dy / (self.y.step() * north)])
    }

    /// Value and gradient per cell at a position in cells from the first node.
    pub(crate) fn at_position(&self, px: f64, py: f64, method: Interpolation) -> (f64, [f64; 2]) {
        let (Some((ix, tx)), Some((iy, ty))) = (self.x.cell(px), self.y.cell(py)) else {
            return (f64::NAN, [f64::NAN; 2]);
        };
        match method {
            Interpolation::Bilinear => self.bilinear(ix, iy, tx, ty),
            Interpolation::Bicubic => self.bicubic(ix, iy, tx, ty),
        }
    }

    fn bilinear(&self, ix: usize, iy: usize, tx: f64, ty: f64) -> (f64, [f64; 2]) {
        let [a, b, c, d] = [self.node(iy, ix), self.node(iy, ix + 1), self.node(iy + 1, ix), self.node(iy + 1, ix + 1)];
        // A node of weight zero is not needed: a hole there must not spoil a sample that lies on its neighbour.
        let mix = |p: f64, q: f64, t: f64| {
            if t == 0.0 {
                p
            } else if t == 1.0 {
                q
            } else {
                (1.0 - t) * p + t * q
            }
        };
        let value = mix(mix(a, b, tx), mix(c, d, tx), ty);
        (value, [mix(b - a, d - c, ty), mix(c - a, d - b, tx)])
    }

    fn bicubic(&self, ix: usize, iy: usize, tx: f64, ty: f64) -> (f64, [f64; 2]) {
        let (wx, dx) = keys_weights(tx);
        let (wy, dy) = keys_weights(ty);
        let (mut value, mut along_x, mut along_y) = (0.0, 0.0, 0.0);
        for r in 0..4 {
            let (mut row, mut row_dx) = (0.0, 0.0);
            for c in 0..4 {
                if (wx[c] == 0.0 && dx[c] == 0.0) || (wy[r] == 0.0 && dy[r] == 0.0) {
                    continue;
                }
                let v = self.extended_node(iy as isize + r as isize - 1, ix as isize + c as isize - 1);
                row += wx[c] * v;
                row_dx += dx[c] * v;
            }
            value += wy[r] * row;
            along_x += wy[r] * row_dx;
            along_y += dy[r] * row;
        }
        (value, [along_x, along_y])
    }

    /// Node value, continued quadratically one node beyond the border (Keys 1981, eq. 19 to 21).
    fn extended_node(&self, row: isize, column: isize) -> f64 {
        let (rows, columns) = (self.y.len() as isize, self.x.len() as isize);
        let continue_by = |outside: isize, inward: isize, len: isize, get: &dyn Fn(isize) -> f64| {
            if len >= 3 {
                3.0 * get(outside + inward) - 3.0 * get(outside + 2 * inward) + get(outside + 3 * inward)
            } else {
                2.0 * get(outside + inward) - get(outside + 2 * inward)
            }
        };
        if row < 0 || row >= rows {
            let inward = if row < 0 { 1 } else { -1 };
            return continue_by(row, inward, rows, &|r| self.extended_node(r, column));
        }
        if column < 0 || column >= columns {
            let inward = if column < 0 { 1 } else { -1 };
            return continue_by(column, inward, columns, &|c| self.extended_node(row, c));
        }
        self.node(row as usize, column as usize)
    }

    /// Least and greatest bilinear value within `half_x`, `half_y` map units of a point; `None` where any of it is off
    /// the map or next to a hole.
    ///
    /// A bilinear patch has its extremes at its corners, so the corners of all the patches that the box cuts are enough.
    pub fn bounds(&self, x: f64, y: f64, half_x: f64, half_y: f64) -> Option<(f64, f64)> {
        let [px, py] = self.position(x, y);
        let cuts = |p: f64, half: f64| {
            let (low, high) = (p - half, p + half);
            let inner = (low + NODE_TOLERANCE).ceil() as i64..=(high - NODE_TOLERANCE).floor() as i64;
            std::iter::once(low).chain(inner.map(|i| i as f64)).chain(std::iter::once(high)).collect::<Vec<_>>()
        };
        let columns = cuts(px, half_x.abs() / self.x.step());
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for r in cuts(py, half_y.abs() / self.y.step()) {
            for &c in &columns {
                let v = self.at_position(c, r, Interpolation::Bilinear).0;
                if v.is_nan() {
                    return None;
                }
                least = least.min(v);
                greatest = greatest.max(v);
            }
        }
        Some((least, greatest))
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
        let pick = |get: &mut dyn FnMut(usize)| {
            for r in rows.clone() {
                for c in columns.clone() {
                    get(r * self.x.len() + c);
                }
            }
        };
        let values = match &self.values {
            GridValues::F32(v) => {
                let mut out = Vec::with_capacity(rows.len() * columns.len());
                pick(&mut |i| out.push(v[i]));
                GridValues::F32(out)
            }
            GridValues::F64(v) => {
                let mut out = Vec::with_capacity(rows.len() * columns.len());
                pick(&mut |i| out.push(v[i]));
                GridValues::F64(out)
            }
        };
        let sigma = self.sigma.as_ref().map(|s| match s {
            MapSigma::Constant(s) => MapSigma::Constant(*s),
            MapSigma::Grid(g) => {
                let mut out = Vec::with_capacity(rows.len() * columns.len());
                pick(&mut |i| out.push(g[i]));
                MapSigma::Grid(out)
            }
        });
        let error_model = self.error_model.as_ref().map(|model| MapErrorModel {
            distance_m: match &model.distance_m {
                DistanceLayer::Constant(d) => DistanceLayer::Constant(*d),
                DistanceLayer::Grid(layer) => {
                    let mut out = Vec::with_capacity(rows.len() * columns.len());
                    pick(&mut |i| out.push(layer[i]));
                    DistanceLayer::Grid(out)
                }
            },
            ..model.clone()
        });
        let x = Axis::new(self.x.at(columns.start), self.x.step(), columns.len())?;
        let y = Axis::new(self.y.at(rows.start), self.y.step(), rows.len())?;
        Self::from_axes(values, x, y, self.geographic)?.with_sigma(sigma)?.with_error_model(error_model)
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
        if self.geographic { metres_per_degree(y) } else { [1.0, 1.0] }
    }

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

/// Weights and their derivatives of cubic convolution with a = -1/2 for the nodes -1, 0, 1, 2 at fraction t.
fn keys_weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2],
        [-1.5 * t2 + 2.0 * t - 0.5, 4.5 * t2 - 5.0 * t, -4.5 * t2 + 4.0 * t + 0.5, 1.5 * t2 - t],
    )
}

/// Takes out jumps of a whole turn between neighbours.
fn unwrap_longitudes(longitudes: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(longitudes.len());
    for &longitude in longitudes {
        out.push(out.last().map_or(longitude, |&previous| wrap_longitude(longitude, previous)));
    }
    out
}
