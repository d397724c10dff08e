//! The same equilibrium by a soft contact, for surfaces on which hard contacts hop: scans, rough facets, many edges at once.
//!
//! Overlap costs energy along the wire, so that there is one function to minimise and every step goes down. The wire sinks in by some
//! hundredths of a millimetre at most; what the contacts carry is spread over their length.

use super::curve::Spot;
use super::newton::{Stiffness, Turns, dot};
use super::rub::Rub;
use super::{Contact, LEAST_DAMPING, MAX_TURN_RAD, MOST_DAMPING, Pressed, Surface};
use crate::chain::{Chain, Links, pull_stiffness};
use nalgebra::{Matrix3, Vector3};

/// Stiffness of the contact along the wire, N/mm per mm of overlap.
const SOFT_N_PER_MM2: f64 = 40.0;
/// Places a link at which overlap is looked for.
const PLACES: usize = 16;
/// Moment that may be out of balance, N mm, and the turn of a link below which steps end, rad.
const BALANCE_NMM: f64 = 1e-3;
const TURN_RAD: f64 = 1e-7;
/// Longest way of a node in a step, links: no step passes through the wire's own radius unseen.
const MAX_WAY_LINKS: f64 = 0.5;

/// A place that overlaps.
struct Touch {
    spot: Spot,
    normal: Vector3<f64>,
    second_per_mm: Matrix3<f64>,
    point_mm: Vector3<f64>,
    overlap_mm: f64,
    /// Force, N, and its change with the overlap, N/mm.
    force_n: f64,
    stiffness_n_per_mm: f64,
}

struct State {
    links: Links,
    touches: Vec<Touch>,
    energy_nmm: f64,
}

impl Chain {
    /// Equilibrium against `surface` from a place where the wire overlaps it by less than its radius.
    #[must_use]
    pub fn press_softly<S: Surface>(&self, surface: &S, start: &Links, most_iterations: usize) -> Pressed {
        self.press_softly_with(surface, start, most_iterations, &[])
    }

    pub(super) fn press_softly_with<S: Surface>(
        &self,
        surface: &S,
        start: &Links,
        most_iterations: usize,
        rubs: &[Rub],
    ) -> Pressed {
        let mut state = self.softly(surface, start.clone(), rubs);
        let mut damping = 0.0_f64;
        for iteration in 1..=most_iterations {
            let raised = (damping * 6.0).max(LEAST_DAMPING);
            let (gradient, turns) = self.soft_step(&state, damping, rubs);
            let imbalance = imbalance_nmm(&gradient);
            let Some(turns) = turns else {
                damping = raised;
                continue;
            };
            let largest = turns.iter().map(Vector3::norm).fold(0.0, f64::max);
            if imbalance < BALANCE_NMM && (largest < TURN_RAD * (1.0 + damping) || damping > 1.0) {
                return self.soft_end(state, iteration, true);
            }
            let way_mm = self.way_mm(&state.links, &turns);
            let scale = (MAX_TURN_RAD / largest.max(1e-300))
                .min(MAX_WAY_LINKS * self.link_mm / way_mm.max(1e-300))
                .min(1.0);
            let turns: Turns = turns.iter().map(|t| t * scale).collect();
            let next = self.softly(surface, self.turned(&state.links, &turns), rubs);
            if next.energy_nmm <= state.energy_nmm + 1e-13 * (1.0 + state.energy_nmm.abs()) {
                damping = if damping <= LEAST_DAMPING { 0.0 } else { damping / 4.0 };
                state = next;
            } else if damping > MOST_DAMPING {
                let balanced = imbalance < BALANCE_NMM;
                return self.soft_end(state, iteration, balanced);
            } else {
                damping = raised;
            }
        }
        let (gradient, _) = self.soft_step(&state, 1.0, rubs);
        let balanced = imbalance_nmm(&gradient) < BALANCE_NMM;
        self.soft_end(state, most_iterations, balanced)
    }

    fn softly<S: Surface>(&self, surface: &S, links: Links, rubs: &[Rub]) -> State {
        let n = self.links();
        let near_mm = self.radius_mm + 0.6 * self.link_mm;
        let share_mm = self.link_mm / PLACES as f64;
        let mut touches = Vec::new();
        for j in 0..n {
            let middle = self.middles[j].point_mm(self, &links);
            if surface.near(&middle, near_mm).is_none() {
                continue;
            }
            for k in 0..PLACES {
                let spot = Spot::new(j as f64 + (k as f64 + 0.5) / PLACES as f64, n);
                let Some(near) = surface.near(&spot.point_mm(self, &links), self.radius_mm) else { continue };
                let overlap_mm = self.radius_mm - near.distance_mm;
                // The tip's half sphere carries what presses along the wire.
                let stiffness_n_per_mm = SOFT_N_PER_MM2 * share_mm;
                touches.push(Touch {
                    spot,
                    normal: near.normal,
                    second_per_mm: near.second_per_mm,
                    point_mm: near.point_mm,
                    overlap_mm,
                    force_n: stiffness_n_per_mm * overlap_mm,
                    stiffness_n_per_mm,
                });
            }
        }
        let stored: f64 = touches.iter().map(|t| 0.5 * t.force_n * t.overlap_mm).sum();
        let energy_nmm = self.rubbed_balance(&links, rubs).energy_nmm + stored;
        State { links, touches, energy_nmm }
    }

