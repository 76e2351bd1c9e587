//! What a model is fitted to: components, projections and intensities, mixed, each with its own weight.

use super::Positions;
use crate::bounds::{FARTHEST_M, MOST_VALUE, require_values};
use crate::error::{Error, Result};

/// What one number was measured of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Sensed {
    /// The field along a unit vector: a component, or the total-field anomaly as the projection on the main field.
    Along([f64; 3]),
    /// The intensity of the main field (here) and the modelled field together.
    Intensity([f64; 3]),
}

/// One number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ObservationRow {
    pub(crate) point: u32,
    pub(crate) sensed: Sensed,
    pub(crate) value: f64,
    /// One over the standard deviation.
    pub(crate) weight: f64,
}

/// A collection of observations for [`fit`](super::fit); calls add to it, so that any mixture can be built.
///
/// Positions are in the frame of the model (north, east, down, metres). `sigma` is the standard deviation: empty for
/// one everywhere, one number for all, or one a point.
///
/// ```
/// use geomag_core::harmonic::{Observations, Positions};
/// let (north, east, down) = ([0.0, 1e3], [0.0, 5e2], [-80.0, -80.0]);
/// let positions = Positions::new(&north, &east, &down)?;
/// let mut observations = Observations::new();
/// observations.vector(&positions, &[[10.0, f64::NAN, -5.0], [8.0, 1.0, -4.0]], &[2.0])?;
/// observations.anomaly(&positions, &[4.0, 3.5], &[[31e3, 0.0, 38e3]], &[])?;
/// assert_eq!(observations.len(), 7);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observations {
    pub(crate) points: Vec<[f64; 3]>,
    pub(crate) rows: Vec<ObservationRow>,
    pub(crate) anomalies: bool,
}

impl Observations {
    /// No observation yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Number of numbers (a full vector counts three).
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Number of points.
    pub fn point_count(&self) -> usize {
        self.points.len()
    }

