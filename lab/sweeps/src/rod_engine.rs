//! Sweeps by the quasi-static rod: no inertia, no damping, the exact mesh as contact surface;
//! friction, softening, drag and weight as the sweep says.
//!
//! At each way l of the base: min E(phi) subject to g(r(s); l) >= 0, by continuation in l from the
//! equilibrium before (equations and sources: [`crate::contact`]). A step is halved where Newton's
//! method fails or a node moves by more than 1.5 mm + 3 dl: then the branch ended at a fold, and
//! the wire sprang. Strain of the skin: |du| D / 2.
//!
//! Hard contacts first; where they hop between the facets of a scan, soft ones (overlap of some
//! hundredths of a millimetre). Samples at which neither came to rest are marked.

use crate::contact::{Configuration, Contact, ContactRod, ContactState, FrictionStep, Surface};
use crate::physics::{fluid_loads, loads_n_per_mm, node_velocities, with_physics};
use crate::sweep::{Event, MovingObject, Sample, Sweep, SweepPlan, Verdict};
use nalgebra::Vector3;
use wcal_core::observation::WhiskerSpec;
use wcal_mesh::{ClosestPoint, Mesh, MeshError};
use wcal_mujoco::engine::fluid::FluidLoads;
use wcal_rod::{Section, Shape};

/// Links of the wire: 19 of 20 base moments are within 0.5 % of the continuous rod's
/// (tests/sim/physics.rs).
pub const LINKS: usize = 40;
/// How often a step of the base is halved where Newton's method does not get there, or the wire
/// springs.
const HALVINGS: u32 = 2;
/// A free wire is touched in a step no longer than this, mm: less than its radius, or its centre
/// line is inside a thin body before that is noticed, and comes out on the other side.
const TOUCH_MM: f64 = 0.1;
/// Newton steps for a hard contact, and for a soft one where the hard one hops or the wire springs
/// far away.
const NEWTON_STEPS: usize = 60;
const PENALTY_STEPS: usize = 400;
/// How often a soft contact that did not come to rest goes on.
const MORE_ROUNDS: usize = 5;
/// Overlap (mm) up to which a wire that did not come to rest is followed on, marked as not settled,
/// and the share of such samples with which a sweep is kept.
const UNSETTLED_MM: f64 = 0.05;
const MAX_UNSETTLED: f64 = 0.2;
/// A node that moves by more than this (mm) beyond three times the base's step has snapped.
const SPRING_MM: f64 = 1.5;
/// A contact that runs faster than this many times the base's speed slips.
const SLIP_RATIO: f64 = 4.0;
/// The first samples keep this distance, mm: nearer, the wire begins inside the object.
const CLEAR_MM: f64 = 0.0;
/// Gaps beyond this need not be known, mm.
const CLEARED_MM: f64 = 4.0;
/// Mesh on which the rest shape is read, mm.
const SHAPE_STEP_MM: f64 = 0.25;

/// A whisker on which sweeps are run.
#[derive(Debug, Clone)]
pub struct RodEngine {
    whisker: WhiskerSpec,
    rod: ContactRod,
    rest: Configuration,
}

/// What a sweep gave.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// Samples at the plan's rate, also of a rejected sweep as far as it got.
    pub samples: Vec<Sample>,
    /// Kept, or why not.
    pub verdict: Verdict,
    /// Equilibria solved.
    pub solves: usize,
    /// Newton steps.
    pub iterations: usize,
}

impl Run {
    /// Without a sample.
    pub fn rejected(why: &'static str) -> Self {
        Self {
            samples: Vec::new(),
            verdict: Verdict::Rejected(why),
            solves: 0,
            iterations: 0,
        }
    }
}

impl RodEngine {
    /// For a whisker.
    ///
    /// # Errors
    /// Where its rest shape cannot be used.
    pub fn new(whisker: &WhiskerSpec, links: usize) -> Result<Self, MeshError> {
        let refuse = |e: wcal_rod::RodError| MeshError::Value {
            what: "whisker".to_owned(),
            expected: "a wire that can be bent".to_owned(),
            found: e.to_string(),
        };
        let shape = Shape::new(&whisker.rest_shape, SHAPE_STEP_MM).map_err(refuse)?;
        let section = Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
        let rod = ContactRod::new(&section, &shape, whisker.diameter_mm, links).map_err(refuse)?;
        let rest = rod.at_rest();
        Ok(Self {
            whisker: whisker.clone(),
            rod,
            rest,
        })
    }

    /// How far the wire reaches along the straight part's direction, mm.
    pub fn reach_mm(&self) -> f64 {
        self.rest.nodes_mm.iter().map(|p| p.x).fold(0.0, f64::max)
    }

