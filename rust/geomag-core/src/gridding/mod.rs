//! From survey points to a grid: minimum curvature, and the distances to the data.
//!
//! Lines are far apart and densely sampled. A linear interpolation across the gaps doubles every oblique feature, and a
//! matcher then finds the wrong double; the surface of least curvature through the data (Briggs, Machine contouring using minimum
//! curvature, Geophysics 39 (1974) 39; Smith and Wessel, Gridding with continuous curvature splines in tension, Geophysics 55 (1990)
//! 293, here without tension) carries it across.

mod distance;
mod relax;

pub use distance::{Distances, distances_to_data};
use relax::Level;

use crate::error::{Error, Result, require_finite};
use crate::grid::Axis;
use crate::monitor::Monitor;

/// Grid steps of the successive levels, in steps of the final grid.
const LEVELS: [usize; 4] = [8, 4, 2, 1];
/// Times that the values at the data's nodes are brought up to date with the gradient, at each level.
const ROUNDS: usize = 4;
/// Narrowest cell, its width over its height: what degrees are next to a pole is not beyond it.
const LEAST_ASPECT: f64 = 1e-6;

/// Surface of least curvature through scattered points, at every node of the grid (row = y ascending, column = x).
///
/// `aspect` is the cell's width over its height in metres. Nodes with data in their own cell take the mean of these, moved to
/// the node along the surface's gradient; all others are relaxed until the surface between them has least curvature
/// (`sweeps` sweeps of over-relaxation a level; 100 are plenty). That is a `weight` of infinity; a finite one lets the surface miss
/// its data, so that `weight` times the misses squared and the squared curvature (per cell height) together are least: a
/// smoothing spline. Nodes far from any datum have no meaning; mask them with [`distances_to_data`]. Those further than `reach`
/// (cell heights) keep what the coarsest level says.
///
/// # Errors
/// [`Error::Invalid`] for an aspect that no cell has, a weight or a reach that is not above zero, or a value that no field has;
/// [`Error::Shape`] for unequal lengths, [`Error::NotFinite`], [`Error::TooFewSamples`] where no point lies on the grid,
/// [`Error::Interrupted`].
#[allow(clippy::too_many_arguments)] // the parts of one equation
pub fn minimum_curvature(
    points: [&[f64]; 3],
    x_axis: &Axis,
    y_axis: &Axis,
    aspect: f64,
    weight: f64,
    reach: f64,
    sweeps: usize,
    monitor: &dyn Monitor,
) -> Result<Vec<f64>> {
    let [x, y, values] = points;
    check(x, y, values)?;
    if !(LEAST_ASPECT..=1.0 / LEAST_ASPECT).contains(&aspect) {
        let needed = format!("a ratio from {LEAST_ASPECT} to {}", 1.0 / LEAST_ASPECT);
        return Err(Error::invalid("aspect", needed, aspect));
    }
    if weight.is_nan() || weight <= 0.0 {
        return Err(Error::invalid("weight", "a number > 0", weight));
    }
    if reach.is_nan() || reach <= 0.0 {
        return Err(Error::invalid("reach", "a number > 0", reach));
    }
    // A node of a level counts as often as its sweep costs.
    let total = LEVELS.iter().map(|level| work(sweeps, *level)).sum();
    let mut done = 0;
    let mut coarse: Option<(Vec<f64>, usize, usize)> = None;
    for level in LEVELS {
        let columns = (x_axis.len() - 1).div_ceil(level) + 1;
        let rows = (y_axis.len() - 1).div_ceil(level) + 1;
        let bins = bin(points, x_axis, y_axis, level, columns, rows)?;
        let surface = match &coarse {
            None => start(&bins, columns, rows),
            Some((surface, c, r)) => refine(surface, *c, *r, columns, rows),
        };
        let near = (coarse.is_some() && reach.is_finite()).then(|| {
            let mut far: Vec<f64> = bins.iter().map(|b| if b.count > 0 { 0.0 } else { f64::INFINITY }).collect();
            distance::transform(&mut far, [columns, rows], [aspect, 1.0]);
            far.into_iter().map(|d| d * level as f64 <= reach).collect::<Vec<bool>>()
        });
        let mut here = Level::new(&bins, [columns, rows], aspect, weight * (level * level) as f64, near.as_deref());
        here.load(&surface);
        let each = sweeps.div_ceil(ROUNDS);
        for _ in 0..ROUNDS {
            here.pin();
            for _ in 0..each {
                monitor.advance(done, total)?;
                here.sweep();
                done += (LEVELS[0] / level).pow(2) as u64;
            }
        }
        here.pin();
        coarse = Some((here.unload(), columns, rows));
    }
    let (surface, columns, _) = coarse.unwrap_or_default();
    // The last level has the grid's own nodes, possibly one column or row more than the axes.
    Ok((0..y_axis.len()).flat_map(|r| surface[r * columns..r * columns + x_axis.len()].to_vec()).collect())
}

