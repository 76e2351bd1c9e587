//! Fields that are no maps, what maps are made of, and what is made up.

use geomag_core::compensation::{Compensator, TERMS, rates, terms};
use geomag_core::field::Field;
use geomag_core::frame::{Earth, LocalFrame, displacement_m, metres_per_degree, wrap_longitude};
use geomag_core::grid::Axis;
use geomag_core::gridding::{distances_to_data, minimum_curvature};
use geomag_core::harmonic::{
    FitOptions, HarmonicMap, Observations, Period, Positions, Prior, Quantity, RectangularHarmonicModel,
    Regularisation, fit,
};
use geomag_core::information::{NodeBlock, TrackInformation};
use geomag_core::main_field::{MainField, pairs};
use geomag_core::monitor::Quiet;
use geomag_core::synthetic::{CrustSpec, InsError, Leg, Path, Random, SensorModel};

use crate::source::{Source, show};

/// Regional models: fitted to anything, evaluated anywhere, through their text and back.
pub fn harmonic(data: &[u8]) {
    let s = &mut Source::new(data);
    let n = s.below(16);
    let (north, east) = (s.numbers(n, -5e3, 5e3), s.numbers(n, -5e3, 5e3));
    let down = s.numbers(n, -100.0, 100.0);
    let Ok(positions) = Positions::new(&north, &east, &down) else { return };
    let mut observations = Observations::new();
    let sigma = if s.one_in(3) { s.numbers(n, 0.1, 10.0) } else { Vec::new() };
    let main = [[s.number(-1e4, 2e4), s.number(-1e3, 1e3), s.number(-5e4, 5e4)]];
    let added = match s.below(3) {
        0 => {
            let field: Vec<[f64; 3]> = (0..n).map(|_| std::array::from_fn(|_| s.number(-50.0, 50.0))).collect();
            observations.vector(&positions, &field, &sigma)
        }
        1 => observations.anomaly(&positions, &s.numbers(n, -50.0, 50.0), &main, &sigma),
        _ => observations.intensity(&positions, &s.numbers(n, 45e3, 55e3), &main, &sigma),
    };
    if added.is_err() {
        return;
    }
    let options = FitOptions {
        order: s.below(3),
        period: if s.one_in(3) {
            Period::Metres([s.number(1e3, 2e4), s.number(1e3, 2e4)])
        } else {
            Period::Ratio(s.number(1.0, 3.0))
        },
        regularisation: if s.one_in(3) {
            Regularisation::TruncatedSvd(s.number(0.0, 0.1))
        } else {
            Regularisation::Ridge(s.number(0.0, 0.1))
        },
        prior: if s.one_in(3) {
            Prior { damping_m: s.number(0.0, 1e3), power: s.number(0.0, 4.0), anisotropy: s.number(0.5, 2.0) }
        } else {
            Prior::default()
        },
        huber: s.maybe(1.0, 3.0),
        max_iterations: 1 + s.below(5),
        covariance: s.one_in(2),
        frame: s.one_in(2).then(|| LocalFrame::new(50.0, 10.0, 0.0, Earth::Wgs84).ok()).flatten(),
        unit: "nT".into(),
    };
    show(&(&observations, &options));
    let Ok(model) = fit(&observations, &options, &Quiet) else { return };
    assert!(model.coefficients().iter().all(|c| c.is_finite()));
    let text = model.to_json().expect("a model can be written");
    let again = RectangularHarmonicModel::from_json(&text).expect("a model that was written is read");
    assert_eq!(again.coefficients(), model.coefficients());
    let m = s.below(5);
    let (a, b, c) = (s.numbers(m, -6e3, 6e3), s.numbers(m, -6e3, 6e3), s.numbers(m, -200.0, 200.0));
    let Ok(places) = Positions::new(&a, &b, &c) else { return };
    for (k, e) in model.evaluate(&places, s.one_in(2)).iter().enumerate() {
        let unknown = e.field.iter().any(|v| v.is_nan());
        let far = [a[k], b[k], c[k]].iter().any(|v| !(v.abs() < 1e5));
        assert!(far || unknown || e.field.iter().all(|v| v.is_finite()), "{e:?}");
        assert_eq!(unknown, e.potential.is_nan(), "{e:?}");
    }
    if let Ok(sigma) = model.sigma(&places, false) {
        assert!(sigma.as_flattened().iter().all(|v| v.is_nan() || *v >= 0.0), "{sigma:?}");
    }
    let quantity =
        s.one_of(&[Quantity::North, Quantity::Down, Quantity::Anomaly(main[0]), Quantity::Intensity(main[0])]);
    if let Ok(map) = HarmonicMap::at_down(std::sync::Arc::new(model), quantity, s.number(-100.0, 100.0)) {
        let value = map.value(s.number(-5e3, 5e3), s.number(-5e3, 5e3));
        assert!(!value.is_infinite());
    }
}

