//! Linear least squares over many rows: the normal equations block by block, solved and then refined.
//!
//! The matrix of rows is never held whole. Blocks of fixed size are built by all threads and added in a fixed order, so
//! that the sums are the same bits for any number of threads. Squaring the condition number costs digits; steps of
//! iterative refinement with residuals taken from the rows themselves bring them back (Bjorck 1996, *Numerical Methods
//! for Least Squares Problems*, sect. 6.6.5, "corrected seminormal equations").

use nalgebra::{Cholesky, DMatrix, DMatrixView, DVector, Dyn, SymmetricEigen};
use rayon::prelude::*;

use super::basis::{Basis, BasisScratch};
use crate::error::{Error, Result};
use crate::monitor::Monitor;

/// Numbers in a block of rows, 32 MB.
const BLOCK_NUMBERS: usize = 1 << 22;
/// Columns of a panel of the Gram matrix: one task each pair.
const PANEL: usize = 128;
/// Steps of iterative refinement.
const REFINEMENTS: usize = 2;

/// How nearly dependent columns are kept from running away. Columns are scaled to unit norm first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Regularisation {
    /// `(A'A + ridge W) c = A'b`; zero for plain least squares. W is the identity, or grows with the wave number (see
    /// [`Prior`](super::Prior)).
    Ridge(f64),
    /// Singular values below this share of the largest are left out. The normal equations resolve shares down to about
    /// 1e-7.
    TruncatedSvd(f64),
}

impl Regularisation {
    pub(super) fn validate(self) -> Result<()> {
        match self {
            Self::Ridge(ridge) => crate::error::require_not_negative("ridge", ridge).map(|_| ()),
            Self::TruncatedSvd(share) if (1e-8..1.0).contains(&share) => Ok(()),
            Self::TruncatedSvd(share) => Err(Error::invalid("truncation", "a share in [1e-8, 1)", share)),
        }
    }
}

/// One linear equation: the field along `direction` at `point`, times `weight`, is `target`.
#[derive(Debug, Clone, Copy)]
pub(super) struct LinearRow {
    pub(super) point: [f64; 3],
    pub(super) direction: [f64; 3],
    pub(super) weight: f64,
    /// Already weighted.
    pub(super) target: f64,
}

/// A part of a long call, from one share of it to another.
#[derive(Clone, Copy)]
pub(super) struct Progress<'a> {
    monitor: &'a dyn Monitor,
    from: f64,
    to: f64,
}

impl<'a> Progress<'a> {
    pub(super) fn whole(monitor: &'a dyn Monitor) -> Self {
        Self { monitor, from: 0.0, to: 1.0 }
    }

    /// The piece from one share to another of this part.
    pub(super) fn part(self, from: f64, to: f64) -> Self {
        let at = |share: f64| self.from + (self.to - self.from) * share;
        Self { from: at(from), to: at(to), ..self }
    }

    fn at(self, share: f64) -> Result<()> {
        const TOTAL: f64 = 1000.0;
        self.monitor.advance(((self.from + (self.to - self.from) * share) * TOTAL) as u64, TOTAL as u64)
    }
}

/// Builds the rows block by block and hands over each block as a matrix with one *column* a row of the problem.
pub(super) fn for_each_block(
    basis: &Basis,
    rows: &[LinearRow],
    progress: Progress<'_>,
    mut take: impl FnMut(&[LinearRow], usize, &DMatrix<f64>),
) -> Result<()> {
    let n = basis.len();
    let block = (BLOCK_NUMBERS / n).clamp(256, 8192).min(rows.len().max(1));
    let mut design = DMatrix::zeros(n, block);
    for (k, rows_here) in rows.chunks(block).enumerate() {
        progress.at((k * block) as f64 / rows.len() as f64)?;
        if rows_here.len() != design.ncols() {
            design = DMatrix::zeros(n, rows_here.len());
        }
        design.as_mut_slice().par_chunks_mut(n * 16).zip(rows_here.par_chunks(16)).for_each(|(columns, rows)| {
            let mut scratch = BasisScratch::default();
            for (row, column) in rows.iter().zip(columns.chunks_exact_mut(n)) {
                basis.project(row.point, row.direction, row.weight, &mut scratch, column);
            }
        });
        take(rows_here, k * block, &design);
    }
    Ok(())
}

