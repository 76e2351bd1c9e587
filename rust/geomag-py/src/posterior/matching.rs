//! The bodies of the calls: tracks and maps converted, the search laid out in map units, the core asked.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::matching::posterior::{self, Channel, PosteriorOptions};
use geomag_core::track::Track;
use pyo3::exceptions::PyDeprecationWarning;
use pyo3::prelude::*;

use super::calls::Extent;
use super::prediction::PyPrediction;
use crate::arrays::vector;
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::long_call;
use crate::stack::field_for;
use crate::track::PyTrack;

/// A further field measured along the track: its map, values and sensor sigma.
type Extra = (Arc<dyn Field>, Vec<f64>, Option<f64>);

/// Greatest number of simulated flights a track.
const MAX_FLIGHTS: usize = 1_000_000;

/// An option of a part, or the keyword of its name: one of the two, where they differ from the default.
pub fn merge<T: PartialEq>(name: &str, part: &str, keyword: T, of_part: T, default: T) -> PyRes<T> {
    if of_part == default {
        return Ok(keyword);
    }
    if keyword != default && keyword != of_part {
        return Err(invalid(name, &format!("a keyword or a field of {part}=, not both"), "both"));
    }
    Ok(of_part)
}

/// What is asked for, its extents in map units or metres as they were given.
pub struct Area {
    options: PosteriorOptions,
    extent: Extent,
}

impl Area {
    pub fn of(options: PosteriorOptions, extent: Extent) -> PyRes<Self> {
        let both = |name: &str| Err(invalid(name, "map units or metres, not both", "both"));
        if extent.half_width.is_some() && extent.half_width_m.is_some() {
            return both("half_width");
        }
        if options.step.is_some() && extent.step_m.is_some() {
            return both("step");
        }
        if extent.half_width.is_none() && extent.half_width_m.is_none() {
            let needed = "half_width_m= (metres), half_width= (map units) or search=: how far off the INS may be";
            return Err(invalid("search", needed, "none of them"));
        }
        Ok(Self { options, extent })
    }

    /// The options in units of a map, where metres are taken at this latitude (the map's middle where there is none).
    pub fn options(self, map: &dyn Field, y: Option<f64>) -> PyRes<PosteriorOptions> {
        let mut options = self.options;
        if self.extent.half_width_m.is_some() || self.extent.step_m.is_some() {
            let middle = || map.layout().map_or(0.0, |g| 0.5 * (g.y().first() + g.y().last()));
            let scale = map.metres_per_unit(y.unwrap_or_else(middle));
            let units = |m: [f64; 2]| [m[0] / scale[0], m[1] / scale[1]];
            options.step = self.extent.step_m.map(units).or(options.step);
            options.half_width = self.extent.half_width_m.map_or(options.half_width, units);
        }
        options.half_width = self.extent.half_width.unwrap_or(options.half_width);
        options.validate()?;
        Ok(options)
    }
}

/// Mean y of tracks: where metres are taken.
fn middle<'a>(tracks: impl IntoIterator<Item = &'a Track>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for y in tracks.into_iter().flat_map(Track::y) {
        sum += y;
        count += 1.0;
    }
    (count > 0.0).then(|| sum / count)
}

fn extras(
    py: Python<'_>,
    channels: Option<Vec<Bound<'_, PyAny>>>,
    more: Option<Vec<Bound<'_, PyAny>>>,
    track: &Track,
) -> PyRes<Vec<Extra>> {
    if more.is_some() {
        let old = c"more= is the old name of channels=";
        PyErr::warn(py, &py.get_type::<PyDeprecationWarning>(), old, 1)?;
    }
    let mut out = Vec::new();
    for item in channels.into_iter().chain(more).flatten() {
        let (grid, values, sigma): (Bound<'_, PyAny>, Bound<'_, PyAny>, Option<f64>) = item.extract()?;
        out.push((field_for(&grid, [track])?, vector("values of a further field", &values)?, sigma));
    }
    Ok(out)
}

#[allow(clippy::too_many_arguments)] // what a call is given
pub fn one(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    track: &Bound<'_, PyTrack>,
    sigma: Option<f64>,
    area: Area,
    surface: bool,
    channels: Option<Vec<Bound<'_, PyAny>>>,
    more: Option<Vec<Bound<'_, PyAny>>>,
    threads: Option<usize>,
) -> PyRes<PyFix> {
    let track = &track.get().on(py, grid)?;
    let map = field_for(grid, [&**track])?;
    let options = PosteriorOptions { surface, ..area.options(&*map, middle([&**track]))? };
    let extras = extras(py, channels, more, track)?;
    let units = posterior::work(&*map, track, &options)?.saturating_mul(extras.len() as u64 + 1);
    let fix = long_call::run(py, units, threads, None, |monitor| {
        let mut channels = vec![Channel { field: &*map, values: track.values(), sigma }];
        channels.extend(extras.iter().map(|(f, v, s)| Channel { field: &**f, values: v, sigma: *s }));
        posterior::match_interruptible(&channels, track, &options, monitor)
    })?;
    Ok(fix.into())
}

#[allow(clippy::too_many_arguments)] // what a call is given
pub fn many(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    tracks: &[Bound<'_, PyTrack>],
    sigma: Option<f64>,
    area: Area,
    streaming: bool,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyRes<Vec<PyFix>> {
    let tracks = crate::track::all_on(py, grid, tracks)?;
    let map = field_for(grid, &tracks)?;
    let options = area.options(&*map, middle(&tracks))?;
    let units = (tracks.len() as u64).saturating_mul(4_000_000);
    let fixes = long_call::run(py, units, threads, progress, |monitor| -> Result<_, Error> {
        if streaming {
            posterior::stream_many(&map, &tracks, sigma, &options, monitor)
        } else {
            posterior::match_many(&*map, &tracks, sigma, &options, monitor)
        }
    })?;
    Ok(fixes.into_iter().map(PyFix::from).collect())
}

#[allow(clippy::too_many_arguments)] // what a call is given
pub fn predicted(
    py: Python<'_>,
    grid: &Bound<'_, PyAny>,
    tracks: &[Bound<'_, PyTrack>],
    sigma: Option<f64>,
    area: Area,
    flights: usize,
    seed: u64,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyRes<Vec<Option<PyPrediction>>> {
    let tracks = crate::track::all_on(py, grid, tracks)?;
    let map = field_for(grid, &tracks)?;
    let options = area.options(&*map, middle(&tracks))?;
    if flights > MAX_FLIGHTS {
        return Err(invalid("flights", &format!("at most {MAX_FLIGHTS}"), flights));
    }
    let units = (tracks.len() as u64).saturating_mul(flights.max(1) as u64).saturating_mul(4_000_000);
    let found = long_call::run(py, units, threads, progress, |monitor| {
        posterior::predict_many(&*map, &tracks, sigma, &options, flights, seed, monitor)
    })?;
    Ok(found.into_iter().map(|p| p.map(|inner| PyPrediction { inner })).collect())
}
