//! A wire pressed by a body of any shape: quasi-static, any number of contacts, with friction where asked for.
//!
//! Newton's method on the constrained energy (sequential quadratic programming): the wire's gaps to the surface are linear in the link
//! rotations at each step, the contact forces follow from the small dual problem. The surface is seen through its signed distance only;
//! how a contact slides enters the stiffness (the minimum of the distance along the wire moves with the wire).

mod candidates;
pub(crate) mod curve;
mod newton;
mod rub;
mod soft;

use crate::chain::{Chain, Links};
use candidates::Candidate;
use curve::Spot;
use nalgebra::{Matrix3, Vector3};
use rub::Rub;
pub use rub::Rubbing;

/// What a surface tells of a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Near {
    /// Signed distance, mm: negative inside. A surface may smooth it.
    pub distance_mm: f64,
    /// Its gradient: away from the surface; shorter than 1 where the distance is smoothed.
    pub normal: Vector3<f64>,
    /// Nearest point of the surface, mm.
    pub point_mm: Vector3<f64>,
    /// Second derivative of the distance, 1/mm.
    pub second_per_mm: Matrix3<f64>,
}

/// A body in the frame of the wire's root.
pub trait Surface {
    /// The surface near a point; `None` where it is farther than `within_mm`.
    fn near(&self, point_mm: &Vector3<f64>, within_mm: f64) -> Option<Near>;

    /// Whether it is made of flat facets.
    fn faceted(&self) -> bool {
        false
    }
}

/// A contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Place on the centre line from the root, mm.
    pub arclength_mm: f64,
    /// That place, mm.
    pub centre_mm: Vector3<f64>,
    /// Point of the surface, mm.
    pub point_mm: Vector3<f64>,
    /// Direction of the force on the wire.
    pub normal: Vector3<f64>,
    /// Force on the wire along it, N.
    pub force_n: f64,
    /// Friction force on the wire, N; across the normal.
    pub friction_n: Vector3<f64>,
    /// Distance of the centre line from the surface less the wire's radius, mm.
    pub gap_mm: f64,
}

/// A wire at rest against a body.
#[derive(Debug, Clone, PartialEq)]
pub struct Pressed {
    /// Links.
    pub links: Links,
    /// Contacts that carry a force, from the root on.
    pub contacts: Vec<Contact>,
    /// Whether balance and contact were reached.
    pub converged: bool,
    /// Newton steps tried.
    pub iterations: usize,
    /// How far the wire overlaps the body, all contacts together, mm.
    pub overlap_mm: f64,
}

/// Balance is reached below this turn of a link, rad, and this overlap, mm.
const TURN_RAD: f64 = 1e-7;
const OVERLAP_MM: f64 = 1e-5;
/// On a surface of small facets the contact hops between their edges; a wire that only trembles by less than this (mm) over so many
/// steps, overlapping less than that, has come to rest.
const TREMBLE_MM: f64 = 5e-3;
const TREMBLES: usize = 8;
const TREMBLE_OVERLAP_MM: f64 = 3e-3;
/// Moment that may be out of balance at a joint, N mm: a quarter of a bench's noise.
const BALANCE_NMM: f64 = 2e-3;
/// Largest turn of a link in a step, rad, and largest way of a node, in links: no farther than contacts are foreseen.
const MAX_TURN_RAD: f64 = 0.2;
const MAX_WAY_LINKS: f64 = 1.5;
/// Damping as a share of the elastic stiffness: the least, and where it is given up.
const LEAST_DAMPING: f64 = 1e-5;
const REMEET_DAMPING: f64 = 1e-2;
const MOST_DAMPING: f64 = 1e4;
/// Most places that are looked at together, and the gap (mm) up to which a plane that was met counts as touched.
const MOST_CANDIDATES: usize = 40;
const PLANE_MM: f64 = 0.02;
/// Places closer than this (links) whose normals differ by less are one: two facets, and others.
const SAME_FACET: [f64; 2] = [0.05, 0.01];
const SAME_PLACE: [f64; 2] = [0.1, 0.1];
/// A loaded place that comes back no farther away (links) has turned to another facet; farther, it has slid.
const TURNED_LINKS: f64 = 0.1;
/// Gap at which the augmented Lagrangian's square is as large as its linear part, mm.
const GAP_SCALE_MM: f64 = 0.01;

