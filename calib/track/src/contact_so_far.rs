//! The contact at hand of a stream: what is known of it after each reading.
//!
//! A point that stays or creeps has its recursive posteriors. Where a point that stays does not
//! explain the moments, the contact is followed as one that slides ([`SlidingStream`]), too; each
//! way has its weight ([`crate::regimes`]), anew with each block of readings.

use crate::TrackError;
use crate::estimator::{Contact, TOUCHED};
use crate::known_motion::segmenter::Beginning;
use crate::known_motion::{
    EpisodeContact, Innovations, MomentField, MotionRow, RecursivePosterior, Settings,
};
use crate::regimes::{Assumed, CREEP_SDS, ContactWeights, MIN_WEIGHT, OUT, Regime, Weighed};
use crate::sliding::{Blocks, MIN_MEANS, SlidingStream};
use crate::track_document::ContactDocument;
use nalgebra::{Matrix2, Vector3};
use wcal_core::stream::Flags;

/// Blocks by which a contact is weighed at most.
const MAX_BLOCKS: usize = 60;

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
}

impl ContactSoFar {
    /// With its first readings; none where the push runs along the whole wire.
    pub(crate) fn begin(of: &Assumed, settings: Settings, beginning: Beginning) -> Option<Self> {
        let may_creep = of.prior.of(Regime::Creeping) > 0.0;
        let creep_sds = CREEP_SDS.into_iter().filter(|_| may_creep);
        let begun = |creep_sd| {
            let settings = Settings {
                creep_sd,
                ..settings
            };
            RecursivePosterior::begin(&of.wire.field, settings, &beginning)
        };
        let posteriors = std::iter::once(0.0).chain(creep_sds).map(begun);
        let posteriors = posteriors.collect::<Option<_>>()?;
        let Beginning { push, lead, rows } = beginning;
        Some(Self {
            posteriors,
            push,
            before: lead.into_iter().next_back().filter(|_| rows.len() == 1),
            blocks: Blocks::default(),
            sliding: None,
            weights: ContactWeights::prior(of.prior),
            span_s: [rows[0].t_s, rows[rows.len() - 1].t_s],
        })
    }

    /// Takes the next reading.
    pub(crate) fn push(&mut self, field: &MomentField, row: &MotionRow) {
        self.posteriors.iter_mut().for_each(|p| p.push(field, row));
        self.span_s[1] = row.t_s;
    }

    /// The point that is allowed the most.
    fn most_allowed(&self) -> &RecursivePosterior {
        // CREEP_SDS rise: the last point may go farthest from where it was.
        &self.posteriors[self.posteriors.len() - 1]
    }

    /// Innovations of the point that is allowed the most.
    pub(crate) fn innovations(&self) -> Innovations {
        self.most_allowed().innovations()
    }

    /// For track.json.
    pub(crate) fn document(&self) -> ContactDocument {
        let (innovations, [from_s, to_s]) = (self.innovations(), self.span_s);
        ContactDocument {
            regions: Some(self.most_allowed().posterior().regions()),
            from_s: Some(from_s),
            to_s: Some(to_s),
            ..ContactDocument::new(&innovations, innovations.rows)
        }
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
        // Blocks are of loaded rows alone: a free wire does not feel how the contact moves.
        let slid = if is_loaded {
            self.weighed(of, row, (disagrees, pose_nmm2))?
        } else {
            None
        };
        let weights = &self.weights;
        let ways = weights.points().into_iter().map(|(weight, ..)| weight);
        let places = self.posteriors.iter().map(|p| p.place(&of.wire.field, row));
        let slides = slid.map(|slid| (weights.regimes.of(Regime::Sliding), slid));
        let all: Vec<(f64, EpisodeContact)> = ways.zip(places).chain(slides).collect();
        // Outside of a contact nothing is in doubt.
        let flags = if is_loaded {
            weights.flags(disagrees, false)
        } else {
            Flags::default()
        };
        Ok(Contact::averaged(&all, flags, |held| held >= TOUCHED))
    }

    /// Weighs the contact where a block of its readings is complete; where it is as one that
    /// slides.
    fn weighed(
        &mut self,
        of: &Assumed,
        row: &MotionRow,
        (disagrees, pose_nmm2): (bool, Matrix2<f64>),
    ) -> Result<Option<EpisodeContact>, TrackError> {
        let complete = self.blocks.push(row);
        let slid = self
            .sliding
            .as_mut()
            .and_then(|sliding| sliding.push(row, &self.blocks.means));
        let blocks = self.blocks.means.len();
        if !complete || !(MIN_MEANS..MAX_BLOCKS).contains(&blocks) {
            return Ok(slid);
        }
        // The noise from pose to pose is one draw for a block.
        let noisy = |row: &MotionRow| MotionRow {
            noise_nmm2: row.noise_nmm2 + pose_nmm2,
            ..row.clone()
        };
        let weighed = Weighed {
            of,
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
            .evidence(sliding.map(|ln| [ln, OUT]), false)
            .weights(&[]);
        if self.sliding.is_none() && (disagrees || self.weights.regimes.of(Regime::Fixed) < 0.5) {
            self.sliding = Some(SlidingStream::new(of.wire.touched()?));
        }
        Ok(slid.filter(|_| self.weights.regimes.of(Regime::Sliding) > MIN_WEIGHT))
    }
}
