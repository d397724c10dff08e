//! What the noise of a whisker session can depend on: its clock, which poses were held, load and
//! depth, and how its values were written.

use super::path::{Reading, WhiskerPath, averaged_readings};
use crate::method::NoiseInputs;
use std::sync::Arc;
use wcal_core::observation::WhiskerData;
use wcal_core::order_statistics::median;

/// Stage positions nearer than this are one, mm (half a microstep of the finest stages).
const SAME_MM: f64 = 5e-5;
/// A reading with this many times the typical noise of averaging counts less.
const FEW_SAMPLES: f64 = 10.0;
/// Steps of recorded wavelengths that are looked for, pm, coarsest first; finer ones are far below
/// any noise.
const STEPS_PM: [f64; 6] = [1000.0, 100.0, 10.0, 1.0, 0.1, 0.01];

/// The inputs of the noise model.
pub(crate) fn noise_inputs(data: &WhiskerData, path: &WhiskerPath) -> NoiseInputs {
    let r = &path.readings;
    let mut settings = Vec::with_capacity(r.len());
    for i in 0..r.len() {
        let held = i > 0 && held(&r[i - 1], &r[i], path.columns.time);
        settings.push(match settings.last() {
            Some(last) if held => *last,
            Some(last) => last + 1,
            None => 0,
        });
    }
    let load = r.iter().map(|r| f64::from(u8::from(!r.rest))).collect();
    // As a share of the line: readings of short and long lines are compared.
    let depth = |r: &Reading| match r.line {
        Some(l) if !r.rest && path.reach_mm[l] > 0.0 => r.x_mm / path.reach_mm[l],
        _ => 0.0,
    };
    NoiseInputs {
        counts_readings: false,
        clock: path
            .columns
            .time
            .then(|| Arc::new(r.iter().map(|r| r.t_s).collect())),
        settings: Arc::new(settings),
        posed: Arc::new(r.iter().map(|r| !r.rest).collect()),
        spread: vec![
            ("load".to_owned(), load),
            ("depth".to_owned(), r.iter().map(depth).collect()),
        ],
        known: known(r),
        averaged: averaged_readings(r).unwrap_or_default(),
        step: [0, 1].map(|c| step_pm(data, c)).to_vec(),
    }
}

/// Whether the stage did not move between two readings: the same place, and where dwells are known
/// the later one's covers the time between.
fn held(a: &Reading, b: &Reading, time: bool) -> bool {
    let same = a.line == b.line
        && a.seating == b.seating
        && (a.x_mm - b.x_mm).abs() < SAME_MM
        && a.rest == b.rest;
    let settled = a.velocity_mm_s == 0.0 && b.velocity_mm_s == 0.0;
    let stayed = !time || b.dwell_s <= 0.0 || b.dwell_s + 1e-6 >= b.t_s - a.t_s;
    // A reversal moves the groove by the backlash even where the stage reads the same.
    same && settled && stayed && a.direction * b.direction >= 0.0
}

/// Readings whose place is not known do not count; those with larger known sample noise count less:
/// the common part is not known yet, so only the worst ones feel it.
fn known(readings: &[Reading]) -> Vec<f64> {
    let own: Vec<f64> = readings
        .iter()
        .map(|r| r.sample_sd_pm[0].hypot(r.sample_sd_pm[1]))
        .collect();
    let limit = FEW_SAMPLES * median(own.iter().copied()).unwrap_or_default();
    let of = |(s, r): (&f64, &Reading)| {
        let weight = if limit > 0.0 && *s > limit {
            limit / s
        } else {
            1.0
        };
        if r.unsteady { 0.0 } else { weight }
    };
    own.iter().zip(readings).map(of).collect()
}

/// Coarsest step of which all recorded wavelengths of a channel are multiples, pm; none where they
/// are written finely.
pub(super) fn step_pm(data: &WhiskerData, channel: usize) -> Option<f64> {
    let first = data.rows.first()?.shift_pm[channel];
    let on = |step: f64| {
        let off = |v: f64| {
            let k = (v - first) / step;
            (k - k.round()).abs() * step
        };
        // Wavelengths in nm carry nine digits before the rounding of their difference.
        data.rows
            .iter()
            .all(|r| off(r.shift_pm[channel]) < 2e-3 * step.min(1.0))
    };
    let moves = data.rows.iter().any(|r| r.shift_pm[channel] != first);
    // Every record is a multiple of the finest step: that one says nothing.
    STEPS_PM
        .into_iter()
        .find(|s| moves && on(*s))
        .filter(|s| *s > STEPS_PM[5])
}
