//! What locates the contacts of a stream's whisker: a network, or the known motion.

use super::TrackArgs;
use super::motion;
use anyhow::{Context, Result};
use nalgebra::{Matrix2, Vector3};
use serde_json::{Value, json};
use std::sync::Arc;
use wcal_contact::contact_history::ContactHistory;
use wcal_contact::known_groove::{KnownGroove, KnownPlace};
use wcal_contact::known_motion::contact_stream::FinishedEpisode;
use wcal_contact::known_motion::{Disagreement, Lost};
use wcal_contact::motion_row_tracker::{MotionAccuracy, MotionInput, MotionRowTracker, RowMotion};
use wcal_contact::row_tracker::{RowInput, RowTracker, TrackedRow};
use wcal_contact::session_groove::{innovations_summary, moment_field};
use wcal_contact::stream_motion::KnownAtRow;
use wcal_contact::trust::WhiskerModel;
use wcal_core::WhiskerSpec;
use wcal_core::observation::MomentAxes;
use wcal_core::stream::MomentSpread;
use wcal_track::stream::Row;

/// The moments' table is filled so far from the wire while the stream begins, mm.
const REACH_MM: f64 = 8.0;

/// Along a known motion.
pub struct ByMotion {
    tracker: MotionRowTracker,
    whisker: WhiskerSpec,
    /// Middle of the free wire, and what the calibration adds to the declared place of the groove, mm.
    middle_mm: Vector3<f64>,
    offset_mm: Vector3<f64>,
    /// Beginning of the stream without contact, s.
    prefix_s: f64,
    episodes: Vec<FinishedEpisode>,
}

/// What locates contacts.
pub enum RowLocator<'a> {
    /// A network; its whisker.
    Network(Box<RowTracker<'a>>, WhiskerSpec),
    /// The motion.
    Motion(Box<ByMotion>),
}

impl<'a> RowLocator<'a> {
    /// The network of a whisker, or the known motion where it has none.
    ///
    /// # Errors
    /// Where the wire cannot be bent, or the calibration does not say of which whisker it is.
    pub fn new(args: &TrackArgs, loaded: &'a WhiskerModel<'a>) -> Result<Self> {
        let whisker = loaded.whisker()?.clone();
        if let Some(tracker) = loaded.row_tracker(&loaded.name, args.sweep, args.tare_s) {
            return Ok(Self::Network(Box::new(tracker), whisker));
        }
        let axes = MomentAxes::default();
        let (wire, changed) =
            loaded.calibration()?.wire(&whisker).with_context(|| loaded.place.display().to_string())?;
        let changed = changed.iter().map(|w| moment_field(w, &axes)).collect();
        let field = Arc::new(moment_field(&wire, &axes).with_changed(changed));
        // The prefix is long enough; a reading that comes sooner solves what it needs itself.
        let filled = Arc::clone(&field);
        std::thread::spawn(move || filled.fill(REACH_MM));
        let accuracy = MotionAccuracy { moved_sd_mm: args.motion_sd_mm, clock_sd_s: args.motion_clock_sd_s };
        let middle_mm = field.free(0.5 * field.length_mm()).0;
        let tracker = MotionRowTracker::new(&loaded.name, field, &whisker, accuracy, args.tare_s);
        Ok(Self::Motion(Box::new(ByMotion {
            tracker,
            whisker,
            middle_mm,
            offset_mm: wire.offset_mm,
            prefix_s: args.prefix_s,
            episodes: Vec::new(),
        })))
    }

    /// Takes a row; `relative` gives the motion past the wire's middle, what the moments' spread is made of, and the row's own noise.
    ///
    /// # Errors
    /// For a row that cannot be used.
    pub fn push(
        &mut self,
        row: &Row,
        known: &KnownAtRow,
        relative: impl Fn(&Vector3<f64>) -> (Result<RowMotion, Lost>, MomentSpread, Option<Matrix2<f64>>),
    ) -> Result<TrackedRow> {
        let KnownAtRow { base, base_mm_s, velocity_mm_s } = *known;
        let (t_s, moments) = (row.t_s, row.moments);
        match self {
            Self::Network(tracker, _) => {
                if moments.is_none() {
                    // What happened in between is not known: the tracker starts anew.
                    tracker.restart();
                }
                Ok(tracker.push(&RowInput { t_s, moments, base, base_mm_s, velocity_mm_s }))
            }
            Self::Motion(own) => {
                let (motion, spread, noise_nmm2) = relative(&own.middle_mm);
                let in_prefix = row.touching.is_none() && t_s < own.prefix_s;
                let input =
                    MotionInput { t_s, moments, spread, noise_nmm2, in_prefix, motion, base, base_mm_s };
                Ok(own.tracker.push(&input)?)
            }
        }
    }

