//! The side of each tag as both cameras see it, against the rig's statement.
//!
//! ```text
//! side = argmin over s of min over T of chi2(T, s p_k)          chi2(s) = chi2_min + (s - side)^2 / var
//! var  = var of the corners + J C J^T                           J = d side / d cameras, by triangulated corners
//! ```
//! Two cameras know lengths by their baseline, so that a tag's side is measured in every pair: one
//! value from all pairs that is not the stated one is a wrong statement; a pair with another value
//! than the rest shows the tag at two places.

use crate::median::{median, median_and_sd};
use crate::rig::Rig;
use crate::stereo::StereoCameras;
use crate::tags::base_pose::{PairTags, observations_of};
use crate::tags::pose::{TAG_MISFIT_PX, TagObservation, body_pose, minimise, residual_rms_px};
use nalgebra::{DVector, Vector3};
use wcal_core::rig_devices::TagRig;

/// Share of the side from which a difference matters: 0.02 mm on a tag of 10 mm, about what a
/// caliper reads of a print.
const MATTERS: f64 = 0.002;
/// Standard deviations from which a difference is none of noise.
const BEYOND_SD: f64 = 6.0;
/// Pairs that have to agree against a single one.
const OTHERS: usize = 2;

/// A side measured in one pair, mm.
#[derive(Clone, Copy)]
struct Side {
    mm: f64,
    /// By the corners alone.
    sd_mm: f64,
    /// By the cameras, in all pairs alike.
    cameras_sd_mm: f64,
}

/// The rig with its tags' sides as seen.
pub(crate) struct TagSizes {
    pub rig: Rig,
    pub warnings: Vec<String>,
    /// Why a pair does not show its tags at one place, one entry a pair.
    pub elsewhere: Vec<Option<String>>,
}

/// Measures all tags of a rig in all pairs. A side that contradicts the rig's is replaced by what
/// the pictures show, with a warning.
pub(crate) fn tag_sizes(stereo: &StereoCameras, rig: &Rig, pairs: &[PairTags]) -> TagSizes {
    let mut found = TagSizes {
        rig: rig.clone(),
        warnings: Vec::new(),
        elsewhere: vec![None; pairs.len()],
    };
    let mut changed = Vec::new();
    for (k, tag) in rig.tags.iter().enumerate() {
        let sides: Vec<Option<Side>> = pairs
            .iter()
            .map(|tags| side(stereo, tag, &observations_of(tag, tags)))
            .collect();
        let seen: Vec<Side> = sides.iter().flatten().copied().collect();
        let all_mm: Vec<f64> = seen.iter().map(|s| s.mm).collect();
        let [typical, spread] = median_and_sd(&all_mm);
        let differs = |s: &Side, from: f64| {
            (s.mm - from).abs() > (MATTERS * from).max(BEYOND_SD * s.sd_mm.hypot(spread))
        };
        let agreeing = seen.iter().filter(|s| !differs(s, typical)).count();
        if agreeing > OTHERS && 2 * agreeing > seen.len() {
            for (pair, side) in sides.iter().enumerate() {
                if let Some(side) = side.filter(|s| differs(s, typical)) {
                    found.elsewhere[pair] = Some(format!(
                        "tag {} {} would have a side of {:.3} mm, in the other pairs it has {typical:.3} mm: pictures not taken together, or of another pose",
                        tag.family, tag.id, side.mm
                    ));
                }
            }
        }
        let Some(cameras_sd) = seen.iter().map(|s| s.cameras_sd_mm).reduce(f64::max) else {
            continue;
        };
        let own = median(seen.iter().map(|s| s.sd_mm));
        // More pairs average the corners' noise, not the cameras' error, which all of them share.
        let sd = cameras_sd.hypot(own.max(spread) / (seen.len() as f64).sqrt());
        let off = (typical - tag.size_mm).abs();
        // Of a tag that stands still one pair is enough; one that moves between the pictures of a
        // single pair is no other size.
        let known = tag.base_from_tag.is_some() || agreeing >= OTHERS;
        if known && 2 * agreeing > seen.len() && off > (MATTERS * tag.size_mm).max(BEYOND_SD * sd) {
            changed.push((k, typical, sd));
        }
    }
    for &(k, mm, sd) in &changed {
        let tag = &rig.tags[k];
        found.rig.tags[k].size_mm = mm;
        found.warnings.push(format!(
            "tag size: {} {} has a side of {mm:.3} mm (sd {sd:.4}) as both cameras see it, the rig states {} mm; {mm:.3} mm is taken",
            tag.family, tag.id, tag.size_mm
        ));
    }
    let factors: Vec<f64> = changed
        .iter()
        .map(|(k, mm, _)| mm / rig.tags[*k].size_mm)
        .collect();
    if let [first, ..] = factors[..]
        && factors.iter().all(|f| (f / first - 1.0).abs() < MATTERS)
        && changed.len() == rig.tags.len()
    {
        found.warnings.push(format!(
            "all tags differ by the factor {:.4}: assumed is that the cameras' scale is right; if the board's side was wrong instead, all lengths here are off by it",
            first
        ));
    }
    found
}

