//! The groove: where the rig tag says the wire sits, corrected across the wire by the wire's own pictures.
//!
//! ```text
//! g = T_base^-1 T_tag v + e_t,  cov C_t;     A (g - p(s)) = e_w,  cov A C_w A;     A = I - t t^T
//! corrected = g - C_t (C_t + A C_w A + big t t^T)^-1 A (g - p);     s moves by t . (corrected - p)
//! ```
//! v: vertex position in the rig tag's frame; p, t: point and tangent of the wire at arc length s. Source: generalised least squares of
//! two estimates with known covariances (Aitken 1936).

use crate::rig::RigGroove;
use crate::rigid::hat;
use crate::shape::curve::CurveShape;
use crate::shape::joint::{PairUncertainty, node_covariance};
use crate::shape::pair_fit::PairFit;
use crate::stereo::StereoCameras;
use crate::tags::base_pose::RigPose;
use crate::tags::pose as tag_pose;
use nalgebra::{Matrix3, Matrix3x6, Point3, Vector3};
use wcal_core::shapes_document::GrooveDocument;

/// The contact of a pair whose rig tag is known. The tag says where along the wire; the wire says where across.
#[must_use]
pub fn groove_document(
    stereo: &StereoCameras,
    fit: &PairFit,
    rig: &RigPose,
    groove: &RigGroove,
    uncertain: &PairUncertainty,
    diameter_mm: f64,
) -> GrooveDocument {
    let base_from_left = fit.left_from_base.inverse();
    let in_left = rig.left_from_tag * Point3::from(groove.position_in_tag_mm);
    let by_tag = (base_from_left * in_left).coords;
    let tag_covariance = tag_position_covariance(stereo, fit, rig, groove, uncertain, &by_tag);
    let shape = fit.model.shape(&fit.state);
    let jacobian = fit.model.jacobian(&fit.state);
    // The nearest node, then along the tangent.
    let last = ((fit.length_mm / fit.model.step_mm) as usize).min(fit.model.nodes - 1);
    let nearest = (0..=last)
        .min_by(|&a, &b| (shape.points[a] - by_tag).norm().total_cmp(&(shape.points[b] - by_tag).norm()))
        .unwrap_or(0);
    let mut arc = nearest as f64 * fit.model.step_mm;
    let (mut point, mut tangent) = (shape.points[nearest], shape.tangents[nearest]);
    let wire_covariance = node_covariance(fit, &jacobian, nearest, uncertain);
    let along = |t: &Vector3<f64>| t * t.transpose();
    // Generalised least squares: tag plus wire across; along the wire only the tag counts.
    for _ in 0..3 {
        let across = Matrix3::identity() - along(&tangent);
        let joint = tag_covariance + across * wire_covariance * across + along(&tangent) * 1e6;
        let offset = by_tag - point;
        // Correlation between along and across in the tag's error shifts the foot point.
        let weight = joint.try_inverse().unwrap_or_else(Matrix3::zeros);
        let corrected = by_tag - tag_covariance * weight * (across * offset);
        arc += tangent.dot(&(corrected - point));
        arc = arc.clamp(0.0, fit.length_mm);
        let x = (arc / fit.model.step_mm).min(fit.model.nodes as f64 - 1.001);
        let (i, f) = (x.floor() as usize, x.fract());
        point = shape.points[i] * (1.0 - f) + shape.points[i + 1] * f;
        tangent = (shape.tangents[i] * (1.0 - f) + shape.tangents[i + 1] * f).normalize();
    }
    let across = Matrix3::identity() - along(&tangent);
    let rest = fit.model.shape(&fit.model.rest()).points;
    let at_rest = rest[((arc / fit.model.step_mm) as usize).min(rest.len() - 1)];
    let moved = across * (point - at_rest);
    let width_mm = groove.width_along_wire_mm;
    let place = Place {
        away: across * (point - by_tag),
        covariance: across * (tag_covariance + wire_covariance) * across + along(&tangent),
        push: (moved.norm() > diameter_mm).then(|| moved.normalize()),
        turn: tangent_at(fit, &shape, arc + 0.5 * width_mm) - tangent_at(fit, &shape, arc - 0.5 * width_mm),
    };
    let contact = place.contact(groove, diameter_mm);
    let contacts_mm = match contact {
        "none" => Vec::new(),
        "double" => vec![arc - 0.5 * width_mm, arc + 0.5 * width_mm],
        _ => vec![arc],
    };
    // Where the flanks meet: the wire's centre stands off it by its radius over the sine of the half angle.
    let apex_mm = place.push.map(|p| {
        let a = by_tag - p * (0.5 * diameter_mm / groove.half_angle_deg.to_radians().sin());
        [a.x, a.y, a.z]
    });
    let arc_variance = (tangent.transpose() * tag_covariance * tangent)[0];
    let covariance = across * wire_covariance * across + along(&tangent) * arc_variance;
    GrooveDocument {
        position_mm: [point.x, point.y, point.z],
        sd_mm: std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt()),
        contact_arclength_mm: arc,
        contact_arclength_sd_mm: arc_variance.max(0.0).sqrt(),
        axis: [tangent.x, tangent.y, tangent.z],
        contact: contact.into(),
        contacts_mm,
        distance_from_vertex_mm: place.away.norm(),
        apex_mm,
        by_tag_mm: [by_tag.x, by_tag.y, by_tag.z],
        covariance_mm2: Some(std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)]))),
    }
}