#[derive(Clone)]
struct State {
    links: Links,
    candidates: Vec<Candidate>,
}

impl State {
    fn overlap_mm(&self) -> f64 {
        self.candidates.iter().map(|c| (-c.gap_mm).max(0.0)).sum()
    }
}

/// Augmented Lagrangian of the contacts that carry a force; overlap of the others, weighted above the forces.
///
/// A contact that a step lifts a little (second order) does not make the step a bad one, as it would with overlaps alone.
fn penalty_nmm(candidates: &[Candidate], weight_n: f64) -> f64 {
    let of = |c: &Candidate| {
        if c.force_n > 0.0 {
            c.force_n * c.gap_mm * (c.gap_mm / (2.0 * GAP_SCALE_MM) - 1.0)
        } else {
            weight_n * (-c.gap_mm).max(0.0)
        }
    };
    candidates.iter().map(of).sum()
}

impl Chain {
    /// Equilibrium against `surface`, from `start`, whose contacts were `known` before the body moved by `moved_mm`.
    ///
    /// Where it is lost, damping makes the steps a walk down the energy, and with enough of them the wire springs to another.
    #[must_use]
    pub fn press<S: Surface>(
        &self,
        surface: &S,
        start: &Links,
        known: &[Contact],
        moved_mm: &Vector3<f64>,
        most_iterations: usize,
    ) -> Pressed {
        self.press_with(surface, start, known, moved_mm, most_iterations, &[])
    }

    /// Moment at the root, N mm.
    #[must_use]
    pub fn base_moment_nmm(&self, pressed: &Pressed) -> Vector3<f64> {
        let along = self.clamp_frame().column(0) * self.link_mm;
        let beyond = |c: &Contact| {
            // The clamp's share in the contact's place is an arm that no link has.
            let share = Spot::new(c.arclength_mm / self.link_mm, self.links()).clamp_share();
            (along * share).cross(&(c.normal * c.force_n + c.friction_n))
        };
        self.root_spring_nmm(&pressed.links) + pressed.contacts.iter().map(beyond).sum::<Vector3<f64>>()
    }

