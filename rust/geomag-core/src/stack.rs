//! One map at several heights: a field that is interpolated between levels.
//!
//! A sample at a height between two levels sees `(1 - t)` of the lower and `t` of the upper one. The two weights are constants
//! over all offsets of that sample, as its bilinear weights are, so that the kernels of the matchers serve a stack as they
//! serve a map, at the cost of a second reading.

use std::sync::Arc;

use crate::error::{Error, Result};
use crate::field::Field;
use crate::grid::{GridMap, GridValues, Interpolation, MapHeight, MapSigma};
use crate::map_error::{DistanceLayer, MapErrorModel};
use crate::track::Track;

/// Share of a cell by which heights may differ from a map's level without being another height.
const SAME_LEVEL: f64 = 1e-3;
/// Share of a cell by which heights may differ and still be one level, for whoever knows no more than one.
const ONE_LEVEL: f64 = 0.1;

/// Levels of one map, lowest first: the same nodes at different heights.
///
/// ```
/// use geomag_core::field::Field;
/// use geomag_core::grid::{GridMap, GridValues, MapHeight};
/// use geomag_core::stack::MapStack;
/// let level = |value: f64, height| {
///     GridMap::new(GridValues::F64(vec![value; 4]), &[0.0, 100.0], &[0.0, 100.0], false)?
///         .with_height(Some(MapHeight::Level(height)))
/// };
/// let stack = MapStack::new(vec![level(10.0, 100.0)?, level(6.0, 200.0)?])?;
/// assert_eq!(stack.value_at(50.0, 50.0, 150.0), 8.0);
/// assert!(stack.value_at(50.0, 50.0, 250.0).is_nan());
/// # Ok::<(), geomag_core::error::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct MapStack {
    levels: Vec<Arc<GridMap>>,
    heights_m: Vec<f64>,
}

/// Where a height lies in a stack: the level below it, and the share of the one above; none of it exactly on a level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Storey {
    /// Number of the level at or below the height.
    pub level: usize,
    /// Share of the level above, in [0, 1).
    pub share: f64,
}

impl Storey {
    /// That of a field of one surface.
    pub const GROUND: Self = Self { level: 0, share: 0.0 };
}

