//! Evidence: gate, candidates, ambiguity picture, smallest detectable sizes.

use super::{absent, figure};
use crate::input::{EvidenceRow, ReportInput};
use crate::markup::{Table, TableCell};
use crate::number::{join_unit, number, p_value, quantity, split_unit, unit_text, with_interval};
use crate::plot::{Axis, Mark, RowChart, RowItem};

/// Gate, candidates and ambiguity.
pub(super) fn body(input: &ReportInput) -> String {
    let mut out = steps(input) + &gate(input);
    match input.evidence.as_slice() {
        [] => out += &absent("No candidate was tested in this run."),
        rows => out += &candidates(rows),
    }
    out += &pictures(input);
    out + &ambiguity(input)
}

fn steps(input: &ReportInput) -> String {
    let mut table = Table::new("How the verdict was reached", &["stage", "outcome"]);
    for step in &input.steps {
        table.row(vec![TableCell::Text(step.name.clone()), TableCell::Text(step.value.clone())]);
    }
    if table.is_empty() { String::new() } else { table.html() }
}

fn gate(input: &ReportInput) -> String {
    let mut table =
        Table::new("Is anything left beyond the noise?", &["test", "#statistic", "#p-value", "remark"]);
    for test in &input.gate {
        table.row(vec![
            TableCell::Text(test.name.clone()),
            TableCell::Number(test.statistic.map_or("–".into(), number)),
            TableCell::Number(test.p_value.map_or("–".into(), p_value)),
            TableCell::Text(test.detail.clone()),
        ]);
    }
    if table.is_empty() { String::new() } else { table.html() }
}

fn status_class(status: &str) -> &'static str {
    match status {
        "accepted" | "best" => "named",
        "survives" => "open",
        "at bound" | "out of range" => "bad",
        _ => "plain",
    }
}

fn candidates(rows: &[EvidenceRow]) -> String {
    let mut table = Table::new(
        "Candidates, best first",
        &[
            "effect",
            "status",
            "law",
            "parameters [95 %]",
            "#chi-square gain",
            "#p, adjusted",
            "#ln L − ln L best",
            "why",
        ],
    );
    for row in rows {
        let parameter = |p: &wcal_core::verify_document::EffectParameter| {
            let (value, interval) = with_interval(p.value, p.interval95);
            format!("{} = {}", split_unit(&p.name).0, join_unit(&format!("{value} {interval}"), &p.unit))
        };
        let parameters: Vec<String> = row.parameters.iter().map(parameter).collect();
        let gain = row.chi2_gain.map_or(TableCell::Number("–".into()), |gain| {
            TableCell::NumberWithNotes(number(gain), vec![format!("for {}", row.degrees_of_freedom)])
        });
        table.row(vec![
            TableCell::Code(row.id.clone()),
            TableCell::Badge(status_class(&row.status), row.status.clone()),
            TableCell::Text(row.law.clone()),
            TableCell::Text(parameters.join("; ")),
            gain,
            TableCell::Number(row.p_adjusted.map_or("–".into(), p_value)),
            TableCell::Number(row.log_likelihood_ratio.map_or("–".into(), number)),
            TableCell::Text(row.why.clone()),
        ]);
    }
    table.html()
}

fn ambiguity(input: &ReportInput) -> String {
    if input.explanations.is_empty() {
        return String::new();
    }
    let row = |e: &crate::input::Explanation| {
        let name = if e.effects.is_empty() { "declared model alone".into() } else { e.effects.join(" + ") };
        let p = e.p_value.map_or(String::new(), |p| format!(", p {}", p_value(p)));
        let word = if e.survives { "survives" } else { "rejected" };
        RowItem {
            label: name,
            value: format!("{}{p}, {word}", number(e.log_likelihood_ratio)),
            class: if e.survives { "s1" } else { "out" },
            mark: Mark::Bar(e.log_likelihood_ratio.abs()),
        }
    };
    let finite = input.explanations.iter().map(|e| e.log_likelihood_ratio.abs()).filter(|v| v.is_finite());
    let high = finite.fold(1.0, f64::max);
    let chart = RowChart {
        title: "How much worse than the best explanation".into(),
        description: "Log likelihood ratio of every refitted explanation to the best one".into(),
        axis: Axis::fixed("ln L of the best − ln L (0 = the best)", 0.0, 1.04 * high),
        rows: input.explanations.iter().map(row).collect(),
        rules: Vec::new(),
    };
    figure(
        input.verify.simulated,
        "forest",
        &chart.svg(),
        "Ambiguity picture: a short bar explains the data nearly as well as the best. Solid: survives the bootstrap; dashed outline: rejected.",
    )
}

/// What the pictures say in addition to the wavelengths; empty without them.
fn pictures(input: &ReportInput) -> String {
    let Some(pictures) = &input.verify.pictures else { return String::new() };
    let mut table = Table::new("Pictures and wavelengths", &["what", "#value"]);
    let decided = input.verify.witness.as_deref();
    let rows = [
        ("pairs that count", Some(pictures.pairs.to_string())),
        ("pairs left out", Some(pictures.left_out.len().to_string())),
        ("scatter about the accepted model over what the shapes state", Some(number(pictures.reduced_chi))),
        (
            "chi-square gain of the accepted effects, wavelengths",
            decided.map(|_| number(pictures.gain_wavelengths)),
        ),
        (
            "chi-square gain of the accepted effects, pictures",
            decided.map(|_| number(pictures.gain_pictures)),
        ),
        ("decided by", decided.map(str::to_owned)),
    ];
    for (what, value) in rows {
        if let Some(value) = value {
            table.row(vec![TableCell::Text(what.into()), TableCell::Number(value)]);
        }
    }
    for pair in &pictures.left_out {
        table.row(vec![
            TableCell::Text(format!("left out: {}", pair.name)),
            TableCell::Text(pair.why.clone()),
        ]);
    }
    table.html()
}

/// Smallest size of each effect that this data could have shown.
pub(super) fn detectable(input: &ReportInput) -> String {
    let rows = &input.verify.detectable;
    if rows.is_empty() {
        return absent("No smallest detectable sizes were computed in this run.");
    }
    let with_pictures = input.verify.pictures.as_ref().is_some_and(|p| p.pairs > 0);
    let columns: &[&str] = if with_pictures {
        &["effect", "status", "#smallest size", "#without pictures", "why"]
    } else {
        &["effect", "status", "#smallest size", "why"]
    };
    let mut table = Table::new("Smallest size found with 90 % probability", columns);
    for d in rows {
        let class = if d.status == "testable" { "good" } else { "plain" };
        let size = |size: Option<f64>| {
            TableCell::Number(size.map_or("–".into(), |v| match unit_text(&d.unit) {
                u if u.is_empty() => number(v),
                _ => quantity(v, &d.unit),
            }))
        };
        let mut cells =
            vec![TableCell::Code(d.id.clone()), TableCell::Badge(class, d.status.clone()), size(d.smallest)];
        if with_pictures {
            cells.push(size(d.smallest_without_pictures));
        }
        cells.push(TableCell::Text(d.why.clone()));
        table.row(cells);
    }
    table.html()
}
