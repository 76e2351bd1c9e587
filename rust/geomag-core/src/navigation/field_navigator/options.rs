//! How a navigator starts and what it believes.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::kalman::Scaling;

/// Which filter carries the state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Method {
    /// Sigma points through the field.
    #[default]
    Unscented,
    /// The field's gradient at the mean.
    Extended,
}

/// How the navigator starts and what it believes.
///
/// A standard deviation of zero for speed, heading or bias leaves that state out. A *walk* is the growth of the standard
/// deviation of a state in the square root of a second.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct NavigatorOptions {
    /// Start, map coordinates `[x, y]`.
    pub start: [f64; 2],
    /// Covariance of the start, square metres, east-north.
    pub covariance_m2: [[f64; 2]; 2],
    /// Process noise of each coordinate, square metres a second.
    pub position_noise_m2_s: f64,
    /// Standard deviation of the indicated speed's error, metres a second.
    pub speed_sigma_m_s: f64,
    /// Its walk.
    pub speed_walk: f64,
    /// Standard deviation of the indicated course's error, degrees.
    pub heading_sigma_deg: f64,
    /// Its walk.
    pub heading_walk_deg: f64,
    /// Standard deviation of the sensor's constant error, field unit (each component).
    pub bias_sigma: f64,
    /// Its walk.
    pub bias_walk: f64,
    /// Standard deviation of a reading, field unit: one for all components or one each.
    pub reading_sigma: Vec<f64>,
    /// Whether the field's own standard deviation is added.
    pub field_sigma: bool,
    /// Probability within which a reading must lie to be used; `None` uses all.
    pub gate: Option<f64>,
    /// The filter.
    pub method: Method,
    /// Its sigma points.
    pub scaling: Scaling,
}

impl Default for NavigatorOptions {
    fn default() -> Self {
        Self {
            start: [0.0, 0.0],
            covariance_m2: [[1e4, 0.0], [0.0, 1e4]],
            position_noise_m2_s: 0.01,
            speed_sigma_m_s: 0.0,
            speed_walk: 0.0,
            heading_sigma_deg: 0.0,
            heading_walk_deg: 0.0,
            bias_sigma: 0.0,
            bias_walk: 0.0,
            reading_sigma: vec![1.0],
            field_sigma: true,
            gate: Some(0.9999),
            method: Method::Unscented,
            scaling: Scaling::default(),
        }
    }
}

impl NavigatorOptions {
    /// Refuses options that make no filter of a sensor of so many numbers.
    pub(super) fn check(&self, numbers: usize) -> Result<()> {
        require_finite("start", &self.start)?;
        require_finite("covariance_m2", self.covariance_m2.as_flattened())?;
        for (name, value) in [
            ("position_noise_m2_s", self.position_noise_m2_s),
            ("speed_sigma_m_s", self.speed_sigma_m_s),
            ("speed_walk", self.speed_walk),
            ("heading_sigma_deg", self.heading_sigma_deg),
            ("heading_walk_deg", self.heading_walk_deg),
            ("bias_sigma", self.bias_sigma),
            ("bias_walk", self.bias_walk),
        ] {
            require_not_negative(name, value)?;
        }
        if self.reading_sigma.len() != 1 && self.reading_sigma.len() != numbers {
            return Err(Error::shape(
                "reading_sigma",
                format!("a number or ({numbers},)"),
                format!("({},)", self.reading_sigma.len()),
            ));
        }
        for (i, &sigma) in self.reading_sigma.iter().enumerate() {
            require_not_negative(&format!("reading_sigma[{i}]"), sigma)?;
        }
        Ok(())
    }
}
