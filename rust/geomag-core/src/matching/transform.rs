//! Closed-form least-squares transforms of a point set onto another: translation, rigid, similarity, affine.

use serde::{Deserialize, Serialize};

use crate::bounds::{MOST_VALUE, require_points, require_spread};
use crate::error::{Error, Result};

/// Smallest ratio of the spread across a point set to the spread along it that still counts as a plane figure.
const COLLINEAR: f64 = 1e-6;

/// What a transform may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TransformKind {
    /// A shift: two parameters, one point or more.
    Translation,
    /// Shift and rotation: three parameters, two distinct points or more.
    #[default]
    Rigid,
    /// Shift, rotation and one scale: four parameters, two distinct points or more.
    Similarity,
    /// Any linear map and a shift: six parameters, three points or more that are not on a line.
    Affine,
}

impl TransformKind {
    /// Every kind, by growing number of parameters.
    pub const ALL: [Self; 4] = [Self::Translation, Self::Rigid, Self::Similarity, Self::Affine];

    /// The name used in Python and reports.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Translation => "translation",
            Self::Rigid => "rigid",
            Self::Similarity => "similarity",
            Self::Affine => "affine",
        }
    }

    /// How many numbers it is free to choose.
    pub const fn parameters(self) -> usize {
        match self {
            Self::Translation => 2,
            Self::Rigid => 3,
            Self::Similarity => 4,
            Self::Affine => 6,
        }
    }

    /// The least number of points that determine it.
    pub const fn min_points(self) -> usize {
        match self {
            Self::Translation => 1,
            Self::Rigid | Self::Similarity => 2,
            Self::Affine => 3,
        }
    }
}

/// A map of the plane, metres to metres: `q = matrix p + shift`, rows east and north.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Transform {
    /// Linear part, row-major.
    pub matrix: [[f64; 2]; 2],
    /// Shift in metres `[east, north]`.
    pub shift: [f64; 2],
}

impl Transform {
    /// The map that moves nothing.
    pub const IDENTITY: Self = Self { matrix: [[1.0, 0.0], [0.0, 1.0]], shift: [0.0, 0.0] };

    /// The image of a point.
    #[inline]
    pub fn apply(&self, p: [f64; 2]) -> [f64; 2] {
        let m = &self.matrix;
        [m[0][0] * p[0] + m[0][1] * p[1] + self.shift[0], m[1][0] * p[0] + m[1][1] * p[1] + self.shift[1]]
    }

    /// Rotation and scale about the origin, then a shift; the rotation counter-clockwise in radians.
    pub fn similarity(rotation_rad: f64, scale: f64, shift: [f64; 2]) -> Self {
        let (s, c) = rotation_rad.sin_cos();
        Self { matrix: [[scale * c, -scale * s], [scale * s, scale * c]], shift }
    }

    /// The rotation nearest to the linear part, counter-clockwise, radians.
    pub fn rotation_rad(&self) -> f64 {
        let m = &self.matrix;
        (m[1][0] - m[0][1]).atan2(m[0][0] + m[1][1])
    }

    /// The mean scale: square root of the absolute determinant.
    pub fn scale(&self) -> f64 {
        let m = &self.matrix;
        (m[0][0] * m[1][1] - m[0][1] * m[1][0]).abs().sqrt()
    }

    /// The transform of a kind that takes `from` nearest to `to` in weighted least squares.
    ///
    /// With weighted centroids p0 and q0, p = from - p0, q = to - q0: rotation = atan2(sum w (p x q), sum w (p . q)),
    /// scale = hypot of the same two sums over sum w |p|^2, affine = (sum w q p')(sum w p p')^-1; the shift follows
    /// (Horn 1987, in the plane). Reflections never result from a rigid or similarity fit.
    ///
    /// # Errors
    /// [`Error::Shape`] for unequal lengths, [`Error::NotFinite`], [`Error::Invalid`] for a negative weight or weights
    /// that are all zero, [`Error::TooFewSamples`], [`Error::RankDeficient`] where points coincide or (affine) lie on a
    /// line.
    ///
    /// ```
    /// use geomag_core::matching::transform::{Transform, TransformKind};
    /// let from = [[0.0, 0.0], [100.0, 0.0], [100.0, 50.0]];
    /// let to = from.map(|[x, y]| [10.0 - y, 20.0 + x]);
    /// let turn = Transform::fit(TransformKind::Rigid, &from, &to, None)?;
    /// assert!((turn.rotation_rad().to_degrees() - 90.0).abs() < 1e-9);
    /// # Ok::<(), geomag_core::error::Error>(())
    /// ```
    pub fn fit(kind: TransformKind, from: &[[f64; 2]], to: &[[f64; 2]], weights: Option<&[f64]>) -> Result<Self> {
        let n = from.len();
        if to.len() != n {
            return Err(Error::shape("transform targets", format!("{n} points as the sources"), to.len()));
        }
        require_points("transform source", from)?;
        require_points("transform target", to)?;
        if let Some(w) = weights {
            if w.len() != n {
                return Err(Error::shape("transform weights", format!("{n} weights as the sources"), w.len()));
            }
            if let Some(i) = w.iter().position(|w| !(0.0..=MOST_VALUE).contains(w)) {
                require_spread(&format!("transform weights[{i}]"), w[i])?;
            }
        }
        let used = weights.map_or(n, |w| w.iter().filter(|&&w| w > 0.0).count());
        if used < kind.min_points() {
            return Err(Error::TooFewSamples {
                what: format!("{} transform (points of positive weight)", kind.as_str()),
                needed: kind.min_points(),
                got: used,
            });
        }
        let mut sums = TransformSums::default();
        for k in 0..n {
            sums.add(from[k], to[k], weights.map_or(1.0, |w| w[k]));
        }
        sums.solve(kind, from, to, weights)
    }
}

