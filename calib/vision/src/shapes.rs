//! `stereo-shape`: tags, the base's pose over the folder, one curve a pair, the joint correction of the base, groove and uncertainties.

use crate::base_pose::{FolderBase, PairTags, base_sightings, folder_base, rig_poses};
use crate::document::{STEREO_PARAMETERS, StereoCameras};
use crate::groove::groove_document;
use crate::pair_fit::{PairFit, fit_pair};
use crate::pairs::PairFiles;
use crate::picture::Picture;
use crate::rig::Rig;
use crate::rigid::{rows, updated};
use crate::shape_fit::{Prior, linearise, sight_residuals, stepped, with_prior};
use crate::shapes_document::{Gap, PairDocument, SHAPES_FORMAT, ShapesDocument, TagDocument};
use crate::tag_pose;
use crate::tags::find_tags;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use rayon::prelude::*;
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::collections::BTreeSet;

/// Root offsets where the base's tags and the wire agree on the frame: the clamp holds to a few micrometres.
const ROOT_CLAMPED: [f64; 2] = [0.003, 1e-4];
/// Root offsets where they do not: the rig file's tag pose is off, the wire's root is measured.
const ROOT_FREE: [f64; 2] = [1.0, 0.05];

/// Shift of a whole line that pieces share, px: uneven light across the wire and the camera's tone curve on unequal sides.
const LINE_FLOOR_PX: f64 = 0.015;
/// A corner is good to hundredths of a pixel: whole pixels are no noise.
const TAG_MISFIT_PX: f64 = 1.0;

/// A pair with its pictures and tags.
struct Loaded {
    name: String,
    pictures: [Picture; 2],
    tags: PairTags,
}

/// Everything that `stereo-shape` found, for the document and for overlays.
pub struct ShapesResult {
    /// `shapes.json`.
    pub document: ShapesDocument,
    /// Fits by pair index; none for rejected pairs.
    pub fits: Vec<Option<PairFit>>,
    /// Cameras used.
    pub stereo: StereoCameras,
}

