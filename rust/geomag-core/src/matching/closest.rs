//! The closest point of a contour line: marching squares, outwards from the point that asks.

use crate::bounds::require_place;
use crate::error::{Error, Result, require_finite};
use crate::field::Field;
use crate::grid::{GridMap, GridValues};

/// The point of a contour line that is closest to a given point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContourPoint {
    /// East, map units, on the map's own turn of longitude.
    pub x: f64,
    /// North, map units.
    pub y: f64,
    /// Distance from the point that was asked for, metres.
    pub distance_m: f64,
}

/// The closest point to (x, y) on the contour line of `value`, within `radius_m` metres; `None` where there is none.
///
/// The contour is that of marching squares (Lorensen and Cline 1987, in two dimensions): straight segments between the
/// points where the value is crossed, linearly, on the sides of a cell. In a saddle cell two segments separate the
/// corners; which two is decided by the mean of the corners, as `contourpy` does. A cell with a NaN corner has no
/// contour. The answer lies on a segment, not only on its ends. Distances on geographic maps use the scale of the
/// point's own latitude.
///
/// # Errors
/// [`Error::NotFinite`] for a point or value that is not finite, [`Error::Invalid`] for a radius that is not positive
/// (infinity is the whole map).
///
/// ```
/// use geomag_core::grid::{GridMap, GridValues};
/// use geomag_core::matching::closest::closest_contour_point;
/// let slope = GridMap::new(GridValues::F64(vec![0.0, 10.0, 0.0, 10.0]), &[0.0, 100.0], &[0.0, 100.0], false)?;
/// let point = closest_contour_point(&slope, 20.0, 30.0, 5.0, f64::INFINITY)?.expect("the slope crosses 5");
/// assert_eq!((point.x, point.y, point.distance_m), (50.0, 30.0, 30.0));
/// assert!(closest_contour_point(&slope, 20.0, 30.0, 5.0, 29.0)?.is_none());
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
pub fn closest_contour_point(map: &GridMap, x: f64, y: f64, value: f64, radius_m: f64) -> Result<Option<ContourPoint>> {
    require_finite("contour point [x, y]", &[x, y])?;
    require_place("contour point", map.geographic(), [x, y])?;
    require_finite("contour value", &[value])?;
    check_radius(radius_m)?;
    let cell_m = cell_size_m(map, y);
    let found = closest_in_cells(map, map.position(x, y), value, cell_m, 0.0, radius_m);
    Ok(found.map(|(at, distance_m)| ContourPoint {
        x: map.x().first() + at[0] * map.x().step(),
        y: map.y().first() + at[1] * map.y().step(),
        distance_m,
    }))
}

/// Refuses a radius that is not positive; infinity is allowed.
pub(crate) fn check_radius(radius_m: f64) -> Result<()> {
    if radius_m > 0.0 { Ok(()) } else { Err(Error::invalid("radius_m", "a number > 0 (infinity allowed)", radius_m)) }
}

/// Size of a cell in metres `[east, north]` at a given y.
pub(crate) fn cell_size_m(map: &GridMap, y: f64) -> [f64; 2] {
    let [east, north] = map.metres_per_unit(y);
    [map.x().step() * east, map.y().step() * north]
}

/// The same search in cells from the first node: place and distance in metres.
///
/// `clear_m` is a distance within which the caller knows that there is no contour; 0 where nothing is known.
pub(crate) fn closest_in_cells(
    map: &GridMap,
    position: [f64; 2],
    value: f64,
    cell_m: [f64; 2],
    clear_m: f64,
    radius_m: f64,
) -> Option<([f64; 2], f64)> {
    let shape = [map.x().len(), map.y().len()];
    match map.values() {
        GridValues::F32(v) => Search::new(v, shape, position, value, cell_m, radius_m).run(clear_m),
        GridValues::F64(v) => Search::new(v, shape, position, value, cell_m, radius_m).run(clear_m),
    }
}

/// A place further than this from the map, in cells, is nowhere: what a transform of nearly nothing makes of a track.
const MOST_CELLS: u64 = 1 << 52;

/// One search: cells are visited in square rings around the point until no unvisited cell can be nearer.
struct Search<'a, T> {
    values: &'a [T],
    columns: usize,
    last: [i64; 2],
    point: [f64; 2],
    value: f64,
    cell_m: [f64; 2],
    best: Option<[f64; 2]>,
    best_squared: f64,
}

impl<'a, T: Copy + Into<f64>> Search<'a, T> {
    fn new(values: &'a [T], shape: [usize; 2], point: [f64; 2], value: f64, cell_m: [f64; 2], radius_m: f64) -> Self {
        let last = [shape[0] as i64 - 2, shape[1] as i64 - 2];
        // A contour at the radius itself still counts.
        let best_squared = (radius_m * radius_m).next_up();
        Self { values, columns: shape[0], last, point, value, cell_m, best: None, best_squared }
    }

