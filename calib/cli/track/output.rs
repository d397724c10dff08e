//! What may be written over, and what stood beside an earlier track.

use super::arguments::TrackArgs;
use crate::output::{check_beside, check_file, first_line};
use anyhow::{Context, Result};
use std::path::Path;
use wcal_track::track_table::{TrackFiles, companion};

/// Summary beside the table.
const SUMMARY: &str = ".json";
/// Live page beside the table.
pub(super) const LIVE_PAGE: &str = ".live.html";

/// Whether a table with this first line is a track, of this version or an earlier one.
fn is_track(first: &str) -> bool {
    first.starts_with("point,t_s,moment_1_nmm,moment_2_nmm,")
}

/// Refuses an `--out` that is neither new nor an earlier track, and files of others beside it.
///
/// # Errors
/// Where something else is there without `force`, or nothing can be written.
pub(crate) fn check(args: &TrackArgs) -> Result<()> {
    let (out, force) = (&args.out, args.force);
    check_file(out, "track", is_track, force)?;
    // What stands beside an earlier track belongs to it.
    let earlier = out.exists() && is_track(&first_line(out)?);
    let own = |start: &str| start.contains("wcal-track/");
    check_beside(&[companion(out, SUMMARY)], own, force || earlier)?;
    let page = args.live_page.map(|_| companion(out, LIVE_PAGE));
    check_beside(page.as_slice(), |_| false, force || earlier)
}

/// Opens the files of a track; nothing of an earlier one stays beside it.
///
/// # Errors
/// Where one cannot be made.
pub(crate) fn create(out: &Path) -> Result<TrackFiles> {
    // Neither summary nor page of an earlier track may stand beside the new rows.
    let earlier = out.is_file() && is_track(&first_line(out)?);
    for beside in [SUMMARY, LIVE_PAGE].map(|ending| companion(out, ending)) {
        if earlier && beside.is_file() {
            std::fs::remove_file(&beside)
                .with_context(|| format!("replacing {}", beside.display()))?;
        }
    }
    Ok(TrackFiles::create(out)?)
}
