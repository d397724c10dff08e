//! Dry friction over one step of the body: Coulomb's law with the normal force lagged, and stick where the cone is not reached.
//!
//! Within a round the contacts' places, normals and friction limits are those of the round before, so that friction has an energy and
//! Newton's method goes down it (M. Li et al., "Incremental Potential Contact", ACM TOG 39, 2020, sec. 5). Rounds are repeated until the
//! root's moment stands still. A contact sticks where it slips by less than a small share of the body's step.

use super::curve::Spot;
use super::{Contact, Pressed, Surface};
use crate::chain::{Balance, Chain, Links, pull_stiffness};
use nalgebra::Vector3;

/// Most rounds, and the change of the root's moment (N mm) below which they end.
const ROUNDS: usize = 12;
const ROUND_NMM: f64 = 1e-4;
/// Round from which each takes the mean of its limits and the last ones: a strong coefficient would swing between two states.
const RELAXED: usize = 4;
/// Slip within which a contact sticks, as a share of the body's step.
const STICK_SHARE: f64 = 0.02;

/// How a body rubs that moved by one step.
#[derive(Debug, Clone, Copy)]
pub struct Rubbing<'a> {
    /// Friction coefficient.
    pub coefficient: f64,
    /// The wire before the step.
    pub before: &'a Links,
    /// The body's step, mm.
    pub moved_mm: Vector3<f64>,
}

/// A contact that rubs.
#[derive(Debug, Clone)]
pub(super) struct Rub {
    spot: Spot,
    /// Where that place of the wire would be if it went with the body, mm.
    stuck_mm: Vector3<f64>,
    normal: Vector3<f64>,
    /// Largest friction force, N.
    limit_n: f64,
    /// Slip within which it sticks, mm.
    stick_mm: f64,
}

impl Rub {
    /// Slip, mm, and the friction force over its limit with its slope per mm, at that slip.
    fn slip(&self, chain: &Chain, links: &Links) -> (Vector3<f64>, f64, f64) {
        let off = self.spot.point_mm(chain, links) - self.stuck_mm;
        let slip = off - self.normal * self.normal.dot(&off);
        let y = slip.norm() / self.stick_mm;
        if y >= 1.0 {
            return (slip, 1.0, 0.0);
        }
        (slip, (2.0 - y) * y, 2.0 * (1.0 - y) / self.stick_mm)
    }

    /// Force on the wire, N.
    fn force_n(&self, chain: &Chain, links: &Links) -> Vector3<f64> {
        let (slip, share, _) = self.slip(chain, links);
        slip.try_normalize(1e-300).map_or_else(Vector3::zeros, |along| -along * (self.limit_n * share))
    }

    fn moment_nmm(&self, chain: &Chain, links: &Links) -> Vector3<f64> {
        self.spot.point_mm(chain, links).cross(&self.force_n(chain, links))
    }

    /// Adds energy, gradient and stiffness.
    fn add(&self, chain: &Chain, links: &Links, all: &mut Balance) {
        let (slip, share, slope) = self.slip(chain, links);
        let (size, stick) = (slip.norm(), self.stick_mm);
        let y = size / stick;
        // Integral of the share of the limit over the slip.
        all.energy_nmm +=
            self.limit_n * if y >= 1.0 { size - stick / 3.0 } else { stick * y * y * (1.0 - y / 3.0) };
        let along = slip.try_normalize(1e-12).unwrap_or_else(|| {
            let x = if self.normal.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() };
            self.normal.cross(&x).normalize()
        });
        let force = -along * (self.limit_n * share);
        for (g, row) in all.gradient.iter_mut().zip(chain.shifts(links, &self.spot, &-force)) {
            *g += row;
        }
        for (j, part) in self.spot.places() {
            let arm: Vector3<f64> = links.frames[j].column(0) * (part * chain.link_mm);
            all.diagonal[j] += pull_stiffness(&arm, &force);
        }
        let across = if y > 1e-9 { share / size } else { 2.0 / stick };
        for (axis, weight) in [(along, slope), (self.normal.cross(&along), across)] {
            all.dyads.push((chain.shifts(links, &self.spot, &axis), self.limit_n * weight));
        }
    }
}

impl Chain {
    pub(super) fn rubbed_balance(&self, links: &Links, rubs: &[Rub]) -> Balance {
        let mut all = self.balance(links);
        rubs.iter().for_each(|rub| rub.add(self, links, &mut all));
        all
    }

    fn rubs(&self, contacts: &[Contact], how: &Rubbing<'_>) -> Vec<Rub> {
        let of = |c: &Contact| {
            let spot = Spot::new(c.arclength_mm / self.link_mm, self.links());
            Rub {
                spot,
                stuck_mm: spot.point_mm(self, how.before) + how.moved_mm,
                normal: c.normal,
                limit_n: how.coefficient * c.force_n,
                stick_mm: STICK_SHARE * how.moved_mm.norm().max(1e-9),
            }
        };
        contacts.iter().filter(|c| c.force_n > 0.0).map(of).collect()
    }

    /// Equilibrium against `surface`, which moved by `how.moved_mm` since the wire was at `how.before` with the contacts `known`, and
    /// rubs. Each round is [`Self::press`], or with `softly` [`Self::press_softly`], of at most `most_iterations`.
    #[must_use]
    pub fn press_rubbing<S: Surface>(
        &self,
        surface: &S,
        known: &[Contact],
        how: &Rubbing<'_>,
        softly: bool,
        most_iterations: usize,
    ) -> Pressed {
        let mut rubs = self.rubs(known, how);
        let (mut start, mut contacts, mut moved) = (how.before.clone(), known.to_vec(), how.moved_mm);
        let mut iterations = 0;
        let mut round = 0;
        loop {
            let mut pressed = if softly {
                self.press_softly_with(surface, &start, most_iterations, &rubs)
            } else {
                self.press_with(surface, &start, &contacts, &moved, most_iterations, &rubs)
            };
            iterations += pressed.iterations;
            round += 1;
            let mut next = self.rubs(&pressed.contacts, how);
            let moment = |rubs: &[Rub]| -> Vector3<f64> {
                rubs.iter().map(|r| r.moment_nmm(self, &pressed.links)).sum()
            };
            let stands = (moment(&next) - moment(&rubs)).norm() < ROUND_NMM;
            if stands || !pressed.converged || round == ROUNDS {
                for (contact, rub) in pressed.contacts.iter_mut().zip(&next) {
                    contact.friction_n = rub.force_n(self, &pressed.links);
                }
                pressed.converged &= stands;
                pressed.iterations = iterations;
                return pressed;
            }
            if round >= RELAXED && rubs.len() == next.len() {
                next.iter_mut().zip(&rubs).for_each(|(n, r)| n.limit_n = (n.limit_n + r.limit_n) / 2.0);
            }
            (rubs, start, contacts, moved) = (next, pressed.links, pressed.contacts, Vector3::zeros());
        }
    }
}
