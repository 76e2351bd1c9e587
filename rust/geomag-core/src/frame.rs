//! Where things are on the Earth: metre scales of geographic coordinates.
//!
//! Geographic maps are searched in degrees and judged in metres. The conversion is local: the radii of curvature of
//! WGS84 at the latitude in question (Groves, *Principles of GNSS, Inertial, and Multisensor Integrated Navigation
//! Systems*, eq. 2.105 and 2.106), at height zero.

use crate::constants::{WGS84_A_M, WGS84_E2};

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

/// Brings a longitude into the turn around `centre_deg`: `[centre - 180, centre + 180)`.
///
/// ```
/// assert_eq!(geomag_core::frame::wrap_longitude(-179.0, 180.0), 181.0);
/// assert_eq!(geomag_core::frame::wrap_longitude(20.0, 15.0), 20.0);
/// ```
pub fn wrap_longitude(longitude_deg: f64, centre_deg: f64) -> f64 {
    let away = longitude_deg - centre_deg;
    if (-180.0..180.0).contains(&away) {
        longitude_deg
    } else {
        longitude_deg - 360.0 * ((away + 180.0) / 360.0).floor()
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
