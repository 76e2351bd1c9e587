use std::f64::consts::TAU;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

use super::super::sensing::{Sensing, Sensor};
use super::*;
use crate::frame::{Earth, LocalFrame};
use crate::grid::{Axis, Interpolation};
use crate::harmonic::{HarmonicMap, Quantity, RectangularHarmonicModel, Region, terms};

/// Wavelengths of 100 to 500 m, about `gradient` nT/m rms a component.
fn model(gradient: f64, seed: u64) -> Arc<RectangularHarmonicModel> {
    let (order, period) = (10, 1000.0);
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut coefficients = vec![0.0; 3];
    for term in terms(order) {
        let u = TAU * (term.t as f64).hypot(term.r as f64) / period;
        let wanted = term.t + term.r >= 2;
        coefficients.push(if wanted { gradient / (5.0 * u * u) * rng.sample::<f64, _>(StandardNormal) } else { 0.0 });
    }
    let region = Region { north_m: [-600.0, 600.0], east_m: [-600.0, 600.0], down_m: [-50.0, 0.0] };
    Arc::new(RectangularHarmonicModel::new(order, [period, period], coefficients, region).unwrap())
}

fn start(seed: u64, sigma: f64) -> ([f64; 2], Pcg64) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let start = [100.0, 45.0].map(|c: f64| c + sigma * rng.sample::<f64, _>(StandardNormal));
    (start, rng)
}

fn options(start: [f64; 2], sigma: f64) -> FieldNavigatorOptions {
    FieldNavigatorOptions {
        start,
        covariance_m2: [[sigma * sigma, 0.0], [0.0, sigma * sigma]],
        reading_sigma: vec![3.0],
        gate: None,
        ..FieldNavigatorOptions::default()
    }
}

/// Sails 100 s with speed 2 m/s, course 60 degrees; the errors and the normalised errors of every step.
fn sail(sensing: &Sensing, options: FieldNavigatorOptions, rng: &mut Pcg64) -> Vec<(f64, f64)> {
    let q = options.position_noise_m2_s;
    let sigma = options.reading_sigma[0];
    let mut navigator = FieldNavigator::new(sensing.clone(), options).unwrap();
    let mut truth = [100.0, 45.0];
    let (sin, cos) = 60_f64.to_radians().sin_cos();
    (0..100)
        .map(|_| {
            for (c, step) in truth.iter_mut().zip([2.0 * sin, 2.0 * cos]) {
                *c += step + q.sqrt() * rng.sample::<f64, _>(StandardNormal);
            }
            let mut reading = vec![0.0; sensing.len()];
            sensing.read(&[truth], &mut reading);
            for r in &mut reading {
                *r += sigma * rng.sample::<f64, _>(StandardNormal);
            }
            let step = navigator.step(1.0, 2.0, 60.0, Some(&reading)).unwrap();
            let (e, n) = (truth[0] - step.x, truth[1] - step.y);
            let [[a, b], [_, d]] = step.covariance_m2;
            (e.hypot(n), (e * e * d - 2.0 * e * n * b + n * n * a) / (a * d - b * b))
        })
        .collect()
}

#[test]
fn normalised_errors_are_consistent_over_200_seeds() {
    for method in [FieldNavigatorMethod::Unscented, FieldNavigatorMethod::Extended] {
        let (mut sum, mut count) = (0.0, 0.0);
        for seed in 0..200 {
            let sensing = Sensing::at_down(model(3.0, seed), Sensor::Vector, 0.0).unwrap();
            let (start, mut rng) = start(1000 + seed, 1.4);
            let steps = sail(&sensing, FieldNavigatorOptions { method, ..options(start, 1.4) }, &mut rng);
            sum += steps[20..].iter().map(|s| s.1).sum::<f64>();
            count += 80.0;
        }
        // Chi-square with two degrees of freedom; the specification allows 1.7 to 2.4.
        let mean = sum / count;
        assert!((1.7..2.4).contains(&mean), "{method:?}: {mean}");
    }
}

