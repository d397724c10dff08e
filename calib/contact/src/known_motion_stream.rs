//! Contacts of a stream along a known motion, reading by reading: episodes and recursive posterior ([`ContactStream`]); no network. Where no fixed
//! point of the object explains the moments any more, the contact is followed as one that slides ([`SlidingStream`]), as in a table.
//!
//! Noise: a row's own is that of the no-contact prefix through the filter; the calibration's noise from pose to pose is a draw that rows of
//! one pose share, forgotten over half a millimetre (an assumption); the zero is another two unknowns of all rows ([`crate::zero`]).

use crate::ContactError;
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings, Message};
use crate::known_motion::contact_stream::FinishedEpisode;
use crate::known_motion::{
    ContactStream, CorrelatedNoise, EpisodeContact, MomentField, MotionRow, Region, Settings, StreamedContact,
};
use crate::reading::{Moments, Reading, RowMotion};
use crate::sliding::{SlidingStream, TouchedWire};
use crate::static_arc::StaticArc;
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method};
use nalgebra::Matrix2;
use std::sync::Arc;
use wcal_core::WhiskerSpec;
use wcal_core::observation::MomentAxes;
use wcal_core::stream::Flags;

/// Of an object of which nothing is known the touched point goes on by so much of the motion (standard deviation). An assumption.
pub(crate) const CREEP_SD: f64 = 0.15;
/// Displacement over which a draw of the noise from pose to pose is forgotten, mm. An assumption.
const POSE_MM: f64 = 0.5;
/// Share of the noise from pose to pose that a row has for itself where no prefix was measured. An assumption, as for the filters.
const WHITE: f64 = 0.2;
/// Rows of a contact that are kept for the case that it slides later.
const MAX_BEFORE: usize = 4096;
/// A contact goes on over rows without moments or motion for so long, s: the displacement is known again after them.
const MAX_LOST_S: f64 = 1.0;

/// What is assumed of the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionAccuracy {
    /// Standard deviation of the displacement in each coordinate, mm.
    pub moved_sd_mm: f64,
    /// Standard deviation of the clock's offset, s.
    pub clock_sd_s: f64,
}

/// The estimator of one whisker.
pub struct KnownMotionStream {
    field: Arc<MomentField>,
    accuracy: MotionAccuracy,
    /// See [`Settings::creep_sd`].
    creep_sd: f64,
    /// From the first moments on: they say what their noise is.
    stream: Option<ContactStream>,
    /// For loaded rows whose motion is not known.
    alone: StaticArc,
    whisker: WhiskerSpec,
    /// The contact at hand: its number, its loaded rows until it slides, and what follows it then.
    touch: Option<(u64, Vec<MotionRow>)>,
    sliding: Option<SlidingStream>,
    slid: u64,
    rows: u64,
    disagreeing: u64,
    /// The last row with moments and motion, s.
    last_s: Option<f64>,
    episodes: Vec<FinishedEpisode>,
}

impl KnownMotionStream {
    /// Of a whisker whose wire has the moments of `field`; a groove holds it at one place.
    pub fn new(
        field: Arc<MomentField>,
        whisker: &WhiskerSpec,
        accuracy: MotionAccuracy,
        of_groove: bool,
    ) -> Self {
        Self {
            field,
            accuracy,
            creep_sd: if of_groove { 0.0 } else { CREEP_SD },
            stream: None,
            alone: StaticArc::new(whisker),
            whisker: whisker.clone(),
            touch: None,
            sliding: None,
            slid: 0,
            rows: 0,
            disagreeing: 0,
            last_s: None,
            episodes: Vec::new(),
        }
    }

    /// The motion is known.
    fn along(&mut self, row: &Reading, m: &Moments, motion: &RowMotion) -> Result<Contact, ContactError> {
        let pose_nmm2 = m.pose_nmm2;
        let stream = self.stream.get_or_insert_with(|| {
            let correlated = Some(CorrelatedNoise::ByPose { covariance_nmm2: pose_nmm2, length_mm: POSE_MM });
            let clock_sd_s = self.accuracy.clock_sd_s;
            let settings =
                Settings { clock_sd_s, correlated, creep_sd: self.creep_sd, ..Settings::default() };
            ContactStream::new(Arc::clone(&self.field), settings)
        });
        if self.last_s.replace(row.t_s).is_some_and(|last| row.t_s - last > MAX_LOST_S) {
            stream.interrupt();
        }
        let zero = m.zero_nmm2.cholesky().map_or_else(Matrix2::zeros, |c| c.l());
        let mut shared_nmm = m.shared_nmm.clone();
        shared_nmm.extend(zero.column_iter().map(|c| [c[0], c[1]]));
        let reading = MotionRow {
            t_s: row.t_s,
            moment_nmm: m.moment_nmm,
            noise_nmm2: m.own_nmm2.unwrap_or(pose_nmm2 * WHITE * WHITE),
            shared_nmm,
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm: motion.moved_mm,
            turn: motion.turn,
            velocity_mm_s: motion.velocity_mm_s,
            moved_sd_mm: self.accuracy.moved_sd_mm,
            free: row.in_prefix,
            contact_segment: 0,
        };
        let found = stream.push(&reading, motion.piece, motion.push)?;
        let flags = if found.disagrees { Flags::MOTION_DISAGREES } else { Flags::default() };
        self.disagreeing += u64::from(found.disagrees);
        // Without a noise of its own a row of a sliding contact has that from pose to pose.
        let reading = MotionRow { noise_nmm2: m.own_nmm2.unwrap_or(pose_nmm2), ..reading };
        if let Some((place, regions)) = self.slide(&reading, &found)? {
            self.slid += 1;
            let flags = flags.with(Flags::SLIDING_ASSUMED);
            return Ok(Contact {
                estimate: ContactEstimate::of_place(&place),
                flags,
                regions,
                on_object: true,
                ..Contact::default()
            });
        }
        let estimate = found.place.as_ref().and_then(ContactEstimate::of_place);
        let on_object = found.place.is_some_and(|p| p.contact >= TOUCHED);
        Ok(Contact { estimate, flags, regions: found.regions, on_object, ..Contact::default() })
    }

