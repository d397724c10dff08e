//! One equilibrium: the wire held at a point by the V-groove, by Newton's method on shooting.
//!
//! Unknown are the contact force F and its arc length s_c; r(s; F) and t(s; F) follow by
//! integration from the clamp: r(s_c; F) - P = 0, and one tangential condition: F . t = 0
//! (frictionless), s_c given (stick), or F . t = rho |F_perp| (slip). The Jacobian is exact:
//! derivatives by F through the integrator (forward mode), dr/ds = t, dt/ds = R (u x e1). Weight w
//! per length enters by its moment M_w(s) = int_s^L (r(a) - r(s)) x w da, frozen, and taken anew on
//! the solved shape. Source: S. S. Antman, "Nonlinear Problems of Elasticity" (2005), ch. VIII;
//! shooting: J. Stoer & R. Bulirsch, "Introduction to Numerical Analysis" (2002), sec. 7.3.

use crate::RodError;
use crate::dual::{Dual3, Scalar, V3, cross};
use crate::kirchhoff::integrate::{Load, MomentTable, to_arclength};
use crate::material::Section;
use crate::se3::{self, Pose, matrix_of, rows_of};
use crate::shape::{Shape, from_arclength, hermite};
use nalgebra::{Matrix3, Matrix4, Rotation3, Vector3, Vector4};
use wcal_core::observation::WhiskerSpec;

/// Default mesh interval, mm: base moments are right to about 1e-7 of their size there
/// (tests/acceptance/).
pub const WORKING_STEP_MM: f64 = 2.0;

/// Point of the loaded wire at arc length `s_mm` (mm) between its nodes (arc length, position,
/// frame; two at least), whose tangents are known.
///
/// Between nodes j and j + 1 with x = (s - s_j) / h, positions p and unit tangents t (cubic Hermite
/// interpolation):
///
/// ```text
/// p(s) = p_j (2x^3 - 3x^2 + 1) + h t_j (x^3 - 2x^2 + x) + p_j+1 (3x^2 - 2x^3) + h t_j+1 (x^3 - x^2)
/// ```
pub fn interpolated_point(nodes: &[(f64, Vector3<f64>, Matrix3<f64>)], s_mm: f64) -> Vector3<f64> {
    let j = nodes
        .partition_point(|n| n.0 <= s_mm)
        .clamp(1, nodes.len() - 1);
    let (a, b) = (&nodes[j - 1], &nodes[j]);
    let h = b.0 - a.0;
    if h <= 0.0 {
        return b.1;
    }
    hermite((s_mm - a.0) / h, h, (a.1, a.2), (b.1, b.2))
}

/// The wire, its clamp and its surroundings.
#[derive(Debug, Clone, PartialEq)]
pub struct Rod {
    /// Rest shape on its mesh.
    pub shape: Shape,
    /// Section stiffness.
    pub section: Section,
    /// Rotation of the root per base moment, rad/(N mm); [`Self::compliance_axes`] weights the base
    /// axes.
    pub compliance_rad_per_nmm: f64,
    /// Relative compliance about the base axes x, y, z.
    pub compliance_axes: Vector3<f64>,
    /// Weight less buoyancy per length, N/mm, base frame; zero unless gravity is declared.
    pub weight_n_per_mm: Vector3<f64>,
}

/// What holds along the wire at the contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Tangential {
    /// F . t = 0.
    Frictionless,
    /// The contact stays at this arc length, mm (stick).
    Stick(f64),
    /// F . t = ratio |F_perp| (slip).
    Ratio(f64),
}

/// An equilibrium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Equilibrium {
    /// Groove point, mm.
    pub point_mm: Vector3<f64>,
    /// Contact force on the wire, N.
    pub force_n: Vector3<f64>,
    /// Arc length of the contact, mm.
    pub arclength_mm: f64,
    /// Wire tangent at the contact.
    pub tangent: Vector3<f64>,
    /// Base moment r x F, N mm, weight included.
    pub moment_nmm: Vector3<f64>,
    /// Determinant of the scaled equations; it changes sign where the equilibrium loses or regains
    /// stability.
    pub determinant: f64,
    /// Newton iterations spent.
    pub iterations: usize,
}

/// Why no equilibrium came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Failure {
    /// Newton did not converge.
    NotConverged,
    /// The equations are singular here: a fold or a branching point.
    Singular,
    /// The contact would lie past the tip.
    PastTip,
}

/// Contact force and arc length: the unknowns, and a guess for them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guess {
    /// N.
    pub force_n: Vector3<f64>,
    /// mm.
    pub arclength_mm: f64,
}

impl From<&Equilibrium> for Guess {
    fn from(e: &Equilibrium) -> Self {
        Self {
            force_n: e.force_n,
            arclength_mm: e.arclength_mm,
        }
    }
}

