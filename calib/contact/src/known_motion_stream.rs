//! Contacts reading by reading, of a stream along its motion or of readings of whose motion nothing is known: episodes and recursive posteriors
//! ([`ContactStream`]), or the arc that the moments allow ([`StaticArc`]); no network. Where a point
//! that stays does not explain the moments, the contact is followed as one that slides ([`SlidingStream`]), too; each way has its weight
//! ([`crate::regimes`]), anew with each block of readings.
//!
//! Noise: a row's own is that of the no-contact prefix through the filter; the calibration's noise from pose to pose is a draw that rows of
//! one pose share, forgotten over half a millimetre (an assumption); the zero is another two unknowns of all rows ([`crate::zero`]).

use crate::ContactError;
use crate::arc_posterior::ArcDensity;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, Estimator, Findings};
use crate::known_motion::contact_stream::FinishedEpisode;
use crate::known_motion::{
    ContactStream, CorrelatedNoise, EpisodeContact, MotionRow, Settings, StreamedContact,
};
use crate::reading::{Moments, MotionAccuracy, Reading, RowMotion};
use crate::regimes::{
    ANY_OBJECT, Alternative, CREEP_SDS, ContactWeights, GAIN, GROOVE, MIN_WEIGHT, OUT, Regime, RegimeWeights,
    Weighed,
};
use crate::sliding::{Blocks, SlidingStream};
use crate::static_arc::StaticArc;
use crate::track_document::{AXIS_OF_WIRE, ContactDocument, EstimatorDocument, Method, POINT_OF_OBJECT};
use nalgebra::{Matrix2, Vector3};
use std::sync::Arc;
use wcal_core::stream::Flags;

/// Displacement over which a draw of the noise from pose to pose is forgotten, mm. An assumption.
const POSE_MM: f64 = 0.5;
/// Share of the noise from pose to pose that a row has for itself where no prefix was measured. An assumption, as for the filters.
const WHITE: f64 = 0.2;
/// Rows of a contact that are kept for the case that it slides later, and blocks by which it is weighed.
const MAX_BEFORE: usize = 4096;
const MAX_BLOCKS: usize = 60;
/// Fewer blocks say nothing of how a contact moves.
const MIN_BLOCKS: usize = 3;
/// A contact goes on over rows without moments or motion for so long, s: the displacement is known again after them.
const MAX_LOST_S: f64 = 1.0;

/// The contact at hand.
struct Touch {
    number: u64,
    push: Vector3<f64>,
    /// The last free row before it, its loaded rows until it is followed as one that slides, and their blocks.
    before: Option<MotionRow>,
    rows: Vec<MotionRow>,
    blocks: Blocks,
    sliding: Option<SlidingStream>,
    weights: ContactWeights,
}

/// The estimator of one whisker.
pub struct KnownMotionStream {
    wire: CalibratedWire,
    accuracy: MotionAccuracy,
    prior: RegimeWeights,
    /// From the first moments on: they say what their noise is.
    stream: Option<ContactStream>,
    /// For loaded rows whose motion is not known.
    alone: StaticArc,
    touch: Option<Touch>,
    free: Option<MotionRow>,
    slid: u64,
    rows: u64,
    disagreeing: u64,
    /// The last row with moments and motion, s.
    last_s: Option<f64>,
    episodes: Vec<FinishedEpisode>,
}

