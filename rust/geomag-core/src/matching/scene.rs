//! The ground that contour matching and its refinement share: channels, samples laid out in metres, motion parameters.

use serde::{Deserialize, Serialize};

use crate::error::{Error, Result, require_finite, require_not_negative};
use crate::field::Field;
use crate::grid::{GridMap, Interpolation};
use crate::matching::closest::cell_size_m;
use crate::track::Track;

/// One field along the track: a map, what was measured of it, and how well.
///
/// Several channels are matched at once: two or three components of one field, or magnetics and gravity together. Their
/// maps must use the same coordinates; spacing and extent are each map's own.
#[derive(Debug)]
pub struct Channel<'a, F: ?Sized = dyn Field + 'a> {
    /// The map: contours want a grid, the posterior takes any field.
    pub field: &'a F,
    /// One measured value a sample of the track, value units.
    pub values: &'a [f64],
    /// Standard deviation of the sensor, value units; `None` where it is not known.
    pub sigma: Option<f64>,
}

// Derived, these would ask that the field itself can be copied.
impl<F: ?Sized> Clone for Channel<'_, F> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<F: ?Sized> Copy for Channel<'_, F> {}

/// What is known of the INS beforehand, each written once; see `table.rs`.
#[doc(hidden)]
#[macro_export]
macro_rules! motion_prior_options {
    ($then:ident $($given:tt)*) => {
        $then! {
            $($given)*
            prior [
                (offset_sigma_m: maybe_number = None; "float, optional";
                    "Standard deviation of the INS error at the newest point on each axis, metres; as infinity by default.")
                (heading_sigma_deg: maybe_number = None; "float, optional";
                    "That of its heading, degrees; the indicated heading is held by default, unless the transform is free to turn.")
                (scale_sigma: maybe_number = None; "float, optional";
                    "That of its scale (speed), a ratio; the indicated scale is held by default, unless the transform is free to stretch.")
                (bias_sigma: maybe_number = None; "float, optional";
                    "That of a constant in the measurement, value units; it is taken to be zero by default.")
            ]
        }
    };
}

macro_rules! priors_struct {
    (prior [$(($name:ident: $kind:ident = $default:tt; $python:literal; $($line:literal)+))*]) => {
        /// What is known beforehand of the INS error at the newest point; infinity is a flat prior, `None` "not looked for". Priors bound the
        /// transforms of ICCP too.
        #[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
        pub struct Priors {
            $($(#[doc = concat!(" ", $line)])+ pub $name: option_type!($kind),)*
        }
    };
}

motion_prior_options!(priors_struct);

impl Priors {
    /// Refuses standard deviations that are not positive (infinity is allowed).
    ///
    /// # Errors
    /// [`Error::Invalid`].
    pub fn check(&self) -> Result<()> {
        for (name, value) in [
            ("offset_sigma_m", self.offset_sigma_m),
            ("heading_sigma_deg", self.heading_sigma_deg),
            ("scale_sigma", self.scale_sigma),
            ("bias_sigma", self.bias_sigma),
        ] {
            if let Some(v) = value
                && (v.is_nan() || v <= 0.0)
            {
                return Err(Error::invalid(name, "a number > 0 (infinity: no prior; leave it out: not estimated)", v));
            }
        }
        Ok(())
    }

    /// Whether any of them bounds the motion.
    pub fn bound_motion(&self) -> bool {
        [self.offset_sigma_m, self.heading_sigma_deg, self.scale_sigma].iter().flatten().any(|s| s.is_finite())
    }
}

/// Motion of the indicated track about its newest point.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Motion {
    /// Offset of the newest point, metres `[east, north]`.
    pub offset_m: [f64; 2],
    /// Rotation of the track, clockwise, radians: true minus indicated heading.
    pub heading_rad: f64,
    /// True over indicated distance, less one.
    pub stretch: f64,
}

impl Motion {
    /// A pure offset.
    pub const fn offset(offset_m: [f64; 2]) -> Self {
        Self { offset_m, heading_rad: 0.0, stretch: 0.0 }
    }

    /// Displacement, metres, of a point at `lever` metres from the newest point.
    #[inline]
    pub fn displacement(&self, lever: [f64; 2]) -> [f64; 2] {
        let (sin, cos) = self.heading_rad.sin_cos();
        let scale = 1.0 + self.stretch;
        [
            self.offset_m[0] + scale * (cos * lever[0] + sin * lever[1]) - lever[0],
            self.offset_m[1] + scale * (cos * lever[1] - sin * lever[0]) - lever[1],
        ]
    }
}

/// Where a sample lies in one channel's map: cells from its first node, and cells per metre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Placement {
    pub base: [f64; 2],
    pub cell_m: [f64; 2],
}

