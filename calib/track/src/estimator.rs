//! From readings to contacts: what every way to locate a contact has in common.

use crate::TrackError;
use crate::arc_posterior::{ArcDensity, Region, mixed_place};
use crate::known_motion::EpisodeContact;
use crate::reading::Reading;
use crate::track_document::EstimatorDocument;
use nalgebra::{Matrix3, Rotation3, Vector3};
use wcal_core::stream::Flags;
use wcal_core::verify_document::GrooveTracking;

/// Contacts of this probability and more are points of the object.
pub(crate) const TOUCHED: f64 = 0.9;

/// Where the wire touches something.
#[derive(Debug, Clone, Copy)]
pub struct ContactEstimate {
    /// Probability of contact.
    pub probability: f64,
    /// Mean place, mm.
    pub place_mm: Vector3<f64>,
    /// Covariance, mm^2.
    pub covariance_mm2: Matrix3<f64>,
    /// Direction of the force on the wire; zero where the place is that of the wire's axis.
    pub normal: Vector3<f64>,
}

impl ContactEstimate {
    /// In a turned frame.
    pub fn turned(&self, turn: &Rotation3<f64>) -> Self {
        let covariance_mm2 = turn * self.covariance_mm2 * turn.inverse();
        let (place_mm, normal) = (turn * self.place_mm, turn * self.normal);
        Self {
            place_mm,
            covariance_mm2,
            normal,
            ..*self
        }
    }
}

/// The contact at a reading.
#[derive(Debug, Clone, Default)]
pub struct Contact {
    /// Place, covariance and probability; none where nothing is stated.
    pub estimate: Option<ContactEstimate>,
    /// What stays in doubt.
    pub flags: Flags,
    /// 95 % regions of highest density along the wire.
    pub regions: Vec<Region>,
    /// Probability of several contacts, where the estimator knows one.
    pub several: Option<f64>,
    /// Number of the contact, where the estimator counts them.
    pub number: Option<u64>,
    /// Whether the place is a point of the object's surface as far as the estimator knows.
    pub on_object: bool,
}

impl Contact {
    /// What the ways in which a contact may move state together, each with its weight;
    /// `on_object`: whether its place is a point of the object, by the probability of contact.
    pub fn averaged(
        all: &[(f64, EpisodeContact)],
        flags: Flags,
        on_object: impl Fn(f64) -> bool,
    ) -> Self {
        // Model averaging: a mixture of the ways' densities with their probabilities.
        let located = || all.iter().filter_map(|(w, c)| Some((*w, c.place_mm?, c)));
        let places = located().map(|(w, at, c)| (w, at, c.covariance_mm2));
        let Some((place_mm, covariance_mm2)) = mixed_place(places) else {
            return Self {
                flags,
                ..Self::default()
            };
        };
        let [held, total] =
            located().fold([0.0; 2], |[h, t], (w, _, c)| [h + w * c.contact, t + w]);
        let probability = held / total;
        Self {
            estimate: Some(ContactEstimate {
                probability,
                place_mm,
                covariance_mm2,
                normal: Vector3::zeros(),
            }),
            flags,
            regions: ArcDensity::mixture(located().map(|(w, _, c)| (w, &c.arc))).regions(),
            on_object: on_object(probability),
            ..Self::default()
        }
    }
}

/// Locates the contacts of one whisker; readings and contacts are in the frame of its wire
/// ([`crate::frame`]).
pub trait Estimator {
    /// Takes the next reading in order of time; gives the contacts that are settled by now, in the
    /// order of their readings.
    ///
    /// # Errors
    /// For a reading that cannot be used, and where the wire cannot be bent.
    fn push(&mut self, reading: &Reading) -> Result<Vec<Contact>, TrackError>;

    /// No reading follows: the contacts of those that are left.
    ///
    /// # Errors
    /// As for `push`.
    fn finish(&mut self) -> Result<Vec<Contact>, TrackError> {
        Ok(Vec::new())
    }

    /// What was found over all readings.
    fn findings(&self) -> Findings;

    /// What the regions of every contact assume of wire and object, in short.
    fn assumes(&self) -> String {
        String::new()
    }
}

/// What an estimator found over all readings.
#[derive(Debug, Clone, Default)]
pub struct Findings {
    /// For track.json.
    pub document: EstimatorDocument,
    /// For people; what the user may not have meant begins with "warning: ".
    pub messages: Vec<String>,
    /// Readings could not be used for want of a motion.
    pub lost: bool,
    /// Contact in a motion of which the estimator knows nothing, or that does not belong to the
    /// moments.
    pub doubt: bool,
    /// Groove of a session against the answers; none inside where nothing was compared.
    pub groove: Option<Option<GrooveTracking>>,
    /// First and last reading of each contact, s, where each reading knows what came before it
    /// alone.
    pub spans_s: Option<Vec<[f64; 2]>>,
}
