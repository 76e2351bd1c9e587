//! The minima of several starts, under the error model that explains the residuals best.

use super::descent::{Minimum, Refiner};
use crate::error::Result;
use crate::matching::scene::Motion;

/// Multiples of the median sample spacing that are tried as the correlation distance of the map's error.
const CORRELATION_TRIALS: [f64; 7] = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];

impl Refiner<'_> {
    /// Distinct minima, the one of greatest mass first.
    pub fn minima(&self, noise: &[f64], starts: &[Motion]) -> Result<Vec<Minimum>> {
        let trials = self.correlation_trials();
        let mut best: Vec<Minimum> = Vec::new();
        for correlation in trials {
            let mut found: Vec<Minimum> = Vec::new();
            for start in starts {
                self.monitor.advance(0, 1)?;
                if let Some(minimum) = self.run(start, noise, correlation)
                    && !found.iter().any(|m| same_place(m, &minimum))
                {
                    found.push(minimum);
                }
            }
            found.sort_by(|a, b| b.log_mass.total_cmp(&a.log_mass));
            let better = match (found.first(), best.first()) {
                (Some(f), Some(b)) => f.log_mass > b.log_mass,
                (found, _) => found.is_some(),
            };
            if better {
                best = found;
            }
        }
        Ok(best)
    }

    fn correlation_trials(&self) -> Vec<f64> {
        let has_sigma = self.scene.channels.iter().any(|c| c.field.map_sigma().is_some());
        match self.options.map_correlation_m {
            Some(d) => vec![d],
            None if !has_sigma => vec![0.0],
            None => {
                let mut gaps: Vec<f64> =
                    self.scene.levers.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1])).collect();
                gaps.sort_by(f64::total_cmp);
                let gap = gaps.get(gaps.len() / 2).copied().unwrap_or(0.0);
                CORRELATION_TRIALS.iter().map(|m| m * gap).collect()
            }
        }
    }

    /// Noise variances from the residuals of the best of the starts, refined twice; for channels that state none.
    pub fn estimate_noise(&self, noise: &mut [f64], starts: &[Motion]) -> Result<()> {
        let unknown: Vec<bool> = noise.iter().map(|v| v.is_nan()).collect();
        let squares = |motion: &Motion, biases: &[f64], c: usize| {
            let r: Vec<f64> = (0..self.scene.len())
                .map(|k| {
                    let d = motion.displacement(self.scene.levers[k]);
                    let (value, _) = self.scene.sample(c, k, d, self.options.interpolation);
                    self.scene.channels[c].values[k] - value - biases[c]
                })
                .filter(|r| r.is_finite())
                .collect();
            let freedom = (r.len() as f64 - self.parameter_count() as f64).max(1.0);
            r.iter().map(|r| r * r).sum::<f64>() / freedom
        };
        for (c, unknown) in unknown.iter().enumerate() {
            if *unknown {
                let spread = |m: &Motion| squares(m, &vec![0.0; noise.len()], c);
                noise[c] = starts.iter().map(spread).fold(f64::INFINITY, f64::min).max(1e-12);
            }
        }
        for _ in 0..2 {
            self.monitor.advance(0, 1)?;
            let best =
                starts.iter().filter_map(|s| self.run(s, noise, 0.0)).max_by(|a, b| a.log_mass.total_cmp(&b.log_mass));
            if let Some(best) = best {
                for (c, unknown) in unknown.iter().enumerate() {
                    if *unknown {
                        noise[c] = squares(&best.motion, &best.biases, c).max(1e-12);
                    }
                }
            }
        }
        Ok(())
    }
}

/// Whether two minima are one: their newest points lie within a tenth of their uncertainty, or a metre.
fn same_place(a: &Minimum, b: &Minimum) -> bool {
    let apart = (a.motion.offset_m[0] - b.motion.offset_m[0]).hypot(a.motion.offset_m[1] - b.motion.offset_m[1]);
    let spread = (a.covariance[(0, 0)] + a.covariance[(1, 1)]).sqrt();
    apart < (0.2 * spread).max(1.0)
}
