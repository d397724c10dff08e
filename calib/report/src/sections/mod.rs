//! The sections of a session's page, in reading order.

pub(crate) mod before_after;
mod calibration;
mod evidence;
mod found;
mod noise;
pub(crate) mod parts;
mod provenance;
mod readings;
mod residuals;
mod result;
mod twin;
pub(crate) mod verdict;

use crate::input::ReportInput;

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
    let mut sections = Vec::new();
    let mut add = |id, title, body| sections.push(Section { id, title, body });
    add(
        "before-after",
        "Before and after",
        before_after::body(input),
    );
    if let Some(sheet) = &input.verify.data_sheet {
        add("result", "Result to write down", result::body(sheet));
    }
    add("found", "What was found", found::body(input));
    if let Some(judged) = &input.verify.calibration {
        add(
            "calibration",
            "The given calibration",
            calibration::body(judged),
        );
    }
    add("twin", "Twin check", twin::body(input));
    add("residuals", "Residuals", residuals::body(input));
    add("evidence", "Evidence", evidence::body(input));
    let title = "Detectability: smallest effects that these data show";
    add("detectable", title, evidence::detectable(input));
    add("noise", "Noise floor and remarks", noise::body(input));
    add("readings", "Readings", readings::body(input));
    add(
        "provenance",
        "What was read, and how",
        provenance::body(input),
    );
    sections.retain(|s| !s.body.is_empty());
    sections
}
