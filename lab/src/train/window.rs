//! Windows of series as input of the network, with a bench's noise, gain, drift and clock.

use super::sensor_errors::{SensorErrors, uniform};
use super::settings::TrainSettings;
use crate::sweep_series::SweepSeries;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_mesh::Mesh;
use wcal_network::inverse::StaticInverse;
use wcal_network::network::features::SWEEP_STEP_S;
use wcal_network::network::{FeatureExtractor, NetworkConfig, features};

/// A window of a series, ready for the network.
pub(super) struct Window<'a> {
    pub series: &'a SweepSeries,
    /// The object's.
    pub mesh: Option<&'a Mesh>,
    /// Way of the base at each token, mm.
    pub travel_mm: Vec<f64>,
    pub inputs: Vec<f32>,
    pub times_s: Vec<f64>,
    /// Candidates' places, a token and node, mm.
    pub points: Vec<f32>,
    /// The filter's belief, a token and node.
    pub posterior: Vec<f32>,
    /// The same of the frictionless filter; empty where there is none.
    pub posterior_frictionless: Vec<f32>,
    /// Weights of the nodes that mean the true place.
    pub weights: Vec<f32>,
    /// True place, mm; what no token has is 0 and not counted.
    pub place: Vec<f32>,
    pub touching: Vec<f32>,
    /// Whether there are several contacts.
    pub several: Vec<f32>,
    pub counted: Vec<f32>,
    /// Whether it is the mirror image of the series's.
    pub mirrored: bool,
}

impl Window<'_> {
    /// Mirrors it at the plane y = 0: the moments of the mirrored object, where the free wire lies
    /// in that plane.
    pub(crate) fn mirror(&mut self) {
        let tokens = self.times_s.len();
        let (width, nodes) = (self.inputs.len() / tokens, self.points.len() / (3 * tokens));
        self.inputs
            .chunks_exact_mut(width)
            .for_each(|token| features::mirror(token, nodes));
        for place in [&mut self.points, &mut self.place] {
            place.iter_mut().skip(1).step_by(3).for_each(|y| *y = -*y);
        }
        self.mirrored = !self.mirrored;
    }
}

/// What windows are made with.
#[derive(Debug, Clone, Copy)]
pub(super) struct WindowMaker<'a> {
    pub config: &'a NetworkConfig,
    pub inverse: &'a StaticInverse,
    pub meshes: &'a BTreeMap<String, Mesh>,
}

/// Share of series in which the wire stays free: noise, drift and the bench's own motion alone.
const FREE_FRACTION: f64 = 0.05;

impl<'a> WindowMaker<'a> {
    /// Windows of series with a bench's errors, drawn from `seed`.
    pub(crate) fn make(
        &self,
        all_series: &'a [SweepSeries],
        settings: &TrainSettings,
        seed: u64,
    ) -> Vec<Window<'a>> {
        all_series
            .par_iter()
            .enumerate()
            .map(|(k, series)| {
                let mut rng =
                    ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1_000_003).wrapping_add(k as u64));
                make_window(series, self, settings, &mut rng)
            })
            .collect()
    }
}

fn make_window<'a>(
    series: &'a SweepSeries,
    with: &WindowMaker<'a>,
    settings: &TrainSettings,
    rng: &mut ChaCha8Rng,
) -> Window<'a> {
    let WindowMaker {
        config,
        inverse,
        meshes,
    } = *with;
    let errors = SensorErrors::draw(settings, rng);
    let [fastest, slowest] = settings.time_factor.map(f64::ln);
    let factor = uniform(rng, fastest, slowest).exp();
    let free = uniform(rng, 0.0, 1.0) < FREE_FRACTION;
    let known = uniform(rng, 0.0, 1.0) < settings.speed_known;
    let stride = 1 + usize::from(uniform(rng, 0.0, 1.0) < 0.3);
    let latest = series
        .samples
        .len()
        .saturating_sub(settings.window * stride / 2);
    let first = (uniform(rng, -0.3, 1.0).max(0.0) * latest as f64) as usize;
    let mut features =
        FeatureExtractor::new(inverse, errors.with_measurement_noise(settings.filters()));
    let nodes = inverse.nodes.len();
    let t = settings.window;
    let mut window = Window {
        series,
        mesh: meshes.get(&series.object),
        travel_mm: Vec::with_capacity(t),
        inputs: Vec::with_capacity(t * FeatureExtractor::width(nodes, config.two_filters)),
        times_s: Vec::with_capacity(t),
        points: Vec::with_capacity(t * nodes * 3),
        posterior: Vec::with_capacity(t * nodes),
        posterior_frictionless: Vec::with_capacity(if config.two_filters { t * nodes } else { 0 }),
        weights: Vec::with_capacity(t * nodes),
        place: Vec::with_capacity(t * 3),
        touching: Vec::with_capacity(t),
        several: Vec::with_capacity(t),
        counted: Vec::with_capacity(t),
        mirrored: false,
    };
    let mut before_s = None;
    let last = series.samples.len() - 1;
    for k in 0..t {
        let at = first + k * stride;
        let now = &series.samples[at.min(last)];
        // Beyond its end a series is padded with tokens that do not count.
        let over_s = at.saturating_sub(last) as f64 * 0.1;
        let t_s = (now.t_s + over_s) * factor;
        let pressed = if free { [0.0; 2] } else { now.moment_nmm };
        let moment = errors.measured(pressed, t_s, rng);
        let speed = known.then_some(now.speed_mm_s / factor);
        let token = features.push(t_s - before_s.unwrap_or(t_s - SWEEP_STEP_S), moment, speed);
        before_s = Some(t_s);
        let truth = now
            .contact
            .filter(|_| !free)
            .map(|c| [c.point_mm.x, c.point_mm.y, c.point_mm.z].map(|x| x as f32));
        window.weights.extend(match truth {
            Some(p) if nodes > 0 => truth_weights(&token.points_mm, p),
            _ => vec![0.0; nodes],
        });
        window.inputs.extend(token.inputs);
        window.points.extend(token.points_mm.iter().flatten());
        window.posterior.extend(token.posterior);
        window
            .posterior_frictionless
            .extend(token.posterior_frictionless);
        window.times_s.push(t_s);
        window.travel_mm.push(now.travel_mm);
        window.place.extend(truth.unwrap_or_default());
        window
            .several
            .push(f32::from(u8::from(now.contacts > 1 && !free)));
        window.touching.push(f32::from(u8::from(truth.is_some())));
        window.counted.push(f32::from(u8::from(at <= last)));
    }
    window
}

