//! The released twin's bench: the whisker at its clamp and the V-groove's tip on three slides (facts: groove_tip/SOURCE.md).
//!
//! In the released frame the wire leaves its root along +y and bends toward -x; the groove comes from +y. Sessions in the default
//! frame (x distal, arc toward -z) are turned into it and back.

use crate::engine::protocol::{Frame, Request};
use crate::mjcf::{MjcfOptions, Surroundings, Touch, convex_parts, mjcf_among};
use crate::{MujocoEngine, TwinError};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use rayon::prelude::*;
use std::fmt::Write as _;
use wcal_core::observation::{RestShape, WhiskerSpec};

/// Which twin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// As released: MuJoCo's composite cable with a rigid first link, the released damping and contact.
    Released,
    /// The whisker as measured: clamp right to second order, 40 links; damping, armature and contact as released, scaled with the links:
    /// that contact is soft where joints are lighter, and the wire sinks through the tip.
    Paper,
}

/// What a pose gave.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseLabel {
    /// r x F, N mm, session's base frame; none where a step went wrong (a number that is none).
    pub moment_nmm: Option<Vector3<f64>>,
    /// Arc length of the contact (mean by force), mm; none without contact.
    pub arclength_mm: Option<f64>,
    /// Deepest overlap while settling, mm.
    pub overlap_mm: f64,
    /// Fastest joint at the end, rad/s.
    pub fastest_rad_s: f64,
    /// Whether the wire came to rest.
    pub settled: bool,
    /// Moment on the straight way there from the trajectory's start, past the places between, where the wire came to rest elsewhere.
    pub straight_nmm: Option<Vector3<f64>>,
}

/// Groove's place at which its tip's body is at [`TIP_MM`], released frame.
const START_MM: [f64; 3] = [0.0, 7.855, 0.0];
/// Tip's body and the root in the world, mm.
const TIP_MM: [f64; 3] = [0.0, 65.383, 25.85];
const ROOT_MM: [f64; 3] = [0.0, 0.0, 50.0];
/// Retreat before each trajectory, along y, mm.
const RETREAT_MM: f64 = 60.0;
/// A pose counts as reached when the tip moves less than this in ten steps, mm.
const REACHED_MM: f64 = 1e-3;
const MOST_STEPS: u64 = 20_000;
/// Steps that settle a pose, and those that settle it on another way.
const SETTLE_STEPS: u64 = 4000;
const AGAIN_STEPS: u64 = 2500;
/// Vertices of the cable that stands for an arc.
const VERTICES: usize = 40;
/// Joint damping (N m s/rad) and armature (kg m^2) as released.
const RELEASED_DAMPING: f64 = 0.005;
const RELEASED_ARMATURE: f64 = 3e-5;
/// Link of the released cable, mm.
const RELEASED_LINK_MM: f64 = 1.4345;
/// A wire at rest: fastest joint, rad/s (friction lets it creep on for long).
const REST_RAD_S: f64 = 1e-3;
/// Another equilibrium: moments that differ by this share of them and this many N mm; less is friction's doing.
const ELSEWHERE: [f64; 2] = [0.05, 0.02];

/// The tip's convex parts (mm), as released.
///
/// # Errors
/// Where the built-in files are damaged.
pub fn tip_parts() -> Result<Vec<Vec<Vector3<f64>>>, TwinError> {
    macro_rules! parts {
        ($($k:literal)*) => { [$(&include_bytes!(concat!("../groove_tip/parts_", $k, ".stl"))[..]),*] };
    }
    parts!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18)
        .into_iter()
        .map(|bytes| {
            let stl = stl_io::read_stl(&mut std::io::Cursor::new(bytes))
                .map_err(TwinError::io("reading", "groove_tip".as_ref()))?;
            Ok(stl
                .vertices
                .iter()
                .map(|v| Vector3::from([v[0], v[1], v[2]].map(|x| f64::from(x) * 1e3)))
                .collect())
        })
        .collect()
}

/// Released frame from the session's.
fn released_from(whisker: &WhiskerSpec) -> Matrix3<f64> {
    match whisker.rest_shape {
        RestShape::Polyline(_) => Matrix3::identity(),
        // x to y, z to x: the arc toward -z then bends toward -x.
        RestShape::StraightArc { .. } => Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    }
}

