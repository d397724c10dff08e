//! The frame in which contacts are computed, whatever the orientation in which a session describes its wire.
//!
//! ```text
//! x = +-(a_1 x a_2) toward the wire's tip side,   z = -(b - (b . x) x) / |..|,   y = z x x          b: direction in which the wire bends
//! m_i = sigma a_i . M        so  [M_y, M_z] = sigma C m,   C = ([a_i . e_j])^-1 for e = (y, z)
//! p = R p_base,   m = sigma C m_base,   cov m = C cov m_base C'
//! ```
//!
//! a_1, a_2, sigma: the axes and the sign of the moments that the calibration gives. The moments do not see the component along x; the
//! root may lean against it. A wire that is given by lengths (straight along x, bending toward -z) with moments about y and z stays as it is.

use crate::ContactError;
use crate::estimator::ContactEstimate;
use crate::reading::{Moments, Reading, RowMotion};
use nalgebra::{Isometry3, Matrix2, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use wcal_core::observation::{MomentAxes, RestShape, WhiskerSpec};
use wcal_track::stream::BasePose;

/// Smallest sine of the angle between the axes of the moments, and cosine of that between their normal and the wire's root: 60 degrees.
const MIN_SINE: f64 = 0.1;
const MIN_COSINE: f64 = 0.5;
/// A wire that bends by less than this share of its length is straight.
const STRAIGHT: f64 = 1e-6;

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
    pub fn new(whisker: &WhiskerSpec, axes: &MomentAxes) -> Result<Self, ContactError> {
        if matches!(whisker.rest_shape, RestShape::StraightArc { .. }) && *axes == MomentAxes::default() {
            return Ok(Self { wire_from_base: None });
        }
        let (tangent, bend) = match &whisker.rest_shape {
            RestShape::StraightArc { .. } => (Vector3::x(), -Vector3::z()),
            RestShape::Polyline(points) => root_and_bend(points),
        };
        let [a, b] = axes.axes.map(|a| a.normalize());
        let normal = a.cross(&b).try_normalize(MIN_SINE);
        let x = normal.map(|n| n * n.dot(&tangent).signum());
        let Some(x) = x.filter(|x| x.dot(&tangent) >= MIN_COSINE) else {
            let found = format!("{:?} and {:?} at a root along {tangent:?}", axes.axes[0], axes.axes[1]);
            return Err(ContactError::value("moments.axes", "two directions across the wire's root", found));
        };
        // A straight wire: the second axis, which turns with the session.
        let bend = if bend.norm() > STRAIGHT { bend } else { -b };
        let across = bend - x * bend.dot(&x);
        let z = -across.try_normalize(1e-12).unwrap_or(-b);
        let y = z.cross(&x);
        let turn = Matrix3::from_rows(&[x.transpose(), y.transpose(), z.transpose()]);
        let seen = Matrix2::new(a.dot(&y), a.dot(&z), b.dot(&y), b.dot(&z));
        let Some(mix) = seen.try_inverse() else {
            return Err(ContactError::value("moments.axes", "two directions", "one"));
        };
        Ok(Self { wire_from_base: Some((Rotation3::from_matrix_unchecked(turn), mix * axes.sign)) })
    }

    /// The whisker in this frame.
    #[must_use]
    pub fn whisker(&self, whisker: &WhiskerSpec) -> WhiskerSpec {
        let Some((turn, _)) = &self.wire_from_base else { return whisker.clone() };
        let points = match &whisker.rest_shape {
            RestShape::Polyline(points) => points.clone(),
            // Other moments of a wire that is given by lengths: it lies along x already.
            RestShape::StraightArc { .. } if is_identity(turn) => return whisker.clone(),
            RestShape::StraightArc { straight_mm, arc_radius_mm, length_mm } => {
                arc_points(*straight_mm, *arc_radius_mm, *length_mm)
            }
        };
        WhiskerSpec {
            rest_shape: RestShape::Polyline(points.iter().map(|p| turn * p).collect()),
            gravity_direction: whisker.gravity_direction.map(|g| turn * g),
            ..whisker.clone()
        }
    }

    /// Rotation from base coordinates to those of this frame.
    #[must_use]
    pub fn rotation(&self) -> Rotation3<f64> {
        self.wire_from_base.as_ref().map_or_else(Rotation3::identity, |(turn, _)| *turn)
    }

    /// Moments (N mm) as components along y and z of this frame.
    #[must_use]
    pub fn moment(&self, moment_nmm: [f64; 2]) -> [f64; 2] {
        self.wire_from_base.as_ref().map_or(moment_nmm, |(_, mix)| (mix * Vector2::from(moment_nmm)).into())
    }

    /// Their covariance, (N mm)^2.
    #[must_use]
    pub fn covariance(&self, nmm2: &Matrix2<f64>) -> Matrix2<f64> {
        self.wire_from_base.as_ref().map_or(*nmm2, |(_, mix)| mix * nmm2 * mix.transpose())
    }

    /// A reading in this frame; poses of the base stay those of the session's base.
    #[must_use]
    pub fn reading(&self, reading: &Reading) -> Reading {
        let Some((turn, _)) = &self.wire_from_base else { return reading.clone() };
        let moments = reading.moments.as_ref().map(|m| self.moments(m));
        let motion = reading.motion.map(|m| RowMotion {
            moved_mm: turn * m.moved_mm,
            turn: turn * m.turn * turn.inverse(),
            velocity_mm_s: turn * m.velocity_mm_s,
            push: m.push.map(|p| turn * p),
            ..m
        });
        let velocity_mm_s = reading.velocity_mm_s.map(|v| turn * v);
        // The speed along this frame's +z, where the velocity is known.
        let base_mm_s = velocity_mm_s.map(|v| v.z).or(reading.base_mm_s);
        Reading { moments, motion, velocity_mm_s, base_mm_s, ..reading.clone() }
    }

    fn moments(&self, m: &Moments) -> Moments {
        let sd = |nmm2: Matrix2<f64>| [0, 1].map(|k| nmm2[(k, k)].max(0.0).sqrt());
        let pose_nmm2 = self.covariance(&m.pose_nmm2);
        let shared_nmm: Vec<[f64; 2]> = m.shared_nmm.iter().map(|h| self.moment(*h)).collect();
        let shared: Matrix2<f64> =
            shared_nmm.iter().map(|h| Vector2::from(*h) * Vector2::from(*h).transpose()).sum();
        Moments {
            moment_nmm: self.moment(m.moment_nmm),
            sd_nmm: sd(pose_nmm2 + shared),
            valid: m.valid,
            pose_nmm2,
            own_nmm2: m.own_nmm2.map(|n| self.covariance(&n)),
            shared_nmm,
        }
    }

    /// A contact of this frame in base coordinates.
    #[must_use]
    pub fn to_base(&self, estimate: ContactEstimate) -> ContactEstimate {
        self.wire_from_base.as_ref().map_or(estimate, |(turn, _)| estimate.turned(&turn.inverse()))
    }

    /// Pose of this frame where that of the base is known.
    #[must_use]
    pub fn pose(&self, base: &BasePose) -> BasePose {
        let Some((turn, _)) = &self.wire_from_base else { return *base };
        let back = UnitQuaternion::from_rotation_matrix(&turn.inverse());
        let base_from_wire = Isometry3::from_parts(Translation3::identity(), back);
        BasePose {
            world_from_base: base.world_from_base * base_from_wire,
            velocity_mm_s: base.velocity_mm_s.map(|v| turn * v),
        }
    }
}

