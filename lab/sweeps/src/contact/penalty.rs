//! The same equilibrium by a penalty on overlap, for surfaces on which hard contacts hop: scans,
//! rough facets, many edges at once.
//!
//! E_p = E + 1/2 k int max(0, radius - d(r(s)))^2 ds with the signed distance d: one function to
//! minimise, and every step goes down it (damped Newton). The wire sinks in by some hundredths of a
//! millimetre at most; what the contacts carry is spread over their length. Source: P. Wriggers,
//! "Computational Contact Mechanics" (2006), ch. 6 (penalty method).

use super::centre_line::CurvePoint;
use super::configuration::Configuration;
use super::friction::FrictionContact;
use super::newton::{Stiffness, Turns, dot};
use super::rod::{ContactRod, load_stiffness};
use super::solve::{MAX_DAMPING, MAX_TURN_RAD, MIN_DAMPING};
use super::surface::{Contact, ContactState, Surface};
use nalgebra::{Matrix3, Vector3};

/// Stiffness of the contact along the wire, N/mm per mm of overlap.
const PENALTY_N_PER_MM2: f64 = 40.0;
/// Places a link at which overlap is evaluated.
const PLACES: usize = 16;
/// Moment that may be out of balance, N mm, and the turn of a link below which steps end, rad.
const BALANCE_NMM: f64 = 1e-3;
const TURN_RAD: f64 = 1e-7;
/// Longest way of a node in a step, links: no step passes through the wire's own radius unseen.
const MAX_WAY_LINKS: f64 = 0.5;

/// A place that overlaps.
struct Overlap {
    place: CurvePoint,
    normal: Vector3<f64>,
    second_per_mm: Matrix3<f64>,
    point_mm: Vector3<f64>,
    overlap_mm: f64,
    /// Force, N, and its change with the overlap, N/mm.
    force_n: f64,
    stiffness_n_per_mm: f64,
}

struct State {
    links: Configuration,
    overlaps: Vec<Overlap>,
    energy_nmm: f64,
}

impl ContactRod {
    /// Equilibrium against `surface` from a place where the wire overlaps it by less than its
    /// radius.
    pub fn solve_penalty_contact<S: Surface>(
        &self,
        surface: &S,
        start: &Configuration,
        max_iterations: usize,
    ) -> ContactState {
        self.solve_penalty_with(surface, start, max_iterations, &[])
    }

    pub(super) fn solve_penalty_with<S: Surface>(
        &self,
        surface: &S,
        start: &Configuration,
        max_iterations: usize,
        friction: &[FrictionContact],
    ) -> ContactState {
        let mut state = self.evaluate_penalty(surface, start.clone(), friction);
        let mut damping = 0.0_f64;
        for iteration in 1..=max_iterations {
            let raised = (damping * 6.0).max(MIN_DAMPING);
            let (gradient, turns) = self.penalty_step(&state, damping, friction);
            let imbalance = imbalance_nmm(&gradient);
            let Some(turns) = turns else {
                damping = raised;
                continue;
            };
            let largest = turns.iter().map(Vector3::norm).fold(0.0, f64::max);
            if imbalance < BALANCE_NMM && (largest < TURN_RAD * (1.0 + damping) || damping > 1.0) {
                return self.finish_penalty(state, iteration, true);
            }
            let way_mm = self.way_mm(&state.links, &turns);
            let scale = (MAX_TURN_RAD / largest.max(1e-300))
                .min(MAX_WAY_LINKS * self.link_mm / way_mm.max(1e-300))
                .min(1.0);
            let turns: Turns = turns.iter().map(|t| t * scale).collect();
            let next = self.evaluate_penalty(surface, self.rotated(&state.links, &turns), friction);
            if next.energy_nmm <= state.energy_nmm + 1e-13 * (1.0 + state.energy_nmm.abs()) {
                damping = if damping <= MIN_DAMPING {
                    0.0
                } else {
                    damping / 4.0
                };
                state = next;
            } else if damping > MAX_DAMPING {
                let balanced = imbalance < BALANCE_NMM;
                return self.finish_penalty(state, iteration, balanced);
            } else {
                damping = raised;
            }
        }
        let (gradient, _) = self.penalty_step(&state, 1.0, friction);
        let balanced = imbalance_nmm(&gradient) < BALANCE_NMM;
        self.finish_penalty(state, max_iterations, balanced)
    }

