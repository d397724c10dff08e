//! The released twin's bench: the whisker at its clamp and the V-groove's tip on three slides
//! (facts: groove_tip/SOURCE.md).
//!
//! In the released frame the wire leaves its root along +y and bends toward -x; the groove comes
//! from +y. Sessions in the default frame (x distal, arc toward -z) are turned into it and back.

use crate::TwinError;
use crate::mjcf::{MjcfOptions, Touch, WorldParts, convex_parts, mjcf_among};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::fmt::Write as _;
use wcal_core::observation::{RestShape, WhiskerSpec};
use wcal_mesh::MeshError;
use wcal_mesh::stl::Stl;

/// Which twin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Preset {
    /// As released: MuJoCo's composite cable with a rigid first link, the released damping and
    /// contact.
    Released,
    /// The whisker as measured: clamp right to second order, 40 links; damping, armature and
    /// contact as released, scaled with the links: that contact is soft where joints are lighter,
    /// and the wire sinks through the tip.
    Paper,
}

/// Groove's place at which its tip's body is at [`TIP_MM`], released frame.
pub(crate) const START_MM: [f64; 3] = [0.0, 7.855, 0.0];
/// Tip's body and the root in the world, mm.
const TIP_MM: [f64; 3] = [0.0, 65.383, 25.85];
const ROOT_MM: [f64; 3] = [0.0, 0.0, 50.0];
/// Mass of the tip, kg: the released model counts its parts and its picture. It only slides; how it
/// swings in decides where friction holds the wire.
const TIP_KG: f64 = 0.037_658_68;
/// Vertices of the cable that stands for an arc.
const VERTICES: usize = 40;
/// Joint damping (N m s/rad) and armature (kg m^2) as released.
const RELEASED_DAMPING: f64 = 0.005;
const RELEASED_ARMATURE: f64 = 3e-5;
/// Link of the released cable, mm.
const RELEASED_LINK_MM: f64 = 1.4345;

/// The tip's convex parts (mm), as released.
///
/// # Errors
/// Where the built-in files are damaged.
fn tip_parts() -> Result<Vec<Vec<Vector3<f64>>>, TwinError> {
    macro_rules! parts {
        ($($k:literal)*) => { [$(&include_bytes!(concat!("../groove_tip/parts_", $k, ".stl"))[..]),*] };
    }
    parts!(0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18)
        .into_iter()
        .map(|bytes| {
            let wrong = |found| TwinError::from(MeshError::Engine(format!("groove_tip: {found}")));
            let stl = Stl::parse(bytes).map_err(wrong)?;
            Ok(stl
                .points
                .iter()
                .map(|v| Vector3::from(v.map(|x| f64::from(x) * 1e3)))
                .collect())
        })
        .collect()
}

/// Released frame from the session's.
pub(crate) fn released_from(whisker: &WhiskerSpec) -> Matrix3<f64> {
    match whisker.rest_shape {
        RestShape::Polyline(_) => Matrix3::identity(),
        // x to y, z to x: the arc toward -z then bends toward -x.
        RestShape::StraightArc { .. } => Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0),
    }
}

/// The bench as a model; `touch` of wire and groove.
///
/// # Errors
/// Where the wire cannot be.
pub fn bench(whisker: &WhiskerSpec, preset: Preset, touch: Touch) -> Result<String, TwinError> {
    let [assets, geoms] = convex_parts("tip", &tip_parts()?, &touch);
    let place = |p: [f64; 3]| format!("{} {} {}", p[0] * 1e-3, p[1] * 1e-3, p[2] * 1e-3);
    let mut around = WorldParts {
        bodies: format!(
            "<body name=\"tip\" pos=\"{}\" quat=\"0.7071068 0.7071068 0 0\">\
             <inertial pos=\"0 0 0\" mass=\"{TIP_KG}\" diaginertia=\"1e-5 1e-5 1e-5\"/>\
             <joint name=\"tipx\" type=\"slide\" axis=\"1 0 0\" damping=\"100\"/>\
             <joint name=\"tipz\" type=\"slide\" axis=\"0 0 1\" damping=\"100\"/>\
             <joint name=\"tipy\" type=\"slide\" axis=\"0 1 0\" damping=\"100\"/>{geoms}</body>",
            place(TIP_MM)
        ),
        head: assets,
        tail: ["x", "z", "y"]
            .iter()
            .fold(String::from("<actuator>"), |text, axis| {
                text + &format!("<position joint=\"tip{axis}\" kp=\"6000\" kv=\"100\"/>")
            })
            + "</actuator>",
        base: [String::new(), String::new()],
    };
    match preset {
        Preset::Paper => {
            let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
                released_from(whisker),
            ));
            around.base[0] = format!(
                "pos=\"{}\" quat=\"{} {} {} {}\"",
                place(ROOT_MM),
                q.w,
                q.i,
                q.j,
                q.k
            );
            let usual = paper_options(whisker);
            let options = MjcfOptions { touch, ..usual };
            mjcf_among(whisker, &options, &around)
        }
        Preset::Released => released(whisker, around, &place(ROOT_MM), &touch),
    }
}

/// The wire of [`Preset::Paper`]: damping, armature and contact as released, scaled with the links.
pub fn paper_options(whisker: &WhiskerSpec) -> MjcfOptions {
    let section =
        wcal_rod::Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
    // Stiffness of a joint of the released cable, N m.
    let joint_nm = section.ei_nmm2 * 1e-3 / RELEASED_LINK_MM;
    MjcfOptions {
        damping_s: RELEASED_DAMPING / joint_nm,
        armature_s2: RELEASED_ARMATURE / joint_nm,
        touch: Touch::RELEASED,
        ..MjcfOptions::default()
    }
}

/// MuJoCo's composite cable with the elasticity plugin.
fn released(
    whisker: &WhiskerSpec,
    around: WorldParts,
    root: &str,
    touch: &Touch,
) -> Result<String, TwinError> {
    let turn = released_from(whisker);
    let vertices: Vec<Vector3<f64>> = match &whisker.rest_shape {
        RestShape::Polyline(points) => points.clone(),
        shape @ RestShape::StraightArc { length_mm, .. } => {
            let fine = wcal_rod::Shape::new(shape, 0.25).map_err(|e| {
                TwinError::value("whisker", "a wire that can be bent", e.to_string())
            })?;
            (0..VERTICES)
                .map(|k| fine.rest_point(length_mm * k as f64 / (VERTICES - 1) as f64))
                .collect()
        }
    };
    let mut text = String::new();
    for p in vertices.iter().map(|p| turn * p * 1e-3) {
        let _ = write!(text, "{} {} {} ", p.x, p.y, p.z);
    }
    let density = whisker.density_or_niti_kg_m3();
    let WorldParts {
        head, bodies, tail, ..
    } = around;
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
        touch.attributes(),
    ))
}
