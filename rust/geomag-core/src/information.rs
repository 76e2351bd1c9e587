//! How much a map tells about position: the Cramer-Rao bound of a straight track that ends at every node.
//!
//! A local computation: the result at a node rests on the nodes within the track's length of it and on nothing else, so a
//! large map can be done in blocks with the same bits for any cut.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_not_negative, require_positive};
use crate::frame::metres_per_degree;

/// The track that is assumed, and the errors of what is read along it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackInformation {
    /// Headings, degrees clockwise from north; one result each.
    pub heading_deg: Vec<f64>,
    /// Samples of the track, the last at the node.
    pub samples: usize,
    /// Distance between samples, metres.
    pub spacing_m: f64,
    /// Standard deviation of a reading, value units.
    pub sigma: f64,
    /// Error of the map as a distance: its standard deviation is this times the gradient, metres.
    pub map_error_m: f64,
    /// Whether a constant of the readings is unknown.
    pub free_level: bool,
    /// Two standard deviations within this are a fix, metres.
    pub tolerance_m: f64,
}

impl Default for TrackInformation {
    /// Northward and eastward tracks of 20 samples, 500 m apart, 5 nT, a map right to 30 m, the level unknown.
    fn default() -> Self {
        Self {
            heading_deg: vec![0.0, 90.0],
            samples: 20,
            spacing_m: 500.0,
            sigma: 5.0,
            map_error_m: 30.0,
            free_level: true,
            tolerance_m: 500.0,
        }
    }
}

/// Part of a map: values row-major, row = y, NaN where unknown.
#[derive(Debug, Clone, Copy)]
pub struct NodeBlock<'a> {
    /// Values.
    pub values: &'a [f64],
    /// y of the rows, map units, ascending.
    pub y: &'a [f64],
    /// Number of columns.
    pub columns: usize,
    /// Spacing of the whole map `[x, y]`, map units. Of the whole map, because a block's own differs by rounding.
    pub spacing: [f64; 2],
    /// Whether coordinates are degrees of longitude and latitude.
    pub geographic: bool,
}

/// What a map tells along tracks of one heading.
#[derive(Debug, Clone, PartialEq)]
pub struct Bound {
    /// Least standard deviation of position that any unbiased matcher can have, root of the trace of the bound, metres;
    /// NaN where over a fifth of the track is unknown or nothing is told.
    pub error_m: Vec<f32>,
    /// Samples, counted back from the node, after which twice that is within the tolerance; NaN if never.
    pub samples: Vec<f32>,
}

/// Nodes from which a place is off any map: sums with it are whole numbers still.
const FARTHEST: f64 = 1e15;
/// Least share of a track that must be known.
const LEAST_KNOWN: f64 = 0.8;

impl TrackInformation {
    fn check(&self) -> Result<()> {
        if self.heading_deg.is_empty() {
            return Err(Error::invalid("heading_deg", "at least one heading", "none"));
        }
        require_finite("heading_deg", &self.heading_deg)?;
        if !(2..=100_000).contains(&self.samples) {
            return Err(Error::invalid("samples", "from 2 to 100000", self.samples));
        }
        require_positive("spacing_m", self.spacing_m)?;
        require_positive("sigma", self.sigma)?;
        require_not_negative("map_error_m", self.map_error_m)?;
        require_positive("tolerance_m", self.tolerance_m)?;
        Ok(())
    }

    /// Nodes `[rows, columns]` that the result at a node reaches to, for a map of this spacing (map units) whose latitude
    /// is at most `latitude_deg` away from the equator.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the option.
    pub fn reach(&self, spacing: [f64; 2], geographic: bool, latitude_deg: f64) -> Result<[usize; 2]> {
        self.check()?;
        let length = self.spacing_m * (self.samples - 1) as f64;
        let [east, _] = if geographic { metres_per_degree(latitude_deg.abs().min(89.0)) } else { [1.0, 1.0] };
        // A degree of latitude is shortest at the equator.
        let north = if geographic { metres_per_degree(0.0)[1] } else { 1.0 };
        let (mut rows, mut columns) = (0.0_f64, 0.0_f64);
        for heading in &self.heading_deg {
            let (sin, cos) = (libm::sin(heading.to_radians()), libm::cos(heading.to_radians()));
            rows = rows.max((length * cos).abs() / (spacing[1] * north));
            columns = columns.max((length * sin).abs() / (spacing[0] * east));
        }
        // One more for rounding to nodes, one for the differences.
        Ok([rows.ceil() as usize + 2, columns.ceil() as usize + 2])
    }

