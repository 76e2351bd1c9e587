//! The part of a map that a search can touch, laid out for the kernel: value, error variance and distance to data.

use super::kernel::LANES;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::{GridMap, MapSigma, at_height};
use crate::map_error::DistanceLayer;
use crate::stack::Storey;

/// Where nothing is known of a map's error, it is taken to be displaced by this many cells.
pub(super) const DEFAULT_ERROR_CELLS: f64 = 1.0;
/// Where nothing is known of the data behind a map, they are taken to be this many cells away.
pub(super) const DEFAULT_DISTANCE_CELLS: f64 = 4.0;
/// Half width in cells of the box over which the gradient of the default error model is averaged.
const SMOOTHING_CELLS: usize = 2;
/// Largest distance in cells between a node and the hole next to it over which nothing is interpolated.
const NODE_TOLERANCE: f64 = 1e-9;
/// The same of a sum of two parts of a cell in single precision.
const PART_TOLERANCE: f32 = 4e-7;
/// Most rows of the lattice in one block up to which the map is read in rows.
const RUNS: usize = 3;

/// Planes of a patch: value minus level, error variance, distance to data, largest second difference, the second differences along x
/// and y, and that along y of those along x; and the same three of the cubic spline through the nodes.
pub(super) const VALUE: usize = 0;
pub(super) const VARIANCE: usize = 1;
pub(super) const DISTANCE: usize = 2;
pub(super) const BEND: usize = 3;
pub(super) const ACROSS: usize = 4;
pub(super) const UP: usize = 5;
pub(super) const TWIST: usize = 6;
pub(super) const SPLINE_ACROSS: usize = 7;
pub(super) const SPLINE_UP: usize = 8;
pub(super) const SPLINE_TWIST: usize = 9;
/// Half of what the values change by from one side of a height to the other.
pub(super) const LIFT: usize = 10;
const PLANES: usize = 11;
/// Nodes beyond what a search can touch: over each of them a spline forgets three quarters of what lies beyond.
const MARGIN_CELLS: i64 = 8;
/// A window of the map, a plane a quantity.
#[derive(Debug, Clone)]
pub(super) struct Patch {
    /// Coordinate of the map's (not the patch's) first node.
    origin: [f64; 2],
    /// Spacing, map units.
    step: [f64; 2],
    /// First column and row of the patch in the map's numbering.
    first: [i64; 2],
    columns: usize,
    rows: usize,
    /// The planes of every level, lowest first; one where the field has one surface.
    levels: Vec<[Vec<f32>; PLANES]>,
    /// Value subtracted from every node, so that single precision suffices.
    pub level: f64,
    /// Whether error variance and distance are the same at every node.
    pub even: bool,
    /// Whether the curved surfaces through the nodes are laid out.
    curved: bool,
}

/// One interpolated point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sample {
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

/// Up to [`LANES`] offsets in cells, as whole cells and the rest; the last is repeated where there are fewer.
#[derive(Debug)]
pub(super) struct Cells {
    whole: [[i32; LANES]; 2],
    part: [[f32; LANES]; 2],
    /// 1 for an offset, 0 for a repetition.
    pub used: [f32; LANES],
    /// Where rows of offsets one cell apart start, and how many such rows there are.
    starts: [usize; RUNS],
    runs: usize,
    /// Lanes of the least and the greatest offset along each axis.
    extremes: [[usize; 2]; 2],
}

