//! Calibrated matching over fields that are no grids.

use geomag_core::error::Error;
use geomag_core::matching::posterior::{PosteriorOptions, match_posterior};
use geomag_core::synthetic::CrustSpec;
use geomag_core::track::Track;

#[test]
fn a_field_without_a_grid_is_not_laid_out_over_half_the_world() {
    let field = CrustSpec::default().draw([0.0, 0.0, 12_000.0, 12_000.0], false, 1).unwrap();
    let track = |x: Vec<f64>| {
        let n = x.len();
        Track::new(x, vec![6000.0; n], vec![1.0; n], None).unwrap()
    };
    let flown = track((0..10).map(|k| 4000.0 + 150.0 * f64::from(k)).collect());
    let mut options = PosteriorOptions::new([1000.0; 2]);
    assert!(match_posterior(&field, &flown, Some(1.0), &options).is_ok());
    options.drift_sigma_m = 1e7;
    let refused = match_posterior(&field, &flown, Some(1.0), &options);
    assert!(matches!(refused, Err(Error::TooManyCandidates { .. })), "{refused:?}");
    let far = match_posterior(&field, &track(vec![0.0, 9e7]), Some(1.0), &PosteriorOptions::new([1000.0; 2])).unwrap();
    assert!(!far.ok(), "{far:?}");
    let beyond = Track::new(vec![0.0, 1e300], vec![6000.0; 2], vec![1.0; 2], None);
    assert!(matches!(beyond, Err(Error::Invalid { .. })), "{beyond:?}");
}
