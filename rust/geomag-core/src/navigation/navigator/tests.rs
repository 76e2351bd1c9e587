//! The navigator against closed forms, against its own covariance, and against what goes wrong on board.

use std::sync::Arc;

use approx::assert_relative_eq;

use super::filter::ErrorFilter;
use super::motion::{
    ACCELEROMETER, COUPLED, GYRO, INS_STATES, POSITION, Rows, TILT, VELOCITY, VehicleMotion, rates, transition,
};
use super::states::*;
use super::*;
use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::{GridMap, GridValues, Interpolation, MapSigma};
use crate::map_error::{DistanceLayer, MapErrorModel};
use crate::monitor::{Monitor, Quiet};
use crate::random::Random;

const R: f64 = 6_371_000.0;
const SPEED: f64 = 70.0;

fn motion(latitude_deg: f64, velocity_m_s: [f64; 2], heading_deg: f64) -> VehicleMotion {
    VehicleMotion {
        latitude_rad: latitude_deg.to_radians(),
        radii_m: [R, R],
        velocity_m_s,
        acceleration_m_s2: [0.0; 2],
        heading_rad: heading_deg.to_radians(),
        turns: true,
    }
}

/// x' = F x for so long, biases constant.
fn carried(f: &Rows, start: [f64; INS_STATES], seconds: f64) -> [f64; INS_STATES] {
    let dt = 2.0;
    let phi = transition(f, &[0.0; INS_STATES - COUPLED], dt);
    let mut x = start;
    for _ in 0..(seconds / dt) as usize {
        let mut next = x;
        for i in 0..COUPLED {
            next[i] = (0..INS_STATES).map(|k| phi[i][k] * x[k]).sum();
        }
        x = next;
    }
    x
}

fn one(state: usize, value: f64) -> [f64; INS_STATES] {
    let mut x = [0.0; INS_STATES];
    x[state] = value;
    x
}

#[test]
fn a_velocity_error_swings_with_the_schuler_period() {
    // At the equator, at rest, to the north: R psiE' = -dvN, dvN' = g psiE.
    let f = rates(&motion(0.0, [0.0; 2], 0.0));
    let rate = (GRAVITY_M_S2 / R).sqrt();
    let period = std::f64::consts::TAU / rate;
    assert!((period / 60.0 - 84.4).abs() < 0.1);
    for t in [600.0, 0.25 * period, 3600.0] {
        let t = (t / 2.0_f64).floor() * 2.0;
        let x = carried(&f, one(VELOCITY + 1, 0.5), t);
        assert_relative_eq!(x[POSITION + 1], 0.5 * (rate * t).sin() / rate, max_relative = 1e-3);
    }
    // A level accelerometer bias: a / w^2 (1 - cos w t); heading north, so that forward is north.
    let t = 1800.0;
    let x = carried(&f, one(ACCELEROMETER, 1e-3), t);
    assert_relative_eq!(x[POSITION + 1], 1e-3 * (1.0 - (rate * t).cos()) / (rate * rate), max_relative = 1e-3);
    // A gyro to the east (right of a vehicle that heads north): -R b (t - sin(w t) / w).
    let bias = 0.01_f64.to_radians() / 3600.0;
    let x = carried(&f, one(GYRO + 1, bias), 3600.0);
    let expected = R * bias * (3600.0 - (rate * 3600.0).sin() / rate);
    // The Earth's rate adds its square to that of the swing, 0.35 %.
    assert_relative_eq!(x[POSITION + 1].abs(), expected, max_relative = 1e-2);
}

#[test]
fn a_heading_error_couples_with_the_earths_rate() {
    // 0.1 degree of heading at 45 degrees north is a gyro to the east of W cosL psi: some hundreds of metres to the north in an hour at
    // rest, and the way flown is turned besides.
    let heading = 0.1_f64.to_radians();
    let f = rates(&motion(45.0, [0.0; 2], 0.0));
    let x = carried(&f, one(TILT + 2, heading), 3600.0);
    let rate = (GRAVITY_M_S2 / R).sqrt();
    let tilting = EARTH_RATE_RAD_S * 45.0_f64.to_radians().cos() * heading;
    let expected = R * tilting * (3600.0 - (rate * 3600.0).sin() / rate);
    assert!((x[POSITION + 1].abs() / expected - 1.0).abs() < 0.1, "{} {expected}", x[POSITION + 1]);
    assert!(x[POSITION + 1].abs() > 1500.0);
    // To the east there is next to nothing: an odometer would have been out by the way times the heading.
    assert!(x[POSITION].abs() < 0.5 * x[POSITION + 1].abs());
}

