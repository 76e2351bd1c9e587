//! Where things are on the Earth: metre scales of geographic coordinates, and local Cartesian frames.
//!
//! Geographic maps are searched in degrees and judged in metres. The conversion is local: the radii of curvature of
//! WGS84 at the latitude in question (Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation
//! Systems*, eq. 2.105 and 2.106), at height zero.

use serde::{Deserialize, Serialize};

use crate::bounds::{FARTHEST_M, MOST_LONGITUDE_DEG};
use crate::constants::{WGS84_A_M, WGS84_E2};
use crate::error::{Error, Result};

/// Metres per degree of longitude and of latitude, `[east, north]`, on WGS84 at height zero.
///
/// ```
/// let [east, north] = geomag_core::frame::metres_per_degree(0.0);
/// assert!((east - 111_319.49).abs() < 0.01);
/// assert!((north - 110_574.28).abs() < 0.01);
/// ```
pub fn metres_per_degree(latitude_deg: f64) -> [f64; 2] {
    let latitude = latitude_deg.to_radians();
    // Not the platform's sine: seeded fields and tracks have the same bits on every machine.
    let (sin, cos) = (libm::sin(latitude), libm::cos(latitude));
    let root = (1.0 - WGS84_E2 * sin * sin).sqrt();
    let transverse = WGS84_A_M / root;
    let meridional = WGS84_A_M * (1.0 - WGS84_E2) / (root * root * root);
    [(transverse * cos).to_radians(), meridional.to_radians()]
}

/// Brings a longitude into the turn around `centre_deg`: `[centre - 180, centre + 180)`; NaN where it is no longitude
/// ([`MOST_LONGITUDE_DEG`]), for what is left of a huge number after so many turns is noise.
///
/// ```
/// assert_eq!(geomag_core::frame::wrap_longitude(-179.0, 180.0), 181.0);
/// assert_eq!(geomag_core::frame::wrap_longitude(20.0, 15.0), 20.0);
/// ```
#[inline]
pub fn wrap_longitude(longitude_deg: f64, centre_deg: f64) -> f64 {
    let away = longitude_deg - centre_deg;
    if (-180.0..180.0).contains(&away) {
        longitude_deg
    } else if longitude_deg.abs() <= MOST_LONGITUDE_DEG {
        longitude_deg - 360.0 * ((away + 180.0) / 360.0).floor()
    } else {
        f64::NAN
    }
}

/// Displacement from one point to another in metres `[east, north]`.
///
/// On geographic coordinates the scale of the mean latitude is used, which is right to second order in the distance
/// (below 1e-6 relative for tens of kilometres away from the poles).
pub fn displacement_m(geographic: bool, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
    if !geographic {
        return [to[0] - from[0], to[1] - from[1]];
    }
    let [east, north] = metres_per_degree(0.5 * (from[1] + to[1]));
    [(wrap_longitude(to[0], from[0]) - from[0]) * east, (to[1] - from[1]) * north]
}

/// The figure of the Earth that geographic coordinates refer to.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Earth {
    /// The WGS84 ellipsoid: geodetic latitude, height above the ellipsoid.
    #[default]
    Wgs84,
    /// A sphere: geocentric latitude, height above its surface.
    Sphere {
        /// Radius, metres.
        radius_m: f64,
    },
}

impl Earth {
    /// Equatorial radius (metres) and first eccentricity squared.
    const fn shape(self) -> (f64, f64) {
        match self {
            Self::Wgs84 => (WGS84_A_M, WGS84_E2),
            Self::Sphere { radius_m } => (radius_m, 0.0),
        }
    }
}

