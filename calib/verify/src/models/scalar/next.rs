//! What would decide between survivors: the same session again, as often as it takes.

use super::system::ScalarSystem;
use crate::measurement_model::MeasurementModel;
use crate::method::ambiguity;
use crate::method::hypothesis::Hypothesis;
use wcal_core::verify_document::NextMeasurement;

/// More repetitions than this are not worth proposing.
const MAX_REPEATS: usize = 10;

/// Repetitions after which the nearest rival falls behind the limit with 90 % probability: what the
/// two fits predict differs by d noise standard deviations in norm, and grows with the root of the
/// repetitions.
pub fn next_measurement(
    system: &ScalarSystem,
    best: &Hypothesis,
    rivals: &[&Hypothesis],
) -> Option<NextMeasurement> {
    let id = |h: &Hypothesis| -> Vec<String> {
        h.effects(system.outliers())
            .iter()
            .map(|&e| system.catalogue()[e].id.to_owned())
            .collect()
    };
    let sd = best.fit.variance().sqrt();
    let nearest = rivals
        .iter()
        .map(|h| ((&h.fit.residual - &best.fit.residual).norm() / sd, *h))
        .min_by(|a, b| a.0.total_cmp(&b.0))?;
    let (d, rival) = nearest;
    let power = |sessions: usize| ambiguity::power(d * d * sessions as f64);
    let repeats = (1..=MAX_REPEATS).find(|&k| power(k + 1) >= 0.9);
    let mut separates = id(best);
    separates.extend(
        id(rival)
            .into_iter()
            .filter(|i| !separates.contains(i))
            .collect::<Vec<_>>(),
    );
    let sequence = if system.frame.direction.is_none() {
        ", with falling as well as rising stimulus"
    } else {
        ""
    };
    let (instruction, expected_power) = match repeats {
        Some(k) => (
            format!(
                "Repeat the session {k} more times, in another order of the stimuli{sequence}."
            ),
            power(k + 1),
        ),
        None => (
            format!(
                "Repeating this session up to {MAX_REPEATS} times does not separate them; take other stimuli or another order{sequence}."
            ),
            power(MAX_REPEATS + 1),
        ),
    };
    let instruction = system.frame.declared.format_text(&instruction);
    Some(NextMeasurement {
        separates,
        instruction,
        poses: Vec::new(),
        expected_power,
    })
}
