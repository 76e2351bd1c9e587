//! One offset looked at closely, and what is to be expected of a track before it is flown.

use super::super::goodness;
use super::super::kernel::{self, KernelScratch};
use super::super::noise::ErrorLevel;
use super::channel::PreparedChannel;
use super::ready::Problem;

/// What is to be expected of a track: see [`Problem::expected`].
pub(in super::super) struct Expected {
    pub bound: [[f64; 2]; 2],
    pub covariance: [[f64; 2]; 2],
    /// Correlation of the map's error from one sample to the next.
    pub coefficient: f64,
    pub map_sigma: Vec<f64>,
    pub sensor_sigma: f64,
    /// Standard deviation of the logarithm of a track's error level.
    pub spread: f64,
}

/// What one offset looks like from near: see [`Problem::detail`].
pub(in super::super) struct ModeDetail {
    /// Measured minus map, value units.
    pub bias: f64,
    pub heading_deg: f64,
    pub scale: f64,
    /// p-value of the residuals: see [`Problem::goodness`].
    pub goodness: f64,
}

impl Problem<'_> {
    /// Information on the offset at one place under every level, nuisance parameters out: see [`kernel::detail`].
    pub fn information(&self, channel: &PreparedChannel, offset: [f64; 2], step: [f64; 2]) -> Vec<[f64; 3]> {
        let mut scratch = KernelScratch::default();
        (channel.noise.levels.iter().enumerate())
            .map(|(v, level)| {
                let setup = self.setup(channel, self.best_component(channel, offset, v, step), step);
                kernel::detail(&setup, channel.cells(offset), *level, &mut scratch).information
            })
            .collect()
    }

    /// A close look at one offset: the parameters by the first channel, the residuals of all.
    pub fn detail(&self, offset: [f64; 2], step: [f64; 2]) -> ModeDetail {
        let channel = &self.channels[0];
        let levels = &channel.noise.levels;
        // That of a spread of levels which is typical, or the worst that an unknown map may be.
        let index = if channel.noise.levels_are_distances { levels.len() - 1 } else { channel.noise.typical };
        let component = self.best_component(channel, offset, index, step);
        let setup = self.setup(channel, component, step);
        let detail = kernel::detail(&setup, channel.cells(offset), levels[index], &mut KernelScratch::default());
        let (heading_deg, scale) = self.nuisance.heading_and_scale(&self.nuisance.components[component], &detail.theta);
        // Of several channels the worst, times their number: the chance that any of them is as bad (Bonferroni).
        let worst = self.channels.iter().map(|c| self.goodness(c, offset, step)).fold(1.0, f64::min);
        let goodness = (worst * self.channels.len() as f64).min(1.0);
        ModeDetail { bias: detail.bias * channel.unit, heading_deg, scale, goodness }
    }

    /// p-value of one channel's residuals at an offset, over what the error level of a track may be (Box, J. Roy. Stat. Soc. A 143
    /// (1980) 383: the prior predictive check).
    fn goodness(&self, channel: &PreparedChannel, offset: [f64; 2], step: [f64; 2]) -> f64 {
        let (map_sigma, distance) = self.along(channel);
        let variances = [channel.mean_variance(&map_sigma), channel.between(self.samples)];
        let setup = self.setup(channel, self.best_component(channel, offset, channel.noise.typical, step), step);
        let mut scratch = KernelScratch::default();
        let tail = |level: ErrorLevel| {
            let detail = kernel::detail(&setup, channel.cells(offset), level, &mut scratch);
            let (_, temper) = channel.temper(&level, distance, variances, self.spacing_m);
            level.log_prior.exp() * goodness::p_value(&detail, level.nu, temper)
        };
        channel.noise.checked().into_iter().map(tail).sum()
    }

    /// What is to be expected at the track's own positions: offset zero, no noise in the values.
    pub fn expected(&self) -> Expected {
        let channel = &self.channels[0];
        let noise = &channel.noise;
        let levels = &noise.levels;
        // The level expected of this map: the middle one, or the most probable of an unknown map.
        let level = levels.iter().copied().fold(levels[0], |a, b| if b.log_prior > a.log_prior { b } else { a });
        // The first component is the likeliest: nothing moved.
        let setup = self.setup(channel, 0, [0.0, 0.0]);
        let mut scratch = KernelScratch::default();
        let detail = kernel::detail(&setup, [0.0, 0.0], level, &mut scratch);
        // Of the stated errors: what the map cannot say between its nodes is no part of the bound.
        let exact_between = ErrorLevel { between: 0.0, ..level };
        let stated = kernel::detail(&setup, [0.0, 0.0], exact_between, &mut scratch);
        let (map_sigma, distance) = self.along(channel);
        let variances = [channel.mean_variance(&map_sigma), channel.between(self.samples)];
        let (share, temper) = channel.temper(&level, distance, variances, self.spacing_m);
        let length = channel.correlation_m(&level, distance);
        let coefficient = if length > 0.0 && share > 0.0 { (-self.spacing_m / length).exp() } else { 0.0 };
        let prior = self.prior_information();
        let invert = |information: [f64; 3], factor: f64| {
            let [ee, en, nn] = information.map(|i| factor * i);
            let (ee, nn) = (ee + prior[0], nn + prior[1]);
            let determinant = ee * nn - en * en;
            [[nn / determinant, -en / determinant], [-en / determinant, ee / determinant]]
        };
        let registration = share * (noise.registration * distance).powi(2);
        let forecast = noise.forecast.unwrap_or_default();
        // What the Student-t estimate loses against the normal one where errors are normal: with nu = 3 some 10 %, with 10 some 2 %.
        let loss = 1.0 + 1.0 / (level.nu * level.nu);
        let mut covariance = invert(detail.information, temper);
        for (d, row) in covariance.iter_mut().enumerate() {
            for v in row.iter_mut() {
                *v *= loss;
            }
            row[d] += registration;
            for v in row.iter_mut() {
                *v *= forecast.spread * forecast.spread;
            }
            row[d] += (forecast.registration * distance).powi(2);
        }
        Expected {
            bound: invert(stated.information, 1.0),
            covariance,
            coefficient,
            map_sigma: map_sigma.iter().map(|s| forecast.level * level.factor * s).collect(),
            sensor_sigma: noise.sensor_variance.sqrt(),
            spread: noise.spread,
        }
    }

    /// Factor from the computed covariance to the one that is declared: that of the most careful of the channels' maps.
    pub fn covariance_factor(&self) -> f64 {
        self.channels.iter().filter_map(|c| c.noise.covariance_factor).reduce(f64::max).unwrap_or(1.0)
    }

    /// The risk to declare for a computed one: as the most careful of the channels' maps has it.
    pub fn declared(&self, computed: f64) -> f64 {
        let length_m = self.spacing_m * self.samples.saturating_sub(1) as f64;
        let read = |c: &PreparedChannel| {
            let risk = c.noise.recalibration.map(|r| r.risk(computed));
            match c.noise.lapses {
                Some(lapses) => Some(lapses.risk(risk.unwrap_or(computed), length_m)),
                None => risk,
            }
        };
        self.channels.iter().filter_map(read).reduce(f64::max).unwrap_or(computed)
    }

    /// Map sigma at every indicated position, and the mean distance to the data.
    fn along(&self, channel: &PreparedChannel) -> (Vec<f64>, f64) {
        let (mut sigma, mut distance, mut known) = (Vec::with_capacity(self.samples), 0.0, 0.0);
        for ([px, py], storey) in channel.indicated.iter().zip(&channel.storeys) {
            let sample = channel.patch.at(*px, *py, *storey);
            let here = sample.value.is_finite();
            sigma.push(if here { f64::from(sample.variance).sqrt() } else { 0.0 });
            if here {
                distance += f64::from(sample.distance);
                known += 1.0;
            }
        }
        (sigma, if known > 0.0 { distance / known } else { 0.0 })
    }
}