/// The side of a tag that both cameras see; none where the corners are no square at one place.
fn side(stereo: &StereoCameras, tag: &TagRig, seen: &[TagObservation]) -> Option<Side> {
    let [Some(left), Some(right)] = [0, 1].map(|camera| seen.iter().find(|s| s.camera == camera))
    else {
        return None;
    };
    let pair = [left, right];
    let rough = triangulated(stereo, pair)?;
    // A side that differs by the factor f looks the same from f times as far: the pose at the rough
    // side starts the search.
    let sized = |mm: f64| -> Vec<TagObservation> {
        pair.map(|s| TagObservation {
            size_mm: mm,
            ..s.clone()
        })
        .to_vec()
    };
    let start = body_pose(stereo, &sized(rough))?;
    let step = 1e-3 * tag.size_mm.min(rough);
    let chi2 = |mm: f64| minimise(stereo, &sized(mm), start.left_from_body).map(|p| p.chi2);
    let (mut mm, mut curvature) = (rough, 0.0);
    for _ in 0..2 {
        let costs = [chi2(mm - step)?, chi2(mm)?, chi2(mm + step)?];
        // Newton's step on the parabola through three costs.
        curvature = (costs[0] - 2.0 * costs[1] + costs[2]) / (step * step);
        if curvature <= 0.0 {
            return None;
        }
        mm += (costs[0] - costs[2]) / (2.0 * step) / curvature;
    }
    let pose = minimise(stereo, &sized(mm), start.left_from_body)?;
    let off_px = residual_rms_px(stereo, &sized(mm), &pose.left_from_body);
    if !(off_px < TAG_MISFIT_PX && mm > 0.0) {
        return None;
    }
    // Scatter beyond the corners' stated noise counts as noise: 16 coordinates, a pose and the
    // side.
    let noise = (pose.chi2 / 9.0).max(1.0);
    let by_cameras = DVector::from_fn(stereo.parameters(), |k, _| {
        let h = stereo.difference_step(k);
        triangulated(&stereo.moved(k, h), pair).map_or(0.0, |moved| (moved - rough) / h)
    });
    let cameras_mm2 = stereo
        .covariance
        .as_ref()
        .map_or(0.0, |c| (by_cameras.transpose() * c * &by_cameras)[0]);
    Some(Side {
        mm,
        // chi2 = chi2_min + (s - side)^2 / var: its second derivative is 2 / var.
        sd_mm: (2.0 * noise / curvature).sqrt(),
        cameras_sd_mm: cameras_mm2.max(0.0).sqrt(),
    })
}

/// Mean side of the square between the corners' places halfway between both lines of sight, mm.
fn triangulated(stereo: &StereoCameras, [left, right]: [&TagObservation; 2]) -> Option<f64> {
    let left_from_right = stereo.right_from_left.inverse();
    let centre = left_from_right.translation.vector;
    let places: Vec<Vector3<f64>> = (0..4)
        .map(|k| {
            let a = stereo.cameras[0]
                .undistort(&left.tag.corners_px[k])?
                .push(1.0);
            let b = left_from_right.rotation
                * stereo.cameras[1]
                    .undistort(&right.tag.corners_px[k])?
                    .push(1.0);
            // a u - (c + b v) across both lines is least.
            let (aa, ab, bb) = (a.dot(&a), a.dot(&b), b.dot(&b));
            let determinant = aa * bb - ab * ab;
            let u = (a.dot(&centre) * bb - b.dot(&centre) * ab) / determinant;
            let v = (a.dot(&centre) * ab - b.dot(&centre) * aa) / determinant;
            let place = 0.5 * (a * u + centre + b * v);
            (u > 0.0 && v > 0.0 && place.iter().all(|x| x.is_finite())).then_some(place)
        })
        .collect::<Option<_>>()?;
    let sides = (0..4).map(|k| (places[(k + 1) % 4] - places[k]).norm());
    Some(sides.sum::<f64>() / 4.0)
}
