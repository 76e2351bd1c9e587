//! The offset lattice, and the one set of hot kernels that sample a map along a shifted track.
//!
//! Offsets that are whole multiples of the map spacing share the interpolation weights of a sample: the four bilinear
//! weights are constants and a row of offsets is a contiguous, vectorisable sum. A lattice step of spacing / q falls
//! into q x q such classes. Everything else (other steps, bicubic sampling, fields that are no grid) goes point by point.
//!
//! Arithmetic and load limit of the fast path, per vector of (offset, sample) and for the squared difference. The sums
//! of 8 rows by 2 vectors stay in registers while samples are added to them, so that sums cost no memory access worth
//! counting; the interpolation of one node row along x (one fused multiply-add) serves the offset rows above and below
//! it. Left are 9/8 + 3 multiply-adds or multiplications, 1 subtraction and 9/8 nodes read twice. Vectors that fill a
//! cache line are loaded once, not aligned (two lines), and their right neighbours made by a turn and a blend.
//! With two multiply-add units and the rest on units of their own (Zen 5) that is 2.1 cycles a vector: 0.26 cycles an
//! offset-sample in float64 and 0.13 in float32 with AVX-512. With two units for everything (most others) it is 3.7
//! cycles with AVX-512 and 2.6 with AVX2, whose vectors are half as long.

mod best_two;
mod comparison;
mod shift;
mod simd;
mod tile;

pub use best_two::BestTwo;
pub use comparison::Comparison;
pub(crate) use shift::{Classes, Shift, value_at};
pub use simd::{Kernel, Real, dispatch};
pub use tile::{MAX_SLOTS, Measure};

use serde::{Deserialize, Serialize};

use crate::bounds::{require_extent, require_resolved};
use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::field::Field;
use crate::track::Track;

/// What no caller can raise that limit above: 2^31, 16 GiB of scores. Beyond it a machine that promises more memory than
/// it has would end the process rather than refuse.
pub const MOST_CANDIDATES: u64 = 1 << 31;

/// The regular set of candidate offsets: `2 half + 1` a side, centred on no offset.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OffsetLattice {
    half: [usize; 2],
    step: [f64; 2],
}

impl OffsetLattice {
    /// The lattice that covers `half_width` (map units, >= 0) in steps of `step` (> 0), each `[x, y]`.
    ///
    /// Half its size is ceil(half width / step) with a tolerance for rounding: 0.1 / 0.01 is 10, not 11 (\[IEMA\] step 1).
    ///
    /// # Errors
    /// [`Error::Invalid`], or [`Error::TooManyCandidates`] beyond `max_candidates` or [`MOST_CANDIDATES`], before any
    /// memory is taken.
    pub fn new(half_width: [f64; 2], step: [f64; 2], max_candidates: u64) -> Result<Self> {
        let mut half = [0_usize; 2];
        let mut sizes = [0_u128; 2];
        for (d, axis) in ["x", "y"].iter().enumerate() {
            require_not_negative(&format!("half_width {axis}"), half_width[d])?;
            require_positive(&format!("step {axis}"), step[d])?;
            let ratio = (half_width[d] / step[d]).min(f64::MAX);
            let cells = (ratio - 1e-9 * ratio.max(1.0)).ceil().max(0.0);
            sizes[d] = (cells as u128).saturating_mul(2).saturating_add(1);
            half[d] = cells as usize;
        }
        let needed = sizes[0].saturating_mul(sizes[1]);
        let limit = max_candidates.min(MOST_CANDIDATES);
        if needed > u128::from(limit) {
            return Err(Error::TooManyCandidates {
                what: format!("offset lattice of {} x {}", sizes[0], sizes[1]),
                needed,
                limit,
            });
        }
        for (d, axis) in ["x", "y"].iter().enumerate() {
            require_extent(&format!("half_width {axis}"), half_width[d])?;
            require_resolved(&format!("step {axis}"), step[d])?;
        }
        Ok(Self { half, step })
    }

