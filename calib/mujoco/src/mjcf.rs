//! The whisker as a MuJoCo model (MJCF, SI units): rigid links joined by three hinges a joint,
//! springs from the section's stiffness.
//!
//! Stiffness of joint j: diag(GJ, EI, EI) / span_j, span h, at the clamp h / 2; damping and
//! armature proportional to it (Rayleigh). Mass of a link: rho pi D^2 h / 4. Symbols as in
//! `wcal_rod::discrete`.
//!
//! The rest shape is in the bodies' poses, so that every spring rests at zero. Twist and bending
//! have their own stiffness, which a ball joint cannot have; three hinges in one place turn as it
//! does up to the second order of a joint's angle. The clamp's spring spans half a link: the plain
//! layout is too stiff there by 1.5/N (docs/src/method.md, Rod). No plugin is needed.

use crate::TwinError;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use serde::Serialize;
use std::f64::consts::PI;
use std::fmt::Write as _;
use wcal_core::observation::WhiskerSpec;
use wcal_rod::{DiscreteRod, Section, Shape};

/// What a model needs besides the wire. Damping and armature are stated over the stiffness: they
/// then scale with the number of links as it does, and the wire's motion does not depend on that
/// number.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MjcfOptions {
    /// Links.
    pub links: usize,
    /// Damping of a joint over its stiffness, s: the wire's material time.
    pub damping_s: f64,
    /// Armature of a joint over its stiffness, s^2: makes the light links integrable.
    pub armature_s2: f64,
    /// Step, s.
    pub step_s: f64,
    /// Turn of the clamp in the base frame, rotation vector, rad, and its offset, mm.
    pub root_turn_rad: Vector3<f64>,
    /// See `root_turn_rad`.
    pub root_offset_mm: Vector3<f64>,
    /// How the wire touches.
    pub touch: Touch,
    /// Where the model comes from: goes into a comment.
    pub provenance: String,
}

/// MuJoCo's soft contact.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Touch {
    /// Coefficient of friction; 0: none.
    pub friction: f64,
    /// Friction against turning about the normal and against rolling, m.
    pub turning_m: [f64; 2],
    /// Time constant of the contact's spring, s.
    pub time_s: f64,
    /// Impedance at touch and at `width_mm`.
    pub impedance: [f64; 2],
    /// Overlap at which the impedance is full, mm.
    pub width_mm: f64,
    /// Where between them the impedance is half way, and the power of its rise.
    pub bend: [f64; 2],
}

impl Default for Touch {
    /// Hard: what a metal wire on a solid does.
    fn default() -> Self {
        Self {
            friction: 0.2,
            turning_m: [5e-3, 1e-4],
            time_s: 2e-3,
            impedance: [0.95, 0.99],
            width_mm: 0.1,
            bend: [0.5, 2.0],
        }
    }
}

impl Touch {
    /// As released with the paper (docs/src/system.md, Twin: Cable).
    pub(crate) const RELEASED: Self = Self {
        friction: 0.2,
        turning_m: [1e-4; 2],
        time_s: 2e-3,
        impedance: [0.15, 0.4],
        width_mm: 4.0,
        bend: [0.9, 6.0],
    };

    /// Attributes of a geom.
    pub fn attributes(&self) -> String {
        let Self {
            friction,
            turning_m: [turn, roll],
            time_s,
            impedance: [d0, most],
            width_mm,
            bend,
        } = self;
        let [middle, power] = bend;
        // MuJoCo's condim: 6 with sliding, torsional and rolling friction, 1 without any.
        let kind = if *friction > 0.0 { 6 } else { 1 };
        format!(
            "condim=\"{kind}\" friction=\"{friction} {turn} {roll}\" solref=\"{time_s} 1\" solimp=\"{d0} {most} {} {middle} {power}\"",
            width_mm * 1e-3
        )
    }
}

/// What stands around the wire, as MJCF.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct WorldParts {
    /// Extensions and assets.
    pub head: String,
    /// Bodies of the world.
    pub bodies: String,
    /// Place and joints of the body that holds the wire.
    pub base: [String; 2],
    /// Actuators and sensors.
    pub tail: String,
}

impl Default for MjcfOptions {
    fn default() -> Self {
        Self {
            links: 40,
            damping_s: 0.02,
            armature_s2: 1e-6,
            step_s: 1e-3,
            root_turn_rad: Vector3::zeros(),
            root_offset_mm: Vector3::zeros(),
            touch: Touch::default(),
            provenance: String::new(),
        }
    }
}

/// Shape is read on a mesh of this step, mm.
const SHAPE_STEP_MM: f64 = 0.25;