impl MapStack {
    /// A stack of maps on the same nodes, each at a level; in any order.
    ///
    /// # Errors
    /// [`Error::TooFewSamples`] without a map; [`Error::Invalid`] for a map that is not on a level, two at the same height, or
    /// maps that differ in nodes, coordinates or precision.
    pub fn new(levels: Vec<GridMap>) -> Result<Self> {
        let mut with_height = Vec::with_capacity(levels.len());
        for (i, level) in levels.into_iter().enumerate() {
            let Some(&MapHeight::Level(height)) = level.height() else {
                let got = if level.height().is_some() { "a draped surface" } else { "a map without a height" };
                return Err(Error::invalid(format!("level {i} of a stack"), "a map on a level", got));
            };
            with_height.push((height, Arc::new(level)));
        }
        with_height.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, first)) = with_height.first() else {
            return Err(Error::TooFewSamples { what: "levels of a stack".into(), needed: 1, got: 0 });
        };
        let single = |map: &GridMap| matches!(map.values(), GridValues::F32(_));
        for (i, (_, level)) in with_height.iter().enumerate() {
            let alike = level.x() == first.x()
                && level.y() == first.y()
                && level.geographic() == first.geographic()
                && level.ground_scale() == first.ground_scale()
                && single(level) == single(first);
            if !alike {
                return Err(Error::invalid(
                    format!("level {i} of a stack"),
                    "the nodes, coordinates and precision of the lowest",
                    "another grid",
                ));
            }
        }
        if let Some(w) = with_height.windows(2).find(|w| w[0].0 == w[1].0) {
            return Err(Error::invalid("heights of a stack", "every height once", format!("{} m twice", w[0].0)));
        }
        let (heights_m, levels) = with_height.into_iter().unzip();
        Ok(Self { levels, heights_m })
    }

    /// The levels, lowest first.
    pub fn levels(&self) -> &[Arc<GridMap>] {
        &self.levels
    }

    /// Their heights, ascending, metres above the height datum.
    pub fn heights_m(&self) -> &[f64] {
        &self.heights_m
    }

    /// The map of the lowest level.
    pub fn lowest(&self) -> &GridMap {
        &self.levels[0]
    }

    /// Where a height lies; `None` below the lowest level and above the highest.
    pub fn storey(&self, height_m: f64) -> Option<Storey> {
        let above = self.heights_m.partition_point(|h| *h <= height_m);
        let level = above.checked_sub(1)?;
        let low = self.heights_m[level];
        match self.heights_m.get(above) {
            Some(high) => Some(Storey { level, share: (height_m - low) / (high - low) }),
            None => (height_m == low).then_some(Storey { level, share: 0.0 }),
        }
    }

    /// Storeys of many heights.
    ///
    /// # Errors
    /// [`Error::Invalid`] naming the first sample that no level lies below, or above.
    pub fn storeys(&self, heights_m: &[f64]) -> Result<Vec<Storey>> {
        let [low, high] = self.range();
        let one = |(k, h): (usize, &f64)| {
            self.storey(*h).ok_or_else(|| {
                Error::invalid(format!("track height_m[{k}]"), format!("a height in the stack, {low} to {high} m"), *h)
            })
        };
        heights_m.iter().enumerate().map(one).collect()
    }

    /// Mean correlation length of the map's errors over some storeys, in distances to the data; `None` without an error model.
    pub(crate) fn correlation(&self, storeys: &[Storey]) -> Option<f64> {
        let of: Vec<f64> = self.levels.iter().map(|l| l.error_model().map(|m| m.correlation)).collect::<Option<_>>()?;
        let one = |s: &Storey| {
            let above = of.get(s.level + 1).filter(|_| s.share > 0.0);
            above.map_or(of[s.level], |above| of[s.level] + s.share * (above - of[s.level]))
        };
        (!storeys.is_empty()).then(|| storeys.iter().map(one).sum::<f64>() / storeys.len() as f64)
    }

    fn range(&self) -> [f64; 2] {
        [self.heights_m[0], self.heights_m[self.heights_m.len() - 1]]
    }

    /// The levels at and around heights from `low` to `high`: less to lay out.
    #[must_use]
    pub fn around(&self, low: f64, high: f64) -> Self {
        let first = self.heights_m.partition_point(|h| *h <= low).saturating_sub(1);
        let end = (self.heights_m.partition_point(|h| *h < high) + 1).min(self.levels.len()).max(first + 1);
        Self { levels: self.levels[first..end].to_vec(), heights_m: self.heights_m[first..end].to_vec() }
    }

    /// The map at one height: its values, sigma and error model between those of the levels about it.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a height outside the stack.
    pub fn at(&self, height_m: f64) -> Result<GridMap> {
        crate::bounds::require_heights("height_m", &[height_m])?;
        let [low, high] = self.range();
        let Some(Storey { level, share }) = self.storey(height_m) else {
            return Err(Error::invalid("height_m", format!("a height in the stack, {low} to {high} m"), height_m));
        };
        let below = &*self.levels[level];
        if share == 0.0 {
            return Ok(below.clone());
        }
        let above = &*self.levels[level + 1];
        let mix = |a: f64, b: f64| a + share * (b - a);
        let values = match (below.values(), above.values()) {
            (GridValues::F32(a), GridValues::F32(b)) => {
                GridValues::F32(a.iter().zip(b).map(|(a, b)| a + share as f32 * (b - a)).collect())
            }
            (a, b) => GridValues::F64((0..a.len()).map(|i| mix(a.get(i), b.get(i))).collect()),
        };
        let sigma = match (below.map_sigma(), above.map_sigma()) {
            (Some(MapSigma::Constant(a)), Some(MapSigma::Constant(b))) => Some(MapSigma::Constant(mix(*a, *b))),
            (Some(a), Some(b)) => {
                let of = |sigma: &MapSigma, i: usize| match sigma {
                    MapSigma::Constant(s) => *s,
                    MapSigma::Grid(layer) => layer[i],
                };
                Some(MapSigma::Grid((0..values.len()).map(|i| mix(of(a, i), of(b, i))).collect()))
            }
            _ => None,
        };
        let model = match (below.error_model(), above.error_model()) {
            (Some(a), Some(b)) => Some(MapErrorModel {
                correlation: mix(a.correlation, b.correlation),
                distance_m: match (&a.distance_m, &b.distance_m) {
                    (DistanceLayer::Constant(p), DistanceLayer::Constant(q)) => DistanceLayer::Constant(mix(*p, *q)),
                    (layer, _) => layer.clone(),
                },
                ..a.clone()
            }),
            _ => None,
        };
        GridMap::from_axes(values, *below.x(), *below.y(), below.geographic())?
            .with_sigma(sigma)?
            .with_error_model(model)?
            .with_ground_scale(below.ground_scale().map(<[_]>::to_vec))?
            .with_height(Some(MapHeight::Level(height_m)))
    }

    fn mixed(&self, height_m: f64, of: impl Fn(&GridMap) -> f64) -> f64 {
        let Some(Storey { level, share }) = self.storey(height_m) else { return f64::NAN };
        let below = of(&self.levels[level]);
        if share == 0.0 { below } else { below + share * (of(&self.levels[level + 1]) - below) }
    }

    /// Value at a place and height; NaN where it is unknown.
    pub fn sample(&self, x: f64, y: f64, height_m: f64, method: Interpolation) -> f64 {
        self.mixed(height_m, |map| map.sample(x, y, method))
    }
}