/// About how large the errors of an INS are, in their units.
const SIZES: [f64; INS_STATES] = [100.0, 100.0, 0.2, 0.2, 1e-4, 1e-4, 1e-3, 1e-7, 1e-7, 1e-7, 1e-3, 1e-3];

#[test]
fn the_transition_is_the_exponential_of_the_rates() {
    let f = rates(&motion(50.0, [60.0, -30.0], 200.0));
    let decay = [1e-4; INS_STATES - COUPLED];
    // The series of exp(F dt), ten terms.
    let dt = 5.0;
    let full = |i: usize, j: usize| {
        if i < COUPLED {
            f[i][j]
        } else if i == j {
            -decay[i - COUPLED]
        } else {
            0.0
        }
    };
    let mut term: Vec<Vec<f64>> =
        (0..INS_STATES).map(|i| (0..INS_STATES).map(|j| f64::from(i == j)).collect()).collect();
    let mut sum = term.clone();
    for order in 1..10 {
        term = (0..INS_STATES)
            .map(|i| {
                (0..INS_STATES)
                    .map(|j| (0..INS_STATES).map(|k| full(i, k) * term[k][j]).sum::<f64>() * dt / f64::from(order))
                    .collect()
            })
            .collect();
        for (s, t) in sum.iter_mut().flatten().zip(term.iter().flatten()) {
            *s += t;
        }
    }
    let phi = transition(&f, &decay, dt);
    for i in 0..COUPLED {
        for j in 0..INS_STATES {
            // What is left out is of the third order; in units of how large the errors are.
            let off = (phi[i][j] - sum[i][j]).abs() * SIZES[j] / SIZES[i];
            assert!(off < 1e-3, "{i} {j}: {} {}", phi[i][j], sum[i][j]);
        }
    }
}

/// A field of many waves on 200 m cells, 40 km square.
fn map(seed: u64) -> GridMap {
    let mut random = Random::new(seed);
    let waves: Vec<[f64; 4]> = (0..40)
        .map(|_| {
            let length = 1500.0 * libm::exp(1.2 * random.uniform(0.0, 1.0));
            let angle = random.uniform(0.0, std::f64::consts::TAU);
            let k = std::f64::consts::TAU / length;
            [k * libm::cos(angle), k * libm::sin(angle), random.uniform(0.0, std::f64::consts::TAU), length / 200.0]
        })
        .collect();
    let axis: Vec<f64> = (0..201).map(|i| f64::from(i) * 200.0).collect();
    let values = axis
        .iter()
        .flat_map(|y| {
            axis.iter()
                .map(|x| waves.iter().map(|[kx, ky, p, a]| a * libm::cos(kx * x + ky * y + p)).sum())
                .collect::<Vec<f64>>()
        })
        .collect();
    GridMap::new(GridValues::F64(values), &axis, &axis, false)
        .unwrap()
        .with_sigma(Some(MapSigma::Constant(0.0)))
        .unwrap()
}

/// A flight to and fro over the map with INS errors drawn from the filter's own model: log and truth.
struct Log {
    time_s: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
    velocity: Vec<[f64; 2]>,
    heading: Vec<f64>,
    readings: Vec<f64>,
    truth: Vec<[f64; 2]>,
}

impl Log {
    fn input(&self) -> FlightInput<'_> {
        FlightInput {
            time_s: &self.time_s,
            x: &self.x,
            y: &self.y,
            velocity_m_s: Some(&self.velocity),
            heading_deg: Some(&self.heading),
            height_m: None,
            readings: Some(&self.readings),
            terms: None,
        }
    }

    fn error_m(&self, step: &NavigatorStep, k: usize) -> [f64; 2] {
        [step.x - self.truth[k][0], step.y - self.truth[k][1]]
    }
}

