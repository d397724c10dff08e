//! Coverage with calibrations that were fitted to plant sessions (SIMULATED, physics that shares no
//! code with rod and fitter).
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use super::*;
use crate::arc_posterior::REGION;
use crate::groove_comparison::{binomial_cdf, coverage_rejected};
use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use wcal_calibration::WhiskerCalibration;
use wcal_core::SessionData;
use wcal_core::verify_document::Verdict;
use wcal_plant::case::{CaseKind, Make, Request};
use wcal_plant::session::draw_under;
use wcal_plant::{Design, Kind, Noise};
use wcal_verify::verify::VerifyRequest;
use wcal_verify::whisker::{PhysicalModel, Verified, WhiskerVerification, verify_whisker};

/// Chance below which too few regions that hold are no accident.
const LEVEL: f64 = 0.01;

/// The loop's result on a drawn session with white noise.
fn verified(seed: u64, design: Design, want: CaseKind) -> WhiskerVerification {
    verified_under(seed, design, want, Noise::Gaussian)
}

/// The same with noise of a kind.
fn verified_under(seed: u64, design: Design, want: CaseKind, noise: Noise) -> WhiskerVerification {
    let request = Request {
        seed,
        design,
        want,
        target_sigma: 20.0,
        rivals: false,
    };
    let case = draw_under(&request, noise, Make::Usual).unwrap();
    let folder = tempfile::tempdir().unwrap();
    case.write(folder.path()).unwrap();
    let session = wcal_session::load(folder.path()).unwrap();
    let SessionData::Whisker(data) = &session.data else {
        unreachable!("the plant draws whiskers")
    };
    let (request, sealed) = (VerifyRequest::default(), session.sealed.whisker());
    match verify_whisker(&session.id, data, sealed, &session.inputs, &[], &request).unwrap() {
        Verified::Done(done) => *done,
        Verified::Refused(document) => unreachable!("{}", document.reason),
    }
}

/// Held-out trajectories through a calibration, one comparison each: their readings have one error.
/// `change` is done to the motion before.
fn tracked(
    done: &WhiskerVerification,
    model: &PhysicalModel,
    change: impl Fn(&mut GrooveMotion),
) -> Vec<Compared> {
    let whole = &done.assessment.whole;
    let mut motion = model.groove_motion(whole).unwrap();
    change(&mut motion);
    let sealed = &whole.sealed;
    let mut compared = compared(whole, motion, |i| sealed[i], |i| whole.row(i).groove_mm).unwrap();
    compared.dedup_by_key(|c| c.trajectory);
    compared
}

/// What all readings of a calibration share, left out.
fn exact(motion: &mut GrooveMotion) {
    motion.changed.clear();
    for r in &mut motion.readings {
        r.shared_nmm.clear();
        r.shared_displacement_mm.clear();
    }
}

/// The calibration as one of `times` its uncertainty: its coefficients are a draw from it.
fn less_certain(model: &PhysicalModel, times: f64, seed: u64) -> PhysicalModel {
    let mut model = model.clone();
    let size = model.covariance.len();
    model
        .covariance
        .iter_mut()
        .flatten()
        .for_each(|v| *v *= times * times);
    // By the Cholesky factor, which moves with the covariance; the signs of eigenvectors jump with
    // its last digits.
    let root = DMatrix::from_fn(size, size, |i, j| model.covariance[i][j])
        .cholesky()
        .unwrap()
        .unpack();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let draw = DVector::from_fn(size, |_, _| -> f64 { StandardNormal.sample(&mut rng) });
    let off = root * draw;
    let count = model.coefficients.len();
    for (k, row) in model.coefficients.iter_mut().enumerate() {
        (0..2).for_each(|c| row[c] += off[c * count + k]);
    }
    model
}

fn held(compared: &[Compared]) -> usize {
    compared.iter().filter(|c| c.held).count()
}

fn said(compared: &[Compared]) -> String {
    let each = compared.iter().map(|c| {
        let held = if c.held { "" } else { "!" };
        format!(
            "{:.0} mm: {:.2}/{:.2}{held}",
            c.arclength_mm, c.error_mm, c.bound_mm
        )
    });
    let each: Vec<String> = each.collect();
    format!(
        "{} of {}: {}",
        held(compared),
        compared.len(),
        each.join(", ")
    )
}

