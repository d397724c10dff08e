//! The catalogue: an effect is a function, in the file of the part that it acts on.

mod bond;
mod cameras;
mod readout;
mod stage;
mod wire;

use super::whisker_effect::WhiskerEffect;
use std::sync::LazyLock;

/// Every effect of docs/src/method.md for kind "whisker".
pub(crate) fn whisker_catalogue() -> &'static [WhiskerEffect] {
    static CATALOGUE: LazyLock<Vec<WhiskerEffect>> = LazyLock::new(|| {
        vec![
            wire::groove_friction(),
            stage::stage_backlash(),
            stage::stage_scale(),
            stage::stage_periodic(),
            stage::time_lag(),
            wire::contact_offset(),
            wire::base_compliance(),
            readout::temperature_mismatch(),
            readout::zero_drift(),
            readout::rest_zero(),
            bond::creep(),
            bond::hysteresis(),
            wire::superelastic_softening(),
            readout::fbg_nonlinearity(),
            bond::dead_zone(),
            wire::wire_taper(),
            readout::slip_outliers(),
            wire::gravity(),
            cameras::camera_pose(),
            cameras::board_scale(),
            cameras::rig_tag(),
            cameras::picture_clock(),
            wire::rest_shape(),
        ]
    });
    &CATALOGUE
}
