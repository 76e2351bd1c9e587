//! The posterior over 37 x 37 offsets and 40 samples on a right map, and a streamed track over 81 x 81 candidates.
#![allow(missing_docs, clippy::expect_used)]

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use geomag_core::grid::{GridMap, GridValues, Interpolation, MapSigma};
use geomag_core::matching::posterior::{PosteriorMatcher, PosteriorOptions, match_posterior};
use geomag_core::track::Track;

/// A slope, as that of a core field, under features of 3 to 30 cells.
fn field(x: f64, y: f64) -> f64 {
    0.004 * y
        + 30.0 * (x / 9000.0).sin() * (y / 7000.0).cos()
        + 12.0 * ((x + 2.0 * y) / 5000.0).cos()
        + 3.0 * (y / 1500.0).sin()
}

fn map() -> GridMap {
    let axis: Vec<f64> = (0..400).map(|i| 1000.0 * f64::from(i)).collect();
    let values = axis.iter().flat_map(|&y| axis.iter().map(move |&x| field(x, y))).collect();
    let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).expect("an even grid");
    map.with_sigma(Some(MapSigma::Constant(0.0))).expect("a sigma of zero")
}

/// 40 samples two cells apart, indicated 7 km off, with noise that is the same in every run.
fn track(map: &GridMap) -> Track {
    let (mut x, mut y, mut v) = (vec![], vec![], vec![]);
    for k in 0..40 {
        let (tx, ty) = (120_300.0 + 1600.0 * f64::from(k), 150_700.0 + 1200.0 * f64::from(k));
        x.push(tx - 5400.0);
        y.push(ty + 4600.0);
        v.push(map.sample(tx, ty, Interpolation::Bilinear) + 0.7 * (f64::from(k) * 12.9898).sin());
    }
    Track::new(x, y, v, None).expect("finite samples")
}

fn posterior(c: &mut Criterion) {
    let map = map();
    let track = track(&map);
    let field: Arc<dyn geomag_core::field::Field> = Arc::new(map.clone());
    let mut group = c.benchmark_group("posterior");
    for (name, bias_sigma) in [("bias known", Some(0.0)), ("bias unknown", None)] {
        let options = PosteriorOptions { bias_sigma, ..PosteriorOptions::new([18_000.0; 2]) };
        group.bench_function(format!("37 x 37 x 40, {name}"), |b| {
            b.iter(|| match_posterior(&map, black_box(&track), Some(0.5), &options).expect("a match"));
        });
        let options = PosteriorOptions { bias_sigma, step: Some([250.0; 2]), ..PosteriorOptions::new([10_000.0; 2]) };
        let matcher = PosteriorMatcher::new(field.clone(), Some(0.5), options, 40).expect("a matcher");
        group.bench_function(format!("40 samples streamed over 81 x 81, {name}"), |b| {
            b.iter_batched_ref(
                || matcher.clone(),
                |m| {
                    for ((x, y), v) in track.x().iter().zip(track.y()).zip(track.values()) {
                        black_box(m.update(*x, *y, *v).expect("a sample"));
                    }
                },
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, posterior);
criterion_main!(benches);
