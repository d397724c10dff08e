//! Whole pages: head, verdict, contents, sections, overview.

use crate::input::{Fact, IndexEntry, ReportInput};
use crate::markup::{Table, TableCell, escape, paragraph};
use crate::sections::{self, before_after, verdict};
use std::fmt::Write;

/// Badge of simulated data.
const SIMULATED: &str = "<span class=\"pill sim\">SIMULATED</span>";

const STYLE: &str = include_str!("style.css");

/// The page of one session.
pub fn render(input: &ReportInput) -> String {
    document(input.heading(), input.verify.simulated, &session(input))
}

/// An overview page that links to session reports in the same folder.
pub fn render_index(title: &str, introduction: &[&str], entries: &[IndexEntry]) -> String {
    let simulated = entries.iter().any(|e| e.verify.simulated);
    document(title, simulated, &overview(title, introduction, entries))
}

/// How every page begins.
const HEAD: &str = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/><meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/><meta name=\"color-scheme\" content=\"light dark\"/><link rel=\"icon\" href=\"data:,\"/><title>";

/// Every page is well-formed XML too, so that a strict parser can check it.
pub(crate) fn document(title: &str, simulated: bool, body: &str) -> String {
    let mark = if simulated { " (simulated data)" } else { "" };
    format!(
        "{HEAD}{}{mark}</title>\n<style>\n{STYLE}</style></head>\n<body><main>\n{body}</main></body></html>\n",
        escape(title)
    )
}

/// Header with the verdict, contents and all sections of a session.
fn session(input: &ReportInput) -> String {
    let sections = sections::all(input);
    let mut out = format!(
        "<article id=\"top\">\n<header>\n{}{}",
        headline(input),
        banner(input)
    );
    out.push_str("<nav aria-label=\"Contents\"><ul>");
    for section in &sections {
        let _ = write!(
            out,
            "<li><a href=\"#{}\">{}</a></li>",
            section.id,
            escape(section.title)
        );
    }
    out.push_str("</ul></nav>\n</header>\n");
    for section in &sections {
        out += &section_html(section.id, section.title, &section.body);
    }
    out + "</article>\n"
}

fn section_html(id: &str, heading: &str, body: &str) -> String {
    let heading = escape(heading);
    format!(
        "<section id=\"{id}\" aria-labelledby=\"{id}-h\"><h2 id=\"{id}-h\">{heading}</h2>\n{body}</section>\n"
    )
}

fn headline(input: &ReportInput) -> String {
    let verify = &input.verify;
    let badge = if verify.simulated { SIMULATED } else { "" };
    let mut out = format!(
        "<p class=\"over\">Calibration report · {} session <code>{}</code> {badge}</p>\n<h1>{}</h1>\n",
        escape(&verify.kind),
        escape(&verify.session),
        escape(input.heading())
    );
    if verify.simulated {
        let how = input
            .simulated_by
            .as_ref()
            .map_or(String::new(), |how| format!(": {}", escape(how)));
        out += &format!("<p class=\"simulated\">Simulated data, not a measurement{how}.</p>\n");
    }
    out + &facts(&input.facts)
}

fn banner(input: &ReportInput) -> String {
    let (class, short, meaning) = verdict::of(&input.verify);
    let mut out = format!(
        "<div class=\"verdict {class}\" role=\"note\"><p class=\"word\"><strong>{short}</strong> <span>{meaning}</span></p>{}",
        paragraph(&input.verify.reason)
    );
    if let Some([name, before, after, floor]) =
        before_after::summary(&input.verify, input.response_unit())
    {
        let cell = |head: &str, value: &str| {
            format!("<div><dt>{head}</dt><dd>{}</dd></div>", escape(value))
        };
        let _ = write!(
            out,
            "<dl><div class=\"wide\"><dt>held-out error</dt><dd>{}</dd></div>{}{}{}</dl>",
            escape(&name),
            cell("before", &before),
            cell("after", &after),
            cell("noise floor", &floor)
        );
    }
    for caution in &input.verify.cautions {
        let _ = write!(out, "<p>Caution: {}</p>", escape(caution));
    }
    if let Some(c) = &input.verify.contact {
        let cell = |head: &str, mm: f64| format!("<div><dt>{head}</dt><dd>{mm:.2} mm</dd></div>");
        let _ = write!(
            out,
            "<dl><div class=\"wide\"><dt>contact</dt><dd>{} readings at the groove</dd></div>{}{}{}</dl>",
            c.readings,
            cell("before", c.before.rms_mm),
            cell("after", c.after.rms_mm),
            cell("bound", c.bound_mm)
        );
    }
    out + "</div>\n"
}