impl Placement {
    #[inline]
    pub fn position(&self, displacement: [f64; 2]) -> [f64; 2] {
        [self.base[0] + displacement[0] / self.cell_m[0], self.base[1] + displacement[1] / self.cell_m[1]]
    }
}

/// How the misfits of two places of a track are made comparable.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Judgement {
    /// Whether a constant of each channel is taken out.
    pub unbiased: bool,
    /// Least samples that a channel must have on its map: a few that fit by chance must not beat the whole track.
    pub min_samples: usize,
}

/// A track laid out on its channels. Displacements are metres east and north at each sample's own latitude; levers are
/// metres from the newest point. A rotation in degrees of longitude and latitude would be none.
#[derive(Debug)]
pub(crate) struct Scene<'a> {
    pub channels: &'a [Channel<'a, GridMap>],
    pub track: &'a Track,
    pub levers: Vec<[f64; 2]>,
    /// Channel by channel, one placement a sample.
    pub placements: Vec<Vec<Placement>>,
    pub weights: Option<&'a [f64]>,
}

impl<'a> Scene<'a> {
    pub fn new(channels: &'a [Channel<'a, GridMap>], track: &'a Track, weights: Option<&'a [f64]>) -> Result<Self> {
        let Some(first) = channels.first() else {
            return Err(Error::invalid("channels", "at least one", 0));
        };
        let n = track.len();
        for (c, channel) in channels.iter().enumerate() {
            if channel.values.len() != n {
                return Err(Error::shape(
                    format!("channel {c} values"),
                    format!("({n},) as the track"),
                    format!("({},)", channel.values.len()),
                ));
            }
            require_finite(&format!("channel {c} values"), channel.values)?;
            if let Some(sigma) = channel.sigma {
                require_not_negative(&format!("channel {c} sigma"), sigma)?;
            }
            if channel.field.geographic() != first.field.geographic() {
                return Err(Error::invalid(
                    format!("channel {c} map"),
                    "the same kind of coordinates as the first",
                    "a mixture of geographic and projected maps",
                ));
            }
        }
        if let Some(w) = weights {
            if w.len() != n {
                return Err(Error::shape("weights", format!("({n},) as the track"), format!("({},)", w.len())));
            }
            require_finite("weights", w)?;
            if let Some(i) = w.iter().position(|&w| w < 0.0) {
                return Err(Error::invalid(format!("weights[{i}]"), "a weight >= 0", w[i]));
            }
            if w.iter().all(|&w| w == 0.0) {
                return Err(Error::invalid("weights", "at least one weight > 0", "only zeros"));
            }
        }
        track.require_on(first.field.geographic())?;
        let newest = track.newest();
        let levers = (0..n).map(|k| first.field.displacement_m(newest, track.point(k))).collect();
        let placements = channels
            .iter()
            .map(|channel| {
                (0..n)
                    .map(|k| {
                        let [x, y] = track.point(k);
                        Placement { base: channel.field.position(x, y), cell_m: cell_size_m(channel.field, y) }
                    })
                    .collect()
            })
            .collect();
        Ok(Self { channels, track, levers, placements, weights })
    }

    pub fn len(&self) -> usize {
        self.track.len()
    }

    pub fn weight(&self, k: usize) -> f64 {
        self.weights.map_or(1.0, |w| w[k])
    }

    /// Map value and gradient per metre of channel `c` at sample `k` moved by `displacement` metres.
    #[inline]
    pub fn sample(&self, c: usize, k: usize, displacement: [f64; 2], method: Interpolation) -> (f64, [f64; 2]) {
        let placement = &self.placements[c][k];
        let [px, py] = placement.position(displacement);
        let (value, [dx, dy]) = self.channels[c].field.at_position(px, py, method);
        (value, [dx / placement.cell_m[0], dy / placement.cell_m[1]])
    }

    /// Root mean square gradient of channel `c` along the moved track, value units per metre; zero where it is unknown.
    pub fn rms_gradient(&self, c: usize, displacement: [f64; 2]) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0_f64);
        for k in 0..self.len() {
            let (_, [east, north]) = self.sample(c, k, displacement, Interpolation::Bilinear);
            if east.is_finite() && north.is_finite() {
                sum += east * east + north * north;
                count += 1.0;
            }
        }
        if count > 0.0 { (sum / count).sqrt() } else { 0.0 }
    }

    /// Mean square of measured minus map value over the samples on the map, in units of each channel's own sigma where
    /// there are several; `None` where a channel has too few samples on its map.
    pub fn misfit(&self, displacement: &dyn Fn(usize) -> [f64; 2], by: &Judgement) -> Option<f64> {
        let (mut total, mut weight_total) = (0.0, 0.0);
        for (c, channel) in self.channels.iter().enumerate() {
            let unit = if self.channels.len() > 1 { channel.sigma.filter(|s| *s > 0.0).unwrap_or(1.0) } else { 1.0 };
            let (mut w0, mut w1, mut w2) = (0.0, 0.0, 0.0);
            let mut seen = 0;
            for k in 0..self.len() {
                let (value, _) = self.sample(c, k, displacement(k), Interpolation::Bilinear);
                let r = (channel.values[k] - value) / unit;
                if r.is_finite() {
                    let w = self.weight(k);
                    seen += 1;
                    w0 += w;
                    w1 += w * r;
                    w2 += w * r * r;
                }
            }
            if seen < by.min_samples {
                return None;
            }
            if w0 > 0.0 {
                total += if by.unbiased { (w2 - w1 * w1 / w0).max(0.0) } else { w2 };
                weight_total += w0;
            }
        }
        (weight_total > 0.0).then(|| total / weight_total)
    }

    /// Points of the track moved by displacements, map units.
    pub fn moved(&self, displacements: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let map = self.channels[0].field;
        displacements
            .iter()
            .enumerate()
            .map(|(k, d)| {
                let [x, y] = self.track.point(k);
                let [east, north] = map.metres_per_unit(y);
                // At a pole every longitude is the same place, and next to it a step may be more turns than can be counted.
                let moved = map.wrap_x(x + d[0] / east);
                [if moved.is_finite() { moved } else { map.wrap_x(x) }, y + d[1] / north]
            })
            .collect()
    }

    /// The offset in map units at the newest point for a displacement there.
    pub fn newest_offset(&self, displacement: [f64; 2]) -> [f64; 2] {
        let [east, north] = self.channels[0].field.metres_per_unit(self.track.newest()[1]);
        [displacement[0] / east, displacement[1] / north]
    }
}

#[cfg(test)]
mod tests {
    use super::{Channel, Scene};
    use crate::grid::{GridMap, GridValues};
    use crate::track::Track;

    #[test]
    fn a_sample_beside_a_pole_is_moved_to_a_place() {
        let axis = [88.0, 89.0, 90.0];
        let map = GridMap::new(GridValues::F64(vec![1.0; 9]), &[9.0, 10.0, 11.0], &axis, true).unwrap();
        for latitude in [89.0, 89.999_999, 90.0 - 1e-9, 90.0_f64.next_down(), 90.0] {
            let track = Track::new(vec![10.0; 2], vec![88.5, latitude], vec![1.0; 2], None).unwrap();
            let channels = [Channel { field: &map, values: track.values(), sigma: None }];
            let scene = Scene::new(&channels, &track, None).unwrap();
            for east in [-3e5, 0.0, 3e5] {
                let moved = scene.moved(&[[east, -2e3]; 2]);
                assert!(moved.iter().flatten().all(|v| v.is_finite()), "{latitude} {east}: {moved:?}");
            }
        }
    }
}
