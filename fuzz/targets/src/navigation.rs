//! Navigators over hours, in a few steps.

use std::sync::Arc;

use geomag_core::field::Field;
use geomag_core::grid::Interpolation;
use geomag_core::kalman::Scaling;
use geomag_core::monitor::Quiet;
use geomag_core::navigation::field_navigator::{self, FieldNavigator};
use geomag_core::navigation::ins_feedback::{InsErrorModel, InsFeedback};
use geomag_core::navigation::navigator::{
    FlightInput, Indicated, InsModel, MatcherPlan, Navigator, NavigatorMethod, NavigatorOptions, NavigatorStep,
    Smoothing, navigate,
};
use geomag_core::navigation::sensing::Sensing;
use geomag_core::state;

use crate::maps;
use crate::source::{Source, assert_covariance, show};

fn ins_model(s: &mut Source<'_>) -> InsModel {
    let mut ins = s.one_of(&[InsModel::navigation(), InsModel::tactical()]);
    if s.one_in(4) {
        let value = s.number(0.0, 10.0);
        match s.below(9) {
            0 => ins.gyro_bias_deg_h = value,
            1 => ins.gyro_time_constant_s = value,
            2 => ins.gyro_walk_deg_sqrt_h = value,
            3 => ins.accelerometer_bias_ug = value,
            4 => ins.accelerometer_time_constant_s = value,
            5 => ins.velocity_walk_m_s_sqrt_h = value,
            6 => ins.velocity_sigma_m_s = value,
            7 => ins.tilt_sigma_mrad = value,
            _ => ins.heading_sigma_mrad = value,
        }
    }
    ins
}

fn options(s: &mut Source<'_>, field: &dyn Field) -> NavigatorOptions {
    let mut options = NavigatorOptions::new(s.number(0.0, 1000.0));
    options.ins = ins_model(s);
    let (first, cell) = maps::extent(field);
    options.start = s.one_in(4).then(|| [0, 1].map(|a| first[a] + cell[a] * s.number(0.0, 8.0)));
    if s.one_in(8) {
        options.covariance_m2 = [[s.number(0.0, 1e4), s.number(-1e3, 1e3)], [s.number(-1e3, 1e3), s.number(0.0, 1e4)]];
    }
    options.reading_sigma = s.number(0.0, 5.0);
    options.bias_sigma = s.number(0.0, 50.0);
    options.bias_walk_sqrt_s = s.number(0.0, 0.1);
    options.batch_m = s.maybe(0.0, 500.0);
    options.registration = s.maybe(0.0, 0.5);
    options.nu = if s.one_in(4) { f64::INFINITY } else { s.number(1.0, 10.0) };
    options.linear_m = s.maybe(1.0, 500.0);
    options.integrity_risk = if s.one_in(4) { s.number(1e-6, 0.5) } else { 1e-3 };
    let terms = if s.one_in(8) { s.below(3) } else { 0 };
    options.terms_covariance = vec![0.0; terms * terms];
    for i in 0..terms {
        options.terms_covariance[i * terms + i] = s.number(0.0, 10.0);
    }
    options.matcher = s.one_in(64).then(|| MatcherPlan {
        every_s: s.number(1.0, 100.0),
        wide_every_s: s.number(1.0, 100.0),
        samples: 1 + s.below(8),
        spacing_m: s.maybe(1.0, 100.0),
        tolerance_m: s.maybe(1.0, 300.0),
        max_risk: s.number(0.0, 0.2),
        reach_m: s.number(1.0, 500.0),
    });
    options.method = s.one_of(&[NavigatorMethod::Navigator, NavigatorMethod::Navigator, NavigatorMethod::Ekf]);
    options.latitude_deg = s.number(-89.0, 89.0);
    options
}

/// A vehicle over the map that says what it wants.
struct Vehicle {
    time_s: f64,
    cells: [f64; 2],
    pace: [f64; 2],
    /// Whether a long gap may still come.
    patient: bool,
}

impl Vehicle {
    fn new(s: &mut Source<'_>) -> Self {
        Self {
            time_s: s.number(-1e3, 1e5),
            cells: [s.within(0.0, 8.0), s.within(0.0, 8.0)],
            pace: [s.within(-0.5, 0.5), s.within(-0.5, 0.5)],
            patient: s.one_in(16),
        }
    }

