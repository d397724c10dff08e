//! What `wcal-trace` promises, through its public interface.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod engine_stages;
mod reference_noise;
mod scalar_cells;
mod scalar_measured;
mod scalar_simulated;
mod scalar_structure;
mod toy;
mod whisker_stages;
