//! Which samples of a track to match: the sampling theorem, one a cell, and delta modulation [DM-ICCP].

use serde::{Deserialize, Serialize};

use crate::bounds::require_quantum;
use crate::error::{Error, Result, require_finite, require_not_negative, require_positive};
use crate::monitor::{Monitor, Quiet};
use crate::state::Saved;

/// Delta modulation of a stream of values: a sample is chosen when the staircase lags it by another quantum.
///
/// The staircase starts at the first value and follows with one quantum a sample,
/// F'(k) = F'(k-1) + sgn(F(k) - F'(k-1)) delta with sgn(0) = +1; code(k) = 1 where the sign is +. Sample k is chosen when
/// code(k) = code(k-1) [DM-ICCP]. In rough field that is every sample, in flat field few or none.
///
/// ```
/// use geomag_core::matching::sequence::DeltaModulator;
/// let mut modulator = DeltaModulator::new(1.0)?;
/// let chosen: Vec<bool> = [0.0, 1.0, 2.0, 3.0, 2.6].map(|v| modulator.update(v).expect("finite").chosen).to_vec();
/// assert_eq!(chosen, [false, false, true, true, false]);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DeltaModulator {
    quantum: f64,
    staircase: Option<f64>,
    code: Option<bool>,
    count: usize,
}

/// What delta modulation made of one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeltaStep {
    /// Number of the sample since the start, from 0.
    pub number: usize,
    /// Its code; the first sample, where the staircase starts, has none.
    pub code: Option<bool>,
    /// Whether it is chosen.
    pub chosen: bool,
}

impl Saved for DeltaModulator {
    const NAME: &'static str = "DeltaModulator";

    fn check(&self) -> Result<()> {
        require_quantum("quantum", self.quantum)?;
        if let Some(staircase) = self.staircase {
            require_finite("staircase", &[staircase])?;
        }
        if (self.staircase.is_some(), self.code.is_some()) != (self.count > 0, self.count > 1) {
            return Err(Error::invalid("values taken", "a staircase after one, a code after two", self.count));
        }
        Ok(())
    }
}

impl DeltaModulator {
    /// A modulator with a quantum in the unit of the values.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a quantum that is not positive.
    pub fn new(quantum: f64) -> Result<Self> {
        require_quantum("quantum", quantum)?;
        Ok(Self { quantum, staircase: None, code: None, count: 0 })
    }

    /// Takes the next value.
    ///
    /// # Errors
    /// [`Error::NotFinite`]; the modulator is as before.
    pub fn update(&mut self, value: f64) -> Result<DeltaStep> {
        if !value.is_finite() {
            return Err(Error::NotFinite { what: "delta modulation values".into(), index: self.count, got: value });
        }
        let number = self.count;
        self.count = self.count.saturating_add(1);
        let Some(staircase) = self.staircase else {
            self.staircase = Some(value);
            return Ok(DeltaStep { number, code: None, chosen: false });
        };
        let code = value - staircase >= 0.0;
        self.staircase = Some(staircase + if code { self.quantum } else { -self.quantum });
        let chosen = self.code == Some(code);
        self.code = Some(code);
        Ok(DeltaStep { number, code: Some(code), chosen })
    }

    /// Begins again: no value seen.
    pub fn reset(&mut self) {
        *self = Self { quantum: self.quantum, staircase: None, code: None, count: 0 };
    }

    /// The quantum.
    pub fn quantum(&self) -> f64 {
        self.quantum
    }

    /// Values taken so far.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Where the staircase stands; `None` before the first value.
    pub fn staircase(&self) -> Option<f64> {
        self.staircase
    }
}

/// Delta modulation of a whole sequence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DeltaModulation {
    /// Indices of the chosen samples, ascending.
    pub keep: Vec<usize>,
    /// Codes of samples 1, 2, ...: one fewer than there are samples.
    pub codes: Vec<bool>,
}

/// Delta modulation of `values` with a quantum; see [`DeltaModulator`].
///
/// # Errors
/// [`Error::Invalid`] for a quantum that is not positive, [`Error::NotFinite`] naming the first bad value.
pub fn delta_modulation(values: &[f64], quantum: f64) -> Result<DeltaModulation> {
    let mut modulator = DeltaModulator::new(quantum)?;
    let mut out = DeltaModulation { keep: Vec::new(), codes: Vec::with_capacity(values.len().saturating_sub(1)) };
    for &value in values {
        let step = modulator.update(value)?;
        out.codes.extend(step.code);
        if step.chosen {
            out.keep.push(step.number);
        }
    }
    Ok(out)
}

