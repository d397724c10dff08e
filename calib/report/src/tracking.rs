//! The pages of a tracker: its training and its evaluation. Both are simulated.

use crate::input::Fact;
use crate::markup::{Table, TableCell, list};
use crate::page::simulated;
use crate::plot::{Axis, Layer, Plot};
use crate::sections::{legend, series};

/// What a page shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TrackingInput {
    /// Line above the heading, e.g. `Contact tracker`.
    pub over: String,
    /// Heading.
    pub title: String,
    /// Model, data, seeds, ...
    pub facts: Vec<Fact>,
    /// What a reader has to know.
    pub notes: Vec<String>,
    /// Charts.
    pub curves: Vec<Curves>,
    /// Tables.
    pub tables: Vec<NumberTable>,
}

/// A chart of several lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Curves {
    /// Short name.
    pub title: String,
    /// Axes with their units.
    pub x: String,
    /// See `x`.
    pub y: String,
    /// Lines by name.
    pub lines: Vec<(String, Vec<[f64; 2]>)>,
    /// A value of x to mark, with a word.
    pub mark: Option<(f64, String)>,
}

/// A table whose first column is text and whose others are numbers, already printed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct NumberTable {
    /// Caption.
    pub caption: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

/// The page.
pub fn render_tracking(input: &TrackingInput) -> String {
    let notes = if input.notes.is_empty() { String::new() } else { list(&input.notes) };
    simulated(
        &input.over,
        &input.title,
        &input.facts,
        &[
            ("notes", "Notes", notes),
            ("curves", "Curves", input.curves.iter().map(curves).collect()),
            ("tables", "Tables", input.tables.iter().map(table).collect()),
        ],
    )
}

fn curves(input: &Curves) -> String {
    let names: Vec<String> = input.lines.iter().map(|l| l.0.clone()).collect();
    let mut layers: Vec<Layer> = Vec::new();
    for (n, (name, at)) in input.lines.iter().enumerate() {
        let (class, marker) = series(n);
        layers.push(Layer::Line { class, at: at.clone() });
        let titles = at.iter().map(|[x, y]| format!("{name}: {x} {y:.4}")).collect();
        layers.push(Layer::Points { class, marker, at: at.clone(), titles });
    }
    if let Some((at, label)) = &input.mark {
        layers.push(Layer::VerticalRule { at: *at, label: label.clone() });
    }
    let all = || input.lines.iter().flat_map(|l| l.1.iter().copied());
    let plot = Plot {
        title: input.title.clone(),
        description: format!("{}: {}", input.title, names.join(", ")),
        width: 460.0,
        height: 280.0,
        x: Axis::covering(&*input.x, all().map(|p| p[0])),
        y: Axis::covering(&*input.y, all().map(|p| p[1])),
        layers,
    };
    format!("{}<figure>{}</figure>\n", legend(&names), plot.svg())
}

fn table(input: &NumberTable) -> String {
    let columns: Vec<String> = input
        .columns
        .iter()
        .enumerate()
        .map(|(k, c)| if k == 0 { c.clone() } else { format!("#{c}") })
        .collect();
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let mut table = Table::new(&input.caption, &columns);
    for row in &input.rows {
        let cell = |(k, text): (usize, &String)| {
            if k == 0 { TableCell::Text(text.clone()) } else { TableCell::Number(text.clone()) }
        };
        table.row(row.iter().enumerate().map(cell).collect());
    }
    table.html()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_shows_its_lines_and_says_that_they_are_simulated() {
        let line = |y: f64| (0..4).map(|k| [f64::from(k), y / f64::from(k + 1)]).collect::<Vec<[f64; 2]>>();
        let input = TrackingInput {
            title: "A <model>".into(),
            curves: vec![Curves {
                title: "Loss".into(),
                lines: vec![("training".into(), line(3.0)), ("held out".into(), line(4.0))],
                mark: Some((2.0, "best".into())),
                ..Curves::default()
            }],
            tables: vec![NumberTable {
                caption: "Errors".into(),
                columns: vec!["object".into(), "RMSE, mm".into()],
                rows: vec![vec!["ball".into(), "0.20 [0.10, 0.30]".into()]],
            }],
            ..TrackingInput::default()
        };
        let page = render_tracking(&input);
        assert!(page.contains("<svg") && page.contains("held out"), "{page}");
        assert!(
            page.contains("SIMULATED") && page.contains("A &lt;model&gt;") && page.contains("[0.10, 0.30]")
        );
        // Negative control: without curves there is no chart.
        let bare = render_tracking(&TrackingInput { curves: vec![], ..input });
        assert!(!bare.contains("<svg"));
    }
}