/// `A'A` and `A'b` of some rows.
#[derive(Debug, Clone)]
pub(super) struct Normal {
    pub(super) gram: DMatrix<f64>,
    pub(super) right: DVector<f64>,
}

impl Normal {
    pub(super) fn of(basis: &Basis, rows: &[LinearRow], progress: Progress<'_>) -> Result<Self> {
        let n = basis.len();
        let panels = n.div_ceil(PANEL);
        let range = |p: usize| (p * PANEL, PANEL.min(n - p * PANEL));
        let mut pairs: Vec<(usize, usize, DMatrix<f64>)> = (0..panels)
            .flat_map(|i| (0..=i).map(move |j| (i, j)))
            .map(|(i, j)| (i, j, DMatrix::zeros(range(i).1, range(j).1)))
            .collect();
        let mut right = DVector::zeros(n);
        for_each_block(basis, rows, progress, |rows, _, design| {
            pairs.par_iter_mut().for_each(|(i, j, sum)| {
                let ((first_i, count_i), (first_j, count_j)) = (range(*i), range(*j));
                let left = design.rows(first_i, count_i);
                let slice = &design.as_slice()[first_j..];
                // The transpose of a panel without a copy: rows and columns exchange strides.
                let turned: DMatrixView<'_, f64, Dyn, Dyn> =
                    DMatrixView::from_slice_with_strides(slice, rows.len(), count_j, n, 1);
                sum.gemm(1.0, &left, &turned, 1.0);
            });
            let targets = DVector::from_iterator(rows.len(), rows.iter().map(|r| r.target));
            right.gemv(1.0, design, &targets, 1.0);
        })?;
        let mut gram = DMatrix::zeros(n, n);
        for (i, j, sum) in &pairs {
            let (first_i, first_j) = (range(*i).0, range(*j).0);
            for c in 0..sum.ncols() {
                for r in 0..sum.nrows() {
                    gram[(first_i + r, first_j + c)] = sum[(r, c)];
                    gram[(first_j + c, first_i + r)] = sum[(r, c)];
                }
            }
        }
        Ok(Self { gram, right })
    }

    /// The equations of the first `n` coefficients alone.
    pub(super) fn leading(&self, n: usize) -> Self {
        Self { gram: self.gram.view((0, 0), (n, n)).into_owned(), right: self.right.rows(0, n).into_owned() }
    }
}

/// The regularised normal equations, ready to be solved for any right-hand side.
#[derive(Debug)]
pub(super) struct Solver {
    scale: DVector<f64>,
    /// Share of the ridge that each coefficient gets.
    damping: DVector<f64>,
    inverse: Inverse,
    undetermined: Vec<[f64; 3]>,
}

/// Share of the largest below which a direction of the uniform field counts as sensed by nothing.
const UNSENSED: f64 = 1e-10;

/// Directions of the uniform field (north, east, down) that no observation senses, from the equations of its three
/// coefficients. Its columns vanish along them, so that they can be left out: each is told to be nil, which changes nothing else.
fn leave_out_unsensed(gram: &mut DMatrix<f64>) -> Vec<[f64; 3]> {
    if gram.nrows() < 3 {
        return Vec::new();
    }
    let uniform = gram.fixed_view::<3, 3>(0, 0).into_owned();
    let eigen = SymmetricEigen::new(uniform);
    let largest = eigen.eigenvalues.max();
    if !(largest > 0.0 && largest.is_finite()) {
        return Vec::new();
    }
    let mut out = Vec::new();
    for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value <= UNSENSED * largest {
            for i in 0..3 {
                for j in 0..3 {
                    gram[(i, j)] += largest * vector[i] * vector[j];
                }
            }
            out.push([vector[0], vector[1], vector[2]]);
        }
    }
    out
}