fn fly(map: &GridMap, seconds: usize, sigma_m: f64, random: &mut Random) -> Log {
    let ins = InsModel::navigation();
    let latitude = 45.0_f64.to_radians();
    let dt = 2.0;
    let mut x = [0.0; INS_STATES];
    for axis in 0..2 {
        x[POSITION + axis] = sigma_m * random.normal();
        x[VELOCITY + axis] = ins.velocity_sigma_m_s * random.normal();
        x[TILT + axis] = 1e-3 * ins.tilt_sigma_mrad * random.normal();
        x[ACCELEROMETER + axis] = ins.accelerometer_m_s2() * random.normal();
    }
    x[TILT + 2] = 1e-3 * ins.heading_sigma_mrad * random.normal();
    for axis in 0..3 {
        x[GYRO + axis] = ins.gyro_rad_s() * random.normal();
    }
    let bias = 30.0 * random.normal();
    let mut place = [5000.0, 6000.0];
    let mut heading = 90.0_f64;
    let (mut log, mut before) = (
        Log {
            time_s: vec![],
            x: vec![],
            y: vec![],
            velocity: vec![],
            heading: vec![],
            readings: vec![],
            truth: vec![],
        },
        [SPEED, 0.0],
    );
    for k in 0..seconds / 2 {
        let h = heading.to_radians();
        let v = [SPEED * libm::sin(h), SPEED * libm::cos(h)];
        if k > 0 {
            place = [place[0] + 0.5 * dt * (v[0] + before[0]), place[1] + 0.5 * dt * (v[1] + before[1])];
            let scale = crate::frame::metres_per_degree(45.0);
            let m = VehicleMotion {
                latitude_rad: latitude,
                radii_m: [scale[0].to_degrees() / libm::cos(latitude), scale[1].to_degrees()],
                velocity_m_s: [0.5 * (v[0] + before[0]), 0.5 * (v[1] + before[1])],
                acceleration_m_s2: [(v[0] - before[0]) / dt, (v[1] - before[1]) / dt],
                heading_rad: h,
                turns: true,
            };
            let decay = [ins.gyro_time_constant_s, ins.accelerometer_time_constant_s].map(|t| 1.0 / t);
            let phi = transition(&rates(&m), &[decay[0], decay[0], decay[0], decay[1], decay[1]], dt);
            let old = x;
            for i in 0..COUPLED {
                x[i] = (0..INS_STATES).map(|j| phi[i][j] * old[j]).sum();
            }
            for axis in 0..3 {
                x[TILT + axis] += (ins.angle_noise() * dt).sqrt() * random.normal();
                x[GYRO + axis] = x[GYRO + axis] * (1.0 - dt * decay[0])
                    + ins.gyro_rad_s() * (2.0 * dt * decay[0]).sqrt() * random.normal();
            }
            for axis in 0..2 {
                x[VELOCITY + axis] += (ins.velocity_noise() * dt).sqrt() * random.normal();
                x[ACCELEROMETER + axis] = x[ACCELEROMETER + axis] * (1.0 - dt * decay[1])
                    + ins.accelerometer_m_s2() * (2.0 * dt * decay[1]).sqrt() * random.normal();
            }
        }
        log.time_s.push(dt * k as f64);
        log.truth.push(place);
        log.x.push(place[0] + x[POSITION]);
        log.y.push(place[1] + x[POSITION + 1]);
        log.velocity.push([v[0] + x[VELOCITY], v[1] + x[VELOCITY + 1]]);
        log.heading.push(heading);
        log.readings.push(map.sample(place[0], place[1], Interpolation::Bilinear) + bias + random.normal());
        before = v;
        // Round the square, turns of three degrees a second.
        let wanted = if place[0] > 33_000.0 && place[1] < 33_000.0 {
            0.0
        } else if place[1] > 33_000.0 && place[0] > 7000.0 {
            270.0
        } else if place[0] < 7000.0 && place[1] > 7000.0 {
            180.0
        } else {
            90.0
        };
        let turn = (wanted - heading + 540.0_f64).rem_euclid(360.0) - 180.0;
        heading = (heading + turn.clamp(-6.0, 6.0)).rem_euclid(360.0);
    }
    log
}

fn run(map: &Arc<GridMap>, log: &Log, options: NavigatorOptions) -> Vec<NavigatorStep> {
    navigate(map.clone(), &log.input(), options, Smoothing::No, &Quiet).unwrap().steps
}

fn square(error: [f64; 2], c: [[f64; 2]; 2]) -> f64 {
    let determinant = c[0][0] * c[1][1] - c[0][1] * c[1][0];
    (c[1][1] * error[0] * error[0] - 2.0 * c[0][1] * error[0] * error[1] + c[0][0] * error[1] * error[1]) / determinant
}

