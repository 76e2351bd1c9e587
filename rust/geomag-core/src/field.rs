//! The one small trait through which matchers and filters see a scalar field.

use crate::error::Result;
use crate::grid::GridMap;
use crate::stack::MapStack;

/// A scalar field over the horizontal plane that a matcher can be given as its map.
///
/// Coordinates are x to the east and y to the north, in metres or (geographic) in degrees of longitude and latitude.
/// Heights are metres above the height datum of the map, positive up: a field that is known at several of them gives them by
/// [`Field::heights`] and answers by [`Field::value_at`]; one that is known on a single surface, or says nothing of heights,
/// answers for that surface whatever the height.
/// [`GridMap`] is the fast path, reached through [`Field::as_grid`]; anything else is sampled point by point.
pub trait Field: Send + Sync + std::fmt::Debug {
    /// Field value at a point; NaN where it is unknown (off the map, on a hole).
    fn value(&self, x: f64, y: f64) -> f64;

    /// Value and gradient per metre `[east, north]`; NaN where unknown.
    fn value_and_gradient(&self, x: f64, y: f64) -> (f64, [f64; 2]);

    /// [`Field::value`] at a height; that of the field's own surface where it has one only.
    fn value_at(&self, x: f64, y: f64, _height_m: f64) -> f64 {
        self.value(x, y)
    }

    /// [`Field::value_and_gradient`] at a height; that of the field's own surface where it has one only.
    fn value_and_gradient_at(&self, x: f64, y: f64, _height_m: f64) -> (f64, [f64; 2]) {
        self.value_and_gradient(x, y)
    }

    /// [`Field::sigma`] at a height; that of the field's own surface where it has one only.
    fn sigma_at(&self, x: f64, y: f64, _height_m: f64) -> f64 {
        self.sigma(x, y)
    }

    /// Lowest and greatest height at which the field is known, metres; `None` for a field of one surface.
    fn heights(&self) -> Option<[f64; 2]> {
        None
    }

    /// Standard deviation of the stored value against the true field at a point: zero for a field that says nothing of its
    /// errors, NaN where one that does says nothing here (a NaN in its layer, or off it).
    fn sigma(&self, _x: f64, _y: f64) -> f64 {
        0.0
    }

    /// [`Field::sigma`] for whoever weighs a sample by it; `None` where it is NaN.
    ///
    /// A value of unknown error cannot be weighed, so the place is as a hole: to take the error for zero would make the
    /// least known part of a map the one that is believed most.
    fn known_sigma(&self, x: f64, y: f64) -> Option<f64> {
        Some(self.sigma(x, y)).filter(|s| !s.is_nan())
    }

    /// Whether coordinates are degrees of longitude and latitude.
    fn geographic(&self) -> bool;

    /// Metres per map unit at a latitude (or any y of a projected map), `[east, north]`.
    fn metres_per_unit(&self, y: f64) -> [f64; 2] {
        if self.geographic() { crate::frame::metres_per_degree(y) } else { [1.0, 1.0] }
    }

    /// Displacement from one point to another on the ground, metres `[east, north]`.
    fn displacement_m(&self, from: [f64; 2], to: [f64; 2]) -> [f64; 2] {
        if self.geographic() {
            return crate::frame::displacement_m(true, from, to);
        }
        let [east, north] = self.metres_per_unit(0.5 * (from[1] + to[1]));
        [(to[0] - from[0]) * east, (to[1] - from[1]) * north]
    }

    /// Brings a longitude to the turn that the map is on; projected x is returned as it is.
    fn wrap_x(&self, x: f64) -> f64;

    /// The spacing `[x, y]` at which this field is known, map units: one cell of a grid.
    fn spacing(&self) -> [f64; 2];

    /// Mean level of the field, used to keep correlation measures about zero.
    fn mean(&self) -> f64;

    /// The regular grid behind this field, where there is one.
    fn as_grid(&self) -> Option<&GridMap> {
        None
    }

    /// The levels behind this field, where it has some.
    fn as_stack(&self) -> Option<&MapStack> {
        None
    }

    /// The field for readings between two heights, of a field that can be evaluated anywhere: itself at that height, or levels of
    /// itself. `None` for one of given surfaces.
    ///
    /// # Errors
    /// [`Error::Invalid`](crate::error::Error::Invalid) for heights at which the field is unknown.
    fn between(&self, _low_m: f64, _high_m: f64) -> Result<Option<Box<dyn Field>>> {
        Ok(None)
    }

    /// The grid whose nodes and error model are those of the field: itself, or the lowest of its levels.
    fn layout(&self) -> Option<&GridMap> {
        self.as_grid()
    }
}
