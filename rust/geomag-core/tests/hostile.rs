//! What fuzzing found (fuzz/), a test a fault.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::sync::Arc;

use geomag_core::error::Error;
use geomag_core::frame::{Earth, LocalFrame};
use geomag_core::grid::{Axis, GridMap, GridValues};
use geomag_core::gridding::{distances_to_data, minimum_curvature};
use geomag_core::kalman::ExtendedKalmanFilter;
use geomag_core::map_error::{DistanceLayer, MapErrorModel};
use geomag_core::matching::contour::{ContourOptions, match_contour};
use geomag_core::matching::iema::{Iema, IemaOptions};
use geomag_core::matching::posterior::{PosteriorMatcher, PosteriorOptions, match_posterior};
use geomag_core::matching::transform::TransformKind;
use geomag_core::monitor::Quiet;
use geomag_core::navigation::ins_feedback::{InsErrorModel, InsFeedback};
use geomag_core::navigation::navigator::{Indicated, InsModel, Navigator, NavigatorOptions};
use geomag_core::state;
use geomag_core::synthetic::CrustSpec;
use geomag_core::track::Track;

fn axis() -> Axis {
    Axis::new(0.0, 100.0, 12).unwrap()
}

fn map() -> GridMap {
    let values = (0..144).map(|i| 30.0 * (f64::from(i % 12) * 0.9).sin() * (f64::from(i / 12) * 0.7).cos()).collect();
    GridMap::from_axes(GridValues::F64(values), axis(), axis(), false).unwrap()
}

fn refused<T>(result: Result<T, Error>, what: &str) {
    let error = result.err().unwrap_or_else(|| panic!("{what}: taken")).to_string();
    assert!(error.contains(what), "{error}");
}

#[test]
fn blanks_among_values_are_refused_at_every_door() {
    let mut values = vec![1.0; 144];
    values[14] = -1e32;
    refused(GridMap::from_axes(GridValues::F64(values), axis(), axis(), false), "map values[1, 2] at (200, 100)");
    refused(Track::new(vec![0.0; 2], vec![0.0; 2], vec![1.0, 9.97e36], None), "track values[1]");
    let field = Arc::new(map());
    let mut iema = Iema::new(field.clone(), IemaOptions::new(1.0, [200.0, 200.0])).unwrap();
    refused(iema.update(300.0, 300.0, 1e300), "value[0]");
    let mut matcher = PosteriorMatcher::new(field.clone(), Some(1.0), PosteriorOptions::new([200.0; 2]), 8).unwrap();
    refused(matcher.update(300.0, 300.0, 1e300), "value[0]");
    let mut navigator = Navigator::new(field, NavigatorOptions::new(100.0)).unwrap();
    let at = Indicated { value: Some(1e300), ..Indicated::at(0.0, 300.0, 300.0) };
    refused(navigator.step(&at), "value[0]");
    let (x, y) = ([50.0], [50.0]);
    refused(minimum_curvature([&x, &y, &[1e300]], &axis(), &axis(), 1.0, 1.0, 10.0, 4, &Quiet), "values[0]");
}

#[test]
fn lengths_and_scales_longer_than_the_earth_are_refused() {
    let (x, y) = ([50.0], [50.0]);
    refused(distances_to_data(&x, &y, &axis(), &axis(), [f64::INFINITY, 1.0]), "cell_m east");
    refused(map().with_ground_scale(Some(vec![[1e-320, 1.0]; 12])), "ground_scale, row 0");
    let wide = MapErrorModel {
        nu: 3.0,
        scale_spread: 0.2,
        correlation: 0.5,
        registration: 0.1,
        distance_m: DistanceLayer::Constant(1e300),
        misfit_threshold: None,
        filter: None,
        recalibration: None,
        forecast: None,
        lapses: None,
        covariance_factor: None,
    };
    refused(map().with_error_model(Some(wide)), "distance_m");
    let track = Track::new(vec![300.0, 400.0, 500.0], vec![300.0; 3], vec![1.0; 3], None).unwrap();
    let options = PosteriorOptions { step: Some([100.0, 6e196]), ..PosteriorOptions::new([200.0; 2]) };
    refused(match_posterior(&map(), &track, Some(1.0), &options), "step y");
    let options = PosteriorOptions { position_sigma_m: 1e200, ..PosteriorOptions::new([200.0; 2]) };
    refused(match_posterior(&map(), &track, Some(1.0), &options), "position_sigma_m");
}

