//! The short form of the fuzzing: every seed that once found something, and some thousand random cases a target.
#![allow(clippy::expect_used, clippy::doc_markdown)]

use std::path::Path;

use geomag_fuzz_targets::{TARGETS, Target};

/// Cases a target; `GEOMAG_FUZZ_CASES` asks for more.
const CASES: u64 = 400;

/// SplitMix64 (Steele, Lea, Flood 2014).
fn next(state: &mut u64) -> u64 {
    *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

fn seeds(target: &Target) -> Vec<Vec<u8>> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../seeds").join(target.name);
    let Ok(files) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<_> = files.map(|f| f.expect("a seed").path()).collect();
    paths.sort();
    paths.iter().map(|p| std::fs::read(p).expect("a seed can be read")).collect()
}

#[test]
fn seeds_and_random_cases() {
    let cases = std::env::var("GEOMAG_FUZZ_CASES").map_or(CASES, |n| n.parse().expect("a number of cases"));
    let only = std::env::var("GEOMAG_FUZZ").ok();
    for target in TARGETS.iter().filter(|t| only.as_ref().is_none_or(|name| name == t.name)) {
        for seed in seeds(target) {
            (target.run)(&seed);
        }
        let mut state = 1;
        for _ in 0..cases {
            let length = next(&mut state) % 400;
            let bytes: Vec<u8> = (0..length).map(|_| (next(&mut state) >> 32) as u8).collect();
            (target.run)(&bytes);
        }
    }
}

#[test]
fn the_targets_see_what_is_wrong() {
    let broken = Target { name: "broken", run: |data| assert!(data.len() < 3 || data[0] != 7, "found") };
    assert!(std::panic::catch_unwind(|| (broken.run)(&[7, 7, 7])).is_err());
    assert!(geomag_fuzz_targets::named("no such target").is_none());
}
