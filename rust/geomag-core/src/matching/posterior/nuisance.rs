//! What moves the samples of a track against each other: heading, scale and drift.

use super::options::PosteriorOptions;

/// Standard deviations of the prior that the components cover.
const REACH: f64 = 4.0;
/// Distance between components in standard deviations about a component and of the components; the sum is then right to 1.4 %: the
/// ripple is 2 exp(-2 pi^2 / spacing^2).
const SPACING: f64 = 2.0;
/// Share of the prior's standard deviation from which it is not worth dividing.
const WHOLE: f64 = 0.8;
/// Most components; where more would be needed, each is wider.
const MOST_COMPONENTS: f64 = 150.0;

/// What is common to all samples of a track and is not the offset: heading, scale and drift.
///
/// The kernel takes them as linear in the map's gradient, which holds for small displacements only. A parameter that may move the
/// far end of the track by more is laid out as a sum of narrow normal densities, one a component (Alspach and Sorenson, IEEE Trans.
/// Autom. Control 17 (1972) 439): the track is turned, stretched and shifted to the component exactly, and what is left of the prior
/// around it is linear.
#[derive(Debug, Clone)]
pub(super) struct Nuisance {
    /// What each parameter does to every sample per standard deviation about its component.
    pub shapes: Vec<Shape>,
    /// Standard deviations about a component over those of the prior.
    pub narrowed: Vec<f64>,
    pub components: Vec<Component>,
    parameters: Vec<Parameter>,
}

/// What a nuisance parameter does to the samples, one entry a sample.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Shape {
    /// Displaces them, metres `[east, north]`.
    Moved(Vec<[f32; 2]>),
    /// Adds to the readings, value units.
    Added(Vec<f32>),
    /// Lifts all of them: what the map changes by with height.
    Lifted,
}

impl Shape {
    /// Greatest displacement of any sample, metres.
    fn lever_m(&self) -> f64 {
        match self {
            Self::Moved(by) => by.iter().map(|[e, n]| f64::from(e.hypot(*n))).fold(0.0, f64::max),
            Self::Added(_) | Self::Lifted => 0.0,
        }
    }

    fn times(&mut self, factor: f32) {
        match self {
            Self::Moved(by) => by.iter_mut().flatten().for_each(|v| *v *= factor),
            Self::Added(by) => by.iter_mut().for_each(|v| *v *= factor),
            Self::Lifted => {}
        }
    }
}

/// Change of course from one sample to the next beyond which a new straight leg begins, degrees.
const TURN_DEG: f64 = 20.0;
/// Most legs with a bias of their own; what follows them shares that of the last.
pub(super) const LEGS: usize = 6;

/// The prior of a height as a sum of narrow normal densities: their means and what they weigh, in standard deviations of the prior, the
/// likeliest first; and their own standard deviation.
pub(super) const HEIGHTS: [f64; 5] = [0.0, 0.8, -0.8, 1.6, -1.6];
pub(super) const HEIGHT_NARROWED: f64 = 0.5;

/// Which straight leg every sample belongs to, of positions `[east, north]` in metres; the numbers begin at 0.
///
/// A leg goes on while the course stays within [`TURN_DEG`] of that at its beginning; a turn flown in small steps ends it as well.
pub(super) fn legs(positions_m: &[[f64; 2]]) -> Vec<usize> {
    let mut leg = 0;
    let mut out = vec![0; positions_m.len()];
    let mut course: Option<[f64; 2]> = None;
    for k in 1..positions_m.len() {
        let [e, n] = [0, 1].map(|d| positions_m[k][d] - positions_m[k - 1][d]);
        let length = e.hypot(n);
        if length > 0.0 {
            let way = [e / length, n / length];
            match course {
                Some([ce, cn]) if ce * way[0] + cn * way[1] < TURN_DEG.to_radians().cos() => {
                    // The sample at the corner was still on the leg before.
                    leg = (leg + 1).min(LEGS - 1);
                    course = Some(way);
                }
                Some(_) => {}
                None => course = Some(way),
            }
        }
        out[k] = leg;
    }
    out
}

/// A bias of its own for every leg after the first, as what it adds to each sample per standard deviation.
pub(super) fn leg_shapes(legs: &[usize], sigma: f64) -> Vec<Shape> {
    let most = legs.iter().copied().max().unwrap_or(0);
    (1..=most)
        .map(|leg| Shape::Added(legs.iter().map(|l| if *l == leg { sigma as f32 } else { 0.0 }).collect()))
        .collect()
}

