//! Mean and covariance of a state, the covariance held as its Cholesky factor.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite};

/// Least pivot of a covariance factor as a share of its row: a correlation nearer to one is lost in the product of the
/// factors, and the covariance that users see would no longer be positive definite.
const LEAST_PIVOT: f64 = 3e-7;
/// Pivots below this share of their row are checked against the product of the factors.
const DOUBTFUL_PIVOT: f64 = 1e-4;
/// Least pivot as a share of the state's own spread before the step: what rounding leaves of it.
const LEAST_SPREAD: f64 = 1e-16;
/// Least pivot of the innovation as a share of its row; below it redundant measurements differ by rounding alone.
const LEAST_INNOVATION: f64 = 1e-13;
/// Growth of the diagonal that is tried, one after the other, where a given covariance does not factorise.
const JITTER: [f64; 6] = [0.0, 1e-15, 1e-13, 1e-12, 1e-11, 1e-9];
/// Share of the diagonal that the product of the factors can spare and still factorise, in anybody's order of sums.
const MARGIN: f64 = 1e-14;

/// Mean and covariance of a state.
///
/// ```
/// use geomag_core::kalman::Estimate;
/// let state = Estimate::new(&[1.0, 2.0], &[4.0, 1.0, 1.0, 9.0])?;
/// assert!((state.covariance()[(0, 1)] - 1.0).abs() < 1e-15);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    pub(super) mean: DVector<f64>,
    #[serde(with = "crate::state::matrix")]
    pub(super) factor: DMatrix<f64>,
    pub(super) regularisations: u64,
}

/// What a measurement was against what was expected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Innovation {
    /// Measured minus expected.
    pub residual: DVector<f64>,
    /// Its covariance, measurement noise included.
    #[serde(with = "crate::state::matrix")]
    pub covariance: DMatrix<f64>,
    /// Normalised innovation squared: chi-square with as many degrees of freedom as numbers measured.
    pub nis: f64,
    /// Kalman gain.
    #[serde(with = "crate::state::matrix")]
    pub gain: DMatrix<f64>,
    /// Whether the state was corrected: false where the gate refused the measurement.
    pub accepted: bool,
}

impl Innovation {
    /// Refuses an innovation that a filter of `n` states cannot have had.
    pub(super) fn check(&self, n: usize) -> Result<()> {
        let m = self.residual.len();
        let shapes = [("innovation covariance", self.covariance.shape(), m), ("gain", self.gain.shape(), n)];
        for (what, shape, rows) in shapes {
            if m == 0 || m > super::MAX_STATES || shape != (rows, m) {
                return Err(Error::shape(what, format!("({rows}, {m})"), format!("{shape:?}")));
            }
        }
        require_finite("innovation", self.residual.as_slice())?;
        if self.nis.is_nan() || self.nis < 0.0 {
            return Err(Error::invalid("normalised innovation squared", "a number >= 0", self.nis));
        }
        Ok(())
    }
}

