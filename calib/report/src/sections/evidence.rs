//! Evidence: gate, explanations, what the pictures say, smallest detectable sizes.

use crate::input::{EvidenceRow, ReportInput};
use crate::markup::{Table, TableCell};
use crate::number::{number, p_value, quantity, unit_text};

/// Gate, explanations and pictures.
pub(super) fn body(input: &ReportInput) -> String {
    let mut out = gate(input);
    out += &explanations(&input.evidence);
    out
}

fn gate(input: &ReportInput) -> String {
    let mut table = Table::new(
        "Is anything left beyond the noise?",
        &["test", "#statistic", "#p-value", "remark"],
    );
    for test in &input.gate {
        table.row([
            test.name.clone(),
            test.statistic.map_or("–".into(), number),
            test.p_value.map_or("–".into(), p_value),
            test.detail.clone(),
        ]);
    }
    table.html()
}

fn explanations(rows: &[EvidenceRow]) -> String {
    let mut table = Table::new(
        "Explanations, best first",
        &[
            "effects",
            "status",
            "law",
            "#chi-square gain",
            "#ln L − ln L best",
            "#p, bootstrap",
        ],
    );
    for row in rows {
        let status = match (row.log_likelihood_ratio >= 0.0, row.survives) {
            (true, _) => TableCell::Badge("named", "best".into()),
            (false, true) => TableCell::Badge("open", "survives".into()),
            (false, false) => TableCell::Badge("plain", "rejected".into()),
        };
        let parameters = vec![format!("for {}", row.degrees_of_freedom)];
        table.row([
            TableCell::Code(match row.effects.as_slice() {
                [] => "declared model alone".into(),
                some => some.join(" + "),
            }),
            status,
            TableCell::Text(row.law.clone()),
            TableCell::WithNotes(number(row.chi2_gain), parameters),
            TableCell::Text(number(row.log_likelihood_ratio)),
            TableCell::Text(p_value(row.p_value)),
        ]);
    }
    table.html()
}

/// Smallest size of each effect that this data could have shown.
pub(super) fn detectable(input: &ReportInput) -> String {
    let rows = &input.verify.detectable;
    // In a session without pictures the second size would only repeat the first.
    let with_pictures = input.verify.tests.iter().any(|t| t.witness == "pictures");
    let columns: &[&str] = if with_pictures {
        &[
            "effect",
            "status",
            "#smallest size",
            "#without pictures",
            "why",
        ]
    } else {
        &["effect", "status", "#smallest size", "why"]
    };
    let mut table = Table::new(
        "Smallest size that is not called adequate, with 90 % probability; its name may take more",
        columns,
    );
    for d in rows {
        let class = if d.status == "testable" {
            "good"
        } else {
            "plain"
        };
        let size = |size: Option<f64>| {
            TableCell::Text(size.map_or("–".into(), |v| match unit_text(&d.unit) {
                u if u.is_empty() => number(v),
                _ => quantity(v, &d.unit),
            }))
        };
        let mut cells = vec![
            TableCell::Code(d.id.clone()),
            TableCell::Badge(class, d.status.clone()),
            size(d.smallest),
        ];
        if with_pictures {
            cells.push(size(d.smallest_without_pictures));
        }
        cells.push(TableCell::Text(d.why.clone()));
        table.row(cells);
    }
    table.html()
}
