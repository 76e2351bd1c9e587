//! Sweeps of over-relaxation over the nodes of one level.
//!
//! The stencil of the curvature reaches two rows up and down, so every third row is independent of its like: the rows of one class are relaxed by
//! several threads at once, with the same answer for any number of them. Within a row all that is not the two nodes just relaxed is summed first,
//! in vectors; the recursion along the row then goes two nodes at a time, which wait for the two before and not for each other.

// A kernel that is not inlined is not compiled for the instruction set that was chosen.
#![allow(clippy::inline_always)]

use std::ops::Range;

use rayon::prelude::*;

use super::Bin;

/// Over-relaxation of the sweeps.
const RELAXATION: f64 = 1.7;
/// Classes of rows that are relaxed one after the other.
const CLASSES: usize = 3;

/// What holds the nodes of a level, and which of them are relaxed.
pub(super) struct Level<'a> {
    bins: &'a [Bin],
    columns: usize,
    rows: usize,
    /// Squared stiffness ratio of x to y.
    ax: f64,
    /// Weight of one datum.
    weight: f64,
    /// First and one past the last node of every stretch of a row that is relaxed.
    spans: Vec<Vec<(usize, usize)>>,
    nodes: [Nodes; CLASSES],
    /// The surface, by classes of rows.
    surface: [Vec<f64>; CLASSES],
}

/// Of every node of a class of rows.
struct Nodes {
    /// The factor of what its neighbours ask for (0 where it is held),
    factor: Vec<f64>,
    /// the factor of what it was,
    kept: Vec<f64>,
    /// and what its data add.
    pull: Vec<f64>,
}

impl Nodes {
    fn new(count: usize) -> Self {
        let zeros = || vec![0.0; count];
        Self { factor: zeros(), kept: zeros(), pull: zeros() }
    }

    fn set(&mut self, place: usize, factor: f64, kept: f64, pull: f64) {
        (self.factor[place], self.kept[place], self.pull[place]) = (factor, kept, pull);
    }
}

/// Of the nodes of a row: what they will be but for the two before, and the factors of the one before and of the one before that.
#[derive(Default)]
struct RowRecursion {
    own: Vec<f64>,
    one: Vec<f64>,
    two: Vec<f64>,
}

impl<'a> Level<'a> {
    /// `weight` is that of one datum; `near` says of every node whether it is relaxed, all where there is nothing.
    pub fn new(bins: &'a [Bin], size: [usize; 2], aspect: f64, weight: f64, near: Option<&[bool]>) -> Self {
        let [columns, rows] = size;
        let spans = (0..rows).map(|r| near.map_or(vec![(0, columns)], |n| runs(&n[r * columns..(r + 1) * columns])));
        let spans = spans.collect();
        let count = |k: usize| (rows + CLASSES - 1 - k) / CLASSES * columns;
        let nodes = [0, 1, 2].map(|k| Nodes::new(count(k)));
        let surface = [0, 1, 2].map(|k| vec![0.0; count(k)]);
        Self { bins, columns, rows, ax: 1.0 / (aspect * aspect), weight, spans, nodes, surface }
    }

    /// Takes a surface over, row after row.
    pub fn load(&mut self, surface: &[f64]) {
        for (r, row) in surface.chunks_exact(self.columns).enumerate() {
            let start = r / CLASSES * self.columns;
            self.surface[r % CLASSES][start..start + self.columns].copy_from_slice(row);
        }
    }

    /// The surface, row after row.
    pub fn unload(&self) -> Vec<f64> {
        (0..self.rows).flat_map(|r| self.row(r).iter().copied()).collect()
    }

    fn row(&self, r: usize) -> &[f64] {
        let start = r / CLASSES * self.columns;
        &self.surface[r % CLASSES][start..start + self.columns]
    }

    fn centre(&self) -> f64 {
        6.0 * self.ax * self.ax + 6.0 + 8.0 * self.ax
    }

    /// Brings what data ask for up to date: their mean, moved to the node along the surface. Data of infinite weight are taken over.
    pub fn pin(&mut self) {
        let slope = |low: f64, high: f64, cells: usize| if cells > 0 { (high - low) / cells as f64 } else { 0.0 };
        let (columns, rows, centre) = (self.columns, self.rows, self.centre());
        for r in 0..rows {
            for c in 0..columns {
                let bin = &self.bins[r * columns + c];
                let place = r / CLASSES * columns + c;
                if bin.count == 0 {
                    self.nodes[r % CLASSES].set(place, RELAXATION / centre, 1.0 - RELAXATION, 0.0);
                    continue;
                }
                let (c0, c1) = (c.saturating_sub(1), (c + 1).min(columns - 1));
                let (r0, r1) = (r.saturating_sub(1), (r + 1).min(rows - 1));
                let gx = slope(self.row(r)[c0], self.row(r)[c1], c1 - c0);
                let gy = slope(self.row(r0)[c], self.row(r1)[c], r1 - r0);
                let target = bin.value - bin.away[0] * gx - bin.away[1] * gy;
                let held = self.weight * f64::from(bin.count);
                if held.is_infinite() {
                    self.nodes[r % CLASSES].set(place, 0.0, 1.0, 0.0);
                    self.surface[r % CLASSES][place] = target;
                } else {
                    let factor = RELAXATION / (centre + held);
                    self.nodes[r % CLASSES].set(place, factor, 1.0 - RELAXATION, factor * held * target);
                }
            }
        }
    }

