//! Base moments at the poses of a calibration by MuJoCo's groove bench, and what they hang on.
//!
//! The poses are run as released. The groove goes from pose to pose in a quarter of a second, and
//! where the wire is held near its tip it swings sideways: it still slides over the tip when the
//! moment is read, and MuJoCo's version and step decide how far it has come. Such poses are
//! recognised without any label: the wire is not at rest, or it rests elsewhere when the groove
//! comes straight from the start.

use crate::engine::protocol::{Frame, Request};
use crate::groove::{Preset, START_MM, bench, released_from};
use crate::mjcf::Touch;
use crate::{MujocoEngine, TwinError};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use wcal_core::observation::WhiskerSpec;

/// Retreat before each trajectory, along y, mm.
const RETREAT_MM: f64 = 60.0;
/// A pose counts as reached when the tip moves less than this in ten steps, mm.
const REACHED_MM: f64 = 1e-3;
const MAX_STEPS: u64 = 20_000;
/// Way beyond the last pose to which the released program retreats between trajectories, m.
const RELEASED_RETREAT_M: f64 = 0.06;
/// Steps that settle a pose in the released program: all of them, at rest or not.
const SETTLE: Settle = Settle {
    steps: 4000,
    rest_rad_s: 0.0,
};
/// The same on another way, where other equilibria are distinguished from this one.
const AGAIN: Settle = Settle {
    steps: 2500,
    rest_rad_s: 3e-3,
};
/// Steps after which it is checked whether the wire rests.
const CHECK_STEPS: u64 = 250;
/// A wire at rest: fastest joint, rad/s (friction lets it creep on for long).
const REST_RAD_S: f64 = 1e-3;
/// Another equilibrium: moments that differ by this share of them and this many N mm; less is
/// friction's doing.
const ELSEWHERE: [f64; 2] = [0.05, 0.02];
/// Share of steps with a change between touching and free past which a settled wire chatters.
const CHATTER: f64 = 0.02;

/// When a pose has settled.
#[derive(Debug, Clone, Copy)]
struct Settle {
    steps: u64,
    rest_rad_s: f64,
}

/// Where the wire came to rest when the groove came straight from the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Other {
    /// r x F, N mm, session's base frame.
    pub moment_nmm: Vector3<f64>,
    /// Arc length of the contact, mm; none: the wire came free.
    pub arclength_mm: Option<f64>,
}

/// What a pose gave.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLabel {
    /// r x F, N mm, session's base frame; none where a step went wrong (a number that is none).
    pub moment_nmm: Option<Vector3<f64>>,
    /// Arc length of the contact (mean by force), mm; none without contact.
    pub arclength_mm: Option<f64>,
    /// Fastest joint at the end, rad/s.
    pub fastest_rad_s: f64,
    /// Whether the wire touches and comes free from step to step.
    pub chatters: bool,
    /// Whether the wire came to rest.
    pub settled: bool,
    /// Another place at which it rests at this pose.
    pub elsewhere: Option<Other>,
}

impl PoseLabel {
    /// Whether the moment hangs on neither history nor version.
    pub fn certain(&self) -> bool {
        self.settled && self.moment_nmm.is_some() && self.elsewhere.is_none()
    }
}