/// Frames, distances on the Earth, and the main field.
pub fn frame(data: &[u8]) {
    let s = &mut Source::new(data);
    let earth = if s.one_in(3) { Earth::Sphere { radius_m: s.number(6e6, 7e6) } } else { Earth::Wgs84 };
    let origin = [s.number(-90.0, 90.0), s.number(-360.0, 360.0), s.number(-1e3, 1e4)];
    if let Ok(frame) = LocalFrame::new(origin[0], origin[1], origin[2], earth) {
        let place = [
            (origin[0] + s.within(-1.0, 1.0)).clamp(-90.0, 90.0),
            origin[1] + s.within(-1.0, 1.0),
            s.within(-1e3, 1e4),
        ];
        let point = frame.forward(place[0], place[1], place[2]);
        assert!(point.iter().all(|v| v.is_finite()), "{place:?} to {point:?}");
        let (whole, radius) =
            (origin[2].abs() < 1e5, if let Earth::Sphere { radius_m } = earth { radius_m } else { 6e6 });
        if place[0].abs() < 89.9 && whole && radius > 1e6 {
            let back = frame.inverse(point);
            let turn = (back[1] - place[1] + 180.0).rem_euclid(360.0) - 180.0;
            assert!((back[0] - place[0]).abs() < 1e-7 && turn.abs() < 1e-6, "{place:?} came back as {back:?}");
        }
        let vector = [s.number(-5e4, 5e4), s.number(-5e4, 5e4), s.number(-5e4, 5e4)];
        let turned = frame.rotate_from_origin(place[0], place[1], frame.rotate_to_origin(place[0], place[1], vector));
        for (a, b) in vector.iter().zip(turned) {
            assert!(
                !(a.abs() < 1e6 && vector.iter().all(|v| v.abs() < 1e6)) || (a - b).abs() < 1e-6,
                "{vector:?} {turned:?}"
            );
        }
        let _ = frame.inverse([s.number(-1e6, 1e6), s.number(-1e6, 1e6), s.number(-1e6, 1e6)]);
    }
    let (a, b) = (s.number(-1e4, 1e4), s.number(-180.0, 180.0));
    let wrapped = wrap_longitude(a, b);
    assert!(!(a.abs() < 3600.0 && b.abs() < 3600.0) || (wrapped - b).abs() <= 180.0 + 1e-6, "{a} about {b}: {wrapped}");
    let scale = metres_per_degree(s.within(-90.0, 90.0));
    assert!(scale.iter().all(|m| m.is_finite() && *m >= 0.0));
    let _ = displacement_m(s.one_in(2), [s.number(-180.0, 180.0), s.number(-90.0, 90.0)], [a, b]);

    let degree = s.below(4);
    let count = if s.one_in(16) { s.below(12) } else { pairs(degree.max(1)) };
    let epochs = vec![s.number(1990.0, 2000.0), s.number(2000.0, 2010.0)];
    let table = |s: &mut Source<'_>| (0..2).map(|_| s.numbers(count, -3e4, 3e4)).collect::<Vec<_>>();
    let (g, h) = (table(s), table(s));
    if let Ok(main) = MainField::new(degree, epochs, g, h) {
        let at = [s.number(-90.0, 90.0), s.number(-180.0, 360.0), s.number(-1e3, 1e6), s.number(1990.0, 2010.0)];
        if let Ok(field) = main.field(at[0], at[1], at[2], at[3]) {
            let large = main.g().iter().chain(main.h()).flatten().any(|c| c.abs() > 1e6);
            assert!(large || field.iter().all(|v| v.is_finite()), "{field:?} at {at:?}");
        }
    }
}

