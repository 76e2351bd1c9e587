//! Evaluating and fitting rectangular harmonic models of order 18.
#![allow(missing_docs, clippy::unwrap_used)]

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use geomag_core::harmonic::{
    FitOptions, Observations, Period, Positions, RectangularHarmonicModel, Region, fit, terms,
};
use geomag_core::monitor::Quiet;

const HALF: f64 = 2e5;

/// Order 18 over 4 degrees, fields of some 100 nT, from a fixed sequence.
fn model() -> RectangularHarmonicModel {
    let periods = [6.6e5, 5.7e5];
    let mut coefficients = vec![10.0, -20.0, 30.0];
    for (k, term) in terms(18).enumerate() {
        let u = (term.t as f64 / periods[0]).hypot(term.r as f64 / periods[1]) * std::f64::consts::TAU;
        coefficients.push(10.0 * (1.7 * k as f64).sin() / u);
    }
    let region = Region { north_m: [-HALF, HALF], east_m: [-HALF, HALF], down_m: [-1e4, 7e3] };
    RectangularHarmonicModel::new(18, periods, coefficients, region).unwrap()
}

fn scattered(n: usize) -> [Vec<f64>; 3] {
    let golden = |k: usize, by: f64| (k as f64 * by).fract();
    [
        (0..n).map(|k| HALF * (2.0 * golden(k, 0.618_033_988) - 1.0)).collect(),
        (0..n).map(|k| HALF * (2.0 * golden(k, 0.754_877_666) - 1.0)).collect(),
        (0..n).map(|k| 7e3 - 1.7e4 * golden(k, 0.569_840_290)).collect(),
    ]
}

fn evaluate(c: &mut Criterion) {
    let model = model();
    let mut group = c.benchmark_group("harmonic order 18");
    group.bench_function("one point", |b| b.iter(|| model.field_at([1e4, -2e4, -500.0])));
    let [north, east, down] = scattered(8192);
    let positions = Positions::new(&north, &east, &down).unwrap();
    let oracle = model.field_at(positions.at(77));
    assert_eq!(model.field(&positions, false)[77], oracle);
    group.throughput(Throughput::Elements(8192));
    group.bench_function("field, scattered points", |b| b.iter(|| model.field(&positions, false)));
    group.bench_function("gradient, scattered points", |b| b.iter(|| model.gradient(&positions, false)));
    let axis: Vec<f64> = (0..500).map(|i| HALF * (2.0 * f64::from(i) / 499.0 - 1.0)).collect();
    group.throughput(Throughput::Elements(250_000));
    group
        .bench_function("field, 500 x 500 grid", |b| b.iter(|| model.field_grid(&axis, &axis, -500.0, false).unwrap()));
    group.finish();
}

fn fitting(c: &mut Criterion) {
    let model = model();
    let [north, east, down] = scattered(20_000);
    let positions = Positions::new(&north, &east, &down).unwrap();
    let mut observations = Observations::new();
    observations.vector(&positions, &model.field(&positions, true), &[]).unwrap();
    let options = FitOptions { order: 18, period: Period::Ratio(1.5), ..FitOptions::default() };
    let mut group = c.benchmark_group("harmonic fit");
    group.sample_size(10);
    group.bench_function("order 18, 20,000 vectors", |b| {
        b.iter(|| fit(&observations, &options, &Quiet).unwrap());
    });
    group.finish();
}

criterion_group!(benches, evaluate, fitting);
criterion_main!(benches);
