//! Seeded random numbers whose bits depend on the seed alone.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// A stream of random numbers: the same seed gives the same bits on every machine and for every version of this crate.
///
/// Uniform and normal numbers are made here, from PCG64's output (O'Neill 2014, HMC-CS-2014-0905), because the
/// distributions of general libraries may change their mapping from bits to numbers between versions.
///
/// ```
/// use geomag_core::synthetic::Random;
/// let mut a = Random::stream(42, 3);
/// let mut b = Random::stream(42, 3);
/// assert_eq!(a.normal().to_bits(), b.normal().to_bits());
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Random {
    generator: Pcg64,
}

impl Random {
    /// The stream of a seed.
    pub fn new(seed: u64) -> Self {
        Self { generator: Pcg64::seed_from_u64(seed) }
    }

    /// Stream `index` of a seed: one a trial, one a purpose. Streams of one seed are independent of each other.
    pub fn stream(seed: u64, index: u64) -> Self {
        Self::new(Self::derive(seed, index))
    }

    /// A seed made from a seed and an index, by two rounds of the `SplitMix64` finaliser (Steele, Lea, Flood 2014).
    pub fn derive(seed: u64, index: u64) -> u64 {
        let mix = |mut z: u64| {
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        };
        mix(mix(seed.wrapping_add(0x9e37_79b9_7f4a_7c15)) ^ index.wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.generator.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Uniform in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number below `n`; zero for `n` = 0.
    pub fn below(&mut self, n: u64) -> u64 {
        // The multiply-shift bias is below n / 2^64.
        ((u128::from(self.generator.next_u64()) * u128::from(n)) >> 64) as u64
    }

    /// Standard normal, by the polar method (Marsaglia, Bray 1964).
    pub fn normal(&mut self) -> f64 {
        loop {
            let (u, v) = (2.0 * self.unit() - 1.0, 2.0 * self.unit() - 1.0);
            let s = u * u + v * v;
            if s > 0.0 && s < 1.0 {
                return u * (-2.0 * libm::log(s) / s).sqrt();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_those_of_the_distributions() {
        let mut random = Random::new(1);
        let n = 200_000;
        let normal: Vec<f64> = (0..n).map(|_| random.normal()).collect();
        let mean = normal.iter().sum::<f64>() / f64::from(n);
        let variance = normal.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        let fourth = normal.iter().map(|v| v.powi(4)).sum::<f64>() / f64::from(n);
        // Four standard errors of each.
        assert!(mean.abs() < 4.0 / f64::from(n).sqrt());
        assert!((variance - 1.0).abs() < 4.0 * (2.0 / f64::from(n)).sqrt());
        assert!((fourth - 3.0).abs() < 4.0 * (96.0 / f64::from(n)).sqrt());
        let mut counts = [0_u32; 7];
        (0..70_000).for_each(|_| counts[random.below(7) as usize] += 1);
        assert!(counts.iter().all(|&c| (f64::from(c) - 10_000.0).abs() < 4.0 * 100.0));
        assert_eq!(random.below(0), 0);
    }

    #[test]
    fn bits_are_pinned() {
        // Made once on x86-64; any machine and any later version must give the same.
        let mut random = Random::stream(2026, 5);
        let got = [random.unit().to_bits(), random.normal().to_bits(), random.below(1000)];
        assert_eq!(got, [4_599_888_570_735_791_598, 13_830_530_395_299_156_715, 366]);
    }

    #[test]
    fn streams_differ() {
        let first: Vec<u64> = (0..1000).map(|i| Random::stream(9, i).unit().to_bits()).collect();
        let mut unique = first.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(unique.len(), first.len());
        assert_ne!(Random::derive(1, 2), Random::derive(2, 1));
    }
}
