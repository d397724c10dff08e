//! The groove: where the rig tag says the wire sits, corrected across the wire by the wire's own pictures.

use crate::base_pose::RigPose;
use crate::document::{STEREO_PARAMETERS, StereoCameras};
use crate::pair_fit::PairFit;
use crate::rig::RigGroove;
use crate::rigid::hat;
use crate::shapes::{Uncertain, moved_cameras, node_covariance};
use crate::shapes_document::GrooveDocument;
use crate::tag_pose;
use nalgebra::{Matrix3, Matrix3x6, Point3, Vector3};

/// The contact of a pair whose rig tag is known. The tag says where along the wire; the wire says where across.
#[must_use]
pub fn groove_document(
    stereo: &StereoCameras,
    fit: &PairFit,
    rig: &RigPose,
    groove: &RigGroove,
    uncertain: &Uncertain,
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
    let off = across * (by_tag - point);
    let mismatch = across * (tag_covariance + wire_covariance) * across + along(&tangent);
    let chi2 = mismatch.try_inverse().map_or(0.0, |i| (off.transpose() * i * off)[0]);
    // 13.8: 99.9 % of chi2 with 2 degrees of freedom. Beyond the wire's own diameter from the vertex there is no contact at all.
    let contact = match (chi2 > 13.8, off.norm() > diameter_mm) {
        (true, true) => "none",
        (true, false) => "out-of-vertex",
        (false, _) => "vertex",
    };
    let arc_variance = (tangent.transpose() * tag_covariance * tangent)[0];
    let covariance = across * wire_covariance * across + along(&tangent) * arc_variance;
    GrooveDocument {
        position_mm: [point.x, point.y, point.z],
        sd_mm: std::array::from_fn(|k| covariance[(k, k)].max(0.0).sqrt()),
        contact_arclength_mm: arc,
        contact_arclength_sd_mm: arc_variance.max(0.0).sqrt(),
        axis: [tangent.x, tangent.y, tangent.z],
        contact: contact.into(),
        distance_from_vertex_mm: off.norm(),
        by_tag_mm: [by_tag.x, by_tag.y, by_tag.z],
    }
}

/// Covariance of the tag's word in the base frame: the rig tag's corners, the base pose, the calibration.
fn tag_position_covariance(
    stereo: &StereoCameras,
    fit: &PairFit,
    rig: &RigPose,
    groove: &RigGroove,
    uncertain: &Uncertain,
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
        let mut total = nalgebra::DMatrix::<f64>::zeros(3, STEREO_PARAMETERS);
        for k in 0..STEREO_PARAMETERS {
            let h = if k < 18 && k % 9 >= 4 {
                1e-3
            } else if (18..21).contains(&k) {
                1e-5
            } else {
                0.05
            };
            let gradient = |s: &StereoCameras| {
                tag_pose::linearise(s, &rig.sightings, &rig.left_from_tag)
                    .map_or_else(nalgebra::Vector6::zeros, |l| l.2)
            };
            let change = (gradient(&moved_cameras(stereo, k, h)) - gradient(stereo)) / h;
            let of_base = nalgebra::Vector6::from_iterator(base_part.column(k).iter().copied());
            total.set_column(k, &(by_pose * (pose * change) + by_base * of_base));
        }
        let m = &total * c * total.transpose();
        covariance += Matrix3::from_iterator(m.iter().copied());
    }
    let noise = nalgebra::Matrix6::from_iterator(noise.iter().copied());
    covariance + by_base * noise * by_base.transpose()
}
