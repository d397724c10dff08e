//! Contacts that slide over an object: where no fixed point of the object explains the moments.

use crate::ContactError;
use crate::known_motion::{EpisodeEstimate, MotionRow};
use crate::sliding::{SlidingContact, TouchedWire, locate_sliding};
use wcal_core::WhiskerSpec;
use wcal_core::observation::MomentAxes;

/// By episode the contact as one that slides, where no fixed point explains the moments; its motion may not support it.
///
/// # Errors
/// Where the wire cannot be bent.
pub fn sliding_contacts(
    whisker: &WhiskerSpec,
    known: &[MotionRow],
    episodes: &[([usize; 2], &EpisodeEstimate)],
) -> Result<Vec<Option<SlidingContact>>, ContactError> {
    if !episodes.iter().any(|(_, found)| found.disagrees()) {
        return Ok(vec![None; episodes.len()]);
    }
    let wire = TouchedWire::new(whisker, &MomentAxes::default())?;
    // A few readings past the end show whether the load was lost at once.
    let one = |([from, to], found): &([usize; 2], &EpisodeEstimate)| {
        let past = (*to + PAST).min(known.len());
        found.disagrees().then(|| {
            let mut all = locate_sliding(&wire, &known[*from..past]);
            all.places.truncate(to - from);
            all.regions.truncate(to - from);
            all
        })
    };
    Ok(episodes.iter().map(one).collect())
}

/// Readings past the end of an episode.
const PAST: usize = 2;
