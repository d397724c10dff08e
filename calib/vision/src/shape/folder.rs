//! `stereo-shape`: tags, the base's pose over the folder, one curve a pair, the joint correction of
//! the base, groove and uncertainties.

use crate::pairs::PairFiles;
use crate::picture::Picture;
use crate::rig::Rig;
use crate::shape::curve_fit::Prior;
use crate::shape::describe::{describe, tag_document};
use crate::shape::groove::find_groove;
use crate::shape::joint::{Joint, ROOT_CLAMPED, uncertainties};
use crate::shape::other_pose::pairs_of_other_poses;
use crate::shape::pair_errors::{SharedErrors, VertexErrors, pair_errors};
use crate::shape::pair_fit::{PairFit, ROOT_FREE, Scene, fit_pair};
use crate::stereo::StereoCameras;
use crate::tags::apriltag_ffi::Tag;
use crate::tags::base_pose::{
    FolderBase, PairTags, base_observations, folder_base, observations_of, rig_poses,
};
use crate::tags::detection::{Search, find_tags};
use crate::tags::pose::{self as tag_pose, TAG_MISFIT_PX};
use crate::tags::size::{TagSizes, tag_sizes};
use nalgebra::Point3;
use rayon::prelude::*;
use std::collections::BTreeSet;
use wcal_core::shapes_document::{PairDocument, SHAPES_FORMAT, ShapesDocument};

/// chi2 of 6 beyond which tags and wire disagree; the chance of more is 4e-5.
const DISAGREEMENT: f64 = 30.0;
/// Length from the root without a piece in either picture at which the root counts as not seen, mm.
const UNSEEN_MM: f64 = 3.0;
/// Part of the wire that counts as near its root, mm.
const NEAR_ROOT_MM: f64 = 6.0;
/// Largest surface strain at the clamp: beyond it NiTi leaves its elastic range, which no bench
/// does.
const MAX_STRAIN: f64 = 0.015;

/// Side of a tag that a search at half size cannot miss, px.
const LARGE_TAG_PX: f64 = 48.0;

/// A pair: the pictures to search for the wire, and tags.
struct PairInput {
    name: String,
    pictures: [Picture; 2],
    tags: PairTags,
    remarks: Vec<String>,
}

/// Everything that `stereo-shape` found, for the document and for the report.
pub struct ShapesResult {
    /// `shapes.json`.
    pub document: ShapesDocument,
    /// Fits by pair index; none for rejected pairs.
    pub fits: Vec<Option<PairFit>>,
}

/// Runs all pairs. `progress` is called with each pair's name when it is done.
pub fn shapes_of_pairs(
    stereo: &StereoCameras,
    rig: &Rig,
    files: &[PairFiles],
    progress: &(dyn Fn(&str) + Sync),
) -> ShapesResult {
    let mut loaded: Vec<Result<PairInput, String>> =
        files.par_iter().map(|f| load(stereo, rig, f)).collect();
    let TagSizes {
        rig: as_seen,
        mut warnings,
        elsewhere,
    } = tag_sizes(stereo, rig, &tags_of(&loaded));
    warnings.splice(0..0, rig.remarks.clone());
    for (pair, why) in loaded.iter_mut().zip(elsewhere) {
        if let Some(why) = why {
            *pair = Err(why);
        }
    }
    let (mut document, mut fits) = shapes_of_loaded(stereo, &as_seen, files, &loaded, progress);
    // What the pairs have in common is found again without those that mix two poses.
    let other_poses = pairs_of_other_poses(&document.pairs);
    if !other_poses.is_empty() {
        for (k, why) in other_poses {
            loaded[k] = Err(why);
        }
        (document, fits) = shapes_of_loaded(stereo, &as_seen, files, &loaded, &|_| {});
    }
    document.warnings.splice(0..0, warnings);
    ShapesResult { document, fits }
}

fn tags_of(loaded: &[Result<PairInput, String>]) -> Vec<PairTags> {
    let tags = |l: &PairInput| l.tags.clone();
    loaded
        .iter()
        .map(|l| l.as_ref().map_or(Vec::new(), tags))
        .collect()
}

/// The pairs as fitted in the base's frame, and the freedom that their roots had.
type FittedPairs = (Vec<Result<PairFit, String>>, [f64; 2]);

