//! The base's pose from its tags in all pairs of a folder: the base stands still, so that corners
//! may be averaged over pairs.
//!
//! The rig only shifts, so that its orientation is shared as well: pair i's information on a turn
//! w, its shift eliminated, is `M_i = I_ww - I_wt I_tt^-1 I_tw`; the shared turn is
//! `(sum M_i)^-1 sum M_i w_i`, accepted where `chi2 = sum (w_i - w)' M_i (w_i - w)` is no more than
//! noise explains, and each shift follows it by `-I_tt^-1 I_tw w`. Source: block elimination of
//! normal equations (Triggs et al., "Bundle Adjustment - A Modern Synthesis", 2000, section 6).

use crate::median::median;
use crate::rig::Rig;
use crate::stereo::StereoCameras;
use crate::tags::apriltag_ffi::Tag;
use crate::tags::pose::{BodyPose, TAG_MISFIT_PX, TagObservation, body_pose, residual_rms_px};
use nalgebra::{Isometry3, Matrix2, Matrix3, Matrix6, UnitQuaternion, Vector2, Vector3};
use std::collections::BTreeMap;
use wcal_core::rig_devices::TagRig;

/// Corners that differ from the folder's by more than this many sd belong to a base that has moved.
const MOVED_SD: f64 = 6.0;
/// Repeatability of a corner between pictures beyond its stated sd, px.
const REPEAT_PX: f64 = 0.04;

/// Tags of one pair: camera (0 left, 1 right) and tag.
pub(crate) type PairTags = Vec<(usize, Tag)>;

/// The folder's base.
pub(crate) struct FolderBase {
    /// Pose from the averaged corners.
    pub pose: BodyPose,
    /// The averaged observations.
    pub observations: Vec<TagObservation>,
    /// Pairs in which the base is at another place.
    pub moved: Vec<usize>,
}

fn observation(rig: &Rig, camera: usize, tag: &Tag) -> Option<TagObservation> {
    let known = rig
        .tags
        .iter()
        .find(|t| t.id == tag.id && t.family == tag.family)?;
    Some(TagObservation {
        camera,
        tag: tag.clone(),
        size_mm: known.size_mm,
        body_from_tag: known.base_from_tag?.0,
    })
}

/// Base tags of one pair alone.
pub(crate) fn base_observations(rig: &Rig, tags: &PairTags) -> Vec<TagObservation> {
    tags.iter()
        .filter_map(|(camera, tag)| observation(rig, *camera, tag))
        .collect()
}

/// Averages the base tags' corners over pairs and solves for the base's pose; none where no pair
/// shows a base tag.
pub(crate) fn folder_base(
    stereo: &StereoCameras,
    rig: &Rig,
    pairs: &[PairTags],
) -> Option<FolderBase> {
    let mut groups: BTreeMap<(usize, u32), Vec<(usize, Tag)>> = BTreeMap::new();
    for (k, tags) in pairs.iter().enumerate() {
        for TagObservation { camera, tag, .. } in base_observations(rig, tags) {
            groups.entry((camera, tag.id)).or_default().push((k, tag));
        }
    }
    let mut moved = Vec::new();
    let mut averaged = Vec::new();
    for ((camera, _), seen) in &groups {
        let typical: [Vector2<f64>; 4] = std::array::from_fn(|c| {
            let axis = |d: usize| median(seen.iter().map(|(_, t)| t.corners_px[c][d]));
            Vector2::new(axis(0), axis(1))
        });
        let (still, other): (Vec<_>, Vec<_>) = seen.iter().partition(|(_, t)| {
            (0..4).all(|c| {
                // Mean variance of both coordinates.
                let sd = (0.5 * t.covariances_px2[c].trace()).sqrt().hypot(REPEAT_PX);
                (t.corners_px[c] - typical[c]).norm() < MOVED_SD * sd
            })
        });
        moved.extend(other.iter().map(|(k, _)| *k));
        let Some((_, first)) = still.first() else {
            continue;
        };
        let n = still.len() as f64;
        let mut mean = first.clone();
        for c in 0..4 {
            let tags = still.iter().map(|(_, t)| t);
            mean.corners_px[c] = tags.clone().map(|t| t.corners_px[c]).sum::<Vector2<f64>>() / n;
            let covariance: Matrix2<f64> = tags.map(|t| t.covariances_px2[c]).sum();
            // The pictures' noise is independent: the variance of a mean is their sum over n^2.
            mean.covariances_px2[c] = covariance / (n * n);
        }
        averaged.extend(observation(rig, *camera, &mean));
    }
    moved.sort_unstable();
    moved.dedup();
    let pose = body_pose(stereo, &averaged)?;
    Some(FolderBase {
        pose,
        observations: averaged,
        moved,
    })
}

