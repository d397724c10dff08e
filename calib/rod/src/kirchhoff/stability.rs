//! Second variation of the energy at an equilibrium: its smallest eigenvalue is positive where the wire holds still.
//!
//! With R -> R exp([eta]x) (body axes, clamped at the root) and the contact free to move by sigma along the wire,
//! L2 = 1/2 int du.D du + m.(du x eta) - n.(eta x (eta x e1)) ds - F.(sigma^2 t'/2 + sigma R (eta x e1)),
//! du = eta' + u x eta, under dr(s_c) + t sigma = 0. Quadratic elements with nodes at the quadrature points (Gauss-Lobatto) keep
//! the mass matrix (arc length) diagonal. Antman, "Nonlinear Problems of Elasticity", ch. VIII; Kumar & Healey, Int. J. Solids
//! Struct. 47 (2010).

use crate::dual::{Dual3, Scalar};
use crate::kirchhoff::integrate::{Load, to_arclength};
use crate::kirchhoff::solve::{Equilibrium, Guess, Rod};
use crate::se3::matrix_of;
use crate::shape::{Interval, Shape};
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix, Vector3};

/// What the groove does to the wire's material point while it is disturbed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hold {
    /// The wire slides through the groove: frictionless contact.
    Sliding,
    /// The material point stays: stick.
    Held,
}

/// A last piece shorter than this share of its interval joins the element before it.
const SLIVER: f64 = 0.05;

/// State at one node of an element.
struct Node {
    frame: Matrix3<f64>,
    u: Vector3<f64>,
    moment: Vector3<f64>,
    force: Vector3<f64>,
    stiffness: Matrix3<f64>,
}

impl Rod {
    /// Smallest eigenvalue (N: energy in N mm per rad^2 mm) of the second variation, the contact free to slide along the wire.
    /// Positive at a stable equilibrium. The root's compliance enters to first order in its turn; the free end's weight is rigid.
    pub fn smallest_eigenvalue(&self, equilibrium: &Equilibrium) -> f64 {
        self.smallest_eigenvalue_as(equilibrium, Hold::Sliding)
    }

    /// [`Self::smallest_eigenvalue`] for a contact that slides or sticks.
    pub fn smallest_eigenvalue_as(&self, equilibrium: &Equilibrium, hold: Hold) -> f64 {
        let elements = self.elements(equilibrium);
        let count = 3 * (2 * elements.len() + 1);
        let mut energy = DMatrix::<f64>::zeros(count, count);
        let mut mass = DVector::<f64>::zeros(count);
        // Displacement of the contact by the rotations.
        let mut reach = DMatrix::<f64>::zeros(3, count);
        for (j, (h, nodes)) in elements.iter().enumerate() {
            let local = element_energy(*h, nodes);
            let first = 6 * j;
            let mut block = energy.view_mut((first, first), (9, 9));
            block += local;
            // The quadrature points are the nodes: the mass is a diagonal of arc lengths.
            for (q, weight) in LOBATTO.iter().enumerate() {
                let at = first + 3 * q;
                for i in 0..3 {
                    mass[at + i] += weight * h;
                }
                // R (eta x e1) = -R [e1]x eta
                let turn = nodes[q].frame * Vector3::x().cross_matrix() * (-weight * h);
                let mut columns = reach.view_mut((0, at), (3, 3));
                columns += turn;
            }
        }
        let mut constraints: Vec<DVector<f64>> = Vec::new();
        self.hold_root(equilibrium, &elements, &mut energy, &mut constraints);
        let tangent = equilibrium.tangent;
        match hold {
            Hold::Held => constraints.extend((0..3).map(|i| reach.row(i).transpose())),
            Hold::Sliding => {
                let helper = if tangent.x.abs() < 0.7 {
                    Vector3::x()
                } else {
                    Vector3::y()
                };
                // Across the wire the contact is held, along it free: two constraints.
                let side = tangent.cross(&helper).normalize();
                for normal in [side, tangent.cross(&side)] {
                    constraints.push(reach.tr_mul(&DVector::from_column_slice(normal.as_slice())));
                }
                self.add_sliding(equilibrium, &elements, &reach, &mut energy);
            }
        }
        // y = sqrt(mass) eta makes it an ordinary eigenvalue problem.
        let root_mass = mass.map(f64::sqrt);
        for i in 0..count {
            for j in 0..count {
                energy[(i, j)] /= root_mass[i] * root_mass[j];
            }
        }
        for row in &mut constraints {
            row.component_div_assign(&root_mass);
        }
        smallest_on_null_space(energy, constraints)
    }