/// A page without a verdict: line above the heading and heading, whether the data are simulated, facts, and sections (anchor, heading,
/// content) of which empty ones are left out.
pub fn plain_page(
    (over, title): (&str, &str),
    simulated: bool,
    input: &[Fact],
    parts: &[(&str, &str, String)],
) -> String {
    let (badge, line) = match simulated {
        true => (
            SIMULATED,
            "<p class=\"simulated\">Simulated data, not a measurement.</p>\n",
        ),
        false => ("", ""),
    };
    let mut body = format!(
        "<header><p class=\"over\">{} {badge}</p>\n<h1>{}</h1>\n{line}{}</header>\n",
        escape(over),
        escape(title),
        facts(input)
    );
    for (id, heading, inner) in parts.iter().filter(|p| !p.2.is_empty()) {
        body += &section_html(id, heading, inner);
    }
    document(title, simulated, &body)
}

pub(crate) fn facts(facts: &[Fact]) -> String {
    if facts.is_empty() {
        return String::new();
    }
    let rows: String = facts
        .iter()
        .map(|f| {
            format!(
                "<div><dt>{}</dt><dd>{}</dd></div>",
                escape(&f.name),
                escape(&f.value)
            )
        })
        .collect();
    format!("<dl class=\"facts\">{rows}</dl>\n")
}

fn overview(title: &str, introduction: &[&str], entries: &[IndexEntry]) -> String {
    let mut out = format!(
        "<header><p class=\"over\">Overview</p><h1>{}</h1>\n",
        escape(title)
    );
    for text in introduction {
        out += &paragraph(text);
    }
    if entries.iter().any(|e| e.verify.simulated) {
        out += "<p class=\"simulated\">Sessions marked SIMULATED are no measurements.</p>\n";
    }
    out += "</header>\n";
    out += "<section id=\"overview\" aria-label=\"Overview\">";
    out += &before_after::overview_figure(entries);
    let mut table = Table::stacked(
        "Sessions with their verdict and held-out error",
        &[
            "session",
            "data",
            "verdict",
            "found",
            "quantity",
            "#before",
            "#after",
            "#noise floor",
            "#contact (mm)",
        ],
    );
    for entry in entries {
        let (class, short, _) = verdict::of(&entry.verify);
        let [name, before, after, floor] =
            before_after::summary(&entry.verify, &entry.response_unit)
                .unwrap_or_else(|| ["–"; 4].map(str::to_owned));
        let contact = entry.verify.contact.as_ref().map_or_else(
            || "–".to_owned(),
            |c| format!("{:.2} → {:.2}", c.before.rms_mm, c.after.rms_mm),
        );
        let data = match entry.verify.simulated {
            true => TableCell::Badge("sim", "SIMULATED".into()),
            false => TableCell::Text("measured".into()),
        };
        table.row(vec![
            TableCell::Link(entry.href.clone(), entry.title.clone()),
            data,
            TableCell::Badge(class, short.into()),
            TableCell::Text(entry.verify.reason.clone()),
            TableCell::Text(name),
            TableCell::Number(before),
            TableCell::Number(after),
            TableCell::Number(floor),
            TableCell::Number(contact),
        ]);
    }
    out + &table.html() + "</section>\n"
}