/// Runs all pairs. `progress` is told each pair's name when it is done.
#[must_use]
pub fn shapes_of_pairs(
    stereo: &StereoCameras,
    rig: &Rig,
    files: &[PairFiles],
    progress: &(dyn Fn(&str) + Sync),
) -> ShapesResult {
    let loaded: Vec<Result<Loaded, String>> = files.par_iter().map(|f| load(stereo, rig, f)).collect();
    let tags: Vec<PairTags> =
        loaded.iter().map(|l| l.as_ref().map_or_else(|_| Vec::new(), |l| l.tags.clone())).collect();
    let base = folder_base(stereo, rig, &tags);
    let mut warnings = Vec::new();
    let attempt = |root_sd: [f64; 2], earlier: &[Result<PairFit, String>]| -> Vec<Result<PairFit, String>> {
        loaded
            .par_iter()
            .enumerate()
            .map(|(k, l)| {
                let l = l.as_ref().map_err(Clone::clone)?;
                let start = match earlier.get(k) {
                    None => None,
                    Some(Ok(fit)) => Some(fit),
                    Some(Err(why)) => return Err(why.clone()),
                };
                let fit = fit_one(stereo, rig, l, base.as_ref(), k, root_sd, start);
                if start.is_none() {
                    progress(&l.name);
                }
                fit
            })
            .collect()
    };
    let mut root_sd = ROOT_CLAMPED;
    let mut fits = attempt(root_sd, &[]);
    let mut joint = base.as_ref().map(|b| Joint::new(stereo, b, &fits, root_sd));
    if let Some(j) = &joint
        && j.disagreement > 30.0
    {
        warnings.push(format!(
            "tags and wire disagree on the base's frame (chi2 {:.0} of 6): base_from_tag in the rig file seems off; the frame follows the tags, the root is measured",
            j.disagreement
        ));
        root_sd = ROOT_FREE;
        fits = attempt(root_sd, &fits);
        joint = base.as_ref().map(|b| Joint::new(stereo, b, &fits, root_sd));
    }
    if let (Some(j), Some(b)) = (&joint, &base) {
        for (k, fit) in fits.iter_mut().enumerate() {
            if let Ok(fit) = fit
                && !b.moved.contains(&k)
            {
                j.apply(stereo, fit, root_sd);
            }
        }
        // Linearised again about the corrected base, for the covariances.
        joint = Some(Joint::new(stereo, &corrected(b, j), &fits, root_sd));
    }
    let (rigs, shared) = rig_poses(stereo, rig, &tags);
    if rigs.iter().flatten().count() > 1 && !shared {
        warnings
            .push("the rig tag turns between pairs; its orientation is taken from each pair alone".into());
    }
    let pairs = (0..files.len())
        .map(|k| {
            let mut document = PairDocument { name: files[k].name.clone(), ..PairDocument::default() };
            if let Ok(l) = &loaded[k] {
                document.tags = l.tags.iter().map(|(camera, t)| tag_document(*camera, t)).collect();
            }
            match &fits[k] {
                Err(why) => {
                    document.status = "rejected".into();
                    document.why.clone_from(why);
                }
                Ok(fit) => {
                    let uncertain = joint.as_ref().map(|j| j.covariance(fit, root_sd));
                    describe(&mut document, fit, uncertain.as_ref());
                    document.groove = rigs[k]
                        .as_ref()
                        .zip(rig.groove.as_ref())
                        .zip(uncertain.as_ref())
                        .map(|((pose, groove), u)| groove_document(stereo, fit, pose, groove, u, rig.whisker.diameter_mm));
                    if base.as_ref().is_some_and(|b| b.moved.contains(&k)) {
                        document.warnings.push("the base stands elsewhere than in the other pairs; its pose is from this pair alone".into());
                    }
                }
            }
            document
        })
        .collect();
    let document = ShapesDocument {
        format: SHAPES_FORMAT.into(),
        pairs,
        warnings,
        provenance: wcal_core::Provenance::default(),
    };
    ShapesResult { document, fits: fits.into_iter().map(Result::ok).collect(), stereo: stereo.clone() }
}

fn corrected(base: &FolderBase, joint: &Joint) -> FolderBase {
    let mut base = base.clone();
    base.pose.left_from_body *= updated(&Isometry3::identity(), &joint.step);
    base
}

fn load(stereo: &StereoCameras, rig: &Rig, files: &PairFiles) -> Result<Loaded, String> {
    let (Some(left), Some(right)) = (&files.left, &files.right) else {
        return Err(format!(
            "the {} picture is missing",
            if files.left.is_none() { "left" } else { "right" }
        ));
    };
    let read = |path: &std::path::PathBuf, camera: usize| {
        let picture = Picture::read(path).map_err(|e| e.to_string())?;
        let expected = stereo.cameras[camera].image_size_px;
        if [picture.width, picture.height] != expected {
            return Err(format!(
                "{}: expected {}x{} px as calibrated, found {}x{}",
                path.display(),
                expected[0],
                expected[1],
                picture.width,
                picture.height
            ));
        }
        match picture.unusable() {
            Some(why) => Err(format!("{}: {why}", path.display())),
            None => Ok(picture),
        }
    };
    let pictures = [read(left, 0)?, read(right, 1)?];
    if pictures[0] == pictures[1] {
        return Err("the left and the right picture are the same".into());
    }
    let families: BTreeSet<&str> = rig.tags.iter().map(|t| t.family.as_str()).collect();
    let mut tags = Vec::new();
    for (camera, picture) in pictures.iter().enumerate() {
        for family in &families {
            let search = |decimate| {
                find_tags(picture, family, Some(&stereo.cameras[camera]), decimate).map_err(|e| e.to_string())
            };
            // Half size finds all but small tags in a quarter of the time; where one is missing, full size decides.
            let mut found = search(2.0)?;
            let mut wanted = rig.tags.iter().filter(|t| t.family == **family);
            if wanted.any(|t| !found.iter().any(|f| f.id == t.id)) {
                found = search(1.0)?;
            }
            tags.extend(found.into_iter().map(|t| (camera, t)));
        }
    }
    Ok(Loaded { name: files.name.clone(), pictures, tags })
}

