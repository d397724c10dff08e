//! Whole pages: head, verdict, contents, sections, overview.

use crate::input::{Fact, ReportInput};
use crate::markup::{TableCell, escape, paragraph};
use crate::sections::{self, before_after, verdict};
use std::fmt::Write;
use wcal_core::verify_document::Verdict;

/// Badge of simulated data.
const SIMULATED: &str = "<span class=\"pill sim\">SIMULATED</span>";

/// Style of every page, CSS.
const STYLE: &str = include_str!("style.css");

/// The page of one session.
pub fn render(input: &ReportInput) -> String {
    document(&input.title, input.verify.simulated, &session(input))
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
        &input.title,
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
        "<div class=\"verdict {class}\" role=\"note\"><p class=\"word\"><strong>{short}</strong> <span>{meaning}</span></p>{}{}",
        before_after::first_claim(input),
        paragraph(&input.verify.reason)
    );
    out += &before_after::summary(input);
    // A reader may see nothing but the verdict, so its cautions stand beside it.
    for caution in &input.verify.cautions {
        let _ = write!(out, "<p>Caution: {}</p>", escape(caution));
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
    // What it is all for, before any word.
    out += &reports
        .first()
        .map_or(String::new(), |(_, r)| before_after::first_claim(r));
    for text in introduction {
        out += &paragraph(text);
    }
    if reports.iter().any(|(_, input)| input.verify.simulated) {
        out += "<p class=\"simulated\">Sessions marked SIMULATED are no measurements.</p>\n";
    }
    out += "</header>\n";
    out += "<div class=\"cards\">";
    for (href, input) in reports {
        out += &card(href, input);
    }
    out + "</div>\n"
}

/// One session of an overview.
fn card(href: &str, input: &ReportInput) -> String {
    let verify = &input.verify;
    let (class, short, meaning) = verdict::of(verify);
    // One overview may mix simulated and measured sessions, so each states its origin.
    let data = if verify.simulated {
        SIMULATED
    } else {
        "measured"
    };
    let link = TableCell::Link(href.to_owned(), input.title.clone()).html();
    let verdict = TableCell::Badge(class, short.into()).html();
    let names: Vec<&str> = verify.effects.iter().map(|e| e.id.as_str()).collect();
    let found = match verify.verdict {
        Verdict::Effect if !names.is_empty() => format!("Found: {}.", names.join(", ")),
        _ => format!("Answer: {meaning}."),
    };
    format!(
        "<section><h2>{link}</h2><p>{verdict} {data}</p>{}{}{}</section>\n",
        paragraph(&input.about),
        paragraph(&found),
        before_after::summary(input)
    )
}
