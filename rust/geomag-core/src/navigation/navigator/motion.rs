//! How the errors of an INS feed each other: the error equations of level flight in a local-level frame.
//!
//! Indicated minus true, position and velocity to the east and north, tilts about north, east and down (radians). The vertical channel is
//! slaved. With W the Earth's rate, L the latitude, R its radii, f the horizontal specific force, C the turn by the heading:
//!
//! ```text
//! dE'  = dvE + vE tanL/R dN - vN tanL/R dE                          dN' = dvN
//! dvN' = fE psiD + g psiE - (2 W sinL + 2 vE tanL/R) dvE - (2 W cosL + vE/(R cos^2 L)) vE/R dN + [C a]N
//! dvE' = -g psiN - fN psiD + (2 W sinL + vE tanL/R) dvN + vN tanL/R dvE + (2 W cosL + vE/(R cos^2 L)) vN/R dN + [C a]E
//! psi' = -w_in x psi + dw_in - C (gyro bias)                        biases: first-order Gauss-Markov
//! ```
//!
//! Source: Titterton & Weston, *Strapdown Inertial Navigation Technology*, sect. 12.3; Groves, *Principles of GNSS, Inertial, and Multisensor
//! Integrated Navigation Systems*, sect. 14.2.

// Matrices are indexed as the formulas are.
#![allow(clippy::needless_range_loop)]

use super::ins::GRAVITY_M_S2;

/// Rate of the Earth's rotation, radians a second (WGS84).
pub const EARTH_RATE_RAD_S: f64 = 7.292_115e-5;
/// Fastest vehicle, metres a second.
pub(super) const FASTEST_M_S: f64 = 1e4;

/// Position error to the east, metres; that to the north is the next, and so for every pair.
pub(super) const POSITION: usize = 0;
/// Velocity error, metres a second.
pub(super) const VELOCITY: usize = 2;
/// Tilts about north, east and down, radians.
pub(super) const TILT: usize = 4;
/// Biases of the gyros: forward, right, down, radians a second.
pub(super) const GYRO: usize = 7;
/// Biases of the accelerometers: forward, right, metres a second squared.
pub(super) const ACCELEROMETER: usize = 10;
/// States of the INS.
pub(super) const INS_STATES: usize = 12;
/// States whose equations are coupled: all but the biases.
pub(super) const COUPLED: usize = GYRO;

/// Where the vehicle is and how it moves, as far as the errors care.
#[derive(Debug, Clone, Copy)]
pub(super) struct VehicleMotion {
    pub latitude_rad: f64,
    /// Radii of curvature for motion to the east and to the north, metres.
    pub radii_m: [f64; 2],
    /// East, north.
    pub velocity_m_s: [f64; 2],
    /// Change of the velocity, east, north.
    pub acceleration_m_s2: [f64; 2],
    pub heading_rad: f64,
    /// Whether the attitude is known well enough that turns are seen through it.
    pub turns: bool,
}

/// The rows of a matrix over the INS states that belong to the coupled ones.
pub(super) type Rows = [[f64; INS_STATES]; COUPLED];

/// The coupled rows of F in x' = F x, per second.
pub(super) fn rates(motion: &VehicleMotion) -> Rows {
    let VehicleMotion { radii_m: [re, rn], velocity_m_s: [ve, vn], .. } = *motion;
    let (sin, cos) = (libm::sin(motion.latitude_rad), libm::cos(motion.latitude_rad));
    let tan = sin / cos;
    let w = EARTH_RATE_RAD_S;
    // What the accelerometers feel beyond gravity: the change of the velocity, and what keeps it along the turning frame.
    let turning = 2.0 * w * sin + ve * tan / re;
    let [fe, fn_] = if motion.turns {
        [motion.acceleration_m_s2[0] - turning * vn, motion.acceleration_m_s2[1] + turning * ve]
    } else {
        [0.0; 2]
    };
    let (sin_h, cos_h) = (libm::sin(motion.heading_rad), libm::cos(motion.heading_rad));
    let transport = 2.0 * w * cos + ve / (re * cos * cos);
    let in_frame = [w * cos + ve / re, -vn / rn, -w * sin - ve * tan / re];
    let mut f = [[0.0; INS_STATES]; COUPLED];
    let (e, n, ve_, vn_) = (POSITION, POSITION + 1, VELOCITY, VELOCITY + 1);
    let [pn, pe, pd] = [TILT, TILT + 1, TILT + 2];
    f[e][ve_] = 1.0;
    f[e][n] = ve * tan / re;
    f[e][e] = -vn * tan / re;
    f[n][vn_] = 1.0;

    f[vn_][pd] = fe;
    f[vn_][pe] = GRAVITY_M_S2;
    f[vn_][ve_] = -2.0 * (w * sin + ve * tan / re);
    f[vn_][n] = -transport * ve / rn;
    f[vn_][ACCELEROMETER] = cos_h;
    f[vn_][ACCELEROMETER + 1] = -sin_h;

    f[ve_][pn] = -GRAVITY_M_S2;
    f[ve_][pd] = -fn_;
    f[ve_][vn_] = turning;
    f[ve_][ve_] = vn * tan / re;
    f[ve_][n] = transport * vn / rn;
    f[ve_][ACCELEROMETER] = sin_h;
    f[ve_][ACCELEROMETER + 1] = cos_h;

    // -w x psi.
    let [wn, we, wd] = in_frame;
    f[pn][pd] = -we;
    f[pn][pe] = wd;
    f[pe][pn] = -wd;
    f[pe][pd] = wn;
    f[pd][pe] = -wn;
    f[pd][pn] = we;
    // Change of w by the errors of velocity and latitude.
    f[pn][ve_] = 1.0 / re;
    f[pn][n] = -w * sin / rn;
    f[pe][vn_] = -1.0 / rn;
    f[pd][ve_] = -tan / re;
    f[pd][n] = -(w * cos + ve / (re * cos * cos)) / rn;
    // -C gyro bias.
    f[pn][GYRO] = -cos_h;
    f[pn][GYRO + 1] = sin_h;
    f[pe][GYRO] = -sin_h;
    f[pe][GYRO + 1] = -cos_h;
    f[pd][GYRO + 2] = -1.0;
    f
}

/// The coupled rows of I + F dt + F^2 dt^2 / 2; `decay` holds the rates at which the biases forget, per second.
pub(super) fn transition(f: &Rows, decay: &[f64; INS_STATES - COUPLED], dt: f64) -> Rows {
    let half = 0.5 * dt * dt;
    let mut phi = [[0.0; INS_STATES]; COUPLED];
    for i in 0..COUPLED {
        let mut square = [0.0; INS_STATES];
        for k in 0..COUPLED {
            let a = f[i][k];
            if a != 0.0 {
                for (s, b) in square.iter_mut().zip(&f[k]) {
                    *s += a * b;
                }
            }
        }
        for (k, d) in decay.iter().enumerate() {
            square[COUPLED + k] -= f[i][COUPLED + k] * d;
        }
        for j in 0..INS_STATES {
            phi[i][j] = f[i][j] * dt + half * square[j];
        }
        phi[i][i] += 1.0;
    }
    phi
}
