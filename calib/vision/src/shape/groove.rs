//! The groove: contact point from the rig tag, corrected across the wire by the wire's own
//! pictures.
//!
//! ```text
//! g = T_base^-1 T_tag v + e_t,  cov C_t;     N^T (g - p(s)) = e_w,  cov N^T C_w N;     N^T [t N] = [0 I]
//! corrected = g - C_t N (N^T (C_t + C_w) N)^-1 N^T (g - p);     s moves by t . (corrected - p)
//! ```
//! v: vertex position in the rig tag's frame; p, t: point and tangent of the wire at arc length s;
//! N: two directions across it.
//! Source: generalised least squares of two estimates with known covariances (Aitken 1936).

use crate::rig::RigGroove;
use crate::shape::curve::CurveShape;
use crate::shape::curve_fit::{between, node};
use crate::shape::joint::{PairUncertainty, node_covariance};
use crate::shape::pair_fit::PairFit;
use crate::tags::base_pose::RigPose;
use nalgebra::{DMatrix, Matrix2, Matrix3, Matrix3x2, Point3, Vector3};
use wcal_core::shapes_document::GrooveDocument;

/// Contact of a pair, with the quantities that its errors derive from.
pub(crate) struct GrooveFound {
    /// As in `shapes.json`; standard deviations and covariance are still to come.
    document: GrooveDocument,
    /// Node before the contact, and fraction of the interval to the next.
    pub at: (usize, f64),
    /// Unit tangent there.
    pub tangent: Vector3<f64>,
    /// `B = I - C_t N W N^T`: derivative of the corrected position by the tag's.
    pub follow: Matrix3<f64>,
}

/// The contact of a pair whose rig tag is known: along the wire from the tag, across it from the
/// wire. `tag_covariance`: of the vertex position by the tag, base frame, mm^2.
pub(crate) fn find_groove(
    fit: &PairFit,
    rig: &RigPose,
    groove: &RigGroove,
    tag_covariance: &Matrix3<f64>,
    uncertain: &PairUncertainty,
    diameter_mm: f64,
) -> GrooveFound {
    let base_from_left = fit.left_from_base.inverse();
    let in_left = rig.left_from_tag * Point3::from(groove.position_in_tag_mm);
    let by_tag = (base_from_left * in_left).coords;
    let shape = fit.model.shape(&fit.state);
    let jacobian = fit.model.jacobian(&fit.state);
    // The nearest node, then along the tangent.
    let last = ((fit.length_mm / fit.model.step_mm) as usize).min(fit.model.nodes - 1);
    let off = |node: usize| (shape.points[node] - by_tag).norm();
    let nearest = (0..=last)
        .min_by(|&a, &b| off(a).total_cmp(&off(b)))
        .unwrap_or(0);
    let mut arc = nearest as f64 * fit.model.step_mm;
    let (mut point, mut tangent) = (shape.points[nearest], shape.tangents[nearest]);
    let (mut at, mut follow) = ((nearest, 0.0), Matrix3::identity());
    let wire_covariance = node_covariance(fit, &jacobian, nearest, uncertain);
    let along = |t: &Vector3<f64>| t * t.transpose();
    // Generalised least squares: tag and wire across; along the wire the tag only, as the wire has
    // no mark there.
    for _ in 0..3 {
        let aside = tangent
            .cross(&Vector3::ith(tangent.iamin(), 1.0))
            .normalize();
        let across = Matrix3x2::from_columns(&[aside, tangent.cross(&aside)]);
        let joint = across.tr_mul(&((tag_covariance + wire_covariance) * across));
        let offset = by_tag - point;
        // Correlation between along and across in the tag's error shifts the foot point.
        let weight = joint.try_inverse().unwrap_or_else(Matrix2::zeros);
        follow = Matrix3::identity() - tag_covariance * across * weight * across.transpose();
        arc += tangent.dot(&(follow * offset));
        arc = arc.clamp(0.0, fit.length_mm);
        at = node(arc, fit.model.step_mm, fit.model.nodes);
        point = between(&shape.points, at);
        tangent = between(&shape.tangents, at).normalize();
    }
    let across = Matrix3::identity() - along(&tangent);
    let rest = fit.model.shape(&fit.model.rest()).points;
    let at_rest = rest[((arc / fit.model.step_mm) as usize).min(rest.len() - 1)];
    // The groove pushes the wire away from where it would rest.
    let moved = across * (point - at_rest);
    let width_mm = groove.width_along_wire_mm;
    let place = GroovePosition {
        away: across * (point - by_tag),
        covariance: across * (tag_covariance + wire_covariance) * across + along(&tangent),
        push: (moved.norm() > diameter_mm).then(|| moved.normalize()),
        turn: tangent_at(fit, &shape, arc + 0.5 * width_mm)
            - tangent_at(fit, &shape, arc - 0.5 * width_mm),
    };
    let contact = place.contact(groove, diameter_mm);
    let contacts_mm = match contact {
        "none" => Vec::new(),
        "double" => vec![arc - 0.5 * width_mm, arc + 0.5 * width_mm],
        _ => vec![arc],
    };
    // Apex of the flanks: the wire's centre is at the distance r / sin(half angle) from it.
    let to_apex_mm = 0.5 * diameter_mm / groove.half_angle_deg.to_radians().sin();
    let apex_mm = place.push.map(|p| (by_tag - p * to_apex_mm).into());
    let document = GrooveDocument {
        position_mm: point.into(),
        sd_mm: [f64::NAN; 3],
        contact_arclength_mm: arc,
        contact_arclength_sd_mm: f64::NAN,
        axis: tangent.into(),
        contact: contact.into(),
        contacts_mm,
        distance_from_vertex_mm: place.away.norm(),
        apex_mm,
        by_tag_mm: by_tag.into(),
        covariance_mm2: None,
    };
    GrooveFound {
        document,
        at,
        tangent,
        follow,
    }
}

