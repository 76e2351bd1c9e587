//! From a candidate of a lattice to the minimum of the score beside it.
//!
//! The lattice finds the basin, not the minimum: on a map as coarse as its features a quadratic through scores a cell apart
//! misses it by a good part of a cell, and a covariance taken there belongs to another place. So the nine scores about the
//! place are taken again and again, an eighth as far apart each time, with the measure and the interpolation of the search.

use crate::error::Result;
use crate::lattice::Comparison;
use crate::matching::similarity::Scoring;
use crate::monitor::Monitor;

/// The next step as a share of the last.
const SHRINK: f64 = 0.125;
/// Moves to a better neighbour at one step.
const MOVES: usize = 4;

/// The winner among all candidates.
#[derive(Debug, Clone, Copy)]
pub(super) struct Best {
    pub score: f64,
    pub row: usize,
    pub column: usize,
    pub placement: usize,
}

/// A candidate refined below the lattice step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Refined {
    /// Offset, map units.
    pub offset: [f64; 2],
    /// Heading and scale that it was had under.
    pub placement: usize,
    /// Score of the candidate itself.
    pub on_lattice: f64,
    /// Score at the refined offset, never more than that.
    pub least: f64,
}

/// What is made least.
pub(super) struct Descent<'a> {
    pub scoring: &'a Scoring,
    pub comparison: &'a Comparison<'a>,
    pub mean: f64,
    pub distance_m: &'a [f64],
}

impl Descent<'_> {
    /// The minimum within one lattice step of an offset, to an `8^levels`-th of the step; the offset itself without any.
    pub fn from(&self, start: [f64; 2], placement: usize, levels: usize, monitor: &dyn Monitor) -> Result<Refined> {
        let lattice = self.comparison.lattice();
        let half = lattice.half().map(|h| h.min(1));
        let mut step = lattice.step();
        let mut around = self.about(start, half, step, monitor)?;
        let mut refined = Refined { offset: start, placement, on_lattice: around.centre(), least: around.centre() };
        let reach = step;
        let within = |at: [f64; 2]| (0..2).all(|d| (at[d] - start[d]).abs() <= reach[d] * (1.0 + 1e-9));
        for _ in 0..levels {
            for _ in 0..MOVES {
                let Some(way) = around.lower() else { break };
                let to = [0, 1].map(|d| refined.offset[d] + way[d] * step[d]);
                if !within(to) {
                    break;
                }
                around = self.about(to, half, step, monitor)?;
                refined = Refined { offset: to, least: around.centre(), ..refined };
            }
            let vertex = around.vertex();
            let to = [0, 1].map(|d| refined.offset[d] + vertex[d] * step[d]);
            step = step.map(|s| SHRINK * s);
            if vertex != [0.0; 2] && within(to) {
                let there = self.about(to, half, step, monitor)?;
                if there.centre() < refined.least {
                    refined = Refined { offset: to, least: there.centre(), ..refined };
                    around = there;
                    continue;
                }
            }
            around = self.about(refined.offset, half, step, monitor)?;
        }
        Ok(refined)
    }

    /// Scores of the offsets about one, in double precision.
    fn about(
        &self,
        offset: [f64; 2],
        half: [usize; 2],
        step: [f64; 2],
        monitor: &dyn Monitor,
    ) -> Result<Neighbourhood> {
        let comparison = self.comparison.around(offset, half, step)?;
        let (rows, columns) = (2 * half[1] + 1, 2 * half[0] + 1);
        let block = self.scoring.scores(&comparison, self.mean, self.distance_m, 0..rows, 0..columns, None, monitor)?;
        let mut scores = [[f64::NAN; 3]; 3];
        for (i, row) in block.chunks_exact(columns).enumerate() {
            for (j, score) in row.iter().enumerate() {
                scores[i + 1 - half[1]][j + 1 - half[0]] = *score;
            }
        }
        Ok(Neighbourhood { scores })
    }
}

/// Scores of the 3 x 3 offsets around one; NaN where there is none.
struct Neighbourhood {
    scores: [[f64; 3]; 3],
}

impl Neighbourhood {
    fn centre(&self) -> f64 {
        self.scores[1][1]
    }

    /// Where the least neighbour lies, in steps `[x, y]`; none that is lower than the centre.
    fn lower(&self) -> Option<[f64; 2]> {
        let mut least = (self.centre(), None);
        for (i, row) in self.scores.iter().enumerate() {
            for (j, &score) in row.iter().enumerate() {
                if score < least.0 {
                    least = (score, Some([j as f64 - 1.0, i as f64 - 1.0]));
                }
            }
        }
        least.1
    }

    /// Vertex of the quadratic through the neighbours, in steps `[x, y]`, at most one step away.
    ///
    /// Both directions together where the quadratic has a minimum there, else each on its own, else not at all.
    fn vertex(&self) -> [f64; 2] {
        let s = &self.scores;
        let c = s[1][1];
        let (gx, hx) = (0.5 * (s[1][2] - s[1][0]), s[1][2] - 2.0 * c + s[1][0]);
        let (gy, hy) = (0.5 * (s[2][1] - s[0][1]), s[2][1] - 2.0 * c + s[0][1]);
        let hxy = 0.25 * (s[2][2] - s[2][0] - s[0][2] + s[0][0]);
        let alone = |g: f64, h: f64| if h > 0.0 && g.is_finite() { (-g / h).clamp(-0.5, 0.5) } else { 0.0 };
        let det = hx * hy - hxy * hxy;
        if hx > 0.0 && hy > 0.0 && det > 1e-6 * hx * hy && gx.is_finite() && gy.is_finite() {
            let vertex = [(hxy * gy - hy * gx) / det, (hxy * gx - hx * gy) / det];
            if vertex.iter().all(|v| v.abs() <= 1.0) {
                return vertex;
            }
        }
        [alone(gx, hx), alone(gy, hy)]
    }
}
