//! What is known of an inertial navigation system: how large its errors are, and how they grow.

use crate::error::{Error, Result, require_not_negative, require_positive};

/// Greatest number of an INS model, in its unit, and least time over which a bias changes.
const MOST: f64 = 1e6;
const LEAST_TIME_S: f64 = 1e-3;

/// Standard gravity, metres a second squared.
pub const GRAVITY_M_S2: f64 = 9.806_65;

/// The grade of an INS, an error a row; see `table.rs`. The defaults are navigation grade.
#[doc(hidden)]
#[macro_export]
macro_rules! ins_model {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            errors [
                (gyro_bias_deg_h: number = 0.02; "float";
                    "Standard deviation of a gyro's bias, degrees an hour.")
                (gyro_time_constant_s: number = 14400.0; "float";
                    "Time over which a gyro's bias changes, seconds.")
                (gyro_walk_deg_sqrt_h: number = 0.003; "float";
                    "Angle random walk, degrees per square root of an hour.")
                (accelerometer_bias_ug: number = 50.0; "float";
                    "Standard deviation of an accelerometer's bias, millionths of standard gravity.")
                (accelerometer_time_constant_s: number = 14400.0; "float";
                    "Time over which an accelerometer's bias changes, seconds.")
                (velocity_walk_m_s_sqrt_h: number = 0.01; "float";
                    "Velocity random walk, metres a second per square root of an hour.")
                (velocity_sigma_m_s: number = 0.2; "float";
                    "Standard deviation of the velocity error at the start, each axis, metres a second.")
                (tilt_sigma_mrad: number = 0.05; "float";
                    "Standard deviation of the tilts at the start, milliradians.")
                (heading_sigma_mrad: number = 1.0; "float";
                    "Standard deviation of the heading error at the start, milliradians.")
            ]
        }
    };
}

ins_model! { record {
    /// The grade of an INS: sensor biases (first-order Gauss-Markov), random walks, and errors after alignment.
    ///
    /// ```
    /// use geomag_core::navigation::navigator::InsModel;
    /// assert_eq!(InsModel::navigation().gyro_bias_deg_h, 0.02);
    /// assert!(InsModel { gyro_bias_deg_h: -1.0, ..InsModel::tactical() }.validate().is_err());
    /// ```
    InsModel
} }

impl InsModel {
    /// An INS of navigation grade: about one nautical mile an hour unaided. The defaults.
    pub fn navigation() -> Self {
        Self::default()
    }

    /// An INS of tactical grade: some tens of kilometres an hour unaided.
    pub fn tactical() -> Self {
        Self {
            gyro_bias_deg_h: 1.0,
            gyro_time_constant_s: 3600.0,
            gyro_walk_deg_sqrt_h: 0.05,
            accelerometer_bias_ug: 300.0,
            accelerometer_time_constant_s: 3600.0,
            velocity_walk_m_s_sqrt_h: 0.05,
            velocity_sigma_m_s: 0.3,
            tilt_sigma_mrad: 0.3,
            heading_sigma_mrad: 4.0,
        }
    }

    /// Checks the ranges of the numbers.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) naming the first out of range.
    pub fn validate(&self) -> Result<()> {
        for (name, value) in [
            ("gyro_bias_deg_h", self.gyro_bias_deg_h),
            ("gyro_walk_deg_sqrt_h", self.gyro_walk_deg_sqrt_h),
            ("accelerometer_bias_ug", self.accelerometer_bias_ug),
            ("velocity_walk_m_s_sqrt_h", self.velocity_walk_m_s_sqrt_h),
            ("velocity_sigma_m_s", self.velocity_sigma_m_s),
            ("tilt_sigma_mrad", self.tilt_sigma_mrad),
            ("heading_sigma_mrad", self.heading_sigma_mrad),
        ] {
            // No INS is worse, and what squares of it overflow is no covariance.
            if require_not_negative(&format!("InsModel {name}"), value)? > MOST {
                return Err(Error::invalid(format!("InsModel {name}"), format!("at most {MOST}"), value));
            }
        }
        for (name, value) in [
            ("gyro_time_constant_s", self.gyro_time_constant_s),
            ("accelerometer_time_constant_s", self.accelerometer_time_constant_s),
        ] {
            if require_positive(&format!("InsModel {name}"), value)? < LEAST_TIME_S {
                return Err(Error::invalid(format!("InsModel {name}"), format!("at least {LEAST_TIME_S} s"), value));
            }
        }
        Ok(())
    }

    /// Standard deviation of a gyro's bias, radians a second.
    pub(super) fn gyro_rad_s(&self) -> f64 {
        self.gyro_bias_deg_h.to_radians() / 3600.0
    }

    /// Standard deviation of an accelerometer's bias, metres a second squared.
    pub(super) fn accelerometer_m_s2(&self) -> f64 {
        self.accelerometer_bias_ug * 1e-6 * GRAVITY_M_S2
    }

    /// Angle random walk squared, radians squared a second.
    pub(super) fn angle_noise(&self) -> f64 {
        (self.gyro_walk_deg_sqrt_h.to_radians() / 60.0).powi(2)
    }

    /// Velocity random walk squared, metres squared a second cubed.
    pub(super) fn velocity_noise(&self) -> f64 {
        (self.velocity_walk_m_s_sqrt_h / 60.0).powi(2)
    }
}