    fn next(&mut self, s: &mut Source<'_>, field: &dyn Field) -> Indicated {
        let (first, cell) = maps::extent(field);
        // Hours are carried on in pieces of five seconds, thousands of them, so there is no more than one gap of that kind.
        let dt = s.one_of(&[1.0, 0.1, 10.0, 0.0, 60.0]);
        self.time_s += if s.one_in(16) {
            let most = if std::mem::take(&mut self.patient) { 5000.0 } else { 100.0 };
            s.number(-10.0, most).min(1e6)
        } else {
            dt
        };
        self.cells = [0, 1].map(|a| self.cells[a] + self.pace[a]);
        let mut place = [0, 1].map(|a| first[a] + cell[a] * self.cells[a]);
        if s.one_in(16) {
            place[s.below(2)] = s.number(-1e7, 1e7);
        }
        let read = field.value_at(place[0], place[1], 100.0);
        let value = match s.below(8) {
            0 => None,
            1 => Some(s.number(-1e4, 1e4)),
            2 => Some(f64::NAN),
            _ => Some(if read.is_finite() { read + s.within(-2.0, 2.0) } else { 1.0 }),
        };
        Indicated {
            time_s: self.time_s,
            x: place[0],
            y: place[1],
            velocity_m_s: s.one_in(2).then(|| [s.number(-100.0, 100.0), s.number(-100.0, 100.0)]),
            heading_deg: s.maybe(-360.0, 360.0),
            height_m: if s.one_in(4) { s.maybe(0.0, 300.0) } else { field.heights().map(|_| 100.0) },
            value,
        }
    }
}

fn assert_step(step: &NavigatorStep) {
    let numbers = [step.x, step.y, step.bias, step.heading_error_deg, step.running_nis, step.protection_level_m];
    assert!(numbers.iter().all(|v| v.is_finite()), "{step:?}");
    assert!(step.velocity_error_m_s.iter().chain(&step.tilt_error_mrad).all(|v| v.is_finite()), "{step:?}");
    assert!(step.nis.is_none_or(|n| n >= 0.0) && step.protection_level_m >= 0.0, "{step:?}");
    assert_covariance("reported", step.covariance_m2);
    assert_covariance("filter", step.covariance_filter_m2);
}

/// The navigator of an INS on a map: steps, corrections, resets, forecasts, saved and restored.
pub fn navigator(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let options = options(s, field.as_ref());
    let Ok(mut navigator) = Navigator::new(field.clone(), options) else { return };
    let terms = navigator.options().terms();
    show(&(&field, navigator.options()));
    let mut vehicle = Vehicle::new(s);
    for _ in 0..12 {
        let before = navigator.save().expect("a state can be written");
        let refused = match s.below(16) {
            0 => {
                let covariance = [[s.number(0.0, 1e4), s.number(-1.0, 1.0)], [s.number(-1.0, 1.0), s.number(0.0, 1e4)]];
                navigator.correct_position([s.number(-500.0, 500.0), s.number(-500.0, 500.0)], covariance).is_err()
            }
            1 => {
                navigator.correct_velocity([s.number(-50.0, 50.0), s.number(-50.0, 50.0)], s.number(0.0, 5.0)).is_err()
            }
            2 => {
                let (first, cell) = maps::extent(field.as_ref());
                let place = [0, 1].map(|a| first[a] + cell[a] * s.number(0.0, 8.0));
                let variance = s.number(0.0, 1e4);
                navigator.reset(place, [[variance, 0.0], [0.0, variance]]).is_err()
            }
            3 => {
                let path: Vec<Indicated> = (0..s.below(4)).map(|_| vehicle.next(s, field.as_ref())).collect();
                if let Ok(bounds) = navigator.predict_bound(&path) {
                    bounds.into_iter().for_each(|c| assert_covariance("forecast", c));
                }
                true
            }
            4 => {
                navigator = Navigator::restore(field.clone(), &before).expect("a state that was written is read");
                true
            }
            _ => {
                let indicated = vehicle.next(s, field.as_ref());
                let own = s.numbers(terms, -1.0, 1.0);
                show(&indicated);
                match navigator.step_with_terms(&indicated, &own) {
                    Ok(step) => {
                        show(&step);
                        assert_step(&step);
                        false
                    }
                    Err(_) => true,
                }
            }
        };
        if refused {
            assert_eq!(navigator.save().expect("again"), before, "a refused call left its mark");
        }
    }
    let bytes = navigator.save().expect("a state can be written");
    let again = Navigator::restore(field, &bytes).expect("a state that was written is read");
    assert_eq!(again.save().expect("again"), bytes);
}