fn tangent_at(fit: &PairFit, shape: &CurveShape, arc_mm: f64) -> Vector3<f64> {
    let k = (arc_mm.clamp(0.0, fit.length_mm) / fit.model.step_mm).round() as usize;
    shape.tangents[k.min(shape.tangents.len() - 1)]
}

/// Where the wire lies in the groove's section across it.
pub struct Place {
    /// From the vertex position to the wire's centre, mm.
    pub away: Vector3<f64>,
    /// Covariance of that, mm^2; of unit size along the wire.
    pub covariance: Matrix3<f64>,
    /// Direction in which the groove pushes; none where the wire is not deflected enough to tell.
    pub push: Option<Vector3<f64>>,
    /// Change of the wire's tangent over the groove's width.
    pub turn: Vector3<f64>,
}

impl Place {
    /// `vertex`: on both flanks; `double`: arched over the vertex, on the groove's two rims; `out-of-vertex`: on one flank;
    /// `none`: clear of both.
    #[must_use]
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
            // Beyond the wire's own diameter from the vertex there is no contact, whichever way the groove opens.
            return if self.away.norm() > diameter_mm { "none" } else { "out-of-vertex" };
        };
        // Over the groove's width the wire's middle stands off its ends by the sagitta of its own bend.
        let arch = -self.turn.dot(&push) * groove.width_along_wire_mm / 8.0;
        if arch > 0.0 && agrees(push * arch) {
            return "double";
        }
        // Centres that touch a flank lie on a line through the vertex position at the half angle from the push.
        let clear = groove.half_angle_deg.to_radians() - self.away.angle(&push);
        let gap = self.away.norm() * clear.sin();
        // Mean variance across the wire: the covariance is of unit size along it.
        let sd = (0.5 * (self.covariance.trace() - 1.0)).max(0.0).sqrt();
        if clear > 0.0 && gap > 3.0 * sd { "none" } else { "out-of-vertex" }
    }
}

/// Covariance of the tag's word in the base frame: the rig tag's corners, the base pose, the calibration.
fn tag_position_covariance(
    stereo: &StereoCameras,
    fit: &PairFit,
    rig: &RigPose,
    groove: &RigGroove,
    uncertain: &PairUncertainty,
    by_tag: &Vector3<f64>,
) -> Matrix3<f64> {
    let to_base = *fit.left_from_base.inverse().rotation.to_rotation_matrix().matrix();
    let turn = *rig.left_from_tag.rotation.to_rotation_matrix().matrix();
    let pose = rig.information.try_inverse().unwrap_or_else(nalgebra::Matrix6::zeros);
    let mut j = Matrix3x6::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-hat(&groove.position_in_tag_mm)));
    j.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    let by_pose = to_base * turn * j;
    let mut covariance = by_pose * pose * by_pose.transpose();
    // A base that is turned by w and shifted by d sees the point at p - d - w x p.
    let mut by_base = Matrix3x6::zeros();
    by_base.fixed_view_mut::<3, 3>(0, 0).copy_from(&hat(by_tag));
    by_base.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-Matrix3::identity()));
    let mut noise = uncertain.covariance.view((0, 0), (6, 6)).into_owned();
    if let Some(c) = &stereo.covariance {
        // The calibration moves base and rig tag together: their sum is taken below, not one by one.
        let base_part = uncertain.by_calibration.rows(0, 6);
        noise -= base_part * c * base_part.transpose();
        let mut total = nalgebra::DMatrix::<f64>::zeros(3, stereo.parameters());
        for k in 0..stereo.parameters() {
            let h = stereo.difference_step(k);
            let gradient = |s: &StereoCameras| {
                tag_pose::linearise(s, &rig.observations, &rig.left_from_tag)
                    .map_or_else(nalgebra::Vector6::zeros, |l| l.2)
            };
            let change = (gradient(&stereo.moved(k, h)) - gradient(stereo)) / h;
            let of_base = nalgebra::Vector6::from_iterator(base_part.column(k).iter().copied());
            total.set_column(k, &(by_pose * (pose * change) + by_base * of_base));
        }
        let m = &total * c * total.transpose();
        covariance += Matrix3::from_iterator(m.iter().copied());
    }
    let noise = nalgebra::Matrix6::from_iterator(noise.iter().copied());
    covariance + by_base * noise * by_base.transpose()
}
