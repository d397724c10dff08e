//! The tracker on the groove under noise as instruments make it (SIMULATED): for each kind of noise
//! of the plant, sessions without an effect, `verify`'s own fit, and the held-out trajectories
//! tracked along the stage's way; how far from the groove, compared with the Cramer-Rao bound.
//!
//! `cargo run --release --example groove_noise -- [--draws N] [--seed S] [--noise KIND] [--design paper|rich|repeats|...] [--each]`
//!
//! A trajectory counts once: its readings share one error. Error and bound are RMS over
//! trajectories; "held" are the 95 % regions, with the Clopper-Pearson interval of their share.
//! "doubted" are trajectories on which moments and motion disagree (`motion-disagrees`). `--each`
//! prints every trajectory.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "an example talks to its user"
)]

use anyhow::{Context, Result, bail};
use wcal_calibration::WhiskerCalibration;
use wcal_core::SessionData;
use wcal_core::verify_document::Verdict;
use wcal_exam::clopper_pearson;
use wcal_plant::session::draw_under;
use wcal_plant::{CaseKind, Design, Make, Noise, Request};
use wcal_track::groove_comparison::Compared;
use wcal_track::session_groove::compared;
use wcal_verify::verify::VerifyRequest;
use wcal_verify::whisker::{Verified, WhiskerVerification, verify_whisker};

struct Options {
    draws: u64,
    seed: u64,
    noise: Option<String>,
    designs: Vec<Design>,
    each: bool,
}

fn options() -> Result<Options> {
    let mut o = Options {
        draws: 4,
        seed: 1,
        noise: None,
        designs: vec![Design::Paper, Design::Rich],
        each: false,
    };
    let mut words = std::env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || {
            words
                .next()
                .with_context(|| format!("{word}: expected a value, found the end"))
        };
        match word.as_str() {
            "--draws" => o.draws = value()?.parse().context("--draws: expected a number")?,
            "--seed" => o.seed = value()?.parse().context("--seed: expected a number")?,
            "--noise" => o.noise = Some(value()?),
            "--design" => o.designs = vec![design(&value()?)?],
            "--each" => o.each = true,
            other => bail!("unknown option {other}; see the head of examples/groove_noise.rs"),
        }
    }
    Ok(o)
}

fn design(name: &str) -> Result<Design> {
    let all = [
        Design::Paper,
        Design::Rich,
        Design::Repeats,
        Design::Shuffled,
        Design::Staircase,
    ];
    let found = all
        .into_iter()
        .find(|d| format!("{d:?}").to_lowercase() == name);
    found.with_context(|| {
        format!("--design: expected paper, rich, repeats, shuffled or staircase, found {name}")
    })
}

/// What is counted of one kind of noise.
#[derive(Default)]
struct Row {
    sessions: usize,
    /// Sessions whose verdict gives a calibration.
    calibrated: usize,
    compared: Vec<Compared>,
}

fn main() -> Result<()> {
    let o = options()?;
    println!(
        "SIMULATED; {} sessions of each kind and design, seed {}; error and bound: RMS over trajectories, mm",
        o.draws, o.seed
    );
    println!(
        "{:10} {:10} {:>10} {:>12} {:>7} {:>7} {:>13} {:>7} {:>9} {:>16} {:>8}",
        "noise",
        "design",
        "calibrated",
        "trajectories",
        "error",
        "bound",
        "error / bound",
        "median",
        "held",
        "95 %",
        "doubted"
    );
    for design in &o.designs {
        for noise in Noise::ALL
            .into_iter()
            .filter(|n| o.noise.as_deref().is_none_or(|name| name == n.name()))
        {
            let mut row = Row::default();
            for draw in 0..o.draws {
                let seed = o.seed.wrapping_mul(1_000_003).wrapping_add(draw);
                row.add(seed, *design, noise, o.each)?;
            }
            row.print(noise, *design);
        }
    }
    Ok(())
}

