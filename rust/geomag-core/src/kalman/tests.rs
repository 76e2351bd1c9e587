use nalgebra::{DMatrix, DVector};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::{ExtendedKalmanFilter, Scaling, UnscentedKalmanFilter};
use crate::error::Error;

/// The Kalman filter as it stands in textbooks.
struct Textbook {
    x: DVector<f64>,
    p: DMatrix<f64>,
}

impl Textbook {
    fn predict(&mut self, f: &DMatrix<f64>, q: &DMatrix<f64>) {
        self.x = f * &self.x;
        self.p = f * &self.p * f.transpose() + q;
    }

    fn update(&mut self, z: &DVector<f64>, h: &DMatrix<f64>, r: &DMatrix<f64>) -> f64 {
        let s = h * &self.p * h.transpose() + r;
        let inverse = s.clone().try_inverse().unwrap();
        let gain = &self.p * h.transpose() * &inverse;
        let residual = z - h * &self.x;
        self.x += &gain * &residual;
        self.p -= &gain * s * gain.transpose();
        residual.dot(&(inverse * &residual))
    }
}

fn row_major(m: &DMatrix<f64>) -> Vec<f64> {
    m.transpose().as_slice().to_vec()
}

fn definite(rng: &mut Pcg64, n: usize) -> DMatrix<f64> {
    let a = DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
    &a * a.transpose() + DMatrix::identity(n, n) * 0.1
}

#[test]
fn both_filters_equal_the_kalman_filter_on_linear_models() {
    let mut rng = Pcg64::seed_from_u64(1);
    for scaling in [
        Scaling::default(),
        Scaling { alpha: 1e-2, ..Scaling::default() },
        Scaling { alpha: 0.7, beta: 0.1, kappa: 1.0 },
    ] {
        let n = 4;
        let start: Vec<f64> = (0..n).map(|_| rng.random_range(-5.0..5.0)).collect();
        let p = definite(&mut rng, n);
        let mut plain = Textbook { x: DVector::from_vec(start.clone()), p: p.clone() };
        let mut unscented = UnscentedKalmanFilter::new(&start, &row_major(&p), scaling).unwrap();
        let mut extended = ExtendedKalmanFilter::new(&start, &row_major(&p)).unwrap();
        for _ in 0..300 {
            let f = DMatrix::identity(n, n) + 0.2 * DMatrix::from_fn(n, n, |_, _| rng.random_range(-1.0..1.0));
            let q = definite(&mut rng, n);
            let m = rng.random_range(1..4);
            let h = DMatrix::from_fn(m, n, |_, _| rng.random_range(-1.0..1.0));
            let r = definite(&mut rng, m);
            let z = DVector::from_fn(m, |_, _| rng.random_range(-5.0..5.0));
            let apply = |a: &DMatrix<f64>, x: &[f64], out: &mut [f64]| {
                out.copy_from_slice((a * DVector::from_column_slice(x)).as_slice());
                Ok::<_, Error>(())
            };
            plain.predict(&f, &q);
            unscented.predict(|x, out| apply(&f, x, out), &row_major(&q)).unwrap();
            let moved = &f * DVector::from_column_slice(extended.estimate().mean());
            extended.predict(moved.as_slice(), &row_major(&f), &row_major(&q)).unwrap();
            let nis = plain.update(&z, &h, &r);
            unscented.update(z.as_slice(), |x, out| apply(&h, x, out), &row_major(&r), None).unwrap();
            let expected = &h * DVector::from_column_slice(extended.estimate().mean());
            extended.update(z.as_slice(), expected.as_slice(), &row_major(&h), &row_major(&r), None).unwrap();
            for (estimate, innovation) in [
                (unscented.estimate(), unscented.innovation().unwrap()),
                (extended.estimate(), extended.innovation().unwrap()),
            ] {
                let size = plain.x.amax().max(1.0);
                assert!((estimate.mean.clone() - &plain.x).amax() < 1e-9 * size);
                assert!((estimate.covariance() - &plain.p).amax() < 1e-9 * plain.p.amax().max(1.0));
                assert!((innovation.nis - nis).abs() < 1e-8 * nis.max(1.0), "{} {nis}", innovation.nis);
            }
        }
    }
}

