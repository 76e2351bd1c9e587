//! What this machine can do at best, and what the kernels take beside it: one JSON object on standard output.
//!
//! Multiply-adds by vector width and reading of memory are the two limits that the kernels are held against, measured in the same run
//! as they. Times are the least of several.
#![allow(clippy::unwrap_used, clippy::inline_always)]

use std::hint::black_box;
use std::time::{Duration, Instant};

use geomag_benches::{points, rough_map};
use geomag_core::grid::Interpolation;
use geomag_core::instructions;
use geomag_core::lattice::{Comparison, OffsetLattice};
use geomag_core::matching::similarity::Msd;
use geomag_core::monitor::Quiet;
use pulp::Simd;

/// Nanoseconds of one run: the least of as many as fit in the time.
fn nanoseconds(patience: Duration, mut work: impl FnMut()) -> f64 {
    let (start, mut least) = (Instant::now(), f64::INFINITY);
    for run in 0.. {
        let begun = Instant::now();
        work();
        least = least.min(begun.elapsed().as_secs_f64());
        if run > 1 && start.elapsed() > patience {
            break;
        }
    }
    1e9 * least
}

/// Independent multiply-adds in flight: more than any machine's latency times its units, fewer than its registers.
const IN_FLIGHT: usize = 12;
/// Rounds of them in one run.
const ROUNDS: usize = 200_000;

struct MultiplyAdds;

impl pulp::WithSimd for MultiplyAdds {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (scale, shift) = (simd.splat_f64s(black_box(0.999)), simd.splat_f64s(black_box(0.001)));
        let mut sums = [simd.splat_f64s(black_box(1.0)); IN_FLIGHT];
        for _ in 0..ROUNDS {
            for sum in &mut sums {
                *sum = simd.mul_add_e_f64s(*sum, scale, shift);
            }
        }
        sums.into_iter().map(|sum| simd.reduce_sum_f64s(sum)).sum()
    }
}

/// Sum of an array, by vectors, so that reading is what it waits for.
struct Read<'a>(&'a [f64]);

impl pulp::WithSimd for Read<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let (vectors, _) = S::as_simd_f64s(self.0);
        let mut sums = [simd.splat_f64s(0.0); 8];
        for group in vectors.chunks_exact(8) {
            for (sum, v) in sums.iter_mut().zip(group) {
                *sum = simd.add_f64s(*sum, *v);
            }
        }
        sums.into_iter().map(|sum| simd.reduce_sum_f64s(sum)).sum()
    }
}

fn main() {
    let patience = Duration::from_millis(if std::env::args().any(|a| a == "--smoke") { 1 } else { 400 });
    let arch = instructions::chosen();
    let mut fields = vec![format!("\"instruction_set\": \"{}\"", instructions::instruction_set().unwrap())];
    let mut say = |name: &str, value: f64| fields.push(format!("\"{name}\": {value:.5}"));

    let each = (IN_FLIGHT * ROUNDS) as f64;
    say("multiply_add_ns", nanoseconds(patience, || _ = black_box(arch.dispatch(MultiplyAdds))) / each);
    for (name, megabytes) in [("read_small", 0.125), ("read_large", 256.0)] {
        let values = vec![1.0_f64; (megabytes * 131_072.0) as usize];
        let took = nanoseconds(patience, || _ = black_box(arch.dispatch(Read(&values))));
        say(&format!("{name}_gigabytes_per_s"), (values.len() * 8) as f64 / took);
    }

    let samples = 100;
    for (name, single) in [("float64", false), ("float32", true)] {
        let map = rough_map(single);
        let lattice = OffsetLattice::new([500.0; 2], [1.0; 2], 1 << 30).unwrap();
        let truth = points(samples);
        let values = truth.iter().map(|p| map.sample(p[0], p[1], Interpolation::Bilinear)).collect();
        let indicated = truth.iter().map(|p| [p[0] - 7.0, p[1] + 5.0]).collect();
        let comparison =
            Comparison::new(&map, lattice, indicated, values, None, Interpolation::Bilinear, samples).unwrap();
        let (rows, columns) = (lattice.rows(), lattice.columns());
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let run = || pool.install(|| comparison.scores(Msd, 0..rows, 0..columns, None, &Quiet).unwrap());
            let took = nanoseconds(patience, || _ = black_box(run()));
            say(&format!("lattice_{name}_{threads}_threads_ns"), took / (rows * columns * samples) as f64);
        }
        let (x, y): (Vec<f64>, Vec<f64>) = (0..20_000)
            .map(|k| (f64::from(k * 7919 % 2_198_000) / 1e3, f64::from(k * 104_729 % 2_198_000) / 1e3))
            .unzip();
        for (method, kind) in [(Interpolation::Bilinear, "bilinear"), (Interpolation::Bicubic, "bicubic")] {
            let took = nanoseconds(patience, || _ = black_box(map.sample_many(&x, &y, method)));
            say(&format!("sample_{kind}_{name}_ns"), took / x.len() as f64);
        }
    }
    println!("{{{}}}", fields.join(", "));
}
