//! The log of a motion, checked against the clock of the table or the recording that it goes with
//! before anything is tracked.

use super::arguments::TrackArgs;
use anyhow::{Context, Result};
use std::path::{Path, PathBuf};
use wcal_acquisition::replay::{self, Message};
use wcal_session::MotionLog;
use wcal_session::motion_table::{LoggedMotion, read};

/// The session whose recording is tracked: the folder that was named, or without a network the one
/// that the recording lies in.
pub(crate) fn session_folder(args: &TrackArgs) -> Option<&Path> {
    let source = args.source.as_deref()?;
    if source.is_dir() || !args.model.is_empty() {
        Some(source)
    } else {
        source.parent()
    }
}

/// The log of `--motion` by the recording's clock (seconds since the first scan); none where none
/// was given.
///
/// # Errors
/// Where log or recording cannot be read, or their clocks have nothing in common.
pub(crate) fn recorded_motion(args: &TrackArgs, parts: &[PathBuf]) -> Result<Option<MotionLog>> {
    let Some(file) = &args.motion else {
        return Ok(None);
    };
    let span_s = || {
        let mut span: Option<[f64; 2]> = None;
        for part in parts {
            replay::read(part, |message| {
                if let Message::Scan(scan) = message {
                    let clocks = scan.reading().clocks;
                    let t_s = clocks.device_s.unwrap_or(clocks.host_s);
                    span = Some([span.map_or(t_s, |s| s[0]), t_s]);
                }
            })?;
        }
        Ok(span.map(|[first, last]| [0.0, last - first]))
    };
    Ok(Some(logged_motion(file, span_s)?.log))
}

/// A log, checked against the clock of the readings (first and last time, s).
///
/// # Errors
/// Where it cannot be read, or the clocks have nothing in common.
pub(crate) fn logged_motion(
    file: &Path,
    span_s: impl FnOnce() -> Result<Option<[f64; 2]>>,
) -> Result<LoggedMotion> {
    let logged = read(file)?;
    logged
        .warning
        .iter()
        .for_each(|warning| eprintln!("warning: {warning}"));
    // A log of another clock would give every reading a motion, and a wrong one.
    if let Some(span_s) = span_s()? {
        logged
            .log
            .check_clock(span_s)
            .with_context(|| file.display().to_string())?;
    }
    for line in logged.log.jumps() {
        eprintln!(
            "{}: line {line}: the motion jumps; contacts before and after are tracked separately",
            file.display()
        );
    }
    Ok(logged)
}
