//! The bodies of the calls: tracks and maps converted, the search laid out in map units, the core asked.

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::matching::posterior::{self, Channel, PosteriorOptions};
use geomag_core::track::Track;
use pyo3::prelude::*;

use super::calls::{Extent, PySearchBox, SearchBox};
use super::prediction::PyPrediction;
use crate::arrays::vector;
use crate::error::{PyRes, invalid};
use crate::fix::PyFix;
use crate::long_call;
use crate::options::old_name;
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

/// How far to look, with what a `SearchBox` says of it in its place: extents, step and the limit of candidates.
pub fn boxed(
    search: Option<&Py<PySearchBox>>,
    mut extent: Extent,
    mut step: Option<[f64; 2]>,
    (max_candidates, default): (u64, u64),
) -> PyRes<(Extent, Option<[f64; 2]>, u64)> {
    let mut most = max_candidates;
    if let Some(part) = search.map(|p| p.get().inner) {
        extent.half_width = merge("half_width", "search", extent.half_width, part.half_width, None)?;
        extent.half_width_m = merge("half_width_m", "search", extent.half_width_m, part.half_width_m, None)?;
        extent.step_m = merge("step_m", "search", extent.step_m, part.step_m, None)?;
        step = merge("step", "search", step, part.step, None)?;
        most = limit(&part, max_candidates, default)?;
    }
    Ok((extent, step, most))
}

/// The limit of candidates of a call whose own default is another than the box's: a box without a limit leaves that of the call.
pub fn limit(part: &SearchBox, keyword: u64, default: u64) -> PyRes<u64> {
    if part.max_candidates == PosteriorOptions::new([1.0; 2]).max_candidates {
        return Ok(keyword);
    }
    merge("max_candidates", "search", keyword, part.max_candidates, default)
}

/// What is asked for, its extents in map units or metres as they were given.
pub struct Area {
    options: PosteriorOptions,
    extent: Extent,
}

impl Area {
    pub fn of(options: PosteriorOptions, extent: Extent) -> PyRes<Self> {
        let extent = extent.check(options.step)?;
        Ok(Self { options, extent })
    }

    /// The options in units of a map, where metres are taken at this latitude (the map's middle where there is none).
    pub fn options(self, map: &dyn Field, y: Option<f64>) -> PyRes<PosteriorOptions> {
        let (half_width, step) = self.extent.in_units(map, y, self.options.step);
        let options = PosteriorOptions { half_width, step, ..self.options };
        options.validate()?;
        Ok(options)
    }
}

impl Extent {
    /// Refuses an extent that is not given, or twice.
    pub fn check(self, step: Option<[f64; 2]>) -> PyRes<Self> {
        let both = |name: &str| Err(invalid(name, "map units or metres, not both", "both"));
        if self.half_width.is_some() && self.half_width_m.is_some() {
            return both("half_width");
        }
        if step.is_some() && self.step_m.is_some() {
            return both("step");
        }
        if self.half_width.is_none() && self.half_width_m.is_none() {
            let needed = "half_width_m= (metres) or half_width= (map units): how far off the INS may be";
            return Err(invalid("search", needed, "neither"));
        }
        Ok(self)
    }

    /// Half width and step in map units, where metres are taken at this latitude (the map's middle where there is none).
    pub fn in_units(self, map: &dyn Field, y: Option<f64>, step: Option<[f64; 2]>) -> ([f64; 2], Option<[f64; 2]>) {
        let middle = || map.layout().map_or(0.0, |g| 0.5 * (g.y().first() + g.y().last()));
        let units = |m: [f64; 2]| {
            let scale = map.metres_per_unit(y.unwrap_or_else(middle));
            [m[0] / scale[0], m[1] / scale[1]]
        };
        let half_width = self.half_width.or_else(|| self.half_width_m.map(units)).unwrap_or_default();
        (half_width, self.step_m.map(units).or(step))
    }
}

/// Mean y of tracks: where metres are taken.
pub fn middle<'a>(tracks: impl IntoIterator<Item = &'a Track>) -> Option<f64> {
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
        old_name(py, "more", "channels")?;
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