const MAX_ITERATIONS: usize = 14;
const TOLERANCE_MM: f64 = 1e-10;

impl Rod {
    /// Rod of a whisker's nominal properties on a mesh of `step_mm`.
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn new(spec: &WhiskerSpec, step_mm: f64) -> Result<Self, RodError> {
        Ok(Self {
            shape: Shape::new(&spec.rest_shape, step_mm)?,
            section: Section::round(spec.diameter_mm, spec.youngs_gpa, spec.shear_gpa),
            compliance_rad_per_nmm: 0.0,
            compliance_axes: Vector3::new(0.0, 1.0, 1.0),
            weight_n_per_mm: Vector3::zeros(),
        })
    }

    /// Adds weight less buoyancy: `(rho_wire - rho_fluid) A g`.
    pub fn with_weight(mut self, spec: &WhiskerSpec, fluid_kg_m3: f64) -> Self {
        const GRAVITY_M_S2: f64 = 9.806_65;
        if let (Some(direction), Some(density)) = (spec.gravity_direction, spec.density_kg_m3) {
            // kg/m^3 m^2 m/s^2 is N/m.
            let area_m2 = std::f64::consts::PI * (spec.diameter_mm * 1e-3).powi(2) / 4.0;
            self.weight_n_per_mm =
                direction * ((density - fluid_kg_m3) * area_m2 * GRAVITY_M_S2 * 1e-3);
        }
        self
    }

    /// The same rod with its weight, turned about its root; none where its clamp yields, which is
    /// given about the axes of the base.
    pub fn turned(&self, turn: &Rotation3<f64>) -> Option<Self> {
        let shape = self.shape.turned(turn);
        let weight_n_per_mm = turn * self.weight_n_per_mm;
        (self.compliance_rad_per_nmm == 0.0).then(|| Self {
            shape,
            weight_n_per_mm,
            ..self.clone()
        })
    }

    /// The same rod with `by_mm` more wire beyond the tip ([`Shape::extended`]); its taper goes on
    /// as it is.
    pub fn extended(&self, by_mm: f64) -> Self {
        let mut rod = self.clone();
        rod.shape = self.shape.extended(by_mm);
        if self.section.taper != 0.0 {
            // The diameter goes on linearly; EI goes with its fourth power.
            let end = (1.0 + self.section.taper).max(1e-3).powf(0.25);
            let end = 1.0 + (end - 1.0) * rod.shape.length_mm / self.shape.length_mm;
            rod.section.taper = end.max(1e-3).powi(4) - 1.0;
        }
        rod
    }

    /// Clamp of the loaded wire, turned by the root's compliance.
    fn root<T: Scalar>(&self, load: &Load<T>) -> Pose<T> {
        let frame = rows_of(&self.shape.root);
        let frame = [0, 1, 2].map(|i| [0, 1, 2].map(|j| T::constant(frame[i][j])));
        let position = [T::constant(0.0); 3];
        if self.compliance_rad_per_nmm == 0.0 {
            return Pose { frame, position };
        }
        // The root carries P x F and gives way in proportion, about each base axis.
        let m = cross(&load.point, &load.force);
        let turn: V3<T> =
            [0, 1, 2].map(|i| m[i].scale(self.compliance_rad_per_nmm * self.compliance_axes[i]));
        let turned = se3::turn(&turn, &frame);
        Pose {
            frame: turned,
            position,
        }
    }

    /// Pose of the loaded wire at an arc length.
    pub(crate) fn end<T: Scalar>(&self, load: &Load<T>, s_mm: f64) -> Pose<T> {
        let root = self.root(load);
        to_arclength(&self.section, &self.shape, root, load, s_mm, |_, _| {})
    }

    /// Equilibrium with the wire's centre at `point_mm`, from a nearby guess.
    ///
    /// # Errors
    /// A [`Failure`] where there is none near the guess.
    pub fn solve(
        &self,
        point_mm: &Vector3<f64>,
        guess: &Guess,
        tangential: Tangential,
    ) -> Result<Equilibrium, Failure> {
        if self.weight_n_per_mm.norm() == 0.0 {
            return self.newton(point_mm, guess, tangential, None);
        }
        // The weight bends the wire by little: its moment is frozen, the wire solved, and the
        // moment taken anew.
        let unloaded = Guess {
            force_n: Vector3::zeros(),
            ..*guess
        };
        let mut table = self.weight_moments(point_mm, &unloaded, None);
        let mut current = *guess;
        for _ in 0..12 {
            let found = self.newton(point_mm, &current, tangential, Some(&table))?;
            // Force times its arm: by how much the base moment still changes, N mm.
            let change = (found.force_n - current.force_n).norm() * point_mm.norm();
            current = Guess::from(&found);
            table = self.weight_moments(point_mm, &current, Some(&table));
            if change < 1e-11 {
                break;
            }
        }
        let mut found = self.newton(point_mm, &current, tangential, Some(&table))?;
        // The root carries the wire's weight, too.
        found.moment_nmm += table.moments_nmm[0];
        Ok(found)
    }

