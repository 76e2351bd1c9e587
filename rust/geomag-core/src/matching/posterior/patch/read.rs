//! Reading a window at many places at once: row by row, within one cell, or each by itself.

use super::place::{Cells, Corners, LANES, NodeAccess, PatchPlace, RUNS, Spots, along};
use super::window::{Patch, VALUE};

impl Patch {
    /// Where a place (cells of the patch) lies at every offset.
    #[inline(always)]
    pub fn locate(&self, place: PatchPlace, cells: &Cells) -> Spots {
        let (column, u, on_columns) = along(place, 0, cells, self.columns);
        let (row, v, on_rows) = along(place, 1, cells, self.rows);
        let mut known = [0.0; LANES];
        for l in 0..LANES {
            known[l] = on_columns[l].min(on_rows[l]).min(1) as f32;
        }
        // What holds for both extremes holds for what lies between them.
        let [[left, right], [lower, upper]] = cells.extremes;
        let everywhere = on_columns[left] & on_columns[right] & on_rows[lower] & on_rows[upper] == 2;
        let (left, right, lower, upper) = (column[left], column[right], row[lower], row[upper]);
        let first = lower as usize * self.columns + left as usize;
        let room = self.columns + (LANES + 1) * cells.stride.max(1);
        let access = if cells.runs <= RUNS && everywhere && self.levels[0][VALUE].len() > first + room {
            NodeAccess::Rows
        } else if right - left <= 1 && upper - lower <= 1 {
            NodeAccess::Close([left, lower])
        } else {
            NodeAccess::Apart
        };
        Spots { u, v, known, column, row, access, level: place.level, share: place.share }
    }

    /// One quantity at the nodes around these spots.
    #[inline(always)]
    pub fn read<const QUANTITY: usize>(&self, cells: &Cells, spots: &mut Spots) -> Corners {
        if QUANTITY != VALUE {
            // What is known of the errors changes slowly with height: that of the nearest level will do.
            return self.read_level::<QUANTITY>(spots.level as usize + usize::from(spots.share > 0.5), cells, spots);
        }
        let mut corners = self.read_level::<QUANTITY>(spots.level as usize, cells, spots);
        if spots.share > 0.0 {
            let above = self.read_level::<QUANTITY>(spots.level as usize + 1, cells, spots);
            for (below, above) in corners.0.iter_mut().zip(&above.0) {
                for l in 0..LANES {
                    below[l] += spots.share * (above[l] - below[l]);
                }
            }
        }
        corners
    }

    #[inline(always)]
    fn read_level<const QUANTITY: usize>(&self, level: usize, cells: &Cells, spots: &mut Spots) -> Corners {
        self.read_plane(self.levels[level][QUANTITY].as_slice(), cells, spots)
    }

    /// A plane on the nodes of the patch at the nodes around these spots.
    #[inline(always)]
    pub fn read_plane(&self, plane: &[f32], cells: &Cells, spots: &mut Spots) -> Corners {
        let read = match spots.access {
            NodeAccess::Rows => self.in_rows(plane, cells, spots),
            NodeAccess::Close(lowest) => self.close(plane, lowest, spots),
            NodeAccess::Apart => None,
        };
        read.unwrap_or_else(|| self.apart(plane, spots))
    }

    /// Offsets a whole number of cells apart along x, row by row.
    #[inline(always)]
    fn in_rows(&self, plane: &[f32], cells: &Cells, spots: &Spots) -> Option<Corners> {
        match cells.stride {
            0 | 1 => self.in_rows_of::<1>(plane, cells, spots),
            2 => self.in_rows_of::<2>(plane, cells, spots),
            3 => self.in_rows_of::<3>(plane, cells, spots),
            4 => self.in_rows_of::<4>(plane, cells, spots),
            _ => self.in_rows_of::<0>(plane, cells, spots),
        }
    }

    /// The same for a `STRIDE` that is known, or any other (0).
    #[inline(always)]
    fn in_rows_of<const STRIDE: usize>(&self, plane: &[f32], cells: &Cells, spots: &Spots) -> Option<Corners> {
        let stride = if STRIDE == 0 { cells.stride } else { STRIDE };
        // Every row is written from its first lane on, beyond the last lane; the next one goes over the rest.
        let mut padded = [[0.0_f32; 2 * LANES]; 4];
        for &start in cells.starts.iter().take(cells.runs) {
            let low = spots.row[start] as usize * self.columns + spots.column[start] as usize;
            let high = low + self.columns;
            for (i, corner) in [low, low + 1, high, high + 1].into_iter().zip(&mut padded) {
                let corner = corner.get_mut(start..start + LANES)?;
                if STRIDE == 1 {
                    corner.copy_from_slice(plane.get(i..i + LANES)?);
                } else {
                    let nodes = plane.get(i..=i + (LANES - 1) * stride)?;
                    for (corner, node) in corner.iter_mut().zip(nodes.iter().step_by(stride)) {
                        *corner = *node;
                    }
                }
            }
        }
        let mut corners = Corners([[0.0; LANES]; 4]);
        for (corner, padded) in corners.0.iter_mut().zip(&padded) {
            corner.copy_from_slice(&padded[..LANES]);
        }
        Some(corners)
    }

    /// Places in one cell of the map or about the corner of four.
    #[inline(always)]
    fn close(&self, plane: &[f32], [column, row]: [i32; 2], spots: &Spots) -> Option<Corners> {
        let first = row as usize * self.columns + column as usize;
        let of_row = |row: usize| plane.get(first + row * self.columns..)?.first_chunk::<3>();
        let (&[a, b, c], &[d, e, f], &[g, h, i]) = (of_row(0)?, of_row(1)?, of_row(2)?);
        let mut corners = Corners([[0.0; LANES]; 4]);
        let [lower_left, lower_right, upper_left, upper_right] = &mut corners.0;
        for l in 0..LANES {
            let right = spots.column[l] > column;
            let up = spots.row[l] > row;
            let (a, b) = (if right { b } else { a }, if right { c } else { b });
            let (d, e) = (if right { e } else { d }, if right { f } else { e });
            let (g, h) = (if right { h } else { g }, if right { i } else { h });
            lower_left[l] = if up { d } else { a };
            lower_right[l] = if up { e } else { b };
            upper_left[l] = if up { g } else { d };
            upper_right[l] = if up { h } else { e };
        }
        Some(corners)
    }

    /// Places anywhere.
    #[inline(always)]
    fn apart(&self, plane: &[f32], spots: &mut Spots) -> Corners {
        let mut corners = Corners([[0.0; LANES]; 4]);
        for l in 0..LANES {
            let i = spots.row[l] as usize * self.columns + spots.column[l] as usize;
            if let Some(near) = self.around(plane, i) {
                for (corner, node) in corners.0.iter_mut().zip(near) {
                    corner[l] = node;
                }
            } else {
                spots.known[l] = 0.0;
            }
        }
        corners
    }
}
