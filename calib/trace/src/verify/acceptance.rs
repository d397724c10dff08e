//! The last rule, for every verdict and kind: what is called adequate or explained has names that the data support, a calibration that can be
//! used and applied, and a held-out error that is neither above the one before nor far above the floor.
//!
//! ```text
//! after <= before,     after^2 / floor^2 <= max(4, F_{0.999}(n, dof))          n independent held-out values, dof of the floor's replicates
//! ```

use super::held_out::Errors;
use super::judgement::MIN_COVERAGE;
use super::session_model::{FloorStatement, SessionModel};
use crate::method::hypothesis::Hypothesis;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// At twice the floor three quarters of the error's variance is no noise of the readings.
const FAR_ABOVE: f64 = 2.0;
/// Level at which the error is above the floor by more than chance.
const ABOVE_LEVEL: f64 = 1e-3;
/// Degrees of freedom of a floor that does not state them.
const FLOOR_DOF: f64 = 8.0;

/// Why a model is not accepted.
#[derive(Debug, Clone, PartialEq)]
pub enum Fault {
    /// It cannot be used, or not on its own rows.
    Useless(String),
    /// Its held-out error is above the declared model's: before, after.
    Worse([f64; 2]),
    /// Its held-out error is far above the floor: error, floor.
    FarAboveFloor([f64; 2]),
}

impl Fault {
    /// In a sentence; `unit` of the error.
    pub fn sentence(&self, unit: &str) -> String {
        let with = |v: f64| format!("{} {unit}", readable(v)).trim_end().to_owned();
        match self {
            Self::Useless(why) => why.clone(),
            Self::Worse([before, after]) => {
                format!("The held-out error rises from {} to {}.", readable(*before), with(*after))
            }
            Self::FarAboveFloor([error, floor]) => format!(
                "The held-out error of {} is {:.1} times what repeats differ by ({}): the model lacks what acts there.",
                with(*error),
                error / floor,
                with(*floor)
            ),
        }
    }
}

/// Three decimals, or an exponent where these would hide the number.
pub fn readable(value: f64) -> String {
    if (0.01..1e6).contains(&value.abs()) { format!("{value:.3}") } else { format!("{value:.3e}") }
}

/// What speaks against the accepted model; none where nothing does. `errors` count without single readings that do not belong;
/// `rise_shown`: a rise of the error would be beyond chance.
pub fn fault<M: SessionModel>(
    model: &M,
    accepted: &Hypothesis,
    errors: &Errors,
    floor: &FloorStatement,
    rise_shown: bool,
) -> Option<Fault> {
    if let Some(why) = model.useless(accepted) {
        return Some(Fault::Useless(why));
    }
    let key = model.quantities()[0].key;
    let counted = errors.trimmed.as_ref().map_or([&errors.before, &errors.after], |[b, a]| [b, a]);
    let [before, after] = counted.map(|e| e.as_ref().and_then(|e| Some((*e.rmse.get(key)?, e.points))));
    let (after, points) = after?;
    if let Some((before, _)) = before.filter(|_| !accepted.fit.terms.is_empty())
        && after > before
        && rise_shown
    {
        return Some(Fault::Worse([before, after]));
    }
    let above = floor.floor.source == "replicates" && floor.sd > 0.0 && {
        let readings = errors.shared.map_or(points as f64, |s| s.independent.min(points as f64));
        let widening = errors.shared.map_or(1.0, |s| s.widening);
        let values = (readings * model.measured().ncols() as f64).max(1.0);
        let ratio = after / (floor.sd * errors.noise_ratio.max(1.0) * widening);
        let chance = FisherSnedecor::new(values, model.floor_dof(accepted).unwrap_or(FLOOR_DOF).max(1.0))
            .map_or(1.0, |f| f.sf(ratio * ratio));
        ratio > FAR_ABOVE && chance < ABOVE_LEVEL
    };
    // A level that is left out at the end of the range is extrapolated to: intervals that say so, on a noise that is the floor's, are no fault.
    let stated = accepted.fit.readings_variance().sqrt() * model.noise_factor() <= FAR_ABOVE * floor.sd
        && errors.coverage95.is_some_and(|c| c >= MIN_COVERAGE);
    let above = above && !stated;
    above.then_some(Fault::FarAboveFloor([after, floor.sd * errors.noise_ratio.max(1.0)]))
}
