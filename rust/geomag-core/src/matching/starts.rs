//! Where an iteration starts: at the INS, at given offsets, or at the best candidates of a lattice.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_positive};
use crate::lattice::MOST_CANDIDATES;
use crate::matching::scene::{Judgement, Scene};
use crate::monitor::Monitor;

/// The options of a lattice of starts, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! starts_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            lattice [
                (half_width_m: maybe_number = None; "float, optional";
                    "Half width of the square of starts, metres; three `offset_sigma_m` by default, or `radius_m`.")
                (step_m: maybe_number = None; "float, optional";
                    "Step of the lattice of starts, metres; a map cell by default, or a fortieth of the half width.")
                (keep_starts: size = 12; "int";
                    "How many minima of the misfit over that lattice the iteration starts from.")
                (max_candidates: count = 1_000_000; "int";
                    "A larger lattice of starts is refused; 2^32 at most.")
            ]
        }
    };
}

macro_rules! starts_defaults {
    (lattice [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]) => {
        /// What is told of a lattice of starts; its size and step follow from the rest of a call where they are not.
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct StartLattice {
            $($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*
        }

        impl StartLattice {
            /// What holds where nothing is told.
            pub const DEFAULT: Self = Self { $($name: $default,)* };
        }
    };
}

starts_options!(starts_defaults);

/// Where the iteration starts.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub enum Starts {
    /// At the indicated track.
    #[default]
    Indicated,
    /// At each of these offsets, metres `[east, north]`.
    Offsets(Vec<[f64; 2]>),
    /// At the best candidates of a square lattice of offsets about the indicated track, by the misfit of map value
    /// against measured value: its lowest local minima.
    Grid {
        /// Half width of the square, metres.
        half_width_m: f64,
        /// Step of the lattice, metres.
        step_m: f64,
        /// How many local minima to start from.
        keep: usize,
        /// Greatest number of candidates, up to [`MOST_CANDIDATES`]; more is refused before any work.
        max_candidates: u64,
    },
}

impl Starts {
    /// A lattice with the default number of starts and limit.
    pub const fn grid(half_width_m: f64, step_m: f64) -> Self {
        let StartLattice { keep_starts, max_candidates, .. } = StartLattice::DEFAULT;
        Self::Grid { half_width_m, step_m, keep: keep_starts, max_candidates }
    }

    /// Refuses starts that cannot be used, and lattices over their limit.
    ///
    /// # Errors
    /// [`Error::Invalid`], [`Error::NotFinite`], [`Error::TooManyCandidates`].
    pub fn check(&self) -> Result<()> {
        match self {
            Self::Indicated => Ok(()),
            Self::Offsets(offsets) => {
                if offsets.is_empty() {
                    return Err(Error::invalid("starts", "at least one offset", "none"));
                }
                require_finite("starts (flattened)", offsets.as_flattened())
            }
            Self::Grid { half_width_m, step_m, keep, max_candidates } => {
                require_positive("starts half width (m)", *half_width_m)?;
                require_positive("starts step (m)", *step_m)?;
                if *keep == 0 {
                    return Err(Error::invalid("starts to keep", "at least one", 0));
                }
                // Saturates far above any limit.
                let side = ((half_width_m / step_m).ceil() as u128).saturating_mul(2).saturating_add(1);
                let needed = side.saturating_mul(side);
                let limit = (*max_candidates).min(MOST_CANDIDATES);
                if needed > u128::from(limit) {
                    return Err(Error::TooManyCandidates { what: "start lattice".into(), needed, limit });
                }
                Ok(())
            }
        }
    }

    /// The offsets to start from, metres, best first for a lattice; none where no candidate lies on the map.
    pub(crate) fn offsets(&self, scene: &Scene<'_>, by: &Judgement, monitor: &dyn Monitor) -> Result<Vec<[f64; 2]>> {
        Ok(match self {
            Self::Indicated => vec![[0.0, 0.0]],
            Self::Offsets(offsets) => offsets.clone(),
            Self::Grid { half_width_m, step_m, keep, .. } => {
                let half = (half_width_m / step_m).ceil() as i64;
                let side = (2 * half + 1) as usize;
                let at = |i: usize| (i as i64 - half) as f64 * step_m;
                let mut scores = vec![f64::INFINITY; side * side];
                for row in 0..side {
                    for column in 0..side {
                        // Half a millisecond or so of samples between two looks.
                        if (row * side + column).is_multiple_of(1 + 65_536 / scene.len()) {
                            monitor.advance((row * side + column) as u64, (side * side) as u64)?;
                        }
                        let d = [at(column), at(row)];
                        if let Some(m) = scene.misfit(&|_| d, by) {
                            scores[row * side + column] = m;
                        }
                    }
                }
                let mut minima: Vec<usize> = (0..side * side)
                    .filter(|&i| {
                        let (row, column) = (i / side, i % side);
                        scores[i].is_finite()
                            && (row.saturating_sub(1)..=(row + 1).min(side - 1)).all(|r| {
                                (column.saturating_sub(1)..=(column + 1).min(side - 1))
                                    .all(|c| scores[r * side + c] >= scores[i])
                            })
                    })
                    .collect();
                minima.sort_by(|&a, &b| scores[a].total_cmp(&scores[b]).then(a.cmp(&b)));
                minima.truncate(*keep);
                minima.into_iter().map(|i| [at(i % side), at(i / side)]).collect()
            }
        })
    }
}