#[test]
fn covariance_stays_positive_definite_under_adversity() {
    let mut rng = Pcg64::seed_from_u64(2);
    let mut steps = 0_u32;
    while steps < 100_000 {
        let n = rng.random_range(1..5);
        let spread: Vec<f64> = (0..n).map(|_| 10_f64.powf(rng.random_range(-12.0..12.0))).collect();
        let p = DMatrix::from_diagonal(&DVector::from_vec(spread));
        let start: Vec<f64> = (0..n).map(|_| rng.random_range(-1e3..1e3)).collect();
        let mut filter = UnscentedKalmanFilter::new(&start, &row_major(&p), Scaling::default()).unwrap();
        for _ in 0..50 {
            steps += 1;
            let q = if rng.random_bool(0.5) { 0.0 } else { 10_f64.powf(rng.random_range(-15.0..3.0)) };
            let q = DMatrix::from_diagonal_element(n, n, q);
            let bend = 10_f64.powf(rng.random_range(-9.0..0.0));
            let m = rng.random_range(1..4);
            let r = if rng.random_bool(0.2) { 0.0 } else { 10_f64.powf(rng.random_range(-30.0..2.0)) };
            let r = DMatrix::from_diagonal_element(m, m, r);
            let rate = rng.random_range(0.5..2.0);
            let motion = |x: &[f64], out: &mut [f64]| {
                for i in 0..x.len() {
                    out[i] = rate * x[i] + (bend * x[(i + 1) % x.len()]).sin();
                }
                Ok::<_, Error>(())
            };
            let sight = |x: &[f64], out: &mut [f64]| {
                for (k, o) in out.iter_mut().enumerate() {
                    *o = x.iter().enumerate().map(|(i, v)| ((i + k) as f64).cos() * v + (bend * v).cos()).sum();
                }
                Ok::<_, Error>(())
            };
            let z: Vec<f64> = (0..m).map(|_| rng.random_range(-1e3..1e3)).collect();
            for result in
                [filter.predict(motion, &row_major(&q)), filter.update(&z, sight, &row_major(&r), None).map(|_| ())]
            {
                assert!(matches!(result, Ok(()) | Err(Error::NotPositiveDefinite { .. })), "{result:?}");
            }
            let p = filter.estimate().covariance();
            assert!(p.iter().all(|v| v.is_finite()) && filter.estimate().mean().iter().all(|v| v.is_finite()));
            assert!(p == p.transpose() && nalgebra::Cholesky::new(p.clone()).is_some(), "{steps}: {p}");
        }
    }
}

#[test]
fn a_gate_refuses_and_changes_nothing() {
    let mut filter = UnscentedKalmanFilter::new(&[0.0], &[1.0], Scaling::default()).unwrap();
    let before = filter.estimate().clone();
    let same = |x: &[f64], out: &mut [f64]| {
        out[0] = x[0];
        Ok::<_, Error>(())
    };
    assert!(!filter.update(&[10.0], same, &[1.0], Some(9.0)).unwrap().accepted);
    assert_eq!(filter.estimate(), &before);
    assert!(filter.update(&[1.0], same, &[1.0], Some(9.0)).unwrap().accepted);
}

#[test]
fn bad_models_are_errors_and_leave_the_state_alone() {
    let mut filter = UnscentedKalmanFilter::new(&[0.0, 0.0], &[1.0, 0.0, 0.0, 1.0], Scaling::default()).unwrap();
    let before = filter.clone();
    let broken = |_: &[f64], out: &mut [f64]| {
        out.fill(f64::NAN);
        Ok::<_, Error>(())
    };
    assert!(matches!(filter.predict(broken, &[0.0; 4]), Err(Error::NotFinite { .. })));
    assert!(matches!(filter.update(&[1.0], broken, &[1.0], None), Err(Error::NotFinite { .. })));
    let blind = |_: &[f64], out: &mut [f64]| {
        out.fill(0.0);
        Ok::<_, Error>(())
    };
    assert!(matches!(filter.update(&[1.0], blind, &[0.0], None), Err(Error::NotPositiveDefinite { .. })));
    assert!(matches!(filter.update(&[f64::NAN], blind, &[1.0], None), Err(Error::NotFinite { .. })));
    assert!(matches!(filter.update(&[], blind, &[], None), Err(Error::Shape { .. })));
    assert!(matches!(filter.predict(blind, &[0.0; 3]), Err(Error::Shape { .. })));
    assert_eq!(filter, before);
    assert!(UnscentedKalmanFilter::new(&[0.0], &[1.0], Scaling { alpha: 0.0, ..Scaling::default() }).is_err());
    assert!(UnscentedKalmanFilter::new(&[0.0], &[1.0], Scaling { kappa: -1.0, ..Scaling::default() }).is_err());
}
