//! The spread of the noise changes with the stimulus.

use super::{HETEROSCEDASTIC_NOISE, law};
use crate::effect::{Effect, EffectModel};
use crate::method::noise::spread::MIN_READINGS;
use crate::scalar::ScalarEffect;
use crate::scalar::frame::Frame;

/// See the module.
pub struct HeteroscedasticNoise;

impl Effect for HeteroscedasticNoise {
    fn id(&self) -> &'static str {
        HETEROSCEDASTIC_NOISE
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![law("spread", Vec::new(), &[])]
    }
    fn sentence(&self) -> &'static str {
        "The noise depends on the stimulus; the readings were weighted accordingly."
    }
    fn source(&self) -> &'static str {
        "score test of Breusch & Pagan 1979, variance model of Harvey 1976"
    }
}

// It has no mean: `scalar::spread_test` finds it.
impl ScalarEffect for HeteroscedasticNoise {
    fn not_observable(&self, frame: &Frame) -> Option<String> {
        (frame.scaling.count < MIN_READINGS || !(frame.scaling.half > 0.0))
            .then(|| format!("needs {MIN_READINGS} readings at different stimuli"))
    }
}