#[test]
fn over_a_right_map_the_covariance_is_what_the_errors_are() {
    let mut random = Random::new(11);
    let (mut nees, mut beyond, mut far, mut n) = (0.0, 0, 0.0_f64, 0.0);
    for seed in 0..6 {
        let map = Arc::new(map(seed));
        let log = fly(&map, 2400, 100.0, &mut random);
        let steps = run(&map, &log, NavigatorOptions::new(100.0));
        for (k, step) in steps.iter().enumerate().skip(300) {
            let error = log.error_m(step, k);
            nees += square(error, step.covariance_m2);
            beyond += i32::from(error[0].hypot(error[1]) > step.protection_level_m);
            far = far.max(error[0].hypot(error[1]));
            n += 1.0;
        }
        assert_eq!(steps.last().unwrap().status, NavigatorStatus::Tracking);
    }
    let nees = nees / n;
    assert!((1.0..2.5).contains(&nees), "NEES {nees}");
    assert!(f64::from(beyond) < 1e-3 * n, "{beyond} of {n} beyond the protection level");
    assert!(far < 120.0, "{far} m");
}

#[test]
fn smoothing_gains_and_keeps_its_covariance() {
    let mut random = Random::new(12);
    let (mut causal, mut whole, mut lagged, mut nees, mut n) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for seed in 0..6 {
        let map = Arc::new(map(seed));
        let log = fly(&map, 2400, 100.0, &mut random);
        let options = NavigatorOptions::new(100.0);
        let flight = navigate(map.clone(), &log.input(), options.clone(), Smoothing::Flight, &Quiet).unwrap();
        let lag = navigate(map.clone(), &log.input(), options, Smoothing::Lag(120.0), &Quiet).unwrap();
        // The causal output does not know that it is smoothed.
        assert_eq!(flight.steps, lag.steps);
        let (flown, smooth, lag) = (flight.steps, flight.smoothed.unwrap(), lag.smoothed.unwrap());
        for k in 300..flown.len() {
            let off = |p: &SmoothedPlace| [p.x - log.truth[k][0], p.y - log.truth[k][1]];
            let length = |e: [f64; 2]| e[0] * e[0] + e[1] * e[1];
            causal += length(log.error_m(&flown[k], k));
            whole += length(off(&smooth[k]));
            lagged += length(off(&lag[k]));
            nees += square(off(&smooth[k]), smooth[k].covariance_m2);
            assert!(smooth[k].covariance_m2[0][0] <= flown[k].covariance_m2[0][0] * (1.0 + 1e-9));
            n += 1.0;
        }
        // The last step has nothing after it.
        let last = flown.len() - 1;
        assert_relative_eq!(smooth[last].x, flown[last].x, epsilon = 1e-6);
        assert_relative_eq!(smooth[last].covariance_m2[1][1], flown[last].covariance_m2[1][1], max_relative = 1e-9);
    }
    assert!(whole < 0.6 * causal && lagged < causal && whole < lagged, "{causal} {whole} {lagged}");
    assert!((0.8..3.0).contains(&(nees / n)), "NEES {}", nees / n);
}

#[test]
fn a_match_that_is_stopped_is_asked_for_again() {
    struct Stop;
    impl Monitor for Stop {
        fn advance(&self, _: u64, _: u64) -> Result<()> {
            Err(Error::Interrupted)
        }
    }
    let map = Arc::new(map(1));
    let log = fly(&map, 400, 3000.0, &mut Random::new(5));
    let mut navigator = Navigator::new(map, NavigatorOptions::new(3000.0)).unwrap();
    let input = log.input();
    let first =
        (0..400).find(|&k| matches!(navigator.step_interruptible(&input.at(k), &[], &Stop), Err(Error::Interrupted)));
    let first = first.expect("a lost filter asks the matcher");
    // The step was taken, and the next one asks again.
    assert_eq!(navigator.steps(), first as u64 + 1);
    let next = input.at(first + 1);
    assert!(navigator.is_match_due(next.time_s));
    assert!(matches!(navigator.step_interruptible(&next, &[], &Stop), Err(Error::Interrupted)));
    navigator.step(&input.at(first + 2)).unwrap();
    assert!(!navigator.is_match_due(input.at(first + 3).time_s));
}

