//! Campaigns. Settings come as JSON from the dataclasses of `geomag.campaign`; rows go out as columns.

use std::sync::Arc;

use geomag_core::campaign::{Campaign, CampaignMethod, CampaignRow, run};
use geomag_core::field::Field;
use geomag_core::grid::GridMap;
use geomag_core::matching::contour::ContourOptions;
use geomag_core::matching::grid_search::GridSearch;
use geomag_core::matching::iema::IemaOptions;
use geomag_core::matching::posterior::PosteriorOptions;
use geomag_core::matching::similarity::Criterion;
use geomag_core::synthetic::SyntheticField;
use numpy::IntoPyArray;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::arrays::shaped;
use crate::contour::PyContourSettings;
use crate::error::{PyRes, invalid};
use crate::grid::PyGridMap;
use crate::long_call;
use crate::synthetic::{PyPath, PySyntheticField, settings};
use crate::track::PyTrack;

/// Rough work of one trial in nanoseconds: campaigns are long calls from a thousand trials on.
const TRIAL_UNITS: u64 = 20_000;

/// Defaults with the given settings laid over them; an unknown one is named.
fn overlay<T: Serialize + DeserializeOwned>(what: &str, defaults: &T, given: &Value) -> PyRes<T> {
    let mut all = serde_json::to_value(defaults).map_err(|e| invalid(what, "settings that JSON can hold", e))?;
    let (Some(all_fields), Some(fields)) = (all.as_object_mut(), given.as_object()) else {
        return Err(invalid(what, "an object of settings", given));
    };
    for (key, value) in fields {
        let Some(slot) = all_fields.get_mut(key) else {
            let known: Vec<&str> = all_fields.keys().map(String::as_str).collect();
            return Err(invalid(what, &format!("one of {}", known.join(", ")), format!("'{key}'")));
        };
        *slot = value.clone();
    }
    serde_json::from_value(all).map_err(|e| invalid(what, "settings of that kind", e))
}

/// Standard deviation of a reading, where it is given.
fn sigma(options: &Bound<'_, PyDict>) -> PyRes<Option<f64>> {
    Ok(options.get_item("sigma")?.map(|s| s.extract()).transpose()?.flatten())
}

/// What `match_contour` makes of keywords for a map.
fn contour_settings(map: &Arc<GridMap>, keywords: &Bound<'_, PyDict>) -> PyRes<ContourOptions> {
    let py = keywords.py();
    let call = py.import("geomag._geomag")?.getattr("_contour_settings")?;
    let made = call.call((PyGridMap::of(Arc::clone(map)),), Some(keywords))?;
    Ok(made.cast::<PyContourSettings>().map_err(PyErr::from)?.get().inner.clone())
}

