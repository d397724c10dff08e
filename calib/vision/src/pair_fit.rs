//! One pair from pictures to a fitted curve, with a base pose that is taken as known here and corrected over the folder.

use crate::document::StereoCameras;
use crate::look::fit_look;
use crate::picture::Picture;
use crate::ridge::{Evidence, RidgeMap};
use crate::rig::{Rig, RigWhisker};
use crate::rod::{RodModel, RodState};
use crate::shape_fit::{
    PairSystem, Prior, Sight, choose_smoothing, image_line, linearise, measure, sights, stepped, visible,
    with_prior,
};
use crate::tip::find_tip;
use crate::trace::{BEAM, Scene, Trace, expected_strength, trace};
use crate::wire::{Look, Piece};
use nalgebra::{Isometry3, Matrix6};

/// A fitted pair.
#[derive(Debug, Clone)]
pub struct PairFit {
    /// Curve model.
    pub model: RodModel,
    /// Curve.
    pub state: RodState,
    /// Base pose used.
    pub left_from_base: Isometry3<f64>,
    /// What tags say about a correction of that pose.
    pub base_information: Matrix6<f64>,
    /// Measured places that count.
    pub sights: Vec<Sight>,
    /// All pieces measured and whether they show the wire, left and right.
    pub pieces: [(Vec<Piece>, Vec<bool>); 2],
    /// Length and its sd, mm.
    pub length_mm: f64,
    /// Sd of the length, mm.
    pub length_sd_mm: f64,
    /// The part of the length's error that all pairs share, mm: the end's form.
    pub length_shared_mm: f64,
    /// Linearised sights at the solution.
    pub system: PairSystem,
    /// Factor on the sights' sd that makes their scatter consistent.
    pub noise: f64,
    /// Smoothing chosen.
    pub smoothing: f64,
    /// +1 dark wire.
    pub polarity: f64,
    /// How the wire looks, left and right.
    pub looks: [Look; 2],
    /// Remarks.
    pub warnings: Vec<String>,
}

/// How far the curve model goes beyond the nominal length.
const REACH: f64 = 1.12;
/// Distance of the curvature splines' knots, mm.
const KNOT_MM: f64 = 2.5;
/// Evidence per millimetre and picture below which there is no wire: a tenth of what a place can score at most, thrice a mm.
const LEAST_EVIDENCE: f64 = 1.2;
/// A second line from the root with this share of the first one's length and of its evidence a millimetre is a wire as well: where it
/// is covered up by the first one it has none.
const RIVAL_LENGTH_SHARE: f64 = 0.6;
const RIVAL_SHARE: f64 = 0.35;
/// Share of the evidence a millimetre that makes a line worth a second look.
const SUSPECT_SHARE: f64 = 0.2;
/// Curves kept in the search for it: it need only be found, not followed well.
const RIVAL_BEAM: usize = 80;
/// Distance from the first wire, in its widths, within which nothing counts.
const COVERED_WIDTHS: f64 = 3.0;
/// Share of the nominal length at which a line is the whole wire.
const LONG_SHARE: f64 = 0.9;
/// Evidence that both pictures together can give, a millimetre: two pictures, three places, at most 4 each.
const MOST_EVIDENCE: f64 = 24.0;