/// Weights of the two nodes between which the curve comes nearest to a place.
fn truth_weights(points: &[[f32; 3]], place: [f32; 3]) -> Vec<f32> {
    let sub = |a: [f32; 3], b: [f32; 3]| [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let mut best = (f32::INFINITY, 0, 0.0);
    for k in 0..points.len() - 1 {
        let (along, to) = (sub(points[k + 1], points[k]), sub(place, points[k]));
        let u = (dot(along, to) / dot(along, along).max(1e-12)).clamp(0.0, 1.0);
        let off = sub(to, along.map(|x| x * u));
        let distance = dot(off, off);
        if distance < best.0 {
            best = (distance, k, u);
        }
    }
    let mut weights = vec![0.0; points.len()];
    weights[best.1] = 1.0 - best.2;
    weights[best.1 + 1] = best.2;
    weights
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::generate_sweeps::{SweepRequest, generate_sweeps};
    use crate::model_file::preset;
    use nalgebra::Vector3;
    use wcal_core::observation::{RestShape, WhiskerSpec};
    use wcal_lab_sweeps::{SweepPlan, objects};
    use wcal_network::inverse::InverseGrid;

    /// A coarse table, and a sweep over a built-in object.
    pub(crate) fn swept(object: &str) -> (StaticInverse, Vec<SweepSeries>) {
        let whisker = WhiskerSpec::nominal();
        let grid = InverseGrid {
            step_mm: 2.0,
            refine: 1,
            tilts: 3,
            ..InverseGrid::default()
        };
        let plan = SweepPlan {
            rate_hz: 10.0,
            ..SweepPlan::default()
        };
        let order = SweepRequest {
            whisker: &whisker,
            plan: &plan,
            seed: 3,
            sweeps: 1,
        };
        let all_series = generate_sweeps(&objects::built_in(object).unwrap(), &order).unwrap();
        (StaticInverse::new(&whisker, grid).unwrap(), all_series)
    }

    /// Negative control of the mirror: a wire that leaves the plane is none.
    #[test]
    fn a_wire_that_leaves_the_plane_is_not_flat() {
        let points = [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [45.0, 3.0, 4.0]]
            .map(Vector3::from)
            .to_vec();
        let whisker = WhiskerSpec {
            rest_shape: RestShape::Polyline(points),
            ..WhiskerSpec::nominal()
        };
        let grid = InverseGrid {
            step_mm: 20.0,
            refine: 1,
            tilts: 1,
            directions: 4,
            steps: 2,
            ..InverseGrid::default()
        };
        assert!(!StaticInverse::new(&whisker, grid).unwrap().flat);
    }

    /// The moments of a mirrored object give a mirrored window, also in the features of filters and
    /// rod.
    #[test]
    fn the_window_of_a_mirrored_course_is_the_mirrored_window() {
        let (inverse, all_series) = swept("vase");
        assert!(inverse.flat);
        let mut turned = all_series.clone();
        for i in turned.iter_mut().flat_map(|c| &mut c.samples) {
            i.moment_nmm[1] = -i.moment_nmm[1];
            i.contact
                .iter_mut()
                .for_each(|c| c.point_mm.y = -c.point_mm.y);
        }
        let config = preset("compact", &inverse, true).unwrap();
        let meshes = BTreeMap::new();
        let windows = WindowMaker {
            config: &config,
            inverse: &inverse,
            meshes: &meshes,
        };
        let settings = TrainSettings::default().without_disturbances();
        let (mut here, there) = (
            windows.make(&all_series, &settings, 5),
            windows.make(&turned, &settings, 5),
        );
        let off = |a: &Window<'_>, b: &Window<'_>| {
            let pairs = [
                (&a.inputs, &b.inputs),
                (&a.points, &b.points),
                (&a.posterior, &b.posterior),
            ];
            let pairs = pairs.into_iter().chain([
                (&a.posterior_frictionless, &b.posterior_frictionless),
                (&a.place, &b.place),
            ]);
            let mean = |(a, b): (&Vec<f32>, &Vec<f32>)| {
                a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / a.len() as f32
            };
            pairs.map(mean).collect()
        };
        let (window, image) = (&mut here[0], &there[0]);
        let before: Vec<f32> = off(window, image);
        window.mirror();
        let after: Vec<f32> = off(window, image);
        // The table's leans at the tip are not quite their own mirror images (points by up to 0.3
        // mm); the filters take it from there.
        let same = |k: usize, share: f32| after[k] < share * before[k];
        assert!(
            same(0, 0.1) && same(1, 0.02) && after[4] == 0.0,
            "{before:?} {after:?}"
        );
        assert!(after[2] < 5e-4 && after[3] < 5e-4, "{after:?}");
        // Negative control: it was another window, in inputs and places.
        assert!(
            before[0] > 0.005 && before[1] > 0.1 && before[4] > 0.1,
            "{before:?}"
        );
    }
}