/// A local Cartesian frame: origin at a geographic point, axes north, east, down there, metres.
///
/// Heights are along the normal of the [`Earth`] figure. On the sphere the coordinates are those of Zhao et al. (2012)
/// with their nested sines mended, `x = r sin(phi) cos(alpha)`, `y = -r sin(phi) sin(alpha)`, `z = R - r cos(phi)`; here
/// they are reached through differences of Cartesian coordinates, which needs no choice of sign, is exact at the origin
/// and loses no digits near it.
///
/// ```
/// use geomag_core::frame::{Earth, LocalFrame};
/// let frame = LocalFrame::new(33.0, 118.0, 0.0, Earth::Wgs84)?;
/// let [north, east, down] = frame.forward(34.0, 118.0, 0.0);
/// assert!((north - 110_908.6).abs() < 1.0 && east == 0.0 && (down - 967.8).abs() < 1.0);
/// let [latitude, longitude, height] = frame.inverse([north, east, down]);
/// assert!((latitude - 34.0).abs() < 1e-13 && longitude == 118.0 && height.abs() < 1e-8);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "FrameState", into = "FrameState")]
pub struct LocalFrame {
    latitude_deg: f64,
    longitude_deg: f64,
    height_m: f64,
    earth: Earth,
    sin: f64,
    cos: f64,
}

#[derive(Serialize, Deserialize)]
struct FrameState {
    latitude_deg: f64,
    longitude_deg: f64,
    height_m: f64,
    earth: Earth,
}

impl TryFrom<FrameState> for LocalFrame {
    type Error = Error;

    fn try_from(s: FrameState) -> Result<Self> {
        Self::new(s.latitude_deg, s.longitude_deg, s.height_m, s.earth)
    }
}

impl From<LocalFrame> for FrameState {
    fn from(f: LocalFrame) -> Self {
        Self { latitude_deg: f.latitude_deg, longitude_deg: f.longitude_deg, height_m: f.height_m, earth: f.earth }
    }
}

impl LocalFrame {
    /// A frame with its origin at a geographic point: degrees, metres above the figure.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; [`Error::Invalid`] for a latitude beyond a pole, a sphere without a positive radius or an
    /// origin that is not above the centre of the Earth.
    pub fn new(latitude_deg: f64, longitude_deg: f64, height_m: f64, earth: Earth) -> Result<Self> {
        crate::error::require_finite("frame origin", &[latitude_deg, longitude_deg])?;
        crate::bounds::require_heights("frame origin height_m", &[height_m])?;
        if latitude_deg.abs() > 90.0 {
            return Err(Error::invalid("frame latitude_deg", "a latitude in [-90, 90] degrees", latitude_deg));
        }
        let (radius, e2) = earth.shape();
        crate::error::require_positive("sphere radius_m", radius)?;
        if height_m > FARTHEST_M || radius > FARTHEST_M {
            let needed = format!("heights and radii within {FARTHEST_M} m");
            return Err(Error::invalid("frame", needed, format!("{height_m} above {radius}")));
        }
        // The normals of an ellipsoid cross within a (1 - e^2) of the centre: below that, coordinates are not unique.
        if height_m <= -radius * (1.0 - e2) * 0.9 {
            return Err(Error::invalid("frame height_m", "an origin well above the Earth's centre", height_m));
        }
        let (sin, cos) = sin_cos_deg(latitude_deg);
        Ok(Self { latitude_deg, longitude_deg, height_m, earth, sin, cos })
    }

    /// Latitude of the origin, degrees.
    pub fn latitude_deg(&self) -> f64 {
        self.latitude_deg
    }

    /// Longitude of the origin, degrees.
    pub fn longitude_deg(&self) -> f64 {
        self.longitude_deg
    }

    /// Height of the origin, metres.
    pub fn height_m(&self) -> f64 {
        self.height_m
    }

    /// The figure of the Earth.
    pub fn earth(&self) -> Earth {
        self.earth
    }

    /// North, east, down in metres of a geographic point (degrees, degrees, metres). NaN gives NaN, and so does a
    /// latitude beyond a pole.
    ///
    /// Written with differences of sines and of radii of curvature, so that the rounding is that of the distance and
    /// not that of the Earth's radius.
    pub fn forward(&self, latitude_deg: f64, longitude_deg: f64, height_m: f64) -> [f64; 3] {
        if latitude_deg.abs() > 90.0 {
            return [f64::NAN; 3];
        }
        self.forward_of(latitude_deg, longitude_deg, height_m)
    }