    /// The stream is over.
    pub fn end(&mut self) {
        if let Self::Motion(own) = self {
            own.episodes = own.tracker.finish();
        }
    }

    /// Compares answers with the groove of a session's readings.
    pub fn know_groove(&mut self, places: &[KnownPlace]) {
        match self {
            Self::Network(tracker, whisker) => tracker.groove = KnownGroove::new(places.to_vec(), whisker),
            Self::Motion(own) => {
                let moved = |p: &KnownPlace| KnownPlace { groove_mm: p.groove_mm + own.offset_mm, ..*p };
                own.tracker.groove = KnownGroove::new(places.iter().map(moved).collect(), &own.whisker);
            }
        }
    }

    /// The comparison with a known groove.
    pub fn groove(&self) -> Option<&KnownGroove> {
        match self {
            Self::Network(tracker, _) => tracker.groove.as_ref(),
            Self::Motion(own) => own.tracker.groove.as_ref(),
        }
    }

    /// Contact intervals and cloud.
    pub fn history(&self) -> &ContactHistory {
        match self {
            Self::Network(tracker, _) => &tracker.history,
            Self::Motion(own) => &own.tracker.history,
        }
    }

    /// Whether rows are in doubt for their motion, or have none.
    pub fn in_doubt(&self) -> bool {
        match self {
            Self::Network(tracker, _) => tracker.motion.any(),
            Self::Motion(own) => {
                own.tracker.disagreeing() > 0
                    || !own.tracker.lost().is_empty()
                    || own.episodes.iter().any(|e| e.disagreement.is_some())
            }
        }
    }

    /// Says which rows are in doubt for their motion, and how far answers are from a known groove.
    pub fn say(&self, whose: &str, rows: u64) {
        match self {
            Self::Network(tracker, _) => {
                motion::say(&tracker.motion, whose, rows);
                motion::say_several(whose, tracker.several_rows);
            }
            Self::Motion(own) => own.say(whose, rows),
        }
        if let Some(said) = self.groove().and_then(KnownGroove::message) {
            eprintln!("{whose}{said}");
        }
    }

    /// For track.json.
    pub fn summary(&self, loaded: &WhiskerModel<'_>) -> Value {
        match self {
            Self::Network(tracker, _) => json!({
                "untrained_motion": motion::summary(&tracker.motion),
                "several_contacts": motion::several_summary(tracker.several_rows),
                "model_sha256": loaded.network.as_ref().map(|n| &n.card.weights_sha256),
                "trained_on_simulation": loaded.network.as_ref().map(|n| n.card.trained_on_simulation),
            }),
            Self::Motion(own) => {
                let contact = |e: &FinishedEpisode| {
                    let mut contact = innovations_summary(&e.innovations, e.disagreement);
                    contact["regions"] = json!(e.regions);
                    contact["from_s"] = e.span_s[0].into();
                    contact["to_s"] = e.span_s[1].into();
                    contact["readings"] = e.readings.into();
                    contact
                };
                json!({
                    "method": "known-motion", "place": "axis of the wire at the contact, base frame",
                    "end_rmse_mm": own.end_rmse_mm(), "lost_rows": own.tracker.lost(), "disagreeing_rows": own.tracker.disagreeing(),
                    "contacts": own.episodes.iter().map(contact).collect::<Vec<_>>(),
                })
            }
        }
    }
}

impl ByMotion {
    /// RMS error on the known groove at the end of each contact, mm.
    fn end_rmse_mm(&self) -> Option<f64> {
        let spans: Vec<[f64; 2]> = self.episodes.iter().map(|e| e.span_s).collect();
        self.tracker.groove.as_ref()?.end_rmse_mm(&spans)
    }

    fn say(&self, whose: &str, rows: u64) {
        let lost: u64 = self.tracker.lost().values().sum();
        if lost > 0 {
            let why: Vec<String> =
                self.tracker.lost().iter().map(|(name, n)| format!("{name} {n}")).collect();
            eprintln!(
                "warning: {whose}the motion of {lost} of {rows} rows, which are loaded, is not known ({}): each has the arc that its moments \
                 allow; marked motion-lost in status",
                why.join(", ")
            );
        }
        let named = |e: &FinishedEpisode| {
            Some((e.number, e.disagreement.map(Disagreement::sentence)?, e.innovations))
        };
        for (number, said, i) in self.episodes.iter().filter_map(named) {
            eprintln!(
                "warning: {whose}contact {number}: {said} (chi2 {:.0} for {:.0} degrees of freedom); marked motion-disagrees in status",
                i.plain, i.dof
            );
        }
        if let Some(mm) = self.end_rmse_mm() {
            eprintln!("{whose}known groove, last reading of each contact: off by {mm:.2} mm RMS");
        }
        if self.episodes.is_empty() {
            eprintln!("{whose}no contact: no row is loaded beyond its noise where the motion is known");
        }
    }
}
