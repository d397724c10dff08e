//! Effects on the stimulus, and those that can act on it.

use super::memory::{
    bouc_wen, delayed, play, relaxed, relaxed_by_steps, relaxed_from, spread_of_jumps,
};
use crate::effect::LawRequirement::{BothDirections, Slope, Time};
use crate::effect::{Effect, EffectModel, Values, law};
use crate::scalar::frame::Declared;
use crate::scalar::scalar_effect::ScalarEffect;

/// Scale error: the response follows x (1 + e), a sensitivity or lead error (systematic deviation
/// of ISO 230-2); a free slope takes it up whole. `sloped`: the declared model follows the
/// stimulus.
pub(crate) fn scale(sloped: bool) -> ScalarEffect {
    let relative = if sloped {
        law("relative").amplitude("relative_scale", "1", [-0.999, 1e5], 1e-3)
    } else {
        law("slope").column("slope", "response/half-range")
    };
    ScalarEffect {
        degree: Some(1),
        warp: |values, frame, u| {
            if frame.sloped() {
                let error = values.of("relative_scale");
                for v in u {
                    // A scale error leaves stimulus zero where it is, not the middle of the range.
                    *v += error * (*v - frame.zero_u);
                }
            }
            true
        },
        columns: |_, frame| {
            Some(if frame.sloped() {
                Vec::new()
            } else {
                vec![frame.u.clone()]
            })
        },
        ..ScalarEffect::new(
            "scale",
            "The response changes in proportion to the stimulus beyond the declared model.",
            vec![relative],
        )
    }
}

/// Creep: the response goes on moving after the stimulus has changed, onward or (negative,
/// recovery) back: one Prony term driven by the stimulus, or the settling of an earlier load.
pub(crate) fn creep() -> ScalarEffect {
    let prony = law("prony")
        .needing(&[Time])
        .amplitude("creep_fraction", "1", [-0.5, 0.5], 0.02)
        .shape(
            "time_constant",
            "duration",
            [1e-3, 3.0],
            &[0.003, 0.01, 0.03, 0.1, 0.3, 1.0],
        );
    let settling = law("settling")
        .needing(&[Time])
        .shape(
            "time_constant",
            "duration",
            [0.01, 0.6],
            &[0.02, 0.05, 0.1, 0.2, 0.4],
        )
        .column("size_at_start", "response");
    // The test of OIML R 60 begins with the load: put on at the first reading, the sensor at rest
    // before.
    let from_rest = EffectModel {
        name: "prony-from-rest",
        ..prony.clone()
    };
    ScalarEffect {
        warp: |values, frame, u| {
            if values.law() == "settling" {
                return true;
            }
            let (true, Some(time)) = (frame.sloped(), &frame.time) else {
                return false;
            };
            let constant = values.of("time_constant");
            let slow = if values.law() == "prony-from-rest" {
                if !frame.begins_loaded() {
                    return false;
                }
                relaxed_from(frame.zero_u, u, time, constant)
            } else {
                relaxed(u, time, constant)
            };
            // u + a r(u): the share a of the response follows late.
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
            Some(vec![
                frame
                    .time
                    .as_ref()?
                    .iter()
                    // What an earlier load left dies away as exp(-t / tau), whatever is loaded now.
                    .map(|t| (-t / constant).exp())
                    .collect(),
            ])
        },
        // After a jump it is an exponential all the same: how much of it passed before the first
        // reading, none of them shows.
        systematic_sd: |values, frame, parameter| match (&frame.time, parameter) {
            (Some(time), "creep_fraction") => {
                let unseen = spread_of_jumps(&frame.u, time, values.of("time_constant"));
                values.of(parameter).abs() * unseen
            }
            _ => 0.0,
        },
        ..Effect {
            has_memory: true,
            superposes: true,
            ..Effect::new(
                "creep",
                "The response creeps: it keeps changing after the stimulus has settled.",
                vec![prony, settling, from_rest],
            )
        }
        .into()
    }
}

/// How much of a loop lies between the state before the first move and that of its direction:
/// nothing says where a record begins. A virgin sensor is halfway, one that was unloaded before the
/// zero reading is on the other branch.
fn begun(values: &Values<'_>) -> f64 {
    match values.law() {
        law if law.ends_with("-from-rest") => 0.5,
        law if law.ends_with("-turned") => 1.0,
        _ => 0.0,
    }
}

