//! Maps: made of anything, and read anywhere.

use std::sync::Arc;

use geomag_core::error::Result;
use geomag_core::field::Field;
use geomag_core::grid::{Axis, GridMap, GridValues, Interpolation, MapHeight, MapSigma};
use geomag_core::map_error::{DistanceLayer, FilterLaw, Forecast, Lapses, MapErrorModel, Recalibration};
use geomag_core::stack::MapStack;
use geomag_core::track::Track;

use crate::source::Source;

/// Values on so many nodes: rough, a plane, or all alike.
fn values(s: &mut Source<'_>, rows: usize, columns: usize) -> Vec<f64> {
    let (kind, seed, size) = (s.below(8), f64::from(s.byte()), s.one_of(&[50.0, 1.0, 1000.0, 1e-6]));
    let mut out: Vec<f64> = (0..rows * columns)
        .map(|i| {
            let (r, c) = ((i / columns) as f64, (i % columns) as f64);
            match kind {
                0 => 0.0,
                1 => size * (0.3 * r + 0.7 * c),
                _ => size * ((1.1 * c + seed).sin() * (0.9 * r - seed).cos() + (0.37 * c * r + seed).sin()),
            }
        })
        .collect();
    for _ in 0..s.below(4) {
        let at = s.below(out.len());
        out[at] = f64::NAN;
    }
    out
}

/// Statistics of errors, most of them such as are learnt.
pub fn error_model(s: &mut Source<'_>, nodes: usize) -> MapErrorModel {
    MapErrorModel {
        nu: s.number(2.0, 10.0),
        scale_spread: s.number(0.0, 0.5),
        correlation: s.number(0.0, 2.0),
        registration: s.number(0.0, 0.4),
        distance_m: if s.one_in(2) {
            DistanceLayer::Grid((0..nodes).map(|_| s.number(0.0, 500.0) as f32).collect())
        } else {
            DistanceLayer::Constant(s.number(0.0, 500.0))
        },
        misfit_threshold: s.maybe(0.0, 10.0),
        filter: s.one_in(2).then(|| FilterLaw {
            sample_factor: s.number(0.5, 3.0),
            batch_factor: s.number(0.5, 3.0),
            crossover: s.number(0.0, 5.0),
            registration_m_per_d: s.number(0.0, 0.5),
            registration_length: s.number(1.0, 50.0),
        }),
        recalibration: s.one_in(2).then(|| Recalibration { slope: s.number(0.5, 1.5), intercept: s.number(-1.0, 1.0) }),
        forecast: s.one_in(2).then(|| Forecast {
            level: s.number(0.5, 1.5),
            spread: s.number(0.0, 0.5),
            registration: s.number(0.0, 1.0),
        }),
        lapses: s.one_in(2).then(|| Lapses { share: s.number(0.0, 0.5), length_m: s.number(100.0, 1e4) }),
        covariance_factor: s.one_in(2).then(|| s.number(0.3, 3.0)),
    }
}

/// A map as callers have it: 4 to 13 nodes a side, at times with holes, errors, a height.
pub fn tame(s: &mut Source<'_>) -> Option<GridMap> {
    let (rows, columns) = (4 + s.below(10), 4 + s.below(10));
    let geographic = s.one_in(4);
    let values = values(s, rows, columns);
    let values =
        if s.one_in(4) { GridValues::F32(values.iter().map(|v| *v as f32).collect()) } else { GridValues::F64(values) };
    let (first, step) = if geographic {
        ([s.one_of(&[10.0, 179.95, -180.0]), s.one_of(&[50.0, 0.0, 88.9, -90.0])], 0.001 * (1.0 + s.below(20) as f64))
    } else {
        ([s.one_of(&[0.0, 1e5, -1e7]), 0.0], s.one_of(&[100.0, 1.0, 1000.0, 7.3]))
    };
    let axis = |at: f64, len: usize| Axis::new(at, step, len).ok();
    let map = GridMap::from_axes(values, axis(first[0], columns)?, axis(first[1], rows)?, geographic).ok()?;
    clothed(s, map).ok()
}

/// The map with whatever may be known of it.
fn clothed(s: &mut Source<'_>, mut map: GridMap) -> Result<GridMap> {
    let nodes = map.values().len();
    if s.one_in(3) {
        let sigma = if s.one_in(2) {
            MapSigma::Grid((0..nodes).map(|_| s.number(0.0, 10.0)).collect())
        } else {
            MapSigma::Constant(s.number(0.0, 10.0))
        };
        map = map.with_sigma(Some(sigma))?.with_correlation_m(s.maybe(0.0, 1000.0))?;
    }
    if s.one_in(4) {
        let model = error_model(s, nodes);
        map = map.with_error_model(Some(model))?;
    }
    if s.one_in(8) {
        let height = if s.one_in(3) {
            MapHeight::Drape((0..nodes).map(|_| s.number(0.0, 500.0)).collect())
        } else {
            MapHeight::Level(s.number(0.0, 500.0))
        };
        map = map.with_height(Some(height))?;
    }
    if s.one_in(8) {
        let rows = (0..map.y().len()).map(|_| [s.number(0.9, 1.1), s.number(0.9, 1.1)]).collect();
        map = map.with_ground_scale(Some(rows))?;
    }
    Ok(map)
}

/// A field as a matcher gets it: a map, or now and then a stack of two.
pub fn field(s: &mut Source<'_>) -> Option<Arc<dyn Field>> {
    let map = tame(s)?;
    if s.one_in(8) {
        let upper = map.clone().with_height(Some(MapHeight::Level(300.0))).ok()?;
        let lower = map.with_height(Some(MapHeight::Level(0.0))).ok()?;
        return Some(Arc::new(MapStack::new(vec![lower, upper]).ok()?));
    }
    Some(Arc::new(map))
}