/// A slow change of the bias with a standard deviation over the track, as a line and the first waves of a random walk (its
/// Karhunen-Loeve series; Van Trees, Detection, Estimation and Modulation Theory I, 1968, section 3.4); `age` from 1 to 0.
pub(super) fn drift_shapes(age: &[f64], sigma: f64) -> Vec<Shape> {
    (0..WALK_WAVES)
        .map(|i| {
            let k = (i as f64 + 0.5) * std::f64::consts::PI;
            Shape::Added(age.iter().map(|a| (sigma * std::f64::consts::SQRT_2 * (k * a).sin() / k) as f32).collect())
        })
        .collect()
}

/// Waves of a walk of the bias: they hold nine tenths of its variance.
const WALK_WAVES: usize = 2;

/// A place in the space of the parameters.
#[derive(Debug, Clone)]
pub(super) struct Component {
    /// The parameters there, in prior standard deviations.
    pub at: Vec<f64>,
    /// By how much each sample is moved, metres `[east, north]`; empty where by nothing.
    pub moved_m: Vec<[f64; 2]>,
    /// Number of its height in [`HEIGHTS`].
    pub height: usize,
    /// Logarithm of its share of the prior.
    pub log_weight: f64,
}

/// One parameter with a prior above zero.
#[derive(Debug, Clone, Copy)]
struct Parameter {
    kind: Kind,
    /// Its prior standard deviation: radians, 1, metres.
    sigma: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Clockwise.
    Heading,
    Scale,
    DriftEast,
    DriftNorth,
    /// Of the readings: nothing moves.
    Reading,
}

impl Nuisance {
    /// The parameters with a prior above zero, on one component. `away_m` is the displacement of every sample from the newest,
    /// metres; `age` runs from 1 (first) to 0 (newest).
    pub fn new(options: &PosteriorOptions, away_m: &[[f64; 2]], age: &[f64]) -> Self {
        let mut parameters: Vec<Parameter> = [
            (Kind::Heading, options.heading_sigma_deg.to_radians()),
            (Kind::Scale, options.scale_sigma),
            (Kind::DriftEast, options.drift_sigma_m),
            (Kind::DriftNorth, options.drift_sigma_m),
        ]
        .into_iter()
        .filter(|(_, sigma)| *sigma > 0.0)
        .map(|(kind, sigma)| Parameter { kind, sigma })
        .collect();
        let mut shapes: Vec<Shape> = parameters
            .iter()
            .map(|p| {
                let shape = |(&[east, north], age): (&[f64; 2], &f64)| {
                    let shape = match p.kind {
                        Kind::Heading => [north, -east],
                        Kind::Scale => [east, north],
                        Kind::DriftEast => [-age, 0.0],
                        Kind::DriftNorth => [0.0, -age],
                        Kind::Reading => [0.0; 2],
                    };
                    shape.map(|v| (p.sigma * v) as f32)
                };
                Shape::Moved(away_m.iter().zip(age).map(shape).collect())
            })
            .collect();
        if options.leg_bias_sigma > 0.0 {
            shapes.extend(leg_shapes(&legs(away_m), options.leg_bias_sigma));
        }
        if options.bias_drift_sigma > 0.0 {
            shapes.extend(drift_shapes(age, options.bias_drift_sigma));
        }
        parameters.resize(shapes.len(), Parameter { kind: Kind::Reading, sigma: 1.0 });
        let component = Component { at: vec![0.0; parameters.len()], moved_m: Vec::new(), height: 0, log_weight: 0.0 };
        Self { narrowed: vec![1.0; shapes.len()], shapes, components: vec![component], parameters }
    }

    /// Greatest displacement of any sample per prior standard deviation of each parameter, metres.
    fn levers_m(&self) -> Vec<f64> {
        self.shapes.iter().map(Shape::lever_m).collect()
    }

    /// Divides the prior so that about each component no parameter moves a sample by more than `linear_m` in a standard deviation.
    #[must_use]
    pub fn divided(mut self, linear_m: f64, away_m: &[[f64; 2]], age: &[f64]) -> Self {
        let levers = self.levers_m();
        let mut linear_m = linear_m;
        let count = |linear_m: f64| levers.iter().map(|lever| NormalSum::count(linear_m / lever)).product::<f64>();
        while count(linear_m) > MOST_COMPONENTS {
            linear_m *= 1.2;
        }
        let sums: Vec<NormalSum> = levers.iter().map(|lever| NormalSum::new(linear_m / lever)).collect();
        self.narrowed = sums.iter().map(|sum| sum.narrowed).collect();
        for (shape, narrowed) in self.shapes.iter_mut().zip(&self.narrowed) {
            shape.times(*narrowed as f32);
        }
        let mut components = self.components;
        for (i, sum) in sums.iter().enumerate() {
            components = components
                .iter()
                .flat_map(|component| {
                    sum.components.iter().map(move |&(at, log_weight)| {
                        let mut component = component.clone();
                        component.at[i] = at;
                        component.log_weight += log_weight;
                        component
                    })
                })
                .collect();
        }
        for component in &mut components {
            if component.at.iter().any(|at| *at != 0.0) {
                component.moved_m = moved(&self.parameters, &component.at, away_m, age);
            }
        }
        // The likeliest first.
        components.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
        self.components = components;
        self
    }

