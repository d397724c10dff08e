//! The whisker as a MuJoCo model (MJCF, SI units): rigid links joined by three hinges a joint, springs from the section's stiffness.
//!
//! The rest shape is in the bodies' poses, so that every spring rests at zero. Twist and bending have their own stiffness, which a ball
//! joint cannot have; three hinges in one place turn as it does up to the second order of a joint's angle. The clamp's spring spans half
//! a link: the plain layout is too stiff there by 1.5/N (TRACING, Rod). No plugin is needed.

use crate::TwinError;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::PI;
use std::fmt::Write as _;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{Chain, Section, Shape};

/// What a model needs besides the wire.
#[derive(Debug, Clone, PartialEq)]
pub struct MjcfOptions {
    /// Links.
    pub links: usize,
    /// Damping of a joint over its stiffness, s: the wire's material time.
    pub damping_s: f64,
    /// Armature of a joint, kg m^2: makes the light links integrable.
    pub armature_kg_m2: f64,
    /// Step, s.
    pub step_s: f64,
    /// Turn of the clamp in the base frame, rotation vector, rad, and its offset, mm.
    pub root_turn_rad: Vector3<f64>,
    /// See `root_turn_rad`.
    pub root_offset_mm: Vector3<f64>,
    /// Where the model comes from: goes into a comment.
    pub provenance: String,
}

impl Default for MjcfOptions {
    fn default() -> Self {
        Self {
            links: 40,
            damping_s: 0.02,
            armature_kg_m2: 1e-9,
            step_s: 1e-3,
            root_turn_rad: Vector3::zeros(),
            root_offset_mm: Vector3::zeros(),
            provenance: String::new(),
        }
    }
}

/// Shape is read on a mesh of this step, mm.
const SHAPE_STEP_MM: f64 = 0.25;
/// Density where none is given, kg/m^3 (NiTi, SYSTEM).
const DENSITY_KG_M3: f64 = 6450.0;

/// The model's text.
///
/// # Errors
/// Where the wire cannot be, or an option is not above zero.
pub fn mjcf(whisker: &WhiskerSpec, options: &MjcfOptions) -> Result<String, TwinError> {
    let refuse = |what: &'static str, expected: &str, found: String| TwinError::Value {
        what,
        expected: expected.to_owned(),
        found,
    };
    for (what, value) in [("step_s", options.step_s), ("damping_s", options.damping_s)] {
        if !(value > 0.0 && value.is_finite()) {
            return Err(refuse(what, "above 0", value.to_string()));
        }
    }
    let shape = Shape::new(&whisker.rest_shape, SHAPE_STEP_MM)
        .map_err(|e| refuse("whisker", "a wire that can be bent", e.to_string()))?;
    let section = Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
    let chain = Chain::new(&section, &shape, whisker.diameter_mm, options.links)
        .map_err(|e| refuse("whisker", "a wire that can be bent", e.to_string()))?;
    let (joints, h_m) = (chain.joints(), chain.link_mm * 1e-3);
    let density = whisker.density_kg_m3.unwrap_or(DENSITY_KG_M3);
    // Of the cylinder, not of the capsule: the round ends overlap.
    let mass_kg = density * PI * (whisker.diameter_mm * 0.5e-3).powi(2) * h_m;
    let root =
        Rotation3::from_scaled_axis(options.root_turn_rad) * Rotation3::from_matrix_unchecked(shape.root);
    let mut text = String::new();
    let mut line = |depth: usize, content: &str| {
        let _ = writeln!(text, "{:indent$}{content}", "", indent = depth.min(20) * 2);
    };
    line(0, "<mujoco model=\"whisker\">");
    line(1, &format!("<!-- {} -->", comment(&options.provenance)));
    line(1, "<compiler angle=\"radian\" autolimits=\"true\"/>");
    let step = options.step_s;
    line(1, &format!("<option timestep=\"{step}\" integrator=\"implicitfast\" gravity=\"0 0 0\"/>"));
    line(1, "<worldbody>");
    line(2, "<body name=\"base\">");
    let mut turn = UnitQuaternion::from_rotation_matrix(&root);
    let mut place = options.root_offset_mm * 1e-3;
    for (j, (rest, stiffness)) in joints.iter().enumerate() {
        let depth = 3 + j;
        turn *= UnitQuaternion::from_scaled_axis(*rest);
        line(
            depth,
            &format!(
                "<body name=\"link{j}\" pos=\"{} {} {}\" quat=\"{} {} {} {}\">",
                place.x, place.y, place.z, turn.w, turn.i, turn.j, turn.k
            ),
        );
        for (name, axis, k) in [("x", "1 0 0", 0), ("y", "0 1 0", 1), ("z", "0 0 1", 2)] {
            // N mm to N m.
            let k = stiffness[k] * 1e-3;
            line(
                depth + 1,
                &format!(
                    "<joint name=\"joint{j}{name}\" type=\"hinge\" axis=\"{axis}\" stiffness=\"{k}\" damping=\"{}\" armature=\"{}\"/>",
                    k * options.damping_s,
                    options.armature_kg_m2
                ),
            );
        }
        line(
            depth + 1,
            &format!(
                "<geom name=\"wire{j}\" type=\"capsule\" fromto=\"0 0 0 {h_m} 0 0\" size=\"{}\" mass=\"{mass_kg}\" contype=\"1\" conaffinity=\"2\"/>",
                whisker.diameter_mm * 0.5e-3
            ),
        );
        (turn, place) = (UnitQuaternion::identity(), Vector3::new(h_m, 0.0, 0.0));
    }
    line(3 + joints.len(), &format!("<site name=\"tip\" pos=\"{h_m} 0 0\"/>"));
    for j in (0..joints.len()).rev() {
        line(3 + j, "</body>");
    }
    line(2, "</body>");
    line(1, "</worldbody>");
    line(0, "</mujoco>");
    Ok(text)
}

/// Two hyphens end a comment.
fn comment(text: &str) -> String {
    text.replace("--", "- -")
}
