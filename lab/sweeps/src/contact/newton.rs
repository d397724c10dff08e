//! One step of sequential quadratic programming on the constrained energy.
//!
//! With gradient e, Hessian H (elastic, geometric of loads and contact forces, damping) and gap
//! rows a_i = grad g_i: min 1/2 phi . H phi + e . phi subject to g_i + a_i . phi >= 0, solved by
//! its dual: W f + b >= 0, f >= 0, f . (W f + b) = 0 with W_ik = a_i . H^-1 a_k, b_i = g_i - a_i .
//! H^-1 e; phi = H^-1 (sum f_i a_i - e). H = T + U diag(w) U^T: block tridiagonal plus few dyads
//! (contacts), inverted by Woodbury's identity; it is positive definite where the inertia of T and
//! of the small matrix diag(1/w) + U^T T^-1 U agree with that of w (E. Haynsworth, Linear Algebra
//! Appl. 1, 1968). Source: J. Nocedal & S. Wright, "Numerical Optimization" (2006), sec. 16.4 and
//! 18.1; projected Gauss-Seidel for the dual: R. Cottle, J.-S. Pang & R. Stone, "The Linear
//! Complementarity Problem" (2009), ch. 5.

use super::block_tridiagonal::BlockFactors;
use super::candidates::ContactCandidate;
use super::centre_line::CurvePoint;
use super::configuration::Configuration;
use super::rod::{Balance, ContactRod, load_stiffness};
use nalgebra::{DMatrix, DVector, Vector3};

/// Stiffness that holds a loaded contact to the surface, N/mm: far above the wire's own. It leaves
/// the solution where it is, and makes the energy convex where only the contact holds the wire
/// (augmented Lagrangian).
const AUGMENTATION_N_PER_MM: f64 = 1.0;
/// A gap that opens more slowly than this to both sides has no place that slides with the wire,
/// 1/mm.
const MIN_OPENING_PER_MM: f64 = 1e-4;
/// Sweeps of the dual problem.
const DUAL_SWEEPS: usize = 200;

pub(super) type Turns = Vec<Vector3<f64>>;

/// Turns of the links and contact forces.
pub(super) struct Step {
    pub turns: Turns,
    pub forces_n: Vec<f64>,
}

/// Stiffness under load: block tridiagonal, plus a few dyads from contacts that slide.
pub(super) struct Stiffness {
    factors: BlockFactors,
    dyads: Vec<Turns>,
    /// Inverse of the stiffness applied to the dyads, by the block part alone.
    solved: Vec<Turns>,
    small: Option<nalgebra::linalg::LU<f64, nalgebra::Dyn, nalgebra::Dyn>>,
}

pub(super) fn dot(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x.dot(y)).sum()
}

impl Stiffness {
    /// `None` where it is not positive definite (Haynsworth's inertia of the small matrix).
    pub(super) fn new(
        diagonal: &[nalgebra::Matrix3<f64>],
        before: &[nalgebra::Matrix3<f64>],
        dyads: Vec<(Turns, f64)>,
    ) -> Option<Self> {
        let factors = BlockFactors::new(diagonal, before)?;
        let (dyads, weights): (Vec<Turns>, Vec<f64>) =
            dyads.into_iter().filter(|d| d.1 != 0.0).unzip();
        let solved: Vec<Turns> = dyads
            .iter()
            .map(|d| {
                let mut z = d.clone();
                factors.solve(&mut z);
                z
            })
            .collect();
        if dyads.is_empty() {
            return (factors.negative == 0).then_some(Self {
                factors,
                dyads,
                solved,
                small: None,
            });
        }
        let small = DMatrix::from_fn(dyads.len(), dyads.len(), |i, j| {
            dot(&dyads[i], &solved[j]) + if i == j { 1.0 / weights[i] } else { 0.0 }
        });
        let symmetric = (&small + small.transpose()) * 0.5;
        let negative = symmetric
            .symmetric_eigenvalues()
            .iter()
            .filter(|v| **v < 0.0)
            .count();
        if factors.negative + negative != weights.iter().filter(|w| **w < 0.0).count() {
            return None;
        }
        Some(Self {
            factors,
            dyads,
            solved,
            small: Some(small.lu()),
        })
    }