    /// [`LocalFrame::forward`] by the formula alone: on the way to an inverse a latitude may step over a pole.
    fn forward_of(&self, latitude_deg: f64, longitude_deg: f64, height_m: f64) -> [f64; 3] {
        let (a, e2) = self.earth.shape();
        let (sin, cos) = sin_cos_deg(latitude_deg);
        let half_latitude = (0.5 * (latitude_deg - self.latitude_deg)).to_radians();
        let middle = (0.5 * (latitude_deg + self.latitude_deg)).to_radians();
        let sin_difference = 2.0 * middle.cos() * half_latitude.sin();
        let cos_difference = -2.0 * middle.sin() * half_latitude.sin();
        let turn = wrap_longitude(longitude_deg, self.longitude_deg) - self.longitude_deg;
        let (turn_sin, _) = sin_cos_deg(turn);
        let half_turn = (0.5 * turn).to_radians().sin();
        let versine = 2.0 * half_turn * half_turn;

        let (root, root_0) = ((1.0 - e2 * sin * sin).sqrt(), (1.0 - e2 * self.sin * self.sin).sqrt());
        let (transverse, transverse_0) = (a / root, a / root_0);
        let transverse_difference = a * e2 * sin_difference * (sin + self.sin) / (root * root_0 * (root + root_0));
        // Distance from the axis and height above the equatorial plane: the point's, and point minus origin.
        let axis = (transverse + height_m) * cos;
        let axis_difference = transverse_difference * cos
            + transverse_0 * cos_difference
            + (height_m - self.height_m) * cos
            + self.height_m * cos_difference;
        let polar_difference = (1.0 - e2) * (transverse_difference * sin + transverse_0 * sin_difference)
            + (height_m - self.height_m) * sin
            + self.height_m * sin_difference;
        // Towards the origin's meridian, less what the turn takes away.
        let outward = axis_difference - axis * versine;
        [
            self.cos * polar_difference - self.sin * outward,
            axis * turn_sin,
            -(self.cos * outward + self.sin * polar_difference),
        ]
    }

    /// Latitude, longitude (degrees, on the turn around the origin) and height (metres) of a point of the frame.
    ///
    /// Bowring's formula (1985) and Newton steps on [`LocalFrame::forward`]: the two are inverse to each other to within
    /// the rounding of the degrees themselves (about a nanometre). NaN gives NaN.
    pub fn inverse(&self, point_m: [f64; 3]) -> [f64; 3] {
        let (a, e2) = self.earth.shape();
        let root_0 = (1.0 - e2 * self.sin * self.sin).sqrt();
        let outward = -self.sin * point_m[0] - self.cos * point_m[2];
        let axis_0 = (a / root_0 + self.height_m) * self.cos + outward;
        let polar =
            (a / root_0 * (1.0 - e2) + self.height_m) * self.sin + self.cos * point_m[0] - self.sin * point_m[2];
        let axis = axis_0.hypot(point_m[1]);
        let b = a * (1.0 - e2).sqrt();
        let radius = axis.hypot(polar);
        let parametric = (b * polar * (1.0 + e2 / (1.0 - e2) * b / radius)).atan2(a * axis);
        let (sin_u, cos_u) = parametric.sin_cos();
        let mut latitude = (polar + e2 / (1.0 - e2) * b * sin_u.powi(3)).atan2(axis - e2 * a * cos_u.powi(3));
        let mut longitude = self.longitude_deg + point_m[1].atan2(axis_0).to_degrees();
        let (sin, cos) = latitude.sin_cos();
        let mut height = axis * cos + polar * sin - a * (1.0 - e2 * sin * sin).sqrt();
        latitude = latitude.to_degrees();
        for _ in 0..2 {
            let found = self.forward_of(latitude, longitude, height);
            let miss = [point_m[0] - found[0], point_m[1] - found[1], point_m[2] - found[2]];
            let [north, east, down] = self.from_origin(latitude, longitude, miss);
            let (sin, cos) = sin_cos_deg(latitude);
            let root = (1.0 - e2 * sin * sin).sqrt();
            latitude = (latitude + (north / (a * (1.0 - e2) / root.powi(3) + height)).to_degrees()).clamp(-90.0, 90.0);
            let parallel = (a / root + height) * cos;
            // Within a metre of a pole the longitude of atan2 is as good as any.
            if parallel > 1.0 {
                longitude += (east / parallel).to_degrees();
            }
            height -= down;
        }
        [latitude, longitude, height]
    }

