//! Rejected readings and the table that leads from every residual back to its file and line.

use super::parts::absent;
use crate::input::ReportInput;
use crate::markup::Table;
use crate::number::{join_unit, number, unit_text};
use wcal_core::ResidualRecord;

/// Larger sessions list their worst readings only.
const MAX_ROWS: usize = 500;
const WORST_ROWS: usize = 40;
const MAX_REJECTED: usize = 200;

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let records = &input.residuals;
    if records.is_empty() {
        return String::new();
    }
    let rejected: Vec<_> = records.iter().filter(|r| r.rejected.is_some()).collect();
    let mut out = match rejected.len() {
        0 => format!(
            "<p>All {} values were used; none was rejected.</p>",
            records.len()
        ),
        n => format!(
            "<p>{n} of {} values were rejected and stay marked in every chart.</p>",
            records.len()
        ),
    };
    if !rejected.is_empty() {
        let mut table = Table::new(
            "Rejected readings",
            &["#point", "file, line", "channel", "#measured", "why"],
        );
        for r in rejected.iter().take(MAX_REJECTED) {
            table.row([
                r.point.to_string(),
                place(r),
                r.channel.clone(),
                join_unit(&number(r.measured), &r.unit),
                r.rejected.clone().unwrap_or_default(),
            ]);
        }
        out += &table.html();
        if rejected.len() > MAX_REJECTED {
            out += &absent(&format!(
                "{} more are not listed here.",
                rejected.len() - MAX_REJECTED
            ));
        }
    }
    let whole = records.len() <= MAX_ROWS;
    let mut rows: Vec<&ResidualRecord> = records.iter().collect();
    // Tens of thousands of table rows would make the page slow to open.
    if !whole {
        // A reading without a prediction has no size: 0 is larger than what is not a number.
        let size =
            |r: &ResidualRecord| ((r.measured - r.predicted_after).abs() / r.noise_sd).max(0.0);
        rows.sort_by(|a, b| size(b).total_cmp(&size(a)));
        rows.truncate(WORST_ROWS);
    }
    let summary = match whole {
        true => format!("All {} values with their predictions", rows.len()),
        false => format!(
            "The {} largest residuals after, in units of their noise",
            rows.len()
        ),
    };
    out + &format!(
        "<details><summary>{summary}</summary>{}</details>",
        listing(&summary, &rows)
    )
}

fn listing(caption: &str, rows: &[&ResidualRecord]) -> String {
    let mut table = Table::new(
        caption,
        &[
            "#point",
            "file, line",
            "role",
            "#group",
            "channel",
            "unit",
            "#measured",
            "#predicted before",
            "#predicted after",
            "#residual before",
            "#residual after",
            "#noise",
        ],
    );
    for r in rows {
        table.row([
            r.point.to_string(),
            place(r),
            r.role.clone(),
            r.group.to_string(),
            r.channel.clone(),
            unit_text(&r.unit),
            number(r.measured),
            number(r.predicted_before),
            number(r.predicted_after),
            number(r.measured - r.predicted_before),
            number(r.measured - r.predicted_after),
            number(r.noise_sd),
        ]);
    }
    table.html()
}

fn place(record: &ResidualRecord) -> String {
    format!("{}, line {}", record.source, record.line)
}
