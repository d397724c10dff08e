//! What the live page shows of a stream that is tracked.

use super::arguments::TrackArgs;
use super::output::LIVE_PAGE;
use crate::live_page::{LivePage, LiveState};
use anyhow::Result;
use std::path::PathBuf;
use std::sync::Arc;
use wcal_track::stream_source::{StreamSource, lost_text};
use wcal_track::track_table::{TrackFiles, companion};
use wcal_track::trust::WhiskerModel;

/// The page of a track.
pub(super) struct LiveTrack {
    page: LivePage,
    place: PathBuf,
    whiskers: Vec<String>,
    /// Duration that was asked for, s.
    asked_s: Option<f64>,
}

impl LiveTrack {
    /// Serves the page where one is asked for.
    ///
    /// # Errors
    /// When the port is taken.
    pub(super) fn open(args: &TrackArgs, loaded: &[WhiskerModel<'_>]) -> Result<Option<Self>> {
        let Some(port) = args.live_page else {
            return Ok(None);
        };
        let mut columns = "t_s".to_owned();
        for one in loaded {
            let own = format!("{}_contact", one.name.replace(' ', "_"));
            for value in ["x_mm", "y_mm", "z_mm", "probability"] {
                columns += &format!(" {}_{value}", own.trim_start_matches('_'));
            }
        }
        let mut state = LiveState::new("track", &args.out, &columns);
        state.status = vec![String::new(); loaded.len()];
        Ok(Some(Self {
            page: LivePage::open(port, &[], state)?,
            place: companion(&args.out, LIVE_PAGE),
            whiskers: loaded.iter().map(|one| one.name.clone()).collect(),
            asked_s: args.seconds,
        }))
    }

    /// Shows every row: its status, and the place where a contact is likelier than none.
    pub(super) fn watch(&self, files: &mut TrackFiles, simulated: bool) {
        let (snapshot, whiskers) = (Arc::clone(&self.page.snapshot), self.whiskers.clone());
        let mut rows = 0;
        files.watch(move |row| {
            rows += 1;
            let k = whiskers.iter().position(|w| *w == row.whisker).unwrap_or(0);
            let estimate = row.contact.estimate;
            let place_mm = estimate.filter(|e| e.probability > 0.5).map(|e| e.place_mm);
            let [x, y, z] = [0, 1, 2].map(|axis| place_mm.map(|mm| mm[axis]));
            snapshot.show(|state| {
                state.simulated = Some(simulated);
                let mut values = state.now.clone();
                values[0] = Some(row.reading.t_s);
                let own = [x, y, z, estimate.map(|e| e.probability)];
                values[4 * k + 1..4 * k + 5].copy_from_slice(&own);
                state.measured(values);
                state.readings = rows;
                let status = format!("{} {}", row.whisker, row.contact.flags.text());
                state.status[k] = status.trim_start().to_owned();
            });
        });
    }

    /// Shows how far the stream has come, in scans and s.
    pub(super) fn stream(&self, stream: &StreamSource<'_>, scans: u64, at_s: f64) {
        self.page.snapshot.show(|state| {
            state.scans = scans;
            state.left_s = self.asked_s.map(|all_s| (all_s - at_s).max(0.0));
            losses(state, stream, 0);
        });
    }

    /// The last state, which stays beside the table; `dropped`: scans that the tracker was late for.
    pub(super) fn end<T>(self, tracked: &Result<T>, stream: &StreamSource<'_>, dropped: u64) {
        self.page.end(&self.place, |state| {
            state.ending = if tracked.is_ok() {
                "finished"
            } else {
                "stopped"
            };
            state.cause = tracked.as_ref().err().map(|e| format!("{e:#}"));
            losses(state, stream, dropped);
        });
    }
}

fn losses(state: &mut LiveState, stream: &StreamSource<'_>, dropped: u64) {
    state.lost_scans = stream.lost()[0];
    state.warnings = lost_text(stream.lost(), dropped).into_iter().collect();
    state
        .warnings
        .extend(stream.clock_faults().iter().map(ToString::to_string));
}
