use std::sync::Arc;

use approx::assert_relative_eq;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_pcg::Pcg64Mcg;

use super::*;
use crate::field::Field;
use crate::fix::Status;
use crate::grid::{GridMap, GridValues, MapSigma};
use crate::track::Track;

fn rough(seed: f64) -> GridMap {
    let axis: Vec<f64> = (0..121).map(|i| 100.0 * f64::from(i)).collect();
    let mut values = Vec::new();
    for y in &axis {
        for x in &axis {
            let (x, y) = (x / 1000.0 + seed, y / 1000.0);
            values.push(
                60.0 * (1.7 * x).sin() * (1.3 * y).cos()
                    + 40.0 * (2.9 * x + 1.1 * y).sin()
                    + 25.0 * (3.7 * y - 0.6 * x).cos(),
            );
        }
    }
    GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap()
}

/// A track whose true offset is (east, north), with noise and a bias.
fn flight(map: &GridMap, offset: [f64; 2], n: usize, sigma: f64, bias: f64, seed: u64) -> Track {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let heading: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let mut t = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..n {
        let s = 150.0 * (k as f64 - 0.5 * n as f64);
        let (x, y) = (6000.0 + s * heading.sin(), 6000.0 + s * heading.cos());
        let noise: f64 = rng.sample(StandardNormal);
        t.0.push(x - offset[0]);
        t.1.push(y - offset[1]);
        t.2.push(map.sample(x, y, crate::grid::Interpolation::Bilinear) + bias + sigma * noise);
    }
    Track::new(t.0, t.1, t.2, None).unwrap()
}

fn exact() -> GridMap {
    rough(0.0).with_sigma(Some(MapSigma::Constant(0.0))).unwrap()
}

#[test]
fn finds_the_offset_and_the_bias() {
    let map = exact();
    let track = flight(&map, [740.0, -310.0], 30, 0.5, 17.0, 3);
    let mut options = PosteriorOptions::new([1000.0, 1000.0]);
    options.tolerance_m = Some(100.0);
    let fix = match_posterior(&map, &track, Some(0.5), &options).unwrap();
    assert_eq!(fix.status, Status::Fixed);
    assert!((fix.offset_m[0] - 740.0).hypot(fix.offset_m[1] + 310.0) < 30.0, "{:?}", fix.offset_m);
    assert_relative_eq!(fix.bias.unwrap(), 17.0, epsilon = 2.0);
    assert!(fix.risk.unwrap() < 0.01 && fix.goodness.unwrap() > 1e-3);
}

#[test]
fn a_flat_field_is_no_fix() {
    let axis: Vec<f64> = (0..60).map(|i| 100.0 * f64::from(i)).collect();
    let map = GridMap::new(GridValues::F64(vec![3.0; 3600]), &axis, &axis, false).unwrap();
    let x: Vec<f64> = (0..20).map(|k| 2000.0 + 100.0 * f64::from(k)).collect();
    let track = Track::new(x, vec![3000.0; 20], vec![3.0; 20], None).unwrap();
    let fix = match_posterior(&map, &track, Some(1.0), &PosteriorOptions::new([1000.0, 1000.0])).unwrap();
    assert!(!fix.ok(), "{fix:?}");
    assert!(fix.risk.unwrap() > 0.5);
}

#[test]
fn a_track_of_another_place_is_rejected_or_not_fixed() {
    let map = exact();
    let mut fixed = 0;
    for seed in 0..20 {
        let track = flight(&rough(40.0), [0.0, 0.0], 30, 0.5, 0.0, seed);
        let fix = match_posterior(&map, &track, Some(0.5), &PosteriorOptions::new([1000.0, 1000.0])).unwrap();
        fixed += usize::from(fix.ok());
    }
    assert_eq!(fixed, 0);
}

