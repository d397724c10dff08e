//! What may be written over, and what stood beside an earlier track.

use crate::output::{check_beside, check_file, first_line};
use anyhow::{Context, Result};
use std::path::Path;
use wcal_track::track_table::{TrackFiles, companion};

/// Summary beside the table.
const SUMMARY: &str = ".json";

/// Whether a table with this first line is a track, of this version or an earlier one.
fn is_track(first: &str) -> bool {
    first.starts_with("point,t_s,moment_1_nmm,moment_2_nmm,")
}

/// Refuses an `--out` that is neither new nor an earlier track, and files of others beside it.
///
/// # Errors
/// Where something else is there without `force`, or nothing can be written.
pub(crate) fn check(out: &Path, force: bool) -> Result<()> {
    check_file(out, "track", is_track, force)?;
    // What stands beside an earlier track belongs to it.
    let earlier = out.exists() && is_track(&first_line(out)?);
    let own = |start: &str| start.contains("wcal-track/");
    check_beside(&[companion(out, SUMMARY)], own, force || earlier)
}

/// Opens the files of a track; nothing of an earlier one stays beside it.
///
/// # Errors
/// Where one cannot be made.
pub(crate) fn create(out: &Path) -> Result<TrackFiles> {
    let summary = companion(out, SUMMARY);
    // The summary of an earlier track must not stand beside the new rows.
    if summary.is_file() && out.is_file() && is_track(&first_line(out)?) {
        std::fs::remove_file(&summary)
            .with_context(|| format!("replacing {}", summary.display()))?;
    }
    Ok(TrackFiles::create(out)?)
}