impl Cells {
    #[inline(always)]
    pub fn new(offsets: &[[f64; 2]]) -> Self {
        let mut cells = Self {
            whole: [[0; LANES]; 2],
            part: [[0.0; LANES]; 2],
            used: [0.0; LANES],
            starts: [0; RUNS],
            runs: usize::from(!offsets.is_empty()),
            extremes: [[0; 2]; 2],
        };
        for lane in 0..LANES {
            let Some(offset) = offsets.get(lane.min(offsets.len().wrapping_sub(1))) else { break };
            let mut place = Place::new(*offset);
            if lane < offsets.len() {
                cells.used[lane] = 1.0;
            }
            if lane > 0 && lane < offsets.len() {
                let before = offsets[lane - 1];
                if offset[1] == before[1] && (offset[0] - before[0] - 1.0).abs() < 1e-9 {
                    // To the bit, so that no rounding puts one of them into another cell than its row says.
                    place.part = cells.part.map(|part| part[lane - 1]);
                    place.whole = [cells.whole[0][lane - 1] + 1, cells.whole[1][lane - 1]];
                } else {
                    if cells.runs < RUNS {
                        cells.starts[cells.runs] = lane;
                    }
                    cells.runs += 1;
                }
            }
            for d in 0..2 {
                (cells.whole[d][lane], cells.part[d][lane]) = (place.whole[d], place.part[d]);
                let at = |lane: usize| (cells.whole[d][lane], cells.part[d][lane]);
                let [least, greatest] = cells.extremes[d];
                if at(lane) < at(least) {
                    cells.extremes[d][0] = lane;
                } else if at(lane) > at(greatest) {
                    cells.extremes[d][1] = lane;
                }
            }
        }
        cells
    }
}

/// Second differences along x.
fn second_differences_across(plane: &[f32], columns: usize) -> Vec<f32> {
    let mut out = vec![0.0; plane.len()];
    if columns < 3 {
        return out;
    }
    for (line, out) in plane.chunks_exact(columns).zip(out.chunks_exact_mut(columns)) {
        for (out, w) in out[1..].iter_mut().zip(line.windows(3)) {
            *out = finite_or_zero(w[0] + w[2] - 2.0 * w[1]);
        }
        (out[0], out[columns - 1]) = (out[1], out[columns - 2]);
    }
    out
}

/// Second differences along y.
fn second_differences_up(plane: &[f32], columns: usize) -> Vec<f32> {
    let mut out = vec![0.0; plane.len()];
    let n = plane.len();
    if n < 3 * columns {
        return out;
    }
    let (low, middle, high) = (&plane[..n - 2 * columns], &plane[columns..n - columns], &plane[2 * columns..]);
    for (out, ((l, m), h)) in out[columns..].iter_mut().zip(low.iter().zip(middle).zip(high)) {
        *out = finite_or_zero(l + h - 2.0 * m);
    }
    out.copy_within(columns..2 * columns, 0);
    out.copy_within(n - 2 * columns..n - columns, n - columns);
    out
}

/// Second differences D to the second derivatives M of the cubic spline, M- + 4 M + M+ = 6 D, along lines whose neighbours stand
/// `stride` apart; at both ends a parabola.
fn spline_bends(plane: &mut [f32], stride: usize) {
    let n = plane.len() / stride;
    if n < 3 {
        return;
    }
    // Elimination from the first inner node on: the coefficient of the next one settles at 2 - sqrt 3.
    let mut factors = vec![0.0_f32; n];
    for i in 1..n - 1 {
        factors[i] = 1.0 / (4.0 - factors[i - 1]);
        let (before, from) = plane.split_at_mut(i * stride);
        for (v, b) in from[..stride].iter_mut().zip(&before[(i - 1) * stride..]) {
            *v = (6.0 * *v - b) * factors[i];
        }
    }
    for i in (1..n - 1).rev() {
        let (upto, after) = plane.split_at_mut((i + 1) * stride);
        for (v, a) in upto[i * stride..].iter_mut().zip(&after[..stride]) {
            *v -= factors[i] * a;
        }
    }
}

fn finite_or_zero(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}

/// A place in cells of the patch: whole cells, and the rest in [0, 1].
#[derive(Debug, Clone, Copy)]
pub(super) struct Place {
    whole: [i32; 2],
    part: [f32; 2],
    /// The level below the place, and the share of the one above.
    level: u32,
    share: f32,
}

impl Place {
    #[inline(always)]
    pub fn new(cells: [f64; 2]) -> Self {
        let whole = cells.map(|c| c.floor().clamp(-1e9, 1e9));
        let part = [0, 1].map(|d| (cells[d] - whole[d]) as f32);
        Self { whole: whole.map(|w| w as i32), part, level: 0, share: 0.0 }
    }

    /// The same place in a storey of the patch.
    pub fn in_storey(self, storey: Storey) -> Self {
        Self { level: storey.level as u32, share: storey.share as f32, ..self }
    }
}

