//! Superelastic softening past a yield curvature.

use super::law;
use crate::candidate::{Candidate, Law};
use crate::mechanics::Mechanics;
use crate::whisker::WhiskerEffect;
use wcal_rod::Softening;

/// See the module.
pub struct SuperelasticSoftening;

impl Candidate for SuperelasticSoftening {
    fn id(&self) -> &'static str {
        "superelastic-softening"
    }
    fn laws(&self) -> Vec<Law> {
        vec![
            law("section-plateau").amplitude("softening_share", "1", [0.0, 1.0], 0.5).shape(
                "onset_per_m",
                "1/m",
                [12.0, 90.0],
                &[20.0, 30.0, 40.0, 52.0, 65.0],
            ),
            law("bilinear").amplitude("softening_share", "1", [0.0, 0.97], 0.5).shape(
                "onset_per_m",
                "1/m",
                [12.0, 90.0],
                &[20.0, 30.0, 40.0, 52.0, 65.0],
            ),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The wire softens where it is bent most: the alloy begins to transform."
    }
    fn source(&self) -> &'static str {
        "NiTi transformation at 0.4-1 % surface strain; section law of a plateau in docs/src/method.md"
    }
}

impl WhiskerEffect for SuperelasticSoftening {
    fn mechanics(&self, law: usize, values: &[f64], mechanics: &mut Mechanics) {
        if values[0] <= 0.0 {
            return;
        }
        let (left, onset_per_m) = (1.0 - values[0], values[1]);
        mechanics.softening = Some(if law == 0 {
            Softening::Section { onset_per_m, hardening: left }
        } else {
            Softening::Bilinear { onset_per_m, ratio: left }
        });
    }
}