#[test]
fn outliers_do_not_move_the_fix() {
    let map = exact();
    let track = flight(&map, [-420.0, 580.0], 40, 0.5, -30.0, 11);
    let mut values = track.values().to_vec();
    values[0] += 50.0;
    values[17] -= 50.0;
    let track = Track::new(track.x().to_vec(), track.y().to_vec(), values, None).unwrap();
    let fix = match_posterior(&map, &track, Some(0.5), &PosteriorOptions::new([1000.0, 1000.0])).unwrap();
    assert!(fix.ok());
    assert!((fix.offset_m[0] + 420.0).hypot(fix.offset_m[1] - 580.0) < 40.0, "{:?}", fix.offset_m);
}

#[test]
fn streaming_and_batch_agree_on_the_same_samples() {
    let map = exact();
    let track = flight(&map, [330.0, 610.0], 25, 0.5, 8.0, 5);
    let options = PosteriorOptions::new([1000.0, 1000.0]);
    let mut stream = PosteriorMatcher::new(Arc::new(map.clone()), Some(0.5), options.clone(), 100).unwrap();
    for k in 0..track.len() {
        stream.update(track.x()[k], track.y()[k], track.values()[k]).unwrap();
    }
    let streamed = stream.fix().unwrap();
    let batch = match_posterior(&map, &track, Some(0.5), &options).unwrap();
    assert_eq!(streamed.status, batch.status);
    assert_relative_eq!(streamed.offset_m[0], batch.offset_m[0], epsilon = 0.5);
    assert_relative_eq!(streamed.offset_m[1], batch.offset_m[1], epsilon = 0.5);
    assert_relative_eq!(streamed.risk.unwrap(), batch.risk.unwrap(), epsilon = 1e-4);
}

#[test]
fn a_saved_stream_goes_on_bit_for_bit() {
    let map: Arc<dyn Field> = Arc::new(exact());
    let track = flight(&exact(), [330.0, 610.0], 25, 0.5, 8.0, 5);
    let mut all = PosteriorOptions::new([1000.0; 2]);
    (all.heading_sigma_deg, all.scale_sigma, all.drift_sigma_m) = (2.0, 0.01, 100.0);
    for options in [PosteriorOptions::new([1000.0; 2]), all] {
        let mut first = PosteriorMatcher::new(map.clone(), Some(0.5), options, 100).unwrap();
        for k in 0..10 {
            first.update(track.x()[k], track.y()[k], track.values()[k]).unwrap();
        }
        let mut second = PosteriorMatcher::load(map.clone(), &first.save().unwrap()).unwrap();
        for k in 10..25 {
            let a = first.update(track.x()[k], track.y()[k], track.values()[k]).unwrap();
            let b = second.update(track.x()[k], track.y()[k], track.values()[k]).unwrap();
            assert_eq!(a.status, b.status);
            assert_eq!(a.risk.to_bits(), b.risk.to_bits());
        }
    }
}

#[test]
fn a_saved_stream_is_refused_by_another_map() {
    let mut stream =
        PosteriorMatcher::new(Arc::new(exact()), Some(0.5), PosteriorOptions::new([1000.0; 2]), 100).unwrap();
    stream.update(6000.0, 6000.0, 10.0).unwrap();
    let axis: Vec<f64> = (0..40).map(|i| 50.0 * f64::from(i)).collect();
    let finer = GridMap::new(GridValues::F64(vec![0.0; 1600]), &axis, &axis, false).unwrap();
    let refused = PosteriorMatcher::load(Arc::new(finer), &stream.save().unwrap());
    assert!(matches!(refused, Err(crate::error::Error::State { .. })));
}

#[test]
fn readings_that_have_nothing_to_do_with_the_map_are_rejected() {
    let bare = rough(0.0);
    let stated = bare.clone().with_sigma(Some(MapSigma::Constant(5.0))).unwrap();
    for (name, map) in [("exact", exact()), ("stated", stated), ("bare", bare)] {
        for n in [20, 40, 80] {
            let track = flight(&map, [0.0; 2], n, 1e5, 0.0, 7);
            let fix = match_posterior(&map, &track, Some(0.5), &PosteriorOptions::new([500.0; 2])).unwrap();
            assert_eq!(fix.status, Status::Rejected, "{name}, {n} samples: {:?}", fix.goodness);
            let right = flight(&map, [200.0, 100.0], n, 0.5, 0.0, 7);
            let fix = match_posterior(&map, &right, Some(0.5), &PosteriorOptions::new([500.0; 2])).unwrap();
            assert!(fix.goodness.unwrap() > 0.01, "{name}, {n} samples: {:?}", fix.goodness);
        }
    }
}

