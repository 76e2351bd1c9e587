//! Contour points, transforms, ICCP and its refinement against independent answers.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use approx::assert_abs_diff_eq;
use geomag_core::error::Error;
use geomag_core::field::Field;
use geomag_core::fix::Status;
use geomag_core::grid::{GridMap, GridValues, MapSigma};
use geomag_core::matching::closest::closest_contour_point;
use geomag_core::matching::contour::{ContourOptions, match_channels, match_contour};
use geomag_core::matching::refine::RefineOptions;
use geomag_core::matching::scene::{Channel, Priors};
use geomag_core::matching::sliding::SlidingState;
use geomag_core::matching::starts::Starts;
use geomag_core::matching::transform::{Transform, TransformKind};
use geomag_core::track::Track;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

fn axis(n: usize, step: f64) -> Vec<f64> {
    (0..n).map(|i| step * i as f64).collect()
}

/// Every segment of marching squares, looked at one by one: the naive oracle of the ring search.
fn closest_by_brute_force(map: &GridMap, x: f64, y: f64, value: f64, radius: f64) -> Option<f64> {
    let (sx, sy) = (map.x().step(), map.y().step());
    let mut best: Option<f64> = None;
    for row in 0..map.y().len() - 1 {
        for column in 0..map.x().len() - 1 {
            let corners = [
                ([0.0, 0.0], map.node(row, column)),
                ([1.0, 0.0], map.node(row, column + 1)),
                ([1.0, 1.0], map.node(row + 1, column + 1)),
                ([0.0, 1.0], map.node(row + 1, column)),
            ];
            if corners.iter().any(|c| c.1.is_nan()) {
                continue;
            }
            // Crossings in order around the cell; side i runs from corner i to corner i + 1.
            let crossings: Vec<(usize, [f64; 2])> = (0..4)
                .filter_map(|i| {
                    let ((p, a), (q, b)) = (corners[i], corners[(i + 1) % 4]);
                    let t = (value - a) / (b - a);
                    ((a > value) != (b > value)).then(|| (i, [p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]))
                })
                .collect();
            let pairs: Vec<[usize; 2]> = match crossings.len() {
                0 => vec![],
                2 => vec![[0, 1]],
                4 => {
                    let mean = corners.iter().map(|c| c.1).sum::<f64>() / 4.0;
                    // Corner 1 lies between sides 0 and 1: it is cut off unless it is on the mean's side.
                    if (corners[1].1 > value) == (mean > value) { vec![[3, 0], [1, 2]] } else { vec![[0, 1], [2, 3]] }
                }
                n => panic!("{n} crossings"),
            };
            for [i, j] in pairs {
                let place = |c: [f64; 2]| {
                    let px = map.x().first() + (column as f64 + c[0]) * sx;
                    let py = map.y().first() + (row as f64 + c[1]) * sy;
                    [px - x, py - y]
                };
                let (p, q) = (place(crossings[i].1), place(crossings[j].1));
                let d = [q[0] - p[0], q[1] - p[1]];
                let square = d[0] * d[0] + d[1] * d[1];
                let t = if square > 0.0 { (-(p[0] * d[0] + p[1] * d[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
                let distance = (p[0] + t * d[0]).hypot(p[1] + t * d[1]);
                if distance <= radius && best.is_none_or(|b| distance < b) {
                    best = Some(distance);
                }
            }
        }
    }
    best
}

proptest! {
    #[test]
    fn ring_search_agrees_with_every_segment_looked_at(
        seed in 0_u64..1000,
        x in -900.0..2900.0_f64,
        y in -900.0..2900.0_f64,
        value in -1.2..1.2_f64,
        radius in 30.0..4000.0_f64,
        stretch in 0.2..5.0_f64,
        holes in 0.0..0.3_f64,
    ) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let n = 21;
        let values: Vec<f64> = (0..n * n)
            .map(|_| if rng.random::<f64>() < holes { f64::NAN } else { 2.0 * rng.random::<f64>() - 1.0 })
            .collect();
        prop_assume!(values.iter().any(|v| !v.is_nan()));
        let map = GridMap::new(GridValues::F64(values), &axis(n, 100.0), &axis(n, 100.0 * stretch), false).unwrap();
        let found = closest_contour_point(&map, x, y, value, radius).unwrap();
        let brute = closest_by_brute_force(&map, x, y, value, radius);
        match (found, brute) {
            (None, None) => {}
            (Some(f), Some(d)) => {
                prop_assert!((f.distance_m - d).abs() < 1e-7, "{} against {d}", f.distance_m);
                prop_assert!(((f.x - x).hypot(f.y - y) - d).abs() < 1e-7);
            }
            (f, b) => {
                // A contour at the radius to the last bit may fall on either side.
                let d = f.map(|f| f.distance_m).or(b).unwrap();
                prop_assert!((d - radius).abs() < 1e-9, "{f:?} against {b:?}");
            }
        }
    }

    #[test]
    fn transforms_recover_what_made_the_points(
        rotation in -3.0..3.0_f64, scale in 0.5..2.0_f64, e in -1e4..1e4_f64, n in -1e4..1e4_f64, seed in 0_u64..500,
    ) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let from: Vec<[f64; 2]> = (0..6).map(|_| [1e3 * rng.random::<f64>(), 1e3 * rng.random::<f64>()]).collect();
        let similarity = Transform::similarity(rotation, scale, [e, n]);
        let to: Vec<[f64; 2]> = from.iter().map(|&p| similarity.apply(p)).collect();
        let weights: Vec<f64> = from.iter().map(|_| 0.1 + rng.random::<f64>()).collect();
        for kind in [TransformKind::Similarity, TransformKind::Affine] {
            let fitted = Transform::fit(kind, &from, &to, Some(&weights)).unwrap();
            for (p, q) in from.iter().zip(&to) {
                let got = fitted.apply(*p);
                prop_assert!((got[0] - q[0]).hypot(got[1] - q[1]) < 1e-5);
            }
        }
        let rigid = Transform::fit(TransformKind::Rigid, &from, &to, Some(&weights)).unwrap();
        prop_assert!((rigid.rotation_rad() - rotation).sin().abs() < 1e-9);
        prop_assert!((rigid.scale() - 1.0).abs() < 1e-12);
    }
}

#[test]
fn transforms_refuse_what_does_not_determine_them() {
    let line = [[0.0, 0.0], [10.0, 20.0], [30.0, 60.0], [50.0, 100.0]];
    let fit = |kind, points: &[[f64; 2]]| Transform::fit(kind, points, points, None);
    assert!(matches!(fit(TransformKind::Affine, &line), Err(Error::RankDeficient { rank: 1, needed: 2, .. })));
    assert!(matches!(fit(TransformKind::Affine, &line[..2]), Err(Error::TooFewSamples { needed: 3, got: 2, .. })));
    assert!(matches!(fit(TransformKind::Rigid, &[[5.0, 5.0]; 4]), Err(Error::RankDeficient { rank: 0, .. })));
    assert!(matches!(fit(TransformKind::Rigid, &line[..1]), Err(Error::TooFewSamples { needed: 2, got: 1, .. })));
    assert!(fit(TransformKind::Translation, &line[..1]).is_ok());
    assert!(fit(TransformKind::Similarity, &line).is_ok());
    let weights = [1.0, 0.0, 0.0, 0.0];
    assert!(matches!(
        Transform::fit(TransformKind::Rigid, &line, &line, Some(&weights)),
        Err(Error::TooFewSamples { got: 1, .. })
    ));
    assert!(matches!(
        Transform::fit(TransformKind::Rigid, &line, &line, Some(&[1.0, 1.0, -1.0, 1.0])),
        Err(Error::Invalid { .. })
    ));
}

fn field(x: f64, y: f64) -> f64 {
    120.0 * (x / 1700.0).sin() * (y / 2300.0).cos() + 80.0 * ((x + 2.0 * y) / 3100.0).cos() + 0.01 * x
}

fn other_field(x: f64, y: f64) -> f64 {
    40.0 * (y / 1900.0).sin() + 30.0 * ((2.0 * x - y) / 2900.0).cos()
}

fn map_of(f: impl Fn(f64, f64) -> f64) -> GridMap {
    let axis = axis(161, 250.0);
    let f = &f;
    let values = axis.iter().flat_map(|&y| axis.iter().map(move |&x| f(x, y))).collect();
    GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap()
}

/// Indicated track of 22 points whose truth is turned by `heading_deg` clockwise about the newest and moved by `offset`.
fn flown(offset: [f64; 2], heading_deg: f64, noise: f64, seed: u64) -> (Track, [f64; 2], Vec<f64>) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let end = [26_000.0, 24_000.0];
    let (mut x, mut y, mut values, mut others) = (vec![], vec![], vec![], vec![]);
    for k in 0..22 {
        let d = 840.0 * f64::from(21 - k);
        let (sin, cos) = 0.7_f64.sin_cos();
        let (ts, tc) = (0.7 + heading_deg.to_radians()).sin_cos();
        let truth = [end[0] - d * ts, end[1] - d * tc];
        x.push(end[0] - offset[0] - d * sin);
        y.push(end[1] - offset[1] - d * cos);
        let mut z = || -> f64 { StandardNormal.sample(&mut rng) };
        values.push(field(truth[0], truth[1]) + noise * z());
        others.push(other_field(truth[0], truth[1]) + noise * z());
    }
    (Track::new(x, y, values, None).unwrap(), end, others)
}

fn tight(transform: TransformKind) -> ContourOptions {
    ContourOptions { transform, converged_m: 1e-3, max_iterations: 20_000, radius_m: 4000.0, ..Default::default() }
}

#[test]
fn every_kind_of_transform_finds_a_clean_offset() {
    let map = map_of(field);
    let (track, end, _) = flown([450.0, -380.0], 0.0, 0.0, 1);
    for kind in [TransformKind::Translation, TransformKind::Rigid, TransformKind::Similarity] {
        for acceleration in [0, 4] {
            let fix = match_contour(&map, &track, None, &ContourOptions { acceleration, ..tight(kind) }).unwrap();
            assert!(fix.ok(), "{kind:?} {fix:?}");
            assert!((fix.x - end[0]).hypot(fix.y - end[1]) < 40.0, "{kind:?} {acceleration} {fix:?}");
            assert_eq!(fix.covariance_m2, None);
            assert_eq!(fix.risk, None);
            assert_eq!(fix.track.len(), 22);
        }
    }
}

#[test]
fn refinement_finds_offset_heading_scale_and_bias_with_honest_covariance() {
    let map = map_of(field);
    let priors =
        Priors { offset_sigma_m: Some(560.0), heading_sigma_deg: Some(0.5), scale_sigma: None, bias_sigma: Some(20.0) };
    let options = ContourOptions {
        refine: true,
        starts: Starts::grid(1500.0, 250.0),
        refinement: RefineOptions { priors, ..Default::default() },
        ..Default::default()
    };
    let mut total = 0.0;
    let runs = 200;
    let mut rng = Pcg64::seed_from_u64(5);
    for seed in 0..runs {
        let mut z = || -> f64 { StandardNormal.sample(&mut rng) };
        let (offset, heading, bias) = ([560.0 * z(), 560.0 * z()], 0.5 * z(), 20.0 * z());
        let (track, end, _) = flown(offset, heading, 1.0, seed);
        let values: Vec<f64> = track.values().iter().map(|v| v + bias).collect();
        let track = Track::new(track.x().to_vec(), track.y().to_vec(), values, None).unwrap();
        let fix = match_contour(&map, &track, Some(1.0), &options).unwrap();
        let Some([[a, b], [_, d]]) = fix.covariance_m2 else { panic!("{fix:?}") };
        let (e, n) = (fix.x - end[0], fix.y - end[1]);
        total += (d * e * e - 2.0 * b * e * n + a * n * n) / (a * d - b * b);
    }
    // Sum of 200 chi-square variables of two degrees of freedom: 400, standard deviation 28.
    assert!((total - 400.0).abs() < 5.0 * 28.3, "normalised errors {total} where 400 is expected");
}

#[test]
fn refinement_says_when_it_is_not_sure() {
    let (track, _, _) = flown([300.0, 200.0], 0.0, 1.0, 9);
    let priors = Priors { offset_sigma_m: Some(560.0), ..Default::default() };
    let options = |priors| ContourOptions {
        transform: TransformKind::Translation,
        refine: true,
        starts: Starts::grid(1500.0, 250.0),
        refinement: RefineOptions { priors, ..Default::default() },
        ..Default::default()
    };
    // A slope has one gradient only: nothing is learnt along its contours.
    let slope = map_of(|x, _| 0.02 * x);
    let values = track.x().iter().map(|x| 0.02 * (x + 300.0)).collect();
    let flat = Track::new(track.x().to_vec(), track.y().to_vec(), values, None).unwrap();
    let fix = match_contour(&slope, &flat, Some(1.0), &options(priors)).unwrap();
    assert_eq!(fix.status, Status::Uninformative);
    let [[east, _], [_, north]] = fix.covariance_m2.unwrap();
    assert!(east.sqrt() < 30.0 && (north.sqrt() - 560.0).abs() < 1.0);
    let no_priors = ContourOptions { transform: TransformKind::Rigid, ..options(Priors::default()) };
    assert_eq!(match_contour(&slope, &flat, Some(1.0), &no_priors).unwrap().status, Status::Uninformative);
    // Another field than the map's: the residuals are not what sigma says.
    let fix = match_contour(&map_of(other_field), &track, Some(1.0), &options(priors)).unwrap();
    assert_eq!(fix.status, Status::Rejected);
    assert!(fix.goodness.unwrap() < 1e-3);
    // The truth beyond the lattice.
    let (far, _, _) = flown([1900.0, 0.0], 0.0, 0.1, 3);
    let fix = match_contour(&map_of(field), &far, Some(0.1), &options(Priors::default())).unwrap();
    assert!(!fix.ok() && fix.status == Status::AtEdge, "{fix:?}");
}

#[test]
fn map_sigma_widens_the_answer() {
    let (track, _, _) = flown([300.0, 200.0], 0.0, 1.0, 9);
    let options = ContourOptions {
        refine: true,
        refinement: RefineOptions {
            priors: Priors { offset_sigma_m: Some(560.0), ..Default::default() },
            ..Default::default()
        },
        ..Default::default()
    };
    let spread = |map: &GridMap| {
        let c = match_contour(map, &track, Some(1.0), &options).unwrap().covariance_m2.unwrap();
        (c[0][0] + c[1][1]).sqrt()
    };
    let plain = spread(&map_of(field));
    let poor = spread(&map_of(field).with_sigma(Some(MapSigma::Constant(10.0))).unwrap());
    assert!(poor > 3.0 * plain, "{poor} against {plain}");
}

#[test]
fn two_fields_beat_one() {
    let (map, other) = (map_of(field), map_of(other_field));
    let mut sum = [0.0; 2];
    for seed in 0..40 {
        let (track, end, others) = flown([400.0, 300.0], 0.0, 2.0, seed);
        let one = [Channel { field: &map, values: track.values(), sigma: Some(2.0) }];
        let two = [one[0], Channel { field: &other, values: &others, sigma: Some(2.0) }];
        for (i, channels) in [&one[..], &two[..]].into_iter().enumerate() {
            let fix = match_channels(channels, &track, None, &tight(TransformKind::Translation)).unwrap();
            sum[i] += (fix.x - end[0]).hypot(fix.y - end[1]);
        }
    }
    assert!(sum[1] < 0.8 * sum[0], "{sum:?}");
    let (track, _, others) = flown([400.0, 300.0], 0.0, 2.0, 0);
    let no_sigma = [
        Channel { field: &map, values: track.values(), sigma: None },
        Channel { field: &other, values: &others, sigma: Some(2.0) },
    ];
    assert!(matches!(match_channels(&no_sigma, &track, None, &ContourOptions::default()), Err(Error::Invalid { .. })));
}

#[test]
fn statuses_and_errors() {
    let map = map_of(field);
    let (track, _, _) = flown([400.0, 300.0], 0.0, 0.0, 1);
    let with = |values: Vec<f64>| Track::new(track.x().to_vec(), track.y().to_vec(), values, None).unwrap();
    // No contour in reach.
    let fix = match_contour(&map, &with(vec![1e6; 22]), None, &ContourOptions::default()).unwrap();
    assert_eq!(fix.status, Status::Lost);
    assert!(fix.x.is_nan() && !fix.ok());
    // A point or two out of reach are left out and counted.
    let mut values = track.values().to_vec();
    values[3] = 1e6;
    values[11] = -1e6;
    let fix = match_contour(&map, &with(values), None, &tight(TransformKind::Translation)).unwrap();
    assert!(fix.ok() && fix.n_samples == 20, "{fix:?}");
    // One point: a translation that puts it on its contour, anywhere along it; an error for a rotation.
    let one = track.slice(5..6).unwrap();
    let fix = match_contour(&map, &one, None, &tight(TransformKind::Translation)).unwrap();
    assert_eq!(fix.status, Status::Uninformative);
    let refused = match_contour(&map, &one, None, &ContourOptions::default());
    assert!(matches!(refused, Err(Error::TooFewSamples { needed: 2, got: 1, .. })));
    // A straight track under an affine transform.
    let refused = match_contour(&map, &track, None, &tight(TransformKind::Affine));
    assert!(matches!(refused, Err(Error::RankDeficient { .. })));
    // The iteration limit.
    let few = ContourOptions { max_iterations: 3, converged_m: 1e-6, ..Default::default() };
    assert_eq!(match_contour(&map, &track, None, &few).unwrap().status, Status::NotConverged);
    // Options.
    for bad in [
        ContourOptions { radius_m: -1.0, ..Default::default() },
        ContourOptions { radius_m: f64::NAN, ..Default::default() },
        ContourOptions { converged_m: 0.0, ..Default::default() },
        ContourOptions { stiffness: -1.0, ..Default::default() },
        ContourOptions { max_iterations: 0, ..Default::default() },
        ContourOptions { starts: Starts::Offsets(vec![]), ..Default::default() },
    ] {
        assert!(matches!(match_contour(&map, &track, None, &bad), Err(Error::Invalid { .. })), "{bad:?}");
    }
    let huge = ContourOptions { starts: Starts::grid(1e9, 1.0), ..Default::default() };
    assert!(matches!(match_contour(&map, &track, None, &huge), Err(Error::TooManyCandidates { .. })));
}

#[test]
fn stiffness_holds_the_answer_near_the_ins() {
    let map = map_of(field);
    let (track, _, _) = flown([400.0, 300.0], 0.0, 0.0, 1);
    let length = |stiffness| {
        let options = ContourOptions { stiffness, ..tight(TransformKind::Translation) };
        let fix = match_contour(&map, &track, None, &options).unwrap();
        fix.offset_m[0].hypot(fix.offset_m[1])
    };
    let (free, held, rigid) = (length(0.0), length(0.5), length(1e6));
    assert!((free - 500.0).abs() < 20.0 && held < free && rigid < 0.01, "{free} {held} {rigid}");
}

#[test]
fn geographic_and_projected_maps_give_the_same_answer() {
    let projected = map_of(field);
    let (track, end, _) = flown([450.0, -380.0], 0.0, 0.0, 1);
    // The same field laid on degrees at 55 north, where a degree of longitude is little over half one of latitude.
    let [east, north] = geomag_core::frame::metres_per_degree(55.2);
    let (lon, lat) = (axis(161, 250.0 / east), axis(161, 250.0 / north));
    let lat: Vec<f64> = lat.iter().map(|l| 55.0 + l).collect();
    let GridValues::F64(values) = projected.values().clone() else { panic!() };
    let map = GridMap::new(GridValues::F64(values), &lon, &lat, true).unwrap();
    let degrees = Track::new(
        track.x().iter().map(|x| x / east).collect(),
        track.y().iter().map(|y| 55.0 + y / north).collect(),
        track.values().to_vec(),
        None,
    )
    .unwrap();
    for kind in [TransformKind::Translation, TransformKind::Rigid] {
        let fix = match_contour(&map, &degrees, None, &tight(kind)).unwrap();
        let [e, n] = geomag_core::frame::displacement_m(true, [end[0] / east, 55.0 + end[1] / north], [fix.x, fix.y]);
        assert!(fix.ok() && e.hypot(n) < 40.0, "{kind:?} {e} {n} {fix:?}");
        assert_abs_diff_eq!(fix.offset[0] * map.metres_per_unit(fix.y)[0], fix.offset_m[0], epsilon = 0.5);
    }
}

#[test]
fn sliding_window_goes_on_bit_for_bit_from_a_saved_state() {
    let map = map_of(field);
    let (track, _, _) = flown([300.0, 250.0], 0.0, 1.0, 4);
    let fresh = || SlidingState::new(12, Some(1.0), 10.0, tight(TransformKind::Rigid)).unwrap();
    let (mut whole, mut parts) = (fresh(), fresh());
    for k in 0..track.len() {
        let [x, y] = track.point(k);
        let bytes = geomag_core::state::save(&parts).unwrap();
        parts = geomag_core::state::load(&bytes).unwrap();
        let (a, b) = (
            whole.update(&map, x, y, track.values()[k]).unwrap(),
            parts.update(&map, x, y, track.values()[k]).unwrap(),
        );
        assert_eq!(format!("{a:?}"), format!("{b:?}"));
        assert_eq!(a.status == Status::Searching, k < 11);
    }
    assert_eq!(whole.settled(), parts.settled());
    assert_eq!(whole.settled().unwrap().number, 9);
    assert_eq!(whole.averaged(&map).len(), 12);
    assert!(whole.update(&map, f64::NAN, 0.0, 0.0).is_err());
    assert_eq!(whole, parts);
}

#[test]
fn a_start_that_leaves_one_sample_on_the_map_does_not_win() {
    let map = map_of(field);
    let (track, end, _) = flown([400.0, 300.0], 0.0, 1.0, 5);
    // From all but the first start the oldest sample alone is on the map, and goes onto its contour as one always can.
    let mut starts = vec![[0.0, 0.0]];
    starts.extend((-28..48).map(|i| [500.0 * f64::from(i), 29_780.0]));
    let options = ContourOptions {
        min_points: Some(1),
        radius_m: 600.0,
        starts: Starts::Offsets(starts),
        ..tight(TransformKind::Translation)
    };
    let fix = match_contour(&map, &track, None, &options).unwrap();
    assert!(fix.ok() && (fix.x - end[0]).hypot(fix.y - end[1]) < 500.0, "{fix:?}");
}

#[test]
fn every_channel_has_its_share_of_samples_where_misfits_are_compared() {
    // The second map ends a little after the oldest samples, so that most starts have but few of its samples.
    let (map, whole) = (map_of(field), map_of(other_field));
    let (track, _, others) = flown([400.0, 300.0], 0.0, 1.0, 5);
    let short = axis(60, 250.0);
    let values = short.iter().flat_map(|&y| short.iter().map(move |&x| other_field(x, y))).collect();
    let corner = GridMap::new(GridValues::F64(values), &short, &short, false).unwrap();
    let options = ContourOptions { starts: Starts::grid(1000.0, 250.0), ..tight(TransformKind::Translation) };
    let status = |other: &GridMap| {
        let channels = [
            Channel { field: &map, values: track.values(), sigma: Some(1.0) },
            Channel { field: other, values: &others, sigma: Some(1.0) },
        ];
        match_channels(&channels, &track, None, &options).unwrap().status
    };
    assert_eq!(status(&whole), Status::Fixed);
    assert_eq!(status(&corner), Status::Lost);
}

#[test]
fn a_sliding_window_at_rest_says_so_and_goes_on() {
    let map = map_of(field);
    let mut window = SlidingState::new(8, Some(1.0), 10.0, tight(TransformKind::Rigid)).unwrap();
    let (track, end, _) = flown([300.0, 250.0], 0.0, 0.5, 4);
    let [x, y] = track.point(0);
    for k in 0..20 {
        let fix = window.update(&map, x, y, track.values()[0]).unwrap();
        assert_eq!(fix.status, if k < 7 { Status::Searching } else { Status::Uninformative });
        assert!(fix.x.is_nan() && fix.n_samples == (k + 1).min(8));
    }
    let mut last = None;
    for k in 1..track.len() {
        let [x, y] = track.point(k);
        last = Some(window.update(&map, x, y, track.values()[k]).unwrap());
    }
    let fix = last.unwrap();
    assert!(fix.ok() && (fix.x - end[0]).hypot(fix.y - end[1]) < 200.0, "{fix:?}");
    assert_eq!(window.count(), 20 + track.len() - 1);
}

#[test]
fn a_sliding_window_refuses_more_points_than_it_holds() {
    let options = |min_points| ContourOptions { min_points: Some(min_points), ..tight(TransformKind::Rigid) };
    assert!(matches!(SlidingState::new(3, None, 10.0, options(9)), Err(Error::Invalid { .. })));
    assert!(SlidingState::new(3, None, 10.0, options(3)).is_ok());
}

#[test]
fn a_sliding_window_says_that_its_search_was_too_narrow() {
    let map = map_of(field);
    let (track, end, _) = flown([1900.0, 0.0], 0.0, 0.1, 3);
    let last = |half_width_m: f64| {
        let options = ContourOptions { refine: true, starts: Starts::grid(half_width_m, 250.0), ..Default::default() };
        let mut window = SlidingState::new(20, Some(0.1), 10.0, options).unwrap();
        let fixes = (0..track.len()).map(|k| {
            let [x, y] = track.point(k);
            window.update(&map, x, y, track.values()[k]).unwrap()
        });
        fixes.skip(19).collect::<Vec<_>>()
    };
    for fix in last(1500.0) {
        assert_eq!(fix.status, Status::AtEdge, "{fix:?}");
    }
    let fixes = last(2500.0);
    assert!(fixes.iter().all(geomag_core::fix::Fix::ok) && (fixes[2].x - end[0]).abs() < 100.0, "{fixes:?}");
}

#[test]
fn where_the_error_of_the_map_is_unknown_it_is_as_a_hole() {
    let map = map_of(field);
    let (track, _, _) = flown([300.0, 200.0], 0.0, 1.0, 9);
    let options = ContourOptions { refine: true, starts: Starts::grid(1000.0, 250.0), ..Default::default() };
    let with = |unknown: &dyn Fn(usize) -> bool| {
        let layer = (0..map.values().len()).map(|i| if unknown(i) { f64::NAN } else { 1.0 }).collect();
        let map = map.clone().with_sigma(Some(MapSigma::Grid(layer))).unwrap();
        match_contour(&map, &track, Some(1.0), &options).unwrap()
    };
    assert!(with(&|_| false).ok());
    let nowhere = with(&|_| true);
    assert_eq!(nowhere.status, Status::Lost, "{nowhere:?}");
    // Unknown south of the oldest three samples or so.
    let part = with(&|i| i / 161 < 49);
    assert!(part.ok() && part.n_samples < 22 && part.n_samples >= 18, "{part:?}");
}
