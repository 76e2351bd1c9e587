//! Many seeded trials at once: how often a matcher finds the truth, how far off it is, how often it is wrong and says not.
//!
//! A trial is a flight (see [`crate::synthetic`]) and a match of it. Everything random in trial `i` comes from a stream of
//! its own, derived from the campaign's seed and `i` alone: any subset of the trials, in any order, on any number of
//! threads or machines, gives the same rows.
//!
//! ```
//! use std::sync::Arc;
//! use geomag_core::campaign::{Campaign, CampaignMethod, RandomTracks, TrackPlan, run};
//! use geomag_core::matching::iema::IemaOptions;
//! use geomag_core::monitor::Quiet;
//! use geomag_core::synthetic::{CrustSpec, InsSpread, PositionSpread, SensorModel};
//! let map = Arc::new(CrustSpec::default().draw([0.0, 0.0, 60_000.0, 60_000.0], false, 1)?.grid_by_step(500.0)?);
//! let campaign = Campaign {
//!     seed: 7,
//!     tracks: TrackPlan::Random(RandomTracks { samples: 30, spacing_m: [500.0, 1000.0], ..RandomTracks::default() }),
//!     ins: InsSpread { position: PositionSpread::Uniform { half_width: [3000.0; 2] }, ..InsSpread::default() },
//!     sensor: SensorModel::white(1.0),
//! };
//! let method = CampaignMethod::Iema(IemaOptions::new(1.0, [3000.0; 2]));
//! let all = run(&campaign, &map, &*map, &[method.clone()], &[0, 1, 2, 3], &Quiet)?;
//! let last = run(&campaign, &map, &*map, &[method], &[3], &Quiet)?;
//! assert_eq!(all[0][3].error_m, last[0][0].error_m);
//! # Ok::<(), geomag_core::error::Error>(())
//! ```

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_not_negative, require_positive};
use crate::field::Field;
use crate::fix::{Fix, Status};
use crate::frame::displacement_m;
use crate::grid::GridMap;
use crate::matching::contour::{ContourOptions, match_contour};
use crate::matching::grid_search::{GridSearch, match_grid};
use crate::matching::iema::{Iema, IemaOptions};
use crate::matching::posterior::{PosteriorOptions, match_posterior};
use crate::matching::similarity::Criterion;
use crate::monitor::{Monitor, Quiet};
use crate::synthetic::{Flight, InsSpread, Leg, Path, Random, SensorModel, fly};
use crate::track::Track;

/// Draws of start and course after which a track is taken not to fit on the map.
const MAX_ATTEMPTS: usize = 5000;
/// Trials between two words to the monitor.
const REPORT_EVERY: u64 = 64;

/// True tracks drawn anew for every trial: constant speed, straight or on one arc, start and course uniform over what
/// keeps the whole track on the map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RandomTracks {
    /// Samples in a track.
    pub samples: usize,
    /// Distance between samples, metres `[least, greatest]`; one value a track.
    pub spacing_m: [f64; 2],
    /// Course at the start, degrees `[least, greatest]`.
    pub course_deg: [f64; 2],
    /// Greatest turn over the whole track to either side, degrees; one value a track; zero for straight tracks.
    pub turn_deg: f64,
    /// Speed, metres a second: with the spacing it gives the time between samples.
    pub speed_m_s: f64,
    /// How far from the border of the map the true track stays, map units `[x, y]`.
    pub margin: [f64; 2],
}

impl Default for RandomTracks {
    /// Straight tracks of 30 samples, 1 km apart, at 100 m/s.
    fn default() -> Self {
        Self {
            samples: 30,
            spacing_m: [1000.0; 2],
            course_deg: [0.0, 360.0],
            turn_deg: 0.0,
            speed_m_s: 100.0,
            margin: [0.0; 2],
        }
    }
}

/// Where the true tracks come from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackPlan {
    /// A new one for every trial.
    Random(RandomTracks),
    /// The same one for every trial.
    Fixed(Path),
}

/// What is drawn in every trial.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Campaign {
    /// Seed of the whole campaign.
    pub seed: u64,
    /// True tracks.
    pub tracks: TrackPlan,
    /// INS errors.
    pub ins: InsSpread,
    /// Sensor.
    pub sensor: SensorModel,
}