/// The samples that a code sequence chooses: those whose code equals the one before. `codes[0]` belongs to sample 1.
///
/// ```
/// use geomag_core::matching::sequence::chosen_by_codes;
/// let codes: Vec<bool> = "010111111000".chars().map(|c| c == '1').collect();
/// assert_eq!(chosen_by_codes(&codes), [5, 6, 7, 8, 9, 11, 12]);
/// ```
pub fn chosen_by_codes(codes: &[bool]) -> Vec<usize> {
    (1..codes.len()).filter(|&k| codes[k] == codes[k - 1]).map(|k| k + 1).collect()
}

/// The frequency, cycles per metre, under which a share of the energy of evenly spaced values lies, their mean removed;
/// zero for constant values.
///
/// Rule 1 (sampling theorem): a matching sequence needs two samples a period of it [DM-ICCP, at least 96 %].
///
/// # Errors
/// [`Error::TooFewSamples`] under 3 values, [`Error::NotFinite`], [`Error::Invalid`] for a spacing that is not positive
/// or a share outside (0, 1].
pub fn energy_bandwidth(values: &[f64], spacing_m: f64, share: f64) -> Result<f64> {
    energy_bandwidth_monitored(values, spacing_m, share, &Quiet)
}

/// [`energy_bandwidth`] that can be watched and stopped: its work grows with the square of the number of values.
///
/// # Errors
/// As [`energy_bandwidth`], and [`Error::Interrupted`].
pub fn energy_bandwidth_monitored(values: &[f64], spacing_m: f64, share: f64, monitor: &dyn Monitor) -> Result<f64> {
    let n = values.len();
    if n < 3 {
        return Err(Error::TooFewSamples { what: "energy_bandwidth".into(), needed: 3, got: n });
    }
    require_finite("energy_bandwidth values", values)?;
    require_positive("spacing_m", spacing_m)?;
    if !(share > 0.0 && share <= 1.0) {
        return Err(Error::invalid("energy share", "a number in (0, 1]", share));
    }
    let mean = values.iter().sum::<f64>() / n as f64;
    let turn: Vec<(f64, f64)> = (0..n).map(|i| (std::f64::consts::TAU * i as f64 / n as f64).sin_cos()).collect();
    let energy: Vec<f64> = (1..=n / 2)
        .map(|f| {
            monitor.advance(f as u64, (n / 2) as u64)?;
            let (mut re, mut im, mut at) = (0.0, 0.0, 0);
            for v in values {
                let (sin, cos) = turn[at];
                re += (v - mean) * cos;
                im -= (v - mean) * sin;
                at = (at + f) % n;
            }
            // The Nyquist line of an even length stands alone; every other line has its mirror image.
            Ok((re * re + im * im) * if 2 * f == n { 1.0 } else { 2.0 })
        })
        .collect::<Result<_>>()?;
    let total: f64 = energy.iter().sum();
    let scale = values.iter().fold(0.0_f64, |m, v| m.max((v - mean).abs()));
    let rounding = (values.iter().fold(0.0_f64, |m, v| m.max(v.abs())) * 8.0 * f64::EPSILON).max(f64::MIN_POSITIVE);
    if scale <= rounding {
        return Ok(0.0);
    }
    let mut sum = 0.0;
    for (i, e) in energy.iter().enumerate() {
        sum += e;
        if sum >= share * total * (1.0 - 1e-12) {
            return Ok((i + 1) as f64 / (n as f64 * spacing_m));
        }
    }
    Ok(0.5 / spacing_m)
}

/// Settings of [`choose_sequence`].
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SequenceRules {
    /// Quantum of the delta modulation, value units: more than the sensor's noise (rule 3).
    pub quantum: f64,
    /// One map cell, metres (rule 2).
    pub cell_m: f64,
    /// Least distance between chosen samples, cells (rule 2).
    pub min_cells: f64,
    /// Share of the field's energy that the sampling must carry (rule 1).
    pub energy_share: f64,
}

/// A matching sequence that keeps the rules.
#[derive(Debug, Clone, PartialEq)]
pub struct ChosenSequence {
    /// Indices of the chosen samples, ascending.
    pub keep: Vec<usize>,
    /// Those of them that delta modulation passed over and the sampling theorem brought back.
    pub filled: Vec<usize>,
    /// Greatest distance between chosen samples that the sampling theorem allows, metres; infinite for a constant field.
    pub greatest_gap_m: f64,
    /// Whether rule 1 holds: false where the track itself, or rule 2, is too coarse for the field.
    pub sampled_enough: bool,
}

