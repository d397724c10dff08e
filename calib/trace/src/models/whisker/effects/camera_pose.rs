//! The cameras moved against each other after their calibration: everything that they see is displaced as one rigid body.
//!
//! ```text
//! r' = r + t + w x (r - c)        t: shift, w: small turn, c: the mean of the grooves, so that both parts stand for themselves
//! ```

use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::{PairObservation, WhiskerEffect};
use nalgebra::Vector3;

/// See the module.
pub struct CameraPose;

/// The law with its six amplitudes.
fn rigid(name: &'static str) -> EffectModel {
    let (shift, turn) = ([-5.0, 5.0], [-0.1, 0.1]);
    law(name)
        .needing(&[LawRequirement::Pictures])
        .amplitude("shift_x_mm", "mm", shift, 0.1)
        .amplitude("shift_y_mm", "mm", shift, 0.1)
        .amplitude("shift_z_mm", "mm", shift, 0.1)
        .amplitude("turn_x_rad", "rad", turn, 0.005)
        .amplitude("turn_y_rad", "rad", turn, 0.005)
        .amplitude("turn_z_rad", "rad", turn, 0.005)
}

impl Effect for CameraPose {
    fn id(&self) -> &'static str {
        "camera-pose"
    }
    fn laws(&self) -> Vec<EffectModel> {
        vec![
            rigid("before-the-session"),
            rigid("during-the-session").shape("from_share", "1", [0.02, 0.98], &[0.2, 0.35, 0.5, 0.65, 0.8]),
        ]
    }
    fn sentence(&self) -> &'static str {
        "The whole scene is displaced in the pictures: the cameras moved after their calibration."
    }
    fn source(&self) -> &'static str {
        "rigid motion of the scene in the cameras' frame, small angles"
    }
}

impl WhiskerEffect for CameraPose {
    fn pictures(&self, values: &Values, seen: &mut [PairObservation]) {
        let vector = |names: [&str; 3]| Vector3::from(names.map(|name| values.of(name)));
        let shift = vector(["shift_x_mm", "shift_y_mm", "shift_z_mm"]);
        let turn = vector(["turn_x_rad", "turn_y_rad", "turn_z_rad"]);
        let from = if values.law() == "during-the-session" { values.of("from_share") } else { 0.0 };
        let centre = seen.iter().map(|s| s.groove_mm).sum::<Vector3<f64>>() / seen.len().max(1) as f64;
        let moved = |p: &mut Vector3<f64>| *p += shift + turn.cross(&(*p - centre));
        for s in seen.iter_mut().filter(|s| s.place >= from) {
            moved(&mut s.groove_mm);
            s.stations_mm.iter_mut().for_each(moved);
        }
    }
}