/// The bench as a model.
///
/// # Errors
/// Where the wire cannot be.
pub fn bench(whisker: &WhiskerSpec, preset: Preset) -> Result<String, TwinError> {
    let touch = Touch::RELEASED;
    let [assets, geoms] = convex_parts("tip", &tip_parts()?, &touch);
    let place = |p: [f64; 3]| format!("{} {} {}", p[0] * 1e-3, p[1] * 1e-3, p[2] * 1e-3);
    let mut around = Surroundings {
        bodies: format!(
            "<body name=\"tip\" pos=\"{}\" quat=\"0.7071 0.7071 0 0\">\
             <joint name=\"tipx\" type=\"slide\" axis=\"1 0 0\" damping=\"100\"/>\
             <joint name=\"tipz\" type=\"slide\" axis=\"0 0 1\" damping=\"100\"/>\
             <joint name=\"tipy\" type=\"slide\" axis=\"0 1 0\" damping=\"100\"/>{geoms}</body>",
            place(TIP_MM)
        ),
        head: assets,
        tail: ["x", "z", "y"].iter().fold(String::from("<actuator>"), |text, axis| {
            text + &format!("<position joint=\"tip{axis}\" kp=\"6000\" kv=\"100\"/>")
        }) + "</actuator>",
        base: [String::new(), String::new()],
    };
    match preset {
        Preset::Paper => {
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(released_from(
                whisker,
            )));
            around.base[0] = format!("pos=\"{}\" quat=\"{} {} {} {}\"", place(ROOT_MM), q.w, q.i, q.j, q.k);
            let section =
                wcal_rod::Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
            // Stiffness of a joint of the released cable, N m.
            let joint_nm = section.ei_nmm2 * 1e-3 / RELEASED_LINK_MM;
            let options = MjcfOptions {
                damping_s: RELEASED_DAMPING / joint_nm,
                armature_s2: RELEASED_ARMATURE / joint_nm,
                touch,
                ..MjcfOptions::default()
            };
            mjcf_among(whisker, &options, &around)
        }
        Preset::Released => released(whisker, around, &place(ROOT_MM)),
    }
}

/// MuJoCo's composite cable with the elasticity plugin.
fn released(whisker: &WhiskerSpec, around: Surroundings, root: &str) -> Result<String, TwinError> {
    let turn = released_from(whisker);
    let vertices: Vec<Vector3<f64>> = match &whisker.rest_shape {
        RestShape::Polyline(points) => points.clone(),
        shape @ RestShape::StraightArc { length_mm, .. } => {
            let fine = wcal_rod::Shape::new(shape, 0.25).map_err(|e| TwinError::Value {
                what: "whisker",
                expected: "a wire that can be bent".to_owned(),
                found: e.to_string(),
            })?;
            (0..VERTICES).map(|k| fine.rest_point(length_mm * k as f64 / (VERTICES - 1) as f64)).collect()
        }
    };
    let mut text = String::new();
    for p in vertices.iter().map(|p| turn * p * 1e-3) {
        let _ = write!(text, "{} {} {} ", p.x, p.y, p.z);
    }
    let density = whisker.density_kg_m3.unwrap_or(crate::mjcf::DENSITY_KG_M3);
    let Surroundings { head, bodies, tail, .. } = around;
    Ok(format!(
        "<mujoco model=\"released\"><extension><plugin plugin=\"mujoco.elasticity.cable\"/></extension>\
         <option timestep=\"0.001\" gravity=\"0 0 0\"/>{head}<worldbody><body name=\"base\" pos=\"{root}\">\
         <composite prefix=\"w\" type=\"cable\" vertex=\"{text}\" initial=\"none\">\
         <plugin plugin=\"mujoco.elasticity.cable\"><config key=\"twist\" value=\"{}\"/><config key=\"bend\" value=\"{}\"/>\
         <config key=\"flat\" value=\"false\"/></plugin>\
         <joint kind=\"main\" damping=\"{RELEASED_DAMPING}\" armature=\"{RELEASED_ARMATURE}\"/>\
         <geom type=\"capsule\" size=\"{}\" density=\"{density}\" contype=\"1\" conaffinity=\"2\" {}/></composite></body>{bodies}</worldbody>\
         {tail}<sensor><torque name=\"torque\" site=\"wS_first\"/></sensor></mujoco>",
        whisker.shear_gpa * 1e9,
        whisker.youngs_gpa * 1e9,
        whisker.diameter_mm * 0.5e-3,
        Touch::RELEASED.attributes(),
    ))
}

