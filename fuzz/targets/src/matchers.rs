//! Matchers over whole tracks.

use geomag_core::fix::{Fix, Status};
use geomag_core::grid::Interpolation;
use geomag_core::lattice::Pivot;
use geomag_core::matching::contour::{self, ContourOptions, match_contour};
use geomag_core::matching::grid_search::{GridSearch, match_grid};
use geomag_core::matching::posterior::{self, PosteriorOptions, match_posterior};
use geomag_core::matching::refine::RefineOptions;
use geomag_core::matching::scene::{Channel, Priors};
use geomag_core::matching::sequence::{
    DeltaModulator, SequenceRules, choose_sequence, chosen_by_codes, delta_modulation, energy_bandwidth,
};
use geomag_core::matching::similarity::{Criterion, Robust};
use geomag_core::matching::starts::Starts;
use geomag_core::matching::transform::{Transform, TransformKind};
use geomag_core::matching::tuning::{BpsoOptions, InsDraw, TuneMethod, TuneOptions, tune_sequence};
use geomag_core::monitor::Quiet;

use crate::maps;
use crate::source::{Source, assert_covariance, show};

const METHODS: [Interpolation; 2] = [Interpolation::Bilinear, Interpolation::Bicubic];

/// Asserts what holds of every answer, whatever its status.
pub fn assert_sound(fix: &Fix) {
    if fix.ok() {
        let numbers = [fix.x, fix.y, fix.offset[0], fix.offset[1], fix.offset_m[0], fix.offset_m[1]];
        assert!(numbers.iter().all(|v| v.is_finite()), "{fix:?}");
        assert!(fix.heading_deg.is_finite() && fix.scale.is_finite(), "{fix:?}");
        assert!(fix.track.iter().flatten().all(|v| v.is_finite()), "{fix:?}");
    }
    for v in [fix.x, fix.y, fix.offset[0], fix.offset[1], fix.offset_m[0], fix.offset_m[1]] {
        assert!(!v.is_infinite(), "{fix:?}");
    }
    for p in [fix.risk, fix.goodness].into_iter().flatten() {
        assert!((0.0..=1.0).contains(&p), "{fix:?}");
    }
    if let Some(c) = fix.covariance_m2 {
        assert_covariance("fix", c);
    }
    if let Some(surface) = &fix.surface {
        assert_eq!(surface.values.len(), surface.rows * surface.columns);
    }
    assert!(fix.risk.is_none() || fix.status != Status::Fixed || fix.risk <= Some(1.0));
}

/// A half width and a step of a search, map units, in cells of the map.
pub fn half_width(s: &mut Source<'_>, cell: [f64; 2], most: f64) -> [f64; 2] {
    [0, 1].map(|a| cell[a].abs() * s.number(0.0, most))
}

/// The grid search by every measure.
pub fn grid_search(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let Some(track) = maps::track(s, field.as_ref(), 12) else { return };
    let (_, cell) = maps::extent(field.as_ref());
    let criterion = match s.below(6) {
        0 => Criterion::Mad,
        1 => Criterion::Prod,
        2 => Criterion::Ncc,
        3 => Criterion::Hausdorff {
            length_scale_m: s.number(0.0, 500.0),
            value_scale: s.number(0.0, 10.0),
            fraction: s.number(0.0, 1.0),
        },
        _ => Criterion::Msd,
    };
    let mut search = GridSearch::new(criterion, half_width(s, cell, 3.0));
    search.max_candidates = 2000;
    search.step = s.one_in(2).then(|| [0, 1].map(|a| cell[a].abs() * s.number(0.1, 1.5)));
    if s.one_in(4) {
        search.heading_deg = {
            let n = s.below(4);
            s.numbers(n, -30.0, 30.0)
        };
        search.scale = {
            let n = s.below(4);
            s.numbers(n, 0.8, 1.2)
        };
    }
    search.pivot = s.one_of(&[Pivot::Newest, Pivot::Centroid]);
    search.remove_mean = s.one_in(2);
    if s.one_in(4) {
        let n = if s.one_in(8) { s.below(14) } else { track.len() };
        search.weights = Some(s.numbers(n, 0.0, 2.0));
    }
    search.robust = match s.below(4) {
        0 => Some(Robust::Huber { threshold: s.number(0.1, 10.0) }),
        1 => Some(Robust::StudentT { nu: s.number(1.0, 10.0), scale: s.number(0.1, 10.0) }),
        _ => None,
    };
    search.interpolation = s.one_of(&METHODS);
    search.min_overlap = s.number(0.1, 1.0);
    search.sigma = s.maybe(0.1, 10.0);
    search.ambiguity = s.number(0.001, 1.0);
    search.refine = s.one_in(2);
    search.surface = s.one_in(4);
    show(&(&field, &track, &search));
    if let Ok(fix) = match_grid(field.as_ref(), &track, &search, &Quiet) {
        assert_sound(&fix);
    }
}

