//! What a transition is computed from: the inverse's solutions of two samples, and what one step of
//! the base allows.

use super::super::sample_geometry::SampleGeometry;
use super::super::settings::BayesSettings;
use crate::inverse::StaticInverse;

/// Inverse solutions of two samples, with their derivatives.
pub(crate) struct TransitionModel<'a> {
    pub(super) settings: &'a BayesSettings,
    pub(super) inverse: &'a StaticInverse,
    pub(super) before: SampleGeometry<'a>,
    pub(super) now: SampleGeometry<'a>,
    /// Nodes from here on are the tip's.
    pub(super) first_tip: usize,
    /// Density of a jump's path along the wire over the length of a node, by the nodes that it
    /// passes, from `-first_tip`.
    pub(super) jump_paths: Vec<f64>,
}

/// What one step of the base allows.
pub(super) struct BaseStep {
    /// Travel, mm, and its variance where the speed is one of several.
    pub(super) travel_mm: f64,
    pub(super) travel_variance_mm2: f64,
    /// Part of the force along the surface against a slip, f = mu / sqrt(1 + mu^2), and its
    /// variance.
    pub(super) drag: f64,
    pub(super) drag_variance: f64,
    /// Variances of the path along the wire, mm^2, and of the turn at the tip, rad^2: constant
    /// velocity, perturbed, reset.
    pub(super) path_variances: [f64; 3],
    pub(super) tip_variances: [f64; 3],
    /// Reach along the wire, mm, and scale of paths beyond its end, mm.
    pub(super) reach_mm: f64,
    pub(super) path_sd_mm: f64,
}