impl Estimate {
    /// From a mean of n numbers and a symmetric positive definite covariance, row-major, n x n.
    ///
    /// A covariance that is indefinite by rounding gets its diagonal raised by up to a billionth of itself, which is
    /// counted in [`Estimate::regularisations`].
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] (not symmetric), [`Error::NotPositiveDefinite`].
    pub fn new(mean: &[f64], covariance: &[f64]) -> Result<Self> {
        let n = mean.len();
        if n == 0 {
            return Err(Error::shape("state x", "at least one number", "none"));
        }
        if n > super::MAX_STATES {
            return Err(Error::shape("state x", format!("at most {} numbers", super::MAX_STATES), n));
        }
        require_finite("state x", mean)?;
        let covariance = square("covariance P", n, covariance)?;
        let (factor, regularised) = factorise("covariance P", &covariance)?;
        Ok(Self { mean: DVector::from_column_slice(mean), factor, regularisations: u64::from(regularised) })
    }

    /// Refuses an estimate that no filter can have made.
    pub(crate) fn check(&self) -> Result<()> {
        let n = self.mean.len();
        if n == 0 || n > super::MAX_STATES {
            return Err(Error::shape("state x", format!("1 to {} numbers", super::MAX_STATES), n));
        }
        if self.factor.shape() != (n, n) {
            let got = format!("{:?}", self.factor.shape());
            return Err(Error::shape("factor of the covariance", format!("({n}, {n})"), got));
        }
        require_finite("state x", self.mean.as_slice())?;
        require_square("factor of the covariance", &self.factor)?;
        for j in 0..n {
            if self.factor[(j, j)] < 0.0 || (0..j).any(|i| self.factor[(i, j)] != 0.0) {
                let needed = "a lower triangle with a diagonal >= 0";
                return Err(Error::invalid(format!("factor of the covariance, column {j}"), needed, "another matrix"));
            }
        }
        Ok(())
    }

    /// From a mean and a covariance that may be singular: what is known for certain has no variance.
    pub(super) fn known(mean: DVector<f64>, covariance: &DMatrix<f64>) -> Result<Self> {
        let factor = noise_factor("covariance", mean.len(), covariance.as_slice())?;
        let estimate = Self { mean, factor, regularisations: 0 };
        estimate.check()?;
        Ok(estimate)
    }

    /// Takes a new mean and covariance of the same size; regularisations go on being counted.
    pub(super) fn set(&mut self, mean: &[f64], covariance: &[f64]) -> Result<()> {
        if mean.len() != self.len() {
            return Err(Error::shape("state x", format!("({},)", self.len()), format!("({},)", mean.len())));
        }
        let new = Self::new(mean, covariance)?;
        *self = Self { regularisations: self.regularisations + new.regularisations, ..new };
        Ok(())
    }

    /// Number of states.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// Whether there is none: never.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// The mean.
    pub fn mean(&self) -> &[f64] {
        self.mean.as_slice()
    }

    /// The covariance, symmetric to the last bit.
    pub fn covariance(&self) -> DMatrix<f64> {
        outer(&self.factor)
    }

    /// The lower Cholesky factor of the covariance.
    pub fn factor(&self) -> &DMatrix<f64> {
        &self.factor
    }

    /// How often a pivot had to be raised to keep the covariance positive definite.
    pub fn regularisations(&self) -> u64 {
        self.regularisations
    }

    /// Adds to the mean, the covariance as it is: for states that are kept about a moving origin.
    pub(crate) fn shift(&mut self, by: &[f64]) {
        for (m, b) in self.mean.iter_mut().zip(by) {
            *m += b;
        }
    }

    /// Moves the mean and adds noise, given as the factor of its covariance: every filter's prediction for a motion that
    /// moves all states alike.
    pub(crate) fn drift(&mut self, by: &[f64], noise: &DMatrix<f64>) -> Result<()> {
        let n = self.len();
        let mut columns = DMatrix::zeros(n, 2 * n);
        columns.as_mut_slice()[..n * n].copy_from_slice(self.factor.as_slice());
        columns.as_mut_slice()[n * n..].copy_from_slice(noise.as_slice());
        let mut mean = self.mean.clone();
        for (m, b) in mean.iter_mut().zip(by) {
            *m += b;
        }
        self.replace(mean, &columns)
    }

    /// Takes a new mean and a covariance given as columns whose outer products add up to it.
    pub(super) fn replace(&mut self, mean: DVector<f64>, columns: &DMatrix<f64>) -> Result<()> {
        require_finite("predicted state", mean.as_slice())?;
        let mut factor = triangular(columns);
        require_square("predicted covariance", &factor)?;
        let raised = raise_pivots(&mut factor, &self.factor);
        self.mean = mean;
        self.factor = factor;
        self.regularisations = self.regularisations.saturating_add(u64::from(raised));
        Ok(())
    }

    /// The same from the full covariance.
    pub(super) fn replace_full(&mut self, mean: DVector<f64>, covariance: &DMatrix<f64>, what: &str) -> Result<()> {
        require_finite(what, mean.as_slice())?;
        require_finite(what, covariance.as_slice())?;
        let (factor, regularised) = factorise(what, covariance)?;
        self.mean = mean;
        self.factor = factor;
        self.regularisations = self.regularisations.saturating_add(u64::from(regularised));
        Ok(())
    }

    /// Corrects the state with an innovation.
    ///
    /// `joint` holds columns whose outer products add up to the joint covariance of measurement (first rows) and state.
    /// An orthogonal transformation makes it `[[Sy, 0], [K Sy, L]]`: `Sy` is the factor of the innovation covariance and
    /// `L` that of the corrected covariance, `P - K S K'` without a subtraction.
    pub(super) fn correct(
        &mut self,
        residual: DVector<f64>,
        joint: &DMatrix<f64>,
        max_nis: Option<f64>,
    ) -> Result<Innovation> {
        let (m, n) = (residual.len(), self.len());
        require_finite("innovation", residual.as_slice())?;
        let lower = triangular(joint);
        require_square("joint covariance of measurement and state", &lower)?;
        let mut root = lower.view((0, 0), (m, m)).into_owned();
        for i in 0..m {
            let row = root.row(i).norm();
            if row == 0.0 {
                return Err(Error::NotPositiveDefinite {
                    what: "innovation covariance".into(),
                    detail: format!("measurement {i} has no noise and does not depend on the state"),
                });
            }
            root[(i, i)] = root[(i, i)].max(LEAST_INNOVATION * row);
        }
        let cross = lower.view((m, 0), (n, m)).into_owned();
        let Some(whitened) = root.solve_lower_triangular(&residual) else {
            return Err(not_definite("innovation covariance"));
        };
        let nis = whitened.norm_squared();
        let Some(gain) = root.tr_solve_lower_triangular(&cross.transpose()) else {
            return Err(not_definite("innovation covariance"));
        };
        let accepted = max_nis.is_none_or(|most| nis <= most);
        let innovation = Innovation { residual, covariance: outer(&root), nis, gain: gain.transpose(), accepted };
        require_finite("normalised innovation squared", &[nis])?;
        if accepted {
            let mean = &self.mean + &cross * whitened;
            require_finite("corrected state", mean.as_slice())?;
            let mut factor = lower.view((m, m), (n, n)).into_owned();
            let raised = raise_pivots(&mut factor, &self.factor);
            self.mean = mean;
            self.factor = factor;
            self.regularisations = self.regularisations.saturating_add(u64::from(raised));
        }
        Ok(innovation)
    }

    /// Moves the state to `mean` with the matrix of a linear (or linearised) motion and the factor of its noise.
    pub(super) fn move_linear(
        &mut self,
        mean: DVector<f64>,
        matrix: &DMatrix<f64>,
        noise: &DMatrix<f64>,
    ) -> Result<()> {
        let n = self.len();
        let mut columns = DMatrix::zeros(n, 2 * n);
        columns.view_mut((0, 0), (n, n)).copy_from(&(matrix * &self.factor));
        columns.view_mut((0, n), (n, n)).copy_from(noise);
        self.replace(mean, &columns)
    }

    /// Corrects the state with a measurement whose matrix (or Jacobian) and factor of noise are given: the one linear update of all
    /// filters.
    pub(super) fn correct_linear(
        &mut self,
        residual: DVector<f64>,
        matrix: &DMatrix<f64>,
        noise: &DMatrix<f64>,
        max_nis: Option<f64>,
    ) -> Result<Innovation> {
        let (m, n) = (residual.len(), self.len());
        let mut joint = DMatrix::zeros(m + n, n + m);
        joint.view_mut((0, 0), (m, n)).copy_from(&(matrix * &self.factor));
        joint.view_mut((m, 0), (n, n)).copy_from(&self.factor);
        joint.view_mut((0, n), (m, m)).copy_from(noise);
        self.correct(residual, &joint, max_nis)
    }

    /// The textbook form, for weights under which the columns of [`Estimate::correct`] would be imaginary.
    pub(super) fn correct_full(
        &mut self,
        residual: DVector<f64>,
        innovation: &DMatrix<f64>,
        cross: &DMatrix<f64>,
        max_nis: Option<f64>,
    ) -> Result<Innovation> {
        require_finite("innovation", residual.as_slice())?;
        require_finite("innovation covariance", innovation.as_slice())?;
        let (root, regularised) = factorise("innovation covariance", innovation)?;
        let whitened = root.solve_lower_triangular(&residual).ok_or_else(|| not_definite("innovation covariance"))?;
        let half =
            root.solve_lower_triangular(&cross.transpose()).ok_or_else(|| not_definite("innovation covariance"))?;
        let gain = root.tr_solve_lower_triangular(&half).ok_or_else(|| not_definite("innovation covariance"))?;
        let nis = whitened.norm_squared();
        require_finite("normalised innovation squared", &[nis])?;
        let accepted = max_nis.is_none_or(|most| nis <= most);
        if accepted {
            let mean = &self.mean + half.transpose() * &whitened;
            let covariance = self.covariance() - half.transpose() * &half;
            self.replace_full(mean, &covariance, "corrected covariance")?;
            self.regularisations = self.regularisations.saturating_add(u64::from(regularised));
        }
        Ok(Innovation { residual, covariance: outer(&root), nis, gain: gain.transpose(), accepted })
    }
}

