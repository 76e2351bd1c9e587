//! Reading a map between its nodes.

// Only what is inlined into the dispatched function is compiled for its instruction set.
#![allow(clippy::inline_always)]

use serde::{Deserialize, Serialize};

use super::axis::{Axis, NODE_TOLERANCE};
use super::{GridMap, GridValues};
use crate::field::Field;

/// How a map is read between its nodes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Interpolation {
    /// Bilinear: continuous, exact at nodes, gradient steps at cell borders.
    #[default]
    Bilinear,
    /// Cubic convolution (Keys 1981, a = -1/2): continuous gradient, third-order accurate, 4 x 4 nodes.
    Bicubic,
}

impl GridMap {
    /// Value between the nodes; NaN off the map and next to holes.
    pub fn sample(&self, x: f64, y: f64, method: Interpolation) -> f64 {
        self.sample_and_gradient(x, y, method).0
    }

    /// Values between the nodes at many places, as [`GridMap::sample`] gives them, to the bit; several times as fast.
    ///
    /// # Panics
    /// Where there are not as many `x` as `y`.
    pub fn sample_many(&self, x: &[f64], y: &[f64], method: Interpolation) -> Vec<f64> {
        assert_eq!(x.len(), y.len(), "as many x as y");
        let mut out = vec![0.0; x.len()];
        crate::instructions::chosen().dispatch(Places { map: self, x, y, method, out: &mut out });
        out
    }

    /// Value and gradient per metre `[east, north]`; NaN off the map and next to holes.
    pub fn sample_and_gradient(&self, x: f64, y: f64, method: Interpolation) -> (f64, [f64; 2]) {
        let [px, py] = self.position(x, y);
        let (value, [dx, dy]) = self.at_position(px, py, method);
        let [east, north] = self.metres_per_unit(y);
        (value, [dx / (self.x.step() * east), dy / (self.y.step() * north)])
    }

    /// What a map with right nodes cannot say at a place between them, as a standard deviation: half the second difference of the
    /// values times t (1 - t), which is by how much a curve through the nodes leaves the straight line; 0 at the nodes.
    ///
    /// The difference of bilinear and bicubic interpolation, without its zeros where the two happen to agree. It is the same over about a
    /// cell. NaN off the map; 0 beside holes, where nothing is known of it.
    pub fn between_sigma(&self, x: f64, y: f64) -> f64 {
        let [px, py] = self.position(x, y);
        let (Some((ix, tx)), Some((iy, ty))) = (self.x.cell(px), self.y.cell(py)) else { return f64::NAN };
        let bend = |row: usize, column: usize| {
            let (r, c) = (row as isize, column as isize);
            let middle = 2.0 * self.node(row, column);
            let across = self.extended_node(r, c - 1) + self.extended_node(r, c + 1) - middle;
            let up = self.extended_node(r - 1, c) + self.extended_node(r + 1, c) - middle;
            let size = across.abs().max(up.abs());
            if size.is_finite() { size } else { 0.0 }
        };
        let low = (1.0 - tx) * bend(iy, ix) + tx * bend(iy, ix + 1);
        let high = (1.0 - tx) * bend(iy + 1, ix) + tx * bend(iy + 1, ix + 1);
        0.5 * ((1.0 - ty) * low + ty * high) * (tx * (1.0 - tx)).max(ty * (1.0 - ty))
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
        let half_cells = [half_x.abs() / self.x.step(), half_y.abs() / self.y.step()];
        let on_map = |axis: &Axis, p: f64, half: f64| axis.cell(p - half).is_some() && axis.cell(p + half).is_some();
        // Before any cut is listed: a box that leaves the map may be of any size.
        if !(on_map(&self.x, px, half_cells[0]) && on_map(&self.y, py, half_cells[1])) {
            return None;
        }
        let cuts = |p: f64, half: f64| {
            let (low, high) = (p - half, p + half);
            let inner = (low + NODE_TOLERANCE).ceil() as i64..=(high - NODE_TOLERANCE).floor() as i64;
            std::iter::once(low).chain(inner.map(|i| i as f64)).chain(std::iter::once(high)).collect::<Vec<_>>()
        };
        let columns = cuts(px, half_cells[0]);
        let (mut least, mut greatest) = (f64::INFINITY, f64::NEG_INFINITY);
        for r in cuts(py, half_cells[1]) {
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
}

/// Many places of a map, read by the machine's own instructions: rounding alone is a call of a function without them.
struct Places<'a> {
    map: &'a GridMap,
    x: &'a [f64],
    y: &'a [f64],
    method: Interpolation,
    out: &'a mut [f64],
}

impl pulp::WithSimd for Places<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        match &self.map.values {
            GridValues::F32(values) => self.read(|i| f64::from(values[i])),
            GridValues::F64(values) => self.read(|i| values[i]),
        }
    }
}

/// Places that are located at a time, before any node is read: the first loop of [`Places::read`] has no branch and becomes vectors.
const GROUP: usize = 32;

