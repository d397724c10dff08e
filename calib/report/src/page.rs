//! Whole pages: head, verdict, contents, sections, overview.

use crate::input::{Fact, ReportInput};
use crate::markup::{Table, TableCell, escape, paragraph};
use crate::sections::{self, before_after, verdict};
use std::fmt::Write;
use wcal_core::verify_document::TrackError;

/// Badge of simulated data.
const SIMULATED: &str = "<span class=\"pill sim\">SIMULATED</span>";

/// Style of every page, CSS.
const STYLE: &str = include_str!("style.css");

/// The page of one session.
pub fn render(input: &ReportInput) -> String {
    document(
        &input.verify.session,
        input.verify.simulated,
        &session(input),
    )
}

/// An overview page that links to session reports in the same folder: each with its address
/// relative to the page, none where that is empty.
pub fn render_index(
    title: &str,
    introduction: &[&str],
    reports: &[(String, ReportInput)],
) -> String {
    let simulated = reports.iter().any(|(_, input)| input.verify.simulated);
    document(title, simulated, &overview(title, introduction, reports))
}

/// How every page begins.
const HEAD: &str = "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"/><meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/><meta name=\"color-scheme\" content=\"light dark\"/><link rel=\"icon\" href=\"data:,\"/><title>";

/// Every page is well-formed XML too, so that a strict parser can check it.
pub(crate) fn document(title: &str, simulated: bool, body: &str) -> String {
    // A bookmark or a printout keeps the title, but not the badge on the page.
    let mark = if simulated { " (simulated data)" } else { "" };
    format!(
        "{HEAD}{}{mark}</title>\n<style>\n{STYLE}</style></head>\n<body><main>\n{body}</main></body></html>\n",
        escape(title)
    )
}

/// Header with the verdict, contents and all sections of a session.
fn session(input: &ReportInput) -> String {
    let sections = sections::all(input);
    let verify = &input.verify;
    let (kind, name) = (escape(&verify.kind), escape(&verify.session));
    let over = format!("Calibration report · {kind} session <code>{name}</code>");
    let how = input
        .simulated_by
        .as_ref()
        .map_or(String::new(), |how| format!(": {how}"));
    let head = headline(
        &over,
        &verify.session,
        verify.simulated.then_some(how.as_str()),
        &input.facts,
    );
    let mut out = format!("<article id=\"top\">\n<header>\n{head}{}", banner(input));
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

/// What a page begins with, `over` its kind in HTML; `how` the data were simulated.
fn headline(over: &str, title: &str, how: Option<&str>, stated: &[Fact]) -> String {
    let mark = |how| {
        format!(
            "<p class=\"simulated\">Simulated data, not a measurement{}.</p>\n",
            escape(how)
        )
    };
    let badge = how.map_or("", |_| SIMULATED);
    format!(
        "<p class=\"over\">{over} {badge}</p>\n<h1>{}</h1>\n{}{}",
        escape(title),
        how.map(mark).unwrap_or_default(),
        facts(stated)
    )
}

fn banner(input: &ReportInput) -> String {
    let (class, short, meaning) = verdict::of(&input.verify);
    let mut out = format!(
        "<div class=\"verdict {class}\" role=\"note\"><p class=\"word\"><strong>{short}</strong> <span>{meaning}</span></p>{}",
        paragraph(&input.verify.reason)
    );
    if let Some([name, before, after, expected]) = before_after::summary(input) {
        let cell = |head: &str, value: &str| {
            format!("<div><dt>{head}</dt><dd>{}</dd></div>", escape(value))
        };
        let _ = write!(
            out,
            "<dl><div class=\"wide\"><dt>held-out error</dt><dd>{}</dd></div>{}{}{}</dl>",
            escape(&name),
            cell("before", &before),
            cell("after", &after),
            cell("expected", &expected)
        );
    }
    // A reader may see nothing but the verdict, so its cautions stand beside it.
    for caution in &input.verify.cautions {
        let _ = write!(out, "<p>Caution: {}</p>", escape(caution));
    }
    if let Some(c) = &input.verify.contact {
        let cell = |head: &str, mm: &str| format!("<div><dt>{head}</dt><dd>{mm}</dd></div>");
        let interval = |e: &TrackError| {
            e.interval95.map_or(String::new(), |[low, high]| {
                format!(" [{low:.2}, {high:.2}]")
            })
        };
        let error = |e: &TrackError| format!("{:.2} mm{}", e.rms_mm, interval(e));
        let _ = write!(
            out,
            "<dl><div class=\"wide\"><dt>contact{}</dt><dd>{} readings of {} trajectories, each left out in turn</dd></div>{}{}{}</dl>",
            if c.is_same() { ": no difference" } else { "" },
            c.readings,
            c.trajectories.len(),
            cell("before", &error(&c.before)),
            cell("after", &error(&c.after)),
            cell("expected", &format!("{:.2} mm", c.bound_mm))
        );
    }
    out + "</div>\n"
}

/// A page without a verdict: line above the heading and heading, whether the data are simulated,
/// facts, and sections (anchor, heading, content) of which empty ones are left out.
pub(crate) fn plain_page(
    (over, title): (&str, &str),
    simulated: bool,
    input: &[Fact],
    parts: &[(&str, &str, String)],
) -> String {
    let head = headline(&escape(over), title, simulated.then_some(""), input);
    let mut body = format!("<header>{head}</header>\n");
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

fn overview(title: &str, introduction: &[&str], reports: &[(String, ReportInput)]) -> String {
    let mut out = format!(
        "<header><p class=\"over\">Overview</p><h1>{}</h1>\n",
        escape(title)
    );
    // What it is all for, in the unit that a user feels.
    let first = reports.iter().find_map(|(_, r)| r.verify.contact.as_ref());
    if let Some(c) = first {
        let [before, after] = [&c.before, &c.after].map(|e| e.rms_mm);
        let _ = writeln!(
            out,
            "<p class=\"claim\">{before:.2} mm → {after:.2} mm <span>error of a contact</span></p>"
        );
    }
    for text in introduction {
        out += &paragraph(text);
    }
    if reports.iter().any(|(_, input)| input.verify.simulated) {
        out += "<p class=\"simulated\">Sessions marked SIMULATED are no measurements.</p>\n";
    }
    out += "</header>\n";
    out += "<section id=\"overview\" aria-label=\"Overview\">";
    out += &before_after::overview_figure(reports);
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
            "#expected",
            "#contact (mm)",
        ],
    );
    for (href, input) in reports {
        let verify = &input.verify;
        let (class, short, _) = verdict::of(verify);
        let [name, before, after, expected] =
            before_after::summary(input).unwrap_or_else(|| ["–"; 4].map(str::to_owned));
        let contact = verify.contact.as_ref().map_or_else(
            || "–".to_owned(),
            |c| format!("{:.2} → {:.2}", c.before.rms_mm, c.after.rms_mm),
        );
        // One overview may mix simulated and measured sessions, so each row states its origin.
        let data = match verify.simulated {
            true => TableCell::Badge("sim", "SIMULATED".into()),
            false => TableCell::Text("measured".into()),
        };
        table.row([
            TableCell::Link(href.clone(), verify.session.clone()),
            data,
            TableCell::Badge(class, short.into()),
            TableCell::Text(verify.reason.clone()),
            TableCell::Text(name),
            TableCell::Text(before),
            TableCell::Text(after),
            TableCell::Text(expected),
            TableCell::Text(contact),
        ]);
    }
    out + &table.html() + "</section>\n"
}
