//! Measured against predicted, before and after.

use super::residuals::unchanged;
use super::{absent, distinct, figure};
use crate::input::ReportInput;
use crate::number::{join_unit, number, unit_text};
use crate::plot::{Axis, Layer, Marker, Plot, stride};
use wcal_core::ResidualRecord;

/// Up to this many readings a channel carry a hover text each.
const MAX_TITLES: usize = 400;
const MAX_POINTS: usize = 3000;

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    if input.residuals.is_empty() {
        return absent("No residual records were handed to this report.");
    }
    let mut charts = String::new();
    for (k, channel) in distinct(input.residuals.iter().map(|r| r.channel.as_str())).iter().enumerate() {
        let records: Vec<_> = input.residuals.iter().filter(|r| r.channel == *channel).collect();
        let unit = records.first().map_or("", |r| r.unit.as_str());
        let values = records.iter().flat_map(|r| [r.measured, r.predicted_before, r.predicted_after]);
        let both = Axis::covering("", values);
        let before = |r: &ResidualRecord| r.predicted_before;
        let after = |r: &ResidualRecord| r.predicted_after;
        if unchanged(input) {
            charts += &chart(k, channel, "before and after", unit, &both, &records, before);
            continue;
        }
        charts += &chart(k, channel, "before", unit, &both, &records, before);
        charts += &chart(k, channel, "after", unit, &both, &records, after);
    }
    figure(
        input.verify.simulated,
        "square",
        &charts,
        "Measured against predicted readings; on the line they agree. Crosses mark rejected readings.",
    )
}

fn chart(
    k: usize,
    channel: &str,
    stage: &str,
    unit: &str,
    axis: &Axis,
    records: &[&ResidualRecord],
    predicted: impl Fn(&ResidualRecord) -> f64,
) -> String {
    let (class, marker) = super::series(k);
    let label = |word: &str| match unit_text(unit) {
        u if u.is_empty() => word.to_owned(),
        u => format!("{word} ({u})"),
    };
    let hover = |r: &ResidualRecord| {
        let value = join_unit(&number(r.measured), unit);
        format!("point {} ({} line {}): measured {value}", r.point, r.source, r.line)
    };
    let mut layers = vec![Layer::Line { class: "quiet", at: vec![[axis.low; 2], [axis.high; 2]] }];
    for rejected in [false, true] {
        let chosen: Vec<_> = records.iter().filter(|r| r.rejected.is_some() == rejected).collect();
        let step = if rejected { 1 } else { stride(chosen.len(), MAX_POINTS) };
        let shown = || chosen.iter().step_by(step);
        let titles =
            if chosen.len() <= MAX_TITLES { shown().map(|r| hover(r)).collect() } else { Vec::new() };
        let at = shown().map(|r| [predicted(r), r.measured]).collect();
        let (class, marker) = if rejected { ("bad", Marker::Cross) } else { (class, marker) };
        layers.push(Layer::Points { class, marker, at, titles });
    }
    Plot {
        title: format!("{channel}, {stage}"),
        description: format!("Measured against predicted {channel}, {stage}; {} readings", records.len()),
        width: 280.0,
        height: 262.0,
        x: Axis { label: label("predicted"), ..axis.clone() },
        y: Axis { label: label("measured"), ..axis.clone() },
        layers,
    }
    .svg()
}
