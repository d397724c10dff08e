//! The sections of a session's page, in reading order.

pub(crate) mod before_after;
mod calibration;
mod evidence;
mod found;
mod noise;
mod provenance;
mod readings;
mod residuals;
mod twin;
pub(crate) mod verdict;

use crate::input::ReportInput;
use crate::markup::escape;

/// One section: its anchor, heading and content.
pub(crate) struct Section {
    /// Anchor within the session.
    pub id: &'static str,
    /// Heading.
    pub title: &'static str,
    /// HTML below the heading.
    pub body: String,
}

/// Sections that apply to this session.
pub(crate) fn all(input: &ReportInput) -> Vec<Section> {
    let mut sections = vec![
        Section { id: "before-after", title: "Before and after", body: before_after::body(input) },
        Section { id: "found", title: "What was found", body: found::body(input) },
    ];
    if let Some(judged) = &input.verify.calibration {
        sections.push(Section {
            id: "calibration",
            title: "The given calibration",
            body: calibration::body(judged),
        });
    }
    if !input.twin.is_empty() || !input.verify.twin.faults.is_empty() {
        sections.push(Section { id: "twin", title: "Twin check", body: twin::body(input) });
    }
    sections.push(Section { id: "residuals", title: "Residuals", body: residuals::body(input) });
    sections.push(Section { id: "evidence", title: "Evidence", body: evidence::body(input) });
    sections.push(Section {
        id: "detectable",
        title: "Detectability: smallest effects found with 90 % power",
        body: evidence::detectable(input),
    });
    sections.push(Section { id: "noise", title: "Noise floor and remarks", body: noise::body(input) });
    sections.push(Section { id: "readings", title: "Readings", body: readings::body(input) });
    sections.push(Section {
        id: "provenance",
        title: "What was read, and how",
        body: provenance::body(input),
    });
    sections
}

/// A chart or several under one caption; simulated data is labelled at the picture itself, since pictures travel alone.
pub(crate) fn figure(simulated: bool, class: &str, charts: &str, caption: &str) -> String {
    let tag = if simulated { "<span class=\"pill sim\">SIMULATED</span> " } else { "" };
    format!(
        "<figure class=\"{class}\"><div class=\"charts\">{charts}</div><figcaption>{tag}{}</figcaption></figure>\n",
        escape(caption)
    )
}

/// Says that something was not part of this run.
fn absent(what: &str) -> String {
    format!("<p class=\"quiet\">{}</p>", escape(what))
}

/// Class and marker of the n-th channel; past the fourth, colours come back with another shape.
pub fn series(n: usize) -> (&'static str, crate::plot::Marker) {
    use crate::plot::Marker::{Circle, Diamond, Square, Triangle};
    (["s1", "s2", "s3", "s4"][n % 4], [Circle, Square, Diamond, Triangle][(n + n / 4) % 4])
}

/// Key of colours and shapes.
pub fn legend(names: &[impl AsRef<str>]) -> String {
    const SHAPES: [&str; 4] = ["●", "■", "◆", "▲"];
    let items: String = names
        .iter()
        .enumerate()
        .map(|(k, name)| {
            let (class, _) = series(k);
            format!(
                "<li><span class=\"key {class}\">{}</span> {}</li>",
                SHAPES[(k + k / 4) % 4],
                escape(name.as_ref())
            )
        })
        .collect();
    format!("<ul class=\"legend\">{items}</ul>")
}

/// Names in order of first appearance.
fn distinct<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for name in names {
        if !out.iter().any(|n| n == name) {
            out.push(name.to_owned());
        }
    }
    out
}

/// `a`, `a and b`, `a, b and c`.
fn joined(names: &[String]) -> String {
    match names {
        [] => String::new(),
        [one] => one.clone(),
        [most @ .., last] => format!("{} and {last}", most.join(", ")),
    }
}
