//! Superelastic softening past a yield curvature.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::WhiskerEffect;
use crate::whisker::rod_parameters::RodParameters;
use wcal_rod::Softening;

/// See the module.
pub struct SuperelasticSoftening;

impl Effect for SuperelasticSoftening {
    fn id(&self) -> &'static str {
        "superelastic-softening"
    }
    fn laws(&self) -> Vec<EffectModel> {
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
        "Superelastic softening: the alloy begins to transform where the wire is bent most."
    }
    fn source(&self) -> &'static str {
        "NiTi transformation at 0.4-1 % surface strain; section law of a plateau in docs/src/method.md"
    }
}

impl WhiskerEffect for SuperelasticSoftening {
    fn rod(&self, values: &Values, rod: &mut RodParameters) {
        let share = values.of("softening_share");
        if share <= 0.0 {
            return;
        }
        let (left, onset_per_m) = (1.0 - share, values.of("onset_per_m"));
        rod.softening = Some(if values.law() == "section-plateau" {
            Softening::Section { onset_per_m, hardening: left }
        } else {
            Softening::Bilinear { onset_per_m, ratio: left }
        });
    }
}
