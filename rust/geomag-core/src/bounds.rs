//! Where a coordinate can lie at all, and how large a value can be. Finite is not enough: blanks of old formats (-1e32, 9.97e36) are finite, and an index made
//! of one overflows.
//!
//! Every place that enters passes here (tracks, samples of a stream, axes, paths), so that nothing further down has to ask.

use crate::error::{Error, Result, require_finite};

/// Greatest size of a projected coordinate, metres: two and a half times round the Earth. (Web Mercator ends at 2.1e7, eastings with
/// the zone before them at 6.1e7.)
pub const FARTHEST_M: f64 = 1e8;
/// Greatest size of a longitude, degrees: ten turns.
pub const MOST_LONGITUDE_DEG: f64 = 3600.0;
/// Greatest size of a value, of a map or a reading, in whatever unit: the Earth's field in femtotesla is 5e10. Blanks of old formats
/// lie beyond, and squares within are numbers in single precision.
pub const MOST_VALUE: f64 = 1e15;
/// Greatest height above or below the surface, metres: a low orbit, and the depth of the core.
pub const MOST_HEIGHT_M: f64 = 3e6;
/// Most that a length can be stretched by.
pub const MOST_SCALE: f64 = 1e3;
/// Least spacing of an axis and least step of a lattice, map units: positions in cells of it are whole numbers that a double holds.
pub const LEAST_STEP: f64 = 1e-7;

/// Refuses a coordinate that no place on the Earth has; `name` is made only for the message.
fn require(name: impl FnOnce() -> String, value: f64, limit: f64, kind: &str) -> Result<()> {
    if value.abs() <= limit { Ok(()) } else { Err(Error::invalid(name(), format!("{kind} within +-{limit}"), value)) }
}

/// Limit and name of a coordinate along x (0) or y (1).
fn limit(geographic: bool, axis: usize) -> (f64, &'static str) {
    match (geographic, axis) {
        (false, _) => (FARTHEST_M, "a coordinate"),
        (true, 0) => (MOST_LONGITUDE_DEG, "a longitude (degrees)"),
        (true, _) => (90.0, "a latitude (degrees)"),
    }
}

/// Refuses arrays of coordinates with one that no place has, naming the first: `{what} x[{index}]`.
///
/// # Errors
/// [`Error::NotFinite`], [`Error::Invalid`] beyond [`FARTHEST_M`], or, on geographic coordinates, beyond 90 degrees of latitude or
/// [`MOST_LONGITUDE_DEG`].
pub fn require_places(what: &str, geographic: bool, x: &[f64], y: &[f64]) -> Result<()> {
    for (axis, (name, values)) in [("x", x), ("y", y)].into_iter().enumerate() {
        let (most, kind) = limit(geographic, axis);
        if let Some(k) = values.iter().position(|v| !(v.abs() <= most)) {
            require_finite(&format!("{what} {name}"), values)?;
            require(|| format!("{what} {name}[{k}]"), values[k], most, kind)?;
        }
    }
    Ok(())
}

/// Refuses a place that cannot be: see [`require_places`].
///
/// # Errors
/// As [`require_places`].
pub fn require_place(what: &str, geographic: bool, place: [f64; 2]) -> Result<()> {
    for (axis, name) in ["x", "y"].into_iter().enumerate() {
        let (most, kind) = limit(geographic, axis);
        if !(place[axis].abs() <= most) {
            require_finite(&format!("{what} {name}"), &place[axis..=axis])?;
            require(|| format!("{what} {name}"), place[axis], most, kind)?;
        }
    }
    Ok(())
}

/// Refuses points in metres with one that cannot be, naming the first: `{what} {index}`. A name is made for that one alone.
///
/// # Errors
/// As [`require_places`].
pub fn require_points(what: &str, points: &[[f64; 2]]) -> Result<()> {
    match points.iter().position(|p| !p.iter().all(|c| c.abs() <= FARTHEST_M)) {
        None => Ok(()),
        Some(k) => require_place(&format!("{what} {k}"), false, points[k]),
    }
}

/// Refuses values with one that no field has, naming the first: `{what}[{index}]`.
///
/// # Errors
/// [`Error::NotFinite`], [`Error::Invalid`] beyond [`MOST_VALUE`].
pub fn require_values(what: &str, values: &[f64]) -> Result<()> {
    match values.iter().position(|v| !(v.abs() <= MOST_VALUE)) {
        None => Ok(()),
        Some(k) if values[k].is_finite() => require(|| format!("{what}[{k}]"), values[k], MOST_VALUE, "a value"),
        Some(_) => require_finite(what, values),
    }
}