/// Fits all pairs that could be read, and moves them into the frame that tags and wires of all of
/// them give; warns of what these disagree about.
fn fit_pairs(
    stereo: &StereoCameras,
    rig: &Rig,
    loaded: &[Result<PairInput, String>],
    base: Option<&FolderBase>,
    progress: &(dyn Fn(&str) + Sync),
    warnings: &mut Vec<String>,
) -> FittedPairs {
    let attempt =
        |root_sd: [f64; 2], earlier: &[Result<PairFit, String>]| -> Vec<Result<PairFit, String>> {
            loaded
                .par_iter()
                .enumerate()
                .map(|(k, l)| {
                    let l = l.as_ref().map_err(Clone::clone)?;
                    let start = earlier.get(k).map(Result::as_ref).transpose();
                    let start = start.map_err(Clone::clone)?;
                    let fit = fit_one(stereo, rig, l, base, k, root_sd, start);
                    // Once a pair, also where it is fitted again.
                    if start.is_none() && root_sd == ROOT_CLAMPED {
                        progress(&l.name);
                    }
                    fit
                })
                .collect()
        };
    let mut root_sd = ROOT_CLAMPED;
    let mut fits = attempt(root_sd, &[]);
    // A root away from the tags' estimate is not seen, or most searches from it fail: search with a
    // free root, in line with the rest of the wire.
    let sound = |fits: &[Result<PairFit, String>]| fits.iter().flatten().count();
    let most_lost = 2 * sound(&fits) < loaded.iter().flatten().count();
    let free = (most_lost || root_misplaced(&fits, rig.whisker.diameter_mm))
        .then(|| attempt(ROOT_FREE, &[]))
        .filter(|free| !most_lost || sound(free) > sound(&fits));
    let mut joint = base.map(|b| Joint::new(b, free.as_ref().unwrap_or(&fits), ROOT_CLAMPED));
    if let Some(j) = &joint
        && j.disagreement > DISAGREEMENT
    {
        warnings.push(format!(
            "tags and wire disagree on the base's frame (chi2 {:.0} of 6): base_from_tag in the rig file seems off; the frame follows the tags, the root is measured",
            j.disagreement
        ));
        root_sd = ROOT_FREE;
        fits = free.unwrap_or_else(|| attempt(root_sd, &fits));
        joint = base.map(|b| Joint::new(b, &fits, root_sd));
    }
    if let (Some(j), Some(b)) = (&joint, base) {
        fits.par_iter_mut().enumerate().for_each(|(k, fit)| {
            if let Ok(fit) = fit
                && !b.moved.contains(&k)
            {
                j.apply(stereo, fit, root_sd);
            }
        });
    }
    (fits, root_sd)
}

