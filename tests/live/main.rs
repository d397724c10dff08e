//! Programs that keep time: sweeps and streams on the virtual bench, signals, and benches that fall behind.
//!
//! A target of its own: Cargo runs one target after another, so that nothing else takes the machine meanwhile.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod known_motion_stream;
mod moving_base;
mod session_pictures;
mod stage_sweep;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod support;
mod track_live;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// One bench at a time: several at this speed starve each other on a small machine.
static ONE: Mutex<()> = Mutex::new(());

fn turn() -> MutexGuard<'static, ()> {
    ONE.lock().unwrap_or_else(PoisonError::into_inner)
}
