//! One pair from pictures to a fitted curve, with a base pose that is taken as known here and
//! corrected over the folder.

use crate::picture::Picture;
use crate::rig::Rig;
use crate::shape::curve::{CurveModel, CurveState};
use crate::shape::curve_fit::{
    LineObservation, PairSystem, Prior, choose_smoothing, image_line, linearise, observation,
    stepped,
};
use crate::shape::socp_start::socp_initial_curve;
use crate::stereo::StereoCameras;
use crate::wire::appearance::fit_appearance;
use crate::wire::piece::{Appearance, Piece, Station, fit_piece};
use crate::wire::search::find_wire;
use crate::wire::tip::{Tip, find_tip};
use nalgebra::{Isometry3, Matrix6, Vector3};

/// A fitted pair.
#[derive(Debug, Clone)]
pub struct PairFit {
    /// Curve model.
    pub model: CurveModel,
    /// Curve.
    pub state: CurveState,
    /// Base pose used.
    pub left_from_base: Isometry3<f64>,
    /// Information of the tags on a correction of that pose.
    pub base_information: Matrix6<f64>,
    /// Measured places that count.
    pub observations: Vec<LineObservation>,
    /// All pieces measured, left and right.
    pub pieces: [Vec<Piece>; 2],
    /// Length and its sd, mm.
    pub length_mm: f64,
    /// Sd of the length, mm.
    pub length_sd_mm: f64,
    /// The part of the length's error that all pairs share, mm: the end's form.
    pub length_shared_mm: f64,
    /// Linearised observations at the solution.
    pub system: PairSystem,
    /// Factor on the observations' sd that makes their scatter consistent.
    pub noise: f64,
    /// Smoothing chosen.
    pub smoothing: f64,
    /// +1 dark wire.
    pub polarity: f64,
    /// Blur and width of the wire, left and right.
    pub appearances: [Appearance; 2],
    /// Nominal diameter of the wire, mm.
    pub diameter_mm: f64,
    /// Distance of the root from the base's origin at which the search found it, mm.
    pub root_aside_mm: f64,
    /// Remarks.
    pub warnings: Vec<String>,
}

/// Length of the curve model, in nominal lengths.
const REACH: f64 = 1.12;
/// Sd of the root's offsets (mm) and tilts (rad) where the wire does not start at the tags'
/// estimate.
pub(crate) const ROOT_FREE: [f64; 2] = [1.0, 0.05];
/// Share of the nominal length by which a wire's end may lie elsewhere.
const LENGTH_SHARE: f64 = 0.1;
/// Smallest ratio of the pieces a mm in the wire's last third to those of the rest, in the picture
/// that shows more of it. Drawn wires of the tests show 46-60 pieces there, one that was lost
/// toward the cameras 13.
const TAIL_SHARE: f64 = 0.35;
/// Share of the wire's length that one picture alone must not show, and the share of its
/// millimetres at which a picture shows a stretch; the other one has twice that. A groove hides
/// less, and one view does not determine the depth.
const STRETCH_SHARE: f64 = 0.25;
const STRETCH_SEEN: f64 = 0.25;
/// Scatter of the pieces against their own noise that is remarked on, and that no single wire
/// shows: drawn single wires have 0.5-1.3, two that were taken for one 2.5-15.
const SCATTER_WARN: f64 = 2.0;
const SCATTER_REJECT: f64 = 3.0;
/// Length by which a wire is followed on where it does not end.
const GROWTH_MM: f64 = 2.0;
/// Distance of the curvature splines' knots, mm.
const KNOT_MM: f64 = 2.5;
/// Distance of the vertex from the wire within which the groove may push it, mm.
const CONTACT_NEAR_MM: f64 = 1.0;
/// A pair before its wire is found.
pub struct Scene<'a> {
    /// Cameras.
    pub stereo: &'a StereoCameras,
    /// Rig.
    pub rig: &'a Rig,
    /// Pictures, left and right.
    pub pictures: &'a [Picture; 2],
    /// Pose of the base.
    pub left_from_base: &'a Isometry3<f64>,
    /// Where the rig tag puts the groove's vertex, base frame, mm; none where it is not seen.
    pub vertex_mm: Option<Vector3<f64>>,
    /// What is known besides the pictures.
    pub prior: &'a Prior,
}

