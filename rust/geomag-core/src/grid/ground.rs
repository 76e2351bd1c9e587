//! The scale of a projection: metres on the ground per map unit.

use super::Axis;
use crate::error::{Error, Result};

/// Least scale of a projection, and one over the greatest: millimetres are not beyond it, nor kilometres.
const LEAST: f64 = 1e-6;

/// Metres on the ground per map unit, `[east, north]`, for every row of a projected map.
///
/// On a Mercator map a metre on paper is less than one on the ground, and how much depends on the latitude alone: at 60 degrees
/// a half. What a projection does along x within one map is left out.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GroundScale(Vec<[f64; 2]>);

impl GroundScale {
    /// One pair for each of `rows` rows, y ascending.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::Invalid`] for what is no scale of a map.
    pub(super) fn new(scale: Vec<[f64; 2]>, rows: usize) -> Result<Self> {
        if scale.len() != rows {
            return Err(Error::shape(
                "map ground_scale",
                format!("{rows} rows as the map"),
                format!("{} rows", scale.len()),
            ));
        }
        for (row, pair) in scale.iter().enumerate() {
            for value in pair {
                if !(LEAST..=1.0 / LEAST).contains(value) {
                    let needed = format!("metres a map unit, from {LEAST} to {}", 1.0 / LEAST);
                    return Err(Error::invalid(format!("map ground_scale, row {row}"), needed, value));
                }
            }
        }
        Ok(Self(scale))
    }

    pub(super) fn rows(&self) -> &[[f64; 2]] {
        &self.0
    }

    /// Between rows it is linear, beyond the map that of its edge.
    pub(super) fn at(&self, axis: &Axis, y: f64) -> [f64; 2] {
        let last = self.0.len() - 1;
        // A y that is no number has the scale of the first row: what is asked for there is no number anyway.
        let position = axis.position(y).clamp(0.0, last as f64);
        let row = (position as usize).min(last - 1);
        let share = position - row as f64;
        let [a, b] = [self.0[row], self.0[row + 1]];
        std::array::from_fn(|i| a[i] + share * (b[i] - a[i]))
    }
}

#[cfg(test)]
mod tests {
    use crate::field::Field;
    use crate::grid::{GridMap, GridValues};

    fn map() -> GridMap {
        let axis: Vec<f64> = (0..4).map(|k| f64::from(k) * 100.0).collect();
        GridMap::new(GridValues::F64((0..16).map(f64::from).collect()), &axis, &axis, false).unwrap()
    }

    #[test]
    fn metres_are_on_the_ground() {
        let scaled = map().with_ground_scale(Some(vec![[0.5, 0.5], [0.4, 0.4], [0.3, 0.3], [0.2, 0.2]])).unwrap();
        let close = |a: [f64; 2], b: [f64; 2]| assert!((a[0] - b[0]).abs() < 1e-12 && (a[1] - b[1]).abs() < 1e-12);
        close(scaled.metres_per_unit(150.0), [0.35, 0.35]);
        close(scaled.metres_per_unit(-50.0), [0.5, 0.5]);
        close(scaled.metres_per_unit(900.0), [0.2, 0.2]);
        close(scaled.displacement_m([0.0, 100.0], [100.0, 200.0]), [35.0, 35.0]);
        // The slope a metre is steeper where metres are fewer.
        let [east, _] = scaled.value_and_gradient(150.0, 150.0).1;
        assert!((east - 0.01 / 0.35).abs() < 1e-12);
        let part = scaled.window(1..4, 0..3).unwrap();
        close(part.metres_per_unit(100.0), [0.4, 0.4]);
        close(map().displacement_m([0.0, 0.0], [30.0, 40.0]), [30.0, 40.0]);
    }

    #[test]
    fn bad_scales_are_refused() {
        assert!(map().with_ground_scale(Some(vec![[1.0, 1.0]; 3])).is_err());
        assert!(map().with_ground_scale(Some(vec![[1.0, 0.0]; 4])).is_err());
        assert!(map().with_ground_scale(Some(vec![[1.0, f64::NAN]; 4])).is_err());
        let axis = [0.0, 1.0];
        let geographic = GridMap::new(GridValues::F64(vec![0.0; 4]), &axis, &axis, true).unwrap();
        assert!(geographic.with_ground_scale(Some(vec![[1.0, 1.0]; 2])).is_err());
    }
}
