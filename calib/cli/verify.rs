//! `wcal verify`: the residual loop on a session.

use crate::artefact::{CalibrationModel, provenance, read_calibration, seal};
use crate::report_input::{of_document, of_scalar, of_whisker};
use anyhow::{Context, bail};
use clap::Args;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::verify_document::{Verdict, VerifyDocument};
use wcal_core::{InputFile, Provenance, ResidualRecord, SessionData, VerificationStatus, WhiskerData};
use wcal_report::ReportInput;
use wcal_session::{LoadedSession, SessionError, add_session, attach_holdout, load, write_atomic};
use wcal_trace::engine::search::Options;
use wcal_trace::scalar::{ScalarData, ScalarOptions, verify_scalar};
use wcal_trace::verify::listings::PredictionRow;
use wcal_trace::verify::{VerifyOptions, verify_whisker};

/// Arguments of `wcal verify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal verify fixtures/whiskerfbg --out out
  wcal verify fixtures/nist/pontius --out out
  wcal verify session --holdout later-session --json
  wcal verify session --add next-measurement --out out2
  wcal verify session --accept groove-friction,creep

Exit code 0: adequate; 1: refused, or an error; 4: every other verdict, also when the effect was found and added.")]
pub struct VerifyArgs {
    /// Session folder
    pub session: PathBuf,
    /// Sealed readings kept apart from the session: another session, or a table
    #[arg(long, value_name = "SESSION-or-CSV")]
    pub holdout: Option<PathBuf>,
    /// A later session of the same sensor, fitted together with this one (own zero a seating); may be repeated
    #[arg(long, value_name = "SESSION")]
    pub add: Vec<PathBuf>,
    /// Accept this explanation (effects separated by commas) although the data leave others open too
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub accept: Vec<String>,
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
    let mut session = match load(&args.session) {
        Ok(session) => session,
        Err(why) => return Err(refuse_unusable(args, why)),
    };
    for later in &args.add {
        add_session(&mut session, later)?;
    }
    if let Some(holdout) = &args.holdout {
        attach_holdout(&mut session, holdout)?;
    }
    for warning in &session.warnings {
        eprintln!("warning: {warning}");
    }
    if let Some(path) = &args.calibration {
        refuse_seen_holdout(path, &session)?;
    }
    let progress = crate::progress::Progress::new(&format!("verify {}", session.id));
    progress.hear_search();
    let done = verify_session(&session, &args.out, args.seed, &args.accept)?;
    drop(progress);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&done.verify)?);
    } else {
        print_text(&done.verify, &args.out);
    }
    Ok(exit_code(done.verify.verdict))
}

/// Data that cannot be used still get a `verify.json` that says so, beside the error.
fn refuse_unusable(args: &VerifyArgs, why: SessionError) -> anyhow::Error {
    let kind = std::fs::read_to_string(args.session.join("session.toml"))
        .ok()
        .and_then(|text| text.parse::<toml::Table>().ok())
        .and_then(|t| Some(t.get("kind")?.as_str()?.to_owned()));
    if let (Some(kind), SessionError::Content(_)) = (kind, &why) {
        let name = args.session.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        let document = VerifyDocument::refused(name, kind, why.to_string(), args.seed);
        let written = std::fs::create_dir_all(&args.out).map_err(anyhow::Error::from).and_then(|()| {
            Ok(write_atomic(&args.out.join("verify.json"), &serde_json::to_vec_pretty(&document)?)?)
        });
        if let Err(e) = written {
            return anyhow::Error::from(why).context(format!("and verify.json could not be written: {e}"));
        }
    }
    why.into()
}

/// Exit code of a verdict.
pub fn exit_code(verdict: Verdict) -> ExitCode {
    ExitCode::from(match verdict {
        Verdict::Adequate => 0,
        Verdict::Refused => 1,
        _ => 4,
    })
}

/// What the loop gives for a session, whatever its kind.
struct Outcome {
    report: ReportInput,
    /// predictions.csv; none where the data were refused.
    predictions: Option<String>,
    /// What a calibration would hold.
    model: Option<CalibrationModel>,
}

