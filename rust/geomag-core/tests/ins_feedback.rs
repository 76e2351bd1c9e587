//! INS feedback judged by its own covariance.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use geomag_core::error::Error;
use geomag_core::navigation::ins_feedback::{CorrectedPosition, InsErrorModel, InsFeedback};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

/// An INS whose error follows the model, integrated twenty times finer than it is told.
struct Drift {
    rng: Pcg64,
    model: InsErrorModel,
    position: [f64; 2],
    velocity: [f64; 2],
    heading: f64,
}

impl Drift {
    fn new(seed: u64, model: InsErrorModel) -> Self {
        let mut d =
            Self { rng: Pcg64::seed_from_u64(seed), model, position: [0.0; 2], velocity: [0.0; 2], heading: 0.0 };
        d.position = [0, 1].map(|_| model.position_sigma_m * d.z());
        d.velocity = [0, 1].map(|_| model.velocity_sigma_m_s * d.z());
        d.heading = model.heading_sigma_deg.to_radians() * d.z();
        d
    }

    fn z(&mut self) -> f64 {
        StandardNormal.sample(&mut self.rng)
    }

    fn advance(&mut self, dt: f64, moved: [f64; 2]) {
        let steps = 20;
        let d = dt / f64::from(steps);
        let decay = (-d / self.model.velocity_time_constant_s).exp();
        for _ in 0..steps {
            let turned = [moved[1], -moved[0]];
            for (i, turned) in turned.into_iter().enumerate() {
                let walk = self.model.position_walk_m_sqrt_s * d.sqrt() * self.z();
                self.position[i] += self.velocity[i] * d + self.heading * turned / f64::from(steps) + walk;
            }
            for i in 0..2 {
                self.velocity[i] = decay * self.velocity[i] + self.model.velocity_walk_m_s_sqrt_s * d.sqrt() * self.z();
            }
            self.heading += self.model.heading_walk_deg_sqrt_s.to_radians() * d.sqrt() * self.z();
        }
    }
}

fn normalised(c: &CorrectedPosition, truth: [f64; 2]) -> f64 {
    let [e, n] = [c.offset_m[0] - truth[0], c.offset_m[1] - truth[1]];
    let [[a, b], [_, d]] = c.covariance_m2;
    (d * e * e - 2.0 * b * e * n + a * n * n) / (a * d - b * b)
}

#[test]
fn six_hours_of_drift_with_good_poor_and_wrong_fixes() {
    for time_constant in [f64::INFINITY, 5000.0] {
        let model = InsErrorModel { velocity_time_constant_s: time_constant, ..Default::default() };
        let (mut sum, mut count, mut wrong_used, mut wrong, mut good, mut good_used) = (0.0, 0.0, 0, 0, 0, 0);
        for run in 0..60 {
            let mut ins = Drift::new(run, model);
            let mut feedback = InsFeedback::new(model, false, 0.999).unwrap();
            let (mut x, mut y) = (0.0, 0.0);
            for k in 0..360 {
                let moved = if k == 0 {
                    [0.0; 2]
                } else {
                    let course = f64::from(k) / 60.0;
                    [600.0 * course.sin(), 600.0 * course.cos()]
                };
                if k > 0 {
                    ins.advance(60.0, moved);
                }
                x += moved[0];
                y += moved[1];
                let mut is_wrong = false;
                let fix = (k % 10 == 9).then(|| {
                    let sigma = [50.0, 150.0, 500.0][(3.0 * ins.rng.random::<f64>()) as usize];
                    is_wrong = ins.rng.random::<f64>() < 0.1;
                    let far = if is_wrong { 6000.0 } else { 0.0 };
                    let (sin, cos) = (std::f64::consts::TAU * ins.rng.random::<f64>()).sin_cos();
                    let e = ins.position[0] + sigma * ins.z() + far * sin;
                    let n = ins.position[1] + sigma * ins.z() + far * cos;
                    ([e, n], [[sigma * sigma, 0.0], [0.0, sigma * sigma]])
                });
                let step = feedback.step(60.0 * f64::from(k), x, y, fix).unwrap();
                if fix.is_some() {
                    wrong += usize::from(is_wrong);
                    wrong_used += usize::from(is_wrong && step.accepted);
                    good += usize::from(!is_wrong);
                    good_used += usize::from(!is_wrong && step.accepted);
                }
                if k == 60 || k == 180 || k == 359 {
                    sum += normalised(&step.after, ins.position);
                    count += 1.0;
                }
            }
        }
        // Mean of 180 nearly independent chi-square variables of two degrees of freedom: 2, standard deviation 0.15.
        let mean = sum / count;
        assert!((mean - 2.0_f64).abs() < 0.6, "normalised error {mean}, time constant {time_constant}");
        assert_eq!(wrong_used, 0, "of {wrong} wrong fixes");
        assert!(good_used as f64 > 0.99 * good as f64, "{good_used} of {good} good fixes used");
    }
}

#[test]
fn without_a_fix_the_covariance_grows_and_nothing_else_changes() {
    let mut feedback = InsFeedback::new(InsErrorModel::default(), true, 0.999).unwrap();
    let first = feedback.step(0.0, 16.0, 34.0, None).unwrap();
    let later = feedback.step(3600.0, 16.3, 34.1, None).unwrap();
    assert_eq!((later.after.x, later.after.y), (16.3, 34.1));
    assert!(later.after.covariance_m2[0][0] > 4.0 * first.after.covariance_m2[0][0]);
    assert_eq!(later.nis, None);
}

#[test]
fn a_refused_step_leaves_the_filter_as_it_was() {
    let mut feedback = InsFeedback::new(InsErrorModel::default(), false, 0.999).unwrap();
    feedback.step(10.0, 0.0, 0.0, None).unwrap();
    let before = feedback.clone();
    assert!(matches!(feedback.step(10.0, 1.0, 0.0, None), Err(Error::Invalid { .. })));
    assert!(matches!(feedback.step(20.0, f64::NAN, 0.0, None), Err(Error::NotFinite { .. })));
    let singular = ([0.0; 2], [[1.0, 1.0], [1.0, 1.0]]);
    assert!(matches!(feedback.step(20.0, 0.0, 0.0, Some(singular)), Err(Error::NotPositiveDefinite { .. })));
    let lopsided = ([0.0; 2], [[100.0, 30.0], [-30.0, 100.0]]);
    assert!(matches!(feedback.step(20.0, 0.0, 0.0, Some(lopsided)), Err(Error::Invalid { .. })));
    assert_eq!(feedback, before);
    assert!(InsFeedback::new(InsErrorModel { position_sigma_m: -1.0, ..Default::default() }, false, 0.9).is_err());
    assert!(InsFeedback::new(InsErrorModel::default(), false, 1.0).is_err());
}
