//! One pair from pictures to a fitted curve, with a base pose that is taken as known here and
//! corrected over the folder.

use crate::picture::Picture;
use crate::rig::Rig;
use crate::shape::curve::{CurveModel, CurveState};
use crate::shape::curve_fit::{
    LineObservation, PairSystem, Prior, choose_smoothing, image_line, linearise, measure,
    observations, stepped, visible, with_prior,
};
use crate::shape::socp_start::socp_initial_curve;
use crate::stereo::StereoCameras;
use crate::wire::appearance::fit_appearance;
use crate::wire::piece::{Appearance, Piece};
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
    /// All pieces measured and whether they show the wire, left and right.
    pub pieces: [(Vec<Piece>, Vec<bool>); 2],
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
fn refine(scene: &Scene<'_>, begun: PairFit, again: bool) -> Result<PairFit, String> {
    let Scene {
        stereo,
        rig,
        left_from_base,
        vertex_mm,
        prior,
        ..
    } = *scene;
    let PairFit {
        mut model,
        mut state,
        mut appearances,
        polarity,
        mut noise,
        ..
    } = begun;
    let (mut length, mut length_sd, mut length_shared) = (begun.length_mm, begun.length_sd_mm, 0.0);
    let mut prior = Prior {
        smoothing: begun.smoothing,
        ..prior.clone()
    };
    // A wire that starts elsewhere is fitted with a free root; whether the base moved as well is
    // decided over the folder.
    if begun.root_aside_mm > 0.0 {
        prior.root_sd = ROOT_FREE;
    }
    let mut pieces: [(Vec<Piece>, Vec<bool>); 2] = Default::default();
    let mut all: Vec<LineObservation> = Vec::new();
    let mut warnings = Vec::new();
    let mut end_seen = false;
    // The window narrows as the curve converges.
    let windows = [4.0, 2.0, 1.2, 1.0, 1.0];
    let mut round = if again { 3 } else { 0 };
    while let Some(&search_px) = windows.get(round) {
        // Blur and width are fitted once the line is approximately right.
        let fit_looks = round == 1 || round == 3;
        pieces = measure_pieces(
            scene,
            &model,
            &state,
            length,
            search_px,
            &mut appearances,
            (polarity, fit_looks),
        );
        all = (0..2)
            .flat_map(|c| observations(c, &pieces[c].0, &pieces[c].1))
            .collect();
        if all.len() < 40 {
            return Err(format!(
                "no wire: only {} pieces of 4 px show a bar",
                all.len()
            ));
        }
        if round == 0 {
            // Far from the solution robust weights and evidence for the smoothing are unreliable:
            // the convex programme needs neither.
            let found = socp_initial_curve(stereo, left_from_base, &model, &state, &all, &prior);
            state = found.ok_or("no curve of the wire's length passes through the pieces")?;
            round += 1;
            continue;
        }
        if let Some(arc_mm) = vertex_mm.and_then(|at| pushed_at(&model, &state, &at)) {
            model = model.with_force_at(arc_mm);
        }
        (state, noise) = gauss_newton(scene, &model, state, &all, noise, &mut prior)?;
        let ends = ends_seen(scene, &model, &state, appearances, length);
        end_seen = !ends.is_empty();
        if ends.is_empty() {
            let last = all.iter().fold(0.0f64, |m, s| m.max(s.arc_mm));
            // Seen up to the end of the searched length, and no wire end there: the wire is longer.
            if last > length - 1.0 && length + GROWTH_MM < REACH * rig.whisker.length_mm {
                length += GROWTH_MM;
                continue;
            }
            // Without a visible end: the last piece seen, or the nominal length where that lies
            // near.
            length = if (last - rig.whisker.length_mm).abs() < 2.0 {
                rig.whisker.length_mm
            } else {
                last
            };
            (length_sd, length_shared) = (1.0, 0.0);
            if round == 4 {
                warnings.push("the wire's end is not seen in either picture; its length is nominal or that of the last piece seen".into());
            }
        } else {
            let w: f64 = ends.iter().map(|e| e.sd_mm.powi(-2)).sum();
            length = ends
                .iter()
                .map(|e| e.arc_mm * e.sd_mm.powi(-2))
                .sum::<f64>()
                / w;
            length_sd = w.powf(-0.5);
            length_shared = ends
                .iter()
                .map(|e| e.shared_mm * e.sd_mm.powi(-2))
                .sum::<f64>()
                / w;
        }
        round += 1;
    }
    warnings.extend(doubts(
        &pieces,
        length,
        end_seen,
        noise,
        rig.whisker.length_mm,
    )?);
    let system = linearise(stereo, left_from_base, &model, &state, &all, noise);
    Ok(PairFit {
        model,
        state,
        left_from_base: *left_from_base,
        base_information: prior.base,
        observations: all,
        pieces,
        length_mm: length,
        length_sd_mm: length_sd,
        length_shared_mm: length_shared,
        system,
        noise,
        smoothing: prior.smoothing,
        polarity,
        appearances,
        diameter_mm: begun.diameter_mm,
        root_aside_mm: begun.root_aside_mm,
        warnings,
    })
}