    /// Runs a sweep to its end.
    pub fn run(&self, mesh: &Mesh, sweep: &Sweep, plan: &SweepPlan) -> Run {
        let mut state = SweepState {
            rod: with_physics(&self.rod, &sweep.physics),
            fluid: fluid_loads(&self.whisker, &sweep.physics),
            nodes_mm_s: vec![Vector3::zeros(); self.rod.links() + 1],
            speed_mm_s: sweep.speed_mm_s,
            mesh,
            sweep,
            longest_mm: plan.step_mm,
            travel_mm: 0.0,
            contact: self.free(),
            solves: 0,
            iterations: 0,
            snapped: false,
            settled: true,
        };
        let mut run = Run {
            samples: Vec::new(),
            verdict: Verdict::Kept,
            solves: 0,
            iterations: 0,
        };
        let (mut touched, mut free_since_mm) = (false, None::<f64>);
        state.settle_free();
        if state.clearance_mm() < CLEAR_MM {
            run.verdict = Verdict::Rejected("starts-inside");
            return run;
        }
        for k in 0.. {
            let t_s = f64::from(k) / plan.rate_hz;
            let (travel_mm, speed_mm_s) = sweep.travel(t_s);
            if travel_mm > plan.max_travel_mm {
                break;
            }
            let before = state.contact.contacts.clone();
            state.speed_mm_s = speed_mm_s;
            let reached = state.advance_to(travel_mm);
            let contacts = state.contact.contacts.clone();
            let moment_nmm = state.rod.base_moment_nmm(&state.contact);
            let step_mm = speed_mm_s / plan.rate_hz;
            let event = event(&before, &contacts, state.snapped, step_mm);
            run.samples.push(Sample {
                t_s,
                travel_mm,
                speed_mm_s,
                moment_nmm,
                contacts,
                event,
                settled: state.settled,
            });
            if !reached {
                run.verdict = Verdict::Rejected("no-equilibrium");
                break;
            }
            // Bending strain of the skin: change of curvature times radius.
            let strain = state.rod.largest_bend_per_mm(&state.contact.links) * state.rod.radius_mm;
            if event == Event::Jump && !plan.keep_jumps {
                run.verdict = Verdict::Rejected("contact-jump");
                break;
            }
            if strain > plan.max_strain {
                run.verdict = Verdict::Rejected("torque-too-high");
                break;
            }
            touched |= !state.contact.contacts.is_empty();
            if touched && state.contact.contacts.is_empty() {
                let since = *free_since_mm.get_or_insert(travel_mm);
                if travel_mm - since >= plan.tail_mm {
                    break;
                }
            } else {
                free_since_mm = None;
            }
        }
        let unsettled = run.samples.iter().filter(|s| !s.settled).count();
        if run.verdict == Verdict::Kept
            && unsettled as f64 > MAX_UNSETTLED * run.samples.len() as f64
        {
            run.verdict = Verdict::Rejected("no-equilibrium");
        }
        if run.verdict == Verdict::Kept && !touched {
            run.verdict = Verdict::Rejected("no-contact");
        }
        (run.solves, run.iterations) = (state.solves, state.iterations);
        run
    }

    fn free(&self) -> ContactState {
        ContactState {
            links: self.rest.clone(),
            contacts: Vec::new(),
            converged: true,
            iterations: 0,
            overlap_mm: 0.0,
        }
    }
}

/// No body near.
struct NoSurface;

impl Surface for NoSurface {
    fn closest_point(&self, _: &Vector3<f64>, _: f64) -> Option<ClosestPoint> {
        None
    }
}

/// A wire on its way.
struct SweepState<'a> {
    /// The wire with the sweep's softening and, from step to step, its loads.
    rod: ContactRod,
    fluid: Option<FluidLoads>,
    /// Velocities of the links' ends in the base frame, mm/s, in the step before, and speed of the
    /// base.
    nodes_mm_s: Vec<Vector3<f64>>,
    speed_mm_s: f64,
    mesh: &'a Mesh,
    sweep: &'a Sweep,
    longest_mm: f64,
    travel_mm: f64,
    contact: ContactState,
    solves: usize,
    iterations: usize,
    /// Since the last sample: whether the wire sprang, and whether it came to rest everywhere.
    snapped: bool,
    settled: bool,
}