/// Refuses a standard deviation, or a ratio of such, that is no number from 0 to [`MOST_VALUE`].
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_spread(what: &str, value: f64) -> Result<f64> {
    if (0.0..=MOST_VALUE).contains(&value) {
        Ok(value)
    } else {
        Err(Error::invalid(what, format!("a finite number >= 0, at most {MOST_VALUE}"), value))
    }
}

/// Refuses a length or a distance that is no number of metres from 0 to twice [`FARTHEST_M`].
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_distance_m(what: &str, value: f64) -> Result<f64> {
    if (0.0..=2.0 * FARTHEST_M).contains(&value) {
        Ok(value)
    } else {
        Err(Error::invalid(what, format!("a finite number >= 0, at most {} m", 2.0 * FARTHEST_M), value))
    }
}

/// Refuses an extent of a search that is longer than the Earth.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_extent(what: &str, value: f64) -> Result<()> {
    require(|| what.to_owned(), value, 2.0 * FARTHEST_M, "an extent")
}

/// Refuses a step, or an extent that steps are made of, that is longer than the Earth, or shorter than a lattice resolves
/// ([`LEAST_STEP`]) and not zero.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_resolved(what: &str, value: f64) -> Result<()> {
    require_extent(what, value)?;
    if value == 0.0 || value.abs() >= LEAST_STEP {
        Ok(())
    } else {
        Err(Error::invalid(what, format!("an extent of at least {LEAST_STEP} map units"), value))
    }
}

/// Refuses heights with one that no vehicle and no map has, naming the first: `{what}[{index}]`.
///
/// # Errors
/// [`Error::NotFinite`], [`Error::Invalid`] beyond [`MOST_HEIGHT_M`].
pub fn require_heights(what: &str, heights_m: &[f64]) -> Result<()> {
    require_finite(what, heights_m)?;
    match heights_m.iter().position(|h| h.abs() > MOST_HEIGHT_M) {
        None => Ok(()),
        Some(k) => {
            let name = if heights_m.len() == 1 { what.to_owned() } else { format!("{what}[{k}]") };
            require(|| name, heights_m[k], MOST_HEIGHT_M, "a height in metres")
        }
    }
}

/// Refuses a factor by which lengths are stretched that no odometer and no map has.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_scale(what: &str, value: f64) -> Result<f64> {
    if (1.0 / MOST_SCALE..=MOST_SCALE).contains(&value) {
        Ok(value)
    } else {
        Err(Error::invalid(what, format!("a scale from {} to {MOST_SCALE}", 1.0 / MOST_SCALE), value))
    }
}

/// Refuses a number that must be above zero and that others are counted in: a quantum of values, the cost of a piece of work.
///
/// # Errors
/// [`Error::Invalid`].
pub fn require_quantum(what: &str, value: f64) -> Result<f64> {
    if value > 0.0 && value <= MOST_VALUE {
        Ok(value)
    } else {
        Err(Error::invalid(what, format!("a number > 0, at most {MOST_VALUE}"), value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_are_refused_by_name() {
        for blank in [-1e32, 9.97e36, 1.7e38, 1e22, 2e8] {
            let got = require_places("track", false, &[0.0, blank], &[0.0, 0.0]).unwrap_err().to_string();
            assert!(got.starts_with("track x[1]: needed a coordinate within +-100000000, got "), "{got}");
            assert!(require_place("sample", false, [0.0, blank]).is_err());
        }
        assert!(require_places("track", true, &[720.5], &[89.0]).is_ok());
        let pole = require_place("sample", true, [0.0, 90.1]).unwrap_err().to_string();
        assert_eq!(pole, "sample y: needed a latitude (degrees) within +-90, got 90.1");
        assert!(matches!(require_place("sample", true, [f64::NAN, 0.0]), Err(Error::NotFinite { .. })));
        assert!(require_extent("half_width x", 1e9).is_err());
        assert!(require_resolved("half_width x", 8.9e-157).is_err() && require_resolved("half_width x", 0.0).is_ok());
        assert!(require_extent("half_width x", 8.9e-157).is_ok() && require_resolved("step x", 1e9).is_err());
        assert!(require_scale("scale", 9.97e36).is_err() && require_scale("scale", 0.0).is_err());
        assert!(require_scale("scale", 0.9).is_ok());
        let blank = require_values("track values", &[1.0, -1e32]).unwrap_err().to_string();
        assert_eq!(
            blank,
            "track values[1]: needed a value within +-1000000000000000, got -100000000000000000000000000000000"
        );
        assert!(matches!(require_values("track values", &[f64::NAN, 1e32]), Err(Error::NotFinite { index: 0, .. })));
    }
}