/// The document of all pairs, and the fits.
fn shapes_of_loaded(
    stereo: &StereoCameras,
    rig: &Rig,
    files: &[PairFiles],
    loaded: &[Result<PairInput, String>],
    progress: &(dyn Fn(&str) + Sync),
) -> (ShapesDocument, Vec<Option<PairFit>>) {
    let tags = tags_of(loaded);
    let base = folder_base(stereo, rig, &tags);
    let mut warnings = Vec::new();
    let (fits, root_sd) = fit_pairs(stereo, rig, loaded, base.as_ref(), progress, &mut warnings);
    let uncertain = base.as_ref().map_or_else(
        || files.iter().map(|_| None).collect(),
        |b| uncertainties(stereo, b, &fits, root_sd),
    );
    let rigs = rig_poses(stereo, rig, &tags);
    let shared = SharedErrors::new(stereo, &uncertain, &rigs);
    if rigs.poses.iter().flatten().count() > 1 && rigs.shared_turn.is_none() {
        warnings.push(
            "the rig tag turns between pairs; its orientation is taken from each pair alone".into(),
        );
    }
    let moved = |k: usize| base.as_ref().is_some_and(|b| b.moved.contains(&k));
    let describe_pair = |k: usize| {
        let mut document = PairDocument {
            name: files[k].name.clone(),
            point: files[k].point,
            ..PairDocument::default()
        };
        if let Ok(l) = &loaded[k] {
            document.tags = l
                .tags
                .iter()
                .map(|(camera, t)| tag_document(*camera, t))
                .collect();
            document.warnings.clone_from(&l.remarks);
        }
        let fit = match &fits[k] {
            Err(why) => {
                document.status = "rejected".into();
                document.why.clone_from(why);
                return document;
            }
            Ok(fit) => fit,
        };
        describe(&mut document, fit, uncertain[k].as_ref());
        if moved(k) {
            let remark = "the base is at another place than in the other pairs; its pose is from this pair alone";
            document.warnings.push(remark.into());
        }
        let Some(u) = &uncertain[k] else {
            return document;
        };
        let groove = rigs.poses[k]
            .as_ref()
            .zip(rig.groove.as_ref())
            .and_then(|(pose, groove)| {
                let vertex = VertexErrors::new(stereo, &shared, &rigs, k, fit, groove, u)?;
                let diameter_mm = rig.whisker.diameter_mm;
                Some((
                    find_groove(fit, pose, groove, &vertex.covariance, u, diameter_mm),
                    vertex,
                ))
            });
        let with_groove = groove.as_ref().map(|(g, v)| (g, v));
        let (errors, covariance) = pair_errors(stereo, &shared, fit, u, with_groove);
        document.groove = groove.map(|(g, _)| g.with_errors(&covariance));
        document.errors = Some(errors);
        document
    };
    let pairs: Vec<PairDocument> = (0..files.len())
        .into_par_iter()
        .map(describe_pair)
        .collect();
    let rows = shared.covariance.row_iter();
    let shared_covariance = rows.map(|row| row.iter().copied().collect()).collect();
    let document = ShapesDocument {
        format: SHAPES_FORMAT.into(),
        pairs,
        shared_parameters: shared.parameters,
        shared_covariance,
        warnings,
        ..ShapesDocument::default()
    };
    (document, fits.into_iter().map(Result::ok).collect())
}

/// In most pairs the curve from the stated root is not the wire: another root has far more
/// evidence, its first millimetres are seen in neither picture, or its strain there exceeds the
/// elastic range.
fn root_misplaced(fits: &[Result<PairFit, String>], diameter_mm: f64) -> bool {
    let misplaced = |f: &PairFit| {
        let first = f
            .observations
            .iter()
            .fold(f64::INFINITY, |a, s| a.min(s.arc_mm));
        let points = f.model.shape(&f.state).points;
        let near = ((NEAR_ROOT_MM / f.model.step_mm) as usize).min(points.len());
        let bend = points[..near]
            .windows(3)
            // Curvature, 1/mm: angle between neighbouring chords over their length.
            .map(|w| (w[1] - w[0]).angle(&(w[2] - w[1])) / f.model.step_mm)
            .fold(0.0, f64::max);
        // Surface strain is half the diameter times the curvature.
        f.root_aside_mm > 0.0 || first > UNSEEN_MM || 0.5 * diameter_mm * bend > MAX_STRAIN
    };
    let votes: Vec<bool> = fits.iter().flatten().map(misplaced).collect();
    2 * votes.iter().filter(|v| **v).count() > votes.len()
}

fn load(stereo: &StereoCameras, rig: &Rig, files: &PairFiles) -> Result<PairInput, String> {
    let pictures = files.read(Some(stereo.cameras[0].image_size_px))?;
    let families: BTreeSet<&str> = rig.tags.iter().map(|t| t.family.as_str()).collect();
    let mut tags = Vec::new();
    for (camera, picture) in pictures.iter().enumerate() {
        for family in &families {
            let search = |search| {
                find_tags(picture, family, Some(&stereo.cameras[camera]), search)
                    .map_err(|e| e.to_string())
            };
            let mut found = search(Search::StrongContrast)?;
            for wider in [Search::Halved, Search::Whole] {
                let mut wanted = rig.tags.iter().filter(|t| t.family == **family);
                let all = wanted.all(|t| found.iter().any(|f| f.id == t.id));
                // Where the tags that are seen are large, one that is not seen at half size is not
                // there.
                let large = |f: &Tag| (f.corners_px[1] - f.corners_px[0]).norm() > LARGE_TAG_PX;
                if all || (wider == Search::Whole && found.iter().any(large)) {
                    break;
                }
                found = search(wider)?;
            }
            tags.extend(found.into_iter().map(|t| (camera, t)));
        }
    }
    let (tags, remarks) = each_once(tags);
    Ok(PairInput {
        name: files.name.clone(),
        pictures,
        tags,
        remarks,
    })
}

