//! Newton's method on the constrained energy: the step is accepted by an augmented Lagrangian as
//! merit function.
//!
//! Merit of a configuration x with gaps g_i and the step's forces f_i: M(x) = E(x) + sum_(f_i > 0)
//! f_i g_i (g_i / 2 g_0 - 1) + w sum_(f_i = 0) max(0, -g_i), w = 1.5 max f_i. Where M does not
//! fall, the step is damped (Levenberg: the Hessian's diagonal grows by mu times its elastic part),
//! or what it ran into is added as plane constraints. Source: J. Nocedal & S. Wright, "Numerical
//! Optimization" (2006), ch. 17-18.

use super::candidates::ContactCandidate;
use super::centre_line::CurvePoint;
use super::configuration::Configuration;
use super::friction::FrictionContact;
use super::rod::ContactRod;
use super::surface::{Contact, ContactState, Surface};
use nalgebra::{Matrix3, Vector3};
use wcal_mesh::ClosestPoint;

/// Balance is reached below this turn of a link, rad, and this overlap, mm.
const TURN_RAD: f64 = 1e-7;
const OVERLAP_MM: f64 = 1e-5;
/// On a surface of small facets the contact hops between their edges; a wire that only trembles by
/// less than this (mm) over so many steps, overlapping less than that, has come to rest.
const CHATTER_MM: f64 = 5e-3;
const MAX_CHATTER_STEPS: usize = 8;
const CHATTER_OVERLAP_MM: f64 = 3e-3;
/// Moment that may be out of balance at a joint, N mm: a quarter of a bench's noise.
const BALANCE_NMM: f64 = 2e-3;
/// Largest turn of a link in a step, rad, and largest way of a node, in links: no farther than
/// contacts are foreseen.
pub(super) const MAX_TURN_RAD: f64 = 0.2;
const MAX_WAY_LINKS: f64 = 1.5;
/// Damping as a share of the elastic stiffness: the least, and where it is given up.
pub(super) const MIN_DAMPING: f64 = 1e-5;
const REPLANE_DAMPING: f64 = 1e-2;
pub(super) const MAX_DAMPING: f64 = 1e4;
/// Most places that are treated together, and the gap (mm) up to which a plane that was met counts
/// as touched.
const MAX_CANDIDATES: usize = 40;
const PLANE_MM: f64 = 0.02;
/// Places closer than this (links) whose normals differ by less are one: two facets, and others.
const SAME_FACET: [f64; 2] = [0.05, 0.01];
const SAME_PLACE: [f64; 2] = [0.1, 0.1];
/// A loaded place that comes back no farther away (links) has turned to another facet; farther, it
/// has slid.
const TURNED_LINKS: f64 = 0.1;
/// Gap at which the augmented Lagrangian's square is as large as its linear part, mm.
const GAP_SCALE_MM: f64 = 0.01;

#[derive(Clone)]
struct State {
    links: Configuration,
    candidates: Vec<ContactCandidate>,
}

impl State {
    fn overlap_mm(&self) -> f64 {
        self.candidates.iter().map(|c| (-c.gap_mm).max(0.0)).sum()
    }
}

/// Augmented Lagrangian of the contacts that carry a force; overlap of the others, weighted above
/// the forces.
///
/// A contact that a step lifts a little (second order) does not make the step a bad one, as it
/// would with overlaps alone.
fn penalty_nmm(candidates: &[ContactCandidate], weight_n: f64) -> f64 {
    let of = |c: &ContactCandidate| {
        if c.force_n > 0.0 {
            c.force_n * c.gap_mm * (c.gap_mm / (2.0 * GAP_SCALE_MM) - 1.0)
        } else {
            weight_n * (-c.gap_mm).max(0.0)
        }
    };
    candidates.iter().map(of).sum()
}

impl ContactRod {
    /// Equilibrium against `surface`, from `start`, whose contacts were `known` before the body
    /// moved by `moved_mm`.
    ///
    /// Where it is lost, damping makes the steps a walk down the energy, and with enough of them
    /// the wire springs to another.
    pub fn solve_contact<S: Surface>(
        &self,
        surface: &S,
        start: &Configuration,
        known: &[Contact],
        moved_mm: &Vector3<f64>,
        max_iterations: usize,
    ) -> ContactState {
        self.solve_contact_with(surface, start, known, moved_mm, max_iterations, &[])
    }

    /// Moment at the root, N mm.
    pub fn base_moment_nmm(&self, pressed: &ContactState) -> Vector3<f64> {
        let along = pressed.links.clamp.column(0) * self.link_mm;
        let beyond = |c: &Contact| {
            // The clamp's share in the contact's place is an arm that no link has.
            let share = CurvePoint::new(c.arclength_mm / self.link_mm, self.links()).clamp_share();
            (along * share).cross(&(c.normal * c.force_n + c.friction_n))
        };
        self.root_spring_nmm(&pressed.links)
            + pressed.contacts.iter().map(beyond).sum::<Vector3<f64>>()
    }