#[test]
fn goodness_is_a_p_value_on_a_right_map() {
    let map = exact();
    let goodness = |seed| {
        let track = flight(&map, [200.0, 100.0], 40, 0.5, 0.0, seed);
        let options = PosteriorOptions::new([300.0; 2]);
        match_posterior(&map, &track, Some(0.5), &options).unwrap().goodness.unwrap()
    };
    let all: Vec<f64> = (0..400).map(goodness).collect();
    for p in [0.01, 0.05, 0.2] {
        let share = all.iter().filter(|g| **g <= p).count() as f64 / 400.0;
        // Four standard deviations of a share, and never the other way: what is tested is that good tracks are kept.
        assert!(share <= p + 4.0 * (p * (1.0 - p) / 400.0).sqrt(), "{share} at {p}");
    }
}

#[test]
fn wild_readings_are_forgiven_up_to_one_in_five_and_not_when_half_are() {
    for map in [exact(), rough(0.0).with_sigma(Some(MapSigma::Constant(5.0))).unwrap()] {
        for (every, forgiven) in [(20, true), (5, true), (2, false)] {
            let right = flight(&map, [200.0, 100.0], 40, 0.5, 0.0, 7);
            let wild = |(k, v): (usize, &f64)| v + if k % every == 0 { 5e3 } else { 0.0 };
            let values = right.values().iter().enumerate().map(wild).collect();
            let track = Track::new(right.x().to_vec(), right.y().to_vec(), values, None).unwrap();
            let fix = match_posterior(&map, &track, Some(0.5), &PosteriorOptions::new([500.0; 2])).unwrap();
            assert_eq!(fix.status != Status::Rejected, forgiven, "one in {every}: {:?}", fix.goodness);
        }
    }
}

#[test]
fn a_second_field_that_is_nonsense_is_rejected() {
    let map = exact();
    let track = flight(&map, [200.0, 100.0], 40, 0.5, 0.0, 7);
    let other = flight(&map, [200.0, 100.0], 40, 1e5, 0.0, 8);
    let channel = |values| Channel { field: &map as &dyn Field, values, sigma: Some(0.5) };
    let options = PosteriorOptions::new([500.0; 2]);
    let fix = match_channels(&[channel(track.values()), channel(other.values())], &track, &options).unwrap();
    assert_eq!(fix.status, Status::Rejected);
}

#[test]
fn every_map_may_be_on_its_own_turn_of_longitude() {
    let plane = exact();
    let on_turn = |first: f64| {
        let x: Vec<f64> = (0..121).map(|i| first + 0.001 * f64::from(i)).collect();
        let y: Vec<f64> = (0..121).map(|i| 0.001 * f64::from(i)).collect();
        let values = (0..121 * 121).map(|i| plane.values().get(i)).collect();
        let map = GridMap::new(GridValues::F64(values), &x, &y, true).unwrap();
        map.with_sigma(Some(MapSigma::Constant(0.0))).unwrap()
    };
    let flown = flight(&plane, [400.0, -300.0], 30, 0.5, 0.0, 3);
    let longitude = flown.x().iter().map(|x| 179.95 + x * 1e-5).collect();
    let latitude = flown.y().iter().map(|y| y * 1e-5).collect();
    let track = Track::new(longitude, latitude, flown.values().to_vec(), None).unwrap();
    let (near, far) = (on_turn(179.95), on_turn(179.95 - 360.0));
    let options = PosteriorOptions::new([0.01; 2]);
    let fix = |second: &GridMap| {
        let both =
            [&near as &dyn Field, second].map(|field| Channel { field, values: track.values(), sigma: Some(0.5) });
        match_channels(&both, &track, &options).unwrap()
    };
    let (same, other) = (fix(&near), fix(&far));
    assert_eq!(same.status, Status::Fixed);
    assert_relative_eq!(same.offset[0], 0.004, epsilon = 5e-4);
    assert_eq!(other.status, Status::Fixed);
    assert_relative_eq!(other.offset[0], same.offset[0], epsilon = 1e-6);
    assert_relative_eq!(other.risk.unwrap(), same.risk.unwrap(), epsilon = 1e-6);
}

