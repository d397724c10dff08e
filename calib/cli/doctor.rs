//! `wcal doctor`: what a session holds, what it lacks, and what looks wrong.

use crate::simulated::word;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_core::SessionData;
use wcal_session::{Finding, LoadedSession, Severity, attach_holdout, examine, load};
use wcal_trace::whisker::sensitivity::lost_sensitivity;

/// Arguments of `wcal doctor`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal doctor fixtures/whiskerfbg

Exit code 0: fit for use; 3: usable, with warnings that matter; 1: cannot be used.")]
pub struct DoctorArgs {
    /// Session folder
    pub session: PathBuf,
    /// Independent test data, not used in the fit: another session, or a table
    #[arg(long, value_name = "SESSION-or-CSV")]
    pub holdout: Option<PathBuf>,
    /// Print the findings as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Runs the command. A session that cannot be read is a finding too, with exit code 1.
///
/// # Errors
/// Where the findings cannot be printed.
pub fn run(args: &DoctorArgs) -> anyhow::Result<ExitCode> {
    crate::session_folder::expect_session(&args.session, "doctor")?;
    let loaded = load(&args.session).and_then(|mut session| {
        if let Some(holdout) = &args.holdout {
            attach_holdout(&mut session, holdout)?;
        }
        Ok(session)
    });
    let (session, findings) = match loaded {
        Ok(session) => {
            let mut findings = examine(&session);
            findings.extend(sensitivity(&session));
            (Some(session), findings)
        }
        Err(error) => {
            let finding =
                Finding { severity: Severity::Error, topic: "files".to_owned(), message: error.to_string() };
            (None, vec![finding])
        }
    };
    let worst = findings.iter().map(|f| f.severity).max().unwrap_or(Severity::Ok);
    if args.json {
        print_json(args, session.as_ref(), &findings, worst)?;
    } else {
        print_text(session.as_ref(), &findings);
    }
    Ok(ExitCode::from(match worst {
        Severity::Ok | Severity::Note => 0,
        Severity::Warn => 3,
        Severity::Error => 1,
    }))
}

/// Whether the gratings of a whisker respond to the load, where the wire can be bent.
fn sensitivity(session: &LoadedSession) -> Option<Finding> {
    let SessionData::Whisker(data) = &session.data else { return None };
    let message = lost_sensitivity(data).ok().flatten()?;
    Some(Finding { severity: Severity::Error, topic: "sensitivity".to_owned(), message })
}

fn print_json(
    args: &DoctorArgs,
    session: Option<&LoadedSession>,
    findings: &[Finding],
    worst: Severity,
) -> anyhow::Result<()> {
    let document = serde_json::json!({
        "format": "wcal-doctor/1",
        "session": session.map(|s| s.id.clone()),
        "kind": session.map(|s| s.kind),
        "simulated": session.is_some_and(|s| s.simulated),
        "folder": args.session,
        "worst": worst,
        "findings": findings,
        "inputs": session.map(|s| s.inputs.clone()).unwrap_or_default(),
    });
    println!("{}", serde_json::to_string_pretty(&document)?);
    Ok(())
}

fn print_text(session: Option<&LoadedSession>, findings: &[Finding]) {
    if let Some(session) = session {
        println!("session {:?}{}, medium {}", session.id, word(session.simulated), session.medium);
    }
    for finding in findings {
        let label = match finding.severity {
            Severity::Ok => "ok   ",
            Severity::Note => "note ",
            Severity::Warn => "warn ",
            Severity::Error => "error",
        };
        println!("{label}  {:<12}  {}", finding.topic, finding.message);
    }
}