/// Lines into maps, and what a place can tell.
pub fn gridding(data: &[u8]) {
    let s = &mut Source::new(data);
    let n = s.below(12);
    let (x, y, values) = (s.numbers(n, 0.0, 900.0), s.numbers(n, 0.0, 900.0), s.numbers(n, -50.0, 50.0));
    let axis = |s: &mut Source<'_>| Axis::new(s.number(-50.0, 50.0), s.number(50.0, 200.0), 2 + s.below(9));
    let (Ok(columns), Ok(rows)) = (axis(s), axis(s)) else { return };
    let (aspect, reach) = (s.number(0.5, 2.0), s.number(0.0, 20.0));
    let weight = if s.one_in(2) { f64::INFINITY } else { s.number(0.0, 10.0) };
    let sweeps = s.below(4);
    show(&(&x, &y, &values, &columns, &rows, aspect, weight, reach, sweeps));
    if let Ok(surface) = minimum_curvature([&x, &y, &values], &columns, &rows, aspect, weight, reach, sweeps, &Quiet) {
        assert_eq!(surface.len(), columns.len() * rows.len());
        let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        assert!(largest > 1e100 || surface.iter().all(|v| v.is_finite()), "{surface:?}");
    }
    if let Ok(found) = distances_to_data(&x, &y, &columns, &rows, [s.number(1.0, 500.0), s.number(1.0, 500.0)]) {
        let rounded = |d: &f64| 1e-9 * (1.0 + d);
        let good = |(d, e): (&f64, &f64)| *d >= 0.0 && (d - rounded(d)..=2.0 * d + rounded(d)).contains(e);
        assert!(found.nearest.iter().zip(&found.either_side).all(good), "{found:?}");
    }
    let (height, width) = (2 + s.below(5), 2 + s.below(5));
    let (values, first) = (s.numbers(height * width, -50.0, 50.0), s.number(-80.0, 80.0));
    let information = TrackInformation {
        heading_deg: vec![s.number(0.0, 360.0), 90.0],
        samples: s.below(12),
        spacing_m: s.number(10.0, 300.0),
        sigma: s.number(0.1, 10.0),
        map_error_m: s.number(0.0, 100.0),
        free_level: s.one_in(2),
        tolerance_m: s.number(1.0, 500.0),
    };
    let geographic = s.one_in(2);
    let spacing = if geographic { [0.01, 0.01] } else { [s.number(50.0, 200.0), s.number(50.0, 200.0)] };
    let y: Vec<f64> = (0..height).map(|r| first + spacing[1] * r as f64).collect();
    let block = NodeBlock { values: &values, y: &y, columns: width, spacing, geographic };
    if let Ok(bounds) = information.bound(&block) {
        for bound in bounds {
            assert!(bound.error_m.iter().chain(&bound.samples).all(|v| v.is_nan() || *v >= 0.0), "{bound:?}");
        }
    }
}

