//! What the answers are worth: verdicts on recordings with a known answer, and rates over drawn
//! ones (SIMULATED). What prints tables for the lab notes stands here.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod bench_verdicts;
mod contact_numbers;
mod exam;
mod picture_errors;
mod recorded_verdicts;
mod residual_loop;
mod scalar_loop;
mod second_witness;
mod statements;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod support;