#[test]
fn regions_hold_and_errors_are_at_the_bound_with_fitted_calibrations() {
    let mut all = Vec::new();
    for seed in 0..8 {
        let done = verified(seed, Design::Paper, CaseKind::Null);
        assert_eq!(done.document.verdict, Verdict::Adequate, "{seed}");
        all.extend(tracked(&done, done.decision.calibration(), |_| ()));
    }
    assert!(
        all.len() >= 40 && binomial_cdf(held(&all), all.len(), REGION) > LEVEL,
        "{}",
        said(&all)
    );
    // The median, since the bound is one for small errors and a shallow press has a few large ones.
    let mut ratios: Vec<f64> = all.iter().map(|c| c.error_mm / c.bound_mm).collect();
    ratios.sort_by(f64::total_cmp);
    let median = ratios[ratios.len() / 2];
    assert!((0.3..1.3).contains(&median), "{median}: {}", said(&all));
    assert!(all.iter().all(|c| !c.doubted), "{}", said(&all));
}

#[test]
fn regions_hold_with_an_effect_that_the_loop_repaired() {
    let done = verified(300, Design::Rich, CaseKind::Effects(vec![Kind::FbgThree]));
    assert_eq!(done.document.verdict, Verdict::Effect);
    let found = tracked(&done, done.decision.calibration(), |_| ());
    assert!(
        binomial_cdf(held(&found), found.len(), REGION) > LEVEL,
        "{}",
        said(&found)
    );
}

/// With the map's error as large as the noise it is seen whether the regions know of it; control:
/// without it they hold too little.
#[test]
fn the_error_of_the_map_is_in_the_regions() {
    const TIMES: f64 = 5.0;
    let (mut with, mut without) = (Vec::new(), Vec::new());
    for seed in 20..22 {
        let done = verified(seed, Design::Paper, CaseKind::Null);
        for draw in 0..4 {
            let model = less_certain(done.decision.calibration(), TIMES, draw);
            with.extend(tracked(&done, &model, |_| ()));
            without.extend(tracked(&done, &model, exact));
        }
    }
    assert!(
        binomial_cdf(held(&with), with.len(), REGION) > LEVEL,
        "{}",
        said(&with)
    );
    assert!(
        binomial_cdf(held(&without), without.len(), REGION) < 1e-4,
        "{}",
        said(&without)
    );
}

/// Drift that the session shows is in the regions; control: taken for white noise they hold too
/// little. Readings that it displaces together move the state where the regions are narrow.
#[test]
fn noise_that_is_correlated_in_time_is_in_the_regions() {
    let (mut with, mut without, mut sessions) = (Vec::new(), Vec::new(), 0);
    for seed in 1_000_005..1_000_016 {
        let done = verified_under(seed, Design::Paper, CaseKind::Null, Noise::Drift);
        let shown = done.decision.calibration().correlated_noise.is_some();
        if done.document.verdict != Verdict::Adequate || !shown {
            continue;
        }
        sessions += 1;
        let white = PhysicalModel {
            correlated_noise: None,
            ..done.decision.calibration().clone()
        };
        with.extend(tracked(&done, done.decision.calibration(), |_| ()));
        without.extend(tracked(&done, &white, |_| ()));
    }
    assert!(sessions >= 4, "{sessions} sessions show their drift");
    assert!(
        binomial_cdf(held(&with), with.len(), REGION) > LEVEL,
        "{}",
        said(&with)
    );
    assert!(
        binomial_cdf(held(&without), without.len(), REGION) < 1e-3,
        "{}",
        said(&without)
    );
}

#[test]
fn the_groove_is_elsewhere_only_where_regions_and_bound_say_so() {
    let of = |held: usize, rmse_mm: f64| {
        coverage_rejected(&GrooveTracking {
            rmse_mm,
            bound_mm: 0.5,
            coverage95: held as f64 / 9.0,
            points: 27,
            trajectories: 9,
            trajectories_held: held,
            doubted: 0,
            split: "fit".to_owned(),
            uncertainty: Vec::new(),
        })
    };
    assert!(of(6, 5.0), "ten times the bound, and three of nine outside");
    // Each alone is none: regions a little narrow at an error within the bound; a large error that
    // the regions hold.
    assert!(!of(6, 0.4) && !of(9, 5.0));
}
