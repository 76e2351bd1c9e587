//! A crustal anomaly field that is known everywhere: fractal plane waves and buried dipoles.

use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

use crate::bounds::{require_distance_m, require_place, require_places, require_spread, require_values};
use crate::error::{Error, Result, require_finite, require_positive};
use crate::field::Field;
use crate::frame::{metres_per_degree, wrap_longitude};
use crate::grid::{Axis, GridMap, GridValues};
use crate::monitor::{Monitor, Quiet};
use crate::state::Saved;
use crate::synthetic::Random;

/// Magnetic constant over four pi, in nT m^3 / (A m^2).
const MU0_OVER_4PI_NT: f64 = 100.0;

/// What a synthetic crust is like.
///
/// Two parts, as in real aeromagnetic maps:
///
/// * a random texture with an isotropic power spectrum `S(k) ~ k^-exponent exp(-2 k h)`, k the radial wavenumber and h
///   the height of the sensor over the top of the sources (power law of a fractal crust: Maus and Dimri 1994, GRL 21, 891,
///   doi 10.1029/94GL00771; attenuation with height: Spector and Grant 1970, Geophysics 35, 293), drawn as plane waves
///   between the shortest and the longest wavelength;
/// * induced dipoles, the steel and the intrusions, with the total-field anomaly of Blakely (1995, *Potential Theory in
///   Gravity and Magnetic Applications*, section 4.3) in a main field of the given inclination and declination.
///
/// Not for: fields that must be harmonic in three dimensions as a whole (the height is a constant here).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CrustSpec {
    /// Mean level, value units (total intensity of the main field; zero for an anomaly).
    pub level: f64,
    /// Slope of the level, value units per metre `[east, north]`.
    pub slope_per_m: [f64; 2],
    /// Standard deviation of the random texture at the sensor, value units.
    pub texture_rms: f64,
    /// Exponent of the two-dimensional power spectrum at the source.
    pub exponent: f64,
    /// Height of the sensor over the sources, metres.
    pub height_m: f64,
    /// Longest wavelength, metres.
    pub longest_m: f64,
    /// Shortest wavelength, metres.
    pub shortest_m: f64,
    /// Number of plane waves.
    pub waves: usize,
    /// Number of dipoles.
    pub dipoles: usize,
    /// Median size of a dipole's anomaly at the sensor, value units; sizes are log-normal about it.
    pub dipole_peak: f64,
    /// Depth of the dipoles under the sensor, metres `[least, greatest]`.
    pub dipole_depth_m: [f64; 2],
    /// Inclination of the main field, degrees downwards.
    pub inclination_deg: f64,
    /// Declination of the main field, degrees east.
    pub declination_deg: f64,
}

impl Default for CrustSpec {
    /// A mid-latitude continental crust seen from 500 m: texture of 80 nT between 1.5 and 60 km, 24 dipoles of about 120 nT.
    fn default() -> Self {
        Self {
            level: 0.0,
            slope_per_m: [0.0, 0.0],
            texture_rms: 80.0,
            exponent: 3.0,
            height_m: 500.0,
            longest_m: 60_000.0,
            shortest_m: 1_500.0,
            waves: 384,
            dipoles: 24,
            dipole_peak: 120.0,
            dipole_depth_m: [700.0, 2_500.0],
            inclination_deg: 60.0,
            declination_deg: 2.0,
        }
    }
}

/// One plane wave of the texture: `amplitude cos(east k_e + north k_n + phase)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct PlaneWave {
    /// Wavenumber `[east, north]`, radians per metre.
    pub k_rad_m: [f64; 2],
    /// Amplitude, value units.
    pub amplitude: f64,
    /// Phase, radians.
    pub phase_rad: f64,
}

/// One dipole, magnetised along the main field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Dipole {
    /// Position `[east, north]` from the field's origin, metres.
    pub position_m: [f64; 2],
    /// Depth under the sensor, metres.
    pub depth_m: f64,
    /// Moment, A m^2; negative where magnetised against the main field.
    pub moment_a_m2: f64,
}

