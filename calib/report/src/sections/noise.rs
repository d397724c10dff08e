//! Noise floor, its source, and remarks.

use crate::input::ReportInput;
use crate::markup::{Table, list};
use crate::number::{number, unit_text};

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let floor = &input.verify.noise_floor;
    let unit = input.response_unit();
    let rows = [
        ("wavelength", floor.wavelength_pm, "pm"),
        ("moment", floor.moment_nmm, "N mm"),
        ("response", floor.response, unit),
        ("position error", floor.error_um, "um"),
        ("contact", floor.contact_mm, "mm"),
    ];
    let mut table = Table::new(
        "Noise floor",
        &["quantity", "#standard deviation", "unit", "source"],
    );
    for (name, value, unit) in rows {
        if let Some(value) = value {
            table.row([
                name.into(),
                number(value),
                unit_text(unit),
                floor.source.clone(),
            ]);
        }
    }
    let source = match floor.source.as_str() {
        "replicates" => "From repeated readings.",
        "difference" => {
            "From differences of neighbouring readings, since no pose was repeated; the verdict is provisional."
        }
        "declared" => "As declared in the session; not measured here.",
        "none" | "" => "Unknown: this session cannot separate noise from error.",
        _ => "",
    };
    let mut out = table.html();
    if !source.is_empty() {
        out += &format!("<p>{source}</p>");
    }
    match input.verify.notes.as_slice() {
        [] => {}
        notes => {
            out += &format!(
                "<div class=\"card warn\"><h3>Remarks</h3>{}</div>",
                list(notes)
            )
        }
    }
    out
}