/// Finds and fits the wire of one pair; `start` takes up an earlier fit of the same pictures where
/// it ended.
///
/// # Errors
/// A sentence with the reason why the pair cannot be used.
pub(crate) fn fit_pair(scene: &Scene<'_>, start: Option<&PairFit>) -> Result<PairFit, String> {
    if let Some(fit) = start {
        return refine(scene, fit.clone(), true);
    }
    let search = |wide| begin(scene, wide).and_then(|begun| refine(scene, begun, false));
    // A wire lost in a gap or at another line is searched for again with wider beams; if that
    // fails, too, the first reason is reported.
    search(false).or_else(|why| search(true).map_err(|_| why))
}

/// The arc length at which the groove pushes a curve, mm; none where it is not there.
fn pushed_at(model: &CurveModel, state: &CurveState, vertex_mm: &Vector3<f64>) -> Option<f64> {
    let off = |p: &Vector3<f64>| (p - vertex_mm).norm();
    let points = model.shape(state).points;
    let (k, near) = points
        .iter()
        .enumerate()
        .min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
    (off(near) < CONTACT_NEAR_MM).then_some(k as f64 * model.step_mm)
}

/// Follows the curve that the search found through the pieces of both pictures.
fn refine(scene: &Scene<'_>, mut fit: PairFit, again: bool) -> Result<PairFit, String> {
    let Scene {
        stereo,
        rig,
        left_from_base,
        vertex_mm,
        prior,
        ..
    } = *scene;
    let nominal_mm = rig.whisker.length_mm;
    let mut prior = Prior {
        smoothing: fit.smoothing,
        ..prior.clone()
    };
    // A wire that starts elsewhere is fitted with a free root; whether the base moved as well is
    // decided over the folder.
    if fit.root_aside_mm > 0.0 {
        prior.root_sd = ROOT_FREE;
    }
    fit.left_from_base = *left_from_base;
    fit.base_information = prior.base;
    fit.length_shared_mm = 0.0;
    fit.warnings.clear();
    let mut end_seen = false;
    // The window narrows as the curve converges.
    let windows = [4.0, 2.0, 1.2, 1.0, 1.0];
    let mut round = if again { 3 } else { 0 };
    while let Some(&search_px) = windows.get(round) {
        // Blur and width are fitted once the line is approximately right.
        measure_pieces(scene, &mut fit, search_px, round == 1 || round == 3);
        let seen = fit.seen().map(|(camera, piece)| observation(camera, piece));
        fit.observations = seen.filter(|o| o.sd_px.is_finite()).collect();
        let all = &fit.observations;
        // The curve and its levels have some 40 parameters: fewer pieces leave it open.
        if all.len() < 40 {
            return Err(format!(
                "no wire: only {} pieces of 4 px show a bar",
                all.len()
            ));
        }
        if round == 0 {
            // Far from the solution robust weights and evidence for the smoothing are unreliable:
            // the convex programme needs neither.
            fit.state =
                socp_initial_curve(stereo, left_from_base, &fit.model, &fit.state, all, &prior)
                    .ok_or("no curve of the wire's length passes through the pieces")?;
            round += 1;
            continue;
        }
        // A force makes a corner in the curvature, which the roughness must not round.
        if let Some(arc_mm) = vertex_mm.and_then(|at| pushed_at(&fit.model, &fit.state, &at)) {
            fit.model = fit.model.with_force_at(arc_mm);
        }
        let last = all.iter().fold(0.0f64, |m, s| m.max(s.arc_mm));
        gauss_newton(stereo, &mut fit, &mut prior)?;
        let ends = ends_seen(scene, &fit);
        end_seen = !ends.is_empty();
        if end_seen {
            // Both pictures' ends are weighted by their information, 1 / sd^2.
            let sum = |of: fn(&Tip) -> f64| ends.iter().map(|e| of(e) * e.sd_mm.powi(-2)).sum();
            let weight: f64 = sum(|_| 1.0);
            fit.length_mm = sum(|e| e.arc_mm) / weight;
            fit.length_shared_mm = sum(|e| e.shared_mm) / weight;
            // Both pictures see the same form of the end: only the rest of their errors averages.
            let own = |e: &Tip| (e.sd_mm.powi(2) - e.shared_mm.powi(2)) * e.sd_mm.powi(-2);
            let own_mm = sum(own).sqrt() / weight;
            fit.length_sd_mm = own_mm.hypot(fit.length_shared_mm);
        } else {
            // Seen up to the end of the searched length, and no wire end there: the wire is longer.
            if last > fit.length_mm - 1.0 && fit.length_mm + GROWTH_MM < REACH * nominal_mm {
                fit.length_mm += GROWTH_MM;
                continue;
            }
            // Without a visible end: the last piece seen, or the nominal length where that lies
            // near.
            fit.length_mm = if (last - nominal_mm).abs() < 2.0 {
                nominal_mm
            } else {
                last
            };
            (fit.length_sd_mm, fit.length_shared_mm) = (1.0, 0.0);
            if round == 4 {
                fit.warnings.push("the wire's end is not seen in either picture; its length is nominal or that of the last piece seen".into());
            }
        }
        round += 1;
    }
    let warnings = doubts(&fit, end_seen, nominal_mm)?;
    fit.warnings.extend(warnings);
    fit.smoothing = prior.smoothing;
    fit.system = fit.linearised(stereo);
    Ok(fit)
}

