//! Tables of options: every option is one row, with its name, kind, default, the type as Python documents it, and its explanation.
//!
//! A table is a macro that hands its rows, in groups, to whatever macro is named: structs with their defaults here, signatures, conversions and
//! docstrings in the bindings. Changing an option is a change of one row. Types of a kind that stand on higher floors are those in the scope of
//! the struct.

/// Rust's type of a kind of option.
macro_rules! option_type {
    (number) => { f64 };
    (maybe_number) => { Option<f64> };
    (maybe_pair) => { Option<[f64; 2]> };
    (count) => { u64 };
    (size) => { usize };
    (interpolation) => { Interpolation };
    (ins) => { InsModel };
    (covariance) => { [[f64; 2]; 2] };
    (matrix) => { Vec<f64> };
    (matcher) => { Option<MatcherPlan> };
    (method) => { Method };
}

/// The default of an option, as Rust has it.
macro_rules! option_default {
    (interpolation "bilinear") => {
        Interpolation::Bilinear
    };
    (interpolation "bicubic") => {
        Interpolation::Bicubic
    };
    (ins None) => {
        InsModel::default()
    };
    (covariance None) => {
        [[0.0; 2]; 2]
    };
    (matrix None) => {
        Vec::new()
    };
    (matcher "default") => {
        Some(MatcherPlan::default())
    };
    (method "navigator") => {
        Method::Navigator
    };
    ($kind:ident $default:tt) => {
        $default
    };
}

/// A struct with one field a row, and its defaults.
macro_rules! record {
    (
        { $(#[$meta:meta])* $record:ident }
        $($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
        pub struct $record {
            $($($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*)*
        }

        impl Default for $record {
            fn default() -> Self {
                Self { $($($name: option_default!($kind $default),)*)* }
            }
        }
    };
}