impl Field for MapStack {
    /// That of the lowest level.
    fn value(&self, x: f64, y: f64) -> f64 {
        self.lowest().value(x, y)
    }

    fn value_and_gradient(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        self.lowest().value_and_gradient(x, y)
    }

    fn value_at(&self, x: f64, y: f64, height_m: f64) -> f64 {
        self.sample(x, y, height_m, Interpolation::Bilinear)
    }

    fn value_and_gradient_at(&self, x: f64, y: f64, height_m: f64) -> (f64, [f64; 2]) {
        let value = self.value_at(x, y, height_m);
        let slope = [0, 1].map(|d| self.mixed(height_m, |map| map.value_and_gradient(x, y).1[d]));
        (value, slope)
    }

    fn sigma(&self, x: f64, y: f64) -> f64 {
        self.lowest().sigma(x, y)
    }

    fn sigma_at(&self, x: f64, y: f64, height_m: f64) -> f64 {
        self.mixed(height_m, |map| map.sigma(x, y))
    }

    fn heights(&self) -> Option<[f64; 2]> {
        Some(self.range())
    }

    fn geographic(&self) -> bool {
        self.lowest().geographic()
    }

    fn metres_per_unit(&self, y: f64) -> [f64; 2] {
        self.lowest().metres_per_unit(y)
    }

    fn wrap_x(&self, x: f64) -> f64 {
        self.lowest().wrap_x(x)
    }

    fn spacing(&self) -> [f64; 2] {
        self.lowest().spacing()
    }

    fn mean(&self) -> f64 {
        self.lowest().mean()
    }

    fn as_stack(&self) -> Option<&MapStack> {
        Some(self)
    }

    fn layout(&self) -> Option<&GridMap> {
        Some(self.lowest())
    }
}

/// What of a field serves readings at these heights.
#[derive(Debug)]
pub enum Served<'a> {
    /// The field as it is.
    AsItIs(&'a dyn Field),
    /// Some levels of a stack.
    Levels(MapStack),
    /// A field that can be evaluated anywhere, at these heights.
    Evaluated(Box<dyn Field>),
}

impl Served<'_> {
    /// The field.
    pub fn field(&self) -> &dyn Field {
        match self {
            Self::AsItIs(field) => *field,
            Self::Levels(stack) => stack,
            Self::Evaluated(field) => &**field,
        }
    }
}

/// Lowest and greatest of some heights; `None` where there are none.
pub fn extent(heights_m: &[f64]) -> Option<[f64; 2]> {
    let low = heights_m.iter().copied().fold(f64::INFINITY, f64::min);
    let high = heights_m.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    (low <= high).then_some([low, high])
}