#[test]
fn an_ins_that_no_number_describes_is_refused() {
    for ins in [
        InsModel { gyro_time_constant_s: 1e-300, ..InsModel::navigation() },
        InsModel { heading_sigma_mrad: 1e150, ..InsModel::navigation() },
    ] {
        let options = NavigatorOptions { ins, ..NavigatorOptions::new(100.0) };
        refused(Navigator::new(Arc::new(map()), options), "InsModel");
    }
    let spec = CrustSpec { exponent: 1e15, ..CrustSpec::default() };
    assert!(spec.draw([0.0, 0.0, 1e4, 1e4], false, 1).is_err());
}

#[test]
fn a_covariance_that_overflows_is_refused_and_leaves_the_filter() {
    let mut filter = ExtendedKalmanFilter::new(&[0.0, 1.0], &[4.0, 0.0, 0.0, 1.0]).unwrap();
    let before = state::save(&filter).unwrap();
    refused(filter.predict(&[0.0, 1.0], &[1e200, 0.0, 0.0, 1.0], &[1.0, 0.0, 0.0, 1.0]), "predicted covariance");
    assert_eq!(state::save(&filter).unwrap(), before);
    refused(filter.update(&[1e200], &[0.0], &[1.0, 0.0], &[1.0], None).map(|_| ()), "normalised innovation squared");
    assert_eq!(state::save(&filter).unwrap(), before);
}

#[test]
fn a_gate_that_lets_nearly_nothing_through_is_saved_and_read() {
    let feedback = InsFeedback::new(InsErrorModel::default(), false, 1e-300).unwrap();
    let bytes = state::save(&feedback).unwrap();
    assert_eq!(state::save(&state::load::<InsFeedback>(&bytes).unwrap()).unwrap(), bytes);
}

#[test]
fn a_navigator_is_put_nowhere_off_the_earth() {
    let mut navigator = Navigator::new(Arc::new(map()), NavigatorOptions::new(100.0)).unwrap();
    navigator.step(&Indicated::at(0.0, 300.0, 300.0)).unwrap();
    let before = navigator.save().unwrap();
    let covariance = [[100.0, 0.0], [0.0, 100.0]];
    refused(navigator.correct_position([-2.4e172, 0.0], covariance), "offset_m x");
    refused(navigator.reset([2.4e172, 0.0], covariance), "place x");
    refused(navigator.correct_velocity([1e200, 0.0], 1.0), "velocity_m_s");
    assert_eq!(navigator.save().unwrap(), before);
    refused(LocalFrame::new(50.0, 10.0, 1e300, Earth::Wgs84), "frame");
    refused(minimum_curvature([&[50.0], &[50.0], &[1.0]], &axis(), &axis(), 1e-320, 1.0, 10.0, 4, &Quiet), "aspect");
}

#[test]
fn a_contour_far_from_a_collapsed_track_is_no_overflow() {
    let track = Track::new(vec![-1e8, 1e8, 300.0], vec![1e8, -1e8, 300.0], vec![3.0, 3.0, 3.0], None).unwrap();
    for transform in TransformKind::ALL {
        for acceleration in [0, 3] {
            let options = ContourOptions { transform, acceleration, max_iterations: 20, ..ContourOptions::default() };
            let _ = match_contour(&map(), &track, Some(1.0), &options);
        }
    }
}