/// A whole log at once, with and without smoothing, by every method.
pub fn flight(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let mut options = options(s, field.as_ref());
    let particles = s.one_in(32);
    let mut vehicle = Vehicle::new(s);
    let n = s.below(10);
    let steps: Vec<Indicated> = (0..n).map(|_| vehicle.next(s, field.as_ref())).collect();
    // A thousand particles are carried on in pieces of five seconds: gaps of days are no matter of milliseconds.
    if particles && steps.windows(2).all(|w| w[1].time_s - w[0].time_s < 600.0) {
        options.method = NavigatorMethod::Rbpf;
    }
    let column = |get: fn(&Indicated) -> f64| steps.iter().map(get).collect::<Vec<f64>>();
    let (time_s, x, y) = (column(|i| i.time_s), column(|i| i.x), column(|i| i.y));
    let readings = column(|i| i.value.unwrap_or(f64::NAN));
    let velocity: Option<Vec<[f64; 2]>> = steps.iter().map(|i| i.velocity_m_s).collect();
    let heading: Option<Vec<f64>> = steps.iter().map(|i| i.heading_deg).collect();
    let height: Option<Vec<f64>> = steps.iter().map(|i| i.height_m).collect();
    let terms = {
        let most = options.terms() * n;
        s.numbers(most, -1.0, 1.0)
    };
    let input = FlightInput {
        time_s: &time_s,
        x: &x,
        y: &y,
        velocity_m_s: velocity.as_deref(),
        heading_deg: heading.as_deref(),
        height_m: height.as_deref(),
        readings: (!s.one_in(8)).then_some(&readings),
        terms: (!terms.is_empty()).then_some(&terms),
    };
    let smoothing = match s.below(3) {
        0 => Smoothing::No,
        1 => Smoothing::Lag(s.number(0.0, 300.0)),
        _ => Smoothing::Flight,
    };
    show(&(&field, &options, &input, smoothing));
    if let Ok(flight) = navigate(field, &input, options, smoothing, &Quiet) {
        flight.steps.iter().for_each(assert_step);
        for place in flight.smoothed.iter().flatten() {
            assert!(place.x.is_finite() && place.y.is_finite(), "{place:?}");
            assert_covariance("smoothed", place.covariance_m2);
        }
    }
}

/// The navigator of speed and course.
pub fn field_navigator(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let (first, cell) = maps::extent(field.as_ref());
    let options = field_navigator::FieldNavigatorOptions {
        start: [0, 1].map(|a| first[a] + cell[a] * s.number(0.0, 8.0)),
        covariance_m2: if s.one_in(8) {
            [[s.number(0.0, 1e4), s.number(-1e3, 1e3)], [s.number(-1e3, 1e3), s.number(0.0, 1e4)]]
        } else {
            [[900.0, 10.0], [10.0, 400.0]]
        },
        position_noise_m2_s: s.number(0.0, 1.0),
        speed_sigma_m_s: s.number(0.0, 2.0),
        speed_walk_m_s_sqrt_s: s.number(0.0, 0.1),
        heading_sigma_deg: s.number(0.0, 5.0),
        heading_walk_deg_sqrt_s: s.number(0.0, 0.1),
        bias_sigma: s.number(0.0, 20.0),
        bias_walk_sqrt_s: s.number(0.0, 1.0),
        reading_sigma: vec![s.number(0.1, 5.0)],
        field_sigma: s.one_in(2),
        gate: s.maybe(0.5, 1.0),
        method: s.one_of(&[
            field_navigator::FieldNavigatorMethod::Unscented,
            field_navigator::FieldNavigatorMethod::Extended,
        ]),
        scaling: if s.one_in(4) {
            Scaling { alpha: s.number(0.01, 1.0), beta: s.number(0.0, 3.0), kappa: s.number(-1.0, 3.0) }
        } else {
            Scaling::default()
        },
    };
    let sensing = Sensing::map(field.clone(), s.one_of(&[Interpolation::Bilinear, Interpolation::Bicubic]));
    let Ok(mut navigator) = FieldNavigator::new(sensing.clone(), options) else { return };
    for _ in 0..8 {
        let before = navigator.save().expect("a state can be written");
        if s.one_in(8) {
            navigator = FieldNavigator::restore(sensing.clone(), &before).expect("a state that was written is read");
            assert_eq!(navigator.save().expect("again"), before);
        }
        if s.one_in(8) {
            let path: Vec<[f64; 2]> = (0..3).map(|k| [first[0] + f64::from(k) * cell[0], first[1] + cell[1]]).collect();
            if let Ok(bounds) = navigator.bound(&path, s.number(0.0, 10.0), s.number(0.0, 50.0), s.number(0.0, 360.0)) {
                bounds.into_iter().for_each(|c| assert_covariance("bound", c));
            }
        }
        let (dt, speed, course) = (s.number(0.0, 10.0), s.number(0.0, 50.0), s.number(0.0, 360.0));
        let [x, y] = navigator.position();
        let read = field.value_at(x, y, 0.0);
        let reading = match s.below(4) {
            0 => None,
            1 => Some([s.number(-100.0, 100.0)]),
            _ => Some([if read.is_finite() { read + s.within(-3.0, 3.0) } else { 0.0 }]),
        };
        match navigator.step(dt, speed, course, reading.as_ref().map(|r| &r[..])) {
            Ok(step) => {
                assert!(step.x.is_finite() && step.y.is_finite(), "{step:?}");
                assert!(step.nis.is_none_or(|n| n >= 0.0), "{step:?}");
                assert_covariance("step", step.covariance_m2);
            }
            Err(_) => assert_eq!(navigator.save().expect("again"), before, "a refused step left its mark"),
        }
    }
}

