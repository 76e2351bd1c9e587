//! The filter behind the navigator: its state vector, motion, measurement and noise.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use super::{FieldNavigator, FieldNavigatorMethod, FieldNavigatorOptions, FieldNavigatorOutcome};
use crate::error::{Error, Result};
use crate::kalman::{Estimate, ExtendedKalmanFilter, Innovation, UnscentedKalmanFilter};
use crate::state::Saved;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum FieldFilter {
    Unscented(UnscentedKalmanFilter),
    Extended(ExtendedKalmanFilter),
}

impl FieldFilter {
    pub fn check(&self) -> Result<()> {
        match self {
            Self::Unscented(f) => f.check(),
            Self::Extended(f) => f.check(),
        }
    }

    pub fn estimate(&self) -> &Estimate {
        match self {
            Self::Unscented(f) => f.estimate(),
            Self::Extended(f) => f.estimate(),
        }
    }

    pub fn estimate_mut(&mut self) -> &mut Estimate {
        match self {
            Self::Unscented(f) => f.estimate_mut(),
            Self::Extended(f) => f.estimate_mut(),
        }
    }

    pub fn innovation(&self) -> Option<&Innovation> {
        match self {
            Self::Unscented(f) => f.innovation(),
            Self::Extended(f) => f.innovation(),
        }
    }
}

/// Where each state is in the vector; east and north are the first two.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Layout {
    pub speed: Option<usize>,
    pub heading: Option<usize>,
    pub bias: Option<usize>,
    pub len: usize,
}

impl Layout {
    pub fn new(options: &FieldNavigatorOptions, numbers: usize) -> Self {
        let mut len = 2;
        let mut place = |wanted: bool, count: usize| {
            wanted.then(|| {
                len += count;
                len - count
            })
        };
        let speed = place(options.speed_sigma_m_s > 0.0, 1);
        let heading = place(options.heading_sigma_deg > 0.0, 1);
        let bias = place(options.bias_sigma > 0.0, numbers);
        Self { speed, heading, bias, len }
    }
}

impl FieldNavigator {
    pub(super) fn predict(&mut self, dt_s: f64, speed_m_s: f64, course_deg: f64) -> Result<()> {
        let noise = self.process_noise(dt_s);
        let layout = self.state.layout;
        let course = course_deg.to_radians();
        if layout.speed.is_none() && layout.heading.is_none() {
            let (sin, cos) = course.sin_cos();
            let away = [dt_s * speed_m_s * sin, dt_s * speed_m_s * cos];
            return self.state.filter.estimate_mut().drift(&away, &noise);
        }
        let motion = move |x: &[f64], out: &mut [f64]| {
            let speed = speed_m_s + layout.speed.map_or(0.0, |i| x[i]);
            let (sin, cos) = (course + layout.heading.map_or(0.0, |i| x[i])).sin_cos();
            out.copy_from_slice(x);
            out[0] += dt_s * speed * sin;
            out[1] += dt_s * speed * cos;
        };
        let jacobian = match self.state.options.method {
            FieldNavigatorMethod::Unscented => Vec::new(),
            FieldNavigatorMethod::Extended => {
                self.motion_jacobian(self.state.filter.estimate().mean(), dt_s, speed_m_s, course_deg)
            }
        };
        match &mut self.state.filter {
            FieldFilter::Unscented(filter) => filter.predict_with(
                |points, out| {
                    let n = layout.len;
                    for (point, out) in points.as_slice().chunks_exact(n).zip(out.as_mut_slice().chunks_exact_mut(n)) {
                        motion(point, out);
                    }
                    Ok(())
                },
                &noise,
            ),
            FieldFilter::Extended(filter) => {
                let mut moved = vec![0.0; layout.len];
                motion(filter.estimate().mean(), &mut moved);
                filter.predict(&moved, &jacobian, (&noise * noise.transpose()).as_slice())
            }
        }
    }

