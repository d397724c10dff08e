//! Remarks of a scalar session's verification.

use super::polynomial::LackOfFit;
use super::steadiness::{Steadiness, UNSTEADY};
use super::system::ScalarSystem;
use super::verdict::Conclusion;
use crate::engine::spread::Spread;
use wcal_core::verify_document::VerifyDocument;

pub(super) fn notes(
    doc: &mut VerifyDocument,
    system: &ScalarSystem,
    c: &Conclusion,
    steadiness: Option<&Steadiness>,
    spread: Option<&Spread>,
    lack: [Option<&LackOfFit>; 2],
    total: usize,
) {
    let used = system.frame.rows.len();
    if used < total {
        doc.notes.push(format!(
            "The search used {used} of {total} readings, chosen evenly by stimulus, direction and cycle; all are predicted, and places and \
             periods are in rows of the table."
        ));
    }
    if let Some(s) = steadiness.filter(|s| s.z > UNSTEADY) {
        let note = format!(
            "The frequency is not steady: {:.3} +- {:.3} cycles over the range by the first half, {:.3} +- {:.3} by the second.",
            s.cycles[0], s.standard_errors[0], s.cycles[1], s.standard_errors[1]
        );
        doc.reason.push(' ');
        doc.reason.push_str(&note);
        doc.notes.push(note);
    }
    for (model, lack) in ["declared", "accepted"].into_iter().zip(lack) {
        if let Some(l) = lack {
            doc.notes.push(format!(
                "Lack of fit of the {model} model against repetitions: F = {:.4} on {} and {} degrees of freedom, p = {:.2e}.",
                l.f, l.dof, l.pure_dof, l.p_value
            ));
        }
    }
    if spread.is_some() {
        doc.notes
            .push("Readings were weighted by the spread found; held-out errors are not weighted.".to_owned());
    }
    if !c.accepted.flagged.is_empty() {
        let points: Vec<String> =
            c.accepted.flagged.iter().map(|&i| system.frame.rows[i].origin.2.to_string()).collect();
        doc.notes.push(format!("Points {} are marked as outliers and count in no error.", points.join(", ")));
    }
}
