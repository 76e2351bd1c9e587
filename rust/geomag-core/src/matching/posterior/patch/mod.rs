//! The part of a map that a search can touch, laid out for the kernel: value, error variance and distance to data.
//!
//! From the bottom: places in cells, curved surfaces through the nodes, the window itself, and how blocks of places are read from it.

mod bends;
mod place;
mod read;
#[cfg(test)]
mod tests;
mod window;

pub(super) use place::{Cells, LANES, PatchPlace, Spots};
pub(super) use window::{
    ACROSS, BEND, DEFAULT_DISTANCE_CELLS, DISTANCE, LIFT, Patch, SPLINE_ACROSS, SPLINE_TWIST, SPLINE_UP, TWIST, UP,
    VALUE, VARIANCE,
};
