//! The indicated track: positions as the INS gives them, with the measured field values.

use serde::{Deserialize, Serialize};

use crate::bounds::{require_places, require_values};
use crate::error::{Error, Result, require_finite, require_weights};

/// Indicated positions and measured values, oldest first.
///
/// x to the east and y to the north, in the map's units (metres, or degrees of longitude and latitude); values in the
/// map's unit; times in seconds; heights, where they are known, in metres above the height datum of the map, positive up.
///
/// ```
/// let track = geomag_core::track::Track::new(vec![0.0, 50.0], vec![0.0, 10.0], vec![12.5, 13.0], None)?;
/// assert_eq!(track.len(), 2);
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Track {
    x: Vec<f64>,
    y: Vec<f64>,
    values: Vec<f64>,
    time_s: Option<Vec<f64>>,
    #[serde(default)]
    height_m: Option<Vec<f64>>,
}

impl Track {
    /// A track of at least one sample.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`] without a sample, [`Error::Shape`] for unequal lengths, [`Error::NotFinite`] naming the
    /// first bad sample, [`Error::Invalid`] where a coordinate or a value is out of bounds ([`require_places`], [`require_values`]) or time runs backwards.
    pub fn new(x: Vec<f64>, y: Vec<f64>, values: Vec<f64>, time_s: Option<Vec<f64>>) -> Result<Self> {
        let n = x.len();
        for (name, len) in [("y", y.len()), ("values", values.len()), ("time_s", time_s.as_ref().map_or(n, Vec::len))] {
            if len != n {
                return Err(Error::shape(format!("track {name}"), format!("({n},) as x"), format!("({len},)")));
            }
        }
        if n == 0 {
            return Err(Error::TooFewSamples { what: "track".into(), needed: 1, got: 0 });
        }
        // What coordinates they are is the map's to say; a matcher asks again with it.
        require_places("track", false, &x, &y)?;
        require_values("track values", &values)?;
        if let Some(time) = &time_s {
            require_finite("track time_s", time)?;
            if let Some(i) = time.windows(2).position(|w| w[1] < w[0]) {
                return Err(Error::invalid(
                    format!("track time_s[{}]", i + 1),
                    format!("a time not before {}", time[i]),
                    time[i + 1],
                ));
            }
        }
        Ok(Self { x, y, values, time_s, height_m: None })
    }

    /// The same track with the height of every sample, metres above the height datum of the map, positive up.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of heights than samples, [`Error::NotFinite`] naming the first bad one.
    pub fn with_height(mut self, height_m: Option<Vec<f64>>) -> Result<Self> {
        if let Some(height) = &height_m {
            if height.len() != self.len() {
                let got = format!("({},)", height.len());
                return Err(Error::shape("track height_m", format!("({},) as x", self.len()), got));
            }
            crate::bounds::require_heights("track height_m", height)?;
        }
        self.height_m = height_m;
        Ok(self)
    }

    /// Refuses a track of which a sample cannot lie on a map of these coordinates.
    ///
    /// # Errors
    /// As [`require_places`].
    pub fn require_on(&self, geographic: bool) -> Result<()> {
        require_places("track", geographic, &self.x, &self.y)
    }

    /// Number of samples, at least one.
    #[allow(clippy::len_without_is_empty)] // never empty by construction
    pub fn len(&self) -> usize {
        self.x.len()
    }

    /// Indicated x (east).
    pub fn x(&self) -> &[f64] {
        &self.x
    }

    /// Indicated y (north).
    pub fn y(&self) -> &[f64] {
        &self.y
    }

    /// Measured values.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Times in seconds, where they are known.
    pub fn time_s(&self) -> Option<&[f64]> {
        self.time_s.as_deref()
    }

    /// Heights in metres above the height datum of the map, where they are known.
    pub fn height_m(&self) -> Option<&[f64]> {
        self.height_m.as_deref()
    }

    /// Indicated position of sample `k`.
    pub fn point(&self, k: usize) -> [f64; 2] {
        [self.x[k], self.y[k]]
    }

    /// Indicated position of the newest sample.
    pub fn newest(&self) -> [f64; 2] {
        self.point(self.len() - 1)
    }

    /// Samples `range` as a track of their own.
    ///
    /// # Errors
    /// [`Error::Invalid`] where the range leaves the track, [`Error::TooFewSamples`] where it is empty.
    pub fn slice(&self, range: std::ops::Range<usize>) -> Result<Self> {
        if range.end > self.len() || range.start > range.end {
            return Err(Error::invalid(
                "track slice",
                format!("a range within 0..{}", self.len()),
                format!("{range:?}"),
            ));
        }
        Self::new(
            self.x[range.clone()].to_vec(),
            self.y[range.clone()].to_vec(),
            self.values[range.clone()].to_vec(),
            self.time_s.as_ref().map(|t| t[range.clone()].to_vec()),
        )?
        .with_height(self.height_m.as_ref().map(|h| h[range].to_vec()))
    }

    /// The samples whose weight is not zero, as a track of their own; all of them without `weights`.
    ///
    /// # Errors
    /// As [`require_weights`].
    pub fn weighted(&self, weights: Option<&[f64]>) -> Result<Self> {
        let Some(weights) = weights else { return Ok(self.clone()) };
        require_weights(weights, self.len())?;
        let pick = |from: &[f64]| from.iter().zip(weights).filter(|(_, w)| **w > 0.0).map(|(v, _)| *v).collect();
        Self::new(pick(&self.x), pick(&self.y), pick(&self.values), self.time_s.as_deref().map(pick))?
            .with_height(self.height_m.as_deref().map(pick))
    }

    /// Standard deviation of the readings.
    pub fn spread(&self) -> f64 {
        let n = self.values.len() as f64;
        let mean = self.values.iter().sum::<f64>() / n;
        (self.values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n).sqrt()
    }

    /// Along-track distance of every sample from the first, metres.
    pub fn distance_m(&self, geographic: bool) -> Vec<f64> {
        let mut out = Vec::with_capacity(self.len());
        let mut total = 0.0;
        out.push(0.0);
        for k in 1..self.len() {
            let [east, north] = crate::frame::displacement_m(geographic, self.point(k - 1), self.point(k));
            total += east.hypot(north);
            out.push(total);
        }
        out
    }
}
