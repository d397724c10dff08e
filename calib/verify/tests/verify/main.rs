//! What `wcal-verify` promises, through its public interface.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal};
use wcal_verify::MeasurementModel;
use wcal_verify::method::fit::Weights;
use wcal_verify::method::options::Options;
use wcal_verify::method::search::{
    Search, compare_rivals, project_signatures, refit, screen_subsets, select_model, test_adequacy,
};
use wcal_verify::method::search_result::SearchResult;
use wcal_verify::scalar::ScalarVerification;

/// One search under a noise that is known, as `verify` makes it in each round.
fn search(
    system: &dyn MeasurementModel,
    weights: &Weights,
    options: &Options,
) -> Option<SearchResult> {
    let mut search = Search::new(system, weights, options)?;
    while test_adequacy(system, &search) {
        let signatures = project_signatures(system, &search);
        let candidates = screen_subsets(system, signatures);
        let refitted = refit(system, &search, &candidates);
        if !select_model(system, &mut search, refitted) {
            break;
        }
    }
    Some(compare_rivals(system, &search))
}

/// Draws with a seed.
struct Noise(rand_chacha::ChaCha8Rng);

impl Noise {
    fn new(seed: u64) -> Self {
        Self(rand_chacha::ChaCha8Rng::seed_from_u64(seed))
    }
    /// Gaussian, of unit variance.
    fn next(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
    fn uniform(&mut self) -> f64 {
        rand::RngExt::random(&mut self.0)
    }
}

/// Names that a verification gives.
fn names(v: &ScalarVerification) -> Vec<&str> {
    v.document.effects.iter().map(|e| e.id.as_str()).collect()
}

mod designs;
mod engine_stages;
mod invariance;
mod reference_noise;
mod scalar_bends;
mod scalar_cells;
mod scalar_check;
mod scalar_data_sheet;
mod scalar_inputs;
mod scalar_inverse;
mod scalar_measured;
mod scalar_names;
mod scalar_simulated;
mod scalar_structure;
mod toy;
mod whisker_check;
mod whisker_stages;
