//! `Fix`.

use geomag_core::fix::Fix;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{points, shaped};
use crate::class::{Reduced, properties, reduced_to_bytes};
use crate::error::PyRes;
use crate::state;

/// A position answer with its quality; every matcher returns one.
///
/// Use it only where `ok` is true; otherwise `status` says why not: searching, ambiguous, at_edge, lost, uninformative,
/// not_converged, rejected. An offset is true minus indicated position: what the fix adds to the INS.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> x = np.arange(0.0, 6000.0, 50.0)
/// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x)
/// >>> k = np.arange(30.0)
/// >>> track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, grid.sample(1210 + 90 * k, 1875 + 40 * k))
/// >>> fix = geomag.match_grid(grid, track, half_width=500)
/// >>> if fix.ok:
/// ...     print([round(v) for v in fix.offset_m], round(fix.x - track.x[-1]), fix.risk)
/// [210, -125] 210 None
#[pyclass(frozen, name = "Fix", module = "geomag")]
pub struct PyFix {
    /// The answer.
    pub inner: Fix,
}

impl From<Fix> for PyFix {
    fn from(inner: Fix) -> Self {
        Self { inner }
    }
}

properties! {
    PyFix: fix {
        /// Corrected newest position, map units (longitudes on the map's own turn).
        x: f64 = fix.x;

        /// Corrected newest position, map units.
        y: f64 = fix.y;

        /// Offset (x, y) at the newest point, map units.
        offset: (f64, f64) = fix.offset.into();

        /// Offset (east, north) at the newest point, metres.
        offset_m: (f64, f64) = fix.offset_m.into();

        /// Heading correction, degrees, clockwise.
        heading_deg: f64 = fix.heading_deg;

        /// Scale correction: true over indicated distance.
        scale: f64 = fix.scale;

        /// Estimated constant of the measurement, measured minus map; None where the method estimates none.
        bias: Option<f64> = fix.bias;

        /// Covariance (2, 2) of the position, square metres, east-north; None where the method has none.
        covariance_m2(py): PyRes<Option<Bound<'py, PyAny>>> =
            fix.covariance_m2.map(|c| shaped(py, c.concat(), &[2, 2])).transpose();

        /// Declared probability that the error is beyond the tolerance; None where the method has none.
        risk: Option<f64> = fix.risk;

        /// p-value of the residuals under the model; None where the method has no such test.
        goodness: Option<f64> = fix.goodness;

        /// What the readings ask for that was not told, where the answer is rejected for it: (effect, estimate, log evidence gained);
        /// else None.
        ///
        /// `height` (metres above the map), `legs` and `bias_drift` (value units), `reading_scale` (factor), `heading` (degrees), `drift`
        /// (metres from the first sample to the newest): tell it the next time, or find out where it comes from.
        misfit: Option<(String, f64, f64)> =
            fix.misfit.as_ref().map(|m| (m.effect.clone(), m.estimate, m.log_evidence));

        /// One of fixed, searching, ambiguous, at_edge, lost, uninformative, not_converged, rejected.
        status: &'static str = fix.status.as_str();

        /// True only where the fix may be used.
        ok: bool = fix.ok();

        /// Score of the answer in the measure's own sense.
        score: f64 = fix.score;

        /// Best score away from the answer; NaN where there is none.
        runner_up: f64 = fix.runner_up;

        /// Samples that the answer rests on.
        n_samples: usize = fix.n_samples;

        /// Iterations taken; 1 for direct methods.
        iterations: usize = fix.iterations;

        /// Corrected points (n, 2), oldest first, map units.
        track(py): PyRes<Bound<'py, PyAny>> = points(py, &fix.track);

        /// Lowest and greatest height (metres above the height datum) at which the map was read, where it is a stack of levels or was
        /// continued to the track's heights; None where it was taken as it is.
        heights_m: Option<(f64, f64)> = fix.heights_m.map(Into::into);

        /// Scores (rows = y offset ascending, columns = x offset ascending), NaN where there is none; None if not asked for.
        surface(py): PyRes<Option<Bound<'py, PyAny>>> =
            fix.surface.as_ref().map(|s| shaped(py, s.values.clone(), &[s.rows, s.columns])).transpose();

        /// x offsets of the surface's columns and y offsets of its rows, map units.
        surface_axes(py): PyRes<Option<(Bound<'py, PyAny>, Bound<'py, PyAny>)>> = {
            let Some(s) = &fix.surface else { return Ok(None) };
            let axis = |n: usize, d: usize| (0..n).map(|i| s.first[d] + s.step[d] * i as f64).collect::<Vec<_>>();
            Ok(Some((shaped(py, axis(s.columns, 0), &[s.columns])?, shaped(py, axis(s.rows, 1), &[s.rows])?)))
        };
    }

    /// Everything but `track` and `surface`, which may be large, as plain Python values; `geomag match --json` adds them.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyDict>> {
        let d = PyDict::new(py);
        let f = &self.inner;
        d.set_item("status", f.status.as_str())?;
        d.set_item("ok", f.ok())?;
        d.set_item("x", f.x)?;
        d.set_item("y", f.y)?;
        d.set_item("offset", self.offset())?;
        d.set_item("offset_m", self.offset_m())?;
        d.set_item("heading_deg", f.heading_deg)?;
        d.set_item("scale", f.scale)?;
        d.set_item("bias", f.bias)?;
        d.set_item("covariance_m2", f.covariance_m2.map(|c| c.map(|r| r.to_vec()).to_vec()))?;
        d.set_item("risk", f.risk)?;
        d.set_item("goodness", f.goodness)?;
        d.set_item("misfit", self.misfit())?;
        d.set_item("score", f.score)?;
        d.set_item("runner_up", f.runner_up)?;
        d.set_item("n_samples", f.n_samples)?;
        d.set_item("iterations", f.iterations)?;
        d.set_item("heights_m", self.heights_m())?;
        Ok(d)
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
        reduced_to_bytes(slf, &state::save(&slf.get().inner)?)
    }

    #[staticmethod]
    fn _restore(bytes: &[u8]) -> PyRes<Self> {
        Ok(Self { inner: state::load(bytes)? })
    }

    fn __repr__(&self) -> String {
        let f = &self.inner;
        let quality = match (f.risk, f.covariance_m2) {
            (risk, Some(c)) => {
                let sigma = format!(", sigma {:.1} x {:.1} m", c[0][0].max(0.0).sqrt(), c[1][1].max(0.0).sqrt());
                risk.map_or(sigma.clone(), |r| format!(", risk {r:.2e}{sigma}"))
            }
            (Some(risk), None) => format!(", risk {risk:.2e}"),
            (None, None) => String::new(),
        };
        let asks = |m: &geomag_core::fix::Misfit| format!(", asks for {} {:.3}", m.effect, m.estimate);
        let quality = quality + &f.misfit.as_ref().map(asks).unwrap_or_default();
        format!(
            "Fix({}, x {:.6}, y {:.6}, offset {:.1} m east {:.1} m north, score {:.4}, runner-up {:.4}, {} samples{quality})",
            f.status, f.x, f.y, f.offset_m[0], f.offset_m[1], f.score, f.runner_up, f.n_samples
        )
    }
}
