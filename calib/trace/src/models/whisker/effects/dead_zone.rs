//! No response below a moment m0.

use super::law;
use crate::effect::{Effect, EffectModel, Values};
use crate::whisker::{Memory, WhiskerEffect};

/// See the module.
pub struct DeadZone;

impl Effect for DeadZone {
    fn id(&self) -> &'static str {
        "dead-zone"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            law("radial").amplitude("threshold_nmm", "N mm", [0.0, 1.0], 0.05),
            law("by-axis").amplitude("threshold_nmm", "N mm", [0.0, 1.0], 0.05),
        ]
    }
    fn sentence(&self) -> &'static str {
        "Dead zone: small moments do not reach the gratings (play in the bond or the mounting)."
    }
    fn source(&self) -> &'static str {
        "play of the seat; radial or by axis"
    }
}

impl WhiskerEffect for DeadZone {
    fn memory(&self, values: &Values) -> Option<Box<dyn Memory>> {
        Some(Box::new(DeadZoneState {
            radial: values.law() == "radial",
            threshold_nmm: values.of("threshold_nmm"),
        }))
    }
}

/// A sensor that feels what is past a threshold; it remembers nothing.
struct DeadZoneState {
    radial: bool,
    threshold_nmm: f64,
}

impl Memory for DeadZoneState {
    fn sensed(&self, _dt_s: Option<f64>, m: [f64; 2]) -> [f64; 2] {
        if self.radial {
            let size = m[0].hypot(m[1]);
            let left = if size > self.threshold_nmm { 1.0 - self.threshold_nmm / size } else { 0.0 };
            [m[0] * left, m[1] * left]
        } else {
            m.map(|v| v.signum() * (v.abs() - self.threshold_nmm).max(0.0))
        }
    }

    fn accept(&mut self, _dt_s: Option<f64>, _moment_nmm: [f64; 2]) {}
}