/// The wire's model by itself.
///
/// # Errors
/// Where the wire cannot be, or an option is not above zero.
pub fn mjcf(whisker: &WhiskerSpec, options: &MjcfOptions) -> Result<String, TwinError> {
    mjcf_among(whisker, options, &WorldParts::default())
}

/// The wire's model among other things.
///
/// # Errors
/// As [`mjcf`].
pub fn mjcf_among(
    whisker: &WhiskerSpec,
    options: &MjcfOptions,
    around: &WorldParts,
) -> Result<String, TwinError> {
    let refuse =
        |what: &'static str, expected: &str, found: String| TwinError::value(what, expected, found);
    if !(options.step_s > 0.0 && options.step_s.is_finite()) {
        return Err(refuse("step_s", "above 0", options.step_s.to_string()));
    }
    for (what, value) in [
        ("damping_s", options.damping_s),
        ("armature_s2", options.armature_s2),
    ] {
        if !(value >= 0.0 && value.is_finite()) {
            return Err(refuse(what, "0 or more", value.to_string()));
        }
    }
    let shape = Shape::new(&whisker.rest_shape, SHAPE_STEP_MM)
        .map_err(|e| refuse("whisker", "a wire that can be bent", e.to_string()))?;
    let section = Section::round(whisker.diameter_mm, whisker.youngs_gpa, whisker.shear_gpa);
    let rod = DiscreteRod::new(&section, &shape, whisker.diameter_mm, options.links)
        .map_err(|e| refuse("whisker", "a wire that can be bent", e.to_string()))?;
    let (joints, h_m) = (rod.joints(), rod.link_mm * 1e-3);
    let density = whisker.density_or_niti_kg_m3();
    // Of the cylinder, not of the capsule: the round ends overlap.
    let mass_kg = density * PI * (whisker.diameter_mm * 0.5e-3).powi(2) * h_m;
    let root = Rotation3::from_scaled_axis(options.root_turn_rad)
        * Rotation3::from_matrix_unchecked(shape.root);
    let mut text = String::new();
    let mut line = |depth: usize, content: &str| {
        let _ = writeln!(text, "{:indent$}{content}", "", indent = depth.min(20) * 2);
    };
    line(0, "<mujoco model=\"whisker\">");
    line(1, &format!("<!-- {} -->", comment(&options.provenance)));
    line(1, "<compiler angle=\"radian\" autolimits=\"true\"/>");
    let step = options.step_s;
    line(
        1,
        &format!("<option timestep=\"{step}\" integrator=\"implicitfast\" gravity=\"0 0 0\"/>"),
    );
    line(1, &around.head);
    line(1, "<worldbody>");
    line(2, &around.bodies);
    line(2, &format!("<body name=\"base\" {}>", around.base[0]));
    line(3, &around.base[1]);
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
                    k * options.armature_s2
                ),
            );
        }
        line(
            depth + 1,
            &format!(
                "<geom name=\"wire{j}\" type=\"capsule\" fromto=\"0 0 0 {h_m} 0 0\" size=\"{}\" mass=\"{mass_kg}\" contype=\"1\" conaffinity=\"2\" {}/>",
                whisker.diameter_mm * 0.5e-3,
                options.touch.attributes()
            ),
        );
        (turn, place) = (UnitQuaternion::identity(), Vector3::new(h_m, 0.0, 0.0));
    }
    line(
        3 + joints.len(),
        &format!("<site name=\"tip\" pos=\"{h_m} 0 0\"/>"),
    );
    for j in (0..joints.len()).rev() {
        line(3 + j, "</body>");
    }
    line(2, "</body>");
    line(1, "</worldbody>");
    line(1, &around.tail);
    line(0, "</mujoco>");
    Ok(text)
}

/// Convex parts (corners, mm) as assets and as geoms of a body, each with its name.
pub fn convex_parts(prefix: &str, parts: &[Vec<Vector3<f64>>], touch: &Touch) -> [String; 2] {
    let mut text = [String::from("<asset>"), String::new()];
    for (k, part) in parts.iter().enumerate() {
        let _ = write!(text[0], "<mesh name=\"{prefix}{k}\" vertex=\"");
        for p in part {
            let _ = write!(text[0], "{} {} {} ", p.x * 1e-3, p.y * 1e-3, p.z * 1e-3);
        }
        text[0].push_str("\"/>");
        let _ = write!(
            text[1],
            "<geom name=\"{prefix}{k}\" type=\"mesh\" mesh=\"{prefix}{k}\" contype=\"2\" conaffinity=\"1\" {}/>",
            touch.attributes()
        );
    }
    text[0].push_str("</asset>");
    text
}

/// Two hyphens end a comment.
fn comment(text: &str) -> String {
    text.replace("--", "- -")
}