/// Share of the work that sweeps of a level are.
fn work(sweeps: usize, level: usize) -> u64 {
    let finest = (LEVELS[0] * LEVELS[0]) as u64;
    (sweeps.div_ceil(ROUNDS) * ROUNDS) as u64 * finest / (level * level) as u64
}

fn check(x: &[f64], y: &[f64], values: &[f64]) -> Result<()> {
    for (name, v) in [("y", y), ("values", values)] {
        if v.len() != x.len() {
            return Err(Error::shape(name, format!("({},) as x", x.len()), format!("({},)", v.len())));
        }
        require_finite(name, v)?;
    }
    crate::bounds::require_values("values", values)?;
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
        let surface =
            minimum_curvature([&x, &y, &v], &axis, &axis, 1.0, f64::INFINITY, f64::INFINITY, 400, &Quiet).unwrap();
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
        let at = |aspect: f64| {
            minimum_curvature([&x, &y, &v], &axis, &axis, aspect, f64::INFINITY, f64::INFINITY, 4000, &Quiet).unwrap()
        };
        let turned = |aspect: f64| {
            minimum_curvature([&y, &x, &v], &axis, &axis, aspect, f64::INFINITY, f64::INFINITY, 4000, &Quiet).unwrap()
        };
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
        let Distances { nearest: got, either_side } = distances_to_data(&x, &y, &ax, &ay, [2.0, 3.0]).unwrap();
        for r in 0..11 {
            for c in 0..17 {
                let best = (0..4)
                    .map(|k| ((c as f64 - x[k]) * 2.0).hypot((r as f64 - y[k]) * 3.0))
                    .fold(f64::INFINITY, f64::min);
                assert!((got[r * 17 + c] - best).abs() < 1e-9);
                assert!((best - 1e-9..=2.0 * best + 1e-9).contains(&either_side[r * 17 + c]));
            }
        }
    }

    #[test]
    fn points_off_the_grid_are_refused() {
        let axis = Axis::new(0.0, 1.0, 5).unwrap();
        assert!(
            minimum_curvature([&[90.0], &[90.0], &[1.0]], &axis, &axis, 1.0, f64::INFINITY, f64::INFINITY, 10, &Quiet)
                .is_err()
        );
        assert!(distances_to_data(&[90.0], &[90.0], &axis, &axis, [1.0, 1.0]).is_err());
    }

    /// Lines at any angle, with data in every node that they pass: between two lines the harmonic mean of the distances to both, beyond the last twice the
    /// distance to it.
    #[test]
    fn data_on_either_side_count_by_their_harmonic_mean() {
        let (n, gap) = (81, 20.0);
        let axis = Axis::new(0.0, 1.0, n).unwrap();
        for degrees in [0.0_f64, 20.0, 45.0, 70.0, 90.0, 130.0] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let at = |along: f64, across: f64| (40.0 + along * cos - across * sin, 40.0 + along * sin + across * cos);
            let (mut x, mut y) = (Vec::new(), Vec::new());
            for k in -400..=400 {
                for across in [-0.5 * gap, 0.5 * gap] {
                    let (px, py) = at(0.25 * f64::from(k), across);
                    x.push(px);
                    y.push(py);
                }
            }
            let got = distances_to_data(&x, &y, &axis, &axis, [30.0, 30.0]).unwrap().either_side;
            for across in [-13.0, -6.0, -3.0, 0.0, 4.0, 7.0, 15.0_f64] {
                let (px, py) = at(0.0, across);
                let node = [px.round(), py.round()];
                // Where the node itself lies.
                let across = -(node[0] - 40.0) * sin + (node[1] - 40.0) * cos;
                let (d, e) = ((across - 0.5 * gap).abs(), (across + 0.5 * gap).abs());
                let wanted = if across.abs() < 0.5 * gap { 2.0 * d * e / (d + e) } else { 2.0 * d.min(e) };
                let is = got[node[1] as usize * n + node[0] as usize] / 30.0;
                assert!((is - wanted).abs() < 1.5, "{degrees} {across} {is} {wanted}");
            }
        }
    }
}