    /// Elements up to the contact: length and state at start, middle and end.
    fn elements(&self, equilibrium: &Equilibrium) -> Vec<(f64, [Node; 3])> {
        let s_c = equilibrium.arclength_mm;
        let mut pieces: Vec<Interval> = Vec::new();
        for interval in &self.shape.intervals {
            let room = s_c - interval.start_mm;
            if room <= 0.0 {
                break;
            }
            let length_mm = room.min(interval.length_mm);
            match pieces.last_mut() {
                Some(last) if room < SLIVER * interval.length_mm => last.length_mm += room,
                _ => pieces.push(Interval {
                    length_mm,
                    ..*interval
                }),
            }
        }
        // The integrator stops at the middles, too: every node of an element has its state.
        let halves = pieces.iter().flat_map(|p| {
            let h = 0.5 * p.length_mm;
            let middle = [0, 1, 2].map(|i| p.u_start[i] + p.u_slope[i] * h);
            [
                Interval { length_mm: h, ..*p },
                Interval {
                    start_mm: p.start_mm + h,
                    length_mm: h,
                    u_start: middle,
                    ..*p
                },
            ]
        });
        let mesh = Shape {
            intervals: halves.collect(),
            ..self.shape.clone()
        };
        let guess = Guess::from(equilibrium);
        let table = self.settled_weight(&equilibrium.point_mm, &guess);
        let load = Load {
            point: equilibrium.point_mm.into(),
            force: equilibrium.force_n.into(),
            distributed: table.as_ref(),
        };
        let mut states = Vec::with_capacity(mesh.intervals.len() + 1);
        to_arclength(
            &self.section,
            &mesh,
            self.root(&load),
            &load,
            s_c,
            |s, g| {
                states.push((s, Vector3::from(g.position), matrix_of(&g.frame)));
            },
        );
        let node = |state: &(f64, Vector3<f64>, Matrix3<f64>), piece: &Interval| {
            let (s, position, frame) = state;
            let mut moment = (equilibrium.point_mm - position).cross(&equilibrium.force_n);
            if let Some(table) = &table {
                moment += table.at(*s);
            }
            let moment = frame.transpose() * moment;
            let factor = self.section.taper_factor(s / self.shape.length_mm);
            let change = self
                .section
                .curvature_change(&[0, 1, 2].map(|i| Dual3::variable(moment[i], i)), factor);
            // d(du)/dm at this moment: a softened section yields more.
            let compliance = Matrix3::from_fn(|i, j| change[i].partial(j));
            let rest = |i: usize| piece.u_start[i] + piece.u_slope[i] * (s - piece.start_mm);
            Node {
                frame: *frame,
                u: Vector3::from([0, 1, 2].map(|i| change[i].value() + rest(i))),
                moment,
                force: frame.transpose()
                    * (equilibrium.force_n + self.weight_n_per_mm * (self.shape.length_mm - s)),
                // The law's tangent compliance is positive definite (material.rs bounds its slope).
                stiffness: compliance.try_inverse().unwrap_or_else(Matrix3::zeros),
            }
        };
        pieces
            .iter()
            .enumerate()
            .map(|(j, p)| (p.length_mm, [0, 1, 2].map(|q| node(&states[2 * j + q], p))))
            .collect()
    }

    /// Clamp, or the root's spring about the axes that give way.
    fn hold_root(
        &self,
        equilibrium: &Equilibrium,
        elements: &[(f64, [Node; 3])],
        energy: &mut DMatrix<f64>,
        constraints: &mut Vec<DVector<f64>>,
    ) {
        // The base's axes as the root sees them: about these it gives way.
        let frame = elements.first().map_or_else(
            || self.root_frame(&equilibrium.moment_nmm),
            |e| e.1[0].frame,
        );
        for i in 0..3 {
            let axis = frame.row(i).transpose();
            let compliance = self.compliance_rad_per_nmm * self.compliance_axes[i];
            if compliance == 0.0 {
                let mut row = DVector::zeros(energy.nrows());
                row.fixed_rows_mut::<3>(0).copy_from(&axis);
                constraints.push(row);
            } else {
                let mut block = energy.view_mut((0, 0), (3, 3));
                block += axis * axis.transpose() / compliance;
            }
        }
    }

