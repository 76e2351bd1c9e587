//! Choice of order, period and ridge by cross-validation.

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rayon::prelude::*;

use super::basis::{Prior, coefficient_count};
use super::fit::{FitOptions, Period, PreparedFit, huber_weights, linear_rows, residuals};
use super::normal::{LinearRow, Normal, Progress, Regularisation, Solver, for_each_block};
use super::observations::{Observations, Sensed};
use super::{Positions, fit};
use crate::error::{Error, Result};
use crate::monitor::Monitor;

/// What to choose from, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct SelectionOptions {
    /// Orders to try.
    pub orders: Vec<usize>,
    /// Period ratios to try.
    pub period_ratios: Vec<f64>,
    /// Ridges to try.
    pub ridges: Vec<f64>,
    /// Priors to try.
    pub priors: Vec<Prior>,
    /// Number of parts; each in turn is left out and predicted.
    pub folds: usize,
    /// One label a point (a flight line, say): points of one label are left out together. Without labels every point
    /// stands alone, which flatters high orders where neighbours share their errors.
    pub groups: Option<Vec<u64>>,
    /// Seed of the deal of points or labels to parts.
    pub seed: u64,
}

/// One choice and how well it predicted what it had not seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    /// Order.
    pub order: usize,
    /// Periods as multiples of the extent.
    pub period_ratio: f64,
    /// Ridge.
    pub ridge: f64,
    /// Prior.
    pub prior: Prior,
    /// Root mean square of the weighted residuals of left-out observations.
    pub rms: f64,
    /// Standard error of `rms` over the parts.
    pub rms_error: f64,
}

/// All candidates in the order tried, and the best.
#[derive(Debug, Clone, PartialEq)]
pub struct Selection {
    /// Every candidate.
    pub candidates: Vec<Choice>,
    /// Index of the one with the least `rms`.
    pub best: usize,
}

/// Cross-validates orders, period ratios, ridges and priors.
///
/// One pass over the observations per part and period builds the normal equations of the highest order, of which those of
/// lower orders are leading parts; a second pass predicts what was left out. Intensities and Huber's weights are taken
/// about one fit of the highest order with the first period, ridge and prior; `options` gives `huber` and `max_iterations`.
///
/// # Errors
/// As [`fit`](super::fit); [`Error::Invalid`] for empty lists, fewer than two parts or fewer labels than parts;
/// [`Error::Shape`] for labels of another number than the points.
pub fn select(
    observations: &Observations,
    choice: &SelectionOptions,
    options: &FitOptions,
    monitor: &dyn Monitor,
) -> Result<Selection> {
    let (Some(&highest), Some(&ratio), Some(&ridge), Some(&prior)) =
        (choice.orders.iter().max(), choice.period_ratios.first(), choice.ridges.first(), choice.priors.first())
    else {
        return Err(Error::invalid("orders, period_ratios, ridges, priors", "at least one of each", "an empty list"));
    };
    for prior in &choice.priors {
        prior.validate()?;
    }
    let fold_of_point = deal(observations.point_count(), choice.folds, choice.groups.as_deref(), choice.seed)?;
    let base = FitOptions {
        order: highest,
        period: Period::Ratio(ratio),
        regularisation: Regularisation::Ridge(ridge),
        prior,
        covariance: false,
        ..options.clone()
    };
    let mut rows = reference_rows(observations, &base, monitor)?;
    // Sorted by part, so that a part is a slice; the order within a part is that of the observations.
    let mut order: Vec<usize> = (0..rows.len()).collect();
    let fold_of_row: Vec<usize> = observations.point_of_rows().map(|p| fold_of_point[p]).collect();
    order.sort_by_key(|&k| fold_of_row[k]);
    rows = order.iter().map(|&k| rows[k]).collect();
    let parts: Vec<&[LinearRow]> = {
        let mut rest = rows.as_slice();
        (0..choice.folds)
            .map(|f| {
                let (here, after) = rest.split_at(fold_of_row.iter().filter(|&&g| g == f).count());
                rest = after;
                here
            })
            .collect()
    };
    let mut candidates = Vec::new();
    for (k, &period_ratio) in choice.period_ratios.iter().enumerate() {
        let prepared =
            PreparedFit::new(observations, &FitOptions { period: Period::Ratio(period_ratio), ..base.clone() })?;
        let share =
            |part: usize| (k as f64 + part as f64 / (choice.folds + 1) as f64) / choice.period_ratios.len() as f64;
        let step = |part: usize| Progress::whole(monitor).part(share(part), share(part + 1));
        let normals = parts
            .iter()
            .enumerate()
            .map(|(i, part)| Normal::of(&prepared.basis, part, step(i)))
            .collect::<Result<Vec<_>>>()?;
        let mut whole = Normal {
            gram: DMatrix::zeros(prepared.basis.len(), prepared.basis.len()),
            right: DVector::zeros(prepared.basis.len()),
        };
        for normal in &normals {
            whole.gram += &normal.gram;
            whole.right += &normal.right;
        }
        let dampings: Vec<Vec<f64>> = choice.priors.iter().map(|&p| prepared.basis.damping(p)).collect();
        let mut choices: Vec<(usize, f64, usize)> = Vec::new();
        for &order in &choice.orders {
            for &ridge in &choice.ridges {
                choices.extend((0..dampings.len()).map(|prior| (order, ridge, prior)));
            }
        }
        let mut squares = vec![Vec::with_capacity(choice.folds); choices.len()];
        for (part, normal) in parts.iter().zip(&normals) {
            let training = Normal { gram: &whole.gram - &normal.gram, right: &whole.right - &normal.right };
            let solutions = solve_all(&training, &choices, &dampings)?;
            let errors = left_out_errors(&prepared, part, &solutions, step(choice.folds))?;
            for (all, error) in squares.iter_mut().zip(errors) {
                all.push((error, part.len()));
            }
        }
        for (&(order, ridge, prior), parts) in choices.iter().zip(&squares) {
            let (rms, rms_error) = summarise(parts);
            candidates.push(Choice { order, period_ratio, ridge, prior: choice.priors[prior], rms, rms_error });
        }
    }
    let best = (0..candidates.len()).fold(0, |best, k| if candidates[k].rms < candidates[best].rms { k } else { best });
    Ok(Selection { candidates, best })
}

