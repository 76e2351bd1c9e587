//! `match_grid`: signature and docstring from the core's table of options.

use geomag_core::error::require_positive;
use geomag_core::lattice::Pivot;
use geomag_core::matching::grid_search::{GridSearch, match_grid};
use geomag_core::matching::similarity::{Criterion, Robust};
use geomag_core::track::Track;
use geomag_core::{common_options, grid_search_options, step_options};
use pyo3::prelude::*;

use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::grid::read_by;
use crate::long_call;
use crate::posterior::{Extent, PySearchBox, boxed, middle};
use crate::stack::field_for;
use crate::track::PyTrack;

macro_rules! grid_search_call {
    (
        extent [$(($bound:ident: $bound_kind:ident = $bound_default:tt; $bound_python:literal; $($bound_line:literal)+))*]
        overlap $overlap:tt
        pitch $pitch:tt
        search $search:tt turn $turn:tt compare $compare:tt answer $answer:tt
        measure [$(($measured:ident: $measured_kind:ident = $measured_default:tt; $measured_python:literal; $($measured_line:literal)+))*]
    ) => {
        grid_search_call! {
            [$(($bound: $bound_kind = $bound_default; $bound_python; $($bound_line)+))*]
            [$(($measured: $measured_kind = $measured_default; $measured_python; $($measured_line)+))*]
            $pitch $search $turn $compare $overlap $answer
        }
    };
    (
        [$(($bound:ident: $bound_kind:ident = $bound_default:tt; $bound_python:literal; $($bound_line:literal)+))*]
        [$(($measured:ident: $measured_kind:ident = $measured_default:tt; $measured_python:literal; $($measured_line:literal)+))*]
        $([$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        /// Search a lattice of offsets (and headings, and scales) with a similarity measure.
        ///
        /// For a whole track at once, on any map. Not for a declared risk: its `ambiguous` is a likelihood ratio, not a
        /// calibrated probability; see `match_posterior`.
        ///
        /// Parameters
        /// ----------
        #[doc = shared_doc!(grid)]
        #[doc = shared_doc!(track)]
        /// criterion : {'msd', 'mad', 'prod', 'ncc', 'hausdorff'}
        ///     Mean square difference, mean absolute difference, product correlation about the map's mean, normalised
        ///     cross-correlation, (partial) Hausdorff distance.
        $(#[doc = row_doc!($bound; $bound_python; $($bound_line)+)])*
        $($(#[doc = row_doc!($name; $python; $($line)+)])*)*
        $(#[doc = row_doc!($measured; $measured_python; $($measured_line)+)])*
        #[doc = shared_doc!(search)]
        #[doc = shared_doc!(threads)]
        #[doc = shared_doc!(progress)]
        /// method : {'bilinear', 'bicubic'}, optional
        ///     Old name of `interpolation`; it warns.
        ///
        /// Returns
        /// -------
        /// Fix
        ///     Its status is `lost` where no candidate brings the track onto the map.
        ///
        /// Raises
        /// ------
        /// InvalidInputError, TooFewSamplesError, CandidateLimitError
        ///
        /// Examples
        /// --------
        /// >>> import numpy as np, geomag
        /// >>> x = np.arange(0.0, 6000.0, 50.0)
        /// >>> grid = geomag.GridMap(90 * np.sin(x / 400)[None, :] * np.cos(x / 500)[:, None], x, x)
        /// >>> k = np.arange(30.0)
        /// >>> track = geomag.Track(1000 + 90 * k, 2000 + 40 * k, grid.sample(1210 + 90 * k, 1875 + 40 * k))
        /// >>> fix = geomag.match_grid(grid, track, criterion="msd", half_width=500)
        /// >>> fix.status, [round(v) for v in fix.offset_m]
        /// ('fixed', [210, -125])
        #[pyfunction(name = "match_grid")]
        #[pyo3(signature = (grid, track, criterion = "msd", *, $($bound = $bound_default,)* $($($name = $default,)*)*
            $($measured = $measured_default,)* search = None, threads = None, progress = None, method = None))]
        #[allow(clippy::too_many_arguments)] // one each, keyword-only
        pub fn py_match_grid(
            py: Python<'_>,
            grid: &Bound<'_, PyAny>,
            track: &PyTrack,
            criterion: &str,
            $($bound: py_type!($bound_kind),)*
            $($($name: py_type!($kind),)*)*
            $($measured: py_type!($measured_kind),)*
            search: Option<Py<PySearchBox>>,
            threads: Option<usize>,
            progress: Option<&Bound<'_, PyAny>>,
            method: Option<&str>,
        ) -> PyRes<PyFix> {
            let measure = Measure { criterion, $($measured,)* };
            measure.check()?;
            let mut given = GridSearch {
                $($($name: py_value!(py $kind $name),)*)*
                ..GridSearch::new(Criterion::Msd, [0.0; 2])
            };
            given.interpolation = read_by(py, given.interpolation, method)?;
            let extent = Extent { $($bound: py_value!(py $bound_kind $bound),)* };
            searched(py, grid, track, &measure, extent, given, search.as_ref(), threads, progress)
        }
    };
}

common_options!(step_options grid_search_options grid_search_call);

/// What makes a measure, as it is given.
struct Measure<'a> {
    criterion: &'a str,
    robust: Option<&'a str>,
    robust_scale: Option<f64>,
    nu: f64,
    length_scale_m: Option<f64>,
    value_scale: Option<f64>,
    fraction: f64,
}

#[allow(clippy::too_many_arguments)] // those of the call
fn searched(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &PyTrack,
    measure: &Measure<'_>,
    extent: Extent,
    given: GridSearch,
    search: Option<&Py<PySearchBox>>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyRes<PyFix> {
    let samples = &*track.on(py, grid)?;
    let field = field_for(grid, [samples])?;
    let measured = samples.weighted(given.weights.as_deref())?;
    let usual = GridSearch::new(Criterion::Msd, [0.0; 2]).max_candidates;
    let (extent, step, max_candidates) = boxed(search, extent, given.step, (given.max_candidates, usual))?;
    let (half_width, step) = extent.check(step)?.in_units(&*field, middle([samples]), step);
    let search = GridSearch {
        criterion: measure.criterion(&measured, field.geographic())?,
        robust: measure.robust()?,
        half_width,
        step,
        max_candidates,
        ..given
    };
    let spacing = field.spacing();
    let cells: f64 = (0..2).map(|d| 2.0 * search.half_width[d] / search.step.unwrap_or(spacing)[d] + 1.0).product();
    let units = cells * samples.len() as f64 * (search.heading_deg.len() * search.scale.len()) as f64;
    let fix =
        long_call::run(py, units as u64, threads, progress, |monitor| match_grid(&*field, samples, &search, monitor))?;
    Ok(fix.into())
}

impl Measure<'_> {
    fn criterion(&self, track: &Track, geographic: bool) -> PyRes<Criterion> {
        Ok(match self.criterion {
            "msd" => Criterion::Msd,
            "mad" => Criterion::Mad,
            "prod" => Criterion::Prod,
            "ncc" => Criterion::Ncc,
            "hausdorff" => {
                Criterion::hausdorff(track, geographic, self.length_scale_m, self.value_scale, self.fraction)
            }
            other => {
                return Err(invalid("criterion", "'msd', 'mad', 'prod', 'ncc' or 'hausdorff'", format!("'{other}'")));
            }
        })
    }

    fn robust(&self) -> PyRes<Option<Robust>> {
        let scale =
            || self.robust_scale.ok_or_else(|| invalid("robust_scale", "a scale in value units with robust=", "None"));
        Ok(match self.robust {
            None => None,
            Some("huber") => Some(Robust::Huber { threshold: scale()? }),
            Some("student_t") => Some(Robust::StudentT { nu: self.nu, scale: scale()? }),
            Some(other) => return Err(invalid("robust", "None, 'huber' or 'student_t'", format!("'{other}'"))),
        })
    }

    /// Refuses nonsense in options of other criteria as well: whoever gave it expects it to act.
    fn check(&self) -> PyRes<()> {
        let given = [
            ("length_scale_m", self.length_scale_m),
            ("value_scale", self.value_scale),
            ("robust_scale", self.robust_scale),
            ("nu", Some(self.nu)),
        ];
        for (what, number) in given {
            number.map(|number| require_positive(what, number)).transpose()?;
        }
        if !(self.fraction > 0.0 && self.fraction <= 1.0) {
            return Err(invalid("fraction", "a number in (0, 1]", self.fraction));
        }
        Ok(())
    }
}

/// Reads the name of a pivot.
pub fn pivot(name: &str) -> PyRes<Pivot> {
    match name {
        "newest" => Ok(Pivot::Newest),
        "centroid" => Ok(Pivot::Centroid),
        other => Err(invalid("pivot", "'newest' or 'centroid'", format!("'{other}'"))),
    }
}