    fn newton(
        &self,
        point_mm: &Vector3<f64>,
        guess: &Guess,
        tangential: Tangential,
        distributed: Option<&MomentTable>,
    ) -> Result<Equilibrium, Failure> {
        let (mut force, mut s) = (guess.force_n, guess.arclength_mm);
        if let Tangential::Stick(fixed) = tangential {
            s = fixed;
        }
        // Forces are compared as moments at the contact so that all four unknowns have the size of
        // millimetres.
        let force_scale = self.section.ei_nmm2 / s.max(1.0).powi(2);
        for iteration in 1..=MAX_ITERATIONS {
            let (residual, jacobian, tangent) =
                self.equations(point_mm, &force, s, tangential, distributed, force_scale);
            let Some(step) = jacobian.lu().solve(&residual) else {
                return Err(Failure::Singular);
            };
            // A longer step leaves the basin of the nearby equilibrium.
            let limit = (0.3 * self.shape.length_mm / step.norm()).min(1.0);
            force -= step.fixed_rows::<3>(0) * (limit * force_scale);
            s -= step[3] * limit;
            if !(s > 0.0 && force.norm().is_finite()) {
                return Err(Failure::NotConverged);
            }
            // Where rounding keeps the residual up, a step of no length ends it as well.
            if residual.norm() < TOLERANCE_MM || (step.norm() < 1e-9 && residual.norm() < 1e-6) {
                if s > self.shape.length_mm {
                    return Err(Failure::PastTip);
                }
                return Ok(Equilibrium {
                    point_mm: *point_mm,
                    force_n: force,
                    arclength_mm: s,
                    tangent,
                    moment_nmm: point_mm.cross(&force),
                    determinant: jacobian.determinant(),
                    iterations: iteration,
                });
            }
        }
        Err(Failure::NotConverged)
    }

    /// Residual (mm; the fourth scaled to mm), its derivatives by (force / scale, s), and the
    /// tangent at the contact.
    pub(crate) fn equations(
        &self,
        point_mm: &Vector3<f64>,
        force: &Vector3<f64>,
        s: f64,
        tangential: Tangential,
        distributed: Option<&MomentTable>,
        force_scale: f64,
    ) -> (Vector4<f64>, Matrix4<f64>, Vector3<f64>) {
        let load = Load {
            point: [0, 1, 2].map(|i| Dual3::constant(point_mm[i])),
            force: [0, 1, 2].map(|i| Dual3::variable(force[i], i)),
            distributed,
        };
        let end = self.end(&load, s);
        let position = Vector3::from(end.position.map(Scalar::value));
        let tangent_dual = [0, 1, 2].map(|i| end.frame[i][0]);
        let tangent = Vector3::from(tangent_dual.map(Scalar::value));
        // By the force through the integrator, by s along the curve.
        let d_tangent = Matrix3::from_fn(|i, j| tangent_dual[i].partial(j));
        let curvature = self.tangent_rate(point_mm, force, s, &position, &end.frame, distributed);
        // Row 4, the force along the wire: with F the tangent turns as well, with s by dt/ds.
        let along = force.dot(&tangent);
        let d_along_force = tangent + d_tangent.transpose() * force;
        let d_along_s = force.dot(&curvature);
        let (fourth, row, by_s) = match tangential {
            Tangential::Frictionless => (along, d_along_force, d_along_s),
            // A contact that sticks: row 4 reads ds = 0.
            Tangential::Stick(_) => (0.0, Vector3::zeros(), force_scale),
            Tangential::Ratio(ratio) => {
                // F.t = ratio |F_perp| is F.t = ratio/sqrt(1 + ratio^2) |F|, smooth away from F =
                // 0.
                let c = ratio / (1.0 + ratio * ratio).sqrt();
                let norm = force.norm().max(1e-300);
                (
                    along - c * norm,
                    d_along_force - force * (c / norm),
                    d_along_s,
                )
            }
        };
        // Rows 1 to 3: the contact is at P; dr/ds = t.
        let jacobian = Matrix4::from_fn(|i, j| match (i, j) {
            (3, 3) => by_s / force_scale,
            (3, _) => row[j],
            (_, 3) => tangent[i],
            _ => end.position[i].partial(j) * force_scale,
        });
        // Miss of the groove in mm, and the condition along the wire as a length.
        let residual = (position - point_mm).push(fourth / force_scale);
        (residual, jacobian, tangent)
    }

