//! A table of errors by place, and by direction: what ISO 230-2 calls the mean positional
//! deviations at each target, and reversal values. No law of the place; it stands where repeats
//! show that the errors belong to the places and no law describes them.
//!
//! ```text
//! error(x) = sum_k h_k(x) (a_k + b_k [falling])        h_k: 1 at place k, 0 at its neighbours, straight between
//! sd between places: 4 s (1 - s) rms_k(a_k - line through a_(k-1) and a_(k+1))        s: share of the gap
//! ```
//!
//! What lies between the places was not measured: leaving out every second place shows how much it
//! may be.

use crate::effect::LawRequirement::BothDirections;
use crate::effect::{Effect, law};
use crate::scalar::scalar_effect::ScalarEffect;

/// Identifier of the table of errors by place.
pub(crate) const ERROR_TABLE: &str = "error-table";

/// The table at `places` (half ranges, rising); none where they are not repeated.
pub(crate) fn error_table(places: &[f64]) -> ScalarEffect {
    // At least two, so that the catalogue can be listed without a session.
    let count = places.len().max(2);
    // The first place's deviation is the declared constant.
    let deviations = |name| law(name).columns(count - 1, "deviation", "response");
    let both = deviations("by-place-and-direction").needing(&[BothDirections]);
    let both = both.columns(count, "reversal_value", "response");
    ScalarEffect {
        not_observable: |frame| {
            let none = frame.scaling.places.is_empty();
            none.then(|| "an axis whose places are all repeated shows it".to_owned())
        },
        columns: |values, frame| {
            let places = frame.places();
            if places.len() < 2 {
                return None;
            }
            let hat = |k: usize| {
                frame
                    .u
                    .iter()
                    .map(|u| hat(&places, k, *u))
                    .collect::<Vec<f64>>()
            };
            let mut out: Vec<Vec<f64>> = (1..places.len()).map(hat).collect();
            if values.law() == "by-place-and-direction" {
                let direction = frame.direction.as_ref()?;
                // Zero on the way up: the coefficient is the difference down less up.
                let falling = |k: usize| {
                    hat(k)
                        .iter()
                        .zip(direction)
                        .map(|(h, d)| 0.5 * (1.0 - d) * h)
                        .collect()
                };
                out.extend((0..places.len()).map(falling));
            }
            Some(out)
        },
        ..Effect {
            // Any law of the place is one of these tables: they are no rivals of it, and are tried
            // only where every law fails.
            refinements: vec![deviations("by-place"), both],
            ..Effect::new(
                ERROR_TABLE,
                "The errors depend on position and direction: a table describes them, no law does.",
                Vec::new(),
            )
        }
        .into()
    }
}

/// Root mean square of what each inner place is off the straight line through its neighbours; none
/// of fewer than three.
pub(crate) fn left_out_rms(places: &[f64], deviations: &[f64]) -> Option<f64> {
    let inner = 1..places.len().saturating_sub(1);
    let off = inner.map(|k| {
        let share = (places[k] - places[k - 1]) / (places[k + 1] - places[k - 1]);
        let line = (1.0 - share) * deviations[k - 1] + share * deviations[k + 1];
        (deviations[k] - line).powi(2)
    });
    let squares: Vec<f64> = off.collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (!squares.is_empty()).then(|| mean.sqrt())
}

/// How far `x` lies within its gap: 0 at a place, 1 in the middle between two.
pub(crate) fn share_of_gap(places: &[f64], x: f64) -> f64 {
    let next = places.partition_point(|p| *p <= x);
    if next == 0 || next == places.len() {
        return 0.0;
    }
    // The bound of linear interpolation, f'' h^2 / 8 times 4 s (1 - s).
    let s = (x - places[next - 1]) / (places[next] - places[next - 1]);
    4.0 * s * (1.0 - s)
}

/// Value at `u` of the function that is 1 at place `k`.
fn hat(places: &[f64], k: usize, u: f64) -> f64 {
    // Hat functions: linear interpolation between the places of a table.
    let side = |other: Option<usize>| match other.and_then(|j| places.get(j)) {
        // Beyond the last place the error is the last one's.
        None => 1.0,
        Some(next) => 1.0 - ((u - places[k]) / (next - places[k])).clamp(0.0, 1.0),
    };
    if u < places[k] {
        side(k.checked_sub(1))
    } else {
        side(Some(k + 1))
    }
}