fn fit_one(
    stereo: &StereoCameras,
    rig: &Rig,
    loaded: &Loaded,
    base: Option<&FolderBase>,
    index: usize,
    root_sd: [f64; 2],
    start: Option<&PairFit>,
) -> Result<PairFit, String> {
    let own = base_sightings(rig, &loaded.tags);
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
        return Err(exchanged_or_foreign(base, &own, off_px));
    }
    let prior = Prior { base: pose.information, base_offset: Vector6::zeros(), root_sd, smoothing: 1e6 };
    fit_pair(stereo, rig, &loaded.pictures, &pose.left_from_body, &prior, start)
}

/// Why the base tag's corners fit no pose.
fn exchanged_or_foreign(base: &FolderBase, own: &[tag_pose::Sighting], off_px: f64) -> String {
    let as_in_the_other_camera = own.iter().all(|s| {
        base.sightings.iter().any(|b| {
            let near = |k: usize| (b.tag.corners_px[k] - s.tag.corners_px[k]).norm() < 3.0 * TAG_MISFIT_PX;
            b.camera != s.camera && b.tag.id == s.tag.id && (0..4).all(near)
        })
    });
    let cause = if as_in_the_other_camera {
        "the left and the right picture are swapped"
    } else {
        "left and right swapped, pictures not taken together, cameras moved since they were calibrated, or another tag size"
    };
    format!("the base tag's corners lie {off_px:.1} px from any pose that both cameras share: {cause}")
}

fn missing_tag(rig: &Rig, loaded: &Loaded) -> String {
    let wanted: Vec<String> = rig
        .tags
        .iter()
        .filter(|t| t.base_from_tag.is_some())
        .map(|t| format!("{} {}", t.family, t.id))
        .collect();
    let found: BTreeSet<String> = loaded.tags.iter().map(|(_, t)| format!("{} {}", t.family, t.id)).collect();
    let found = if found.is_empty() {
        "no tag".to_string()
    } else {
        found.into_iter().collect::<Vec<_>>().join(", ")
    };
    format!("expected the base tag ({}), found {found}", wanted.join(", "))
}

fn tag_document(camera: usize, tag: &crate::tags::Tag) -> TagDocument {
    TagDocument {
        id: tag.id,
        camera: if camera == 0 { "left" } else { "right" }.into(),
        corners_px: tag.corners_px.map(|c| [c.x, c.y]),
        corners_sd_px: tag.covariances_px2.map(|c| (0.5 * c.trace()).sqrt()),
    }
}

/// The base correction shared by the folder, and what the calibration's own uncertainty does to it.
struct Joint {
    /// Information on the base from tags and all wires.
    information: Matrix6<f64>,
    /// Base correction that all agree on.
    step: Vector6<f64>,
    /// How far the wires pull the base off its tags, in chi2.
    disagreement: f64,
    /// Right-hand side's derivative by the calibration's parameters, base part (6 x 24).
    sensitivity: DMatrix<f64>,
    stereo: StereoCameras,
}

impl Joint {
    fn new(
        stereo: &StereoCameras,
        base: &FolderBase,
        fits: &[Result<PairFit, String>],
        root_sd: [f64; 2],
    ) -> Self {
        let mut information = base.pose.information;
        let mut rhs = Vector6::zeros();
        let mut sensitivity = tag_sensitivity(stereo, base);
        for (k, fit) in fits.iter().enumerate() {
            let Ok(fit) = fit else { continue };
            if base.moved.contains(&k) {
                continue;
            }
            if let Some((h, g, s)) = reduced(stereo, fit, root_sd) {
                information += h;
                rhs += g;
                sensitivity += s;
            }
        }
        let step = information.cholesky().map_or_else(Vector6::zeros, |c| c.solve(&rhs));
        let disagreement = (step.transpose() * base.pose.information * step)[0];
        Self { information, step, disagreement, sensitivity, stereo: stereo.clone() }
    }

