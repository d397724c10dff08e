//! The rod under a shape's load, and how far a measured line is from it.
//!
//! Base frame: r(s) = A r_w(s) + b with the clamp's turn A and offset b; the groove point in the
//! wire's frame is A^T (P - b). Distance of a measured p: s <- s + (p - r(s)) . t(s) twice from the
//! measured arc length, then the parts of p - r(s) along the two transverse axes. Between nodes r
//! is the cubic Hermite interpolant of places and tangents (C. de Boor, "A Practical Guide to
//! Splines", 2001, ch. IV).

use super::model::RestModel;
use crate::{Guess, Rod, Tangential, WORKING_STEP_MM, interpolated_point};
use nalgebra::{DVector, Matrix3, Vector3};
use wcal_core::observation::WhiskerSpec;

/// A measured centre line.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredShape {
    /// Name of the pair.
    pub name: String,
    /// Points from the root to the tip, base frame, mm.
    pub centreline_mm: Vec<Vector3<f64>>,
    /// Standard deviation across the line, one a point, mm.
    pub sd_mm: Vec<f64>,
    /// Length and its standard deviation, mm.
    pub length_mm: [f64; 2],
    /// The wire's centre in the groove, base frame, mm, and its arc length, mm; none for a free
    /// wire.
    pub groove: Option<(Vector3<f64>, f64)>,
}

/// Parts in which the groove is brought to its place.
const LEGS: usize = 8;

/// A shape and where Newton starts for it: the equilibrium at the nominal geometry, if it is held.
#[derive(Clone, Copy)]
pub(super) struct GuessedShape<'a> {
    pub shape: &'a MeasuredShape,
    pub guess: Option<Guess>,
}

/// Nodes of a wire: arc length, position, frame; base frame.
pub(super) type Nodes = Vec<(f64, Vector3<f64>, Matrix3<f64>)>;

/// The wire under a shape's load, and its equilibrium.
pub(super) fn loaded_nodes(
    nominal: &WhiskerSpec,
    model: RestModel,
    v: &DVector<f64>,
    held: &GuessedShape<'_>,
) -> Result<(Nodes, Option<Guess>), String> {
    let mut rod = Rod::new(nominal, WORKING_STEP_MM).map_err(|e| e.to_string())?;
    rod.shape = model.shape(v, WORKING_STEP_MM).map_err(|e| e.to_string())?;
    let (turn, offset) = model.root(v);
    let Some((point, arclength_mm)) = &held.shape.groove else {
        let (positions, frames) = (&rod.shape.nodes_mm, &rod.shape.frames);
        let ends = rod
            .shape
            .intervals
            .iter()
            .map(|i| i.start_mm)
            .chain([rod.shape.length_mm]);
        let nodes = ends
            .zip(positions)
            .zip(frames)
            .map(|((s, p), f)| (s, turn * p + offset, turn * f));
        return Ok((nodes.collect(), None));
    };
    // In the wire's frame the clamp is straight and the groove moves instead.
    let point = turn.inverse() * (point - offset);
    let solve = |at: &Vector3<f64>, guess: &Guess| rod.solve(at, guess, Tangential::Frictionless);
    let near = held.guess.and_then(|guess| solve(&point, &guess).ok());
    let found = match near {
        Some(found) => found,
        None => {
            // Continuation from the free wire, leg by leg, where no equilibrium near is known.
            let from = rod.shape.rest_point(*arclength_mm);
            let mut guess = Guess {
                force_n: Vector3::zeros(),
                arclength_mm: *arclength_mm,
            };
            for leg in 1..LEGS {
                let at = from + (point - from) * (leg as f64 / LEGS as f64);
                guess = Guess::from(&solve(&at, &guess).map_err(unreached)?);
            }
            solve(&point, &guess).map_err(unreached)?
        }
    };
    let nodes = rod
        .loaded_shape(&found)
        .into_iter()
        .map(|(s, p, f)| (s, turn * p + offset, turn * f));
    Ok((nodes.collect(), Some(Guess::from(&found))))
}

fn unreached(failure: crate::Failure) -> String {
    format!("the rod does not reach the groove ({failure:?})")
}

/// Of every measured point: arc length and distances along the rod's two transverse axes, mm.
pub(super) fn distances(
    nominal: &WhiskerSpec,
    model: RestModel,
    v: &DVector<f64>,
    held: &GuessedShape<'_>,
) -> Result<Vec<(f64, [f64; 2])>, String> {
    let (shape, (nodes, _)) = (held.shape, loaded_nodes(nominal, model, v, held)?);
    let mut s_mm = 0.0;
    let mut out = Vec::with_capacity(shape.centreline_mm.len());
    for (k, p) in shape.centreline_mm.iter().enumerate() {
        if k > 0 {
            s_mm += (p - shape.centreline_mm[k - 1]).norm();
        }
        // The nearest place: from equal arc length along the tangent, twice.
        let mut s = s_mm;
        let mut at = on_curve(&nodes, s);
        for _ in 0..2 {
            s += (p - at.0).dot(&at.1.column(0));
            at = on_curve(&nodes, s);
        }
        let off = p - at.0;
        out.push((s_mm, [off.dot(&at.1.column(1)), off.dot(&at.1.column(2))]));
    }
    Ok(out)
}

/// Place and frame at an arc length: a cubic through two nodes and their tangents, straight on
/// beyond the ends.
fn on_curve(nodes: &Nodes, s_mm: f64) -> (Vector3<f64>, Matrix3<f64>) {
    let after = nodes
        .partition_point(|n| n.0 < s_mm)
        .clamp(1, nodes.len() - 1);
    let (before, after) = (&nodes[after - 1], &nodes[after]);
    let nearer = if s_mm - before.0 < 0.5 * (after.0 - before.0) {
        before
    } else {
        after
    };
    // A measured point past the tip has a distance, too.
    if s_mm < before.0 || s_mm > after.0 {
        return (nearer.1 + nearer.2.column(0) * (s_mm - nearer.0), nearer.2);
    }
    (interpolated_point(nodes, s_mm), nearer.2)
}
