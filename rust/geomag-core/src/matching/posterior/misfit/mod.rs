//! What the readings ask for that was not told: the evidence of the model as told against that of models with one effect more.
//!
//! A test at the declared place does not see a wrong height or a bias that steps: a place at which the readings happen to fit was
//! found under the model as told. What sees it is the evidence over the whole search, the likelihood summed over all offsets (Kass and
//! Raftery, J. Am. Stat. Assoc. 90 (1995) 773): the right place under the right model fits better than the wrong place under the wrong
//! one. The likelihood is tempered, because errors that neighbours share must not be counted for every sample.
//!
//! The sum is begun on a lattice of some twenty offsets a side, on which a sample's variance contains what the map does between them,
//! and goes on about the places that hold the evidence of any model, at half the step each time, as long as an effect may yet gain
//! what is needed.

mod effects;

use rayon::prelude::*;

use super::kernel::{self, KernelScratch, LANES, Screened, Wide};
use super::lattice::children;
use super::nuisance::Shape;
use super::problem::Problem;
use crate::fix::Misfit;
use effects::{Alternative, View, alternatives, estimate};

/// Log evidence that an effect must gain where neither options nor map say otherwise: on left-out lines of two surveys one right fix
/// in thirty gains more by another height.
const THRESHOLD: f64 = 6.0;
/// Power to which likelihoods are taken.
const TEMPER: f64 = 0.4;
/// Lattice steps from the answer to the end of the search: this many, more where they would be longer than so many cells, but not more
/// than that.
const STEPS: f64 = 10.0;
const STEP_CELLS: f64 = 2.0;
const MOST_STEPS: f64 = 15.0;
/// What an effect may be short of at places where the answer would be wrong, on the lattices before the last.
const SLACK: f64 = 1.0;
/// Least of the greatest risks that is counted: nobody knows of untold effects what a lesser one would take.
const LEAST_RISK: f64 = 1e-3;
/// How far below the best place of a model, in the logarithm, others are looked at more closely.
const DEPTH: f64 = 6.0;
/// Step in units of that on which the answer was found from which none is finer.
const FINEST: f64 = 1.5;
/// Most lattices one after another, and places that hold the evidence of one from which it needs no finer one: it resolves them.
const STAGES: usize = 8;
const RESOLVED: usize = 100;

/// Log evidence from which an effect forbids a fix: what it gains over the whole search, and what it gains where the answer would be
/// wrong, further from it than the tolerance. With prior odds exp(-gain) of the effect such a place is as probable as the greatest risk
/// when the second is that much lower.
#[derive(Debug, Clone, Copy)]
struct Thresholds {
    gain: f64,
    away: f64,
}

/// One lattice, and the tempered log-likelihoods of its offsets: under the model as told, and with each of some effects.
struct Stage {
    offsets: Vec<[f64; 2]>,
    step: [f64; 2],
    told: Vec<f64>,
    with: Vec<Vec<f64>>,
}

/// The effect that the readings ask for most clearly where a fix at `offset` would be declared on a lattice of step `finest` (map
/// units); `None` where none gains more than the threshold, be it over the whole search or, by as much less as the greatest risk is below
/// one, at places where the answer would be wrong.
pub(super) fn asked_for(problem: &Problem<'_>, offset: [f64; 2], finest: [f64; 2]) -> Option<Misfit> {
    let of_map = problem.field.as_grid().and_then(|g| g.error_model()).and_then(|m| m.misfit_threshold);
    let threshold = problem.options.misfit_threshold.or(of_map).unwrap_or(THRESHOLD);
    if threshold == f64::INFINITY {
        return None;
    }
    let threshold = Thresholds { gain: threshold, away: threshold + problem.options.max_risk.max(LEAST_RISK).ln() };
    let told: Vec<View<'_>> = problem.channels.iter().map(|c| View::new(problem, c, offset, finest)).collect();
    let alternatives = alternatives(problem, &told);
    let mut alive: Vec<&Alternative> = alternatives.iter().collect();
    let (mut offsets, mut step) = lattice(problem, offset);
    let mut last = (0..2).all(|d| step[d] <= finest[d]);
    for stage in 1..=STAGES {
        let mut found = look(problem, &told, &alive, offsets, step);
        let evidence = sum(found.told.iter().copied());
        let elsewhere = found.beyond(problem, offset);
        let hopeful = |i: &usize| {
            let with = &found.with[*i];
            // NaN where an effect says nothing.
            sum(with.iter().copied()) > evidence || sum(of(with, &elsewhere)) - evidence > threshold.away - SLACK
        };
        let kept: Vec<usize> = (0..alive.len()).filter(hopeful).collect();
        if kept.is_empty() {
            return None;
        }
        alive = kept.iter().map(|i| alive[*i]).collect();
        found.with = kept.iter().map(|i| std::mem::take(&mut found.with[*i])).collect();
        let closer = found.holding();
        if last || stage == STAGES || closer.len() > RESOLVED {
            return decide(problem, &told, &alive, &mut found, offset, threshold);
        }
        offsets = children(&closer, step);
        step = step.map(|s| 0.5 * s);
        last = (0..2).all(|d| step[d] <= FINEST * finest[d]);
    }
    None
}

