//! The lattice kernels against sums over single map values, wherever the lattice lies on the map.
#![allow(clippy::unwrap_used)]

use geomag_core::grid::{GridMap, GridValues, Interpolation};
use geomag_core::lattice::{BestTwo, Comparison, OffsetLattice};
use geomag_core::matching::similarity::{Mad, Msd, Ncc};
use geomag_core::monitor::Quiet;
use proptest::prelude::*;

#[derive(Debug, Clone)]
struct Case {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
    single: bool,
    half: [usize; 2],
    per_cell: usize,
    points: Vec<[f64; 2]>,
    measured: Vec<f64>,
    weights: Option<Vec<f64>>,
    min_samples: usize,
}

fn position(len: usize) -> impl Strategy<Value = f64> {
    let fraction = prop_oneof![Just(0.0), Just(0.5), Just(1.0 - 1e-6), 0.0..1.0];
    (0..len, fraction).prop_map(|(cell, fraction)| cell as f64 + fraction)
}

fn case() -> impl Strategy<Value = Case> {
    (2_usize..70, 2_usize..50, any::<bool>(), 0_usize..25, 0_usize..20, 1_usize..4, 1_usize..45).prop_flat_map(
        |(columns, rows, single, half_x, half_y, per_cell, n)| {
            let holes = prop_oneof![3 => Just(0.0), 1 => Just(0.02), 1 => Just(0.4)];
            let node = (-100.0..100.0, 0.0..1.0);
            (
                prop::collection::vec(node, rows * columns),
                holes,
                prop::collection::vec((position(columns), position(rows)), n),
                prop::collection::vec(-100.0..100.0, n),
                prop::option::of(prop::collection::vec(0.1..3.0, n)),
                1..=n,
            )
                .prop_filter_map(
                    "a map of holes only",
                    move |(nodes, holes, points, measured, weights, min_samples)| {
                        let values: Vec<f64> =
                            nodes.iter().map(|&(v, u)| if u < holes { f64::NAN } else { v }).collect();
                        (!values.iter().all(|v| v.is_nan())).then(|| Case {
                            columns,
                            rows,
                            values,
                            single,
                            half: [half_x, half_y],
                            per_cell,
                            points: points.into_iter().map(|(x, y)| [x, y]).collect(),
                            measured,
                            weights,
                            min_samples,
                        })
                    },
                )
        },
    )
}

impl Case {
    fn map(&self) -> GridMap {
        let axis = |n: usize| (0..n).map(|i| i as f64).collect::<Vec<_>>();
        let values = if self.single {
            GridValues::F32(self.values.iter().map(|v| *v as f32).collect())
        } else {
            GridValues::F64(self.values.clone())
        };
        GridMap::new(values, &axis(self.columns), &axis(self.rows), false).unwrap()
    }

    fn comparison<'a>(&self, map: &'a GridMap) -> Comparison<'a> {
        let step = 1.0 / self.per_cell as f64;
        let lattice = OffsetLattice::new(self.half.map(|h| h as f64 * step), [step; 2], 1 << 20).unwrap();
        let (points, measured) = (self.points.clone(), self.measured.clone());
        let interpolation = Interpolation::Bilinear;
        Comparison::new(map, lattice, points, measured, self.weights.clone(), interpolation, self.min_samples).unwrap()
    }
}

/// Scores candidate by candidate by a function of (map value, measured, weight).
fn one_by_one(case: &Case, comparison: &Comparison<'_>, score: impl Fn(&[[f64; 3]]) -> f64) -> Vec<f64> {
    let lattice = comparison.lattice();
    let candidates = (0..lattice.rows()).flat_map(|r| (0..lattice.columns()).map(move |c| (r, c)));
    let known = |(r, c): (usize, usize)| {
        let sample =
            |k: usize| [comparison.map_value(k, r, c), case.measured[k], case.weights.as_ref().map_or(1.0, |w| w[k])];
        let known: Vec<[f64; 3]> = (0..case.points.len()).map(sample).filter(|s| !s[0].is_nan()).collect();
        if known.len() < case.min_samples { f64::NAN } else { score(&known) }
    };
    candidates.map(known).collect()
}

fn mean(samples: &[[f64; 3]], loss: impl Fn(f64) -> f64) -> f64 {
    let total: f64 = samples.iter().map(|s| s[2]).sum();
    samples.iter().map(|s| s[2] * loss(s[0] - s[1])).sum::<f64>() / total
}

