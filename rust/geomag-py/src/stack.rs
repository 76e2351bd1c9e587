//! `MapStack`, and which field serves a track at its heights.

use std::sync::Arc;

use geomag_core::error::require_finite;
use geomag_core::field::Field;
use geomag_core::grid::GridMap;
use geomag_core::stack::{MapStack, continuation_needed, extent, heights_needed, is_one_level};
use geomag_core::track::Track;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::arrays::{broadcast, shaped};
use crate::error::{PyRes, invalid};
use crate::grid::{PyGridMap, field, read_by};

/// One map at several heights: what a vehicle that climbs is matched with.
///
/// Taken wherever a matcher takes a map, by tracks that have heights (`Track(height_m=)`); between two levels the field is
/// interpolated. Made by `geomag.continuation.continue_to` (`GridMap.continue_to`), or of maps that were made for their
/// heights. Not for maps of different nodes: grid them alike first.
///
/// Parameters
/// ----------
/// levels : sequence of GridMap
///     Maps on the same nodes, each with a level of its own (`GridMap(height_m=)`), in any order.
///
/// Raises
/// ------
/// InvalidInputError
///     For a map without a level, two at one height, maps on different nodes or of different precision.
/// TooFewSamplesError
///     Without a map.
///
/// Examples
/// --------
/// >>> import numpy as np, geomag
/// >>> axis = np.arange(0.0, 2000.0, 100.0)
/// >>> values = 80 * np.sin(axis / 300) * np.ones((20, 1))
/// >>> levels = [geomag.GridMap(values * np.exp(-h / 300), axis, axis, height_m=h) for h in (0.0, 50.0, 100.0)]
/// >>> stack = geomag.MapStack(levels)
/// >>> stack.heights_m, round(stack.sample(450.0, 900.0, 75.0), 2)
/// (array([  0.,  50., 100.]), 61.5)
#[pyclass(frozen, name = "MapStack", module = "geomag")]
pub struct PyMapStack {
    /// The levels, shared with every matcher made from them.
    pub inner: Arc<MapStack>,
    levels: Vec<Py<PyGridMap>>,
}

#[pymethods]
impl PyMapStack {
    #[new]
    fn new(levels: Vec<Py<PyGridMap>>) -> PyRes<Self> {
        let inner = MapStack::new(levels.iter().map(|level| (*level.get().inner).clone()).collect())?;
        let mut levels = levels;
        let height = |level: &Py<PyGridMap>| match level.get().inner.height() {
            Some(geomag_core::grid::MapHeight::Level(h)) => *h,
            _ => f64::NAN,
        };
        levels.sort_by(|a, b| height(a).total_cmp(&height(b)));
        Ok(Self { inner: Arc::new(inner), levels })
    }

    /// Heights of the levels, ascending, metres above the height datum.
    #[getter]
    fn heights_m<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyAny>> {
        shaped(py, self.inner.heights_m().to_vec(), &[self.inner.heights_m().len()])
    }

    /// The maps, lowest first.
    #[getter]
    fn levels<'py>(&self, py: Python<'py>) -> PyRes<Bound<'py, PyTuple>> {
        Ok(PyTuple::new(py, self.levels.iter().map(|level| level.clone_ref(py)))?)
    }

    /// Metres per map unit (east, north) at a y: see `GridMap.metres_per_unit`.
    fn metres_per_unit(&self, y: f64) -> PyRes<(f64, f64)> {
        self.levels[0].get().metres_per_unit(y)
    }

    /// Spacing (x, y), map units.
    #[getter]
    fn spacing(&self) -> (f64, f64) {
        self.inner.spacing().into()
    }

    /// Whether coordinates are degrees of longitude and latitude.
    #[getter]
    fn geographic(&self) -> bool {
        self.inner.geographic()
    }

    /// Values at places and heights; arrays of any shape are broadcast. NaN off the map, next to holes, and below or above the stack.
    #[pyo3(signature = (x, y, height_m, *, interpolation = "bilinear", method = None))]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        y: &Bound<'py, PyAny>,
        height_m: &Bound<'py, PyAny>,
        interpolation: &str,
        method: Option<&str>,
    ) -> PyRes<Bound<'py, PyAny>> {
        let interpolation = read_by(py, crate::grid::interpolation(interpolation)?, method)?;
        let ([x, y, h], shape) = broadcast(["x", "y", "height_m"], [x, y, height_m])?;
        let sample = |i: usize| self.inner.sample(x[i], y[i], h[i], interpolation);
        let values = crate::pool::detached(py, || (0..x.len()).map(sample).collect());
        shaped(py, values, &shape)
    }

    /// The map at one height of the stack, with its sigma and error model.
    ///
    /// Raises `InvalidInputError` for a height below or above the stack.
    fn at(&self, py: Python<'_>, height_m: f64) -> PyRes<PyGridMap> {
        let lowest = self.levels[0].get();
        Ok(lowest.named_alike(crate::pool::detached(py, || self.inner.at(height_m))?))
    }

    fn __len__(&self) -> usize {
        self.levels.len()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> (Bound<'py, PyAny>, (Vec<Py<PyGridMap>>,)) {
        let py = slf.py();
        let levels = slf.get().levels.iter().map(|level| level.clone_ref(py)).collect();
        (slf.get_type().into_any(), (levels,))
    }

    fn __repr__(&self) -> String {
        let heights = self.inner.heights_m();
        let map = self.inner.lowest();
        format!(
            "MapStack({} levels, {} to {} m, {} x {} nodes)",
            heights.len(),
            heights[0],
            heights[heights.len() - 1],
            map.y().len(),
            map.x().len()
        )
    }
}

