//! Saved states: any bytes give an error or an object that goes on.

use std::sync::{Arc, LazyLock};

use geomag_core::compensation::Compensator;
use geomag_core::field::Field;
use geomag_core::fix::Fix;
use geomag_core::grid::{Axis, GridMap, GridValues, Interpolation};
use geomag_core::harmonic::{FitOptions, Observations, Positions, RectangularHarmonicModel, fit};
use geomag_core::kalman::{ExtendedKalmanFilter, Scaling, UnscentedKalmanFilter};
use geomag_core::matching::contour::ContourOptions;
use geomag_core::matching::grid_search::{GridSearch, match_grid};
use geomag_core::matching::iema::{Iema, IemaOptions};
use geomag_core::matching::posterior::{PosteriorMatcher, PosteriorOptions};
use geomag_core::matching::sequence::DeltaModulator;
use geomag_core::matching::similarity::Criterion;
use geomag_core::matching::sliding::{SlidingContour, SlidingState};
use geomag_core::matching::stream::{Sample, Stream};
use geomag_core::monitor::Quiet;
use geomag_core::navigation::field_navigator::{self, FieldNavigator};
use geomag_core::navigation::ins_feedback::{InsErrorModel, InsFeedback};
use geomag_core::navigation::navigator::{Indicated, Navigator};
use geomag_core::navigation::sensing::Sensing;
use geomag_core::state::{self, Saved};
use geomag_core::synthetic::{CrustSpec, Path, SyntheticField};
use geomag_core::track::Track;

use crate::navigation::flown;
use crate::source::Source;

/// Head, up to the name, and body of a saved state.
fn opened(bytes: &[u8]) -> (&[u8], &[u8]) {
    let two = |bytes| postcard::take_from_bytes::<(&str, &str)>(bytes).expect("a state begins with two names").1;
    let rest: &[u8] = two(bytes);
    let body = postcard::take_from_bytes::<(u64, u64)>(rest).expect("then length and checksum").1;
    (&bytes[..bytes.len() - rest.len()], body)
}

/// Bytes whose length and checksum fit: what is in them is then for the object itself to judge.
fn sealed(head: &[u8], body: &[u8]) -> Vec<u8> {
    let sum =
        body.iter().fold(0xcbf2_9ce4_8422_2325_u64, |sum, b| (sum ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3));
    let mut out = head.to_vec();
    out.extend(postcard::to_stdvec(&(body.len() as u64, sum)).expect("two numbers can be written"));
    out.extend_from_slice(body);
    out
}

/// The bytes with what the case wants of them.
fn bent(s: &mut Source<'_>, honest: &[u8]) -> Vec<u8> {
    let (head, body) = opened(honest);
    let mut body = body.to_vec();
    match s.below(8) {
        0 => return s.rest().to_vec(),
        1 => body = s.rest().to_vec(),
        _ => {
            for _ in 0..=s.below(4) {
                let at = usize::from(u16::from_le_bytes([s.byte(), s.byte()])) % body.len().max(1);
                match s.below(5) {
                    0 => body.truncate(at),
                    1 => body.insert(at.min(body.len()), s.byte()),
                    2 if at + 8 <= body.len() => {
                        body[at..at + 8].copy_from_slice(&s.number(-100.0, 100.0).to_le_bytes());
                    }
                    _ if at < body.len() => body[at] = s.byte(),
                    _ => {}
                }
            }
        }
    }
    sealed(head, &body)
}

fn small_map() -> GridMap {
    let values = (0..144).map(|i| 30.0 * (f64::from(i % 12) * 0.9).sin() * (f64::from(i / 12) * 0.7).cos()).collect();
    let axis = || Axis::new(0.0, 100.0, 12).expect("an axis");
    GridMap::from_axes(GridValues::F64(values), axis(), axis(), false).expect("a map")
}

/// What is saved, as it should be, and what becomes of other bytes.
struct Kind {
    honest: Vec<u8>,
    tried: fn(&[u8]),
}

static MAP: LazyLock<Arc<GridMap>> = LazyLock::new(|| Arc::new(small_map()));
static FIELD: LazyLock<Arc<dyn Field>> = LazyLock::new(|| MAP.clone());

fn stream<S: Stream>(loaded: geomag_core::error::Result<S>, restore: impl Fn(&[u8]) -> geomag_core::error::Result<S>) {
    let Ok(mut stream) = loaded else { return };
    for k in 0..3 {
        let sample = Sample { place: [300.0 + 50.0 * f64::from(k), 400.0], value: 3.0, height_m: None };
        let _ = stream.take(&sample, &Quiet);
    }
    let _ = stream.answer();
    restore(&stream.saved().expect("what goes on can be written")).expect("and is read again");
    let _ = stream.begin_again();
}