impl PlaneWave {
    fn check(&self) -> Result<()> {
        require_finite("plane wave", &[self.k_rad_m[0], self.k_rad_m[1], self.amplitude, self.phase_rad])
    }
}

impl Dipole {
    fn check(&self) -> Result<()> {
        require_finite("dipole", &[self.position_m[0], self.position_m[1], self.moment_a_m2])?;
        require_positive("dipole depth_m", self.depth_m).map(drop)
    }
}

/// A made-up field that is known at every point, so that a map of it has a true interpolation error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SyntheticField {
    geographic: bool,
    /// `[x least, y least, x greatest, y greatest]`, map units.
    extent: [f64; 4],
    origin: [f64; 2],
    metres_per_unit: [f64; 2],
    level: f64,
    slope_per_m: [f64; 2],
    waves: Vec<PlaneWave>,
    dipoles: Vec<Dipole>,
    /// Unit vector of the main field, `[north, east, down]`.
    main_direction: [f64; 3],
    finest_m: f64,
}

/// Refuses an extent that no field can have.
fn check_extent(extent: [f64; 4], geographic: bool) -> Result<()> {
    require_places("field extent", geographic, &[extent[0], extent[2]], &[extent[1], extent[3]])?;
    if !(extent[2] > extent[0] && extent[3] > extent[1]) {
        return Err(Error::invalid(
            "field extent",
            "[x least, y least, x greatest, y greatest]",
            format!("{extent:?}"),
        ));
    }
    if geographic && (extent[1] < -89.0 || extent[3] > 89.0 || extent[2] - extent[0] > 360.0) {
        return Err(Error::invalid(
            "field extent",
            "latitudes within [-89, 89] and at most one turn of longitude",
            format!("{extent:?}"),
        ));
    }
    Ok(())
}

impl Saved for SyntheticField {
    const NAME: &'static str = "SyntheticField";

    fn check(&self) -> Result<()> {
        check_extent(self.extent, self.geographic)?;
        require_place("field origin", self.geographic, self.origin)?;
        require_positive("metres per unit", self.metres_per_unit[0].min(self.metres_per_unit[1]))?;
        require_finite("field level and slope", &[self.level, self.slope_per_m[0], self.slope_per_m[1]])?;
        require_finite("direction of the main field", &self.main_direction)?;
        require_positive("finest detail", self.finest_m)?;
        self.waves.iter().try_for_each(PlaneWave::check)?;
        self.dipoles.iter().try_for_each(Dipole::check)
    }
}

impl CrustSpec {
    fn check(&self) -> Result<()> {
        require_values("crust level", &[self.level])?;
        require_values("crust slope_per_m", &self.slope_per_m)?;
        require_spread("crust texture_rms", self.texture_rms)?;
        require_finite("crust exponent", &[self.exponent])?;
        require_distance_m("crust height_m", self.height_m)?;
        require_distance_m("crust shortest_m", require_positive("crust shortest_m", self.shortest_m)?)?;
        require_distance_m("crust longest_m", self.longest_m)?;
        if self.longest_m < self.shortest_m {
            return Err(Error::invalid(
                "crust longest_m",
                format!("at least shortest_m = {}", self.shortest_m),
                self.longest_m,
            ));
        }
        if self.waves > 100_000 || self.dipoles > 100_000 {
            return Err(Error::invalid(
                "crust waves and dipoles",
                "at most 100000 of each",
                format!("{} and {}", self.waves, self.dipoles),
            ));
        }
        require_spread("crust dipole_peak", self.dipole_peak)?;
        require_positive("crust dipole_depth_m[0]", self.dipole_depth_m[0])?;
        require_distance_m("crust dipole_depth_m[1]", self.dipole_depth_m[1])?;
        if self.dipole_depth_m[1] < self.dipole_depth_m[0] {
            return Err(Error::invalid(
                "crust dipole_depth_m[1]",
                format!("at least {}", self.dipole_depth_m[0]),
                self.dipole_depth_m[1],
            ));
        }
        if !(-90.0..=90.0).contains(&self.inclination_deg) {
            return Err(Error::invalid("crust inclination_deg", "within [-90, 90]", self.inclination_deg));
        }
        require_finite("crust declination_deg", &[self.declination_deg])
    }

