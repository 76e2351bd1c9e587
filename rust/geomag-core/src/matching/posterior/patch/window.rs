//! A window of a map, a plane a quantity.

use super::bends::{finite_or_zero, second_differences_across, second_differences_up, spline_bends};
use super::place::PatchPlace;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::{GridMap, MapSigma, at_height};
use crate::map_error::DistanceLayer;
use crate::stack::Storey;

/// Where nothing is known of a map's error, it is taken to be displaced by this many cells.
const DEFAULT_ERROR_CELLS: f64 = 1.0;
/// Where nothing is known of the data behind a map, they are taken to be this many cells away.
pub(in super::super) const DEFAULT_DISTANCE_CELLS: f64 = 4.0;
/// Half width in cells of the box over which the gradient of the default error model is averaged.
const SMOOTHING_CELLS: usize = 2;
/// Largest distance in cells between a node and the hole next to it over which nothing is interpolated.
const NODE_TOLERANCE: f64 = 1e-9;

/// Planes of a patch: value minus level, error variance, distance to data, largest second difference, the second differences along x
/// and y, and that along y of those along x; and the same three of the cubic spline through the nodes.
pub(in super::super) const VALUE: usize = 0;
pub(in super::super) const VARIANCE: usize = 1;
pub(in super::super) const DISTANCE: usize = 2;
pub(in super::super) const BEND: usize = 3;
pub(in super::super) const ACROSS: usize = 4;
pub(in super::super) const UP: usize = 5;
pub(in super::super) const TWIST: usize = 6;
pub(in super::super) const SPLINE_ACROSS: usize = 7;
pub(in super::super) const SPLINE_UP: usize = 8;
pub(in super::super) const SPLINE_TWIST: usize = 9;
/// Half of what the values change by from one side of a height to the other.
pub(in super::super) const LIFT: usize = 10;
pub(super) const PLANES: usize = 11;
/// Nodes beyond what a search can touch: over each of them a spline forgets three quarters of what lies beyond.
const MARGIN_CELLS: i64 = 8;

/// A window of the map, a plane a quantity.
#[derive(Debug, Clone)]
pub(in super::super) struct Patch {
    /// Coordinate of the map's (not the patch's) first node.
    origin: [f64; 2],
    /// Spacing, map units.
    step: [f64; 2],
    /// First column and row of the patch in the map's numbering.
    first: [i64; 2],
    pub(super) columns: usize,
    pub(super) rows: usize,
    /// The planes of every level, lowest first; one where the field has one surface.
    pub(super) levels: Vec<[Vec<f32>; PLANES]>,
    /// Value subtracted from every node, so that single precision suffices.
    pub level: f64,
    /// Whether error variance and distance are the same at every node.
    pub even: bool,
    /// Whether the curved surfaces through the nodes are laid out.
    curved: bool,
}

/// One interpolated point.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct MapPoint {
    pub value: f32,
    pub variance: f32,
    pub distance: f32,
    /// Gradient per cell.
    pub gradient: [f32; 2],
    /// What a curve through the nodes would differ by from the straight line between them.
    pub curvature: f32,
    /// Largest second difference at the nodes around.
    pub bend: f32,
}

