//! Evenly spaced axes, and positions along them.

// Only what is inlined into a dispatched function is compiled for its instruction set, and only what has no branch becomes vectors.
#![allow(clippy::inline_always, clippy::needless_bitwise_bool)]

use serde::{Deserialize, Serialize};

use crate::bounds::{LEAST_STEP, require_places};
use crate::error::{Error, Result};
use crate::frame::wrap_longitude;

/// Positions within this many cells of a node are taken to be on it, so that rounding never drags a neighbouring hole in.
pub(super) const NODE_TOLERANCE: f64 = 1e-9;
/// Greatest departure of an axis from even spacing, in cells.
const EVENNESS_TOLERANCE: f64 = 1e-2;

/// An evenly spaced, ascending axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    first: f64,
    step: f64,
    len: usize,
}

impl Axis {
    /// An axis from its first coordinate, its spacing (> 0) and its number of nodes (>= 2).
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`], [`Error::TooFewSamples`].
    pub fn new(first: f64, step: f64, len: usize) -> Result<Self> {
        crate::error::require_positive("axis step", step)?;
        if step < LEAST_STEP {
            return Err(Error::invalid("axis step", format!("at least {LEAST_STEP} map units"), step));
        }
        let last = first + step * len.saturating_sub(1) as f64;
        require_places("axis first and last", false, &[first, last], &[])?;
        if len < 2 {
            return Err(Error::TooFewSamples { what: "axis".into(), needed: 2, got: len });
        }
        Ok(Self { first, step, len })
    }

    /// An axis from its coordinates, evenly spaced to within a hundredth of a cell, and whether they run downwards.
    ///
    /// `resolution` is the rounding of the coordinates themselves (zero for float64, larger for coordinates stored in
    /// fewer digits); it is allowed on top.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`], [`Error::NotFinite`], or [`Error::Invalid`] naming the first uneven node.
    pub fn from_coordinates(name: &str, coordinates: &[f64], resolution: f64) -> Result<(Self, bool)> {
        let len = coordinates.len();
        if len < 2 {
            return Err(Error::TooFewSamples { what: format!("axis {name}"), needed: 2, got: len });
        }
        crate::error::require_finite(name, coordinates)?;
        let signed = (coordinates[len - 1] - coordinates[0]) / (len - 1) as f64;
        let tolerance = signed.abs() * EVENNESS_TOLERANCE + resolution;
        for (i, &c) in coordinates.iter().enumerate() {
            let expected = coordinates[0] + signed * i as f64;
            if signed == 0.0 || (c - expected).abs() > tolerance {
                return Err(Error::invalid(
                    format!("axis {name}[{i}]"),
                    format!("evenly spaced coordinates in one direction (here {expected} for a spacing of {signed})"),
                    c,
                ));
            }
        }
        let reversed = signed < 0.0;
        let first = if reversed { coordinates[len - 1] } else { coordinates[0] };
        Ok((Self::new(first, signed.abs(), len)?, reversed))
    }

    /// Coordinate of the first node.
    pub fn first(&self) -> f64 {
        self.first
    }

    /// Coordinate of the last node.
    pub fn last(&self) -> f64 {
        self.at(self.len - 1)
    }

    /// Spacing, always positive.
    pub fn step(&self) -> f64 {
        self.step
    }

    /// Number of nodes.
    #[allow(clippy::len_without_is_empty)] // never empty by construction
    pub fn len(&self) -> usize {
        self.len
    }

    /// Coordinate of node `i`.
    pub fn at(&self, i: usize) -> f64 {
        self.first + self.step * i as f64
    }

    /// Position of a coordinate in cells from the first node.
    #[inline]
    pub fn position(&self, coordinate: f64) -> f64 {
        (coordinate - self.first) / self.step
    }

    /// The cell that holds a position in cells, and the fraction within it; positions on a node give fraction 0 or 1.
    #[inline(always)]
    pub(crate) fn cell(&self, position: f64) -> Option<(usize, f64)> {
        let (cell, fraction, inside) = self.cell_or_first(position);
        inside.then_some((cell as usize, fraction))
    }

    /// As [`Axis::cell`], the first cell where the position is beyond the axis, and whether it is not; without a branch.
    #[inline(always)]
    pub(super) fn cell_or_first(&self, position: f64) -> (u32, f64, bool) {
        let last_cell = (self.len - 2) as f64;
        let inside = (position >= -NODE_TOLERANCE) & (position <= last_cell + 1.0 + NODE_TOLERANCE);
        let (cell, fraction) = split(if inside { position } else { 0.0 });
        let fraction = if cell > last_cell { 1.0 } else { fraction };
        (cell.clamp(0.0, last_cell) as u32, fraction, inside)
    }
}

/// Whole cells and fraction in [0, 1) of a position, with positions next to a node taken to be on it.
pub(crate) fn split_position(position: f64) -> (i64, f64) {
    let (cell, fraction) = split(position);
    (cell as i64, fraction)
}

#[inline(always)]
fn split(position: f64) -> (f64, f64) {
    let floor = position.floor();
    let fraction = position - floor;
    let (at, below) = (fraction <= NODE_TOLERANCE, (position - (floor + 1.0)).abs() <= NODE_TOLERANCE);
    (if below & !at { floor + 1.0 } else { floor }, if at | below { 0.0 } else { fraction })
}

/// Takes out jumps of a whole turn between neighbours.
pub(super) fn unwrap_longitudes(longitudes: &[f64]) -> Vec<f64> {
    let mut out = Vec::with_capacity(longitudes.len());
    for &longitude in longitudes {
        out.push(out.last().map_or(longitude, |&previous| wrap_longitude(longitude, previous)));
    }
    out
}
