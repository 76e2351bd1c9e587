use std::sync::Arc;

use approx::assert_relative_eq;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::basis::Basis;
use super::*;
use crate::field::Field;
use crate::frame::Earth;
use crate::grid::Axis;
use crate::monitor::{Monitor, Quiet};

const HALF: f64 = 5e4;

struct Stop;

impl Monitor for Stop {
    fn advance(&self, _: u64, _: u64) -> Result<()> {
        Err(Error::Interrupted)
    }
}

fn region() -> Region {
    Region { north_m: [-HALF, HALF], east_m: [-0.8 * HALF, 0.8 * HALF], down_m: [-8e3, 0.0] }
}

/// A model with fields of about 100 nT on every wavelength.
fn random_model(order: usize, seed: u64) -> RectangularHarmonicModel {
    let mut rng = Pcg64::seed_from_u64(seed);
    let periods = [1.3e5, 1.1e5];
    let mut coefficients = vec![12.0, -7.0, 30.0];
    for term in terms(order) {
        let u = (term.t as f64 / periods[0]).hypot(term.r as f64 / periods[1]) * std::f64::consts::TAU;
        coefficients.push(100.0 * rng.random_range(-1.0..1.0) / u / (order as f64));
    }
    RectangularHarmonicModel::new(order, periods, coefficients, region()).unwrap()
}

fn random_points(n: usize, seed: u64) -> [Vec<f64>; 3] {
    let mut rng = Pcg64::seed_from_u64(seed);
    let r = region();
    [r.north_m, r.east_m, r.down_m].map(|[a, b]| (0..n).map(|_| rng.random_range(a..b)).collect())
}

/// The specification's formulas, term by term.
fn oracle(model: &RectangularHarmonicModel, [x, y, z]: [f64; 3]) -> (f64, [f64; 3]) {
    let [v, w] = model.periods_m().map(|p| std::f64::consts::TAU / p);
    let c = model.coefficients();
    let mut potential = c[0] * x + c[1] * y + c[2] * z;
    let mut field = [-c[0], -c[1], -c[2]];
    for (term, &c) in terms(model.order()).zip(&c[3..]) {
        let (tv, rw) = (term.t as f64 * v, term.r as f64 * w);
        let u = tv.hypot(rw);
        let ((sx, cx), (sy, cy)) = ((tv * x).sin_cos(), (rw * y).sin_cos());
        let (fx, dx) = if term.sine_x { (sx, tv * cx) } else { (cx, -tv * sx) };
        let (fy, dy) = if term.sine_y { (sy, rw * cy) } else { (cy, -rw * sy) };
        let e = (u * z).exp();
        potential += c * fx * fy * e;
        field[0] -= c * dx * fy * e;
        field[1] -= c * fx * dy * e;
        field[2] -= c * u * fx * fy * e;
    }
    (potential, field)
}

fn observed(model: &RectangularHarmonicModel, n: usize, seed: u64) -> Observations {
    let [north, east, down] = random_points(n, seed);
    let positions = Positions::new(&north, &east, &down).unwrap();
    let mut observations = Observations::new();
    observations.vector(&positions, &model.field(&positions, true), &[]).unwrap();
    observations
}

fn same_periods(model: &RectangularHarmonicModel) -> FitOptions {
    FitOptions {
        order: model.order(),
        period: Period::Metres(model.periods_m()),
        regularisation: Regularisation::Ridge(0.0),
        ..FitOptions::default()
    }
}

#[test]
fn agrees_with_the_formulas_term_by_term() {
    for order in [0, 1, 2, 5, 18] {
        let model = random_model(order, 3);
        let [north, east, down] = random_points(37, 4);
        let positions = Positions::new(&north, &east, &down).unwrap();
        for (i, e) in model.evaluate(&positions, false).iter().enumerate() {
            let (potential, field) = oracle(&model, positions.at(i));
            assert_relative_eq!(e.potential, potential, epsilon = 1e-6, max_relative = 1e-12);
            for (found, expected) in e.field.iter().zip(field) {
                assert_relative_eq!(*found, expected, epsilon = 1e-10);
            }
            assert_eq!(model.field_at(positions.at(i)), model.field(&positions, false)[i]);
        }
    }
}