impl PairFit {
    /// Pieces that show the wire, with their camera.
    pub(crate) fn seen(&self) -> impl Iterator<Item = (usize, &Piece)> {
        let of = |camera: usize| self.pieces[camera].iter().map(move |p| (camera, p));
        of(0)
            .chain(of(1))
            .filter(|(_, piece)| piece.shows(self.polarity))
    }

    /// The observations, linearised about the curve.
    pub(crate) fn linearised(&self, stereo: &StereoCameras) -> PairSystem {
        let (model, state) = (&self.model, &self.state);
        let (pose, observations) = (&self.left_from_base, &self.observations);
        linearise(stereo, pose, model, state, observations, self.noise)
    }
}

impl Scene<'_> {
    /// Stations along the image of a curve in a picture.
    fn line(&self, fit: &PairFit, camera: usize, length_mm: f64) -> Vec<Station> {
        image_line(
            self.stereo,
            self.left_from_base,
            camera,
            &fit.model.shape(&fit.state).points,
            fit.model.step_mm,
            length_mm,
            fit.diameter_mm,
        )
    }
}

/// Measures the pieces of the wire in both pictures, and fits the wire's appearance to them where
/// `fit_looks`.
fn measure_pieces(scene: &Scene<'_>, fit: &mut PairFit, search_px: f64, fit_looks: bool) {
    for camera in 0..2 {
        let line = scene.line(fit, camera, fit.length_mm);
        let (picture, appearance) = (&scene.pictures[camera], &mut fit.appearances[camera]);
        fit.pieces[camera] = line
            .iter()
            .filter_map(|s| fit_piece(picture, s, *appearance, search_px))
            .collect();
        if fit_looks {
            *appearance = fit_appearance(picture, &fit.pieces[camera], *appearance);
        }
    }
}

