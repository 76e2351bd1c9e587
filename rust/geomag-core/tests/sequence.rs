//! Delta modulation, the sampling rules and their tuning.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use geomag_core::error::Error;
use geomag_core::grid::{GridMap, GridValues};
use geomag_core::matching::sequence::{
    DeltaModulator, SequenceRules, choose_sequence, chosen_by_codes, delta_modulation, energy_bandwidth,
};
use geomag_core::matching::tuning::{BpsoOptions, SettingSpace, TuneMethod, TuneOptions, bpso, tune_sequence};
use geomag_core::monitor::Quiet;
use geomag_core::track::Track;
use proptest::prelude::*;

/// Values whose codes are the given ones.
fn values_of(codes: &str) -> Vec<f64> {
    let mut staircase = 0.0;
    let mut values = vec![0.0];
    for c in codes.chars() {
        let sign = if c == '1' { 1.0 } else { -1.0 };
        values.push(staircase + 0.25 * sign);
        staircase += sign;
    }
    values
}

#[test]
fn the_papers_code_chooses_seven() {
    let made = delta_modulation(&values_of("010111111000"), 1.0).unwrap();
    let codes: String = made.codes.iter().map(|&c| if c { '1' } else { '0' }).collect();
    assert_eq!(codes, "010111111000");
    assert_eq!(made.keep, [5, 6, 7, 8, 9, 11, 12]);
    assert_eq!(chosen_by_codes(&made.codes), made.keep);
}

#[test]
fn constant_field_chooses_none_and_steep_field_every_sample() {
    // sgn(0) = +1: a constant field makes the staircase swing about it.
    assert_eq!(delta_modulation(&[5.0; 40], 1.0).unwrap().keep, [0_usize; 0]);
    let steep: Vec<f64> = (0..40).map(|k| 100.0 * f64::from(k)).collect();
    assert_eq!(delta_modulation(&steep, 1.0).unwrap().keep, (2..40).collect::<Vec<_>>());
    assert!(delta_modulation(&[], 1.0).unwrap().keep.is_empty());
    assert!(matches!(delta_modulation(&[1.0], 0.0), Err(Error::Invalid { .. })));
    assert!(matches!(delta_modulation(&[1.0, f64::NAN], 1.0), Err(Error::NotFinite { index: 1, .. })));
}

proptest! {
    #[test]
    fn streaming_equals_batch(values in prop::collection::vec(-50.0..50.0_f64, 0..200), quantum in 0.1..20.0_f64) {
        let batch = delta_modulation(&values, quantum).unwrap();
        let mut stream = DeltaModulator::new(quantum).unwrap();
        let steps: Vec<_> = values.iter().map(|&v| stream.update(v).unwrap()).collect();
        let keep: Vec<usize> = steps.iter().filter(|s| s.chosen).map(|s| s.number).collect();
        let codes: Vec<bool> = steps.iter().filter_map(|s| s.code).collect();
        prop_assert_eq!(keep, batch.keep);
        prop_assert_eq!(codes, batch.codes);
    }

    #[test]
    fn what_is_chosen_keeps_rules_one_and_two(
        gaps in prop::collection::vec(1.0..90.0_f64, 20..150),
        wave in 400.0..5000.0_f64,
        amplitude in 0.0..60.0_f64,
        cell in 20.0..150.0_f64,
        quantum in 0.5..15.0_f64,
    ) {
        let along: Vec<f64> = gaps.iter().scan(0.0, |s, g| { *s += g; Some(*s) }).collect();
        let values: Vec<f64> = along.iter().map(|s| amplitude * (s / wave * std::f64::consts::TAU).sin()).collect();
        let rules = SequenceRules { quantum, cell_m: cell, min_cells: 1.0, energy_share: 0.96 };
        let chosen = choose_sequence(&along, &values, &rules).unwrap();
        let mut widest: f64 = 0.0;
        let mut from = along[0];
        for pair in chosen.keep.windows(2) {
            prop_assert!(along[pair[1]] - along[pair[0]] >= cell * (1.0 - 1e-9), "rule 2");
        }
        for &k in &chosen.keep {
            widest = widest.max(along[k] - from);
            from = along[k];
        }
        if chosen.sampled_enough {
            prop_assert!(widest <= chosen.greatest_gap_m, "rule 1: {widest} over {}", chosen.greatest_gap_m);
        } else {
            // Only a track, or cells, coarser than the field allows are an excuse.
            let coarsest = gaps.iter().copied().fold(0.0, f64::max) + cell;
            prop_assert!(coarsest > chosen.greatest_gap_m);
        }
        prop_assert!(chosen.filled.iter().all(|f| chosen.keep.contains(f)));
    }
}

