//! The wire as a discrete-energy Kirchhoff rod.
//!
//! The wire is cut into elements of constant curvature (helices). The elastic energy
//! `sum h/2 (u_i - u0_i)' B (u_i - u0_i)` is made stationary under `r(contact) = P`; the multiplier
//! of that constraint is the contact force `F`. The variation of the contact point with the
//! curvature of element `i` is the integral of `R (du) x (P - r)` over it, so stationarity reads:
//! the elastic moment of every element equals the mean of `R' ((P - r) x F)` over it. The scheme is
//! second order; two meshes and Richardson's extrapolation make it fourth. The residual are four
//! unknowns (`F` and the contact's arc length).

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};
use std::sync::Arc;

use crate::WireError;

type V3 = Vector3<f64>;
type M3 = Matrix3<f64>;

/// A section that is neither uniform nor linear.
pub trait Section: std::fmt::Debug + Send + Sync {
    /// Bending and torsion stiffness at a fraction of the length, relative to the root's.
    fn stiffness(&self, fraction: f64) -> f64;

    /// Change of curvature (1/mm) that a linear section's change `linear` (moment / EI) becomes.
    fn curvature(&self, linear: f64) -> f64;
}

/// A wire: straight part, then an arc that bends toward -z, clamped at the origin along x.
#[derive(Debug, Clone)]
pub struct Wire {
    /// Straight part in mm.
    pub straight_mm: f64,
    /// Radius of the arc in mm.
    pub arc_radius_mm: f64,
    /// Whole length in mm.
    pub length_mm: f64,
    /// Diameter in mm.
    pub diameter_mm: f64,
    /// Bending stiffness at the root in N mm^2.
    pub ei_nmm2: f64,
    /// Torsion stiffness at the root in N mm^2.
    pub gj_nmm2: f64,
    /// What differs from a uniform linear section.
    pub section: Option<Arc<dyn Section>>,
    /// Turn of the root per moment, rad/(N mm), about base y and z.
    pub root_compliance: [f64; 2],
    /// Elements on the coarse mesh in (straight, arc).
    pub elements: [usize; 2],
}

/// One equilibrium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Equilibrium {
    /// Contact force on the wire in N, base frame.
    pub force_n: V3,
    /// Arc length of the contact in mm.
    pub arclength_mm: f64,
    /// Tangent at the contact.
    pub tangent: V3,
    /// Moment on the base in N mm, `P x F`.
    pub moment_nmm: V3,
}

/// exp of a rotation vector, and its left integral applied to e1 (the chord of a helix).
fn helix(phi: &V3) -> (M3, V3) {
    let t2 = phi.norm_squared();
    // Near zero the closed forms divide 0 by 0: their series stand in for them.
    let (a, b, c) = if t2 < 1e-4 {
        (
            1.0 - t2 / 6.0 + t2 * t2 / 120.0,
            0.5 - t2 / 24.0 + t2 * t2 / 720.0,
            1.0 / 6.0 - t2 / 120.0 + t2 * t2 / 5040.0,
        )
    } else {
        let t = t2.sqrt();
        (t.sin() / t, (1.0 - t.cos()) / t2, (t - t.sin()) / (t2 * t))
    };
    // Rodrigues' formula, and its integral over the element: the chord of a helix.
    let k = phi.cross_matrix();
    let k2 = k * k;
    (
        M3::identity() + k * a + k2 * b,
        V3::x() + k.column(0) * b + k2.column(0) * c,
    )
}

/// Gauss points of two on (0, 1).
const GAUSS: [f64; 2] = [0.211_324_865_405_187_1, 0.788_675_134_594_812_9];