    /// Number of y offsets.
    pub fn rows(&self) -> usize {
        2 * self.half[1] + 1
    }

    /// Number of x offsets.
    pub fn columns(&self) -> usize {
        2 * self.half[0] + 1
    }

    /// Number of candidates.
    #[allow(clippy::len_without_is_empty)] // at least the zero offset
    pub fn len(&self) -> usize {
        self.rows() * self.columns()
    }

    /// Step `[x, y]`, map units.
    pub fn step(&self) -> [f64; 2] {
        self.step
    }

    /// Half size `[x, y]` in steps: the index of no offset.
    pub fn half(&self) -> [usize; 2] {
        self.half
    }

    /// Offset of a row (y) and column (x), map units `[x, y]`; the middle is exactly zero.
    pub fn offset(&self, row: usize, column: usize) -> [f64; 2] {
        [(column as f64 - self.half[0] as f64) * self.step[0], (row as f64 - self.half[1] as f64) * self.step[1]]
    }

    /// Whether a row and column lie on the border of the search. A direction with one offset only has no border.
    pub fn on_border(&self, row: usize, column: usize) -> bool {
        (self.half[1] > 0 && (row == 0 || row == self.rows() - 1))
            || (self.half[0] > 0 && (column == 0 || column == self.columns() - 1))
    }
}

/// Where a rotation or a change of scale of the track leaves it unmoved.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Pivot {
    /// The newest point: the fix is for now.
    #[default]
    Newest,
    /// The mean of the indicated points.
    Centroid,
}

/// The mean of points, longitudes counted from the first one's so that a track over the date line has its own middle.
pub(crate) fn centroid(geographic: bool, points: impl Iterator<Item = [f64; 2]>) -> [f64; 2] {
    let mut points = points.peekable();
    let origin = points.peek().copied().unwrap_or([f64::NAN; 2]);
    let (mut x, mut y, mut n) = (0.0, 0.0, 0.0);
    for p in points {
        let unwrapped = if geographic { crate::frame::wrap_longitude(p[0], origin[0]) } else { p[0] };
        x += unwrapped - origin[0];
        y += p[1] - origin[1];
        n += 1.0;
    }
    [origin[0] + x / n, origin[1] + y / n]
}

/// Track points rotated by `heading_deg` (clockwise from above, as headings are) and stretched by `scale` about the pivot.
///
/// Done in metres; a rotation in longitude and latitude is no rotation. No rotation and no stretch give the points back
/// to the last bit.
pub fn place_track(field: &dyn Field, track: &Track, heading_deg: f64, scale: f64, pivot: Pivot) -> Vec<[f64; 2]> {
    let points = (0..track.len()).map(|k| track.point(k));
    if heading_deg == 0.0 && scale == 1.0 {
        return points.collect();
    }
    let geographic = field.geographic();
    let pivot = match pivot {
        Pivot::Newest => track.newest(),
        Pivot::Centroid => centroid(geographic, points.clone()),
    };
    let (sin, cos) = heading_deg.to_radians().sin_cos();
    points
        .map(|p| {
            let [east, north] = field.displacement_m(pivot, p);
            let moved = [scale * (cos * east + sin * north) - east, scale * (cos * north - sin * east) - north];
            let unit = field.metres_per_unit(p[1]);
            [p[0] + moved[0] / unit[0], p[1] + moved[1] / unit[1]]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::centroid;

    #[test]
    fn the_middle_of_a_track_over_the_date_line_is_on_it() {
        let track = [[179.5, 10.0], [-179.5, 11.0], [-178.5, 12.0]];
        let [x, y] = centroid(true, track.into_iter());
        assert!((x - 180.5).abs() < 1e-12 && (y - 11.0).abs() < 1e-12, "{x} {y}");
        assert_eq!(centroid(false, [[179.0, 0.0], [-179.0, 0.0]].into_iter()), [0.0, 0.0]);
    }
}
