//! From survey points to a grid: minimum curvature, and the distance to the nearest datum.
//!
//! Lines are far apart and densely sampled. A linear interpolation across the gaps doubles every oblique feature, and a
//! matcher then finds the wrong double; the surface of least curvature through the data (Briggs, Machine contouring using minimum
//! curvature, Geophysics 39 (1974) 39; Smith and Wessel, Gridding with continuous curvature splines in tension, Geophysics 55 (1990)
//! 293, here without tension) carries it across.

use crate::error::{Error, Result, require_finite};
use crate::grid::Axis;
use crate::monitor::Monitor;

/// Over-relaxation of the sweeps.
const RELAXATION: f64 = 1.4;
/// Grid steps of the successive levels, in steps of the final grid.
const LEVELS: [usize; 4] = [8, 4, 2, 1];
/// Times that the values at the data's nodes are brought up to date with the gradient, at each level.
const ROUNDS: usize = 4;

/// Surface of least curvature through scattered points, at every node of the grid (row = y ascending, column = x).
///
/// `aspect` is the cell's width over its height in metres. Nodes with data in their own cell take the mean of these, moved to
/// the node along the surface's gradient; all others are relaxed until the surface between them has least curvature
/// (`sweeps` Gauss-Seidel sweeps a round; 100 is plenty). That is a `weight` of infinity; a finite one lets the surface miss
/// its data, so that `weight` times the misses squared and the squared curvature (per cell height) together are least: a
/// smoothing spline. Nodes far from any datum have no meaning; mask them with [`distance_to_data`].
///
/// # Errors
/// [`Error::Invalid`] for a weight that is not above zero;
/// [`Error::Shape`] for unequal lengths, [`Error::NotFinite`], [`Error::TooFewSamples`] where no point lies on the grid,
/// [`Error::Interrupted`].
pub fn minimum_curvature(
    points: [&[f64]; 3],
    x_axis: &Axis,
    y_axis: &Axis,
    aspect: f64,
    weight: f64,
    sweeps: usize,
    monitor: &dyn Monitor,
) -> Result<Vec<f64>> {
    let [x, y, values] = points;
    check(x, y, values)?;
    if weight.is_nan() || weight <= 0.0 {
        return Err(Error::invalid("weight", "a number > 0", weight));
    }
    let mut coarse: Option<(Vec<f64>, usize, usize)> = None;
    for (done, level) in LEVELS.into_iter().enumerate() {
        monitor.advance(done as u64, LEVELS.len() as u64)?;
        let columns = (x_axis.len() - 1).div_ceil(level) + 1;
        let rows = (y_axis.len() - 1).div_ceil(level) + 1;
        let bins = bin(points, x_axis, y_axis, level, columns, rows)?;
        let mut pins = Pins::new(&bins, weight * (level * level) as f64);
        let mut surface = match &coarse {
            None => start(&bins, columns, rows),
            Some((surface, c, r)) => refine(surface, *c, *r, columns, rows),
        };
        for _ in 0..ROUNDS {
            pins.set(&mut surface, &bins, columns, rows);
            for _ in 0..sweeps.div_ceil(ROUNDS) {
                monitor.advance(done as u64, LEVELS.len() as u64)?;
                relax(&mut surface, &pins, columns, rows, aspect);
            }
        }
        pins.set(&mut surface, &bins, columns, rows);
        coarse = Some((surface, columns, rows));
    }
    let (surface, columns, _) = coarse.unwrap_or_default();
    // The last level has the grid's own nodes, possibly one column or row more than the axes.
    Ok((0..y_axis.len()).flat_map(|r| surface[r * columns..r * columns + x_axis.len()].to_vec()).collect())
}

fn check(x: &[f64], y: &[f64], values: &[f64]) -> Result<()> {
    for (name, v) in [("y", y), ("values", values)] {
        if v.len() != x.len() {
            return Err(Error::shape(name, format!("({},) as x", x.len()), format!("({},)", v.len())));
        }
        require_finite(name, v)?;
    }
    require_finite("x", x)
}

/// Count, mean value and mean place within the cell, of the data of each node.
struct Bin {
    count: u32,
    value: f64,
    away: [f64; 2],
}

fn bin(
    [x, y, values]: [&[f64]; 3],
    x_axis: &Axis,
    y_axis: &Axis,
    level: usize,
    columns: usize,
    rows: usize,
) -> Result<Vec<Bin>> {
    let mut bins: Vec<Bin> = (0..columns * rows).map(|_| Bin { count: 0, value: 0.0, away: [0.0; 2] }).collect();
    let mut used = 0;
    for ((x, y), value) in x.iter().zip(y).zip(values) {
        let (px, py) = (x_axis.position(*x) / level as f64, y_axis.position(*y) / level as f64);
        let (c, r) = (px.round(), py.round());
        if c < 0.0 || r < 0.0 || c >= columns as f64 || r >= rows as f64 {
            continue;
        }
        let bin = &mut bins[r as usize * columns + c as usize];
        bin.count += 1;
        bin.value += value;
        bin.away[0] += px - c;
        bin.away[1] += py - r;
        used += 1;
    }
    if used == 0 {
        return Err(Error::TooFewSamples { what: "survey points on the grid".into(), needed: 1, got: 0 });
    }
    for bin in &mut bins {
        let n = f64::from(bin.count.max(1));
        bin.value /= n;
        bin.away = bin.away.map(|a| a / n);
    }
    Ok(bins)
}

