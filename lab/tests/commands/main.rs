//! Each command of `wcal-lab` as a user runs it (SIMULATED): what it prints and writes, its exit
//! codes, and what it refuses.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod man;
mod models;
#[path = "../../../tests/support/not_run.rs"]
mod not_run;
mod simulate;
mod simulate_mujoco;
mod slurm;
mod support;
mod train;