/// Refuses a gate that would silently refuse every measurement (negative, zero) or none (NaN).
pub(super) fn check_max_nis(max_nis: Option<f64>) -> Result<()> {
    match max_nis {
        Some(limit) if limit.is_nan() || limit <= 0.0 => {
            Err(Error::invalid("max_nis", "a normalised innovation squared > 0", limit))
        }
        _ => Ok(()),
    }
}

fn not_definite(what: &str) -> Error {
    Error::NotPositiveDefinite { what: what.into(), detail: "a pivot is zero".into() }
}

/// `L L'`, both triangles from the same numbers.
pub(super) fn outer(factor: &DMatrix<f64>) -> DMatrix<f64> {
    let n = factor.nrows();
    let mut out = DMatrix::zeros(n, n);
    for i in 0..n {
        for j in 0..=i {
            let sum = (0..=j).map(|k| factor[(i, k)] * factor[(j, k)]).sum();
            out[(i, j)] = sum;
            out[(j, i)] = sum;
        }
    }
    out
}

/// A symmetric matrix from row-major numbers.
pub(crate) fn square(what: &str, n: usize, values: &[f64]) -> Result<DMatrix<f64>> {
    if values.len() != n * n {
        return Err(Error::shape(what, format!("({n}, {n})"), format!("{} numbers", values.len())));
    }
    require_finite(what, values)?;
    let matrix = DMatrix::from_row_slice(n, n, values);
    for i in 0..n {
        for j in 0..i {
            let size = (matrix[(i, i)].abs() * matrix[(j, j)].abs()).sqrt();
            if (matrix[(i, j)] - matrix[(j, i)]).abs() > 1e-8 * size.max(f64::MIN_POSITIVE) {
                return Err(Error::invalid(
                    format!("{what}[{i}][{j}]"),
                    "a symmetric matrix",
                    format!("{} against {}", matrix[(i, j)], matrix[(j, i)]),
                ));
            }
        }
    }
    Ok(matrix)
}