    /// Draws a field over `[x least, y least, x greatest, y greatest]` (map units) from a seed.
    ///
    /// Geographic fields are made on the plane that touches the Earth at the middle of the extent, with the metre scales
    /// of that latitude throughout.
    ///
    /// # Errors
    /// [`Error::Invalid`] or [`Error::NotFinite`] naming the parameter.
    pub fn draw(&self, extent: [f64; 4], geographic: bool, seed: u64) -> Result<SyntheticField> {
        self.check()?;
        check_extent(extent, geographic)?;
        let origin = [0.5 * (extent[0] + extent[2]), 0.5 * (extent[1] + extent[3])];
        let metres_per_unit = if geographic { metres_per_degree(origin[1]) } else { [1.0, 1.0] };
        let (sin_i, cos_i) = sin_cos(self.inclination_deg.to_radians());
        let (sin_d, cos_d) = sin_cos(self.declination_deg.to_radians());
        let half_m =
            [0.5 * (extent[2] - extent[0]) * metres_per_unit[0], 0.5 * (extent[3] - extent[1]) * metres_per_unit[1]];
        let field = SyntheticField {
            geographic,
            extent,
            origin,
            metres_per_unit,
            level: self.level,
            slope_per_m: self.slope_per_m,
            waves: self.draw_waves(&mut Random::stream(seed, 10)),
            dipoles: self.draw_dipoles(half_m, sin_i, &mut Random::stream(seed, 11)),
            main_direction: [cos_i * cos_d, cos_i * sin_d, sin_i],
            finest_m: self.shortest_m,
        };
        // What the numbers of the spectrum make overflow is no field.
        field.waves.iter().try_for_each(PlaneWave::check)?;
        field.dipoles.iter().try_for_each(Dipole::check)?;
        Ok(field)
    }

    /// Plane waves, one in each of `waves` equal steps of log wavenumber, in random directions.
    fn draw_waves(&self, random: &mut Random) -> Vec<PlaneWave> {
        let (low, span) = (libm::log(TAU / self.longest_m), libm::log(self.longest_m / self.shortest_m));
        let mut waves = Vec::with_capacity(self.waves);
        let mut power = 0.0;
        for i in 0..self.waves {
            let log_k = low + span * (i as f64 + random.unit()) / self.waves as f64;
            let k = libm::exp(log_k);
            let (sin, cos) = sin_cos(random.uniform(0.0, TAU));
            // Power in a ring of d(log k): S(k) k dk = S(k) k^2 d(log k).
            let amplitude = libm::exp(0.5 * (2.0 - self.exponent) * log_k - k * self.height_m);
            power += 0.5 * amplitude * amplitude;
            waves.push(PlaneWave { k_rad_m: [k * cos, k * sin], amplitude, phase_rad: random.uniform(0.0, TAU) });
        }
        let gain = if power > 0.0 { self.texture_rms / power.sqrt() } else { 0.0 };
        for wave in &mut waves {
            wave.amplitude *= gain;
        }
        waves
    }

    fn draw_dipoles(&self, half_m: [f64; 2], sin_inclination: f64, random: &mut Random) -> Vec<Dipole> {
        // Anomaly straight above an induced dipole: mu0 / 4 pi m (3 sin^2 I - 1) / d^3; near the magnetic equator the
        // peak lies elsewhere, and the size is held to half the polar one.
        let shape = (3.0 * sin_inclination * sin_inclination - 1.0).abs().max(1.0);
        let [least, greatest] = self.dipole_depth_m;
        (0..self.dipoles)
            .map(|_| {
                let position_m = [random.uniform(-half_m[0], half_m[0]), random.uniform(-half_m[1], half_m[1])];
                let depth_m = random.uniform(least, greatest);
                let sign = if random.unit() < 0.75 { 1.0 } else { -1.0 };
                let peak = sign * self.dipole_peak * libm::exp(0.5 * random.normal());
                let moment_a_m2 = peak * depth_m * depth_m * depth_m / (MU0_OVER_4PI_NT * shape);
                Dipole { position_m, depth_m, moment_a_m2 }
            })
            .collect()
    }
}

