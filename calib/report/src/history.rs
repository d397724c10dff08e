//! The page of one unit's calibrations over time: a control chart of each quantity.

use crate::input::Fact;
use crate::markup::escape;
use crate::number::number;
use crate::page::plain_page;
use crate::plot::{Axis, Layer, Plot, stride, svg};
use crate::sections::parts::{figure, series};

/// Dates that are written along an axis.
const MAX_DATES: usize = 6;

/// What the page shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HistoryInput {
    /// Heading.
    pub title: String,
    /// A calibration of a simulated session is among them.
    pub simulated: bool,
    /// What the history says.
    pub facts: Vec<Fact>,
    /// Date of each calibration, and when it was, in months since the first.
    pub dates: Vec<(String, f64)>,
    /// When to calibrate again, alike.
    pub until: Option<f64>,
    /// Quantities.
    pub charts: Vec<HistoryChart>,
}

/// One quantity.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HistoryChart {
    /// Name and unit.
    pub quantity: String,
    /// Value and half width of its 95 % interval, one a calibration.
    pub values: Vec<[f64; 2]>,
    /// Values between which it costs less than the stated uncertainty.
    pub limits: Option<[f64; 2]>,
    /// Value at the first calibration and change a month of the line of drift.
    pub drift: Option<[f64; 2]>,
}

/// The page.
pub fn render_history(input: &HistoryInput) -> String {
    let charts: String = input.charts.iter().map(|c| chart(input, c)).collect();
    let caption = "Value of each calibration with its 95 % interval against its date. Band: from the last calibration as far as costs less than the stated uncertainty of a reading. Line: drift. Upright line: recalibrate by.";
    let figure = figure(input.simulated, "many", &charts, caption);
    plain_page(
        ("Calibrations over time", &input.title),
        input.simulated,
        &input.facts,
        &[("charts", "Control charts", figure)],
    )
}

fn chart(input: &HistoryInput, chart: &HistoryChart) -> String {
    let months = || input.dates.iter().map(|(_, month)| *month);
    let (class, marker) = series(0);
    let points = months().zip(&chart.values);
    let bar = |(t, [value, half]): (f64, &[f64; 2])| {
        [[t, value - half], [t, value + half], [f64::NAN; 2]]
    };
    let bars: Vec<[f64; 2]> = points.clone().flat_map(bar).collect();
    let title = |((date, _), [value, half]): (&(String, f64), &[f64; 2])| {
        format!("{date}: {} ± {}", number(*value), number(*half))
    };
    let end = months().chain(input.until).fold(0.0, f64::max);
    let line = chart
        .drift
        .map(|[first, a_month]| vec![[0.0, first], [end, first + a_month * end]]);
    let values = bars
        .iter()
        .map(|p| p[1])
        .chain(chart.limits.into_iter().flatten());
    let y = Axis::covering(
        chart.quantity.clone(),
        values.chain(line.iter().flatten().map(|p| p[1])),
    );
    let every = stride(input.dates.len(), MAX_DATES);
    let dates = input.dates.iter().step_by(every);
    let x = Axis {
        ticks: Some(dates.map(|(date, month)| (*month, date.clone())).collect()),
        ..Axis::covering("date", months().chain(input.until))
    };
    let mut layers: Vec<Layer> = Vec::new();
    layers.extend(chart.limits.map(|between| Layer::Band { between }));
    layers.extend(input.until.map(|at| Layer::VerticalRule { at }));
    layers.extend(line.map(|at| Layer::Line { class: "quiet", at }));
    layers.push(Layer::Line { class, at: bars });
    layers.push(Layer::Points {
        class,
        marker,
        at: points.map(|(t, v)| [t, v[0]]).collect(),
        titles: input.dates.iter().zip(&chart.values).map(title).collect(),
    });
    svg(&Plot {
        title: chart.quantity.clone(),
        description: format!(
            "{} of each calibration against its date",
            escape(&chart.quantity)
        ),
        width: 460.0,
        height: 230.0,
        x,
        y,
        layers,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chart_has_what_is_known_and_nothing_else() {
        let dates = [("2026-01-05", 0.0), ("2026-03-05", 2.0)];
        let of = |limits, drift, until| {
            render_history(&HistoryInput {
                title: "cell <1>".into(),
                dates: dates.map(|(date, month)| (date.into(), month)).to_vec(),
                until,
                charts: vec![HistoryChart {
                    quantity: "zero (V)".into(),
                    values: vec![[1.0, 0.1], [1.2, 0.1]],
                    limits,
                    drift,
                }],
                ..HistoryInput::default()
            })
        };
        let whole = of(Some([1.0, 1.4]), Some([1.0, 0.1]), Some(6.0));
        let bare = of(None, None, None);
        assert!(whole.contains("2026-03-05: 1.2 ± 0.1") && whole.contains("cell &lt;1&gt;"));
        // Negative control: without limits, drift and day none of them is drawn.
        let count = |page: &str, what: &str| page.matches(what).count();
        for what in ["<rect class=\"band", "class=\"rule\"", "class=\"line quiet"] {
            assert_eq!(count(&whole, what), count(&bare, what) + 1, "{what}");
        }
    }
}
