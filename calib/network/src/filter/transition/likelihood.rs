//! Likelihood of a transition: how well a path of the contact between two samples explains the
//! moments.
//!
//! ```text
//! constraint     e_1 = n . d + f D,  f = mu / sqrt(1 + mu^2),  D = slip_x^2 / |slip|      (Coulomb friction across the wire)
//! its variance   r_1 = s_c^2 + (q z)^2 + s_m^2 (c_j^2 + c_k^2) + n_z^2 var_z + s_f^2 D^2 + (h |n_k - n_j| |slip|)^2
//! turn           about the wire: p(turn) = (1 - w) Laplace(b_smooth) + w Laplace(b_sharp)
//! slip           exp(-(|slip| - 1.2 z) / sd) where it is longer than the base's travel z allows
//! ```
//!
//! Symbols and sources: see `transition`.

use super::super::exp::exp;
use super::super::grid_cell::LinearGaussianPair;
use super::super::sample_geometry::{ContactState, SampleGeometry};
use super::super::settings::BayesSettings;
use crate::inverse::StaticInverse;
use nalgebra::Vector3;

/// Inverse solutions of two samples, with their derivatives.
pub(crate) struct TransitionModel<'a> {
    pub settings: &'a BayesSettings,
    pub inverse: &'a StaticInverse,
    pub before: SampleGeometry<'a>,
    pub now: SampleGeometry<'a>,
    /// Nodes from here on are the tip's.
    pub first_tip: usize,
    /// Density of a jump's path along the wire over the length of a node, by the nodes that it
    /// passes, from `-first_tip`.
    pub jump_paths: Vec<f64>,
}

/// What one step of the base allows.
pub(super) struct BaseStep {
    /// Travel, mm, and its variance where the speed is one of several.
    pub travel_mm: f64,
    pub travel_variance_mm2: f64,
    /// Part of the force along the surface against a slip, f = mu / sqrt(1 + mu^2), and its
    /// variance.
    pub drag: f64,
    pub drag_variance: f64,
    /// Variances of the path along the wire, mm^2, and of the turn at the tip, rad^2: constant
    /// velocity, perturbed, reset.
    pub path_variances: [f64; 3],
    pub tip_variances: [f64; 3],
    /// Reach along the wire, mm, and scale of paths beyond its end, mm.
    pub reach_mm: f64,
    pub path_sd_mm: f64,
}

/// Residual of the rigid-body constraint from a contact before to a node now.
pub(super) struct ConstraintResidual {
    /// First measurement: distance by which the touched point leaves the object's surface.
    pub pair: LinearGaussianPair,
    /// Its variance in an outlier, mm^2.
    pub outlier_variance: f64,
    /// Path along the surface, mm.
    pub slip_mm: Vector3<f64>,
}

