//! The closed-form transform under constraints: priors and a greatest rotation.

use super::options::ContourOptions;
use crate::matching::transform::{Transform, TransformKind};

/// Points and where they should go.
pub(super) struct Pairs {
    pub from: Vec<[f64; 2]>,
    pub to: Vec<[f64; 2]>,
    pub weights: Vec<f64>,
}

impl Pairs {
    pub fn with_capacity(n: usize) -> Self {
        Self { from: Vec::with_capacity(n), to: Vec::with_capacity(n), weights: Vec::with_capacity(n) }
    }

    pub fn clear(&mut self) {
        self.from.clear();
        self.to.clear();
        self.weights.clear();
    }

    pub fn push(&mut self, from: [f64; 2], to: [f64; 2], weight: f64) {
        self.from.push(from);
        self.to.push(to);
        self.weights.push(weight);
    }
}

impl ContourOptions {
    /// Inverse variances of east, north, rotation and scale as this kind of transform has them.
    fn prior_information(&self) -> [f64; 4] {
        let p = &self.refinement.priors;
        let inverse = |s: Option<f64>| s.map_or(0.0, |s| 1.0 / (s * s));
        let offset = inverse(p.offset_sigma_m);
        [offset, offset, inverse(p.heading_sigma_deg.map(f64::to_radians)), inverse(p.scale_sigma)]
    }

    pub(super) fn prior_penalty(&self, t: &Transform) -> f64 {
        let q = [t.shift[0], t.shift[1], t.rotation_rad(), t.scale() - 1.0];
        q.iter().zip(self.prior_information()).map(|(q, i)| i * q * q).sum()
    }

    /// The least-squares transform with the priors as further observations: three Gauss-Newton steps from the free fit,
    /// whose only nonlinearity is the rotation's.
    pub(super) fn fit_with_priors(&self, pairs: &Pairs, free: &Transform, information: f64) -> Transform {
        let prior = self.prior_information();
        let used = match self.transform {
            TransformKind::Translation => 2,
            TransformKind::Rigid => 3,
            TransformKind::Similarity | TransformKind::Affine => 4,
        };
        let mut q = [free.shift[0], free.shift[1], free.rotation_rad(), free.scale() - 1.0];
        for _ in 0..3 {
            let mut normal = nalgebra::Matrix4::<f64>::identity();
            let mut gradient = nalgebra::Vector4::<f64>::zeros();
            normal.view_mut((0, 0), (used, used)).fill(0.0);
            let (sin, cos) = q[2].sin_cos();
            for ((p, y), w) in pairs.from.iter().zip(&pairs.to).zip(&pairs.weights) {
                let w = w * information;
                let turned = [cos * p[0] - sin * p[1], sin * p[0] + cos * p[1]];
                let scale = 1.0 + q[3];
                let r = [q[0] + scale * turned[0] - y[0], q[1] + scale * turned[1] - y[1]];
                let columns = [[1.0, 0.0], [0.0, 1.0], [-scale * turned[1], scale * turned[0]], [turned[0], turned[1]]];
                for i in 0..used {
                    gradient[i] += w * (columns[i][0] * r[0] + columns[i][1] * r[1]);
                    for j in 0..used {
                        normal[(i, j)] += w * (columns[i][0] * columns[j][0] + columns[i][1] * columns[j][1]);
                    }
                }
            }
            for i in 0..used {
                normal[(i, i)] += prior[i];
                gradient[i] += prior[i] * q[i];
            }
            let Some(factor) = normal.cholesky() else { break };
            let step = factor.solve(&gradient);
            for i in 0..used {
                q[i] -= step[i];
            }
        }
        Transform::similarity(q[2], 1.0 + q[3], [q[0], q[1]])
    }

    /// The transform with its rotation held within the cap, the centroid of the points going where it went.
    pub(super) fn cap_rotation(&self, t: Transform, pairs: &Pairs) -> Transform {
        let Some(cap) = self.max_rotation_deg else { return t };
        let (rotation, cap) = (t.rotation_rad(), cap.to_radians());
        if rotation.abs() <= cap || self.transform == TransformKind::Affine {
            return t;
        }
        let (mut weight, mut centre) = (0.0, [0.0; 2]);
        for (p, w) in pairs.from.iter().zip(&pairs.weights) {
            weight += w;
            centre = [centre[0] + w * p[0], centre[1] + w * p[1]];
        }
        let centre = centre.map(|v| v / weight);
        let held = Transform::similarity(rotation.clamp(-cap, cap), t.scale(), [0.0; 2]);
        let (goal, turned) = (t.apply(centre), held.apply(centre));
        Transform { shift: [goal[0] - turned[0], goal[1] - turned[1]], ..held }
    }
}
