//! A candidate at the gate: the biases that its samples allow, and how many samples do not fit.

use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct GateCandidate {
    pub offset: [f64; 2],
    /// Interval of the biases that most of the samples so far allow, and how many these are.
    pub bias: [f64; 2],
    pub support: u32,
    /// The same of some of the others: it takes the place of the first when it has more, so that an outlier does not
    /// decide which samples fit.
    pub rival: [f64; 2],
    pub rival_support: u32,
    /// Samples outside the first interval.
    pub misses: u32,
}

impl GateCandidate {
    pub fn new(offset: [f64; 2]) -> Self {
        let all = [f64::NEG_INFINITY, f64::INFINITY];
        Self { offset, bias: all, support: 0, rival: all, rival_support: 0, misses: 0 }
    }

    /// Whether its counts can be those of so many samples: each is support or a miss, and a rival's are among the misses.
    pub fn counts_within(&self, samples: usize) -> bool {
        let taken = u64::from(self.support) + u64::from(self.misses);
        self.rival_support <= self.misses && taken <= samples as u64 && taken < u64::from(u32::MAX)
    }

    /// Takes one more sample, which allows the biases in `own`; none beyond `most` either way is possible.
    pub fn take(&mut self, own: [f64; 2], most: f64) {
        let both = |a: [f64; 2]| {
            let [low, high] = [a[0].max(own[0]), a[1].min(own[1])];
            (low <= high && low <= most && high >= -most).then_some([low, high])
        };
        if let Some(bias) = both(self.bias) {
            self.bias = bias;
            self.support += 1;
            return;
        }
        self.misses += 1;
        if let Some(rival) = both(self.rival) {
            self.rival = rival;
            self.rival_support += 1;
        } else {
            self.rival = own;
            self.rival_support = u32::from(own[0] <= most && own[1] >= -most);
        }
        if self.rival_support > self.support {
            self.misses = self.misses + self.support - self.rival_support;
            std::mem::swap(&mut self.bias, &mut self.rival);
            std::mem::swap(&mut self.support, &mut self.rival_support);
        }
    }

    /// Takes in what another candidate allows, from which the truth may have come.
    pub fn join(&mut self, other: &Self) {
        let bias = [self.bias[0].min(other.bias[0]), self.bias[1].max(other.bias[1])];
        if other.misses < self.misses {
            *self = Self { offset: self.offset, ..*other };
        }
        self.bias = bias;
    }
}
