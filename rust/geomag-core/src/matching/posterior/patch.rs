//! The part of a map that a search can touch, laid out for the kernel: value, error variance and distance to data.

use super::kernel::LANES;
use crate::field::Field;
use crate::grid::MapSigma;
use crate::map_error::DistanceLayer;

/// Where nothing is known of a map's error, it is taken to be displaced by this many cells.
pub(super) const DEFAULT_ERROR_CELLS: f64 = 1.0;
/// Where nothing is known of the data behind a map, they are taken to be this many cells away.
pub(super) const DEFAULT_DISTANCE_CELLS: f64 = 4.0;
/// Half width in cells of the box over which the gradient of the default error model is averaged.
const SMOOTHING_CELLS: usize = 2;
/// Largest distance in cells between a node and the hole next to it over which nothing is interpolated.
const NODE_TOLERANCE: f64 = 1e-9;

/// A window of the map: `[value - level, error variance, distance to data, largest second difference]` a node.
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
    nodes: Vec<[f32; 4]>,
    /// Value subtracted from every node, so that single precision suffices.
    pub level: f64,
    /// Whether error variance and distance are the same at every node.
    pub even: bool,
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
}

/// The four nodes around each of [`LANES`] places: lower left, lower right, upper left, upper right.
#[derive(Debug, Clone, Copy)]
pub(super) struct Corners {
    pub nodes: [[[f32; 4]; LANES]; 4],
    /// Place between the nodes, 0 to 1.
    pub u: [f32; LANES],
    pub v: [f32; LANES],
    pub known: [f32; LANES],
}

impl Corners {
    pub const NONE: Self =
        Self { nodes: [[[0.0; 4]; LANES]; 4], u: [0.0; LANES], v: [0.0; LANES], known: [0.0; LANES] };
}

impl Patch {
    /// The window of `field` that covers the box from `low` to `high` (map units, on the map's own turn of longitude).
    pub fn new(field: &dyn Field, low: [f64; 2], high: [f64; 2]) -> Self {
        let step = field.spacing();
        let grid = field.as_grid();
        let origin = grid.map_or(low, |g| [g.x().first(), g.y().first()]);
        let limits = grid.map_or([i64::MAX / 4; 2], |g| [g.x().len() as i64 - 1, g.y().len() as i64 - 1]);
        let (mut first, mut last) = ([0_i64; 2], [0_i64; 2]);
        for d in 0..2 {
            let margin = SMOOTHING_CELLS as i64 + 1;
            let least = if grid.is_some() { 0 } else { i64::MIN / 4 };
            first[d] = (((low[d] - origin[d]) / step[d]).floor() as i64 - margin).clamp(least, limits[d]);
            last[d] = (((high[d] - origin[d]) / step[d]).ceil() as i64 + margin).clamp(first[d], limits[d]);
        }
        let (columns, rows) = ((last[0] - first[0] + 1) as usize, (last[1] - first[1] + 1) as usize);
        let middle = 0.5 * (low[1] + high[1]);
        let [east, north] = field.metres_per_unit(middle);
        let cell_m = (step[0] * east * step[1] * north).sqrt();
        let level = field.mean();
        let mut patch =
            Self { origin, step, first, columns, rows, nodes: vec![[0.0; 4]; columns * rows], level, even: false };
        let default_distance = (DEFAULT_DISTANCE_CELLS * cell_m) as f32;
        let map_columns = grid.map_or(0, |g| g.x().len());
        for r in 0..rows {
            for c in 0..columns {
                let (row, column) = (first[1] + r as i64, first[0] + c as i64);
                let node = &mut patch.nodes[r * columns + c];
                if let Some(g) = grid {
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
                    let value = if sigma.is_nan() || distance.is_nan() { f64::NAN } else { g.values().get(i) - level };
                    *node = [value as f32, (sigma * sigma) as f32, distance, 0.0];
                } else {
                    let (x, y) = (origin[0] + column as f64 * step[0], origin[1] + row as f64 * step[1]);
                    let sigma = field.sigma(x, y);
                    *node = [(field.value(x, y) - level) as f32, (sigma * sigma) as f32, default_distance, 0.0];
                }
            }
        }
        patch.fill_bends();
        if grid.is_some_and(|g| g.map_sigma().is_none()) {
            patch.fill_default_variance([step[0] * east / cell_m, step[1] * north / cell_m]);
        }
        let first = patch.nodes[0];
        patch.even = patch.nodes.iter().all(|node| node[1] == first[1] && node[2] == first[2]);
        patch
    }

    /// Root mean square of the largest second difference at a node, value units.
    pub fn typical_bend(&self) -> f64 {
        let sum: f64 = self.nodes.iter().map(|node| f64::from(node[3]).powi(2)).sum();
        (sum / self.nodes.len() as f64).sqrt()
    }

    /// Second differences of the values: what bilinear interpolation leaves out.
    fn fill_bends(&mut self) {
        let (columns, rows) = (self.columns, self.rows);
        for r in 0..rows {
            for c in 0..columns {
                let at = |r: usize, c: usize| self.nodes[r * columns + c][0];
                let middle = at(r, c);
                let across = if c > 0 && c + 1 < columns { at(r, c - 1) + at(r, c + 1) - 2.0 * middle } else { 0.0 };
                let along = if r > 0 && r + 1 < rows { at(r - 1, c) + at(r + 1, c) - 2.0 * middle } else { 0.0 };
                let bend = across.abs().max(along.abs());
                self.nodes[r * columns + c][3] = if bend.is_finite() { bend } else { 0.0 };
            }
        }
    }