/// Labels at the groove's places of each trajectory (session's frame, in order of travel);
/// trajectories run side by side. `each` is called twice a place.
///
/// # Errors
/// Where the engine is missing or dies.
pub fn labels(
    whisker: &WhiskerSpec,
    preset: Preset,
    trajectories: &[Vec<Vector3<f64>>],
    each: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<PoseLabel>>, TwinError> {
    let touch = Touch::RELEASED;
    let (labels, straight) = rayon::join(
        || released(whisker, preset, trajectories, each),
        || run(whisker, preset, touch, trajectories, AGAIN, true, each),
    );
    let mut labels = labels?;
    for (label, other) in labels
        .iter_mut()
        .flatten()
        .zip(straight?.into_iter().flatten())
    {
        if let (Some(here), Some(there)) = (label.moment_nmm, other.moment_nmm)
            && (there - here).norm() > ELSEWHERE[0] * here.norm() + ELSEWHERE[1]
        {
            label.elsewhere = Some(Other {
                moment_nmm: there,
                arclength_mm: other.arclength_mm,
            });
        }
    }
    Ok(labels)
}

/// The trajectories as the released program ran them: one after the other, the wire's motion
/// carried on, which decides where friction holds it. Between them the groove goes ten steps out
/// for every step back, until that stands still, then to its start.
fn released(
    whisker: &WhiskerSpec,
    preset: Preset,
    trajectories: &[Vec<Vector3<f64>>],
    each: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<PoseLabel>>, TwinError> {
    let mut bench = GrooveEngine::start(whisker, preset, Touch::RELEASED)?;
    let mut last = Vector3::<f64>::zeros();
    let mut labels = Vec::with_capacity(trajectories.len());
    for (t, places) in trajectories.iter().enumerate() {
        let retreat = if t == 0 {
            Vec::new()
        } else {
            vec![0.0, -last.y - RELEASED_RETREAT_M, 0.0]
        };
        bench.control(vec![0.0; 3], retreat, true)?;
        bench.engine.frame(&Request::Run {
            steps: SETTLE.steps,
        })?;
        let mut found = Vec::with_capacity(places.len());
        for place in places {
            let place = bench.turn * place;
            last = way_m(&place);
            found.push(bench.label(&place, SETTLE, true)?);
            each();
        }
        labels.push(found);
    }
    Ok(labels)
}

/// Way of the groove from its start, m.
fn way_m(place_mm: &Vector3<f64>) -> Vector3<f64> {
    (place_mm - Vector3::from(START_MM)) * 1e-3
}

/// Runs the trajectories; `straight`: from the start to each place, without those between.
fn run(
    whisker: &WhiskerSpec,
    preset: Preset,
    touch: Touch,
    trajectories: &[Vec<Vector3<f64>>],
    settle: Settle,
    straight: bool,
    each: &(dyn Fn() + Sync),
) -> Result<Vec<Vec<PoseLabel>>, TwinError> {
    trajectories
        .par_iter()
        .map(|places| {
            if places.is_empty() {
                return Ok(Vec::new());
            }
            let mut bench = GrooveEngine::start(whisker, preset, touch)?;
            bench.begin()?;
            let mut labels = Vec::with_capacity(places.len());
            for (k, place) in places.iter().enumerate() {
                if straight && k > 0 {
                    bench.begin()?;
                }
                let place = bench.turn * place;
                labels.push(bench.label(&place, settle, false)?);
                each();
            }
            Ok(labels)
        })
        .collect()
}

/// A running engine with the groove bench loaded; places in the released frame.
struct GrooveEngine {
    engine: MujocoEngine,
    turn: Matrix3<f64>,
}

impl GrooveEngine {
    fn start(whisker: &WhiskerSpec, preset: Preset, touch: Touch) -> Result<Self, TwinError> {
        let mut engine = MujocoEngine::start()?;
        engine.load(&bench(whisker, preset, touch)?, preset == Preset::Released)?;
        Ok(Self {
            engine,
            turn: released_from(whisker),
        })
    }

    fn control(
        &mut self,
        control: Vec<f64>,
        retreat: Vec<f64>,
        goes_on: bool,
    ) -> Result<Frame, TwinError> {
        self.engine.frame(&Request::Control {
            control,
            retreat,
            goes_on,
            body: "tip".to_owned(),
            moved_m: REACHED_MM * 1e-3,
            steps: MAX_STEPS,
        })
    }

    fn go(&mut self, place_mm: &Vector3<f64>, goes_on: bool) -> Result<Frame, TwinError> {
        // The tip is turned by 90 degrees about x: its z is the world's -y, its y the world's z.
        let way = way_m(place_mm);
        self.control(vec![way.x, -way.y, way.z], Vec::new(), goes_on)
    }

    /// From the free wire: the groove retreats, then comes to the trajectories' start.
    fn begin(&mut self) -> Result<(), TwinError> {
        self.engine.frame(&Request::Reset)?;
        self.go(
            &(Vector3::from(START_MM) + Vector3::y() * RETREAT_MM),
            false,
        )?;
        self.go(&Vector3::from(START_MM), false).map(drop)
    }

    fn label(
        &mut self,
        place_mm: &Vector3<f64>,
        settle: Settle,
        goes_on: bool,
    ) -> Result<PoseLabel, TwinError> {
        self.go(place_mm, goes_on)?;
        let mut frames: Vec<Frame> = Vec::new();
        let checks = settle.steps / CHECK_STEPS;
        while (frames.len() as u64) < checks {
            let frame = self.engine.frame(&Request::Run { steps: CHECK_STEPS })?;
            let ended = frame.bad || frame.fastest < settle.rest_rad_s;
            frames.push(frame);
            // One check alone may meet a turning point.
            if ended && frames.len() > 1 {
                break;
            }
        }
        // The groove's arrival shakes the wire: only the later half tells whether it chatters.
        let late = &frames[frames.len() / 2..];
        let [_, .., frame] = &frames[..] else {
            return Err(TwinError::Engine(
                "expected two checks of a pose or more, found fewer".to_owned(),
            ));
        };
        let [toggles, steps] = [|f: &Frame| f.toggles, |f: &Frame| f.steps]
            .map(|of| late.iter().map(of).sum::<u64>() as f64);
        Ok(PoseLabel {
            moment_nmm: self.moment(frame)?,
            arclength_mm: arclength_mm(frame),
            fastest_rad_s: frame.fastest,
            chatters: toggles > CHATTER * steps,
            settled: frame.fastest < REST_RAD_S && !frame.bad,
            elsewhere: None,
        })
    }

    /// r x F in the session's frame. MuJoCo's torque sensor reads its reaction.
    fn moment(&self, frame: &Frame) -> Result<Option<Vector3<f64>>, TwinError> {
        if frame.bad {
            return Ok(None);
        }
        let own = frame.base_moment_nm.map(Vector3::from);
        let moment = own.or_else(|| frame.sensor_nm.map(|t| -Vector3::from(t)));
        let moment = moment
            .ok_or_else(|| TwinError::Engine("expected a base moment, found none".to_owned()))?;
        // From the released frame into the session's, and from N m to N mm.
        Ok(Some(self.turn.tr_mul(&moment) * 1e3))
    }
}

/// Arc length of the contact on the chain of links, mean by force, mm.
fn arclength_mm(frame: &Frame) -> Option<f64> {
    let at = |j: usize| Vector3::from(frame.links_m[j]);
    let (mut sum, mut weight) = (0.0, 0.0);
    for contact in &frame.contacts {
        let along: f64 = (0..contact.link).map(|j| (at(j + 1) - at(j)).norm()).sum();
        let axis = (at(contact.link + 1) - at(contact.link)).normalize();
        let force = Vector3::from(contact.force_n).norm();
        sum += force * (along + axis.dot(&(Vector3::from(contact.point_m) - at(contact.link))));
        weight += force;
    }
    (weight > 0.0).then(|| sum / weight * 1e3)
}