/// Runs the loop and writes every result; shared with `demo`.
pub fn verify_session(
    session: &LoadedSession,
    out: &Path,
    seed: u64,
    accept: &[String],
) -> anyhow::Result<ReportInput> {
    std::fs::create_dir_all(out).with_context(|| format!("creating {}", out.display()))?;
    let seen = note_unsealing(session, out)?;
    let provenance = provenance(&session.inputs, seed);
    let search = Options { seed, ..Options::default() };
    let Outcome { mut report, predictions, model } = match &session.data {
        SessionData::Whisker(data) => {
            let options = VerifyOptions { search, accept: accept.to_vec() };
            of_whisker_session(session, data, &options, provenance.clone())?
        }
        other if !accept.is_empty() => {
            bail!("--accept: expected a session of kind \"whisker\", found {:?}", other.kind())
        }
        SessionData::Transducer(data) => {
            of_scalar_session(session, ScalarData::Transducer(data), search, provenance.clone())?
        }
        SessionData::Axis(data) => {
            of_scalar_session(session, ScalarData::Axis(data), search, provenance.clone())?
        }
    };
    add_notes(&mut report.verify, session, seen);
    report.verify.inputs = session.inputs.clone();
    if let Some(csv) = predictions {
        write_atomic(&out.join("predictions.csv"), csv.as_bytes())?;
    }
    let verified = match report.verify.verdict {
        Verdict::Adequate | Verdict::Effect | Verdict::TwinFault => true,
        Verdict::Ambiguous => !accept.is_empty(),
        _ => false,
    };
    if let Some(model) = model.filter(|_| verified) {
        let whisker = match &session.data {
            SessionData::Whisker(data) => Some(&data.whisker),
            _ => None,
        };
        let file = seal(&session.id, VerificationStatus::Verified, model, provenance, whisker)?;
        write_atomic(&out.join("calibration.json"), &serde_json::to_vec_pretty(&file)?)?;
    }
    write_atomic(&out.join("verify.json"), &serde_json::to_vec_pretty(&report.verify)?)?;
    write_atomic(&out.join("report.html"), wcal_report::render(&report).as_bytes())?;
    Ok(report)
}

fn of_whisker_session(
    session: &LoadedSession,
    data: &WhiskerData,
    options: &VerifyOptions,
    provenance: Provenance,
) -> anyhow::Result<Outcome> {
    Ok(match verify_whisker(&session.id, data, &session.inputs, options)? {
        Err(document) => {
            Outcome { report: of_document(session, document, provenance), predictions: None, model: None }
        }
        Ok(done) => Outcome {
            predictions: Some(predictions_csv(&done.predictions)?),
            model: Some(CalibrationModel::Physical(done.model.clone())),
            report: of_whisker(session, data, &done, provenance),
        },
    })
}

fn of_scalar_session(
    session: &LoadedSession,
    data: ScalarData<'_>,
    search: Options,
    provenance: Provenance,
) -> anyhow::Result<Outcome> {
    let options = ScalarOptions { search, ..ScalarOptions::default() };
    let done = verify_scalar(&session.id, data, &options)?;
    Ok(Outcome {
        predictions: (!done.residuals.is_empty()).then(|| scalar_csv(data, &done.residuals)),
        model: done.model.clone().map(CalibrationModel::Scalar),
        report: of_scalar(session, data, &done, provenance),
    })
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

/// Every reading with what both models say of it, in the session's unit.
fn scalar_csv(data: ScalarData<'_>, records: &[ResidualRecord]) -> String {
    let name = if matches!(data, ScalarData::Axis(_)) { "error_um" } else { "response" };
    let mut csv =
        format!("source,point,role,{name}_measured,{name}_before,{name}_after,{name}_sd,rejected\n");
    for r in records {
        let why = r.rejected.as_deref().unwrap_or_default();
        let values = [r.measured, r.predicted_before, r.predicted_after, r.noise_sd].map(|v| v.to_string());
        csv += &format!("{},{},{},{},{why}\n", r.source, r.point, r.role, values.join(","));
    }
    csv
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
                let [low, high] = p.interval95.map(readable);
                format!("{} = {} [{low}, {high}] {}", p.name, readable(p.value), p.unit)
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
            let after = a.rmse.get(name).copied().unwrap_or(f64::NAN);
            println!("    {name:<32} {:>10} {:>10}", readable(*before), readable(after));
        }
        if let (Some(b), Some(a)) = (&b.loo, &a.loo) {
            for (k, axis) in ["1", "2"].iter().enumerate() {
                let [before, after] = [b, a].map(|m| readable(m.moment_rmse_nmm_each[k]));
                println!(
                    "    {:<32} {before:>10} {after:>10}",
                    format!("{} map, loo, moment_{axis}_nmm", b.map)
                );
            }
        }
    }
    let n = &v.noise_floor;
    for (floor, unit) in [(n.wavelength_pm, "pm"), (n.response, "(unit of the response)"), (n.error_um, "um")]
    {
        if let Some(floor) = floor {
            println!("  noise floor {} {unit} ({})", readable(floor), n.source);
        }
    }
    if let Some(n) = &v.next_measurement {
        println!("  next: {} (expected power {:.2})", n.instruction, n.expected_power);
    }
    println!("  written to {}", out.display());
}

/// Four decimals, or an exponent where these would hide the number.
fn readable(value: f64) -> String {
    if value == 0.0 || (0.01..1e6).contains(&value.abs()) {
        format!("{value:.4}")
    } else {
        format!("{value:.4e}")
    }
}
