//! The frame in which contacts are computed, whatever the orientation in which a session describes
//! its wire.
//!
//! ```text
//! x = +-(a_1 x a_2) toward the wire's side,   z = -(b - (b . x) x) / |..|,   y = z x x          b: direction in which the wire bends
//! m_i = sigma a_i . M        so  [M_y, M_z] = sigma C m,   C = ([a_i . e_j])^-1 for e = (y, z)
//! p = R p_base,   m = sigma C m_base,   cov m = C cov m_base C'
//! ```
//!
//! a_1, a_2, sigma: the axes and the sign of the moments that the calibration gives. The moments do
//! not see the component along x; the root may lean against it. A wire that is given by lengths
//! (straight along x, bending toward -z) with moments about y and z stays as it is.

use crate::observation::{MomentAxes, RestShape, WhiskerSpec};
use crate::ranges::OutOfRange;
use nalgebra::{Matrix2, Matrix3, Rotation3, Vector2, Vector3};

/// Smallest sine of the angle between the axes of the moments, and cosine of that between their
/// normal and the wire's root: 60 degrees.
const MIN_SINE: f64 = 0.1;
const MIN_COSINE: f64 = 0.5;
/// A wire whose tip is off its root's direction by less than this share of its length is straight.
const STRAIGHT: f64 = 1e-6;
/// Distance of the points of a wire that is given by lengths, mm.
const STEP_MM: f64 = 0.25;

/// The frame of a wire.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct WireFrame {
    /// R: base coordinates to those of the wire's frame; none where they are the same.
    wire_from_base: Option<(Rotation3<f64>, Matrix2<f64>)>,
}

impl WireFrame {
    /// Of a whisker whose moments are components along `axes`.
    ///
    /// # Errors
    /// Where the axes do not span a plane across the wire's root.
    pub fn new(whisker: &WhiskerSpec, axes: &MomentAxes) -> Result<Self, OutOfRange> {
        if matches!(whisker.rest_shape, RestShape::StraightArc { .. })
            && *axes == MomentAxes::default()
        {
            return Ok(Self {
                wire_from_base: None,
            });
        }
        let refuse = |expected: &str, found: String| OutOfRange {
            key: "moments.axes".to_owned(),
            expected: expected.to_owned(),
            found,
        };
        let (tangent, bend) = match &whisker.rest_shape {
            RestShape::StraightArc { .. } => (Vector3::x(), -Vector3::z()),
            RestShape::Polyline(points) => root_and_bend(points),
        };
        let [a, b] = axes.axes.map(|a| a.normalize());
        // |a x b| is the sine of the angle between the axes: of a small one they span no plane.
        let normal = a.cross(&b).try_normalize(MIN_SINE);
        let x = normal.map(|n| n * n.dot(&tangent).signum());
        let Some(x) = x.filter(|x| x.dot(&tangent) >= MIN_COSINE) else {
            let found = format!(
                "{:?} and {:?} at a root along {tangent:?}",
                axes.axes[0], axes.axes[1]
            );
            return Err(refuse("two directions across the wire's root", found));
        };
        // A straight wire: the second axis, which turns with the session.
        let bend = if bend.norm() > STRAIGHT { bend } else { -b };
        // The wire bends toward -z, in the plane across its root.
        let across = bend - x * bend.dot(&x);
        let z = -across.try_normalize(1e-12).unwrap_or(-b);
        let y = z.cross(&x);
        let turn = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
        // What the two axes see of moments about y and z; its inverse is C.
        let seen = Matrix2::new(a.dot(&y), a.dot(&z), b.dot(&y), b.dot(&z));
        let Some(mix) = seen.try_inverse() else {
            return Err(refuse("two directions", "one".to_owned()));
        };
        Ok(Self {
            wire_from_base: Some((Rotation3::from_matrix_unchecked(turn), mix * axes.sign)),
        })
    }

    /// The whisker in this frame.
    pub fn whisker(&self, whisker: &WhiskerSpec) -> WhiskerSpec {
        let Some((turn, _)) = &self.wire_from_base else {
            return whisker.clone();
        };
        let points = match &whisker.rest_shape {
            RestShape::Polyline(points) => points.clone(),
            // Other moments of a wire that is given by lengths: it lies along x already.
            RestShape::StraightArc { .. } if is_identity(turn) => return whisker.clone(),
            arc @ RestShape::StraightArc { .. } => arc.points(STEP_MM),
        };
        WhiskerSpec {
            rest_shape: RestShape::Polyline(points.iter().map(|p| turn * p).collect()),
            gravity_direction: whisker.gravity_direction.map(|g| turn * g),
            ..whisker.clone()
        }
    }

