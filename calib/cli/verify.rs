//! `wcal verify`: the residual loop on a session.

use crate::artefact::{CalibrationModel, provenance, read_calibration, seal};
use crate::report_input::{of_document, of_whisker};
use anyhow::{Context, bail};
use clap::Args;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::verify_document::{Verdict, VerifyDocument};
use wcal_core::{InputFile, SessionData, VerificationStatus};
use wcal_report::ReportInput;
use wcal_session::{LoadedSession, attach_holdout, load, write_atomic};
use wcal_trace::engine::search::Options;
use wcal_trace::verify::whisker::PredictionRow;
use wcal_trace::verify::{VerifyOptions, verify_whisker};

/// Arguments of `wcal verify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal verify fixtures/whiskerfbg --out out
  wcal verify session --holdout later-session --json

Exit code 0: adequate; 1: refused, or an error; 4: every other verdict, also when the effect was found and added.")]
pub struct VerifyArgs {
    /// Session folder
    pub session: PathBuf,
    /// Sealed readings kept apart from the session: another session, or a table
    #[arg(long, value_name = "SESSION-or-CSV")]
    pub holdout: Option<PathBuf>,
    /// A calibration to judge: refused where the holdout was in its fit
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// Folder for verify.json, predictions.csv, report.html and calibration.json
    #[arg(long, value_name = "DIR", default_value = "verify-out")]
    pub out: PathBuf,
    /// Print verify.json on stdout
    #[arg(long)]
    pub json: bool,
    /// Seed of every random draw
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Runs the command.
///
/// # Errors
/// A session that cannot be read, a model that cannot be built, or a file that cannot be written.
pub fn run(args: &VerifyArgs) -> anyhow::Result<ExitCode> {
    let mut session = load(&args.session)?;
    if let Some(holdout) = &args.holdout {
        attach_holdout(&mut session, holdout)?;
    }
    for warning in &session.warnings {
        eprintln!("warning: {warning}");
    }
    if let Some(path) = &args.calibration {
        refuse_seen_holdout(path, &session)?;
    }
    let done = verify_session(&session, &args.out, args.seed)?;
    if args.json {
        println!("{}", serde_json::to_string_pretty(&done.verify)?);
    } else {
        print_text(&done.verify, &args.out);
    }
    Ok(exit_code(done.verify.verdict))
}

/// Exit code of a verdict.
pub fn exit_code(verdict: Verdict) -> ExitCode {
    ExitCode::from(match verdict {
        Verdict::Adequate => 0,
        Verdict::Refused => 1,
        _ => 4,
    })
}

/// Runs the loop and writes every result; shared with `demo`.
pub fn verify_session(session: &LoadedSession, out: &Path, seed: u64) -> anyhow::Result<ReportInput> {
    let options = VerifyOptions { search: Options { seed, ..Options::default() } };
    std::fs::create_dir_all(out).with_context(|| format!("creating {}", out.display()))?;
    let mut inputs = session.inputs.clone();
    let seen = note_unsealing(session, out)?;
    let provenance = provenance(&session.inputs, seed);
    let mut report = match &session.data {
        SessionData::Whisker(data) => match verify_whisker(&session.id, data, &inputs, &options)? {
            Err(document) => of_document(session, document, provenance.clone()),
            Ok(mut done) => {
                add_notes(&mut done.document, session, seen);
                write_atomic(&out.join("predictions.csv"), predictions_csv(&done.predictions)?.as_bytes())?;
                let status = match done.document.verdict {
                    Verdict::Adequate | Verdict::Effect | Verdict::TwinFault => VerificationStatus::Verified,
                    _ => VerificationStatus::Failed,
                };
                if status == VerificationStatus::Verified {
                    let file = seal(
                        &session.id,
                        status,
                        CalibrationModel::Physical(done.model.clone()),
                        provenance.clone(),
                    )?;
                    write_atomic(&out.join("calibration.json"), &serde_json::to_vec_pretty(&file)?)?;
                }
                of_whisker(session, data, &done, provenance.clone())
            }
        },
        other => bail!("verify: sessions of kind {:?} are not handled yet", other.kind()),
    };
    report.verify.inputs = std::mem::take(&mut inputs);
    write_atomic(&out.join("verify.json"), &serde_json::to_vec_pretty(&report.verify)?)?;
    write_atomic(&out.join("report.html"), wcal_report::render(&report).as_bytes())?;
    Ok(report)
}

fn add_notes(document: &mut VerifyDocument, session: &LoadedSession, seen: bool) {
    document.notes.extend(session.warnings.iter().cloned());
    if seen {
        document.notes.push(
            "This holdout was unsealed before in this output folder: its error is no longer a first look."
                .to_owned(),
        );
    }
}

/// Records by hash that the holdout was opened; says whether it had been opened before.
fn note_unsealing(session: &LoadedSession, out: &Path) -> anyhow::Result<bool> {
    let sealed: Vec<&InputFile> = session.inputs.iter().filter(|i| i.path.contains("holdout")).collect();
    if sealed.is_empty() {
        return Ok(false);
    }
    let path = out.join("unsealed.json");
    let mut known: Vec<String> = match std::fs::read(&path) {
        Ok(bytes) => serde_json::from_slice(&bytes).with_context(|| format!("reading {}", path.display()))?,
        Err(_) => Vec::new(),
    };
    let seen = sealed.iter().any(|i| known.contains(&i.sha256));
    known.extend(sealed.iter().map(|i| i.sha256.clone()));
    known.sort();
    known.dedup();
    write_atomic(&path, &serde_json::to_vec_pretty(&known)?)?;
    Ok(seen)
}

/// A holdout whose file was among the calibration's inputs proves nothing.
fn refuse_seen_holdout(path: &Path, session: &LoadedSession) -> anyhow::Result<()> {
    let file = read_calibration(path)?;
    for sealed in session.inputs.iter().filter(|i| i.path.contains("holdout")) {
        if let Some(same) =
            file.provenance.inputs.iter().find(|i| i.sha256 == sealed.sha256 && !i.path.contains("holdout"))
        {
            bail!(
                "{}: expected a holdout that was not in the fit, found {} among the inputs of {}",
                sealed.path,
                same.path,
                path.display()
            );
        }
    }
    Ok(())
}

fn predictions_csv(rows: &[PredictionRow]) -> anyhow::Result<String> {
    let mut csv = String::from(
        "source,point,role,moment_1_nmm_before,moment_2_nmm_before,moment_1_nmm_after,moment_2_nmm_after,\
         moment_1_sd_nmm,moment_2_sd_nmm,fbg_1_pm_before,fbg_2_pm_before,fbg_1_pm_after,fbg_2_pm_after\n",
    );
    for r in rows {
        let role = serde_json::to_value(r.role)?;
        write!(csv, "{},{},{}", r.source, r.point, role.as_str().unwrap_or_default())?;
        for pair in [r.before.moment_nmm, r.after.moment_nmm, r.after.moment_sd_nmm] {
            write!(csv, ",{:.7},{:.7}", pair[0], pair[1])?;
        }
        for p in [&r.before, &r.after] {
            write!(csv, ",{:.5},{:.5}", p.shift_pm[0] + r.thermal_pm[0], p.shift_pm[1] + r.thermal_pm[1])?;
        }
        csv.push('\n');
    }
    Ok(csv)
}

/// The result as a person reads it.
pub fn print_text(v: &VerifyDocument, out: &Path) {
    let verdict = serde_json::to_value(v.verdict).unwrap_or_default();
    println!("{}: {}", v.session, verdict.as_str().unwrap_or_default());
    println!("  {}", v.reason);
    for f in &v.twin.faults {
        let points: Vec<String> = f.points.iter().map(ToString::to_string).collect();
        println!("  twin fault ({}): points {}: {}", f.kind, points.join(", "), f.detail);
    }
    for e in &v.effects {
        let parameters: Vec<String> = e
            .parameters
            .iter()
            .map(|p| {
                format!(
                    "{} = {:.4} [{:.4}, {:.4}] {}",
                    p.name, p.value, p.interval95[0], p.interval95[1], p.unit
                )
            })
            .collect();
        println!(
            "  {} (p = {:.1e}, class {}): {}",
            e.id,
            e.p_value,
            e.class.join("/"),
            parameters.join(", ")
        );
    }
    if let (Some(b), Some(a)) = (&v.before, &v.after) {
        println!("  held-out error ({}, {} readings):        before      after", a.split, a.points);
        for (name, before) in &b.rmse {
            println!("    {name:<32} {before:>10.4} {:>10.4}", a.rmse.get(name).copied().unwrap_or(f64::NAN));
        }
    }
    if let Some(floor) = v.noise_floor.wavelength_pm {
        println!("  noise floor {floor:.3} pm ({})", v.noise_floor.source);
    }
    if let Some(n) = &v.next_measurement {
        println!("  next: {} (expected power {:.2})", n.instruction, n.expected_power);
    }
    println!("  written to {}", out.display());
}
