//! The same groove point on a wire that differs a little: Broyden's method from the Jacobian of a
//! known equilibrium.
//!
//! x_(k+1) = x_k - B_k g_k with B_0 the inverse Jacobian of the known equilibrium, g the equations
//! of [`super::solve`], and with dx = x_(k+1) - x_k, dg = g_(k+1) - g_k: B_(k+1) = B_k + (dx - B_k
//! dg) dx^T B_k / (dx . B_k dg)  (C. G. Broyden, Math. Comp. 19, 1965).
//!
//! A fit asks for hundreds of wires whose stiffness, offset or softening differ by a few per cent.
//! Their equilibria lie next to known ones, so that plain evaluations with the updated Jacobian
//! reach them; where they contract too slowly, [`Rod::follow`] is to be used.

use crate::kirchhoff::integrate::Load;
use crate::kirchhoff::solve::{Equilibrium, Rod, Tangential};
use nalgebra::{Matrix4, Vector3, Vector4};

/// A known frictionless equilibrium with the inverse Jacobian of its equations.
#[derive(Debug, Clone, PartialEq)]
pub struct Anchor {
    /// The equilibrium.
    pub equilibrium: Equilibrium,
    force_scale_n: f64,
    inverse: Matrix4<f64>,
}

/// Residual at which a neighbour counts as found, mm: moments are right to about 1e-8 N mm then.
const TOLERANCE_MM: f64 = 1e-8;
/// Each iteration must shrink the residual to this share, else the neighbour is not near.
const CONTRACTION: f64 = 0.3;
const MAX_ITERATIONS: usize = 10;

impl Rod {
    /// Keeps the Jacobian at `equilibrium`; none where it is singular or where the wire's weight
    /// acts (solved by other means).
    pub fn anchor(&self, equilibrium: &Equilibrium) -> Option<Anchor> {
        if self.weight_n_per_mm.norm() > 0.0 {
            return None;
        }
        // EI / s^2 is the scale of forces that bend a rod of length s strongly: unknowns and
        // equations of one order.
        let force_scale_n = self.section.ei_nmm2 / equilibrium.arclength_mm.max(1.0).powi(2);
        let (_, jacobian, _) = self.equations(
            &equilibrium.point_mm,
            &equilibrium.force_n,
            equilibrium.arclength_mm,
            Tangential::Frictionless,
            None,
            force_scale_n,
        );
        Some(Anchor {
            equilibrium: *equilibrium,
            force_scale_n,
            inverse: jacobian.try_inverse()?,
        })
    }

    /// Frictionless equilibrium at `point_mm` next to `anchor`, which may belong to a slightly
    /// different wire or point.
    ///
    /// None where the iteration does not contract well: the equilibrium is then not safely on the
    /// anchor's branch.
    pub fn solve_near(&self, point_mm: &Vector3<f64>, anchor: &Anchor) -> Option<Equilibrium> {
        let known = &anchor.equilibrium;
        let (mut force, mut s) = (known.force_n, known.arclength_mm);
        let mut last = f64::INFINITY;
        let mut inverse = anchor.inverse;
        let mut before: Option<(Vector4<f64>, Vector4<f64>)> = None;
        for iteration in 1..=MAX_ITERATIONS {
            // One integration without derivatives an iteration: that is what the update saves.
            let load = Load {
                point: (*point_mm).into(),
                force: force.into(),
                distributed: None,
            };
            let end = self.end(&load, s);
            let offset = Vector3::from(end.position) - point_mm;
            let tangent = Vector3::from([0, 1, 2].map(|i| end.frame[i][0]));
            // Frictionless contact: the force has no component along the wire.
            let residual = offset.push(force.dot(&tangent) / anchor.force_scale_n);
            let size = residual.norm();
            if size < TOLERANCE_MM {
                // The determinant is the anchor's: so near to it the branch is the same.
                return (s <= self.shape.length_mm).then(|| Equilibrium {
                    point_mm: *point_mm,
                    force_n: force,
                    arclength_mm: s,
                    tangent,
                    moment_nmm: point_mm.cross(&force),
                    determinant: known.determinant,
                    iterations: iteration,
                });
            }
            // The first residual is the step between the wires, whatever its size.
            if iteration > 1 && !(size < CONTRACTION * last) {
                return None;
            }
            last = size;
            if let Some((step, residual_before)) = before {
                // Sherman-Morrison form of the secant update; the step was taken with a minus.
                let image = inverse * (residual - residual_before);
                let along_step = step.dot(&image);
                // A vanishing denominator would make the update singular: the last inverse is kept.
                if along_step.abs() > 1e-12 * step.norm_squared() {
                    inverse += (-step - image) * (-step).transpose() * inverse / -along_step;
                }
            }
            let step = inverse * residual;
            before = Some((step, residual));
            force -= step.fixed_rows::<3>(0) * anchor.force_scale_n;
            s -= step[3];
            if !(s > 0.0) {
                return None;
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Line, Outcome};
    use wcal_core::observation::WhiskerSpec;

    fn rod() -> Rod {
        let spec = WhiskerSpec::nominal();
        Rod::new(&spec, 4.0).unwrap()
    }

    fn held(rod: &Rod, line: &Line, x_mm: f64) -> Equilibrium {
        match rod.follow(line, &[x_mm])[0] {
            Outcome::Held(e) => e,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_neighbour_equals_what_following_gives() {
        let nominal = rod();
        let line = Line {
            origin_mm: nominal.shape.rest_point(31.0),
            direction: Vector3::new(0.0, 0.6, 0.8),
        };
        let anchor = nominal.anchor(&held(&nominal, &line, 6.0)).unwrap();
        let mut other = rod();
        other.compliance_rad_per_nmm = 2e-3;
        other.section.taper = 0.05;
        let near = other.solve_near(&line.point(6.2), &anchor).unwrap();
        let followed = held(&other, &line, 6.2);
        assert!((near.moment_nmm - followed.moment_nmm).norm() < 1e-7);
        let unchanged = anchor.equilibrium.moment_nmm;
        assert!(
            (near.moment_nmm - unchanged).norm() > 1e-3,
            "the other wire went unseen"
        );
    }

    #[test]
    fn a_far_wire_is_refused() {
        let nominal = rod();
        let line = Line {
            origin_mm: nominal.shape.rest_point(31.0),
            direction: Vector3::new(0.0, 0.6, 0.8),
        };
        let anchor = nominal.anchor(&held(&nominal, &line, 2.0)).unwrap();
        assert_eq!(nominal.solve_near(&line.point(14.0), &anchor), None);
    }
}
