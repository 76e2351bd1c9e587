//! Calibrated matching as Python calls it: signatures, docstrings and conversion, all from the core's table of options.
//!
//! The bodies are in `matching.rs` and `streaming.rs`; what stands here is what a row of the table becomes.

use geomag_core::error::Error;
use geomag_core::matching::posterior::{PosteriorMatcher, PosteriorOptions};
use geomag_core::matching::stream::{Sample, Stream, feed};
use geomag_core::{common_options, posterior_options};
use pyo3::prelude::*;

use super::matching::{self, Area, merge};
use super::prediction::PyPrediction;
use super::streaming::PyPosteriorStep;
use crate::class::{Reduced, reduced};
use crate::error::PyRes;
use crate::fix::PyFix;
use crate::grid::field;
use crate::lock::Shared;
use crate::long_call;
use crate::track::PyTrack;

/// A part of a call: its struct, with a field a row, and its class.
macro_rules! part {
    (
        $(#[$meta:meta])* $inner:ident $class:ident $called:literal
        [$($row:tt)*] [$(($name:ident: $kind:ident = $default:tt; $($_rest:tt)*))*]
    ) => {
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $inner {
            $(pub $name: core_type!($kind),)*
        }

        impl $inner {
            /// What its fields mean depends on the map: the call checks them.
            #[allow(clippy::unnecessary_wraps, clippy::unused_self)] // as the records of the core have it
            fn validate(&self) -> Result<(), Error> {
                Ok(())
            }
        }

        record_class! { { $(#[$meta])*; $class $called $inner; {} } fields [$($row)*] }
    };
}

macro_rules! core_type {
    (number) => { f64 };
    (maybe_number) => { Option<f64> };
    (maybe_pair) => { Option<[f64; 2]> };
    (count) => { u64 };
}

macro_rules! parts {
    (
        extent [$($extent:tt)*] overlap [$($overlap:tt)*] search [$($search:tt)*] accept [$($accept:tt)*] prior [$($prior:tt)*]
        reading $reading:tt
    ) => {
        part! {
            /// Where a matcher looks: how far, how fine, and how much of it at most.
            SearchBox PySearchBox "SearchBox" [$($extent)* $($search)*] [$($extent)* $($search)*]
        }
        part! {
            /// What is accepted as a fix: what counts as wrong, and how sure it must be.
            Acceptance PyAcceptance "Acceptance" [$($accept)* $($overlap)*] [$($accept)* $($overlap)*]
        }
        part! {
            /// What the INS may be wrong by beside the offset: drift, heading, scale, jitter.
            InsPrior PyInsPrior "InsPrior" [$($prior)*] [$($prior)*]
        }
    };
}

macro_rules! merging {
    (
        extent [$(($bound:ident: $($_e:tt)*))*] overlap [$(($overlap:ident: $($_o:tt)*))*] search [$(($looked:ident: $($_s:tt)*))*]
        accept [$(($accepted:ident: $($_a:tt)*))*] prior [$(($known:ident: $($_p:tt)*))*] reading $reading:tt
    ) => {
        /// Extents of a search as they are given: map units or metres.
        #[derive(Debug, Clone, Copy)]
        pub struct Extent {
            $(pub $bound: Option<[f64; 2]>,)*
        }

        /// Options and extents with those of the parts in their places.
        fn merged(
            mut options: PosteriorOptions,
            mut extent: Extent,
            search: Option<&Py<PySearchBox>>,
            prior: Option<&Py<PyInsPrior>>,
            accept: Option<&Py<PyAcceptance>>,
        ) -> PyRes<Area> {
            let defaults = PosteriorOptions::new([1.0; 2]);
            if let Some(part) = search.map(|p| p.get().inner) {
                $(extent.$bound = merge(stringify!($bound), "search", extent.$bound, part.$bound, None)?;)*
                $(options.$looked = merge(stringify!($looked), "search", options.$looked, part.$looked, defaults.$looked)?;)*
            }
            if let Some(part) = prior.map(|p| p.get().inner) {
                $(options.$known = merge(stringify!($known), "prior", options.$known, part.$known, defaults.$known)?;)*
            }
            if let Some(part) = accept.map(|p| p.get().inner) {
                $(options.$accepted =
                    merge(stringify!($accepted), "accept", options.$accepted, part.$accepted, defaults.$accepted)?;)*
                $(options.$overlap = merge(stringify!($overlap), "accept", options.$overlap, part.$overlap, defaults.$overlap)?;)*
            }
            Area::of(options, extent)
        }
    };
}

macro_rules! calls {
    (
        extent [$(($bound:ident: $bound_kind:ident = $bound_default:tt; $bound_python:literal; $($bound_line:literal)+))*]
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        /// Match a whole track and declare the risk that the answer is wrong.
        ///
        /// For fixes that somebody will act on. Where the map is flat, or the start known only to tens of kilometres, it will mostly
        /// decline.
        ///
        /// Parameters
        /// ----------
        /// grid : GridMap, MapStack or HarmonicMap
        ///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
        #[doc = shared_doc!(track)]
        $(#[doc = row_doc!($bound; $bound_python; $($bound_line)+)])*
        #[doc = shared_doc!(sigma)]
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        #[doc = shared_doc!(parts)]
        /// surface : bool
        ///     Return the posterior over the offsets as `Fix.surface`.
        #[doc = shared_doc!(channels)]
        #[doc = shared_doc!(threads)]
        /// more : sequence of (GridMap, values, sigma), optional
        ///     Old name of `channels`; it warns.
        ///
        /// Returns
        /// -------
        /// Fix
        ///     With `risk`, `covariance_m2` and `goodness`.
        ///
        /// Raises
        /// ------
        /// InvalidInputError, CandidateLimitError
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(0.0, 6000.0, 50.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
        /// >>> k = np.arange(30.0)
        /// >>> noise = np.random.default_rng(1).normal(0, 1, 30)
        /// >>> track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, grid.sample(1210 + 90 * k, 1875 + 40 * k) + noise)
        /// >>> fix = geomag.match_posterior(grid, track, half_width=500, sigma=1.0, tolerance_m=100)
        /// >>> fix.ok, fix.risk < 0.01
        /// (True, True)
        #[pyfunction]
        #[pyo3(signature = (grid, track, *, $($bound = $bound_default,)* sigma = None, $($($name = $default,)*)*
            search = None, prior = None, accept = None, surface = false, channels = None, threads = None, more = None))]
        #[allow(clippy::too_many_arguments)] // one each, keyword-only
        pub fn match_posterior(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            track: &Bound<'_, PyTrack>,
            $($bound: py_type!($bound_kind),)*
            sigma: Option<f64>,
            $($($name: py_type!($kind),)*)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            surface: bool,
            channels: Option<Vec<Bound<'_, PyAny>>>,
            threads: Option<usize>,
            more: Option<Vec<Bound<'_, PyAny>>>,
        ) -> PyRes<PyFix> {
            let given = PosteriorOptions { $($($name: py_value!(py $kind $name),)*)* ..PosteriorOptions::new([1.0; 2]) };
            let extent = Extent { $($bound: py_value!(py $bound_kind $bound),)* };
            let area = merged(given, extent, search.as_ref(), prior.as_ref(), accept.as_ref())?;
            matching::one(py, grid, track, sigma, area, surface, channels, more, threads)
        }

        /// `match_posterior` for many tracks on one map, on all cores; with `streaming=True` each is fed sample by sample to a
        /// `PosteriorMatcher` and answers at its first fix.
        ///
        /// Parameters
        /// ----------
        /// grid : GridMap, MapStack or HarmonicMap
        ///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
        /// tracks : sequence of Track
        ///     Indicated positions and measured values.
        $(#[doc = row_doc!($bound; $bound_python; $($bound_line)+)])*
        #[doc = shared_doc!(sigma)]
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        #[doc = shared_doc!(parts)]
        /// streaming : bool
        ///     Whether the tracks are fed sample by sample.
        #[doc = shared_doc!(threads)]
        #[doc = shared_doc!(progress)]
        ///
        /// Returns
        /// -------
        /// list of Fix
        ///     In the order of the tracks.
        ///
        /// Raises
        /// ------
        /// InvalidInputError, TooFewSamplesError, CandidateLimitError
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(0.0, 6000.0, 50.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
        /// >>> k, noise = np.arange(30.0), np.random.default_rng(1).normal(0, 1, 30)
        /// >>> readings = grid.sample(1210 + 90 * k, 1875 + 40 * k) + noise
        /// >>> tracks = [geomag.Track(1210 + e + 90 * k, 1875 + 40 * k, readings) for e in (-200.0, 50.0, 150.0)]
        /// >>> fixes = geomag.match_posterior_many(grid, tracks, half_width=500, sigma=1.0, tolerance_m=100)
        /// >>> [round(fix.offset_m[0], -1) for fix in fixes if fix.ok]
        /// [200.0, -50.0, -150.0]
        #[pyfunction]
        #[pyo3(signature = (grid, tracks, *, $($bound = $bound_default,)* sigma = None, $($($name = $default,)*)*
            search = None, prior = None, accept = None, streaming = false, threads = None, progress = None))]
        #[allow(clippy::too_many_arguments)] // one each, keyword-only
        pub fn match_posterior_many(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            tracks: Vec<Bound<'_, PyTrack>>,
            $($bound: py_type!($bound_kind),)*
            sigma: Option<f64>,
            $($($name: py_type!($kind),)*)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            streaming: bool,
            threads: Option<usize>,
            progress: Option<&Bound<'_, PyAny>>,
        ) -> PyRes<Vec<PyFix>> {
            let given = PosteriorOptions { $($($name: py_value!(py $kind $name),)*)* ..PosteriorOptions::new([1.0; 2]) };
            let extent = Extent { $($bound: py_value!(py $bound_kind $bound),)* };
            let area = merged(given, extent, search.as_ref(), prior.as_ref(), accept.as_ref())?;
            matching::many(py, grid, &tracks, sigma, area, streaming, threads, progress)
        }

        /// Predict, before flight, how planned tracks would be fixed: Cramer-Rao bound, expected covariance, share of simulated
        /// flights that are fixed and how soon.
        ///
        /// Parameters
        /// ----------
        /// grid : GridMap, MapStack or HarmonicMap
        ///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
        /// tracks : sequence of Track
        ///     Planned positions; the values are not used.
        $(#[doc = row_doc!($bound; $bound_python; $($bound_line)+)])*
        #[doc = shared_doc!(sigma)]
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        #[doc = shared_doc!(parts)]
        /// flights : int
        ///     Simulated flights a track, at most 1,000,000.
        /// seed : int
        ///     Of the simulated flights.
        #[doc = shared_doc!(threads)]
        #[doc = shared_doc!(progress)]
        ///
        /// Returns
        /// -------
        /// list of Prediction or None
        ///     None where the map is unknown along the track.
        ///
        /// Raises
        /// ------
        /// InvalidInputError, CandidateLimitError
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(0.0, 6000.0, 50.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
        /// >>> k = np.arange(30.0)
        /// >>> plan = geomag.Track(1210 + 90 * k, 1875 + 40 * k, 0 * k)
        /// >>> ahead, = geomag.predict_many(grid, [plan], half_width=500, sigma=1.0, tolerance_m=100, flights=10)
        /// >>> ahead.fix_probability > 0.5, bool(np.sqrt(np.trace(ahead.covariance_m2)) < 100)
        /// (True, True)
        #[pyfunction]
        #[pyo3(signature = (grid, tracks, *, $($bound = $bound_default,)* sigma = None, $($($name = $default,)*)*
            search = None, prior = None, accept = None, flights = 20, seed = 0, threads = None, progress = None))]
        #[allow(clippy::too_many_arguments)] // one each, keyword-only
        pub fn predict_many(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            tracks: Vec<Bound<'_, PyTrack>>,
            $($bound: py_type!($bound_kind),)*
            sigma: Option<f64>,
            $($($name: py_type!($kind),)*)*
            search: Option<Py<PySearchBox>>,
            prior: Option<Py<PyInsPrior>>,
            accept: Option<Py<PyAcceptance>>,
            flights: usize,
            seed: u64,
            threads: Option<usize>,
            progress: Option<&Bound<'_, PyAny>>,
        ) -> PyRes<Vec<Option<PyPrediction>>> {
            let given = PosteriorOptions { $($($name: py_value!(py $kind $name),)*)* ..PosteriorOptions::new([1.0; 2]) };
            let extent = Extent { $($bound: py_value!(py $bound_kind $bound),)* };
            let area = merged(given, extent, search.as_ref(), prior.as_ref(), accept.as_ref())?;
            matching::predicted(py, grid, &tracks, sigma, area, flights, seed, threads, progress)
        }

        /// Calibrated matching sample by sample: `match_posterior` for a stream, with a fix as soon as its risk allows.
        ///
        /// For a live track of any length; candidates that the samples exclude are dropped, and at most `max_samples` samples are
        /// kept, so that time and memory are bounded. It pickles, and goes on bit for bit. Not for a whole log: `match_posterior`.
        ///
        /// Parameters
        /// ----------
        /// grid : GridMap, MapStack or HarmonicMap
        ///     The stored map. What is known of its errors goes with it: `sigma=`, or `geomag.survey.map_from_lines`.
        $(#[doc = row_doc!($bound; $bound_python; $($bound_line)+)])*
        #[doc = shared_doc!(sigma)]
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        #[doc = shared_doc!(parts)]
        /// max_samples : int
        ///     Samples kept, at least 3; when there are more the oldest is let go.
        ///
        /// Raises
        /// ------
        /// InvalidInputError, CandidateLimitError
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(0.0, 6000.0, 50.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x, sigma=0.0)
        /// >>> k, noise = np.arange(30.0), np.random.default_rng(1).normal(0, 1, 30)
        /// >>> readings = grid.sample(1210 + 90 * k, 1875 + 40 * k) + noise
        /// >>> matcher = geomag.PosteriorMatcher(grid, half_width=500, sigma=1.0, tolerance_m=100)
        /// >>> for px, py, value in zip(1000 + 90 * k, 2000 + 40 * k, readings):
        /// ...     step = matcher.update(px, py, value)
        /// ...     if step.fix is not None and step.fix.ok:
        /// ...         break
        /// >>> step.status, step.risk <= 0.01, matcher.n_samples < 30
        /// ('fixed', True, True)
        #[pyclass(frozen, name = "PosteriorMatcher", module = "geomag")]
        pub struct PyPosteriorMatcher {
            inner: Shared<PosteriorMatcher>,
            grid: Py<PyAny>,
        }

        #[pymethods]
        impl PyPosteriorMatcher {
            #[new]
            #[pyo3(signature = (grid, *, $($bound = $bound_default,)* sigma = None, $($($name = $default,)*)*
                search = None, prior = None, accept = None, max_samples = 200))]
            #[allow(clippy::too_many_arguments)] // one each, keyword-only
            fn new(
                py: Python<'_>,
                grid: &Bound<'_, PyAny>,
                $($bound: py_type!($bound_kind),)*
                sigma: Option<f64>,
                $($($name: py_type!($kind),)*)*
                search: Option<Py<PySearchBox>>,
                prior: Option<Py<PyInsPrior>>,
                accept: Option<Py<PyAcceptance>>,
                max_samples: usize,
            ) -> PyRes<Self> {
                let given = PosteriorOptions { $($($name: py_value!(py $kind $name),)*)* ..PosteriorOptions::new([1.0; 2]) };
                let extent = Extent { $($bound: py_value!(py $bound_kind $bound),)* };
            let area = merged(given, extent, search.as_ref(), prior.as_ref(), accept.as_ref())?;
                let map = field(grid)?;
                let options = area.options(&*map, None)?;
                let inner = PosteriorMatcher::new(map, sigma, options, max_samples)?;
                Ok(Self { inner: Shared::new(inner), grid: grid.clone().unbind() })
            }

            /// Takes one sample: indicated position `x`, `y` (map units), measured `value`, and `height_m` where the map is a `MapStack`.
            /// Returns a `PosteriorStep`.
            ///
            /// Raises `NotFiniteError` for a sample that is not finite; it is not taken.
            #[pyo3(signature = (x, y, value, height_m = None))]
            fn update(&self, py: Python<'_>, x: f64, y: f64, value: f64, height_m: Option<f64>) -> PyRes<PyPosteriorStep> {
                // With heading, drift or scale a candidate is looked at many times.
                let held = |m: &mut PosteriorMatcher| m.n_feasible() as u64 * m.seen().min(m.holds().unwrap_or(usize::MAX)) as u64;
                let units = self.inner.with(py, held).saturating_mul(100);
                let sample = Sample { place: [x, y], value, height_m };
                let inner = long_call::run(py, units, None, None, |monitor| {
                    self.inner.alone(|m| m.update_interruptible(&sample, monitor))
                })?;
                Ok(PyPosteriorStep { inner })
            }

            /// Takes samples until a fix is declared or the track ends; the answer then.
            fn run(&self, py: Python<'_>, track: &Bound<'_, PyTrack>) -> PyRes<PyFix> {
                let track = track.get().on(py, self.grid.bind(py))?;
                let total = track.len() as u64;
                let units = total.saturating_mul(self.inner.with(py, |m| m.n_feasible()) as u64);
                let fix = long_call::run(py, units, None, None, |monitor| {
                    self.inner.alone(|matcher| feed(matcher, &track, false, monitor))
                })?;
                Ok(fix.into())
            }

            /// The `Fix` on the samples held, whatever its status; the posterior is taken now, which `update` does not do at every sample.
            ///
            /// Raises `TooFewSamplesError` before there are enough samples.
            fn fix(&self, py: Python<'_>) -> PyRes<PyFix> {
                Ok(self.inner.answer(py)?.into())
            }

            /// Forgets all samples; every candidate is back.
            fn reset(&self, py: Python<'_>) -> PyRes<()> {
                self.inner.begin_again(py)
            }

            /// Samples seen.
            #[getter]
            fn n_samples(&self, py: Python<'_>) -> usize {
                self.inner.seen(py)
            }

            /// Candidates left.
            #[getter]
            fn n_feasible(&self, py: Python<'_>) -> usize {
                self.inner.with(py, |m| m.n_feasible())
            }

            fn __reduce__<'py>(slf: &Bound<'py, Self>) -> Reduced<'py> {
                let (py, this) = (slf.py(), slf.get());
                reduced(slf, (this.grid.clone_ref(py), this.inner.saved(py)?))
            }

            #[staticmethod]
            fn _restore(grid: &Bound<'_, PyAny>, state: &[u8]) -> PyRes<Self> {
                let inner = Shared::new(PosteriorMatcher::load(field(grid)?, state)?);
                Ok(Self { inner, grid: grid.clone().unbind() })
            }

            fn __repr__(&self, py: Python<'_>) -> String {
                let (samples, left) = self.inner.with(py, |m| (m.n_samples(), m.n_feasible()));
                format!("PosteriorMatcher({samples} samples, {left} feasible)")
            }
        }
    };
}

common_options!(posterior_options parts);
common_options!(posterior_options merging);
common_options!(posterior_options calls);
