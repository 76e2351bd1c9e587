//! Iterative evaluation matching (IEMA): the gated offset matrix, sample by sample.
//!
//! Huang, Sun, Wang, Liu, Gao: Iterative evaluation matching algorithm for geomagnetic navigation. J. Nanjing Univ.
//! Aeronautics & Astronautics 44(4), 2012, 565-569. The rule is the paper's; what it leaves open is said at each option.

use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::bounds::{require_place, require_values};
use crate::constants::LN_SQRT_2PI;
use crate::error::{Error, Result, require_not_negative, require_positive, room};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::grid::{GridMap, Interpolation};
use crate::lattice::{Classes, Comparison, OffsetLattice, Shift, value_at};
use crate::matching::stream::{Sample, Step, Stream};
use crate::monitor::{Monitor, Quiet};
use crate::stack::{Storey, check_heights, extent};
use crate::state::Saved;
use crate::track::Track;

/// Candidates a thread takes at a time where there are many.
const CHUNK: usize = 1 << 14;

/// What becomes of a candidate off the map or on a hole.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub enum Unknown {
    /// It stays feasible: a hole is no evidence. Its score takes the mean log density of a right candidate.
    #[default]
    Keep,
    /// It is dropped.
    Drop,
}

/// The options of IEMA, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! iema_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            search [
                (max_candidates: count = 268_435_456; "int";
                    "A larger lattice is refused before memory is taken; one of more than 2^31 offsets always is. Each candidate that is"
                    "left after the first sample takes 24 bytes, and as much again while they are gathered.")
            ]
            rule [
                (max_misses: tally = 0; "int";
                    "Gate violations that a candidate survives (outliers). A violation counts in its score as a residual on the gate.")
                (unknown: unknown = "keep"; "{'keep', 'drop'}";
                    "What becomes of candidates off the map or on holes.")
                (gate_sigmas: number = 3.0; "float";
                    "Gate in standard deviations, as in the paper.")
            ]
        }
    };
}

macro_rules! iema_struct {
    ($($part:ident [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*])*) => {
        /// Options of [`Iema`].
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        pub struct IemaOptions {
            /// Standard deviation of the sensor, value units.
            pub sigma: f64,
            /// Bound of the INS position error at the start `[x, y]`, map units.
            pub half_width: [f64; 2],
            /// Extent of the feasible set `[x, y]`, map units, at which the answer is unique enough; zero is the paper's rule.
            pub tolerance: [f64; 2],
            $($($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*)*
        }

        impl IemaOptions {
            /// The paper's rule.
            pub fn new(sigma: f64, half_width: [f64; 2]) -> Self {
                Self { sigma, half_width, tolerance: [0.0; 2], $($($name: option_default!($kind $default),)*)* }
            }
        }
    };
}

step_options!(iema_options iema_struct);

impl IemaOptions {
    fn check(&self) -> Result<()> {
        require_positive("sigma", self.sigma)?;
        require_positive("gate_sigmas", self.gate_sigmas)?;
        for (d, axis) in ["x", "y"].iter().enumerate() {
            require_not_negative(&format!("tolerance {axis}"), self.tolerance[d])?;
        }
        Ok(())
    }
}

/// A candidate that is still feasible.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct LatticeCandidate {
    row: u32,
    column: u32,
    log_score: f64,
    misses: u32,
    tested: u32,
}

/// What one sample did to the feasible set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IemaStep {
    /// `searching`, `fixed` or `lost`.
    pub status: Status,
    /// Samples seen, this one included.
    pub n_samples: usize,
    /// Candidates left.
    pub n_feasible: usize,
    /// Extent of the feasible set `[x, y]`, map units: greatest less least offset.
    pub extent: [f64; 2],
    /// Offset of the greatest score `[x, y]`, map units; NaN when lost and until a candidate had a map value.
    pub best_offset: [f64; 2],
    /// Its log score: the sum of the log densities; NaN where it has no offset.
    pub log_score: f64,
    /// The greatest log score outside one map cell of it; NaN where there is none.
    pub runner_up: f64,
    /// The indicated position of this sample.
    pub indicated: [f64; 2],
}

