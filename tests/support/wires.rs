//! Wires of the rod's tests: 0.3 mm and 60 mm, under their weight.

use nalgebra::Vector3;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_rod::Rod;

/// Length of the test wire, mm.
pub(crate) const LENGTH_MM: f64 = 60.0;

pub(crate) fn spec(rest_shape: RestShape) -> WhiskerSpec {
    WhiskerSpec {
        diameter_mm: 0.3,
        youngs_gpa: 75.0,
        shear_gpa: 28.2,
        density_kg_m3: Some(6450.0),
        rest_shape,
        gravity_direction: Some(-Vector3::z()),
    }
}

pub(crate) fn straight_shape() -> RestShape {
    RestShape::StraightArc {
        straight_mm: LENGTH_MM,
        arc_radius_mm: 20.0,
        length_mm: LENGTH_MM,
    }
}

pub(crate) fn bent_shape() -> RestShape {
    RestShape::StraightArc {
        straight_mm: 30.0,
        arc_radius_mm: 20.0,
        length_mm: LENGTH_MM,
    }
}

pub(crate) fn bent(step_mm: f64) -> Rod {
    Rod::new(&spec(bent_shape()), step_mm).unwrap()
}
