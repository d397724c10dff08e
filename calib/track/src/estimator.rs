//! From readings to contacts: what every way to locate a contact has in common.

use crate::TrackError;
use crate::arc_posterior::Region;
use crate::known_motion::EpisodeContact;
use crate::reading::Reading;
use crate::regimes::{Alternative, averaged};
use crate::track_document::EstimatorDocument;
use nalgebra::{Matrix3, Rotation3, Vector3};
use wcal_core::stream::Flags;
use wcal_core::verify_document::GrooveTracking;
use wcal_network::network::Prediction;

/// Where the wire touches something.
#[derive(Debug, Clone, Copy, PartialEq)]
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

impl From<&Prediction> for ContactEstimate {
    fn from(p: &Prediction) -> Self {
        let vector = |v: [f32; 3]| Vector3::from(v.map(f64::from));
        let covariance_mm2 = Matrix3::from_fn(|i, j| f64::from(p.covariance_mm2[i][j]));
        Self {
            probability: f64::from(p.contact),
            place_mm: vector(p.point_mm),
            covariance_mm2,
            normal: vector(p.normal),
        }
    }
}

impl ContactEstimate {
    /// At a place of the wire's axis; none where nothing was found.
    fn of_place(place: &EpisodeContact) -> Option<Self> {
        let (probability, covariance_mm2) = (place.contact, place.covariance_mm2);
        Some(Self {
            probability,
            place_mm: place.place_mm?,
            covariance_mm2,
            normal: Vector3::zeros(),
        })
    }

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
    /// What the ways in which a contact may move state together; `on_object`: whether its place is
    /// a point of the object.
    pub fn averaged(
        all: &[Alternative],
        flags: Flags,
        on_object: impl Fn(&EpisodeContact) -> bool,
    ) -> Self {
        let Some((place, arc)) = averaged(all) else {
            return Self {
                flags,
                ..Self::default()
            };
        };
        let (estimate, regions, on_object) = (
            ContactEstimate::of_place(&place),
            arc.regions(),
            on_object(&place),
        );
        Self {
            estimate,
            flags,
            regions,
            on_object,
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
