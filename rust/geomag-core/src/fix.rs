//! The answer that every matcher gives.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_positive};
use crate::field::Field;
use crate::state::Saved;
use crate::track::Track;

/// Why an answer may, or may not, be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Status {
    /// A fix: the only status under which [`Fix::ok`] is true.
    Fixed,
    /// More samples are needed.
    Searching,
    /// Two places, or more, fit about as well.
    Ambiguous,
    /// The best candidate lies on the border of what was searched: the truth may lie beyond it.
    AtEdge,
    /// No candidate is left, or none agrees with the measurement.
    Lost,
    /// The field along the track is too flat, or too little of it is known, to tell candidates apart.
    Uninformative,
    /// An iteration ended before it settled.
    NotConverged,
    /// A test on the answer refused it.
    Rejected,
}

impl Status {
    /// Every status, in declaration order.
    pub const ALL: [Self; 8] = [
        Self::Fixed,
        Self::Searching,
        Self::Ambiguous,
        Self::AtEdge,
        Self::Lost,
        Self::Uninformative,
        Self::NotConverged,
        Self::Rejected,
    ];

    /// The name used in Python, JSON and reports.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Fixed => "fixed",
            Self::Searching => "searching",
            Self::Ambiguous => "ambiguous",
            Self::AtEdge => "at_edge",
            Self::Lost => "lost",
            Self::Uninformative => "uninformative",
            Self::NotConverged => "not_converged",
            Self::Rejected => "rejected",
        }
    }
}

impl std::fmt::Display for Status {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// An effect that was not told and that the readings clearly ask for: why an answer that would have been a fix is rejected.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Misfit {
    /// `height`, `legs`, `bias_drift`, `reading_scale`, `heading`, `scale` or `drift`.
    pub effect: String,
    /// Its size where it fits best: metres above the map, value units (largest step between legs; change of the bias from the first
    /// sample to the newest), factor on the map's values, degrees, factor on distance, metres from the first sample to the newest.
    pub estimate: f64,
    /// Logarithm of the evidence of the model with the effect over that of the model as told, over the whole search.
    pub log_evidence: f64,
}

/// Scores over the offset lattice: row = y offset ascending, column = x offset ascending, NaN where there is none.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Surface {
    /// Row-major scores.
    pub values: Vec<f64>,
    /// Number of rows (y offsets).
    pub rows: usize,
    /// Number of columns (x offsets).
    pub columns: usize,
    /// Offset of the first column and row, map units.
    pub first: [f64; 2],
    /// Lattice step, map units.
    pub step: [f64; 2],
}

/// A position answer with its quality. Every matcher returns this.
///
/// An *offset* is true minus indicated position: what the fix adds to the INS.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fix {
    /// Corrected newest position, map units.
    pub x: f64,
    /// Corrected newest position, map units.
    pub y: f64,
    /// True minus indicated at the newest point, map units `[x, y]`.
    pub offset: [f64; 2],
    /// The same in metres `[east, north]`.
    pub offset_m: [f64; 2],
    /// Heading correction, degrees, clockwise from above (added to an indicated heading).
    pub heading_deg: f64,
    /// Scale correction: true over indicated distance.
    pub scale: f64,
    /// Estimated constant of the measurement, measured minus map, where the method estimates one.
    pub bias: Option<f64>,
    /// Covariance of the newest position, square metres, east-north; `None` where the method has none.
    pub covariance_m2: Option<[[f64; 2]; 2]>,
    /// Declared probability that the fix is wrong; `None` where the method has none.
    pub risk: Option<f64>,
    /// p-value of the residuals under the model; `None` where the method has no such test.
    pub goodness: Option<f64>,
    /// What the readings ask for that was not told, where that is why the answer is rejected.
    pub misfit: Option<Misfit>,
    /// Whether it may be used, and why not.
    pub status: Status,
    /// Score of the answer in the measure's own sense.
    pub score: f64,
    /// Best score away from the answer; NaN where there is none.
    pub runner_up: f64,
    /// Samples that the answer rests on.
    pub n_samples: usize,
    /// Iterations taken (1 for direct methods).
    pub iterations: usize,
    /// Corrected points, oldest first, `[x, y]` map units.
    pub track: Vec<[f64; 2]>,
    /// Scores over the lattice, where asked for.
    pub surface: Option<Surface>,
    /// Lowest and greatest height at which the levels of a map were read, metres above the height datum; `None` where the map
    /// was taken as it is.
    pub heights_m: Option<[f64; 2]>,
}

