//! Effects on the stimulus, and those that can act on it.

use super::memory::{bouc_wen, delayed, play, relaxed};
use crate::effect::{Effect, LawRequirement, law};
use crate::scalar::frame::Declared;
use crate::scalar::scalar_effect::ScalarEffect;

/// Scale error: the response follows x (1 + e), a sensitivity or lead error (systematic deviation of ISO 230-2); a free slope takes it up
/// whole. `sloped`: the declared model follows the stimulus.
pub fn scale(sloped: bool) -> ScalarEffect {
    let relative = if sloped {
        law("relative").amplitude("relative_scale", "1", [-0.5, 0.5], 1e-3)
    } else {
        law("slope").column("slope", "response/half-range")
    };
    ScalarEffect {
        degree: Some(1),
        warp: |values, frame, u| {
            if frame.sloped() {
                let error = values.of("relative_scale");
                for v in u {
                    *v += error * (*v - frame.zero_u);
                }
            }
            true
        },
        columns: |_, frame| Some(if frame.sloped() { Vec::new() } else { vec![frame.u.clone()] }),
        ..ScalarEffect::new(
            "scale",
            "The response changes in proportion to the stimulus beyond the declared model.",
            vec![relative],
        )
    }
}

/// Saturation: beyond a knee, away from zero, the response follows the stimulus less or not at all (limit stop or full-scale limit, piecewise
/// linear).
pub fn saturation() -> ScalarEffect {
    const UPPER: &[f64] = &[-0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8];
    const LOWER: &[f64] = &[-0.8, -0.6, -0.4, -0.2, 0.0, 0.2, 0.4];
    let knee = |name, range, grid| {
        // A share of one is complete saturation.
        let lost = law(name).needing(&[LawRequirement::Slope]).amplitude("slope_lost", "1", [0.0, 1.0], 0.2);
        lost.shape("knee", "stimulus", range, grid)
    };
    ScalarEffect {
        warp: |values, frame, u| {
            let (share, knee) = (values.of("slope_lost"), values.of("knee"));
            let upper = values.law() == "upper-knee";
            // Toward zero a lost slope is a dead zone.
            let away = if upper { knee >= frame.zero_u } else { knee <= frame.zero_u };
            if !away {
                return false;
            }
            for v in u {
                let beyond = if upper { (*v - knee).max(0.0) } else { (*v - knee).min(0.0) };
                *v -= share * beyond;
            }
            true
        },
        ..ScalarEffect::new(
            "saturation",
            "Saturation: above a threshold the sensitivity decreases.",
            vec![knee("upper-knee", [-0.9, 0.98], UPPER), knee("lower-knee", [-0.98, 0.9], LOWER)],
        )
    }
}

/// Dead zone: near zero the response follows the stimulus less or not at all (play or threshold, piecewise linear).
pub fn dead_zone() -> ScalarEffect {
    let about_zero = law("about-zero")
        .needing(&[LawRequirement::Slope])
        .amplitude("slope_lost", "1", [0.0, 1.0], 0.2)
        .shape("half_width", "half-range", [0.005, 1.6], &[0.05, 0.1, 0.2, 0.4, 0.8]);
    ScalarEffect {
        not_observable: |frame| {
            let outside = frame.zero_u.abs() > 1.2;
            outside.then(|| "no reading was taken near stimulus zero".to_owned())
        },
        warp: |values, frame, u| {
            let (share, width) = (values.of("slope_lost"), values.of("half_width"));
            for v in u {
                *v -= share * (*v - frame.zero_u).clamp(-width, width);
            }
            true
        },
        ..ScalarEffect::new(
            "dead-zone",
            "Dead zone: near zero the response does not follow the stimulus.",
            vec![about_zero],
        )
    }
}

/// Creep: the response goes on moving after the stimulus has changed, onward or (negative, recovery) back: one Prony term driven by the
/// stimulus, or the settling of an earlier load.
pub fn creep() -> ScalarEffect {
    let prony = law("prony")
        .needing(&[LawRequirement::Time])
        .amplitude("creep_fraction", "1", [-0.5, 0.5], 0.02)
        .shape("time_constant", "duration", [1e-3, 3.0], &[0.003, 0.01, 0.03, 0.1, 0.3, 1.0]);
    let settling = law("settling")
        .needing(&[LawRequirement::Time])
        .shape("time_constant", "duration", [0.01, 0.6], &[0.02, 0.05, 0.1, 0.2, 0.4])
        .column("size_at_start", "response");
    ScalarEffect {
        warp: |values, frame, u| {
            if values.law() == "settling" {
                return true;
            }
            let (true, Some(time)) = (frame.sloped(), &frame.time) else { return false };
            let slow = relaxed(u, time, values.of("time_constant"));
            let fraction = values.of("creep_fraction");
            for (v, r) in u.iter_mut().zip(slow) {
                *v += fraction * r;
            }
            true
        },
        columns: |values, frame| {
            if values.law() != "settling" {
                return Some(Vec::new());
            }
            let constant = values.of("time_constant");
            Some(vec![frame.time.as_ref()?.iter().map(|t| (-t / constant).exp()).collect()])
        },
        ..Effect {
            has_memory: true,
            superposes: true,
            ..Effect::new(
                "creep",
                "The response creeps: it keeps changing after the stimulus has settled.",
                vec![prony, settling],
            )
        }
        .into()
    }
}

