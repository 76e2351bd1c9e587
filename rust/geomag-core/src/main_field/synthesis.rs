//! Sums over associated Legendre functions, several places at once.
//!
//! Columns of one order m are summed upwards in degree: `R = P / sin(theta)` for m > 0, which is finite at the poles and gives the
//! derivative without a division. Functions underflow to zero near the poles where they are below 1e-300, which loses
//! nothing: their sums grow by less than 2^n.

use crate::constants::{GEOMAGNETIC_RADIUS_M, WGS84_A_M, WGS84_E2};

/// Places that are evaluated side by side.
pub(super) const LANES: usize = 4;

type DoubleLane = [f64; LANES];

/// Radial, colatitude and longitude components.
pub(super) type FieldSums = [f64; 3];

/// A place in geocentric terms.
pub(super) struct SpherePlace {
    /// Sine and cosine of the geocentric latitude: cosine and sine of the colatitude.
    sin: f64,
    cos: f64,
    longitude: f64,
    /// Reference radius over geocentric radius.
    ratio: f64,
    /// Sine and cosine of geocentric less geodetic latitude.
    tilt: [f64; 2],
}

impl SpherePlace {
    /// Geodetic degrees, metres above WGS84.
    pub(super) fn new(latitude_deg: f64, longitude_deg: f64, height_m: f64) -> Self {
        let (sin, cos) =
            if latitude_deg.abs() == 90.0 { (latitude_deg.signum(), 0.0) } else { latitude_deg.to_radians().sin_cos() };
        let transverse = WGS84_A_M / (1.0 - WGS84_E2 * sin * sin).sqrt();
        let axis = (transverse + height_m) * cos;
        let polar = (transverse * (1.0 - WGS84_E2) + height_m) * sin;
        let radius = axis.hypot(polar);
        let (sin_c, cos_c) = (polar / radius, axis / radius);
        let tilt = [sin_c * cos - cos_c * sin, cos_c * cos + sin_c * sin];
        let ratio = GEOMAGNETIC_RADIUS_M / radius;
        Self { sin: sin_c, cos: cos_c, longitude: longitude_deg.to_radians(), ratio, tilt }
    }

    /// North, east, down at the ellipsoid's normal from radial, colatitude and longitude components.
    pub(super) fn geodetic(&self, [radial, colatitude, longitude]: &FieldSums) -> [f64; 3] {
        let (north, down) = (-colatitude, -radial);
        let [s, c] = self.tilt;
        [north * c - down * s, *longitude, north * s + down * c]
    }
}

/// Factors of the recursion in degree, for all orders: they depend on nothing else.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Recursion {
    degree: usize,
    /// For (m, n), n from max(m, 1): factors of the last function, of the one before it, and the root in the derivative.
    factors: Vec<[f64; 3]>,
    /// Seed of order m over the seed of order m - 1 without its sine.
    seeds: Vec<f64>,
}

impl Recursion {
    pub(super) fn new(degree: usize) -> Self {
        let mut factors = Vec::new();
        for m in 0..=degree {
            for n in m.max(1)..=degree {
                let square = |n: usize| (n * n - m * m) as f64;
                factors.push(if n == m {
                    [0.0; 3]
                } else {
                    let root = square(n).sqrt();
                    let before = if n > m + 1 { square(n - 1).sqrt() / root } else { 0.0 };
                    [(2 * n - 1) as f64 / root, before, root]
                });
            }
        }
        let seeds = (0..=degree).map(|m| if m < 2 { 1.0 } else { ((2 * m - 1) as f64 / (2 * m) as f64).sqrt() });
        Self { degree, factors, seeds: seeds.collect() }
    }

    /// The three sums at every place: coefficients are `share` of the way between two epochs.
    pub(super) fn sums(
        &self,
        places: &[SpherePlace; LANES],
        from: [&[[f64; 2]]; LANES],
        to: [&[[f64; 2]]; LANES],
        share: DoubleLane,
    ) -> [FieldSums; LANES] {
        let lane = |f: &dyn Fn(usize) -> f64| -> DoubleLane { std::array::from_fn(f) };
        let (cos_t, sin_t) = (lane(&|l| places[l].sin), lane(&|l| places[l].cos));
        let ratio = lane(&|l| places[l].ratio);
        let mut powers = vec![[0.0; LANES]; self.degree + 1];
        let mut power = lane(&|l| ratio[l] * ratio[l]);
        for p in &mut powers {
            *p = power;
            power = lane(&|l| power[l] * ratio[l]);
        }
        let mut sums = [[0.0; 3]; LANES];
        // sqrt(n (n + 1) / 2) P_n1 is the derivative of P_n0 but for its sign.
        let mut zonal = vec![[0.0; LANES]; self.degree + 1];
        let mut seed = [1.0; LANES];
        let mut k = 0;
        for m in 0..=self.degree {
            if m >= 2 {
                seed = lane(&|l| seed[l] * self.seeds[m] * sin_t[l]);
            }
            let order = m as f64;
            let turn: [(f64, f64); LANES] = std::array::from_fn(|l| (order * places[l].longitude).sin_cos());
            // Of order 0 the functions themselves, of others the functions over the sine.
            let (mut last, mut before) = if m == 0 { (seed, [0.0; LANES]) } else { ([0.0; LANES], [0.0; LANES]) };
            let [mut radial, mut down_along, mut across] = [[0.0; LANES]; 3];
            for n in m.max(1)..=self.degree {
                let [a, b, root] = self.factors[k];
                let now = if n == m { seed } else { lane(&|l| a * cos_t[l] * last[l] - b * before[l]) };
                let degree = n as f64;
                for l in 0..LANES {
                    let [g0, h0] = from[l][k];
                    let [g1, h1] = to[l][k];
                    let g = g0 + share[l] * (g1 - g0);
                    let h = h0 + share[l] * (h1 - h0);
                    let (s, c) = turn[l];
                    let along = powers[n][l] * (g * c + h * s);
                    if m == 0 {
                        radial[l] += (degree + 1.0) * along * now[l];
                        zonal[n][l] = along;
                    } else {
                        radial[l] += (degree + 1.0) * along * now[l];
                        down_along[l] -= along * (degree * cos_t[l] * now[l] - root * last[l]);
                        across[l] += powers[n][l] * order * (g * s - h * c) * now[l];
                        if m == 1 {
                            down_along[l] += zonal[n][l] * (0.5 * degree * (degree + 1.0)).sqrt() * now[l] * sin_t[l];
                        }
                    }
                }
                before = last;
                last = now;
                k += 1;
            }
            for l in 0..LANES {
                sums[l][0] += if m == 0 { radial[l] } else { radial[l] * sin_t[l] };
                sums[l][1] += down_along[l];
                sums[l][2] += across[l];
            }
        }
        sums
    }
}