/// Finds and fits the wire of one pair; `start` takes up an earlier fit of the same pictures where it ended.
///
/// # Errors
/// A sentence that says why the pair cannot be used.
pub fn fit_pair(
    stereo: &StereoCameras,
    rig: &Rig,
    pictures: &[Picture; 2],
    left_from_base: &Isometry3<f64>,
    prior: &Prior,
    start: Option<&PairFit>,
) -> Result<PairFit, String> {
    let begun = match start {
        Some(fit) => fit.clone(),
        None => begin(stereo, rig, pictures, left_from_base, prior)?,
    };
    let PairFit { model, mut state, mut looks, polarity, mut noise, .. } = begun;
    let (mut length, mut length_sd, mut length_shared) = (begun.length_mm, begun.length_sd_mm, 0.0);
    let mut prior = Prior { smoothing: begun.smoothing, ..prior.clone() };
    let mut pieces: [(Vec<Piece>, Vec<bool>); 2] = Default::default();
    let mut all: Vec<Sight> = Vec::new();
    let mut warnings = Vec::new();
    // The window narrows as the curve settles; the look is fitted once the line is roughly right.
    let windows = [4.0, 2.5, 1.5, 1.2, 1.0];
    let first = if start.is_some() { 3 } else { 0 };
    for (round, search_px) in windows.into_iter().enumerate().skip(first) {
        let shape = model.shape(&state);
        all.clear();
        for camera in 0..2 {
            let line = image_line(
                stereo,
                left_from_base,
                camera,
                &shape.points,
                model.step_mm,
                length,
                rig.whisker.diameter_mm,
            );
            let mut measured = measure(&pictures[camera], &line, looks[camera], search_px);
            if round == 1 || round == 3 {
                looks[camera] = fit_look(&pictures[camera], &measured, looks[camera]);
                measured = measure(&pictures[camera], &line, looks[camera], search_px);
            }
            let seen = visible(&measured, polarity);
            all.extend(sights(camera, &measured, &seen));
            pieces[camera] = (measured, seen);
        }
        if all.len() < 40 {
            return Err(format!("no wire: only {} pieces of 4 px show a bar", all.len()));
        }
        // Gauss-Newton on the pieces as measured; the smoothing is chosen once the curve is close.
        for inner in 0..4 {
            let system = linearise(stereo, left_from_base, &model, &state, &all, noise);
            if inner == 1 {
                prior.smoothing = choose_smoothing(&system, &prior, &state, &model);
            }
            let (mut h, g) = with_prior(&system, &prior, &state, &model);
            // The base is held here; the folder's joint step moves it.
            for k in 0..6 {
                h[(k, k)] += 1e15;
            }
            let step = h.cholesky().ok_or("the curve's normal matrix is singular")?.solve(&g);
            state = stepped(left_from_base, &state, &step).1;
            if inner == 3 {
                noise = consistent_noise(&system, noise, &all);
            }
        }
        if round >= 1 {
            let shape = model.shape(&state);
            let ends: Vec<_> = (0..2)
                .filter_map(|camera| {
                    let line = image_line(
                        stereo,
                        left_from_base,
                        camera,
                        &shape.points,
                        model.step_mm,
                        f64::INFINITY,
                        rig.whisker.diameter_mm,
                    );
                    find_tip(&pictures[camera], &line.stations, looks[camera], length)
                })
                .collect();
            if ends.is_empty() {
                // Without a visible end: the last piece seen, or the nominal length where that lies near.
                let last = all.iter().fold(0.0f64, |m, s| m.max(s.arc_mm));
                length =
                    if (last - rig.whisker.length_mm).abs() < 2.0 { rig.whisker.length_mm } else { last };
                (length_sd, length_shared) = (1.0, 0.0);
                if round == 4 {
                    warnings.push("the wire's end is not seen in either picture; its length is nominal or that of the last piece seen".into());
                }
            } else {
                let w: f64 = ends.iter().map(|e| e.sd_mm.powi(-2)).sum();
                length = ends.iter().map(|e| e.arc_mm * e.sd_mm.powi(-2)).sum::<f64>() / w;
                length_sd = w.powf(-0.5);
                length_shared = ends.iter().map(|e| e.shared_mm * e.sd_mm.powi(-2)).sum::<f64>() / w;
            }
        }
    }
    let expected = rig.whisker.length_mm;
    if (length - expected).abs() > 0.02 * expected {
        warnings.push(format!("length {length:.2} mm, nominal {expected:.2} mm"));
    }
    let system = linearise(stereo, left_from_base, &model, &state, &all, noise);
    Ok(PairFit {
        model,
        state,
        left_from_base: *left_from_base,
        base_information: prior.base,
        sights: all,
        pieces,
        length_mm: length,
        length_sd_mm: length_sd,
        length_shared_mm: length_shared,
        system,
        noise,
        smoothing: prior.smoothing,
        polarity,
        looks,
        warnings,
    })
}

/// The curve that the search found, before anything is measured.
fn begin(
    stereo: &StereoCameras,
    rig: &Rig,
    pictures: &[Picture; 2],
    left_from_base: &Isometry3<f64>,
    prior: &Prior,
) -> Result<PairFit, String> {
    let (found, polarity) = find_wire(stereo, rig, pictures, left_from_base)?;
    let model = RodModel::new(&rig.whisker, REACH * rig.whisker.length_mm, KNOT_MM, true);
    let per_node: Vec<[f64; 2]> = (0..model.nodes)
        .map(|i| {
            let k = ((i as f64 * model.step_mm) as usize).min(found.curvatures.len() - 1);
            found.curvatures[k]
        })
        .collect();
    let state = model.from_curvatures(&per_node);
    let system = linearise(stereo, left_from_base, &model, &state, &[], 1.0);
    Ok(PairFit {
        model,
        state,
        left_from_base: *left_from_base,
        base_information: prior.base,
        sights: Vec::new(),
        pieces: Default::default(),
        length_mm: found.length_mm.max(0.5 * rig.whisker.length_mm),
        length_sd_mm: 0.5,
        length_shared_mm: 0.0,
        system,
        noise: 1.0,
        smoothing: prior.smoothing,
        polarity,
        looks: [Look { blur_px: 1.0, width_scale: 1.0 }; 2],
        warnings: Vec::new(),
    })
}