/// A matcher from its kind, and its options as JSON or, where they are those of the binding, as they are.
fn method(map: &Arc<GridMap>, (kind, json, options): &(String, String, Bound<'_, PyDict>)) -> PyRes<CampaignMethod> {
    match kind.as_str() {
        "iema" => {
            let defaults = IemaOptions::new(1.0, [0.0; 2]);
            Ok(CampaignMethod::Iema(overlay("method iema", &defaults, &settings("method iema", json)?)?))
        }
        "grid" => {
            let defaults = GridSearch::new(Criterion::Msd, [0.0; 2]);
            Ok(CampaignMethod::Grid(overlay("method grid", &defaults, &settings("method grid", json)?)?))
        }
        "hausdorff" => {
            let mut given: Value = settings("method grid", json)?;
            let mut take = |name: &str| given.as_object_mut().and_then(|o| o.remove(name)).and_then(|v| v.as_f64());
            let (length_scale_m, value_scale) = (take("length_scale_m"), take("value_scale"));
            let fraction = take("fraction").unwrap_or(1.0);
            let search = overlay("method grid", &GridSearch::new(Criterion::Msd, [0.0; 2]), &given)?;
            Ok(CampaignMethod::Hausdorff { length_scale_m, value_scale, fraction, search })
        }
        "contour" => {
            let rest = options.copy()?;
            if rest.contains("sigma")? {
                rest.del_item("sigma")?;
            }
            Ok(CampaignMethod::Contour { sigma: sigma(options)?, options: contour_settings(map, &rest)? })
        }
        "posterior" => {
            let mut given: Value = settings("method posterior", json)?;
            given.as_object_mut().and_then(|o| o.remove("sigma"));
            let options_in_force = overlay("method posterior", &PosteriorOptions::new([0.0; 2]), &given)?;
            Ok(CampaignMethod::Posterior { sigma: sigma(options)?, options: options_in_force })
        }
        other => Err(invalid("method", "'iema', 'grid', 'hausdorff', 'posterior' or 'contour'", format!("'{other}'"))),
    }
}

/// What the sensor reads: the map itself or another field.
enum Truth {
    Map(Arc<GridMap>),
    Synthetic(SyntheticField),
}

impl Truth {
    fn new(map: &PyGridMap, truth: Option<&Bound<'_, PyAny>>) -> PyRes<Self> {
        match truth {
            None => Ok(Self::Map(Arc::clone(&map.inner))),
            Some(object) => {
                if let Ok(grid) = object.cast::<PyGridMap>() {
                    Ok(Self::Map(Arc::clone(&grid.get().inner)))
                } else if let Ok(field) = object.cast::<PySyntheticField>() {
                    Ok(Self::Synthetic(field.get().inner.clone()))
                } else {
                    Err(invalid("truth", "a GridMap or a SyntheticField", object.get_type()))
                }
            }
        }
    }

    fn field(&self) -> &dyn Field {
        match self {
            Self::Map(map) => &**map,
            Self::Synthetic(field) => field,
        }
    }
}

fn columns<'py>(py: Python<'py>, rows: &[CampaignRow]) -> PyRes<Bound<'py, PyDict>> {
    let d = PyDict::new(py);
    let number = |get: &dyn Fn(&CampaignRow) -> f64| shaped(py, rows.iter().map(get).collect(), &[rows.len()]);
    d.set_item("trial", rows.iter().map(|r| r.trial).collect::<Vec<u64>>().into_pyarray(py))?;
    let status: Vec<&str> = rows.iter().map(|r| r.status.as_str()).collect();
    d.set_item("status", py.import("numpy")?.call_method1("array", (status, "U13"))?)?;
    d.set_item("n_samples", rows.iter().map(|r| r.n_samples as u32).collect::<Vec<u32>>().into_pyarray(py))?;
    d.set_item("iterations", rows.iter().map(|r| r.iterations as u32).collect::<Vec<u32>>().into_pyarray(py))?;
    d.set_item("true_x", number(&|r| r.truth[0])?)?;
    d.set_item("true_y", number(&|r| r.truth[1])?)?;
    d.set_item("error_m", number(&CampaignRow::distance_m)?)?;
    d.set_item("error_east_m", number(&|r| r.error_m[0])?)?;
    d.set_item("error_north_m", number(&|r| r.error_m[1])?)?;
    d.set_item("ins_error_east_m", number(&|r| r.ins_error_m[0])?)?;
    d.set_item("ins_error_north_m", number(&|r| r.ins_error_m[1])?)?;
    d.set_item("risk", number(&|r| r.risk)?)?;
    d.set_item("goodness", number(&|r| r.goodness)?)?;
    d.set_item("covariance_ee_m2", number(&|r| r.covariance_m2[0])?)?;
    d.set_item("covariance_en_m2", number(&|r| r.covariance_m2[1])?)?;
    d.set_item("covariance_nn_m2", number(&|r| r.covariance_m2[2])?)?;
    d.set_item("score", number(&|r| r.score)?)?;
    d.set_item("runner_up", number(&|r| r.runner_up)?)?;
    Ok(d)
}

/// Runs trials of a campaign; one dict of columns a method.
#[pyfunction]
#[pyo3(signature = (grid, truth, campaign_json, methods, trials, threads = None, progress = None))]
#[allow(clippy::too_many_arguments)] // private; geomag.campaign calls it with names
pub fn campaign_rows<'py>(
    py: Python<'py>,
    grid: &PyGridMap,
    truth: Option<&Bound<'py, PyAny>>,
    campaign_json: &str,
    methods: Vec<(String, String, Bound<'py, PyDict>)>,
    trials: Vec<u64>,
    threads: Option<usize>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyRes<Vec<Bound<'py, PyDict>>> {
    let campaign: Campaign = settings("campaign", campaign_json)?;
    let (map, truth) = (Arc::clone(&grid.inner), Truth::new(grid, truth)?);
    let methods = methods.iter().map(|m| method(&map, m)).collect::<PyRes<Vec<CampaignMethod>>>()?;
    let units = TRIAL_UNITS.saturating_mul(trials.len() as u64);
    let rows = long_call::run(py, units, threads, progress, |monitor| {
        run(&campaign, &map, truth.field(), &methods, &trials, monitor)
    })?;
    rows.iter().map(|r| columns(py, r)).collect()
}

/// One flight of a campaign: true path, indicated track, true field along the path.
#[pyfunction]
pub fn campaign_flight<'py>(
    py: Python<'py>,
    grid: &PyGridMap,
    truth: Option<&Bound<'py, PyAny>>,
    campaign_json: &str,
    trial: u64,
) -> PyRes<(PyPath, PyTrack, Bound<'py, PyAny>)> {
    let campaign: Campaign = settings("campaign", campaign_json)?;
    let truth = Truth::new(grid, truth)?;
    let flight = campaign.flight(&grid.inner, truth.field(), trial)?;
    let n = flight.truth.len();
    let track = PyTrack::from_core(flight.track);
    Ok((PyPath { inner: flight.path }, track, shaped(py, flight.truth, &[n])?))
}
