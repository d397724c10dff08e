//! Contacts along a known motion, fed reading by reading by a table, a recording or a live stream; no
//! network.
//!
//! ```text
//! stream      a reading is answered at once, from those up to it                                   (contact_so_far)
//! record      answers are stated in the end, each from all readings of its contact                 (whole_contact)
//! no motion   of a stream: the arc of the wire that the moments of a loaded reading allow          (arc)
//! ```
//!
//! Noise of a stream: a row's own is that of the no-contact prefix through the filter; the
//! calibration's noise from pose to pose is a draw that rows of one pose share, forgotten over half
//! a millimetre (an assumption); the zero is another two unknowns of all rows ([`crate::zero`]).

use crate::TrackError;
use crate::arc::StaticArc;
use crate::calibrated_wire::CalibratedWire;
use crate::contact_so_far::ContactSoFar;
use crate::estimator::{Contact, Estimator, Findings};
use crate::known_motion::{CorrelatedNoise, MotionRow, Segmenter, Settings, Step, check_row};
use crate::reading::{Moments, MotionAccuracy, Reading, RowMotion};
use crate::regimes::{Assumed, GAIN, RegimeWeights};
use crate::track_document::{
    AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method, POINT_OF_OBJECT,
};
use crate::whole_contact::{Known, located};
use crate::zero::WHITE;
use std::collections::BTreeMap;
use wcal_core::stream::Flags;
use wcal_session::MotionUnknown;

/// Displacement over which a draw of the noise from pose to pose is forgotten, mm. An assumption.
const POSE_MM: f64 = 0.5;
/// A contact goes on over rows without moments or motion for so long, s: the displacement is known
/// again after them.
const MAX_LOST_S: f64 = 1.0;

/// A contact of which no reading follows.
struct Ended {
    document: ContactDocument,
    /// For people.
    said: Vec<String>,
    doubted: bool,
}

/// The estimator of one whisker.
pub struct ContactTracker {
    of: Assumed,
    accuracy: MotionAccuracy,
    /// Of a stream: the contact at hand, and the time of the last row (s) with its number of common
    /// unknowns.
    segmenter: Segmenter,
    contact: Option<ContactSoFar>,
    last: Option<(f64, usize)>,
    /// Of a record: readings along their motion, and all answers until they are stated.
    is_record: bool,
    known: Vec<Known>,
    answers: Vec<Contact>,
    /// For readings whose motion is not known, and how many there are by why; of a stream those
    /// that are loaded.
    alone: StaticArc,
    lost: BTreeMap<&'static str, u64>,
    readings: usize,
    /// Rows of a stream that slide, and at which moments and motion do not belong together.
    slid: u64,
    disagreeing: u64,
    ended: Vec<Ended>,
}

impl ContactTracker {
    /// Of a whisker's wire, by readings that are answered in the end; `prior`: how a contact may
    /// move on what it touches.
    pub fn of_record(wire: CalibratedWire, accuracy: MotionAccuracy, prior: RegimeWeights) -> Self {
        Self {
            is_record: true,
            ..Self::of_stream(wire, accuracy, prior)
        }
    }

    /// By readings that are answered at once.
    pub fn of_stream(wire: CalibratedWire, accuracy: MotionAccuracy, prior: RegimeWeights) -> Self {
        Self {
            segmenter: Segmenter::new(&wire.field),
            contact: None,
            last: None,
            is_record: false,
            known: Vec::new(),
            answers: Vec::new(),
            alone: StaticArc::new(wire.clone()),
            lost: BTreeMap::new(),
            readings: 0,
            slid: 0,
            disagreeing: 0,
            ended: Vec::new(),
            of: Assumed {
                settings: wire.settings(&accuracy),
                wire,
                prior,
            },
            accuracy,
        }
    }

    /// Whether readings had a motion.
    fn is_along(&self) -> bool {
        self.is_record || self.last.is_some()
    }