/// Poses of the rig tag in every pair that shows it, the orientation shared where the pictures
/// allow it: the stage only shifts the rig.
pub(crate) struct RigPose {
    /// Pose in the left camera's frame.
    pub left_from_tag: Isometry3<f64>,
    /// Information that this pair's corners alone give on a correction in the tag's frame.
    pub information: Matrix6<f64>,
    /// Sightings.
    pub observations: Vec<TagObservation>,
}

/// The rig tag in all pairs.
pub(crate) struct RigPoses {
    /// One entry a pair; none where the tag is not seen.
    pub poses: Vec<Option<RigPose>>,
    /// Information of all pairs on the orientation that they share, tag's frame; none where each
    /// has its own.
    pub shared_turn: Option<Matrix3<f64>>,
}

/// Rig tag poses of all pairs.
pub(crate) fn rig_poses(stereo: &StereoCameras, rig: &Rig, pairs: &[PairTags]) -> RigPoses {
    let groove = rig.groove.as_ref();
    let known = groove.and_then(|groove| rig.tags.iter().find(|t| t.id == groove.tag));
    let mut poses: Vec<Option<RigPose>> = pairs
        .iter()
        .map(|tags| {
            let known = known?;
            let observations = observations_of(known, tags);
            let pose = body_pose(stereo, &observations)?;
            // A tag that was at two places says nothing of the rig's orientation.
            if residual_rms_px(stereo, &observations, &pose.left_from_body) > TAG_MISFIT_PX {
                return None;
            }
            Some(RigPose {
                left_from_tag: pose.left_from_body,
                information: pose.information,
                observations,
            })
        })
        .collect();
    let shared = shared_orientation(&poses);
    if let Some((shared, _)) = &shared {
        for (p, TurnBlocks { cross, shift, .. }) in poses
            .iter_mut()
            .flatten()
            .filter_map(|p| p.blocks().map(|b| (p, b)))
        {
            let turn = (p.left_from_tag.rotation.inverse() * shared).scaled_axis();
            // The position that minimises chi2 at the shared orientation.
            let by = -(shift * cross.transpose() * turn);
            let moved = p.left_from_tag.translation.vector + p.left_from_tag.rotation * by;
            p.left_from_tag = Isometry3::from_parts(moved.into(), *shared);
        }
    }
    RigPoses {
        poses,
        shared_turn: shared.map(|s| s.1),
    }
}

/// Sightings of one tag in its own frame.
pub(crate) fn observations_of(known: &TagRig, tags: &PairTags) -> Vec<TagObservation> {
    tags.iter()
        .filter(|(_, t)| t.id == known.id && t.family == known.family)
        .map(|(camera, tag)| TagObservation {
            camera: *camera,
            tag: tag.clone(),
            size_mm: known.size_mm,
            body_from_tag: Isometry3::identity(),
        })
        .collect()
}

/// A pair's information on the rig tag, its shift eliminated.
pub struct TurnBlocks {
    /// `M = I_ww - I_wt I_tt^-1 I_tw`.
    pub marginal: Matrix3<f64>,
    /// `I_wt`.
    pub cross: Matrix3<f64>,
    /// `I_tt^-1`.
    pub shift: Matrix3<f64>,
}

impl RigPose {
    /// None where the corners leave a direction open.
    pub(crate) fn blocks(&self) -> Option<TurnBlocks> {
        let block = |i, j| self.information.fixed_view::<3, 3>(i, j).into_owned();
        let (cross, shift) = (block(0, 3), block(3, 3).try_inverse()?);
        Some(TurnBlocks {
            marginal: block(0, 0) - cross * shift * cross.transpose(),
            cross,
            shift,
        })
    }
}

/// The orientation that all poses share, and their information on it; none where they differ, or
/// leave it open.
fn shared_orientation(poses: &[Option<RigPose>]) -> Option<(UnitQuaternion<f64>, Matrix3<f64>)> {
    let reference = poses.iter().flatten().next()?.left_from_tag.rotation;
    let (mut total, mut pull, mut turns) = (Matrix3::zeros(), Vector3::zeros(), Vec::new());
    for p in poses.iter().flatten() {
        let marginal = p.blocks()?.marginal;
        let turn = (reference.inverse() * p.left_from_tag.rotation).scaled_axis();
        total += marginal;
        pull += marginal * turn;
        turns.push((marginal, turn));
    }
    let mean = total.try_inverse()? * pull;
    // Scatter of the turns about their weighted mean: 3 (n - 1) is expected of noise.
    let chi2: f64 = turns
        .iter()
        .map(|(m, w)| ((w - mean).transpose() * m * (w - mean))[0])
        .sum();
    let degrees = 3.0 * (turns.len() as f64 - 1.0);
    // Up to twice the stated noise counts as noise; a rig that turns differs by far more.
    (turns.len() > 1 && chi2 <= 4.0 * degrees + 12.0)
        .then(|| (reference * UnitQuaternion::from_scaled_axis(mean), total))
}
