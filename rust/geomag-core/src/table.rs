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
    (method) => { NavigatorMethod };
    (field_method) => { FieldNavigatorMethod };
    (flag) => { bool };
    (tally) => { u32 };
    (maybe_size) => { Option<usize> };
    (reach) => { f64 };
    (pair) => { [f64; 2] };
    (headings) => { Vec<f64> };
    (scales) => { Vec<f64> };
    (weights) => { Option<Vec<f64>> };
    (pivot) => { Pivot };
    (unknown) => { Unknown };
    (transform) => { TransformKind };
    (starts) => { Starts };
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
        NavigatorMethod::Navigator
    };
    (field_method "unscented") => {
        FieldNavigatorMethod::Unscented
    };
    (reach None) => {
        f64::INFINITY
    };
    (pair None) => {
        [0.0; 2]
    };
    (headings None) => {
        vec![0.0]
    };
    (scales None) => {
        vec![1.0]
    };
    (pivot "newest") => {
        Pivot::Newest
    };
    (unknown "keep") => {
        Unknown::Keep
    };
    (transform "rigid") => {
        TransformKind::Rigid
    };
    (starts None) => {
        Starts::Indicated
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

/// Rows that several matchers share: how far to look, and how much of a track must lie on the map.
#[doc(hidden)]
#[macro_export]
macro_rules! common_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            extent [
                (half_width: maybe_pair = None; "float or (float, float), optional";
                    "Bound of the INS error (x, y), map units. This, `half_width_m` or a `search` is needed.")
                (half_width_m: maybe_pair = None; "float or (float, float), optional";
                    "The same (east, north) in metres; on a map in degrees at the middle latitude of the tracks, or of the map before there is"
                    "one.")
                (step_m: maybe_pair = None; "float or (float, float), optional";
                    "`step` in metres.")
            ]
            overlap [
                (min_overlap: number = 0.8; "float";
                    "Least share of the samples that a candidate must have on the map.")
            ]
        }
    };
}

/// The step of a lattice that is not refined where it matters.
#[doc(hidden)]
#[macro_export]
macro_rules! step_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            pitch [
                (step: maybe_pair = None; "float or (float, float), optional";
                    "Lattice step, map units; the map spacing by default. Whole fractions of the spacing are fast.")
            ]
        }
    };
}