impl Wire {
    /// A uniform linear wire; lengths in mm, moduli in GPa.
    pub fn new(
        diameter_mm: f64,
        length_mm: f64,
        straight_mm: f64,
        arc_radius_mm: f64,
        youngs_gpa: f64,
        shear_gpa: f64,
    ) -> Self {
        let quartic = std::f64::consts::PI * diameter_mm.powi(4);
        Self {
            straight_mm,
            arc_radius_mm,
            length_mm,
            diameter_mm,
            ei_nmm2: youngs_gpa * 1e3 * quartic / 64.0,
            gj_nmm2: shear_gpa * 1e3 * quartic / 32.0,
            section: None,
            root_compliance: [0.0; 2],
            elements: [9, 7],
        }
    }

    /// Radius of its cross-section in mm.
    pub fn radius_mm(&self) -> f64 {
        self.diameter_mm / 2.0
    }

    /// Shape at rest: position and tangent at arc length `s_mm`.
    pub fn rest(&self, s_mm: f64) -> (V3, V3) {
        let turn = ((s_mm - self.straight_mm) / self.arc_radius_mm).max(0.0);
        let x = s_mm.min(self.straight_mm) + self.arc_radius_mm * turn.sin();
        let z = -self.arc_radius_mm * (1.0 - turn.cos());
        (V3::new(x, 0.0, z), V3::new(turn.cos(), 0.0, -turn.sin()))
    }

    /// Marches from the root to arc length `sigma_mm` under force `force` at `point`; returns
    /// position and tangent.
    pub fn march(&self, point: &V3, force: &V3, sigma_mm: f64, refine: usize) -> (V3, V3) {
        let split = self.straight_mm.min(sigma_mm);
        let sections = [
            ([0.0, split], self.elements[0], 0.0),
            (
                [split, sigma_mm],
                self.elements[1],
                1.0 / self.arc_radius_mm,
            ),
        ];
        let mut walk = Walk::from_root(self, point, force);
        for (ends, count, curvature) in sections {
            if ends[1] - ends[0] >= 1e-9 {
                // The rest curvature jumps here: the next element's first guess jumps with it.
                walk.u.y += curvature;
                walk.along(force, ends, count * refine, curvature, |_| {});
            }
        }
        (walk.r, walk.frame.column(0).into_owned())
    }

    /// Centre line from root to tip in pieces of at most `step_mm`, loaded by `contact` (`None`: at
    /// rest) at `point`; what lies past the contact carries no moment and keeps its rest curvature.
    pub fn centre_line(&self, contact: Option<(&V3, &Equilibrium)>, step_mm: f64) -> Vec<V3> {
        let (point, force, contact_mm) = contact
            .map_or((V3::zeros(), V3::zeros(), 0.0), |(p, e)| {
                (*p, e.force_n, e.arclength_mm)
            });
        let mut walk = Walk::from_root(self, &point, &force);
        let mut line = vec![walk.r];
        for (ends, count) in self.pieces(contact_mm, step_mm) {
            let in_arc = ends[0] >= self.straight_mm;
            let curvature = if in_arc {
                1.0 / self.arc_radius_mm
            } else {
                0.0
            };
            // Past the contact nothing pulls.
            let loaded = if ends[1] <= contact_mm { 1.0 } else { 0.0 };
            walk.along(&(force * loaded), ends, count, curvature, |r| line.push(r));
        }
        line
    }

    /// Stretches between contact, the end of the straight part and the ends, each with its number
    /// of elements: those of [`Wire::centre_line`].
    pub fn pieces(&self, contact_mm: f64, step_mm: f64) -> Vec<([f64; 2], usize)> {
        let mut cuts = [0.0, contact_mm, self.straight_mm, self.length_mm];
        cuts.sort_by(f64::total_cmp);
        let long = cuts.windows(2).filter(|w| w[1] - w[0] > 1e-9);
        long.map(|w| ([w[0], w[1]], ((w[1] - w[0]) / step_mm).ceil() as usize))
            .collect()
    }

