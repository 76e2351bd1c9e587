//! Sweeps of over-relaxation over the nodes of one level.
//!
//! The stencil of the curvature reaches two rows up and down, so every third row is independent of its like: the rows of one class are relaxed by
//! several threads at once, with the same answer for any number of them. Within a row all that is not the two nodes just relaxed is summed first,
//! in vectors; the recursion along the row is then one product and one sum a node.

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
    /// Of every node: the factor of what its neighbours ask for (0 where it is held), of what it was, and what its data add.
    nodes: [Vec<[f64; 3]>; CLASSES],
    /// The surface, by classes of rows.
    surface: [Vec<f64>; CLASSES],
}

impl<'a> Level<'a> {
    /// `weight` is that of one datum; `near` says of every node whether it is relaxed, all where there is nothing.
    pub fn new(bins: &'a [Bin], size: [usize; 2], aspect: f64, weight: f64, near: Option<&[bool]>) -> Self {
        let [columns, rows] = size;
        let spans = (0..rows).map(|r| near.map_or(vec![(0, columns)], |n| runs(&n[r * columns..(r + 1) * columns])));
        let spans = spans.collect();
        let count = |k: usize| (rows + CLASSES - 1 - k) / CLASSES * columns;
        let nodes = [0, 1, 2].map(|k| vec![[0.0; 3]; count(k)]);
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
                    self.nodes[r % CLASSES][place] = [RELAXATION / centre, 1.0 - RELAXATION, 0.0];
                    continue;
                }
                let (c0, c1) = (c.saturating_sub(1), (c + 1).min(columns - 1));
                let (r0, r1) = (r.saturating_sub(1), (r + 1).min(rows - 1));
                let gx = slope(self.row(r)[c0], self.row(r)[c1], c1 - c0);
                let gy = slope(self.row(r0)[c], self.row(r1)[c], r1 - r0);
                let target = bin.value - bin.away[0] * gx - bin.away[1] * gy;
                let held = self.weight * f64::from(bin.count);
                self.nodes[r % CLASSES][place] = if held.is_infinite() {
                    [0.0, 1.0, 0.0]
                } else {
                    let factor = RELAXATION / (centre + held);
                    [factor, 1.0 - RELAXATION, factor * held * target]
                };
                if held.is_infinite() {
                    self.surface[r % CLASSES][place] = target;
                }
            }
        }
    }

    /// One sweep over all rows.
    pub fn sweep(&mut self) {
        for class in 0..CLASSES {
            let mut own = std::mem::take(&mut self.surface[class]);
            let (level, columns) = (&*self, self.columns);
            own.par_chunks_mut(columns).zip(level.nodes[class].par_chunks(columns)).enumerate().for_each_init(
                || vec![[0.0; 3]; columns],
                |scratch, (k, (row, nodes))| level.relax(k * CLASSES + class, row, nodes, scratch),
            );
            self.surface[class] = own;
        }
    }

    /// Relaxes row `r`, which is `row`; the rows of other classes are read.
    fn relax(&self, r: usize, row: &mut [f64], nodes: &[[f64; 3]], scratch: &mut [[f64; 3]]) {
        let inner_row = r >= 2 && r + 2 < self.rows;
        for &(start, end) in &self.spans[r] {
            let low = if inner_row { start.max(2).min(end) } else { end };
            let high = if inner_row { end.min(self.columns.saturating_sub(2)).max(low) } else { end };
            for (c, node) in (start..low).zip(&nodes[start..low]) {
                self.border(r, c, row, node);
            }
            if low < high {
                self.inner(r, low, high, row, nodes, scratch);
            }
            for (c, node) in (high..end).zip(&nodes[high..end]) {
                self.border(r, c, row, node);
            }
        }
    }

    /// Nodes of which all neighbours exist.
    fn inner(&self, r: usize, low: usize, high: usize, row: &mut [f64], nodes: &[[f64; 3]], scratch: &mut [[f64; 3]]) {
        let ax = self.ax;
        let (across, along) = (4.0 * ax * ax + 4.0 * ax, 4.0 + 4.0 * ax);
        let (from, to) = (low - 2, high + 2);
        let cut = |r: usize| &self.row(r)[from..to];
        let (down2, down, up, up2) = (cut(r - 2), cut(r - 1), cut(r + 1), cut(r + 2));
        let old = &row[from..to];
        let n = high - low;
        for i in 0..n {
            let k = i + 2;
            let [factor, kept, pull] = nodes[low + i];
            let rest = across * old[k + 1] - ax * ax * old[k + 2] + along * (down[k] + up[k])
                - 2.0 * ax * (down[k - 1] + down[k + 1] + up[k - 1] + up[k + 1])
                - (down2[k] + up2[k]);
            scratch[i] = [kept * old[k] + pull + factor * rest, factor * across, -factor * ax * ax];
        }
        let (mut before, mut last) = (row[low - 2], row[low - 1]);
        for (value, [own, one, two]) in row[low..high].iter_mut().zip(&scratch[..n]) {
            let new = (own + two * before) + one * last;
            (before, last) = (last, new);
            *value = new;
        }
    }

    /// The border is soft: harmonic, from the neighbours that there are.
    fn border(&self, r: usize, c: usize, row: &mut [f64], node: &[f64; 3]) {
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
        let [factor, kept, pull] = *node;
        row[c] = kept * row[c] + pull + factor * self.centre() * free;
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