impl Patch {
    /// The window of `field` that covers the box from `low` to `high` (map units, on the map's own turn of longitude), with the
    /// curved surfaces through its nodes where asked for.
    ///
    /// # Errors
    /// [`Error::TooManyCandidates`] for a field without a grid that would have to be evaluated at more than `most` nodes.
    pub fn new(field: &dyn Field, low: [f64; 2], high: [f64; 2], most: u64, curved: bool) -> Result<Self> {
        let step = field.spacing();
        let grid = field.layout();
        let origin = grid.map_or(low, |g| [g.x().first(), g.y().first()]);
        let far = i64::MAX / 4;
        let limits = grid.map_or([far; 2], |g| [g.x().len() as i64 - 1, g.y().len() as i64 - 1]);
        let (mut first, mut last) = ([0_i64; 2], [0_i64; 2]);
        for d in 0..2 {
            let margin = if grid.is_some() { MARGIN_CELLS } else { SMOOTHING_CELLS as i64 + 1 };
            let least = if grid.is_some() { 0 } else { -far };
            let cells = |v: f64| ((v - origin[d]) / step[d]).clamp(-far as f64, far as f64);
            first[d] = (cells(low[d]).floor() as i64 - margin).clamp(least, limits[d]);
            last[d] = (cells(high[d]).ceil() as i64 + margin).clamp(first[d], limits[d]);
        }
        let needed = [0, 1].map(|d| (last[d] - first[d] + 1) as u128).iter().product();
        if grid.is_none() && needed > u128::from(most) {
            return Err(Error::TooManyCandidates { what: "window of the field".into(), needed, limit: most });
        }
        let (columns, rows) = ((last[0] - first[0] + 1) as usize, (last[1] - first[1] + 1) as usize);
        let middle = 0.5 * (low[1] + high[1]);
        let [east, north] = field.metres_per_unit(middle);
        let cell_m = (step[0] * east * step[1] * north).sqrt();
        let level = field.mean();
        let mut patch = Self { origin, step, first, columns, rows, levels: Vec::new(), level, even: false, curved };
        let default_distance = (DEFAULT_DISTANCE_CELLS * cell_m) as f32;
        let grids: Vec<Option<&GridMap>> = match field.as_stack() {
            Some(stack) => stack.levels().iter().map(|g| Some(&**g)).collect(),
            None => vec![grid],
        };
        for grid in grids {
            let mut planes = std::array::from_fn(|q| vec![0.0; if q < ACROSS { columns * rows } else { 0 }]);
            patch.fill(&mut planes, field, grid, default_distance);
            patch.fill_bends(&mut planes);
            if grid.is_some_and(|g| g.map_sigma().is_none()) {
                patch.fill_default_variance(&mut planes, [step[0] * east / cell_m, step[1] * north / cell_m]);
            }
            patch.levels.push(planes);
        }
        let even = |planes: &[Vec<f32>; PLANES], q: usize| planes[q].iter().all(|v| *v == planes[q][0]);
        patch.even = patch.levels.iter().all(|planes| even(planes, VARIANCE) && even(planes, DISTANCE));
        Ok(patch)
    }

    /// Value, variance and distance at the nodes of one level, or of a field without a grid.
    fn fill(&self, planes: &mut [Vec<f32>; PLANES], field: &dyn Field, grid: Option<&GridMap>, default_distance: f32) {
        let map_columns = grid.map_or(0, |g| g.x().len());
        for r in 0..self.rows {
            for c in 0..self.columns {
                let (row, column) = (self.first[1] + r as i64, self.first[0] + c as i64);
                let (value, sigma, distance) = if let Some(g) = grid {
                    let i = row as usize * map_columns + column as usize;
                    let sigma = match g.map_sigma() {
                        None => 0.0,
                        Some(MapSigma::Constant(s)) => *s,
                        Some(MapSigma::Grid(layer)) => layer[i],
                    };
                    let distance = match g.error_model().map(|m| &m.distance_m) {
                        None => default_distance,
                        Some(DistanceLayer::Constant(d)) => *d as f32,
                        Some(DistanceLayer::Grid(layer)) => layer[i],
                    };
                    (g.values().get(i), sigma, distance)
                } else {
                    let x = self.origin[0] + column as f64 * self.step[0];
                    let y = self.origin[1] + row as f64 * self.step[1];
                    (field.value(x, y), field.sigma(x, y), default_distance)
                };
                // A value of unknown error cannot be weighed: the place is as a hole (`Field::known_sigma`).
                let value = if sigma.is_nan() || distance.is_nan() { f64::NAN } else { value - self.level };
                let node = [value as f32, (sigma * sigma) as f32, distance];
                for (plane, quantity) in planes.iter_mut().zip(node) {
                    plane[r * self.columns + c] = quantity;
                }
            }
        }
    }

    /// The same window of the map at a height above it, and how it changes over `about_m` on either side of that; with an `about_m` of
    /// zero, for a first look, its bends stay those of the map.
    pub fn lifted(&self, grid: &GridMap, height_m: f64, about_m: f64) -> Self {
        let mut lifted = self.clone();
        lifted.levels[0][VALUE] = self.at_height(grid, height_m);
        if about_m > 0.0 {
            let (below, above) = (self.at_height(grid, height_m - about_m), self.at_height(grid, height_m + about_m));
            lifted.levels[0][LIFT] = above.iter().zip(&below).map(|(a, b)| finite_or_zero(0.5 * (a - b))).collect();
            self.fill_bends(&mut lifted.levels[0]);
        }
        lifted
    }