#[test]
fn errors_are_near_the_bound() {
    let (mut sum, mut bound) = (0.0, 0.0);
    for seed in 0..40 {
        let sensing = Sensing::at_down(model(3.0, seed), Sensor::Vector, 0.0).unwrap();
        let (start, mut rng) = start(7000 + seed, 1.4);
        let navigator = FieldNavigator::new(sensing.clone(), options(start, 1.4)).unwrap();
        let (sin, cos) = 60_f64.to_radians().sin_cos();
        let path: Vec<[f64; 2]> =
            (1..=100).map(|k| [100.0 + 2.0 * sin * f64::from(k), 45.0 + 2.0 * cos * f64::from(k)]).collect();
        let bounds = navigator.bound(&path, 1.0, 2.0, 60.0).unwrap();
        bound += bounds[20..].iter().map(|b| b[0][0] + b[1][1]).sum::<f64>();
        sum += sail(&sensing, options(start, 1.4), &mut rng)[20..].iter().map(|s| s.0 * s.0).sum::<f64>();
    }
    let ratio = (sum / bound).sqrt();
    assert!((0.9..1.25).contains(&ratio), "{ratio}");
}

#[test]
fn finds_speed_heading_and_bias() {
    let sensing = Sensing::at_down(model(3.0, 5), Sensor::Vector, 0.0).unwrap();
    for method in [FieldNavigatorMethod::Unscented, FieldNavigatorMethod::Extended] {
        let options = FieldNavigatorOptions {
            speed_sigma_m_s: 0.3,
            heading_sigma_deg: 5.0,
            bias_sigma: 20.0,
            method,
            ..options([101.0, 44.0], 2.0)
        };
        let mut navigator = FieldNavigator::new(sensing.clone(), options).unwrap();
        let mut truth = [100.0, 45.0];
        let mut rng = Pcg64::seed_from_u64(9);
        let (sin, cos) = 63_f64.to_radians().sin_cos();
        for _ in 0..200 {
            truth = [truth[0] + 2.2 * sin, truth[1] + 2.2 * cos];
            let mut reading = [0.0; 3];
            sensing.read(&[truth], &mut reading);
            for (r, bias) in reading.iter_mut().zip([12.0, -15.0, 8.0]) {
                *r += bias + 3.0 * rng.sample::<f64, _>(StandardNormal);
            }
            navigator.step(1.0, 2.0, 60.0, Some(&reading)).unwrap();
        }
        let near = |(value, sigma): (f64, f64), expected: f64| (value - expected).abs() < 4.0 * sigma && sigma > 0.0;
        assert!(near(navigator.speed_error_m_s().unwrap(), 0.2), "{:?}", navigator.speed_error_m_s());
        assert!(near(navigator.heading_error_deg().unwrap(), 3.0), "{:?}", navigator.heading_error_deg());
        for (bias, expected) in navigator.bias().into_iter().zip([12.0, -15.0, 8.0]) {
            assert!(near(bias, expected), "{bias:?} {expected}");
        }
        let [x, y] = navigator.position();
        assert!((x - truth[0]).hypot(y - truth[1]) < 2.0);
    }
}

