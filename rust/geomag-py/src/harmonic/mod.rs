//! `RectangularHarmonicModel`, `FieldObservations` and `HarmonicMap`.

mod points;
mod quantity;
mod request;

mod fitting;
mod map;
mod observations;

mod model;

pub use self::map::PyHarmonicMap;
pub use self::model::PyHarmonicModel;
pub use self::observations::PyFieldObservations;
pub use self::quantity::{main_vector, quantity, quantity_name};