fn object<T: Saved>(bytes: &[u8]) -> Option<T> {
    let object: T = state::load(bytes).ok()?;
    let again = state::save(&object).expect("what was read can be written");
    state::load::<T>(&again).expect("and is read again");
    Some(object)
}

fn fed<S: Stream>(mut stream: S) -> Vec<u8> {
    for k in 0..5 {
        let place = [250.0 + 60.0 * f64::from(k), 300.0 + 40.0 * f64::from(k)];
        let value = MAP.value(place[0] + 50.0, place[1] - 30.0);
        stream.take(&Sample { place, value, height_m: None }, &Quiet).expect("a sample as it should be");
    }
    stream.saved().expect("a state can be written")
}

fn sensing() -> Sensing {
    Sensing::map(FIELD.clone(), Interpolation::Bilinear)
}

static KINDS: LazyLock<Vec<Kind>> = LazyLock::new(|| {
    let written = "a state can be written";
    let iema = Iema::new(FIELD.clone(), IemaOptions::new(5.0, [200.0, 200.0])).expect("IEMA");
    // Over few offsets and once: the search in stages has targets of its own.
    let once = PosteriorOptions {
        step: Some([50.0, 50.0]),
        misfit_threshold: Some(f64::INFINITY),
        ..PosteriorOptions::new([150.0, 150.0])
    };
    let posterior = PosteriorMatcher::new(FIELD.clone(), Some(1.0), once, 8).expect("matcher");
    let sliding = SlidingState::new(4, Some(1.0), 10.0, ContourOptions::default()).expect("window");
    let mut delta = DeltaModulator::new(2.0).expect("modulator");
    delta.update(3.0).expect("a value");
    let mut feedback = InsFeedback::new(InsErrorModel::default(), false, 0.999).expect("feedback");
    feedback.step(0.0, 10.0, 20.0, Some(([5.0, 6.0], [[100.0, 1.0], [1.0, 90.0]]))).expect("a step");
    let ukf = UnscentedKalmanFilter::new(&[1.0, 2.0], &[4.0, 1.0, 1.0, 3.0], Scaling::default()).expect("filter");
    let ekf = ExtendedKalmanFilter::new(&[1.0, 2.0], &[4.0, 1.0, 1.0, 3.0]).expect("filter");
    let mut walking = FieldNavigator::new(
        sensing(),
        field_navigator::FieldNavigatorOptions { start: [300.0, 300.0], bias_sigma: 2.0, ..Default::default() },
    )
    .expect("navigator");
    walking.step(1.0, 10.0, 45.0, Some(&[3.0])).expect("a step");
    let k: Vec<f64> = (0..6).map(|k| 300.0 + 60.0 * f64::from(k)).collect();
    let values = k.iter().map(|x| MAP.value(*x + 40.0, *x)).collect();
    let track = Track::new(k.clone(), k.clone(), values, None).expect("track");
    let search = GridSearch { surface: true, ..GridSearch::new(Criterion::Msd, [100.0, 100.0]) };
    let fix = match_grid(FIELD.as_ref(), &track, &search, &Quiet).expect("fix");
    let path = Path::straight([0.0, 0.0], 30.0, 10.0, 1.0, 4, false).expect("path");
    let crust =
        CrustSpec { waves: 3, dipoles: 2, ..CrustSpec::default() }.draw([0.0, 0.0, 1e4, 1e4], false, 1).expect("field");
    let compensator = Compensator::new([0.5; 18], 2.0).expect("compensator");
    let kind = |honest: Vec<u8>, tried: fn(&[u8])| Kind { honest, tried };
    vec![
        kind(fed(iema), |b| stream(Iema::restore(FIELD.clone(), b), |b| Iema::restore(FIELD.clone(), b))),
        kind(fed(posterior), |b| {
            stream(PosteriorMatcher::load(FIELD.clone(), b), |b| PosteriorMatcher::load(FIELD.clone(), b));
        }),
        kind(fed(SlidingContour::new(MAP.clone(), sliding)), |b| {
            stream(SlidingContour::restore(MAP.clone(), b), |b| SlidingContour::restore(MAP.clone(), b));
        }),
        kind(flown(&FIELD, 12).save().expect(written), |b| {
            let Ok(mut navigator) = Navigator::restore(FIELD.clone(), b) else { return };
            let time = 100.0;
            for k in 0..3 {
                let mut at = Indicated::at(time + f64::from(k), 400.0, 500.0);
                at.value = Some(2.0);
                let terms = vec![0.1; navigator.options().terms()];
                if let Ok(step) = navigator.step_with_terms(&at, &terms) {
                    assert!(!step.protection_level_m.is_nan() && !step.x.is_nan(), "{step:?}");
                }
            }
            let bytes = navigator.save().expect("what goes on can be written");
            Navigator::restore(FIELD.clone(), &bytes).expect("and is read again");
        }),
        kind(walking.save().expect(written), |b| {
            let Ok(mut navigator) = FieldNavigator::restore(sensing(), b) else { return };
            for _ in 0..3 {
                if let Ok(step) = navigator.step(1.0, 10.0, 45.0, Some(&[3.0])) {
                    assert!(!step.x.is_nan() && !step.covariance_m2[0][0].is_nan(), "{step:?}");
                }
            }
            let bytes = navigator.save().expect("what goes on can be written");
            FieldNavigator::restore(sensing(), &bytes).expect("and is read again");
        }),
        kind(state::save(&feedback).expect(written), |b| {
            let Some(mut feedback) = object::<InsFeedback>(b) else { return };
            let _ = feedback.step(1e6, 10.0, 20.0, Some(([5.0, 6.0], [[100.0, 1.0], [1.0, 90.0]])));
            let bytes = state::save(&feedback).expect("what goes on can be written");
            state::load::<InsFeedback>(&bytes).expect("and is read again");
        }),
        kind(state::save(&ukf).expect(written), |b| {
            let Some(mut ukf) = object::<UnscentedKalmanFilter>(b) else { return };
            let n = ukf.estimate().len();
            let read = |x: &[f64], out: &mut [f64]| -> geomag_core::error::Result<()> {
                out[0] = x.first().copied().unwrap_or(0.0);
                Ok(())
            };
            if n < 50 {
                let _ = ukf.update(&[1.0], read, &[2.0], None);
            }
        }),
        kind(state::save(&ekf).expect(written), |b| {
            let Some(mut ekf) = object::<ExtendedKalmanFilter>(b) else { return };
            let n = ekf.estimate().len();
            let _ = ekf.update(&[1.0], &[0.5], &vec![1.0; n], &[2.0], None);
        }),
        kind(state::save(&delta).expect(written), |b| {
            let Some(mut delta) = object::<DeltaModulator>(b) else { return };
            let _ = delta.update(1.0);
        }),
        kind(state::save(&fix).expect(written), |b| drop(object::<Fix>(b))),
        kind(state::save(&path).expect(written), |b| {
            let Some(path) = object::<Path>(b) else { return };
            assert!(path.x().iter().all(|x| x.is_finite()));
        }),
        kind(state::save(&crust).expect(written), |b| {
            let Some(field) = object::<SyntheticField>(b) else { return };
            let _ = field.value(10.0, 10.0);
        }),
        kind(state::save(&compensator).expect(written), |b| {
            let Some(mut compensator) = object::<Compensator>(b) else { return };
            let _ = compensator.update(1e9, [1.0, 2.0, 3.0], 4.0);
        }),
    ]
});

