//! How a navigator starts and what it believes.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::kalman::Scaling;

/// Which filter carries the state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum FieldNavigatorMethod {
    /// Sigma points through the field.
    #[default]
    Unscented,
    /// The field's gradient at the mean.
    Extended,
}

/// The options of a navigator without an INS, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! field_navigator_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            options [
                (position_noise_m2_s: number = 0.01; "float";
                    "Process noise of each coordinate, square metres a second.")
                (speed_sigma_m_s: number = 0.0; "float";
                    "Standard deviation of the indicated speed's constant error; a state where it is not zero.")
                (speed_walk_m_s_sqrt_s: number = 0.0; "float";
                    "Random walk of that error, (m/s) / sqrt(s).")
                (heading_sigma_deg: number = 0.0; "float";
                    "Standard deviation of the indicated course's constant error; a state where it is not zero.")
                (heading_walk_deg_sqrt_s: number = 0.0; "float";
                    "Random walk of that error, degrees / sqrt(s).")
                (bias_sigma: number = 0.0; "float";
                    "Standard deviation of the sensor's constant error, field unit, each component; states where it is not zero.")
                (bias_walk_sqrt_s: number = 0.0; "float";
                    "Random walk of that error, field unit / sqrt(s).")
                (field_sigma: flag = true; "bool";
                    "Whether the field's own standard deviation is added to that of the reading.")
                (method: field_method = "unscented"; "{'unscented', 'extended'}";
                    "Which filter: sigma points through the field, or the field's gradient at the mean.")
            ]
        }
    };
}

/// Probability within which a reading must lie to be used, where nothing is said.
pub const GATE: f64 = 0.9999;

macro_rules! field_navigator_struct {
    (options [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]) => {
        /// How a [`FieldNavigator`](super::FieldNavigator) starts and what it believes.
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct FieldNavigatorOptions {
            /// Start, map coordinates `[x, y]`.
            pub start: [f64; 2],
            /// Covariance of the start, square metres, east-north.
            pub covariance_m2: [[f64; 2]; 2],
            /// Standard deviation of a reading, field unit: one for all components or one each.
            pub reading_sigma: Vec<f64>,
            /// Probability within which a reading must lie to be used; `None` uses all.
            pub gate: Option<f64>,
            /// Sigma points of the unscented filter.
            pub scaling: Scaling,
            $($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*
        }

        impl Default for FieldNavigatorOptions {
            fn default() -> Self {
                Self {
                    start: [0.0, 0.0],
                    covariance_m2: [[1e4, 0.0], [0.0, 1e4]],
                    reading_sigma: vec![1.0],
                    gate: Some(GATE),
                    scaling: Scaling::default(),
                    $($name: option_default!($kind $default),)*
                }
            }
        }
    };
}

field_navigator_options!(field_navigator_struct);

impl FieldNavigatorOptions {
    /// Refuses options that make no filter of a sensor of so many numbers.
    pub(super) fn check(&self, numbers: usize) -> Result<()> {
        require_finite("start", &self.start)?;
        require_finite("covariance_m2", self.covariance_m2.as_flattened())?;
        for (name, value) in [
            ("position_noise_m2_s", self.position_noise_m2_s),
            ("speed_sigma_m_s", self.speed_sigma_m_s),
            ("speed_walk_m_s_sqrt_s", self.speed_walk_m_s_sqrt_s),
            ("heading_sigma_deg", self.heading_sigma_deg),
            ("heading_walk_deg_sqrt_s", self.heading_walk_deg_sqrt_s),
            ("bias_sigma", self.bias_sigma),
            ("bias_walk_sqrt_s", self.bias_walk_sqrt_s),
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
