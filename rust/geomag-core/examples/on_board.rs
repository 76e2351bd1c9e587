//! A matcher on a vehicle: samples in, a fix out, and a restart in mid-flight that goes on bit for bit.
//!
//! `cargo run --release --example on_board`

use std::sync::Arc;

use geomag_core::error::Result;
use geomag_core::field::Field;
use geomag_core::fix::Status;
use geomag_core::matching::iema::{Iema, IemaOptions};
use geomag_core::synthetic::{CrustSpec, InsError, Path, SensorModel, fly};

fn main() -> Result<()> {
    // The map comes from the vehicle's own storage: here it is made up.
    let field = CrustSpec::default().draw([0.0, 0.0, 40_000.0, 30_000.0], false, 7)?;
    let map = Arc::new(field.grid_by_step(250.0)?);

    // What the instruments say: an INS that is off by 940 m, a magnetometer with noise.
    let path = Path::straight([9_000.0, 7_000.0], 60.0, 60.0, 8.0, 45, false)?;
    let ins = InsError { position_m: [-800.0, 500.0], ..InsError::default() };
    let flight = fly(&field, &path, &ins, &SensorModel::white(2.0), 1)?;

    // The gate allows for the sensor and for the map between the offsets tried; a region of 500 m is unique enough.
    let options = IemaOptions { tolerance: [500.0; 2], max_misses: 2, ..IemaOptions::new(8.0, [2_000.0; 2]) };
    let mut matcher = Iema::new(map.clone() as Arc<dyn Field>, options)?;

    for k in 0..flight.track.len() {
        let [x, y] = flight.track.point(k);
        let step = matcher.update(x, y, flight.track.values()[k])?;
        if k == 5 {
            // Power fails; the state was saved, and a new process goes on with it.
            let saved = matcher.save()?;
            matcher = Iema::restore(map.clone() as Arc<dyn Field>, &saved)?;
        }
        match step.status {
            Status::Fixed => {
                let fix = step.fix(&*map);
                let [east, north] = fix.offset_m;
                println!("fixed after {} samples: correct by {east:.0} m east, {north:.0} m north", fix.n_samples);
                return Ok(());
            }
            Status::Lost => {
                // No candidate agrees: nothing is invented. Begin anew, with a wider gate if that is known to help.
                matcher.reset();
            }
            _ => {}
        }
    }
    println!("no fix: {} candidates left", matcher.n_feasible());
    Ok(())
}