fn sin_cos(angle_rad: f64) -> (f64, f64) {
    (libm::sin(angle_rad), libm::cos(angle_rad))
}

impl SyntheticField {
    /// `[x least, y least, x greatest, y greatest]`, map units.
    pub fn extent(&self) -> [f64; 4] {
        self.extent
    }

    /// The plane waves of the texture.
    pub fn waves(&self) -> &[PlaneWave] {
        &self.waves
    }

    /// The dipoles.
    pub fn dipoles(&self) -> &[Dipole] {
        &self.dipoles
    }

    /// Metres `[east, north]` from the field's origin.
    fn local(&self, x: f64, y: f64) -> [f64; 2] {
        [(self.wrap_x(x) - self.origin[0]) * self.metres_per_unit[0], (y - self.origin[1]) * self.metres_per_unit[1]]
    }

    /// Anomaly of all dipoles and its gradient `[east, north]` at local metres.
    fn dipole_part(&self, east: f64, north: f64) -> (f64, [f64; 2]) {
        let [fn_, fe, fd] = self.main_direction;
        let (mut value, mut along_east, mut along_north) = (0.0, 0.0, 0.0);
        for d in &self.dipoles {
            // From the dipole to the sensor: north, east, down (the sensor is above, so down is negative).
            let (rn, re, rd) = (north - d.position_m[1], east - d.position_m[0], -d.depth_m);
            let r2 = rn * rn + re * re + rd * rd;
            let r5 = r2 * r2 * r2.sqrt();
            let dot = fn_ * rn + fe * re + fd * rd;
            let gain = MU0_OVER_4PI_NT * d.moment_a_m2 / r5;
            value += gain * (3.0 * dot * dot - r2);
            along_east += gain * (6.0 * dot * fe - 2.0 * re - 5.0 * re * (3.0 * dot * dot - r2) / r2);
            along_north += gain * (6.0 * dot * fn_ - 2.0 * rn - 5.0 * rn * (3.0 * dot * dot - r2) / r2);
        }
        (value, [along_east, along_north])
    }

    fn smooth_part(&self, east: f64, north: f64) -> f64 {
        self.level + self.slope_per_m[0] * east + self.slope_per_m[1] * north
    }

    /// A map of the field: its exact values at the nodes of two axes, float64.
    ///
    /// # Errors
    /// [`Error::TooManyCandidates`] over 2^28 nodes, and what [`GridMap`] refuses.
    pub fn grid(&self, x: Axis, y: Axis) -> Result<GridMap> {
        self.grid_monitored(x, y, &Quiet)
    }

