//! What the rest shape may be: a straight part with an arc, or a curvature that is free along the
//! wire.
//!
//! Straight and arc: v = (straight a, radius R, length L); free: both transverse curvatures at n
//! places s_k = k L / (n - 1), linear between them. The clamp follows: turn exp([w]x) and offset
//! across the wire. A free curvature leaves out w_x, which turns all curvatures alike.

use crate::{RodError, Shape};
use nalgebra::{DVector, Rotation3, Vector3};
use wcal_core::observation::RestShape;

/// Differences for the Jacobian, far above Newton's tolerance and far below what is measured:
/// lengths (mm), curvatures (1/mm), turns of the clamp (rad), its offsets (mm).
const DIFFERENCE_STEPS: [f64; 4] = [1e-3, 1e-6, 1e-5, 1e-4];
/// First point of a free wire's polyline, and distance of the others, mm: its first edge is the
/// clamp's tangent.
const FIRST_MM: f64 = 0.01;
const POINTS_MM: f64 = 0.5;

/// Model of the rest shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RestModel {
    /// Straight part and arc in one plane.
    StraightArc,
    /// Both curvatures piecewise linear between so many places, evenly spread from root to tip. The
    /// clamp does not turn about the wire: the curvatures' direction says the same.
    FreeCurvature(usize),
}

impl RestModel {
    /// Name in the results.
    pub fn name(self) -> String {
        match self {
            Self::StraightArc => "straight-arc".to_owned(),
            Self::FreeCurvature(places) => format!("free-curvature-{places}"),
        }
    }

    /// Unknowns of the shape; the last of them is the length.
    pub(super) fn shape_unknowns(self) -> usize {
        match self {
            Self::StraightArc => 3,
            Self::FreeCurvature(places) => 2 * places + 1,
        }
    }

    /// Names and units of the unknowns, in order.
    pub fn names(self) -> Vec<String> {
        let owned = |names: &[&str]| names.iter().map(|n| (*n).to_owned()).collect::<Vec<_>>();
        let root = [
            "root_turn_x_rad",
            "root_turn_y_rad",
            "root_turn_z_rad",
            "root_offset_y_mm",
            "root_offset_z_mm",
        ];
        match self {
            Self::StraightArc => [
                owned(&["straight_mm", "arc_radius_mm", "length_mm"]),
                owned(&root),
            ]
            .concat(),
            Self::FreeCurvature(places) => {
                let bends = ["y", "z"]
                    .iter()
                    .flat_map(|axis| (0..places).map(move |k| format!("bend_{axis}_{k}_per_mm")));
                [bends.collect(), owned(&["length_mm"]), owned(&root[1..])].concat()
            }
        }
    }

    /// Steps for derivatives.
    pub fn difference_steps(self) -> Vec<f64> {
        let kind = |name: &String| match name {
            n if n.starts_with("bend") => DIFFERENCE_STEPS[1],
            n if n.ends_with("rad") => DIFFERENCE_STEPS[2],
            n if n.starts_with("root") => DIFFERENCE_STEPS[3],
            _ => DIFFERENCE_STEPS[0],
        };
        self.names().iter().map(kind).collect()
    }

    /// Whether values can be a wire's.
    pub(super) fn is_admissible(self, v: &DVector<f64>) -> bool {
        v.iter().all(|x| x.is_finite()) && v[self.shape_unknowns() - 1] > 0.0
    }

    /// Places of the free curvatures, mm.
    pub fn places_mm(self, v: &DVector<f64>) -> Vec<f64> {
        match self {
            Self::StraightArc => Vec::new(),
            Self::FreeCurvature(n) => (0..n)
                .map(|k| v[2 * n] * k as f64 / (n - 1) as f64)
                .collect(),
        }
    }

    /// The shape in its own frame, on a mesh.
    pub(super) fn shape(self, v: &DVector<f64>, step_mm: f64) -> Result<Shape, RodError> {
        match self {
            Self::StraightArc => Shape::new(&arc(v), step_mm),
            Self::FreeCurvature(n) => {
                let bends: Vec<[f64; 2]> = (0..n).map(|k| [v[k], v[n + k]]).collect();
                Shape::from_curvature(v[2 * n], &bends, step_mm)
            }
        }
    }

    /// The shape as the other commands read it: a free one as a polyline.
    ///
    /// # Errors
    /// Where the values are no wire's.
    pub fn rest_shape(self, v: &DVector<f64>) -> Result<RestShape, RodError> {
        if self == Self::StraightArc {
            return Ok(arc(v));
        }
        let shape = self.shape(v, POINTS_MM / 2.0)?;
        let steps = (shape.length_mm / POINTS_MM).ceil();
        let places = (1..=steps as usize).map(|k| shape.length_mm * k as f64 / steps);
        Ok(RestShape::Polyline(
            [0.0, FIRST_MM]
                .into_iter()
                .chain(places)
                .map(|s| shape.rest_point(s))
                .collect(),
        ))
    }

    /// Turn of the clamp in the base frame, and its offset, mm.
    pub fn root(self, v: &DVector<f64>) -> (Rotation3<f64>, Vector3<f64>) {
        let root: Vec<f64> = v.iter().skip(self.shape_unknowns()).copied().collect();
        let (turns, offsets) = root.split_at(root.len() - 2);
        let about_x = if let [x, _, _] = turns { *x } else { 0.0 };
        let turn = Vector3::new(about_x, turns[turns.len() - 2], turns[turns.len() - 1]);
        (
            Rotation3::new(turn),
            Vector3::new(0.0, offsets[0], offsets[1]),
        )
    }

    /// A straight part with an arc, in this model's unknowns.
    #[allow(
        clippy::wrong_self_convention,
        reason = "parameters of this model from a shape"
    )]
    pub(super) fn from_arc(self, v: &DVector<f64>) -> DVector<f64> {
        let Self::FreeCurvature(n) = self else {
            return v.clone();
        };
        let (straight_mm, bend, length_mm, roll) = (v[0], 1.0 / v[1], v[2], v[3]);
        let cell_mm = length_mm / (n - 1) as f64;
        // Each place takes what lies nearest to it.
        let share = |k: usize| {
            let at = k as f64 * cell_mm;
            let (from, to) = (
                (at - cell_mm / 2.0).max(0.0),
                (at + cell_mm / 2.0).min(length_mm),
            );
            ((to - straight_mm) / (to - from)).clamp(0.0, 1.0)
        };
        // A turn of the clamp about the wire is the direction of all curvatures.
        let bends = [roll.cos(), roll.sin()]
            .into_iter()
            .flat_map(|part| (0..n).map(move |k| bend * part * share(k)));
        DVector::from_iterator(
            2 * n + 5,
            bends.chain([length_mm]).chain(v.iter().skip(4).copied()),
        )
    }
}

fn arc(v: &DVector<f64>) -> RestShape {
    RestShape::StraightArc {
        straight_mm: v[0],
        arc_radius_mm: v[1],
        length_mm: v[2],
    }
}