    /// Turns a vector given north-east-down at its own point into north-east-down at the origin. Lengths are kept.
    pub fn rotate_to_origin(&self, latitude_deg: f64, longitude_deg: f64, vector: [f64; 3]) -> [f64; 3] {
        let m = self.rotation(latitude_deg, longitude_deg);
        std::array::from_fn(|i| m[i][0] * vector[0] + m[i][1] * vector[1] + m[i][2] * vector[2])
    }

    /// Turns a vector given north-east-down at the origin into north-east-down at a point of its own.
    pub fn rotate_from_origin(&self, latitude_deg: f64, longitude_deg: f64, vector: [f64; 3]) -> [f64; 3] {
        self.from_origin(latitude_deg, longitude_deg, vector)
    }

    #[allow(clippy::wrong_self_convention)] // "from" is the direction of the rotation
    fn from_origin(&self, latitude_deg: f64, longitude_deg: f64, vector: [f64; 3]) -> [f64; 3] {
        let m = self.rotation(latitude_deg, longitude_deg);
        std::array::from_fn(|i| m[0][i] * vector[0] + m[1][i] * vector[1] + m[2][i] * vector[2])
    }

    /// Rows: north, east, down of the origin; columns: north, east, down of the point. Product of the two rotations to
    /// Earth-centred axes, in which only the difference of longitudes is left.
    fn rotation(&self, latitude_deg: f64, longitude_deg: f64) -> [[f64; 3]; 3] {
        let (s, c) = sin_cos_deg(latitude_deg);
        let (s0, c0) = (self.sin, self.cos);
        let (sl, cl) = sin_cos_deg(longitude_deg - self.longitude_deg);
        [
            [s0 * s * cl + c0 * c, s0 * sl, s0 * c * cl - c0 * s],
            [-s * sl, cl, -c * sl],
            [c0 * s * cl - s0 * c, c0 * sl, c0 * c * cl + s0 * s],
        ]
    }
}

