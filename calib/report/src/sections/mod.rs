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
    let mut sections = vec![
        Section {
            id: "before-after",
            title: "Before and after",
            body: before_after::body(input),
        },
        Section {
            id: "found",
            title: "What was found",
            body: found::body(input),
        },
    ];
    if let Some(judged) = &input.verify.calibration {
        sections.push(Section {
            id: "calibration",
            title: "The given calibration",
            body: calibration::body(judged),
        });
    }
    if !input.twin.is_empty() || !input.verify.twin.faults.is_empty() {
        sections.push(Section {
            id: "twin",
            title: "Twin check",
            body: twin::body(input),
        });
    }
    sections.push(Section {
        id: "residuals",
        title: "Residuals",
        body: residuals::body(input),
    });
    sections.push(Section {
        id: "evidence",
        title: "Evidence",
        body: evidence::body(input),
    });
    sections.push(Section {
        id: "detectable",
        title: "Detectability: smallest effects found with 90 % power",
        body: evidence::detectable(input),
    });
    sections.push(Section {
        id: "noise",
        title: "Noise floor and remarks",
        body: noise::body(input),
    });
    sections.push(Section {
        id: "readings",
        title: "Readings",
        body: readings::body(input),
    });
    sections.push(Section {
        id: "provenance",
        title: "What was read, and how",
        body: provenance::body(input),
    });
    sections
}
