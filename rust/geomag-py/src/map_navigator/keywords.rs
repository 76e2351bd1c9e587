//! The keywords of a navigator.

use geomag_core::error::Error;
use geomag_core::navigation::navigator::{MatcherPlan, NavigatorMethod, NavigatorOptions};
use geomag_core::navigator_options;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::models::{PyInsModel, PyMatcherPlan};
use crate::arrays::{matrix, pair};
use crate::error::{PyRes, invalid};
use crate::options::{old_name, unexpected};

/// A covariance from a number (variance on each axis) or a (2, 2) array.
pub fn covariance(object: &Bound<'_, PyAny>) -> PyRes<[[f64; 2]; 2]> {
    if let Ok(variance) = object.extract::<f64>() {
        return Ok([[variance, 0.0], [0.0, variance]]);
    }
    let (v, rows, columns) = matrix("covariance_m2", object)?;
    if (rows, columns) != (2, 2) {
        return Err(Error::shape("covariance_m2", "(2, 2) east-north", format!("({rows}, {columns})")).into());
    }
    Ok([[v[0], v[1]], [v[2], v[3]]])
}

/// The core's value of a keyword of a navigator.
macro_rules! keyword {
    (number $key:ident $value:ident) => {
        number($key, $value)?
    };
    (maybe_number $key:ident $value:ident) => {
        Some(number($key, $value)?)
    };
    (maybe_pair $key:ident $value:ident) => {
        Some(pair($key, $value)?)
    };
    (flag $key:ident $value:ident) => {
        $value.extract::<bool>().map_err(|_| invalid($key, "True or False", $value.get_type()))?
    };
    (covariance $key:ident $value:ident) => {
        covariance($value)?
    };
    (matrix $key:ident $value:ident) => {
        matrix($key, $value)?.0
    };
    (ins $key:ident $value:ident) => {
        $value.cast::<PyInsModel>().map_err(|_| invalid($key, "a geomag.InsModel", $value.get_type()))?.get().inner
    };
    (matcher $key:ident $value:ident) => {
        Some(plan($key, $value)?)
    };
    (method $key:ident $value:ident) => {
        method($key, $value)?
    };
}

fn number(key: &str, value: &Bound<'_, PyAny>) -> PyRes<f64> {
    value.extract::<f64>().map_err(|_| invalid(key, "a number", value.get_type()))
}

fn plan(key: &str, value: &Bound<'_, PyAny>) -> PyRes<MatcherPlan> {
    if value.extract::<&str>().is_ok_and(|name| name == "default") {
        return Ok(MatcherPlan::default());
    }
    let plan = value.cast::<PyMatcherPlan>();
    Ok(plan.map_err(|_| invalid(key, "a geomag.MatcherPlan, 'default' or None", value.get_type()))?.get().inner)
}

fn method(key: &str, value: &Bound<'_, PyAny>) -> PyRes<NavigatorMethod> {
    match value.extract::<&str>() {
        Ok("navigator") => Ok(NavigatorMethod::Navigator),
        Ok("ekf") => Ok(NavigatorMethod::Ekf),
        Ok("rbpf") => Ok(NavigatorMethod::Rbpf),
        _ => Err(invalid(key, "'navigator', 'ekf' or 'rbpf'", value.repr()?)),
    }
}

macro_rules! keywords {
    (
        extent [$(($start:ident: $($_e:tt)*))*]
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $($_rest:tt)*))*])*
    ) => {
        /// All keywords of a navigator.
        const KEYWORDS: &[&str] = &[$(stringify!($start),)* $($(stringify!($name),)*)*];

        /// Puts a keyword in its place; false for one that there is not.
        fn put(out: &mut NavigatorOptions, key: &str, value: &Bound<'_, PyAny>) -> PyRes<bool> {
            $($(
                if key == stringify!($name) {
                    out.$name = keyword!($kind key value);
                    return Ok(true);
                }
            )*)*
            Ok(false)
        }
    };
}

navigator_options!(keywords);

/// Options of a navigator from the keywords that both ways to one take.
pub fn options(given: Option<&Bound<'_, PyDict>>) -> PyRes<NavigatorOptions> {
    let mut out = NavigatorOptions::new(100.0);
    let Some(given) = given else { return Ok(out) };
    let stated = |key: &str| given.get_item(key).map(|v| v.filter(|v| !v.is_none()));
    if let Some(sigma) = stated("position_sigma_m")? {
        if stated("covariance_m2")?.is_some() {
            return Err(invalid("start", "position_sigma_m or covariance_m2", "both"));
        }
        let sigma = number("position_sigma_m", &sigma)?;
        if !(sigma >= 0.0) {
            return Err(invalid("position_sigma_m", "a finite number >= 0", sigma));
        }
        out.covariance_m2 = [[sigma * sigma, 0.0], [0.0, sigma * sigma]];
    }
    for (key, value) in given.iter() {
        let mut key: String = key.extract()?;
        if key == "bias_walk" {
            old_name(given.py(), "bias_walk", "bias_walk_sqrt_s")?;
            key = "bias_walk_sqrt_s".into();
        }
        if value.is_none() {
            // None is the default of all keywords but one, for which it is none.
            if key == "matcher" {
                out.matcher = None;
            }
        } else if key != "position_sigma_m" && !put(&mut out, &key, &value)? {
            return Err(unexpected(&key, KEYWORDS));
        }
    }
    Ok(out)
}
