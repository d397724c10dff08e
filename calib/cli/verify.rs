//! `wcal verify`: the residual loop on a session.

pub mod dry_run;
mod text;

pub(crate) use text::print_text;

use crate::output::{OutputFolder, Overwrite, ResultKind, text_of};
use crate::progress::Progress;
use crate::report_input::{of_document, of_scalar, of_whisker};
use crate::session_folder::expect_session;
use crate::simulated::{is_simulated, mark_table};
use anyhow::{Context, Result, bail};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use text::{predictions_csv, scalar_csv};
use wcal_calibration::{
    CalibrationModel, GivenCalibration, SessionSystem, WireParts, provenance, seal,
};
use wcal_core::files::folder_of;
use wcal_core::verify_document::{
    CalibrationContact, CalibrationJudgement, HoldoutOutcome, Verdict, VerifyDocument,
};
use wcal_core::{
    Provenance, SealedRows, SessionData, TransducerData, VerificationStatus, WhiskerData,
};
use wcal_report::ReportInput;
use wcal_session::sweep_session::SweepSession;
use wcal_session::{
    LoadedSession, SessionError, SessionLedger, WarningKind, add_session, attach_holdout, load,
};
use wcal_track::groove_comparison::{calibration_contact, contact_comparison, groove_tracking};
use wcal_track::session_groove::{count_loaded, groove_places, left_out_places};
use wcal_track::sweep_witness::SweepWitness;
use wcal_verify::method::options::{Options, ProgressListener};
use wcal_verify::scalar::{ScalarModel, verify_scalar};
use wcal_verify::verify::conclusion::asserts_validity;
use wcal_verify::verify::{VerifyRequest, Witness};
use wcal_verify::whisker::{
    PhysicalModel, Verified, WhiskerSystem, WhiskerVerification, verify_whisker,
};

/// Arguments of `wcal verify`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal verify fixtures/whiskerfbg --out out
  wcal verify fixtures/nist/pontius --out out
  wcal verify session --holdout later-session --json
  wcal verify session --add next-measurement --out session-and-next
  wcal verify session --accept groove-friction,creep
  wcal verify session --dry-run

Turn a plain table into a session first: wcal import TABLE.csv ... --out SESSION.

Exit code 0: adequate, or an effect was found and added; 1: refused (verify.json says why), or an error; 3: as 0, but the session has warnings, or single sealed readings lie far outside the noise; 4: ambiguous, unknown-effect or twin-fault, or sealed readings that contradict the accepted model, or a calibration (--calibration) that does not hold.")]
pub struct VerifyArgs {
    /// Session folder
    pub session: PathBuf,
    /// Independent test data, not used in the fit: another session, or a table
    #[arg(long, value_name = "SESSION-or-CSV")]
    pub holdout: Option<PathBuf>,
    /// A later session of the same sensor, fitted together with this one (separate zero offset per
    /// mounting); may be repeated
    #[arg(long, value_name = "SESSION")]
    pub add: Vec<PathBuf>,
    /// Accept this explanation (effects separated by commas) although others remain
    #[arg(long, value_name = "ID", value_delimiter = ',')]
    pub accept: Vec<String>,
    /// A calibration to judge on readings outside its fit: the holdout, or a whole other session.
    /// If it fails, a copy with status "failed" is written as judged-calibration.json
    #[arg(long, value_name = "FILE")]
    pub calibration: Option<PathBuf>,
    /// A sweep of the same whisker over a known object (`wcal import --kind sweep`). Explanations
    /// that it refutes are rejected (kind whisker)
    #[arg(long, value_name = "SWEEP")]
    pub sweep: Option<PathBuf>,
    /// Only look at the session: what it holds, what it lacks, what looks wrong. Exit code 0: fit
    /// for use; 3: usable, with warnings; 1: not usable
    #[arg(long, alias = "check", conflicts_with_all = ["add", "accept", "calibration", "sweep"])]
    pub dry_run: bool,
    /// Folder for verify.json, predictions.csv, report.html and calibration.json [default:
    /// SESSION-verified, beside the session]
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

/// What `verify` leaves; `unsealed.json` outlives it, so that a second look at a holdout is known
/// as one.
pub const RESULT: ResultKind<'_> = ResultKind {
    kept: &["unsealed.json"],
    made_of: |folder| text_of(folder, "verify.json", "session"),
    ..ResultKind::new(
        "verify",
        "verify.json",
        "wcal-verify/",
        &[
            "predictions.csv",
            "report.html",
            "calibration.json",
            "judged-calibration.json",
        ],
    )
};