    fn press_with<S: Surface>(
        &self,
        surface: &S,
        start: &Links,
        known: &[Contact],
        moved_mm: &Vector3<f64>,
        most_iterations: usize,
        rubs: &[Rub],
    ) -> Pressed {
        // The first step keeps the side of the surface on which the wire was.
        let mut state = State { links: start.clone(), candidates: self.carried(known, moved_mm) };
        if state.candidates.is_empty() {
            state.candidates = self.candidates(surface, start, &[]);
        }
        let mut balance = self.rubbed_balance(&state.links, rubs);
        let (mut damping, mut weight, mut trembles) = (0.0_f64, 0.0_f64, 0);
        for iteration in 1..=most_iterations {
            let raised = (damping * 8.0).max(LEAST_DAMPING);
            let Some(step) = self.newton_step(&balance, &state.links, &state.candidates, damping) else {
                damping = raised;
                if damping > MOST_DAMPING {
                    return self.ended(state, iteration, false);
                }
                continue;
            };
            let largest = step.turns.iter().map(Vector3::norm).fold(0.0, f64::max);
            let way_mm = self.way_mm(&state.links, &step.turns);
            let scale = (MAX_TURN_RAD / largest.max(1e-300))
                .min(MAX_WAY_LINKS * self.link_mm / way_mm.max(1e-300))
                .min(1.0);
            let turns: Vec<_> = step.turns.iter().map(|phi| phi * scale).collect();
            let links = self.turned(&state.links, &turns);
            let mut carriers = state.candidates.clone();
            carriers.iter_mut().zip(&step.forces_n).for_each(|(c, f)| c.force_n = *f);
            let seen = self.candidates(surface, &links, &carriers);
            let candidates = self.carried_on(surface.faceted(), &links, &carriers, seen);
            let next = State { links, candidates };
            let next_balance = self.rubbed_balance(&next.links, rubs);
            weight = step.forces_n.iter().fold(weight, |w, f| w.max(1.5 * f));
            let old = balance.energy_nmm + penalty_nmm(&carriers, weight);
            let new = next_balance.energy_nmm + penalty_nmm(&next.candidates, weight);
            // The first step goes from the body's old place to its new one: nothing to compare with.
            if iteration > 1 && new > old + 1e-10 * (1.0 + old.abs()) && largest > 1e-6 {
                if !self.meet(&mut state, &next) {
                    damping = raised;
                }
                if damping > MOST_DAMPING {
                    return self.ended(state, iteration, false);
                }
                continue;
            }
            damping = if damping <= LEAST_DAMPING { 0.0 } else { damping / 8.0 };
            state = next;
            balance = next_balance;
            let overlap_mm = state.overlap_mm();
            trembles = if way_mm < TREMBLE_MM && overlap_mm < TREMBLE_OVERLAP_MM { trembles + 1 } else { 0 };
            let still = trembles > TREMBLES || (largest < TURN_RAD && overlap_mm < OVERLAP_MM);
            if iteration > 1
                && still
                && self.imbalance_nmm(&balance.gradient, &state.links, &state.candidates) < BALANCE_NMM
            {
                if self.planes_hold(surface, &state) {
                    return self.ended(state, iteration, true);
                }
                // The planes were met too far away: shorter steps meet them where they are.
                state.candidates.retain(|c| !c.met);
                damping = raised.max(REMEET_DAMPING);
            }
        }
        self.ended(state, most_iterations, false)
    }

    /// Takes what a refused step ran into as planes that the next one must keep clear of; false where that is known already.
    ///
    /// Where the wire lies in a notch, or over several edges of a link, the lowest place alone does not tell of the others.
    fn meet(&self, state: &mut State, refused: &State) -> bool {
        let mut learned = false;
        for c in refused.candidates.iter().filter(|c| c.gap_mm < -OVERLAP_MM && !c.met) {
            let known = |k: &Candidate| {
                (k.spot.at - c.spot.at).abs() < SAME_FACET[0]
                    && (k.near.normal - c.near.normal).norm() < SAME_FACET[1]
            };
            if state.candidates.len() < MOST_CANDIDATES && !state.candidates.iter().any(known) {
                let plane = Candidate { met: true, slides: false, force_n: 0.0, ..c.clone() };
                state.candidates.push(self.against_plane(&state.links, plane));
                learned = true;
            }
        }
        learned
    }

    /// The gap to the plane of a place that a refused step met.
    fn against_plane(&self, links: &Links, mut plane: Candidate) -> Candidate {
        let centre_mm = plane.spot.point_mm(self, links);
        plane.gap_mm += plane.near.normal.dot(&(centre_mm - plane.centre_mm));
        plane.centre_mm = centre_mm;
        plane.near.second_per_mm = Matrix3::zeros();
        // The wire slides over the plane: it is touched below the place where the wire is now.
        let normal = plane.near.normal.normalize();
        plane.near.point_mm = centre_mm - normal * (plane.gap_mm + self.radius_mm);
        plane
    }

