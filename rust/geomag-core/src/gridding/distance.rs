//! How far every node is from the nearest datum.

use super::check;
use crate::bounds::require_distance_m;
use crate::error::{Error, Result, require_positive};
use crate::grid::Axis;

/// Distance in metres from every node to the nearest datum, to within half a cell.
///
/// `cell_m` is the cell's size `[east, north]`. The exact Euclidean transform of the occupied nodes (Felzenszwalb and
/// Huttenlocher, Distance transforms of sampled functions, Theory of Computing 8 (2012) 415).
///
/// # Errors
/// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] for a cell that is no length above zero, [`Error::TooFewSamples`] where no point lies on the grid.
pub fn distance_to_data(x: &[f64], y: &[f64], x_axis: &Axis, y_axis: &Axis, cell_m: [f64; 2]) -> Result<Vec<f64>> {
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
    transform(&mut square, [columns, rows], cell_m);
    Ok(square)
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