impl IemaStep {
    /// The common answer of this step; its track is the newest point alone.
    pub fn fix(&self, field: &dyn Field) -> Fix {
        let mut fix = if self.best_offset[0].is_nan() {
            Fix::none(self.status, self.n_samples)
        } else {
            Fix::at_point(field, self.indicated, self.best_offset, self.status)
        };
        fix.n_samples = self.n_samples;
        fix.iterations = self.n_samples;
        fix.score = self.log_score;
        fix.runner_up = self.runner_up;
        fix
    }
}

/// Streaming IEMA: constant memory, one call a sample, work proportional to the candidates that are left.
///
/// ```
/// use std::sync::Arc;
/// use geomag_core::grid::{GridMap, GridValues, Interpolation};
/// use geomag_core::matching::iema::{Iema, IemaOptions};
/// let axis: Vec<f64> = (0..60).map(f64::from).collect();
/// let values = (0..3600).map(|i| 90.0 * (f64::from(i % 60) / 4.0).sin() * (f64::from(i / 60) / 5.0).cos()).collect();
/// let map = Arc::new(GridMap::new(GridValues::F64(values), &axis, &axis, false)?);
/// let mut iema = Iema::new(map.clone(), IemaOptions::new(1.0, [5.0, 5.0]))?;
/// let mut k = 0.0;
/// let step = loop {
///     let value = map.sample(20.3 + k, 22.6 + 0.7 * k, Interpolation::Bilinear);
///     let step = iema.update(18.3 + k, 25.6 + 0.7 * k, value)?; // indicated 2 west, 3 north of the truth
///     if step.status != geomag_core::fix::Status::Searching { break step; }
///     k += 1.0;
/// };
/// assert_eq!(step.best_offset, [2.0, -3.0]);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone)]
pub struct Iema {
    field: Arc<dyn Field>,
    options: IemaOptions,
    lattice: OffsetLattice,
    classes: Option<Classes>,
    state: IemaState,
    /// Weights of the classes for the current sample, kept so that later samples allocate nothing.
    shifts: Vec<Shift>,
}

/// Everything that changes from sample to sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct IemaState {
    n_samples: usize,
    /// Indicated position of the newest sample.
    newest: Option<[f64; 2]>,
    /// `None` until the first sample: all are feasible and untested, and need no memory yet.
    feasible: Option<Vec<LatticeCandidate>>,
}

/// What is saved: everything but the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Saving {
    options: IemaOptions,
    state: IemaState,
}

impl Saved for Saving {
    const NAME: &'static str = "Iema";

    fn check(&self) -> Result<()> {
        self.options.check()?;
        if let Some(newest) = self.state.newest {
            require_place("newest", false, newest)?;
        }
        let Some(list) = &self.state.feasible else {
            return match self.state.n_samples {
                0 => Ok(()),
                n => Err(Error::invalid("samples seen", "0 before the first", n)),
            };
        };
        if list.windows(2).any(|w| (w[0].row, w[0].column) >= (w[1].row, w[1].column)) {
            return Err(Error::invalid("candidates", "row by row, each once", "another order"));
        }
        let most = self.options.max_misses;
        let wrong = |c: &&LatticeCandidate| {
            !c.log_score.is_finite() || c.misses > most.min(c.tested) || c.tested as usize > self.state.n_samples
        };
        match list.iter().find(wrong) {
            None => Ok(()),
            Some(c) => {
                let needed = "a finite score, and no more misses than allowed and than samples seen";
                Err(Error::invalid("candidate", needed, format!("{c:?}")))
            }
        }
    }
}

impl Iema {
    /// A matcher on a map.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a sigma, step or gate that is not positive or a negative bound or tolerance,
    /// [`Error::TooManyCandidates`].
    pub fn new(field: Arc<dyn Field>, options: IemaOptions) -> Result<Self> {
        options.check()?;
        let lattice =
            OffsetLattice::new(options.half_width, options.step.unwrap_or(field.spacing()), options.max_candidates)?;
        let classes = field.layout().and_then(|grid| Classes::of(grid, lattice.step()));
        Ok(Self {
            field,
            options,
            lattice,
            classes,
            state: IemaState { n_samples: 0, newest: None, feasible: None },
            shifts: Vec::new(),
        })
    }

