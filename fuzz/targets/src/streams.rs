//! Matchers that are fed sample by sample.

use std::sync::Arc;

use geomag_core::error::Result;
use geomag_core::field::Field;
use geomag_core::matching::iema::{Iema, IemaOptions, Unknown};
use geomag_core::matching::posterior::PosteriorMatcher;
use geomag_core::matching::sliding::{SlidingContour, SlidingState};
use geomag_core::matching::stream::{Sample, Stream};
use geomag_core::monitor::Quiet;

use crate::maps;
use crate::matchers::{assert_sound, contour_options, half_width, posterior_options};
use crate::source::Source;

/// Feeds a stream in any order of calls; asserts that a refused sample leaves it, and that saved bytes bring it back.
fn drive<S: Stream>(mut stream: S, restore: impl Fn(&[u8]) -> Result<S>, s: &mut Source<'_>, field: &dyn Field) {
    let Some(track) = maps::track(s, field, 10) else { return };
    for k in 0..track.len() {
        match s.below(12) {
            0 => stream.begin_again().expect("what was made once is made again"),
            1 => {
                let bytes = stream.saved().expect("a state can be written");
                stream = restore(&bytes).expect("a state that was written is read");
                assert_eq!(stream.saved().expect("again"), bytes);
            }
            2 => {
                let mut bad = Sample::of(&track, k);
                match s.below(4) {
                    0 => bad.place[0] = s.number(-1e9, 1e9),
                    1 => bad.place[1] = s.number(-1e9, 1e9),
                    2 => bad.value = s.number(-1e9, 1e9),
                    _ => bad.height_m = s.maybe(-1e4, 1e4),
                }
                let before = stream.saved().expect("a state can be written");
                if stream.take(&bad, &Quiet).is_err() {
                    assert_eq!(stream.saved().expect("again"), before, "a refused sample left its mark: {bad:?}");
                }
            }
            3 => {
                if let Ok(fix) = stream.answer() {
                    assert_sound(&fix);
                }
            }
            _ => {
                let before = stream.seen();
                match stream.take(&Sample::of(&track, k), &Quiet) {
                    Ok(step) => {
                        assert!(stream.seen() > before);
                        if let Some(fix) = &step.fix {
                            assert_sound(fix);
                        }
                    }
                    Err(_) => assert_eq!(stream.seen(), before),
                }
            }
        }
    }
    if let Ok(fix) = stream.answer() {
        assert_sound(&fix);
    }
    assert!(stream.holds().is_none_or(|h| h >= 1));
}

/// IEMA.
pub fn iema(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let (_, cell) = maps::extent(field.as_ref());
    let mut options = IemaOptions::new(s.number(0.1, 20.0), half_width(s, cell, 3.0));
    options.tolerance = if s.one_in(2) { half_width(s, cell, 1.0) } else { [0.0; 2] };
    options.step = s.one_in(2).then(|| [0, 1].map(|a| cell[a].abs() * s.number(0.2, 1.5)));
    options.max_misses = u32::from(s.byte() % 4);
    options.unknown = s.one_of(&[Unknown::Keep, Unknown::Drop]);
    options.gate_sigmas = s.number(0.5, 5.0);
    options.max_candidates = 1000;
    let Ok(iema) = Iema::new(field.clone(), options) else { return };
    drive(iema, |bytes| Iema::restore(field.clone(), bytes), s, field.as_ref());
}

/// The calibrated matcher, streaming.
pub fn posterior(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(field) = maps::field(s) else { return };
    let options = posterior_options(s, maps::extent(field.as_ref()).1);
    let (sigma, most) = (s.maybe(0.1, 5.0), s.below(12));
    let Ok(matcher) = PosteriorMatcher::new(field.clone(), sigma, options, most) else { return };
    drive(matcher, |bytes| PosteriorMatcher::load(field.clone(), bytes), s, field.as_ref());
}

/// Contour matching over a window.
pub fn sliding(data: &[u8]) {
    let s = &mut Source::new(data);
    let Some(map) = maps::tame(s) else { return };
    let map = Arc::new(map);
    let [east, _] = map.metres_per_unit(map.y().first());
    let mut options = contour_options(s, (map.x().step() * east).abs().max(1e-3));
    options.max_iterations = options.max_iterations.min(6);
    let (length, sigma, floor) = (s.below(7), s.maybe(0.1, 5.0), s.number(0.0, 100.0));
    let Ok(state) = SlidingState::new(length, sigma, floor, options) else { return };
    let stream = SlidingContour::new(map.clone(), state);
    drive(stream, |bytes| SlidingContour::restore(map.clone(), bytes), s, map.as_ref());
}