    /// The bound at every node of a block, one [`Bound`] a heading.
    ///
    /// Information matrix of the offset: sum w g g^T over the track, g the map's gradient (central differences at the
    /// node next to each sample), w = 1 / (sigma^2 + (`map_error_m` |g|)^2); with a free level less
    /// (sum w g)(sum w g)^T / sum w. The bound is its inverse (Van Trees 1968, section 2.4). It is local: it does not
    /// know of other places that fit as well.
    ///
    /// ```
    /// use geomag_core::information::{NodeBlock, TrackInformation};
    /// // A plane tells nothing across its slope; waves in both directions do.
    /// let n = 60_usize;
    /// let values: Vec<f64> = (0..n * n)
    ///     .map(|i| 80.0 * ((i % n) as f64 / 3.0).sin() * ((i / n) as f64 / 4.0).cos())
    ///     .collect();
    /// let y: Vec<f64> = (0..n).map(|i| 500.0 * i as f64).collect();
    /// let block = NodeBlock { values: &values, y: &y, columns: n, spacing: [500.0; 2], geographic: false };
    /// let north = &TrackInformation::default().bound(&block)?[0];
    /// assert!(north.error_m[40 * n + 30] < 100.0);
    /// assert!(north.error_m[0].is_nan()); // its track lies off the map
    /// # Ok::<(), geomag_core::error::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the option, [`Error::Shape`] where values and axes do not fit.
    pub fn bound(&self, block: &NodeBlock<'_>) -> Result<Vec<Bound>> {
        self.check()?;
        let (rows, columns) = (block.y.len(), block.columns);
        if rows.checked_mul(columns) != Some(block.values.len()) || columns == 0 {
            let needed = format!("{rows} rows x {columns} columns, at least one of each");
            return Err(Error::shape("block values", needed, format!("{} values", block.values.len())));
        }
        for (name, spacing) in [("x", block.spacing[0]), ("y", block.spacing[1])] {
            require_positive(&format!("block spacing {name}"), spacing)?;
        }
        require_finite("block y", block.y)?;
        let gradient = gradient(block);
        Ok(self.heading_deg.iter().map(|&heading| self.along(block, &gradient, heading)).collect())
    }

    fn along(&self, block: &NodeBlock<'_>, gradient: &[[f64; 2]], heading_deg: f64) -> Bound {
        let columns = block.columns;
        let rows = block.y.len() as i64;
        let (sin, cos) = (libm::sin(heading_deg.to_radians()), libm::cos(heading_deg.to_radians()));
        let mut out = Bound { error_m: vec![f32::NAN; gradient.len()], samples: vec![f32::NAN; gradient.len()] };
        let error_rows = out.error_m.par_chunks_mut(columns);
        let sample_rows = out.samples.par_chunks_mut(columns);
        error_rows.zip(sample_rows).enumerate().for_each(|(row, (errors, samples))| {
            let [cell_east, cell_north] = cell_m(block, row);
            // Shifts back along the track, the same for the whole row.
            let shifts: Vec<(i64, i64)> = (0..self.samples)
                .map(|k| {
                    let back = k as f64 * self.spacing_m;
                    let nodes = |metres: f64, cell: f64| (metres / cell).round().clamp(-FARTHEST, FARTHEST) as i64;
                    (row as i64 - nodes(back * cos, cell_north), -nodes(back * sin, cell_east))
                })
                .collect();
            for column in 0..columns {
                let mut sums = InformationSums::default();
                let mut soon = f32::NAN;
                for (k, &(r, shift)) in shifts.iter().enumerate() {
                    let c = column as i64 + shift;
                    if !(0..rows).contains(&r) || !(0..columns as i64).contains(&c) {
                        continue;
                    }
                    let g = gradient[r as usize * columns + c as usize];
                    if g[0].is_nan() {
                        continue;
                    }
                    sums.add(g, self);
                    if soon.is_nan() && 2.0 * sums.error_m(self.free_level) <= self.tolerance_m {
                        soon = (k + 1) as f32;
                    }
                }
                if f64::from(sums.known) >= LEAST_KNOWN * self.samples as f64 {
                    errors[column] = sums.error_m(self.free_level) as f32;
                    samples[column] = soon;
                }
            }
        });
        out
    }
}

/// Metres per cell of a row, `[east, north]`.
fn cell_m(block: &NodeBlock<'_>, row: usize) -> [f64; 2] {
    let [east, north] = if block.geographic { metres_per_degree(block.y[row]) } else { [1.0, 1.0] };
    [block.spacing[0] * east, block.spacing[1] * north]
}

/// Central differences per metre `[east, north]`; NaN on the border and beside holes.
fn gradient(block: &NodeBlock<'_>) -> Vec<[f64; 2]> {
    let (rows, columns) = (block.y.len(), block.columns);
    let mut out = vec![[f64::NAN; 2]; block.values.len()];
    out.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        if row == 0 || row + 1 >= rows {
            return;
        }
        let [east, north] = cell_m(block, row);
        for (column, out) in line.iter_mut().enumerate().take(columns.saturating_sub(1)).skip(1) {
            let at = row * columns + column;
            let along_x = (block.values[at + 1] - block.values[at - 1]) / (2.0 * east);
            let along_y = (block.values[at + columns] - block.values[at - columns]) / (2.0 * north);
            let known = (along_x + along_y + block.values[at]).is_finite();
            *out = if known { [along_x, along_y] } else { [f64::NAN; 2] };
        }
    });
    out
}