    /// Every component at every height, about which the map is linear in the height.
    #[must_use]
    pub fn at_heights(mut self) -> Self {
        let log = |z: f64| -0.5 * z * z / (1.0 - HEIGHT_NARROWED * HEIGHT_NARROWED);
        let total = HEIGHTS.iter().map(|z| log(*z).exp()).sum::<f64>().ln();
        let at_height = |component: &Component, (height, z): (usize, &f64)| Component {
            height,
            log_weight: component.log_weight + log(*z) - total,
            ..component.clone()
        };
        self.components = (self.components.iter())
            .flat_map(|component| HEIGHTS.iter().enumerate().map(move |height| at_height(component, height)))
            .collect();
        self.components.sort_by(|a, b| b.log_weight.total_cmp(&a.log_weight));
        self.shapes.push(Shape::Lifted);
        self.narrowed.push(HEIGHT_NARROWED);
        self.parameters.push(Parameter { kind: Kind::Reading, sigma: 1.0 });
        for component in &mut self.components {
            component.at.push(0.0);
        }
        self
    }

    /// Heading in degrees and scale of parameters in standard deviations about a component.
    pub fn heading_and_scale(&self, component: &Component, about: &[f64]) -> (f64, f64) {
        let (mut heading, mut scale) = (0.0, 1.0);
        for (i, p) in self.parameters.iter().enumerate() {
            let value = p.sigma * (component.at[i] + self.narrowed[i] * about[i]);
            match p.kind {
                Kind::Heading => heading += value.to_degrees(),
                Kind::Scale => scale += value,
                Kind::DriftEast | Kind::DriftNorth | Kind::Reading => {}
            }
        }
        (heading, scale)
    }
}

/// Bound of the displacement of any sample at any component, metres, on a track that reaches `lever_m` from its newest sample.
pub(super) fn reach_m(options: &PosteriorOptions, lever_m: f64) -> f64 {
    let turned = lever_m * options.heading_sigma_deg.to_radians().hypot(options.scale_sigma);
    REACH * turned.hypot(std::f64::consts::SQRT_2 * options.drift_sigma_m)
}

/// By how much each sample is moved with the parameters at these values (prior standard deviations).
fn moved(parameters: &[Parameter], at: &[f64], away_m: &[[f64; 2]], age: &[f64]) -> Vec<[f64; 2]> {
    let (mut heading, mut scale, mut drift) = (0.0_f64, 1.0, [0.0; 2]);
    for (p, at) in parameters.iter().zip(at) {
        let value = p.sigma * at;
        match p.kind {
            Kind::Heading => heading += value,
            Kind::Scale => scale += value,
            Kind::DriftEast => drift[0] += value,
            Kind::DriftNorth => drift[1] += value,
            Kind::Reading => {}
        }
    }
    let (sine, cosine) = heading.sin_cos();
    (away_m.iter().zip(age))
        .map(|(&[east, north], age)| {
            let turned = [cosine * east + sine * north, cosine * north - sine * east];
            [scale * turned[0] - east - age * drift[0], scale * turned[1] - north - age * drift[1]]
        })
        .collect()
}

/// The standard normal sum as a sum of narrower ones.
struct NormalSum {
    /// Their standard deviation.
    narrowed: f64,
    /// Their means, and the logarithms of their weights.
    components: Vec<(f64, f64)>,
}

impl NormalSum {
    /// Distance between the components, and how many there are on either side of the middle.
    fn layout(narrowed: f64) -> (f64, f64) {
        if narrowed >= WHOLE {
            return (0.0, 0.0);
        }
        // Variances add: that of the means and that about them make the whole.
        let between = (1.0 - narrowed * narrowed).sqrt();
        let spacing = SPACING * narrowed * between;
        (spacing, (REACH * between / spacing).ceil())
    }

    /// Number of components.
    fn count(narrowed: f64) -> f64 {
        2.0 * Self::layout(narrowed).1 + 1.0
    }

