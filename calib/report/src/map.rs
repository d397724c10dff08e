//! The page of the map from wavelengths to moments: the candidates, cross-validated, and the one that was chosen.

use crate::input::Fact;
use crate::markup::{Table, TableCell, list};
use crate::number::{number, percent, significant};
use crate::page::plain;
use crate::plot::{Axis, Mark, RowChart, RowItem};
use crate::sections::{figure, series};
use wcal_core::map_document::MapDocument;

/// Names of the two moments in the tables.
const MOMENTS: [&str; 2] = ["moment 1", "moment 2"];

/// The page.
#[must_use]
pub fn render_map(map: &MapDocument) -> String {
    let facts = [
        Fact::new("chosen", map.chosen.clone()),
        Fact::new("poses", map.points.to_string()),
        Fact::new("labels from", map.labels.clone()),
        Fact::new("condition number, wavelength from moment", number(map.identifiability.condition)),
    ];
    let parts =
        [("candidates", "Candidate maps", candidates(map)), ("chosen", "The chosen map", chosen(map))];
    plain(("Calibration", "Map from wavelengths to moments"), map.simulated, &facts, &parts)
}

fn candidates(map: &MapDocument) -> String {
    let mut out = String::new();
    if !map.identifiability.warnings.is_empty() {
        out += &format!(
            "<div class=\"card warn\"><h3>Warnings</h3>{}</div>",
            list(&map.identifiability.warnings)
        );
    }
    out += &table(map);
    if !map.candidates.is_empty() {
        let caption = "How often the stated intervals hold the left-out label; the line is what they claim.";
        out += &figure(map.simulated, "forest", &coverage_rows(map), caption);
    }
    out
}

fn chosen(map: &MapDocument) -> String {
    let mut details = Table::new("Valid region and hyperparameters of the chosen map", &["name", "value"]);
    details.row(vec![TableCell::Text("valid region".into()), TableCell::Code(map.valid_region.to_string())]);
    for (name, value) in &map.hyperparameters {
        details.row(vec![TableCell::Text(name.replace('_', " ")), TableCell::Code(value.to_string())]);
    }
    details.html()
}

fn table(map: &MapDocument) -> String {
    let [first, second] = MOMENTS;
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
                TableCell::Text(name),
                TableCell::Number(pair(c.loo_rmse_nmm, number)),
                TableCell::Number(c.loto_rmse_nmm.map_or("–".into(), |p| pair(p, number))),
                TableCell::Number(pair(c.coverage95, percent)),
                TableCell::Number(pair(c.nll, |v| significant(v, 3))),
                TableCell::Number(c.log_evidence.map_or("–".into(), number)),
            ],
        );
    }
    table.html()
}

fn coverage_rows(map: &MapDocument) -> String {
    let all = || map.candidates.iter().flat_map(|c| c.coverage95);
    let low = all().filter(|v| v.is_finite()).fold(0.85, f64::min);
    let rows = map.candidates.iter().flat_map(|c| {
        (0..2).map(move |k| RowItem {
            label: format!("{}, {}", c.name, MOMENTS[k]),
            value: percent(c.coverage95[k]),
            class: series(k).0,
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