    /// Moves a pair to the joint base and lets its curve follow.
    fn apply(&self, stereo: &StereoCameras, fit: &mut PairFit, root_sd: [f64; 2]) {
        let roughness = fit.model.roughness();
        let moved = fit.left_from_base * updated(&Isometry3::identity(), &self.step);
        fit.left_from_base = moved;
        for _ in 0..3 {
            let system = linearise(stereo, &moved, &fit.model, &fit.state, &fit.sights, fit.noise);
            let (mut h, g) = with_prior(&system, &held(root_sd, fit.smoothing), &fit.state, &roughness);
            for k in 0..6 {
                h[(k, k)] += 1e15;
            }
            let Some(c) = h.cholesky() else { return };
            fit.state = stepped(&moved, &fit.state, &c.solve(&g)).1;
        }
        fit.system = linearise(stereo, &moved, &fit.model, &fit.state, &fit.sights, fit.noise);
    }

    /// Covariance of (base correction, curve parameters) of one pair: noise of everything, and the calibration.
    fn covariance(&self, fit: &PairFit, root_sd: [f64; 2]) -> Uncertain {
        let (h, _) =
            with_prior(&fit.system, &held(root_sd, fit.smoothing), &fit.state, &fit.model.roughness());
        let n = h.nrows();
        let own = reduced(&self.stereo, fit, root_sd).map_or_else(Matrix6::zeros, |r| r.0);
        let mut full = h;
        for i in 0..6 {
            for j in 0..6 {
                full[(i, j)] += self.information[(i, j)] - own[(i, j)];
            }
        }
        let inverse =
            full.clone().cholesky().map_or_else(|| DMatrix::identity(n, n) * f64::INFINITY, |c| c.inverse());
        let mut by_calibration = sensitivity(&self.stereo, fit);
        // The base's part holds what all pairs and tags say; the own part is in it already, reduced.
        let reduced_own = reduced(&self.stereo, fit, root_sd).map(|r| r.2);
        for i in 0..6 {
            for j in 0..STEREO_PARAMETERS {
                let other = self.sensitivity[(i, j)] - reduced_own.as_ref().map_or(0.0, |r| r[(i, j)]);
                by_calibration[(i, j)] += other;
            }
        }
        let response = &inverse * by_calibration;
        let mut covariance = inverse;
        if let Some(c) = &self.stereo.covariance {
            covariance += &response * c * response.transpose();
        }
        // A shift of one picture's line by a pixel moves the wire in depth by z^2 / (f b).
        let depth_mm = fit.left_from_base.translation.vector.norm();
        let baseline_mm = self.stereo.right_from_left.translation.vector.norm();
        let by_pixel = depth_mm * depth_mm / (self.stereo.cameras[0].focal_px[0] * baseline_mm);
        Uncertain { covariance, by_calibration: response, shared_mm: LINE_FLOOR_PX * by_pixel }
    }
}

/// Covariance of base correction and curve parameters, and their derivative by the calibration.
pub struct Uncertain {
    /// (6 + parameters) square.
    pub covariance: DMatrix<f64>,
    /// Rows as above, 24 columns.
    pub by_calibration: DMatrix<f64>,
    /// Error that all places of the wire share and that the pictures' scatter does not show, mm.
    pub shared_mm: f64,
}

fn held(root_sd: [f64; 2], smoothing: f64) -> Prior {
    Prior { base: Matrix6::zeros(), base_offset: Vector6::zeros(), root_sd, smoothing }
}