#[test]
fn field_is_minus_the_gradient_of_the_potential() {
    let model = random_model(7, 11);
    let [north, east, down] = random_points(20, 12);
    let step = 3.0;
    for i in 0..20 {
        let p = [0.98 * north[i], 0.98 * east[i], down[i] - 100.0];
        let e = model.evaluate_at(p);
        for k in 0..3 {
            let (mut ahead, mut behind) = (p, p);
            ahead[k] += step;
            behind[k] -= step;
            let (a, b) = (model.evaluate_at(ahead), model.evaluate_at(behind));
            let slope = -(a.potential - b.potential) / (2.0 * step);
            assert!((slope - e.field[k]).abs() < 1e-4, "{slope} {}", e.field[k]);
            for c in 0..3 {
                let slope = (a.field[c] - b.field[c]) / (2.0 * step);
                assert!((slope - e.gradient[c][k]).abs() < 1e-8, "{slope} {}", e.gradient[c][k]);
            }
        }
    }
}

#[test]
fn gradient_is_symmetric_and_traceless() {
    let model = random_model(18, 5);
    let [north, east, down] = random_points(50, 6);
    let positions = Positions::new(&north, &east, &down).unwrap();
    for g in model.gradient(&positions, false) {
        let size = g.as_flattened().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        assert!((g[0][0] + g[1][1] + g[2][2]).abs() < 1e-14 * size);
        assert!((0..3).all(|i| (0..3).all(|j| g[i][j] == g[j][i])));
    }
}

#[test]
fn grid_and_points_agree() {
    for (rows, columns) in [(1_u16, 1_u16), (7, 5), (33, 70)] {
        let model = random_model(9, 21);
        let north: Vec<f64> = (0..rows).map(|i| -4e4 + 1.9e3 * f64::from(i)).collect();
        let east: Vec<f64> = (0..columns).map(|j| -4.1e4 + 1.2e3 * f64::from(j)).collect();
        let grid = model.field_grid(&north, &east, -1234.5, false).unwrap();
        for (k, node) in grid.iter().enumerate() {
            let point = model.field_at([north[k / east.len()], east[k % east.len()], -1234.5]);
            for c in 0..3 {
                assert!(
                    (node[c] - point[c]).abs() < 1e-10 || (node[c].is_nan() && point[c].is_nan()),
                    "{k}: {node:?} {point:?}"
                );
            }
        }
    }
}

#[test]
fn known_coefficients_come_back() {
    for order in [1, 4, 9] {
        let model = random_model(order, 31);
        let fitted = fit(&observed(&model, 3000, 32), &same_periods(&model), &Quiet).unwrap();
        let size = model.coefficients().iter().fold(0.0_f64, |m, c| m.max(c.abs()));
        for (a, b) in fitted.coefficients().iter().zip(model.coefficients()) {
            assert!((a - b).abs() < 1e-9 * size, "{order}: {a} {b}");
        }
        assert!(fitted.summary().unwrap().residual_rms < 1e-9);
    }
}

#[test]
fn mixtures_with_holes_weights_and_intensities_come_back() {
    let model = random_model(4, 41);
    let mut rng = Pcg64::seed_from_u64(42);
    let [north, east, down] = random_points(600, 43);
    let positions = Positions::new(&north, &east, &down).unwrap();
    let field = model.field(&positions, true);
    let main = [[31e3, -2e3, 38e3]];
    let mut observations = Observations::new();
    let holes: Vec<[f64; 3]> =
        field.iter().map(|f| f.map(|c| if rng.random_bool(0.3) { f64::NAN } else { c })).collect();
    observations.vector(&positions, &holes, &[2.0]).unwrap();
    let intensity: Vec<f64> = model.intensity(&positions, main[0], true);
    observations.intensity(&positions, &intensity, &main, &[0.5]).unwrap();
    let length = (main[0].iter().map(|c| c * c).sum::<f64>()).sqrt();
    let anomaly: Vec<f64> = field.iter().map(|f| (0..3).map(|i| f[i] * main[0][i]).sum::<f64>() / length).collect();
    observations.anomaly(&positions, &anomaly, &main, &[]).unwrap();
    let fitted = fit(&observations, &same_periods(&model), &Quiet).unwrap();
    let summary = fitted.summary().unwrap();
    assert!(summary.converged && summary.iterations <= 6, "{summary:?}");
    let size = model.coefficients().iter().fold(0.0_f64, |m, c| m.max(c.abs()));
    for (a, b) in fitted.coefficients().iter().zip(model.coefficients()) {
        assert!((a - b).abs() < 1e-8 * size, "{a} {b}");
    }
}

