//! The one loop of tracking: a source's readings through the tracks of their whiskers to the files,
//! of a table, a session, a recording or a live stream.

use crate::TrackError;
use crate::reading::Reading;
use crate::track_table::TrackFiles;
use crate::whisker_track::WhiskerTrack;
use std::time::{Duration, Instant};
use wcal_core::stream::Flags;

/// Rows stay in memory no longer than this where a source is slow.
const FLUSH: Duration = Duration::from_millis(500);

/// What a source gives next.
pub enum Input {
    /// A reading of a whisker, by its number.
    Reading(usize, Box<Reading>),
    /// Nothing for now.
    Idle,
}

/// Takes all that a source gives; whatever ends it, what was read is tracked to its end and
/// written. Gives the time that the tracks took.
///
/// # Errors
/// What the source fails with, a reading that cannot be used, a disk that takes no more.
pub fn track<E: From<TrackError>>(
    source: impl IntoIterator<Item = Result<Input, E>>,
    tracks: &mut [WhiskerTrack<'_>],
    files: &mut TrackFiles,
) -> Result<Duration, E> {
    let (mut flushed, mut spent, mut fault) = (Instant::now(), Duration::ZERO, None);
    for input in source {
        let taken = input.and_then(|input| {
            if let Input::Reading(whisker, reading) = input {
                let begun = Instant::now();
                let rows = tracks[whisker].push(*reading)?;
                rows.iter().try_for_each(|row| files.row(row))?;
                spent += begun.elapsed();
            }
            Ok(())
        });
        if let Err(why) = taken {
            fault = Some(why);
            break;
        }
        if flushed.elapsed() > FLUSH {
            files.flush()?;
            flushed = Instant::now();
        }
    }
    for track in tracks {
        track.finish()?.iter().try_for_each(|row| files.row(row))?;
        // Known at the end alone.
        if track.coverage_rejected() {
            files.flag(track.name(), Flags::GROOVE_MISSED)?;
            track.flag_all();
        }
    }
    files.flush()?;
    fault.map_or(Ok(spent), Err)
}