/// Gauss-Newton on the pieces as measured; the smoothing is chosen once the curve is close, the
/// pieces' noise at the end.
fn gauss_newton(
    stereo: &StereoCameras,
    fit: &mut PairFit,
    prior: &mut Prior,
) -> Result<(), String> {
    for inner in 0..3 {
        let system = fit.linearised(stereo);
        if inner == 1 {
            prior.smoothing = choose_smoothing(&system, prior, &fit.state, &fit.model);
        }
        // The base is held here; the folder's joint step moves it.
        fit.state = stepped(&system, prior, &fit.state, &fit.model)
            .ok_or("the curve's normal matrix is singular")?;
        if inner == 2 {
            fit.noise = consistent_noise(&system, fit.noise, &fit.observations);
        }
    }
    Ok(())
}

/// The wire's end where a picture shows it.
fn ends_seen(scene: &Scene<'_>, fit: &PairFit) -> Vec<Tip> {
    let of = |camera: usize| {
        let line = scene.line(fit, camera, f64::INFINITY);
        find_tip(
            &scene.pictures[camera],
            &line,
            fit.appearances[camera],
            fit.length_mm,
        )
    };
    (0..2).filter_map(of).collect()
}

/// Why a fitted line is not the wire, or what is doubtful about it; `expected` is the wire's
/// length, mm.
fn doubts(fit: &PairFit, end_seen: bool, expected: f64) -> Result<Vec<String>, String> {
    let (length, noise) = (fit.length_mm, fit.noise);
    let mut warnings = Vec::new();
    // The wire's length is known: a line that ends far from it is another object.
    if end_seen && (length - expected).abs() > LENGTH_SHARE * expected {
        return Err(format!(
            "the line found ends at {length:.1} mm, the wire is {expected:.1} mm long: lost on something else, or whisker.length_mm in the rig file is wrong"
        ));
    }
    if let Some((camera, from, to)) = unseen_stretch(fit) {
        let side = ["left", "right"][camera];
        return Err(format!(
            "the {side} picture shows hardly anything of the wire from {from:.0} to {to:.0} mm: one view gives no shape (hidden, lost on something else, or no wire there)"
        ));
    }
    let tail = tail_share(fit, expected);
    if tail < TAIL_SHARE {
        return Err(format!(
            "the wire is lost: its last third shows {:.0} % of the pieces that the rest of it has a mm (lost on something else, or it points at both cameras)",
            100.0 * tail
        ));
    }
    if noise > SCATTER_REJECT {
        return Err(format!(
            "the pieces found lie {noise:.0} times farther from one smooth curve than their noise: a second wire next to the first, or an object in front of it"
        ));
    }
    if noise > SCATTER_WARN {
        warnings.push(format!(
            "the pieces lie {noise:.1} times farther from the curve than their noise: a second wire or texture next to it?"
        ));
    }
    if (length - expected).abs() > 0.02 * expected {
        warnings.push(format!("length {length:.2} mm, nominal {expected:.2} mm"));
    }
    Ok(warnings)
}

/// The curve that the search found, before anything is measured.
fn begin(scene: &Scene<'_>, wide: bool) -> Result<PairFit, String> {
    let Scene {
        stereo,
        rig,
        pictures,
        left_from_base,
        prior,
        ..
    } = *scene;
    let root_free = prior.root_sd == ROOT_FREE;
    let (found, polarity) = find_wire(stereo, rig, pictures, left_from_base, root_free, wide)?;
    let model = CurveModel::new(&rig.whisker, REACH * rig.whisker.length_mm, KNOT_MM);
    let last = found.curvatures.len() - 1;
    let per_node: Vec<[f64; 2]> = (0..model.nodes)
        .map(|i| found.curvatures[((i as f64 * model.step_mm) as usize).min(last)])
        .collect();
    let mut state = model.state_of_curvatures(&per_node);
    state.root[..2].copy_from_slice(&found.root_mm);
    let system = linearise(stereo, left_from_base, &model, &state, &[], 1.0);
    Ok(PairFit {
        model,
        state,
        left_from_base: *left_from_base,
        base_information: prior.base,
        observations: Vec::new(),
        pieces: Default::default(),
        length_mm: found.length_mm.max(0.5 * rig.whisker.length_mm),
        length_sd_mm: 0.5,
        length_shared_mm: 0.0,
        system,
        noise: 1.0,
        smoothing: prior.smoothing,
        polarity,
        appearances: [Appearance {
            blur_px: 1.0,
            width_scale: 1.0,
        }; 2],
        diameter_mm: rig.whisker.diameter_mm,
        root_aside_mm: found.root_mm[0].hypot(found.root_mm[1]),
        warnings: Vec::new(),
    })
}

