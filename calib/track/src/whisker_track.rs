//! The track of one whisker: readings in, rows out, whatever the source and the estimator.
//!
//! ```text
//! reading -> zero -> frame of the wire -> estimator -> contact -> base frame -> known groove, contact intervals -> row
//! ```

use crate::TrackError;
use crate::estimator::{Contact, Estimator};
use crate::frame::{in_base_frame, in_wire_frame};
use crate::groove_comparison::coverage_rejected;
use crate::known_groove::KnownGroove;
use crate::mesh_score::{KnownObject, MeshScore};
use crate::reading::Reading;
use crate::track_document::WhiskerDocument;
use crate::track_table::TrackRow;
use crate::zero::Zero;
use std::collections::VecDeque;
use wcal_core::WireFrame;
use wcal_core::verify_document::GrooveTracking;
use wcal_network::segments::SegmentFinder;

/// What stands beside the rows of a whisker.
#[derive(Debug, Clone, Default)]
pub struct WhiskerFacts {
    /// Name among several, or empty.
    pub name: String,
    /// Codes of what speaks against calibration or model, and sentences.
    pub doubt_codes: String,
    /// See `doubt_codes`.
    pub doubts: Vec<String>,
    /// Hash of the calibration's content.
    pub calibration_sha256: String,
}

/// The track of one whisker.
pub struct WhiskerTrack<'a> {
    facts: WhiskerFacts,
    frame: WireFrame,
    estimator: Box<dyn Estimator + 'a>,
    zero: Zero,
    /// Readings that wait for their contacts.
    pending: VecDeque<Reading>,
    /// Contact intervals; none where each reading stands by itself.
    segments: SegmentFinder,
    followed: bool,
    last_s: Option<f64>,
    /// The groove that the answers are compared with, where it is known.
    pub groove: Option<KnownGroove>,
    /// The object that is passed, where its place is known.
    pub object: Option<KnownObject>,
    /// Distances of the contacts on it, mm.
    distances_mm: Vec<f64>,
    rows: u64,
    flagged: u64,
    outside: u64,
}