    pub(super) fn solve(&self, mut x: Turns) -> Option<Turns> {
        self.factors.solve(&mut x);
        if let Some(small) = &self.small {
            // Woodbury's identity.
            let right =
                DVector::from_iterator(self.dyads.len(), self.dyads.iter().map(|d| dot(d, &x)));
            let shares = small.solve(&right)?;
            for (z, share) in self.solved.iter().zip(shares.iter()) {
                x.iter_mut().zip(z).for_each(|(x, z)| *x -= z * *share);
            }
        }
        Some(x)
    }
}

impl ContactCandidate {
    /// How the gap changes with the links' turns.
    fn row(&self, rod: &ContactRod, links: &Configuration) -> Turns {
        rod.displacement_row(links, &self.place, &self.closest.normal)
    }

    /// Dyads of the load on a contact on a curved surface, with their weights.
    ///
    /// Second order of the gap: dx . H dx - (n . dt + H t . dx)^2 / (t . H t + n . x''), the last
    /// where the contact slides.
    fn dyads(&self, rod: &ContactRod, links: &Configuration) -> Vec<(Turns, f64)> {
        let (normal, second) = (self.closest.normal, self.closest.second_per_mm);
        let mut dyads = Vec::new();
        let curved = second.amax() > 1e-9;
        if curved {
            let axes = second.symmetric_eigen();
            for (value, axis) in axes.eigenvalues.iter().zip(axes.eigenvectors.column_iter()) {
                if value.abs() > 1e-9 * second.amax() {
                    dyads.push((
                        rod.displacement_row(links, &self.place, &axis.into()),
                        -self.force_n * value,
                    ));
                }
            }
        }
        if self.slides {
            let tangent = self.place.tangent(links);
            let turn_per_mm = second * tangent;
            let opens_per_mm =
                turn_per_mm.dot(&tangent) + normal.dot(&self.place.bend_per_mm(links));
            if opens_per_mm > MIN_OPENING_PER_MM {
                let mut both = rod.displacement_row(links, &self.place, &turn_per_mm);
                for (j, share) in self.place.tangents() {
                    let tangent: Vector3<f64> = links.frames[j].column(0) * share;
                    both[j] += tangent.cross(&normal);
                }
                dyads.push((both, self.force_n / opens_per_mm));
            }
        }
        dyads
    }
}

impl ContactRod {
    /// How a place's coordinate along `direction` changes with the links' turns.
    pub(super) fn displacement_row(
        &self,
        links: &Configuration,
        place: &CurvePoint,
        direction: &Vector3<f64>,
    ) -> Turns {
        let mut row = vec![Vector3::zeros(); self.links()];
        for (j, share) in place.places() {
            let arm: Vector3<f64> = links.frames[j].column(0) * (share * self.link_mm);
            row[j] = arm.cross(direction);
        }
        row
    }

    /// Largest moment out of balance at a joint, N mm: that of all links beyond it.
    pub(super) fn imbalance_nmm(
        &self,
        gradient: &[Vector3<f64>],
        links: &Configuration,
        candidates: &[ContactCandidate],
    ) -> f64 {
        let mut rest = gradient.to_vec();
        for c in candidates.iter().filter(|c| c.force_n > 0.0) {
            rest.iter_mut()
                .zip(c.row(self, links))
                .for_each(|(r, row)| *r -= row * c.force_n);
        }
        let (mut beyond, mut largest) = (Vector3::zeros(), 0.0_f64);
        for moment in rest.iter().rev() {
            beyond += moment;
            largest = largest.max(beyond.norm());
        }
        largest
    }

