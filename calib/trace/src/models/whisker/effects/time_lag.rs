//! A delay between stage and wavelengths: a transport delay, or the low-pass filter of an interrogator or of a bond.
//!
//! ```text
//! delay          the reading belongs to x(t - tau)
//! first-order    the reading belongs to d with tau d' = x - d      (steady motion: x - v tau; after a start or a stop it takes some tau)
//! ```

use super::creep::relax;
use super::law;
use crate::effect::{Effect, EffectModel, LawRequirement, Values};
use crate::whisker::Observers;
use crate::whisker::WhiskerEffect;
use crate::whisker::path::WhiskerPath;
use crate::whisker::way::{MotionSegment, way_between};

/// See the module.
pub struct TimeLag;

impl Effect for TimeLag {
    fn id(&self) -> &'static str {
        "time-lag"
    }
    fn laws(&self) -> Vec<EffectModel> {
        let lag =
            |name| law(name).needing(&[LawRequirement::Motion]).amplitude("lag_s", "s", [0.0, 1.0], 0.02);
        vec![lag("delay"), lag("first-order")]
    }
    fn sentence(&self) -> &'static str {
        "Readings taken while the stage moves belong to an earlier position."
    }
    fn source(&self) -> &'static str {
        "clock offset or filter delay between interrogator and stage"
    }
}

impl WhiskerEffect for TimeLag {
    fn observers(&self) -> Observers {
        Observers::Gratings
    }

    fn pose(&self, values: &Values, path: &WhiskerPath, xs_mm: &mut [f64]) {
        let lag_s = values.of("lag_s");
        if lag_s <= 0.0 {
            return;
        }
        let late: Vec<f64> = match values.law() {
            "first-order" => low_passed(path, xs_mm, lag_s),
            _ => (0..xs_mm.len()).map(|k| delayed(path, xs_mm, lag_s, k)).collect(),
        };
        xs_mm.copy_from_slice(&late);
    }
}

/// Position at node `k` in steady motion, mm.
fn steady(path: &WhiskerPath, xs_mm: &[f64], lag_s: f64, k: usize) -> f64 {
    xs_mm[k] - path.nodes[k].reading.map_or(0.0, |i| path.readings[i].velocity_mm_s) * lag_s
}

/// Position `lag_s` before node `k`, mm, along the way back as far as it is known.
fn delayed(path: &WhiskerPath, xs_mm: &[f64], lag_s: f64, k: usize) -> f64 {
    let mut left_s = lag_s;
    let mut at = k;
    while at > 0 {
        let Some(pieces) = way_between(path, xs_mm, at - 1) else { break };
        for MotionSegment { from_mm, to_mm, dt_s } in pieces.into_iter().rev() {
            if left_s <= dt_s {
                return if dt_s > 0.0 { to_mm + (from_mm - to_mm) * left_s / dt_s } else { to_mm };
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
        let last = k.checked_sub(1).and_then(|before| Some((out[before], way_between(path, xs_mm, before)?)));
        out.push(match last {
            Some((d, pieces)) => pieces.iter().fold(d, |d, p| relax(d, p.from_mm, p.to_mm, p.dt_s, lag_s)),
            None => steady(path, xs_mm, lag_s, k),
        });
    }
    out
}