/// The heights at which levels were read for a track, for its answer.
pub fn read_heights(served: &[Served<'_>], track: &Track) -> Option<[f64; 2]> {
    let levels = served.iter().any(|s| !matches!(s, Served::AsItIs(_)));
    track.height_m().filter(|_| levels).and_then(extent)
}

/// Whether a map is at another height than a track somewhere: the heights over which it has to be continued.
///
/// A track without heights is taken to be at the map's own.
///
/// # Errors
/// [`Error::Invalid`] for a track with heights over a map without.
pub fn continuation_needed(map: &GridMap, track: &Track) -> Result<Option<[f64; 2]>> {
    heights_needed(map, track.height_m().and_then(extent))
}

/// [`continuation_needed`] for readings between a lowest and a greatest height, `None` where nobody said.
///
/// # Errors
/// As [`continuation_needed`].
pub fn heights_needed(map: &GridMap, heights_m: Option<[f64; 2]>) -> Result<Option<[f64; 2]>> {
    let Some([low, high]) = heights_m else { return Ok(None) };
    match map.height() {
        None => Err(Error::invalid(
            "map height_m",
            "the height of the map, for the track has heights (leave these out for a track at the map's own height)",
            format!("none; the track is at {low} to {high} m"),
        )),
        Some(MapHeight::Level(level)) => {
            let same = SAME_LEVEL * smaller_cell_m(map);
            Ok(((low - level).abs() > same || (high - level).abs() > same).then_some([low, high]))
        }
        Some(MapHeight::Drape(_)) => Ok(Some([low, high])),
    }
}

/// The smaller side of a cell at the middle of a field, metres.
fn smaller_cell_m(map: &GridMap) -> f64 {
    let [east, north] = map.metres_per_unit(0.5 * (map.y().first() + map.y().last()));
    (map.x().step() * east).min(map.y().step() * north)
}

/// Whether readings between two heights may be taken as those of one level: within a tenth of a cell.
pub fn is_one_level(cell_m: f64, [low, high]: [f64; 2]) -> bool {
    high - low <= ONE_LEVEL * cell_m
}

/// Checks that a map of one level is that of a reading, for whoever follows one level only.
///
/// # Errors
/// [`Error::Invalid`] for a map at another height, or at none that is known.
pub fn require_level(map: &GridMap, height_m: f64) -> Result<()> {
    match map.height() {
        Some(MapHeight::Level(level))
            if is_one_level(smaller_cell_m(map), [level.min(height_m), level.max(height_m)]) =>
        {
            Ok(())
        }
        Some(MapHeight::Level(level)) => Err(Error::invalid(
            "height_m",
            format!("the map's own level of {level} m, the one that is followed"),
            height_m,
        )),
        Some(MapHeight::Drape(_)) => Err(Error::invalid("map", "a map on a level", "one on a draped surface")),
        None => heights_needed(map, Some([height_m; 2])).map(|_| ()),
    }
}

/// Whether a field can say what is read at a height; `None` where the height was not told.
///
/// # Errors
/// [`Error::Invalid`] where heights are told on one side only and matter, or a map of one level is at another.
pub fn check_height(field: &dyn Field, height_m: Option<f64>) -> Result<()> {
    check_extent(field, height_m.map(|h| [h; 2]))
}

/// Whether a field serves a track at its heights.
///
/// # Errors
/// [`Error::Invalid`] where heights are told on one side only and matter, or lie outside what the field knows.
pub fn check_heights(field: &dyn Field, track: &Track) -> Result<()> {
    check_extent(field, track.height_m().and_then(extent))?;
    if let (Some(stack), Some(heights)) = (field.as_stack(), track.height_m()) {
        stack.storeys(heights)?;
    }
    Ok(())
}

fn check_extent(field: &dyn Field, heights_m: Option<[f64; 2]>) -> Result<()> {
    if let (Some(stack), None) = (field.as_stack(), heights_m) {
        let [low, high] = stack.range();
        return Err(Error::invalid(
            "track height_m",
            format!("the heights of the track, for the map is a stack of levels from {low} to {high} m"),
            "none",
        ));
    }
    if let Some(map) = field.as_grid()
        && let Some([low, high]) = heights_needed(map, heights_m)?
    {
        let own = match map.height() {
            Some(MapHeight::Level(level)) => format!("its own level of {level} m"),
            _ => "its draped surface".into(),
        };
        return Err(Error::invalid(
            "map",
            format!("a stack of levels that covers the track's heights, for this map is known on {own} only"),
            format!("a track at {low} to {high} m"),
        ));
    }
    Ok(())
}

/// The part of a field that serves a track at its heights.
///
/// # Errors
/// As [`check_heights`].
pub fn served<'a>(field: &'a dyn Field, track: &Track) -> Result<Served<'a>> {
    check_heights(field, track)?;
    let Some(stack) = field.as_stack() else {
        let evaluated = match track.height_m().and_then(extent) {
            Some([low, high]) => field.between(low, high)?,
            None => None,
        };
        return Ok(evaluated.map_or(Served::AsItIs(field), Served::Evaluated));
    };
    Ok(match track.height_m().and_then(extent) {
        Some([low, high]) => Served::Levels(stack.around(low, high)),
        None => Served::AsItIs(field),
    })
}
