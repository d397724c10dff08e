//! Sweeps by MuJoCo: the base on a slide whose speed the solver sees, the object as convex parts,
//! labels on the exact mesh.
//!
//! M q'' + c = J^T f - K q - D q', forces f of the soft contacts by MuJoCo's convex problem (E.
//! Todorov, ICRA 2014); the base's slide has l'' prescribed. Base moment: what the springs and
//! dampers of the first joint carry. Contact of a group of touching places: s = sum s_i |f_i| /
//! sum |f_i|, its normal part f . n with n of the exact mesh at r(s), the rest is friction.
//!
//! The wire has inertia, damping and soft contacts: what they cost is compared with the
//! quasi-static rod (tests/peers and `compare_engines`). Steps that go wrong are named: `unstable`
//! (a number that is none), `penetration` (deeper than the wire's radius), `chatter` (the contact
//! opens and closes from step to step), `engine-died`, `model-refused` (a part that MuJoCo cannot
//! take).

use crate::RodEngine;
use crate::contact::{Contact, Surface};
use crate::physics::fluid_loads;
use crate::rod_engine::{LINKS, Run, event};
use crate::sweep::{ENGINE_DIED, Event, HOLD_S, MovingObject, Sample, Sweep, SweepPlan, Verdict};
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use wcal_core::observation::WhiskerSpec;
use wcal_mesh::Mesh;
use wcal_mujoco::engine::protocol::{Frame, Request};
use wcal_mujoco::mjcf::{MjcfOptions, WorldParts, convex_parts, mjcf_among};
use wcal_mujoco::{MujocoEngine, TwinError};

/// Share of steps with a change between touching and free past which a sample chatters, and of such
/// samples past which a sweep does.
const CHATTER: f64 = 0.1;
const MAX_CHATTER: f64 = 0.2;
/// Touching places nearer than this along the wire are one contact, mm.
const ONE_CONTACT_MM: f64 = 1.0;
/// Weight of the body that leads the wire, kg: contacts do not move it.
const BASE_KG: f64 = 1000.0;
/// Steps in which the free wire comes to hang in its medium before the base moves.
const SETTLE_STEPS: u64 = 500;
/// A node that moves by more than this (mm) beyond three times the base's step has snapped.
const SPRING_MM: f64 = 1.5;

/// A whisker in MuJoCo on which sweeps are run, one after the other.
#[derive(Debug)]
pub struct CableEngine {
    engine: MujocoEngine,
    whisker: WhiskerSpec,
    options: MjcfOptions,
    /// Bending stiffness, N mm^2.
    ei_nmm2: f64,
    reach_mm: f64,
    /// Processor time of engines that died, s.
    spent_s: f64,
    /// What MuJoCo said of the last model that it refused.
    pub refused: Option<String>,
}

/// Why a plan with softening is refused.
pub fn no_softening(found: &str) -> TwinError {
    TwinError::value(
        "softening_onset_per_m",
        "none with the mujoco engine, whose joints are linear (the rod engine softens)",
        found,
    )
}

impl CableEngine {
    /// Starts an engine for a whisker.
    ///
    /// # Errors
    /// Where the engine is missing or the wire cannot be.
    pub fn start(whisker: &WhiskerSpec, options: &MjcfOptions) -> Result<Self, TwinError> {
        let section =
            wcal_rod::Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
        Ok(Self {
            engine: MujocoEngine::start()?,
            whisker: whisker.clone(),
            options: options.clone(),
            ei_nmm2: section.ei_nmm2,
            reach_mm: RodEngine::new(whisker, LINKS)?.reach_mm(),
            spent_s: 0.0,
            refused: None,
        })
    }

    /// How far the wire reaches along the straight part's direction, mm.
    pub fn reach_mm(&self) -> f64 {
        self.reach_mm
    }

    /// Processor time of the engine's processes so far, s.
    pub fn core_s(&self) -> f64 {
        self.spent_s + self.engine.core_s
    }

    /// Runs a sweep to its end; an engine that dies on the way is started again for the next one.
    ///
    /// # Errors
    /// Where the engine cannot be started again, or the sweep asks for physics that it does not
    /// have.
    pub fn run(
        &mut self,
        mesh: &Mesh,
        parts: &[Vec<Vector3<f64>>],
        sweep: &Sweep,
        plan: &SweepPlan,
    ) -> Result<Run, TwinError> {
        if let Some(onset) = sweep.physics.onset_per_m() {
            return Err(no_softening(&format!("{onset:.1}")));
        }
        let mut run = Run {
            samples: Vec::new(),
            verdict: Verdict::Kept,
            solves: 0,
            iterations: 0,
        };
        match self.follow(mesh, parts, sweep, plan, &mut run) {
            Err(TwinError::EngineDied(_)) => {
                let spent_s = self.engine.core_s;
                self.engine = MujocoEngine::start()?;
                self.spent_s += spent_s;
                run.verdict = Verdict::Rejected(ENGINE_DIED);
            }
            other => other?,
        }
        Ok(run)
    }