    /// Error variance from the local mean square gradient; `aspect` is the cell's sides over its mean side.
    ///
    /// The gradient at one node vanishes on every crest, where an interpolated map is at its worst; its mean over a few
    /// cells does not.
    fn fill_default_variance(&mut self, aspect: [f64; 2]) {
        let (columns, rows) = (self.columns, self.rows);
        let mut square = vec![[0.0_f64; 2]; columns * rows];
        let at = |nodes: &[[f32; 4]], r: usize, c: usize| f64::from(nodes[r * columns + c][0]);
        for r in 0..rows {
            for c in 0..columns {
                let slope = |a: f64, b: f64, cells: f64| if cells > 0.0 { (b - a) / cells } else { 0.0 };
                let (c0, c1) = (c.saturating_sub(1), (c + 1).min(columns - 1));
                let (r0, r1) = (r.saturating_sub(1), (r + 1).min(rows - 1));
                let gx = slope(at(&self.nodes, r, c0), at(&self.nodes, r, c1), (c1 - c0) as f64 * aspect[0]);
                let gy = slope(at(&self.nodes, r0, c), at(&self.nodes, r1, c), (r1 - r0) as f64 * aspect[1]);
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
                self.nodes[r * columns + c][1] = (DEFAULT_ERROR_CELLS * DEFAULT_ERROR_CELLS * mean) as f32;
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

    /// Bilinear value, variance, distance and gradient; a NaN value off the patch and next to holes.
    #[inline(always)]
    pub fn at(&self, px: f64, py: f64) -> Sample {
        const UNKNOWN: Sample =
            Sample { value: f32::NAN, variance: 0.0, distance: 0.0, gradient: [0.0; 2], curvature: 0.0 };
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
        let (Some(&[a, b]), Some(&[e, f])) =
            (self.nodes[i..].first_chunk::<2>(), self.nodes.get(i + self.columns..).and_then(|s| s.first_chunk::<2>()))
        else {
            return UNKNOWN;
        };
        let mut mixed = [0.0_f32; 4];
        for k in 0..4 {
            let low = a[k] + u * (b[k] - a[k]);
            let high = e[k] + u * (f[k] - e[k]);
            mixed[k] = low + v * (high - low);
        }
        let [value, variance, distance, bend] = mixed;
        let gx = (b[0] - a[0]) + v * ((f[0] - e[0]) - (b[0] - a[0]));
        let gy = (e[0] - a[0]) + u * ((f[0] - b[0]) - (e[0] - a[0]));
        let curvature = 0.5 * bend * (u * (1.0 - u)).max(v * (1.0 - v));
        Sample { value, variance, distance, gradient: [gx, gy], curvature }
    }

    /// The nodes around [`LANES`] places (cells of the patch), and where the places lie between them; places that are
    /// not on the patch are marked unknown.
    #[inline(always)]
    pub fn corners(&self, px: &[f64; LANES], py: &[f64; LANES], out: &mut Corners) {
        let (last_column, last_row) = ((self.columns - 1) as f64, (self.rows - 1) as f64);
        let (most_c, most_r) = (self.columns.saturating_sub(2) as i32, self.rows.saturating_sub(2) as i32);
        let columns = self.columns as i32;
        let mut index = [0_i32; LANES];
        for l in 0..LANES {
            let (x, y) = (px[l], py[l]);
            let inside = (x >= -NODE_TOLERANCE)
                & (y >= -NODE_TOLERANCE)
                & (x <= last_column + NODE_TOLERANCE)
                & (y <= last_row + NODE_TOLERANCE);
            let (c, r) = ((x.max(0.0) as i32).min(most_c), (y.max(0.0) as i32).min(most_r));
            out.u[l] = (x - f64::from(c)) as f32;
            out.v[l] = (y - f64::from(r)) as f32;
            out.known[l] = if inside { 1.0 } else { 0.0 };
            index[l] = r * columns + c;
        }
        for l in 0..LANES {
            let i = index[l] as usize;
            let (Some(&[a, b]), Some(&[e, f])) = (
                self.nodes.get(i..).and_then(|s| s.first_chunk::<2>()),
                self.nodes.get(i + self.columns..).and_then(|s| s.first_chunk::<2>()),
            ) else {
                out.known[l] = 0.0;
                continue;
            };
            (out.nodes[0][l], out.nodes[1][l], out.nodes[2][l], out.nodes[3][l]) = (a, b, e, f);
        }
    }

    /// [`Patch::corners`] for places one cell apart along x from lane `start` on, the first at (`px`, `py`); the lanes before
    /// it are left alone. `false`, with nothing done, where that would leave the patch.
    #[inline(always)]
    pub fn corners_in_row(&self, px: f64, py: f64, start: usize, out: &mut Corners) -> bool {
        let inside =
            px >= 0.0 && py >= 0.0 && px + LANES as f64 <= (self.columns - 1) as f64 && py < (self.rows - 1) as f64;
        if !inside {
            return false;
        }
        let (c, r) = (px as usize, py as usize);
        let (u, v) = ((px - c as f64) as f32, (py - r as f64) as f32);
        let i = r * self.columns + c;
        let count = LANES - start;
        let (Some(low), Some(high)) =
            (self.nodes.get(i..=i + count), self.nodes.get(i + self.columns..=i + self.columns + count))
        else {
            return false;
        };
        out.nodes[0][start..].copy_from_slice(&low[..count]);
        out.nodes[1][start..].copy_from_slice(&low[1..]);
        out.nodes[2][start..].copy_from_slice(&high[..count]);
        out.nodes[3][start..].copy_from_slice(&high[1..]);
        out.u[start..].fill(u);
        out.v[start..].fill(v);
        out.known[start..].fill(1.0);
        true
    }

    /// Spacing, map units.
    pub fn step(&self) -> [f64; 2] {
        self.step
    }
}