/// The pair's information on the base with the curve eliminated, right-hand side, and sensitivity.
fn reduced(
    stereo: &StereoCameras,
    fit: &PairFit,
    root_sd: [f64; 2],
) -> Option<(Matrix6<f64>, Vector6<f64>, DMatrix<f64>)> {
    let (h, g) = with_prior(&fit.system, &held(root_sd, fit.smoothing), &fit.state, &fit.model.roughness());
    let n = h.nrows() - 6;
    let cross = h.view((0, 6), (6, n)).into_owned();
    let own = h.view((6, 6), (n, n)).into_owned().cholesky()?;
    let carried = own.solve(&cross.transpose()).transpose();
    let information = h.view((0, 0), (6, 6)) - &carried * cross.transpose();
    let rhs = g.rows(0, 6) - &carried * g.rows(6, n);
    let s = sensitivity(stereo, fit);
    let reduced = s.rows(0, 6) - &carried * s.rows(6, n);
    Some((
        Matrix6::from_iterator(information.iter().copied()),
        Vector6::from_iterator(rhs.iter().copied()),
        reduced,
    ))
}

/// Step of each calibration parameter for finite differences: small against its effect's curvature.
fn calibration_step(k: usize) -> f64 {
    match k {
        k if k < 18 && k % 9 < 4 => 0.01,
        k if k < 18 => 1e-4,
        k if k < 21 => 1e-6,
        _ => 1e-3,
    }
}

/// The cameras with one parameter moved.
pub(crate) fn moved_cameras(stereo: &StereoCameras, k: usize, by: f64) -> StereoCameras {
    let mut s = stereo.clone();
    if k < 18 {
        let mut p = s.cameras[k / 9].parameters();
        p[k % 9] += by;
        s.cameras[k / 9] = s.cameras[k / 9].with_parameters(&p);
    } else {
        let mut step = Vector6::zeros();
        step[k - 18] = by;
        s.right_from_left = updated(&s.right_from_left, &step);
    }
    s
}

/// Derivative of the sights' right-hand side by the calibration.
fn sensitivity(stereo: &StereoCameras, fit: &PairFit) -> DMatrix<f64> {
    let points = fit.model.shape(&fit.state).points;
    let residuals =
        |s: &StereoCameras| sight_residuals(s, &fit.left_from_base, &points, fit.model.step_mm, &fit.sights);
    let now = residuals(stereo);
    let mut out = DMatrix::zeros(fit.system.data.nrows(), STEREO_PARAMETERS);
    for k in 0..STEREO_PARAMETERS {
        let h = calibration_step(k);
        let there = residuals(&moved_cameras(stereo, k, h));
        let change = DVector::from_iterator(now.len(), there.iter().zip(&now).map(|(a, b)| (a - b) / h));
        out.set_column(k, &(fit.system.rows_weighted.transpose() * change));
    }
    out
}

/// Derivative of the base tags' right-hand side by the calibration.
fn tag_sensitivity(stereo: &StereoCameras, base: &FolderBase) -> DMatrix<f64> {
    let pose = &base.pose.left_from_body;
    let gradient = |s: &StereoCameras| {
        tag_pose::linearise(s, &base.sightings, pose).map_or_else(Vector6::zeros, |l| l.2)
    };
    let now = gradient(stereo);
    let mut out = DMatrix::zeros(6, STEREO_PARAMETERS);
    for k in 0..STEREO_PARAMETERS {
        let h = calibration_step(k);
        out.set_column(k, &((gradient(&moved_cameras(stereo, k, h)) - now) / h));
    }
    out
}

/// Radius over sqrt(chi2_2(0.95)) that holds 95 % of a plane Gaussian with these variances (Satterthwaite's approximation).
pub(crate) fn planar_sd(a: f64, b: f64) -> f64 {
    let mean = a + b;
    if !(mean > 0.0) || !mean.is_finite() {
        return f64::NAN;
    }
    let variance = 2.0 * (a * a + b * b);
    let degrees = 2.0 * mean * mean / variance;
    let quantile = ChiSquared::new(degrees).map_or(5.991, |c| c.inverse_cdf(0.95));
    (variance / (2.0 * mean) * quantile / 5.991_464_547).sqrt()
}