    /// What must vanish: position mismatch in mm, and the tangential force less `drag` times the
    /// normal one.
    fn residual(&self, point: &V3, drag: f64, x: &Vector4<f64>, refine: usize) -> Vector4<f64> {
        let force = x.xyz();
        let (r, t) = self.march(point, &force, x.w, refine);
        let along = force.dot(&t);
        let across = (force - t * along).norm();
        let gap = r - point;
        // Measured by the force of 1 mm of deflection, so that the row stays regular where the
        // force vanishes.
        Vector4::new(
            gap.x,
            gap.y,
            gap.z,
            (along - drag * across) / self.force_scale(point),
        )
    }

    /// Equilibrium with the contact at `point` and tangential over normal force `drag` (0:
    /// frictionless).
    ///
    /// `start` is a nearby equilibrium; `slope` a Jacobian to try first, replaced by the last one
    /// used.
    ///
    /// # Errors
    /// [`WireError::NoEquilibrium`] when Newton's iteration does not settle.
    pub fn solve(
        &self,
        point: &V3,
        drag: f64,
        start: &Equilibrium,
        slope: &mut Option<Matrix4<f64>>,
    ) -> Result<Equilibrium, WireError> {
        let mut x = Vector4::new(
            start.force_n.x,
            start.force_n.y,
            start.force_n.z,
            start.arclength_mm,
        );
        let mut solutions = [Vector4::zeros(); 2];
        for (slot, refine) in solutions.iter_mut().zip([1, 2]) {
            x = self.newton(point, drag, x, refine, slope)?;
            *slot = x;
        }
        // Second-order scheme: the error falls fourfold from mesh to mesh.
        let best = solutions[1] + (solutions[1] - solutions[0]) / 3.0;
        let force_n = best.xyz();
        let (_, tangent) = self.march(point, &force_n, best.w, 2);
        Ok(Equilibrium {
            force_n,
            arclength_mm: best.w,
            tangent,
            moment_nmm: point.cross(&force_n),
        })
    }

    fn force_scale(&self, point: &V3) -> f64 {
        3.0 * self.ei_nmm2 / point.norm().powi(3)
    }

    fn newton(
        &self,
        point: &V3,
        drag: f64,
        start: Vector4<f64>,
        refine: usize,
        jacobian: &mut Option<Matrix4<f64>>,
    ) -> Result<Vector4<f64>, WireError> {
        let mut x = start;
        let mut g = self.residual(point, drag, &x, refine);
        let mut fresh = false;
        for _ in 0..60 {
            if g.norm() < 1e-10 {
                return Ok(x);
            }
            let j = match jacobian {
                Some(j) => *j,
                None => {
                    fresh = true;
                    self.slope(point, drag, &x, &g, refine)
                }
            };
            let inverse = j
                .try_inverse()
                .ok_or(WireError::NoEquilibrium { residual: g.norm() })?;
            let mut step = -(inverse * g);
            // A long step leaves the branch: cut it back.
            let long = (step.xyz().norm() / (0.05 + 0.5 * x.xyz().norm())).max(step.w.abs() / 2.0);
            if long > 1.0 {
                step /= long;
            }
            let next = x + step;
            let g_next = self.residual(point, drag, &next, refine);
            if g_next.norm() > 0.3 * g.norm() && !fresh {
                *jacobian = None;
                if g_next.norm() > g.norm() {
                    continue;
                }
            } else {
                *jacobian = Some(j);
            }
            if fresh && long <= 1.0 && g_next.norm() > 4.0 * g.norm() {
                return Err(WireError::NoEquilibrium {
                    residual: g_next.norm(),
                });
            }
            if fresh && (long > 1.0 || g_next.norm() > 0.1 * g.norm()) {
                *jacobian = None;
            }
            fresh = false;
            x = next;
            g = g_next;
        }
        if g.norm() < 1e-8 {
            Ok(x)
        } else {
            Err(WireError::NoEquilibrium { residual: g.norm() })
        }
    }