/// Sine and cosine of degrees, exact at multiples of a right angle.
fn sin_cos_deg(degrees: f64) -> (f64, f64) {
    let quarter = (degrees / 90.0).round();
    let (s, c) = (degrees - 90.0 * quarter).to_radians().sin_cos();
    match quarter.rem_euclid(4.0) as i32 {
        0 => (s, c),
        1 => (c, -s),
        2 => (-s, -c),
        _ => (-c, s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> impl Iterator<Item = (f64, f64, f64)> {
        let latitudes = [-90.0, -89.999, -45.0, -0.001, 0.0, 12.3, 33.25, 54.8, 89.9, 90.0];
        let longitudes = [-180.0, -90.0, -0.1, 0.0, 61.7, 118.0, 179.9];
        let heights = [-5000.0, 0.0, 10_000.0, 400_000.0];
        latitudes
            .into_iter()
            .flat_map(move |a| longitudes.into_iter().flat_map(move |b| heights.into_iter().map(move |h| (a, b, h))))
    }

    #[test]
    fn round_trips_to_nanometres() {
        for earth in [Earth::Wgs84, Earth::Sphere { radius_m: 6_371_200.0 }] {
            for (lat0, lon0, h0) in [(33.0, 118.0, 0.0), (-22.0, -179.5, 300.0), (89.0, 10.0, 50.0), (0.0, 0.0, -20.0)]
            {
                let frame = LocalFrame::new(lat0, lon0, h0, earth).unwrap();
                for (lat, lon, h) in points() {
                    let p = frame.forward(lat, lon, h);
                    let [lat2, lon2, h2] = frame.inverse(p);
                    let q = frame.forward(lat2, lon2, h2);
                    let away = (0..3).map(|i| (p[i] - q[i]).powi(2)).sum::<f64>().sqrt();
                    let distance = p.iter().map(|v| v * v).sum::<f64>().sqrt();
                    // Degrees of longitude are rounded to 1.4e-14, which is 1.6 nm at the equator; far away the
                    // coordinates themselves are rounded to a nanometre.
                    assert!(away < 4e-9 + 4e-16 * distance, "{earth:?} {lat0} {lon0}: {lat} {lon} {h}: {away}");
                }
            }
        }
    }

    #[test]
    fn agrees_with_earth_centred_coordinates() {
        let ecef = |lat: f64, lon: f64, h: f64| {
            let (sl, cl) = lat.to_radians().sin_cos();
            let (so, co) = lon.to_radians().sin_cos();
            let n = WGS84_A_M / (1.0 - WGS84_E2 * sl * sl).sqrt();
            [(n + h) * cl * co, (n + h) * cl * so, (n * (1.0 - WGS84_E2) + h) * sl]
        };
        let (lat0, lon0, h0) = (33.0_f64, 118.0_f64, 25.0);
        let frame = LocalFrame::new(lat0, lon0, h0, Earth::Wgs84).unwrap();
        let origin = ecef(lat0, lon0, h0);
        let (sl, cl) = lat0.to_radians().sin_cos();
        let (so, co) = lon0.to_radians().sin_cos();
        for (lat, lon, h) in points() {
            let p = ecef(lat, lon, h);
            let d = [p[0] - origin[0], p[1] - origin[1], p[2] - origin[2]];
            let expected = [
                -sl * co * d[0] - sl * so * d[1] + cl * d[2],
                -so * d[0] + co * d[1],
                -cl * co * d[0] - cl * so * d[1] - sl * d[2],
            ];
            let got = frame.forward(lat, lon, h);
            for i in 0..3 {
                assert!((expected[i] - got[i]).abs() < 1e-8, "{lat} {lon} {h} {i}: {} {}", expected[i], got[i]);
            }
        }
    }

    #[test]
    fn sphere_follows_the_corrected_paper() {
        let radius_m = 6_371_200.0;
        let frame = LocalFrame::new(40.0, 100.0, 0.0, Earth::Sphere { radius_m }).unwrap();
        let theta0 = 50.0_f64.to_radians();
        for (lat, lon, h) in [(41.0, 101.5, 0.0), (39.2, 99.0, 3000.0), (45.0, 93.0, -100.0)] {
            let theta = (90.0_f64 - lat).to_radians();
            let away = (100.0_f64 - lon).to_radians();
            let phi = (theta0.cos() * theta.cos() + theta0.sin() * theta.sin() * away.cos()).acos();
            let sin_alpha = theta.sin() * away.sin() / phi.sin();
            let cos_alpha = (theta.cos() - theta0.cos() * phi.cos()) / (theta0.sin() * phi.sin());
            let r = radius_m + h;
            let expected = [r * phi.sin() * cos_alpha, -r * phi.sin() * sin_alpha, radius_m - r * phi.cos()];
            let got = frame.forward(lat, lon, h);
            for i in 0..3 {
                // acos of a number next to one keeps eight digits of a small angle.
                assert!((expected[i] - got[i]).abs() < 1e-3, "{lat} {lon}: {expected:?} {got:?}");
            }
        }
    }

    #[test]
    fn rotation_keeps_length_and_undoes_itself() {
        let frame = LocalFrame::new(33.0, 118.0, 0.0, Earth::Wgs84).unwrap();
        let v = [31_000.0, -3500.0, 38_000.0];
        for (lat, lon, _) in points() {
            let w = frame.rotate_to_origin(lat, lon, v);
            let length = |a: [f64; 3]| a.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((length(v) - length(w)).abs() < 1e-10);
            let back = frame.rotate_from_origin(lat, lon, w);
            assert!((0..3).all(|i| (back[i] - v[i]).abs() < 1e-10));
        }
        assert_eq!(frame.rotate_to_origin(33.0, 118.0, v).map(f64::round), v);
    }

    #[test]
    fn refuses_what_is_no_place() {
        assert!(matches!(LocalFrame::new(91.0, 0.0, 0.0, Earth::Wgs84), Err(Error::Invalid { .. })));
        assert!(matches!(LocalFrame::new(f64::NAN, 0.0, 0.0, Earth::Wgs84), Err(Error::NotFinite { .. })));
        let sphere = Earth::Sphere { radius_m: 0.0 };
        assert!(matches!(LocalFrame::new(0.0, 0.0, 0.0, sphere), Err(Error::Invalid { .. })));
        let frame = LocalFrame::new(0.0, 0.0, 0.0, Earth::Wgs84).unwrap();
        assert!([f64::NAN, 91.0, -90.5].iter().all(|&latitude| frame.forward(latitude, 0.0, 0.0)[0].is_nan()));
    }
}