#[test]
fn a_start_known_to_kilometres_is_acquired() {
    let map = Arc::new(map(3));
    let mut log = fly(&map, 1800, 0.0, &mut Random::new(13));
    for k in 0..log.x.len() {
        log.x[k] += 2600.0;
        log.y[k] -= 1900.0;
    }
    let options = NavigatorOptions { linear_m: Some(250.0), ..NavigatorOptions::new(2500.0) };
    let steps = run(&map, &log, options.clone());
    assert_eq!(steps[10].status, NavigatorStatus::Acquiring);
    assert_eq!(steps[10].reason, Reason::StartUncertain);
    let last = steps.len() - 1;
    let error = log.error_m(&steps[last], last);
    assert!(error[0].hypot(error[1]) < steps[last].protection_level_m.min(200.0), "{error:?}");
    assert_eq!(steps[last].status, NavigatorStatus::Tracking);
    assert!(steps[last].last_fix_s.is_some());
    // Alone, the filter does not find it.
    let alone = run(&map, &log, NavigatorOptions { matcher: None, ..options });
    assert!(alone[last].last_fix_s.is_none());
}

#[test]
fn outages_spikes_stuck_and_jammed_sensors_and_jumps_of_level_stay_within_the_bound() {
    let mut random = Random::new(14);
    let map = Arc::new(map(5));
    for case in 0..5 {
        let mut log = fly(&map, 3600, 100.0, &mut random);
        let range = match case {
            0 => 600..900,  // ten minutes without readings
            1 => 600..630,  // a minute of one and the same
            2 => 600..750,  // five minutes of jamming
            3 => 600..1800, // a jump of level
            _ => 0..1800,   // one reading in twenty far off
        };
        let stuck = log.readings[range.start];
        for k in range.clone() {
            let r = &mut log.readings[k];
            match case {
                0 => *r = f64::NAN,
                1 => *r = stuck,
                2 => *r += 200.0 * random.normal(),
                3 => *r += 50.0,
                _ if k % 20 == 7 => *r += 100.0 * random.normal(),
                _ => {}
            }
        }
        let steps = run(&map, &log, NavigatorOptions::new(100.0));
        let beyond = (150..steps.len())
            .filter(|&k| {
                let e = log.error_m(&steps[k], k);
                e[0].hypot(e[1]) > steps[k].protection_level_m
            })
            .count();
        assert!(
            beyond as f64 <= 1e-3 * steps.len() as f64,
            "case {case}: {beyond} of {} beyond the bound",
            steps.len()
        );
        let last = steps.len() - 1;
        let e = log.error_m(&steps[last], last);
        assert!(e[0].hypot(e[1]) < 150.0, "case {case}: {e:?}");
        match case {
            0 => assert!(steps[880].status == NavigatorStatus::Coasting && steps[880].reason == Reason::NoReading),
            1 => assert!((610..630).any(|k| steps[k].reason == Reason::StuckSensor)),
            3 => assert!((steps[last].bias - steps[590].bias - 50.0).abs() < 20.0, "{}", steps[last].bias),
            _ => {}
        }
    }
}

#[test]
fn errors_of_the_map_are_gathered_and_stay_within_the_covariance() {
    // A map with errors of a wavelength of twice the gap between its lines, said to be so large.
    let mut random = Random::new(15);
    let (mut nees, mut n) = (0.0, 0.0);
    for seed in 20..24 {
        let right = map(seed);
        let wrong = map(seed + 100);
        let values = (0..right.values().len())
            .map(|i| right.values().get(i) + 0.08 * (wrong.values().get(i) - wrong.mean()))
            .collect();
        let axis: Vec<f64> = (0..201).map(|i| f64::from(i) * 200.0).collect();
        let model = MapErrorModel {
            nu: 3.0,
            scale_spread: 0.35,
            correlation: 1.5,
            registration: 0.05,
            distance_m: DistanceLayer::Constant(300.0),
            ..model()
        };
        let charted = GridMap::new(GridValues::F64(values), &axis, &axis, false)
            .unwrap()
            .with_sigma(Some(MapSigma::Constant(5.0)))
            .unwrap()
            .with_error_model(Some(model))
            .unwrap();
        let log = fly(&right, 2400, 100.0, &mut random);
        let steps = run(&Arc::new(charted), &log, NavigatorOptions::new(100.0));
        assert!(steps.iter().any(|s| s.outcome == NavigatorOutcome::Waiting) && steps.iter().any(|s| s.nis.is_some()));
        for (k, step) in steps.iter().enumerate().skip(300) {
            nees += square(log.error_m(step, k), step.covariance_m2);
            n += 1.0;
        }
    }
    assert!(nees / n < 3.0, "NEES {}", nees / n);
}

