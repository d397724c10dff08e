//! Coverage with calibrations that were fitted to plant sessions (SIMULATED, physics that shares no code with rod and fitter).
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use super::*;
use wcal_calibration::WhiskerCalibration;
use wcal_core::SessionData;
use wcal_core::verify_document::Verdict;
use wcal_plant::effects::Kind;
use wcal_plant::session::{Make, Request, Want, draw_under};
use wcal_plant::{Design, Noise};
use wcal_trace::verify::VerifyOptions;
use wcal_trace::whisker::{Verified, WhiskerVerification, verify_whisker};

/// The loop's result on a drawn session.
fn verified(seed: u64, design: Design, want: Want, noise: Noise) -> WhiskerVerification {
    let request = Request { seed, design, want, target_sigma: 20.0, rivals: false };
    let case = draw_under(&request, noise, Make::Usual).unwrap();
    let folder = tempfile::tempdir().unwrap();
    case.write(folder.path()).unwrap();
    let session = wcal_session::load(folder.path()).unwrap();
    let SessionData::Whisker(data) = &session.data else { unreachable!("the plant draws whiskers") };
    let options = VerifyOptions { permutations: 99, ..VerifyOptions::default() };
    match verify_whisker(&session.id, data, &session.inputs, &options).unwrap() {
        Verified::Done(done) => *done,
        Verified::Refused(document) => unreachable!("{}", document.reason),
    }
}

/// Its held-out readings, tracked; `change` is done to the motion before.
fn tracked(done: &WhiskerVerification, change: impl Fn(&mut GrooveMotion)) -> Vec<Compared> {
    let whole = &done.whole;
    let mut motion = done.model.groove_motion(whole).unwrap();
    change(&mut motion);
    let [sealed, _] = whole.held_out();
    let found = track(whole, motion, |i| sealed[i]).unwrap();
    found.compared(whole, |i| whole.row(i).groove_mm).unwrap()
}

/// One comparison for each trajectory: its readings have one error.
fn by_trajectory(compared: &[Compared]) -> Vec<Compared> {
    let mut last = None;
    compared.iter().copied().filter(|c| last.replace(c.trajectory) != Some(c.trajectory)).collect()
}

#[test]
#[ignore = "measurement"]
fn measure() {
    let env = |name: &str, default: &str| std::env::var(name).unwrap_or_else(|_| default.to_owned());
    let seeds: Vec<u64> = {
        let s = env("SEEDS", "0..4");
        let (a, b) = s.split_once("..").unwrap();
        (a.parse().unwrap()..b.parse().unwrap()).collect()
    };
    let kind = env("KIND", "null");
    let noise = match env("NOISE", "gaussian").as_str() {
        "gaussian" => Noise::Gaussian,
        "drift" => Noise::Drift,
        "pose" => Noise::Pose,
        "loaded" => Noise::Loaded,
        "t" => Noise::StudentT,
        _ => panic!(),
    };
    let design = match env("DESIGN", "rich").as_str() {
        "rich" => Design::Rich,
        "paper" => Design::Paper,
        _ => panic!(),
    };
    let mut all = Vec::new();
    for seed in seeds {
        let want = if kind == "null" {
            Want::Null
        } else {
            Want::Effects(vec![
                *wcal_plant::effects::ALL.iter().find(|k| format!("{k:?}") == kind).unwrap(),
            ])
        };
        let started = std::time::Instant::now();
        let done = verified(seed, design, want, noise);
        let spent = started.elapsed().as_secs_f64();
        let accepted = matches!(
            done.document.verdict,
            Verdict::Adequate | Verdict::Effect | Verdict::TwinFault
        );
        let found = by_trajectory(&tracked(&done, |_| ()));
        let t = groove_tracking(&found, "holdout").unwrap();
        eprintln!(
            "seed {seed} {:?} {:?} verify {spent:.1} s, {:.1} s noise {:.3}: {:.3} mm bound {:.3} held {}/{} doubted {} | {}",
            done.document.verdict,
            done.document.effects.iter().map(|e| e.id.clone()).collect::<Vec<_>>(),
            started.elapsed().as_secs_f64() - spent,
            done.model.noise_sd_pm,
            t.rmse_mm,
            t.bound_mm,
            found.iter().filter(|c| c.held).count(),
            found.len(),
            t.doubted,
            found.iter().map(|c| format!("{:.0}:{:.2}/{:.2}{}", c.arclength_mm, c.error_mm, c.bound_mm, if c.held { "" } else { "!" })).collect::<Vec<_>>().join(" ")
        );
        if accepted {
            all.extend(found);
        }
    }
    let t = groove_tracking(&all, "holdout").unwrap();
    eprintln!("ALL {kind}: {} trajectories, {:.3} mm, bound {:.3}, ratio {:.2}, coverage {:.3}", all.len(), t.rmse_mm, t.bound_mm, t.rmse_mm / t.bound_mm, t.coverage95);
    let _ = Kind::FrictionCoulomb;
}
