//! Links of equal length in a row.

use nalgebra::{Matrix3, Vector3};

/// Where the links are.
#[derive(Debug, Clone, PartialEq)]
pub struct Configuration {
    /// Frame of each link; its first column is the link's direction.
    pub frames: Vec<Matrix3<f64>>,
    /// Ends of the links from the root on, mm: one more than links.
    pub nodes_mm: Vec<Vector3<f64>>,
    /// Frame of the clamp from which they start.
    pub clamp: Matrix3<f64>,
    /// Length of each, mm.
    pub link_mm: f64,
}
