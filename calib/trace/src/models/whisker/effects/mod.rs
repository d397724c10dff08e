//! The catalogues: one file an effect.

mod base_compliance;
mod board_scale;
mod camera_pose;
mod contact_offset;
mod creep;
mod dead_zone;
mod fbg_nonlinearity;
mod gravity;
mod groove_friction;
mod hysteresis;
mod picture_clock;
mod rest_shape;
mod rest_zero;
mod rig_tag;
mod slip_outliers;
mod stage_backlash;
mod stage_periodic;
mod stage_scale;
mod superelastic_softening;
mod temperature_mismatch;
mod time_lag;
mod wire_taper;
mod zero_drift;

use crate::effect::{EffectModel, Parameter, Role};
use crate::whisker::WhiskerEffect;
use std::sync::Arc;

/// Every effect of docs/src/formats.md for kind "whisker".
pub fn whisker_catalogue() -> Vec<Arc<dyn WhiskerEffect>> {
    vec![
        Arc::new(groove_friction::GrooveFriction),
        Arc::new(stage_backlash::StageBacklash),
        Arc::new(stage_scale::StageScale),
        Arc::new(stage_periodic::StagePeriodic),
        Arc::new(time_lag::TimeLag),
        Arc::new(contact_offset::ContactOffset),
        Arc::new(base_compliance::BaseCompliance),
        Arc::new(temperature_mismatch::TemperatureMismatch),
        Arc::new(zero_drift::ZeroDrift),
        Arc::new(rest_zero::RestZero),
        Arc::new(creep::Creep),
        Arc::new(hysteresis::Hysteresis),
        Arc::new(superelastic_softening::SuperelasticSoftening),
        Arc::new(fbg_nonlinearity::FbgNonlinearity),
        Arc::new(dead_zone::DeadZone),
        Arc::new(wire_taper::WireTaper),
        Arc::new(slip_outliers::SlipOutliers),
        Arc::new(gravity::Gravity),
        Arc::new(camera_pose::CameraPose),
        Arc::new(board_scale::BoardScale),
        Arc::new(rig_tag::RigTag),
        Arc::new(picture_clock::PictureClock),
        Arc::new(rest_shape::RestShape),
    ]
}

/// A law without parameters of either kind yet.
fn law(name: &'static str) -> EffectModel {
    EffectModel { name, parameters: Vec::new(), linear: Vec::new(), largest_share: None, needs: Vec::new() }
}

impl EffectModel {
    fn amplitude(mut self, name: &'static str, unit: &'static str, range: [f64; 2], probe: f64) -> Self {
        self.parameters.push(Parameter { name, unit, range, role: Role::Amplitude { probe } });
        self
    }

    fn shape(
        mut self,
        name: &'static str,
        unit: &'static str,
        range: [f64; 2],
        grid: &'static [f64],
    ) -> Self {
        self.parameters.push(Parameter { name, unit, range, role: Role::Shape { grid } });
        self
    }

    fn column(mut self, name: &'static str, unit: &'static str) -> Self {
        self.linear.push((name, unit));
        self
    }

    fn at_most(mut self, share: f64) -> Self {
        self.largest_share = Some(share);
        self
    }
}