    /// The wire on its slide and the object, at the start of a sweep.
    ///
    /// # Errors
    /// Where the wire cannot be.
    pub fn world(&self, parts: &[Vec<Vector3<f64>>], sweep: &Sweep) -> Result<String, TwinError> {
        let mut options = self.options.clone();
        options.touch.friction = sweep.physics.friction;
        let [head, geoms] = convex_parts("part", parts, &options.touch);
        let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(sweep.turn));
        let p = sweep.shift_mm * 1e-3;
        let around = WorldParts {
            head,
            bodies: format!(
                "<body name=\"object\" pos=\"{} {} {}\" quat=\"{} {} {} {}\">{geoms}</body>",
                p.x, p.y, p.z, q.w, q.i, q.j, q.k
            ),
            base: [
                String::new(),
                format!(
                    "<inertial pos=\"0 0 0\" mass=\"{BASE_KG}\" diaginertia=\"1 1 1\"/><joint name=\"base\" type=\"slide\" axis=\"0 0 1\"/>"
                ),
            ],
            tail: String::new(),
        };
        mjcf_among(&self.whisker, &options, &around)
    }

    /// Leads the base along legs of constant acceleration; `steps` counts those of all legs,
    /// `frame` is the last one's.
    fn lead(
        &mut self,
        legs: &[(f64, f64, f64)],
        step_s: f64,
        steps: &mut u64,
        frame: &mut Frame,
    ) -> Result<Led, TwinError> {
        let mut led = Led {
            taken: 0,
            toggles: 0,
            deepest_m: 0.0,
        };
        for (until_s, speed, acceleration) in legs {
            let more = ((until_s / step_s).round() as u64).saturating_sub(*steps);
            *frame = self.engine.frame(&Request::Lead {
                speed_m_s: speed * 1e-3,
                acceleration_m_s2: acceleration * 1e-3,
                steps: more,
            })?;
            *steps += more;
            led.taken += more;
            led.toggles += frame.toggles;
            led.deepest_m = led.deepest_m.max(frame.deepest_m);
        }
        Ok(led)
    }

    fn follow(
        &mut self,
        mesh: &Mesh,
        parts: &[Vec<Vector3<f64>>],
        sweep: &Sweep,
        plan: &SweepPlan,
        run: &mut Run,
    ) -> Result<(), TwinError> {
        let radius_mm = self.whisker.diameter_mm / 2.0;
        let loaded = match self.engine.load(&self.world(parts, sweep)?, false) {
            Err(TwinError::Engine(why)) => {
                self.refused = Some(why);
                run.verdict = Verdict::Rejected("model-refused");
                return Ok(());
            }
            other => other?,
        };
        let mut frame = self.engine.frame(&Request::Run { steps: 0 })?;
        if let Some(medium) = fluid_loads(&self.whisker, &sweep.physics) {
            self.engine.frame(&Request::Medium { medium })?;
            frame = self.engine.frame(&Request::Run {
                steps: SETTLE_STEPS,
            })?;
        }
        let mut nodes = nodes_mm(&frame, 0.0);
        let at_start = MovingObject::new(mesh, sweep, 0.0);
        if nodes.iter().any(|p| {
            at_start
                .closest_point(p, 4.0)
                .is_some_and(|n| n.distance_mm < radius_mm)
        }) {
            run.verdict = Verdict::Rejected("starts-inside");
            return Ok(());
        }
        let (mut touched, mut free_since_mm, mut steps, mut chatter) = (false, None::<f64>, 0, 0.0);
        for k in 0.. {
            let t_s = f64::from(k) / plan.rate_hz;
            let (travel_mm, speed_mm_s) = sweep.travel(t_s);
            if travel_mm > plan.max_travel_mm {
                break;
            }
            let Led {
                taken,
                toggles,
                deepest_m,
            } = self.lead(
                &legs(sweep, t_s - 1.0 / plan.rate_hz, t_s),
                loaded.step_s,
                &mut steps,
                &mut frame,
            )?;
            run.solves += 1;
            run.iterations = steps as usize;
            // A number that is none is no sample.
            if frame.bad
                || frame
                    .base_moment_nm
                    .is_none_or(|m| m.iter().any(|x| !x.is_finite()))
            {
                run.verdict = Verdict::Rejected("unstable");
                return Ok(());
            }
            let before = std::mem::replace(&mut nodes, nodes_mm(&frame, travel_mm));
            let step_mm = speed_mm_s / plan.rate_hz;
            let moved = nodes
                .iter()
                .zip(&before)
                .map(|(a, b)| (a - b).norm())
                .fold(0.0, f64::max);
            let snapped = moved > SPRING_MM + 3.0 * step_mm;
            let contacts = contacts(
                &frame,
                &nodes,
                &MovingObject::new(mesh, sweep, travel_mm),
                travel_mm,
                radius_mm,
            );
            let moment = Vector3::from(frame.base_moment_nm.unwrap_or([f64::NAN; 3])) * 1e3;
            let earlier = run.samples.last().map_or(&[][..], |s: &Sample| &s.contacts);
            let event = event(earlier, &contacts, snapped, step_mm);
            let chatters = toggles as f64 > CHATTER * taken as f64;
            chatter += f64::from(u8::from(chatters));
            run.samples.push(Sample {
                t_s,
                travel_mm,
                speed_mm_s,
                moment_nmm: moment,
                contacts,
                event,
                settled: !chatters,
            });
            // Bending strain of the skin at the root: M / EI times radius.
            let strain = moment.yz().norm() / self.ei_nmm2 * radius_mm;
            let wrong = [
                (deepest_m * 1e3 > radius_mm, "penetration"),
                (event == Event::Jump && !plan.keep_jumps, "contact-jump"),
                (strain > plan.max_strain, "torque-too-high"),
            ];
            if let Some((_, why)) = wrong.iter().find(|w| w.0) {
                run.verdict = Verdict::Rejected(why);
                return Ok(());
            }
            let touching = run.samples.last().is_some_and(|s| !s.contacts.is_empty());
            touched |= touching;
            if touched && !touching {
                let since = *free_since_mm.get_or_insert(travel_mm);
                if travel_mm - since >= plan.tail_mm {
                    break;
                }
            } else {
                free_since_mm = None;
            }
        }
        if chatter > MAX_CHATTER * run.samples.len() as f64 {
            run.verdict = Verdict::Rejected("chatter");
        } else if !touched {
            run.verdict = Verdict::Rejected("no-contact");
        }
        Ok(())
    }
}

