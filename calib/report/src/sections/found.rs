//! What was found: effects, ambiguity, unknown driver, next measurement.

use super::parts::{absent, joined};
use super::residuals;
use crate::input::ReportInput;
use crate::markup::{Table, escape, paragraph, with_sign};
use crate::number::{
    join_unit, number, p_value, percent, quantity, split_unit, unit_text, with_interval,
};
use wcal_core::verify_document::{NamedEffect, NextMeasurement, Verdict};

/// The section.
pub(super) fn body(input: &ReportInput) -> String {
    let verify = &input.verify;
    let mut out = String::new();
    // Nothing is called accepted that was not.
    if verify.verdict == Verdict::Ambiguous
        && !input.accepted_on_request
        && !verify.effects.is_empty()
    {
        out += "<p>Best of the explanations that survive; not accepted, since the data leave others open:</p>";
    }
    for effect in &verify.effects {
        out += &one_effect(effect);
    }
    if verify.effects.is_empty() {
        out += &absent("No effect of the catalogue was added to the declared model.");
    }
    out += &left_out(input);
    out += &ambiguity(input);
    if let Some(unknown) = &verify.unknown {
        let period = match unknown.period {
            Some(period) => {
                format!(
                    " with period {}",
                    quantity(period, &residuals::unit_of(&unknown.driver))
                )
            }
            None => String::new(),
        };
        out += &format!(
            "<div class=\"card\"><h3>Unknown effect</h3><p>The residual follows <strong>{}</strong> (shape: {}{}). All covariates, strongest first: {}.</p>{}</div>",
            escape(&residuals::label_of(&unknown.driver)),
            escape(&unknown.shape),
            escape(&period),
            escape(
                &unknown
                    .drivers_ranked
                    .iter()
                    .map(|d| residuals::label_of(d))
                    .collect::<Vec<_>>()
                    .join(", ")
            ),
            residuals::driver_figure(input, &unknown.driver)
        );
    }
    if !verify.twin.faults.is_empty() {
        out += "<p>Faulty labels of the twin are listed under the twin check.</p>";
    }
    if let Some(next) = &verify.next_measurement {
        out += &next_measurement(next);
    }
    out
}

/// Parameters that need no folding; a table of errors has as many as places.
const MANY: usize = 12;

fn one_effect(effect: &NamedEffect) -> String {
    let mut out = format!(
        "<div class=\"card\"><h3><code>{}</code></h3>",
        escape(&effect.id)
    );
    if !effect.sentence.is_empty() {
        out += &paragraph(&effect.sentence);
    }
    let mut table = Table::new(
        &format!("Parameters of {}", effect.id),
        &["parameter", "#value", "#95 % interval", "unit"],
    );
    for p in &effect.parameters {
        let (value, interval) = with_interval(p.value, p.interval95);
        table.row([split_unit(&p.name).0, value, interval, unit_text(&p.unit)]);
    }
    let (table, count) = (table.html(), effect.parameters.len());
    out += &match count {
        0..=MANY => table,
        _ => format!("<details><summary>All {count} values</summary>{table}</details>"),
    };
    out += &format!(
        "<p>Adjusted for the whole catalogue: p {}.",
        with_sign(&p_value(effect.p_value))
    );
    let others: Vec<String> = effect
        .class
        .iter()
        .filter(|id| **id != effect.id)
        .cloned()
        .collect();
    if !others.is_empty() {
        out += &format!(
            " This data cannot distinguish it from {}, even in principle.",
            escape(&joined(&others))
        );
    }
    out + "</p></div>"
}

/// What each accepted effect is worth.
fn left_out(input: &ReportInput) -> String {
    let mut table = Table::new(
        "Each effect left out, the others refitted",
        &[
            "effect",
            "#misfit grows by",
            "#p",
            "#left-out error with",
            "#without",
        ],
    );
    for e in &input.verify.leave_one_effect_out {
        let error = |e: Option<f64>| e.map_or_else(|| "-".to_owned(), number);
        table.row([
            e.id.clone(),
            format!("{} times", number(e.misfit_ratio)),
            p_value(e.p_value),
            error(e.left_out),
            error(e.left_out_without),
        ]);
    }
    table.html()
}

fn ambiguity(input: &ReportInput) -> String {
    let sets = &input.verify.alternatives;
    if sets.is_empty() {
        return String::new();
    }
    let name = |set: &Vec<String>| match set.as_slice() {
        [] => "declared model alone".to_owned(),
        some => some.join(" + "),
    };
    let rows: String = sets
        .iter()
        .map(|set| format!("<li><code>{}</code></li>", escape(&name(set))))
        .collect();
    let lead = match (input.verify.verdict, sets.len()) {
        (_, 1) => "Only one survives:",
        (Verdict::Ambiguous, _) => "Competing explanations, best first:",
        _ => "Explanations that survive, best first:",
    };
    format!("<div class=\"card\"><h3>Competing explanations</h3><p>{lead}</p><ol>{rows}</ol></div>")
}

fn next_measurement(next: &NextMeasurement) -> String {
    let mut out = format!(
        "<div class=\"card\"><h3>Next measurement</h3>{}",
        paragraph(&next.instruction)
    );
    if !next.separates.is_empty() {
        out += &format!(
            "<p>Separates <code>{}</code>; expected to decide with probability <strong>{}</strong>.</p>",
            escape(&next.separates.join(", ")),
            percent(next.expected_power)
        );
    }
    let mut table = Table::new(
        "Poses of the next measurement, in order",
        &[
            "#step",
            "#trajectory",
            "#stage (mm)",
            "direction",
            "#speed",
            "#dwell (s)",
        ],
    );
    for (k, pose) in next.poses.iter().enumerate() {
        let direction = if pose.direction < 0.0 {
            "unloading"
        } else {
            "loading"
        };
        let speed = match pose.speed_mm_s {
            0.0 => "settled".to_owned(),
            v => join_unit(&number(v), "mm/s"),
        };
        table.row([
            (k + 1).to_string(),
            pose.trajectory.to_string(),
            number(pose.stage_mm),
            format!("{direction} ({})", number(pose.direction)),
            speed,
            number(pose.dwell_s),
        ]);
    }
    out += &table.html();
    out + "</div>"
}
