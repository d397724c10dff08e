//! Acceptance of the rod: exact solutions, order, contact laws, and a negative control for each
//! check.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

mod contact;
mod elastica;
mod elliptic;
mod laws;
mod order;
mod rest_fit;
mod touch;

#[path = "../../../../tests/support/wires.rs"]
mod wires;

use wcal_rod::Rod;
use wires::{LENGTH_MM, bent, bent_shape, spec, straight_shape};

fn straight(step_mm: f64) -> Rod {
    Rod::new(&spec(straight_shape()), step_mm).unwrap()
}