    /// [`SyntheticField::grid`] that can be watched and stopped.
    ///
    /// # Errors
    /// As [`SyntheticField::grid`], and [`Error::Interrupted`].
    pub fn grid_monitored(&self, x: Axis, y: Axis, monitor: &dyn Monitor) -> Result<GridMap> {
        const MAX_NODES: u64 = 1 << 28;
        let needed = x.len() as u128 * y.len() as u128;
        if needed > u128::from(MAX_NODES) {
            return Err(Error::TooManyCandidates { what: "synthetic map".into(), needed, limit: MAX_NODES });
        }
        let (columns, rows) = (x.len(), y.len());
        let mut values = Vec::with_capacity(columns * rows);
        // A wave costs a row a tenth of what a dipole does.
        let (dipole_rows, wave_rows) = ((10 * self.dipoles.len() + 1) as u64, self.waves.len() as u64);
        let total = (rows as u64).saturating_mul(dipole_rows + wave_rows);
        for row in 0..rows {
            monitor.advance(row as u64 * dipole_rows, total)?;
            for column in 0..columns {
                let [east, north] = self.local(x.at(column), y.at(row));
                values.push(self.smooth_part(east, north) + self.dipole_part(east, north).0);
            }
        }
        // cos(a + b) = cos a cos b - sin a sin b makes each wave a sum of two outer products: no trigonometry a node.
        for (number, wave) in self.waves.iter().enumerate() {
            monitor.advance(rows as u64 * (dipole_rows + number as u64), total)?;
            let along_x: Vec<(f64, f64)> = (0..columns)
                .map(|c| {
                    let (sin, cos) = sin_cos(wave.k_rad_m[0] * self.local(x.at(c), y.at(0))[0] + wave.phase_rad);
                    (wave.amplitude * sin, wave.amplitude * cos)
                })
                .collect();
            for (row, line) in values.chunks_exact_mut(columns).enumerate() {
                let (sin, cos) = sin_cos(wave.k_rad_m[1] * self.local(x.at(0), y.at(row))[1]);
                for (value, &(sin_x, cos_x)) in line.iter_mut().zip(&along_x) {
                    *value += cos_x * cos - sin_x * sin;
                }
            }
        }
        GridMap::from_axes(GridValues::F64(values), x, y, self.geographic)
    }

    /// A map of the whole extent with nodes every `step` map units in both directions.
    ///
    /// # Errors
    /// As [`SyntheticField::grid`], and [`Error::Invalid`] for a step that is not positive or exceeds the extent.
    pub fn grid_by_step(&self, step: f64) -> Result<GridMap> {
        let [x, y] = self.axes_by_step(step)?;
        self.grid(x, y)
    }

    /// Axes `[x, y]` over the whole extent with nodes every `step` map units.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a step that is not positive or exceeds the extent.
    pub fn axes_by_step(&self, step: f64) -> Result<[Axis; 2]> {
        require_positive("map step", step)?;
        let axis = |low: f64, high: f64| {
            let cells = ((high - low) / step * (1.0 + 1e-12)).floor();
            if cells < 1.0 {
                return Err(Error::invalid("map step", format!("at most the extent, {}", high - low), step));
            }
            Axis::new(low, step, (cells as usize).saturating_add(1))
        };
        Ok([axis(self.extent[0], self.extent[2])?, axis(self.extent[1], self.extent[3])?])
    }
}

impl Field for SyntheticField {
    fn value(&self, x: f64, y: f64) -> f64 {
        self.value_and_gradient(x, y).0
    }

    fn value_and_gradient(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let wrapped = self.wrap_x(x);
        let inside =
            (self.extent[0]..=self.extent[2]).contains(&wrapped) && (self.extent[1]..=self.extent[3]).contains(&y);
        if !inside {
            return (f64::NAN, [f64::NAN; 2]);
        }
        let [east, north] = self.local(x, y);
        let (mut value, mut gradient) = self.dipole_part(east, north);
        value += self.smooth_part(east, north);
        gradient[0] += self.slope_per_m[0];
        gradient[1] += self.slope_per_m[1];
        for wave in &self.waves {
            let (sin, cos) = sin_cos(wave.k_rad_m[0] * east + wave.k_rad_m[1] * north + wave.phase_rad);
            value += wave.amplitude * cos;
            gradient[0] -= wave.amplitude * wave.k_rad_m[0] * sin;
            gradient[1] -= wave.amplitude * wave.k_rad_m[1] * sin;
        }
        (value, gradient)
    }

    fn geographic(&self) -> bool {
        self.geographic
    }

    fn wrap_x(&self, x: f64) -> f64 {
        if self.geographic { wrap_longitude(x, self.origin[0]) } else { x }
    }

    fn spacing(&self) -> [f64; 2] {
        [0.25 * self.finest_m / self.metres_per_unit[0], 0.25 * self.finest_m / self.metres_per_unit[1]]
    }

