//! An existing calibration on readings that were not in its fit.

use crate::markup::{Table, escape};
use crate::number::{number, percent, with_interval};
use wcal_core::verify_document::CalibrationJudgement;

/// The section.
pub(super) fn body(judged: &CalibrationJudgement) -> String {
    let verdict = if judged.holds {
        "It holds"
    } else {
        "It does not hold"
    };
    let mut table = Table::new(
        "Errors of the given calibration",
        &["quantity", "#error", "#95 % interval"],
    );
    for (name, value) in &judged.error.rmse {
        let interval = judged
            .error
            .interval95
            .get(name)
            .copied()
            .unwrap_or([f64::NAN; 2]);
        let (value, interval) = with_interval(*value, interval);
        table.row([name.clone(), value, interval]);
    }
    format!(
        "<p><strong>{verdict}</strong> on {} readings that were not in its fit: {}.</p>{}<p><code>{}</code>; coverage of its 95 % intervals {}; \
         error in stated standard deviations {}.</p>",
        judged.error.points,
        escape(&judged.why),
        table.html(),
        escape(&judged.path),
        percent(judged.coverage95),
        judged.ratio.map_or_else(|| "not known".to_owned(), number)
    )
}
