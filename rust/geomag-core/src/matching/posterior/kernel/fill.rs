//! The map along the track at every candidate of a block.

use super::super::noise::{ErrorLevel, Interpolant};
use super::super::patch::{
    ACROSS, BEND, Cells, DISTANCE, LIFT, SPLINE_ACROSS, SPLINE_TWIST, SPLINE_UP, TWIST, UP, VALUE, VARIANCE,
};
use super::setup::{EMPTY, KernelScratch, LANES, Lane, Setup};

/// Samples the map along the track at every candidate.
#[inline(always)]
#[allow(clippy::too_many_lines)] // one pass over samples and lanes
pub(super) fn fill<const BOUND: bool>(
    setup: &Setup<'_>,
    offsets: &[[f64; 2]],
    levels: &[ErrorLevel],
    scratch: &mut KernelScratch,
) {
    // Under a bound that stands for all levels the bends in its reach stand for the curves.
    let cubic = setup.cover == 0.0 && levels.iter().any(|l| l.surface != Interpolant::Bilinear);
    let bent = BOUND || levels.iter().any(|l| l.between > 0.0);
    let n = setup.places.len();
    scratch.rows.resize(n, EMPTY);
    let unit = setup.per_unit;
    let [per_east, per_north] = setup.cell_m.map(|m| unit / m);
    let ([blur_x, blur_y], sensor_variance) = (setup.blur_m2, setup.sensor_variance);
    let [half_x, half_y] = setup.half_cells;
    let half = half_x.max(half_y);
    // A surface that bends twice as much as the bilinear one does at its nodes.
    let bends = if cubic { 1.5 } else { 1.0 };
    let cells = Cells::new(offsets);
    for k in 0..n {
        let row = &mut scratch.rows[k];
        let mut spots = setup.patch.locate(setup.places[k], &cells);
        let values = setup.patch.read::<VALUE>(&cells, &mut spots);
        let bend = if bent { setup.patch.read::<BEND>(&cells, &mut spots).mixed(&spots) } else { [0.0; LANES] };
        let value = values.mixed(&spots);
        let [a, b, e, f] = values.0;
        let (u, v) = (spots.u, spots.v);
        let measured = setup.values[k];
        let mut known = [0.0; LANES];
        for l in 0..LANES {
            let residual = (measured - value[l]) * unit;
            let on = residual.is_finite() & (spots.known[l] > 0.0) & (cells.used[l] > 0.0);
            known[l] = if on { 1.0 } else { 0.0 };
            row.residual[l] = if on { residual } else { 0.0 };
        }
        row.known = known;
        let mut extra_variance = [0.0; LANES];
        for l in 0..LANES {
            let (low, high) = (b[l] - a[l], f[l] - e[l]);
            let (left, right) = (e[l] - a[l], f[l] - b[l]);
            let (gx, gy) = (low + v[l] * (high - low), left + u[l] * (right - left));
            let (gx_m, gy_m) = (gx * per_east, gy * per_north);
            let extra = sensor_variance + gx_m * gx_m * blur_x + gy_m * gy_m * blur_y;
            let on = known[l] > 0.0;
            extra_variance[l] = extra;
            let bent = if on { 0.5 * bend[l] * unit } else { 0.0 };
            if BOUND {
                let (least_u, most_u) = off_node_within(u[l], half_x);
                let (least_v, most_v) = off_node_within(v[l], half_y);
                let (least, most) = (bent * least_u.max(least_v), bent * most_u.max(most_v));
                (row.between[l], row.least_between[l]) = (most * most, least * least);
            } else {
                let curved = bent * off_node(u[l]).max(off_node(v[l]));
                row.between[l] = curved * curved;
            }
            row.gradient[0][l] = if on { gx_m } else { 0.0 };
            row.gradient[1][l] = if on { gy_m } else { 0.0 };
            if BOUND {
                let reach = (half_x * gx.abs() + half_y * gy.abs() + (half * bends + setup.cover) * bend[l]) * unit;
                row.reach[l] = if on { reach } else { 0.0 };
            }
        }
        for l in 0..LANES {
            row.extra_variance[l] = if known[l] > 0.0 { extra_variance[l] } else { 1.0 };
        }
        if cubic {
            let across = setup.patch.read::<ACROSS>(&cells, &mut spots).mixed(&spots);
            let up = setup.patch.read::<UP>(&cells, &mut spots).mixed(&spots);
            let twist = setup.patch.read::<TWIST>(&cells, &mut spots).mixed(&spots);
            for l in 0..LANES {
                let (qu, qv) = (0.5 * off_node(u[l]), 0.5 * off_node(v[l]));
                let curve = (qu * qv * twist[l] - qu * across[l] - qv * up[l]) * unit;
                row.curve[l] = if known[l] > 0.0 { curve } else { 0.0 };
            }
            let third = |t: &Lane| t.map(|t| (1.0 + t) * (1.0 / 3.0));
            let (u_third, v_third) = (third(&u), third(&v));
            let across = setup.patch.read::<SPLINE_ACROSS>(&cells, &mut spots).mixed_at(&u_third, &v);
            let up = setup.patch.read::<SPLINE_UP>(&cells, &mut spots).mixed_at(&u, &v_third);
            let twist = setup.patch.read::<SPLINE_TWIST>(&cells, &mut spots).mixed_at(&u_third, &v_third);
            for l in 0..LANES {
                let (qu, qv) = (0.5 * off_node(u[l]), 0.5 * off_node(v[l]));
                let spline = (qu * qv * twist[l] - qu * across[l] - qv * up[l]) * unit;
                row.spline[l] = if known[l] > 0.0 { spline } else { 0.0 };
            }
        } else {
            (row.curve, row.spline) = ([0.0; LANES], [0.0; LANES]);
        }
        if setup.lifts {
            let lift = setup.patch.read::<LIFT>(&cells, &mut spots).mixed(&spots);
            for l in 0..LANES {
                row.lift[l] = if known[l] > 0.0 { lift[l] * unit } else { 0.0 };
            }
        }
        if setup.patch.even {
            let [even_variance, even_distance] = setup.patch.everywhere(setup.places[k]);
            for l in 0..LANES {
                row.map_variance[l] = known[l] * even_variance * unit * unit;
                row.distance[l] = known[l] * even_distance;
            }
        } else {
            let variance = setup.patch.read::<VARIANCE>(&cells, &mut spots).mixed(&spots);
            let distance = setup.patch.read::<DISTANCE>(&cells, &mut spots).mixed(&spots);
            for l in 0..LANES {
                let on = known[l] > 0.0;
                row.map_variance[l] = if on { variance[l] * unit * unit } else { 0.0 };
                row.distance[l] = if on { distance[l] } else { 0.0 };
            }
        }
    }
}

/// How far a place is from the nodes on either side of it: 0 at a node, 1/4 half way.
#[inline(always)]
fn off_node(t: f32) -> f32 {
    t * (1.0 - t)
}

/// The least and the most of that within `half` of a place.
#[inline(always)]
fn off_node_within(t: f32, half: f32) -> (f32, f32) {
    let (below, above) = (off_node(t - half), off_node(t + half));
    let most = if (t - 0.5).abs() <= half { 0.25 } else { below.max(above) };
    (below.min(above).max(0.0), most)
}