/// Searches for a dark and for a bright wire; the likelier one.
fn find_wire(
    stereo: &StereoCameras,
    rig: &Rig,
    pictures: &[Picture; 2],
    left_from_base: &Isometry3<f64>,
) -> Result<(Trace, f64), String> {
    let depth = left_from_base.translation.z;
    let width = rig.whisker.diameter_mm * stereo.cameras[0].focal_px[0] / depth;
    // A bar answers most at a scale of its width over 2 sqrt 3 (Steger 1998, eq. 11); below 1.2 px noise would rule.
    let scale = (width / 12f64.sqrt()).max(1.2);
    let maps = [RidgeMap::new(&pictures[0], scale), RidgeMap::new(&pictures[1], scale)];
    let background = [maps[0].background(60_000), maps[1].background(60_000)];
    let mut best: Option<(Trace, f64, [f64; 2])> = None;
    for polarity in [1.0, -1.0] {
        // Nothing beats a line that has half of all the evidence there could be along most of the nominal length.
        if best.as_ref().is_some_and(|(b, ..)| b.score > 0.5 * MOST_EVIDENCE * 0.8 * rig.whisker.length_mm) {
            break;
        }
        let mut strength = expected_strength(stereo, left_from_base, &maps, &rig.whisker, polarity);
        let mut last = None;
        // The second search knows how strong the wire of the first one answers.
        for _ in 0..2 {
            let evidence = [0, 1].map(|k| Evidence::new(&background[k], strength[k], polarity));
            let scene = Scene::new(stereo, left_from_base, &maps, evidence);
            last = search(&scene, &rig.whisker);
            let Some(found) = &last else { break };
            let settled = (0..2).all(|k| (found.strength[k] / strength[k] - 1.0).abs() < 0.2);
            for (s, f) in strength.iter_mut().zip(found.strength) {
                if f.is_finite() {
                    *s = f;
                }
            }
            if settled {
                break;
            }
        }
        if let Some(found) = last
            && best.as_ref().is_none_or(|b| found.score > b.0.score)
        {
            best = Some((found, polarity, strength));
        }
    }
    let (found, polarity, strength) = best.ok_or("no wire: nothing like a line leaves the root")?;
    if found.score < 2.0 * LEAST_EVIDENCE * found.length_mm || found.length_mm < 0.3 * rig.whisker.length_mm {
        return Err(format!(
            "no wire: the best line from the root is {:.0} mm long with a log likelihood ratio of {:.0}",
            found.length_mm, found.score
        ));
    }
    let evidence = [0, 1].map(|k| Evidence::new(&background[k], strength[k], polarity));
    let scene =
        Scene::new(stereo, left_from_base, &maps, evidence).without(&found.path, COVERED_WIDTHS * width);
    let density = |t: &Trace| t.score / t.length_mm;
    // A narrow beam first: hardly anything passes it where there is one wire.
    let suspect = trace(&scene, &rig.whisker, RIVAL_BEAM)
        .is_some_and(|t| density(&t) > SUSPECT_SHARE * density(&found));
    if suspect
        && let Some(rival) = trace(&scene, &rig.whisker, 4 * BEAM)
        && density(&rival) > RIVAL_SHARE * density(&found)
        && rival.length_mm > RIVAL_LENGTH_SHARE * found.length_mm
    {
        return Err(format!(
            "two wires leave the root: {:.0} mm and {:.0} mm long, log likelihood ratios {:.0} and {:.0}",
            found.length_mm, rival.length_mm, found.score, rival.score
        ));
    }
    Ok((found, polarity))
}

/// A groove's edges can crowd the wire out of the beam: where what is found is too short, wider beams look again.
fn search(scene: &Scene<'_>, whisker: &RigWhisker) -> Option<Trace> {
    let mut best: Option<Trace> = None;
    for beam in [BEAM, 4 * BEAM, 16 * BEAM] {
        let found = trace(scene, whisker, beam);
        if let Some(found) = found
            && best.as_ref().is_none_or(|b| found.score > b.score)
        {
            best = Some(found);
        }
        if best.as_ref().is_some_and(|b| b.length_mm >= LONG_SHARE * whisker.length_mm) {
            break;
        }
    }
    best
}

/// Factor on the stated sd from the residuals' scatter (weighted) and from how far neighbours share their errors.
fn consistent_noise(system: &PairSystem, noise: f64, sights: &[Sight]) -> f64 {
    let (mut sum, mut weight) = (0.0f64, 0.0f64);
    let (mut lag, mut here) = (0.0, 0.0);
    for k in 0..sights.len() {
        let w = system.weights[k];
        let z = system.residuals_px[k] / sights[k].sd_px;
        if !z.is_finite() {
            continue;
        }
        sum += w * z * z;
        weight += 1.0;
        if k + 1 < sights.len() && sights[k + 1].camera == sights[k].camera {
            let z2 = system.residuals_px[k + 1] / sights[k + 1].sd_px;
            let ww = (w * system.weights[k + 1]).sqrt();
            lag += ww * z * z2;
            here += 0.5 * ww * (z * z + z2 * z2);
        }
    }
    let scatter = (sum / (weight - 40.0).max(1.0)).max(0.25);
    let rho: f64 = if here > 0.0 { (lag / here).clamp(0.0, 0.8) } else { 0.0 };
    // Effective number of independent pieces of a first-order process.
    let shared = (1.0 + rho) / (1.0 - rho);
    // Damped, so that noise and smoothing settle together.
    0.5 * noise + 0.5 * (scatter * shared).sqrt()
}