/// Options of contour matching; the lattice of starts stays small.
pub fn contour_options(s: &mut Source<'_>, cell_m: f64) -> ContourOptions {
    let mut options = ContourOptions {
        transform: s.one_of(&TransformKind::ALL),
        radius_m: if s.one_in(2) { cell_m * s.number(0.1, 8.0) } else { f64::INFINITY },
        stiffness: if s.one_in(3) { s.number(0.0, 1.0) } else { 0.0 },
        converged_m: cell_m * s.number(0.001, 0.1),
        max_iterations: s.below(12),
        min_points: s.one_in(4).then(|| s.below(6)),
        acceleration: s.below(4),
        max_rotation_deg: s.maybe(0.0, 90.0),
        starts: Starts::Indicated,
        refine: s.one_in(3),
        refinement: RefineOptions::default(),
    };
    options.starts = match s.below(6) {
        0 => Starts::Offsets((0..s.below(4)).map(|_| [s.number(-500.0, 500.0), s.number(-500.0, 500.0)]).collect()),
        1 => Starts::Grid {
            half_width_m: cell_m * s.number(0.0, 2.0),
            step_m: cell_m * s.number(0.5, 1.0),
            keep: s.below(4),
            max_candidates: 200,
        },
        _ => Starts::Indicated,
    };
    if s.one_in(2) {
        let prior = |s: &mut Source<'_>, most: f64| match s.below(3) {
            0 => None,
            1 => Some(f64::INFINITY),
            _ => Some(s.number(0.0, most)),
        };
        options.refinement = RefineOptions {
            priors: Priors {
                offset_sigma_m: prior(s, 500.0),
                heading_sigma_deg: prior(s, 10.0),
                scale_sigma: prior(s, 0.1),
                bias_sigma: prior(s, 30.0),
            },
            interpolation: s.one_of(&METHODS),
            map_correlation_m: s.maybe(0.0, 1000.0),
            max_iterations: s.below(12),
            min_overlap: s.number(0.1, 1.0),
            tolerance_m: s.maybe(0.0, 100.0),
            max_risk: s.number(0.0, 0.1),
            min_goodness: s.number(0.0, 0.1),
        };
    }
    options
}

/// Contour matching with every transform, with and without refinement, on one map or two.
pub fn contour(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(map) = maps::tame(s) else { return };
    let Some(track) = maps::track(s, &map, 10) else { return };
    let [east, _] = geomag_core::field::Field::metres_per_unit(&map, track.newest()[1]);
    let options = contour_options(s, (map.x().step() * east).abs().max(1e-3));
    let sigma = s.maybe(0.1, 5.0);
    show(&(&map, &track, &options, sigma));
    let fix = if s.one_in(4) {
        let weights = s.one_in(2).then(|| s.numbers(track.len(), 0.0, 2.0));
        let second = Channel { field: &map, values: track.values(), sigma: s.maybe(0.1, 5.0) };
        let channels = [Channel { field: &map, values: track.values(), sigma }, second];
        contour::match_channels(&channels, &track, weights.as_deref(), &options)
    } else {
        match_contour(&map, &track, sigma, &options)
    };
    if let Ok(fix) = fix {
        assert_sound(&fix);
    }
    let points = |s: &mut Source<'_>| -> Vec<[f64; 2]> {
        (0..s.below(5)).map(|_| [s.number(-10.0, 10.0), s.number(-10.0, 10.0)]).collect()
    };
    let (from, to) = (points(s), points(s));
    if let Ok(t) = Transform::fit(options.transform, &from, &to, None) {
        assert!(t.matrix.as_flattened().iter().chain(&t.shift).all(|v| !v.is_nan()), "{t:?} of {from:?} to {to:?}");
    }
}

/// Options of the posterior over few candidates.
pub fn posterior_options(s: &mut Source<'_>, cell: [f64; 2]) -> PosteriorOptions {
    let mut options = PosteriorOptions::new(half_width(s, cell, 1.5));
    options.max_candidates = 400;
    // Searched in stages only now and then, and simply: that goes through thousands of places.
    let staged = s.one_in(32);
    options.step = (!staged).then(|| [0, 1].map(|a| cell[a].abs() * s.number(0.5, 1.5)));
    options.tolerance_m = if s.one_in(2) { None } else { Some(s.number(100.0, 500.0)) };
    options.max_risk = s.number(0.0, 0.1);
    options.bias_sigma = s.maybe(0.0, 50.0);
    if !staged && s.one_in(4) {
        match s.below(7) {
            0 => options.leg_bias_sigma = s.number(0.0, 10.0),
            1 => options.bias_drift_sigma = s.number(0.0, 10.0),
            2 => options.height_sigma_m = s.number(0.0, 100.0),
            3 => options.drift_sigma_m = s.number(0.0, 100.0),
            4 => options.heading_sigma_deg = s.number(0.0, 5.0),
            5 => options.scale_sigma = s.number(0.0, 0.05),
            _ => options.position_sigma_m = s.number(0.0, 50.0),
        }
    }
    options.misfit_threshold = if !staged && s.one_in(8) { s.maybe(0.0, 10.0) } else { Some(f64::INFINITY) };
    options.nu = s.maybe(1.0, 20.0);
    options.interpolation = s.one_of(&METHODS);
    options.min_overlap = s.number(0.1, 1.0);
    options.min_goodness = s.number(0.0, 0.1);
    options.surface = s.one_in(8);
    options
}

