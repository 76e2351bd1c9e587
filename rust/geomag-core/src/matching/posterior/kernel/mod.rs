//! The likelihood of candidates: Student-t, bias and nuisance parameters integrated out, for several error levels at once.
//!
//! For a candidate offset with residuals e_k = measured - map and variances s_k^2, the bias b that maximises
//! prod t(e_k - b) is found by reweighting (weights (nu + 1) / (nu s^2 + e^2), started wide so that an outlier cannot
//! capture it) and integrated out by Laplace's method with the expected information (nu + 1) / ((nu + 3) s^2).
//!
//! Beside the density at the candidate itself there is its bound over the candidate's cell: every residual may be
//! smaller by as much as the map changes within the cell, |dm/dx| h_x + |dm/dy| h_y and the bend of the map over it, and its
//! variance as small as anywhere in the cell. What the bound rules out holds no place that the density would have found.
//!
//! Between the nodes the map is a bilinear surface plus what the bicubic one (Keys, IEEE Trans. Acoust. Speech
//! Signal Process. 29 (1981) 1153) differs by: with second differences D at the nodes and q(t) = t (1 - t) / 2, that is
//! -q(u) Dx - q(v) Dy + q(u) q(v) Dxy, each interpolated; the cubic spline through the nodes is the same of its own second
//! derivatives, interpolated at (1 + t) / 3. A standard deviation of the same size is what the map cannot say.
//!
//! Values are in units of the sensor's standard deviation, so that single precision suffices for the samples; sums over
//! samples are in double precision.
mod block;
mod closely;
mod fill;
mod integral;
mod screen;
mod setup;

pub(super) use block::score;
pub(super) use closely::{Detail, detail};
pub(super) use screen::{Screened, screen};
pub(super) use setup::{KernelScratch, LANES, Scores, Setup, Wide};