    pub(super) fn update(&mut self, reading: &[f64], kept: &[usize]) -> Result<(FieldNavigatorOutcome, Option<f64>)> {
        let here = self.position();
        if !self.sensing.covers(here[0], here[1]) {
            return Ok((FieldNavigatorOutcome::OffField, None));
        }
        let Some(noise) = self.reading_noise(here, kept) else { return Ok((FieldNavigatorOutcome::OffField, None)) };
        let gate = self.gates.get(kept.len() - 1).copied();
        let z: Vec<f64> = kept.iter().map(|&k| reading[k]).collect();
        let (sensing, layout, anchor) = (&self.sensing, self.state.layout, self.state.anchor);
        let scale = sensing.metres_per_unit(anchor[1]);
        let numbers = sensing.len();
        let found = match &mut self.state.filter {
            FieldFilter::Unscented(filter) => filter.update_with(
                &z,
                |points, out| {
                    let places: Vec<[f64; 2]> = points
                        .column_iter()
                        .map(|p| [sensing.wrap_x(anchor[0] + p[0] / scale[0]), anchor[1] + p[1] / scale[1]])
                        .collect();
                    let mut values = vec![0.0; numbers * places.len()];
                    sensing.read(&places, &mut values);
                    if values.iter().any(|v| v.is_nan()) {
                        return Err(OffField::Off);
                    }
                    for (i, (point, mut out)) in points.column_iter().zip(out.column_iter_mut()).enumerate() {
                        for (o, &k) in out.iter_mut().zip(kept) {
                            *o = values[i * numbers + k] + layout.bias.map_or(0.0, |first| point[first + k]);
                        }
                    }
                    Ok(())
                },
                &noise,
                gate,
            ),
            FieldFilter::Extended(filter) => {
                let expected = sensing.read_with_gradient(here[0], here[1]);
                if expected.iter().any(|e| e.0.is_nan() || e.1.iter().any(|g| g.is_nan())) {
                    return Ok((FieldNavigatorOutcome::OffField, None));
                }
                let mean = filter.estimate().mean();
                let values: Vec<f64> =
                    kept.iter().map(|&k| expected[k].0 + layout.bias.map_or(0.0, |first| mean[first + k])).collect();
                let h = jacobian_of_readings(layout, &expected, kept);
                filter.update(&z, &values, &h, (&noise * noise.transpose()).as_slice(), gate).map_err(OffField::from)
            }
        };
        match found {
            Ok(innovation) => {
                let outcome =
                    if innovation.accepted { FieldNavigatorOutcome::Updated } else { FieldNavigatorOutcome::Rejected };
                Ok((outcome, Some(innovation.nis)))
            }
            Err(OffField::Off) => Ok((FieldNavigatorOutcome::OffField, None)),
            Err(OffField::Failed(error)) => Err(error),
        }
    }

    /// Factor of the process noise over a step.
    pub(super) fn process_noise(&self, dt_s: f64) -> DMatrix<f64> {
        let o = &self.state.options;
        let root = dt_s.sqrt();
        let layout = self.state.layout;
        let mut noise = DMatrix::zeros(layout.len, layout.len);
        for i in 0..2 {
            noise[(i, i)] = (o.position_noise_m2_s * dt_s).sqrt();
        }
        if let Some(i) = layout.speed {
            noise[(i, i)] = o.speed_walk_m_s_sqrt_s * root;
        }
        if let Some(i) = layout.heading {
            noise[(i, i)] = o.heading_walk_deg_sqrt_s.to_radians() * root;
        }
        if let Some(first) = layout.bias {
            for i in first..layout.len {
                noise[(i, i)] = o.bias_walk_sqrt_s * root;
            }
        }
        noise
    }

    /// Factor of the noise of the numbers that are kept: the sensor's and the field's own; `None` where the latter is not
    /// known.
    pub(super) fn reading_noise(&self, place: [f64; 2], kept: &[usize]) -> Option<DMatrix<f64>> {
        let o = &self.state.options;
        let sigma = |k: usize| {
            let sensor = if o.reading_sigma.len() == 1 { o.reading_sigma[0] } else { o.reading_sigma[k] };
            let field = if o.field_sigma { self.sensing.sigma(place[0], place[1], k)? } else { 0.0 };
            Some(sensor.hypot(field))
        };
        let sigmas = kept.iter().map(|&k| sigma(k)).collect::<Option<Vec<f64>>>()?;
        Some(DMatrix::from_diagonal(&DVector::from_vec(sigmas)))
    }

    /// Row-major Jacobian of the motion.
    pub(super) fn motion_jacobian(&self, mean: &[f64], dt_s: f64, speed_m_s: f64, course_deg: f64) -> Vec<f64> {
        let layout = self.state.layout;
        let n = layout.len;
        let mut f = vec![0.0; n * n];
        for i in 0..n {
            f[i * n + i] = 1.0;
        }
        let speed = speed_m_s + layout.speed.map_or(0.0, |i| mean[i]);
        let (sin, cos) = (course_deg.to_radians() + layout.heading.map_or(0.0, |i| mean[i])).sin_cos();
        if let Some(i) = layout.speed {
            f[i] = dt_s * sin;
            f[n + i] = dt_s * cos;
        }
        if let Some(i) = layout.heading {
            f[i] = dt_s * speed * cos;
            f[n + i] = -dt_s * speed * sin;
        }
        f
    }

    pub(super) fn measurement_jacobian(&self, expected: &[(f64, [f64; 2])], kept: &[usize]) -> Vec<f64> {
        jacobian_of_readings(self.state.layout, expected, kept)
    }
}

/// Row-major Jacobian of the numbers that are kept.
fn jacobian_of_readings(layout: Layout, expected: &[(f64, [f64; 2])], kept: &[usize]) -> Vec<f64> {
    let n = layout.len;
    let mut h = vec![0.0; kept.len() * n];
    for (row, &k) in kept.iter().enumerate() {
        h[row * n..row * n + 2].copy_from_slice(&expected[k].1);
        if let Some(first) = layout.bias {
            h[row * n + first + k] = 1.0;
        }
    }
    h
}

/// Why a reading was not compared.
enum OffField {
    /// A sigma point lies where the field is not known.
    Off,
    Failed(Error),
}

impl From<Error> for OffField {
    fn from(error: Error) -> Self {
        Self::Failed(error)
    }
}