/// A matcher with its options.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CampaignMethod {
    /// Streaming IEMA, stopped at its first fix.
    Iema(IemaOptions),
    /// Grid search over the whole track.
    Grid(GridSearch),
    /// Grid search with the Hausdorff measure, whose scales are those of each track where they are not given.
    Hausdorff {
        /// Along-track metres that count as one.
        length_scale_m: Option<f64>,
        /// Value difference that counts as one.
        value_scale: Option<f64>,
        /// Quantile of the point-to-set distances.
        fraction: f64,
        /// The search; its criterion is replaced.
        search: GridSearch,
    },
    /// Calibrated matching over the whole track.
    Posterior {
        /// Standard deviation of a reading, where it is known.
        sigma: Option<f64>,
        /// Options.
        options: PosteriorOptions,
    },
    /// Contour matching (ICCP) over the whole track.
    Contour {
        /// Standard deviation of a measured value, where it is known.
        sigma: Option<f64>,
        /// Options.
        options: ContourOptions,
    },
}

impl CampaignMethod {
    /// Matches one track; the second value is the index of the sample that the fix is for.
    ///
    /// # Errors
    /// What the matcher refuses.
    pub fn fix(&self, map: &Arc<GridMap>, track: &Track) -> Result<(Fix, usize)> {
        let last = track.len() - 1;
        match self {
            Self::Iema(options) => {
                let fix = Iema::new(Arc::clone(map) as Arc<dyn Field>, options.clone())?.run(track)?;
                let at = fix.n_samples.clamp(1, track.len()) - 1;
                Ok((fix, at))
            }
            Self::Grid(search) => Ok((match_grid(&**map, track, search, &Quiet)?, last)),
            Self::Hausdorff { length_scale_m, value_scale, fraction, search } => {
                let measured = track.weighted(search.weights.as_deref())?;
                let criterion =
                    Criterion::hausdorff(&measured, map.geographic(), *length_scale_m, *value_scale, *fraction);
                Ok((match_grid(&**map, track, &GridSearch { criterion, ..search.clone() }, &Quiet)?, last))
            }
            Self::Posterior { sigma, options } => Ok((match_posterior(&**map, track, *sigma, options)?, last)),
            Self::Contour { sigma, options } => Ok((match_contour(map, track, *sigma, options)?, last)),
        }
    }
}

/// The outcome of one trial. Errors are estimated minus true; what a method does not give is NaN.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CampaignRow {
    /// Number of the trial.
    pub trial: u64,
    /// Status of the fix.
    pub status: Status,
    /// Samples used.
    pub n_samples: usize,
    /// Iterations taken.
    pub iterations: usize,
    /// True position at the sample that the fix is for, map units `[x, y]`.
    pub truth: [f64; 2],
    /// Error of the fix, metres `[east, north]`.
    pub error_m: [f64; 2],
    /// Error of the INS at the same sample, metres `[east, north]`.
    pub ins_error_m: [f64; 2],
    /// Declared risk.
    pub risk: f64,
    /// Goodness of fit.
    pub goodness: f64,
    /// Declared covariance, square metres: east-east, east-north, north-north.
    pub covariance_m2: [f64; 3],
    /// Score.
    pub score: f64,
    /// Best score elsewhere.
    pub runner_up: f64,
}

impl CampaignRow {
    /// The row of a fix for sample `at` of a flight.
    pub fn new(trial: u64, flight: &Flight, fix: &Fix, at: usize) -> Self {
        let geographic = flight.path.geographic();
        let truth = flight.path.point(at);
        let covariance_m2 = fix.covariance_m2.map_or([f64::NAN; 3], |c| [c[0][0], c[0][1], c[1][1]]);
        Self {
            trial,
            status: fix.status,
            n_samples: fix.n_samples,
            iterations: fix.iterations,
            truth,
            error_m: displacement_m(geographic, truth, [fix.x, fix.y]),
            ins_error_m: displacement_m(geographic, truth, flight.track.point(at)),
            risk: fix.risk.unwrap_or(f64::NAN),
            goodness: fix.goodness.unwrap_or(f64::NAN),
            covariance_m2,
            score: fix.score,
            runner_up: fix.runner_up,
        }
    }

    /// Length of the error of the fix, metres; NaN where there is no position.
    pub fn distance_m(&self) -> f64 {
        self.error_m[0].hypot(self.error_m[1])
    }
}

