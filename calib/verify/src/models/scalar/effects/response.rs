//! Effects that add columns to the response, and those of its noise.

use crate::effect::LawRequirement::{Clock, Covariate, Temperature};
use crate::effect::{Effect, law};
use crate::method::MIN_READINGS;
use crate::scalar::scalar_effect::{ScalarEffect, steps_above};
use crate::scalar::sequence::MIN_REPEATS;

/// Identifier of the effect on the spread of the noise, found by `scalar::spread_trend`.
pub(crate) const HETEROSCEDASTIC_NOISE: &str = "heteroscedastic-noise";

/// Drift of the zero, in proportion to time, or to the order where there is no time.
pub(crate) fn drift() -> ScalarEffect {
    let linear = law("linear")
        .needing(&[Clock])
        .column("rate", "response/duration");
    ScalarEffect {
        columns: |_, frame| Some(vec![frame.clock().to_vec()]),
        ..ScalarEffect::new("drift", "The zero drifts during the session.", vec![linear])
    }
}

/// Temperature moves the zero, the sensitivity (OIML R 60), or both: where the lines of all
/// temperatures meet need not be the stimulus zero (a pH electrode's isopotential point).
pub(crate) fn temperature() -> ScalarEffect {
    let warm = |name| law(name).needing(&[Temperature]);
    let (zero, slope) = (
        ("zero_shift", "response/degc"),
        ("slope_shift", "response/half-range/degc"),
    );
    ScalarEffect {
        columns: |values, frame| {
            let rise = frame.temperature.as_ref()?;
            // dS (T - T0) (u - u0): nothing changes at stimulus zero.
            let sensitivity = || {
                rise.iter()
                    .zip(&frame.u)
                    .map(|(t, u)| t * (u - frame.zero_u))
                    .collect()
            };
            Some(match values.law() {
                "zero" => vec![rise.clone()],
                "sensitivity" => vec![sensitivity()],
                _ => vec![rise.clone(), sensitivity()],
            })
        },
        ..ScalarEffect::new(
            "temperature",
            "The response moves with the temperature.",
            vec![
                warm("zero").column(zero.0, zero.1),
                warm("sensitivity").column(slope.0, slope.1),
                warm("zero-and-sensitivity")
                    .column(zero.0, zero.1)
                    .column(slope.0, slope.1),
            ],
        )
    }
}

/// Places of a step: every hundredth of what it runs over.
const OF_SESSION: [f64; 99] = steps_above(0.0, 0.01);
const OF_STIMULUS: [f64; 99] = steps_above(-1.0, 0.02);

/// Step: from some reading, or from some stimulus on, every response is shifted; a change point in
/// time, in the order of the readings where the table has no times, or along the stimulus (another
/// range of the read-out, a weight that was exchanged).
pub(crate) fn step() -> ScalarEffect {
    let once = law("once")
        .needing(&[Clock])
        .shape("place", "clock", [0.0, 1.0], &OF_SESSION);
    let along = law("over-stimulus").shape("place", "stimulus", [-1.0, 1.0], &OF_STIMULUS);
    ScalarEffect {
        waves_of_stimulus: &["over-stimulus"],
        columns: |values, frame| {
            let (place, along) = (values.of("place"), values.law() == "over-stimulus");
            // A count that starts again has its own law; in one series the clock is the stimulus.
            let other = if along { !frame.scaling.wraps.is_empty() } else { !frame.ordered || frame.swept_once() };
            if other && !frame.new_rows {
                return None;
            }
            let over = if along { &frame.u } else { frame.clock() };
            let column: Vec<f64> = over.iter().map(|o| f64::from(u8::from(*o >= place))).collect();
            let after = column.iter().filter(|v| **v > 0.0).count();
            // A shift of few readings at either end is a matter of single readings.
            let few = after.min(column.len() - after) < MIN_REPEATS;
            (!few || frame.new_rows).then_some(vec![column])
        },
        ..Effect {
            superposes: true,
            ..Effect::new(
                "step",
                "The response steps: from one reading, or from one stimulus on, all responses are shifted by a constant.",
                vec![once.column("height", "response"), along.column("height", "response")],
            )
        }
        .into()
    }
}

/// Single readings far outside the noise.
pub(crate) fn outliers() -> ScalarEffect {
    let sentence = "Single readings lie far outside the noise of the others.";
    let found_singly = Effect::new("outliers", sentence, vec![law("single-readings")]);
    Effect {
        is_outlier_process: true,
        ..found_singly
    }
    .into()
}

/// The spread of the noise changes with the stimulus: score test of Breusch & Pagan 1979, variance
/// model of Harvey 1976. It has no mean: `scalar::spread_trend` finds it.
pub(crate) fn heteroscedastic_noise() -> ScalarEffect {
    ScalarEffect {
        not_observable: |frame| {
            (frame.scaling.count < MIN_READINGS || !(frame.scaling.half > 0.0))
                .then(|| format!("needs {MIN_READINGS} readings at different stimuli"))
        },
        ..ScalarEffect::new(
            HETEROSCEDASTIC_NOISE,
            "The noise depends on the stimulus; the readings were weighted accordingly.",
            vec![law("spread")],
        )
    }
}

/// A further covariate acts on the response: linear cross-sensitivity, one law for each of the
/// table's `count`; the names stand in the session.
pub(crate) fn cross_axis(count: usize) -> ScalarEffect {
    let one = law("covariate")
        .needing(&[Covariate])
        .column("slope", "response/covariate");
    ScalarEffect {
        columns: |values, frame| Some(vec![frame.covariates.get(values.index())?.clone()?]),
        ..Effect {
            superposes: true,
            by_column: true,
            ..Effect::new(
                "cross-axis",
                "Cross-sensitivity: the response also depends on a second quantity of the table.",
                vec![one; count.max(1)],
            )
        }
        .into()
    }
}
