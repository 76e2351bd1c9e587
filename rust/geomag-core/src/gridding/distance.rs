//! How far every node is from the data: from the nearest, and from those on either side.

use rayon::prelude::*;

use super::check;
use crate::bounds::require_distance_m;
use crate::error::{Error, Result, require_positive};
use crate::grid::Axis;

/// Distances from the nodes to the data, metres, to within half a cell.
#[derive(Debug, Clone, PartialEq)]
pub struct Distances {
    /// To the nearest datum.
    pub nearest: Vec<f64>,
    /// To the data on either side: the harmonic mean of the distance to the nearest datum and that to the nearest on the other side of the node. In the
    /// middle of a gap it is the distance to either side, next to one of them, and beyond the last datum, twice that to the nearest.
    pub either_side: Vec<f64>,
}

/// Distances in metres from every node to the data.
///
/// What is interpolated between two data errs by less than what is carried on beyond one: of a process of independent steps (Brownian motion) that is known at
/// distances d and e on either side the variance is d e / (d + e). `cell_m` is the cell's size `[east, north]`. The nearest datum is found by the exact
/// Euclidean transform of the occupied nodes (Felzenszwalb and Huttenlocher, Distance transforms of sampled functions, Theory of Computing 8 (2012) 415),
/// the other side among the nearest of the four quadrants, each by one sweep: the nearest that lies more than 120 degrees off the nearest of all.
///
/// # Errors
/// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] for a cell that is no length above zero, [`Error::TooFewSamples`] where no point lies on the grid.
pub fn distances_to_data(x: &[f64], y: &[f64], x_axis: &Axis, y_axis: &Axis, cell_m: [f64; 2]) -> Result<Distances> {
    check(x, y, x)?;
    for (name, size) in [("cell_m east", cell_m[0]), ("cell_m north", cell_m[1])] {
        require_distance_m(name, require_positive(name, size)?)?;
    }
    let (columns, rows) = (x_axis.len(), y_axis.len());
    let mut square = vec![f64::INFINITY; columns * rows];
    let mut used = 0;
    for (x, y) in x.iter().zip(y) {
        let (c, r) = (x_axis.position(*x).round(), y_axis.position(*y).round());
        if c >= 0.0 && r >= 0.0 && c < columns as f64 && r < rows as f64 {
            square[r as usize * columns + c as usize] = 0.0;
            used += 1;
        }
    }
    if used == 0 {
        return Err(Error::TooFewSamples { what: "survey points on the grid".into(), needed: 1, got: 0 });
    }
    let other = other_side(&square, [columns, rows], cell_m);
    transform(&mut square, [columns, rows], cell_m);
    // A datum has no other side, so that two distances that are finite are above zero.
    let mean = |(d, other): (&f64, f64)| {
        let e = other.max(*d);
        if e.is_finite() { 2.0 * d * e / (d + e) } else { 2.0 * d }
    };
    let either_side = square.iter().zip(other).map(mean).collect();
    Ok(Distances { nearest: square, either_side })
}

/// Nodes away, east and north.
type Away = [i32; 2];

/// Distance to the nearest datum on the other side of every node; infinite where there is none and where a datum is. `occupied` is 0 at a datum.
fn other_side(occupied: &[f64], shape: [usize; 2], cell_m: [f64; 2]) -> Vec<f64> {
    let metres = |a: Away| [f64::from(a[0]) * cell_m[0], f64::from(a[1]) * cell_m[1]];
    let quadrants: Vec<Vec<Option<Away>>> = [[1, 1], [-1, 1], [1, -1], [-1, -1]]
        .par_iter()
        .map(|towards| quadrant(occupied, shape, cell_m, *towards))
        .collect();
    let of_node = |i: usize| {
        let near = || quadrants.iter().filter_map(|q| q[i]).map(|a| (metres(a), length(metres(a))));
        let Some((nearest, distance)) = near().min_by(|a, b| a.1.total_cmp(&b.1)).filter(|n| n.1 > 0.0) else {
            return f64::INFINITY;
        };
        let opposite = |(m, d): &([f64; 2], f64)| m[0] * nearest[0] + m[1] * nearest[1] < -0.5 * d * distance;
        near().filter(opposite).map(|(_, d)| d).fold(f64::INFINITY, f64::min)
    };
    (0..occupied.len()).into_par_iter().map(of_node).collect()
}

fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// The nearest datum of every node in the quadrant `towards` (signs east and north), in one sweep away from it: that of one of the three neighbours there.
fn quadrant(occupied: &[f64], [columns, rows]: [usize; 2], cell_m: [f64; 2], towards: Away) -> Vec<Option<Away>> {
    let mut found: Vec<Option<Away>> = vec![None; occupied.len()];
    let order = |count: usize, sign: i32, k: usize| if sign > 0 { count - 1 - k } else { k };
    let neighbour = |at: usize, sign: i32, count: usize| {
        if sign > 0 { Some(at + 1).filter(|n| *n < count) } else { at.checked_sub(1) }
    };
    for r in (0..rows).map(|k| order(rows, towards[1], k)) {
        for c in (0..columns).map(|k| order(columns, towards[0], k)) {
            let i = r * columns + c;
            if occupied[i] == 0.0 {
                found[i] = Some([0, 0]);
                continue;
            }
            let (beside, beyond) = (neighbour(c, towards[0], columns), neighbour(r, towards[1], rows));
            let from = |column: Option<usize>, row: Option<usize>, step: Away| {
                let [x, y] = found[row? * columns + column?]?;
                let away = [x + step[0], y + step[1]];
                Some((away, length([f64::from(away[0]) * cell_m[0], f64::from(away[1]) * cell_m[1]])))
            };
            let some = [
                from(beside, Some(r), [towards[0], 0]),
                from(Some(c), beyond, [0, towards[1]]),
                from(beside, beyond, towards),
            ];
            found[i] = some.into_iter().flatten().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(away, _)| away);
        }
    }
    found
}

/// Distances, from 0 where the datum is and infinity elsewhere.
pub(super) fn transform(square: &mut [f64], [columns, rows]: [usize; 2], cell_m: [f64; 2]) {
    let mut line = vec![0.0; columns.max(rows)];
    for c in 0..columns {
        for r in 0..rows {
            line[r] = square[r * columns + c];
        }
        for (r, v) in envelope(&line[..rows], cell_m[1]).into_iter().enumerate() {
            square[r * columns + c] = v;
        }
    }
    for row in square.chunks_exact_mut(columns) {
        row.copy_from_slice(&envelope(row, cell_m[0]));
    }
    for d in square {
        *d = d.sqrt();
    }
}

/// Lower envelope of the parabolas f(q) + (step (p - q))^2.
fn envelope(f: &[f64], step: f64) -> Vec<f64> {
    let sites: Vec<usize> = (0..f.len()).filter(|&q| f[q].is_finite()).collect();
    if sites.is_empty() {
        return f.to_vec();
    }
    let s2 = step * step;
    let (mut hull, mut from): (Vec<usize>, Vec<f64>) = (Vec::new(), Vec::new());
    for &q in &sites {
        let mut start = f64::NEG_INFINITY;
        while let (Some(&last), Some(&begin)) = (hull.last(), from.last()) {
            let (a, b) = (q as f64, last as f64);
            start = ((f[q] - f[last]) / s2 + a * a - b * b) / (2.0 * (a - b));
            if start > begin {
                break;
            }
            hull.pop();
            from.pop();
            start = f64::NEG_INFINITY;
        }
        hull.push(q);
        from.push(start);
    }
    let mut out = Vec::with_capacity(f.len());
    let mut k = 0;
    for p in 0..f.len() {
        while k + 1 < hull.len() && from[k + 1] < p as f64 {
            k += 1;
        }
        let d = p as f64 - hull[k] as f64;
        out.push(f[hull[k]] + s2 * d * d);
    }
    out
}
