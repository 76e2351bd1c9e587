//! Statistical linearisation: the plane that fits a field best over the whole ellipse of where the vehicle may be.
//!
//! The field is nonlinear in two coordinates alone, so the regression needs a lattice over these two, 5 x 5 Gauss-Hermite points,
//! whatever the number of states. What the plane leaves goes into the noise.
//!
//! Source: Lefebvre, Bruyninckx & De Schutter, IEEE Trans. Automatic Control 47 (2002) 1406 (statistical linear regression);
//! Särkkä, *Bayesian Filtering and Smoothing*, ch. 5 and 6.

/// Abscissae and weights of the Gauss-Hermite rule of order five for a standard normal variable (Abramowitz & Stegun, table 25.10).
const NODES: [(f64, f64); 5] = [
    (-2.856_970_013_872_806, 0.011_257_411_327_720_69),
    (-1.355_626_179_974_265_7, 0.222_075_922_005_612_64),
    (0.0, 0.533_333_333_333_333_3),
    (1.355_626_179_974_265_7, 0.222_075_922_005_612_64),
    (2.856_970_013_872_806, 0.011_257_411_327_720_69),
];
/// Least share of the weight that must lie on the map.
const LEAST_ON_MAP: f64 = 0.7;

/// A plane fitted to a function of two coordinates.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plane {
    /// Mean of the function.
    pub mean: f64,
    /// Slopes.
    pub slope: [f64; 2],
    /// Variance that the plane leaves.
    pub left: f64,
}

/// The plane of `function` over a normal law about zero with this covariance; `None` where too much of it is unknown (NaN).
pub(crate) fn fit(covariance: [[f64; 2]; 2], function: impl Fn([f64; 2]) -> f64) -> Option<Plane> {
    // L L' = C.
    let l00 = covariance[0][0].sqrt();
    let l10 = covariance[1][0] / l00;
    let l11 = (covariance[1][1] - l10 * l10).max(1e-12 * covariance[1][1]).sqrt();
    if !(l00 > 0.0 && l11 > 0.0) {
        return None;
    }
    let (mut weights, mut mean, mut first, mut second) = (0.0, 0.0, [0.0; 2], [[0.0; 2]; 2]);
    let mut values = [(0.0, 0.0, [0.0; 2]); 25];
    let mut known = 0;
    for (a, wa) in NODES {
        for (b, wb) in NODES {
            let value = function([l00 * a, l10 * a + l11 * b]);
            if value.is_nan() {
                continue;
            }
            let w = wa * wb;
            weights += w;
            mean += w * value;
            values[known] = (w, value, [a, b]);
            known += 1;
            for (i, u) in [a, b].into_iter().enumerate() {
                first[i] += w * u;
                for (j, v) in [a, b].into_iter().enumerate() {
                    second[i][j] += w * u * v;
                }
            }
        }
    }
    if weights < LEAST_ON_MAP {
        return None;
    }
    mean /= weights;
    let centre = first.map(|f| f / weights);
    let mut along = [0.0; 2];
    let mut square = 0.0;
    for (w, value, u) in &values[..known] {
        let d = value - mean;
        square += w * d * d;
        for i in 0..2 {
            along[i] += w * d * (u[i] - centre[i]);
        }
    }
    // Moments about the centre of what is known: the unit matrix where all of it is.
    let m = |i: usize, j: usize| second[i][j] / weights - centre[i] * centre[j];
    let (m00, m01, m11) = (m(0, 0), m(0, 1), m(1, 1));
    let determinant = m00 * m11 - m01 * m01;
    if !(determinant > 1e-9) {
        return None;
    }
    let [p, q] = along.map(|a| a / weights);
    let unit = [(m11 * p - m01 * q) / determinant, (m00 * q - m01 * p) / determinant];
    let left = (square / weights - unit[0] * p - unit[1] * q).max(0.0);
    // Slopes per unit of the coordinates: L^-T.
    let slope_1 = unit[1] / l11;
    let slope_0 = (unit[0] - l10 * slope_1) / l00;
    Some(Plane { mean: mean - unit[0] * centre[0] - unit[1] * centre[1], slope: [slope_0, slope_1], left })
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    const C: [[f64; 2]; 2] = [[400.0, 120.0], [120.0, 250.0]];

    #[test]
    fn planes_are_found_exactly() {
        let plane = fit(C, |[x, y]| 7.0 + 0.3 * x - 0.2 * y).unwrap();
        assert_relative_eq!(plane.mean, 7.0, epsilon = 1e-12);
        assert_relative_eq!(plane.slope[0], 0.3, epsilon = 1e-12);
        assert_relative_eq!(plane.slope[1], -0.2, epsilon = 1e-12);
        assert_relative_eq!(plane.left, 0.0, epsilon = 1e-9);
    }

    #[test]
    fn curvature_is_left_over_with_its_own_variance() {
        // For x^2: mean C00, no slope, variance 2 C00^2; the rule is exact to the ninth power.
        let plane = fit(C, |[x, _]| x * x).unwrap();
        assert_relative_eq!(plane.mean, 400.0, max_relative = 1e-12);
        assert_relative_eq!(plane.slope[0], 0.0, epsilon = 1e-9);
        assert_relative_eq!(plane.left, 2.0 * 400.0 * 400.0, max_relative = 1e-12);
        // For x^3 the best plane has slope 3 C00.
        assert_relative_eq!(fit(C, |[x, _]| x * x * x).unwrap().slope[0], 1200.0, max_relative = 1e-12);
    }

    #[test]
    fn a_border_of_the_map_is_no_slope() {
        let cut = |[x, y]: [f64; 2]| if x > 30.0 { f64::NAN } else { 5.0 + 0.1 * y + 0.2 * x };
        let plane = fit(C, cut).unwrap();
        assert_relative_eq!(plane.slope[0], 0.2, epsilon = 1e-9);
        assert_relative_eq!(plane.mean, 5.0, epsilon = 1e-9);
        assert_eq!(fit(C, |[x, _]| if x > -1.0 { f64::NAN } else { 1.0 }), None);
    }
}
