//! The grade of an INS, and when the matcher beside the filter is asked.

use geomag_core::navigation::navigator::{InsModel, MatcherPlan};
use geomag_core::{ins_model, matcher_plan};
use pyo3::prelude::*;

use crate::error::PyRes;

ins_model! { record_class {
    /// The grade of an INS: how large its errors are, and how they grow.
    ;
    ///
    /// Notes
    /// -----
    /// The defaults are those of `InsModel.navigation()`: about a nautical mile an hour unaided. Biases are first-order Gauss-Markov
    /// processes. Source: Groves, Principles of GNSS, Inertial, and Multisensor Integrated Navigation Systems, ch. 4 and 14.
    ///
    /// Examples
    /// --------
    /// >>> import geomag
    /// >>> geomag.InsModel.tactical().gyro_bias_deg_h
    /// 1.0
    /// >>> geomag.InsModel(gyro_bias_deg_h=0.01) == geomag.InsModel.navigation()
    /// False
    PyInsModel "InsModel" InsModel;
    {
        /// Navigation grade: about a nautical mile an hour unaided.
        #[staticmethod]
        fn navigation() -> Self {
            Self { inner: InsModel::navigation() }
        }

        /// Tactical grade: some tens of kilometres an hour unaided.
        #[staticmethod]
        fn tactical() -> Self {
            Self { inner: InsModel::tactical() }
        }
    }
} }

matcher_plan! { record_class {
    /// When and how the matcher beside a `Navigator` is asked.
    ;
    ///
    /// Notes
    /// -----
    /// A fix is a measurement only while the filter is lost, and a test while it tracks: two that contradict it, or one under alarm, reset
    /// position and sensor bias. Source: geomag's own.
    ///
    /// Examples
    /// --------
    /// >>> import geomag
    /// >>> geomag.MatcherPlan(every_s=30.0).every_s
    /// 30.0
    PyMatcherPlan "MatcherPlan" MatcherPlan;
    {}
} }