#[test]
fn huber_shrugs_off_outliers() {
    let model = random_model(3, 51);
    let mut observations = observed(&model, 400, 52);
    for row in observations.rows.iter_mut().step_by(17) {
        row.value += 4000.0;
    }
    let plain = fit(&observations, &same_periods(&model), &Quiet).unwrap();
    let robust = FitOptions { huber: Some(1.345), max_iterations: 60, ..same_periods(&model) };
    let robust = fit(&observations, &robust, &Quiet).unwrap();
    let point = [1e4, -5e3, -2e3];
    let error = |m: &RectangularHarmonicModel| {
        let (a, b) = (m.field_at(point), model.field_at(point));
        (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
    };
    assert!(error(&robust) < 0.05 * error(&plain), "{} {}", error(&robust), error(&plain));
}

#[test]
fn ridge_and_truncation_settle_what_least_squares_cannot() {
    let model = random_model(6, 61);
    let observations = observed(&model, 300, 62);
    let with = |period, regularisation| {
        fit(&observations, &FitOptions { order: 12, period, regularisation, ..FitOptions::default() }, &Quiet)
    };
    let wide = Period::Ratio(4.0);
    assert!(matches!(with(wide, Regularisation::Ridge(0.0)), Err(Error::RankDeficient { .. })));
    for regularisation in [Regularisation::Ridge(1e-9), Regularisation::TruncatedSvd(1e-5)] {
        let fitted = with(Period::Ratio(1.4), regularisation).unwrap();
        let summary = fitted.summary().unwrap();
        assert!(summary.effective_parameters <= 315.0 && summary.effective_parameters > 50.0, "{summary:?}");
        assert!(summary.residual_rms < 1.0, "{summary:?}");
    }
}

#[test]
fn sigma_is_that_of_the_errors() {
    // 60 fits of the same field with fresh noise: the errors over sigma have unit variance.
    let model = random_model(2, 71);
    let [north, east, down] = random_points(200, 72);
    let positions = Positions::new(&north, &east, &down).unwrap();
    let truth = model.field(&positions, true);
    let probe = [[1e4, -4e4], [3e4, 2e4], [-1e3, -7e3]];
    let probes = Positions::new(&probe[0], &probe[1], &probe[2]).unwrap();
    let expected = model.field(&probes, false);
    let mut rng = Pcg64::seed_from_u64(73);
    let (mut sum, mut count) = (0.0, 0.0);
    for _ in 0..60 {
        let noisy: Vec<[f64; 3]> =
            truth.iter().map(|f| f.map(|c| c + 5.0 * rng.sample::<f64, _>(rand_distr::StandardNormal))).collect();
        let mut observations = Observations::new();
        observations.vector(&positions, &noisy, &[5.0]).unwrap();
        let fitted = fit(&observations, &same_periods(&model), &Quiet).unwrap();
        assert_relative_eq!(fitted.summary().unwrap().unit_sigma, 1.0, epsilon = 0.12);
        let (found, sigma) = (fitted.field(&probes, false), fitted.sigma(&probes, false).unwrap());
        for i in 0..probes.len() {
            for c in 0..3 {
                sum += ((found[i][c] - expected[i][c]) / sigma[i][c]).powi(2);
                count += 1.0;
            }
        }
    }
    // 360 squares, correlated within a fit: 0.13 is some two standard deviations.
    assert_relative_eq!(sum / count, 1.0, epsilon = 0.13);
}

#[test]
fn same_bits_for_any_number_of_threads() {
    let model = random_model(6, 81);
    let observations = observed(&model, 4000, 82);
    let options = FitOptions { order: 8, ..FitOptions::default() };
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fit(&observations, &options, &Quiet).unwrap())
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn saved_models_come_back_bit_for_bit() {
    let model = random_model(5, 91);
    let frame = LocalFrame::new(33.0, 118.0, 10.0, Earth::Wgs84).unwrap();
    let options = FitOptions { frame: Some(frame), unit: "mGal".into(), ..same_periods(&model) };
    let fitted = fit(&observed(&model, 200, 92), &options, &Quiet).unwrap();
    assert_eq!(RectangularHarmonicModel::from_json(&fitted.to_json().unwrap()).unwrap(), fitted);
    let broken = fitted.to_json().unwrap().replace("\"version\":1", "\"version\":7");
    assert!(matches!(RectangularHarmonicModel::from_json(&broken), Err(Error::State { .. })));
    assert!(matches!(RectangularHarmonicModel::from_json("{}"), Err(Error::State { .. })));
    let cut = fitted.without_covariance().to_json().unwrap().replace("\"order\":5", "\"order\":6");
    assert!(matches!(RectangularHarmonicModel::from_json(&cut), Err(Error::Shape { .. })));
}

#[test]
fn cross_validation_finds_the_order() {
    let model = random_model(4, 101);
    let mut rng = Pcg64::seed_from_u64(102);
    let [north, east, down] = random_points(500, 103);
    let positions = Positions::new(&north, &east, &down).unwrap();
    let noisy: Vec<[f64; 3]> = model
        .field(&positions, true)
        .iter()
        .map(|f| f.map(|c| c + 3.0 * rng.sample::<f64, _>(rand_distr::StandardNormal)))
        .collect();
    let mut observations = Observations::new();
    observations.vector(&positions, &noisy, &[]).unwrap();
    let choice = SelectionOptions {
        orders: vec![2, 3, 4, 6, 8],
        period_ratios: vec![model.periods_m()[0] / (2.0 * HALF)],
        ridges: vec![1e-9, 1e-6],
        priors: vec![Prior::default()],
        folds: 5,
        groups: None,
        seed: 1,
    };
    let found = select(&observations, &choice, &FitOptions::default(), &Quiet).unwrap();
    assert_eq!(found.candidates.len(), 10);
    let best = found.candidates[found.best];
    assert!(best.order == 4 || best.order == 6, "{found:?}");
    assert!(best.rms > 2.8 && best.rms < 3.6, "{best:?}");
    assert!(select(&observations, &SelectionOptions { folds: 1, ..choice }, &FitOptions::default(), &Quiet).is_err());
}

#[test]
fn stands_where_a_map_stands() {
    let frame = LocalFrame::new(33.0, 118.0, 0.0, Earth::Wgs84).unwrap();
    let model = Arc::new(random_model(6, 111).with_frame(Some(frame)));
    let main = [31e3, -2e3, 38e3];
    for quantity in [Quantity::North, Quantity::Down, Quantity::Anomaly(main), Quantity::Projection(main)] {
        let map = HarmonicMap::at_height(Arc::clone(&model), quantity, 500.0).unwrap();
        assert!(map.geographic() && map.mean().is_finite());
        let grid = map.to_grid(Axis::new(117.9, 0.01, 21).unwrap(), Axis::new(32.9, 0.01, 21).unwrap()).unwrap();
        let (x, y) = (118.03, 33.04);
        assert_relative_eq!(grid.node(14, 13), map.value(x, y), epsilon = 1e-9);
        let (_, [east, north]) = map.value_and_gradient(x, y);
        let [de, dn] = map.metres_per_unit(y);
        let h = 1e-4;
        assert_relative_eq!((map.value(x + h, y) - map.value(x - h, y)) / (2.0 * h * de), east, epsilon = 3e-5);
        assert_relative_eq!((map.value(x, y + h) - map.value(x, y - h)) / (2.0 * h * dn), north, epsilon = 3e-5);
        assert!(map.value(125.0, 33.0).is_nan());
        assert_eq!(map.sigma(x, y), 0.0);
    }
    let plane = HarmonicMap::at_down(Arc::clone(&model), Quantity::Intensity(main), -100.0).unwrap();
    assert!(!plane.geographic());
    let total = model.field_at([200.0, 100.0, -100.0]);
    let length = (0..3).map(|i| (total[i] + main[i]).powi(2)).sum::<f64>().sqrt();
    assert_relative_eq!(plane.value(100.0, 200.0), length, epsilon = 1e-9);
}

#[test]
fn answers_only_where_it_knows() {
    let model = random_model(6, 121);
    assert!(model.field_at([0.0, 0.0, -1e6])[0].is_finite());
    assert!(model.field_at([0.0, 0.0, 5e3])[0].is_nan());
    assert!(model.field_at([0.0, 2.0 * HALF, 0.0])[0].is_nan());
    assert!(model.field_at([f64::NAN, 0.0, 0.0])[0].is_nan());
    let far = Positions::new(&[2.0 * HALF, f64::NAN, 0.0], &[0.0; 3], &[0.0, 0.0, 1e9]).unwrap();
    let field = model.field(&far, true);
    assert!(field[0][0].is_finite() && field[1][0].is_nan() && field[2][0].is_nan());
    assert!(model.sigma(&far, false).is_err());
}

#[test]
fn refuses_bad_input() {
    let model = random_model(3, 131);
    let observations = observed(&model, 100, 132);
    let fails = |o: FitOptions| fit(&observations, &o, &Quiet).unwrap_err();
    assert!(matches!(fails(FitOptions { order: 20, ..same_periods(&model) }), Error::TooFewSamples { .. }));
    assert!(matches!(fails(FitOptions { order: 90, ..same_periods(&model) }), Error::Invalid { .. }));
    let ratio = FitOptions { period: Period::Ratio(0.5), ..same_periods(&model) };
    assert!(matches!(fails(ratio), Error::Invalid { .. }));
    let negative = FitOptions { regularisation: Regularisation::Ridge(-1.0), ..same_periods(&model) };
    assert!(matches!(fails(negative), Error::Invalid { .. }));
    assert_eq!(fit(&observations, &same_periods(&model), &Stop).unwrap_err(), Error::Interrupted);
    let mut deep = Observations::new();
    let (x, z) = ([0.0, 1.0, 2.0, 3.0, 4.0], [1e7; 5]);
    deep.vector(&Positions::new(&x, &x, &z).unwrap(), &[[1.0; 3]; 5], &[]).unwrap();
    let small = FitOptions { order: 1, ..FitOptions::default() };
    assert!(matches!(fit(&deep, &small, &Quiet), Err(Error::Invalid { .. })));
    let mut bad = Observations::new();
    let positions = Positions::new(&x, &x, &x).unwrap();
    assert!(matches!(bad.vector(&positions, &[[f64::INFINITY; 3]; 5], &[]), Err(Error::NotFinite { .. })));
    assert!(matches!(bad.vector(&positions, &[[0.0; 3]; 4], &[]), Err(Error::Shape { .. })));
    assert!(matches!(bad.vector(&positions, &[[0.0; 3]; 5], &[0.0]), Err(Error::Invalid { .. })));
    assert!(matches!(bad.anomaly(&positions, &[0.0; 5], &[[0.0; 3]], &[]), Err(Error::Invalid { .. })));
}

#[test]
fn damping_keeps_what_lies_between_lines() {
    // Lines 4 km apart, waves down to 3 km: alike, waves that vanish between the lines are as good as those that do not.
    let truth = random_model(3, 141);
    let (mut north, mut east) = (Vec::new(), Vec::new());
    for line in 0..10 {
        for k in 0..60 {
            north.push(-2e4 + 4e3 * f64::from(line));
            east.push(-2e4 + 650.0 * f64::from(k));
        }
    }
    let down = vec![0.0; north.len()];
    let positions = Positions::new(&north, &east, &down).unwrap();
    let main = [[20e3, 1e3, 40e3]];
    let values: Vec<f64> =
        truth.field(&positions, true).iter().map(|f| (20.0 * f[0] + f[1] + 40.0 * f[2]) / 44.732_538).collect();
    let mut observations = Observations::new();
    observations.anomaly(&positions, &values, &main, &[]).unwrap();
    let between: Vec<f64> = north.iter().map(|n| n + 2e3).collect();
    let probes = Positions::new(&between, &east, &down).unwrap();
    let error = |damping_m: f64| {
        let options = FitOptions {
            order: 12,
            period: Period::Ratio(1.2),
            regularisation: Regularisation::Ridge(1e-6),
            prior: Prior { damping_m, ..Prior::default() },
            ..FitOptions::default()
        };
        let model = fit(&observations, &options, &Quiet).unwrap();
        let pairs = model.field(&probes, true).into_iter().zip(truth.field(&probes, true));
        let sum: f64 = pairs.map(|(a, b)| (a[2] - b[2]).powi(2)).sum();
        (sum / probes.len() as f64).sqrt()
    };
    let (alike, damped) = (error(0.0), error(4e3));
    assert!(damped < 0.2 * alike, "{damped} {alike}");
}

/// Lines of a field drawn from the prior itself, with noise: a coefficient of unit prior field has variance one.
fn drawn_from_the_prior(prior: Prior, noise: f64, seed: u64) -> (Observations, Vec<u64>) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut normal = || -> f64 { rand_distr::Distribution::sample(&rand_distr::StandardNormal, &mut rng) };
    let periods = [12e3, 12e3];
    let weights = Basis::new(8, periods).damping(prior);
    let mut coefficients = vec![0.0; 3];
    for (term, weight) in terms(8).zip(&weights[3..]) {
        let u = (term.t as f64).hypot(term.r as f64) * std::f64::consts::TAU / 12e3;
        coefficients.push(100.0 * normal() / u / weight.sqrt());
    }
    let region = Region { north_m: [-5e3, 5e3], east_m: [-5e3, 5e3], down_m: [0.0, 0.0] };
    let model = RectangularHarmonicModel::new(8, periods, coefficients, region).unwrap();
    let (mut north, mut east, mut groups) = (Vec::new(), Vec::new(), Vec::new());
    for line in 0..20_u32 {
        for k in 0..60 {
            north.push(-5e3 + 1e4 / 19.0 * f64::from(line));
            east.push(-5e3 + 1e4 / 59.0 * f64::from(k));
            groups.push(u64::from(line));
        }
    }
    let down = vec![0.0; north.len()];
    let positions = Positions::new(&north, &east, &down).unwrap();
    let main = [[2.0, 1.0, 4.0]];
    let values: Vec<f64> = (model.field(&positions, true).iter())
        .map(|b| (2.0 * b[0] + b[1] + 4.0 * b[2]) / 21_f64.sqrt() + noise * normal())
        .collect();
    let mut observations = Observations::new();
    observations.anomaly(&positions, &values, &main, &[]).unwrap();
    (observations, groups)
}

