//! Blocks of candidates: their densities or bounds under several error levels.

use std::ops::Range;

use super::super::noise::{ErrorLevel, LEVELS};
use super::fill::fill;
use super::integral::{Tails, nuisances, one_bias, weigh};
use super::setup::{
    FEW_PARAMETERS, KernelScratch, LANES, MOST_PARAMETERS, SOME_PARAMETERS, Scores, Setup, WIDENING, Wide,
};

/// Scores the candidates `offsets` (at most [`LANES`]; cells of the map) under the given levels: their density, or with
/// `BOUND` a bound over the cell of each. The other levels are minus infinity.
pub(in super::super) fn score<const BOUND: bool>(
    setup: &Setup<'_>,
    offsets: &[[f64; 2]],
    levels: Range<usize>,
    scratch: &mut KernelScratch,
) -> Scores {
    crate::instructions::chosen().dispatch(LaneBlock::<'_, '_, BOUND> { setup, offsets, levels, scratch })
}

struct LaneBlock<'a, 'b, const BOUND: bool> {
    setup: &'a Setup<'b>,
    offsets: &'a [[f64; 2]],
    levels: Range<usize>,
    scratch: &'a mut KernelScratch,
}

impl<const BOUND: bool> pulp::WithSimd for LaneBlock<'_, '_, BOUND> {
    type Output = Scores;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Scores {
        fill::<BOUND>(self.setup, self.offsets, &self.setup.levels[self.levels.clone()], self.scratch);
        evaluate::<BOUND>(self.setup, self.levels, &WIDENING, self.scratch)
    }
}

#[inline(always)]
fn evaluate<const BOUND: bool>(
    setup: &Setup<'_>,
    levels: Range<usize>,
    widening: &[f32],
    scratch: &mut KernelScratch,
) -> Scores {
    let n = setup.places.len();
    let (mut count, mut distance, mut map_variance) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
    let mut between = [0.0; LANES];
    for row in &scratch.rows {
        for l in 0..LANES {
            count[l] += row.known[l];
            distance[l] += row.distance[l];
            map_variance[l] += row.map_variance[l];
            between[l] += row.between[l];
        }
    }
    for l in 0..LANES {
        distance[l] /= count[l].max(1.0);
        map_variance[l] /= count[l].max(1.0);
        between[l] /= count[l].max(1.0);
    }
    let needed = (setup.min_overlap * n as f64).max(1.0);
    let mut out = [[f64::NEG_INFINITY; LANES]; LEVELS];
    let mut bias = [0.0; LANES];
    let mut theta = [[0.0; LANES]; MOST_PARAMETERS];
    let mut weighed: Option<(ErrorLevel, Wide)> = None;
    for index in levels {
        let level = &setup.levels[index];
        // A level that differs from the one before in its tails only has the same variances; the bias is nearly the same anyhow.
        let (mut lane, turns) = match weighed {
            Some((before, lane)) if before.same_surface(level) => (lane, &widening[widening.len() - 1..]),
            Some(_) => (weigh::<BOUND>(scratch, level), &widening[1..]),
            None => (weigh::<BOUND>(scratch, level), widening),
        };
        weighed = Some((*level, lane));
        if setup.shapes.is_empty() {
            one_bias::<BOUND>(setup, scratch, Tails::of(level), turns, &mut bias, &mut lane);
        } else {
            let tails = Tails::of(level);
            let log = match setup.shapes.len() + usize::from(setup.bias_sigma.is_some()) {
                n if n <= FEW_PARAMETERS => {
                    nuisances::<BOUND, FEW_PARAMETERS>(setup, scratch, tails, turns, &mut theta)
                }
                n if n <= SOME_PARAMETERS => {
                    nuisances::<BOUND, SOME_PARAMETERS>(setup, scratch, tails, turns, &mut theta)
                }
                _ => nuisances::<BOUND, MOST_PARAMETERS>(setup, scratch, tails, turns, &mut theta),
            };
            for l in 0..LANES {
                lane[l] += log[l];
            }
        }
        for l in 0..LANES {
            // A candidate that misses a few samples is judged by those that it has, as if there were all.
            let count = f64::from(count[l]);
            out[index][l] = if count >= needed { lane[l] * (n as f64 / count.max(1.0)) } else { f64::NEG_INFINITY };
        }
    }
    Scores { log_likelihood: out, distance, map_variance, between }
}