/// The field that serves tracks at their heights: a map that is at another height is continued to theirs, once for all.
pub fn field_for<'a>(object: &Bound<'_, PyAny>, tracks: impl IntoIterator<Item = &'a Track>) -> PyRes<Arc<dyn Field>> {
    field_over(object, tracks.into_iter().map(|track| track.height_m().and_then(extent)))
}

/// The field that serves readings between lowest and greatest heights, `None` for those that are taken to be at the map's own.
pub fn field_over(
    object: &Bound<'_, PyAny>,
    heights_m: impl IntoIterator<Item = Option<[f64; 2]>>,
) -> PyRes<Arc<dyn Field>> {
    let Ok(grid) = object.cast::<PyGridMap>() else { return field(object) };
    let map: &GridMap = &grid.get().inner;
    let mut needed: Option<[f64; 2]> = None;
    let mut at_own = false;
    for heights in heights_m {
        if let Some([low, high]) = heights_needed(map, heights)? {
            needed = Some(needed.map_or([low, high], |[a, b]| [a.min(low), b.max(high)]));
        } else {
            at_own = true;
        }
    }
    let Some([low, high]) = needed else { return field(object) };
    let continuation = object.py().import("geomag.continuation")?;
    field(&continuation.getattr("_stack_for")?.call1((object, low, high, at_own))?)
}

/// The map at one height: itself where it is there, else continued or taken out of its stack.
pub fn level_at<'py>(what: &str, object: &Bound<'py, PyAny>, height_m: f64) -> PyRes<Bound<'py, PyGridMap>> {
    require_finite("height_m", &[height_m])?;
    let py = object.py();
    if let Ok(stack) = object.cast::<PyMapStack>() {
        return Ok(Bound::new(py, stack.get().at(py, height_m)?)?);
    }
    let Ok(grid) = object.cast::<PyGridMap>() else {
        return Err(invalid(what, "a geomag.GridMap or MapStack", object.get_type().name()?));
    };
    if heights_needed(&grid.get().inner, Some([height_m; 2]))?.is_none() {
        return Ok(grid.clone());
    }
    let stack = py.import("geomag.continuation")?.getattr("_stack_for")?.call1((object, height_m, height_m, false))?;
    let stack = stack.cast::<PyMapStack>().map_err(PyErr::from)?;
    Ok(Bound::new(py, stack.get().at(py, height_m)?)?)
}

/// The one level that serves a track, for matchers that follow the contours of one map.
pub fn level_for(what: &str, object: &Bound<'_, PyAny>, track: &Track) -> PyRes<Arc<GridMap>> {
    let one = |field: &dyn Field| -> PyRes<f64> {
        let y = track.newest()[1];
        let [east, north] = field.metres_per_unit(y);
        let [dx, dy] = field.spacing();
        match track.height_m().and_then(extent) {
            Some(heights) if is_one_level((dx * east).min(dy * north), heights) => Ok(0.5 * (heights[0] + heights[1])),
            Some([low, high]) => {
                let got = format!("heights from {low} to {high} m");
                Err(invalid("track height_m", "one height, for contours are those of one level", got))
            }
            None => Err(invalid("track height_m", "the height of the track, for the map is a stack of levels", "none")),
        }
    };
    if let Ok(stack) = object.cast::<PyMapStack>() {
        return Ok(level_at(what, object, one(&*stack.get().inner)?)?.get().inner.clone());
    }
    let Ok(grid) = object.cast::<PyGridMap>() else {
        return Err(invalid(what, "a geomag.GridMap or MapStack", object.get_type().name()?));
    };
    let map = &grid.get().inner;
    if continuation_needed(map, track)?.is_none() {
        return Ok(map.clone());
    }
    Ok(level_at(what, object, one(&**map)?)?.get().inner.clone())
}

/// Whether a map is the very one behind an object.
pub fn same_map(object: &Bound<'_, PyAny>, map: &Arc<GridMap>) -> bool {
    object.cast::<PyGridMap>().is_ok_and(|grid| Arc::ptr_eq(&grid.get().inner, map))
}
