//! Physical and geodetic constants.

/// Semi-major axis of WGS84, metres (NIMA TR8350.2).
pub const WGS84_A_M: f64 = 6_378_137.0;
/// Flattening of WGS84 (NIMA TR8350.2).
pub const WGS84_F: f64 = 1.0 / 298.257_223_563;
/// First eccentricity of WGS84, squared.
pub const WGS84_E2: f64 = WGS84_F * (2.0 - WGS84_F);
/// Geomagnetic reference radius, metres (IGRF, WMM, EMM).
pub const GEOMAGNETIC_RADIUS_M: f64 = 6_371_200.0;
/// One international nautical mile, metres.
pub const NAUTICAL_MILE_M: f64 = 1852.0;
/// Natural logarithm of the square root of two pi.
pub const LN_SQRT_2PI: f64 = 0.918_938_533_204_672_8;