    pub(super) fn solve_contact_with<S: Surface>(
        &self,
        surface: &S,
        start: &Configuration,
        known: &[Contact],
        moved_mm: &Vector3<f64>,
        max_iterations: usize,
        friction: &[FrictionContact],
    ) -> ContactState {
        // The first step keeps the side of the surface on which the wire was.
        let mut state = State {
            links: start.clone(),
            candidates: self.transported(known, moved_mm),
        };
        if state.candidates.is_empty() {
            state.candidates = self.candidates(surface, start, &[]);
        }
        let mut balance = self.frictional_balance(&state.links, friction);
        let (mut damping, mut weight, mut chatter_steps) = (0.0_f64, 0.0_f64, 0);
        for iteration in 1..=max_iterations {
            let raised = (damping * 8.0).max(MIN_DAMPING);
            let Some(step) = self.newton_step(&balance, &state.links, &state.candidates, damping)
            else {
                damping = raised;
                if damping > MAX_DAMPING {
                    return self.finish(state, iteration, false);
                }
                continue;
            };
            let largest = step.turns.iter().map(Vector3::norm).fold(0.0, f64::max);
            let way_mm = self.way_mm(&state.links, &step.turns);
            let scale = (MAX_TURN_RAD / largest.max(1e-300))
                .min(MAX_WAY_LINKS * self.link_mm / way_mm.max(1e-300))
                .min(1.0);
            let turns: Vec<_> = step.turns.iter().map(|phi| phi * scale).collect();
            let links = self.rotated(&state.links, &turns);
            let mut carriers = state.candidates.clone();
            carriers
                .iter_mut()
                .zip(&step.forces_n)
                .for_each(|(c, f)| c.force_n = *f);
            let seen = self.candidates(surface, &links, &carriers);
            let candidates = self.carry_over(surface.faceted(), &links, &carriers, seen);
            let next = State { links, candidates };
            let next_balance = self.frictional_balance(&next.links, friction);
            weight = step.forces_n.iter().fold(weight, |w, f| w.max(1.5 * f));
            let old = balance.energy_nmm + penalty_nmm(&carriers, weight);
            let new = next_balance.energy_nmm + penalty_nmm(&next.candidates, weight);
            // The first step goes from the body's old place to its new one: nothing to compare
            // with.
            if iteration > 1 && new > old + 1e-10 * (1.0 + old.abs()) && largest > 1e-6 {
                if !self.add_planes(&mut state, &next) {
                    damping = raised;
                }
                if damping > MAX_DAMPING {
                    return self.finish(state, iteration, false);
                }
                continue;
            }
            damping = if damping <= MIN_DAMPING {
                0.0
            } else {
                damping / 8.0
            };
            state = next;
            balance = next_balance;
            let overlap_mm = state.overlap_mm();
            chatter_steps = if way_mm < CHATTER_MM && overlap_mm < CHATTER_OVERLAP_MM {
                chatter_steps + 1
            } else {
                0
            };
            let still = chatter_steps > MAX_CHATTER_STEPS
                || (largest < TURN_RAD && overlap_mm < OVERLAP_MM);
            if iteration > 1
                && still
                && self.imbalance_nmm(&balance.gradient, &state.links, &state.candidates)
                    < BALANCE_NMM
            {
                if self.planes_hold(surface, &state) {
                    return self.finish(state, iteration, true);
                }
                // The planes were met too far away: shorter steps meet them where they are.
                state.candidates.retain(|c| !c.plane_constraint);
                damping = raised.max(REPLANE_DAMPING);
            }
        }
        self.finish(state, max_iterations, false)
    }

    /// Takes what a refused step ran into as planes that the next one must keep clear of; false
    /// where that is known already.
    ///
    /// Where the wire lies in a notch, or over several edges of a link, the lowest place alone does
    /// not tell of the others.
    fn add_planes(&self, state: &mut State, refused: &State) -> bool {
        let mut learned = false;
        for c in refused
            .candidates
            .iter()
            .filter(|c| c.gap_mm < -OVERLAP_MM && !c.plane_constraint)
        {
            let known = |k: &ContactCandidate| {
                (k.place.at - c.place.at).abs() < SAME_FACET[0]
                    && (k.closest.normal - c.closest.normal).norm() < SAME_FACET[1]
            };
            if state.candidates.len() < MAX_CANDIDATES && !state.candidates.iter().any(known) {
                let plane = ContactCandidate {
                    plane_constraint: true,
                    slides: false,
                    force_n: 0.0,
                    ..c.clone()
                };
                state
                    .candidates
                    .push(self.plane_constraint_at(&state.links, plane));
                learned = true;
            }
        }
        learned
    }

