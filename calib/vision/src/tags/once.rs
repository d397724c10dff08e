//! A tag that a picture shows twice (a second print, a mirror image) counts once.

use crate::rig::Rig;
use crate::stereo::StereoCameras;
use crate::tags::base_pose::{PairTags, observations_of};
use crate::tags::pose::body_pose;

/// The tags of a pair with each of the rig's at most once a camera, and what is said of the others. Of several that one stays which fits the other
/// camera's best, or, where the other camera does not see it, the most certain one.
pub(crate) fn each_once(stereo: &StereoCameras, rig: &Rig, mut tags: PairTags) -> (PairTags, Vec<String>) {
    let mut remarks = Vec::new();
    for known in &rig.tags {
        let is_it =
            |(_, t): &&(usize, crate::tags::detection::Tag)| t.id == known.id && t.family == known.family;
        let seen: [PairTags; 2] =
            [0, 1].map(|camera| tags.iter().filter(is_it).filter(|t| t.0 == camera).cloned().collect());
        if seen.iter().all(|s| s.len() < 2) {
            continue;
        }
        for (side, found) in ["left", "right"].iter().zip(&seen).filter(|(_, found)| found.len() > 1) {
            remarks.push(format!(
                "tag {} {} is seen {} times in the {side} picture: counted once",
                known.family,
                known.id,
                found.len()
            ));
        }
        let misfit = |pair: &PairTags| {
            body_pose(stereo, &observations_of(known, pair)).map_or(f64::INFINITY, |p| p.chi2)
        };
        let both = seen[0].iter().flat_map(|l| seen[1].iter().map(move |r| vec![l.clone(), r.clone()]));
        let kept = both.min_by(|a, b| misfit(a).total_cmp(&misfit(b))).unwrap_or_else(|| {
            let certain = |a: &&(usize, _), b: &&(usize, _)| margin(a).total_cmp(&margin(b));
            seen.iter().flatten().max_by(certain).cloned().into_iter().collect()
        });
        tags.retain(|t| !is_it(&t));
        tags.extend(kept);
    }
    (tags, remarks)
}

fn margin(tag: &(usize, crate::tags::detection::Tag)) -> f64 {
    tag.1.decision_margin
}
