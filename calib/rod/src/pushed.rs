//! A wire that one force pushes, from the contact inward: explicit, without a search for the equilibrium.
//!
//! Seen from the contact nothing is unknown: the force there is given and no moment acts, so that each joint's turn follows from what
//! lies beyond it. The root's place and moment come out at the end; turned so that the root stands in the clamp they are the base's.

use crate::Chain;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// Steps of the fixed point for a joint's turn; its factor of contraction is a quarter of the turn at most.
const TURN_STEPS: usize = 6;

/// What a push gives, base frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Push {
    /// Contact on the wire's axis, mm.
    pub axis_mm: Vector3<f64>,
    /// Force on the wire, N.
    pub force_n: Vector3<f64>,
    /// Direction of the wire there, toward the tip.
    pub tangent: Vector3<f64>,
    /// Moment at the root, N mm.
    pub moment_nmm: Vector3<f64>,
}

impl Chain {
    /// The wire pushed at an arc length (mm) by a force (N) given in the frame of its link there.
    #[must_use]
    pub fn pushed(&self, arclength_mm: f64, force_n: &Vector3<f64>) -> Push {
        let last = ((arclength_mm / self.link_mm).max(0.0) as usize).min(self.links() - 1);
        // In the frame of the link that is pushed, from its inner end.
        let touched = Vector3::x() * (arclength_mm - last as f64 * self.link_mm);
        let (mut frame, mut node, mut moment) = (Matrix3::identity(), Vector3::zeros(), Vector3::zeros());
        for j in (0..=last).rev() {
            moment = (touched - node).cross(force_n);
            let turn = self.turn_under(j, &frame.tr_mul(&moment));
            frame *= Rotation3::from_scaled_axis(-turn).matrix();
            if j > 0 {
                node -= frame.column(0) * self.link_mm;
            }
        }
        let base = self.clamp_frame() * frame.transpose();
        Push {
            axis_mm: base * (touched - node),
            force_n: base * force_n,
            tangent: base.column(0).into(),
            moment_nmm: base * moment,
        }
    }

    /// Turn (rad) of a joint that carries a moment (N mm, frame of the link beyond it).
    fn turn_under(&self, joint: usize, moment_nmm: &Vector3<f64>) -> Vector3<f64> {
        let (rest, stiffness) = self.joint_law(joint);
        let mut turn = rest;
        for _ in 0..TURN_STEPS {
            turn = rest + (right_jacobian(&turn).tr_mul(moment_nmm)).component_div(&stiffness);
        }
        turn
    }
}

fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let (a, b) = if angle2 < 1e-6 {
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let angle = angle2.sqrt();
        ((1.0 - angle.cos()) / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    let hat = w.cross_matrix();
    Matrix3::identity() - hat * a + hat * hat * b
}
