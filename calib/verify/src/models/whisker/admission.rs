//! Which whisker readings can be used at all.

use super::sensitivity::{self, MIN_LOADED};
use super::system::WhiskerSystem;
use crate::scalar::admission::clock_fault;
use crate::verify::sealed_in_fit::sealed_in_fit;
use wcal_core::Sealed;
use wcal_core::observation::{Role, WhiskerRow};

/// Why the readings of a session cannot be used; `sealed` are those of its holdout.
pub(super) fn refusal(system: &WhiskerSystem, sealed: &Sealed<WhiskerRow>) -> Option<String> {
    let rows = &system.data.rows;
    let loaded = rows.iter().filter(|r| r.role != Role::Rest).count();
    if loaded < MIN_LOADED {
        return Some(format!(
            "The session has {loaded} loaded readings; K, the zero and a residual need at least {MIN_LOADED}."
        ));
    }
    if let Some(why) = clock_fault(rows.iter().map(|r| r.t_s)) {
        return Some(format!("The data cannot be used: {why}."));
    }
    let copied = sealed.refusal(&rows[..], |sealed, fitted| {
        let read = |r: &WhiskerRow| {
            (
                r.t_s,
                [r.stage_mm.unwrap_or(f64::NAN), r.shift_pm[0], r.shift_pm[1]],
            )
        };
        let fitted = fitted.iter().filter(|r| r.role != Role::Rest).map(read);
        Some(format!(
            "{}.",
            sealed_in_fit(fitted, sealed.iter().filter(|r| r.sealed).map(read))?
        ))
    });
    copied.or_else(|| sensitivity::of_system(system))
}
