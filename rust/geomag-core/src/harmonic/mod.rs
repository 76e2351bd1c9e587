//! Rectangular harmonic model of a potential field in a source-free box.
//!
//! In the frame of the model, x north, y east, z down, metres,
//!
//! `V = A x + B y + C z + sum_{q=1..N} sum_{t=0..q} P_tr(x, y) exp(u z)`, `r = q - t`, `v = 2 pi / Lx`, `w = 2 pi / Ly`,
//! `u = hypot(t v, r w)`,
//! `P_tr = D cos(tvx) cos(rwy) + E cos(tvx) sin(rwy) + F sin(tvx) cos(rwy) + G sin(tvx) sin(rwy)`,
//!
//! and the field is `-grad V` [Alldredge 1981, doi 10.1029/JB086iB04p03021; Zhao et al. 2012, with their garbled sums
//! mended]. The basis is periodic and the field is not: periods of 1.2 to 1.6 times the region keep the edges from
//! ringing, at the price of columns that are nearly dependent, which a small ridge settles.

mod basis;
mod evaluate;
mod fit;
mod gridded;
mod kernel;
mod map;
mod misfit;
mod normal;
mod observations;
mod select;

use serde::{Deserialize, Serialize};

pub use basis::{Prior, Term, coefficient_count, terms};
pub use evaluate::{Evaluation, Positions};
pub use fit::{FitOptions, FitSummary, Period, Regularisation, fit};
pub(crate) use map::Altitude;
pub use map::{HarmonicMap, Quantity};
pub use misfit::{FieldMisfit, Left, leave_out};
pub use observations::Observations;
pub use select::{Choice, Selection, SelectionOptions, select};

use crate::error::{Error, Result, require_finite, require_positive};
use crate::frame::LocalFrame;

/// Highest order that is accepted: 1.3 million coefficients, beyond any fit.
pub const MAX_ORDER: usize = 800;
/// How far beyond the data, as a share of their extent, still counts as inside: meridians open with height.
const MARGIN: f64 = 0.01;
/// How far below the data still counts as inside, in e-foldings of the shortest wavelength.
const MARGIN_BELOW: f64 = 0.1;

/// Cosine of the angle to a uniform field that nothing senses up to which a scalar counts as independent of it: north and down of
/// places in a frame differ by as much.
const UNSENSED: f64 = 0.1;

/// What a uniform field along a direction is called.
pub fn uniform_name(direction: &[f64; 3]) -> String {
    let axis = direction.iter().position(|c| c.abs() > 1.0 - 1e-6);
    if let Some(i) = axis {
        return format!("uniform field to the {}", ["north", "east", "nadir"][i]);
    }
    let [n, e, d] = direction;
    format!("uniform field along [{n:.3}, {e:.3}, {d:.3}] (north, east, down)")
}

/// The box that the observations filled: least and greatest north, east and down, metres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Least and greatest x.
    pub north_m: [f64; 2],
    /// Least and greatest y.
    pub east_m: [f64; 2],
    /// Least and greatest z. The field is continued upwards without limit, downwards by a tenth of an e-folding of the
    /// shortest wavelength.
    pub down_m: [f64; 2],
}

/// Lower triangle of the covariance of the coefficients, row by row.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Covariance {
    lower: Vec<f64>,
}

/// A rectangular harmonic model: coefficients, frame, region and, where it was fitted, how well they are known.
///
/// For maps of tens to hundreds of kilometres from any mixture of observations, for upward continuation and for smooth
/// gradients. Not for a region with sources in it, nor for the main field itself.
///
/// ```
/// use geomag_core::harmonic::{Region, RectangularHarmonicModel};
/// let region = Region { north_m: [-5e3, 5e3], east_m: [-5e3, 5e3], down_m: [-1e3, 0.0] };
/// // Order 1: A, B, C, then D, E of (t, r) = (0, 1), then D, F of (1, 0).
/// let model = RectangularHarmonicModel::new(1, [12e3, 12e3], vec![0.0, 0.0, -20.0, 0.0, 0.0, 0.0, 3e4], region)?;
/// let field = model.field_at([0.0, 0.0, 0.0]);
/// assert!((field[0] + 3e4 * std::f64::consts::TAU / 12e3).abs() < 1e-12);
/// assert_eq!(field[2], 20.0);
/// assert!(model.field_at([6e3, 0.0, 0.0])[0].is_nan());
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct RectangularHarmonicModel {
    periods_m: [f64; 2],
    coefficients: Vec<f64>,
    region: Region,
    frame: Option<LocalFrame>,
    unit: String,
    covariance: Option<Covariance>,
    summary: Option<FitSummary>,
    misfit: FieldMisfit,
    packed: kernel::Packed,
}