    /// Gives the forces of `carriers` to the places `seen` now, with the planes that are still touched and seen no more.
    ///
    /// Between two facets a wire's end is held by both, and the surface shows but the nearer: the other one would be lost, and the
    /// wire hop between them for ever.
    fn carried_on(
        &self,
        faceted: bool,
        links: &Links,
        carriers: &[Candidate],
        mut seen: Vec<Candidate>,
    ) -> Vec<Candidate> {
        let places = seen.len();
        // Facets next to each other differ by little and are two all the same; on a smooth body what is seen is where it is.
        let close = if faceted { SAME_FACET } else { SAME_PLACE };
        for c in carriers.iter().filter(|c| c.force_n > 0.0) {
            let off = |s: &Candidate| (s.spot.at - c.spot.at).abs();
            let same = |s: &Candidate| off(s) < close[0] && (s.near.normal - c.near.normal).norm() < close[1];
            let plane = self.against_plane(links, Candidate { met: true, slides: false, ..c.clone() });
            let touched = plane.gap_mm.abs() < PLANE_MM;
            let known = seen[..places].iter().position(same);
            let heir = (0..places).min_by(|&a, &b| off(&seen[a]).total_cmp(&off(&seen[b])));
            let facet = faceted && c.near.second_per_mm == Matrix3::zeros();
            let turned = facet && heir.is_none_or(|h| off(&seen[h]) < TURNED_LINKS);
            if known.is_none() && touched && (c.met || turned) {
                seen.push(plane);
                continue;
            }
            let heir = heir.filter(|&h| !c.met && off(&seen[h]) < 3.0);
            if let Some(heir) = known.filter(|_| faceted).or(heir) {
                seen[heir].force_n += c.force_n;
            }
        }
        seen
    }

    /// Whether the surface is where the loaded planes are.
    fn planes_hold<S: Surface>(&self, surface: &S, state: &State) -> bool {
        state.candidates.iter().filter(|c| c.met && c.force_n > 0.0).all(|c| {
            let lies = |at: &Vector3<f64>, mm: f64| {
                let near = surface.near(at, 2.0 * self.link_mm);
                near.is_some_and(|n| (n.distance_mm - mm).abs() < TREMBLE_OVERLAP_MM)
            };
            // Past an edge the wire may be as near to the next facet, and the plane's own place is nowhere.
            lies(&c.centre_mm, self.radius_mm) && lies(&c.near.point_mm, 0.0)
        })
    }

    /// Longest way of a node in a step, mm.
    fn way_mm(&self, links: &Links, turns: &[Vector3<f64>]) -> f64 {
        let (mut way, mut longest) = (Vector3::zeros(), 0.0_f64);
        for (frame, turn) in links.frames.iter().zip(turns) {
            way += turn.cross(&Vector3::from(frame.column(0))) * self.link_mm;
            longest = longest.max(way.norm());
        }
        longest
    }

    fn ended(&self, state: State, iterations: usize, converged: bool) -> Pressed {
        let contacts = state
            .candidates
            .iter()
            .filter(|c| c.force_n > 0.0)
            .map(|c| Contact {
                arclength_mm: c.spot.at * self.link_mm,
                centre_mm: c.spot.point_mm(self, &state.links),
                point_mm: c.near.point_mm,
                normal: c.near.normal.normalize(),
                force_n: c.force_n * c.near.normal.norm(),
                friction_n: Vector3::zeros(),
                gap_mm: c.gap_mm,
            })
            .collect();
        let overlap_mm = state.overlap_mm();
        Pressed { links: state.links, contacts, converged, iterations, overlap_mm }
    }

    fn carried(&self, known: &[Contact], moved_mm: &Vector3<f64>) -> Vec<Candidate> {
        known
            .iter()
            .map(|c| Candidate {
                spot: Spot::new(c.arclength_mm / self.link_mm, self.links()),
                near: Near {
                    distance_mm: self.radius_mm + c.gap_mm,
                    normal: c.normal,
                    point_mm: c.point_mm + moved_mm,
                    second_per_mm: Matrix3::zeros(),
                },
                gap_mm: c.gap_mm - c.normal.dot(moved_mm),
                centre_mm: c.centre_mm,
                force_n: c.force_n,
                slides: false,
                met: false,
            })
            .collect()
    }
}