impl SweepState<'_> {
    fn at(&self, travel_mm: f64) -> MovingObject<'_> {
        MovingObject::new(self.mesh, self.sweep, travel_mm)
    }

    /// Least gap of the wire's nodes where they are, mm; infinite where nothing is near.
    fn clearance_mm(&self) -> f64 {
        let body = self.at(self.travel_mm);
        let gap = |p: &Vector3<f64>| {
            body.closest_point(p, CLEARED_MM)
                .map_or(f64::INFINITY, |n| n.distance_mm - self.rod.radius_mm)
        };
        self.contact
            .links
            .nodes_mm
            .iter()
            .map(gap)
            .fold(f64::INFINITY, f64::min)
    }

    /// Loads of the medium, with the velocities of the step before: drag bends the wire far too
    /// little to move it on in between.
    fn update_loads(&mut self) {
        if let Some(fluid) = &self.fluid {
            let base_mm_s = Vector3::z() * self.speed_mm_s;
            self.rod.loads_n_per_mm =
                loads_n_per_mm(fluid, &self.contact.links, &base_mm_s, &self.nodes_mm_s);
        }
    }

    /// The free wire under its loads, before the object comes.
    fn settle_free(&mut self) {
        if self.fluid.is_none() {
            return;
        }
        self.update_loads();
        let free = self.rod.solve_contact(
            &NoSurface,
            &self.contact.links,
            &[],
            &Vector3::zeros(),
            PENALTY_STEPS,
        );
        self.iterations += free.iterations;
        self.contact = free;
    }

    /// Equilibrium one step on.
    fn solve_step(&mut self, travel_mm: f64, moved: &Vector3<f64>, penalty: bool) -> ContactState {
        let (body, rod, from) = (self.at(travel_mm), &self.rod, &self.contact);
        let steps = if penalty { PENALTY_STEPS } else { NEWTON_STEPS };
        let coefficient = self.sweep.physics.friction;
        let next = if coefficient > 0.0 {
            let how = FrictionStep {
                coefficient,
                before: &from.links,
                moved_mm: *moved,
            };
            rod.solve_frictional_contact(&body, &from.contacts, &how, penalty, steps)
        } else if penalty {
            rod.solve_penalty_contact(&body, &from.links, steps)
        } else {
            rod.solve_contact(&body, &from.links, &from.contacts, moved, steps)
        };
        self.iterations += next.iterations;
        next
    }

    /// Follows the equilibrium; false where it is lost for good.
    fn advance_to(&mut self, travel_mm: f64) -> bool {
        (self.snapped, self.settled) = (false, true);
        let longest_mm = self.longest_mm;
        let mut halvings = 0_u32;
        while travel_mm - self.travel_mm > 1e-12 {
            let step_mm = (longest_mm / f64::from(1 << halvings)).min(travel_mm - self.travel_mm);
            let next_mm = self.travel_mm + step_mm;
            let moved = Vector3::new(0.0, 0.0, -step_mm);
            self.update_loads();
            let mut next = self.solve_step(next_mm, &moved, false);
            let halvable = step_mm > longest_mm / f64::from(1 << HALVINGS);
            let penalty = !next.converged && !halvable;
            if penalty {
                next = self.solve_step(next_mm, &moved, true);
                // What slips off an edge has a long way down the energy: it goes on from where it
                // got.
                for _ in 0..MORE_ROUNDS {
                    if next.converged {
                        break;
                    }
                    let begun = std::mem::replace(&mut self.contact, next);
                    next = self.solve_step(next_mm, &Vector3::zeros(), true);
                    self.contact = begun;
                }
            }
            self.solves += 1;
            let nodes = next.links.nodes_mm.iter().zip(&self.contact.links.nodes_mm);
            let largest = nodes.map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
            let springs = largest > SPRING_MM + 3.0 * step_mm;
            let touched = self.contact.contacts.is_empty() && !next.contacts.is_empty();
            // Smaller steps tell a spring from a step that was too long, and on which side a body
            // is met.
            if (!next.converged || springs) && halvable || touched && step_mm > TOUCH_MM {
                // What is left of the way may be shorter than a halved step: the same again would
                // fail again.
                while longest_mm / f64::from(1 << halvings) >= step_mm {
                    halvings += 1;
                }
                continue;
            }
            self.snapped |= springs;
            self.settled &= next.converged;
            let lost = !next.converged && !(next.overlap_mm < UNSETTLED_MM);
            // A spring is over in milliseconds: no velocity of the quasi-static way.
            self.nodes_mm_s = if springs {
                vec![Vector3::zeros(); next.links.nodes_mm.len()]
            } else {
                node_velocities(&self.contact.links, &next.links, step_mm / self.speed_mm_s)
            };
            self.contact = next;
            self.travel_mm = next_mm;
            if lost {
                return false;
            }
            // Where a hard contact hops it mostly hops on: a longer step would be tried in vain.
            if !penalty {
                halvings = halvings.saturating_sub(1);
            }
        }
        true
    }
}

/// What happened between two samples; `snapped`: whether the wire jumped, `step_mm`: way of the
/// base.
pub fn event(before: &[Contact], after: &[Contact], snapped: bool, step_mm: f64) -> Event {
    match (before.first(), after.first()) {
        (None, Some(_)) => Event::Onset,
        (Some(_), None) => Event::Release,
        _ if snapped => Event::Jump,
        (Some(a), Some(b)) if (a.arclength_mm - b.arclength_mm).abs() > SLIP_RATIO * step_mm => {
            Event::Slip
        }
        _ => Event::None,
    }
}
