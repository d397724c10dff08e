//! Effects that add columns to the readout, and single readings.

use crate::effect::LawRequirement::{RestReadings, Temperature, Time};
use crate::effect::{Effect, law};
use crate::whisker::path::{Reading, WhiskerPath};
use crate::whisker::whisker_effect::WhiskerEffect;

/// Five times what is usual at most (4 % of full scale), which leaves room for its standard
/// deviation: more is no grating's nonlinearity.
const MAX_SHARE: f64 = 0.2;

/// One column, its value at each reading.
fn column(path: &WhiskerPath, of: impl Fn(&Reading) -> f64) -> Vec<Vec<f64>> {
    vec![path.readings.iter().map(of).collect()]
}

/// Rest of the temperature compensation, dk (T - T0) in each channel: difference of the temperature
/// coefficients, tens of pm/K where bonded to polymer.
pub(crate) fn temperature_mismatch() -> WhiskerEffect {
    let linear = law("linear").needing(&[Temperature]);
    WhiskerEffect {
        // Of the other readings: this one's own noise is in its compensated shifts as well, and
        // would pull the coefficient.
        columns: |_, path, origin, _| {
            column(path, |r| r.temperature_loo_degc - origin.temperature_degc)
        },
        ..WhiskerEffect::new(
            "temperature-mismatch",
            "Sensing and reference gratings differ in temperature sensitivity: compensation is incomplete.",
            vec![linear.column("mismatch_pm_per_degc", "pm/degC")],
        )
    }
}

/// Drift of the zero, linear in time: relaxation of bonds and packaging, interrogator drift.
pub(crate) fn zero_drift() -> WhiskerEffect {
    let linear = law("linear").needing(&[Time]);
    WhiskerEffect {
        columns: |_, path, origin, _| {
            // In minutes, for a drift in pm/min.
            column(path, |r| (r.t_s - origin.t_s) / 60.0)
        },
        ..WhiskerEffect::new(
            "zero-drift",
            "The zero of the readings drifts with time.",
            vec![linear.column("drift_pm_per_min", "pm/min")],
        )
    }
}

/// Rest readings of another zero than the loaded ones: `y = y0 + z` at rest, `y = y0 + K m` under
/// load.
///
/// A rest reading that was taken on another day, after a remount or before the wire was seated says
/// nothing of the zero that the loaded readings have: packaging and bond settle at first load.
pub(crate) fn rest_zero() -> WhiskerEffect {
    let step = law("step").needing(&[RestReadings]);
    WhiskerEffect {
        columns: |_, path, _, _| column(path, |r| f64::from(u8::from(r.rest))),
        ..WhiskerEffect::new(
            "rest-zero",
            "The rest readings have another zero than the loaded ones (taken at another time or mounting).",
            vec![step.column("rest_zero_pm", "pm")],
        )
    }
}

/// Quadratic form of the moment in each channel: second-order strain-optic and bonding terms.
pub(crate) fn fbg_nonlinearity() -> WhiskerEffect {
    let quadratic = law("quadratic")
        .column("quadratic_11", "pm/(N mm)^2")
        .column("quadratic_12", "pm/(N mm)^2")
        .column("quadratic_22", "pm/(N mm)^2")
        .at_most(MAX_SHARE);
    WhiskerEffect {
        columns: |_, _, _, moments_nmm| {
            let product = |a: usize, b: usize| moments_nmm.iter().map(|m| m[a] * m[b]).collect();
            vec![product(0, 0), product(0, 1), product(1, 1)]
        },
        ..WhiskerEffect::new(
            "fbg-nonlinearity",
            "The wavelength shift is nonlinear in the moment.",
            vec![quadratic],
        )
    }
}

/// Single readings with the wire out of the vertex.
pub(crate) fn slip_outliers() -> WhiskerEffect {
    let sentence =
        "Outlying readings were excluded: the wire possibly left the vertex of the groove.";
    let found_singly = Effect::new("slip-outliers", sentence, vec![law("single-readings")]);
    Effect {
        is_outlier_process: true,
        ..found_singly
    }
    .into()
}