#[test]
fn the_prior_of_the_field_predicts_best_and_knows_how_well() {
    let truth = Prior { damping_m: 100.0, power: 3.0, anisotropy: 1.4 };
    let (observations, groups) = drawn_from_the_prior(truth, 2.0, 5);
    // Columns are scaled to unit norm: of a product of two waves of unit field that is about a quarter of 1,200 rows.
    let ridge = 2.0_f64.powi(2) / 100.0_f64.powi(2) / 300.0;
    let others = [
        Prior::default(),
        Prior { anisotropy: 1.0 / 1.4, ..truth },
        Prior { damping_m: 0.0, power: 0.5, anisotropy: 1.0 },
        truth,
    ];
    let choice = SelectionOptions {
        orders: vec![8],
        period_ratios: vec![1.2],
        ridges: vec![ridge],
        priors: others.to_vec(),
        folds: 5,
        groups: Some(groups.clone()),
        seed: 3,
    };
    let found = select(&observations, &choice, &FitOptions::default(), &Quiet).unwrap();
    assert_eq!(found.candidates[found.best].prior, truth, "{found:?}");

    let options = FitOptions {
        order: 8,
        period: Period::Ratio(1.2),
        regularisation: Regularisation::Ridge(ridge),
        prior: truth,
        ..FitOptions::default()
    };
    let (mut scaled, mut plain, mut count) = (0.0, 0.0, 0.0);
    for seed in 0..20 {
        let (observations, groups) = drawn_from_the_prior(truth, 2.0, 100 + seed);
        let left = leave_out(&observations, &options, 5, Some(&groups), 1, &Quiet).unwrap();
        for (e, s) in left.errors.iter().zip(&left.sigma) {
            // An observation has its noise, a prediction has not.
            plain += e * e / (s * s + 4.0);
            scaled += (e / left.misfit.sigma(*s)).powi(2);
            count += 1.0;
        }
    }
    // 20 draws of some hundred degrees of freedom left open each.
    assert!((plain / count - 1.0).abs() < 0.15, "{}", plain / count);
    assert!((scaled / count - 1.0).abs() < 1e-6, "{}", scaled / count);
}