fn model() -> MapErrorModel {
    serde_json::from_str(
        r#"{"nu": 3, "scale_spread": 0.3, "correlation": 1, "registration": 0, "distance_m": {"Constant": 1.0}}"#,
    )
    .unwrap()
}

#[test]
fn it_goes_on_bit_for_bit_after_a_save() {
    let map = Arc::new(map(7));
    let log = fly(&map, 1200, 100.0, &mut Random::new(16));
    let mut whole = Navigator::new(map.clone(), NavigatorOptions::new(100.0)).unwrap();
    let mut saved = whole.clone();
    for k in 0..log.x.len() {
        if k % 97 == 0 {
            saved = Navigator::restore(map.clone(), &saved.save().unwrap()).unwrap();
        }
        let indicated = log.input().at(k);
        assert_eq!(whole.step(&indicated).unwrap(), saved.step(&indicated).unwrap());
    }
    let bytes = whole.save().unwrap();
    assert!(Navigator::restore(map.clone(), &bytes[..bytes.len() - 3]).is_err());
    for k in (0..bytes.len()).step_by(7) {
        let mut broken = bytes.clone();
        broken[k] ^= 0x40;
        // Refused, or a navigator that can be asked; never a panic.
        if let Ok(mut navigator) = Navigator::restore(map.clone(), &broken) {
            let _ = navigator.step(&log.input().at(log.x.len() - 1));
        }
    }
}

#[test]
fn bad_input_changes_nothing() {
    let map = Arc::new(map(8));
    let log = fly(&map, 200, 100.0, &mut Random::new(17));
    let mut navigator = Navigator::new(map, NavigatorOptions::new(100.0)).unwrap();
    for k in 0..50 {
        navigator.step(&log.input().at(k)).unwrap();
    }
    let before = navigator.save().unwrap();
    let good = log.input().at(50);
    for bad in [
        Indicated { time_s: good.time_s - 100.0, ..good },
        Indicated { time_s: f64::NAN, ..good },
        Indicated { time_s: 1e9, ..good },
        Indicated { x: f64::INFINITY, ..good },
        Indicated { velocity_m_s: Some([1e6, 0.0]), ..good },
        Indicated { heading_deg: Some(f64::NAN), ..good },
        Indicated { height_m: Some(f64::INFINITY), ..good },
        Indicated { value: Some(f64::NEG_INFINITY), ..good },
    ] {
        assert!(navigator.step(&bad).is_err(), "{bad:?}");
        assert_eq!(navigator.save().unwrap(), before);
    }
    assert!(navigator.correct_position([f64::NAN, 0.0], [[1.0, 0.0], [0.0, 1.0]]).is_err());
    assert!(navigator.correct_position([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]]).is_err());
    assert!(navigator.correct_velocity([1.0, 2.0], -1.0).is_err());
    assert_eq!(navigator.save().unwrap(), before);
}

#[test]
fn positions_from_elsewhere_are_believed() {
    let map = Arc::new(map(9));
    let log = fly(&map, 400, 300.0, &mut Random::new(18));
    let mut navigator = Navigator::new(map.clone(), NavigatorOptions::new(300.0)).unwrap();
    assert!(navigator.correct_position([0.0; 2], [[1.0, 0.0], [0.0, 1.0]]).is_err());
    let mut input = log.input();
    input.readings = None;
    for k in 0..100 {
        navigator.step(&input.at(k)).unwrap();
    }
    let offset = [log.truth[99][0] - log.x[99], log.truth[99][1] - log.y[99]];
    let correction = navigator.correct_position(offset, [[25.0, 3.0], [3.0, 16.0]]).unwrap();
    assert!(!correction.reset && correction.nis < 13.8);
    let step = navigator.step(&input.at(100)).unwrap();
    let e = log.error_m(&step, 100);
    assert!(e[0].hypot(e[1]) < 15.0 && step.covariance_m2[0][0] < 40.0, "{e:?}");
    // One that contradicts is a new start.
    let far = navigator.correct_position([offset[0] + 5000.0, offset[1]], [[25.0, 0.0], [0.0, 25.0]]).unwrap();
    assert!(far.reset && far.nis > 13.8);
    let bound = navigator.predict_bound(
        &(0..100).map(|k| Indicated { value: Some(0.0), ..log.input().at(k + 100) }).collect::<Vec<_>>(),
    );
    let bound = bound.unwrap();
    assert!(bound.len() == 100 && bound[99][0][0] > 0.0 && bound[99][0][0] < 1e4);
}