impl<'a> WhiskerTrack<'a> {
    /// Of an estimator in the frame of its wire; `tare_s`: time at the beginning whose mean moments
    /// are the zero; `followed`: contacts have intervals.
    pub fn new(
        facts: WhiskerFacts,
        (frame, estimator): (WireFrame, Box<dyn Estimator + 'a>),
        tare_s: f64,
        followed: bool,
    ) -> Self {
        let segments = SegmentFinder::new(&facts.name);
        Self {
            facts,
            frame,
            estimator,
            zero: Zero::new(tare_s),
            pending: VecDeque::new(),
            segments,
            followed,
            last_s: None,
            groove: None,
            object: None,
            distances_mm: Vec::new(),
            rows: 0,
            flagged: 0,
            outside: 0,
        }
    }

    /// Takes the next reading in order of time; the rows that are settled now.
    ///
    /// # Errors
    /// For a reading that cannot be used.
    pub fn push(&mut self, reading: Reading) -> Result<Vec<TrackRow>, TrackError> {
        let t_s = reading.t_s;
        let moments = reading.moments.clone().map(|m| self.zero.applied(t_s, m));
        let reading = Reading { moments, ..reading };
        let contacts = self.estimator.push(&in_wire_frame(&self.frame, &reading))?;
        self.pending.push_back(reading);
        Ok(self.settle(contacts))
    }

    /// No reading follows: the rows that are left.
    ///
    /// # Errors
    /// As for `push`.
    pub fn finish(&mut self) -> Result<Vec<TrackRow>, TrackError> {
        let contacts = self.estimator.finish()?;
        Ok(self.settle(contacts))
    }

    fn settle(&mut self, contacts: Vec<Contact>) -> Vec<TrackRow> {
        let row = |contact| {
            let reading = self.pending.pop_front()?;
            Some(self.row(reading, contact))
        };
        contacts.into_iter().map_while(row).collect()
    }

    fn row(&mut self, reading: Reading, contact: Contact) -> TrackRow {
        let (t_s, base_mm_s) = (reading.t_s, reading.base_mm_s);
        let estimate = contact.estimate.map(|e| in_base_frame(&self.frame, e));
        if let (Some(groove), Some(estimate)) = (&mut self.groove, &estimate) {
            groove.push(t_s, estimate);
        }
        let step_s = self.last_s.replace(t_s).map_or(0.0, |last| t_s - last);
        if reading.gap || estimate.is_none() {
            self.segments.gap();
        }
        let segment = estimate.as_ref().and_then(|e| {
            let step_mm = base_mm_s.unwrap_or(0.0) * step_s;
            self.segments
                .push(t_s, e.probability, e.place_mm, e.covariance_mm2, step_mm)
        });
        let mut row = TrackRow {
            whisker: self.facts.name.clone(),
            doubts: self.facts.doubt_codes.clone(),
            assumes: estimate.map_or_else(String::new, |_| self.estimator.assumes()),
            object_mm: None,
            contact: Contact {
                estimate,
                flags: reading.flags.with(contact.flags),
                number: contact.number.or(segment.filter(|_| self.followed)),
                ..contact
            },
            reading,
        };
        let object = self.object.as_ref().zip(row.world());
        row.object_mm = object.map(|(object, (world_mm, _))| object.distance_mm(&world_mm));
        let on_object = row.object_mm.filter(|_| row.contact.on_object);
        self.distances_mm.extend(on_object);
        let moments = row.reading.moments.as_ref();
        self.rows += 1;
        self.flagged += u64::from(!row.contact.flags.none());
        self.outside += u64::from(moments.is_some_and(|m| !m.valid));
        row
    }

    /// Whether the stated regions do not hold a known groove.
    pub(crate) fn coverage_rejected(&self) -> bool {
        let known = self.groove.as_ref();
        let of_session = self.estimator.findings().groove.flatten();
        of_session.as_ref().is_some_and(coverage_rejected)
            || known.is_some_and(KnownGroove::coverage_rejected)
    }

    /// All of its rows are flagged.
    pub(crate) fn flag_all(&mut self) {
        self.flagged = self.rows;
    }

    /// Distances of the contacts on the object; none without one, or for few contacts.
    pub fn object_score(&self) -> Option<MeshScore> {
        MeshScore::new(self.distances_mm.clone())
    }

    /// Name among several, or empty.
    pub fn name(&self) -> &str {
        &self.facts.name
    }

    /// What was found: for track.json, for people, and for the exit code.
    pub fn findings(&self) -> TrackFindings {
        let found = self.estimator.findings();
        let groove = self.groove.as_ref();
        let end_rmse_mm = found.spans_s.map(|spans_s| groove?.end_rmse_mm(&spans_s));
        let mut messages = found.messages;
        if let Some(mm) = end_rmse_mm.flatten() {
            messages.push(format!(
                "known groove, last reading of each contact: off by {mm:.2} mm RMS"
            ));
        }
        messages.extend(groove.and_then(KnownGroove::message));
        let document = WhiskerDocument {
            rows: self.rows,
            flagged_rows: self.flagged,
            outside_valid_region: self.outside,
            doubts: self.facts.doubts.clone(),
            calibration_sha256: self.facts.calibration_sha256.clone(),
            segments: self.followed.then(|| self.segments.all()),
            known_groove: groove.and_then(KnownGroove::score),
            end_rmse_mm,
            estimator: found.document,
        };
        TrackFindings {
            document,
            messages,
            outcome: Outcome {
                outside: self.outside > 0,
                coverage_rejected: self.coverage_rejected(),
                lost: found.lost,
                doubt: found.doubt,
            },
            groove: found.groove,
        }
    }
}

/// What a track found.
#[derive(Debug, Clone)]
pub struct TrackFindings {
    /// For track.json.
    pub document: WhiskerDocument,
    /// For people.
    pub messages: Vec<String>,
    /// For the exit code.
    pub outcome: Outcome,
    /// Groove of a session against the answers; none inside where nothing was compared.
    pub groove: Option<Option<GrooveTracking>>,
}

/// What speaks against the rows that were written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Outcome {
    /// Rows lie outside the calibration's valid region.
    pub outside: bool,
    /// Stated regions do not hold a known groove.
    pub coverage_rejected: bool,
    /// Readings were lost, dropped or unusable.
    pub lost: bool,
    /// Contact in a motion of which the estimator knows nothing, or that does not belong to the
    /// moments.
    pub doubt: bool,
}

impl Outcome {
    /// Both.
    pub fn and(self, other: Self) -> Self {
        Self {
            outside: self.outside || other.outside,
            coverage_rejected: self.coverage_rejected || other.coverage_rejected,
            lost: self.lost || other.lost,
            doubt: self.doubt || other.doubt,
        }
    }

    /// Why the exit code is not 0, and what to do.
    pub fn sentence(self, forced: bool) -> Option<String> {
        let code = self.exit_code(forced);
        let why = [
            (
                self.outside && !forced,
                "readings lie outside the valid region: calibrate up to their moments, or take them with --force",
            ),
            (
                self.coverage_rejected,
                "stated regions do not hold the known groove: look for a groove that moved, or verify the calibration anew",
            ),
            (
                self.lost,
                "readings were lost, unusable or without motion: see status in the table, and mend their source",
            ),
            (
                self.doubt,
                "rows are in doubt: take those that say ok in status; the lines above say what explains the others",
            ),
        ];
        let why: Vec<&str> = why.into_iter().filter(|w| w.0).map(|w| w.1).collect();
        (code != 0).then(|| format!("exit code {code}: {}", why.join("; ")))
    }

    /// Exit code of the program: 4 before 3 before 0; `forced`: the user takes what is not good
    /// enough.
    pub fn exit_code(self, forced: bool) -> u8 {
        match (
            (self.outside || self.coverage_rejected) && !forced,
            self.lost || self.doubt || self.coverage_rejected,
        ) {
            (true, _) => 4,
            (false, true) => 3,
            (false, false) => 0,
        }
    }
}