#[test]
fn declared_risk_holds_and_covariance_fits() {
    let map = exact();
    let mut options = PosteriorOptions::new([1000.0, 1000.0]);
    options.tolerance_m = Some(60.0);
    let (mut declared, mut wrong, mut fixed, mut nees) = (0.0, 0, 0, 0.0);
    let mut rng = Pcg64Mcg::seed_from_u64(99);
    for seed in 0..400 {
        let offset = [rng.random_range(-900.0..900.0), rng.random_range(-900.0..900.0)];
        let track = flight(&map, offset, 14, 3.0, 20.0, seed);
        let fix = match_posterior(&map, &track, Some(3.0), &options).unwrap();
        if !fix.ok() {
            continue;
        }
        fixed += 1;
        declared += fix.risk.unwrap();
        let e = [fix.offset_m[0] - offset[0], fix.offset_m[1] - offset[1]];
        wrong += usize::from(e[0].hypot(e[1]) > 60.0);
        let [[a, b], [_, d]] = fix.covariance_m2.unwrap();
        nees += (d * e[0] * e[0] - 2.0 * b * e[0] * e[1] + a * e[1] * e[1]) / (a * d - b * b);
    }
    assert!(fixed > 100, "{fixed}");
    assert!(wrong as f64 <= declared + 4.0 * (declared + 1.0_f64).sqrt(), "{wrong} wrong, {declared} declared");
    let mean = nees / f64::from(fixed);
    assert!(mean > 1.0 && mean < 3.0, "{mean}");
}

#[test]
fn two_channels_are_better_than_one() {
    let (one, two) = (exact(), rough(7.0).with_sigma(Some(MapSigma::Constant(0.0))).unwrap());
    let track = flight(&one, [100.0, 200.0], 12, 2.0, 0.0, 2);
    let second: Vec<f64> = (0..track.len())
        .map(|k| two.sample(track.x()[k] + 100.0, track.y()[k] + 200.0, crate::grid::Interpolation::Bilinear))
        .collect();
    let options = PosteriorOptions::new([1000.0, 1000.0]);
    let alone = match_posterior(&one, &track, Some(2.0), &options).unwrap();
    let channels = [
        Channel { field: &one as &dyn Field, values: track.values(), sigma: Some(2.0) },
        Channel { field: &two as &dyn Field, values: &second, sigma: Some(2.0) },
    ];
    let both = match_channels(&channels, &track, &options).unwrap();
    let size = |c: Option<[[f64; 2]; 2]>| c.map(|c| c[0][0] + c[1][1]).unwrap();
    assert!(size(both.covariance_m2) < size(alone.covariance_m2));
}

/// Maps of different character: rough, smooth with a trend, ridges, and one that is rough on one side and nearly flat on the other.
fn fields() -> Vec<(&'static str, GridMap)> {
    let draw = |value: &dyn Fn(f64, f64) -> f64| {
        let axis: Vec<f64> = (0..121).map(|i| 100.0 * f64::from(i)).collect();
        let values = axis.iter().flat_map(|y| axis.iter().map(move |x| value(x / 1000.0, y / 1000.0))).collect();
        GridMap::new(GridValues::F64(values), &axis, &axis, false)
            .unwrap()
            .with_sigma(Some(MapSigma::Constant(0.0)))
            .unwrap()
    };
    vec![
        ("rough", exact()),
        (
            "smooth",
            draw(&|x, y| 300.0 * (0.5 * x).sin() * (0.4 * y).cos() + 30.0 * (1.1 * x - 0.9 * y).sin() + 5.0 * y),
        ),
        ("ridges", draw(&|x, y| 80.0 * (1.9 * (x + 0.3 * y)).sin() + 25.0 * (2.3 * y + 0.4 * x).cos())),
        ("uneven", uneven()),
    ]
}

