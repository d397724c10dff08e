//! Sweeps over objects (SIMULATED), and the solver of the wire's contacts below them.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod discrete_contact;
mod physics;
mod rod_physics;
mod sweeps;

#[path = "../../../../tests/support/wires.rs"]
mod wires;

use wires::{LENGTH_MM, bent, bent_shape, spec, straight_shape};