/// Lower Cholesky factor; where it fails, with the diagonal raised by a bounded share of itself. Whether it was.
fn factorise(what: &str, matrix: &DMatrix<f64>) -> Result<(DMatrix<f64>, bool)> {
    for jitter in JITTER {
        if let Some(mut factor) = cholesky(matrix, jitter) {
            let before = factor.clone();
            let raised = raise_pivots(&mut factor, &before);
            return Ok((factor, raised || jitter > 0.0));
        }
    }
    Err(Error::NotPositiveDefinite {
        what: what.into(),
        detail: format!("even with its diagonal raised by {:e} of itself", JITTER[JITTER.len() - 1]),
    })
}

fn cholesky(matrix: &DMatrix<f64>, jitter: f64) -> Option<DMatrix<f64>> {
    let n = matrix.nrows();
    let mut l = DMatrix::zeros(n, n);
    for j in 0..n {
        let mut pivot = matrix[(j, j)] * (1.0 + jitter);
        for k in 0..j {
            pivot -= l[(j, k)] * l[(j, k)];
        }
        if !(pivot > 0.0) {
            return None;
        }
        let pivot: f64 = pivot.sqrt();
        l[(j, j)] = pivot;
        for i in j + 1..n {
            let mut sum = 0.5 * (matrix[(i, j)] + matrix[(j, i)]);
            for k in 0..j {
                sum -= l[(i, k)] * l[(j, k)];
            }
            l[(i, j)] = sum / pivot;
        }
    }
    Some(l)
}