/// Weighted sums along a track.
#[derive(Debug, Clone, Copy, Default)]
struct InformationSums {
    w: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    known: u32,
}

impl InformationSums {
    fn add(&mut self, [x, y]: [f64; 2], options: &TrackInformation) {
        let variance = options.sigma * options.sigma + options.map_error_m * options.map_error_m * (x * x + y * y);
        let w = 1.0 / variance;
        self.w += w;
        self.x += w * x;
        self.y += w * y;
        self.xx += w * x * x;
        self.xy += w * x * y;
        self.yy += w * y * y;
        self.known += 1;
    }

    /// Root of the trace of the inverse; infinite where the matrix has none.
    fn error_m(&self, free_level: bool) -> f64 {
        let (mut xx, mut xy, mut yy) = (self.xx, self.xy, self.yy);
        if free_level && self.w > 0.0 {
            xx -= self.x * self.x / self.w;
            xy -= self.x * self.y / self.w;
            yy -= self.y * self.y / self.w;
        }
        let determinant = xx * yy - xy * xy;
        // Rounding must not make a direction known that is not: it is as large as the sums before the level is taken out.
        let before = self.xx + self.yy;
        if determinant > 1e-12 * before * before { ((xx + yy) / determinant).sqrt() } else { f64::INFINITY }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    fn waves(n: usize) -> (Vec<f64>, Vec<f64>) {
        let value =
            |i: usize| 80.0 * ((i % n) as f64 / 3.0).sin() * ((i / n) as f64 / 4.0).cos() + 3.0 * (i % n) as f64;
        ((0..n * n).map(value).collect(), (0..n).map(|i| 100.0 * i as f64).collect())
    }

    #[test]
    fn the_bound_is_the_inverse_of_the_information() {
        let n = 50;
        let (values, y) = waves(n);
        let block = NodeBlock { values: &values, y: &y, columns: n, spacing: [100.0; 2], geographic: false };
        let options = TrackInformation {
            heading_deg: vec![90.0],
            samples: 12,
            spacing_m: 200.0,
            sigma: 2.0,
            map_error_m: 0.0,
            free_level: true,
            tolerance_m: 50.0,
        };
        let found = &options.bound(&block).unwrap()[0];
        let (row, column) = (20, 40);
        let g: Vec<[f64; 2]> = (0..12).map(|k| gradient(&block)[row * n + column - 2 * k]).collect();
        // Level, east, north: the inverse's lower right block by nalgebra.
        let design = nalgebra::DMatrix::from_fn(12, 3, |i, j| if j == 0 { 1.0 } else { g[i][j - 1] } / 2.0);
        let inverse = (design.transpose() * design).try_inverse().unwrap();
        let expected = (inverse[(1, 1)] + inverse[(2, 2)]).sqrt();
        assert_relative_eq!(f64::from(found.error_m[row * n + column]), expected, max_relative = 1e-6);
    }

    #[test]
    fn a_plane_tells_nothing_and_a_hole_is_unknown() {
        let n = 40;
        let y: Vec<f64> = (0..n).map(|i| 100.0 * i as f64).collect();
        let plane: Vec<f64> = (0..n * n).map(|i| 5.0 * (i % n) as f64 + 3.0 * (i / n) as f64).collect();
        let options = TrackInformation { samples: 10, spacing_m: 100.0, ..TrackInformation::default() };
        let block = NodeBlock { values: &plane, y: &y, columns: n, spacing: [100.0; 2], geographic: false };
        let north = &options.bound(&block).unwrap()[0];
        assert!(north.error_m[20 * n + 20].is_infinite());
        assert!(north.samples[20 * n + 20].is_nan());
        let (mut values, _) = waves(n);
        values[18 * n + 20] = f64::NAN;
        let block = NodeBlock { values: &values, y: &y, columns: n, spacing: [100.0; 2], geographic: false };
        let north = &options.bound(&block).unwrap()[0];
        assert!(north.error_m[20 * n + 20].is_nan()); // three of ten samples are beside the hole
        assert!(north.error_m[30 * n + 20].is_finite());
    }

    #[test]
    fn bad_options_are_refused() {
        let (values, y) = waves(8);
        let block = NodeBlock { values: &values, y: &y, columns: 8, spacing: [100.0; 2], geographic: false };
        for bad in [
            TrackInformation { heading_deg: vec![], ..TrackInformation::default() },
            TrackInformation { samples: 1, ..TrackInformation::default() },
            TrackInformation { sigma: 0.0, ..TrackInformation::default() },
            TrackInformation { spacing_m: f64::NAN, ..TrackInformation::default() },
        ] {
            assert!(bad.bound(&block).is_err());
        }
        let wrong = NodeBlock { columns: 7, ..block };
        assert!(TrackInformation::default().bound(&wrong).is_err());
    }
}