/// The effect that gains the most over the last lattice, in full, if that is more than the threshold.
fn decide(
    problem: &Problem<'_>,
    told: &[View<'_>],
    alive: &[&Alternative],
    found: &mut Stage,
    offset: [f64; 2],
    threshold: Thresholds,
) -> Option<Misfit> {
    let evidence = sum(found.told.iter().copied());
    for (i, effect) in alive.iter().enumerate() {
        if effect.height.is_none() {
            let Some(with) = in_full(problem, told, effect, found, i) else { continue };
            found.with[i] = with;
        }
    }
    let elsewhere = found.beyond(problem, offset);
    let gains: Vec<f64> = found.with.iter().map(|with| sum(with.iter().copied()) - evidence).collect();
    // Both on the scale of the gain's threshold.
    let asks = |i: usize| {
        let away = sum(of(&found.with[i], &elsewhere)) - evidence;
        gains[i].max(away + threshold.gain - threshold.away)
    };
    let asked: Vec<f64> = (0..alive.len()).map(asks).collect();
    let clear = (0..alive.len()).filter(|i| asked[*i] > threshold.gain);
    let best = clear.max_by(|a, b| asked[*a].total_cmp(&asked[*b]))?;
    let at = found.offsets[top(&found.with[best])?];
    Some(Misfit {
        effect: alive[best].effect.into(),
        estimate: estimate(problem, &told[0], alive[best], at, found.step),
        log_evidence: asked[best],
    })
}

impl Stage {
    /// Which offsets lie, cell and all, beyond the tolerance from the answer.
    fn beyond(&self, problem: &Problem<'_>, answer: [f64; 2]) -> Vec<bool> {
        let metres = |d: usize, by: f64| by * problem.scale_m[d];
        let radius = problem.tolerance_m + 0.5 * metres(0, self.step[0]).max(metres(1, self.step[1]));
        let away = |o: &[f64; 2]| metres(0, o[0] - answer[0]).hypot(metres(1, o[1] - answer[1])) > radius;
        self.offsets.iter().map(away).collect()
    }

    /// The offsets that hold the evidence of any of the models.
    fn holding(&self) -> Vec<[f64; 2]> {
        let mut holds = vec![false; self.offsets.len()];
        for totals in self.with.iter().chain(std::iter::once(&self.told)) {
            let best = top(totals).map_or(f64::NAN, |i| totals[i]);
            for (holds, total) in holds.iter_mut().zip(totals) {
                *holds |= *total > best - DEPTH;
            }
        }
        self.offsets.iter().zip(&holds).filter(|(_, holds)| **holds).map(|(o, _)| *o).collect()
    }
}

/// Offsets over the whole search, one of them the answer, and their step; map units.
fn lattice(problem: &Problem<'_>, offset: [f64; 2]) -> (Vec<[f64; 2]>, [f64; 2]) {
    let half = problem.options.half_width;
    let step = [0, 1].map(|d| {
        let step = (half[d] / STEPS).min(STEP_CELLS * problem.cell[d]).max(half[d] / MOST_STEPS);
        // Whole cells, where it is more than one: these are read in rows.
        let cells = step / problem.cell[d];
        if cells > 1.0 { cells.round() * problem.cell[d] } else { step }
    });
    let axis = |d: usize| {
        let first = ((-half[d] - offset[d]) / step[d] - 1e-9).ceil() as i64;
        let last = ((half[d] - offset[d]) / step[d] + 1e-9).floor() as i64;
        (first..=last.max(first)).map(move |i| offset[d] + i as f64 * step[d]).collect::<Vec<f64>>()
    };
    let (xs, ys) = (axis(0), axis(1));
    (ys.iter().flat_map(|y| xs.iter().map(move |x| [*x, *y])).collect(), step)
}

/// The models over one lattice: effects that leave the map as it is to first order, other maps in full.
fn look(
    problem: &Problem<'_>,
    told: &[View<'_>],
    alternatives: &[&Alternative],
    offsets: Vec<[f64; 2]>,
    step: [f64; 2],
) -> Stage {
    let (other_maps, this): (Vec<usize>, Vec<usize>) =
        (0..alternatives.len()).partition(|i| alternatives[*i].height.is_some());
    let mut of_told = vec![0.0; offsets.len()];
    let mut with = vec![vec![0.0; offsets.len()]; alternatives.len()];
    for (c, view) in told.iter().enumerate() {
        let maps: Vec<&[f32]> = other_maps.iter().map(|i| alternatives[*i].maps[c].as_slice()).collect();
        let effects: Vec<&[Shape]> = this.iter().map(|i| alternatives[*i].shapes[c].as_slice()).collect();
        let setup = view.setup(problem, step);
        let cells: Vec<[f64; 2]> = offsets.iter().map(|o| view.channel.cells(*o)).collect();
        let blocks: Vec<Screened> = cells
            .par_chunks(LANES)
            .with_min_len(8)
            .map_init(KernelScratch::default, |scratch, block| {
                kernel::screen(&setup, &effects, &maps, block, view.level, scratch)
            })
            .collect();
        for (i, block) in blocks.iter().enumerate() {
            let add = |totals: &mut [f64], scores: &Wide| {
                for (sum, score) in totals[i * LANES..].iter_mut().zip(scores) {
                    *sum += TEMPER * score;
                }
            };
            add(&mut of_told, &block.told);
            let scores = this.iter().zip(&block.effects).chain(other_maps.iter().zip(&block.maps));
            for (number, scores) in scores {
                add(&mut with[*number], scores);
            }
        }
    }
    Stage { offsets, step, told: of_told, with }
}

/// What the effect with a number comes to in full at the places that hold its evidence, and to first order elsewhere.
fn in_full(
    problem: &Problem<'_>,
    told: &[View<'_>],
    effect: &Alternative,
    found: &Stage,
    number: usize,
) -> Option<Vec<f64>> {
    let views: Vec<View<'_>> = told.iter().enumerate().map(|(c, view)| view.with(effect, c)).collect();
    let mut totals = found.with[number].clone();
    let best = totals[top(&totals)?];
    let holding: Vec<usize> = (0..totals.len()).filter(|i| totals[*i] > best - DEPTH).collect();
    let places: Vec<[f64; 2]> = holding.iter().map(|i| found.offsets[*i]).collect();
    let (with, without) = (joint(problem, &views, &places, found.step), joint(problem, told, &places, found.step));
    for ((i, with), without) in holding.into_iter().zip(with).zip(without) {
        totals[i] = found.told[i] + with - without;
    }
    Some(totals)
}

/// Tempered log-likelihoods of some offsets under a model, all channels together.
fn joint(problem: &Problem<'_>, views: &[View<'_>], offsets: &[[f64; 2]], step: [f64; 2]) -> Vec<f64> {
    let mut total = vec![0.0; offsets.len()];
    let mut scratch = KernelScratch::default();
    for view in views {
        let setup = view.setup(problem, step);
        let cells: Vec<[f64; 2]> = offsets.iter().map(|o| view.channel.cells(*o)).collect();
        for (block, sums) in cells.chunks(LANES).zip(total.chunks_mut(LANES)) {
            let scores = kernel::score::<false>(&setup, block, view.level..view.level + 1, &mut scratch);
            for (sum, score) in sums.iter_mut().zip(&scores.log_likelihood[view.level]) {
                *sum += TEMPER * score;
            }
        }
    }
    total
}

/// The place with the largest of some log-likelihoods.
fn top(totals: &[f64]) -> Option<usize> {
    (0..totals.len()).filter(|i| totals[*i].is_finite()).max_by(|a, b| totals[*a].total_cmp(&totals[*b]))
}

/// Those of the log-likelihoods that are asked for.
fn of<'a>(totals: &'a [f64], asked: &'a [bool]) -> impl Iterator<Item = f64> + Clone + 'a {
    totals.iter().zip(asked).filter(|(_, asked)| **asked).map(|(total, _)| *total)
}

/// Logarithm of the sum of what these are the logarithms of; NaN where nothing is known.
fn sum(totals: impl Iterator<Item = f64> + Clone) -> f64 {
    let top = totals.clone().filter(|t| t.is_finite()).fold(f64::NAN, f64::max);
    top + totals.filter(|t| t.is_finite()).map(|t| (t - top).exp()).sum::<f64>().ln()
}
