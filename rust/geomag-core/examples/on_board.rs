//! Navigation on a vehicle: samples in, a fix with its risk, a restart in mid-flight that goes on bit for bit, then a position at every
//! step with the radius that holds it.
//!
//! `cargo run --release --example on_board`

use std::sync::Arc;

use geomag_core::error::Result;
use geomag_core::field::Field;
use geomag_core::fix::Fix;
use geomag_core::grid::MapSigma;
use geomag_core::matching::posterior::{PosteriorMatcher, PosteriorOptions};
use geomag_core::navigation::navigator::{Indicated, Navigator, NavigatorOptions};
use geomag_core::synthetic::{CrustSpec, InsError, Path, SensorModel, fly};

/// Runs the flight, and fails where it does not end as it should.
///
/// # Errors
/// What the matcher or the navigator refuses.
pub fn main() -> Result<()> {
    // The map comes from the vehicle's own storage, with what is known of its errors: here it is made up.
    let field = CrustSpec::default().draw([0.0, 0.0, 40_000.0, 30_000.0], false, 7)?;
    let map: Arc<dyn Field> = Arc::new(field.grid_by_step(200.0)?.with_sigma(Some(MapSigma::Constant(2.0)))?);

    // What the instruments say, every four seconds: an INS that is off by 940 m, a magnetometer with noise.
    let path = Path::straight([6_000.0, 5_000.0], 60.0, 60.0, 4.0, 120, false)?;
    let ins = InsError { position_m: [-800.0, 500.0], ..InsError::default() };
    let flight = fly(&field, &path, &ins, &SensorModel::white(2.0), 1)?;
    let (track, velocity) = (&flight.track, [60.0 * 60f64.to_radians().sin(), 60.0 * 60f64.to_radians().cos()]);

    let options = PosteriorOptions { tolerance_m: Some(200.0), ..PosteriorOptions::new([2_000.0; 2]) };
    let mut matcher = PosteriorMatcher::new(map.clone(), Some(2.0), options, 60)?;
    let mut navigator: Option<Navigator> = None;
    let mut beyond = 0;
    for k in 0..track.len() {
        let ([x, y], value) = (track.point(k), track.values()[k]);
        if let Some(navigator) = &mut navigator {
            // From here on every reading corrects the INS.
            let indicated = Indicated {
                time_s: 4.0 * k as f64,
                x,
                y,
                velocity_m_s: Some(velocity),
                heading_deg: Some(60.0),
                height_m: None,
                value: Some(value),
            };
            let step = navigator.step(&indicated)?;
            let [true_x, true_y] = path.point(k);
            let error = (step.x - true_x).hypot(step.y - true_y);
            beyond += u32::from(error > step.protection_level_m);
            if k + 1 == track.len() {
                println!(
                    "{}: within {:.0} m, and in truth {error:.0} m off",
                    step.status.as_str(),
                    step.protection_level_m
                );
                println!("{beyond} positions beyond their protection level");
                assert!(error < 300.0 && beyond == 0, "the bound must hold");
            }
            continue;
        }
        if k == 5 {
            // Power fails; the state was saved, and a new process goes on with it.
            let saved = matcher.save()?;
            matcher = PosteriorMatcher::load(map.clone(), &saved)?;
        }
        // Not finding a fix is a status, never an error: nothing is invented.
        if let Some(fix) = matcher.update(x, y, value)?.fix.filter(Fix::ok) {
            let ([east, north], risk) = (fix.offset_m, fix.risk.unwrap_or(1.0));
            println!("fixed after {} samples: correct by {east:.0} m east, {north:.0} m north", fix.n_samples);
            println!("the risk that this is wrong by more than 200 m is {risk:.1e}");
            // It begins where the fix puts the vehicle.
            let covariance_m2 = fix.covariance_m2.unwrap_or([[4e4, 0.0], [0.0, 4e4]]);
            let start = NavigatorOptions { start: Some([fix.x, fix.y]), covariance_m2, ..NavigatorOptions::new(200.0) };
            navigator = Some(Navigator::new(map.clone(), start)?);
        }
    }
    assert!(navigator.is_some(), "the flight must come to a fix");
    Ok(())
}