/// Part of every point.
pub(super) fn deal(points: usize, folds: usize, groups: Option<&[u64]>, seed: u64) -> Result<Vec<usize>> {
    if folds < 2 {
        return Err(Error::invalid("folds", "at least 2", folds));
    }
    let labels: Vec<u64> = match groups {
        None => (0..points as u64).collect(),
        Some(groups) if groups.len() == points => groups.to_vec(),
        Some(groups) => {
            return Err(Error::shape("groups", format!("({points},) as the points"), format!("({},)", groups.len())));
        }
    };
    let mut distinct = labels.clone();
    distinct.sort_unstable();
    distinct.dedup();
    if distinct.len() < folds {
        return Err(Error::invalid("groups", format!("at least {folds} labels, one a part"), distinct.len()));
    }
    let mut parts: Vec<usize> = (0..distinct.len()).map(|k| k % folds).collect();
    parts.shuffle(&mut rand_pcg::Pcg64::seed_from_u64(seed));
    Ok(labels.iter().map(|l| parts[distinct.partition_point(|d| d < l)]).collect())
}

/// The equations about a fit to everything, where they depend on one.
fn reference_rows(observations: &Observations, base: &FitOptions, monitor: &dyn Monitor) -> Result<Vec<LinearRow>> {
    let curved = observations.rows.iter().any(|r| matches!(r.sensed, Sensed::Intensity(_)));
    if !curved && base.huber.is_none() {
        let none = vec![[0.0; 3]; observations.point_count()];
        return Ok(linear_rows(observations, &none, &vec![1.0; observations.len()]));
    }
    let model = fit(observations, base, monitor)?;
    let axis = |i: usize| observations.points.iter().map(|p| p[i]).collect::<Vec<_>>();
    let (north, east, down) = (axis(0), axis(1), axis(2));
    let field = model.field(&Positions::new(&north, &east, &down)?, true);
    let robust = match base.huber {
        None => vec![1.0; observations.len()],
        Some(bound) => huber_weights(observations, &residuals(observations, &field), bound),
    };
    Ok(linear_rows(observations, &field, &robust))
}

/// Coefficients of every choice, filled up with zeros to the highest order.
fn solve_all(training: &Normal, choices: &[(usize, f64, usize)], dampings: &[Vec<f64>]) -> Result<DMatrix<f64>> {
    let solutions = choices
        .par_iter()
        .map(|&(order, ridge, prior)| {
            let leading = training.leading(coefficient_count(order));
            let ridge = Regularisation::Ridge(ridge);
            let solution = Solver::new(leading.gram, ridge, &dampings[prior])?.solve(&leading.right);
            Ok(solution.resize_vertically(training.right.len(), 0.0))
        })
        .collect::<Result<Vec<_>>>()?;
    Ok(DMatrix::from_columns(&solutions))
}

/// Sum of the squared residuals of a part for every choice. From the rows: the normal equations would lose it in
/// cancellation.
fn left_out_errors(
    prepared: &PreparedFit,
    part: &[LinearRow],
    solutions: &DMatrix<f64>,
    progress: Progress<'_>,
) -> Result<Vec<f64>> {
    let mut sums = vec![0.0; solutions.ncols()];
    let turned = solutions.transpose();
    for_each_block(&prepared.basis, part, progress, |rows, _, design| {
        let predicted = &turned * design;
        for (row, column) in rows.iter().zip(predicted.column_iter()) {
            for (sum, p) in sums.iter_mut().zip(column.iter()) {
                *sum += (row.target - p).powi(2);
            }
        }
    })?;
    Ok(sums)
}

/// Root mean square over all parts, and its standard error from their scatter.
fn summarise(parts: &[(f64, usize)]) -> (f64, f64) {
    let count: usize = parts.iter().map(|p| p.1).sum();
    let rms = (parts.iter().map(|p| p.0).sum::<f64>() / count as f64).sqrt();
    let each: Vec<f64> = parts.iter().map(|p| (p.0 / p.1.max(1) as f64).sqrt()).collect();
    let mean = each.iter().sum::<f64>() / each.len() as f64;
    let variance = each.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / (each.len() - 1) as f64;
    (rms, (variance / each.len() as f64).sqrt())
}