    /// The point that each number belongs to.
    pub fn point_of_rows(&self) -> impl Iterator<Item = usize> + '_ {
        self.rows.iter().map(|r| r.point as usize)
    }

    /// Adds vectors (north, east, down in the axes of the model's frame); a NaN component is left out.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`] (positions, infinite components), [`Error::Invalid`] (sigma not positive).
    pub fn vector(&mut self, positions: &Positions<'_>, field: &[[f64; 3]], sigma: &[f64]) -> Result<()> {
        const AXES: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let n = positions.len();
        if field.len() != n {
            return Err(Error::shape("field", format!("({n}, 3)"), format!("({}, 3)", field.len())));
        }
        let components = field.as_flattened();
        if let Some(k) = components.iter().position(|c| c.abs() > MOST_VALUE) {
            require_values(&format!("field[{}, {}]", k / 3, k % 3), &components[k..=k])?;
        }
        let weights = weights(n, sigma)?;
        let first = self.add_points(positions)?;
        for (i, f) in field.iter().enumerate() {
            for (axis, &value) in AXES.iter().zip(f) {
                if !value.is_nan() {
                    let sensed = Sensed::Along(*axis);
                    self.rows.push(ObservationRow { point: first + i as u32, sensed, value, weight: weights(i) });
                }
            }
        }
        Ok(())
    }

    /// Adds scalar total-field anomalies: the projection of the field on the direction of the main field.
    ///
    /// `main_field` (north, east, down in the axes of the model's frame; one for all or one a point) gives the direction
    /// and need not be of unit length.
    ///
    /// # Errors
    /// As [`Observations::vector`]; [`Error::Invalid`] for a main field of length zero.
    pub fn anomaly(
        &mut self,
        positions: &Positions<'_>,
        values: &[f64],
        main_field: &[[f64; 3]],
        sigma: &[f64],
    ) -> Result<()> {
        self.scalar(positions, values, main_field, sigma, |main| {
            let length = super::evaluate::norm(main);
            Sensed::Along(main.map(|c| c / length))
        })?;
        self.anomalies |= !values.is_empty();
        Ok(())
    }

    /// Whether any of them are total-field anomalies.
    pub(crate) fn has_anomalies(&self) -> bool {
        self.anomalies
    }

    /// Adds total intensities: the length of `main_field` plus the field. Fitted by Gauss-Newton steps.
    ///
    /// # Errors
    /// As [`Observations::anomaly`].
    pub fn intensity(
        &mut self,
        positions: &Positions<'_>,
        values: &[f64],
        main_field: &[[f64; 3]],
        sigma: &[f64],
    ) -> Result<()> {
        self.scalar(positions, values, main_field, sigma, Sensed::Intensity)
    }

    fn scalar(
        &mut self,
        positions: &Positions<'_>,
        values: &[f64],
        main_field: &[[f64; 3]],
        sigma: &[f64],
        sensed: impl Fn([f64; 3]) -> Sensed,
    ) -> Result<()> {
        let n = positions.len();
        if values.len() != n {
            return Err(Error::shape("values", format!("({n},)"), format!("({},)", values.len())));
        }
        require_values("values", values)?;
        if main_field.len() != 1 && main_field.len() != n {
            return Err(Error::shape("main_field", format!("(3,) or ({n}, 3)"), format!("({}, 3)", main_field.len())));
        }
        for (i, main) in main_field.iter().enumerate() {
            require_values(&format!("main_field[{i}]"), main)?;
            if super::evaluate::norm(*main) == 0.0 {
                return Err(Error::invalid(format!("main_field[{i}]"), "a vector of length > 0", "a zero vector"));
            }
        }
        let weights = weights(n, sigma)?;
        let first = self.add_points(positions)?;
        for (i, &value) in values.iter().enumerate() {
            let main = if main_field.len() == 1 { main_field[0] } else { main_field[i] };
            self.rows.push(ObservationRow { point: first + i as u32, sensed: sensed(main), value, weight: weights(i) });
        }
        Ok(())
    }

    fn add_points(&mut self, positions: &Positions<'_>) -> Result<u32> {
        for i in 0..positions.len() {
            let point = positions.at(i);
            if let Some(bad) = point.iter().find(|c| !(c.abs() <= FARTHEST_M)) {
                if !bad.is_finite() {
                    return Err(Error::NotFinite { what: "position".into(), index: i, got: *bad });
                }
                let needed = format!("north, east and down within +-{FARTHEST_M} m");
                return Err(Error::invalid(format!("position[{i}]"), needed, bad));
            }
        }
        let first = self.points.len();
        if u32::try_from(first + positions.len()).is_err() {
            return Err(Error::invalid("observations", "fewer than 2^32 points", first + positions.len()));
        }
        self.points.extend((0..positions.len()).map(|i| positions.at(i)));
        Ok(first as u32)
    }

    /// Least and greatest of each coordinate over the points that were observed.
    pub(crate) fn extent(&self) -> [[f64; 2]; 3] {
        let mut out = [[f64::INFINITY, f64::NEG_INFINITY]; 3];
        for p in &self.points {
            for (range, &c) in out.iter_mut().zip(p) {
                *range = [range[0].min(c), range[1].max(c)];
            }
        }
        out
    }
}

/// One over the standard deviations, as a function of the point.
fn weights(n: usize, sigma: &[f64]) -> Result<impl Fn(usize) -> f64 + use<'_>> {
    if sigma.len() > 1 && sigma.len() != n {
        return Err(Error::shape("sigma", format!("a number or ({n},)"), format!("({},)", sigma.len())));
    }
    if let Some(i) = sigma.iter().position(|s| !(s.is_finite() && *s > 0.0)) {
        return Err(Error::invalid(format!("sigma[{i}]"), "a finite number > 0", sigma[i]));
    }
    Ok(move |i: usize| match sigma {
        [] => 1.0,
        [one] => 1.0 / one,
        many => 1.0 / many[i],
    })
}
