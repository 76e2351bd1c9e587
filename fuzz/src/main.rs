//! One target of `geomag_fuzz_targets` under libFuzzer: `GEOMAG_FUZZ=navigator geomag-fuzz -runs=1000000 corpus/navigator`.
#![no_main]

use std::sync::LazyLock;

use geomag_fuzz_targets::{Target, named};
use libfuzzer_sys::fuzz_target;

static TARGET: LazyLock<Target> = LazyLock::new(|| {
    let name = std::env::var("GEOMAG_FUZZ").unwrap_or_default();
    named(&name).unwrap_or_else(|| panic!("GEOMAG_FUZZ: needed the name of a target, got '{name}'"))
});

fuzz_target!(|data: &[u8]| (TARGET.run)(data));