impl RandomTracks {
    fn check(&self) -> Result<()> {
        if self.samples == 0 {
            return Err(Error::TooFewSamples { what: "campaign tracks".into(), needed: 1, got: 0 });
        }
        require_positive("campaign spacing_m[0]", self.spacing_m[0])?;
        for (name, [low, high]) in [("spacing_m", self.spacing_m), ("course_deg", self.course_deg)] {
            if !(low.is_finite() && high.is_finite() && high >= low) {
                let got = format!("[{low}, {high}]");
                return Err(Error::invalid(format!("campaign {name}"), "[least, greatest], finite", got));
            }
        }
        require_not_negative("campaign turn_deg", self.turn_deg)?;
        require_positive("campaign speed_m_s", self.speed_m_s)?;
        require_not_negative("campaign margin x", self.margin[0])?;
        require_not_negative("campaign margin y", self.margin[1])?;
        Ok(())
    }

    /// A track on the map, drawn until all of it is where both map and true field are known.
    fn draw(&self, map: &GridMap, truth: &dyn Field, random: &mut Random) -> Result<Path> {
        let (x, y) = (map.x(), map.y());
        let low = [x.first() + self.margin[0], y.first() + self.margin[1]];
        let high = [x.last() - self.margin[0], y.last() - self.margin[1]];
        let inside = |[px, py]: [f64; 2]| px >= low[0] && px <= high[0] && py >= low[1] && py <= high[1];
        if low[0] <= high[0] && low[1] <= high[1] {
            for _ in 0..MAX_ATTEMPTS {
                let spacing = random.uniform(self.spacing_m[0], self.spacing_m[1]);
                let course = random.uniform(self.course_deg[0], self.course_deg[1]);
                let turn = random.uniform(-self.turn_deg, self.turn_deg);
                let start = [random.uniform(low[0], high[0]), random.uniform(low[1], high[1])];
                let interval = spacing / self.speed_m_s;
                let steps = self.samples - 1;
                let turn_deg_s = if steps == 0 { 0.0 } else { turn / (steps as f64 * interval) };
                let leg = Leg { samples: steps, turn_deg_s };
                let Ok(path) = Path::along_legs(start, course, self.speed_m_s, interval, &[leg], map.geographic())
                else {
                    continue; // it ran over a pole
                };
                let known = |k: usize| {
                    let [px, py] = path.point(k);
                    inside([px, py]) && truth.value(px, py).is_finite()
                };
                // The end first: it tells most misfits at once.
                if known(self.samples - 1) && (0..self.samples).all(known) {
                    return Ok(path);
                }
            }
        }
        Err(Error::invalid(
            "campaign tracks",
            "tracks that fit on the map within its margin",
            format!("none in {MAX_ATTEMPTS} draws of {} samples, {:?} m apart", self.samples, self.spacing_m),
        ))
    }
}

impl Campaign {
    /// Flight number `trial`.
    ///
    /// `map` bounds the random tracks; `truth` is the field that the sensor reads: the map itself, or another field.
    ///
    /// # Errors
    /// [`Error::Invalid`] where no track fits on the map, where a fixed one leaves the field, and for bad settings.
    pub fn flight(&self, map: &GridMap, truth: &dyn Field, trial: u64) -> Result<Flight> {
        let seed = Random::derive(self.seed, trial);
        let path = match &self.tracks {
            TrackPlan::Random(tracks) => {
                tracks.check()?;
                tracks.draw(map, truth, &mut Random::stream(seed, 20))?
            }
            TrackPlan::Fixed(path) => path.clone(),
        };
        let ins = self.ins.draw(&mut Random::stream(seed, 21))?;
        fly(truth, &path, &ins, &self.sensor, seed)
    }
}