/// The nearest datum everywhere, by growing outwards.
fn start(bins: &[Bin], columns: usize, rows: usize) -> Vec<f64> {
    let mut surface: Vec<f64> = bins.iter().map(|b| if b.count > 0 { b.value } else { f64::NAN }).collect();
    let mut front: std::collections::VecDeque<usize> = (0..bins.len()).filter(|&i| bins[i].count > 0).collect();
    while let Some(i) = front.pop_front() {
        let (r, c) = (i / columns, i % columns);
        for (dr, dc) in [(0_i64, 1_i64), (0, -1), (1, 0), (-1, 0)] {
            let (nr, nc) = (r as i64 + dr, c as i64 + dc);
            if nr >= 0 && nc >= 0 && nr < rows as i64 && nc < columns as i64 {
                let j = nr as usize * columns + nc as usize;
                if surface[j].is_nan() {
                    surface[j] = surface[i];
                    front.push_back(j);
                }
            }
        }
    }
    surface
}

/// A coarse surface on a grid twice as fine, bilinearly.
fn refine(coarse: &[f64], c: usize, r: usize, columns: usize, rows: usize) -> Vec<f64> {
    let mut fine = Vec::with_capacity(columns * rows);
    for j in 0..rows {
        let (j0, v) = (j / 2, 0.5 * (j % 2) as f64);
        let (j0, j1) = (j0.min(r - 1), (j0 + 1).min(r - 1));
        for i in 0..columns {
            let (i0, u) = (i / 2, 0.5 * (i % 2) as f64);
            let (i0, i1) = (i0.min(c - 1), (i0 + 1).min(c - 1));
            let low = (1.0 - u) * coarse[j0 * c + i0] + u * coarse[j0 * c + i1];
            let high = (1.0 - u) * coarse[j1 * c + i0] + u * coarse[j1 * c + i1];
            fine.push((1.0 - v) * low + v * high);
        }
    }
    fine
}

/// What holds each node: the weight of its data against the curvature, none where there are no data, and the value that they ask for.
struct Pins {
    weight: Vec<f64>,
    target: Vec<f64>,
}

impl Pins {
    /// `weight` is that of one datum.
    fn new(bins: &[Bin], weight: f64) -> Self {
        let of = |b: &Bin| if b.count > 0 { weight * f64::from(b.count) } else { 0.0 };
        Self { weight: bins.iter().map(of).collect(), target: vec![0.0; bins.len()] }
    }

    /// Brings the targets up to date: the mean of the data, moved to the node along the surface. Data of infinite weight are taken over.
    fn set(&mut self, surface: &mut [f64], bins: &[Bin], columns: usize, rows: usize) {
        let slope = |low: f64, high: f64, cells: usize| if cells > 0 { (high - low) / cells as f64 } else { 0.0 };
        for (i, bin) in bins.iter().enumerate().filter(|(_, bin)| bin.count > 0) {
            let (r, c) = (i / columns, i % columns);
            let (c0, c1) = (c.saturating_sub(1), (c + 1).min(columns - 1));
            let (r0, r1) = (r.saturating_sub(1), (r + 1).min(rows - 1));
            let gx = slope(surface[r * columns + c0], surface[r * columns + c1], c1 - c0);
            let gy = slope(surface[r0 * columns + c], surface[r1 * columns + c], r1 - r0);
            self.target[i] = bin.value - bin.away[0] * gx - bin.away[1] * gy;
        }
        for ((value, weight), target) in surface.iter_mut().zip(&self.weight).zip(&self.target) {
            if weight.is_infinite() {
                *value = *target;
            }
        }
    }
}

fn relax(surface: &mut [f64], pins: &Pins, columns: usize, rows: usize, aspect: f64) {
    let (ax, ay) = (1.0 / (aspect * aspect), 1.0);
    let across = 4.0 * ax * ax + 4.0 * ax * ay;
    let along = 4.0 * ay * ay + 4.0 * ax * ay;
    let centre = 6.0 * ax * ax + 6.0 * ay * ay + 8.0 * ax * ay;
    for r in 0..rows {
        let inner_row = r >= 2 && r + 2 < rows;
        for c in 0..columns {
            let i = r * columns + c;
            let held = pins.weight[i];
            if held.is_infinite() {
                continue;
            }
            let free = if inner_row && c >= 2 && c + 2 < columns {
                let (up, down) = (i + columns, i - columns);
                (across * (surface[i - 1] + surface[i + 1]) + along * (surface[down] + surface[up])
                    - 2.0 * ax * ay * (surface[down - 1] + surface[down + 1] + surface[up - 1] + surface[up + 1])
                    - ax * ax * (surface[i - 2] + surface[i + 2])
                    - ay * ay * (surface[down - columns] + surface[up + columns]))
                    / centre
            } else {
                // The border is soft: harmonic, from the neighbours that there are.
                let (mut sum, mut weight) = (0.0, 0.0);
                let mut add = |v: f64, w: f64| {
                    sum += w * v;
                    weight += w;
                };
                if c > 0 {
                    add(surface[i - 1], ax);
                }
                if c + 1 < columns {
                    add(surface[i + 1], ax);
                }
                if r > 0 {
                    add(surface[i - columns], ay);
                }
                if r + 1 < rows {
                    add(surface[i + columns], ay);
                }
                if weight > 0.0 { sum / weight } else { surface[i] }
            };
            let value = if held > 0.0 { (centre * free + held * pins.target[i]) / (centre + held) } else { free };
            surface[i] += RELAXATION * (value - surface[i]);
        }
    }
}

