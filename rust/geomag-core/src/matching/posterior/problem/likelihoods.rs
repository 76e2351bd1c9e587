//! Log-likelihoods of offsets by every channel, in the scope of error levels and components that still matter.

use std::ops::Range;

use rayon::prelude::*;

use super::super::kernel::{self, KernelScratch, LANES, Scores};
use super::super::noise::LEVELS;
use super::channel::PreparedChannel;
use super::ready::Problem;

/// What of one channel is looked at: error levels and components of the nuisance parameters.
#[derive(Debug, Clone)]
pub(in super::super) struct Scope {
    pub levels: Range<usize>,
    /// Whether the bound under the one level stands for all.
    pub cover: bool,
    pub components: Vec<usize>,
}

/// Scores of all candidates by one channel.
pub(in super::super) struct Scored {
    /// A block of [`LANES`] candidates each.
    pub blocks: Vec<Scores>,
    /// The largest log-likelihood of any candidate at every component in the scope, its share of the prior counted.
    pub best_of_component: Vec<[f64; LEVELS]>,
}

/// The scores by every channel.
pub(in super::super) type Likelihoods = Vec<Scored>;
/// What a field may do between the nodes of an exact map, in units of its second difference there: half as much again as the bicubic
/// surface, which differs from the bilinear one by up to an eighth along either axis.
const COVER: f32 = 0.375;
/// Samples times candidates times levels below which one thread is faster than several.
const PARALLEL: usize = 16_000;

impl Problem<'_> {
    /// Everything there is to look at.
    pub fn whole(&self) -> Vec<Scope> {
        let components: Vec<usize> = (0..self.nuisance.components.len()).collect();
        self.channels
            .iter()
            .map(|c| Scope { levels: 0..c.noise.levels.len(), cover: false, components: components.clone() })
            .collect()
    }

    /// The surface through the nodes that was named, where there are several: between the places of a coarse lattice they are alike.
    pub fn named(&self) -> Vec<Scope> {
        let mut scopes = self.whole();
        for (scope, channel) in scopes.iter_mut().zip(&self.channels) {
            let levels = &channel.noise.levels;
            if channel.noise.covered {
                scope.levels = 0..levels.iter().take_while(|l| l.surface == levels[0].surface).count();
            }
        }
        scopes
    }

    /// The part of a scope over which bounds are taken: the first level alone where it stands for all, which under several surfaces it
    /// does at the `first` stage only.
    pub fn bounded(&self, scopes: &[Scope], first: bool) -> Vec<Scope> {
        let part = |(channel, scope): (&PreparedChannel, &Scope)| {
            let noise = &channel.noise;
            let cover = first && noise.covered;
            let levels = if cover {
                0..1
            } else if noise.alike {
                scope.levels.start..scope.levels.start + 1
            } else {
                scope.levels.clone()
            };
            Scope { levels, cover, components: scope.components.clone() }
        };
        self.channels.iter().zip(scopes).map(part).collect()
    }

    /// Log-likelihoods of these offsets in the scope of every channel: densities, or bounds over cells of this step.
    pub fn likelihoods<const BOUND: bool>(
        &self,
        offsets: &[[f64; 2]],
        step: [f64; 2],
        scopes: &[Scope],
    ) -> Likelihoods {
        let score = |(channel, scope): (&PreparedChannel, &Scope)| {
            let cells: Vec<[f64; 2]> = offsets.iter().map(|o| channel.cells(*o)).collect();
            let one = |scratch: &mut KernelScratch, block: &[[f64; 2]]| {
                if self.interruption.now() {
                    return (Scores::nothing(), Vec::new());
                }
                self.score_block::<BOUND>(channel, scope, step, block, scratch)
            };
            let work = offsets.len() * self.samples * scope.levels.len() * scope.components.len();
            let (blocks, components): (Vec<Scores>, Vec<Vec<[f64; LEVELS]>>) = if work < PARALLEL {
                let mut scratch = KernelScratch::default();
                cells.chunks(LANES).map(|block| one(&mut scratch, block)).unzip()
            } else {
                let width = 8_usize.div_ceil(scope.components.len());
                cells.par_chunks(LANES).with_min_len(width).map_init(KernelScratch::default, one).unzip()
            };
            let mut best_of_component = vec![[f64::NEG_INFINITY; LEVELS]; scope.components.len()];
            for block in &components {
                for (best, of_block) in best_of_component.iter_mut().zip(block) {
                    for (best, log) in best.iter_mut().zip(of_block) {
                        *best = best.max(*log);
                    }
                }
            }
            Scored { blocks, best_of_component }
        };
        self.channels.iter().zip(scopes).map(score).collect()
    }

    /// One block, its components added up; and the best of each component.
    fn score_block<const BOUND: bool>(
        &self,
        channel: &PreparedChannel,
        scope: &Scope,
        step: [f64; 2],
        cells: &[[f64; 2]],
        scratch: &mut KernelScratch,
    ) -> (Scores, Vec<[f64; LEVELS]>) {
        let mut sum: Option<Scores> = None;
        let mut best = Vec::new();
        for &component in &scope.components {
            let mut setup = self.setup(channel, component, step);
            if BOUND {
                setup.blur_m2 = [self.options.position_sigma_m.powi(2) as f32; 2];
                if scope.cover {
                    // The first level is about the surface that was named; the bends in its reach stand for the others.
                    setup.cover = COVER;
                }
            }
            let mut scores = kernel::score::<BOUND>(&setup, cells, scope.levels.clone(), scratch);
            if self.nuisance.components.len() > 1 {
                scores.weigh(self.nuisance.components[component].log_weight);
                best.push(scores.best());
            }
            match &mut sum {
                None => sum = Some(scores),
                Some(sum) => sum.add(&scores),
            }
        }
        (sum.unwrap_or_else(Scores::nothing), best)
    }

    /// The component at which this offset is the most likely, given an error level.
    pub fn best_component(&self, channel: &PreparedChannel, offset: [f64; 2], level: usize, step: [f64; 2]) -> usize {
        let components = self.nuisance.components.len();
        if components == 1 {
            return 0;
        }
        let scope = Scope { levels: level..level + 1, cover: false, components: (0..components).collect() };
        let (_, best) =
            self.score_block::<false>(channel, &scope, step, &[channel.cells(offset)], &mut KernelScratch::default());
        (1..components).fold(0, |a, b| if best[b][level] > best[a][level] { b } else { a })
    }
}