    /// Terms of the contact's shift along the wire, sigma = -t.dr.
    fn add_sliding(
        &self,
        equilibrium: &Equilibrium,
        elements: &[(f64, [Node; 3])],
        reach: &DMatrix<f64>,
        energy: &mut DMatrix<f64>,
    ) {
        let Some((_, [.., end])) = elements.last() else {
            return;
        };
        let sigma = -reach.tr_mul(&DVector::from_column_slice(equilibrium.tangent.as_slice()));
        let tangent_rate = end.frame * end.u.cross(&Vector3::x());
        let mut turn = DVector::zeros(energy.nrows());
        let body_force = end.frame.transpose() * equilibrium.force_n;
        turn.fixed_rows_mut::<3>(energy.nrows() - 3)
            .copy_from(&Vector3::x().cross(&body_force));
        // -F . (sigma^2 t' / 2 + sigma R (eta x e1)), twice, as a symmetric form.
        energy.ger(-equilibrium.force_n.dot(&tangent_rate), &sigma, &sigma, 1.0);
        energy.ger(-1.0, &sigma, &turn, 1.0);
        energy.ger(-1.0, &turn, &sigma, 1.0);
    }
}

/// Gauss-Lobatto weights of an element of unit length; its points are the element's nodes.
const LOBATTO: [f64; 3] = [1.0 / 6.0, 4.0 / 6.0, 1.0 / 6.0];

/// Slopes of the three shape functions (columns) at the three nodes (rows), for unit length.
const SLOPES: [[f64; 3]; 3] = [[-3.0, 4.0, -1.0], [-1.0, 0.0, 1.0], [1.0, -4.0, 3.0]];

fn element_energy(h: f64, nodes: &[Node; 3]) -> SMatrix<f64, 9, 9> {
    let mut energy = SMatrix::<f64, 9, 9>::zeros();
    for (q, node) in nodes.iter().enumerate() {
        // du = slopes . eta + u x eta
        let mut change = SMatrix::<f64, 3, 9>::zeros();
        let mut here = SMatrix::<f64, 3, 9>::zeros();
        for (k, slope) in SLOPES[q].iter().enumerate() {
            change
                .fixed_view_mut::<3, 3>(0, 3 * k)
                .copy_from(&(Matrix3::identity() * (slope / h)));
        }
        here.fixed_view_mut::<3, 3>(0, 3 * q)
            .copy_from(&Matrix3::identity());
        change += node.u.cross_matrix() * here;
        let elastic = change.transpose() * node.stiffness * change;
        let coupling = -(change.transpose() * node.moment.cross_matrix() * here);
        let e1_force = Vector3::x() * node.force.transpose();
        let geometric =
            Matrix3::identity() * node.force.x - (e1_force + e1_force.transpose()) * 0.5;
        let load = here.transpose() * geometric * here;
        energy += (elastic + (coupling + coupling.transpose()) * 0.5 + load) * (LOBATTO[q] * h);
    }
    energy
}

/// Smallest eigenvalue of `matrix` on the space orthogonal to all `constraints`.
fn smallest_on_null_space(mut matrix: DMatrix<f64>, constraints: Vec<DVector<f64>>) -> f64 {
    let mut basis: Vec<DVector<f64>> = Vec::new();
    for row in constraints {
        let size = row.norm();
        let mut rest = row;
        // Twice is enough for Gram-Schmidt.
        for _ in 0..2 {
            for b in &basis {
                let share = b.dot(&rest);
                rest.axpy(-share, b, 1.0);
            }
        }
        // A straight wire's axial constraint is empty to first order.
        if rest.norm() > 1e-9 * size.max(f64::MIN_POSITIVE) && size > 1e-9 {
            basis.push(rest.normalize());
        }
    }
    // P A P + big Q Q^T: the constrained directions go to the top of the spectrum.
    let big = matrix.norm();
    for q in &basis {
        let image = &matrix * q;
        let own = q.dot(&image);
        matrix.ger(-1.0, &image, q, 1.0);
        matrix.ger(-1.0, q, &image, 1.0);
        matrix.ger(own + big, q, q, 1.0);
    }
    matrix.symmetric_eigenvalues().min()
}
