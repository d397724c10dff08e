//! A small system with known answers for the engine's tests (SIMULATED): a line over x with candidates of every kind.

use nalgebra::DMatrix;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_distr::{Distribution, StandardNormal};
use std::sync::Arc;
use wcal_trace::effect::{Effect, EffectModel, EffectTerm, Parameter, Role};
use wcal_trace::measurement_model::MeasurementModel;

/// Indices of the candidates.
pub const SHELF: usize = 0;
pub const BEND: usize = 1;
pub const SCALE: usize = 2;
pub const OUTLIERS: usize = 3;

/// Largest part of the bend in what the readings span.
pub const BEND_SHARE: f64 = 0.3;

pub const READINGS: usize = 60;
/// True line: zero and slope.
pub const LINE: [f64; 2] = [3.0, 20.0];
/// Noise of one reading.
pub const NOISE: f64 = 0.1;

struct Toy(usize);

impl Effect for Toy {
    fn id(&self) -> &'static str {
        ["shelf", "bend", "scale", "outliers"][self.0]
    }
    fn laws(&self) -> Vec<EffectModel> {
        let amplitude =
            |name, range| Parameter { name, unit: "1", range, role: Role::Amplitude { probe: 0.02 } };
        let parameters = match self.0 {
            SHELF => vec![
                amplitude("height", [0.0, 0.5]),
                Parameter {
                    name: "place",
                    unit: "1",
                    range: [0.02, 0.98],
                    role: Role::Shape { grid: &[0.2, 0.4, 0.6, 0.8] },
                },
            ],
            SCALE => vec![amplitude("share", [-0.5, 0.5])],
            _ => Vec::new(),
        };
        let linear = if self.0 == BEND { vec![("square", "1")] } else { Vec::new() };
        let largest_share = (self.0 == BEND).then_some(BEND_SHARE);
        vec![EffectModel { name: "only", parameters, linear, largest_share, needs: Vec::new() }]
    }
    fn refinements(&self) -> Vec<EffectModel> {
        if self.0 != SHELF {
            return Vec::new();
        }
        let place = |name| Parameter {
            name,
            unit: "1",
            range: [0.02, 0.98],
            role: Role::Shape { grid: &[0.2, 0.4, 0.6, 0.8] },
        };
        let height =
            |name| Parameter { name, unit: "1", range: [0.0, 0.5], role: Role::Amplitude { probe: 0.02 } };
        let parameters =
            vec![height("height"), place("place"), height("second_height"), place("second_place")];
        vec![EffectModel {
            name: "two",
            parameters,
            linear: Vec::new(),
            largest_share: None,
            needs: Vec::new(),
        }]
    }
    fn in_single_readings(&self) -> bool {
        self.0 == OUTLIERS
    }
    fn sentence(&self) -> &'static str {
        "Something acts."
    }
    fn source(&self) -> &'static str {
        "made for a test"
    }
}

/// How far the shelf at `place` lifts the reading at x; rises over about a tenth of the range.
pub fn shelf(x: f64, place: f64) -> f64 {
    0.5 * (1.0 + ((x - place) / 0.05).tanh())
}

pub struct ToySystem {
    x: Vec<f64>,
    measured: DMatrix<f64>,
    catalogue: Vec<Arc<dyn Effect>>,
    groups: Vec<u32>,
    known: DMatrix<f64>,
}

impl ToySystem {
    /// Readings at evenly spread, shuffled x: `extra` is added to line and noise.
    pub fn draw(seed: u64, extra: impl Fn(usize, f64) -> f64) -> Self {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut x: Vec<f64> = (0..READINGS).map(|i| i as f64 / (READINGS - 1) as f64).collect();
        x.shuffle(&mut rng);
        let measured = DMatrix::from_fn(READINGS, 1, |i, _| {
            let z: f64 = StandardNormal.sample(&mut rng);
            LINE[0] + LINE[1] * x[i] + extra(i, x[i]) + NOISE * z
        });
        Self {
            x,
            measured,
            catalogue: (0..4).map(|k| Arc::new(Toy(k)) as Arc<dyn Effect>).collect(),
            groups: (0..READINGS).map(|i| (i / 10) as u32).collect(),
            known: DMatrix::zeros(READINGS, 1),
        }
    }
}

impl MeasurementModel for ToySystem {
    fn measured(&self) -> &DMatrix<f64> {
        &self.measured
    }
    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>> {
        let mut x = self.x.clone();
        for t in terms {
            for (x, raw) in x.iter_mut().zip(&self.x) {
                match t.effect {
                    SHELF => {
                        for pair in t.values.chunks(2) {
                            *x += pair[0] * shelf(*raw, pair[1]);
                        }
                    }
                    SCALE => *x += t.values[0] * raw,
                    _ => {}
                }
            }
        }
        let mut columns = vec![vec![1.0; READINGS], x];
        if terms.iter().any(|t| t.effect == BEND) {
            columns.push(self.x.iter().map(|x| x * x).collect());
        }
        Some(DMatrix::from_fn(READINGS, columns.len(), |i, j| columns[j][i]))
    }
    fn catalogue(&self) -> &[Arc<dyn Effect>] {
        &self.catalogue
    }
    fn not_observable(&self, _effect: usize) -> Option<String> {
        None
    }
    fn groups(&self) -> &[u32] {
        &self.groups
    }
    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        vec![("stimulus".into(), self.x.clone()), ("t_s".into(), (0..READINGS).map(|i| i as f64).collect())]
    }
    fn known_noise(&self) -> &DMatrix<f64> {
        &self.known
    }
}