/// Where a map lies: first node, cell, number of cells, x and y.
pub fn extent(field: &dyn Field) -> ([f64; 2], [f64; 2]) {
    let [x, y] = field.spacing();
    let first = field.as_grid().map_or([0.0; 2], |g| [g.x().first(), g.y().first()]);
    (first, [x, y])
}

/// A track over the map, indicated beside its true place, with what was read on it; at times with nonsense in it.
pub fn track(s: &mut Source<'_>, field: &dyn Field, most: usize) -> Option<Track> {
    let n = 1 + s.below(most);
    let (first, cell) = extent(field);
    let start = [s.within(0.0, 8.0), s.within(0.0, 8.0)];
    let step = [s.within(-1.0, 1.0), s.within(-1.0, 1.0)];
    let offset = [s.within(-2.0, 2.0), s.within(-2.0, 2.0)];
    let (mut x, mut y, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..n {
        let place = [0, 1].map(|a| first[a] + cell[a] * (start[a] + step[a] * k as f64));
        let read = field.value_at(place[0], place[1], 100.0);
        values.push(if read.is_finite() { read + s.within(-1.0, 1.0) } else { s.number(-50.0, 50.0) });
        x.push(place[0] - cell[0] * offset[0]);
        y.push(place[1] - cell[1] * offset[1]);
    }
    if s.one_in(8) {
        let (k, bad) = (s.below(n), s.number(-1e3, 1e3));
        match s.below(3) {
            0 => x[k] = bad,
            1 => y[k] = bad,
            _ => values[k] = bad,
        }
    }
    let heights = (field.heights().is_some() || s.one_in(8)).then(|| s.numbers(n, 0.0, 300.0));
    let time = s.one_in(2).then(|| (0..n).map(|k| k as f64 * 10.0).collect());
    Track::new(x, y, values, time).and_then(|t| t.with_height(heights)).ok()
}

/// Map construction and reading.
pub fn map(data: &[u8]) {
    let mut s = Source::new(data);
    let s = &mut s;
    let made = if s.one_in(2) {
        tame(s)
    } else {
        let (rows, columns) = (s.below(7), s.below(7));
        let count = if s.one_in(16) { s.below(60) } else { rows * columns };
        let values: Vec<f64> = s.numbers(count, -100.0, 100.0);
        let axis = |s: &mut Source<'_>, n: usize| -> Vec<f64> {
            let (at, step) = (s.number(-100.0, 100.0), s.number(-50.0, 50.0));
            let mut out: Vec<f64> = (0..n).map(|k| at + step * k as f64).collect();
            if n > 0 && s.one_in(4) {
                let k = s.below(n);
                out[k] = s.number(-100.0, 100.0);
            }
            out
        };
        let (x, y) = (axis(s, columns), axis(s, rows));
        let values = if s.one_in(2) {
            GridValues::F32(values.iter().map(|v| *v as f32).collect())
        } else {
            GridValues::F64(values)
        };
        let (geographic, resolution) = (s.one_in(2), s.number(0.0, 0.1));
        GridMap::with_resolution(values, &x, &y, geographic, resolution).and_then(|m| clothed(s, m)).ok()
    };
    let Some(map) = made else { return };
    let known = (0..map.values().len()).map(|i| map.values().get(i)).filter(|v| v.is_finite());
    let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
    let slack = 1e-6 * (high - low).abs().max(low.abs()).max(high.abs());
    let (first, cell) = extent(&map);
    for _ in 0..6 {
        let mut place = [0, 1].map(|a| first[a] + cell[a] * s.within(-1.0, 14.0));
        if s.one_in(4) {
            place[s.below(2)] = s.number(-1e6, 1e6);
        }
        let [x, y] = place;
        for method in [Interpolation::Bilinear, Interpolation::Bicubic] {
            let (value, gradient) = map.sample_and_gradient(x, y, method);
            assert!(!value.is_infinite() || low.abs().max(high.abs()) > 1e300, "{value} at {place:?}");
            // Beside a hole there is a value on the edge, and no slope.
            assert!(!value.is_nan() || gradient.iter().any(|g| g.is_nan()), "{value} {gradient:?} at {place:?}");
            assert_eq!(value.to_bits(), map.sample(x, y, method).to_bits());
            if method == Interpolation::Bilinear && value.is_finite() {
                assert!(value >= low - slack && value <= high + slack, "{value} outside of [{low}, {high}]");
            }
        }
        let sigma = map.sigma(x, y);
        assert!(sigma.is_nan() || sigma >= 0.0, "sigma {sigma}");
        let between = map.between_sigma(x, y);
        assert!(between.is_nan() || between >= 0.0, "between the nodes {between}");
        if let Some((least, most)) = map.bounds(x, y, cell[0].abs() * s.within(0.0, 3.0), cell[1].abs()) {
            assert!(least <= most);
        }
        let height = s.number(-100.0, 1000.0);
        let (value, _) = map.value_and_gradient_at(x, y, height);
        assert!(!value.is_infinite() || height.abs() > 1e6 || high - low > 1e6, "{value} at height {height}");
    }
    let (a, b, c, d) = (s.below(15), s.below(15), s.below(15), s.below(15));
    if let Ok(part) = map.window(a..b, c..d) {
        assert_eq!(part.values().len(), (b - a) * (d - c));
    }
    if let Ok(stack) = MapStack::new(vec![map]) {
        let height = s.number(-10.0, 600.0);
        let _ = stack.at(height).map(|m| m.holes());
        let _ = stack.sample(first[0], first[1], height, Interpolation::Bicubic);
    }
}