fn is_identity(turn: &Rotation3<f64>) -> bool {
    (turn.matrix() - Matrix3::identity()).norm() < 1e-12
}

/// Direction of a wire at its root, and where its tip is off that direction, over its length.
fn root_and_bend(points: &[Vector3<f64>]) -> (Vector3<f64>, Vector3<f64>) {
    let length_mm: f64 = points.windows(2).map(|w| (w[1] - w[0]).norm()).sum();
    let first = points.windows(2).map(|w| w[1] - w[0]).find_map(|e| e.try_normalize(1e-9));
    let tangent = first.unwrap_or_else(Vector3::x);
    let chord = points.last().zip(points.first()).map_or_else(Vector3::zeros, |(tip, root)| tip - root);
    (tangent, (chord - tangent * chord.dot(&tangent)) / length_mm.max(1e-9))
}

/// A wire by lengths as points a quarter of a millimetre apart.
fn arc_points(straight_mm: f64, radius_mm: f64, length_mm: f64) -> Vec<Vector3<f64>> {
    const STEP_MM: f64 = 0.25;
    let count = (length_mm / STEP_MM).ceil().max(2.0) as usize;
    let at = |s: f64| {
        let angle = (s - straight_mm).max(0.0) / radius_mm;
        let (sine, cosine) = angle.sin_cos();
        Vector3::new(s.min(straight_mm) + radius_mm * sine, 0.0, -radius_mm * (1.0 - cosine))
    };
    (0..=count).map(|k| at(length_mm * k as f64 / count as f64)).collect()
}
