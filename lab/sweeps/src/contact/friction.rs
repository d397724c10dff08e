//! Dry friction over one step of the body: Coulomb's law with the normal force lagged, and stick
//! where the cone is not reached.
//!
//! With slip u across the normal since the step before and y = |u| / eps: friction force -mu f_n
//! s(y) u/|u|, s = y (2 - y) for y < 1, else 1; its energy is mu f_n (|u| - eps/3) beyond eps and
//! mu f_n eps y^2 (1 - y/3) below.
//!
//! Within a round the contacts' places, normals and friction limits are those of the round before,
//! so that friction has an energy and Newton's method goes down it (M. Li et al., "Incremental
//! Potential Contact", ACM TOG 39, 2020, sec. 5). Rounds are repeated until the root's moment
//! stands still. A contact sticks where it slips by less than a small share of the body's step.

use super::centre_line::CurvePoint;
use super::configuration::Configuration;
use super::rod::{Balance, ContactRod, load_stiffness};
use super::surface::{Contact, ContactState, Surface};
use nalgebra::Vector3;

/// Most rounds, and the change of the root's moment (N mm) below which they end.
const ROUNDS: usize = 12;
const ROUND_NMM: f64 = 1e-4;
/// Round from which each takes the mean of its limits and the last ones: a strong coefficient would
/// swing between two states.
const RELAXED: usize = 4;
/// Slip within which a contact sticks, as a share of the body's step.
const STICK_SHARE: f64 = 0.02;

/// How a body friction that moved by one step.
#[derive(Debug, Clone, Copy)]
pub struct FrictionStep<'a> {
    /// Friction coefficient.
    pub coefficient: f64,
    /// The wire before the step.
    pub before: &'a Configuration,
    /// The body's step, mm.
    pub moved_mm: Vector3<f64>,
}

/// A contact that friction.
#[derive(Debug, Clone)]
pub(super) struct FrictionContact {
    place: CurvePoint,
    /// Where that place of the wire would be if it went with the body, mm.
    stuck_mm: Vector3<f64>,
    normal: Vector3<f64>,
    /// Largest friction force, N.
    limit_n: f64,
    /// Slip within which it sticks, mm.
    stick_mm: f64,
}

impl FrictionContact {
    /// Slip, mm, and the friction force over its limit with its slope per mm, at that slip.
    fn slip(&self, links: &Configuration) -> (Vector3<f64>, f64, f64) {
        let off = self.place.point_mm(links) - self.stuck_mm;
        let slip = off - self.normal * self.normal.dot(&off);
        let y = slip.norm() / self.stick_mm;
        if y >= 1.0 {
            return (slip, 1.0, 0.0);
        }
        (slip, (2.0 - y) * y, 2.0 * (1.0 - y) / self.stick_mm)
    }

    /// Force on the wire, N.
    fn force_n(&self, links: &Configuration) -> Vector3<f64> {
        let (slip, share, _) = self.slip(links);
        slip.try_normalize(1e-300)
            .map_or_else(Vector3::zeros, |along| -along * (self.limit_n * share))
    }

    fn moment_nmm(&self, links: &Configuration) -> Vector3<f64> {
        self.place.point_mm(links).cross(&self.force_n(links))
    }

