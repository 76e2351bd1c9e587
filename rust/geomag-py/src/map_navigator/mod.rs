//! `InsModel`, `Navigator` and whole flights.

mod flight;
mod keywords;
mod log;
mod measures;
mod models;
mod navigator;
mod step;

pub use flight::py_navigate;
pub use measures::{py_displacements_m, py_radii_m};
pub use models::{PyInsModel, PyMatcherPlan};
pub use navigator::PyNavigator;
pub use step::PyNavigatorStep;
