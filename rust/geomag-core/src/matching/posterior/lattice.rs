//! The lattice of offsets: where the first stage looks, which of its cells go on, and their quarters.

use super::options::PosteriorOptions;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};

/// Candidates of the first stage where the step is chosen here.
const FIRST_STAGE: f64 = 2500.0;

/// The offsets of the first stage: whole multiples of `step` up to `most` of them either way.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Lattice {
    /// Map units.
    pub step: [f64; 2],
    pub most: [i64; 2],
}

impl Lattice {
    /// That of a search on a map of the given cell.
    pub fn new(cell: [f64; 2], options: &PosteriorOptions) -> Result<Self> {
        let half = options.half_width;
        let step = options.step.unwrap_or_else(|| {
            // One cell, or coarser for a wide start: later stages refine, and the variance knows the step.
            let cells = (2.0 * half[0] / cell[0] + 1.0) * (2.0 * half[1] / cell[1] + 1.0);
            let factor = (cells / FIRST_STAGE).sqrt().max(1.0);
            // Beyond a few cells a coarse sample says nothing about the features between.
            let factor = factor.min(4.0);
            [cell[0] * factor, cell[1] * factor]
        });
        let most = [0, 1].map(|d| (half[d] / step[d] - 1e-9).ceil().max(0.0) as i64);
        let [columns, rows] = most.map(|m| 2 * m as u128 + 1);
        let needed = columns.saturating_mul(rows);
        if needed > u128::from(options.max_candidates) {
            let limit = options.max_candidates;
            return Err(Error::TooManyCandidates { what: "offset lattice".into(), needed, limit });
        }
        Ok(Self { step, most })
    }

    /// How many there are.
    pub fn len(&self) -> u64 {
        self.most.map(|m| 2 * m as u64 + 1).iter().product()
    }

    /// All of them, row by row.
    pub fn offsets(&self) -> Vec<[f64; 2]> {
        let [columns, rows] = self.most;
        let mut out = Vec::with_capacity(usize::try_from(self.len()).unwrap_or(0));
        for j in -rows..=rows {
            out.extend((-columns..=columns).map(|i| self.offset([i, j])));
        }
        out
    }

    pub fn offset(&self, index: [i64; 2]) -> [f64; 2] {
        [0, 1].map(|d| index[d] as f64 * self.step[d])
    }

    pub fn index(&self, offset: [f64; 2]) -> [i64; 2] {
        [0, 1].map(|d| (offset[d] / self.step[d]).round() as i64)
    }

    /// Where the cells of the outermost offsets end, map units.
    pub fn edge(&self) -> [f64; 2] {
        [0, 1].map(|d| (self.most[d] as f64 + 0.5) * self.step[d])
    }
}

/// The offsets whose `merit` is above minus `depth`, the best `most` where there are more, in their order.
pub(super) fn select(offsets: &[[f64; 2]], merit: &[f64], depth: f64, most: usize) -> Vec<[f64; 2]> {
    let mut floor = -depth;
    let mut values: Vec<f64> = merit.iter().copied().filter(|m| *m >= floor).collect();
    if values.len() > most {
        values.select_nth_unstable_by(most - 1, |a, b| b.total_cmp(a));
        floor = values[most - 1];
    }
    offsets.iter().zip(merit).filter(|(_, m)| **m >= floor).map(|(o, _)| *o).collect()
}

/// The four quarters of every cell of this step.
pub(super) fn children(cells: &[[f64; 2]], step: [f64; 2]) -> Vec<[f64; 2]> {
    let [x, y] = step.map(|s| 0.25 * s);
    cells.iter().flat_map(|o| [[-x, -y], [x, -y], [-x, y], [x, y]].map(|[u, v]| [o[0] + u, o[1] + v])).collect()
}

/// Variance per axis of a place anywhere in a lattice cell, square metres.
pub(super) fn lattice_variance(step: [f64; 2], scale_m: [f64; 2]) -> f64 {
    (0..2).map(|d| (step[d] * scale_m[d]).powi(2)).sum::<f64>() / 24.0
}