/// Distance in metres from every node to the nearest datum, to within half a cell.
///
/// `cell_m` is the cell's size `[east, north]`. The exact Euclidean transform of the occupied nodes (Felzenszwalb and
/// Huttenlocher, Distance transforms of sampled functions, Theory of Computing 8 (2012) 415).
///
/// # Errors
/// [`Error::Shape`], [`Error::NotFinite`], [`Error::TooFewSamples`] where no point lies on the grid.
pub fn distance_to_data(x: &[f64], y: &[f64], x_axis: &Axis, y_axis: &Axis, cell_m: [f64; 2]) -> Result<Vec<f64>> {
    check(x, y, x)?;
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
    Ok(square.into_iter().map(f64::sqrt).collect())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::monitor::Quiet;

    #[test]
    fn a_plane_comes_back() {
        let axis = Axis::new(0.0, 1.0, 21).unwrap();
        let (mut x, mut y, mut v) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..60 {
            let (a, b) = (10.0 + 10.0 * (f64::from(k) * 0.7).sin(), 10.0 + 10.0 * (f64::from(k) * 1.3).cos());
            x.push(a);
            y.push(b);
            v.push(3.0 + 0.5 * a - 0.25 * b);
        }
        let surface = minimum_curvature([&x, &y, &v], &axis, &axis, 1.0, f64::INFINITY, 400, &Quiet).unwrap();
        // The border is harmonic where data are wanting, which a sloping plane is not; the further in the nearer.
        let mut worst = [0.0_f64; 2];
        for r in 3..18 {
            for c in 3..18 {
                let truth = 3.0 + 0.5 * c as f64 - 0.25 * r as f64;
                let inner = usize::from((6..15).contains(&r) && (6..15).contains(&c));
                worst[inner] = worst[inner].max((surface[r * 21 + c] - truth).abs());
            }
        }
        assert!(worst[0] < 0.13 && worst[1] < 0.03, "{worst:?}");
    }

    #[test]
    fn the_aspect_says_which_way_the_surface_is_stiff() {
        // Two heights along the middle column and none elsewhere: stretched cells pull the far columns less.
        let axis = Axis::new(0.0, 1.0, 17).unwrap();
        let (x, y, v) = ([8.0, 8.0, 0.0, 16.0], [4.0, 12.0, 8.0, 8.0], [0.0, 0.0, 1.0, 1.0]);
        let at =
            |aspect: f64| minimum_curvature([&x, &y, &v], &axis, &axis, aspect, f64::INFINITY, 4000, &Quiet).unwrap();
        let turned =
            |aspect: f64| minimum_curvature([&y, &x, &v], &axis, &axis, aspect, f64::INFINITY, 4000, &Quiet).unwrap();
        let (wide, tall) = (at(2.0), turned(0.5));
        let mut worst = 0.0_f64;
        for r in 0..17 {
            for c in 0..17 {
                // Wide cells with the axes exchanged are tall ones.
                worst = worst.max((wide[r * 17 + c] - tall[c * 17 + r]).abs());
            }
        }
        assert!(worst < 1e-4, "{worst}");
        let middle = 8 * 17 + 8;
        assert!(wide[middle] < at(1.0)[middle] && at(1.0)[middle] < at(0.5)[middle]);
    }

    #[test]
    fn distances_are_those_of_a_brute_search() {
        let (ax, ay) = (Axis::new(0.0, 1.0, 17).unwrap(), Axis::new(0.0, 1.0, 11).unwrap());
        let x = [2.0, 9.0, 15.0, 4.0];
        let y = [1.0, 8.0, 2.0, 10.0];
        let got = distance_to_data(&x, &y, &ax, &ay, [2.0, 3.0]).unwrap();
        for r in 0..11 {
            for c in 0..17 {
                let best = (0..4)
                    .map(|k| ((c as f64 - x[k]) * 2.0).hypot((r as f64 - y[k]) * 3.0))
                    .fold(f64::INFINITY, f64::min);
                assert!((got[r * 17 + c] - best).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn points_off_the_grid_are_refused() {
        let axis = Axis::new(0.0, 1.0, 5).unwrap();
        assert!(minimum_curvature([&[90.0], &[90.0], &[1.0]], &axis, &axis, 1.0, f64::INFINITY, 10, &Quiet).is_err());
        assert!(distance_to_data(&[90.0], &[90.0], &axis, &axis, [1.0, 1.0]).is_err());
    }
}
