//! `wcal verify --dry-run`: what a session holds, what it lacks, and what looks wrong; nothing is
//! fitted.

use crate::simulated::word;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::Path;
use std::process::ExitCode;
use wcal_core::{InputFile, SessionKind};
use wcal_session::{Finding, LoadedSession, Severity, attach_holdout, examine, load};
use wcal_verify::whisker::sensitivity::lost_sensitivity;

/// Exit code 0: fit for use; 3: usable, with warnings that matter; 1: cannot be used. A session
/// that cannot be read is a finding, too.
///
/// # Errors
/// Where the findings cannot be printed.
pub fn check(folder: &Path, holdout: Option<&Path>, as_json: bool) -> anyhow::Result<ExitCode> {
    let loaded = load(folder).and_then(|mut session| {
        if let Some(holdout) = holdout {
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
            let finding = Finding {
                severity: Severity::Error,
                topic: "files".to_owned(),
                message: error.to_string(),
            };
            (None, vec![finding])
        }
    };
    let worst = findings
        .iter()
        .map(|f| f.severity)
        .max()
        .unwrap_or(Severity::Ok);
    if as_json {
        print_json(folder, session.as_ref(), &findings, worst)?;
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
    let message = lost_sensitivity(session.whisker().ok()?).ok().flatten()?;
    Some(Finding {
        severity: Severity::Error,
        topic: "sensitivity".to_owned(),
        message,
    })
}

/// Findings about a session.
#[derive(Serialize, JsonSchema)]
pub(crate) struct CheckDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-check/1"))]
    format: &'static str,
    /// Identifier; null where it cannot be read.
    session: Option<&'a str>,
    /// Kind; null where it cannot be read.
    kind: Option<SessionKind>,
    /// The session is simulated.
    simulated: bool,
    /// Folder.
    folder: &'a Path,
    /// Worst finding.
    worst: Severity,
    /// Findings.
    findings: &'a [Finding],
    /// Files read.
    inputs: &'a [InputFile],
}

fn print_json(
    folder: &Path,
    session: Option<&LoadedSession>,
    findings: &[Finding],
    worst: Severity,
) -> anyhow::Result<()> {
    let document = CheckDocument {
        format: "wcal-check/1",
        session: session.map(|s| s.id.as_str()),
        kind: session.map(|s| s.kind),
        simulated: session.is_some_and(|s| s.simulated),
        folder,
        worst,
        findings,
        inputs: session.map_or(&[], |s| &s.inputs),
    };
    println!("{}", serde_json::to_string_pretty(&document)?);
    Ok(())
}

fn print_text(session: Option<&LoadedSession>, findings: &[Finding]) {
    if let Some(session) = session {
        println!(
            "session {:?}{}, medium {}",
            session.id,
            word(session.simulated),
            session.medium
        );
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