#[derive(Debug)]
enum Inverse {
    Ridge(Cholesky<f64, Dyn>, f64),
    /// Eigenvectors kept and one over their eigenvalues.
    Truncated(DMatrix<f64>, DVector<f64>),
}

impl Solver {
    /// Scales the columns to unit norm and factorises. `damping` multiplies the ridge of each coefficient.
    pub(super) fn new(mut gram: DMatrix<f64>, regularisation: Regularisation, damping: &[f64]) -> Result<Self> {
        let n = gram.nrows();
        let undetermined = leave_out_unsensed(&mut gram);
        let damping = DVector::from_column_slice(&damping[..n]);
        let scale = DVector::from_fn(n, |i, _| gram[(i, i)].sqrt());
        if let Some(i) = (0..n).find(|&i| !(scale[i] > 0.0 && scale[i].is_finite())) {
            return Err(Error::RankDeficient {
                what: "harmonic fit".into(),
                rank: n - 1,
                needed: n,
                detail: format!("no observation senses coefficient {i}"),
            });
        }
        for j in 0..n {
            for i in 0..n {
                gram[(i, j)] /= scale[i] * scale[j];
            }
        }
        let inverse = match regularisation {
            Regularisation::Ridge(ridge) => {
                for i in 0..n {
                    gram[(i, i)] += ridge * damping[i];
                }
                Inverse::Ridge(factorise(gram)?, ridge)
            }
            Regularisation::TruncatedSvd(share) => {
                let eigen = SymmetricEigen::new(gram);
                let largest = eigen.eigenvalues.max();
                let kept: Vec<usize> = (0..n).filter(|&i| eigen.eigenvalues[i] >= share * share * largest).collect();
                let vectors = eigen.eigenvectors.select_columns(&kept);
                Inverse::Truncated(vectors, DVector::from_fn(kept.len(), |k, _| 1.0 / eigen.eigenvalues[kept[k]]))
            }
        };
        Ok(Self { scale, damping, inverse, undetermined })
    }

    /// Coefficients for `A'b`.
    pub(super) fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let scaled = right.component_div(&self.scale);
        let solution = match &self.inverse {
            Inverse::Ridge(factor, _) => factor.solve(&scaled),
            Inverse::Truncated(vectors, inverse) => vectors * inverse.component_mul(&(vectors.transpose() * scaled)),
        };
        solution.component_div(&self.scale)
    }

    /// `A'(b - A c)` less the pull of the ridge: zero at the solution.
    fn gradient(&self, residual: DVector<f64>, coefficients: &DVector<f64>) -> DVector<f64> {
        match self.inverse {
            Inverse::Ridge(_, ridge) => {
                let weight = self.scale.component_mul(&self.scale).component_mul(&self.damping);
                residual - ridge * coefficients.component_mul(&weight)
            }
            Inverse::Truncated(..) => residual,
        }
    }

    /// Directions of the uniform field that nothing senses: they are nil in every solution.
    pub(super) fn undetermined(&self) -> &[[f64; 3]] {
        &self.undetermined
    }

    /// Number of directions that the observations decide, not the regularisation.
    pub(super) fn effective_parameters(&self) -> f64 {
        self.decided() - self.undetermined.len() as f64
    }

    fn decided(&self) -> f64 {
        let n = self.scale.len();
        match &self.inverse {
            Inverse::Ridge(_, 0.0) => n as f64,
            Inverse::Ridge(factor, ridge) => {
                let columns = inverse_of(factor);
                n as f64 - ridge * columns.diagonal().dot(&self.damping)
            }
            Inverse::Truncated(vectors, _) => vectors.ncols() as f64,
        }
    }

    /// `(A'A + ridge I)^-1` in the units of the coefficients: their covariance for observations of unit variance, with
    /// the ridge read as what was known before.
    pub(super) fn covariance(&self) -> DMatrix<f64> {
        let mut out = match &self.inverse {
            Inverse::Ridge(factor, _) => inverse_of(factor),
            Inverse::Truncated(vectors, inverse) => {
                let mut weighted = vectors.clone();
                for (mut column, &w) in weighted.column_iter_mut().zip(inverse.iter()) {
                    column *= w;
                }
                weighted * vectors.transpose()
            }
        };
        let n = out.nrows();
        for j in 0..n {
            for i in 0..n {
                out[(i, j)] /= self.scale[i] * self.scale[j];
            }
        }
        out
    }
}

