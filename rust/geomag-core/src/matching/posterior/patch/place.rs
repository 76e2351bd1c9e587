//! Places and offsets in cells of a patch, as whole cells and the rest.

use crate::stack::Storey;

/// Candidates handled together, so that the inner loops are vectors.
pub(in super::super) const LANES: usize = 16;
/// Largest distance in cells between a node and the hole next to it over which nothing is interpolated, for a sum of two parts of a cell
/// in single precision.
const PART_TOLERANCE: f32 = 4e-7;
/// Most rows of the lattice in one block up to which the map is read in rows.
pub(super) const RUNS: usize = 3;
/// Most cells between the offsets of such a row.
const MOST_STRIDE: f64 = 32.0;

/// Up to [`LANES`] offsets in cells, as whole cells and the rest; the last is repeated where there are fewer.
#[derive(Debug)]
pub(in super::super) struct Cells {
    pub(super) whole: [[i32; LANES]; 2],
    pub(super) part: [[f32; LANES]; 2],
    /// 1 for an offset, 0 for a repetition.
    pub used: [f32; LANES],
    /// Where rows of offsets a whole number of cells apart start, how many such rows there are, and that number.
    pub(super) starts: [usize; RUNS],
    pub(super) runs: usize,
    pub(super) stride: usize,
    /// Lanes of the least and the greatest offset along each axis.
    pub(super) extremes: [[usize; 2]; 2],
}

impl Cells {
    #[inline(always)]
    pub fn new(offsets: &[[f64; 2]]) -> Self {
        let mut cells = Self {
            whole: [[0; LANES]; 2],
            part: [[0.0; LANES]; 2],
            used: [0.0; LANES],
            starts: [0; RUNS],
            runs: usize::from(!offsets.is_empty()),
            stride: 0,
            extremes: [[0; 2]; 2],
        };
        for lane in 0..LANES {
            let Some(offset) = offsets.get(lane.min(offsets.len().wrapping_sub(1))) else { break };
            let mut place = PatchPlace::new(*offset);
            if lane < offsets.len() {
                cells.used[lane] = 1.0;
            }
            if lane > 0 && lane < offsets.len() {
                let before = offsets[lane - 1];
                let apart = offset[0] - before[0];
                if cells.stride == 0 {
                    cells.stride = apart.round().clamp(1.0, MOST_STRIDE) as usize;
                }
                if offset[1] == before[1] && (apart - cells.stride as f64).abs() < 1e-9 {
                    // To the bit, so that no rounding puts one of them into another cell than its row says.
                    place.part = cells.part.map(|part| part[lane - 1]);
                    place.whole = [cells.whole[0][lane - 1] + cells.stride as i32, cells.whole[1][lane - 1]];
                } else {
                    if cells.runs < RUNS {
                        cells.starts[cells.runs] = lane;
                    }
                    cells.runs += 1;
                }
            }
            for d in 0..2 {
                (cells.whole[d][lane], cells.part[d][lane]) = (place.whole[d], place.part[d]);
                let at = |lane: usize| (cells.whole[d][lane], cells.part[d][lane]);
                let [least, greatest] = cells.extremes[d];
                if at(lane) < at(least) {
                    cells.extremes[d][0] = lane;
                } else if at(lane) > at(greatest) {
                    cells.extremes[d][1] = lane;
                }
            }
        }
        cells
    }
}

/// A place in cells of the patch: whole cells, and the rest in [0, 1].
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct PatchPlace {
    pub(super) whole: [i32; 2],
    pub(super) part: [f32; 2],
    /// The level below the place, and the share of the one above.
    pub(super) level: u32,
    pub(super) share: f32,
}

impl PatchPlace {
    #[inline(always)]
    pub fn new(cells: [f64; 2]) -> Self {
        let whole = cells.map(|c| c.floor().clamp(-1e9, 1e9));
        let part = [0, 1].map(|d| (cells[d] - whole[d]) as f32);
        Self { whole: whole.map(|w| w as i32), part, level: 0, share: 0.0 }
    }

    /// The same place in a storey of the patch.
    pub fn in_storey(self, storey: Storey) -> Self {
        Self { level: storey.level as u32, share: storey.share as f32, ..self }
    }
}

/// Whole cells and the rest of a coordinate at every offset, on an axis of `size` nodes; 2 where it lies on the axis, 1 where
/// on either end of it, else 0.
#[inline(always)]
pub(super) fn along(
    place: PatchPlace,
    d: usize,
    cells: &Cells,
    size: usize,
) -> ([i32; LANES], [f32; LANES], [i32; LANES]) {
    let (place, rest, whole, part) = (place.whole[d], place.part[d], &cells.whole[d], &cells.part[d]);
    let last = size as i32 - 1;
    let (mut at, mut between, mut on) = ([0; LANES], [0.0; LANES], [0; LANES]);
    for l in 0..LANES {
        let sum = rest + part[l];
        let carry = sum >= 1.0;
        let cell = place + whole[l] + i32::from(carry);
        let sum = if carry { sum - 1.0 } else { sum };
        let before = (cell == -1) & (sum >= 1.0 - PART_TOLERANCE);
        let after = (cell == last) & (sum <= PART_TOLERANCE);
        let between_nodes = (cell >= 0) & (cell < last);
        let inside = (between_nodes | before | after) & (last > 0);
        let sum = if before { 0.0 } else { sum };
        between[l] = if after { 1.0 } else { sum };
        at[l] = cell.min(last - 1).max(0);
        on[l] = i32::from(inside) + i32::from(between_nodes);
    }
    (at, between, on)
}

/// Where a place lies at every offset.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(in super::super) struct Spots {
    /// Between the nodes, 0 to 1.
    pub u: [f32; LANES],
    pub v: [f32; LANES],
    /// 1 on the patch, 0 off it.
    pub known: [f32; LANES],
    /// Column and row of the lower left node.
    pub(super) column: [i32; LANES],
    pub(super) row: [i32; LANES],
    pub(super) access: NodeAccess,
    /// The level below, and the share of the one above.
    pub(super) level: u32,
    pub(super) share: f32,
}

/// How the nodes around the places are read.
#[derive(Debug, Clone, Copy)]
pub(super) enum NodeAccess {
    /// Row by row: the offsets are one cell apart.
    Rows,
    /// The places lie in one cell of the map or about the corner of four, of which this is the lower left one.
    Close([i32; 2]),
    /// Each by itself.
    Apart,
}

/// A quantity at the four nodes around every place: lower left, lower right, upper left, upper right.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(in super::super) struct Corners(pub [[f32; LANES]; 4]);

impl Corners {
    /// Interpolated.
    #[inline(always)]
    pub fn mixed(&self, spots: &Spots) -> [f32; LANES] {
        self.mixed_at(&spots.u, &spots.v)
    }

    /// Interpolated at other places between the nodes.
    #[inline(always)]
    pub fn mixed_at(&self, u: &[f32; LANES], v: &[f32; LANES]) -> [f32; LANES] {
        let [a, b, e, f] = &self.0;
        let mut mixed = [0.0; LANES];
        for l in 0..LANES {
            let low = a[l] + u[l] * (b[l] - a[l]);
            let high = e[l] + u[l] * (f[l] - e[l]);
            mixed[l] = low + v[l] * (high - low);
        }
        mixed
    }
}