impl TransitionModel<'_> {
    /// Density of the force's turn about the wire, 1/rad.
    pub(super) fn turn_density(&self, from: &ContactState<'_>, j: usize, step: &BaseStep) -> f64 {
        let (s, c) = (self.settings, &self.now.solutions[j]);
        let Some(axis) = &self.now.turn_axes[j] else {
            return 0.0;
        };
        // The direction's change across wire and force: for small turns the angle about the wire.
        let turn = axis.dot(&(c.normal - from.normal));
        let noise = s.noise_nmm * root_sum_square(from.turn_rad_per_nmm, c.turn_rad_per_nmm);
        let scale = |of: [f64; 2]| root_sum_square(of[0] + of[1] * step.travel_mm.abs(), noise);
        let [smooth, sharp] = [scale(s.turn), scale(s.sharp_turn)];
        (1.0 - s.sharp_fraction) * laplace_pdf(turn, smooth)
            + s.sharp_fraction * laplace_pdf(turn, sharp)
    }

    /// Factor against a slip on the surface that is longer than the base's travel.
    pub(super) fn excess_slip(&self, slip_mm: &Vector3<f64>, step: &BaseStep) -> f64 {
        // On a body at rest a contact slips about as far as the base goes; a fifth more is free.
        let over = slip_mm.norm() - 1.2 * step.travel_mm.abs();
        if over > 0.0 {
            exp(-over / step.path_sd_mm)
        } else {
            1.0
        }
    }

    /// Variance of the constraint by itself, s_c^2 + (q z)^2, mm^2.
    pub(super) fn constraint_variance(&self, travel_mm: f64) -> f64 {
        self.settings.constraint_sd_mm.powi(2)
            + (self.settings.constraint_sd_share * travel_mm).powi(2)
    }

    /// D, mm: slip over the object across the wire times its share of the whole slip. The force has
    /// the tangential part f against the slip, so that along the force, unlike along the normal,
    /// the touched point moves by f D.
    fn friction_shift_mm(
        &self,
        from: &ContactState<'_>,
        j: usize,
        path: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) -> f64 {
        let slope = self.now.point_slopes[j];
        let Some(along) = (slope - normal * normal.dot(&slope)).try_normalize(1e-9) else {
            return 0.0;
        };
        let across = path.dot(&along.cross(normal));
        // The displacement of the contact along the wire itself is no slip.
        let nodes = &self.inverse.nodes;
        let last = self.first_tip - 1;
        let along_wire_mm = nodes[j.min(last)].arclength_mm
            - nodes[from.node.min(last)].arclength_mm
            - from.cell.offset * self.node_mm();
        let slip = root_sum_square(across, path.dot(&along) - along_wire_mm);
        if slip > 1e-9 {
            across * across / slip
        } else {
            0.0
        }
    }

    /// Residual e_1 of the rigid-body constraint from a contact before to node `j` now, with
    /// derivatives and variance.
    pub(super) fn constraint(
        &self,
        from: &ContactState<'_>,
        j: usize,
        step: &BaseStep,
    ) -> ConstraintResidual {
        let (s, to) = (self.settings, &self.now.solutions[j]);
        let (point_slope, normal_slope) = (self.now.point_slopes[j], self.now.normal_slopes[j]);
        // Path of the contact on the object, which carried the contact before along.
        let path = to.point_mm - from.point_mm;
        let normal = (from.normal + to.normal)
            .try_normalize(0.1)
            .unwrap_or(to.normal);
        let shift = if step.drag > 0.0 {
            self.friction_shift_mm(from, j, &path, &normal)
        } else {
            0.0
        };
        let out = normal.dot(&path);
        let off = out + step.drag * shift;
        // Derivatives by the offsets: of the point, and of the mean normal, which turns half as
        // much.
        let by_now = normal.dot(&point_slope) + 0.5 * normal_slope.dot(&path);
        let by_before = -normal.dot(&from.point_slope) + 0.5 * from.normal_slope.dot(&path);
        let compliances = from.compliance_mm_per_nmm.powi(2) + to.compliance_mm_per_nmm.powi(2);
        let slip_mm = path - normal * out;
        // On a curved surface the mean normal is exact only where the curvature is constant: an
        // error in proportion to turn and slip.
        let bent = (to.normal - from.normal).norm_squared()
            * slip_mm.norm_squared()
            * s.turn_share
            * s.turn_share;
        let noise = self.constraint_variance(step.travel_mm)
            + s.noise_nmm.powi(2) * compliances
            + normal.z * normal.z * step.travel_variance_mm2
            + step.drag_variance * shift * shift
            + bent;
        let pair = LinearGaussianPair {
            residual: [off, 0.0],
            by_before: [by_before, 0.0],
            by_now: [by_now, 0.0],
            noise: [noise, 1.0],
            variance: from.cell.variance,
        };
        let outlier_variance =
            noise + s.outlier_sd_mm.powi(2) + s.outlier_sd_share.powi(2) * slip_mm.norm_squared();
        ConstraintResidual {
            pair,
            outlier_variance,
            slip_mm,
        }
    }
}

/// sqrt(a^2 + b^2): standard deviations that add.
fn root_sum_square(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

/// Laplace density.
pub(super) fn laplace_pdf(x: f64, scale: f64) -> f64 {
    exp(-x.abs() / scale) / (2.0 * scale)
}
