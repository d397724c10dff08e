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

mod clean_bench;
mod known_motion_stream;
mod moving_base;
mod session_pictures;
mod stage_sweep;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod support;
mod track_live;

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Benches that run now. Several fast ones starve each other on a small machine; those at a few times real time leave it idle.
static BENCHES: RwLock<()> = RwLock::new(());

/// For a fast bench, or one that may lose nothing: no other runs.
fn alone() -> RwLockWriteGuard<'static, ()> {
    BENCHES.write().unwrap_or_else(PoisonError::into_inner)
}

/// For a slow bench: others like it may run.
fn beside_others() -> RwLockReadGuard<'static, ()> {
    BENCHES.read().unwrap_or_else(PoisonError::into_inner)
}
