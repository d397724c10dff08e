//! What would decide between survivors: the same session again, as often as it takes.

use super::system::ScalarSystem;
use crate::MeasurementModel;
use crate::method::Hypothesis;
use crate::method::ambiguity;
use std::collections::BTreeSet;
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
    let sd = best.fit.variance().sqrt();
    let apart = |h: &Hypothesis| (&h.fit.residual - &best.fit.residual).norm() / sd;
    let rival = rivals.iter().min_by(|a, b| apart(a).total_cmp(&apart(b)))?;
    let d = apart(rival);
    // The noncentrality d^2 of repeated sessions adds up.
    let power = |sessions: usize| ambiguity::power(d * d * sessions as f64);
    let repeats = (1..=MAX_REPEATS).find(|&k| power(k + 1) >= 0.9);
    let mut effects = best.effects(system.outliers());
    effects.extend(rival.effects(system.outliers()));
    let mut seen = BTreeSet::new();
    effects.retain(|e| seen.insert(*e));
    let id = |e: usize| system.catalogue()[e].id.to_owned();
    let separates = effects.into_iter().map(id).collect();
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