    /// A reading of a stream whose motion is known.
    fn along(
        &mut self,
        row: MotionRow,
        m: &Moments,
        motion: &RowMotion,
    ) -> Result<Contact, TrackError> {
        let (last_s, shared) = self
            .last
            .unwrap_or((f64::NEG_INFINITY, row.shared_nmm.len()));
        check_row(&row, last_s, shared, "reading of a stream")?;
        self.last = Some((row.t_s, shared));
        if row.t_s - last_s > MAX_LOST_S {
            self.segmenter.interrupt();
        }
        // What is not the row's own noise is the draw of its pose, which the posterior carries.
        let by_pose = CorrelatedNoise::ByPose {
            covariance_nmm2: m.pose_nmm2,
            length_mm: POSE_MM,
        };
        let settings = Settings {
            correlated: Some(by_pose),
            ..self.of.settings
        };
        // A free wire shows the draw of its pose, too: not a reading's own noise alone.
        let mut row = MotionRow {
            free_nmm2: None,
            ..row
        };
        // Where the own noise is not known, the white share of that of the pose stands for it.
        let noise_nmm2 = m.own_nmm2.unwrap_or(m.pose_nmm2 * WHITE * WHITE);
        let mut own = MotionRow {
            noise_nmm2,
            ..row.clone()
        };
        let is_loaded = settings.is_loaded(&own);
        let step = self
            .segmenter
            .push(&mut own, motion.piece, motion.push, is_loaded);
        row.contact_segment = own.contact_segment;
        match step {
            Step::Within => self
                .contact
                .iter_mut()
                .for_each(|c| c.push(&self.of.wire.field, &own)),
            Step::Begins(beginning) => {
                self.end();
                self.contact = ContactSoFar::begin(&self.of, settings, beginning);
            }
            Step::Outside => self.end(),
        }
        let Some(contact) = &mut self.contact else {
            return Ok(Contact::default());
        };
        let stated = contact.stated(&self.of, &row, (is_loaded, m.pose_nmm2))?;
        self.disagreeing += u64::from(stated.flags.has(Flags::MOTION_DISAGREES));
        self.slid += u64::from(stated.flags.has(Flags::SLIDING_ASSUMED));
        Ok(stated)
    }

    /// Ends the contact at hand.
    fn end(&mut self) {
        let long_enough = self.segmenter.take_ended().is_some();
        let Some(contact) = self.contact.take().filter(|_| long_enough) else {
            return;
        };
        let said = contact.innovations().sentence().into_iter();
        let said = said.map(|said| format!("{said}; marked motion-disagrees in status"));
        self.ended.push(Ended {
            document: contact.document(),
            doubted: said.len() > 0,
            said: said.collect(),
        });
    }

    fn messages(&self) -> Vec<String> {
        let (mut all, readings) = (Vec::new(), self.readings);
        if self.slid > 0 {
            all.push(format!(
                "warning: {} of {readings} rows: no fixed point of the object explains the moments, a contact that slides does; where it ends is not seen \
                 yet; marked sliding-assumed in status",
                self.slid
            ));
        }
        let lost: u64 = self.lost.values().sum();
        if lost > 0 {
            let why = self.lost.iter().map(|(name, n)| format!("{name} {n}"));
            let why = why.collect::<Vec<_>>().join(", ");
            all.push(match self.is_record {
                true => format!("the motion of {lost} of {readings} readings is not known ({why}); marked motion-lost in status"),
                false => format!(
                    "warning: the motion of {lost} of {readings} rows, which are loaded, is not known ({why}; --motion, --model): each has the arc that its \
                     moments allow; marked motion-lost in status"
                ),
            });
        }
        let warning = if self.is_record { "" } else { "warning: " };
        let said = self
            .ended
            .iter()
            .enumerate()
            .flat_map(|(n, e)| e.said.iter().map(move |said| (n, said)));
        all.extend(said.map(|(n, said)| format!("{warning}contact {n}: {said}")));
        let by_gain_mm = self
            .ended
            .iter()
            .filter_map(|e| e.document.mm_by_gain_percent)
            .fold(0.0, f64::max);
        if by_gain_mm > 0.0 {
            all.push(format!(
                "{GAIN}; 1 % of gain moves a contact by up to {by_gain_mm:.2} mm"
            ));
        } else if !self.is_record && !self.ended.is_empty() {
            all.push(GAIN.to_owned());
        }
        if self.ended.is_empty() && self.is_along() {
            let none =
                "no contact: no reading is loaded beyond its noise where the motion is known";
            all.push(none.to_owned());
        }
        all
    }
}