/// A factor of a positive semidefinite matrix (process or measurement noise), row-major n x n: zero rows stay zero.
pub(crate) fn noise_factor(what: &str, n: usize, values: &[f64]) -> Result<DMatrix<f64>> {
    let matrix = square(what, n, values)?;
    let mut l = DMatrix::zeros(n, n);
    for j in 0..n {
        let mut pivot: f64 = matrix[(j, j)];
        for k in 0..j {
            pivot -= l[(j, k)] * l[(j, k)];
        }
        let rounding = 16.0 * n as f64 * f64::EPSILON * matrix[(j, j)].abs();
        if pivot < -rounding || matrix[(j, j)] < 0.0 {
            return Err(Error::NotPositiveDefinite {
                what: what.into(),
                detail: format!("pivot {j} is {pivot:e}; noise may be zero but not negative"),
            });
        }
        let root = pivot.max(0.0).sqrt();
        if pivot > rounding {
            l[(j, j)] = root;
        }
        for i in j + 1..n {
            let mut sum = matrix[(i, j)];
            for k in 0..j {
                sum -= l[(i, k)] * l[(j, k)];
            }
            if pivot > rounding {
                l[(i, j)] = sum / root;
            } else if sum.abs() > 1e-7 * (matrix[(i, i)].abs() * matrix[(j, j)].abs()).sqrt() {
                return Err(Error::NotPositiveDefinite {
                    what: what.into(),
                    detail: format!("covariance {sum:e} between {i} and {j}, of which one has no variance left"),
                });
            }
        }
    }
    Ok(l)
}

/// Raises the pivots that rounding has eaten. Whether any was.
///
/// Pivots may be small one after the other, and then the product of the factors has lost what they say: where it does
/// not factorise any more, its diagonal is raised by as little as does.
fn raise_pivots(factor: &mut DMatrix<f64>, before: &DMatrix<f64>) -> bool {
    let (mut raised, mut doubtful) = (false, false);
    for i in 0..factor.nrows() {
        let norm = factor.row(i).norm();
        let least = (LEAST_PIVOT * norm).max(LEAST_SPREAD * before.row(i).norm()).max(f64::MIN_POSITIVE.sqrt());
        doubtful |= factor[(i, i)] < DOUBTFUL_PIVOT * norm;
        if factor[(i, i)] < least {
            factor[(i, i)] = least;
            raised = true;
        }
    }
    if doubtful {
        let covariance = outer(factor);
        for jitter in JITTER {
            let Some(mended) = cholesky(&covariance, jitter) else { continue };
            let candidate = if jitter == 0.0 { factor.clone() } else { mended };
            if cholesky(&outer(&candidate), -MARGIN).is_some() {
                *factor = candidate;
                return raised || jitter > 0.0;
            }
        }
    }
    raised
}

/// The lower triangular matrix with a positive diagonal that has the same product with its transpose: Householder
/// reflections of the rows.
pub(super) fn triangular(columns: &DMatrix<f64>) -> DMatrix<f64> {
    let (n, k) = columns.shape();
    // Each row on its own stretch of memory; plain loops, as the matrices of a filter are too small for anything else.
    let mut rows = vec![0.0; n * k];
    for (i, row) in rows.chunks_exact_mut(k).enumerate() {
        for (value, c) in row.iter_mut().zip(columns.as_slice()[i..].iter().step_by(n)) {
            *value = *c;
        }
    }
    let mut lower = DMatrix::zeros(n, n);
    for j in 0..n.min(k) {
        let (done, rest) = rows.split_at_mut((j + 1) * k);
        let pivot = &mut done[j * k + j..];
        let scale = pivot.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        let head = pivot[0];
        let mut diagonal = 0.0;
        // Below this, one over it is out of range.
        if scale > 1e-300 {
            let by_scale = 1.0 / scale;
            let norm = scale * pivot.iter().map(|v| (v * by_scale) * (v * by_scale)).sum::<f64>().sqrt();
            diagonal = if head > 0.0 { -norm } else { norm };
            // v = x - alpha e1, H = I - 2 v v' / v'v; v'v = 2 norm (norm + |x1|).
            pivot[0] = head - diagonal;
            // Divided in two steps: the square of the norm may be out of range where the norm is not.
            let (by_norm, by_sum) = (1.0 / norm, 1.0 / (norm + head.abs()));
            for row in rest.chunks_exact_mut(k) {
                let part = &mut row[j..];
                let along: f64 = pivot.iter().zip(part.iter()).map(|(v, p)| (v * by_norm) * p).sum();
                let factor = along * by_sum;
                for (p, v) in part.iter_mut().zip(pivot.iter()) {
                    *p -= factor * v;
                }
            }
        }
        let sign = if diagonal < 0.0 { -1.0 } else { 1.0 };
        lower[(j, j)] = sign * diagonal;
        for (i, row) in rest.chunks_exact(k).enumerate() {
            lower[(j + 1 + i, j)] = sign * row[j];
        }
    }
    lower
}