/// Runs the command.
///
/// # Errors
/// A session that cannot be read, a model that cannot be built, or a file that cannot be written.
pub fn run(args: &VerifyArgs) -> Result<ExitCode> {
    if args.dry_run {
        expect_session(&args.session, "verify")?;
        return dry_run::check(&args.session, args.holdout.as_deref(), args.json);
    }
    let folder = args.out.clone().map_or_else(|| beside(&args.session), Ok)?;
    // A wrong --out is refused now, not after the search.
    let mut out = OutputFolder::open(&RESULT, &folder, args.overwrite.force)?;
    expect_session(&args.session, "verify")?;
    let mut session = match load(&args.session) {
        Ok(session) => session,
        Err(why) => return Err(refuse_unusable(args, out, why)),
    };
    out.refuse_other(&session.id)?;
    // What joining sessions says by itself is no reason to doubt the result.
    let doubtful = session
        .warnings
        .iter()
        .any(|w| w.kind != WarningKind::OpenEnd);
    for later in &args.add {
        add_session(&mut session, later)?;
    }
    if let Some(holdout) = &args.holdout {
        attach_holdout(&mut session, holdout)?;
    }
    for warning in &session.warnings {
        eprintln!("warning: {warning}");
    }
    let given = args
        .calibration
        .as_deref()
        .map(|path| GivenCalibration::read(path, &session))
        .transpose()?;
    let progress = Progress::new(&format!("verify {}", session.id));
    let request = VerifyRequest {
        accept: args.accept.clone(),
        ..searching(args.seed, Some(&progress))
    };
    let done = verify_session(
        session,
        &mut out,
        request,
        given.as_ref(),
        args.sweep.as_deref(),
    )?;
    out.finish()?;
    drop(progress);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&done.verify)?);
    } else {
        print_text(&done, &folder);
    }
    let (code, why) = exit_code(&done.verify, doubtful);
    if code != 0 {
        eprintln!("verify: exit code {code}: {why}");
    }
    Ok(ExitCode::from(code))
}

/// `SESSION-verified`, beside the session.
fn beside(session: &Path) -> Result<PathBuf> {
    let named = if session.is_file() {
        folder_of(session)
    } else {
        session
    };
    // `.` and `..` have no name of their own.
    let named = match named.file_name() {
        Some(_) => named.to_owned(),
        None => named
            .canonicalize()
            .with_context(|| format!("reading {}", session.display()))?,
    };
    let name = named
        .file_name()
        .with_context(|| format!("{}: expected a session folder", session.display()))?;
    let mut verified = name.to_owned();
    verified.push("-verified");
    Ok(named.with_file_name(verified))
}

/// Data that cannot be used still get a `verify.json` that says so, beside the error, in place of
/// an earlier result of the same session. A session whose identifier cannot be read gets none: it
/// would stand in the way of the next one there.
fn refuse_unusable(
    args: &VerifyArgs,
    mut out: OutputFolder<'_>,
    why: SessionError,
) -> anyhow::Error {
    let SessionError::Content(_) = &why else {
        return why.into();
    };
    let read = wcal_core::files::read_text(args.session.join("session.toml")).ok();
    let table = read
        .and_then(|text| wcal_core::document::toml(&text).ok())
        .unwrap_or_default();
    let text = |key: &str| Some(table.get(key)?.as_str()?.to_owned());
    let Some(name) = text("id") else {
        return why.into();
    };
    if let Err(other) = out.refuse_other(&name) {
        return anyhow::Error::from(why).context(other.to_string());
    }
    let kind = text("kind").unwrap_or_else(|| "unknown".to_owned());
    let mut document = VerifyDocument::refused(name, kind, why.to_string(), args.seed);
    document.simulated = is_simulated(&args.session.join("session.toml"));
    let written = serde_json::to_vec_pretty(&document)
        .map_err(anyhow::Error::from)
        .and_then(|text| {
            out.put("verify.json", text);
            out.finish()
        });
    match written {
        Ok(()) => why.into(),
        Err(e) => {
            anyhow::Error::from(why).context(format!("and verify.json could not be written: {e}"))
        }
    }
}

/// Exit code of a result, and where it is not 0 why and what to do; `doubtful` where the session
/// was read with warnings.
fn exit_code(verify: &VerifyDocument, doubtful: bool) -> (u8, &'static str) {
    match verify.verdict {
        Verdict::Refused => (1, "the data cannot be used; correct what the reason names"),
        Verdict::Ambiguous => (
            4,
            "explanations of more than one class remain; take the next measurement that is named, or choose one with --accept",
        ),
        Verdict::UnknownEffect => (
            4,
            "something remains that no effect explains, and no calibration was written; report.html shows what it follows",
        ),
        Verdict::TwinFault => (
            4,
            "labels of the outside twin are faulty; correct them as the fault says, or use the rod's (fit-gpr --labels rod)",
        ),
        _ if verify.holdout.outcome == HoldoutOutcome::Contradicted => (
            4,
            "the sealed readings contradict the accepted model, and no calibration was written; measure again, or look for what changed between",
        ),
        _ if verify.calibration.as_ref().is_some_and(|c| !c.holds) => (
            4,
            "the given calibration does not hold on these readings; calibrate anew, or find what changed",
        ),
        _ if !verify.cautions.is_empty() => (3, "the calibration stands within the cautions above"),
        _ if verify.after_trimmed.is_some() => (
            3,
            "single sealed readings lie far outside the noise; look at them (predictions.csv) before the calibration is used",
        ),
        _ if doubtful => (
            3,
            "the session was read with the warnings above; look at them before the calibration is used",
        ),
        _ => (0, ""),
    }
}

