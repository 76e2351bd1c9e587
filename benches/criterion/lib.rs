//! Shared inputs of the benches: a rough map and straight tracks, the same in every run.

use geomag_core::grid::{GridMap, GridValues};

/// Nodes a side of [`rough_map`].
pub const SIDE: usize = 2200;

/// A value between -100 and 100 for a pair of node indices: a hash, so that no two neighbours agree.
pub fn rough(row: usize, column: usize) -> f64 {
    let mut h = (row as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ (column as u64).wrapping_mul(0xC2B2_AE3D_27D4_EB4F);
    h ^= h >> 29;
    h = h.wrapping_mul(0x1656_67B1_9E37_79F9);
    h ^= h >> 32;
    (h % 20_001) as f64 / 100.0 - 100.0
}

/// A map of [`SIDE`] x [`SIDE`] nodes at unit spacing.
///
/// # Panics
/// Never: the axes are even.
#[allow(clippy::expect_used)] // benches may stop
pub fn rough_map(single: bool) -> GridMap {
    let axis: Vec<f64> = (0..SIDE).map(|i| i as f64).collect();
    let node = |i: usize| rough(i / SIDE, i % SIDE);
    let values = if single {
        GridValues::F32((0..SIDE * SIDE).map(|i| node(i) as f32).collect())
    } else {
        GridValues::F64((0..SIDE * SIDE).map(node).collect())
    };
    GridMap::new(values, &axis, &axis, false).expect("an even grid")
}

/// `n` true points in the middle of the map that lie between nodes.
pub fn points(n: usize) -> Vec<[f64; 2]> {
    (0..n).map(|k| [900.3 + 2.1 * k as f64, 950.7 + 1.3 * k as f64]).collect()
}