impl Places<'_> {
    #[inline(always)]
    fn read(self, node: impl Fn(usize) -> f64) {
        let map = self.map;
        let (columns, rows) = (map.x.len(), map.y.len());
        let (mut at, mut fractions, mut on_map) = ([[0_u32; GROUP]; 2], [[0.0; GROUP]; 2], [true; GROUP]);
        let groups = self.x.chunks(GROUP).zip(self.y.chunks(GROUP)).zip(self.out.chunks_mut(GROUP));
        for ((x, y), out) in groups {
            on_map.fill(true);
            for (d, (axis, along)) in [(&map.x, x), (&map.y, y)].into_iter().enumerate() {
                let (cells, shares) = (&mut at[d], &mut fractions[d]);
                for (k, &coordinate) in along.iter().enumerate() {
                    let coordinate = if d == 0 { map.wrap_x(coordinate) } else { coordinate };
                    let (cell, share, inside) = axis.cell_or_first(axis.position(coordinate));
                    (cells[k], shares[k], on_map[k]) = (cell, share, on_map[k] & inside);
                }
            }
            for (k, out) in out.iter_mut().enumerate() {
                let [ix, iy] = [0, 1].map(|d: usize| at[d][k] as usize);
                let [tx, ty] = [0, 1].map(|d: usize| fractions[d][k]);
                let value = match self.method {
                    Interpolation::Bilinear => {
                        let low = iy * columns + ix;
                        let high = low + columns;
                        let below = mix(node(low), node(low + 1), tx);
                        mix(below, mix(node(high), node(high + 1), tx), ty)
                    }
                    // Away from borders and from node lines, all sixteen nodes are there and have weights other than zero.
                    Interpolation::Bicubic
                        if tx != 0.0 && ty != 0.0 && ix > 0 && iy > 0 && ix + 2 < columns && iy + 2 < rows =>
                    {
                        let (wx, wy) = (keys_weights(tx).0, keys_weights(ty).0);
                        let first = (iy - 1) * columns + ix - 1;
                        let mut value = 0.0;
                        for (r, wy) in wy.into_iter().enumerate() {
                            let mut row = 0.0;
                            for (c, wx) in wx.into_iter().enumerate() {
                                row += wx * node(first + r * columns + c);
                            }
                            value += wy * row;
                        }
                        value
                    }
                    Interpolation::Bicubic => map.bicubic(ix, iy, tx, ty).0,
                };
                *out = if on_map[k] { value } else { f64::NAN };
            }
        }
    }
}

/// Linear between two nodes. A node of weight zero is not needed: a hole there must not spoil a sample that lies on its neighbour.
#[inline(always)]
fn mix(p: f64, q: f64, t: f64) -> f64 {
    if t == 0.0 {
        p
    } else if t == 1.0 {
        q
    } else {
        (1.0 - t) * p + t * q
    }
}

/// Weights and their derivatives of cubic convolution with a = -1/2 for the nodes -1, 0, 1, 2 at fraction t.
#[inline(always)]
fn keys_weights(t: f64) -> ([f64; 4], [f64; 4]) {
    let (t2, t3) = (t * t, t * t * t);
    (
        [-0.5 * t3 + t2 - 0.5 * t, 1.5 * t3 - 2.5 * t2 + 1.0, -1.5 * t3 + 2.0 * t2 + 0.5 * t, 0.5 * t3 - 0.5 * t2],
        [-1.5 * t2 + 2.0 * t - 0.5, 4.5 * t2 - 5.0 * t, -4.5 * t2 + 4.0 * t + 0.5, 1.5 * t2 - t],
    )
}

#[cfg(test)]
mod tests {
    use crate::grid::{GridMap, GridValues, Interpolation};

    #[test]
    fn many_places_are_read_as_one_is() {
        let axis: Vec<f64> = (0..9).map(|k| 177.0 + 0.75 * f64::from(k)).collect();
        let rows: Vec<f64> = (0..7).map(|k| -2.0 + 0.5 * f64::from(k)).collect();
        let mut values: Vec<f64> = (0..63).map(|k| f64::from(k * k % 17) - 3.0).collect();
        values[40] = f64::NAN;
        let single = GridValues::F32(values.iter().map(|&v| v as f32).collect());
        for values in [GridValues::F64(values), single] {
            let map = GridMap::new(values, &axis, &rows, true).unwrap();
            let (mut x, mut y) = (vec![f64::NAN, 1e30, 177.0, 183.0], vec![0.0, 0.0, 1.0, -2.0]);
            for k in 0..4000 {
                x.push(176.5 + f64::from(k % 131) * 0.05 - if k % 3 == 0 { 360.0 } else { 0.0 });
                y.push(-2.5 + f64::from(k % 97) * 0.125 / 3.0);
            }
            for method in [Interpolation::Bilinear, Interpolation::Bicubic] {
                for (k, value) in map.sample_many(&x, &y, method).into_iter().enumerate() {
                    let one = map.sample(x[k], y[k], method);
                    let same = value.to_bits() == one.to_bits() || (value.is_nan() && one.is_nan());
                    assert!(same, "{} {} {method:?}: {value} {one}", x[k], y[k]);
                }
            }
        }
    }

    #[test]
    fn what_a_map_cannot_say_is_about_the_difference_of_two_interpolations() {
        let axis: Vec<f64> = (0..40).map(f64::from).collect();
        let values =
            axis.iter().flat_map(|y| axis.iter().map(move |x| (0.9 * x).sin() * (0.7 * y + 1.0).cos())).collect();
        let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap();
        let (mut said, mut difference) = (0.0, 0.0);
        for i in 0..2000 {
            let (x, y) = (5.0 + 29.0 * f64::from(i % 61) / 61.0, 5.0 + 29.0 * f64::from(i % 53) / 53.0);
            said += map.between_sigma(x, y).powi(2);
            difference +=
                (map.sample(x, y, Interpolation::Bicubic) - map.sample(x, y, Interpolation::Bilinear)).powi(2);
        }
        assert!(said > 0.4 * difference && said < 2.5 * difference, "{said} {difference}");
        assert_eq!(map.between_sigma(7.0, 9.0), 0.0);
        assert!(map.between_sigma(-1.0, 9.0).is_nan());
    }
}