    fn mean(&self) -> f64 {
        self.level
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    const EXTENT: [f64; 4] = [0.0, 0.0, 80_000.0, 60_000.0];

    #[test]
    fn grid_equals_the_field_at_its_nodes() {
        for (extent, geographic, step) in [(EXTENT, false, 2_000.0), ([-3.0, 54.0, -2.0, 54.5], true, 0.02)] {
            let spec = CrustSpec { level: 48_000.0, slope_per_m: [1e-3, -2e-3], ..CrustSpec::default() };
            let field = spec.draw(extent, geographic, 3).unwrap();
            let map = field.grid_by_step(step).unwrap();
            for (row, column) in [(0, 0), (5, 7), (map.y().len() - 1, map.x().len() - 1)] {
                let (x, y) = (map.x().at(column).min(extent[2]), map.y().at(row).min(extent[3]));
                assert_relative_eq!(map.node(row, column), field.value(x, y), epsilon = 1e-8);
            }
        }
    }

    #[test]
    fn gradient_equals_differences() {
        let field = CrustSpec::default().draw(EXTENT, false, 4).unwrap();
        for (x, y) in [(10_000.0, 20_000.0), (41_234.5, 3_210.0)] {
            let (_, [east, north]) = field.value_and_gradient(x, y);
            assert_relative_eq!(east, (field.value(x + 1.0, y) - field.value(x - 1.0, y)) / 2.0, epsilon = 1e-6);
            assert_relative_eq!(north, (field.value(x, y + 1.0) - field.value(x, y - 1.0)) / 2.0, epsilon = 1e-6);
        }
    }

    #[test]
    fn texture_has_the_declared_size() {
        let spec = CrustSpec { dipoles: 0, longest_m: 10_000.0, ..CrustSpec::default() };
        let map = spec.draw([0.0, 0.0, 200_000.0, 200_000.0], false, 5).unwrap().grid_by_step(1_000.0).unwrap();
        let mean = map.mean();
        let n = map.values().len();
        let rms = ((0..n).map(|i| (map.values().get(i) - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
        assert_relative_eq!(rms, spec.texture_rms, max_relative = 0.05);
    }

    #[test]
    fn a_lone_polar_dipole_has_its_textbook_anomaly() {
        let spec = CrustSpec { waves: 0, dipoles: 1, inclination_deg: 90.0, ..CrustSpec::default() };
        let field = spec.draw(EXTENT, false, 6).unwrap();
        let d = field.dipoles()[0];
        let above = field.value(d.position_m[0] + 40_000.0, d.position_m[1] + 30_000.0);
        assert_relative_eq!(above, 2.0 * 100.0 * d.moment_a_m2 / d.depth_m.powi(3), max_relative = 1e-12);
        // A vertical dipole's anomaly vanishes where the distance is sqrt(2) times the depth.
        let at_zero = field.value(d.position_m[0] + 40_000.0 - 2.0_f64.sqrt() * d.depth_m, d.position_m[1] + 30_000.0);
        assert!(at_zero.abs() < 1e-9 * above.abs());
    }

    #[test]
    fn bad_parameters_are_refused() {
        let bad = [
            CrustSpec { shortest_m: 0.0, ..CrustSpec::default() },
            CrustSpec { longest_m: 10.0, ..CrustSpec::default() },
            CrustSpec { texture_rms: f64::NAN, ..CrustSpec::default() },
            CrustSpec { waves: 1 << 40, ..CrustSpec::default() },
            CrustSpec { dipole_depth_m: [10.0, 5.0], ..CrustSpec::default() },
            CrustSpec { inclination_deg: 91.0, ..CrustSpec::default() },
        ];
        for spec in bad {
            assert!(spec.draw(EXTENT, false, 0).is_err(), "{spec:?}");
        }
        assert!(CrustSpec::default().draw([0.0, 0.0, -1.0, 1.0], false, 0).is_err());
        assert!(CrustSpec::default().draw([0.0, 80.0, 1.0, 95.0], true, 0).is_err());
        let field = CrustSpec::default().draw(EXTENT, false, 0).unwrap();
        assert!(field.grid_by_step(1e-3).is_err());
        assert!(field.grid_by_step(1e6).is_err());
    }
}