fn assert_same(ours: &[f64], theirs: &[f64], tolerance: f64) {
    assert_eq!(ours.len(), theirs.len());
    for (i, (a, b)) in ours.iter().zip(theirs).enumerate() {
        assert!(
            a.is_nan() && b.is_nan() || (a - b).abs() <= tolerance * b.abs().max(1.0),
            "candidate {i}: {a} and {b}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn sums_are_those_of_single_map_values(case in case()) {
        let map = case.map();
        let comparison = case.comparison(&map);
        let (rows, columns) = (comparison.lattice().rows(), comparison.lattice().columns());
        let tolerance = if case.single { 2e-4 } else { 1e-9 };
        let msd = comparison.scores(Msd, 0..rows, 0..columns, None, &Quiet).unwrap();
        assert_same(&msd, &one_by_one(&case, &comparison, |s| mean(s, |r| r * r)), tolerance);
        let mad = comparison.scores(Mad, 0..rows, 0..columns, None, &Quiet).unwrap();
        assert_same(&mad, &one_by_one(&case, &comparison, |s| mean(s, f64::abs)), tolerance);
    }

    #[test]
    fn a_search_for_the_best_two_alone_finds_the_same(case in case(), away in [1.0_f64..4.0, 1.0_f64..4.0]) {
        let map = case.map();
        let comparison = case.comparison(&map);
        let (rows, columns) = (comparison.lattice().rows(), comparison.lattice().columns());
        let all = comparison.scores(Msd, 0..rows, 0..columns, None, &Quiet).unwrap();
        let contest = BestTwo::new(away);
        let some = comparison.scores(Msd, 0..rows, 0..columns, Some(&contest), &Quiet).unwrap();
        let least = |scores: &[f64], admit: &dyn Fn(usize) -> bool| {
            let admitted = (0..scores.len()).filter(|&i| admit(i) && !scores[i].is_nan());
            admitted.min_by(|&a, &b| scores[a].total_cmp(&scores[b]))
        };
        let best = least(&all, &|_| true);
        prop_assert_eq!(best, least(&some, &|_| true));
        if let Some(best) = best {
            let far = |i: usize| {
                (i / columns).abs_diff(best / columns) as f64 > away[1] || (i % columns).abs_diff(best % columns) as f64 > away[0]
            };
            prop_assert_eq!(all[best].to_bits(), some[best].to_bits());
            let rival = least(&all, &far);
            prop_assert_eq!(rival, least(&some, &far));
            prop_assert!(rival.is_none_or(|i| all[i].to_bits() == some[i].to_bits()));
        }
    }
}

#[test]
fn correlation_of_a_constant_with_anything_is_unknown() {
    let case = Case {
        columns: 9,
        rows: 9,
        values: vec![3.0; 81],
        single: false,
        half: [1, 1],
        per_cell: 1,
        points: vec![[3.2, 3.4], [4.1, 4.9], [5.5, 5.0]],
        measured: vec![-1.0, 0.0, 1.0],
        weights: None,
        min_samples: 2,
    };
    let map = case.map();
    let scores = case
        .comparison(&map)
        .scores(Ncc { level: 3.0, spread: 2.0, epsilon: f64::EPSILON }, 0..3, 0..3, None, &Quiet)
        .unwrap();
    assert!(scores.iter().all(|s| s.is_nan()), "{scores:?}");
}

#[test]
fn no_candidate_within_the_limit_is_given_up_for_rounded_weights() {
    // All candidates score alike, all of it from the first sample; the weights are summed in single precision.
    let axis = |n: usize| (0..n).map(|i| i as f64).collect::<Vec<_>>();
    let values = (0..11 * 61).map(|i| if i % 61 < 30 { 1.0 } else { 0.0 }).collect();
    let map = GridMap::new(GridValues::F32(values), &axis(61), &axis(11), false).unwrap();
    let lattice = OffsetLattice::new([3.0; 2], [1.0; 2], 1 << 20).unwrap();
    let mut points = vec![[50.0, 5.0]; 1000];
    points[0] = [10.0, 5.0];
    for weight in [0.1, 0.2, 0.3, 0.7, 1.1, 1.3, 1.7] {
        let weights = Some(vec![weight; 1000]);
        let comparison =
            Comparison::new(&map, lattice, points.clone(), vec![0.0; 1000], weights, Interpolation::Bilinear, 1)
                .unwrap();
        let all = comparison.scores(Msd, 0..7, 0..7, None, &Quiet).unwrap();
        assert!(all.iter().all(|s| *s == all[0]));
        let contest = BestTwo::new([0.0; 2]);
        contest.finished(all[0], 0, 0);
        contest.finished(all[0], 6, 6);
        assert_eq!(contest.limit(), all[0]);
        let some = comparison.scores(Msd, 0..7, 0..7, Some(&contest), &Quiet).unwrap();
        assert_eq!(all, some, "weight {weight}");
    }
}