#[test]
fn a_models_misfit_is_in_its_sigma_and_in_its_file() {
    let (observations, _) = drawn_from_the_prior(Prior::default(), 2.0, 9);
    let options = FitOptions { order: 6, ..FitOptions::default() };
    let model = fit(&observations, &options, &Quiet).unwrap();
    let positions = Positions::new(&[100.0], &[-300.0], &[0.0]).unwrap();
    let bare = model.sigma_along(&positions, &[[0.0, 0.0, 1.0]], false).unwrap()[0];
    let told = model.with_misfit(FieldMisfit { nugget: 3.0, scale: 2.0 });
    let more = told.sigma_along(&positions, &[[0.0, 0.0, 1.0]], false).unwrap()[0];
    assert_relative_eq!(more, 3.0_f64.hypot(2.0 * bare), max_relative = 1e-12);
    let text = told.to_json().unwrap();
    assert_eq!(RectangularHarmonicModel::from_json(&text).unwrap(), told);
    let old = text.replace(r#","misfit":{"nugget":3.0,"scale":2.0}"#, "");
    assert_ne!(old, text);
    assert_eq!(RectangularHarmonicModel::from_json(&old).unwrap().misfit(), FieldMisfit::default());
    assert!(RectangularHarmonicModel::from_json(&text.replace("\"scale\":2.0", "\"scale\":-2.0")).is_err());
}