fn uneven() -> GridMap {
    let axis: Vec<f64> = (0..121).map(|i| 100.0 * f64::from(i)).collect();
    let mut values = Vec::new();
    for y in &axis {
        for x in &axis {
            let (x, y) = (x / 1000.0, y / 1000.0);
            let rough = 20.0 * (2.7 * x).sin() * (2.3 * y).cos() + 14.0 * (2.9 * x + 1.9 * y).sin();
            values.push(rough * (0.1 + 0.5 * (1.0 + ((x - 6.0) / 0.4).tanh())) + 4.0 * (1.3 * y).sin());
        }
    }
    GridMap::new(GridValues::F64(values), &axis, &axis, false)
        .unwrap()
        .with_sigma(Some(MapSigma::Constant(0.0)))
        .unwrap()
}

fn nees(covariance: [[f64; 2]; 2], e: [f64; 2]) -> f64 {
    let [[a, b], [_, d]] = covariance;
    (d * e[0] * e[0] - 2.0 * b * e[0] * e[1] + a * e[1] * e[1]) / (a * d - b * b)
}

#[test]
fn the_stages_find_what_one_fine_lattice_finds() {
    // A cell changes by several times the noise in one half of the map and by less than the noise in the other: a coarse density
    // takes the flat half, whatever is true.
    let map = uneven();
    let mut staged = PosteriorOptions::new([500.0, 500.0]);
    staged.tolerance_m = Some(60.0);
    let whole = PosteriorOptions { step: Some([6.25, 6.25]), ..staged.clone() };
    // Away from the border, over which the stages reach by half a cell to see what lies beyond it.
    let mut rng = Pcg64Mcg::seed_from_u64(5);
    let (mut sure, mut worst) = (0, 0.0_f64);
    for seed in 0..60 {
        let offset = [rng.random_range(-320.0..320.0), rng.random_range(-320.0..320.0)];
        let track = flight(&map, offset, 18, 1.5, 0.0, seed);
        let a = match_posterior(&map, &track, Some(1.5), &staged).unwrap();
        let b = match_posterior(&map, &track, Some(1.5), &whole).unwrap();
        let (ra, rb) = (a.risk.unwrap(), b.risk.unwrap());
        // Above that the stages may end early: nothing is declared there.
        if ra.min(rb) < 0.1 {
            worst = worst.max((ra - rb).abs());
            assert!((ra - rb).abs() < 0.04, "seed {seed}: risk {ra} in stages, {rb} at once");
        }
        if rb < 0.05 {
            sure += 1;
            let apart = (a.offset_m[0] - b.offset_m[0]).hypot(a.offset_m[1] - b.offset_m[1]);
            assert!(apart < 6.0, "seed {seed}: {apart} m apart");
        }
    }
    assert!(sure > 20, "{sure} of 60, worst {worst}");
}

#[test]
fn cells_that_nothing_tells_apart_do_not_multiply() {
    // Cells ten thousand times as long as wide, as beside a pole, and readings of no use: every bound is the same at every stage.
    let (x, y): (Vec<f64>, Vec<f64>) = (0..9).map(|i| (0.01 * f64::from(i), 100.0 * f64::from(i))).unzip();
    let map = GridMap::new(GridValues::F64(vec![1.0; 81]), &x, &y, false).unwrap();
    let at = |by: f64| (0..6).map(|k| by * (4.0 + 0.1 * f64::from(k))).collect::<Vec<f64>>();
    let track = Track::new(at(0.01), at(100.0), vec![0.5, 0.4, -1.0, -0.4, -0.4, -20.0], None).unwrap();
    for half_width in [[1e-5, 40.0], [0.02, 40.0], [0.02, 200.0]] {
        let options = PosteriorOptions::new(half_width);
        let fix = match_posterior(&map, &track, Some(2.0), &options).unwrap();
        assert!(!fix.ok(), "{half_width:?}: {fix:?}");
        assert!(fix.iterations < 20, "{half_width:?}: {} stages", fix.iterations);
    }
}

