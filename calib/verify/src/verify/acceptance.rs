//! The last rule on the open readings, for every kind: what is called adequate or explained can be
//! used as a calibration, and the error of readings left out in turn is not far above the floor.
//!
//! ```text
//! error^2 / floor^2 <= max(4, F_{1 - level}(n, dof))          n left-out values, dof of the floor's replicates, level of `levels.rs`
//! ```

use super::judgement::MIN_COVERAGE;
use super::left_out::Errors;
use super::session_model::{FloorStatement, SessionModel};
use crate::method::distributions::f_tail;
use crate::method::hypothesis::Hypothesis;
use crate::method::smooth_rival::SmoothRival;
use wcal_core::text::with_unit;

/// At twice the floor three quarters of the error's variance is no noise of the readings.
const FAR_ABOVE: f64 = 2.0;
/// Degrees of freedom of a floor that does not state them.
const FLOOR_DOF: f64 = 8.0;

/// Why a model cannot be called one that holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Unfit {
    /// It cannot be used, or not on its own rows.
    Unusable(String),
    /// Its error is far above the floor: error, floor.
    FarAboveFloor([f64; 2]),
    /// Something smooth predicts what it leaves.
    Predictable(SmoothRival),
    /// A course over this driver describes the readings better than its effects do.
    Outdone(String),
}

impl Unfit {
    /// What something that the model lacks follows, where it is known.
    pub(super) fn driver(&self) -> Option<&str> {
        match self {
            Self::Predictable(SmoothRival { driver, .. }) | Self::Outdone(driver) => Some(driver),
            Self::Unusable(_) | Self::FarAboveFloor(_) => None,
        }
    }

    /// In a sentence; `unit` of the error.
    pub fn sentence(&self, unit: &str) -> String {
        let with = |v: f64| with_unit(&format_significant(v), unit);
        match self {
            Self::Unusable(why) => why.clone(),
            Self::FarAboveFloor([error, floor]) => format!(
                "The error of {} on readings that no fit saw is {:.1} times what repeats differ by ({}): the model lacks what acts there.",
                with(*error),
                error / floor,
                with(*floor)
            ),
            Self::Predictable(SmoothRival { driver, factor }) => {
                let what = if *factor {
                    "A characteristic that follows"
                } else {
                    "A smooth course over"
                };
                format!(
                    "{what} {driver} predicts what the model leaves of readings that no fit saw."
                )
            }
            Self::Outdone(driver) => format!(
                "A course over {driver}, whatever it comes from, describes the readings better than the named effects."
            ),
        }
    }
}

/// Three decimals, or an exponent where these would hide the number.
pub(crate) fn format_significant(value: f64) -> String {
    if (0.01..1e6).contains(&value.abs()) {
        format!("{value:.3}")
    } else {
        format!("{value:.3e}")
    }
}

/// Error and floor, where the accepted model's error is far above what repeats differ by.
pub(crate) fn far_above_floor(
    model: &impl SessionModel,
    accepted: &Hypothesis,
    errors: &Errors,
    floor: &FloorStatement,
    level: f64,
) -> Option<Unfit> {
    let after = errors.after.as_ref()?;
    let (error, points) = (
        *after.rmse.get(model.quantities()[0].key)?,
        after.points as f64,
    );
    if floor.floor.source != "replicates" || !(floor.sd > 0.0) {
        return None;
    }
    let readings = errors.shared.map_or(points, |s| s.independent.min(points));
    let widening = errors.shared.map_or(1.0, |s| s.widening);
    let values = (readings * model.measured().ncols() as f64).max(1.0);
    // Readings that share noise are fewer than they are, and their error is larger at the
    // interval's end.
    let ratio = error / (floor.sd * errors.noise_ratio.max(1.0) * widening);
    let dof = floor.dof.unwrap_or(FLOOR_DOF).max(1.0);
    // Both errors are estimated: their squared ratio is F where the model lacks nothing.
    let chance = f_tail(ratio * ratio, [values, dof])?;
    // A level that is omitted at the end of the range is extrapolated to: intervals that say so, on
    // a noise that is the floor's, are no fault.
    let stated = accepted.fit.readings_variance().sqrt() * model.noise_factor()
        <= FAR_ABOVE * floor.sd
        && errors.coverage95.is_some_and(|c| c >= MIN_COVERAGE);
    let far = ratio > FAR_ABOVE && chance < level && !stated;
    far.then_some(Unfit::FarAboveFloor([
        error,
        floor.sd * errors.noise_ratio.max(1.0),
    ]))
}