/// A session without an effect through `verify`'s loop; none where the session is refused.
fn verified(seed: u64, design: Design, noise: Noise) -> Result<Option<WhiskerVerification>> {
    let request = Request {
        seed,
        design,
        want: CaseKind::Null,
        target_sigma: 20.0,
        rivals: false,
    };
    let folder = tempfile::tempdir()?;
    draw_under(&request, noise, Make::Usual)?.write(folder.path())?;
    let session = wcal_session::load(folder.path())?;
    let SessionData::Whisker(data) = &session.data else {
        bail!("the plant drew another kind of session")
    };
    let (request, sealed) = (VerifyRequest::default(), session.sealed.whisker());
    let done = verify_whisker(&session.id, data, sealed, &session.inputs, &[], &request)?;
    Ok(match done {
        Verified::Done(done) => Some(*done),
        Verified::Refused(_) => None,
    })
}

impl Row {
    fn add(&mut self, seed: u64, design: Design, noise: Noise, each: bool) -> Result<()> {
        self.sessions += 1;
        let Some(done) = verified(seed, design, noise)? else {
            return Ok(());
        };
        // As `wcal verify` has it: other verdicts give no calibration.
        if !matches!(done.document.verdict, Verdict::Adequate | Verdict::Effect) {
            return Ok(());
        }
        let whole = &done.assessment.whole;
        let Some(motion) = done.decision.calibration().groove_motion(whole) else {
            return Ok(());
        };
        self.calibrated += 1;
        let sealed = &whole.sealed;
        let mut found = compared(whole, motion, |i| sealed[i], |i| whole.row(i).groove_mm)?;
        // Its readings have one error.
        found.dedup_by_key(|c| c.trajectory);
        if each {
            let part = done.decision.calibration().correlated_noise;
            let part = part.map_or_else(
                || "no correlated part".to_owned(),
                |c| {
                    format!(
                        "{:.2} pm correlated over {:.0} s",
                        c.sd_pm, c.time_constant_s
                    )
                },
            );
            println!(
                "  {} {seed} {design:?}: noise {:.2} pm, {part}",
                noise.name(),
                done.decision.calibration().noise_sd_pm
            );
        }
        for c in found.iter().filter(|_| each) {
            println!(
                "  {} {seed} {design:?} trajectory {}: {:.1} mm, {:.3}/{:.3} mm{}{}",
                noise.name(),
                c.trajectory,
                c.arclength_mm,
                c.error_mm,
                c.bound_mm,
                if c.held { "" } else { " outside" },
                if c.doubted { " doubted" } else { "" }
            );
        }
        self.compared.extend(found);
        Ok(())
    }

    fn print(&self, noise: Noise, design: Design) {
        let n = self.compared.len();
        let rms = |of: fn(&Compared) -> f64| {
            (self.compared.iter().map(|c| of(c).powi(2)).sum::<f64>() / n as f64).sqrt()
        };
        let [error, bound] = [rms(|c| c.error_mm), rms(|c| c.bound_mm)];
        let mut ratios: Vec<f64> = self
            .compared
            .iter()
            .map(|c| c.error_mm / c.bound_mm)
            .collect();
        ratios.sort_by(f64::total_cmp);
        let median = ratios.get(n / 2).copied().unwrap_or(f64::NAN);
        let number = |v: f64| {
            if v.is_finite() {
                format!("{v:.2}")
            } else {
                "-".to_owned()
            }
        };
        let held = self.compared.iter().filter(|c| c.held).count();
        let (low, high) = clopper_pearson(held, n);
        println!(
            "{:10} {:10} {:>10} {n:>12} {:>7} {:>7} {:>13} {:>7} {:>9} {:>16} {:>8}",
            noise.name(),
            format!("{design:?}").to_lowercase(),
            format!("{}/{}", self.calibrated, self.sessions),
            number(error),
            number(bound),
            number(error / bound),
            number(median),
            format!("{held}/{n}"),
            format!("[{low:.3}, {high:.3}]"),
            self.compared.iter().filter(|c| c.doubted).count(),
        );
    }
}
