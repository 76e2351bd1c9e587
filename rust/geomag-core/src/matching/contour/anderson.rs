//! Anderson acceleration.

/// How many times further than the plain step an extrapolation may go.
const GREATEST_EXTRAPOLATION: f64 = 20.0;

/// Anderson acceleration (type II; Walker and Ni 2011) of a fixed-point iteration in six coordinates.
pub(super) struct Anderson {
    depth: usize,
    last: Option<([f64; 6], [f64; 6])>,
    /// Differences of images and of residuals, oldest first.
    history: Vec<([f64; 6], [f64; 6])>,
}

impl Anderson {
    pub const fn new(depth: usize) -> Self {
        Self { depth, last: None, history: Vec::new() }
    }

    pub fn clear(&mut self) {
        self.last = None;
        self.history.clear();
    }

    /// The next place from a place and its image; `None` where the plain image is to be taken.
    pub fn next(&mut self, place: [f64; 6], image: [f64; 6]) -> Option<[f64; 6]> {
        if self.depth == 0 {
            return None;
        }
        let difference = |a: &[f64; 6], b: &[f64; 6]| std::array::from_fn(|i| a[i] - b[i]);
        let residual: [f64; 6] = difference(&image, &place);
        if let Some((last_image, last_residual)) = self.last.replace((image, residual)) {
            if self.history.len() == self.depth {
                self.history.remove(0);
            }
            self.history.push((difference(&image, &last_image), difference(&residual, &last_residual)));
        }
        if self.history.is_empty() {
            return None;
        }
        let columns = nalgebra::DMatrix::from_fn(6, self.history.len(), |i, j| self.history[j].1[i]);
        let target = nalgebra::DVector::from_column_slice(&residual);
        let svd = columns.svd(true, true);
        let cutoff = 1e-8 * svd.singular_values.max();
        let gamma = svd.solve(&target, cutoff).ok()?;
        let mut further = [0.0; 6];
        for (j, (step, _)) in self.history.iter().enumerate() {
            for i in 0..6 {
                further[i] -= gamma[j] * step[i];
            }
        }
        let length = |v: &[f64; 6]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
        let shrink = (GREATEST_EXTRAPOLATION * length(&residual) / length(&further).max(f64::MIN_POSITIVE)).min(1.0);
        let next: [f64; 6] = std::array::from_fn(|i| image[i] + shrink * further[i]);
        next.iter().all(|v| v.is_finite()).then_some(next)
    }
}