    /// The values of the window at a height.
    pub fn at_height(&self, grid: &GridMap, height_m: f64) -> Vec<f32> {
        let (own, parts) = at_height(height_m);
        let mut out: Vec<f32> = self.levels[0][VALUE].iter().map(|v| own as f32 * v).collect();
        let map_columns = grid.x().len();
        for (number, weight) in parts.into_iter().filter(|(_, weight)| *weight != 0.0) {
            let continued = grid.continued(number);
            for (r, line) in out.chunks_exact_mut(self.columns).enumerate() {
                let from = (self.first[1] as usize + r) * map_columns + self.first[0] as usize;
                for (v, c) in line.iter_mut().zip(continued.get(from..).unwrap_or_default()) {
                    *v += weight as f32 * c;
                }
            }
        }
        out
    }

    /// Root mean square of the largest second difference at a node, value units.
    pub fn typical_bend(&self) -> f64 {
        let bends = &self.levels[0][BEND];
        let sum: f64 = bends.iter().map(|bend| f64::from(*bend).powi(2)).sum();
        (sum / bends.len() as f64).sqrt()
    }

    /// Lays out the curved surfaces through the nodes.
    pub fn add_curves(&mut self) {
        self.curved = true;
        let mut levels = std::mem::take(&mut self.levels);
        for planes in &mut levels {
            self.fill_bends(planes);
        }
        self.levels = levels;
    }

    /// Second differences of the values: what bilinear interpolation leaves out; those of the curved surfaces where they are wanted. On
    /// the border those of the row or column inside it, which continue the map as a parabola; zero beside holes.
    fn fill_bends(&self, planes: &mut [Vec<f32>; PLANES]) {
        let columns = self.columns;
        let across = second_differences_across(&planes[VALUE], columns);
        let up = second_differences_up(&planes[VALUE], columns);
        planes[BEND] = across.iter().zip(&up).map(|(a, u)| a.abs().max(u.abs())).collect();
        if self.curved {
            // The spline bends at its nodes by M with M- + 4 M + M+ = 6 D (de Boor, A Practical Guide to Splines, 1978, chapter IV).
            let mut spline = across.clone();
            for row in spline.chunks_exact_mut(columns) {
                spline_bends(row, 1);
            }
            planes[SPLINE_TWIST] = second_differences_up(&spline, columns);
            spline_bends(&mut planes[SPLINE_TWIST], columns);
            planes[SPLINE_ACROSS] = spline;
            planes[SPLINE_UP].clone_from(&up);
            spline_bends(&mut planes[SPLINE_UP], columns);
            planes[TWIST] = second_differences_up(&across, columns);
            planes[ACROSS] = across;
            planes[UP] = up;
        }
    }
    /// Error variance from the local mean square gradient; `aspect` is the cell's sides over its mean side.
    ///
    /// The gradient at one node vanishes on every crest, where an interpolated map is at its worst; its mean over a few
    /// cells does not.
    fn fill_default_variance(&self, planes: &mut [Vec<f32>; PLANES], aspect: [f64; 2]) {
        let (columns, rows) = (self.columns, self.rows);
        let mut square = vec![[0.0_f64; 2]; columns * rows];
        let at = |r: usize, c: usize| f64::from(planes[VALUE][r * columns + c]);
        for r in 0..rows {
            for c in 0..columns {
                let slope = |a: f64, b: f64, cells: f64| if cells > 0.0 { (b - a) / cells } else { 0.0 };
                let (c0, c1) = (c.saturating_sub(1), (c + 1).min(columns - 1));
                let (r0, r1) = (r.saturating_sub(1), (r + 1).min(rows - 1));
                let gx = slope(at(r, c0), at(r, c1), (c1 - c0) as f64 * aspect[0]);
                let gy = slope(at(r0, c), at(r1, c), (r1 - r0) as f64 * aspect[1]);
                let total = gx * gx + gy * gy;
                square[r * columns + c] = if total.is_finite() { [total, 1.0] } else { [0.0, 0.0] };
            }
        }
        // Two passes of a running sum: columns of each row, then rows.
        let mut across = vec![[0.0_f64; 2]; columns * rows];
        for r in 0..rows {
            for c in 0..columns {
                for k in c.saturating_sub(SMOOTHING_CELLS)..=(c + SMOOTHING_CELLS).min(columns - 1) {
                    across[r * columns + c][0] += square[r * columns + k][0];
                    across[r * columns + c][1] += square[r * columns + k][1];
                }
            }
        }
        for r in 0..rows {
            for c in 0..columns {
                let (mut sum, mut count) = (0.0, 0.0);
                for k in r.saturating_sub(SMOOTHING_CELLS)..=(r + SMOOTHING_CELLS).min(rows - 1) {
                    sum += across[k * columns + c][0];
                    count += across[k * columns + c][1];
                }
                let mean = if count > 0.0 { sum / count } else { 0.0 };
                planes[VARIANCE][r * columns + c] = (DEFAULT_ERROR_CELLS * DEFAULT_ERROR_CELLS * mean) as f32;
            }
        }
    }