/// Whole cells and the rest of a coordinate at every offset, on an axis of `size` nodes; 2 where it lies on the axis, 1 where
/// on either end of it, else 0.
#[inline(always)]
fn along(place: Place, d: usize, cells: &Cells, size: usize) -> ([i32; LANES], [f32; LANES], [i32; LANES]) {
    let (place, rest, whole, part) = (place.whole[d], place.part[d], &cells.whole[d], &cells.part[d]);
    let last = size as i32 - 1;
    let (mut at, mut between, mut on) = ([0; LANES], [0.0; LANES], [0; LANES]);
    for l in 0..LANES {
        let sum = rest + part[l];
        let carry = sum >= 1.0;
        let cell = place + whole[l] + i32::from(carry);
        let sum = if carry { sum - 1.0 } else { sum };
        let before = (cell == -1) & (sum >= 1.0 - PART_TOLERANCE);
        let after = (cell == last) & (sum <= PART_TOLERANCE);
        let between_nodes = (cell >= 0) & (cell < last);
        let inside = (between_nodes | before | after) & (last > 0);
        let sum = if before { 0.0 } else { sum };
        between[l] = if after { 1.0 } else { sum };
        at[l] = cell.min(last - 1).max(0);
        on[l] = i32::from(inside) + i32::from(between_nodes);
    }
    (at, between, on)
}

/// Where a place lies at every offset.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Spots {
    /// Between the nodes, 0 to 1.
    pub u: [f32; LANES],
    pub v: [f32; LANES],
    /// 1 on the patch, 0 off it.
    pub known: [f32; LANES],
    /// Column and row of the lower left node.
    column: [i32; LANES],
    row: [i32; LANES],
    way: Way,
    /// The level below, and the share of the one above.
    level: u32,
    share: f32,
}

/// How the nodes around the places are read.
#[derive(Debug, Clone, Copy)]
enum Way {
    /// Row by row: the offsets are one cell apart.
    Rows,
    /// The places lie in one cell of the map or about the corner of four, of which this is the lower left one.
    Close([i32; 2]),
    /// Each by itself.
    Apart,
}

/// A quantity at the four nodes around every place: lower left, lower right, upper left, upper right.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Corners(pub [[f32; LANES]; 4]);

impl Corners {
    /// Interpolated.
    #[inline(always)]
    pub fn mixed(&self, spots: &Spots) -> [f32; LANES] {
        self.mixed_at(&spots.u, &spots.v)
    }

