//! Fields, tracks, INS errors and sensors that are made up but realistic: for examples, tests, campaigns and users.
//!
//! Everything is drawn from a seed, and the same seed gives the same bits on every machine: PCG random numbers, and
//! trigonometric, exponential and logarithmic functions from a library written in Rust instead of the platform's own.
//!
//! The order of things is that of a real run: a [`CrustSpec`] gives a [`SyntheticField`]; that is surveyed into a map
//! ([`SyntheticField::grid`]); a vehicle flies a true [`Path`] through the field; its INS indicates another one
//! ([`InsError`]); its magnetometer reads the field at the true position ([`SensorModel`]). [`fly`] does the last three
//! at once.
//!
//! ```
//! use geomag_core::field::Field;
//! use geomag_core::synthetic::{CrustSpec, InsError, Path, SensorModel, fly};
//! let field = CrustSpec::default().draw([0.0, 0.0, 40_000.0, 30_000.0], false, 7)?;
//! let map = field.grid_by_step(500.0)?;
//! let path = Path::straight([8_000.0, 6_000.0], 60.0, 60.0, 10.0, 41, false)?;
//! let ins = InsError { position_m: [-700.0, 450.0], ..InsError::default() };
//! let flight = fly(&field, &path, &ins, &SensorModel::white(0.5), 7)?;
//! let offset = flight.offset_m();
//! assert!((offset[0] - 700.0).abs() < 1e-6 && (offset[1] + 450.0).abs() < 1e-6);
//! assert!((flight.track.values()[0] - map.value(8_000.0, 6_000.0)).abs() < 20.0);
//! # Ok::<(), geomag_core::error::Error>(())
//! ```

mod crust;
mod ins;
mod path;
mod sensor;

pub use crate::random::Random;
pub use crust::{CrustSpec, Dipole, PlaneWave, SyntheticField};
pub use ins::{InsError, InsSpread, PositionSpread, SCHULER_RATE_RAD_S};
pub use path::{Leg, Path};
pub use sensor::SensorModel;

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result};
use crate::field::Field;
use crate::frame::displacement_m;
use crate::track::Track;

/// One run of a vehicle: where it was, what its instruments said.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Flight {
    /// The true path.
    pub path: Path,
    /// Indicated positions, measured values, times.
    pub track: Track,
    /// Field at the true positions without any sensor error, value units.
    pub truth: Vec<f64>,
}

impl Flight {
    /// True minus indicated position of the newest sample, metres `[east, north]`: what a fix should find.
    pub fn offset_m(&self) -> [f64; 2] {
        displacement_m(self.path.geographic(), self.track.newest(), self.path.newest())
    }

    /// True minus indicated position of the newest sample, map units `[x, y]`.
    pub fn offset(&self) -> [f64; 2] {
        let ([x, y], [u, v]) = (self.path.newest(), self.track.newest());
        [x - u, y - v]
    }
}

/// Flies a path through a field: indicated positions from the INS error, readings from the sensor model.
///
/// The INS error's random walk and the sensor's noise are drawn from streams of their own of `seed`, so that changing the
/// one leaves the other as it was.
///
/// # Errors
/// [`Error::Invalid`] where the path meets a place where the field is unknown, naming the sample; and what the models
/// themselves refuse.
pub fn fly(field: &dyn Field, path: &Path, ins: &InsError, sensor: &SensorModel, seed: u64) -> Result<Flight> {
    if field.geographic() != path.geographic() {
        let name = |geographic| if geographic { "degrees" } else { "metres" };
        return Err(Error::invalid(
            "path",
            format!("coordinates in {}", name(field.geographic())),
            name(path.geographic()),
        ));
    }
    let mut truth = Vec::with_capacity(path.len());
    for k in 0..path.len() {
        let [x, y] = path.point(k);
        let value = field.value(x, y);
        if !value.is_finite() {
            return Err(Error::invalid(
                format!("path sample {k}"),
                "a position where the field is known",
                format!("({x}, {y}), where it is not"),
            ));
        }
        truth.push(value);
    }
    let (x, y) = ins.indicate(path, &mut Random::stream(seed, 1))?;
    let values = sensor.read(&truth, path.time_s(), &mut Random::stream(seed, 2))?;
    let track = Track::new(x, y, values, Some(path.time_s().to_vec()))?;
    Ok(Flight { path: path.clone(), track, truth })
}
