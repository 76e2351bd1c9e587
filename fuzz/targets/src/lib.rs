//! What geomag is fuzzed with.
//!
//! A target reads bytes as a case (a map, options, samples, an order of calls) and asserts what must hold whatever they are: no panic, no
//! hang, numbers that are finite or a status that says why not, covariances that are covariances, and state that a refused call leaves as
//! it was. libFuzzer drives them with coverage (`make fuzz`); `tests/short.rs` runs the same functions over the seeds and random bytes.

// A target that finds something ends: that is what it is for.
#![allow(clippy::expect_used, clippy::unwrap_used, clippy::panic, clippy::needless_for_each)]

mod fields;
mod filters;
mod maps;
mod matchers;
mod navigation;
mod source;
mod states;
mod streams;

pub use source::Source;

/// One way to be hostile.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Its name on the command line and of its folder of seeds.
    pub name: &'static str,
    /// Runs one case; panics where something does not hold.
    pub run: fn(&[u8]),
}

/// All targets.
pub const TARGETS: [Target; 19] = [
    Target { name: "map", run: maps::map },
    Target { name: "state", run: states::state },
    Target { name: "iema", run: streams::iema },
    Target { name: "grid_search", run: matchers::grid_search },
    Target { name: "contour", run: matchers::contour },
    Target { name: "posterior", run: matchers::posterior },
    Target { name: "posterior_stream", run: streams::posterior },
    Target { name: "sliding", run: streams::sliding },
    Target { name: "sequence", run: matchers::sequence },
    Target { name: "tuning", run: matchers::tuning },
    Target { name: "kalman", run: filters::kalman },
    Target { name: "field_navigator", run: navigation::field_navigator },
    Target { name: "navigator", run: navigation::navigator },
    Target { name: "flight", run: navigation::flight },
    Target { name: "ins_feedback", run: navigation::ins_feedback },
    Target { name: "harmonic", run: fields::harmonic },
    Target { name: "frame", run: fields::frame },
    Target { name: "gridding", run: fields::gridding },
    Target { name: "synthetic", run: fields::synthetic },
];

/// The target of a name.
pub fn named(name: &str) -> Option<Target> {
    TARGETS.into_iter().find(|t| t.name == name)
}