    /// Adds energy, gradient and stiffness.
    fn add(&self, rod: &ContactRod, links: &Configuration, all: &mut Balance) {
        let (slip, share, slope) = self.slip(links);
        let (size, stick) = (slip.norm(), self.stick_mm);
        let y = size / stick;
        // Integral of s(y) over the slip.
        all.energy_nmm += self.limit_n
            * if y >= 1.0 {
                size - stick / 3.0
            } else {
                stick * y * y * (1.0 - y / 3.0)
            };
        let along = slip.try_normalize(1e-12).unwrap_or_else(|| {
            let x = if self.normal.x.abs() < 0.9 {
                Vector3::x()
            } else {
                Vector3::y()
            };
            self.normal.cross(&x).normalize()
        });
        let force = -along * (self.limit_n * share);
        for (g, row) in
            all.gradient
                .iter_mut()
                .zip(rod.displacement_row(links, &self.place, &-force))
        {
            *g += row;
        }
        for (j, part) in self.place.places() {
            let arm: Vector3<f64> = links.frames[j].column(0) * (part * rod.link_mm);
            all.diagonal[j] += load_stiffness(&arm, &force);
        }
        // Stiffness along the slip is s'(y) / eps, across it s(y) / |u|.
        let across = if y > 1e-9 { share / size } else { 2.0 / stick };
        for (axis, weight) in [(along, slope), (self.normal.cross(&along), across)] {
            all.dyads.push((
                rod.displacement_row(links, &self.place, &axis),
                self.limit_n * weight,
            ));
        }
    }
}

impl ContactRod {
    pub(super) fn frictional_balance(
        &self,
        links: &Configuration,
        friction: &[FrictionContact],
    ) -> Balance {
        let mut all = self.balance(links);
        friction
            .iter()
            .for_each(|contact| contact.add(self, links, &mut all));
        all
    }

    fn frictional_contacts(
        &self,
        contacts: &[Contact],
        how: &FrictionStep<'_>,
    ) -> Vec<FrictionContact> {
        let of = |c: &Contact| {
            let place = CurvePoint::new(c.arclength_mm / self.link_mm, self.links());
            FrictionContact {
                place,
                stuck_mm: place.point_mm(how.before) + how.moved_mm,
                normal: c.normal,
                limit_n: how.coefficient * c.force_n,
                stick_mm: STICK_SHARE * how.moved_mm.norm().max(1e-9),
            }
        };
        contacts
            .iter()
            .filter(|c| c.force_n > 0.0)
            .map(of)
            .collect()
    }

    /// Equilibrium against `surface`, which moved by `how.moved_mm` since the wire was at
    /// `how.before` with the contacts `known`, and friction. Each round is [`Self::solve_contact`],
    /// or with `penalty` [`Self::solve_penalty_contact`], of at most `max_iterations`.
    pub fn solve_frictional_contact<S: Surface>(
        &self,
        surface: &S,
        known: &[Contact],
        how: &FrictionStep<'_>,
        penalty: bool,
        max_iterations: usize,
    ) -> ContactState {
        let mut friction = self.frictional_contacts(known, how);
        let (mut start, mut contacts, mut moved) =
            (how.before.clone(), known.to_vec(), how.moved_mm);
        let mut iterations = 0;
        let mut round = 0;
        loop {
            let mut state = if penalty {
                self.solve_penalty_with(surface, &start, max_iterations, &friction)
            } else {
                self.solve_contact_with(
                    surface,
                    &start,
                    &contacts,
                    &moved,
                    max_iterations,
                    &friction,
                )
            };
            iterations += state.iterations;
            round += 1;
            let mut next = self.frictional_contacts(&state.contacts, how);
            let moment = |friction: &[FrictionContact]| -> Vector3<f64> {
                friction.iter().map(|r| r.moment_nmm(&state.links)).sum()
            };
            let stands = (moment(&next) - moment(&friction)).norm() < ROUND_NMM;
            if stands || !state.converged || round == ROUNDS {
                for (contact, friction) in state.contacts.iter_mut().zip(&next) {
                    contact.friction_n = friction.force_n(&state.links);
                }
                state.converged &= stands;
                state.iterations = iterations;
                return state;
            }
            if round >= RELAXED && friction.len() == next.len() {
                next.iter_mut()
                    .zip(&friction)
                    .for_each(|(n, r)| n.limit_n = (n.limit_n + r.limit_n) / 2.0);
            }
            (friction, start, contacts, moved) =
                (next, state.links, state.contacts, Vector3::zeros());
        }
    }
}