    /// One sweep over all rows.
    pub fn sweep(&mut self) {
        for class in 0..CLASSES {
            let mut own = std::mem::take(&mut self.surface[class]);
            let (level, columns) = (&*self, self.columns);
            own.par_chunks_mut(columns).enumerate().for_each_init(RowRecursion::default, |recursion, (k, row)| {
                level.relax(k * CLASSES + class, row, recursion);
            });
            self.surface[class] = own;
        }
    }

    /// Relaxes row `r`, which is `row`; the rows of other classes are read.
    fn relax(&self, r: usize, row: &mut [f64], recursion: &mut RowRecursion) {
        let inner_row = r >= 2 && r + 2 < self.rows;
        for &(start, end) in &self.spans[r] {
            let low = if inner_row { start.max(2).min(end) } else { end };
            let high = if inner_row { end.min(self.columns.saturating_sub(2)).max(low) } else { end };
            for c in start..low {
                self.border(r, c, row);
            }
            if low < high {
                let inner = Inner { level: self, r, span: low..high, row, recursion };
                crate::instructions::chosen().dispatch(inner);
            }
            for c in high..end {
                self.border(r, c, row);
            }
        }
    }

    /// The border is soft: harmonic, from the neighbours that there are.
    fn border(&self, r: usize, c: usize, row: &mut [f64]) {
        let (mut sum, mut weight) = (0.0, 0.0);
        let mut add = |v: f64, w: f64| {
            sum += w * v;
            weight += w;
        };
        if c > 0 {
            add(row[c - 1], self.ax);
        }
        if c + 1 < self.columns {
            add(row[c + 1], self.ax);
        }
        if r > 0 {
            add(self.row(r - 1)[c], 1.0);
        }
        if r + 1 < self.rows {
            add(self.row(r + 1)[c], 1.0);
        }
        let free = if weight > 0.0 { sum / weight } else { row[c] };
        let (nodes, place) = (&self.nodes[r % CLASSES], r / CLASSES * self.columns + c);
        row[c] = nodes.kept[place] * row[c] + nodes.pull[place] + nodes.factor[place] * self.centre() * free;
    }
}

/// The nodes `span` of row `r`, which is `row`: of all of them all neighbours exist.
struct Inner<'a, 'b> {
    level: &'a Level<'b>,
    r: usize,
    span: Range<usize>,
    row: &'a mut [f64],
    recursion: &'a mut RowRecursion,
}

impl pulp::WithSimd for Inner<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _simd: S) {
        let Self { level, r, span, row, recursion } = self;
        let (ax, n) = (level.ax, span.len());
        let (across, along) = (4.0 * ax * ax + 4.0 * ax, 4.0 + 4.0 * ax);
        let (from, to) = (span.start - 2, span.end + 2);
        let cut = |r: usize| &level.row(r)[from..to];
        let (down2, down, up, up2) = (cut(r - 2), cut(r - 1), cut(r + 1), cut(r + 2));
        let old = &row[from..to];
        let first = r / CLASSES * level.columns + span.start;
        let nodes = &level.nodes[r % CLASSES];
        let [factor, kept, pull] = [&nodes.factor, &nodes.kept, &nodes.pull].map(|all| &all[first..first + n]);
        let RowRecursion { own, one, two } = recursion;
        for some in [&mut *own, &mut *one, &mut *two] {
            some.resize(level.columns, 0.0);
        }
        let (own, one, two) = (&mut own[..n], &mut one[..n], &mut two[..n]);
        for i in 0..n {
            let k = i + 2;
            let rest = across * old[k + 1] - ax * ax * old[k + 2] + along * (down[k] + up[k])
                - 2.0 * ax * (down[k - 1] + down[k + 1] + up[k - 1] + up[k + 1])
                - (down2[k] + up2[k]);
            own[i] = kept[i] * old[k] + pull[i] + factor[i] * rest;
            one[i] = factor[i] * across;
            two[i] = -factor[i] * ax * ax;
        }
        let (mut before, mut last) = (row[span.start - 2], row[span.start - 1]);
        let row = &mut row[span];
        let pairs = row.chunks_exact_mut(2).zip(own.chunks_exact(2)).zip(one.chunks_exact(2)).zip(two.chunks_exact(2));
        for (((row, own), one), two) in pairs {
            let next = (own[0] + two[0] * before) + one[0] * last;
            let after = ((own[1] + one[1] * own[0]) + one[1] * two[0] * before) + (two[1] + one[1] * one[0]) * last;
            (row[0], row[1]) = (next, after);
            (before, last) = (next, after);
        }
        if n % 2 == 1 {
            row[n - 1] = (own[n - 1] + two[n - 1] * before) + one[n - 1] * last;
        }
    }
}

/// Stretches of what is true.
fn runs(flags: &[bool]) -> Vec<(usize, usize)> {
    let mut out = Vec::new();
    let mut start = None;
    for (i, &flag) in flags.iter().chain(std::iter::once(&false)).enumerate() {
        match (flag, start) {
            (true, None) => start = Some(i),
            (false, Some(first)) => {
                out.push((first, i));
                start = None;
            }
            _ => {}
        }
    }
    out
}