    /// The options.
    pub fn options(&self) -> &IemaOptions {
        &self.options
    }

    /// The map.
    pub fn field(&self) -> &Arc<dyn Field> {
        &self.field
    }

    /// The lattice of candidate offsets.
    pub fn lattice(&self) -> &OffsetLattice {
        &self.lattice
    }

    /// Samples seen since the start or the last reset.
    pub fn n_samples(&self) -> usize {
        self.state.n_samples
    }

    /// Candidates left.
    pub fn n_feasible(&self) -> usize {
        self.state.feasible.as_ref().map_or(self.lattice.len(), Vec::len)
    }

    /// The offset matrix T: true where feasible, row = y offset ascending, column = x offset ascending.
    pub fn feasible(&self) -> Vec<bool> {
        let mut out = vec![self.state.feasible.is_none(); self.lattice.len()];
        for c in self.state.feasible.iter().flatten() {
            out[c.row as usize * self.lattice.columns() + c.column as usize] = true;
        }
        out
    }

    /// The evaluation matrix as log S, minus infinity where infeasible, laid out as [`Iema::feasible`].
    pub fn log_scores(&self) -> Vec<f64> {
        let empty = if self.state.feasible.is_none() { 0.0 } else { f64::NEG_INFINITY };
        let mut out = vec![empty; self.lattice.len()];
        for c in self.state.feasible.iter().flatten() {
            out[c.row as usize * self.lattice.columns() + c.column as usize] = c.log_score;
        }
        out
    }

    /// Begins again: every candidate feasible, no sample seen.
    pub fn reset(&mut self) {
        self.state = IemaState { n_samples: 0, newest: None, feasible: None };
    }

    /// Takes one sample: indicated position (map units) and measured value.
    ///
    /// A lost matcher stays lost, without work, until [`Iema::reset`].
    ///
    /// # Errors
    /// [`Error::NotFinite`] for a NaN or infinite argument, [`Error::NoMemory`]; the state is then as it was.
    pub fn update(&mut self, x: f64, y: f64, value: f64) -> Result<IemaStep> {
        self.update_at(x, y, value, None)
    }

    /// [`Iema::update`] with the height of the sample, metres above the map's height datum: needed on a stack of levels.
    ///
    /// # Errors
    /// As [`Iema::update`]; [`Error::Invalid`] for a height that the map does not serve.
    pub fn update_at(&mut self, x: f64, y: f64, value: f64, height_m: Option<f64>) -> Result<IemaStep> {
        require_place("indicated", self.field.geographic(), [x, y])?;
        require_values("value", &[value])?;
        if height_m.is_some() || self.field.as_stack().is_some() {
            let sample = Track::new(vec![x], vec![y], vec![value], None)?.with_height(height_m.map(|h| vec![h]))?;
            check_heights(&*self.field, &sample)?;
        }
        let test = Test {
            value,
            inverse_sigma: 1.0 / self.options.sigma,
            gate: self.options.gate_sigmas * self.options.sigma,
            gate_density: -0.5 * self.options.gate_sigmas * self.options.gate_sigmas - LN_SQRT_2PI,
            max_misses: self.options.max_misses,
            unknown: self.options.unknown,
        };
        let feasible = match self.state.feasible.take() {
            None => self.first([x, y], height_m, &test)?,
            Some(list) => {
                self.place(x, y);
                self.later(list, [x, y], height_m, &test)
            }
        };
        self.state.feasible = Some(feasible);
        self.state.n_samples += 1;
        self.state.newest = Some([x, y]);
        Ok(self.summary([x, y]))
    }

    /// Runs over a whole track from a fresh start and stops at the first fix, or when lost.
    ///
    /// The fix is for the sample at which it was had; its track holds the points up to there.
    ///
    /// # Errors
    /// As [`Iema::update`].
    pub fn run(&mut self, track: &Track) -> Result<Fix> {
        self.run_monitored(track, &Quiet)
    }

