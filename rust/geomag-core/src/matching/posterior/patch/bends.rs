//! Second differences and the bends of a cubic spline: what curved surfaces through the nodes of a map differ by from the flat ones.

/// Second differences along x.
pub(super) fn second_differences_across(plane: &[f32], columns: usize) -> Vec<f32> {
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
pub(super) fn second_differences_up(plane: &[f32], columns: usize) -> Vec<f32> {
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
pub(super) fn spline_bends(plane: &mut [f32], stride: usize) {
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

pub(super) fn finite_or_zero(value: f32) -> f32 {
    if value.is_finite() { value } else { 0.0 }
}
