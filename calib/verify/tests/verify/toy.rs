//! A small system with known answers for the engine's tests (SIMULATED): a line over x with
//! candidates of every kind.

use nalgebra::DMatrix;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_distr::{Distribution, StandardNormal};
use wcal_verify::effect::{Effect, EffectTerm, law};
use wcal_verify::measurement_model::MeasurementModel;

/// Indices of the candidates.
pub(crate) const SHELF: usize = 0;
pub(crate) const BEND: usize = 1;
pub(crate) const SCALE: usize = 2;
pub(crate) const OUTLIERS: usize = 3;

/// Largest part of the bend in what the readings span.
pub(crate) const BEND_SHARE: f64 = 0.3;

pub(crate) const READINGS: usize = 60;
/// True line: zero and slope.
pub(crate) const LINE: [f64; 2] = [3.0, 20.0];
/// Noise of one reading.
pub(crate) const NOISE: f64 = 0.1;

fn catalogue() -> Vec<Effect> {
    const GRID: &[f64] = &[0.2, 0.4, 0.6, 0.8];
    let shelf = |name| {
        law(name)
            .amplitude("height", "1", [0.0, 0.5], 0.02)
            .shape("place", "1", [0.02, 0.98], GRID)
    };
    let two = shelf("two").amplitude("second_height", "1", [0.0, 0.5], 0.02);
    let two = two.shape("second_place", "1", [0.02, 0.98], GRID);
    let effect = |id, law| Effect::new(id, "Something acts.", vec![law]);
    vec![
        Effect {
            refinements: vec![two],
            ..effect("shelf", shelf("only"))
        },
        effect(
            "bend",
            law("only").column("square", "1").at_most(BEND_SHARE),
        ),
        effect(
            "scale",
            law("only").amplitude("share", "1", [-0.5, 0.5], 0.02),
        ),
        Effect {
            is_outlier_process: true,
            ..effect("outliers", law("only"))
        },
    ]
}

/// How far the shelf at `place` lifts the reading at x; rises over about a tenth of the range.
pub(crate) fn shelf(x: f64, place: f64) -> f64 {
    0.5 * (1.0 + ((x - place) / 0.05).tanh())
}

pub(crate) struct ToySystem {
    x: Vec<f64>,
    measured: DMatrix<f64>,
    catalogue: Vec<Effect>,
    groups: Vec<u32>,
}

impl ToySystem {
    /// Readings at evenly spread, shuffled x: `extra` is added to line and noise.
    pub(crate) fn draw(seed: u64, extra: impl Fn(usize, f64) -> f64) -> Self {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut x: Vec<f64> = (0..READINGS)
            .map(|i| i as f64 / (READINGS - 1) as f64)
            .collect();
        x.shuffle(&mut rng);
        let measured = DMatrix::from_fn(READINGS, 1, |i, _| {
            let z: f64 = StandardNormal.sample(&mut rng);
            LINE[0] + LINE[1] * x[i] + extra(i, x[i]) + NOISE * z
        });
        Self {
            x,
            measured,
            catalogue: catalogue(),
            groups: (0..READINGS).map(|i| (i / 10) as u32).collect(),
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
        Some(DMatrix::from_fn(READINGS, columns.len(), |i, j| {
            columns[j][i]
        }))
    }
    fn catalogue(&self) -> &[Effect] {
        &self.catalogue
    }
    fn not_observable(&self, _effect: usize) -> Option<String> {
        None
    }
    fn groups(&self) -> &[u32] {
        &self.groups
    }
    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        vec![
            ("stimulus".into(), self.x.clone()),
            ("t_s".into(), (0..READINGS).map(|i| i as f64).collect()),
        ]
    }
}
