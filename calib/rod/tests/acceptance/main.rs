//! Acceptance of the rod: exact solutions, order, contact laws, and a negative control for each check.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

mod contact;
mod elastica;
mod elliptic;
mod laws;
mod order;
mod rest_fit;
mod stability;
mod touch;

use nalgebra::Vector3;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_rod::Rod;

/// Length of the test wire, mm.
const LENGTH_MM: f64 = 60.0;

/// Wire of 0.3 mm and 60 mm; `rest_shape` and gravity as given.
fn spec(rest_shape: RestShape) -> WhiskerSpec {
    WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: Some(6450.0),
        rest_shape,
        gravity_direction: Some(-Vector3::z()),
    }
}

fn straight_shape() -> RestShape {
    RestShape::StraightArc { straight_mm: LENGTH_MM, arc_radius_mm: 20.0, length_mm: LENGTH_MM }
}

fn bent_shape() -> RestShape {
    RestShape::StraightArc { straight_mm: 30.0, arc_radius_mm: 20.0, length_mm: LENGTH_MM }
}

fn straight(step_mm: f64) -> Rod {
    Rod::new(&spec(straight_shape()), step_mm).unwrap()
}

fn bent(step_mm: f64) -> Rod {
    Rod::new(&spec(bent_shape()), step_mm).unwrap()
}
