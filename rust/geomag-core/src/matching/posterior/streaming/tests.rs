//! The gate forgives an outlier and spreads as far as the offset may have moved.

use std::sync::Arc;

use super::super::options::PosteriorOptions;
use super::candidate::GateCandidate;
use super::*;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::{GridMap, GridValues, MapSigma};
use crate::matching::stream::Sample;
use crate::monitor::{Monitor, Quiet};

#[test]
fn an_outlier_costs_one_miss_wherever_it_comes() {
    for outlier in 0..6 {
        let mut c = GateCandidate::new([0.0; 2]);
        for k in 0..12 {
            let middle = if k == outlier { 90.0 } else { 10.0 + 0.1 * f64::from(k) };
            c.take([middle - 2.0, middle + 2.0], f64::INFINITY);
        }
        assert_eq!((c.misses, c.support), (1, 11), "outlier at {outlier}");
        assert!(c.bias[0] > 8.0 && c.bias[1] < 12.2, "{:?}", c.bias);
    }
}

#[test]
fn a_bias_beyond_its_bound_is_a_miss() {
    let mut c = GateCandidate::new([0.0; 2]);
    for _ in 0..5 {
        c.take([30.0, 34.0], 20.0);
    }
    assert_eq!((c.misses, c.support), (5, 0));
}

#[test]
fn candidates_spread_as_far_as_the_offset_may_have_moved() {
    let axis: Vec<f64> = (0..60).map(|i| 100.0 * f64::from(i)).collect();
    let values = (0..3600).map(f64::from).collect();
    let map = GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap();
    let map = map.with_sigma(Some(MapSigma::Constant(0.0))).unwrap();
    let field: Arc<dyn Field> = Arc::new(map);
    let mut options = PosteriorOptions::new([1000.0; 2]);
    options.heading_sigma_deg = 1.0;
    let mut matcher = PosteriorMatcher::new(field.clone(), Some(1.0), options, 10).unwrap();
    matcher.state.y.push(3000.0);
    matcher.state.candidates = vec![
        GateCandidate { misses: 2, bias: [0.0, 4.0], ..GateCandidate::new([200.0, 300.0]) },
        GateCandidate { misses: 1, bias: [3.0, 5.0], ..GateCandidate::new([900.0, 300.0]) },
    ];
    matcher.state.moved_m = 150.0;
    matcher.state.spread(&*field, 2.0);
    assert_eq!(matcher.state.candidates.len(), 2, "not far enough to spread");
    matcher.state.spread(&*field, 0.5);
    let places: Vec<[f64; 2]> = matcher.state.candidates.iter().map(|c| c.offset).collect();
    // Five columns about the first, three and the edge about the second, and five rows.
    assert_eq!(places.len(), 5 * 5 + 4 * 5);
    assert!(places.iter().all(|o| o[0].abs() <= 1000.0 && (o[1] - 300.0).abs() <= 200.0));
    assert!(places.windows(2).all(|w| (w[0][1], w[0][0]) < (w[1][1], w[1][0])), "row by row");
    assert_eq!(matcher.state.moved_m, 0.0);
    let mut near = GateCandidate { misses: 2, bias: [0.0, 4.0], ..GateCandidate::new([0.0; 2]) };
    near.join(&GateCandidate { misses: 1, support: 7, bias: [3.0, 5.0], ..GateCandidate::new([100.0, 0.0]) });
    assert_eq!((near.offset, near.misses, near.support, near.bias), ([0.0; 2], 1, 7, [0.0, 5.0]));
}

/// Wants everything to stop at once.
struct Stop;

impl Monitor for Stop {
    fn advance(&self, _: u64, _: u64) -> Result<()> {
        Err(Error::Interrupted)
    }
}

#[test]
fn a_sample_whose_search_is_stopped_is_not_taken() {
    let axis: Vec<f64> = (0..60).map(|i| 100.0 * f64::from(i)).collect();
    let at = |x: f64, y: f64| 40.0 * (x / 300.0).sin() * (y / 250.0).cos();
    let values = axis.iter().flat_map(|y| axis.iter().map(|x| at(*x, *y))).collect();
    let field: Arc<dyn Field> = Arc::new(GridMap::new(GridValues::F64(values), &axis, &axis, false).unwrap());
    let mut matcher = PosteriorMatcher::new(field, Some(1.0), PosteriorOptions::new([400.0; 2]), 20).unwrap();
    let sample = |k: i32| Sample { place: [2000.0 + 90.0 * f64::from(k), 3000.0], value: 5.0, height_m: None };
    // The first two are too few to search with.
    for k in 0..2 {
        matcher.update_interruptible(&sample(k), &Stop).unwrap();
    }
    let before = matcher.save().unwrap();
    assert!(matches!(matcher.update_interruptible(&sample(2), &Stop), Err(Error::Interrupted)));
    assert_eq!(matcher.save().unwrap(), before);
    matcher.update_interruptible(&sample(2), &Quiet).unwrap();
    assert_eq!(matcher.n_samples(), 3);
}
