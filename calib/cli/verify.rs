//! `wcal verify`: the residual loop on a session.

pub mod check;
mod text;

pub use text::print_text;

use crate::output::{OutputFolder, Overwrite, ResultKind, text_of};
use crate::progress::Progress;
use crate::report_input::{of_document, of_scalar, of_whisker};
use crate::session_folder::expect_session;
use crate::simulated::{is_simulated, mark_table};
use crate::unseal_record::UnsealRecord;
use anyhow::{Context, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use text::{predictions_csv, scalar_csv};
use wcal_calibration::{
    CalibrationModel, GivenCalibration, SessionSystem, WhiskerCalibration, WireParts, provenance, seal,
};
use wcal_contact::groove_comparison;
use wcal_contact::session_groove;
use wcal_contact::sweep_session::SweepSession;
use wcal_contact::sweep_verify::verify_with_sweep;
use wcal_contact::sweep_witness::SweepWitness;
use wcal_core::files::folder_of;
use wcal_core::verify_document::{CalibrationJudgement, GrooveTracking, Verdict, VerifyDocument};
use wcal_core::{Provenance, Seal, SessionData, Unsealing, VerificationStatus, WhiskerData};
use wcal_report::ReportInput;
use wcal_session::{LoadedSession, SessionError, add_session, attach_holdout, load};
use wcal_trace::method::options::{Options, ProgressListener};
use wcal_trace::scalar::{ScalarData, verify_scalar};
use wcal_trace::verify::VerifyOptions;
use wcal_trace::whisker::{Verified, WhiskerVerification, verify_whisker};

/// Arguments of `wcal verify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal verify fixtures/whiskerfbg --out out
  wcal verify fixtures/nist/pontius --out out
  wcal verify session --holdout later-session --json
  wcal verify session --add next-measurement --out session-and-next
  wcal verify session --accept groove-friction,creep
  wcal verify session --check

Turn a plain table into a session first: wcal import TABLE.csv ... --out SESSION.

Exit code 0: adequate, or an effect was found and added; 1: refused (verify.json says why), or an error; 3: as 0, but the session has warnings, or single sealed readings lie far outside the noise; 4: ambiguous, unknown-effect or twin-fault.")]
pub struct VerifyArgs {
    /// Session folder
    pub session: PathBuf,
    /// Independent test data, not used in the fit: another session, or a table
    #[arg(long, value_name = "SESSION-or-CSV")]
    pub holdout: Option<PathBuf>,
    /// A later session of the same sensor, fitted together with this one (separate zero offset per mounting); may be repeated
    #[arg(long, value_name = "SESSION")]
    pub add: Vec<PathBuf>,
    /// Accept this explanation (effects separated by commas) although others remain
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub accept: Vec<String>,
    /// A calibration to judge on readings outside its fit: the holdout, or a whole other session. If it fails, a copy with status "failed" is written as judged-calibration.json
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// A sweep of the same whisker over a known object (`wcal import --kind sweep`). Explanations that it refutes are rejected (kind whisker)
    #[arg(long, value_name = "SWEEP")]
    pub sweep: Option<PathBuf>,
    /// Only look at the session: what it holds, what it lacks, what looks wrong. Exit code 0: fit for use; 3: usable, with warnings; 1: not usable
    #[arg(long, conflicts_with_all = ["add", "accept", "calibration", "sweep"])]
    pub check: bool,
    /// Folder for verify.json, predictions.csv, report.html and calibration.json [default: SESSION-verified, beside the session]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print verify.json on stdout
    #[arg(long)]
    pub json: bool,
    /// Seed of every random draw
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// What `verify` leaves; `unsealed.json` outlives it, so that a second look at a holdout is known as one.
pub const RESULT: ResultKind<'_> = ResultKind {
    command: "verify",
    document: "verify.json",
    format_prefix: "wcal-verify/",
    files: &["predictions.csv", "report.html", "calibration.json", "judged-calibration.json"],
    kept: &["unsealed.json"],
    resumes: false,
    made_of: |folder| text_of(folder, "verify.json", "session"),
};

/// Runs the command.
///
/// # Errors
/// A session that cannot be read, a model that cannot be built, or a file that cannot be written.
pub fn run(args: &VerifyArgs) -> anyhow::Result<ExitCode> {
    expect_session(&args.session, "verify")?;
    if args.check {
        return check::check(&args.session, args.holdout.as_deref(), args.json);
    }
    let folder = args.out.clone().map_or_else(|| beside(&args.session), Ok)?;
    let mut out = OutputFolder::open(&RESULT, &folder, args.overwrite.force)?;
    let mut session = match load(&args.session) {
        Ok(session) => session,
        Err(why) => return Err(refuse_unusable(args, out, why)),
    };
    out.refuse_other(&session.id)?;
    // What joining sessions says by itself is no reason to doubt the result.
    let doubtful = session.warnings.iter().any(|w| !w.is_remark());
    for later in &args.add {
        add_session(&mut session, later)?;
    }
    if let Some(holdout) = &args.holdout {
        attach_holdout(&mut session, holdout)?;
    }
    for warning in &session.warnings {
        eprintln!("warning: {warning}");
    }
    let given = args.calibration.as_deref().map(|path| GivenCalibration::read(path, &session)).transpose()?;
    let progress = Progress::new(&format!("verify {}", session.id));
    let options = VerifyOptions { accept: args.accept.clone(), ..searching(args.seed, Some(&progress)) };
    let done = verify_session(&session, &mut out, options, given.as_ref(), args.sweep.as_deref())?;
    out.finish()?;
    drop(progress);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&done.verify)?);
    } else {
        print_text(&done, &folder);
    }
    Ok(exit_code(done.verify.verdict, doubtful || done.verify.after_trimmed.is_some()))
}