/// Runs the given trials with every method on identical flights; `[method][trial]`, in the order of `trials`.
///
/// Trials run on all threads of the current rayon pool.
///
/// # Errors
/// The error of a trial that failed, with its number; [`Error::Interrupted`].
pub fn run(
    campaign: &Campaign,
    map: &Arc<GridMap>,
    truth: &dyn Field,
    methods: &[CampaignMethod],
    trials: &[u64],
    monitor: &dyn Monitor,
) -> Result<Vec<Vec<CampaignRow>>> {
    let done = AtomicU64::new(0);
    let total = trials.len() as u64;
    monitor.advance(0, total)?;
    let by_trial: Vec<Vec<CampaignRow>> = trials
        .par_iter()
        .map(|&trial| {
            let flight = campaign.flight(map, truth, trial)?;
            let rows: Result<Vec<CampaignRow>> = methods
                .iter()
                .map(|method| {
                    let (fix, at) = method.fix(map, &flight.track)?;
                    Ok(CampaignRow::new(trial, &flight, &fix, at))
                })
                .collect();
            let count = done.fetch_add(1, Ordering::Relaxed) + 1;
            if count.is_multiple_of(REPORT_EVERY) || count == total {
                monitor.advance(count, total)?;
            }
            rows
        })
        .collect::<Result<_>>()?;
    let mut out: Vec<Vec<CampaignRow>> = methods.iter().map(|_| Vec::with_capacity(trials.len())).collect();
    for rows in by_trial {
        for (column, row) in out.iter_mut().zip(rows) {
            column.push(row);
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{CrustSpec, PositionSpread};

    fn map() -> Arc<GridMap> {
        let field = CrustSpec::default().draw([0.0, 0.0, 60_000.0, 50_000.0], false, 2).unwrap();
        Arc::new(field.grid_by_step(500.0).unwrap())
    }

    fn campaign() -> Campaign {
        Campaign {
            seed: 11,
            tracks: TrackPlan::Random(RandomTracks { samples: 25, turn_deg: 40.0, ..RandomTracks::default() }),
            ins: InsSpread { position: PositionSpread::Uniform { half_width: [2000.0; 2] }, ..InsSpread::default() },
            sensor: SensorModel::white(1.0),
        }
    }

    fn methods() -> Vec<CampaignMethod> {
        let grid = GridSearch { refine: true, ..GridSearch::new(Criterion::Msd, [2500.0; 2]) };
        vec![CampaignMethod::Iema(IemaOptions::new(1.0, [2000.0; 2])), CampaignMethod::Grid(grid)]
    }

    fn bits(rows: &[Vec<CampaignRow>]) -> String {
        // NaN is not equal to itself; what is printed is.
        format!("{rows:?}")
    }

    #[test]
    fn rows_do_not_depend_on_order_subset_or_threads() {
        let (map, campaign, methods) = (map(), campaign(), methods());
        let forward: Vec<u64> = (0..40).collect();
        let all = run(&campaign, &map, &*map, &methods, &forward, &Quiet).unwrap();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let backward: Vec<u64> = (0..40).rev().collect();
        let mut again = pool.install(|| run(&campaign, &map, &*map, &methods, &backward, &Quiet)).unwrap();
        for rows in &mut again {
            rows.reverse();
        }
        assert_eq!(bits(&all), bits(&again));
        let some = run(&campaign, &map, &*map, &methods, &[7, 31], &Quiet).unwrap();
        assert_eq!(format!("{:?}", some[1][1]), format!("{:?}", all[1][31]));
    }

    #[test]
    fn tracks_stay_on_the_map_and_errors_are_what_was_drawn() {
        let (map, mut campaign) = (map(), campaign());
        campaign.sensor = SensorModel::white(0.0);
        let TrackPlan::Random(tracks) = &mut campaign.tracks else { unreachable!() };
        tracks.margin = [3000.0, 2000.0];
        let rows = run(&campaign, &map, &*map, &methods()[1..], &(0..50).collect::<Vec<_>>(), &Quiet).unwrap();
        for row in &rows[0] {
            assert!((3000.0..=57_000.0).contains(&row.truth[0]) && (2000.0..=48_000.0).contains(&row.truth[1]));
            assert!(row.ins_error_m.iter().all(|e| e.abs() <= 2000.0));
        }
        let near = rows[0].iter().filter(|row| row.distance_m() < 250.0).count();
        assert!(near >= 45, "{near} of 50 noiseless grid searches came within half a cell");
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        let map = map();
        let mut long = campaign();
        long.tracks = TrackPlan::Random(RandomTracks { samples: 500, ..RandomTracks::default() });
        assert!(run(&long, &map, &*map, &methods(), &[0], &Quiet).is_err());
        let mut none = campaign();
        none.tracks = TrackPlan::Random(RandomTracks { samples: 0, ..RandomTracks::default() });
        assert!(none.flight(&map, &*map, 0).is_err());
        assert!(run(&campaign(), &map, &*map, &methods(), &[], &Quiet).unwrap()[0].is_empty());
    }

    #[derive(Debug)]
    struct Stop;
    impl Monitor for Stop {
        fn advance(&self, done: u64, _total: u64) -> Result<()> {
            if done > 0 { Err(Error::Interrupted) } else { Ok(()) }
        }
    }

    #[test]
    fn a_campaign_can_be_interrupted() {
        let map = map();
        let trials: Vec<u64> = (0..200).collect();
        assert_eq!(run(&campaign(), &map, &*map, &methods()[..1], &trials, &Stop), Err(Error::Interrupted));
    }
}
