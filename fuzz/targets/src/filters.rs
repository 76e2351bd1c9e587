//! Kalman filters that know vectors, not fields.

use geomag_core::error::{Error, Result};
use geomag_core::kalman::error_state::ErrorStateFilter;
use geomag_core::kalman::{Estimate, ExtendedKalmanFilter, Scaling, UnscentedKalmanFilter};
use geomag_core::state;
use nalgebra::{DMatrix, DVector};

use crate::source::Source;

fn assert_estimate(estimate: &Estimate) {
    let covariance = estimate.covariance();
    assert!(estimate.mean().iter().all(|v| v.is_finite()), "{estimate:?}");
    assert!(covariance.iter().all(|v| v.is_finite()), "{covariance}");
    assert_eq!(covariance, covariance.transpose());
    assert!(covariance.diagonal().iter().all(|v| *v >= 0.0), "{covariance}");
    assert!(estimate.factor().iter().all(|v| v.is_finite()));
}

/// L L' of hostile numbers, at times anything at all.
fn covariance(s: &mut Source<'_>, n: usize, most: f64) -> Vec<f64> {
    let l = DMatrix::from_vec(n, n, s.numbers(n * n, -most, most)).lower_triangle();
    let mut out: Vec<f64> = (&l * l.transpose()).data.into();
    if s.one_in(8) && n > 0 {
        let k = s.below(n * n);
        out[k] = s.number(-most, most);
    }
    out
}

fn model(kind: usize, size: f64) -> impl FnMut(&[f64], &mut [f64]) -> Result<()> {
    move |x: &[f64], out: &mut [f64]| {
        for (k, o) in out.iter_mut().enumerate() {
            let v = x.get(k % x.len()).copied().unwrap_or(0.0);
            *o = match kind {
                0 => v,
                1 => size * v,
                2 => size * v * v,
                3 => (size * v).sin(),
                4 => f64::NAN,
                5 => size / v,
                6 => return Err(Error::invalid("model", "a place", "none")),
                _ => v + size * x[0],
            };
        }
        Ok(())
    }
}

/// Predictions and updates of the three filters with anything.
pub fn kalman(data: &[u8]) {
    let s = &mut Source::new(data);
    let n = 1 + s.below(4);
    let (mean, first) = (s.numbers(n, -10.0, 10.0), covariance(s, n, 5.0));
    let scaling = if s.one_in(2) {
        Scaling { alpha: s.number(0.01, 1.0), beta: s.number(0.0, 3.0), kappa: s.number(-3.0, 3.0) }
    } else {
        Scaling::default()
    };
    match s.below(3) {
        0 => {
            let Ok(mut ukf) = UnscentedKalmanFilter::new(&mean, &first, scaling) else { return };
            for _ in 0..5 {
                let before = state::save(&ukf).expect("a state can be written");
                let (kind, size, m) = (s.below(8), s.number(-2.0, 2.0), 1 + s.below(3));
                let done = if s.one_in(2) {
                    let q = covariance(s, n, 1.0);
                    ukf.predict(model(kind, size), &q)
                } else {
                    let (z, r) = (s.numbers(m, -10.0, 10.0), covariance(s, m, 2.0));
                    let gate = s.maybe(0.5, 1.0);
                    ukf.update(&z, model(kind, size), &r, gate)
                        .map(|i| assert!(i.nis >= 0.0 && i.nis.is_finite(), "{i:?}"))
                };
                if done.is_err() {
                    assert_eq!(state::save(&ukf).expect("again"), before, "a refused call left its mark");
                }
                assert_estimate(ukf.estimate());
                ukf = state::load(&state::save(&ukf).expect("again")).expect("a state that was written is read");
            }
        }
        1 => {
            let Ok(mut ekf) = ExtendedKalmanFilter::new(&mean, &first) else { return };
            for _ in 0..5 {
                let before = state::save(&ekf).expect("a state can be written");
                let m = 1 + s.below(3);
                let done = if s.one_in(2) {
                    let (x, f, q) = (s.numbers(n, -10.0, 10.0), s.numbers(n * n, -2.0, 2.0), covariance(s, n, 1.0));
                    ekf.predict(&x, &f, &q)
                } else {
                    let (z, h, j) = (s.numbers(m, -10.0, 10.0), s.numbers(m, -10.0, 10.0), s.numbers(m * n, -2.0, 2.0));
                    let (r, gate) = (covariance(s, m, 2.0), s.maybe(0.5, 1.0));
                    ekf.update(&z, &h, &j, &r, gate).map(|i| assert!(i.nis >= 0.0 && i.nis.is_finite(), "{i:?}"))
                };
                if done.is_err() {
                    assert_eq!(state::save(&ekf).expect("again"), before, "a refused call left its mark");
                }
                assert_estimate(ekf.estimate());
                ekf = state::load(&state::save(&ekf).expect("again")).expect("a state that was written is read");
            }
        }
        _ => {
            let square = DMatrix::from_row_slice(n, n, &first);
            let Ok(mut filter) = ErrorStateFilter::new(DVector::from_vec(mean), &square) else { return };
            for _ in 0..5 {
                let before = (filter.state().to_vec(), filter.covariance());
                let m = 1 + s.below(2);
                let done = if s.one_in(2) {
                    let f = DMatrix::from_vec(n, n, s.numbers(n * n, -2.0, 2.0));
                    let q = DMatrix::from_row_slice(n, n, &covariance(s, n, 1.0));
                    filter.predict(&f, &q)
                } else {
                    let z = DVector::from_vec(s.numbers(m, -10.0, 10.0));
                    let h = DMatrix::from_vec(m, n, s.numbers(m * n, -2.0, 2.0));
                    let r = DMatrix::from_row_slice(m, m, &covariance(s, m, 2.0));
                    let gate = s.number(0.0, 20.0);
                    filter.update(&z, &h, &r, gate).map(|u| assert!(u.nis >= 0.0 && u.nis.is_finite(), "{u:?}"))
                };
                let after = (filter.state().to_vec(), filter.covariance());
                assert!(after.0.iter().chain(after.1.iter()).all(|v| v.is_finite()), "{after:?}");
                if done.is_err() {
                    assert_eq!(before, after, "a refused call left its mark");
                }
            }
        }
    }
}