    /// Newton's step; `None` where the stiffness is not positive definite at this damping.
    pub(super) fn newton_step(
        &self,
        balance: &Balance,
        links: &Configuration,
        candidates: &[ContactCandidate],
        damping: f64,
    ) -> Option<Step> {
        let mut diagonal = balance.diagonal.clone();
        let mut gradient = balance.gradient.clone();
        let mut dyads = balance.dyads.clone();
        // Loaded contacts: augmentation on the gap, geometric stiffness of their forces, and of the
        // surface's curvature.
        let rows: Vec<Turns> = candidates.iter().map(|c| c.row(self, links)).collect();
        for (c, row) in candidates
            .iter()
            .zip(&rows)
            .filter(|(c, _)| c.force_n > 0.0)
        {
            gradient
                .iter_mut()
                .zip(row)
                .for_each(|(g, r)| *g += r * (AUGMENTATION_N_PER_MM * c.gap_mm));
            dyads.push((row.clone(), AUGMENTATION_N_PER_MM));
            let force = c.closest.normal * c.force_n;
            for (j, share) in c.place.places() {
                let arm: Vector3<f64> = links.frames[j].column(0) * (share * self.link_mm);
                diagonal[j] += load_stiffness(&arm, &force);
            }
            dyads.extend(c.dyads(self, links));
        }
        // Levenberg damping in proportion to the elastic part.
        for (block, elastic) in diagonal.iter_mut().zip(&balance.diagonal) {
            *block += nalgebra::Matrix3::identity() * (damping * elastic.trace() / 3.0);
        }
        let stiffness = Stiffness::new(&diagonal, &balance.before, dyads)?;
        // The unconstrained step and the gaps that it would leave.
        let free = stiffness.solve(gradient)?;
        let free: Turns = free.iter().map(|v| -v).collect();
        let ahead: Vec<f64> = candidates
            .iter()
            .zip(&rows)
            .map(|(c, row)| c.gap_mm + dot(row, &free))
            .collect();
        // Places that the free wire would keep clear of take part only where the others push it
        // onto them.
        let mut taken: Vec<usize> = (0..candidates.len())
            .filter(|&k| candidates[k].force_n > 0.0 || ahead[k] < 0.0)
            .collect();
        let mut responses: Vec<Turns> = Vec::new();
        loop {
            for &k in &taken[responses.len()..] {
                responses.push(stiffness.solve(rows[k].clone())?);
            }
            let matrix: Vec<Vec<f64>> = taken
                .iter()
                .map(|&k| responses.iter().map(|z| dot(&rows[k], z)).collect())
                .collect();
            let gaps: Vec<f64> = taken.iter().map(|&k| ahead[k]).collect();
            let forces = solve_complementarity(
                &matrix,
                &gaps,
                taken.iter().map(|&k| candidates[k].force_n).collect(),
            );
            let mut turns = free.clone();
            for (z, force) in responses.iter().zip(&forces).filter(|(_, f)| **f > 0.0) {
                turns.iter_mut().zip(z).for_each(|(b, z)| *b += z * *force);
            }
            let violated: Vec<usize> = (0..candidates.len())
                .filter(|k| {
                    !taken.contains(k) && candidates[*k].gap_mm + dot(&rows[*k], &turns) < 0.0
                })
                .collect();
            if violated.is_empty() {
                let mut forces_n = vec![0.0; candidates.len()];
                taken
                    .iter()
                    .zip(&forces)
                    .for_each(|(&k, f)| forces_n[k] = *f);
                let finite = turns.iter().all(|t| t.iter().all(|x| x.is_finite()));
                return finite.then_some(Step { turns, forces_n });
            }
            taken.extend(violated);
        }
    }
}

/// Forces f >= 0 with `matrix f + gaps >= 0` and one of the two zero everywhere, by projected
/// Gauss-Seidel.
fn solve_complementarity(matrix: &[Vec<f64>], gaps: &[f64], mut forces: Vec<f64>) -> Vec<f64> {
    for _ in 0..DUAL_SWEEPS {
        let mut change = 0.0_f64;
        for (k, row) in matrix.iter().enumerate() {
            let rest: f64 =
                row.iter().zip(&forces).map(|(m, f)| m * f).sum::<f64>() - row[k] * forces[k];
            let force = if row[k] > 0.0 {
                (-(gaps[k] + rest) / row[k]).max(0.0)
            } else {
                0.0
            };
            change = change.max((force - forces[k]).abs());
            forces[k] = force;
        }
        if change < 1e-13 {
            break;
        }
    }
    forces
}
