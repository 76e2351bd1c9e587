//! What a search for the best candidate and its rival alone lets it skip.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// A finished candidate.
#[derive(Debug, Clone, Copy)]
struct Entry {
    score: f64,
    row: usize,
    column: usize,
}

/// The least score and the least one more than `away` rows or columns from it are wanted; no other.
///
/// Whichever candidate wins, one of any two that lie more than twice `away` apart is far enough from it to be its
/// rival. So a candidate that is worse than both of such a pair is neither winner nor rival and can be given up, and
/// the answer does not depend on when that is noticed.
#[derive(Debug)]
pub struct BestTwo {
    away: [f64; 2],
    pair: Mutex<[Option<Entry>; 2]>,
    /// Bits of the worse score of the best pair so far, which is not negative: the order of the bits is its own.
    limit: AtomicU64,
}

impl BestTwo {
    /// Of which the second is more than `away` `[columns, rows]` from the first in either direction.
    pub fn new(away: [f64; 2]) -> Self {
        Self { away, pair: Mutex::default(), limit: AtomicU64::new(f64::INFINITY.to_bits()) }
    }

    /// A candidate beyond it is not wanted.
    pub fn limit(&self) -> f64 {
        f64::from_bits(self.limit.load(Ordering::Relaxed))
    }

    /// Takes note of a finished candidate with a score that is not negative.
    pub fn finished(&self, score: f64, row: usize, column: usize) {
        if !(score < self.limit()) {
            return;
        }
        let Ok(mut pair) = self.pair.lock() else { return };
        let new = Entry { score, row, column };
        let far = |old: &Entry| {
            row.abs_diff(old.row) as f64 > 2.0 * self.away[1] || column.abs_diff(old.column) as f64 > 2.0 * self.away[0]
        };
        let partner = pair.iter().flatten().copied().filter(far).min_by(|a, b| a.score.total_cmp(&b.score));
        match (partner, *pair) {
            (Some(partner), _) => {
                *pair = if score < partner.score { [Some(new), Some(partner)] } else { [Some(partner), Some(new)] };
                self.limit.fetch_min(score.max(partner.score).to_bits(), Ordering::Relaxed);
            }
            // Nearer to both: the better of what is there gives way only to a better one.
            (None, [first, _]) => {
                if first.is_none_or(|first| score < first.score) {
                    *pair = [Some(new), None];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn least(scores: &[f64], columns: usize, admit: impl Fn(usize, usize) -> bool) -> f64 {
        let admitted = scores.iter().enumerate().filter(|(i, _)| admit(i / columns, i % columns));
        admitted.map(|(_, s)| *s).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn the_limit_never_falls_below_the_second_wanted_score() {
        let (rows, columns, away) = (9, 11, [2.0, 1.0]);
        let mut state = 7_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64
        };
        let mut useful = 0;
        for _ in 0..300 {
            let scores: Vec<f64> = (0..rows * columns).map(|_| random()).collect();
            let best = least(&scores, columns, |_, _| true);
            let at = scores.iter().position(|s| *s == best).unwrap_or(0);
            let second = least(&scores, columns, |row, column| {
                row.abs_diff(at / columns) as f64 > away[1] || column.abs_diff(at % columns) as f64 > away[0]
            });
            let contest = BestTwo::new(away);
            for (i, &score) in scores.iter().enumerate() {
                contest.finished(score, i / columns, i % columns);
                assert!(contest.limit() >= second);
            }
            useful += usize::from(contest.limit() < 2.0 * second);
        }
        assert!(useful > 200, "{useful}");
    }
}
