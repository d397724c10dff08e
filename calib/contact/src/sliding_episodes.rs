//! Contacts that slide over an object: tracked by the filter where no fixed point of the object explains the moments.

use crate::ContactError;
use crate::known_motion::{Disagreement, Located, MotionRow};
use crate::sliding::{SlidingContact, locate_sliding};
use wcal_calibration::SensedRow;
use wcal_core::WhiskerSpec;
use wcal_track::{InverseGrid, StaticInverse};

/// By episode the contact as one that slides, where no fixed point explains the moments; its motion may not support it.
///
/// # Errors
/// Where the wire cannot be bent.
pub fn sliding_contacts(
    whisker: &WhiskerSpec,
    rows: &[SensedRow],
    known: &[MotionRow],
    episodes: &[([usize; 2], &Located)],
) -> Result<Vec<Option<SlidingContact>>, ContactError> {
    let unexplained = |found: &Located| found.disagreement == Some(Disagreement::Unexplained);
    if !episodes.iter().any(|(_, found)| unexplained(found)) {
        return Ok(vec![None; episodes.len()]);
    }
    let inverse = StaticInverse::new(whisker, InverseGrid { refine: 2, ..InverseGrid::default() })?;
    let variance = rows.iter().map(|r| 0.5 * r.sensed.noise_nmm2.trace()).sum::<f64>() / rows.len() as f64;
    let one = |([from, to], found): &([usize; 2], &Located)| {
        let slides =
            |all: &[MotionRow]| locate_sliding(&inverse, all, variance.sqrt(), whisker.diameter_mm / 2.0);
        unexplained(found).then(|| slides(&known[*from..*to]))
    };
    Ok(episodes.iter().map(one).collect())
}
