//! The page of a fit of damping and contact: every trial, the trade between the demands, and the choice. The trials are simulated.

use crate::input::Fact;
use crate::markup::{Table, TableCell, paragraph};
use crate::nullable::or_nan;
use crate::number::number;
use crate::page::simulated;
use crate::plot::{Axis, Layer, Marker, Plot};
use crate::sections::{legend, series};
use serde::{Deserialize, Serialize};

/// What the page shows.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DynamicsInput {
    /// Heading.
    pub title: String,
    /// Whisker, targets, chosen values.
    pub facts: Vec<Fact>,
    /// Why this one, in sentences.
    pub choice: Vec<String>,
    /// Trials that were judged in full.
    pub trials: Vec<DynamicsTrial>,
    /// Number of the chosen one.
    pub best: usize,
}

/// A trial.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct DynamicsTrial {
    /// Stage of the search.
    pub stage: String,
    /// Parameters and results in words.
    pub label: String,
    /// Bounce over the undamped wire's.
    #[serde(deserialize_with = "or_nan")]
    pub bounce_ratio: f64,
    /// Change of the mean moment between two speeds, %.
    #[serde(deserialize_with = "or_nan")]
    pub bias_percent: f64,
    /// Ripple, N mm.
    #[serde(deserialize_with = "or_nan")]
    pub ripple_nmm: f64,
    /// Deepest overlap, mm.
    #[serde(deserialize_with = "or_nan")]
    pub overlap_mm: f64,
    /// Sum of squares of the demands.
    #[serde(deserialize_with = "or_nan")]
    pub total: f64,
}

/// Rows of the table for each stage.
const SHOWN: usize = 3;

/// The page.
#[must_use]
pub fn render_dynamics(input: &DynamicsInput) -> String {
    let mut stages: Vec<String> = Vec::new();
    for trial in &input.trials {
        if !stages.contains(&trial.stage) {
            stages.push(trial.stage.clone());
        }
    }
    let mut plots = legend(&stages);
    plots += &plot(
        input,
        &stages,
        [
            "Speed bias against bounce",
            "change of the mean moment from 3.2 to 7.7 mm/s, %",
            "bounce over the undamped wire's",
        ],
        |t| [t.bias_percent, t.bounce_ratio],
    );
    plots += &plot(input, &stages, ["Ripple against overlap", "overlap, mm", "ripple, N mm"], |t| {
        [t.overlap_mm, t.ripple_nmm]
    });
    let choice: String = input.choice.iter().map(|line| paragraph(line)).collect();
    let parts = [("choice", "Choice", choice + &table(input, &stages)), ("trade", "Trade", plots)];
    simulated("Damping and contact", &input.title, &input.facts, &parts)
}

fn plot(
    input: &DynamicsInput,
    stages: &[String],
    [title, x, y]: [&str; 3],
    at: impl Fn(&DynamicsTrial) -> [f64; 2],
) -> String {
    let points: Vec<[f64; 2]> = input.trials.iter().map(&at).collect();
    let mut layers: Vec<Layer> = stages
        .iter()
        .enumerate()
        .map(|(n, stage)| {
            let own: Vec<&DynamicsTrial> = input.trials.iter().filter(|t| t.stage == *stage).collect();
            let (class, marker) = series(n);
            Layer::Points {
                class,
                marker,
                at: own.iter().map(|t| at(t)).collect(),
                titles: own.iter().map(|t| t.label.clone()).collect(),
            }
        })
        .collect();
    if let Some(best) = input.trials.get(input.best) {
        layers.push(Layer::Points {
            class: "bad",
            marker: Marker::Ring,
            at: vec![at(best)],
            titles: vec![best.label.clone()],
        });
    }
    let plot = Plot {
        title: title.to_owned(),
        description: format!("{title}: one mark a trial, the chosen one ringed"),
        width: 460.0,
        height: 280.0,
        x: Axis::covering(x, points.iter().map(|p| p[0])),
        y: Axis::covering(y, points.iter().map(|p| p[1])),
        layers,
    };
    format!("<figure>{}</figure>\n", plot.svg())
}

/// The last stages crowd around the best: every stage is shown.
fn table(input: &DynamicsInput, stages: &[String]) -> String {
    let mut order: Vec<&DynamicsTrial> = Vec::new();
    for stage in stages {
        let mut own: Vec<&DynamicsTrial> = input.trials.iter().filter(|t| t.stage == *stage).collect();
        own.sort_by(|a, b| a.total.total_cmp(&b.total));
        order.extend(own.into_iter().take(SHOWN));
    }
    order.sort_by(|a, b| a.total.total_cmp(&b.total));
    let mut table = Table::new(
        "Best trials of each stage",
        &["stage", "parameters", "#bounce", "#bias, %", "#ripple, N mm", "#overlap, mm", "#sum of squares"],
    );
    for t in order {
        let mut row = vec![TableCell::Text(t.stage.clone()), TableCell::Text(t.label.clone())];
        row.extend(
            [t.bounce_ratio, t.bias_percent, t.ripple_nmm, t.overlap_mm, t.total]
                .map(|v| TableCell::Number(number(v))),
        );
        table.row(row);
    }
    table.html()
}