    fn run(mut self, clear_m: f64) -> Option<([f64; 2], f64)> {
        let [px, py] = self.point;
        let (cx, cy) = (px.floor() as i64, py.floor() as i64);
        let (tx, ty) = (px - px.floor(), py - py.floor());
        let outside = |c: i64, last: i64| if c < 0 { c.saturating_neg() } else { (c - last).max(0) };
        // Cells of ring r lie within (r + 1) cell diagonals: rings inside the clear disc hold nothing.
        let cleared = (clear_m / self.cell_m[0].hypot(self.cell_m[1])) as i64;
        // Beyond the farthest ring that touches the map there is nothing, however much is clear.
        let farthest = [(cx, self.last[0]), (cy, self.last[1])].map(|(c, last)| c.unsigned_abs().max(last.abs_diff(c)));
        let farthest = farthest[0].max(farthest[1]);
        if farthest > MOST_CELLS || cleared > farthest as i64 {
            return None;
        }
        let mut ring = outside(cx, self.last[0]).max(outside(cy, self.last[1])).max(cleared);
        if ring == 0 {
            self.row(cy, cx, cx);
            ring = 1;
        }
        loop {
            let gap = (ring - 1) as f64;
            let [mx, my] = self.cell_m;
            let mut alive = false;
            for (row, distance) in [(cy - ring, (gap + ty) * my), (cy + ring, (gap + 1.0 - ty) * my)] {
                let to_come = if row < cy { row >= 0 } else { row <= self.last[1] };
                if to_come && distance * distance < self.best_squared {
                    alive = true;
                    // The square root of infinity is infinity, and the cast saturates: the whole ring.
                    let half = (self.best_squared - distance * distance).sqrt() / mx;
                    let from = ((px - half).floor() as i64).max(cx - ring);
                    let to = ((px + half).floor() as i64).min(cx + ring);
                    self.row(row, from, to);
                }
            }
            for (column, distance) in [(cx - ring, (gap + tx) * mx), (cx + ring, (gap + 1.0 - tx) * mx)] {
                let to_come = if column < cx { column >= 0 } else { column <= self.last[0] };
                if to_come && distance * distance < self.best_squared {
                    alive = true;
                    if (0..=self.last[0]).contains(&column) {
                        let half = (self.best_squared - distance * distance).sqrt() / my;
                        let from = ((py - half).floor() as i64).max(cy - ring + 1).max(0);
                        let to = ((py + half).floor() as i64).min(cy + ring - 1).min(self.last[1]);
                        for row in from..=to {
                            self.cell(row as usize, column as usize);
                        }
                    }
                }
            }
            if !alive {
                break;
            }
            ring += 1;
        }
        self.best.map(|at| (at, self.best_squared.sqrt()))
    }

    /// Cells `from..=to` of a row, as far as they are on the map.
    fn row(&mut self, row: i64, from: i64, to: i64) {
        if !(0..=self.last[1]).contains(&row) {
            return;
        }
        for column in from.max(0)..=to.min(self.last[0]) {
            self.cell(row as usize, column as usize);
        }
    }

    #[inline]
    fn cell(&mut self, row: usize, column: usize) {
        let i = row * self.columns + column;
        let [a, b, c, d]: [f64; 4] = [
            self.values[i].into(),
            self.values[i + 1].into(),
            self.values[i + self.columns].into(),
            self.values[i + self.columns + 1].into(),
        ];
        let v = self.value;
        let code = usize::from(a > v) | usize::from(b > v) << 1 | usize::from(c > v) << 2 | usize::from(d > v) << 3;
        // NaN compares as below, so a cell of holes alone ends here too.
        if code != 0 && code != 15 {
            self.segments(code, [a, b, c, d], column as f64, row as f64);
        }
    }

    fn segments(&mut self, code: usize, [a, b, c, d]: [f64; 4], column: f64, row: f64) {
        let sum = (a + b) + (c + d);
        if sum.is_nan() {
            return;
        }
        let v = self.value;
        let bottom = || [(v - a) / (b - a), 0.0];
        let right = || [1.0, (v - b) / (d - b)];
        let top = || [(v - c) / (d - c), 1.0];
        let left = || [0.0, (v - a) / (c - a)];
        let mut segment = |p: [f64; 2], q: [f64; 2]| {
            self.segment([column + p[0], row + p[1]], [column + q[0], row + q[1]]);
        };
        match code {
            1 | 14 => segment(left(), bottom()),
            2 | 13 => segment(bottom(), right()),
            4 | 11 => segment(left(), top()),
            8 | 7 => segment(right(), top()),
            3 | 12 => segment(left(), right()),
            5 | 10 => segment(bottom(), top()),
            // A saddle: the diagonal whose corners are on the side of the mean is joined, the other corners cut off.
            _ => {
                let joined_diagonal_is_rising = (code == 9) == (0.25 * sum > v);
                if joined_diagonal_is_rising {
                    segment(bottom(), right());
                    segment(left(), top());
                } else {
                    segment(left(), bottom());
                    segment(right(), top());
                }
            }
        }
    }

    fn segment(&mut self, p: [f64; 2], q: [f64; 2]) {
        let [mx, my] = self.cell_m;
        let (ax, ay) = ((p[0] - self.point[0]) * mx, (p[1] - self.point[1]) * my);
        let (dx, dy) = ((q[0] - p[0]) * mx, (q[1] - p[1]) * my);
        let length_squared = dx * dx + dy * dy;
        let t = if length_squared > 0.0 { (-(ax * dx + ay * dy) / length_squared).clamp(0.0, 1.0) } else { 0.0 };
        let (ex, ey) = (ax + t * dx, ay + t * dy);
        let squared = ex * ex + ey * ey;
        if squared < self.best_squared {
            self.best_squared = squared;
            self.best = Some([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
        }
    }
}
