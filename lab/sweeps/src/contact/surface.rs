//! What the contact solvers see of a body, and what they give back.

use super::configuration::Configuration;

use nalgebra::Vector3;
use wcal_mesh::ClosestPoint;

/// A body in the frame of the wire's root.
pub trait Surface {
    /// The surface near a point; `None` where it is farther than `within_mm`.
    fn closest_point(&self, point_mm: &Vector3<f64>, within_mm: f64) -> Option<ClosestPoint>;

    /// Whether it is made of flat facets.
    fn faceted(&self) -> bool {
        false
    }
}

/// A contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Place on the centre line from the root, mm.
    pub arclength_mm: f64,
    /// That place, mm.
    pub centre_mm: Vector3<f64>,
    /// Point of the surface, mm.
    pub point_mm: Vector3<f64>,
    /// Direction of the force on the wire.
    pub normal: Vector3<f64>,
    /// Force on the wire along it, N.
    pub force_n: f64,
    /// Friction force on the wire, N; across the normal.
    pub friction_n: Vector3<f64>,
    /// Distance of the centre line from the surface less the wire's radius, mm.
    pub gap_mm: f64,
}

/// A wire at rest against a body.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactState {
    /// Links.
    pub links: Configuration,
    /// Contacts that carry a force, from the root on.
    pub contacts: Vec<Contact>,
    /// Whether balance and contact were reached.
    pub converged: bool,
    /// Newton steps tried.
    pub iterations: usize,
    /// How far the wire overlaps the body, all contacts together, mm.
    pub overlap_mm: f64,
}
