//! One candidate looked at closely: its parameters, its misfit, what it tells of the offset.

use super::super::noise::ErrorLevel;
use super::fill::fill;
use super::integral::{Tails, derivatives, nuisances, weigh};
use super::setup::{FEW_PARAMETERS, KernelScratch, LANES, MOST_PARAMETERS, SOME_PARAMETERS, Setup, WIDENING};

/// Standard deviations beyond which a sample is a miss. A Student-t distribution with nu = 10 has 5 in 10,000 there, one with nu = 3 15 in 1,000.
const MISS: f64 = 5.0;

/// What one candidate looks like under one error level.
#[derive(Debug, Clone, Copy, Default)]
pub(in super::super) struct Detail {
    /// Measured minus map constant, units.
    pub bias: f64,
    /// Nuisance parameters beside the bias, in the setup's order, standard deviations about the component.
    pub theta: [f64; MOST_PARAMETERS],
    /// Mean of (nu + 1) z^2 / (nu + z^2) over the samples that are no misses, 1 where the model holds.
    pub misfit: f64,
    /// Samples whose residual is beyond [`MISS`] standard deviations.
    pub misses: usize,
    /// Samples that lie on the map.
    pub known: usize,
    /// Information on the offset, nuisance parameters out, one over square metres: `[ee, en, nn]`.
    pub information: [f64; 3],
}

/// Looks closely at one candidate (cells of the map) under one error level.
pub(in super::super) fn detail(
    setup: &Setup<'_>,
    offset: [f64; 2],
    level: ErrorLevel,
    scratch: &mut KernelScratch,
) -> Detail {
    crate::instructions::chosen().dispatch(Single { setup, offset, level, scratch })
}

struct Single<'a, 'b> {
    setup: &'a Setup<'b>,
    offset: [f64; 2],
    level: ErrorLevel,
    scratch: &'a mut KernelScratch,
}

impl pulp::WithSimd for Single<'_, '_> {
    type Output = Detail;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) -> Detail {
        look_closely(self.setup, self.offset, self.level, self.scratch)
    }
}

#[inline(always)]
fn look_closely(setup: &Setup<'_>, offset: [f64; 2], level: ErrorLevel, scratch: &mut KernelScratch) -> Detail {
    fill::<false>(setup, &[offset], &[level], scratch);
    weigh::<false>(scratch, &level);
    let with_bias = usize::from(setup.bias_sigma.is_some());
    let mut theta = [[0.0; LANES]; MOST_PARAMETERS];
    let tails = Tails::of(&level);
    match with_bias + setup.shapes.len() {
        n if n <= FEW_PARAMETERS => nuisances::<false, FEW_PARAMETERS>(setup, scratch, tails, &WIDENING, &mut theta),
        n if n <= SOME_PARAMETERS => nuisances::<false, SOME_PARAMETERS>(setup, scratch, tails, &WIDENING, &mut theta),
        _ => nuisances::<false, MOST_PARAMETERS>(setup, scratch, tails, &WIDENING, &mut theta),
    };
    let nu = level.nu;
    let (mut misfit, mut known, mut misses) = (0.0, 0, 0);
    let size = with_bias + setup.shapes.len();
    // Fisher information of (offset east, north, nuisances); the Schur complement leaves that of the offset.
    let mut full = [[0.0; MOST_PARAMETERS + 2]; MOST_PARAMETERS + 2];
    let mut derived = [[0.0; LANES]; MOST_PARAMETERS];
    for (k, row) in scratch.rows.iter().enumerate() {
        let p = f64::from(row.precision[0]);
        if p == 0.0 {
            continue;
        }
        known += 1;
        derivatives(setup, row, k, with_bias, &mut derived);
        let mut h = [0.0; MOST_PARAMETERS + 2];
        h[0] = f64::from(row.gradient[0][0]);
        h[1] = f64::from(row.gradient[1][0]);
        let mut e = f64::from(row.error[0]);
        for i in 0..size {
            h[2 + i] = f64::from(derived[i][0]);
            e -= h[2 + i] * theta[i][0];
        }
        let z2 = e * e * p;
        if z2 > MISS * MISS {
            misses += 1;
        } else {
            misfit += (nu + 1.0) * z2 / (nu + z2);
        }
        for i in 0..size + 2 {
            for j in 0..size + 2 {
                full[i][j] += p * h[i] * h[j];
            }
        }
    }
    if let Some(s) = setup.bias_sigma
        && s.is_finite()
    {
        full[2][2] += 1.0 / (s * s);
    }
    for i in 0..setup.shapes.len() {
        // The whole prior: what is known of the offset must not depend on how it was divided.
        full[2 + with_bias + i][2 + with_bias + i] += setup.narrowed[i] * setup.narrowed[i];
    }
    let information = schur(full, size);
    let mut rest = [0.0; MOST_PARAMETERS];
    for i in 0..setup.shapes.len() {
        rest[i] = theta[with_bias + i][0];
    }
    Detail {
        bias: if with_bias == 1 { theta[0][0] } else { 0.0 },
        theta: rest,
        misfit: misfit / (known - misses).max(1) as f64,
        misses,
        known,
        information,
    }
}

/// Information on the first two parameters when the `others` after them are unknown.
fn schur(mut m: [[f64; MOST_PARAMETERS + 2]; MOST_PARAMETERS + 2], others: usize) -> [f64; 3] {
    for pivot in (2..2 + others).rev() {
        let diagonal = m[pivot][pivot];
        if diagonal <= 0.0 {
            continue;
        }
        for i in 0..pivot {
            for j in 0..pivot {
                m[i][j] -= m[i][pivot] * m[pivot][j] / diagonal;
            }
        }
    }
    [m[0][0], m[0][1], m[1][1]]
}
