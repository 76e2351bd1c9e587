//! ICCP, its refinement, the sliding window and tuning, on one smooth map of 800 x 800 nodes at 250 m.
#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use geomag_core::grid::{GridMap, GridValues};
use geomag_core::matching::closest::closest_contour_point;
use geomag_core::matching::contour::{ContourOptions, match_contour};
use geomag_core::matching::refine::RefineOptions;
use geomag_core::matching::scene::Priors;
use geomag_core::matching::sliding::SlidingState;
use geomag_core::matching::starts::Starts;
use geomag_core::matching::transform::TransformKind;
use geomag_core::matching::tuning::{TuneMethod, TuneOptions, tune_sequence};
use geomag_core::monitor::Quiet;
use geomag_core::track::Track;

fn field(x: f64, y: f64) -> f64 {
    180.0 * (x / 9000.0).sin() * (y / 11_000.0).cos()
        + 120.0 * ((x + 2.0 * y) / 15_000.0).cos()
        + 40.0 * (y / 5000.0).sin()
}

fn map() -> GridMap {
    let axis: Vec<f64> = (0..800).map(|i| 250.0 * f64::from(i)).collect();
    let values = axis.iter().flat_map(|&y| axis.iter().map(move |&x| field(x, y))).collect();
    GridMap::new(GridValues::F64(values), &axis, &axis, false).expect("an even grid")
}

/// `n` points every `spacing` metres, indicated 790 m off.
fn track(n: u32, spacing: f64) -> Track {
    let (mut x, mut y, mut v) = (vec![], vec![], vec![]);
    for k in 0..n {
        let d = spacing * f64::from(k);
        let (tx, ty) = (60_000.0 + 0.8 * d, 70_000.0 + 0.6 * d);
        x.push(tx - 500.0);
        y.push(ty + 611.6);
        // Noise that is the same in every run.
        v.push(field(tx, ty) + 2.0 * (f64::from(k) * 12.9898).sin());
    }
    Track::new(x, y, v, None).expect("finite samples")
}

fn contour(c: &mut Criterion) {
    let (map, indicated) = (map(), track(22, 840.0));
    let iccp = ContourOptions { radius_m: 2370.0, ..ContourOptions::default() };
    let mut group = c.benchmark_group("contour");
    group.bench_function("closest point", |b| {
        b.iter(|| closest_contour_point(&map, black_box(61_000.0), 71_000.0, field(60_500.0, 71_500.0), 2370.0));
    });
    group.bench_function("one iteration, 22 points", |b| {
        let one = ContourOptions { max_iterations: 1, ..iccp.clone() };
        b.iter(|| match_contour(&map, black_box(&indicated), None, &one));
    });
    group.bench_function("rigid ICCP to the letter, 22 points", |b| {
        b.iter(|| match_contour(&map, black_box(&indicated), None, &iccp));
    });
    let recommended = ContourOptions {
        transform: TransformKind::Translation,
        refine: true,
        starts: Starts::grid(1500.0, 250.0),
        refinement: RefineOptions {
            priors: Priors { offset_sigma_m: Some(560.0), heading_sigma_deg: Some(0.5), ..Priors::default() },
            ..RefineOptions::default()
        },
        ..iccp.clone()
    };
    let fix = match_contour(&map, &indicated, Some(2.0), &recommended).expect("good input");
    assert!((fix.offset_m[0] - 500.0).hypot(fix.offset_m[1] + 611.6) < 200.0, "{fix:?}");
    group.bench_function("recommended pipeline, 22 points", |b| {
        b.iter(|| match_contour(&map, black_box(&indicated), Some(2.0), &recommended));
    });
    let long = track(200, 840.0);
    group.bench_function("sliding update, 22 points", |b| {
        let mut full = SlidingState::new(22, Some(2.0), 10.0, iccp.clone()).expect("good options");
        for k in 0..40 {
            full.update(&map, long.x()[k], long.y()[k], long.values()[k]).expect("finite sample");
        }
        b.iter_batched(
            || full.clone(),
            |mut window| window.update(&map, long.x()[40], long.y()[40], long.values()[40]),
            criterion::BatchSize::SmallInput,
        );
    });
    group.sample_size(10);
    group.bench_function("exhaustive tuning, 435 settings, 30 draws", |b| {
        let dense = track(220, 280.0);
        let (x, y): (Vec<f64>, Vec<f64>) = (0..220).map(|k| (dense.x()[k] + 500.0, dense.y()[k] - 611.6)).unzip();
        let values = x.iter().zip(&y).map(|(&x, &y)| field(x, y)).collect();
        let planned = Track::new(x, y, values, None).expect("finite samples");
        let options =
            TuneOptions { max_length: Some(31), sigma: 2.0, matching: iccp.clone(), ..TuneOptions::default() };
        let tuned = tune_sequence(&map, &planned, &options, &TuneMethod::Exhaustive, &Quiet).expect("enough samples");
        assert_eq!(tuned.settings.len(), 435);
        b.iter(|| tune_sequence(&map, &planned, &options, &TuneMethod::Exhaustive, &Quiet));
    });
    group.finish();
}

criterion_group!(benches, contour);
criterion_main!(benches);
