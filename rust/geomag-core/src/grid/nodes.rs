//! What stands at the nodes of a map: values, holes, standard deviations.

use std::ops::Range;

/// Values of a map, row-major, row = y ascending, column = x ascending.
#[derive(Debug, Clone, PartialEq)]
pub enum GridValues {
    /// Single precision: half the memory, about 1e-7 of the value's size in precision.
    F32(Vec<f32>),
    /// Double precision.
    F64(Vec<f64>),
}

impl GridValues {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::F32(v) => v.len(),
            Self::F64(v) => v.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Value `i` as double precision.
    #[inline]
    pub fn get(&self, i: usize) -> f64 {
        match self {
            Self::F32(v) => f64::from(v[i]),
            Self::F64(v) => v[i],
        }
    }

    pub(super) fn flip(&mut self, columns: usize, reverse_rows: bool, reverse_columns: bool) {
        fn flip<T>(v: &mut [T], columns: usize, reverse_rows: bool, reverse_columns: bool) {
            if reverse_rows && reverse_columns {
                v.reverse();
                return;
            }
            if reverse_columns {
                v.chunks_exact_mut(columns).for_each(<[T]>::reverse);
            }
            if reverse_rows {
                let rows = v.len() / columns;
                for i in 0..rows / 2 {
                    let (upper, lower) = v.split_at_mut((rows - 1 - i) * columns);
                    upper[i * columns..(i + 1) * columns].swap_with_slice(&mut lower[..columns]);
                }
            }
        }
        match self {
            Self::F32(v) => flip(v, columns, reverse_rows, reverse_columns),
            Self::F64(v) => flip(v, columns, reverse_rows, reverse_columns),
        }
    }
}

/// Standard deviation of a map's values against the true field.
#[derive(Debug, Clone, PartialEq)]
pub enum MapSigma {
    /// One number for the whole map, value units.
    Constant(f64),
    /// One number a node, in the map's own layout; NaN where unknown.
    Grid(Vec<f64>),
}

/// Height of a map's values, metres above its height datum, positive up.
#[derive(Debug, Clone, PartialEq)]
pub enum MapHeight {
    /// One height for the whole map.
    Level(f64),
    /// One height a node, in the map's own layout: a surface draped over the ground. NaN only on holes.
    Drape(Vec<f64>),
}

/// Where the holes of a map are, by blocks of nodes: one hole in a corner must not slow down the whole map.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Holes {
    pub count: usize,
    blocks_a_row: usize,
    /// Row-major; ends with the last row of blocks that has a hole.
    blocks: Vec<bool>,
}

impl Holes {
    /// Nodes a side of a block.
    const BLOCK: usize = 32;

    pub fn none(columns: usize) -> Self {
        Self { count: 0, blocks_a_row: columns.div_ceil(Self::BLOCK), blocks: Vec::new() }
    }

    pub fn add(&mut self, row: usize, column: usize) {
        self.count += 1;
        let first = row / Self::BLOCK * self.blocks_a_row;
        if self.blocks.len() <= first {
            self.blocks.resize(first + self.blocks_a_row, false);
        }
        self.blocks[first + column / Self::BLOCK] = true;
    }

    pub fn may_be_in(&self, rows: Range<usize>, columns: Range<usize>) -> bool {
        let across = columns.start / Self::BLOCK..columns.end.div_ceil(Self::BLOCK).min(self.blocks_a_row);
        let mut block_rows = self
            .blocks
            .chunks(self.blocks_a_row.max(1))
            .take(rows.end.div_ceil(Self::BLOCK))
            .skip(rows.start / Self::BLOCK);
        self.count > 0 && block_rows.any(|row| row[across.clone()].contains(&true))
    }
}

/// The part of row-major `values` in these rows and columns.
pub(super) fn part<T: Copy>(values: &[T], width: usize, rows: &Range<usize>, columns: &Range<usize>) -> Vec<T> {
    let mut out = Vec::with_capacity(rows.len() * columns.len());
    for row in rows.clone() {
        out.extend_from_slice(&values[row * width..][columns.clone()]);
    }
    out
}