#[test]
fn bandwidth_of_known_waves() {
    let n = 400;
    let two = |k: usize| {
        let s = 50.0 * k as f64;
        10.0 * (s / 2000.0 * std::f64::consts::TAU).sin() + 1.0 * (s / 500.0 * std::f64::consts::TAU).sin() + 48_000.0
    };
    let values: Vec<f64> = (0..n).map(two).collect();
    // The small wave holds 1 % of the energy: within 96 % is the long one, within 99.9 % both.
    assert!((energy_bandwidth(&values, 50.0, 0.96).unwrap() - 1.0 / 2000.0).abs() < 1e-12);
    assert!((energy_bandwidth(&values, 50.0, 0.999).unwrap() - 1.0 / 500.0).abs() < 1e-12);
    assert_eq!(energy_bandwidth(&[7.0; 50], 50.0, 0.96).unwrap(), 0.0);
    assert!(energy_bandwidth(&[1.0, 2.0], 50.0, 0.96).is_err());
}

fn rough() -> (GridMap, Track) {
    let axis: Vec<f64> = (0..201).map(|i| 250.0 * f64::from(i)).collect();
    let field = |x: f64, y: f64| 150.0 * (x / 5100.0).sin() * (y / 6100.0).cos() + 90.0 * ((x - y) / 4100.0).cos();
    let values = axis.iter().flat_map(|&y| axis.iter().map(move |&x| field(x, y))).collect();
    let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap();
    let (x, y): (Vec<f64>, Vec<f64>) =
        (0..120).map(|k| (8000.0 + 230.0 * f64::from(k), 9000.0 + 170.0 * f64::from(k))).unzip();
    let values = x.iter().zip(&y).map(|(&x, &y)| field(x, y)).collect();
    (map, Track::new(x, y, values, None).unwrap())
}

#[test]
fn swarm_finds_the_exhaustive_optimum() {
    let (map, track) = rough();
    let options = TuneOptions { max_length: Some(31), draws: 6, sigma: 1.0, ..Default::default() };
    let all = tune_sequence(&map, &track, &options, &TuneMethod::Exhaustive, &Quiet).unwrap();
    assert_eq!(all.settings.len(), 29 * 15);
    assert!(all.settings.iter().all(|s| s.objective >= all.best.objective));
    let space = SettingSpace { lengths: 3..=31, quanta: 15 };
    let near = (0..100)
        .filter(|&seed| {
            let found = bpso(&space, &BpsoOptions::default(), seed, &mut |_, length, quantum| {
                Ok(all.settings[(length - 3) * 15 + quantum].objective)
            })
            .unwrap();
            found.objective <= 1.01 * all.best.objective
        })
        .count();
    assert!(near >= 95, "{near} of 100");
    // The same search through the front door sees the same objective.
    let swarm = tune_sequence(&map, &track, &options, &TuneMethod::Bpso(BpsoOptions::default()), &Quiet).unwrap();
    let same = all.settings.iter().find(|s| s.length == swarm.best.length && s.quantum == swarm.best.quantum).unwrap();
    assert_eq!(same.objective, swarm.best.objective);
    assert!(swarm.settings.len() <= all.settings.len());
}

#[test]
fn tuning_is_seeded_and_refuses_nonsense() {
    let (map, track) = rough();
    let options = TuneOptions { max_length: Some(8), quanta: vec![2.0, 4.0], draws: 4, ..Default::default() };
    let run = |o: &TuneOptions| tune_sequence(&map, &track, o, &TuneMethod::Exhaustive, &Quiet);
    assert_eq!(run(&options).unwrap(), run(&options).unwrap());
    for bad in [
        TuneOptions { quanta: vec![], ..options.clone() },
        TuneOptions { quanta: vec![2.0, 2.0], ..options.clone() },
        TuneOptions { draws: 0, ..options.clone() },
        TuneOptions { max_length: Some(2), ..options.clone() },
        TuneOptions { error_range_m: Some([500.0, 250.0]), ..options.clone() },
    ] {
        assert!(matches!(run(&bad), Err(Error::Invalid { .. })), "{bad:?}");
    }
    let hopeless = TuneOptions { quanta: vec![1e6], ..options };
    assert!(matches!(run(&hopeless), Err(Error::TooFewSamples { .. })));
}