    /// The contact as one that slides, from where no fixed point explains it on; none before, and where no such contact explains it either.
    fn slide(
        &mut self,
        row: &MotionRow,
        found: &StreamedContact,
    ) -> Result<Option<(EpisodeContact, Vec<Region>)>, ContactError> {
        if self.touch.as_ref().map(|t| t.0) != found.episode {
            (self.touch, self.sliding) = (found.episode.map(|number| (number, Vec::new())), None);
        }
        let Some((_, before)) = self.touch.as_mut().filter(|_| found.loaded) else { return Ok(None) };
        if self.sliding.is_none() && !found.disagrees {
            // Of a long press the first rows say where a contact that slides later began.
            if before.len() < MAX_BEFORE {
                before.push(row.clone());
            }
            return Ok(None);
        }
        let sliding = match &mut self.sliding {
            Some(sliding) => sliding,
            none => {
                let wire = TouchedWire::new(&self.whisker, &MomentAxes::default())?;
                none.insert(SlidingStream::new(wire, &std::mem::take(before)))
            }
        };
        let place = sliding.push(row);
        Ok(place.filter(|_| sliding.explains()))
    }

    fn messages(&self) -> Vec<Message> {
        let mut all = Vec::new();
        if self.slid > 0 {
            all.push(Message::warning(format!(
                "{} of {} rows: no fixed point of the object explains the moments, a contact that slides does, as it does where motion or calibration \
                 are wrong; marked sliding-assumed in status",
                self.slid, self.rows
            )));
        }
        let lost: u64 = self.alone.lost().values().sum();
        if lost > 0 {
            let why: Vec<String> = self.alone.lost().iter().map(|(name, n)| format!("{name} {n}")).collect();
            all.push(Message::warning(format!(
                "the motion of {lost} of {} rows, which are loaded, is not known ({}): each has the arc that its moments allow; marked \
                 motion-lost in status",
                self.rows,
                why.join(", ")
            )));
        }
        let said = |e: &FinishedEpisode| Some((e.number, e.innovations.sentence()?));
        all.extend(self.episodes.iter().filter_map(said).map(|(number, said)| {
            Message::warning(format!("contact {number}: {said}; marked motion-disagrees in status"))
        }));
        if self.episodes.is_empty() {
            all.push(Message::note(
                "no contact: no row is loaded beyond its noise where the motion is known",
            ));
        }
        all
    }
}

/// Contacts of this probability and more are points of the object.
const TOUCHED: f64 = 0.9;

impl Estimator for KnownMotionStream {
    fn push(&mut self, row: &Reading) -> Result<Vec<Contact>, ContactError> {
        self.rows += 1;
        let contact = match (&row.moments, &row.motion) {
            (None, _) => Contact::default(),
            (Some(_), Err(_)) if row.in_prefix => Contact::default(),
            (Some(m), Err(why)) => self.alone.estimate_contact(m, *why)?,
            (Some(m), Ok(motion)) => self.along(row, m, motion)?,
        };
        Ok(vec![contact])
    }

    /// Ends the contact at hand.
    fn finish(&mut self) -> Result<Vec<Contact>, ContactError> {
        self.episodes = self.stream.as_mut().map_or_else(Vec::new, |s| s.finish().to_vec());
        Ok(Vec::new())
    }

    fn findings(&self) -> Findings {
        let lost = !self.alone.lost().is_empty();
        let document = EstimatorDocument {
            method: Some(Method::KnownMotion),
            place: Some(AXIS_OF_WIRE),
            lost_rows: Some(self.alone.lost().clone()),
            disagreeing_rows: Some(self.disagreeing),
            contacts: Some(self.episodes.iter().map(ContactDocument::of_stream).collect()),
            ..EstimatorDocument::default()
        };
        let doubt = self.disagreeing > 0 || lost || self.episodes.iter().any(|e| !e.innovations.consistent());
        let spans_s = Some(self.episodes.iter().map(|e| e.span_s).collect());
        Findings { document, messages: self.messages(), doubt, spans_s, ..Findings::default() }
    }
}