/// Factor on the stated sd from the residuals' weighted scatter and the correlation of neighbours.
fn consistent_noise(system: &PairSystem, noise: f64, observations: &[LineObservation]) -> f64 {
    let (mut sum, mut weight) = (0.0f64, 0.0f64);
    let (mut lag, mut here) = (0.0, 0.0);
    for k in 0..observations.len() {
        let w = system.weights[k];
        let z = system.residuals_px[k] / observations[k].sd_px;
        if !z.is_finite() {
            continue;
        }
        sum += w * z * z;
        weight += 1.0;
        if k + 1 < observations.len() && observations[k + 1].camera == observations[k].camera {
            let z2 = system.residuals_px[k + 1] / observations[k + 1].sd_px;
            // Student weights of both: one wild piece must not make up a correlation.
            let ww = (w * system.weights[k + 1]).sqrt();
            lag += ww * z * z2;
            here += 0.5 * ww * (z * z + z2 * z2);
        }
    }
    // Some 40 parameters of curve and levels are estimated from the same pieces.
    let scatter = (sum / (weight - 40.0).max(1.0)).max(0.25);
    let rho: f64 = if here > 0.0 {
        (lag / here).clamp(0.0, 0.8)
    } else {
        0.0
    };
    // Effective number of independent pieces of a first-order process.
    let shared = (1.0 + rho) / (1.0 - rho);
    // Damped, so that noise and smoothing settle together.
    0.5 * noise + 0.5 * (scatter * shared).sqrt()
}

/// The first stretch that one picture shows and the other does not: the other camera, start and
/// end, mm.
fn unseen_stretch(fit: &PairFit) -> Option<(usize, f64, f64)> {
    let cells = fit.length_mm as usize;
    let long = ((STRETCH_SHARE * fit.length_mm) as usize).max(1);
    let shown = |camera: usize| {
        let mut shows = vec![0.0; cells];
        for (_, piece) in fit.seen().filter(|s| s.0 == camera) {
            if let Some(cell) = shows.get_mut(piece.station.arc_mm as usize) {
                *cell = 1.0;
            }
        }
        shows
            .windows(long)
            .map(|w| w.iter().sum::<f64>() / long as f64)
            .collect::<Vec<f64>>()
    };
    let both = [shown(0), shown(1)];
    (0..2).find_map(|camera| {
        let lost = |k: &usize| {
            both[camera][*k] < STRETCH_SEEN && both[1 - camera][*k] > 2.0 * STRETCH_SEEN
        };
        let from = (0..both[0].len()).find(lost)?;
        let windows = (from..both[0].len()).take_while(lost).count();
        Some((camera, from as f64, (from + windows + long - 1) as f64))
    })
}

/// Seen pieces a mm in the last third of a length (mm) against those before it, in the picture that
/// shows more.
fn tail_share(fit: &PairFit, length_mm: f64) -> f64 {
    let from_mm = length_mm * 2.0 / 3.0;
    let seen = |tail: bool| {
        let of = |camera| {
            let there =
                |s: &(usize, &Piece)| s.0 == camera && (s.1.station.arc_mm > from_mm) == tail;
            fit.seen().filter(there).count()
        };
        of(0).max(of(1)) as f64
    };
    // The rest is twice as long as the last third: 1 where both show pieces alike.
    2.0 * seen(true) / seen(false).max(1.0)
}