    /// [`Iema::run`] that can be watched and stopped; once stopped, the samples seen so far are kept.
    ///
    /// # Errors
    /// As [`Iema::run`], and [`Error::Interrupted`].
    pub fn run_monitored(&mut self, track: &Track, monitor: &dyn Monitor) -> Result<Fix> {
        self.reset();
        for k in 0..track.len() {
            monitor.advance(k as u64, track.len() as u64)?;
            let height = track.height_m().map(|h| h[k]);
            let step = self.update_at(track.x()[k], track.y()[k], track.values()[k], height)?;
            if step.status != Status::Searching || k + 1 == track.len() {
                let mut fix = step.fix(&*self.field);
                fix.heights_m = self.field.as_stack().and(track.height_m()).and_then(extent);
                if fix.x.is_finite() {
                    let seen = track.slice(0..k + 1)?;
                    fix.track = Fix::at_offset(&*self.field, &seen, step.best_offset, step.status).track;
                }
                return Ok(fix);
            }
        }
        Err(Error::TooFewSamples { what: "IEMA".into(), needed: 1, got: 0 })
    }

    /// The state as bytes, to go on from later with the same map.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn save(&self) -> Result<Vec<u8>> {
        crate::state::save(&Saving { options: self.options.clone(), state: self.state.clone() })
    }

    /// A matcher that goes on, bit for bit, where [`Iema::save`] left.
    ///
    /// # Errors
    /// [`Error::State`] for bytes that are no such state or do not fit the lattice.
    pub fn restore(field: Arc<dyn Field>, bytes: &[u8]) -> Result<Self> {
        let Saving { options, state } = crate::state::load(bytes)?;
        let mut iema = Self::new(field, options)?;
        let (rows, columns) = (iema.lattice.rows(), iema.lattice.columns());
        if state.feasible.iter().flatten().any(|c| c.row as usize >= rows || c.column as usize >= columns) {
            return Err(Error::State {
                what: "Iema".into(),
                detail: format!("a candidate lies outside the {rows} x {columns} lattice of this map"),
            });
        }
        iema.state = state;
        Ok(iema)
    }

    /// The first sample: whole rows through the lattice kernels, only survivors are kept.
    fn first(&self, [x, y]: [f64; 2], height_m: Option<f64>, test: &Test) -> Result<Vec<LatticeCandidate>> {
        let comparison = Comparison::new(
            &*self.field,
            self.lattice,
            vec![[x, y]],
            vec![test.value],
            None,
            Interpolation::Bilinear,
            1,
        )?
        .at_heights(height_m.as_ref().map(std::slice::from_ref))?;
        let columns = self.lattice.columns();
        let row_survivors = |row: usize, values: &mut Vec<f64>, out: &mut Vec<LatticeCandidate>| {
            values.resize(columns, 0.0);
            comparison.map_row(0, row, 0, values);
            for (column, &m) in values.iter().enumerate() {
                let fresh =
                    LatticeCandidate { row: row as u32, column: column as u32, log_score: 0.0, misses: 0, tested: 0 };
                if let Some(c) = test.apply(fresh, m) {
                    out.push(c);
                }
            }
        };
        if self.lattice.len() < CHUNK {
            let mut out = room("candidates", self.lattice.len())?;
            let mut values = Vec::with_capacity(columns);
            for row in 0..self.lattice.rows() {
                row_survivors(row, &mut values, &mut out);
            }
            return Ok(out);
        }
        let scratch = || (Vec::new(), Vec::new());
        let parts: Vec<Vec<LatticeCandidate>> = (0..self.lattice.rows())
            .into_par_iter()
            .map_init(scratch, |(values, out), row| {
                out.clear();
                row_survivors(row, values, out);
                let mut exact = room("candidates", out.len())?;
                exact.extend_from_slice(out);
                Ok(exact)
            })
            .collect::<Result<_>>()?;
        let mut all = room("candidates", parts.iter().map(Vec::len).sum())?;
        for part in parts {
            all.extend_from_slice(&part);
        }
        Ok(all)
    }

    /// Weights of every class of offsets for a sample at a point.
    fn place(&mut self, x: f64, y: f64) {
        self.shifts.clear();
        if let (Some(grid), Some(classes)) = (self.field.layout(), self.classes) {
            let position = grid.position(x, y);
            let half = self.lattice.half().map(|h| -(h as i64));
            let [qx, qy] = classes.per_cell;
            let all = (0..qy).flat_map(|cy| (0..qx).map(move |cx| [cx, cy]));
            self.shifts.extend(all.map(|class| classes.shift(position, half, class)));
        }
    }

    /// Later samples: the survivors alone.
    fn later(
        &self,
        mut list: Vec<LatticeCandidate>,
        at: [f64; 2],
        height_m: Option<f64>,
        test: &Test,
    ) -> Vec<LatticeCandidate> {
        let sampler = Sampler::new(self, at, height_m);
        if list.len() < 2 * CHUNK {
            // In place: no allocation after the first sample.
            let mut kept = 0;
            for i in 0..list.len() {
                if let Some(c) = test.apply(list[i], sampler.value(list[i].row, list[i].column)) {
                    list[kept] = c;
                    kept += 1;
                }
            }
            list.truncate(kept);
            return list;
        }
        // Each thread packs its chunks where they stand, and they are drawn together: nothing is allocated either.
        let kept: Vec<usize> = list
            .par_chunks_mut(CHUNK)
            .map(|chunk| {
                let mut kept = 0;
                for i in 0..chunk.len() {
                    if let Some(c) = test.apply(chunk[i], sampler.value(chunk[i].row, chunk[i].column)) {
                        chunk[kept] = c;
                        kept += 1;
                    }
                }
                kept
            })
            .collect();
        let mut end = 0;
        for (i, kept) in kept.into_iter().enumerate() {
            list.copy_within(i * CHUNK..i * CHUNK + kept, end);
            end += kept;
        }
        list.truncate(end);
        list
    }

    fn summary(&self, indicated: [f64; 2]) -> IemaStep {
        let list = self.state.feasible.as_deref().unwrap_or(&[]);
        let n_samples = self.state.n_samples;
        let Some(first) = list.first() else {
            return IemaStep {
                status: Status::Lost,
                n_samples,
                n_feasible: 0,
                extent: [f64::NAN; 2],
                best_offset: [f64::NAN; 2],
                log_score: f64::NAN,
                runner_up: f64::NAN,
                indicated,
            };
        };
        let mut best = first;
        let (mut low, mut high) = ([u32::MAX; 2], [0_u32; 2]);
        let mut tested = false;
        for c in list {
            tested |= c.tested > 0;
            // Candidates are in index order, so the first of equals is the smaller index.
            if c.log_score > best.log_score {
                best = c;
            }
            low = [low[0].min(c.column), low[1].min(c.row)];
            high = [high[0].max(c.column), high[1].max(c.row)];
        }
        let step = self.lattice.step();
        let spacing = self.field.spacing();
        let cells = [0, 1].map(|d| spacing[d] / step[d] + 1e-9);
        let mut runner_up = f64::NAN;
        for c in list {
            let away =
                f64::from(c.column.abs_diff(best.column)) > cells[0] || f64::from(c.row.abs_diff(best.row)) > cells[1];
            if away && !(c.log_score <= runner_up) {
                runner_up = c.log_score;
            }
        }
        let span = [0, 1].map(|d| f64::from(high[d] - low[d]));
        let unique = (0..2).all(|d| span[d] <= self.options.tolerance[d] / step[d] + 1e-9);
        // A candidate that was never tested is no answer, however alone it stands.
        let status = if unique && best.tested > 0 { Status::Fixed } else { Status::Searching };
        // Scores that no map value went into rank nothing.
        let known = |number: f64| if tested { number } else { f64::NAN };
        IemaStep {
            status,
            n_samples,
            n_feasible: list.len(),
            extent: [span[0] * step[0], span[1] * step[1]],
            best_offset: self.lattice.offset(best.row as usize, best.column as usize).map(known),
            log_score: known(best.log_score),
            runner_up: known(runner_up),
            indicated,
        }
    }
}