/// What happened while the base was led.
struct Led {
    /// Steps taken, and changes of the contacts in them.
    taken: u64,
    toggles: u64,
    /// Deepest penetration, m.
    deepest_m: f64,
}

/// Legs of constant acceleration between two times: end (s), speed at the start (mm/s),
/// acceleration (mm/s^2).
fn legs(sweep: &Sweep, from_s: f64, to_s: f64) -> Vec<(f64, f64, f64)> {
    let mut legs = Vec::new();
    let mut t = from_s.max(0.0);
    while t < to_s - 1e-9 {
        let end = (HOLD_S * ((t + 1e-9) / HOLD_S).floor() + HOLD_S).min(to_s);
        let [a, b] = [sweep.travel(t).1, sweep.travel(end).1];
        legs.push((end, a, (b - a) / (end - t)));
        t = end;
    }
    legs
}

/// Ends of the links in the base frame, mm.
fn nodes_mm(frame: &Frame, travel_mm: f64) -> Vec<Vector3<f64>> {
    frame
        .links_m
        .iter()
        .map(|p| Vector3::from(*p) * 1e3 - Vector3::z() * travel_mm)
        .collect()
}

/// Places where the wire is pushed, from the root on; the label is the mesh's nearest point to the
/// wire's centre there.
fn contacts(
    frame: &Frame,
    nodes: &[Vector3<f64>],
    body: &MovingObject<'_>,
    travel_mm: f64,
    radius_mm: f64,
) -> Vec<Contact> {
    let travel = Vector3::z() * travel_mm;
    let mut places: Vec<(f64, Vector3<f64>)> = frame
        .contacts
        .iter()
        .filter(|c| Vector3::from(c.force_n).norm() > 0.0)
        .map(|c| {
            let before: f64 = (0..c.link).map(|j| (nodes[j + 1] - nodes[j]).norm()).sum();
            let link = nodes[c.link + 1] - nodes[c.link];
            let along =
                (Vector3::from(c.point_m) * 1e3 - travel - nodes[c.link]).dot(&link.normalize());
            (
                before + along.clamp(0.0, link.norm()),
                Vector3::from(c.force_n),
            )
        })
        .collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut contacts: Vec<Contact> = Vec::new();
    let mut group: Vec<(f64, Vector3<f64>)> = Vec::new();
    for k in 0..places.len() {
        group.push(places[k]);
        if places
            .get(k + 1)
            .is_some_and(|next| next.0 - places[k].0 < ONE_CONTACT_MM)
        {
            continue;
        }
        // One contact at the centre of force of its places.
        let weight: f64 = group.iter().map(|g| g.1.norm()).sum();
        let s_mm = group.iter().map(|g| g.0 * g.1.norm()).sum::<f64>() / weight;
        let force: Vector3<f64> = group.drain(..).map(|g| g.1).sum();
        let centre_mm = on_wire(nodes, s_mm);
        let Some(near) = body.closest_point(&centre_mm, 10.0) else {
            continue;
        };
        let along = force.dot(&near.normal);
        contacts.push(Contact {
            arclength_mm: s_mm,
            centre_mm,
            point_mm: near.point_mm,
            normal: near.normal,
            force_n: along,
            friction_n: force - near.normal * along,
            gap_mm: near.distance_mm - radius_mm,
        });
    }
    contacts
}

fn on_wire(nodes: &[Vector3<f64>], s_mm: f64) -> Vector3<f64> {
    let mut left = s_mm;
    for pair in nodes.windows(2) {
        let link = pair[1] - pair[0];
        if left <= link.norm() {
            return pair[0] + link.normalize() * left;
        }
        left -= link.norm();
    }
    nodes.last().copied().unwrap_or_else(Vector3::zeros)
}
