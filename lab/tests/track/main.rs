//! What is trained and what tracks with it: sweeps as tables, the network, the filter, contacts
//! that slide (all SIMULATED).

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod assumed_motion;
mod dataset;
mod evaluation_document;
mod forward;
mod free_wire;
mod friction;
mod on_surface;
mod sliding;
mod tracking;
