//! Faults of the cameras' setup: effects on what pairs of pictures show.

use crate::effect::LawRequirement::{MovingPictures, Pictures};
use crate::effect::{EffectModel, law};
use crate::whisker::stage_motion::velocity;
use crate::whisker::whisker_effect::{Observers, WhiskerEffect};
use nalgebra::Vector3;

/// The cameras moved against each other after their calibration: everything that they see is
/// displaced as one rigid body, in their frame.
///
/// ```text
/// r' = r + t + w x (r - c)        t: shift, w: small turn, c: the mean of the grooves, so that both parts stand for themselves
/// ```
pub(crate) fn camera_pose() -> WhiskerEffect {
    let during = rigid("during-the-session");
    let during = during.shape(
        "from_share",
        "1",
        [0.02, 0.98],
        &[0.2, 0.35, 0.5, 0.65, 0.8],
    );
    WhiskerEffect {
        pictures: |values, seen| {
            let [shift, turn] = [0, 3].map(|k| Vector3::from_column_slice(&values.all()[k..k + 3]));
            let from = if values.law() == "during-the-session" {
                values.of("from_share")
            } else {
                0.0
            };
            let centre =
                seen.iter().map(|s| s.groove_mm).sum::<Vector3<f64>>() / seen.len().max(1) as f64;
            let moved = |p: &mut Vector3<f64>| *p += shift + turn.cross(&(*p - centre));
            for s in seen.iter_mut().filter(|s| s.place >= from) {
                moved(&mut s.groove_mm);
                s.stations_mm.iter_mut().for_each(moved);
            }
        },
        ..WhiskerEffect::new(
            "camera-pose",
            "The whole scene is displaced in the pictures: the cameras moved after their calibration.",
            vec![rigid("before-the-session"), during],
        )
    }
}

/// The law with its six amplitudes.
fn rigid(name: &'static str) -> EffectModel {
    let shifts = ["shift_x_mm", "shift_y_mm", "shift_z_mm"];
    let turns = ["turn_x_rad", "turn_y_rad", "turn_z_rad"];
    law(name)
        .needing(&[Pictures])
        .amplitudes(shifts, "mm", [-5.0, 5.0], 0.1)
        .amplitudes(turns, "rad", [-0.1, 0.1], 0.005)
}

/// The calibration board is not as large as stated: a stereo pair has the scale of its board, and
/// every length that the cameras measure is off by one factor (Hartley & Zisserman, Multiple View
/// Geometry, ch. 10.2).
pub(crate) fn board_scale() -> WhiskerEffect {
    let one_factor = law("one-factor").needing(&[Pictures]);
    WhiskerEffect {
        pictures: |values, seen| {
            let scale = values.of("relative_scale");
            for s in seen {
                match s.derivatives.clone().board_scale.as_ref() {
                    Some(by) => s.add(by, scale),
                    // About the base's origin, from which every length is taken.
                    None => {
                        s.groove_mm *= 1.0 + scale;
                        s.arclength_mm *= 1.0 + scale;
                        s.stations_mm.iter_mut().for_each(|p| *p *= 1.0 + scale);
                    }
                }
            }
        },
        ..WhiskerEffect::new(
            "board-scale",
            "All lengths in the pictures are wrong by one factor: the calibration board differs from its stated size.",
            vec![one_factor.amplitude("relative_scale", "1", [-0.1, 0.1], 0.005)],
        )
    }
}

/// The rig tag is glued askew: the tag says where along the wire the groove is, the wire's own
/// pictures say where across.
pub(crate) fn rig_tag() -> WhiskerEffect {
    let rigid = law("rigid").needing(&[Pictures]);
    let offsets = ["offset_x_mm", "offset_y_mm", "offset_z_mm"];
    let rigid = rigid.amplitudes(offsets, "mm", [-5.0, 5.0], 0.2);
    WhiskerEffect {
        pictures: |values, seen| {
            let offset = values.all();
            for s in seen {
                match s.derivatives.clone().rig_tag.as_ref() {
                    Some(by) => by
                        .iter()
                        .zip(offset)
                        .for_each(|(by, size)| s.add(by, *size)),
                    // The foot of the tag's groove on the wire moves along it.
                    None => {
                        let along = s.tangent.dot(&Vector3::from_column_slice(offset));
                        s.groove_mm += s.tangent * along;
                        s.arclength_mm += along;
                    }
                }
            }
        },
        ..WhiskerEffect::new(
            "rig-tag",
            "The rig tag is displaced from its stated position: the contact appears shifted along the wire by a constant.",
            vec![rigid],
        )
    }
}

/// The pictures' clock is off the stage's: a pair taken while the stage moves shows the groove at
/// x + v tau.
pub(crate) fn picture_clock() -> WhiskerEffect {
    let offset = law("offset").needing(&[Pictures, MovingPictures]);
    WhiskerEffect {
        observers: Observers::Cameras,
        pose: |values, path, xs_mm| {
            let clock_s = values.of("clock_s");
            for (node, x) in path.nodes.iter().zip(xs_mm) {
                *x += velocity(path, node) * clock_s;
            }
        },
        ..WhiskerEffect::new(
            "picture-clock",
            "The cameras' clock is offset: pictures taken in motion show another position than their rows.",
            vec![offset.amplitude("clock_s", "s", [-1.0, 1.0], 0.02)],
        )
    }
}
