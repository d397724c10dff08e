//! Contacts that slide over an object: tracked by the filter where no fixed point of the object explains the moments.

use crate::ContactError;
use crate::known_motion::{Disagreement, Located, MotionRow};
use crate::sliding::{SlidingContact, locate_sliding};
use wcal_core::WhiskerSpec;
use wcal_track::{InverseGrid, StaticInverse};

/// By episode the contact as one that slides, where no fixed point explains the moments; its motion may not support it. `noise_nmm`:
/// standard deviation of the moments from pose to pose, N mm.
///
/// # Errors
/// Where the wire cannot be bent.
pub fn sliding_contacts(
    whisker: &WhiskerSpec,
    noise_nmm: f64,
    known: &[MotionRow],
    episodes: &[([usize; 2], &Located)],
) -> Result<Vec<Option<SlidingContact>>, ContactError> {
    let unexplained = |found: &Located| found.disagreement == Some(Disagreement::Unexplained);
    if !episodes.iter().any(|(_, found)| unexplained(found)) {
        return Ok(vec![None; episodes.len()]);
    }
    let inverse = StaticInverse::new(whisker, InverseGrid { refine: 2, ..InverseGrid::default() })?;
    let one = |([from, to], found): &([usize; 2], &Located)| {
        let slides = |all: &[MotionRow]| locate_sliding(&inverse, all, noise_nmm, whisker.diameter_mm / 2.0);
        unexplained(found).then(|| slides(&known[*from..*to]))
    };
    Ok(episodes.iter().map(one).collect())
}
