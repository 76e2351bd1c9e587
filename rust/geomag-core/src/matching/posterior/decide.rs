//! From a posterior to an answer: centre, covariance, risk and status.

use super::density::Posterior;
use super::lattice::Lattice;
use super::misfit;
use super::problem::Problem;
use crate::fix::{Fix, Status, Surface};
use crate::statistics::round_normal_in_disc;
use crate::track::Track;

/// Share of the prior's variance above which the field has told nothing.
const UNINFORMED: f64 = 0.5;
/// Probability of a candidate that changes no risk.
const NEGLIGIBLE: f64 = 1e-12;

fn square(x: f64, y: f64) -> f64 {
    x * x + y * y
}

/// Makes the answer of a posterior.
pub(super) fn answer(problem: &Problem<'_>, track: &Track, posterior: &Posterior, lattice: &Lattice) -> Fix {
    let n = track.len();
    let Some(mode) = posterior.mode() else {
        return Fix::none(Status::Lost, n);
    };
    let scale = problem.scale_m;
    let tolerance = problem.tolerance_m;
    let metres = |o: [f64; 2]| [o[0] * scale[0], o[1] * scale[1]];
    // The centre of the mass within the tolerance of the mode, moved there twice, so that it sits on the mode's body and
    // not on one node of it.
    let mut centre = metres(posterior.offsets[mode]);
    let p: Vec<f64> = posterior.log_p.iter().map(|lp| if *lp > -60.0 { lp.exp() } else { 0.0 }).collect();
    for _ in 0..3 {
        let mut sums = [0.0; 3];
        for (o, p) in posterior.offsets.iter().zip(&p) {
            let [east, north] = metres(*o);
            if square(east - centre[0], north - centre[1]) <= tolerance * tolerance {
                sums[0] += p;
                sums[1] += p * east;
                sums[2] += p * north;
            }
        }
        if sums[0] > 0.0 {
            centre = [sums[1] / sums[0], sums[2] / sums[0]];
        }
    }
    let (mut inside, mut mean, mut second) = (0.0, [0.0; 2], [0.0; 3]);
    for (i, o) in posterior.offsets.iter().enumerate() {
        if p[i] < NEGLIGIBLE {
            continue;
        }
        let [east, north] = metres(*o);
        inside += p[i]
            * round_normal_in_disc(square(east - centre[0], north - centre[1]).sqrt(), posterior.blur_m[i], tolerance);
        mean[0] += p[i] * east;
        mean[1] += p[i] * north;
    }
    for (i, o) in posterior.offsets.iter().enumerate() {
        let [east, north] = metres(*o);
        let (de, dn) = (east - mean[0], north - mean[1]);
        let blur2 = posterior.blur_m[i].powi(2);
        second[0] += p[i] * (de * de + blur2);
        second[1] += p[i] * de * dn;
        second[2] += p[i] * (dn * dn + blur2);
    }
    let computed = (1.0 - inside).clamp(0.0, 1.0);
    let risk = problem.declared(computed);
    let offset = [centre[0] / scale[0], centre[1] / scale[1]];
    let detail = problem.detail(offset, posterior.step);
    let runner_up = posterior
        .offsets
        .iter()
        .zip(&posterior.log_p)
        .filter(|(o, _)| {
            let [east, north] = metres(**o);
            square(east - centre[0], north - centre[1]) > tolerance * tolerance
        })
        .map(|(_, lp)| *lp)
        .fold(f64::NEG_INFINITY, f64::max);
    let mut status =
        status(problem, posterior, lattice, &p, offset, [computed, risk], detail.goodness, runner_up, second);
    // Only what would be used has to stand the tests.
    let misfit = if status == Status::Fixed { misfit::asked_for(problem, offset, posterior.step) } else { None };
    if misfit.is_some() {
        status = Status::Rejected;
    }
    // The covariance is about the answer, not about the posterior's mean, so that it bounds the answer's own error.
    let (shift_e, shift_n) = (mean[0] - centre[0], mean[1] - centre[1]);
    let factor = problem.covariance_factor();
    let covariance = [
        [second[0] + shift_e * shift_e, second[1] + shift_e * shift_n],
        [second[1] + shift_e * shift_n, second[2] + shift_n * shift_n],
    ]
    .map(|row| row.map(|v| factor * v));
    Fix {
        covariance_m2: Some(covariance),
        risk: Some(risk),
        goodness: Some(detail.goodness),
        misfit,
        bias: Some(detail.bias),
        heading_deg: detail.heading_deg,
        scale: detail.scale,
        score: posterior.log_p[mode],
        runner_up,
        iterations: posterior.stages,
        ..Fix::at_offset(problem.field, track, offset, status)
    }
}

#[allow(clippy::too_many_arguments)] // the parts of one decision
fn status(
    problem: &Problem<'_>,
    posterior: &Posterior,
    lattice: &Lattice,
    p: &[f64],
    offset: [f64; 2],
    [computed, risk]: [f64; 2],
    goodness: f64,
    runner_up: f64,
    second: [f64; 3],
) -> Status {
    let options = problem.options;
    let scale = problem.scale_m;
    if goodness < options.min_goodness {
        return Status::Rejected;
    }
    let half_m = [options.half_width[0] * scale[0], options.half_width[1] * scale[1]];
    // Within a step of where the search ends: what lies beyond may be better. Up to there the answer has been seen from both sides.
    let edge = lattice.edge();
    if (0..2).any(|d| offset[d].abs() > edge[d] - posterior.step[d]) {
        return Status::AtEdge;
    }
    if risk <= options.max_risk {
        return Status::Fixed;
    }
    let prior = (half_m[0] * half_m[0] + half_m[1] * half_m[1]) / 3.0;
    if second[0] + second[2] > UNINFORMED * prior {
        return Status::Uninformative;
    }
    // A second place, not the flank of the first: the mass around the best point away from the answer.
    let rival = posterior.log_p.iter().position(|lp| *lp == runner_up && lp.is_finite());
    if let Some(rival) = rival {
        let far = |a: [f64; 2], b: [f64; 2]| {
            square((a[0] - b[0]) * scale[0], (a[1] - b[1]) * scale[1]) > problem.tolerance_m.powi(2)
        };
        let there = posterior.offsets[rival];
        let distance = ((there[0] - offset[0]) * scale[0]).hypot((there[1] - offset[1]) * scale[1]);
        let mass: f64 = posterior.offsets.iter().zip(p).filter(|(o, _)| !far(**o, there)).map(|(_, p)| *p).sum();
        if distance > 2.0 * problem.tolerance_m && mass > 0.5 * computed {
            return Status::Ambiguous;
        }
    }
    Status::Searching
}

/// The first lattice as a surface of probabilities.
pub(super) fn surface(offsets: &[[f64; 2]], log_p: &[f64], step: [f64; 2]) -> Option<Surface> {
    let first = *offsets.first()?;
    let last = *offsets.last()?;
    let columns = ((last[0] - first[0]) / step[0]).round() as usize + 1;
    let rows = ((last[1] - first[1]) / step[1]).round() as usize + 1;
    if columns * rows != offsets.len() {
        return None;
    }
    let values = log_p.iter().map(|lp| if lp.is_finite() { lp.exp() } else { f64::NAN }).collect();
    Some(Surface { values, rows, columns, first, step })
}