/// `SESSION-verified`, beside the session.
fn beside(session: &Path) -> anyhow::Result<PathBuf> {
    let named = if session.is_file() { folder_of(session) } else { session };
    // `.` and `..` have no name of their own.
    let named = match named.file_name() {
        Some(_) => named.to_owned(),
        None => named.canonicalize().with_context(|| format!("reading {}", session.display()))?,
    };
    let name =
        named.file_name().with_context(|| format!("{}: expected a session folder", session.display()))?;
    let mut verified = name.to_owned();
    verified.push("-verified");
    Ok(named.with_file_name(verified))
}

/// Data that cannot be used still get a `verify.json` that says so, beside the error, in place of an earlier result of the same session.
fn refuse_unusable(args: &VerifyArgs, mut out: OutputFolder<'_>, why: SessionError) -> anyhow::Error {
    let SessionError::Content(_) = &why else { return why.into() };
    let read = wcal_core::files::read_text(args.session.join("session.toml")).ok();
    let table = read.and_then(|text| wcal_core::document::toml(&text).ok()).unwrap_or_default();
    let text = |key: &str| Some(table.get(key)?.as_str()?.to_owned());
    let folder = || args.session.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let (name, kind) = (text("id").unwrap_or_else(folder), text("kind"));
    if let Err(other) = out.refuse_other(&name) {
        return anyhow::Error::from(why).context(other.to_string());
    }
    let kind = kind.unwrap_or_else(|| "unknown".to_owned());
    let mut document = VerifyDocument::refused(name, kind, why.to_string(), args.seed);
    document.simulated = is_simulated(&args.session.join("session.toml"));
    let written = serde_json::to_vec_pretty(&document).map_err(anyhow::Error::from).and_then(|text| {
        out.put("verify.json", text);
        out.finish()
    });
    match written {
        Ok(()) => why.into(),
        Err(e) => anyhow::Error::from(why).context(format!("and verify.json could not be written: {e}")),
    }
}

/// Exit code of a verdict; `doubtful` where the session was read with warnings, or sealed readings lie far outside the noise.
pub fn exit_code(verdict: Verdict, doubtful: bool) -> ExitCode {
    ExitCode::from(match verdict {
        Verdict::Refused => 1,
        Verdict::Ambiguous | Verdict::UnknownEffect | Verdict::TwinFault => 4,
        Verdict::Adequate | Verdict::Effect => u8::from(doubtful) * 3,
    })
}

