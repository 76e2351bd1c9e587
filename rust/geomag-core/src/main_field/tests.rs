use super::*;
use crate::monitor::Quiet;

/// A model of every coefficient, falling with degree as the Earth's do.
fn model(degree: usize) -> MainField {
    let row = |seed: f64| -> Vec<f64> {
        let mut k = 0.0;
        let mut row = Vec::new();
        for n in 1..=degree {
            for _ in 0..=n {
                k += 1.0;
                row.push(30_000.0 * 0.5_f64.powi(n as i32) * (seed + 1.7 * k).sin());
            }
        }
        row
    };
    let epochs = vec![2020.0, 2025.0, 2030.0];
    MainField::new(degree, epochs, vec![row(0.3), row(0.4), row(0.5)], vec![row(1.3), row(1.5), row(1.4)]).unwrap()
}

/// The potential straight from the definition, by unnormalised functions of one's own.
fn potential(model: &MainField, epoch: usize, r: f64, theta: f64, lambda: f64) -> f64 {
    let a = crate::constants::GEOMAGNETIC_RADIUS_M;
    let (c, s) = (theta.cos(), theta.sin());
    let mut sum = 0.0;
    for n in 1..=model.degree() {
        for m in 0..=n {
            // P_mm = (2m - 1)!! s^m, upwards in degree, then Schmidt's factor.
            let mut p_mm = 1.0;
            for i in 1..=m {
                p_mm *= (2 * i - 1) as f64 * s;
            }
            let (mut before, mut p) = (0.0, p_mm);
            for i in m + 1..=n {
                let next = ((2 * i - 1) as f64 * c * p - (i + m - 1) as f64 * before) / (i - m) as f64;
                before = p;
                p = next;
            }
            let ratio: f64 = (n - m + 1..=n + m).map(|i| i as f64).product();
            let schmidt = if m == 0 { 1.0 } else { (2.0 / ratio).sqrt() };
            let k = n * (n + 1) / 2 + m - 1;
            let (g, h) = (model.g()[epoch][k], if m == 0 { 0.0 } else { model.h()[epoch][k] });
            let turn = m as f64 * lambda;
            sum += a * (a / r).powi(n as i32 + 1) * (g * turn.cos() + h * turn.sin()) * schmidt * p;
        }
    }
    sum
}

#[test]
fn the_field_is_the_gradient_of_the_potential() {
    let model = model(9);
    let (a, e2) = (crate::constants::WGS84_A_M, crate::constants::WGS84_E2);
    for (latitude, longitude, height) in [(48.0, 11.0, 300.0), (-71.5, 200.0, 9000.0), (0.0, -60.0, 0.0)] {
        let (s, c) = f64::to_radians(latitude).sin_cos();
        let transverse = a / (1.0 - e2 * s * s).sqrt();
        let (axis, polar) = ((transverse + height) * c, (transverse * (1.0 - e2) + height) * s);
        let (r, theta, lambda) = (axis.hypot(polar), axis.atan2(polar), f64::to_radians(longitude));
        let at = |dr: f64, dt: f64, dl: f64| potential(&model, 1, r + dr, theta + dt, lambda + dl);
        let d = 1e-4;
        let radial = -(at(10.0, 0.0, 0.0) - at(-10.0, 0.0, 0.0)) / 20.0;
        let south = -(at(0.0, d, 0.0) - at(0.0, -d, 0.0)) / (2.0 * d * r);
        let east = -(at(0.0, 0.0, d) - at(0.0, 0.0, -d)) / (2.0 * d * r * theta.sin());
        let found = model.field(latitude, longitude, height, 2025.0).unwrap();
        let length = |v: [f64; 3]| v.iter().map(|c| c * c).sum::<f64>().sqrt();
        assert!((found[1] - east).abs() < 0.01, "{found:?} {east}");
        assert!((length(found) - length([radial, south, east])).abs() < 0.01);
        // The ellipsoid's normal leans north of the radius on the northern half.
        let lean = f64::to_radians(latitude) - polar.atan2(axis);
        let down = -(lean.cos() * radial - lean.sin() * south);
        assert!((found[2] - down).abs() < 0.01, "{found:?} {down}");
    }
}

#[test]
fn time_is_linear_between_epochs_and_bounded() {
    let model = model(6);
    let at = |year: f64| model.field(30.0, 40.0, 0.0, year).unwrap();
    let (first, middle, last) = (at(2025.0), at(2026.25), at(2030.0));
    for i in 0..3 {
        assert!((middle[i] - (0.75 * first[i] + 0.25 * last[i])).abs() < 1e-9);
    }
    let error = model.field_many(&[0.0; 2], &[0.0; 2], &[0.0; 2], &[2025.0, 2030.1], &Quiet).unwrap_err();
    assert!(error.to_string().contains("date[1]") && error.to_string().contains("2020 to 2030"), "{error}");
}

#[test]
fn poles_are_limits_and_lanes_do_not_meet() {
    let model = model(40);
    for pole in [90.0_f64, -90.0] {
        let on = model.field(pole, 25.0, 1000.0, 2027.0).unwrap();
        let near = model.field(pole * (1.0 - 1e-11), 25.0, 1000.0, 2027.0).unwrap();
        for i in 0..3 {
            assert!((on[i] - near[i]).abs() < 1e-3, "{on:?} {near:?}");
        }
    }
    let latitudes = [10.0, -45.0, 89.9999, 0.0, 71.0, -89.0, 33.0];
    let many = model.field_many(&latitudes, &[5.0; 7], &[0.0; 7], &[2021.0; 7], &Quiet).unwrap();
    for (latitude, found) in latitudes.iter().zip(&many) {
        assert_eq!(*found, model.field(*latitude, 5.0, 0.0, 2021.0).unwrap());
    }
}

#[test]
fn bad_models_are_refused() {
    let flat = |rows: usize, columns: usize| vec![vec![0.0; columns]; rows];
    assert!(MainField::new(0, vec![1.0, 2.0], flat(2, 0), flat(2, 0)).is_err());
    assert!(MainField::new(1, vec![1.0], flat(1, 2), flat(1, 2)).is_err());
    assert!(MainField::new(1, vec![2.0, 1.0], flat(2, 2), flat(2, 2)).is_err());
    assert!(MainField::new(1, vec![1.0, 2.0], flat(2, 3), flat(2, 2)).is_err());
    let text = serde_json::to_string(&model(3)).unwrap();
    assert_eq!(serde_json::from_str::<MainField>(&text).unwrap(), model(3));
}