    /// Energy and overlaps at a configuration.
    fn evaluate_penalty<S: Surface>(
        &self,
        surface: &S,
        links: Configuration,
        friction: &[FrictionContact],
    ) -> State {
        let n = self.links();
        let near_mm = self.radius_mm + 0.6 * self.link_mm;
        let share_mm = self.link_mm / PLACES as f64;
        let mut overlaps = Vec::new();
        for j in 0..n {
            let middle = self.middles[j].point_mm(&links);
            if surface.closest_point(&middle, near_mm).is_none() {
                continue;
            }
            for k in 0..PLACES {
                let place = CurvePoint::new(j as f64 + (k as f64 + 0.5) / PLACES as f64, n);
                let Some(closest) = surface.closest_point(&place.point_mm(&links), self.radius_mm)
                else {
                    continue;
                };
                let overlap_mm = self.radius_mm - closest.distance_mm;
                // The tip's half sphere carries what presses along the wire.
                let stiffness_n_per_mm = PENALTY_N_PER_MM2 * share_mm;
                overlaps.push(Overlap {
                    place,
                    normal: closest.normal,
                    second_per_mm: closest.second_per_mm,
                    point_mm: closest.point_mm,
                    overlap_mm,
                    force_n: stiffness_n_per_mm * overlap_mm,
                    stiffness_n_per_mm,
                });
            }
        }
        let stored: f64 = overlaps
            .iter()
            .map(|t| 0.5 * t.force_n * t.overlap_mm)
            .sum();
        let energy_nmm = self.frictional_balance(&links, friction).energy_nmm + stored;
        State {
            links,
            overlaps,
            energy_nmm,
        }
    }

    /// Gradient, and Newton's step; no step where the stiffness is not positive definite at this
    /// damping.
    fn penalty_step(
        &self,
        state: &State,
        damping: f64,
        friction: &[FrictionContact],
    ) -> (Turns, Option<Turns>) {
        let balance = self.frictional_balance(&state.links, friction);
        let (mut gradient, mut diagonal) = (balance.gradient, balance.diagonal.clone());
        let mut dyads = balance.dyads;
        // A place that overlaps: its force, the force's geometric stiffness, the penalty's own, and
        // the surface's curvature.
        for t in &state.overlaps {
            let row = self.displacement_row(&state.links, &t.place, &t.normal);
            gradient
                .iter_mut()
                .zip(&row)
                .for_each(|(g, r)| *g -= r * t.force_n);
            for (j, share) in t.place.places() {
                let arm: Vector3<f64> = state.links.frames[j].column(0) * (share * self.link_mm);
                diagonal[j] += load_stiffness(&arm, &(t.normal * t.force_n));
            }
            dyads.push((row, t.stiffness_n_per_mm));
            if t.second_per_mm.amax() > 1e-9 {
                let axes = t.second_per_mm.symmetric_eigen();
                for (value, axis) in axes.eigenvalues.iter().zip(axes.eigenvectors.column_iter()) {
                    if value.abs() > 1e-9 * t.second_per_mm.amax() {
                        dyads.push((
                            self.displacement_row(&state.links, &t.place, &axis.into()),
                            -t.force_n * value,
                        ));
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
        // A descent direction, whatever rounding does.
        let step = step.filter(|x| dot(x, &gradient) <= 0.0);
        (gradient, step)
    }

    /// Places that touch next to each other are one contact.
    fn finish_penalty(&self, state: State, iterations: usize, converged: bool) -> ContactState {
        let mut contacts: Vec<Contact> = Vec::new();
        let mut groups: Vec<Vec<&Overlap>> = Vec::new();
        for t in &state.overlaps {
            match groups.last_mut() {
                Some(group)
                    if group
                        .last()
                        .is_some_and(|g| t.place.at - g.place.at < 2.5 / PLACES as f64) =>
                {
                    group.push(t);
                }
                _ => groups.push(vec![t]),
            }
        }
        for group in groups {
            let force: Vector3<f64> = group.iter().map(|t| t.normal * t.force_n).sum();
            let Some(deepest) = group.iter().max_by(|a, b| a.force_n.total_cmp(&b.force_n)) else {
                continue;
            };
            // Where the force acts: the mean of the places by what they carry.
            let carried: f64 = group.iter().map(|t| t.force_n).sum();
            let share = |t: &Overlap| t.force_n / carried.max(1e-300);
            contacts.push(Contact {
                arclength_mm: group.iter().map(|t| t.place.at * share(t)).sum::<f64>()
                    * self.link_mm,
                centre_mm: group
                    .iter()
                    .map(|t| t.place.point_mm(&state.links) * share(t))
                    .sum(),
                point_mm: deepest.point_mm,
                normal: force.try_normalize(1e-300).unwrap_or(deepest.normal),
                force_n: force.norm(),
                friction_n: Vector3::zeros(),
                gap_mm: -deepest.overlap_mm,
            });
        }
        let overlap_mm = state
            .overlaps
            .iter()
            .map(|t| t.overlap_mm)
            .fold(0.0, f64::max);
        ContactState {
            links: state.links,
            contacts,
            converged,
            iterations,
            overlap_mm,
        }
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
