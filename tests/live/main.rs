//! Programs that keep time: sweeps and streams on the virtual bench, signals, and benches that fall
//! behind.
//!
//! A target of its own: nothing else may take the machine from them.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

/// `make test` runs these before all others in the machine's favour, and those beside them with
/// `--skip keeps_time::`.
#[path = "."]
mod keeps_time {
    mod clean_bench;
    mod known_motion_stream;
    mod moving_base;
    mod session_pictures;
    mod stage_sweep;
    mod track_live;
}
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod support;

use std::sync::{PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};

/// Benches that run now. Several fast ones starve each other on a small machine; those at a few
/// times real time leave it idle.
static BENCHES: RwLock<()> = RwLock::new(());

/// For a fast bench, or one that may lose nothing: no other runs.
pub(crate) fn alone() -> RwLockWriteGuard<'static, ()> {
    BENCHES.write().unwrap_or_else(PoisonError::into_inner)
}

/// For a slow bench: others like it may run.
pub(crate) fn beside_others() -> RwLockReadGuard<'static, ()> {
    BENCHES.read().unwrap_or_else(PoisonError::into_inner)
}