/// Fits a pair, from an earlier fit where there is one.
fn fit_one(
    stereo: &StereoCameras,
    rig: &Rig,
    loaded: &PairInput,
    base: Option<&FolderBase>,
    index: usize,
    root_sd: [f64; 2],
    start: Option<&PairFit>,
) -> Result<PairFit, String> {
    let own = base_observations(rig, &loaded.tags);
    let base = base.ok_or_else(|| missing_tag(rig, loaded))?;
    // A pair without its base tag cannot show that the base still stood where it was.
    if own.is_empty() {
        return Err(missing_tag(rig, loaded));
    }
    let pose = if base.moved.contains(&index) {
        tag_pose::body_pose(stereo, &own).ok_or("the base tag's pose has no solution")?
    } else {
        base.pose.clone()
    };
    let off_px = tag_pose::residual_rms_px(stereo, &own, &pose.left_from_body);
    if off_px > TAG_MISFIT_PX {
        return Err(format!(
            "the base tag's corners lie {off_px:.1} px from any pose that both cameras share: left and right swapped, pictures not taken together, cameras moved since they were calibrated, or another tag size"
        ));
    }
    let mut vertex_mm = None;
    for tag in rig.tags.iter().filter(|t| t.base_from_tag.is_none()) {
        let seen = observations_of(tag, &loaded.tags);
        let Some(own) = tag_pose::body_pose(stereo, &seen) else {
            continue;
        };
        if let Some(groove) = rig.groove.as_ref().filter(|g| g.tag == tag.id) {
            let in_left = own.left_from_body * Point3::from(groove.position_in_tag_mm);
            vertex_mm = Some((pose.left_from_body.inverse() * in_left).coords);
        }
        let off_px = tag_pose::residual_rms_px(stereo, &seen, &own.left_from_body);
        if off_px > TAG_MISFIT_PX {
            return Err(format!(
                "tag {} {} lies {off_px:.1} px from any pose that both cameras share: pictures not taken together, or another tag size",
                tag.family, tag.id
            ));
        }
    }
    let prior = Prior {
        base: pose.information,
        root_sd,
        smoothing: 1e6,
    };
    let scene = Scene {
        stereo,
        rig,
        pictures: &loaded.pictures,
        left_from_base: &pose.left_from_body,
        vertex_mm,
        prior: &prior,
    };
    fit_pair(&scene, start)
}

/// The most certain of several sightings of a tag in one picture (a second print, a mirror image),
/// and what is said of the others.
fn each_once(tags: PairTags) -> (PairTags, Vec<String>) {
    let (mut kept, mut remarks) = (PairTags::new(), BTreeSet::new());
    for (camera, tag) in tags {
        let same =
            |k: &&mut (usize, Tag)| k.0 == camera && k.1.id == tag.id && k.1.family == tag.family;
        let Some(other) = kept.iter_mut().find(same) else {
            kept.push((camera, tag));
            continue;
        };
        remarks.insert(format!(
            "tag {} {} is seen more than once in the {} picture: counted once",
            tag.family,
            tag.id,
            ["left", "right"][camera]
        ));
        if tag.decision_margin > other.1.decision_margin {
            other.1 = tag;
        }
    }
    (kept, remarks.into_iter().collect())
}

fn missing_tag(rig: &Rig, loaded: &PairInput) -> String {
    let wanted = rig.tags.iter().filter(|t| t.base_from_tag.is_some());
    let wanted: Vec<_> = wanted.map(|t| format!("{} {}", t.family, t.id)).collect();
    let found = loaded
        .tags
        .iter()
        .map(|(_, t)| format!("{} {}", t.family, t.id));
    let found: BTreeSet<String> = found.collect();
    let found = match found.is_empty() {
        true => "no tag".to_owned(),
        false => found.into_iter().collect::<Vec<_>>().join(", "),
    };
    format!(
        "expected the base tag ({}), found {found}",
        wanted.join(", ")
    )
}