    /// Gradient, and Newton's step; no step where the stiffness is not positive definite at this damping.
    fn soft_step(&self, state: &State, damping: f64, rubs: &[Rub]) -> (Turns, Option<Turns>) {
        let balance = self.rubbed_balance(&state.links, rubs);
        let (mut gradient, mut diagonal) = (balance.gradient, balance.diagonal.clone());
        let mut dyads = balance.dyads;
        for t in &state.touches {
            let row = self.shifts(&state.links, &t.spot, &t.normal);
            gradient.iter_mut().zip(&row).for_each(|(g, r)| *g -= r * t.force_n);
            for (j, share) in t.spot.places() {
                let arm: Vector3<f64> = state.links.frames[j].column(0) * (share * self.link_mm);
                diagonal[j] += pull_stiffness(&arm, &(t.normal * t.force_n));
            }
            dyads.push((row, t.stiffness_n_per_mm));
            if t.second_per_mm.amax() > 1e-9 {
                let axes = t.second_per_mm.symmetric_eigen();
                for (value, axis) in axes.eigenvalues.iter().zip(axes.eigenvectors.column_iter()) {
                    if value.abs() > 1e-9 * t.second_per_mm.amax() {
                        dyads.push((self.shifts(&state.links, &t.spot, &axis.into()), -t.force_n * value));
                    }
                }
            }
        }
        for (block, elastic) in diagonal.iter_mut().zip(&balance.diagonal) {
            *block += Matrix3::identity() * (damping * elastic.trace() / 3.0);
        }
        let step = Stiffness::new(&diagonal, &balance.before, dyads)
            .and_then(|s| s.solve(gradient.clone()))
            .map(|x| x.iter().map(|v| -v).collect::<Turns>())
            .filter(|x| x.iter().all(|v| v.iter().all(|c| c.is_finite())));
        // Down the hill, whatever rounding does.
        let step = step.filter(|x| dot(x, &gradient) <= 0.0);
        (gradient, step)
    }

    /// Places that touch next to each other are one contact.
    fn soft_end(&self, state: State, iterations: usize, converged: bool) -> Pressed {
        let mut contacts: Vec<Contact> = Vec::new();
        let mut groups: Vec<Vec<&Touch>> = Vec::new();
        for t in &state.touches {
            match groups.last_mut() {
                Some(group) if group.last().is_some_and(|g| t.spot.at - g.spot.at < 2.5 / PLACES as f64) => {
                    group.push(t);
                }
                _ => groups.push(vec![t]),
            }
        }
        for group in groups {
            let force: Vector3<f64> = group.iter().map(|t| t.normal * t.force_n).sum();
            let Some(deepest) = group.iter().max_by(|a, b| a.force_n.total_cmp(&b.force_n)) else { continue };
            // Where the force acts: the mean of the places by what they carry.
            let carried: f64 = group.iter().map(|t| t.force_n).sum();
            let share = |t: &Touch| t.force_n / carried.max(1e-300);
            contacts.push(Contact {
                arclength_mm: group.iter().map(|t| t.spot.at * share(t)).sum::<f64>() * self.link_mm,
                centre_mm: group.iter().map(|t| t.spot.point_mm(self, &state.links) * share(t)).sum(),
                point_mm: deepest.point_mm,
                normal: force.try_normalize(1e-300).unwrap_or(deepest.normal),
                force_n: force.norm(),
                friction_n: Vector3::zeros(),
                gap_mm: -deepest.overlap_mm,
            });
        }
        let overlap_mm = state.touches.iter().map(|t| t.overlap_mm).fold(0.0, f64::max);
        Pressed { links: state.links, contacts, converged, iterations, overlap_mm }
    }
}

/// Largest moment out of balance at a joint, N mm.
fn imbalance_nmm(gradient: &[Vector3<f64>]) -> f64 {
    let (mut beyond, mut largest) = (Vector3::zeros(), 0.0_f64);
    for moment in gradient.iter().rev() {
        beyond += moment;
        largest = largest.max(beyond.norm());
    }
    largest
}