/// Labels at the groove's places of each trajectory (session's frame, in order of travel); trajectories run side by side.
///
/// # Errors
/// Where the engine is missing or dies.
pub fn labels(
    whisker: &WhiskerSpec,
    preset: Preset,
    trajectories: &[Vec<Vector3<f64>>],
) -> Result<Vec<Vec<PoseLabel>>, TwinError> {
    let xml = bench(whisker, preset)?;
    let turn = released_from(whisker);
    trajectories
        .par_iter()
        .map(|places| {
            let mut engine = MujocoEngine::start()?;
            engine.load(&xml, preset == Preset::Released)?;
            let mut bench = Bench { engine, turn };
            let places: Vec<Vector3<f64>> = places.iter().map(|place| turn * place).collect();
            bench.begin()?;
            let mut labels: Vec<PoseLabel> =
                places.iter().map(|place| bench.label(place)).collect::<Result<_, _>>()?;
            for (k, (place, label)) in places.iter().zip(&mut labels).enumerate() {
                // The first place is come to straight already.
                if k > 0 {
                    let there = bench.straight(place)?;
                    if let (Some(here), Some(there)) = (label.moment_nmm, there)
                        && (there - here).norm() > ELSEWHERE[0] * here.norm() + ELSEWHERE[1]
                    {
                        label.straight_nmm = Some(there);
                    }
                }
            }
            Ok(labels)
        })
        .collect()
}

/// A running bench; places in the released frame.
struct Bench {
    engine: MujocoEngine,
    turn: Matrix3<f64>,
}

impl Bench {
    fn go(&mut self, place_mm: &Vector3<f64>) -> Result<Frame, TwinError> {
        let way = (place_mm - Vector3::from(START_MM)) * 1e-3;
        let control = vec![way.x, -way.y, way.z];
        let reached = Request::Control {
            control,
            body: "tip".to_owned(),
            moved_m: REACHED_MM * 1e-3,
            steps: MOST_STEPS,
        };
        self.engine.frame(&reached)
    }

    /// From the free wire: the groove retreats, then comes to the trajectories' start.
    fn begin(&mut self) -> Result<(), TwinError> {
        self.engine.frame(&Request::Reset)?;
        self.go(&(Vector3::from(START_MM) + Vector3::y() * RETREAT_MM))?;
        self.go(&Vector3::from(START_MM)).map(drop)
    }

    /// The moment at a place that is come to straight from the start.
    fn straight(&mut self, place_mm: &Vector3<f64>) -> Result<Option<Vector3<f64>>, TwinError> {
        self.begin()?;
        self.go(place_mm)?;
        let frame = self.engine.frame(&Request::Run { steps: AGAIN_STEPS })?;
        self.moment(&frame)
    }

    fn label(&mut self, place_mm: &Vector3<f64>) -> Result<PoseLabel, TwinError> {
        self.go(place_mm)?;
        let frame = self.engine.frame(&Request::Run { steps: SETTLE_STEPS })?;
        Ok(PoseLabel {
            moment_nmm: self.moment(&frame)?,
            arclength_mm: arclength_mm(&frame),
            overlap_mm: frame.deepest_m * 1e3,
            fastest_rad_s: frame.fastest,
            settled: frame.fastest < REST_RAD_S && !frame.bad,
            straight_nmm: None,
        })
    }

    /// r x F in the session's frame. MuJoCo's torque sensor reads its reaction.
    fn moment(&self, frame: &Frame) -> Result<Option<Vector3<f64>>, TwinError> {
        if frame.bad {
            return Ok(None);
        }
        let own = frame.base_moment_nm.map(Vector3::from);
        let moment = own.or_else(|| frame.sensor_nm.map(|t| -Vector3::from(t)));
        let moment =
            moment.ok_or_else(|| TwinError::Engine("expected a base moment, found none".to_owned()))?;
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