/// Position covariance of a node, base frame.
pub(crate) fn node_covariance(
    fit: &PairFit,
    jacobian: &DMatrix<f64>,
    node: usize,
    u: &Uncertain,
) -> Matrix3<f64> {
    let n = fit.model.parameters();
    let j = jacobian.rows(3 * node, 3);
    let c = u.covariance.view((6, 6), (n, n));
    let m = j * c * j.transpose();
    Matrix3::from_iterator(m.iter().copied()) + Matrix3::identity() * u.shared_mm * u.shared_mm
}

fn describe(document: &mut PairDocument, fit: &PairFit, uncertain: Option<&Uncertain>) {
    document.status = "ok".into();
    document.left_from_base = rows(&fit.left_from_base).to_vec();
    document.length_mm = fit.length_mm;
    document.length_sd_mm = fit.length_sd_mm;
    document.warnings.clone_from(&fit.warnings);
    let shape = fit.model.shape(&fit.state);
    let jacobian = fit.model.jacobian(&fit.state);
    let last = fit.model.nodes as f64 - 1.001;
    let count = (fit.length_mm / 0.5).round().max(1.0) as usize;
    for k in 0..=count {
        let s = fit.length_mm * k as f64 / count as f64;
        let x = (s / fit.model.step_mm).min(last);
        let (i, f) = (x.floor() as usize, x.fract());
        let p: Vector3<f64> = shape.points[i] * (1.0 - f) + shape.points[i + 1] * f;
        document.centreline_mm.push([p.x, p.y, p.z]);
        let sd = uncertain.map_or(f64::NAN, |u| {
            let c = node_covariance(fit, &jacobian, i + usize::from(f > 0.5), u);
            let t = shape.tangents[i];
            let across = Matrix3::identity() - t * t.transpose();
            let e = (across * c * across).symmetric_eigenvalues();
            let mut e: Vec<f64> = e.iter().copied().collect();
            e.sort_by(f64::total_cmp);
            planar_sd(e[2].max(0.0), e[1].max(0.0))
        });
        document.centreline_sd_mm.push(sd);
    }
    document.gaps = gaps(fit);
    for camera in 0..2 {
        let (mut n, mut sum) = (0.0, 0.0);
        for (s, r) in fit.sights.iter().zip(&fit.system.residuals_px) {
            if s.camera == camera && r.is_finite() {
                n += 1.0;
                sum += r * r;
            }
        }
        document.residual_rms_px[camera] = f64::sqrt(sum / f64::max(n, 1.0));
    }
}

/// Stretches of more than a millimetre that one or both pictures do not show.
fn gaps(fit: &PairFit) -> Vec<Gap> {
    let cell = 0.25;
    let n = (fit.length_mm / cell).ceil() as usize;
    let mut hidden = vec![[true; 2]; n];
    for (camera, (pieces, seen)) in fit.pieces.iter().enumerate() {
        for (p, s) in pieces.iter().zip(seen) {
            let k = (p.station.arc_mm / cell) as usize;
            if *s {
                for h in hidden.iter_mut().take((k + 2).min(n)).skip(k.saturating_sub(1)) {
                    h[camera] = false;
                }
            }
        }
    }
    let mut gaps = Vec::new();
    let mut from = 0;
    while from < n {
        let kind = hidden[from];
        let to = (from..n).find(|&k| hidden[k] != kind).unwrap_or(n);
        if kind != [false; 2] && (to - from) as f64 * cell >= 1.0 {
            let names = ["left", "right"];
            gaps.push(Gap {
                from_mm: from as f64 * cell,
                to_mm: (to as f64 * cell).min(fit.length_mm),
                hidden_in: (0..2).filter(|&c| kind[c]).map(|c| names[c].to_string()).collect(),
            });
        }
        from = to;
    }
    gaps
}