/// The gate and the evaluation of one sample.
struct Test {
    value: f64,
    inverse_sigma: f64,
    gate: f64,
    gate_density: f64,
    max_misses: u32,
    unknown: Unknown,
}

impl Test {
    /// The candidate after the sample, or `None` where it is no longer feasible.
    #[inline]
    fn apply(&self, mut c: LatticeCandidate, m: f64) -> Option<LatticeCandidate> {
        let r = m - self.value;
        if r.abs() <= self.gate {
            let z = r * self.inverse_sigma;
            c.log_score += -0.5 * z * z - LN_SQRT_2PI;
            c.tested = c.tested.saturating_add(1);
            Some(c)
        } else if r.is_nan() {
            if self.unknown == Unknown::Drop {
                return None;
            }
            c.log_score += -0.5 - LN_SQRT_2PI;
            Some(c)
        } else if c.misses < self.max_misses {
            c.log_score += self.gate_density;
            c.misses += 1;
            c.tested = c.tested.saturating_add(1);
            Some(c)
        } else {
            None
        }
    }
}

/// Map values of one sample under any offset of the lattice.
enum Sampler<'a> {
    Grid {
        grid: &'a GridMap,
        /// The level above and its share, where the sample lies between two.
        above: Option<(&'a GridMap, f64)>,
        per_cell: [u32; 2],
        shifts: &'a [Shift],
    },
    Any {
        field: &'a dyn Field,
        lattice: &'a OffsetLattice,
        at: [f64; 2],
        height_m: Option<f64>,
    },
}