/// Cholesky, refused where the pivots are no more than rounding.
fn factorise(matrix: DMatrix<f64>) -> Result<Cholesky<f64, Dyn>> {
    let n = matrix.nrows();
    let floor = n as f64 * f64::EPSILON;
    let deficient = |rank: usize| Error::RankDeficient {
        what: "harmonic fit".into(),
        rank,
        needed: n,
        detail: "columns are dependent to rounding: give a ridge > 0, a truncation, a lower order, longer tracks or \
                 more components"
            .into(),
    };
    let factor = Cholesky::new(matrix).ok_or_else(|| deficient(n - 1))?;
    let lost = factor.l_dirty().diagonal().iter().filter(|&&p| p * p < floor).count();
    if lost > 0 { Err(deficient(n - lost)) } else { Ok(factor) }
}

/// The inverse, a few columns a task.
fn inverse_of(factor: &Cholesky<f64, Dyn>) -> DMatrix<f64> {
    let n = factor.l_dirty().nrows();
    let mut out = DMatrix::identity(n, n);
    let columns = 16;
    out.as_mut_slice().par_chunks_mut(n * columns).for_each(|slice| {
        let count = slice.len() / n;
        let mut part = nalgebra::DMatrixViewMut::from_slice(slice, n, count);
        factor.solve_mut(&mut part);
    });
    out
}

/// Solves the regularised problem over `rows` and refines the answer with residuals from the rows.
pub(super) fn solve_refined(
    basis: &Basis,
    rows: &[LinearRow],
    regularisation: Regularisation,
    damping: &[f64],
    progress: Progress<'_>,
) -> Result<(DVector<f64>, Solver)> {
    // The Gram matrix is all but the whole of the work.
    let normal = Normal::of(basis, rows, progress.part(0.0, 0.8))?;
    let solver = Solver::new(normal.gram, regularisation, damping)?;
    let mut coefficients = solver.solve(&normal.right);
    for step in 0..REFINEMENTS {
        let share = |k: usize| 0.8 + 0.2 * k as f64 / REFINEMENTS as f64;
        let progress = progress.part(share(step), share(step + 1));
        let residual = transposed_residual(basis, rows, &coefficients, progress)?;
        coefficients += solver.solve(&solver.gradient(residual, &coefficients));
    }
    Ok((coefficients, solver))
}

/// `A'(b - A c)`, with the residuals taken row by row.
fn transposed_residual(
    basis: &Basis,
    rows: &[LinearRow],
    coefficients: &DVector<f64>,
    progress: Progress<'_>,
) -> Result<DVector<f64>> {
    let mut out = DVector::zeros(basis.len());
    for_each_block(basis, rows, progress, |rows, _, design| {
        let mut residual = DVector::zeros(rows.len());
        residual.as_mut_slice().par_iter_mut().enumerate().for_each(|(k, r)| {
            *r = rows[k].target - design.column(k).dot(coefficients);
        });
        out.gemv(1.0, design, &residual, 1.0);
    })?;
    Ok(out)
}
