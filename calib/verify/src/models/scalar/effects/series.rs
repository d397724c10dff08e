//! What belongs to a series, or to the read-out's own range.

use crate::effect::law;
use crate::scalar::scalar_effect::ScalarEffect;
use crate::scalar::stimulus_scale::times_wrapped;

/// Identifier of the zeros of series.
pub(crate) const ZERO_BY_SERIES: &str = "zero-by-series";

/// Every series (mounting, cycle) has its own zero (ISO 376: X - X0 of each series): sum-to-zero
/// contrasts, so that the constant is the mean zero. Nothing is known of the zero of another
/// series.
pub(crate) fn zero_by_series(count: usize) -> ScalarEffect {
    let shifts = law("one-each").columns(count.max(2) - 1, "zero_shift", "response");
    ScalarEffect {
        not_observable: |frame| {
            let none = "the table has no series of their own (column cycle or replicate)";
            let stroke = "each series is a stroke: what is its own belongs to its direction";
            let strokes = frame.strokes_are_series().then_some(stroke);
            let why = if frame.scaling.series.is_empty() {
                Some(none)
            } else {
                strokes
            };
            why.map(str::to_owned)
        },
        columns: |_, frame| {
            let (first, others) = frame.scaling.series.split_first()?;
            let own =
                |group: u32, series: u32| f64::from(u8::from(group == series && !frame.new_rows));
            let shift = |s: &u32| {
                frame
                    .groups
                    .iter()
                    // Sum to zero: the first series has minus the sum of the others' shifts.
                    .map(|g| own(*g, *s) - own(*g, *first))
                    .collect()
            };
            Some(others.iter().map(shift).collect())
        },
        ..ScalarEffect::new(
            ZERO_BY_SERIES,
            "Each series has its own zero: subtract the zero reading of its series from a reading.",
            vec![shifts],
        )
    }
}

/// A count that starts again at zero: one jump by its modulus between neighbouring places, the same
/// slope on both sides.
pub(crate) fn count_wrap() -> ScalarEffect {
    ScalarEffect {
        // Its size is that of the read-out's range.
        shows_on_one_level: true,
        not_observable: |frame| {
            let none = frame.scaling.wraps.is_empty();
            none.then(|| {
                "no jump by the whole range of a count between neighbouring places".to_owned()
            })
        },
        columns: |_, frame| Some(vec![times_wrapped(&frame.rows, &frame.scaling.wraps)]),
        ..ScalarEffect::new(
            "count-wrap",
            "The count starts again within the range: take the jump off the readings beyond it.",
            vec![law("modulus").column("jump", "response")],
        )
    }
}