impl RectangularHarmonicModel {
    /// A model from its coefficients: A, B, C, then for q = 1 ... N and t = 0 ... q those of D, E, F, G that are not
    /// identically zero (see [`terms`]); field unit times metre. Periods along north and east in metres.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong number of coefficients, [`Error::NotFinite`], [`Error::Invalid`] for periods or a
    /// region that are not positive, or for exponentials that would overflow.
    pub fn new(order: usize, periods_m: [f64; 2], coefficients: Vec<f64>, region: Region) -> Result<Self> {
        if order > MAX_ORDER {
            return Err(Error::invalid("order", format!("at most {MAX_ORDER}"), order));
        }
        if coefficients.len() != coefficient_count(order) {
            return Err(Error::shape(
                "coefficients",
                format!("({},) for order {order}", coefficient_count(order)),
                format!("({},)", coefficients.len()),
            ));
        }
        require_finite("coefficients", &coefficients)?;
        require_positive("period along north", periods_m[0])?;
        require_positive("period along east", periods_m[1])?;
        for (name, [low, high]) in [("north", region.north_m), ("east", region.east_m), ("down", region.down_m)] {
            require_finite(&format!("region {name}_m"), &[low, high])?;
            if low > high {
                return Err(Error::invalid(
                    format!("region {name}_m"),
                    "least before greatest",
                    format!("[{low}, {high}]"),
                ));
            }
        }
        let wave = periods_m.map(|p| std::f64::consts::TAU / p);
        check_exponent(order, wave, region.down_m)?;
        let packed = kernel::Packed::new(order, wave, &coefficients);
        Ok(Self {
            periods_m,
            coefficients,
            region,
            frame: None,
            unit: "nT".into(),
            covariance: None,
            summary: None,
            misfit: FieldMisfit::default(),
            packed,
        })
    }

    /// The same model in a frame on the Earth, so that geographic coordinates can be used with it.
    #[must_use]
    pub fn with_frame(mut self, frame: Option<LocalFrame>) -> Self {
        self.frame = frame;
        self
    }

    /// The same model with another unit of the field (`nT` unless told).
    #[must_use]
    pub fn with_unit(mut self, unit: impl Into<String>) -> Self {
        self.unit = unit.into();
        self
    }

    /// The same model without the covariance of its coefficients: half a million numbers less at order 18.
    #[must_use]
    pub fn without_covariance(mut self) -> Self {
        self.covariance = None;
        self
    }

    /// The same model with a covariance of its coefficients, row-major, square.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::NotFinite`], [`Error::Invalid`] for a negative variance.
    pub fn with_covariance(mut self, covariance: &[f64]) -> Result<Self> {
        let n = self.coefficients.len();
        if covariance.len() != n * n {
            return Err(Error::shape("covariance", format!("({n}, {n})"), format!("{} numbers", covariance.len())));
        }
        let lower = (0..n).flat_map(|i| covariance[i * n..=i * n + i].iter().copied()).collect();
        self.covariance = Some(Covariance::new(lower, n)?);
        Ok(self)
    }

    /// The same model with another account of its errors (see [`FieldMisfit`]).
    #[must_use]
    pub fn with_misfit(mut self, misfit: FieldMisfit) -> Self {
        self.misfit = misfit;
        self
    }

    /// The same field with zero at a level: all points on that plane are then the cheap ones. The coefficients as they are
    /// told are not changed, nor is the region.
    pub(crate) fn seen_from(&self, down_m: f64) -> Self {
        Self { packed: self.packed.seen_from(down_m), ..self.clone().without_covariance() }
    }

    /// What its sigma is made of besides the covariance of the coefficients.
    pub fn misfit(&self) -> FieldMisfit {
        self.misfit
    }

    /// Order N.
    pub fn order(&self) -> usize {
        self.packed.order
    }

    /// Periods along north and east, metres.
    pub fn periods_m(&self) -> [f64; 2] {
        self.periods_m
    }

    /// The coefficients, in the order of [`RectangularHarmonicModel::new`], field unit times metre.
    pub fn coefficients(&self) -> &[f64] {
        &self.coefficients
    }

    /// The box that the observations filled.
    pub fn region(&self) -> &Region {
        &self.region
    }

    /// The frame on the Earth, where it has one.
    pub fn frame(&self) -> Option<&LocalFrame> {
        self.frame.as_ref()
    }

    /// Unit of the field.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// What the fit said of itself, where the model was fitted.
    pub fn summary(&self) -> Option<&FitSummary> {
        self.summary.as_ref()
    }

    /// A quantity as this model knows it: what was fitted as a projection on the main field is read as one again, for the part of
    /// the field across it, which the length of the sum would count, was not observed.
    pub(crate) fn as_fitted(&self, quantity: Quantity) -> Quantity {
        if !self.summary.as_ref().is_some_and(|s| s.projected) {
            return quantity;
        }
        match quantity {
            Quantity::Anomaly(main) => Quantity::Projection(main),
            Quantity::Intensity(main) => Quantity::ProjectedIntensity(main),
            other => other,
        }
    }

    /// The name of a uniform field along which a scalar is sensitive and that no observation senses, where there is one.
    pub(crate) fn unsensed(&self, direction: [f64; 3]) -> Option<String> {
        let length = evaluate::norm(direction);
        let along = |n: &[f64; 3]| (0..3).map(|i| n[i] * direction[i]).sum::<f64>().abs() > UNSENSED * length;
        self.summary.as_ref()?.undetermined.iter().find(|n| along(n)).map(uniform_name)
    }

