//! A network as an estimator: filters and network (TrackerStream), then what the motion allows (MotionJudge).

use crate::ContactError;
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings, Message};
use crate::motion_judge::{JudgedRow, MotionJudge, UnjudgedRow};
use crate::reading::Reading;
use crate::track_document::{EstimatorDocument, SeveralContacts};
use wcal_core::stream::Flags;
use wcal_track::filter::FilterBank;
use wcal_track::model_file::Card;
use wcal_track::{Sample, Tracker, TrackerStream};

/// The network of one whisker.
#[derive(Debug)]
pub struct NetworkEstimator<'a> {
    tracker: &'a Tracker,
    card: &'a Card,
    filters: FilterBank,
    stream: TrackerStream<'a>,
    motion: MotionJudge,
    rows: u64,
    /// Rows with a probability of several contacts, and those at which several are more probable than one.
    several_rows: [u64; 2],
}

/// Probability from which on a contact, or a second one, is more probable than not.
const PROBABLE: f32 = 0.5;
/// Contacts of this probability and more are points of the object.
const TOUCHED: f32 = 0.9;

impl<'a> NetworkEstimator<'a> {
    /// Of a model with filters that know the noise of its moments; `vouched`: a motion that is not known is as in training.
    #[must_use]
    pub fn new((tracker, card): (&'a Tracker, &'a Card), filters: FilterBank, vouched: bool) -> Self {
        Self {
            tracker,
            card,
            filters,
            stream: tracker.stream_with(filters),
            motion: MotionJudge::new(&card.training, vouched),
            rows: 0,
            several_rows: [0; 2],
        }
    }
}

impl Estimator for NetworkEstimator<'_> {
    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, ContactError> {
        self.rows += 1;
        if reading.gap {
            // What happened in between is not known: filters, network and judge start anew.
            self.stream = self.tracker.stream_with(self.filters);
            self.motion.restart();
        }
        let Some(moments) = &reading.moments else { return Ok(vec![Contact::default()]) };
        let (t_s, moment_nmm) = (reading.t_s, moments.moment_nmm);
        let answer = self.stream.push(&Sample { t_s, moment_nmm, base_mm_s: reading.base_mm_s });
        let log_evidence = self.stream.log_evidence();
        let (moments, velocity_mm_s) = (moments.stated(), reading.velocity_mm_s);
        let unjudged = UnjudgedRow { t_s, moments, answer, log_evidence, velocity_mm_s };
        let judged = self.motion.judge(unjudged, &self.tracker.inverse);
        let several = several(&judged);
        self.several_rows[0] += u64::from(several.is_some());
        self.several_rows[1] += u64::from(several.is_some_and(|p| p > f64::from(PROBABLE)));
        let JudgedRow { flags, answer, regions } = judged;
        let on_object = answer.contact >= TOUCHED;
        let estimate = Some(ContactEstimate::from(&answer));
        Ok(vec![Contact { estimate, flags, regions, several, number: None, on_object }])
    }

    fn findings(&self) -> Findings {
        let [rows, probable_rows] = self.several_rows;
        let mut messages = self.motion.messages(self.rows);
        if probable_rows > 0 {
            messages.push(Message::note(format!(
                "at {probable_rows} of {rows} rows in contact several contacts are more probable than one (several_probability above 0.5): \
                 the places of the further ones are not estimated"
            )));
        }
        let document = EstimatorDocument {
            model_sha256: Some(self.card.weights_sha256.clone()),
            trained_on_simulation: Some(self.card.trained_on_simulation),
            untrained_motion: Some(self.motion.document()),
            several_contacts: Some(SeveralContacts { rows, probable_rows }),
            ..EstimatorDocument::default()
        };
        Findings { document, messages, doubt: self.motion.any(), ..Findings::default() }
    }
}

/// The network's probability of several contacts where it sees contact in a motion that it may know.
fn several(row: &JudgedRow) -> Option<f64> {
    let knows = row.answer.contact >= PROBABLE && !row.flags.has(Flags::UNTRAINED_MOTION);
    knows.then_some(f64::from(row.answer.several))
}
