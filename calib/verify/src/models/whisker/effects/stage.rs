//! Effects on the position of the stage.

use crate::effect::LawRequirement::{Motion, StagePosition};
use crate::effect::law;
use crate::models::relaxation::relax;
use crate::whisker::path::WhiskerPath;
use crate::whisker::stage_motion::{MotionSegment, motion_between, velocity};
use crate::whisker::whisker_effect::{Observers, WhiskerEffect};

/// Lost motion: after a reversal the groove stays until the play is taken up. X-LSM100A states < 12
/// um between screw and nut, with encoder (device notes).
pub(crate) fn stage_backlash() -> WhiskerEffect {
    let play = |name| law(name).amplitude("backlash_mm", "mm", [0.0, 0.3], 0.01);
    WhiskerEffect {
        pose: |values, path, xs_mm| {
            let play = values.of("backlash_mm");
            // Loading reads true where the axis was referenced that way; centred play is off by
            // half on either side.
            let shift = if values.law() == "play-from-loading" {
                0.0
            } else {
                -0.5 * play
            };
            let mut line = None;
            let mut held = 0.0;
            for (node, x) in path.nodes.iter().zip(xs_mm.iter_mut()) {
                // A line begins in the loading direction, with the play taken up.
                if node.line != line {
                    line = node.line;
                    held = *x;
                }
                // Play operator: the groove follows once the play is taken up.
                held = held.clamp(*x, *x + play);
                *x = held + shift;
            }
        },
        ..WhiskerEffect::new(
            "stage-backlash",
            "Backlash: after a reversal the stage lags behind its command.",
            vec![play("play-from-loading"), play("play-centred")],
        )
    }
}

/// Scale error, x (1 + e): lead error of the screw.
pub(crate) fn stage_scale() -> WhiskerEffect {
    WhiskerEffect {
        pose: |values, _, xs_mm| {
            let relative_scale = values.of("relative_scale");
            for x in xs_mm {
                *x *= 1.0 + relative_scale;
            }
        },
        ..WhiskerEffect::new(
            "stage-scale",
            "Scale error: the stage travels a constant factor more or less than commanded.",
            vec![law("linear").needing(&[StagePosition]).amplitude(
                "relative_scale",
                "1",
                [-0.03, 0.03],
                0.01,
            )],
        )
    }
}

/// Periodic error, A sin(2 pi x / pitch) + B cos(2 pi x / pitch). LSM100A: screw lead 0.6096 mm a
/// turn (device notes).
pub(crate) fn stage_periodic() -> WhiskerEffect {
    let screw = law("screw")
        .needing(&[StagePosition])
        .amplitudes(["sine_mm", "cosine_mm"], "mm", [-0.1, 0.1], 0.005)
        .shape("pitch_mm", "mm", [0.25, 1.3], &[0.6096, 0.3048, 1.2192]);
    WhiskerEffect {
        pose: |values, _, xs_mm| {
            let [sine_mm, cosine_mm, pitch_mm] =
                ["sine_mm", "cosine_mm", "pitch_mm"].map(|name| values.of(name));
            for x in xs_mm {
                let (sin, cos) = (std::f64::consts::TAU * *x / pitch_mm).sin_cos();
                *x += sine_mm * sin + cosine_mm * cos;
            }
        },
        ..WhiskerEffect::new(
            "stage-periodic",
            "Periodic error: the stage position errs with the period of the screw.",
            vec![screw],
        )
    }
}

/// A delay between stage and wavelengths: the clocks' offset, a transport delay, or the low-pass
/// filter of an interrogator or of a bond.
///
/// ```text
/// delay          the reading belongs to x(t - tau)
/// first-order    the reading belongs to d with tau d' = x - d      (steady motion: x - v tau; after a start or a stop it takes some tau)
/// ```
pub(crate) fn time_lag() -> WhiskerEffect {
    let lag = |name| {
        law(name)
            .needing(&[Motion])
            .amplitude("lag_s", "s", [0.0, 1.0], 0.02)
    };
    WhiskerEffect {
        observers: Observers::Gratings,
        pose: |values, path, xs_mm| {
            let lag_s = values.of("lag_s");
            if lag_s <= 0.0 {
                return;
            }
            // A filter remembers the whole way, a transport delay one moment of it.
            let late: Vec<f64> = match values.law() {
                "first-order" => low_passed(path, xs_mm, lag_s),
                _ => (0..xs_mm.len())
                    .map(|k| delayed(path, xs_mm, lag_s, k))
                    .collect(),
            };
            xs_mm.copy_from_slice(&late);
        },
        ..WhiskerEffect::new(
            "time-lag",
            "Readings taken while the stage moves belong to an earlier position.",
            vec![lag("delay"), lag("first-order")],
        )
    }
}

/// Position at node `k` in steady motion, mm.
fn steady(path: &WhiskerPath, xs_mm: &[f64], lag_s: f64, k: usize) -> f64 {
    xs_mm[k] - velocity(path, &path.nodes[k]) * lag_s
}

/// Position `lag_s` before node `k`, mm, along the way back as far as it is known.
fn delayed(path: &WhiskerPath, xs_mm: &[f64], lag_s: f64, k: usize) -> f64 {
    let mut left_s = lag_s;
    let mut at = k;
    while at > 0 {
        let Some(pieces) = motion_between(path, xs_mm, at - 1) else {
            break;
        };
        for MotionSegment {
            from_mm,
            to_mm,
            dt_s,
        } in pieces.into_iter().rev()
        {
            if left_s <= dt_s {
                return if dt_s > 0.0 {
                    to_mm + (from_mm - to_mm) * left_s / dt_s
                } else {
                    to_mm
                };
            }
            left_s -= dt_s;
        }
        at -= 1;
    }
    // Before what is recorded the groove came as it moved then.
    steady(path, xs_mm, left_s, at)
}

/// Low-passed positions at every node, mm.
fn low_passed(path: &WhiskerPath, xs_mm: &[f64], lag_s: f64) -> Vec<f64> {
    let mut out: Vec<f64> = Vec::with_capacity(xs_mm.len());
    for k in 0..xs_mm.len() {
        let last = k
            .checked_sub(1)
            .and_then(|before| Some((out[before], motion_between(path, xs_mm, before)?)));
        out.push(match last {
            Some((d, pieces)) => pieces
                .iter()
                .fold(d, |d, p| relax(d, [p.from_mm, p.to_mm], p.dt_s / lag_s)),
            // In steady motion a first-order filter lags by v tau.
            None => steady(path, xs_mm, lag_s, k),
        });
    }
    out
}
