//! Inverse statics of the discrete rod under one point force, from the contact inward: explicit,
//! without a search for the equilibrium.
//!
//! In the frame of the link that is loaded, with the force f at c and nothing beyond: for j from
//! that link to the root m_j = (c - x_j) x f (moment at joint j), w_j = w0_j + K_j^-1 J_r(w_j)^T
//! R_j^T m_j, R_(j-1) = R_j exp(-w_j), x_(j-1) = x_j - h R_(j-1) e1. The root's frame, place and
//! moment come out at the end; rotated so that the root stands in the clamp, which yields by that
//! moment, they are the base's. Past the onset of softening a joint's turn from its rest is that of
//! the section's law. Each joint is solved by a fixed point with Newton's slope at the start.
//! Symbols as in `discrete.rs`.

use crate::DiscreteRod;
use crate::se3::exp_coefficients;
use nalgebra::{Matrix3, Vector3};

/// Steps of the fixed point for a joint's turn; its factor of contraction is a quarter of the turn
/// at most.
const TURN_STEPS: usize = 12;
/// Change of a joint's turn at which it has settled, rad.
const TURN_AGREES: f64 = 1e-10;
/// Steps in which the clamp's turn settles; it is small, and the moment turns with it.
const CLAMP_STEPS: usize = 6;
/// Square of the turn below which series are used, rad^2.
const SERIES_RAD2: f64 = 0.25;

/// A wire in equilibrium under one point force, base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointLoad {
    /// Contact on the wire's axis, mm.
    pub axis_mm: Vector3<f64>,
    /// Force on the wire, N.
    pub force_n: Vector3<f64>,
    /// Direction of the wire there, toward the tip.
    pub tangent: Vector3<f64>,
    /// Frame of the link that is loaded; its first column is `tangent`.
    pub frame: Matrix3<f64>,
    /// Moment at the root, N mm.
    pub moment_nmm: Vector3<f64>,
}

impl DiscreteRod {
    /// Contact place, force and root moment in the base frame for a force (N), given in the frame
    /// of the link that it acts on, at an arc length (mm).
    pub fn under_point_load(&self, arclength_mm: f64, force_n: &Vector3<f64>) -> PointLoad {
        let last = ((arclength_mm / self.link_mm).max(0.0) as usize).min(self.links() - 1);
        // In the frame of the link that is pushed, from its inner end.
        let touched = Vector3::x() * (arclength_mm - last as f64 * self.link_mm);
        let (mut frame, mut node, mut moment) =
            (Matrix3::identity(), Vector3::zeros(), Vector3::zeros());
        for j in (0..=last).rev() {
            // Beyond a joint only f acts: its moment gives the joint's turn, and that the next link
            // inward.
            moment = (touched - node).cross(force_n);
            let turn = self.joint_rotation(j, &frame.tr_mul(&moment));
            frame *= rotation(&-turn);
            if j > 0 {
                node -= frame.column(0) * self.link_mm;
            }
        }
        // All is turned so that the root stands in the clamp; one that yields turns with the moment
        // that it carries, which turns with it.
        let stiff = self.clamp_frame() * frame.transpose();
        let mut base = stiff;
        if self.compliance != Vector3::zeros() {
            for _ in 0..CLAMP_STEPS {
                base = rotation(&self.compliance.component_mul(&(base * moment))) * stiff;
            }
        }
        PointLoad {
            axis_mm: base * (touched - node),
            force_n: base * force_n,
            tangent: base.column(0).into(),
            frame: base,
            moment_nmm: base * moment,
        }
    }

    /// Rotation vector (rad) of a joint that carries a moment (N mm, frame of the link beyond it):
    /// rest + J_r(turn)^T moment / stiffness.
    fn joint_rotation(&self, joint: usize, moment_nmm: &Vector3<f64>) -> Vector3<f64> {
        let (rest, stiffness) = self.joints()[joint];
        let soft = stiffness.map(f64::recip);
        let mut turn = rest + moment_nmm.component_mul(&soft);
        // What changes with the turn, but for the change of its factors: third order in it.
        let (_, a, b) = rotation_factors(turn.norm_squared());
        let (m, once) = (
            moment_nmm.cross_matrix(),
            turn.cross(moment_nmm).cross_matrix(),
        );
        let change = m * a + (once + turn.cross_matrix() * m) * b;
        // Newton's slope at the start serves all steps: the turn is small.
        let slope = Matrix3::identity() + Matrix3::from_diagonal(&soft) * change;
        let Some(newton) = slope.try_inverse() else {
            return turn;
        };
        for _ in 0..TURN_STEPS {
            let linear = right_jacobian_transposed(&turn, moment_nmm).component_mul(&soft);
            let off = rest + self.softened(joint, linear) - turn;
            turn += newton * off;
            if off.norm_squared() < TURN_AGREES * TURN_AGREES {
                break;
            }
        }
        turn
    }
}