    /// Interpolated at other places between the nodes.
    #[inline(always)]
    pub fn mixed_at(&self, u: &[f32; LANES], v: &[f32; LANES]) -> [f32; LANES] {
        let [a, b, e, f] = &self.0;
        let mut mixed = [0.0; LANES];
        for l in 0..LANES {
            let low = a[l] + u[l] * (b[l] - a[l]);
            let high = e[l] + u[l] * (f[l] - e[l]);
            mixed[l] = low + v[l] * (high - low);
        }
        mixed
    }
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
    fn at_height(&self, grid: &GridMap, height_m: f64) -> Vec<f32> {
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
    pub fn at(&self, px: f64, py: f64, storey: Storey) -> Sample {
        let below = self.on_level(px, py, storey.level);
        if storey.share == 0.0 {
            return below;
        }
        let above = self.on_level(px, py, storey.level + 1);
        let mix = |a: f32, b: f32| a + storey.share as f32 * (b - a);
        let nearest = if storey.share > 0.5 { &above } else { &below };
        Sample {
            value: mix(below.value, above.value),
            gradient: [0, 1].map(|d| mix(below.gradient[d], above.gradient[d])),
            ..*nearest
        }
    }

    #[inline(always)]
    fn on_level(&self, px: f64, py: f64, level: usize) -> Sample {
        const UNKNOWN: Sample =
            Sample { value: f32::NAN, variance: 0.0, distance: 0.0, gradient: [0.0; 2], curvature: 0.0, bend: 0.0 };
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
        Sample { value, variance, distance, gradient: slope, curvature, bend }
    }

    /// Where a place (cells of the patch) lies at every offset.
    #[inline(always)]
    pub fn locate(&self, place: Place, cells: &Cells) -> Spots {
        let (column, u, on_columns) = along(place, 0, cells, self.columns);
        let (row, v, on_rows) = along(place, 1, cells, self.rows);
        let mut known = [0.0; LANES];
        for l in 0..LANES {
            known[l] = on_columns[l].min(on_rows[l]).min(1) as f32;
        }
        // What holds for both extremes holds for what lies between them.
        let [[left, right], [lower, upper]] = cells.extremes;
        let everywhere = on_columns[left] & on_columns[right] & on_rows[lower] & on_rows[upper] == 2;
        let (left, right, lower, upper) = (column[left], column[right], row[lower], row[upper]);
        let first = lower as usize * self.columns + left as usize;
        let way = if cells.runs <= RUNS && everywhere && self.levels[0][VALUE].len() > first + self.columns + 2 * LANES
        {
            Way::Rows
        } else if right - left <= 1 && upper - lower <= 1 {
            Way::Close([left, lower])
        } else {
            Way::Apart
        };
        Spots { u, v, known, column, row, way, level: place.level, share: place.share }
    }

    /// One quantity at the nodes around these spots.
    #[inline(always)]
    pub fn read<const QUANTITY: usize>(&self, cells: &Cells, spots: &mut Spots) -> Corners {
        if QUANTITY != VALUE {
            // What is known of the errors changes slowly with height: that of the nearest level will do.
            return self.read_level::<QUANTITY>(spots.level as usize + usize::from(spots.share > 0.5), cells, spots);
        }
        let mut corners = self.read_level::<QUANTITY>(spots.level as usize, cells, spots);
        if spots.share > 0.0 {
            let above = self.read_level::<QUANTITY>(spots.level as usize + 1, cells, spots);
            for (below, above) in corners.0.iter_mut().zip(&above.0) {
                for l in 0..LANES {
                    below[l] += spots.share * (above[l] - below[l]);
                }
            }
        }
        corners
    }

    #[inline(always)]
    fn read_level<const QUANTITY: usize>(&self, level: usize, cells: &Cells, spots: &mut Spots) -> Corners {
        let plane = self.levels[level][QUANTITY].as_slice();
        let read = match spots.way {
            Way::Rows => self.in_rows(plane, cells, spots),
            Way::Close(lowest) => self.close(plane, lowest, spots),
            Way::Apart => None,
        };
        read.unwrap_or_else(|| self.apart(plane, spots))
    }

    /// Offsets one cell apart along x, row by row.
    #[inline(always)]
    fn in_rows(&self, plane: &[f32], cells: &Cells, spots: &Spots) -> Option<Corners> {
        // Every row is written from its first lane on, beyond the last lane; the next one goes over the rest.
        let mut padded = [[0.0_f32; 2 * LANES]; 4];
        for &start in cells.starts.iter().take(cells.runs) {
            let low = spots.row[start] as usize * self.columns + spots.column[start] as usize;
            let high = low + self.columns;
            for (i, corner) in [low, low + 1, high, high + 1].into_iter().zip(&mut padded) {
                corner.get_mut(start..start + LANES)?.copy_from_slice(plane.get(i..i + LANES)?);
            }
        }
        let mut corners = Corners([[0.0; LANES]; 4]);
        for (corner, padded) in corners.0.iter_mut().zip(&padded) {
            corner.copy_from_slice(&padded[..LANES]);
        }
        Some(corners)
    }

    /// Places in one cell of the map or about the corner of four.
    #[inline(always)]
    fn close(&self, plane: &[f32], [column, row]: [i32; 2], spots: &Spots) -> Option<Corners> {
        let first = row as usize * self.columns + column as usize;
        let of_row = |row: usize| plane.get(first + row * self.columns..)?.first_chunk::<3>();
        let (&[a, b, c], &[d, e, f], &[g, h, i]) = (of_row(0)?, of_row(1)?, of_row(2)?);
        let mut corners = Corners([[0.0; LANES]; 4]);
        let [lower_left, lower_right, upper_left, upper_right] = &mut corners.0;
        for l in 0..LANES {
            let right = spots.column[l] > column;
            let up = spots.row[l] > row;
            let (a, b) = (if right { b } else { a }, if right { c } else { b });
            let (d, e) = (if right { e } else { d }, if right { f } else { e });
            let (g, h) = (if right { h } else { g }, if right { i } else { h });
            lower_left[l] = if up { d } else { a };
            lower_right[l] = if up { e } else { b };
            upper_left[l] = if up { g } else { d };
            upper_right[l] = if up { h } else { e };
        }
        Some(corners)
    }

    /// Places anywhere.
    #[inline(always)]
    fn apart(&self, plane: &[f32], spots: &mut Spots) -> Corners {
        let mut corners = Corners([[0.0; LANES]; 4]);
        for l in 0..LANES {
            let i = spots.row[l] as usize * self.columns + spots.column[l] as usize;
            if let Some(near) = self.around(plane, i) {
                for (corner, node) in corners.0.iter_mut().zip(near) {
                    corner[l] = node;
                }
            } else {
                spots.known[l] = 0.0;
            }
        }
        corners
    }

    /// The four nodes of a cell: lower left (number `i`), lower right, upper left, upper right.
    #[inline(always)]
    fn around(&self, plane: &[f32], i: usize) -> Option<[f32; 4]> {
        let &[a, b] = plane.get(i..)?.first_chunk::<2>()?;
        let &[e, f] = plane.get(i + self.columns..)?.first_chunk::<2>()?;
        Some([a, b, e, f])
    }

    /// Error variance and distance to data of an even patch, in the storey of a place.
    pub fn everywhere(&self, place: Place) -> [f32; 2] {
        let nearest = place.level as usize + usize::from(place.share > 0.5);
        [VARIANCE, DISTANCE].map(|q| self.levels[nearest][q][0])
    }

    /// Spacing, map units.
    pub fn step(&self) -> [f64; 2] {
        self.step
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::GridValues;

    /// A map of 20 by 15 nodes with a hole, or one whose sigma differs from node to node.
    fn patch(uneven: bool) -> Patch {
        let axis = |n: u32| (0..n).map(f64::from).collect::<Vec<f64>>();
        let wave = |i: u32| 40.0 * (f64::from(i % 20) * 0.9).sin() + 25.0 * (f64::from(i / 20) * 0.7).cos();
        let values = (0..300).map(|i| if i == 153 { f64::NAN } else { wave(i) }).collect();
        let map = GridMap::new(GridValues::F64(values), &axis(20), &axis(15), false).unwrap();
        let sigma = if uneven {
            MapSigma::Grid((0..300).map(|i| 1.0 + 0.01 * f64::from(i)).collect())
        } else {
            MapSigma::Constant(2.0)
        };
        Patch::new(&map.with_sigma(Some(sigma)).unwrap(), [0.0; 2], [19.0, 14.0], 0, true).unwrap()
    }

    fn read_as_one_by_one(patch: &Patch, place: [f64; 2], offsets: &[[f64; 2]]) {
        let cells = Cells::new(offsets);
        let mut spots = patch.locate(Place::new(place), &cells);
        let value = patch.read::<VALUE>(&cells, &mut spots).mixed(&spots);
        let bend = patch.read::<BEND>(&cells, &mut spots).mixed(&spots);
        let (variance, distance) = if patch.even {
            let [variance, distance] = patch.everywhere(Place::new(place));
            ([variance; LANES], [distance; LANES])
        } else {
            let variance = patch.read::<VARIANCE>(&cells, &mut spots).mixed(&spots);
            (variance, patch.read::<DISTANCE>(&cells, &mut spots).mixed(&spots))
        };
        for (l, o) in offsets.iter().enumerate() {
            let wanted = patch.at(place[0] + o[0], place[1] + o[1], Storey::GROUND);
            let known = spots.known[l] > 0.0 && value[l].is_finite();
            assert_eq!(known, wanted.value.is_finite(), "{place:?} + {o:?}");
            if known {
                let curvature = 0.5 * bend[l] * (spots.u[l] * (1.0 - spots.u[l])).max(spots.v[l] * (1.0 - spots.v[l]));
                assert!((value[l] - wanted.value).abs() < 1e-4, "{place:?} + {o:?}: {} {}", value[l], wanted.value);
                assert!((variance[l] - wanted.variance).abs() < 1e-4);
                assert!((curvature - wanted.curvature).abs() < 1e-4);
                assert!((distance[l] - wanted.distance).abs() < 1e-3);
            }
        }
    }

    /// A field without a grid that says nothing of its error beyond x = 5.
    #[derive(Debug)]
    struct HalfKnown;

    impl Field for HalfKnown {
        fn value(&self, x: f64, _y: f64) -> f64 {
            x
        }
        fn value_and_gradient(&self, x: f64, _y: f64) -> (f64, [f64; 2]) {
            (x, [1.0, 0.0])
        }
        fn sigma(&self, x: f64, _y: f64) -> f64 {
            if x > 5.0 { f64::NAN } else { 1.0 }
        }
        fn geographic(&self) -> bool {
            false
        }
        fn wrap_x(&self, x: f64) -> f64 {
            x
        }
        fn spacing(&self) -> [f64; 2] {
            [1.0; 2]
        }
        fn mean(&self) -> f64 {
            0.0
        }
    }

    #[test]
    fn a_value_of_unknown_error_is_a_hole() {
        let patch = Patch::new(&HalfKnown, [0.0; 2], [10.0; 2], 10_000, false).unwrap();
        for (x, known) in [(2.5, true), (7.5, false)] {
            let [u, v] = patch.position(x, 3.0);
            assert_eq!(patch.at(u, v, Storey::GROUND).value.is_finite(), known, "at x = {x}");
        }
    }

    #[test]
    fn blocks_read_what_single_places_do() {
        let lattice = |count: usize, columns: usize, step: f64| -> Vec<[f64; 2]> {
            (0..count).map(|i| [(i % columns) as f64 * step - 1.0, (i / columns) as f64 * step - 2.0]).collect()
        };
        let blocks = [
            lattice(16, 16, 1.0),
            lattice(16, 7, 1.0),
            lattice(13, 9, 1.0),
            lattice(16, 4, 0.125),
            lattice(16, 4, 0.5),
            lattice(5, 2, 0.01),
            lattice(16, 3, 1.7),
            vec![[0.0; 2]],
        ];
        for patch in [patch(false), patch(true)] {
            for offsets in &blocks {
                for place in (0..22).flat_map(|i| (0..18).map(move |j| [f64::from(i), f64::from(j)])) {
                    read_as_one_by_one(&patch, place, offsets);
                    read_as_one_by_one(&patch, [place[0] + 0.37, place[1] - 0.81], offsets);
                }
            }
        }
    }

    #[test]
    fn a_row_stays_a_row_where_its_cells_begin() {
        let patch = patch(false);
        for a in [0.5_f32, 0.6, 0.7, 0.83, 0.999] {
            // Offsets whose parts differ by 1e-9 and round to neighbours, of which one reaches the next cell.
            let next = f32::from_bits(a.to_bits() + 1);
            let middle = 0.5 * (f64::from(a) + f64::from(next));
            let noise = |k: u32| 8e-10 * f64::from(k % 2) - 4e-10;
            let offsets: Vec<[f64; 2]> = (0..12).map(|k| [middle + f64::from(k) + noise(k), 0.25]).collect();
            read_as_one_by_one(&patch, [4.0 - f64::from(next), 3.5], &offsets);
        }
    }

    #[test]
    fn the_edge_belongs_to_the_patch_whatever_rounding_says() {
        let patch = patch(false);
        for (place, offset) in [([0.3, 5.0], [-0.3, 0.0]), ([18.9, 13.9], [0.1, 0.1]), ([5.7, 0.1], [0.0, -0.1])] {
            let cells = Cells::new(&[offset]);
            let mut spots = patch.locate(Place::new(place), &cells);
            let value = patch.read::<VALUE>(&cells, &mut spots).mixed(&spots)[0];
            let wanted = patch.at(place[0] + offset[0], place[1] + offset[1], Storey::GROUND).value;
            assert!(spots.known[0] > 0.0 && (value - wanted).abs() < 1e-4, "{place:?}: {value} {wanted}");
        }
    }
}
