//! Sampling, lattice kernels, the IEMA step and grid search. Every bench asserts its answer.
#![allow(missing_docs, clippy::unwrap_used)]

use std::hint::black_box;
use std::sync::Arc;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use geomag_benches::{points, rough_map};
use geomag_core::fix::Status;
use geomag_core::grid::Interpolation;
use geomag_core::lattice::{Comparison, OffsetLattice};
use geomag_core::matching::grid_search::{GridSearch, match_grid};
use geomag_core::matching::iema::{Iema, IemaOptions};
use geomag_core::matching::similarity::{Criterion as Measure, Msd};
use geomag_core::monitor::Quiet;
use geomag_core::track::Track;

fn sampling(c: &mut Criterion) {
    let map = rough_map(false);
    let at = points(500);
    let mut group = c.benchmark_group("sample 500 points");
    group.throughput(Throughput::Elements(500));
    for (name, method) in [("bilinear", Interpolation::Bilinear), ("bicubic", Interpolation::Bicubic)] {
        group.bench_function(name, |b| {
            b.iter(|| at.iter().map(|p| map.sample_and_gradient(p[0], p[1], method).0).sum::<f64>());
        });
        assert!(at.iter().all(|p| map.sample(p[0], p[1], method).abs() < 300.0));
    }
    group.finish();
}

/// The kernels by instruction: (offset, sample) pairs a second for each precision and thread count.
fn kernels(c: &mut Criterion) {
    let mut group = c.benchmark_group("msd surface");
    group.sample_size(10);
    for (name, single) in [("f64", false), ("f32", true)] {
        let map = rough_map(single);
        for (side, samples) in [(21, 10), (201, 50), (1001, 100)] {
            let lattice = OffsetLattice::new([f64::from(side / 2); 2], [1.0; 2], 1 << 30).unwrap();
            let truth = points(samples);
            let values = truth.iter().map(|p| map.sample(p[0], p[1], Interpolation::Bilinear)).collect();
            let indicated = truth.iter().map(|p| [p[0] - 7.0, p[1] + 5.0]).collect();
            let comparison =
                Comparison::new(&map, lattice, indicated, values, None, Interpolation::Bilinear, samples).unwrap();
            let (rows, columns) = (lattice.rows(), lattice.columns());
            group.throughput(Throughput::Elements((rows * columns * samples) as u64));
            for threads in [1, 2] {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                let run = || pool.install(|| comparison.scores(Msd, 0..rows, 0..columns, None, &Quiet).unwrap());
                let best = run().into_iter().enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).unwrap().0;
                assert_eq!((best / columns, best % columns), (rows / 2 - 5, columns / 2 + 7));
                let id = BenchmarkId::new(format!("{name} {threads} threads"), format!("{side}x{side}x{samples}"));
                group.bench_function(id, |b| b.iter(|| black_box(run())));
            }
        }
    }
    group.finish();
}

fn searches(c: &mut Criterion) {
    let map = rough_map(false);
    let truth = points(50);
    let values = truth.iter().map(|p| map.sample(p[0], p[1], Interpolation::Bilinear)).collect();
    let (x, y) = truth.iter().map(|p| (p[0] - 7.0, p[1] + 5.0)).unzip();
    let track = Track::new(x, y, values, None).unwrap();
    let mut group = c.benchmark_group("grid search 201x201x50");
    group.sample_size(10);
    let hausdorff = Measure::Hausdorff { length_scale_m: 2.5, value_scale: 50.0, fraction: 1.0 };
    for measure in [Measure::Msd, Measure::Mad, Measure::Prod, Measure::Ncc, hausdorff] {
        let search = GridSearch::new(measure, [100.0; 2]);
        let fix = match_grid(&map, &track, &search, &Quiet).unwrap();
        assert!((fix.offset[0] - 7.0).hypot(fix.offset[1] + 5.0) < 1.0, "{fix:?}");
        group.bench_function(measure.as_str(), |b| b.iter(|| match_grid(&map, &track, &search, &Quiet).unwrap()));
    }
    group.finish();
}

fn iema(c: &mut Criterion) {
    let map = Arc::new(rough_map(false));
    let truth = points(12);
    let mut group = c.benchmark_group("iema step");
    for half in [10.0, 100.0, 500.0] {
        let options = IemaOptions::new(5.0, [half; 2]);
        let side = 2 * half as usize + 1;
        let value = |k: usize| map.sample(truth[k][0], truth[k][1], Interpolation::Bilinear);
        let mut whole = Iema::new(map.clone(), options.clone()).unwrap();
        let end = (0..12).map(|k| whole.update(truth[k][0] - 7.0, truth[k][1] + 5.0, value(k)).unwrap());
        let fixed = end.into_iter().find(|s| s.status == Status::Fixed).unwrap();
        assert_eq!(fixed.best_offset, [7.0, -5.0]);
        let fresh = Iema::new(map.clone(), options).unwrap();
        let mut later = fresh.clone();
        later.update(truth[0][0] - 7.0, truth[0][1] + 5.0, value(0)).unwrap();
        for (name, start, k) in [("first", &fresh, 0), ("second", &later, 1)] {
            let (x, y, v) = (truth[k][0] - 7.0, truth[k][1] + 5.0, value(k));
            group.bench_function(BenchmarkId::new(name, format!("{side}x{side}")), |b| {
                b.iter_batched_ref(
                    || start.clone(),
                    |iema| iema.update(x, y, v).unwrap(),
                    criterion::BatchSize::SmallInput,
                );
            });
        }
    }
    group.finish();
}

criterion_group!(benches, sampling, kernels, searches, iema);
criterion_main!(benches);