/// Chooses the samples of a track to match.
///
/// The track is thinned to one sample every `min_cells` cells (rule 2: v T >= n d); delta modulation of what is left
/// chooses those that the field tells apart (rule 3); where two chosen ones are further apart than half the shortest
/// period that matters (rule 1: `f_s` >= 2 `f_max`), as many as are needed of the passed-over ones between them come back.
///
/// `along_m` is the along-track distance of each sample, ascending.
///
/// # Errors
/// Arrays of unequal length, values or distances that are not finite, distances that run backwards, settings that are
/// not positive, fewer than 3 samples.
pub fn choose_sequence(along_m: &[f64], values: &[f64], rules: &SequenceRules) -> Result<ChosenSequence> {
    choose_sequence_monitored(along_m, values, rules, &Quiet)
}

/// [`choose_sequence`] that can be watched and stopped.
///
/// # Errors
/// As [`choose_sequence`], and [`Error::Interrupted`].
pub fn choose_sequence_monitored(
    along_m: &[f64],
    values: &[f64],
    rules: &SequenceRules,
    monitor: &dyn Monitor,
) -> Result<ChosenSequence> {
    let n = values.len();
    if along_m.len() != n {
        return Err(Error::shape("along_m", format!("({n},) as the values"), format!("({},)", along_m.len())));
    }
    require_finite("along_m", along_m)?;
    require_quantum("quantum", rules.quantum)?;
    require_positive("cell_m", rules.cell_m)?;
    require_not_negative("min_cells", rules.min_cells)?;
    if let Some(i) = along_m.windows(2).position(|w| w[1] < w[0]) {
        return Err(Error::invalid(
            format!("along_m[{}]", i + 1),
            format!("not less than {}", along_m[i]),
            along_m[i + 1],
        ));
    }
    if n < 3 {
        return Err(Error::TooFewSamples { what: "choose_sequence".into(), needed: 3, got: n });
    }
    let length = along_m[n - 1] - along_m[0];
    if length <= 0.0 {
        return Err(Error::invalid("along_m", "a track that moves", "the same distance throughout"));
    }
    let even = evenly(along_m, values);
    let bandwidth = energy_bandwidth_monitored(&even, length / (n - 1) as f64, rules.energy_share, monitor)?;
    let greatest_gap_m = if bandwidth > 0.0 { 0.5 / bandwidth } else { f64::INFINITY };
    let least_gap = rules.min_cells * rules.cell_m;
    let mut thinned = vec![0];
    let mut last = 0;
    for k in 1..n {
        if along_m[k] - along_m[last] >= least_gap * (1.0 - 1e-12) {
            thinned.push(k);
            last = k;
        }
    }
    let picked: Vec<f64> = thinned.iter().map(|&k| values[k]).collect();
    let modulated = delta_modulation(&picked, rules.quantum)?.keep;
    let mut keep: Vec<usize> = Vec::new();
    let mut filled = Vec::new();
    let mut next_modulated = modulated.into_iter().peekable();
    for (i, &k) in thinned.iter().enumerate() {
        let chosen = next_modulated.next_if_eq(&i).is_some();
        let too_far_to_skip = thinned.get(i + 1).is_some_and(|&after| {
            let from = keep.last().map_or(along_m[0], |&last| along_m[last]);
            along_m[after] - from > greatest_gap_m
        });
        if chosen || too_far_to_skip {
            keep.push(k);
            if !chosen {
                filled.push(k);
            }
        }
    }
    let mut from = along_m[0];
    let mut widest: f64 = 0.0;
    for &k in &keep {
        widest = widest.max(along_m[k] - from);
        from = along_m[k];
    }
    widest = widest.max(along_m[last] - from);
    Ok(ChosenSequence { sampled_enough: widest <= greatest_gap_m, keep, filled, greatest_gap_m })
}

/// The values at as many evenly spaced distances, by linear interpolation.
fn evenly(along_m: &[f64], values: &[f64]) -> Vec<f64> {
    let n = values.len();
    let step = (along_m[n - 1] - along_m[0]) / (n - 1) as f64;
    let mut j = 0;
    (0..n)
        .map(|i| {
            let at = along_m[0] + step * i as f64;
            while j + 2 < n && along_m[j + 1] < at {
                j += 1;
            }
            let gap = along_m[j + 1] - along_m[j];
            let t = if gap > 0.0 { ((at - along_m[j]) / gap).clamp(0.0, 1.0) } else { 0.0 };
            values[j] + t * (values[j + 1] - values[j])
        })
        .collect()
}
