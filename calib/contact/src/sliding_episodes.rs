//! The contacts of a table as ones that slide over an object.

use crate::ContactError;
use crate::known_motion::MotionRow;
use crate::sliding::{SlidingContact, TouchedWire, locate_sliding};
use wcal_core::WhiskerSpec;
use wcal_core::observation::MomentAxes;

/// By episode (first reading, and one past the last) the contact as one that slides; its motion may not support it.
///
/// # Errors
/// Where the wire cannot be bent.
pub fn sliding_contacts(
    whisker: &WhiskerSpec,
    known: &[MotionRow],
    episodes: &[[usize; 2]],
) -> Result<Vec<SlidingContact>, ContactError> {
    if episodes.is_empty() {
        return Ok(Vec::new());
    }
    let wire = TouchedWire::new(whisker, &MomentAxes::default())?;
    // A few readings past the end show whether the load was lost at once.
    let one = |[from, to]: &[usize; 2]| {
        let past = (*to + PAST).min(known.len());
        let mut all = locate_sliding(&wire, &known[*from..past]);
        all.places.truncate(to - from);
        all.regions.truncate(to - from);
        all
    };
    Ok(episodes.iter().map(one).collect())
}

/// Readings past the end of an episode.
const PAST: usize = 2;