static MODEL: LazyLock<String> = LazyLock::new(|| {
    let north: Vec<f64> = (0..36).map(|k| 1e3 * f64::from(k % 6)).collect();
    let east: Vec<f64> = (0..36).map(|k| 1e3 * f64::from(k / 6)).collect();
    let down = vec![0.0; 36];
    let positions = Positions::new(&north, &east, &down).expect("positions");
    let field: Vec<[f64; 3]> = north.iter().map(|x| [1.0, 2.0, (x / 2e3).cos()]).collect();
    let mut observations = Observations::new();
    observations.vector(&positions, &field, &[]).expect("observations");
    let options = FitOptions { order: 1, ..FitOptions::default() };
    fit(&observations, &options, &Quiet).and_then(|m| m.to_json()).expect("a model")
});

/// Every saved type, and the text of a harmonic model.
pub fn state(data: &[u8]) {
    let s = &mut Source::new(data);
    let which = s.below(KINDS.len() + 1);
    if let Some(kind) = KINDS.get(which) {
        let bytes = bent(s, &kind.honest);
        (kind.tried)(&bytes);
        return;
    }
    let mut text = MODEL.clone().into_bytes();
    for _ in 0..=s.below(3) {
        let at = usize::from(u16::from_le_bytes([s.byte(), s.byte()])) % text.len();
        match s.below(3) {
            0 => text.truncate(at.max(1)),
            1 => text.insert(at, s.byte()),
            _ => text[at] = s.one_of(b"0123456789-.e,[]{}\"n"),
        }
    }
    let Ok(text) = String::from_utf8(text) else { return };
    if let Ok(model) = RectangularHarmonicModel::from_json(&text) {
        let again = model.to_json().expect("a model can be written");
        RectangularHarmonicModel::from_json(&again).expect("a model that was written is read");
        let _ = model.field_at([1.0, 2.0, 3.0]);
        let place = [1.0];
        let _ = model.sigma(&Positions::new(&place, &place, &place).expect("one place"), true);
    }
}
