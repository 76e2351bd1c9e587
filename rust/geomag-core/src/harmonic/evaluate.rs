//! The model at points: field, intensity, potential, gradient tensor and their standard deviation.

use nalgebra::DMatrix;
use rayon::prelude::*;

use super::RectangularHarmonicModel;
use super::basis::{Basis, BasisScratch};
use super::kernel::{BLOCK, Output, Run};
use crate::error::{Error, Result};

/// Points that one task takes: some tens of microseconds.
const CHUNK: usize = 2 * BLOCK;
/// Points for which a small block is enough.
const FEW_POINTS: usize = 16;

/// Points of a frame: north, east and down in metres, one array each, of one length.
#[derive(Debug, Clone, Copy)]
pub struct Positions<'a> {
    north: &'a [f64],
    east: &'a [f64],
    down: &'a [f64],
}

impl<'a> Positions<'a> {
    /// Three arrays of the same length.
    ///
    /// # Errors
    /// [`Error::Shape`].
    pub fn new(north: &'a [f64], east: &'a [f64], down: &'a [f64]) -> Result<Self> {
        for (name, len) in [("east", east.len()), ("down", down.len())] {
            if len != north.len() {
                return Err(Error::shape(name, format!("({},) as north", north.len()), format!("({len},)")));
            }
        }
        Ok(Self { north, east, down })
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.north.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.north.is_empty()
    }

    /// Point `i`.
    pub fn at(&self, i: usize) -> [f64; 3] {
        [self.north[i], self.east[i], self.down[i]]
    }
}

/// Everything that the model says at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// Potential, field unit times metre.
    pub potential: f64,
    /// Field, north, east, down.
    pub field: [f64; 3],
    /// Gradient tensor per metre: row = component, column = direction. Symmetric, trace zero.
    pub gradient: [[f64; 3]; 3],
}

impl Evaluation {
    const UNKNOWN: Self = Self { potential: f64::NAN, field: [f64::NAN; 3], gradient: [[f64::NAN; 3]; 3] };

    fn of<const B: usize>(out: &Output<B>, l: usize) -> Self {
        let [potential, north, east, down, xx, xy, xz, yy, yz, zz] = std::array::from_fn(|row| out[row][l]);
        Self { potential, field: [north, east, down], gradient: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]] }
    }
}

impl RectangularHarmonicModel {
    /// Field (north, east, down) at a point (north, east, down, metres); NaN outside the region.
    pub fn field_at(&self, point_m: [f64; 3]) -> [f64; 3] {
        if self.usable(point_m, false) { self.lane::<false>(point_m).field } else { [f64::NAN; 3] }
    }

    /// Potential, field and gradient tensor at a point (north, east, down, metres); NaN outside the region.
    pub fn evaluate_at(&self, point_m: [f64; 3]) -> Evaluation {
        if self.usable(point_m, false) { self.lane::<true>(point_m) } else { Evaluation::UNKNOWN }
    }

    fn lane<const GRADIENT: bool>(&self, point_m: [f64; 3]) -> Evaluation {
        let mut out = [[0.0; 1]; 10];
        let [north, east, down] = &point_m;
        let points = [north, east, down].map(std::slice::from_ref);
        self.run::<GRADIENT, _>(points, &mut out, &mut Vec::new());
        Evaluation::of(&out, 0)
    }