    /// dt/ds at the contact.
    fn tangent_rate(
        &self,
        point: &Vector3<f64>,
        force: &Vector3<f64>,
        s: f64,
        position: &Vector3<f64>,
        frame: &[[Dual3; 3]; 3],
        distributed: Option<&MomentTable>,
    ) -> Vector3<f64> {
        let frame = matrix_of(&frame.map(|row| row.map(Scalar::value)));
        // The moment at the contact itself: the force has no arm there, weight has.
        let mut moment = (point - position).cross(force);
        if let Some(table) = distributed {
            moment += table.at(s);
        }
        let body: [f64; 3] = (frame.transpose() * moment).into();
        let du = self
            .section
            .curvature_change(&body, self.section.taper_factor(s / self.shape.length_mm));
        let interval = &self.shape.intervals[self.shape.interval_at(s)];
        let offset = s - interval.start_mm;
        let u = Vector3::from(
            [0, 1, 2].map(|i| du[i] + interval.u_start[i] + interval.u_slope[i] * offset),
        );
        frame * u.cross(&Vector3::x())
    }

    /// Nodes of the loaded wire from root to tip: (arc length, position, frame).
    pub fn loaded_shape(
        &self,
        equilibrium: &Equilibrium,
    ) -> Vec<(f64, Vector3<f64>, Matrix3<f64>)> {
        let guess = Guess::from(equilibrium);
        let table = self.settled_weight(&equilibrium.point_mm, &guess);
        self.nodes(&equilibrium.point_mm, &guess, table.as_ref())
    }

    /// Moments of the weight on the shape that it and the contact give the wire; none without
    /// weight.
    fn settled_weight(&self, point: &Vector3<f64>, held: &Guess) -> Option<MomentTable> {
        if self.weight_n_per_mm.norm() == 0.0 {
            return None;
        }
        let mut table = self.weight_moments(point, held, None);
        // Fixed point: a round shrinks the change by about w L^3 / EI.
        for _ in 0..6 {
            table = self.weight_moments(point, held, Some(&table));
        }
        Some(table)
    }

    fn nodes(
        &self,
        point: &Vector3<f64>,
        held: &Guess,
        distributed: Option<&MomentTable>,
    ) -> Vec<(f64, Vector3<f64>, Matrix3<f64>)> {
        let loaded = Load {
            point: (*point).into(),
            force: held.force_n.into(),
            distributed,
        };
        let mut nodes = Vec::with_capacity(self.shape.intervals.len() + 2);
        let mut push =
            |s: f64, g: &Pose<f64>| nodes.push((s, Vector3::from(g.position), matrix_of(&g.frame)));
        let contact = to_arclength(
            &self.section,
            &self.shape,
            self.root(&loaded),
            &loaded,
            held.arclength_mm,
            &mut push,
        );
        // Past the contact the wire carries only its own weight: its rest curvature goes on from
        // there.
        let free = Load {
            point: [0.0; 3],
            force: [0.0; 3],
            distributed,
        };
        let rest = Shape {
            intervals: from_arclength(&self.shape, held.arclength_mm),
            ..self.shape.clone()
        };
        to_arclength(
            &self.section,
            &rest,
            contact,
            &free,
            self.shape.length_mm,
            |s, g| {
                if s > held.arclength_mm {
                    push(s, g);
                }
            },
        );
        nodes
    }

    /// Moment about each s of the weight beyond it, on a 0.5 mm grid.
    fn weight_moments(
        &self,
        point: &Vector3<f64>,
        held: &Guess,
        previous: Option<&MomentTable>,
    ) -> MomentTable {
        const GRID_MM: f64 = 0.5;
        let nodes = self.nodes(point, held, previous);
        let count = (self.shape.length_mm / GRID_MM).ceil() as usize;
        let step_mm = self.shape.length_mm / count as f64;
        let position = |s: f64| interpolated_point(&nodes, s);
        // M(s) = (integral of r beyond s - r(s) (L - s)) x w, trapezoid on the grid.
        let mut moments_nmm = vec![Vector3::zeros(); count + 1];
        let mut integral = Vector3::zeros();
        let mut later = position(self.shape.length_mm);
        for j in (0..count).rev() {
            let here = position(j as f64 * step_mm);
            // Trapezoid rule from the tip inward.
            integral += (here + later) * (0.5 * step_mm);
            let beyond = self.shape.length_mm - j as f64 * step_mm;
            moments_nmm[j] = (integral - here * beyond).cross(&self.weight_n_per_mm);
            later = here;
        }
        MomentTable {
            step_mm,
            moments_nmm,
        }
    }

    /// Base moment of the free wire's weight, N mm.
    pub fn rest_moment_nmm(&self) -> Vector3<f64> {
        let free = Guess {
            force_n: Vector3::zeros(),
            arclength_mm: self.shape.length_mm,
        };
        let table = self.settled_weight(&Vector3::zeros(), &free);
        table.map_or_else(Vector3::zeros, |table| table.moments_nmm[0])
    }
}
