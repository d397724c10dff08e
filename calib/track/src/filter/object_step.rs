//! Rigid motion of the touched object with respect to the base from one sample to the next.

use nalgebra::{Rotation3, Vector3};

/// A point of the object at p goes to `turn p + moved_mm`, base frame, mm.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ObjectStep {
    /// Rotation.
    pub turn: Rotation3<f64>,
    /// Displacement, mm.
    pub moved_mm: Vector3<f64>,
    /// Standard deviation of the displacement in each coordinate, mm.
    pub sd_mm: f64,
}

impl ObjectStep {
    /// Of an object at rest past which the base travels along its +z, mm.
    pub fn past_base(travel_mm: f64) -> Self {
        Self { turn: Rotation3::identity(), moved_mm: Vector3::z() * -travel_mm, sd_mm: 0.0 }
    }

    /// This step and then another; independent errors add.
    pub fn followed_by(&self, next: &Self) -> Self {
        Self {
            turn: next.turn * self.turn,
            moved_mm: next.turn * self.moved_mm + next.moved_mm,
            sd_mm: self.sd_mm.hypot(next.sd_mm),
        }
    }

    /// Displacement of the object's point that is at `point_mm`, mm.
    pub fn displacement_mm(&self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        self.turn * point_mm + self.moved_mm - point_mm
    }
}