/// What the loop gives for a session, whatever its kind.
struct Outcome {
    report: ReportInput,
    /// predictions.csv; none where the data were refused.
    predictions: Option<String>,
    /// What a calibration would hold.
    model: Option<CalibrationModel>,
    /// Record of the unsealing; none where nothing was unsealed.
    unsealing: Option<Unsealing>,
    /// How the given calibration does.
    judged: Option<CalibrationJudgement>,
}

/// Settings of a search that says how far it is.
pub fn searching(seed: u64, progress: Option<&Progress>) -> VerifyOptions {
    let listener = |p: &Progress| {
        let reporter = p.reporter();
        ProgressListener::new(move |stage, done| reporter.at(stage, done))
    };
    let progress = progress.map(listener).unwrap_or_default();
    VerifyOptions { search: Options { seed, progress, ..Options::default() }, ..VerifyOptions::default() }
}

/// Runs the loop and gathers every result; shared with `demo`. `given`: a calibration to be judged; `sweep`: folder of a sweep that judges the
/// explanations.
pub fn verify_session(
    session: &LoadedSession,
    out: &mut OutputFolder<'_>,
    options: VerifyOptions,
    given: Option<&GivenCalibration>,
    sweep: Option<&Path>,
) -> anyhow::Result<ReportInput> {
    let provenance = provenance(session, options.search.seed);
    let record = UnsealRecord::read(session, out.folder())?;
    let ledger = record.ledger(&provenance);
    let options = VerifyOptions { seal: Seal { ledger, ..record.seal(session, &provenance) }, ..options };
    let Outcome { mut report, predictions, model, unsealing, judged } = match &session.data {
        SessionData::Whisker(data) => {
            let witness = sweep.map(|folder| witness(folder, data)).transpose()?;
            of_whisker_session(session, data, &options, (given, witness.as_ref()), provenance.clone())?
        }
        _ if sweep.is_some() => {
            bail!("--sweep: expected a session of kind whisker, found {:?}", session.data.kind())
        }
        SessionData::Transducer(data) => {
            of_scalar_session(session, ScalarData::Transducer(data), &options, given, provenance.clone())?
        }
        SessionData::Axis(data) => {
            of_scalar_session(session, ScalarData::Axis(data), &options, given, provenance.clone())?
        }
    };
    add_notes(&mut report.verify, session, unsealing.is_some_and(|u| u.seen_before));
    report.verify.inputs = session.inputs.clone();
    report.verify.simulated = session.simulated;
    if let Some(csv) = predictions {
        out.put("predictions.csv", mark_table(&csv, session.simulated));
    }
    let verified = match report.verify.verdict {
        Verdict::Adequate | Verdict::Effect | Verdict::TwinFault => true,
        Verdict::Ambiguous => !options.accept.is_empty(),
        _ => false,
    };
    if let Some(model) = model.filter(|_| verified) {
        let contact = report.verify.groove_tracking.as_ref().and_then(groove_comparison::calibration_contact);
        let wire = match &session.data {
            SessionData::Whisker(data) => {
                Some(WireParts { whisker: &data.whisker, moments: &data.moments, contact })
            }
            _ => None,
        };
        let status = VerificationStatus::Verified;
        let file = seal(&session.id, status, Some(valid_until()?), model, provenance, wire)?;
        out.put("calibration.json", serde_json::to_vec_pretty(&file)?);
    }
    if let (Some(given), Some(judged)) = (given, judged) {
        if !judged.holds {
            out.put("judged-calibration.json", serde_json::to_vec_pretty(&given.failed()?)?);
        }
        report.verify.calibration = Some(judged);
    }
    out.put("verify.json", serde_json::to_vec_pretty(&report.verify)?);
    out.put("report.html", wcal_report::render(&report));
    Ok(report)
}

