//! What stands before the cameras at one moment.

use nalgebra::Vector3;

use super::faces::Face;

/// Where the V-groove is and how it is turned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Groove {
    /// The wire's centre when it lies in the vertex, base frame, mm.
    pub position_mm: Vector3<f64>,
    /// Axis of the groove: the wire's tangent in it.
    pub axis: Vector3<f64>,
    /// Direction of the push.
    pub push: Vector3<f64>,
}

/// Surfaces and wire.
#[derive(Debug, Clone, PartialEq)]
pub struct View {
    /// Flat surfaces.
    pub faces: Vec<Face>,
    /// Centre line of the wire from root to tip, base frame, mm; empty: no wire.
    pub wire: Vec<Vector3<f64>>,
    /// Diameter of the wire, mm.
    pub diameter_mm: f64,
}
