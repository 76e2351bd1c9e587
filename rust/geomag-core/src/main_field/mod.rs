//! The main field of the Earth: spherical harmonic models with coefficients that change with time.
//!
//! IGRF, the World Magnetic Model and its high-resolution twin are one thing: Schmidt semi-normalised coefficients at epochs,
//! linear in time between them (a secular variation is one more epoch). Coefficients are read elsewhere; this module
//! evaluates them at geodetic places on WGS84, each with a time of its own. Formulas: Langel, *The Main Field*, in
//! *Geomagnetism* vol. 1 (1987), section 4; the technical report of WMM2025, section 1.2.

mod synthesis;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use self::synthesis::{FieldSums, LANES, Recursion};
use crate::error::{Error, Result, require_finite};
use crate::monitor::Monitor;

/// Highest degree accepted: below it the recursion loses nothing that matters, poles included.
pub const HIGHEST_DEGREE: usize = 800;

/// Points between two looks at the monitor.
const CHUNK: usize = 1024;

/// A spherical harmonic model of the main field.
///
/// ```
/// use geomag_core::main_field::MainField;
/// // An axial dipole: at the equator the field points north, at the pole it is twice as strong and points down.
/// let dipole = MainField::new(1, vec![2025.0, 2030.0], vec![vec![-30_000.0, 0.0], vec![-30_000.0, 0.0]], vec![vec![0.0; 2]; 2])?;
/// let [north, east, down] = dipole.field(0.0, 10.0, 0.0, 2026.5)?;
/// assert!((north - 29_902.3).abs() < 0.1 && east == 0.0 && down.abs() < 1e-9);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "SavedMainField", into = "SavedMainField")]
pub struct MainField {
    degree: usize,
    epochs: Vec<f64>,
    /// As given: `[epoch][k]`, k counting (n, m) for m from 0 to n and n from 1.
    g: Vec<Vec<f64>>,
    h: Vec<Vec<f64>>,
    recursion: Recursion,
    /// `[epoch][(m, n)]`: g and h in the order of the recursion.
    ordered: Vec<Vec<[f64; 2]>>,
}

#[derive(Clone, Serialize, Deserialize)]
struct SavedMainField {
    degree: usize,
    epochs: Vec<f64>,
    g: Vec<Vec<f64>>,
    h: Vec<Vec<f64>>,
}

impl TryFrom<SavedMainField> for MainField {
    type Error = Error;

    fn try_from(s: SavedMainField) -> Result<Self> {
        Self::new(s.degree, s.epochs, s.g, s.h)
    }
}

impl From<MainField> for SavedMainField {
    fn from(f: MainField) -> Self {
        Self { degree: f.degree, epochs: f.epochs, g: f.g, h: f.h }
    }
}

/// Number of coefficient pairs up to a degree: (1, 0), (1, 1), (2, 0), ...
pub const fn pairs(degree: usize) -> usize {
    (degree + 1) * (degree + 2) / 2 - 1
}

impl MainField {
    /// A model from its coefficients, nT: one row of g and of h an epoch (decimal years, rising), pairs (n, m) in the order
    /// (1, 0), (1, 1), (2, 0), (2, 1), (2, 2), ...
    ///
    /// # Errors
    /// [`Error::Invalid`] for a degree of 0 or over [`HIGHEST_DEGREE`], fewer than two epochs or epochs that do not rise;
    /// [`Error::Shape`]; [`Error::NotFinite`].
    pub fn new(degree: usize, epochs: Vec<f64>, g: Vec<Vec<f64>>, h: Vec<Vec<f64>>) -> Result<Self> {
        crate::error::require_count("main field degree", degree, HIGHEST_DEGREE)?;
        require_finite("main field epochs", &epochs)?;
        if epochs.len() < 2 || epochs.windows(2).any(|w| w[1] <= w[0]) {
            return Err(Error::invalid("main field epochs", "at least two, rising", format!("{epochs:?}")));
        }
        for (name, table) in [("g", &g), ("h", &h)] {
            if table.len() != epochs.len() {
                let needed = format!("{} rows, one an epoch", epochs.len());
                return Err(Error::shape(format!("main field {name}"), needed, format!("{} rows", table.len())));
            }
            for (k, row) in table.iter().enumerate() {
                let what = format!("main field {name}[{k}]");
                if row.len() != pairs(degree) {
                    let needed = format!("({},), the pairs up to degree {degree}", pairs(degree));
                    return Err(Error::shape(what, needed, format!("({},)", row.len())));
                }
                require_finite(&what, row)?;
            }
        }
        let recursion = Recursion::new(degree);
        let ordered = g
            .iter()
            .zip(&h)
            .map(|(g, h)| {
                let mut row = Vec::with_capacity(pairs(degree));
                for m in 0..=degree {
                    for n in m.max(1)..=degree {
                        let k = n * (n + 1) / 2 + m - 1;
                        row.push([g[k], if m == 0 { 0.0 } else { h[k] }]);
                    }
                }
                row
            })
            .collect();
        Ok(Self { degree, epochs, g, h, recursion, ordered })
    }