/// What the loop gives for a session, whatever its kind.
struct Outcome {
    report: ReportInput,
    /// predictions.csv; none where the data were refused.
    predictions: Option<String>,
    /// What a calibration would hold.
    model: Option<CalibrationModel>,
    /// What it makes of a contact.
    contact: Option<CalibrationContact>,
    /// How the given calibration does.
    judged: Option<CalibrationJudgement>,
}

/// A request to search that says how far it is.
pub fn searching(seed: u64, progress: Option<&Progress>) -> VerifyRequest {
    let listener = |p: &Progress| ProgressListener::new(p.reporter());
    let progress = progress.map(listener).unwrap_or_default();
    VerifyRequest {
        search: Options {
            seed,
            progress,
            ..Options::default()
        },
        ..VerifyRequest::default()
    }
}

/// Runs the loop and gathers every result; shared with `demo`. `given`: a calibration to be judged;
/// `sweep`: folder of a sweep that judges the explanations.
pub fn verify_session(
    mut session: LoadedSession,
    out: &mut OutputFolder<'_>,
    request: VerifyRequest,
    given: Option<&GivenCalibration>,
    sweep: Option<&Path>,
) -> Result<ReportInput> {
    let provenance = Provenance {
        command: crate::kept::command(),
        ..provenance(&session, request.search.seed)
    };
    let ledger = SessionLedger::new(&session, out.folder(), &provenance).ledger();
    let claims = given
        .iter()
        .map(|g| g.content_sha256().to_owned())
        .collect();
    let request = VerifyRequest {
        ledger,
        claims,
        ..request
    };
    // The search must not see the sealed rows: they judge what it decides.
    let sealed = std::mem::take(&mut session.sealed);
    let (session, made) = (&session, provenance.clone());
    let Outcome {
        mut report,
        predictions,
        model,
        contact,
        judged,
    } = match &session.data {
        SessionData::Whisker(data) => {
            let sweep = sweep.map(|folder| witness(folder, data)).transpose()?;
            let witnesses: Vec<&dyn Witness<WhiskerSystem>> =
                sweep.iter().map(|s| s as _).collect();
            of_whisker_session(session, data, sealed, &request, (given, &witnesses), made)?
        }
        SessionData::Transducer(_) if sweep.is_some() => bail!(
            "--sweep: expected a session of kind whisker, found {}",
            session.kind
        ),
        SessionData::Transducer(data) => {
            of_scalar_session(session, data, sealed, &request, given, made)?
        }
    };
    let later = report.verify.holdout.look > 1;
    let said = session.warnings.iter().map(ToString::to_string);
    report.verify.notes.extend(said);
    if later {
        let note = "This holdout has met another decision before: its error is no longer that of a first look.";
        report.verify.notes.push(note.to_owned());
    }
    report.verify.inputs = session.inputs.clone();
    report.verify.simulated = session.simulated;
    if let Some(csv) = predictions {
        out.put("predictions.csv", mark_table(&csv, session.simulated));
    }
    // What the sealed readings contradict must not leave as a calibration that others trust.
    let verified = report.verify.holdout.outcome != HoldoutOutcome::Contradicted
        && asserts_validity(report.verify.verdict, !request.accept.is_empty());
    if let Some(model) = model.filter(|_| verified) {
        let wire = match &session.data {
            SessionData::Whisker(data) => Some(WireParts {
                whisker: &data.whisker,
                moments: &data.moments,
                contact,
            }),
            _ => None,
        };
        // Sealed readings that were met before may have shaped an earlier decision.
        let status = if later {
            VerificationStatus::Reverified
        } else {
            VerificationStatus::Verified
        };
        if let CalibrationModel::Scalar(model) = &model {
            report.verify.data_sheet = model.data_sheet();
        }
        let file = seal(
            &session.id,
            status,
            Some(valid_until()?),
            model,
            provenance,
            wire,
        )?;
        out.put("calibration.json", serde_json::to_vec_pretty(&file)?);
    }
    if let (Some(given), Some(judged)) = (given, judged) {
        if !judged.holds {
            out.put(
                "judged-calibration.json",
                serde_json::to_vec_pretty(&given.failed()?)?,
            );
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
    sealed: SealedRows,
    request: &VerifyRequest,
    (given, witnesses): (Option<&GivenCalibration>, &[&dyn Witness<WhiskerSystem>]),
    provenance: Provenance,
) -> Result<Outcome> {
    let count = sealed.len();
    let verified = verify_whisker(
        &session.id,
        data,
        sealed.whisker(),
        &session.inputs,
        witnesses,
        request,
    )?;
    let done = match verified {
        Verified::Refused(document) => {
            return Ok(Outcome {
                report: of_document(session, *document, provenance),
                predictions: None,
                model: None,
                contact: None,
                judged: None,
            });
        }
        Verified::Done(done) => done,
    };
    let on_request = !request.accept.is_empty();
    let mut report = of_whisker(session, (data, count), &done, on_request, provenance);
    let (calibration, whole) = (done.decision.calibration(), &done.assessment.whole);
    // An explanation that is accepted on request alone says nothing certain of contacts.
    let contact = match asserts_validity(done.document.verdict, false) {
        true => contacts(&done, count > 0, &mut report.verify)?,
        false => None,
    };
    Ok(Outcome {
        judged: given
            .map(|g| g.judge(SessionSystem::Whisker(whole)))
            .transpose()?,
        predictions: Some(predictions_csv(&done)?),
        model: Some(CalibrationModel::Physical(calibration.clone())),
        contact,
        report,
    })
}

/// The sweep in a folder as a witness of a session's whisker.
fn witness(folder: &Path, data: &WhiskerData) -> Result<SweepWitness> {
    let sweep = SweepSession::of(folder)?.with_context(|| {
        format!(
            "--sweep {}: expected a session of kind sweep",
            folder.display()
        )
    })?;
    let poses = data.rows.iter().filter(|r| r.trajectory.is_some()).count();
    Ok(SweepWitness::new(
        sweep,
        (&data.whisker, &data.moments),
        poses,
    )?)
}

/// Contacts in the groove: by the calibrations of the others on each trajectory in turn, and by the
/// calibration itself on the sealed ones. What it says of contacts comes from the readings that it
/// was fitted to; the sealed ones show whether it is true.
fn contacts(
    done: &WhiskerVerification,
    has_sealed: bool,
    document: &mut VerifyDocument,
) -> Result<Option<CalibrationContact>> {
    let (decision, whole) = (&done.decision, &done.assessment.whole);
    let own = groove_places(decision.model(), decision.calibration(), |_| true)?;
    let [before, after] = left_out_places(decision)?;
    document.contact =
        contact_comparison([&before, &after], count_loaded(decision.model(), |_| true));
    document.groove_tracking = groove_tracking(&own, "fit");
    if has_sealed {
        let sealed = &whole.sealed;
        let of = |model: &PhysicalModel| groove_places(whole, model, |i| sealed[i]);
        let [before, after] = [
            of(&decision.declared_calibration())?,
            of(decision.calibration())?,
        ];
        let confirming = contact_comparison([&before, &after], count_loaded(whole, |i| sealed[i]));
        document
            .contact
            .iter_mut()
            .for_each(|c| c.sealed = confirming.clone().map(Box::new));
        document.groove_tracking = groove_tracking(&after, "holdout");
    }
    Ok(groove_tracking(&own, "fit")
        .as_ref()
        .and_then(calibration_contact))
}

fn of_scalar_session(
    session: &LoadedSession,
    data: &TransducerData,
    sealed: SealedRows,
    request: &VerifyRequest,
    given: Option<&GivenCalibration>,
    provenance: Provenance,
) -> Result<Outcome> {
    let count = sealed.len();
    let done = verify_scalar(&session.id, data, sealed.transducer(), request)?;
    Ok(Outcome {
        predictions: (!done.residuals.is_empty()).then(|| scalar_csv(data.model, &done.residuals)),
        judged: match (given, &done.whole) {
            (Some(g), Some(whole)) => Some(g.judge(SessionSystem::Scalar(whole))?),
            _ => None,
        },
        // By these columns a later table of the same instrument is read.
        model: done.model.clone().map(|model| {
            CalibrationModel::Scalar(ScalarModel {
                columns: session.imported.clone(),
                ..model
            })
        }),
        contact: None,
        report: of_scalar(session, (data, count), &done, provenance),
    })
}

/// Days for which a calibration is valid; afterwards `predict` and `track` refuse it. A year, as
/// for other transducers.
const VALID_DAYS: i64 = 365;

/// Last moment of validity, RFC 3339.
fn valid_until() -> Result<String> {
    // A day has no fixed length for a time stamp; an hour has.
    let hours = jiff::Span::new().try_hours(24 * VALID_DAYS)?;
    Ok(jiff::Timestamp::now().checked_add(hours)?.to_string())
}
