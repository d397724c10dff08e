//! Each command as a user runs it: what it prints and writes, its exit codes, and what it refuses.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod bad_input;
mod board_statements;
mod calibrated;
mod exported;
mod known_motion;
mod live_page;
mod own_session;
mod passed_object;
mod pictured_session;
mod several_sessions;
mod stereo;
mod strokes;
#[path = "../support/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod support;
mod sweep_import;
mod sweep_witness;
mod tracked;
mod twin;
mod witness;