impl Estimator for ContactTracker {
    fn assumes(&self) -> String {
        self.of.wire.assumes()
    }

    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, TrackError> {
        let number = self.readings;
        self.readings += 1;
        let row = self.of.wire.row(reading, &self.accuracy);
        let lost = &mut self.lost;
        let mut lose = |why: MotionUnknown| *lost.entry(why.name()).or_default() += 1;
        let contact = match (&reading.moments, reading.motion, row) {
            (Some(m), Ok(motion), Some(row)) if self.is_record => {
                self.known.push(Known::new(number, row, m, &motion));
                Contact::default()
            }
            (Some(m), Ok(motion), Some(row)) => self.along(row, m, &motion)?,
            (_, Err(why), _) if self.is_record => {
                lose(why);
                Contact {
                    flags: Flags::MOTION_LOST,
                    ..Contact::default()
                }
            }
            // In the prefix the noise is not known yet, and nothing may touch.
            (Some(m), Err(why), _) if !reading.in_prefix => {
                let contact = self.alone.estimate_contact(m)?;
                contact.estimate.iter().for_each(|_| lose(why));
                contact
            }
            _ => Contact::default(),
        };
        if self.is_record {
            self.answers.push(contact);
            return Ok(Vec::new());
        }
        Ok(vec![contact])
    }

    fn finish(&mut self) -> Result<Vec<Contact>, TrackError> {
        self.segmenter.interrupt();
        self.end();
        let contacts = located(&self.of, std::mem::take(&mut self.known))?;
        for (n, contact) in contacts.iter().enumerate() {
            for (k, number) in contact.numbers.iter().enumerate() {
                let stated = contact.stated(k, &mut self.alone)?;
                self.answers[*number] = Contact {
                    number: Some(n as u64),
                    ..stated
                };
            }
            self.ended.push(Ended {
                document: contact.document(),
                said: contact.sentences(),
                doubted: !contact.flags().none(),
            });
        }
        Ok(std::mem::take(&mut self.answers))
    }

    fn findings(&self) -> Findings {
        let (is_lost, is_stream) = (!self.lost.is_empty(), !self.is_record);
        let (method, place) = if self.is_along() {
            (Method::KnownMotion, AXIS_OF_WIRE)
        } else {
            (Method::StaticArc, POINT_OF_OBJECT)
        };
        let contacts = self.ended.iter().map(|e| e.document.clone());
        let contacts: Vec<ContactDocument> = contacts.collect();
        let span_s = |c: &ContactDocument| Some([c.from_s?, c.to_s?]);
        Findings {
            messages: self.messages(),
            lost: is_lost && self.is_record,
            doubt: self.ended.iter().any(|e| e.doubted)
                || is_stream && (self.disagreeing > 0 || is_lost),
            spans_s: (is_stream && self.is_along())
                .then(|| contacts.iter().filter_map(span_s).collect()),
            document: EstimatorDocument {
                method: Some(method),
                place: Some(place),
                lost_rows: Some(self.lost.clone()),
                disagreeing_rows: is_stream.then_some(self.disagreeing),
                contacts: Some(contacts),
                ..EstimatorDocument::default()
            },
            ..Findings::default()
        }
    }
}
