//! What to write down of the instrument.

use crate::markup::{Table, escape};
use crate::number::quantity;
use wcal_core::data_sheet::DataSheet;

/// The section.
pub(super) fn body(sheet: &DataSheet) -> String {
    let mut out = format!(
        "<p><strong>{}</strong></p><p>It holds {}.</p>",
        escape(&sheet.equation),
        escape(&sheet.range_text())
    );
    let mut table = Table::new(
        "Characteristics of the accepted model (intervals 95 %)",
        &["characteristic", "#value", "what it is"],
    );
    for c in &sheet.characteristics {
        table.row([c.name.clone(), c.text(), c.meaning.clone()]);
    }
    out += &table.html();
    if let Some(u) = &sheet.uncertainty {
        let caption = format!(
            "U = {} (95 %, k = {:.2}) of a {}, largest at {}",
            quantity(u.expanded, &u.unit),
            u.k,
            u.of,
            quantity(u.at, &sheet.range_unit)
        );
        let mut budget = Table::new(&caption, &["source", "#standard uncertainty"]);
        for s in &u.sources {
            budget.row([s.source.clone(), s.text(&u.unit)]);
        }
        out += &budget.html();
        out += "<p>U is k times the root of the squares, and any bound added.</p>";
    }
    for condition in &sheet.conditions {
        out += &format!("<p>Condition: {}.</p>", escape(condition));
    }
    out
}