fn of_whisker_session(
    session: &LoadedSession,
    data: &WhiskerData,
    options: &VerifyOptions,
    (given, witness): (Option<&GivenCalibration>, Option<&SweepWitness>),
    provenance: Provenance,
) -> anyhow::Result<Outcome> {
    let verified = match witness {
        Some(witness) => verify_with_sweep(&session.id, data, &session.inputs, options, witness)?,
        None => verify_whisker(&session.id, data, &session.inputs, options)?,
    };
    Ok(match verified {
        Verified::Refused(document) => Outcome {
            report: of_document(session, *document, provenance),
            predictions: None,
            model: None,
            unsealing: None,
            judged: None,
        },
        Verified::Done(done) => Outcome {
            unsealing: done.unsealing.clone(),
            judged: given
                .map(|g| g.judge(SessionSystem::Whisker(&done.whole), options.search.seed))
                .transpose()?,
            predictions: Some(predictions_csv(&done)?),
            model: Some(CalibrationModel::Physical(done.model.clone())),
            report: {
                let mut report = of_whisker(session, data, &done, !options.accept.is_empty(), provenance);
                report.verify.groove_tracking = groove_tracking(&done)?;
                report
            },
        },
    })
}

/// The sweep in a folder as a witness of a session's whisker.
fn witness(folder: &Path, data: &WhiskerData) -> anyhow::Result<SweepWitness> {
    let sweep = SweepSession::of(folder)?
        .with_context(|| format!("--sweep {}: expected a session of kind sweep", folder.display()))?;
    let poses = data.rows.iter().filter(|r| r.trajectory.is_some()).count();
    Ok(SweepWitness::new(sweep, (&data.whisker, &data.moments), poses)?)
}

/// The tracker on the groove, with the accepted calibration: on the sealed readings where there are any. None where the verdict accepts no
/// calibration, or the stage's way is not recorded.
fn groove_tracking(done: &WhiskerVerification) -> anyhow::Result<Option<GrooveTracking>> {
    let whole = &done.whole;
    let readings = 0..whole.path.readings.len();
    let way_known = |i: usize| whole.path.readings[i].rest || whole.row(i).stage_mm.is_some();
    let accepted = matches!(done.document.verdict, Verdict::Adequate | Verdict::Effect | Verdict::TwinFault);
    if !accepted || !readings.clone().all(way_known) {
        return Ok(None);
    }
    let Some(motion) = done.model.groove_motion(whole) else { return Ok(None) };
    let [sealed, _] = whole.held_out();
    let (any, split) = if sealed.contains(&true) { (true, "holdout") } else { (false, "fit") };
    let tracked = session_groove::track(whole, motion, |i| sealed[i] == any)?;
    let compared = tracked.compared(whole, |i| whole.row(i).groove_mm)?;
    Ok(groove_comparison::groove_tracking(&compared, split))
}

fn of_scalar_session(
    session: &LoadedSession,
    data: ScalarData<'_>,
    options: &VerifyOptions,
    given: Option<&GivenCalibration>,
    provenance: Provenance,
) -> anyhow::Result<Outcome> {
    let done = verify_scalar(&session.id, data, options)?;
    Ok(Outcome {
        predictions: (!done.residuals.is_empty()).then(|| scalar_csv(data, &done.residuals)),
        unsealing: done.unsealing.clone(),
        judged: match (given, &done.whole) {
            (Some(g), Some(whole)) => Some(g.judge(SessionSystem::Scalar(whole), options.search.seed)?),
            _ => None,
        },
        model: done.model.clone().map(CalibrationModel::Scalar),
        report: of_scalar(session, data, &done, provenance),
    })
}

fn add_notes(document: &mut VerifyDocument, session: &LoadedSession, seen: bool) {
    document.notes.extend(session.warnings.iter().map(ToString::to_string));
    if seen {
        document
            .notes
            .push("This holdout was unsealed before: its error is no longer a first look.".to_owned());
    }
}

/// Days for which a calibration is valid; afterwards `predict` and `track` refuse it. A year, as for other transducers.
const VALID_DAYS: i64 = 365;

/// Last moment of validity, RFC 3339.
fn valid_until() -> anyhow::Result<String> {
    let hours = jiff::Span::new().try_hours(24 * VALID_DAYS)?;
    Ok(jiff::Timestamp::now().checked_add(hours)?.to_string())
}