/// Hysteresis: the response depends on whether the stimulus was rising or falling: Coulomb friction by direction, or Bouc-Wen with n = 1
/// (Wen 1976). An axis counts a mere offset by direction as backlash.
pub fn hysteresis(declared: Declared) -> ScalarEffect {
    let gradual = law("bouc-wen")
        .needing(&[LawRequirement::BothDirections])
        .amplitude("half_loop", "half-range", [-0.5, 0.5], 0.01)
        .shape("width", "half-range", [0.005, 2.0], &[0.02, 0.1, 0.3, 1.0]);
    let plain =
        law("by-direction").needing(&[LawRequirement::BothDirections]).column("half_loop", "response");
    let laws = if declared == Declared::Axis { vec![gradual] } else { vec![plain, gradual] };
    ScalarEffect {
        warp: |values, frame, u| {
            if values.law() == "by-direction" {
                return true;
            }
            if !frame.sloped() {
                return false;
            }
            let state = bouc_wen(u, values.of("width"));
            let half_loop = values.of("half_loop");
            for (v, s) in u.iter_mut().zip(state) {
                *v += half_loop * s;
            }
            true
        },
        columns: |values, frame| match values.law() {
            "by-direction" => Some(vec![frame.direction.clone()?]),
            _ => Some(Vec::new()),
        },
        ..Effect {
            has_memory: true,
            ..Effect::new(
                "hysteresis",
                "Hysteresis: the response differs between rising and falling stimulus.",
                laws,
            )
        }
        .into()
    }
}

/// Backlash: after a reversal the output stays until the play is taken up (play operator). Of an axis an offset by direction is backlash, too
/// (reversal value B of ISO 230-2).
pub fn backlash(declared: Declared) -> ScalarEffect {
    let taken_up = law("play").needing(&[LawRequirement::Slope, LawRequirement::BothDirections]).amplitude(
        "backlash",
        "half-range",
        [0.0, 0.5],
        0.01,
    );
    let reversal =
        law("reversal").needing(&[LawRequirement::BothDirections]).column("reversal_value", "response");
    let laws = if declared == Declared::Axis { vec![taken_up, reversal] } else { vec![taken_up] };
    ScalarEffect {
        warp: |values, _, u| {
            if values.law() == "play" {
                let held = play(u, values.of("backlash"));
                u.copy_from_slice(&held);
            }
            true
        },
        columns: |values, frame| {
            if values.law() != "reversal" {
                return Some(Vec::new());
            }
            // Zero on the way up: the coefficient is the difference down less up.
            Some(vec![frame.direction.as_ref()?.iter().map(|d| 0.5 * (1.0 - d)).collect()])
        },
        ..Effect {
            has_memory: true,
            ..Effect::new("backlash", "After a reversal the output stays until the play is taken up.", laws)
        }
        .into()
    }
}

/// Lag: the response belongs to an earlier stimulus: pure delay of unsynchronised clocks, or a first-order low pass.
pub fn lag() -> ScalarEffect {
    let late = |name, value| {
        let timed = law(name).needing(&[LawRequirement::Slope, LawRequirement::Time]);
        timed.amplitude(value, "duration", [0.0, 0.1], 2e-3)
    };
    ScalarEffect {
        warp: |values, frame, u| {
            let Some(time) = &frame.time else { return false };
            let late = values.all()[0];
            if late > 0.0 {
                let moved =
                    if values.law() == "delay" { delayed(u, time, late) } else { relaxed(u, time, late) };
                u.copy_from_slice(&moved);
            }
            true
        },
        ..Effect {
            has_memory: true,
            ..Effect::new(
                "lag",
                "The response lags behind the stimulus in time.",
                vec![late("delay", "delay"), late("first-order", "time_constant")],
            )
        }
        .into()
    }
}