#[test]
fn scalar_maps_and_models_give_the_same_track() {
    let model = model(1.0, 11);
    let main = [20_000.0, 1000.0, 40_000.0];
    let quantity = Quantity::Anomaly(main);
    let map = HarmonicMap::at_down(Arc::clone(&model), quantity, 0.0).unwrap();
    let axis = Axis::new(-500.0, 2.0, 501).unwrap();
    let grid = Arc::new(map.to_grid(axis, axis).unwrap());
    let run = |sensing: Sensing| {
        let mut navigator = FieldNavigator::new(sensing, options([103.0, 43.0], 3.0)).unwrap();
        let direct = Sensing::at_down(Arc::clone(&model), Sensor::Scalar(quantity), 0.0).unwrap();
        for k in 1..=60 {
            let mut reading = [0.0];
            direct.read(&[[100.0 + f64::from(k), 45.0]], &mut reading);
            navigator.step(1.0, 1.0, 90.0, Some(&reading)).unwrap();
        }
        navigator.position()
    };
    let on_model = run(Sensing::at_down(Arc::clone(&model), Sensor::Scalar(quantity), 0.0).unwrap());
    let on_grid = run(Sensing::map(grid, Interpolation::Bicubic));
    let on_adapter = run(Sensing::map(Arc::new(map), Interpolation::Bicubic));
    assert!((on_model[0] - on_grid[0]).hypot(on_model[1] - on_grid[1]) < 0.02, "{on_model:?} {on_grid:?}");
    assert!((on_model[0] - on_adapter[0]).hypot(on_model[1] - on_adapter[1]) < 1e-9);
    assert!((on_model[0] - 160.0).hypot(on_model[1] - 45.0) < 3.0, "{on_model:?}");
}

#[test]
fn geographic_fields_are_sailed_in_metres() {
    let frame = LocalFrame::new(60.0, 179.999, 0.0, Earth::Wgs84).unwrap();
    let metric = model(3.0, 13);
    let geographic = Arc::new((*metric).clone().with_frame(Some(frame)));
    let sensing = Sensing::at_height(geographic, Sensor::Vector, 0.0).unwrap();
    let [latitude, longitude, _] = frame.inverse([45.0, 100.0, 0.0]);
    let mut navigator = FieldNavigator::new(
        sensing.clone(),
        options([longitude - 360.0 + 2.0 / 55_000.0, latitude - 2.0 / 111_000.0], 3.0),
    )
    .unwrap();
    for k in 1..=100 {
        let [latitude, longitude, _] = frame.inverse([45.0 + f64::from(k), 100.0 + f64::from(k), 0.0]);
        let mut reading = [0.0; 3];
        sensing.read(&[[longitude, latitude]], &mut reading);
        navigator.step(1.0, 2_f64.sqrt(), 45.0, Some(&reading)).unwrap();
    }
    let [x, y] = navigator.position();
    let [north, east, _] = frame.forward(y, x, 0.0);
    assert!((north - 145.0).hypot(east - 200.0) < 0.5, "{north} {east}");
    assert!(x > 180.0, "on the turn of the frame: {x}");
}

#[test]
fn outages_gates_and_edges_are_told_apart() {
    let sensing = Sensing::at_down(model(3.0, 17), Sensor::Vector, 0.0).unwrap();
    let gated = FieldNavigatorOptions { gate: Some(0.999), ..options([100.0, 45.0], 1.0) };
    let mut navigator = FieldNavigator::new(sensing.clone(), gated.clone()).unwrap();
    assert_eq!(navigator.step(1.0, 2.0, 60.0, None).unwrap().outcome, FieldNavigatorOutcome::Predicted);
    let step = navigator.step(1.0, 2.0, 60.0, Some(&[f64::NAN; 3])).unwrap();
    assert_eq!((step.outcome, step.nis), (FieldNavigatorOutcome::Predicted, None));
    let mut reading = [0.0; 3];
    sensing.read(&[navigator.position()], &mut reading);
    reading[1] = f64::NAN;
    let step = navigator.step(0.0, 2.0, 60.0, Some(&reading)).unwrap();
    assert_eq!((step.outcome, step.dof), (FieldNavigatorOutcome::Updated, 2));
    for k in 0..10 {
        let step = navigator.step(1.0, 2.0, 60.0, Some(&[9e3, 9e3, 9e3])).unwrap();
        assert_eq!(step.outcome, FieldNavigatorOutcome::Rejected);
        assert_eq!(step.diverged, k == 9);
    }
    let away = FieldNavigatorOptions { start: [5000.0, 0.0], ..gated };
    let mut outside = FieldNavigator::new(sensing, away).unwrap();
    assert_eq!(outside.step(1.0, 2.0, 60.0, Some(&[0.0; 3])).unwrap().outcome, FieldNavigatorOutcome::OffField);
}