/// Weighted first moments of pairs of points.
#[derive(Default)]
struct TransformSums {
    weight: f64,
    from: [f64; 2],
    to: [f64; 2],
}

impl TransformSums {
    fn add(&mut self, p: [f64; 2], q: [f64; 2], w: f64) {
        self.weight += w;
        for i in 0..2 {
            self.from[i] += w * p[i];
            self.to[i] += w * q[i];
        }
    }

    fn solve(
        &self,
        kind: TransformKind,
        from: &[[f64; 2]],
        to: &[[f64; 2]],
        weights: Option<&[f64]>,
    ) -> Result<Transform> {
        let p0 = self.from.map(|v| v / self.weight);
        let q0 = self.to.map(|v| v / self.weight);
        // Second moments about the centroids: sum w q p' and sum w p p'.
        let (mut qp, mut pp) = ([[0.0; 2]; 2], [[0.0; 2]; 2]);
        for (k, (p, q)) in from.iter().zip(to).enumerate() {
            let w = weights.map_or(1.0, |w| w[k]);
            let p = [p[0] - p0[0], p[1] - p0[1]];
            let q = [q[0] - q0[0], q[1] - q0[1]];
            for i in 0..2 {
                for j in 0..2 {
                    qp[i][j] += w * q[i] * p[j];
                    pp[i][j] += w * p[i] * p[j];
                }
            }
        }
        let spread = pp[0][0] + pp[1][1];
        let deficient = |rank, detail: &str| Error::RankDeficient {
            what: format!("{} transform", kind.as_str()),
            rank,
            needed: kind.min_points() - 1,
            detail: detail.into(),
        };
        // Rounding of the centroid alone gives this much spread.
        let rounding = self.weight * (p0[0].hypot(p0[1]) * 4.0 * f64::EPSILON).powi(2);
        if kind != TransformKind::Translation && spread <= rounding {
            return Err(deficient(0, "all points coincide, so a rotation has no lever"));
        }
        let (dot, cross) = (qp[0][0] + qp[1][1], qp[1][0] - qp[0][1]);
        let matrix = match kind {
            TransformKind::Translation => Transform::IDENTITY.matrix,
            TransformKind::Rigid => Transform::similarity(cross.atan2(dot), 1.0, [0.0; 2]).matrix,
            TransformKind::Similarity => {
                Transform::similarity(cross.atan2(dot), dot.hypot(cross) / spread, [0.0; 2]).matrix
            }
            TransformKind::Affine => {
                let det = pp[0][0] * pp[1][1] - pp[0][1] * pp[1][0];
                if det <= (COLLINEAR * spread).powi(2).max(spread * rounding) {
                    return Err(deficient(
                        1,
                        "the points lie on a line; an affine transform needs points on both sides of it: use similarity",
                    ));
                }
                let inverse = [[pp[1][1] / det, -pp[0][1] / det], [-pp[1][0] / det, pp[0][0] / det]];
                let mut m = [[0.0; 2]; 2];
                for i in 0..2 {
                    for j in 0..2 {
                        m[i][j] = qp[i][0] * inverse[0][j] + qp[i][1] * inverse[1][j];
                    }
                }
                m
            }
        };
        let turned = Transform { matrix, shift: [0.0; 2] }.apply(p0);
        Ok(Transform { matrix, shift: [q0[0] - turned[0], q0[1] - turned[1]] })
    }
}
