//! A page of facts, notes, charts and tables, for what the lab makes. All of it is simulated.

use wcal_report::plot::{Axis, Layer, Plot};
use wcal_report::{Fact, Table, TableCell, legend, list, plain_page, series};

/// What a page shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Page {
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
    pub tables: Vec<PlainTable>,
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
    /// Values of x to mark, each with a word.
    pub marks: Vec<(f64, String)>,
}

/// A table of values that are already printed.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PlainTable {
    /// Caption.
    pub caption: String,
    /// Names of the columns; one that begins with `#` holds numbers.
    pub columns: Vec<String>,
    /// Rows.
    pub rows: Vec<Vec<String>>,
}

/// The page as HTML.
pub fn render(page: &Page) -> String {
    plain_page(
        (&page.over, &page.title),
        true,
        &page.facts,
        &[
            ("notes", "Notes", list(&page.notes)),
            ("curves", "Curves", page.curves.iter().map(curves).collect()),
            ("tables", "Tables", page.tables.iter().map(table).collect()),
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
    let marks = input.marks.iter();
    layers.extend(marks.map(|(at, label)| Layer::VerticalRule { at: *at, label: label.clone() }));
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

fn table(input: &PlainTable) -> String {
    let columns: Vec<&str> = input.columns.iter().map(String::as_str).collect();
    let mut table = Table::new(&input.caption, &columns);
    for row in &input.rows {
        let cell = |(name, text): (&&str, &String)| {
            if name.starts_with('#') {
                TableCell::Number(text.clone())
            } else {
                TableCell::Text(text.clone())
            }
        };
        table.row(columns.iter().zip(row).map(cell).collect());
    }
    table.html()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_shows_its_lines_and_says_that_they_are_simulated() {
        let line = |y: f64| (0..4).map(|k| [f64::from(k), y / f64::from(k + 1)]).collect::<Vec<[f64; 2]>>();
        let page = Page {
            title: "A <model>".into(),
            curves: vec![Curves {
                title: "Loss".into(),
                lines: vec![("training".into(), line(3.0)), ("held out".into(), line(f64::NAN))],
                marks: vec![(2.0, "best".into())],
                ..Curves::default()
            }],
            tables: vec![PlainTable {
                caption: "Errors".into(),
                columns: vec!["object".into(), "#RMSE, mm".into()],
                rows: vec![vec!["ball".into(), "0.20 [0.10, 0.30]".into()]],
            }],
            ..Page::default()
        };
        let html = render(&page);
        assert!(html.contains("<svg") && html.contains("held out") && html.contains("<title>best"), "{html}");
        assert!(html.contains("SIMULATED") && html.contains("A &lt;model&gt;"));
        assert!(html.contains("<td class=\"num\">0.20 [0.10, 0.30]</td>") && !html.contains("NaN"), "{html}");
        // Negative control: without curves there is no chart.
        let bare = render(&Page { curves: vec![], ..page });
        assert!(!bare.contains("<svg"));
    }
}
