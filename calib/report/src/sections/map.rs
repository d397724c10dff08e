//! Comparison of the candidate maps.

use super::figure;
use crate::input::ReportInput;
use crate::markup::{Cell, Table, escape, list};
use crate::number::{number, percent, significant};
use crate::plot::{Axis, Layer, Plot};
use crate::plot::{Mark, RowChart, RowItem};
use wcal_core::map_document::MapDocument;

/// The section.
pub(super) fn body(input: &ReportInput, map: &MapDocument) -> String {
    let mut out = format!(
        "<p>Chosen: <strong>{}</strong>, fitted to {} points; labels from {}. Condition number of the wavelength-from-moment matrix: {}.</p>",
        escape(&map.chosen),
        map.points,
        escape(&map.labels),
        number(map.identifiability.condition)
    );
    if !map.identifiability.warnings.is_empty() {
        out += &format!(
            "<div class=\"card warn\"><h5>Warnings</h5>{}</div>",
            list(&map.identifiability.warnings)
        );
    }
    out += &table(input, map);
    out += &coverage(input, map);
    let mut details = Table::new("Valid region and hyperparameters of the chosen map", &["name", "value"]);
    details.row(vec![Cell::Text("valid region".into()), Cell::Code(map.valid_region.to_string())]);
    for (name, value) in &map.hyperparameters {
        details.row(vec![Cell::Text(name.replace('_', " ")), Cell::Code(value.to_string())]);
    }
    out + &details.html()
}

fn table(input: &ReportInput, map: &MapDocument) -> String {
    let [first, second] = &input.moment_names;
    let mut table = Table::new(
        &format!("Candidate maps, cross-validated; pairs are {first} / {second}"),
        &[
            "candidate",
            "#leave one out (N\u{a0}mm)",
            "#leave one trajectory out (N\u{a0}mm)",
            "#95 % coverage",
            "#negative log density",
            "#log evidence",
        ],
    );
    let pair = |p: [f64; 2], text: fn(f64) -> String| format!("{} / {}", text(p[0]), text(p[1]));
    for c in &map.candidates {
        let chosen = c.name == map.chosen;
        let name = if chosen { format!("{} (chosen)", c.name) } else { c.name.clone() };
        table.marked_row(
            if chosen { "chosen" } else { "" },
            vec![
                Cell::Text(name),
                Cell::Number(pair(c.loo_rmse_nmm, number)),
                Cell::Number(c.loto_rmse_nmm.map_or("–".into(), |p| pair(p, number))),
                Cell::Number(pair(c.coverage95, percent)),
                Cell::Number(pair(c.nll, |v| significant(v, 3))),
                Cell::Number(c.log_evidence.map_or("–".into(), number)),
            ],
        );
    }
    table.html()
}

/// Curves where they are known, the 95 % points of the candidates else.
fn coverage(input: &ReportInput, map: &MapDocument) -> String {
    let mut charts = String::new();
    if !input.coverage.is_empty() {
        let mut layers = vec![Layer::Line { class: "quiet", at: vec![[0.0, 0.0], [1.0, 1.0]] }];
        let names: Vec<String> = input.coverage.iter().map(|c| c.name.clone()).collect();
        for (k, curve) in input.coverage.iter().enumerate() {
            let (class, marker) = super::series(k);
            let at: Vec<_> = curve.nominal.iter().zip(&curve.observed).map(|(n, o)| [*n, *o]).collect();
            layers.push(Layer::Line { class, at: at.clone() });
            layers.push(Layer::Points { class, marker, at, titles: Vec::new() });
        }
        let plot = Plot {
            title: "Coverage of stated intervals".into(),
            description: format!("Observed against nominal coverage of {}", names.join(", ")),
            width: 340.0,
            height: 270.0,
            x: Axis::fixed("nominal coverage", 0.0, 1.02),
            y: Axis::fixed("observed coverage", 0.0, 1.02),
            layers,
        };
        charts += &format!("<div>{}{}</div>", plot.svg(), super::legend(&names));
    }
    if !map.candidates.is_empty() {
        charts += &coverage_rows(input, map);
    }
    if charts.is_empty() {
        return String::new();
    }
    figure(
        input,
        "forest",
        &charts,
        "How often the stated intervals hold the left-out label; the line is what they claim.",
    )
}

fn coverage_rows(input: &ReportInput, map: &MapDocument) -> String {
    let all = || map.candidates.iter().flat_map(|c| c.coverage95);
    let low = all().filter(|v| v.is_finite()).fold(0.85, f64::min);
    let rows = map.candidates.iter().flat_map(|c| {
        (0..2).map(move |k| RowItem {
            label: format!("{}, {}", c.name, input.moment_names[k]),
            value: percent(c.coverage95[k]),
            class: super::series(k).0,
            mark: Mark::Dot(c.coverage95[k], None),
        })
    });
    RowChart {
        title: "Leave-one-out coverage of the 95 % intervals".into(),
        description: "Share of left-out labels inside the stated 95 % interval, by candidate and moment"
            .into(),
        axis: Axis::fixed("share inside", low - 0.02, 1.01),
        rows: rows.collect(),
        rules: vec![(0.95, "95 %".into())],
    }
    .svg()
}