#[test]
fn the_covariance_stays_positive_over_a_million_steps() {
    use super::filter::FilterScratch;
    let steps = if std::env::var_os("GEOMAG_LONG").is_some() { 1_000_000 } else { 20_000 };
    let mut filter =
        ErrorFilter::new(&[1e4, 1e4, 0.04, 0.04, 1e-8, 1e-8, 1e-6, 1e-14, 1e-14, 1e-14, 1e-7, 1e-7, 900.0, 1e4, 1e4]);
    let mut scratch = FilterScratch::default();
    let phi = transition(&rates(&motion(50.0, [60.0, 30.0], 63.0)), &[1e-4; INS_STATES - COUPLED], 1.0);
    let factors = [0.9999; STATES - COUPLED];
    let noise = [0.0, 0.0, 8e-9, 8e-9, 1e-15, 1e-15, 1e-15, 1e-18, 1e-18, 1e-18, 1e-11, 1e-11, 1e-3, 1.0, 1.0];
    for k in 0..steps {
        filter.predict(&phi, &factors, &noise, &mut scratch);
        let (s, c) = (libm::sin(0.1 * f64::from(k)), libm::cos(0.1 * f64::from(k)));
        let slopes = [(POSITION, s), (POSITION + 1, c), (BIAS, 1.0), (REGISTRATION, -s), (REGISTRATION + 1, -c)];
        let predicted = filter.project(&slopes, &mut scratch);
        // Now and then a reading without any error to speak of.
        let r = if k % 1000 == 0 { 1e-12 } else { 1.0 };
        filter.update(&slopes, predicted, 0.1 * s, r, &mut scratch);
    }
    assert!(filter.is_whole(STATES));
    // Scaled to units: Cholesky goes through.
    let n = STATES;
    let scaled = nalgebra::DMatrix::from_fn(n, n, |i, j| filter.at(i, j) / (filter.at(i, i) * filter.at(j, j)).sqrt());
    assert!(scaled.cholesky().is_some());
}

#[test]
fn the_vehicles_own_field_is_learnt_in_flight() {
    // Two terms that turn with the heading, some 40 nT each: known not at all, and known rightly.
    let map = Arc::new(map(30));
    let mut log = fly(&map, 3600, 100.0, &mut Random::new(31));
    let coefficients = [40.0, -25.0];
    let terms: Vec<f64> = log.heading.iter().flat_map(|h| [h.to_radians().cos(), h.to_radians().sin()]).collect();
    for (reading, term) in log.readings.iter_mut().zip(terms.chunks(2)) {
        *reading += coefficients[0] * term[0] + coefficients[1] * term[1];
    }
    let options = NavigatorOptions { terms_covariance: vec![2500.0, 0.0, 0.0, 2500.0], ..NavigatorOptions::new(100.0) };
    let input = FlightInput { terms: Some(&terms), ..log.input() };
    let flight = navigate(map.clone(), &input, options.clone(), Smoothing::No, &Quiet).unwrap();
    for (found, wanted) in flight.state[STATES..].iter().zip(coefficients) {
        assert!((found - wanted).abs() < 8.0, "{:?}", &flight.state[STATES..]);
    }
    let last = flight.steps.len() - 1;
    let error = log.error_m(&flight.steps[last], last);
    assert!(error[0].hypot(error[1]) < flight.steps[last].protection_level_m);
    // Terms must be as many as there are coefficients.
    assert!(navigate(map.clone(), &log.input(), options.clone(), Smoothing::No, &Quiet).is_err());
    let singular = NavigatorOptions { terms_covariance: vec![1.0, 1.0, 1.0, 1.0], ..options };
    assert!(Navigator::new(map, singular).is_err());
}