    /// Rotation from base coordinates to those of this frame.
    pub fn rotation(&self) -> Rotation3<f64> {
        self.wire_from_base
            .as_ref()
            .map_or_else(Rotation3::identity, |(turn, _)| *turn)
    }

    /// Moments (N mm) as components along y and z of this frame.
    pub fn moment(&self, moment_nmm: [f64; 2]) -> [f64; 2] {
        self.wire_from_base.as_ref().map_or(moment_nmm, |(_, mix)| {
            (mix * Vector2::from(moment_nmm)).into()
        })
    }

    /// Their covariance, (N mm)^2.
    pub fn covariance(&self, nmm2: &Matrix2<f64>) -> Matrix2<f64> {
        self.wire_from_base
            .as_ref()
            .map_or(*nmm2, |(_, mix)| mix * nmm2 * mix.transpose())
    }

    /// Way of the base past an object at rest that sweeps have: against the wire's bend. Base
    /// frame.
    pub fn sweep_direction(&self) -> Vector3<f64> {
        self.rotation().inverse() * Vector3::z()
    }

    /// Whether coordinates are those of the base.
    pub fn is_base(&self) -> bool {
        self.wire_from_base.is_none()
    }
}

fn is_identity(turn: &Rotation3<f64>) -> bool {
    (turn.matrix() - Matrix3::identity()).norm() < 1e-12
}

/// Direction of a wire at its root, and where its tip is off that direction, over its length.
fn root_and_bend(points: &[Vector3<f64>]) -> (Vector3<f64>, Vector3<f64>) {
    let length_mm: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let first = points
        .windows(2)
        .map(|w| w[1] - w[0])
        .find_map(|e| e.try_normalize(1e-9));
    let tangent = first.unwrap_or_else(Vector3::x);
    let chord = points
        .last()
        .zip(points.first())
        .map_or_else(Vector3::zeros, |(tip, root)| tip - root);
    (
        tangent,
        (chord - tangent * chord.dot(&tangent)) / length_mm.max(1e-9),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wire() -> WhiskerSpec {
        let shape = WhiskerSpec::nominal().rest_shape;
        WhiskerSpec {
            rest_shape: RestShape::Polyline(shape.points(0.5)),
            ..WhiskerSpec::nominal()
        }
    }

    #[test]
    fn a_turned_wire_has_the_same_shape_and_moments_in_its_frame() {
        let spec = WhiskerSpec::nominal();
        assert!(
            WireFrame::new(&spec, &MomentAxes::default())
                .unwrap()
                .is_base()
        );
        let moment = Vector3::new(0.1, 0.7, -0.4);
        let plain = WireFrame::new(&wire(), &MomentAxes::default()).unwrap();
        let own = plain.whisker(&wire());
        for (k, sign) in (0..20).zip([1.0, -1.0].into_iter().cycle()) {
            let turn = Rotation3::from_euler_angles(
                0.3 * f64::from(k),
                1.1 * f64::from(k),
                -0.7 * f64::from(k),
            );
            let RestShape::Polyline(points) = wire().rest_shape else {
                unreachable!()
            };
            let rest_shape = RestShape::Polyline(points.iter().map(|p| turn * p).collect());
            // Other axes in the same plane, not at right angles.
            let axes = [
                turn * Vector3::new(0.0, 1.0, 0.2).normalize(),
                turn * Vector3::new(0.0, -0.5, 1.0).normalize(),
            ];
            let axes = MomentAxes { axes, sign };
            let turned = WhiskerSpec {
                rest_shape,
                ..wire()
            };
            let frame = WireFrame::new(&turned, &axes).unwrap();
            let (a, b) = (
                own.rest_shape.points(1.0),
                frame.whisker(&turned).rest_shape.points(1.0),
            );
            assert!(a.iter().zip(&b).all(|(a, b)| (a - b).norm() < 1e-9), "{k}");
            let seen = frame.moment(axes.components_nmm(&(turn * moment)));
            assert!(
                (seen[0] - 0.7).abs() < 1e-12 && (seen[1] + 0.4).abs() < 1e-12,
                "{k}: {seen:?}"
            );
            assert!((frame.sweep_direction() - turn * Vector3::z()).norm() < 1e-9);
        }
    }

    #[test]
    fn moments_along_the_wire_are_refused() {
        let along = MomentAxes {
            axes: [Vector3::x(), Vector3::y()],
            sign: 1.0,
        };
        assert!(
            WireFrame::new(&wire(), &along)
                .unwrap_err()
                .to_string()
                .contains("moments.axes")
        );
        let same = MomentAxes {
            axes: [Vector3::y(), Vector3::y()],
            sign: 1.0,
        };
        assert!(WireFrame::new(&wire(), &same).is_err());
    }
}
