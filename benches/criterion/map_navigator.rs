//! One step of the map-aided navigator, without a match.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use geomag_core::field::Field;
use geomag_core::grid::{GridMap, GridValues, Interpolation, MapSigma};
use geomag_core::map_error::{DistanceLayer, MapErrorModel};
use geomag_core::monitor::Quiet;
use geomag_core::navigation::navigator::{FlightInput, NavigatorOptions, Smoothing, navigate};

const STEPS: usize = 4000;

fn map(exact: bool) -> GridMap {
    let axis: Vec<f64> = (0..1000).map(|i| f64::from(i) * 60.0).collect();
    let wave = |a: f64, b: f64| (a / 700.0).sin() * 90.0 + (b / 530.0).cos() * 80.0;
    let values = axis.iter().flat_map(|y| axis.iter().map(|x| wave(*x, *y)).collect::<Vec<_>>()).collect();
    let sigma = MapSigma::Constant(if exact { 0.0 } else { 5.0 });
    let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap().with_sigma(Some(sigma)).unwrap();
    let model = MapErrorModel {
        misfit_threshold: None,
        nu: 3.0,
        scale_spread: 0.35,
        correlation: 1.3,
        registration: 0.05,
        distance_m: DistanceLayer::Constant(230.0),
        filter: None,
        recalibration: None,
        forecast: None,
        lapses: None,
        covariance_factor: None,
    };
    map.with_error_model((!exact).then_some(model)).unwrap()
}

/// A flight along the map and back, a step every 1.4 s: time of a step by the number of steps.
fn flight(c: &mut Criterion) {
    let mut group = c.benchmark_group("navigator, flight of 4000 steps");
    for (name, exact) in [("readings one by one", true), ("readings in batches", false)] {
        let map = Arc::new(map(exact));
        let time_s: Vec<f64> = (0..STEPS).map(|k| 1.4 * k as f64).collect();
        let along = |t: f64| {
            let way = (70.0 * t) % 100_000.0;
            if way < 50_000.0 { (5000.0 + way, 70.0) } else { (105_000.0 - way, -70.0) }
        };
        let x: Vec<f64> = time_s.iter().map(|t| along(*t).0).collect();
        let y = vec![30_000.0; STEPS];
        let velocity: Vec<[f64; 2]> = time_s.iter().map(|t| [along(*t).1, 0.0]).collect();
        let heading: Vec<f64> = velocity.iter().map(|v| if v[0] > 0.0 { 90.0 } else { 270.0 }).collect();
        let readings: Vec<f64> = x.iter().map(|x| map.sample(*x, 30_000.0, Interpolation::Bilinear)).collect();
        let input = FlightInput {
            time_s: &time_s,
            x: &x,
            y: &y,
            velocity_m_s: Some(&velocity),
            heading_deg: Some(&heading),
            height_m: None,
            readings: Some(&readings),
            terms: None,
        };
        let options = NavigatorOptions { matcher: None, ..NavigatorOptions::new(100.0) };
        let field: Arc<dyn Field> = map;
        let run = || navigate(field.clone(), &input, options.clone(), Smoothing::No, &Quiet).unwrap();
        let last = *run().steps.last().unwrap();
        assert!((last.x - x[STEPS - 1]).hypot(last.y - 30_000.0) < last.protection_level_m);
        group.throughput(criterion::Throughput::Elements(STEPS as u64));
        group.bench_function(name, |b| b.iter(|| black_box(run())));
    }
    group.finish();
}

criterion_group!(benches, flight);
criterion_main!(benches);