    fn slope(
        &self,
        point: &V3,
        drag: f64,
        x: &Vector4<f64>,
        g: &Vector4<f64>,
        refine: usize,
    ) -> Matrix4<f64> {
        let mut j = Matrix4::zeros();
        let force_step = 1e-6 * x.xyz().norm().max(0.1 * self.force_scale(point));
        for k in 0..4 {
            // Forward differences: Newton needs the slope's direction, not its last digits.
            let h = if k == 3 { 1e-6 } else { force_step };
            let mut y = *x;
            y[k] += h;
            j.set_column(k, &((self.residual(point, drag, &y, refine) - g) / h));
        }
        j
    }

    /// First guess a little after touch: a straight cantilever's force along `direction`.
    pub fn touch(&self, arclength_mm: f64, push: &V3) -> Equilibrium {
        // Tip load of a straight cantilever: F = 3 EI w / s^3.
        let force_n = push * (3.0 * self.ei_nmm2 / arclength_mm.powi(3));
        let (at, tangent) = self.rest(arclength_mm);
        Equilibrium {
            force_n,
            arclength_mm,
            tangent,
            moment_nmm: at.cross(&force_n),
        }
    }
}

/// A walk along the loaded wire, element by element.
struct Walk<'a> {
    wire: &'a Wire,
    point: &'a V3,
    frame: M3,
    r: V3,
    /// Curvature of the last element.
    u: V3,
}

impl<'a> Walk<'a> {
    /// At the root, which turns with the moment of `force` at `point`.
    fn from_root(wire: &'a Wire, point: &'a V3, force: &V3) -> Self {
        // A clamp that gives turns in proportion to its moment, about y and z alone.
        let (base, [of_y, of_z]) = (point.cross(force), wire.root_compliance);
        Self {
            wire,
            point,
            frame: helix(&V3::new(0.0, of_y * base.y, of_z * base.z)).0,
            r: V3::zeros(),
            u: V3::zeros(),
        }
    }

    /// `count` elements between two arc lengths; `pass` hears where each ends.
    fn along(
        &mut self,
        force: &V3,
        [from, to]: [f64; 2],
        count: usize,
        curvature: f64,
        mut pass: impl FnMut(V3),
    ) {
        let h = (to - from) / count as f64;
        for i in 0..count {
            // The stiffness at an element's middle keeps the scheme of second order.
            let fraction = (from + (i as f64 + 0.5) * h) / self.wire.length_mm;
            let section = self.wire.section.as_ref();
            let factor = section.map_or(1.0, |s| s.stiffness(fraction));
            self.bend(force, curvature, h, factor);
            let (turn, chord) = helix(&(self.u * h));
            self.r += self.frame * (chord * h);
            self.frame *= turn;
            pass(self.r);
        }
    }

    /// Curvature of one element: fixed point of "elastic moment = mean applied moment".
    fn bend(&mut self, force: &V3, curvature: f64, h: f64, factor: f64) {
        let (ei, gj) = (self.wire.ei_nmm2 * factor, self.wire.gj_nmm2 * factor);
        for _ in 0..12 {
            let mut mean = V3::zeros();
            // Two Gauss points take the mean of a cubic exactly.
            for g in GAUSS {
                let (turn, chord) = helix(&(self.u * (h * g)));
                let at = self.r + self.frame * (chord * (h * g));
                mean += (self.frame * turn).tr_mul(&(self.point - at).cross(force)) * 0.5;
            }
            let mut bend = V3::new(0.0, mean.y / ei, mean.z / ei);
            let size = bend.norm();
            if let Some(section) = self.wire.section.as_ref().filter(|_| size > 0.0) {
                bend *= section.curvature(size) / size;
            }
            let next = V3::new(0.0, curvature, 0.0) + bend + V3::new(mean.x / gj, 0.0, 0.0);
            let change = (next - self.u).norm();
            self.u = next;
            if change < 1e-14 {
                break;
            }
        }
    }
}