#[test]
fn the_stages_lose_nothing_when_heading_and_drift_are_unknown() {
    let map = uneven();
    let mut staged = PosteriorOptions::new([400.0, 400.0]);
    staged.tolerance_m = Some(80.0);
    staged.heading_sigma_deg = 1.0;
    staged.drift_sigma_m = 40.0;
    let whole = PosteriorOptions { step: Some([12.5, 12.5]), ..staged.clone() };
    let mut rng = Pcg64Mcg::seed_from_u64(6);
    for seed in 0..30 {
        let offset = [rng.random_range(-220.0..220.0), rng.random_range(-220.0..220.0)];
        let track = flight(&map, offset, 14, 1.5, 3.0, seed);
        let a = match_posterior(&map, &track, Some(1.5), &staged).unwrap();
        let b = match_posterior(&map, &track, Some(1.5), &whole).unwrap();
        let (ra, rb) = (a.risk.unwrap(), b.risk.unwrap());
        assert!(ra.min(rb) > 0.1 || (ra - rb).abs() < 0.04, "seed {seed}: risk {ra} in stages, {rb} at once");
    }
}

#[test]
fn errors_of_fixes_reach_the_bound() {
    for (name, map) in fields() {
        let mut options = PosteriorOptions::new([500.0, 500.0]);
        options.tolerance_m = Some(200.0);
        let (mut sum, mut count, mut declared) = (0.0, 0, 0.0);
        for seed in 0..220 {
            let track = flight(&map, [0.0, 0.0], 30, 1.0, 5.0, 1000 + seed);
            let bound = predict(&map, &track, Some(1.0), &options, 0, 0).unwrap().bound_m2;
            let fix = match_posterior(&map, &track, Some(1.0), &options).unwrap();
            if fix.ok() {
                sum += nees(bound, fix.offset_m);
                declared += nees(fix.covariance_m2.unwrap(), fix.offset_m);
                count += 1;
            }
        }
        assert!(count > 120, "{name}: {count}");
        // Root mean square error over the bound, in the bound's own metric: at most 1.15, and not below 1 by more than chance.
        let ratio = (sum / (2.0 * f64::from(count))).sqrt();
        let chance = 4.0 * 0.5 / f64::from(count).sqrt();
        assert!(ratio < 1.15 && ratio > 1.0 - chance, "{name}: {ratio}");
        let declared = declared / f64::from(count);
        assert!((declared - 2.0).abs() < 4.0 * 2.0 / f64::from(count).sqrt(), "{name}: normalised error {declared}");
    }
}

#[test]
fn prediction_and_outcome_agree() {
    for (name, map) in fields() {
        let mut options = PosteriorOptions::new([500.0, 500.0]);
        options.tolerance_m = Some(300.0);
        let (mut sum, mut count) = (0.0, 0);
        for seed in 0..160 {
            let track = flight(&map, [0.0, 0.0], 30, 1.0, 5.0, seed);
            let expected = predict(&map, &track, Some(1.0), &options, 0, 0).unwrap();
            let fix = match_posterior(&map, &track, Some(1.0), &options).unwrap();
            if fix.ok() {
                sum += nees(expected.covariance_m2, fix.offset_m);
                count += 1;
            }
        }
        assert!(count > 100, "{name}: {count}");
        // Mean of chi-square with two degrees of freedom over `count` draws, four standard errors.
        let mean = sum / f64::from(count);
        assert!((mean - 2.0).abs() < 4.0 * 2.0 / f64::from(count).sqrt(), "{name}: {mean}");
    }
}

#[test]
fn bad_options_are_refused_before_memory_is_taken() {
    let map = exact();
    let track = flight(&map, [0.0, 0.0], 5, 1.0, 0.0, 0);
    for change in [
        |o: &mut PosteriorOptions| o.half_width = [0.0, 1.0],
        |o: &mut PosteriorOptions| o.max_risk = 1.5,
        |o: &mut PosteriorOptions| o.step = Some([1e-9, 1e-9]),
        |o: &mut PosteriorOptions| o.tolerance_m = Some(f64::NAN),
        |o: &mut PosteriorOptions| o.min_overlap = 0.0,
    ] {
        let mut options = PosteriorOptions::new([1000.0, 1000.0]);
        change(&mut options);
        assert!(match_posterior(&map, &track, None, &options).is_err());
    }
}