impl<'a> Sampler<'a> {
    fn new(iema: &'a Iema, at: [f64; 2], height_m: Option<f64>) -> Self {
        let storey = iema.field.as_stack().zip(height_m).and_then(|(stack, h)| Some((stack, stack.storey(h)?)));
        let (grid, above) = match storey {
            Some((stack, Storey { level, share })) => {
                let above = (share > 0.0).then(|| (&*stack.levels()[level + 1], share));
                (Some(&*stack.levels()[level]), above)
            }
            None => (iema.field.as_grid(), None),
        };
        match (grid, iema.classes) {
            (Some(grid), Some(classes)) => {
                Self::Grid { grid, above, per_cell: classes.per_cell.map(|q| q as u32), shifts: &iema.shifts }
            }
            _ => Self::Any { field: &*iema.field, lattice: &iema.lattice, at, height_m },
        }
    }

    #[inline]
    fn value(&self, row: u32, column: u32) -> f64 {
        match self {
            Self::Grid { grid, above, per_cell: [qx, qy], shifts } => {
                let (shift, row, column) = if *qx == 1 && *qy == 1 {
                    (&shifts[0], row, column)
                } else {
                    (&shifts[(row % qy * qx + column % qx) as usize], row / qy, column / qx)
                };
                let below = value_at(grid, shift, row as usize, column as usize);
                match above {
                    None => below,
                    Some((grid, share)) => {
                        below + share * (value_at(grid, shift, row as usize, column as usize) - below)
                    }
                }
            }
            Self::Any { field, lattice, at: [x, y], height_m } => {
                let [ox, oy] = lattice.offset(row as usize, column as usize);
                match height_m {
                    Some(height) => field.value_at(x + ox, y + oy, *height),
                    None => field.value(x + ox, y + oy),
                }
            }
        }
    }
}

impl Stream for Iema {
    fn take(&mut self, sample: &Sample, _: &dyn Monitor) -> Result<Step> {
        let Sample { place: [x, y], value, height_m } = *sample;
        let step = self.update_at(x, y, value, height_m)?;
        Ok(Step { status: step.status, fix: Some(step.fix(&*self.field)) })
    }

    fn answer(&self) -> Result<Fix> {
        match self.state.newest {
            None => Err(Error::TooFewSamples { what: "IEMA".into(), needed: 1, got: 0 }),
            Some(indicated) => Ok(self.summary(indicated).fix(&*self.field)),
        }
    }

    fn begin_again(&mut self) -> Result<()> {
        self.reset();
        Ok(())
    }

    fn seen(&self) -> usize {
        self.state.n_samples
    }

    fn holds(&self) -> Option<usize> {
        None
    }

    fn saved(&self) -> Result<Vec<u8>> {
        self.save()
    }
}