/// Transposed right Jacobian of the rotation vector `w` times `m`: m + (1 - cos)/w^2 w x m + (w -
/// sin)/w^3 w x (w x m).
fn right_jacobian_transposed(w: &Vector3<f64>, m: &Vector3<f64>) -> Vector3<f64> {
    let (_, a, b) = rotation_factors(w.norm_squared());
    let once = w.cross(m);
    m + once * a + w.cross(&once) * b
}

/// Rotation by a vector: 1 + sin/w [w] + (1 - cos)/w^2 [w]^2.
fn rotation(w: &Vector3<f64>) -> Matrix3<f64> {
    let w2 = w.norm_squared();
    let (s, a, _) = rotation_factors(w2);
    let mut r = w * w.transpose() * a + w.cross_matrix() * s;
    (0..3).for_each(|k| r[(k, k)] += 1.0 - a * w2);
    r
}

/// sin(w)/w, (1 - cos(w))/w^2 and (w - sin(w))/w^3 by the square of w; a link's turn is small.
fn rotation_factors(w2: f64) -> (f64, f64, f64) {
    if w2 > SERIES_RAD2 {
        let w = w2.sqrt();
        let (sin, cos) = w.sin_cos();
        return (sin / w, (1.0 - cos) / w2, (w - sin) / (w2 * w));
    }
    exp_coefficients(w2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Guess, Rod, Softening, Tangential};
    use nalgebra::Rotation3;
    use wcal_core::observation::WhiskerSpec;

    #[test]
    fn taper_softening_and_a_clamp_that_yields_are_those_of_the_continuous_rod() {
        let nominal = Rod::new(&WhiskerSpec::nominal(), 1.0).unwrap();
        let softening = Some(Softening::Section {
            onset_per_m: 8.0,
            hardening: 0.3,
        });
        let changed = |k: usize| {
            let mut rod = nominal.clone();
            rod.section.taper = if k == 1 { -0.3 } else { 0.0 };
            rod.section.softening = softening.filter(|_| k == 2);
            rod.compliance_rad_per_nmm = if k == 3 { 0.02 } else { 0.0 };
            rod
        };
        let s_mm = 40.0;
        let off = |rod: &Rod, links: &DiscreteRod| {
            let load = links.under_point_load(s_mm, &Vector3::new(0.0, 0.006, 0.02));
            let guess = Guess {
                force_n: load.force_n,
                arclength_mm: s_mm,
            };
            let held = rod
                .solve(&load.axis_mm, &guess, Tangential::Stick(s_mm))
                .ok()?;
            Some((held.force_n - load.force_n).norm() / load.force_n.norm())
        };
        for k in 0..4 {
            let links = |count: usize| DiscreteRod::of_rod(&changed(k), 0.3, count).unwrap();
            // Of second order in the links' length: a quarter with twice as many.
            let [coarse, fine] = [120, 240].map(|count| off(&changed(k), &links(count)).unwrap());
            assert!(fine < 0.01 && fine < 0.3 * coarse, "{k}: {coarse} {fine}");
            // Control: the wire without the change is another, or is not held there at all.
            let other = off(&nominal, &links(240)).unwrap_or(f64::INFINITY);
            assert!(k == 0 || other > 0.02, "{k}: {other}");
        }
    }

    #[test]
    fn rotations_are_those_of_the_library_on_both_sides_of_the_series() {
        for size in [0.0, 1e-9, 1e-3, 0.1, 0.3, 0.499, 0.501, 1.2, 3.0] {
            let w = Vector3::new(0.48, -0.6, 0.64) * size;
            let off = rotation(&w) - Rotation3::from_scaled_axis(w).matrix();
            assert!(off.amax() < 4e-16, "{size}: {}", off.amax());
            // The Jacobian is the rotation's derivative: R(w)^T dR along d is [J_r d].
            let (d, m) = (Vector3::new(0.3, 0.2, -0.7), Vector3::new(-1.1, 0.4, 0.9));
            let h = 1e-6;
            let turned = (rotation(&(w + d * h)) - rotation(&(w - d * h))) / (2.0 * h);
            let rate = rotation(&w).tr_mul(&turned);
            let rate = Vector3::new(rate[(2, 1)], rate[(0, 2)], rate[(1, 0)]);
            let by_jacobian = right_jacobian_transposed(&w, &m).dot(&d);
            assert!((m.dot(&rate) - by_jacobian).abs() < 1e-9, "{size}");
            // Control: the left Jacobian, its transpose, is another.
            if size > 0.1 {
                let left = right_jacobian_transposed(&-w, &m).dot(&d);
                assert!((m.dot(&rate) - left).abs() > 1e-3, "{size}");
            }
        }
    }
}
