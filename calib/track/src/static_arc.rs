//! Readings of whose motion nothing is known: an arc of the wire for every loaded one
//! ([`crate::arc`]), each reading by itself.

use crate::TrackError;
use crate::arc::{arc_density, static_arc};
use crate::arc_posterior::ArcDensity;
use crate::calibrated_wire::CalibratedWire;
use crate::estimator::{Contact, ContactEstimate};
use crate::reading::Moments;
use wcal_core::stream::Flags;
use wcal_network::StaticInverse;
use wcal_network::network::Prediction;

/// A wire that is loaded by so many standard deviations touches something.
const LOADED_SDS: f64 = 4.0;

/// What moments alone allow.
pub(crate) struct StaticArc {
    wire: CalibratedWire,
    /// Made at the first loaded reading.
    inverse: Option<StaticInverse>,
}

impl StaticArc {
    /// Of a wire.
    pub(crate) fn new(wire: CalibratedWire) -> Self {
        Self {
            wire,
            inverse: None,
        }
    }

    /// What the moments of a loaded reading allow, with standard deviations of these sizes, N mm.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn allowed(
        &mut self,
        moment_nmm: [f64; 2],
        sd_nmm: [f64; 2],
    ) -> Result<(ContactEstimate, ArcDensity), TrackError> {
        let inverse = match &mut self.inverse {
            Some(inverse) => inverse,
            none => none.insert(self.wire.static_inverse()?),
        };
        let answer = static_arc(inverse, moment_nmm, sd_nmm, &Prediction::unknown());
        Ok((
            ContactEstimate::from(&answer),
            arc_density(&inverse.nodes, &answer.weights),
        ))
    }

    /// The arc of a reading that is loaded beyond its noise.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    pub(crate) fn estimate_contact(&mut self, m: &Moments) -> Result<Contact, TrackError> {
        // A reading's own noise may be larger than that from pose to pose, which is one of
        // averages.
        let own = m.own_nmm2.map_or(0.0, |n| n.trace());
        let sd_nmm = (m.sd_nmm[0].powi(2) + m.sd_nmm[1].powi(2) + own).sqrt();
        if m.moment_nmm[0].hypot(m.moment_nmm[1]) <= LOADED_SDS * sd_nmm {
            return Ok(Contact::default());
        }
        let (estimate, arc) = self.allowed(m.moment_nmm, m.sd_nmm)?;
        let (estimate, regions) = (Some(estimate), arc.regions());
        Ok(Contact {
            estimate,
            flags: Flags::MOTION_LOST,
            regions,
            ..Contact::default()
        })
    }
}
