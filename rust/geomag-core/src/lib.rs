//! # geomag-core
//!
//! Geomagnetic and gravity map-matching navigation: from an indicated track, measured field values and a stored map to a
//! position fix with its risk. No files, no clock, no printing: a crate that a vehicle can carry.
//!
//! Floors, each knowing only those before it: [`error`], [`constants`], [`monitor`]; [`frame`], [`field`], [`grid`], [`track`],
//! [`fix`].
//!
//! Conventions: x to the east, y to the north, metres on projected maps, degrees of longitude and latitude on geographic
//! ones. Values in the map's unit. An *offset* is true minus indicated position.

#[macro_use]
mod table;

pub mod bounds;
pub mod campaign;
pub mod compensation;
pub mod constants;
pub mod error;
pub mod field;
pub mod fix;
pub mod frame;
pub mod grid;
pub mod gridding;
pub mod harmonic;
pub mod information;
pub mod instructions;
pub mod kalman;
pub mod lattice;
pub mod main_field;
pub mod map_error;
pub mod matching;
pub mod monitor;
pub mod navigation;
mod random;
pub mod stack;
pub mod state;
mod statistics;
pub mod synthetic;
pub mod track;

/// The examples of the crate's README run as tests.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeExamples;
