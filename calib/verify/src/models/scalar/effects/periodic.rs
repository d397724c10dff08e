//! Periodic effect: sine and cosine over stimulus, time or order, with a free frequency.

use crate::effect::LawRequirement::{Order, Time};
use crate::effect::{Effect, law};
use crate::scalar::frame::{Frame, correlation};
use crate::scalar::scalar_effect::{ScalarEffect, steps_above};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;

/// Identifier of the periodic effect.
pub(crate) const PERIODIC: &str = "periodic";

/// Half cycles: neighbouring frequencies are then still half in step, and the fit slides to the
/// best between them.
const GRID: [f64; 197] = steps_above(1.75, 0.5);

/// With fewer cycles nothing was seen to repeat: such a wave is a bend or a slope by another name.
const MIN_CYCLES: f64 = 2.0;

/// Cycles of bends that never repeat, so near each other that one of them follows any bend to a
/// tenth of its size.
const SQUIGGLES: [f64; 14] = [
    0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.85,
];

/// Harmonic regression; frequencies up to the sampling limit or 100 cycles.
pub(crate) fn periodic() -> ScalarEffect {
    let wave = |name, unit| {
        let period = law(name).shape("period", unit, [MIN_CYCLES, 120.0], &GRID);
        period
            .column("sine", "response")
            .column("cosine", "response")
    };
    // Eccentricity of an encoder's magnet or disc acts once a turn, its tilt twice.
    let of_turn = |name| {
        law(name)
            .column("sine", "response")
            .column("cosine", "response")
    };
    ScalarEffect {
        waves_of_stimulus: &["over-stimulus", "once-a-turn", "twice-a-turn"],
        spans_too_few_periods: &SQUIGGLES,
        not_observable: |frame| {
            (frame.scaling.count < MIN_PLACES).then(|| format!("fewer than {MIN_PLACES} readings"))
        },
        columns: |values, frame| {
            if let Some(period) = of_a_turn(values.law(), frame) {
                return period.map(|period| waves(frame.rows.iter().map(|r| TAU * r.x / period)));
            }
            // A free phase is a free sine and cosine of one frequency.
            let (place, places) = variable(values.law(), frame)?;
            // Above half a cycle from place to place a frequency is another one's alias.
            let cycles = values.of("period");
            let aliased = places < MIN_PLACES || cycles > 0.5 * (places as f64 - 1.0);
            if aliased && !frame.new_rows {
                return None;
            }
            let phase: Vec<f64> = place.iter().map(|p| TAU * cycles * p).collect();
            let locked = || {
                let design = DMatrix::from_fn(phase.len(), 3, |i, j| match j {
                    0 => 1.0,
                    1 => phase[i].sin(),
                    _ => phase[i].cos(),
                });
                is_locked(&design, &DVector::from_column_slice(&frame.u))
                    || locked_to_strokes(frame, &phase)
            };
            if values.law() != "over-stimulus" && !frame.new_rows && locked() {
                return None;
            }
            Some(waves(phase.into_iter()))
        },
        ..Effect {
            superposes: true,
            // Of the third wave a turn to the fourth.
            min_shape_ratio: 1.3,
            ..Effect::new(
                PERIODIC,
                "The residual repeats with a fixed period.",
                vec![
                    wave("over-stimulus", "period:stimulus"),
                    wave("over-time", "period:time").needing(&[Time]),
                    wave("over-order", "period:order").needing(&[Order]),
                    of_turn("once-a-turn"),
                    of_turn("twice-a-turn"),
                ],
            )
        }
        .into()
    }
}

/// Period of a law that counts turns, where the stimulus goes around; none of other laws.
pub(crate) fn of_a_turn(law: &str, frame: &Frame) -> Option<Option<f64>> {
    match law {
        "once-a-turn" => Some(frame.scaling.turn),
        "twice-a-turn" => Some(frame.scaling.turn.map(|turn| 0.5 * turn)),
        _ => None,
    }
}

/// Sine and cosine of a phase.
fn waves(phase: impl Iterator<Item = f64> + Clone) -> Vec<Vec<f64>> {
    [f64::sin as fn(f64) -> f64, f64::cos]
        .map(|f| phase.clone().map(f).collect())
        .into()
}

/// A wave in time that explains this share of the stimulus runs with the stimulus: what follows it
/// is a function of the stimulus.
const LOCKED: f64 = 0.95;

/// Whether the columns of a design explain the share [`LOCKED`] of the variance of `y`.
fn is_locked(design: &DMatrix<f64>, y: &DVector<f64>) -> bool {
    let left = design.clone().svd(true, true).solve(y, 1e-9);
    let total = y.add_scalar(-y.mean()).norm_squared();
    left.is_ok_and(|b| (y - design * b).norm_squared() < (1.0 - LOCKED) * total)
}

/// Strokes from which on a wave that follows stimulus and direction counts as the strokes' own.
const MIN_STROKES: usize = 5;

/// Degree of the polynomial of the stimulus that stands for whatever repeats with the strokes.
const STROKE_DEGREE: usize = 6;

/// A polynomial of the stimulus for each direction explains sine and cosine: the wave or its
/// fundamental repeats with the strokes.
fn locked_to_strokes(frame: &Frame, phase: &[f64]) -> bool {
    let Some(direction) = frame.direction.as_ref() else {
        return false;
    };
    // Few strokes repeat nothing.
    let strokes = 1 + direction.windows(2).filter(|d| d[0] * d[1] < 0.0).count();
    if strokes < MIN_STROKES {
        return false;
    }
    let design = DMatrix::from_fn(phase.len(), 2 * (STROKE_DEGREE + 1), |i, j| {
        // Any smooth function of stimulus and direction: even columns plain, odd ones by direction.
        let power = frame.u[i].powi(j as i32 / 2);
        if j % 2 == 0 {
            power
        } else {
            power * direction[i]
        }
    });
    let waves = waves(phase.iter().copied());
    let mut waves = waves.into_iter().map(DVector::from_vec);
    waves.all(|wave| is_locked(&design, &wave))
}

/// Two covariates that run together this closely are one.
const SAME: f64 = 0.9999;
/// Fewer places than this do not show a period.
const MIN_PLACES: usize = 12;

/// The covariate of a law, from 0 to 1, and how many different places it has; none where another
/// law covers it.
fn variable(law: &str, frame: &Frame) -> Option<(Vec<f64>, usize)> {
    // New rows are not searched: they follow the law that was fitted.
    // A column that counts the readings stands in for a clock only where there is none.
    let by_clock = frame.counts_readings && frame.time.is_some();
    let same =
        |a: &[f64], b: &[f64]| !frame.new_rows && !by_clock && correlation(a, b).abs() > SAME;
    let n = frame.scaling.count;
    match law {
        "over-stimulus" if by_clock => None,
        // From -1..1 to 0..1, so that cycles are counted over the whole range.
        "over-stimulus" => Some((
            frame.u.iter().map(|u| 0.5 * (u + 1.0)).collect(),
            frame.levels(),
        )),
        "over-time" => frame
            .time
            .as_ref()
            .filter(|_| frame.new_rows || !frame.swept_once())
            .map(|t| (t.clone(), n)),
        _ => {
            // The order of the rows stands in for a clock only where there is none.
            let known = frame.time.is_some() || same(&frame.u, &frame.order) || frame.swept_once();
            (!known && frame.ordered).then(|| (frame.order.clone(), n))
        }
    }
}