    /// Whether the covariance of the coefficients is known.
    pub fn has_covariance(&self) -> bool {
        self.covariance.is_some()
    }

    /// The covariance of the coefficients, row-major and square, where it is known.
    pub fn covariance(&self) -> Option<Vec<f64>> {
        let n = self.coefficients.len();
        self.covariance.as_ref().map(|c| (0..n * n).map(|k| c.at(k / n, k % n)).collect())
    }

    /// Whether a point (north, east, down, metres) is where the model may be used without extrapolating: within the
    /// region and a hundredth of its extent around it, any distance above it, and a tenth of an e-folding of the
    /// shortest wavelength below.
    pub fn contains(&self, point_m: [f64; 3]) -> bool {
        let within = |value: f64, [low, high]: [f64; 2]| {
            let margin = MARGIN * (high - low);
            value >= low - margin && value <= high + margin
        };
        let [v, w] = self.packed.wave;
        let shortest = (v.max(w) * self.order() as f64).max(f64::MIN_POSITIVE);
        within(point_m[0], self.region.north_m)
            && within(point_m[1], self.region.east_m)
            && point_m[2] <= self.region.down_m[1] + MARGIN_BELOW / shortest
    }

    /// The model as JSON text: frame, periods, region, coefficients, covariance, units.
    ///
    /// # Errors
    /// [`Error::State`].
    pub fn to_json(&self) -> Result<String> {
        let saved = SavedHarmonicModel {
            format: FORMAT.into(),
            version: VERSION,
            unit: self.unit.clone(),
            frame: self.frame,
            order: self.order(),
            periods_m: self.periods_m,
            region: self.region,
            coefficients: self.coefficients.clone(),
            covariance_lower: self.covariance.as_ref().map(|c| c.lower.clone()),
            fit: self.summary.clone(),
            misfit: Some(self.misfit),
        };
        serde_json::to_string(&saved).map_err(|e| state_error(&e))
    }

    /// The model from its JSON text, bit for bit as it was saved.
    ///
    /// # Errors
    /// [`Error::State`] for text that is no such model; otherwise as [`RectangularHarmonicModel::new`].
    pub fn from_json(text: &str) -> Result<Self> {
        let saved: SavedHarmonicModel = serde_json::from_str(text).map_err(|e| state_error(&e))?;
        if saved.format != FORMAT || saved.version != VERSION {
            return Err(state_error(&format!(
                "needed format {FORMAT:?} version {VERSION}, got {:?} version {}",
                saved.format, saved.version
            )));
        }
        let mut model = Self::new(saved.order, saved.periods_m, saved.coefficients, saved.region)?
            .with_frame(saved.frame)
            .with_unit(saved.unit);
        model.covariance =
            saved.covariance_lower.map(|lower| Covariance::new(lower, model.coefficients.len())).transpose()?;
        model.summary = saved.fit;
        model.misfit = saved.misfit.unwrap_or_default();
        model.misfit.validate()?;
        Ok(model)
    }
}

const FORMAT: &str = "geomag rectangular harmonic model";
const VERSION: u32 = 1;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedHarmonicModel {
    format: String,
    version: u32,
    unit: String,
    frame: Option<LocalFrame>,
    order: usize,
    periods_m: [f64; 2],
    region: Region,
    coefficients: Vec<f64>,
    covariance_lower: Option<Vec<f64>>,
    fit: Option<FitSummary>,
    #[serde(default)]
    misfit: Option<FieldMisfit>,
}

fn state_error(detail: &impl ToString) -> Error {
    Error::State { what: "rectangular harmonic model".into(), detail: detail.to_string() }
}

/// Refuses exponentials that leave the range of double precision: the frame's origin is then far from the data's level.
fn check_exponent(order: usize, wave: [f64; 2], down_m: [f64; 2]) -> Result<()> {
    let largest = wave[0].max(wave[1]) * order as f64 * down_m[0].abs().max(down_m[1].abs());
    if largest <= 300.0 {
        return Ok(());
    }
    Err(Error::invalid(
        "down_m",
        "levels within 300 e-foldings of the shortest wavelength from zero (put the frame's origin at the level of \
         the observations, or lower the order)",
        format!("{largest:.0} e-foldings"),
    ))
}

impl Covariance {
    fn new(lower: Vec<f64>, n: usize) -> Result<Self> {
        if lower.len() != n * (n + 1) / 2 {
            return Err(Error::shape(
                "covariance (lower triangle)",
                format!("({},)", n * (n + 1) / 2),
                format!("({},)", lower.len()),
            ));
        }
        require_finite("covariance (lower triangle)", &lower)?;
        let covariance = Self { lower };
        match (0..n).find(|&i| covariance.at(i, i) < 0.0) {
            None => Ok(covariance),
            Some(i) => Err(Error::invalid(format!("covariance[{i}][{i}]"), "a variance >= 0", covariance.at(i, i))),
        }
    }

    fn at(&self, i: usize, j: usize) -> f64 {
        let (i, j) = (i.max(j), i.min(j));
        self.lower[i * (i + 1) / 2 + j]
    }
}

#[cfg(test)]
mod tests;