/// Made-up fields, paths, INS errors and sensors; the vehicle's own field.
pub fn synthetic(data: &[u8]) {
    let s = &mut Source::new(data);
    let spec = CrustSpec {
        level: s.number(-100.0, 100.0),
        slope_per_m: [s.number(-0.1, 0.1), s.number(-0.1, 0.1)],
        texture_rms: s.number(0.0, 100.0),
        exponent: s.number(0.0, 4.0),
        height_m: s.number(0.0, 1000.0),
        longest_m: s.number(1e3, 1e5),
        shortest_m: s.number(10.0, 1e3),
        waves: s.below(6),
        dipoles: s.below(4),
        dipole_peak: s.number(0.0, 100.0),
        dipole_depth_m: [s.number(10.0, 100.0), s.number(100.0, 1000.0)],
        inclination_deg: s.number(-90.0, 90.0),
        declination_deg: s.number(-180.0, 180.0),
    };
    let geographic = s.one_in(4);
    let extent = if geographic {
        [s.number(-10.0, 10.0), s.number(40.0, 50.0), s.number(10.0, 12.0), s.number(50.0, 52.0)]
    } else {
        [0.0, 0.0, s.number(1e3, 1e5), s.number(1e3, 1e5)]
    };
    show(&(&spec, extent));
    if let Ok(field) = spec.draw(extent, geographic, u64::from(s.byte())) {
        // Rounding may end beyond the edge.
        let place = [0, 1].map(|a| s.within(extent[a], extent[a + 2]).clamp(extent[a], extent[a + 2]));
        show(&(&field, place));
        let (value, gradient) = field.value_and_gradient(place[0], place[1]);
        assert!(!value.is_nan() && gradient.iter().all(|g| !g.is_nan()), "{value} {gradient:?} of {spec:?}");
    }
    let legs: Vec<Leg> =
        (0..s.below(4)).map(|_| Leg { samples: s.below(9), turn_deg_s: s.number(-3.0, 3.0) }).collect();
    let start = [s.number(-80.0, 80.0), s.number(-80.0, 80.0)];
    let (course, speed, dt) = (s.number(0.0, 360.0), s.number(0.0, 100.0), s.number(0.1, 10.0));
    let path = if s.one_in(2) {
        Path::straight(start, course, speed, dt, s.below(9), geographic)
    } else {
        Path::along_legs(start, course, speed, dt, &legs, geographic)
    };
    if let Ok(path) = path {
        assert!(path.x().iter().chain(path.y()).all(|v| v.is_finite()), "{path:?}");
        let ins = InsError {
            position_m: [s.number(-1e3, 1e3), s.number(-1e3, 1e3)],
            velocity_m_s: [s.number(-1.0, 1.0), s.number(-1.0, 1.0)],
            heading_deg: s.number(-5.0, 5.0),
            scale: s.number(0.9, 1.1),
            gyro_deg_h: [s.number(-0.1, 0.1), s.number(-0.1, 0.1)],
            walk_m_sqrt_s: s.number(0.0, 1.0),
            schuler: s.one_in(2),
            ..InsError::default()
        };
        let mut random = Random::new(u64::from(s.byte()));
        if let Ok((x, y)) = ins.indicate(&path, &mut random) {
            assert_eq!((x.len(), y.len()), (path.len(), path.len()));
        }
        let sensor = SensorModel {
            sigma: s.number(0.0, 5.0),
            correlation: s.number(0.0, 1.0),
            outlier_rate: s.number(0.0, 1.0),
            outlier_sigma: s.number(0.0, 100.0),
            bias: s.number(-10.0, 10.0),
            resolution: s.number(0.0, 1.0),
            ..SensorModel::white(0.0)
        };
        let truth = s.numbers(path.len(), -50.0, 50.0);
        if let Ok(read) = sensor.read(&truth, path.time_s(), &mut random) {
            assert_eq!(read.len(), truth.len());
        }
    }
    let field: Vec<[f64; 3]> = (0..s.below(5)).map(|_| std::array::from_fn(|_| s.number(-6e4, 6e4))).collect();
    let time = s.numbers(field.len(), 0.0, 100.0);
    let _ = rates(&field, s.one_in(2).then_some(&time), s.number(0.1, 10.0));
    let coefficients: [f64; TERMS] = std::array::from_fn(|_| s.number(-10.0, 10.0));
    if let Ok(mut compensator) = Compensator::new(coefficients, s.number(0.1, 10.0)) {
        for (k, f) in field.iter().enumerate() {
            let before = compensator.clone();
            if compensator.update(time[k], *f, s.number(4e4, 6e4)).is_err() {
                assert_eq!(before, compensator, "a refused reading left its mark");
            }
            let _ = terms(*f, [0.0; 3]);
        }
    }
}