/// Refuses a factor whose square is no finite matrix.
fn require_square(what: &str, factor: &DMatrix<f64>) -> Result<()> {
    match (0..factor.nrows()).find(|&i| !factor.row(i).norm_squared().is_finite()) {
        None => Ok(()),
        Some(index) => Err(Error::NotFinite { what: what.into(), index, got: factor.row(index).amax() }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangular_keeps_the_product() {
        let columns = DMatrix::from_fn(4, 9, |i, j| ((3 * i + 7 * j) as f64).sin() * 10_f64.powi(3 * i as i32 - 5));
        let expected = &columns * columns.transpose();
        let found = outer(&triangular(&columns));
        for i in 0..4 {
            for j in 0..4 {
                let size = (expected[(i, i)] * expected[(j, j)]).sqrt();
                assert!((expected[(i, j)] - found[(i, j)]).abs() < 1e-14 * size);
            }
        }
        let narrow = triangular(&DMatrix::from_row_slice(3, 1, &[1.0, -2.0, 0.0]));
        assert_eq!(narrow, DMatrix::from_row_slice(3, 3, &[1.0, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0]));
    }

    #[test]
    fn beta_does_not_overflow_for_large_and_small_rows() {
        for scale in [1e-150, 1.0, 1e150] {
            let found = triangular(&DMatrix::from_row_slice(1, 2, &[3.0 * scale, 4.0 * scale]));
            assert!((found[(0, 0)] / scale - 5.0).abs() < 1e-14);
        }
    }

    #[test]
    fn noise_may_be_zero_but_not_negative() {
        assert_eq!(noise_factor("Q", 2, &[0.0; 4]).unwrap(), DMatrix::zeros(2, 2));
        let one = noise_factor("Q", 2, &[4.0, 2.0, 2.0, 1.0]).unwrap();
        assert_eq!(outer(&one), DMatrix::from_row_slice(2, 2, &[4.0, 2.0, 2.0, 1.0]));
        assert!(matches!(noise_factor("Q", 1, &[-1.0]), Err(Error::NotPositiveDefinite { .. })));
        assert!(matches!(noise_factor("Q", 2, &[0.0, 1.0, 1.0, 1.0]), Err(Error::NotPositiveDefinite { .. })));
        assert!(matches!(noise_factor("Q", 2, &[1.0, 2.0, 0.0, 1.0]), Err(Error::Invalid { .. })));
    }

    #[test]
    fn bad_states_are_refused() {
        assert!(matches!(Estimate::new(&[1.0], &[-1.0]), Err(Error::NotPositiveDefinite { .. })));
        assert!(matches!(Estimate::new(&[f64::NAN], &[1.0]), Err(Error::NotFinite { .. })));
        assert!(matches!(Estimate::new(&[1.0, 2.0], &[1.0]), Err(Error::Shape { .. })));
        assert!(Estimate::new(&[], &[]).is_err());
        // Indefinite by rounding alone: mended and counted.
        let mended = Estimate::new(&[0.0, 0.0], &[1.0, 1.0, 1.0, 1.0 - 1e-16]).unwrap();
        assert_eq!(mended.regularisations(), 1);
    }
}
