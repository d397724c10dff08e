//! A network as an estimator: filters and network (TrackerStream), then what the motion allows.
//!
//! A network knows one motion: the base goes along its +z past an object at rest, at the speeds of
//! its training. Two moments cannot tell another one from it: presses and sweeps give the same
//! moments. So a contact has one of two statuses:
//!
//! | motion | status | point | regions |
//! |---|---|---|---|
//! | known or vouched for, and one of training | `ok` | network's | network's |
//! | any other, or not known | `motion-assumed` | network's | of the mixture of network and moments alone (`arc::any_motion`) |
//!
//! It knows one wire, too. On another one the row says `wire-assumed`: its spread is that of the
//! mixture, its regions are what the moments alone allow of that wire.

use crate::TrackError;
use crate::arc::{any_motion, arc_density};
use crate::estimator::{Contact, ContactEstimate, Estimator, Findings, TOUCHED};
use crate::reading::{Moments, Reading};
use crate::track_document::{EstimatorDocument, SeveralContacts};
use nalgebra::Vector3;
use wcal_core::stream::Flags;
use wcal_network::filter::FilterBank;
use wcal_network::model_file::Card;
use wcal_network::{Sample, StaticInverse, Tracker, TrackerStream};

/// The network of one whisker.
#[derive(Debug)]
pub struct NetworkEstimator<'a> {
    tracker: &'a Tracker,
    card: &'a Card,
    filters: FilterBank,
    stream: TrackerStream<'a>,
    /// Whether the user vouches for a motion as in training where it is not known.
    vouched: bool,
    /// The wire that is tracked, where the network was trained for another.
    other_wire: Option<StaticInverse>,
    foreign_rows: u64,
    rows: u64,
    assumed_rows: u64,
    /// Rows with a probability of several contacts, and those at which several are more probable
    /// than one.
    several_rows: [u64; 2],
}

/// Probability from which on a contact, or a second one, is more probable than not.
const PROBABLE: f32 = 0.5;
/// Largest ratio of the velocity across the base's +z to that along it in the trained motion.
const ASIDE: f64 = 0.2;
/// A wire loaded by this much, N mm, and by this many standard deviations, is in contact.
const LOADED_NMM: f64 = 0.02;
const LOADED_SDS: f64 = 5.0;

impl<'a> NetworkEstimator<'a> {
    /// Of a model with filters that know the noise of its moments; `vouched`: a motion that is not
    /// known is as in training; `other_wire`: the wire that is tracked, where the network was
    /// trained for another.
    pub fn new(
        (tracker, card): (&'a Tracker, &'a Card),
        filters: FilterBank,
        vouched: bool,
        other_wire: Option<StaticInverse>,
    ) -> Self {
        Self {
            tracker,
            card,
            filters,
            stream: tracker.stream_with(filters),
            vouched,
            other_wire,
            foreign_rows: 0,
            rows: 0,
            assumed_rows: 0,
            several_rows: [0; 2],
        }
    }

    /// Whether a velocity of the base past what it touches (base frame, mm/s) is one of training.
    fn trained(&self, velocity_mm_s: Option<Vector3<f64>>) -> bool {
        let [low, high] = self.card.training.speed_mm_s();
        velocity_mm_s.map_or(self.vouched, |w| {
            (low..=high).contains(&w.z) && w.xy().norm() <= ASIDE * w.z
        })
    }
}

/// Whether the wire is loaded, whatever the network states.
fn loaded(moments: &Moments) -> bool {
    // A network may miss a contact that is none of its training; the moments do not.
    let [size, sd] = [moments.moment_nmm, moments.sd_nmm].map(|m| m[0].hypot(m[1]));
    size >= LOADED_NMM.max(LOADED_SDS * sd)
}

impl Estimator for NetworkEstimator<'_> {
    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, TrackError> {
        self.rows += 1;
        if reading.gap {
            // What happened in between is not known: filters and network start anew.
            self.stream = self.tracker.stream_with(self.filters);
        }
        let Some(moments) = &reading.moments else {
            return Ok(vec![Contact::default()]);
        };
        let (t_s, moment_nmm) = (reading.t_s, moments.moment_nmm);
        let mut answer = self.stream.push(&Sample {
            t_s,
            moment_nmm,
            base_mm_s: reading.base_mm_s,
        });
        let several = (answer.contact >= PROBABLE).then_some(f64::from(answer.several));
        self.several_rows[0] += u64::from(several.is_some());
        self.several_rows[1] += u64::from(several.is_some_and(|p| p > f64::from(PROBABLE)));
        let mut flags = Flags::default();
        let inverse = self.other_wire.as_ref().unwrap_or(&self.tracker.inverse);
        if answer.contact >= PROBABLE || loaded(moments) {
            if !self.trained(reading.velocity_mm_s) {
                self.assumed_rows += 1;
                flags = Flags::MOTION_ASSUMED;
            }
            if self.other_wire.is_some() {
                self.foreign_rows += 1;
                flags = flags.with(Flags::WIRE_ASSUMED);
                // Places on the other wire's curve.
                answer.weights.clear();
            }
        }
        if !flags.none() {
            answer = any_motion(inverse, moment_nmm, moments.sd_nmm, answer);
        }
        let regions = arc_density(&inverse.nodes, &answer.weights).regions();
        let estimate = ContactEstimate::from(&answer);
        Ok(vec![Contact {
            estimate: Some(estimate),
            flags,
            regions,
            several,
            number: None,
            on_object: estimate.probability >= TOUCHED,
        }])
    }

    fn findings(&self) -> Findings {
        let [rows, probable_rows] = self.several_rows;
        let mut messages = Vec::new();
        if self.foreign_rows > 0 {
            messages.push(format!(
                "warning: {} of {} rows are contact of a wire that the network was not trained for: their places assume the trained one, their spread and \
                 regions are those of the moments alone; marked wire-assumed in status (a known motion needs no network; or train one for this wire)",
                self.foreign_rows, self.rows
            ));
        }
        if self.assumed_rows > 0 {
            messages.push(format!(
                "warning: {} of {} rows are contact in a motion that is not known to be one of training: their places assume the base along its +z \
                 past an object at rest, at {:.1} to {:.1} mm/s, their regions hold for any; marked motion-assumed in status (--sweep vouches \
                 for the motion where it is not known)",
                self.assumed_rows,
                self.rows,
                self.card.training.speed_mm_s()[0],
                self.card.training.speed_mm_s()[1]
            ));
        }
        if probable_rows > 0 {
            messages.push(format!(
                "at {probable_rows} of {rows} rows in contact several contacts are more probable than one (several_probability above 0.5): \
                 the places of the further ones are not estimated"
            ));
        }
        let document = EstimatorDocument {
            model_sha256: Some(self.card.weights_sha256.clone()),
            trained_on_simulation: Some(self.card.trained_on_simulation),
            motion_assumed_rows: Some(self.assumed_rows),
            several_contacts: Some(SeveralContacts {
                rows,
                probable_rows,
            }),
            ..EstimatorDocument::default()
        };
        Findings {
            document,
            messages,
            doubt: self.assumed_rows + self.foreign_rows > 0,
            ..Findings::default()
        }
    }
}