/// Fixes fed back into an INS that gives positions alone.
pub fn ins_feedback(data: &[u8]) {
    let s = &mut Source::new(data);
    let model = InsErrorModel {
        position_sigma_m: s.number(0.0, 1000.0),
        velocity_sigma_m_s: s.number(0.0, 2.0),
        heading_sigma_deg: s.number(0.0, 1.0),
        position_walk_m_sqrt_s: s.number(0.0, 1.0),
        velocity_walk_m_s_sqrt_s: s.number(0.0, 0.01),
        heading_walk_deg_sqrt_s: s.number(0.0, 0.01),
        velocity_time_constant_s: if s.one_in(2) { f64::INFINITY } else { s.number(1.0, 1e5) },
    };
    let geographic = s.one_in(2);
    let gate = if s.one_in(4) { s.number(0.5, 1.0) } else { 0.999 };
    let Ok(mut feedback) = InsFeedback::new(model, geographic, gate) else { return };
    let (mut time, scale) = (s.number(-1e3, 1e6), if geographic { 1e-5 } else { 1.0 });
    for _ in 0..10 {
        let before = state::save(&feedback).expect("a state can be written");
        if s.one_in(8) {
            feedback = state::load(&before).expect("a state that was written is read");
        }
        time += s.number(-0.1, 100.0);
        let (x, y) = (scale * s.number(-1e5, 1e5), scale * s.number(-1e5, 1e5));
        let fix = s.one_in(2).then(|| {
            let cross = s.number(-10.0, 10.0);
            ([s.number(-1e3, 1e3), s.number(-1e3, 1e3)], [[s.number(1.0, 1e4), cross], [cross, s.number(1.0, 1e4)]])
        });
        match feedback.step(time, x, y, fix) {
            Ok(step) => {
                for place in [step.before, step.after] {
                    assert!(place.x.is_finite() && place.y.is_finite(), "{step:?}");
                    assert_covariance("feedback", place.covariance_m2);
                }
                assert!(step.nis.is_none_or(|n| n >= 0.0 && n.is_finite()), "{step:?}");
            }
            Err(_) => assert_eq!(state::save(&feedback).expect("again"), before, "a refused step left its mark"),
        }
    }
}

/// A navigator in flight over a small map, for its saved state.
pub fn flown(field: &Arc<dyn Field>, steps: u32) -> Navigator {
    let mut options = NavigatorOptions::new(100.0);
    options.terms_covariance = vec![4.0, 0.0, 0.0, 4.0];
    let mut navigator = Navigator::new(field.clone(), options).expect("options as they should be");
    for k in 0..steps {
        let mut at = Indicated::at(f64::from(k), 200.0 + 20.0 * f64::from(k), 300.0 + 10.0 * f64::from(k));
        at.value = Some(field.value(at.x, at.y));
        navigator.step_with_terms(&at, &[0.1, 0.2]).expect("a step as it should be");
    }
    navigator
}