    /// Position in cells from the patch's first node.
    #[inline]
    pub fn position(&self, x: f64, y: f64) -> [f64; 2] {
        [
            (x - self.origin[0]) / self.step[0] - self.first[0] as f64,
            (y - self.origin[1]) / self.step[1] - self.first[1] as f64,
        ]
    }

    /// Bilinear value, variance, distance and gradient in a storey; a NaN value off the patch and next to holes.
    #[inline(always)]
    pub fn at(&self, px: f64, py: f64, storey: Storey) -> MapPoint {
        let below = self.on_level(px, py, storey.level);
        if storey.share == 0.0 {
            return below;
        }
        let above = self.on_level(px, py, storey.level + 1);
        let mix = |a: f32, b: f32| a + storey.share as f32 * (b - a);
        let nearest = if storey.share > 0.5 { &above } else { &below };
        MapPoint {
            value: mix(below.value, above.value),
            gradient: [0, 1].map(|d| mix(below.gradient[d], above.gradient[d])),
            ..*nearest
        }
    }

    #[inline(always)]
    fn on_level(&self, px: f64, py: f64, level: usize) -> MapPoint {
        const UNKNOWN: MapPoint =
            MapPoint { value: f32::NAN, variance: 0.0, distance: 0.0, gradient: [0.0; 2], curvature: 0.0, bend: 0.0 };
        let (last_column, last_row) = ((self.columns - 1) as f64, (self.rows - 1) as f64);
        if !(px >= -NODE_TOLERANCE
            && py >= -NODE_TOLERANCE
            && px <= last_column + NODE_TOLERANCE
            && py <= last_row + NODE_TOLERANCE)
        {
            return UNKNOWN;
        }
        let c = (px.max(0.0) as usize).min(self.columns.saturating_sub(2));
        let r = (py.max(0.0) as usize).min(self.rows.saturating_sub(2));
        let (u, v) = ((px - c as f64) as f32, (py - r as f64) as f32);
        let i = r * self.columns + c;
        let planes = &self.levels[level];
        let Some([a, b, e, f]) = self.around(&planes[VALUE], i) else { return UNKNOWN };
        let mix = |[a, b, e, f]: [f32; 4]| {
            let low = a + u * (b - a);
            let high = e + u * (f - e);
            low + v * (high - low)
        };
        let of = |quantity: usize| self.around(&planes[quantity], i).map_or(0.0, mix);
        let [variance, distance] =
            if self.even { [planes[VARIANCE][0], planes[DISTANCE][0]] } else { [of(VARIANCE), of(DISTANCE)] };
        let (value, bend) = (mix([a, b, e, f]), of(BEND));
        let slope = [(b - a) + v * ((f - e) - (b - a)), (e - a) + u * ((f - b) - (e - a))];
        let curvature = 0.5 * bend * (u * (1.0 - u)).max(v * (1.0 - v));
        MapPoint { value, variance, distance, gradient: slope, curvature, bend }
    }

    /// The four nodes of a cell: lower left (number `i`), lower right, upper left, upper right.
    #[inline(always)]
    pub(super) fn around(&self, plane: &[f32], i: usize) -> Option<[f32; 4]> {
        let &[a, b] = plane.get(i..)?.first_chunk::<2>()?;
        let &[e, f] = plane.get(i + self.columns..)?.first_chunk::<2>()?;
        Some([a, b, e, f])
    }

    /// Error variance and distance to data of an even patch, in the storey of a place.
    pub fn everywhere(&self, place: PatchPlace) -> [f32; 2] {
        let nearest = place.level as usize + usize::from(place.share > 0.5);
        [VARIANCE, DISTANCE].map(|q| self.levels[nearest][q][0])
    }

    /// Spacing, map units.
    pub fn step(&self) -> [f64; 2] {
        self.step
    }
}
