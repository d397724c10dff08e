//! What `wcal-trace` promises, through its public interface.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

use wcal_trace::MeasurementModel;
use wcal_trace::method::fit::Weights;
use wcal_trace::method::options::Options;
use wcal_trace::method::search::{
    Search, compare_rivals, project_signatures, refit, screen_subsets, select_model, test_adequacy,
};
use wcal_trace::method::search_result::SearchResult;

/// One search under a noise that is known, as `verify` makes it in each round.
fn search(system: &dyn MeasurementModel, weights: &Weights, options: &Options) -> Option<SearchResult> {
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

mod engine_stages;
mod reference_noise;
mod scalar_bends;
mod scalar_cells;
mod scalar_inputs;
mod scalar_measured;
mod scalar_simulated;
mod scalar_structure;
mod toy;
mod whisker_stages;