#[test]
fn divergence_shows_in_the_innovations() {
    let sensing = Sensing::at_down(model(3.0, 19), Sensor::Vector, 0.0).unwrap();
    let lost = FieldNavigatorOptions {
        covariance_m2: [[0.01, 0.0], [0.0, 0.01]],
        position_noise_m2_s: 1e-6,
        ..options([300.0, -200.0], 1.0)
    };
    let mut navigator = FieldNavigator::new(sensing.clone(), lost).unwrap();
    let mut diverged = false;
    for k in 1..=30 {
        let mut reading = [0.0; 3];
        sensing.read(&[[100.0 + f64::from(k), 45.0]], &mut reading);
        diverged |= navigator.step(1.0, 1.0, 90.0, Some(&reading)).unwrap().diverged;
    }
    assert!(diverged);
}

#[test]
fn goes_on_bit_for_bit_after_a_save() {
    let sensing = Sensing::at_down(model(3.0, 23), Sensor::Vector, 0.0).unwrap();
    for method in [FieldNavigatorMethod::Unscented, FieldNavigatorMethod::Extended] {
        let options = FieldNavigatorOptions { method, bias_sigma: 3.0, ..options([101.0, 46.0], 2.0) };
        let mut first = FieldNavigator::new(sensing.clone(), options).unwrap();
        let step = |navigator: &mut FieldNavigator, k: u32| {
            let mut reading = [0.0; 3];
            sensing.read(&[[100.0 + f64::from(k), 45.0]], &mut reading);
            navigator.step(1.0, 1.0, 90.0, Some(&reading)).unwrap()
        };
        for k in 1..30 {
            step(&mut first, k);
        }
        let mut second = FieldNavigator::restore(sensing.clone(), &first.save().unwrap()).unwrap();
        for k in 30..60 {
            assert_eq!(step(&mut first, k), step(&mut second, k));
        }
        let scalar = Sensing::at_down(model(3.0, 23), Sensor::Scalar(Quantity::Down), 0.0).unwrap();
        assert!(matches!(FieldNavigator::restore(scalar, &first.save().unwrap()), Err(Error::State { .. })));
    }
}

#[test]
fn refuses_bad_input() {
    let sensing = Sensing::at_down(model(3.0, 29), Sensor::Vector, 0.0).unwrap();
    let make = |o| FieldNavigator::new(sensing.clone(), o);
    let good = options([100.0, 45.0], 1.0);
    assert!(make(FieldNavigatorOptions { position_noise_m2_s: -1.0, ..good.clone() }).is_err());
    assert!(make(FieldNavigatorOptions { reading_sigma: vec![1.0, 2.0], ..good.clone() }).is_err());
    assert!(make(FieldNavigatorOptions { covariance_m2: [[1.0, 2.0], [2.0, 1.0]], ..good.clone() }).is_err());
    assert!(make(FieldNavigatorOptions { gate: Some(1.0), ..good.clone() }).is_err());
    assert!(make(FieldNavigatorOptions { start: [f64::NAN, 0.0], ..good.clone() }).is_err());
    let mut navigator = make(good).unwrap();
    assert!(matches!(navigator.step(-1.0, 0.0, 0.0, None), Err(Error::Invalid { .. })));
    assert!(matches!(navigator.step(1.0, f64::NAN, 0.0, None), Err(Error::NotFinite { .. })));
    assert!(matches!(navigator.step(1.0, 1.0, 0.0, Some(&[1.0])), Err(Error::Shape { .. })));
    assert!(matches!(navigator.step(1.0, 1.0, 0.0, Some(&[f64::INFINITY, 0.0, 0.0])), Err(Error::NotFinite { .. })));
    assert_eq!(navigator.steps(), 0);
}