    fn run<const GRADIENT: bool, const B: usize>(
        &self,
        points: [&[f64]; 3],
        out: &mut Output<B>,
        scratch: &mut Vec<f64>,
    ) {
        crate::instructions::chosen().dispatch(Run::<'_, GRADIENT, B> { packed: &self.packed, points, out, scratch });
    }

    /// Whether the model answers at a point.
    fn usable(&self, point_m: [f64; 3], extrapolate: bool) -> bool {
        if !extrapolate {
            return self.contains(point_m);
        }
        let [v, w] = self.packed.wave;
        // Beyond this the exponentials leave double precision.
        point_m.iter().all(|c| c.is_finite()) && point_m[2] * v.hypot(w) * self.order() as f64 <= 700.0
    }

    /// Calls `take(i, what the model says there)` for every point, in the caller's thread; `None` where it does not answer.
    pub(crate) fn for_each<const GRADIENT: bool>(
        &self,
        positions: &Positions<'_>,
        range: std::ops::Range<usize>,
        extrapolate: bool,
        take: impl FnMut(usize, Option<Evaluation>),
    ) {
        // A filter asks for a few points at a time and should not clear room for hundreds.
        if range.len() <= FEW_POINTS {
            self.for_each_block::<GRADIENT, FEW_POINTS>(positions, range, extrapolate, take);
        } else {
            self.for_each_block::<GRADIENT, BLOCK>(positions, range, extrapolate, take);
        }
    }

    fn for_each_block<const GRADIENT: bool, const B: usize>(
        &self,
        positions: &Positions<'_>,
        range: std::ops::Range<usize>,
        extrapolate: bool,
        mut take: impl FnMut(usize, Option<Evaluation>),
    ) {
        let (mut out, mut scratch) = ([[0.0; B]; 10], Vec::new());
        for first in range.clone().step_by(B) {
            let here = first..(first + B).min(range.end);
            let points = [positions.north, positions.east, positions.down].map(|axis| &axis[here.clone()]);
            self.run::<GRADIENT, _>(points, &mut out, &mut scratch);
            for i in here {
                let usable = self.usable(positions.at(i), extrapolate);
                take(i, usable.then(|| Evaluation::of(&out, i - first)));
            }
        }
    }

    fn collect<const GRADIENT: bool, T: Copy + Send + Sync>(
        &self,
        positions: &Positions<'_>,
        extrapolate: bool,
        unknown: T,
        pick: impl Fn(&Evaluation) -> T + Sync,
    ) -> Vec<T> {
        let mut out = vec![unknown; positions.len()];
        let fill = |(chunk, out): (usize, &mut [T])| {
            let first = chunk * CHUNK;
            self.for_each::<GRADIENT>(positions, first..first + out.len(), extrapolate, |i, e| {
                if let Some(e) = e {
                    out[i - first] = pick(&e);
                }
            });
        };
        if positions.len() <= CHUNK {
            fill((0, out.as_mut_slice()));
        } else {
            out.par_chunks_mut(CHUNK).enumerate().for_each(fill);
        }
        out
    }

    /// Field (north, east, down) at points; NaN outside the region unless `extrapolate`.
    pub fn field(&self, positions: &Positions<'_>, extrapolate: bool) -> Vec<[f64; 3]> {
        self.collect::<false, _>(positions, extrapolate, [f64::NAN; 3], |e| e.field)
    }

    /// Field at geographic points (degrees, degrees, metres above the frame's Earth), north, east, down at each point.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a model without a frame, [`Error::Shape`] for arrays of different lengths.
    pub fn field_geographic(
        &self,
        latitude_deg: &[f64],
        longitude_deg: &[f64],
        height_m: &[f64],
        extrapolate: bool,
    ) -> Result<Vec<[f64; 3]>> {
        let Some(frame) = self.frame() else {
            return Err(Error::invalid("model", "a frame on the Earth", "a model without one"));
        };
        let places = Positions::new(latitude_deg, longitude_deg, height_m)?;
        let points: Vec<[f64; 3]> = (0..places.len())
            .map(|i| {
                let [latitude, longitude, height] = places.at(i);
                frame.forward(latitude, longitude, height)
            })
            .collect();
        let axis = |k: usize| points.iter().map(|p| p[k]).collect::<Vec<_>>();
        let (north, east, down) = (axis(0), axis(1), axis(2));
        let field = self.field(&Positions::new(&north, &east, &down)?, extrapolate);
        Ok((field.iter().enumerate())
            .map(|(i, &b)| frame.rotate_from_origin(latitude_deg[i], longitude_deg[i], b))
            .collect())
    }

    /// Total intensity of the modelled field plus a constant `main_field` (north, east, down) at points.
    pub fn intensity(&self, positions: &Positions<'_>, main_field: [f64; 3], extrapolate: bool) -> Vec<f64> {
        self.collect::<false, _>(positions, extrapolate, f64::NAN, |e| {
            norm([e.field[0] + main_field[0], e.field[1] + main_field[1], e.field[2] + main_field[2]])
        })
    }

    /// Potential at points, field unit times metre.
    pub fn potential(&self, positions: &Positions<'_>, extrapolate: bool) -> Vec<f64> {
        self.collect::<false, _>(positions, extrapolate, f64::NAN, |e| e.potential)
    }

    /// Gradient tensor at points, field unit per metre: row = component, column = direction.
    pub fn gradient(&self, positions: &Positions<'_>, extrapolate: bool) -> Vec<[[f64; 3]; 3]> {
        self.collect::<true, _>(positions, extrapolate, [[f64::NAN; 3]; 3], |e| e.gradient)
    }

    /// Potential, field and gradient tensor at points.
    pub fn evaluate(&self, positions: &Positions<'_>, extrapolate: bool) -> Vec<Evaluation> {
        self.collect::<true, _>(positions, extrapolate, Evaluation::UNKNOWN, |e| *e)
    }

    /// Standard deviation of the modelled field along a direction (north, east, down; one for all points or one a
    /// point), from the covariance of the coefficients; NaN outside the region unless `extrapolate`.
    ///
    /// The error of the fit, and where the model was told of it what the order leaves out (see
    /// [`FieldMisfit`](super::FieldMisfit)).
    ///
    /// # Errors
    /// [`Error::Invalid`] where the model has no covariance, [`Error::Shape`] for another number of directions.
    pub fn sigma_along(
        &self,
        positions: &Positions<'_>,
        directions: &[[f64; 3]],
        extrapolate: bool,
    ) -> Result<Vec<f64>> {
        if directions.len() != 1 && directions.len() != positions.len() {
            return Err(Error::shape(
                "directions",
                format!("(3,) or ({}, 3)", positions.len()),
                format!("({}, 3)", directions.len()),
            ));
        }
        let direction = |i: usize| if directions.len() == 1 { directions[0] } else { directions[i] };
        let rows: Vec<(usize, [f64; 3])> = (0..positions.len()).map(|i| (i, direction(i))).collect();
        self.row_sigma(positions, &rows, extrapolate)
    }

    /// Standard deviation of the three components (north, east, down) of the modelled field; infinite for one whose uniform
    /// part no observation senses (see [`FitSummary::undetermined`](super::FitSummary::undetermined)).
    ///
    /// # Errors
    /// [`Error::Invalid`] where the model has no covariance.
    pub fn sigma(&self, positions: &Positions<'_>, extrapolate: bool) -> Result<Vec<[f64; 3]>> {
        const AXES: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let rows: Vec<(usize, [f64; 3])> =
            (0..positions.len()).flat_map(|i| AXES.into_iter().map(move |axis| (i, axis))).collect();
        let flat = self.row_sigma(positions, &rows, extrapolate)?;
        Ok(flat.chunks_exact(3).map(|s| [s[0], s[1], s[2]]).collect())
    }

    fn row_sigma(&self, positions: &Positions<'_>, rows: &[(usize, [f64; 3])], extrapolate: bool) -> Result<Vec<f64>> {
        const ROWS: usize = 96;
        let Some(covariance) = self.covariance.as_ref() else {
            return Err(Error::invalid(
                "sigma",
                "a model with the covariance of its coefficients",
                "one without (made from coefficients, or fitted or saved with covariance = false)",
            ));
        };
        let basis = Basis::new(self.order(), self.periods_m);
        let n = basis.len();
        let full = DMatrix::from_fn(n, n, |i, j| covariance.at(i, j));
        let mut out = vec![f64::NAN; rows.len()];
        out.par_chunks_mut(ROWS).zip(rows.par_chunks(ROWS)).for_each(|(out, rows)| {
            let mut scratch = BasisScratch::default();
            let mut design = DMatrix::zeros(n, rows.len());
            for (&(i, direction), column) in rows.iter().zip(design.as_mut_slice().chunks_exact_mut(n)) {
                if self.usable(positions.at(i), extrapolate) {
                    basis.project(positions.at(i), direction, 1.0, &mut scratch, column);
                } else {
                    column.fill(f64::NAN);
                }
            }
            let spread = &full * &design;
            for (k, sigma) in out.iter_mut().enumerate() {
                // Rounding may leave a variance of zero just below it.
                let variance = spread.column(k).dot(&design.column(k));
                *sigma = if variance.is_nan() {
                    f64::NAN
                } else if self.unsensed(rows[k].1).is_some() {
                    f64::INFINITY
                } else {
                    self.misfit().sigma(variance.max(0.0).sqrt())
                };
            }
        });
        Ok(out)
    }
}

pub(crate) fn norm(v: [f64; 3]) -> f64 {
    (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt()
}