impl Fix {
    /// An answer with the given offset at the newest point and no more than that; the caller fills in the rest.
    ///
    /// Longitudes of the result lie on the map's own turn. `track` is the offset added to every indicated point.
    pub fn at_offset(field: &dyn Field, track: &Track, offset: [f64; 2], status: Status) -> Self {
        let [nx, ny] = track.newest();
        let corrected =
            (0..track.len()).map(|k| [field.wrap_x(track.x()[k] + offset[0]), track.y()[k] + offset[1]]).collect();
        Self { n_samples: track.len(), track: corrected, ..Self::at_point(field, [nx, ny], offset, status) }
    }

    /// An answer for one indicated point; `track` holds the corrected point alone.
    pub fn at_point(field: &dyn Field, indicated: [f64; 2], offset: [f64; 2], status: Status) -> Self {
        let y = indicated[1] + offset[1];
        let [east, north] = field.metres_per_unit(0.5 * (indicated[1] + y));
        let x = field.wrap_x(indicated[0] + offset[0]);
        Self {
            x,
            y,
            offset,
            offset_m: [offset[0] * east, offset[1] * north],
            track: vec![[x, y]],
            ..Self::none(status, 1)
        }
    }

    /// An answer that is no position: every coordinate NaN, the status says why.
    pub fn none(status: Status, n_samples: usize) -> Self {
        Self {
            x: f64::NAN,
            y: f64::NAN,
            offset: [f64::NAN; 2],
            offset_m: [f64::NAN; 2],
            heading_deg: 0.0,
            scale: 1.0,
            bias: None,
            covariance_m2: None,
            risk: None,
            goodness: None,
            misfit: None,
            status,
            score: f64::NAN,
            runner_up: f64::NAN,
            n_samples,
            iterations: 1,
            track: Vec::new(),
            surface: None,
            heights_m: None,
        }
    }

    /// True only where the fix may be used.
    pub fn ok(&self) -> bool {
        self.status == Status::Fixed
    }
}

impl Saved for Surface {
    const NAME: &'static str = "Surface";

    fn check(&self) -> Result<()> {
        if self.rows.checked_mul(self.columns) != Some(self.values.len()) || self.values.is_empty() {
            let needed = format!("{} x {} scores", self.rows, self.columns);
            return Err(Error::shape("surface", needed, format!("{} scores", self.values.len())));
        }
        require_finite("surface first offset", &self.first)?;
        self.step.iter().try_for_each(|s| require_positive("surface step", *s).map(drop))
    }
}

impl Saved for Fix {
    const NAME: &'static str = "Fix";

    fn check(&self) -> Result<()> {
        if self.ok() {
            require_finite("a fix: x, y", &[self.x, self.y])?;
        }
        for (name, share) in [("risk", self.risk), ("goodness", self.goodness)] {
            if let Some(p) = share
                && !(0.0..=1.0).contains(&p)
            {
                return Err(Error::invalid(name, "a probability", p));
            }
        }
        if let Some([[ee, en], [ne, nn]]) = self.covariance_m2
            && (ee < 0.0 || nn < 0.0 || en.is_nan() != ne.is_nan())
        {
            return Err(Error::invalid("covariance_m2", "variances >= 0", format!("{ee}, {nn}")));
        }
        self.surface.as_ref().map_or(Ok(()), Saved::check)
    }
}