/// Hysteresis: the response depends on whether the stimulus was rising or falling: Coulomb friction
/// by direction, a loop that closes at both ends of the range (elastic hysteresis; DKD-R 6-1, ISO
/// 376 reversibility), or Bouc-Wen with n = 1 (Wen 1976). An axis counts a mere offset by direction
/// as backlash.
///
/// ```text
/// closed loop: (1 - u^2) d (h + s u)        u: stimulus in half ranges, d: +1 rising, -1 falling, h: half the loop at the middle
/// ```
pub(crate) fn hysteresis(declared: Declared) -> ScalarEffect {
    let both = |name| law(name).needing(&[BothDirections]);
    let gradual = both("bouc-wen")
        .amplitude("half_loop", "half-range", [-0.5, 0.5], 0.01)
        .shape("width", "half-range", [0.005, 2.0], &[0.02, 0.1, 0.3, 1.0]);
    let plain = |name| both(name).column("half_loop", "response");
    let closed = both("closed-loop").column("half_loop", "response");
    let skewed = EffectModel {
        name: "skewed-loop",
        ..closed.clone()
    }
    .column("skew", "response");
    let mut laws = vec![gradual, closed, skewed];
    if declared != Declared::Axis {
        laws.splice(
            0..0,
            [
                "by-direction",
                "by-direction-from-rest",
                "by-direction-turned",
            ]
            .map(plain),
        );
    }
    ScalarEffect {
        warp: |values, frame, u| {
            if values.law() != "bouc-wen" {
                return true;
            }
            if !frame.sloped() {
                return false;
            }
            // u + h z: the loop is as wide as the state swings.
            let state = bouc_wen(u, values.of("width"));
            let half_loop = values.of("half_loop");
            for (v, s) in u.iter_mut().zip(state) {
                *v += half_loop * s;
            }
            true
        },
        columns: |values, frame| {
            let by_way = |f: fn(f64) -> f64| {
                // Before the first move: on this branch, halfway (0), or on the other one (-1).
                let direction = frame.direction_begun(1.0 - 2.0 * begun(values))?;
                Some(
                    direction
                        .iter()
                        .zip(&frame.u)
                        .map(|(d, u)| d * f(*u))
                        .collect::<Vec<f64>>(),
                )
            };
            if !values.law().starts_with("by-direction")
                && !frame.new_rows
                && !frame.read_both_ways()
            {
                return (values.law() == "bouc-wen").then(Vec::new);
            }
            match values.law() {
                "closed-loop" => Some(vec![by_way(|u| 1.0 - u * u)?]),
                "skewed-loop" => Some(vec![
                    by_way(|u| 1.0 - u * u)?,
                    by_way(|u| u * (1.0 - u * u))?,
                ]),
                "bouc-wen" => Some(Vec::new()),
                _ => Some(vec![by_way(|_| 1.0)?]),
            }
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

/// Backlash: after a reversal the output stays until the play is taken up (play operator). Of an
/// axis an offset by direction is backlash, too (reversal value B of ISO 230-2).
pub(crate) fn backlash(declared: Declared) -> ScalarEffect {
    let taken_up = |name| {
        let both = law(name).needing(&[Slope, BothDirections]);
        both.amplitude("backlash", "half-range", [0.0, 0.5], 0.01)
    };
    let reversal = law("reversal")
        .needing(&[BothDirections])
        .column("reversal_value", "response");
    let mut laws = ["play", "play-from-rest", "play-turned"]
        .map(taken_up)
        .to_vec();
    if declared == Declared::Axis {
        laws.push(reversal);
    }
    ScalarEffect {
        warp: |values, _, u| {
            if values.law() != "reversal" {
                // The response follows what the play lets through.
                let held = play(u, values.of("backlash"), begun(values));
                u.copy_from_slice(&held);
            }
            true
        },
        columns: |values, frame| {
            if values.law() != "reversal" {
                return Some(Vec::new());
            }
            // Zero on the way up: the coefficient is the difference down less up.
            Some(vec![
                frame
                    .direction
                    .as_ref()?
                    .iter()
                    .map(|d| 0.5 * (1.0 - d))
                    .collect(),
            ])
        },
        ..Effect {
            has_memory: true,
            ..Effect::new(
                "backlash",
                "After a reversal the output stays until the play is taken up.",
                laws,
            )
        }
        .into()
    }
}

/// What ends the name of a lag whose state at the first reading is free.
const FROM_ANY_STATE: &str = "-from-any-state";

/// Lag: the response belongs to an earlier stimulus: pure delay of unsynchronised clocks, or a
/// first-order low pass. What the stimulus did before the first reading is not known: it stood
/// still, it moved as it does after it, or it left the low pass in any state r0. Nor is what it did
/// between readings: it moved evenly, or jumped.
///
/// ```text
/// r(t) = r_still(t) + (r0 - u0) exp(-(t - t0) / tau)          r' = (u - r) / tau
/// ```
pub(crate) fn lag() -> ScalarEffect {
    let late = |name, value| {
        let timed = law(name).needing(&[Slope, Time]);
        timed.amplitude(value, "duration", [0.0, 0.1], 2e-3)
    };
    let first_order = late("first-order", "time_constant");
    // A step at a reading is estimated a little before or after it.
    let by_steps = late("first-order-by-steps", "time_constant").shape(
        "moment_of_step",
        "interval",
        [-0.2, 1.2],
        &[0.0, 0.5, 1.0],
    );
    // Bounded, and not a free column: readings after it died away leave it where it is.
    let from_any = |name, law: EffectModel| {
        EffectModel { name, ..law }.shape(
            "first_state",
            "half-range",
            [-2.0, 2.0],
            &[-0.5, 0.0, 0.5],
        )
    };
    ScalarEffect {
        warp: |values, frame, u| {
            let Some(time) = &frame.time else {
                return false;
            };
            let late = values.all()[0];
            if late > 0.0 {
                let mut moved = match values.law() {
                    "delay" => delayed(u, time, late, false),
                    "delay-in-motion" => delayed(u, time, late, true),
                    law if law.contains("by-steps") => {
                        relaxed_by_steps(u, time, late, values.of("moment_of_step"))
                    }
                    _ => relaxed(u, time, late),
                };
                if values.law().ends_with(FROM_ANY_STATE) {
                    let off = values.of("first_state");
                    moved
                        .iter_mut()
                        .zip(time)
                        // The free solution of tau r' = u - r: time begins with the first reading.
                        .for_each(|(m, t)| *m += off * (-t / late).exp());
                }
                u.copy_from_slice(&moved);
            }
            true
        },
        ..Effect {
            has_memory: true,
            ..Effect::new(
                "lag",
                "The response lags behind the stimulus in time.",
                vec![
                    late("delay", "delay"),
                    first_order.clone(),
                    late("delay-in-motion", "delay"),
                    by_steps.clone(),
                    from_any("first-order-from-any-state", first_order),
                    from_any("first-order-by-steps-from-any-state", by_steps),
                ],
            )
        }
        .into()
    }
}
