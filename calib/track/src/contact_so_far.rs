//! The contact at hand of a stream: what is known of it after each reading.
//!
//! A point that stays or creeps has its recursive posteriors. Where a point that stays does not
//! explain the moments, the contact is followed as one that slides ([`SlidingStream`]), too; each
//! way has its weight ([`crate::regimes`]), anew with each block of readings.

use crate::TrackError;
use crate::arc_posterior::{ArcDensity, Region};
use crate::calibrated_wire::Assumed;
use crate::estimator::Contact;
use crate::known_motion::segmenter::Beginning;
use crate::known_motion::{
    EpisodeContact, Innovations, MomentField, MotionRow, RecursivePosterior, Settings,
};
use crate::regimes::{Alternative, CREEP_SDS, ContactWeights, MIN_WEIGHT, OUT, Regime, Weighed};
use crate::sliding::{Blocks, SlidingStream};
use crate::track_document::ContactDocument;
use nalgebra::{Matrix2, Vector3};
use wcal_core::stream::Flags;

/// Blocks by which a contact is weighed; fewer say nothing of how it moves.
const MIN_BLOCKS: usize = 3;
const MAX_BLOCKS: usize = 60;
/// Contacts of this probability and more are points of the object.
const TOUCHED: f64 = 0.9;

/// A contact of which readings may follow.
pub(crate) struct ContactSoFar {
    posteriors: Vec<RecursivePosterior>,
    push: Vector3<f64>,
    /// The last free row before it, and blocks of its loaded rows.
    before: Option<MotionRow>,
    blocks: Blocks,
    sliding: Option<SlidingStream>,
    weights: ContactWeights,
    /// First and last reading, s.
    span_s: [f64; 2],
    /// 95 % regions of the point that is allowed the most.
    regions: Vec<Region>,
}

impl ContactSoFar {
    /// With its first readings; none where the push runs along the whole wire.
    pub(crate) fn begin(of: &Assumed, settings: Settings, beginning: Beginning) -> Option<Self> {
        let creep_sds = if of.prior.of(Regime::Creeping) > 0.0 {
            &CREEP_SDS[..]
        } else {
            &[]
        };
        let begun = |creep_sd: &f64| {
            let settings = Settings {
                creep_sd: *creep_sd,
                ..settings
            };
            RecursivePosterior::begin(&of.wire.field, settings, &beginning)
        };
        let posteriors = std::iter::once(&0.0)
            .chain(creep_sds)
            .map(begun)
            .collect::<Option<_>>()?;
        let Beginning { push, lead, rows } = beginning;
        Some(Self {
            posteriors,
            push,
            before: lead.into_iter().next_back().filter(|_| rows.len() == 1),
            blocks: Blocks::default(),
            sliding: None,
            weights: ContactWeights::prior(of.prior),
            span_s: [rows[0].t_s, rows[rows.len() - 1].t_s],
            regions: Vec::new(),
        })
    }

    /// Takes the next reading.
    pub(crate) fn push(&mut self, field: &MomentField, row: &MotionRow) {
        self.posteriors.iter_mut().for_each(|p| p.push(field, row));
        self.span_s[1] = row.t_s;
    }

    /// Innovations of the point that is allowed the most.
    pub(crate) fn innovations(&self) -> Innovations {
        self.posteriors[self.posteriors.len() - 1].innovations()
    }

    /// For track.json.
    pub(crate) fn document(&self) -> ContactDocument {
        ContactDocument::of_stream(&self.innovations(), self.regions.clone(), self.span_s)
    }

    /// What is known of a reading that was taken.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn stated(
        &mut self,
        of: &Assumed,
        row: &MotionRow,
        (is_loaded, pose_nmm2): (bool, Matrix2<f64>),
    ) -> Result<Contact, TrackError> {
        let disagrees = !self.innovations().consistent();
        let slid = if is_loaded {
            self.weighed(of, row, (disagrees, pose_nmm2))?
        } else {
            None
        };
        let places: Vec<_> = self
            .posteriors
            .iter()
            .map(|p| p.place(&of.wire.field, row))
            .collect();
        self.regions = self
            .posteriors
            .last()
            .map(|p| p.posterior().regions())
            .unwrap_or_default();
        let weights = &self.weights;
        let points = weights
            .points()
            .into_iter()
            .map(|(weight, ..)| weight)
            .zip(places);
        let slides = slid.map(|slid| (weights.regimes.of(Regime::Sliding), slid));
        let all: Vec<Alternative> = points.chain(slides).map(Alternative::from).collect();
        // Outside of a contact nothing is in doubt.
        let flags = if is_loaded {
            weights.flags(disagrees, false)
        } else {
            Flags::default()
        };
        Ok(Contact::averaged(&all, flags, |place| {
            place.contact >= TOUCHED
        }))
    }

    /// Weighs the contact where a block of its readings is complete; where it is as one that
    /// slides.
    fn weighed(
        &mut self,
        of: &Assumed,
        row: &MotionRow,
        (disagrees, pose_nmm2): (bool, Matrix2<f64>),
    ) -> Result<Option<(EpisodeContact, ArcDensity)>, TrackError> {
        let complete = self.blocks.push(row);
        let slid = self
            .sliding
            .as_mut()
            .and_then(|sliding| sliding.push(row, &self.blocks.means));
        let blocks = self.blocks.means.len();
        if !complete || !(MIN_BLOCKS..MAX_BLOCKS).contains(&blocks) {
            return Ok(slid);
        }
        // The noise from pose to pose is one draw for a block.
        let noisy = |row: &MotionRow| MotionRow {
            noise_nmm2: row.noise_nmm2 + pose_nmm2,
            ..row.clone()
        };
        let weighed = Weighed {
            field: &of.wire.field,
            settings: of.settings,
            push: self.push,
            before: self.before.as_ref().map(noisy),
            blocks: self.blocks.means.at_middles().iter().map(noisy).collect(),
            factors: false,
        };
        // Nothing slides while a point that stays explains the readings.
        let sliding = self
            .sliding
            .as_ref()
            .map_or(Some(OUT), |s| s.ln_evidence(blocks));
        self.weights = weighed
            .evidence(of.prior, sliding.map(|ln| [ln, OUT]), false)
            .weights(&[]);
        if self.sliding.is_none() && (disagrees || self.weights.regimes.of(Regime::Fixed) < 0.5) {
            self.sliding = Some(SlidingStream::new(of.wire.touched()?));
        }
        Ok(slid.filter(|_| self.weights.regimes.of(Regime::Sliding) > MIN_WEIGHT))
    }
}
