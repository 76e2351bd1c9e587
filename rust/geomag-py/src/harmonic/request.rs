//! What `fit`, `fit_observations`, `select` and `leave_out` are told, read in one place.

use geomag_core::error::Error;
use geomag_core::harmonic::{
    FitOptions, Observations, Period, Prior, RectangularHarmonicModel, Regularisation, SelectionOptions,
    coefficient_count, fit, leave_out, select,
};
use geomag_core::monitor::Monitor;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::pair;
use crate::error::{PyRes, invalid};
use crate::frame::PyLocalFrame;

/// One value or several to choose from.
fn choices<T: for<'a, 'py> FromPyObject<'a, 'py>>(
    what: &str,
    needed: &str,
    object: &Bound<'_, PyAny>,
) -> PyRes<Vec<T>> {
    if let Ok(one) = object.extract::<T>() {
        return Ok(vec![one]);
    }
    let Ok(items) = object.try_iter() else {
        return Err(invalid(what, needed, object.repr()?));
    };
    let mut out = Vec::new();
    for item in items {
        let item = item?;
        out.push(
            item.extract()
                .map_err(|_| invalid(what, needed, item.repr().map_or_else(|e| e.to_string(), |r| r.to_string())))?,
        );
    }
    if out.is_empty() { Err(invalid(what, needed, "an empty sequence")) } else { Ok(out) }
}

/// What `fit`, `fit_observations` and `select` are told.
pub struct Request {
    orders: Vec<usize>,
    ratios: Vec<f64>,
    ridges: Vec<f64>,
    priors: Vec<Prior>,
    pub options: FitOptions,
    pub folds: usize,
    pub groups: Option<Vec<u64>>,
    pub seed: u64,
    misfit: bool,
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub struct Keywords<'py> {
    order: Bound<'py, PyAny>,
    period_ratio: Bound<'py, PyAny>,
    periods_m: Option<Bound<'py, PyAny>>,
    ridge: Bound<'py, PyAny>,
    truncation: Option<f64>,
    damping_m: Bound<'py, PyAny>,
    spectrum_power: Bound<'py, PyAny>,
    anisotropy: Bound<'py, PyAny>,
    misfit: bool,
    huber: Option<f64>,
    max_iterations: usize,
    covariance: bool,
    frame: Option<Py<PyLocalFrame>>,
    unit: String,
    folds: usize,
    groups: Option<Bound<'py, PyAny>>,
    seed: u64,
}

impl Request {
    pub fn new(k: &Keywords<'_>) -> PyRes<Self> {
        let orders = choices("order", "an order >= 0, or several to choose from", &k.order)?;
        let ratios = choices("period_ratio", "a ratio >= 1, or several to choose from", &k.period_ratio)?;
        let ridges = choices("ridge", "a number >= 0, or several to choose from", &k.ridge)?;
        let needed = "a number, or several to choose from";
        let mut priors = Vec::new();
        for damping_m in choices("damping_m", needed, &k.damping_m)? {
            for &power in &choices("spectrum_power", needed, &k.spectrum_power)? {
                for &anisotropy in &choices("anisotropy", needed, &k.anisotropy)? {
                    priors.push(Prior { damping_m, power, anisotropy });
                }
            }
        }
        let regularisation = match k.truncation {
            Some(share) => Regularisation::TruncatedSvd(share),
            None => Regularisation::Ridge(ridges[0]),
        };
        let period = match &k.periods_m {
            None => Period::Ratio(ratios[0]),
            Some(periods) => Period::Metres(pair("periods_m", periods)?),
        };
        let groups = k.groups.as_ref().map(labels).transpose()?;
        let options = FitOptions {
            order: orders[0],
            period,
            regularisation,
            prior: priors[0],
            huber: k.huber,
            max_iterations: k.max_iterations,
            covariance: k.covariance,
            frame: k.frame.as_ref().map(|f| f.get().inner),
            unit: k.unit.clone(),
        };
        let request =
            Self { orders, ratios, ridges, priors, options, folds: k.folds, groups, seed: k.seed, misfit: k.misfit };
        if request.several() && (k.truncation.is_some() || k.periods_m.is_some()) {
            return Err(invalid(
                "order, period_ratio, ridge, damping_m, spectrum_power, anisotropy",
                "one of each where periods_m or truncation is given",
                "several",
            ));
        }
        Ok(request)
    }

