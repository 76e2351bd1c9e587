//! One step of the field navigator on a harmonic model.
#![allow(missing_docs, clippy::unwrap_used)]

use std::sync::Arc;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use geomag_core::harmonic::{RectangularHarmonicModel, Region, terms};
use geomag_core::navigation::field_navigator::{FieldNavigator, FieldNavigatorMethod, FieldNavigatorOptions};
use geomag_core::navigation::sensing::{Sensing, Sensor};

/// Wavelengths of 100 m and more, some nT a metre.
fn model(order: usize) -> Arc<RectangularHarmonicModel> {
    let period = 100.0 * order as f64;
    let mut coefficients = vec![0.0; 3];
    for (k, term) in terms(order).enumerate() {
        let u = std::f64::consts::TAU * (term.t as f64).hypot(term.r as f64) / period;
        coefficients.push((1.7 * k as f64).sin() / (u * u));
    }
    let region = Region { north_m: [-period, period], east_m: [-period, period], down_m: [-10.0, 0.0] };
    Arc::new(RectangularHarmonicModel::new(order, [period, period], coefficients, region).unwrap())
}

fn steps(c: &mut Criterion) {
    let mut group = c.benchmark_group("field navigator step");
    for order in [10, 18] {
        for (name, method, extra) in [
            ("unscented, position", FieldNavigatorMethod::Unscented, 0.0),
            ("extended, position", FieldNavigatorMethod::Extended, 0.0),
            ("unscented, speed, heading and bias", FieldNavigatorMethod::Unscented, 1.0),
        ] {
            let sensing = Sensing::at_down(model(order), Sensor::Vector, 0.0).unwrap();
            let options = FieldNavigatorOptions {
                start: [10.0, 20.0],
                covariance_m2: [[2.0, 0.0], [0.0, 2.0]],
                speed_sigma_m_s: 0.1 * extra,
                heading_sigma_deg: extra,
                bias_sigma: 5.0 * extra,
                reading_sigma: vec![3.0],
                method,
                ..FieldNavigatorOptions::default()
            };
            let navigator = FieldNavigator::new(sensing.clone(), options).unwrap();
            let mut reading = [0.0; 3];
            sensing.read(&[[12.0, 21.0]], &mut reading);
            group.bench_function(format!("order {order}, {name}"), |b| {
                b.iter_batched_ref(
                    || navigator.clone(),
                    |n| n.step(1.0, 2.0, 60.0, Some(&reading)).unwrap(),
                    BatchSize::SmallInput,
                );
            });
        }
    }
    group.finish();
}

criterion_group!(benches, steps);
criterion_main!(benches);
