//! A small system for the method's own tests (SIMULATED): a constant, and effects that add one
//! column each.

use crate::effect::{Effect, EffectTerm, law};
use crate::measurement_model::MeasurementModel;
use nalgebra::DMatrix;
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};

pub(crate) struct ColumnsSystem {
    measured: DMatrix<f64>,
    columns: Vec<Vec<f64>>,
    catalogue: Vec<Effect>,
    groups: Vec<u32>,
    covariates: Vec<(String, Vec<f64>)>,
}

impl ColumnsSystem {
    /// The same with covariates.
    pub(crate) fn with_covariates(self, covariates: Vec<(String, Vec<f64>)>) -> Self {
        Self { covariates, ..self }
    }

    /// `clean` with white noise of standard deviation 1, in groups of ten readings.
    pub(crate) fn new(seed: u64, columns: Vec<Vec<f64>>, clean: &[f64]) -> Self {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let n = clean.len();
        let single = Effect::new(
            "outliers",
            "Single readings stand out.",
            vec![law("single-readings")],
        );
        let single = Effect {
            is_outlier_process: true,
            ..single
        };
        let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
        Self {
            measured: DMatrix::from_fn(n, 1, |i, _| clean[i] + noise()),
            catalogue: columns
                .iter()
                .map(|_| {
                    Effect::new(
                        "column",
                        "A column acts.",
                        vec![law("linear").column("size", "1")],
                    )
                })
                .chain([single])
                .collect(),
            columns,
            groups: (0..n).map(|i| (i / 10) as u32).collect(),
            covariates: Vec::new(),
        }
    }

    /// Term of a column.
    pub(crate) fn term(effect: usize) -> EffectTerm {
        EffectTerm {
            effect,
            law: 0,
            values: Vec::new(),
        }
    }
}

impl MeasurementModel for ColumnsSystem {
    fn measured(&self) -> &DMatrix<f64> {
        &self.measured
    }
    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>> {
        let one = vec![1.0; self.measured.nrows()];
        let columns: Vec<&Vec<f64>> = std::iter::once(&one)
            .chain(terms.iter().map(|t| &self.columns[t.effect]))
            .collect();
        Some(DMatrix::from_fn(one.len(), columns.len(), |i, j| {
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
        self.covariates.clone()
    }
}