    /// Of sums of about this standard deviation, the whole where that is not much less than 1.
    fn new(narrowed: f64) -> Self {
        let (spacing, most) = Self::layout(narrowed);
        if most == 0.0 {
            return Self { narrowed: 1.0, components: vec![(0.0, 0.0)] };
        }
        let between = 1.0 - narrowed * narrowed;
        let log = |at: f64| -0.5 * at * at / between;
        let places: Vec<f64> = (0..=2 * most as i64).map(|i| (i as f64 - most) * spacing).collect();
        let total = places.iter().map(|at| log(*at).exp()).sum::<f64>().ln();
        Self { narrowed, components: places.into_iter().map(|at| (at, log(at) - total)).collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn narrow_components_add_up_to_the_prior() {
        for narrowed in [0.7, 0.4, 0.15, 0.05] {
            let sum = NormalSum::new(narrowed);
            let normal = |x: f64, s: f64| (-0.5 * (x / s).powi(2)).exp() / (s * std::f64::consts::TAU.sqrt());
            for x in [0.0, 0.1, 0.37, 1.0, 1.9, 2.7] {
                let density: f64 = sum.components.iter().map(|(at, w)| w.exp() * normal(x - at, sum.narrowed)).sum();
                let expected = normal(x, 1.0);
                assert!((density - expected).abs() < 0.05 * expected, "{narrowed} at {x}: {density} {expected}");
            }
        }
        assert_eq!(NormalSum::new(0.9).components.len(), 1);
    }

    #[test]
    fn a_turn_begins_a_leg_and_a_wobble_does_not() {
        let mut at = [0.0, 0.0];
        let mut positions = vec![at];
        for k in 0..12 {
            let course: f64 = if k < 6 { if k % 2 == 0 { 3.0 } else { -3.0 } } else { 90.0 };
            at = [at[0] + 100.0 * course.to_radians().sin(), at[1] + 100.0 * course.to_radians().cos()];
            positions.push(at);
        }
        let found = legs(&positions);
        assert_eq!(found, [vec![0; 7], vec![1; 6]].concat());
        assert_eq!(leg_shapes(&found, 5.0).len(), 1);
    }

    #[test]
    fn a_prior_without_measure_has_few_nodes() {
        let mut options = PosteriorOptions::new([1000.0; 2]);
        options.drift_sigma_m = 1e12;
        options.scale_sigma = 1e9;
        let (away, age) = ([[-5e3, 2e3], [0.0, 0.0]], [1.0, 0.0]);
        let divided = Nuisance::new(&options, &away, &age).divided(10.0, &away, &age);
        assert!(divided.components.len() as f64 <= MOST_COMPONENTS);
        assert!(divided.levers_m().iter().all(|v| v.is_finite()));
    }

    #[test]
    fn a_node_turns_stretches_and_shifts_as_the_shapes_say() {
        let mut options = PosteriorOptions::new([1000.0; 2]);
        options.heading_sigma_deg = 1.0;
        options.scale_sigma = 0.01;
        options.drift_sigma_m = 5.0;
        let away: Vec<[f64; 2]> = (0..10).map(|k| [-100.0 * f64::from(9 - k), -300.0 * f64::from(9 - k)]).collect();
        let age: Vec<f64> = (0..10).map(|k| f64::from(9 - k) / 9.0).collect();
        let whole = Nuisance::new(&options, &away, &age);
        let shape = |i: usize, k: usize, d: usize| match &whole.shapes[i] {
            Shape::Moved(by) => f64::from(by[k][d]),
            Shape::Added(_) | Shape::Lifted => 0.0,
        };
        let divided = whole.clone().divided(20.0, &away, &age);
        assert!(divided.components.len() > 20 && divided.components.len() as f64 <= MOST_COMPONENTS);
        for component in &divided.components {
            // What the linear shapes leave out: the square of the angle, and the angle times the stretch.
            let (angle, stretch) = (component.at[0] * 1.0_f64.to_radians(), component.at[1] * 0.01);
            for k in 0..10 {
                let linear: Vec<f64> = (0..2).map(|d| (0..4).map(|i| component.at[i] * shape(i, k, d)).sum()).collect();
                let moved = component.moved_m.get(k).copied().unwrap_or([0.0; 2]);
                for d in 0..2 {
                    let rest = away[k][0].hypot(away[k][1]) * (0.5 * angle * angle + (angle * stretch).abs());
                    assert!((moved[d] - linear[d]).abs() <= 1.1 * rest + 1e-3, "{component:?} {k} {linear:?}");
                }
            }
        }
        let total: f64 = divided.components.iter().map(|n| n.log_weight.exp()).sum();
        assert!((total - 1.0).abs() < 1e-9);
        let component = divided.components.iter().find(|n| n.at[0] != 0.0 && n.at[1] == 0.0).unwrap();
        let (heading, scale) = divided.heading_and_scale(component, &[0.0; 4]);
        assert!((heading - component.at[0]).abs() < 1e-12 && scale == 1.0);
    }
}