impl KnownMotionStream {
    /// Of a whisker's wire; a groove holds it at one place.
    pub fn new(wire: CalibratedWire, accuracy: MotionAccuracy, of_groove: bool) -> Self {
        Self {
            alone: StaticArc::new(wire.clone()),
            wire,
            accuracy,
            prior: if of_groove { GROOVE } else { ANY_OBJECT },
            stream: None,
            touch: None,
            free: None,
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
            let fixed = Settings { correlated, ..self.wire.settings(&self.accuracy) };
            let mut settings = vec![fixed];
            if self.prior.of(Regime::Creeping) > 0.0 {
                settings.extend(CREEP_SDS.map(|creep_sd| Settings { creep_sd, ..fixed }));
            }
            ContactStream::new(Arc::clone(&self.wire.field), settings)
        });
        if self.last_s.replace(row.t_s).is_some_and(|last| row.t_s - last > MAX_LOST_S) {
            stream.interrupt();
        }
        let Some(reading) = self.wire.row(row, &self.accuracy) else { return Ok(Contact::default()) };
        // What is not the row's own noise is the draw of its pose, which the posterior carries.
        let own_nmm2 = m.own_nmm2.unwrap_or(pose_nmm2 * WHITE * WHITE);
        let own = MotionRow { noise_nmm2: own_nmm2, free_nmm2: None, ..reading.clone() };
        let found = stream.push(&own, motion.piece, motion.push)?;
        let reading = MotionRow { free_nmm2: None, ..reading };
        let slid = self.weigh(&reading, &found, pose_nmm2)?;
        let weights = self.touch.as_ref().map_or(ContactWeights::prior(self.prior), |t| t.weights);
        let each = weights.points().into_iter().zip(&found.places);
        let mut all: Vec<Alternative> = each
            .map(|((weight, ..), (place, arc))| Alternative {
                weight,
                place: place.clone(),
                arc: arc.clone(),
            })
            .collect();
        let weight = weights.regimes.of(Regime::Sliding);
        all.extend(slid.map(|(place, arc)| Alternative { weight, place, arc }));
        // Outside of a contact nothing is in doubt.
        let flags = match found.loaded {
            true => weights.flags(found.disagrees, false),
            false if found.disagrees && !weights.slides() => Flags::MOTION_DISAGREES,
            false => Flags::default(),
        };
        self.disagreeing += u64::from(flags.has(Flags::MOTION_DISAGREES));
        self.slid += u64::from(flags.has(Flags::SLIDING_ASSUMED));
        Ok(Contact::averaged(&all, flags, |place| place.contact >= TOUCHED))
    }

    /// Weighs the contact at hand where a block of its readings is complete; where it is as one that slides.
    fn weigh(
        &mut self,
        row: &MotionRow,
        found: &StreamedContact,
        pose_nmm2: Matrix2<f64>,
    ) -> Result<Option<(EpisodeContact, ArcDensity)>, ContactError> {
        let Some((number, push)) = found.episode else {
            (self.touch, self.free) = (None, (!found.loaded).then(|| row.clone()));
            return Ok(None);
        };
        if self.touch.as_ref().is_none_or(|t| t.number != number) {
            self.touch = Some(Touch {
                number,
                push,
                before: self.free.take(),
                rows: Vec::new(),
                blocks: Blocks::default(),
                sliding: None,
                weights: ContactWeights::prior(self.prior),
            });
        }
        let Some(touch) = self.touch.as_mut().filter(|_| found.loaded) else { return Ok(None) };
        let complete = touch.blocks.push(row);
        let slid = match &mut touch.sliding {
            Some(sliding) => sliding.push(row),
            None if touch.rows.len() < MAX_BEFORE => {
                touch.rows.push(row.clone());
                None
            }
            None => None,
        };
        let blocks = touch.blocks.means.len();
        if !complete || !(MIN_BLOCKS..MAX_BLOCKS).contains(&blocks) {
            return Ok(slid);
        }
        // The noise from pose to pose is one draw for a block.
        let noisy = |row: &MotionRow| MotionRow { noise_nmm2: row.noise_nmm2 + pose_nmm2, ..row.clone() };
        let weighed = Weighed {
            field: &self.wire.field,
            settings: self.wire.settings(&self.accuracy),
            push: touch.push,
            before: touch.before.as_ref().map(noisy),
            blocks: touch.blocks.means.at_middles().iter().map(noisy).collect(),
            factors: false,
        };
        let sliding = touch.sliding.as_ref().and_then(SlidingStream::ln_evidence);
        let sliding = sliding.filter(|(_, solved)| *solved == blocks).map_or(OUT, |s| s.0);
        touch.weights = weighed.evidence(self.prior, [sliding, OUT], false).weights(&[]);
        if touch.sliding.is_none() && (found.disagrees || touch.weights.regimes.of(Regime::Fixed) < 0.5) {
            touch.sliding = Some(SlidingStream::new(self.wire.touched()?, &std::mem::take(&mut touch.rows)));
        }
        Ok(slid.filter(|_| touch.weights.regimes.of(Regime::Sliding) > MIN_WEIGHT))
    }

    fn messages(&self) -> Vec<String> {
        let mut all = Vec::new();
        if self.slid > 0 {
            all.push(format!(
                "warning: {} of {} rows: no fixed point of the object explains the moments, a contact that slides does; where it ends is not seen yet; marked \
                 sliding-assumed in status",
                self.slid, self.rows
            ));
        }
        let lost: u64 = self.alone.lost().values().sum();
        if lost > 0 {
            let why: Vec<String> = self.alone.lost().iter().map(|(name, n)| format!("{name} {n}")).collect();
            all.push(format!(
                "warning: the motion of {lost} of {} rows, which are loaded, is not known ({}; --motion, --model): each has the arc that its moments allow; \
                 marked motion-lost in status",
                self.rows,
                why.join(", ")
            ));
        }
        let said = |e: &FinishedEpisode| Some((e.number, e.innovations.sentence()?));
        all.extend(self.episodes.iter().filter_map(said).map(|(number, said)| {
            format!("warning: contact {number}: {said}; marked motion-disagrees in status")
        }));
        if !self.episodes.is_empty() {
            all.push(GAIN.to_owned());
        }
        if self.episodes.is_empty() && self.stream.is_some() {
            all.push("no contact: no row is loaded beyond its noise where the motion is known".to_owned());
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
        let (method, place) = match self.stream.is_some() {
            true => (Method::KnownMotion, AXIS_OF_WIRE),
            false => (Method::StaticArc, POINT_OF_OBJECT),
        };
        let document = EstimatorDocument {
            method: Some(method),
            place: Some(place),
            lost_rows: Some(self.alone.lost().clone()),
            disagreeing_rows: Some(self.disagreeing),
            contacts: Some(self.episodes.iter().map(ContactDocument::of_stream).collect()),
            ..EstimatorDocument::default()
        };
        let doubt = self.disagreeing > 0 || lost || self.episodes.iter().any(|e| !e.innovations.consistent());
        let spans_s = self.stream.as_ref().map(|_| self.episodes.iter().map(|e| e.span_s).collect());
        Findings { document, messages: self.messages(), doubt, spans_s, ..Findings::default() }
    }
}