    /// The gap to the plane of a place that a refused step met.
    fn plane_constraint_at(
        &self,
        links: &Configuration,
        mut plane: ContactCandidate,
    ) -> ContactCandidate {
        let centre_mm = plane.place.point_mm(links);
        plane.gap_mm += plane.closest.normal.dot(&(centre_mm - plane.centre_mm));
        plane.centre_mm = centre_mm;
        plane.closest.second_per_mm = Matrix3::zeros();
        // The wire slides over the plane: it is touched below the place where the wire is now.
        let normal = plane.closest.normal.normalize();
        plane.closest.point_mm = centre_mm - normal * (plane.gap_mm + self.radius_mm);
        plane
    }

    /// Gives the forces of `carriers` to the places `seen` now, with the planes that are still
    /// touched and seen no more.
    ///
    /// Between two facets a wire's end is held by both, and the surface shows but the nearer: the
    /// other one would be lost, and the wire hop between them for ever.
    fn carry_over(
        &self,
        faceted: bool,
        links: &Configuration,
        carriers: &[ContactCandidate],
        mut seen: Vec<ContactCandidate>,
    ) -> Vec<ContactCandidate> {
        let places = seen.len();
        // Facets next to each other differ by little and are two all the same; on a smooth body
        // what is seen is where it is.
        let close = if faceted { SAME_FACET } else { SAME_PLACE };
        for c in carriers.iter().filter(|c| c.force_n > 0.0) {
            let off = |s: &ContactCandidate| (s.place.at - c.place.at).abs();
            let same = |s: &ContactCandidate| {
                off(s) < close[0] && (s.closest.normal - c.closest.normal).norm() < close[1]
            };
            let plane = self.plane_constraint_at(
                links,
                ContactCandidate {
                    plane_constraint: true,
                    slides: false,
                    ..c.clone()
                },
            );
            let touched = plane.gap_mm.abs() < PLANE_MM;
            let known = seen[..places].iter().position(same);
            let heir = (0..places).min_by(|&a, &b| off(&seen[a]).total_cmp(&off(&seen[b])));
            let facet = faceted && c.closest.second_per_mm == Matrix3::zeros();
            let turned = facet && heir.is_none_or(|h| off(&seen[h]) < TURNED_LINKS);
            if known.is_none() && touched && (c.plane_constraint || turned) {
                seen.push(plane);
                continue;
            }
            let heir = heir.filter(|&h| !c.plane_constraint && off(&seen[h]) < 3.0);
            if let Some(heir) = known.filter(|_| faceted).or(heir) {
                seen[heir].force_n += c.force_n;
            }
        }
        seen
    }

    /// Whether the surface is where the loaded planes are.
    fn planes_hold<S: Surface>(&self, surface: &S, state: &State) -> bool {
        state
            .candidates
            .iter()
            .filter(|c| c.plane_constraint && c.force_n > 0.0)
            .all(|c| {
                let lies = |at: &Vector3<f64>, mm: f64| {
                    let closest = surface.closest_point(at, 2.0 * self.link_mm);
                    closest.is_some_and(|n| (n.distance_mm - mm).abs() < CHATTER_OVERLAP_MM)
                };
                // Past an edge the wire may be as near to the next facet, and the plane's own place
                // is nowhere.
                lies(&c.centre_mm, self.radius_mm) && lies(&c.closest.point_mm, 0.0)
            })
    }

    /// Longest way of a node in a step, mm.
    pub(super) fn way_mm(&self, links: &Configuration, turns: &[Vector3<f64>]) -> f64 {
        let (mut way, mut longest) = (Vector3::zeros(), 0.0_f64);
        for (frame, turn) in links.frames.iter().zip(turns) {
            way += turn.cross(&Vector3::from(frame.column(0))) * self.link_mm;
            longest = longest.max(way.norm());
        }
        longest
    }

    fn finish(&self, state: State, iterations: usize, converged: bool) -> ContactState {
        let contacts = state
            .candidates
            .iter()
            .filter(|c| c.force_n > 0.0)
            .map(|c| Contact {
                arclength_mm: c.place.at * self.link_mm,
                centre_mm: c.place.point_mm(&state.links),
                point_mm: c.closest.point_mm,
                normal: c.closest.normal.normalize(),
                force_n: c.force_n * c.closest.normal.norm(),
                friction_n: Vector3::zeros(),
                gap_mm: c.gap_mm,
            })
            .collect();
        let overlap_mm = state.overlap_mm();
        ContactState {
            links: state.links,
            contacts,
            converged,
            iterations,
            overlap_mm,
        }
    }

    fn transported(&self, known: &[Contact], moved_mm: &Vector3<f64>) -> Vec<ContactCandidate> {
        known
            .iter()
            .map(|c| ContactCandidate {
                place: CurvePoint::new(c.arclength_mm / self.link_mm, self.links()),
                closest: ClosestPoint {
                    distance_mm: self.radius_mm + c.gap_mm,
                    normal: c.normal,
                    point_mm: c.point_mm + moved_mm,
                    second_per_mm: Matrix3::zeros(),
                },
                gap_mm: c.gap_mm - c.normal.dot(moved_mm),
                centre_mm: c.centre_mm,
                force_n: c.force_n,
                slides: false,
                plane_constraint: false,
            })
            .collect()
    }
}
