//! Gauss-Newton on the misfit of map value against measured value, with priors: where contour matching ends.
//!
//! Minimises `sum r' R^-1 r + prior`, r = measured - map(moved point) - bias, over the offset of the newest point, the
//! heading, the scale and a constant per channel. `R` holds the sensor's noise and the map's own error, the latter
//! correlated along the track where it is said, or found, to be. The normal matrix gives the covariance; several starts give several
//! minima, and their masses (Laplace's approximation) the probability that another one is the right one.

mod descent;
mod minima;
mod options;

pub use descent::Minimum;
pub use options::RefineOptions;

use crate::error::Result;
use crate::fix::{Fix, Status};
use crate::matching::scene::{Motion, Scene};
use crate::monitor::Monitor;
use crate::statistics::{chi_square_survival, normal_in_disc};
use descent::Refiner;

/// Share of the prior's variance above which the field has told too little to call the answer a fix.
const UNINFORMATIVE: f64 = 0.5;

/// Refines from every start and makes the common answer of what is found.
///
/// `searched_m` is the half width of the square of offsets that was searched, where there is one.
pub(crate) fn answer(
    scene: &Scene<'_>,
    options: &RefineOptions,
    starts: &[Motion],
    before: usize,
    searched_m: Option<f64>,
    monitor: &dyn Monitor,
) -> Result<Fix> {
    let n = scene.len();
    let refiner = Refiner::new(scene, options, monitor);
    let mut noise: Vec<f64> = scene.channels.iter().map(|c| c.sigma.map_or(f64::NAN, |s| s * s)).collect();
    let known = noise.iter().all(|v| !v.is_nan());
    if !known {
        refiner.estimate_noise(&mut noise, starts)?;
    }
    // A sigma of zero would make the normal matrix infinite: rounding of the map's own values is the floor.
    for (variance, channel) in noise.iter_mut().zip(scene.channels) {
        let size = channel.values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
        *variance = variance.max((size * f64::from(f32::EPSILON)).powi(2)).max(f64::MIN_POSITIVE.sqrt());
    }
    let minima = refiner.minima(&noise, starts)?;
    let Some(best) = minima.first() else {
        // Equations without a solution leave a direction open; no equations at all leave everything.
        let placed = starts.iter().any(|s| refiner.whitening(s, &noise, 0.0).is_some());
        return Ok(Fix::none(if placed { Status::Uninformative } else { Status::Lost }, n));
    };
    let masses: Vec<f64> = minima.iter().map(|m| (m.log_mass - best.log_mass).exp()).collect();
    let total: f64 = masses.iter().sum();
    let elsewhere = 1.0 - 1.0 / total;
    let risk = options.tolerance_m.map_or(elsewhere, |tolerance| {
        let outside: f64 = minima.iter().zip(&masses).map(|(m, mass)| mass * mass_outside(tolerance, best, m)).sum();
        outside / total
    });
    // A position that nothing holds has no mass anywhere.
    let risk = if risk <= 1.0 { risk.max(0.0) } else { 1.0 };
    let freedom = (best.n_residuals as f64 - refiner.flat_parameters() as f64).max(1.0);
    let goodness = known.then(|| chi_square_survival(best.cost, freedom));
    let covariance = best.position_covariance();
    let spread = covariance[0][0] + covariance[1][1];
    // What was known before: the prior, or that it lies in what was searched, or on the map (uniform: width^2 / 12).
    let map = scene.channels[0].field;
    let [east, north] = crate::matching::closest::cell_size_m(map, scene.track.newest()[1]);
    let on_map = ((east * (map.x().len() - 1) as f64).powi(2) + (north * (map.y().len() - 1) as f64).powi(2)) / 12.0;
    let prior = options.priors.offset_sigma_m.map_or(f64::INFINITY, |s| 2.0 * s * s);
    let known_before = prior.min(searched_m.map_or(f64::INFINITY, |half| 2.0 * half * half / 3.0)).min(on_map);
    let beyond = |m: f64| best.motion.offset_m.iter().any(|o| o.abs() > m);
    let status = if !best.converged {
        Status::NotConverged
    } else if goodness.is_some_and(|p| p < options.min_goodness) {
        Status::Rejected
    } else if searched_m.is_some_and(beyond) {
        Status::AtEdge
    } else if elsewhere > options.max_risk {
        Status::Ambiguous
    } else if risk > options.max_risk || spread > UNINFORMATIVE * known_before {
        Status::Uninformative
    } else {
        Status::Fixed
    };
    let displacements: Vec<[f64; 2]> = scene.levers.iter().map(|&l| best.motion.displacement(l)).collect();
    Ok(Fix {
        heading_deg: best.motion.heading_rad.to_degrees(),
        scale: 1.0 + best.motion.stretch,
        bias: options.priors.bias_sigma.map(|_| best.biases[0]),
        covariance_m2: Some(covariance),
        risk: Some(risk),
        goodness,
        score: best.cost,
        runner_up: minima.get(1).map_or(f64::NAN, |m| m.cost),
        n_samples: best.n_residuals / scene.channels.len(),
        iterations: before + best.iterations,
        track: scene.moved(&displacements),
        ..Fix::at_point(
            scene.channels[0].field,
            scene.track.newest(),
            scene.newest_offset(best.motion.offset_m),
            status,
        )
    })
}

/// Probability that the position of a minimum lies further than `tolerance` metres from that of the best one.
fn mass_outside(tolerance: f64, best: &Minimum, minimum: &Minimum) -> f64 {
    let (from, to) = (best.motion.offset_m, minimum.motion.offset_m);
    1.0 - normal_in_disc([to[0] - from[0], to[1] - from[1]], minimum.position_covariance(), tolerance)
}
