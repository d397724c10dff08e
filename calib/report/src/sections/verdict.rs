//! Verdict in words, with a class for its colour.

use wcal_core::verify_document::{HoldoutOutcome, Verdict, VerifyDocument};

/// Style class, short form and what it means.
fn words(verdict: Verdict) -> (&'static str, &'static str, &'static str) {
    match verdict {
        Verdict::Adequate => ("good", "Adequate", "nothing beyond the noise remains"),
        Verdict::Effect => (
            "named",
            "Effect found",
            "one class of effects explains what was left",
        ),
        Verdict::Ambiguous => (
            "open",
            "Ambiguous",
            "explanations of more than one class survive",
        ),
        Verdict::UnknownEffect => (
            "open",
            "Unknown effect",
            "a residual remains that no catalogued effect explains",
        ),
        Verdict::TwinFault => (
            "named",
            "Twin fault",
            "labels of the twin were faulty and have been repaired",
        ),
        Verdict::Refused => ("bad", "Refused", "the data cannot be used"),
    }
}

/// The same of a result: what the sealed readings contradict is not shown as one that holds.
pub(crate) fn of(verify: &VerifyDocument) -> (&'static str, &'static str, &'static str) {
    let (class, short, meaning) = words(verify.verdict);
    match verify.holdout.outcome {
        HoldoutOutcome::Contradicted => (
            "bad",
            short,
            "but the sealed readings contradict the accepted model",
        ),
        _ => (class, short, meaning),
    }
}