    fn several(&self) -> bool {
        self.orders.len() * self.ratios.len() * self.ridges.len() * self.priors.len() > 1
    }

    /// About the nanoseconds that it takes.
    pub fn units(&self, rows: usize) -> u64 {
        let columns = self.orders.iter().map(|&n| coefficient_count(n.min(1000)) as u64).max().unwrap_or(0);
        (rows as u64).saturating_mul(columns.saturating_mul(columns) / 8).saturating_mul(self.ratios.len() as u64)
    }

    pub fn selection(&self) -> SelectionOptions {
        SelectionOptions {
            orders: self.orders.clone(),
            period_ratios: self.ratios.clone(),
            ridges: self.ridges.clone(),
            priors: self.priors.clone(),
            folds: self.folds,
            groups: self.groups.clone(),
            seed: self.seed,
        }
    }

    pub fn run(&self, observations: &Observations, monitor: &dyn Monitor) -> Result<RectangularHarmonicModel, Error> {
        let options = if self.several() {
            let found = select(observations, &self.selection(), &self.options, monitor)?;
            let best = found.candidates[found.best];
            FitOptions {
                order: best.order,
                period: Period::Ratio(best.period_ratio),
                regularisation: Regularisation::Ridge(best.ridge),
                prior: best.prior,
                ..self.options.clone()
            }
        } else {
            self.options.clone()
        };
        let model = fit(observations, &options, monitor)?;
        if !self.misfit {
            return Ok(model);
        }
        let left = leave_out(observations, &options, self.folds, self.groups.as_deref(), self.seed, monitor)?;
        Ok(model.with_misfit(left.misfit))
    }
}

/// Labels of any kind as numbers, in the order in which they come.
fn labels(object: &Bound<'_, PyAny>) -> PyRes<Vec<u64>> {
    let seen = PyDict::new(object.py());
    let mut out = Vec::new();
    for item in object.try_iter()? {
        let item = item?;
        let next = seen.len() as u64;
        if let Some(known) = seen.get_item(&item)? {
            out.push(known.extract()?);
        } else {
            seen.set_item(item, next)?;
            out.push(next);
        }
    }
    Ok(out)
}

/// Defaults of the keywords that `fit`, `fit_observations` and `select` share.
pub fn keywords<'py>(py: Python<'py>, given: Option<&Bound<'py, PyDict>>) -> PyRes<Keywords<'py>> {
    let all = PyDict::new(py);
    all.set_item("order", 12)?;
    all.set_item("period_ratio", 1.5)?;
    all.set_item("ridge", 1e-9)?;
    for name in ["periods_m", "truncation", "huber", "frame", "groups"] {
        all.set_item(name, py.None())?;
    }
    all.set_item("damping_m", 0.0)?;
    all.set_item("spectrum_power", 0.0)?;
    all.set_item("anisotropy", 1.0)?;
    all.set_item("misfit", false)?;
    all.set_item("max_iterations", 20)?;
    all.set_item("covariance", true)?;
    all.set_item("unit", "nT")?;
    all.set_item("folds", 5)?;
    all.set_item("seed", 0)?;
    if let Some(given) = given {
        for (key, value) in given {
            let name: String = key.extract()?;
            if all.get_item(&name)?.is_none() {
                return Err(
                    pyo3::exceptions::PyTypeError::new_err(format!("unexpected keyword argument '{name}'")).into()
                );
            }
            all.set_item(name, value)?;
        }
    }
    all.extract().map_err(|e: PyErr| invalid("options of the fit", "arguments of the documented types", e))
}
