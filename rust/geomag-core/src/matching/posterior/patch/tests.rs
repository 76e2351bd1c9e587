//! Blocks read what single places do.

use super::*;
use crate::field::Field;
use crate::grid::{GridMap, GridValues, MapSigma};
use crate::stack::Storey;

/// A map of 20 by 15 nodes with a hole, or one whose sigma differs from node to node.
fn patch(uneven: bool) -> Patch {
    let axis = |n: u32| (0..n).map(f64::from).collect::<Vec<f64>>();
    let wave = |i: u32| 40.0 * (f64::from(i % 20) * 0.9).sin() + 25.0 * (f64::from(i / 20) * 0.7).cos();
    let values = (0..300).map(|i| if i == 153 { f64::NAN } else { wave(i) }).collect();
    let map = GridMap::new(GridValues::F64(values), &axis(20), &axis(15), false).unwrap();
    let sigma = if uneven {
        MapSigma::Grid((0..300).map(|i| 1.0 + 0.01 * f64::from(i)).collect())
    } else {
        MapSigma::Constant(2.0)
    };
    Patch::new(&map.with_sigma(Some(sigma)).unwrap(), [0.0; 2], [19.0, 14.0], 0, true).unwrap()
}

fn read_as_one_by_one(patch: &Patch, place: [f64; 2], offsets: &[[f64; 2]]) {
    let cells = Cells::new(offsets);
    let mut spots = patch.locate(PatchPlace::new(place), &cells);
    let value = patch.read::<VALUE>(&cells, &mut spots).mixed(&spots);
    let bend = patch.read::<BEND>(&cells, &mut spots).mixed(&spots);
    let (variance, distance) = if patch.even {
        let [variance, distance] = patch.everywhere(PatchPlace::new(place));
        ([variance; LANES], [distance; LANES])
    } else {
        let variance = patch.read::<VARIANCE>(&cells, &mut spots).mixed(&spots);
        (variance, patch.read::<DISTANCE>(&cells, &mut spots).mixed(&spots))
    };
    for (l, o) in offsets.iter().enumerate() {
        let wanted = patch.at(place[0] + o[0], place[1] + o[1], Storey::GROUND);
        let known = spots.known[l] > 0.0 && value[l].is_finite();
        assert_eq!(known, wanted.value.is_finite(), "{place:?} + {o:?}");
        if known {
            let curvature = 0.5 * bend[l] * (spots.u[l] * (1.0 - spots.u[l])).max(spots.v[l] * (1.0 - spots.v[l]));
            assert!((value[l] - wanted.value).abs() < 1e-4, "{place:?} + {o:?}: {} {}", value[l], wanted.value);
            assert!((variance[l] - wanted.variance).abs() < 1e-4);
            assert!((curvature - wanted.curvature).abs() < 1e-4);
            assert!((distance[l] - wanted.distance).abs() < 1e-3);
        }
    }
}

/// A field without a grid that says nothing of its error beyond x = 5.
#[derive(Debug)]
struct HalfKnown;

impl Field for HalfKnown {
    fn value(&self, x: f64, _y: f64) -> f64 {
        x
    }
    fn value_and_gradient(&self, x: f64, _y: f64) -> (f64, [f64; 2]) {
        (x, [1.0, 0.0])
    }
    fn sigma(&self, x: f64, _y: f64) -> f64 {
        if x > 5.0 { f64::NAN } else { 1.0 }
    }
    fn geographic(&self) -> bool {
        false
    }
    fn wrap_x(&self, x: f64) -> f64 {
        x
    }
    fn spacing(&self) -> [f64; 2] {
        [1.0; 2]
    }
    fn mean(&self) -> f64 {
        0.0
    }
}

#[test]
fn a_value_of_unknown_error_is_a_hole() {
    let patch = Patch::new(&HalfKnown, [0.0; 2], [10.0; 2], 10_000, false).unwrap();
    for (x, known) in [(2.5, true), (7.5, false)] {
        let [u, v] = patch.position(x, 3.0);
        assert_eq!(patch.at(u, v, Storey::GROUND).value.is_finite(), known, "at x = {x}");
    }
}

#[test]
fn blocks_read_what_single_places_do() {
    let lattice = |count: usize, columns: usize, step: f64| -> Vec<[f64; 2]> {
        (0..count).map(|i| [(i % columns) as f64 * step - 1.0, (i / columns) as f64 * step - 2.0]).collect()
    };
    let blocks = [
        lattice(16, 16, 1.0),
        lattice(16, 7, 1.0),
        lattice(13, 9, 1.0),
        lattice(16, 4, 0.125),
        lattice(16, 4, 0.5),
        lattice(5, 2, 0.01),
        lattice(16, 3, 1.7),
        lattice(16, 7, 2.0),
        lattice(14, 5, 3.0),
        lattice(16, 4, 5.0),
        vec![[0.0; 2]],
    ];
    for patch in [patch(false), patch(true)] {
        for offsets in &blocks {
            for place in (0..22).flat_map(|i| (0..18).map(move |j| [f64::from(i), f64::from(j)])) {
                read_as_one_by_one(&patch, place, offsets);
                read_as_one_by_one(&patch, [place[0] + 0.37, place[1] - 0.81], offsets);
            }
        }
    }
}

#[test]
fn a_row_stays_a_row_where_its_cells_begin() {
    let patch = patch(false);
    for a in [0.5_f32, 0.6, 0.7, 0.83, 0.999] {
        // Offsets whose parts differ by 1e-9 and round to neighbours, of which one reaches the next cell.
        let next = f32::from_bits(a.to_bits() + 1);
        let middle = 0.5 * (f64::from(a) + f64::from(next));
        let noise = |k: u32| 8e-10 * f64::from(k % 2) - 4e-10;
        let offsets: Vec<[f64; 2]> = (0..12).map(|k| [middle + f64::from(k) + noise(k), 0.25]).collect();
        read_as_one_by_one(&patch, [4.0 - f64::from(next), 3.5], &offsets);
    }
}

#[test]
fn the_edge_belongs_to_the_patch_whatever_rounding_says() {
    let patch = patch(false);
    for (place, offset) in [([0.3, 5.0], [-0.3, 0.0]), ([18.9, 13.9], [0.1, 0.1]), ([5.7, 0.1], [0.0, -0.1])] {
        let cells = Cells::new(&[offset]);
        let mut spots = patch.locate(PatchPlace::new(place), &cells);
        let value = patch.read::<VALUE>(&cells, &mut spots).mixed(&spots)[0];
        let wanted = patch.at(place[0] + offset[0], place[1] + offset[1], Storey::GROUND).value;
        assert!(spots.known[0] > 0.0 && (value - wanted).abs() < 1e-4, "{place:?}: {value} {wanted}");
    }
}