/// The pieces of the wire in both pictures, and which of them show it; appearances are fitted to
/// them where `fit_looks`.
fn measure_pieces(
    scene: &Scene<'_>,
    model: &CurveModel,
    state: &CurveState,
    length_mm: f64,
    search_px: f64,
    appearances: &mut [Appearance; 2],
    (polarity, fit_looks): (f64, bool),
) -> [(Vec<Piece>, Vec<bool>); 2] {
    let points = model.shape(state).points;
    [0, 1].map(|camera| {
        let line = image_line(
            scene.stereo,
            scene.left_from_base,
            camera,
            &points,
            model.step_mm,
            length_mm,
            scene.rig.whisker.diameter_mm,
        );
        let picture = &scene.pictures[camera];
        let measured = measure(picture, &line, appearances[camera], search_px);
        if fit_looks {
            appearances[camera] = fit_appearance(picture, &measured, appearances[camera]);
        }
        let seen = visible(&measured, polarity);
        (measured, seen)
    })
}

/// Gauss-Newton on the pieces as measured; the smoothing is chosen once the curve is close. The
/// state, and the noise of the pieces.
fn gauss_newton(
    scene: &Scene<'_>,
    model: &CurveModel,
    mut state: CurveState,
    all: &[LineObservation],
    mut noise: f64,
    prior: &mut Prior,
) -> Result<(CurveState, f64), String> {
    for inner in 0..3 {
        let system = linearise(
            scene.stereo,
            scene.left_from_base,
            model,
            &state,
            all,
            noise,
        );
        if inner == 1 {
            prior.smoothing = choose_smoothing(&system, prior, &state, model);
        }
        let (mut h, g) = with_prior(&system, prior, &state, model);
        // The base is held here; the folder's joint step moves it.
        for k in 0..6 {
            h[(k, k)] += 1e15;
        }
        let step = h
            .cholesky()
            .ok_or("the curve's normal matrix is singular")?
            .solve(&g);
        state = stepped(scene.left_from_base, &state, &step).1;
        if inner == 2 {
            noise = consistent_noise(&system, noise, all);
        }
    }
    Ok((state, noise))
}

/// The wire's end where a picture shows it, near the arc length `length`.
fn ends_seen(
    scene: &Scene<'_>,
    model: &CurveModel,
    state: &CurveState,
    appearances: [Appearance; 2],
    length: f64,
) -> Vec<Tip> {
    let (points, diameter_mm) = (model.shape(state).points, scene.rig.whisker.diameter_mm);
    let of = |camera: usize| {
        let (from, step) = (scene.left_from_base, model.step_mm);
        let line = image_line(
            scene.stereo,
            from,
            camera,
            &points,
            step,
            f64::INFINITY,
            diameter_mm,
        );
        find_tip(&scene.pictures[camera], &line, appearances[camera], length)
    };
    (0..2).filter_map(of).collect()
}

/// Why a fitted line is not the wire, or what is doubtful about it; `expected` is the wire's
/// length, mm.
fn doubts(
    pieces: &[(Vec<Piece>, Vec<bool>); 2],
    length: f64,
    end_seen: bool,
    noise: f64,
    expected: f64,
) -> Result<Vec<String>, String> {
    let mut warnings = Vec::new();
    // The wire's length is known: a line that ends far from it is another object.
    if end_seen && (length - expected).abs() > LENGTH_SHARE * expected {
        return Err(format!(
            "the line found ends at {length:.1} mm, the wire is {expected:.1} mm long: lost on something else, or whisker.length_mm in the rig file is wrong"
        ));
    }
    if let Some((camera, from, to)) = unseen_stretch(pieces, length) {
        let side = ["left", "right"][camera];
        return Err(format!(
            "the {side} picture shows hardly anything of the wire from {from:.0} to {to:.0} mm: one view gives no shape (hidden, lost on something else, or no wire there)"
        ));
    }
    let tail = tail_share(pieces, expected);
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
    let model = CurveModel::new(&rig.whisker, REACH * rig.whisker.length_mm, KNOT_MM, true);
    let per_node: Vec<[f64; 2]> = (0..model.nodes)
        .map(|i| {
            let k = ((i as f64 * model.step_mm) as usize).min(found.curvatures.len() - 1);
            found.curvatures[k]
        })
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
            let ww = (w * system.weights[k + 1]).sqrt();
            lag += ww * z * z2;
            here += 0.5 * ww * (z * z + z2 * z2);
        }
    }
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
fn unseen_stretch(
    pieces: &[(Vec<Piece>, Vec<bool>); 2],
    length_mm: f64,
) -> Option<(usize, f64, f64)> {
    let cells = length_mm as usize;
    let long = ((STRETCH_SHARE * length_mm) as usize).max(1);
    let shown = |camera: usize| {
        let mut shows = vec![0.0; cells];
        for (piece, _) in pieces[camera]
            .0
            .iter()
            .zip(&pieces[camera].1)
            .filter(|(_, seen)| **seen)
        {
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
fn tail_share(pieces: &[(Vec<Piece>, Vec<bool>); 2], length_mm: f64) -> f64 {
    let from_mm = length_mm * 2.0 / 3.0;
    let seen = |tail: bool| {
        let of = |(pieces, seen): &(Vec<Piece>, Vec<bool>)| {
            let both = pieces.iter().zip(seen);
            both.filter(|(p, seen)| **seen && (p.station.arc_mm > from_mm) == tail)
                .count()
        };
        pieces.iter().map(of).max().unwrap_or(0) as f64
    };
    2.0 * seen(true) / seen(false).max(1.0)
}