impl GrooveFound {
    /// The document with the covariance of position and arc length (mm^2) that the pair's own and
    /// shared errors add up to.
    pub(crate) fn with_errors(mut self, covariance: &DMatrix<f64>) -> GrooveDocument {
        let [x, y, z, arc] = [0, 1, 2, 3].map(|k| covariance[(k, k)].max(0.0).sqrt());
        self.document.sd_mm = [x, y, z];
        self.document.contact_arclength_sd_mm = arc;
        let of_position = covariance.fixed_view::<3, 3>(0, 0).into_owned();
        self.document.covariance_mm2 = Some(of_position.into());
        self.document
    }
}

fn tangent_at(fit: &PairFit, shape: &CurveShape, arc_mm: f64) -> Vector3<f64> {
    let k = (arc_mm.clamp(0.0, fit.length_mm) / fit.model.step_mm).round() as usize;
    shape.tangents[k.min(shape.tangents.len() - 1)]
}

/// Where the wire lies in the groove's section across it.
pub struct GroovePosition {
    /// From the vertex position to the wire's centre, mm.
    pub away: Vector3<f64>,
    /// Covariance of that, mm^2; of unit size along the wire.
    pub covariance: Matrix3<f64>,
    /// Direction in which the groove pushes; none where the deflection is too small to determine
    /// it.
    pub push: Option<Vector3<f64>>,
    /// Change of the wire's tangent over the groove's width.
    pub turn: Vector3<f64>,
}

impl GroovePosition {
    /// `vertex`: on both flanks; `double`: arched over the vertex, on the groove's two rims;
    /// `out-of-vertex`: on one flank; `none`: clear of both.
    pub fn contact(&self, groove: &RigGroove, diameter_mm: f64) -> &'static str {
        let inverse = self.covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
        // 13.8: 99.9 % of chi2 with 2 degrees of freedom.
        let agrees = |with: Vector3<f64>| {
            let off = self.away - with;
            (off.transpose() * inverse * off)[0] <= 13.8
        };
        if agrees(Vector3::zeros()) {
            return "vertex";
        }
        let Some(push) = self.push else {
            // Beyond the wire's own diameter from the vertex there is no contact, whichever way the
            // groove opens.
            return if self.away.norm() > diameter_mm {
                "none"
            } else {
                "out-of-vertex"
            };
        };
        // Over the groove's width the wire's middle is off the chord by the sagitta of its
        // curvature.
        let arch = -self.turn.dot(&push) * groove.width_along_wire_mm / 8.0;
        if arch > 0.0 && agrees(push * arch) {
            return "double";
        }
        // Centres that touch a flank lie on a line through the vertex position at the half angle
        // from the push.
        let clear = groove.half_angle_deg.to_radians() - self.away.angle(&push);
        let gap = self.away.norm() * clear.sin();
        // Mean variance across the wire: the covariance is of unit size along it.
        let sd = (0.5 * (self.covariance.trace() - 1.0)).max(0.0).sqrt();
        if clear > 0.0 && gap > 3.0 * sd {
            "none"
        } else {
            "out-of-vertex"
        }
    }
}