    /// Highest degree.
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Epochs, decimal years.
    pub fn epochs(&self) -> &[f64] {
        &self.epochs
    }

    /// Coefficients g as given: a row an epoch.
    pub fn g(&self) -> &[Vec<f64>] {
        &self.g
    }

    /// Coefficients h as given: a row an epoch.
    pub fn h(&self) -> &[Vec<f64>] {
        &self.h
    }

    /// First and last time of the model, decimal years.
    pub fn span(&self) -> [f64; 2] {
        [self.epochs[0], self.epochs[self.epochs.len() - 1]]
    }

    /// North, east, down in nT at geodetic degrees, metres above WGS84 and a decimal year.
    ///
    /// # Errors
    /// As [`MainField::field_many`].
    pub fn field(&self, latitude_deg: f64, longitude_deg: f64, height_m: f64, year: f64) -> Result<[f64; 3]> {
        let many = self.field_many(&[latitude_deg], &[longitude_deg], &[height_m], &[year], &crate::monitor::Quiet)?;
        Ok(many[0])
    }

    /// North, east, down in nT at many places, each with its time.
    ///
    /// # Errors
    /// [`Error::Shape`] for unequal lengths, [`Error::NotFinite`], [`Error::Invalid`] naming the first latitude beyond a pole,
    /// place within 100 km of the Earth's centre or time outside the model's years, [`Error::Interrupted`].
    pub fn field_many(
        &self,
        latitude_deg: &[f64],
        longitude_deg: &[f64],
        height_m: &[f64],
        year: &[f64],
        monitor: &dyn Monitor,
    ) -> Result<Vec<[f64; 3]>> {
        let n = latitude_deg.len();
        for (name, values) in [("longitude_deg", longitude_deg), ("height_m", height_m), ("year", year)] {
            if values.len() != n {
                let needed = format!("({n},) as latitude_deg");
                return Err(Error::shape(format!("main field {name}"), needed, format!("({},)", values.len())));
            }
        }
        for (name, values) in
            [("latitude_deg", latitude_deg), ("longitude_deg", longitude_deg), ("height_m", height_m), ("year", year)]
        {
            require_finite(&format!("main field {name}"), values)?;
        }
        if let Some(i) = latitude_deg.iter().position(|l| l.abs() > 90.0) {
            let what = format!("main field latitude_deg[{i}]");
            return Err(Error::invalid(what, "a latitude in [-90, 90] degrees", latitude_deg[i]));
        }
        if let Some(i) = height_m.iter().position(|h| *h < -6.2e6) {
            let what = format!("main field height_m[{i}]");
            return Err(Error::invalid(what, "a height above -6.2e6 m", height_m[i]));
        }
        let [first, last] = self.span();
        if let Some(i) = year.iter().position(|y| !(first..=last).contains(y)) {
            let what = format!("main field date[{i}]");
            let needed = format!("a time within the model's years, {first} to {last}");
            return Err(Error::invalid(what, needed, format!("{:.4}", year[i])));
        }
        let mut out = vec![[0.0; 3]; n];
        let mut done = 0;
        // Blocks between looks at the monitor hold work for every thread.
        for block in out.chunks_mut(CHUNK * 8).enumerate() {
            let (b, rows) = block;
            let start = b * CHUNK * 8;
            rows.par_chunks_mut(LANES).enumerate().with_min_len(16).for_each(|(c, rows)| {
                let from = start + c * LANES;
                // A short last set repeats its last point: lanes do not meet.
                let pick = |values: &[f64]| std::array::from_fn(|lane| values[from + lane.min(rows.len() - 1)]);
                let at = [pick(latitude_deg), pick(longitude_deg), pick(height_m), pick(year)];
                for (row, found) in rows.iter_mut().zip(self.lanes(at)) {
                    *row = found;
                }
            });
            done += rows.len();
            monitor.advance(done as u64, n as u64)?;
        }
        Ok(out)
    }

    fn lanes(&self, [latitude, longitude, height, year]: [[f64; LANES]; 4]) -> [[f64; 3]; LANES] {
        let places = std::array::from_fn(|l| synthesis::SpherePlace::new(latitude[l], longitude[l], height[l]));
        let intervals: [usize; LANES] = std::array::from_fn(|l| self.interval(year[l]));
        let share: [f64; LANES] = std::array::from_fn(|l| {
            let k = intervals[l];
            (year[l] - self.epochs[k]) / (self.epochs[k + 1] - self.epochs[k])
        });
        let from = intervals.map(|k| self.ordered[k].as_slice());
        let to = intervals.map(|k| self.ordered[k + 1].as_slice());
        let sums: [FieldSums; LANES] = self.recursion.sums(&places, from, to, share);
        std::array::from_fn(|l| places[l].geodetic(&sums[l]))
    }

    fn interval(&self, year: f64) -> usize {
        self.epochs.partition_point(|e| *e <= year).clamp(1, self.epochs.len() - 1) - 1
    }
}

#[cfg(test)]
mod tests;