/// The calibrated matcher, over one channel or two.
pub fn posterior(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let Some(track) = maps::track(s, field.as_ref(), 8) else { return };
    let options = posterior_options(s, maps::extent(field.as_ref()).1);
    let sigma = s.maybe(0.1, 5.0);
    show(&(&field, &track, &options, sigma));
    let fix = if s.one_in(8) {
        let channel = Channel { field: field.as_ref(), values: track.values(), sigma };
        posterior::match_channels(&[channel, channel], &track, &options)
    } else {
        match_posterior(field.as_ref(), &track, sigma, &options)
    };
    if let Ok(fix) = fix {
        assert_sound(&fix);
        if fix.ok() {
            assert!(fix.risk.is_some_and(|r| r <= options.max_risk), "{fix:?}");
        }
    }
}

/// Delta modulation and the rules of a matching sequence.
pub fn sequence(data: &[u8]) {
    let s = &mut Source::new(data);
    let n = s.below(40);
    let values = s.numbers(n, -50.0, 50.0);
    let quantum = s.number(0.1, 10.0);
    if let Ok(kept) = delta_modulation(&values, quantum) {
        assert!(kept.keep.windows(2).all(|w| w[0] < w[1]) && kept.keep.iter().all(|k| *k < n));
        assert!(chosen_by_codes(&kept.codes).iter().all(|k| *k <= kept.codes.len()));
    }
    if let Ok(mut stream) = DeltaModulator::new(quantum) {
        for v in &values {
            let before = stream.clone();
            if stream.update(*v).is_err() {
                assert_eq!(before, stream);
            }
            assert!(stream.staircase().is_none_or(f64::is_finite), "{stream:?}");
        }
    }
    let (spacing, share) = (s.number(1.0, 100.0), s.number(0.5, 1.0));
    if let Ok(bandwidth) = energy_bandwidth(&values, spacing, share) {
        assert!(bandwidth >= 0.0 && !bandwidth.is_nan(), "{bandwidth}");
    }
    let mut along = s.numbers(n, 0.0, 1000.0);
    if !s.one_in(4) {
        along.sort_by(f64::total_cmp);
    }
    let rules = SequenceRules {
        quantum,
        cell_m: s.number(1.0, 200.0),
        min_cells: s.number(0.1, 3.0),
        energy_share: s.number(0.5, 1.0),
    };
    if let Ok(chosen) = choose_sequence(&along, &values, &rules) {
        assert!(chosen.keep.windows(2).all(|w| w[0] < w[1]) && chosen.keep.iter().all(|k| *k < n));
    }
}

/// Settings of a sequence tried out on a small map.
pub fn tuning(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(map) = maps::tame(s) else { return };
    let Some(track) = maps::track(s, &map, 8) else { return };
    let mut matching = contour_options(s, map.x().step().abs().max(1e-3));
    (matching.max_iterations, matching.refine) = (matching.max_iterations.min(4), false);
    let options = TuneOptions {
        min_length: s.below(6),
        max_length: s.one_in(2).then(|| s.below(9)),
        quanta: {
            let n = s.below(3);
            s.numbers(n, 0.1, 20.0)
        },
        weights: [s.number(0.0, 1.0), s.number(0.0, 1.0)],
        error_range_m: s.one_in(4).then(|| [s.number(0.0, 100.0), s.number(50.0, 500.0)]),
        cost_range: s.one_in(4).then(|| [s.number(0.0, 100.0), s.number(50.0, 500.0)]),
        cost_per_work: s.number(0.0, 2.0),
        draws: s.below(3),
        sigma: s.number(0.0, 5.0),
        ins: InsDraw {
            offset_m: s.number(0.0, 300.0),
            heading_sigma_deg: s.number(0.0, 5.0),
            scale_sigma: s.number(0.0, 0.1),
        },
        matching,
        seed: u64::from(s.byte()),
    };
    let method = if s.one_in(2) {
        TuneMethod::Bpso(BpsoOptions {
            particles: s.below(4),
            iterations: s.below(4),
            patience: s.below(3),
            inertia: [s.number(0.0, 1.0), s.number(0.0, 1.0)],
            pulls: [s.number(0.0, 2.0), s.number(0.0, 2.0)],
            max_velocity: s.number(0.0, 6.0),
        })
    } else {
        TuneMethod::Exhaustive
    };
    if let Ok(tuned) = tune_sequence(&map, &track, &options, &method, &Quiet) {
        let least = tuned.settings.iter().map(|x| x.objective).fold(f64::INFINITY, f64::min);
        assert!(!tuned.best.objective.is_nan() && tuned.best.objective <= least, "{tuned:?}");
    }
}
