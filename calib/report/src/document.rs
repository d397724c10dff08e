//! `report.json` (format `wcal-report/1`): what a page shows and no other document of its command says, so that it can be made again.
//!
//! A session's page stands on `verify.json`, which is not repeated here. Numbers that JSON cannot hold are null.

use crate::dynamics::{DynamicsInput, render_dynamics};
use crate::input::ReportInput;
use crate::page::render;
use crate::shapes::{ShapesInput, render_shapes};
use crate::sweeps::{SweepsInput, render_sweeps};
use crate::twin::{TwinInput, render_twin};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use wcal_core::document::{DocumentError, json as json_text};
use wcal_core::format;
use wcal_core::ranges::{self, Range};
use wcal_core::verify_document::VERIFY_FORMAT;

/// Format tag of `report.json`.
pub const REPORT_FORMAT: &str = "wcal-report/1";

/// Counts and numbers that name something; what was measured and fitted may be anything.
const RANGES: &[Range] = &[
    Range::whole("seed", 0.0, 1.9e19),
    Range::whole("degrees_of_freedom", 0.0, 1e12),
    Range::whole("group", 0.0, 4e9),
    Range::whole("line", 0.0, 1e15),
    Range::whole("points", 0.0, 1e15),
    Range::real("p_value", 0.0, 1.0 + 1e-9),
    Range::real("coverage95", 0.0, 1.0 + 1e-9),
    // Anything else that was measured or fitted, in any unit.
    Range::real("", -1e150, 1e150),
];

/// A page by what it shows.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Page {
    /// A session through `verify`.
    Session(Box<ReportInput>),
    /// Shapes from stereo pictures.
    Shapes(ShapesInput),
    /// A sweep dataset.
    Sweeps(SweepsInput),
    /// A twin's labels.
    Twin(TwinInput),
    /// A fit of damping and contact.
    Dynamics(DynamicsInput),
}

/// Why a document gives no page.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// No JSON, or other keys and types than a page has.
    #[error("expected a page's document, found: {0}")]
    Content(#[from] DocumentError),
    /// The same of the result that it shows.
    #[error("verify.json: expected the result of verify, found: {0}")]
    Result(#[source] DocumentError),
    /// Another format or version, or a number that its key cannot have.
    #[error("{0}")]
    Format(String),
    /// The same of the result that it shows.
    #[error("verify.json: {0}")]
    ResultFormat(String),
    /// A session's page without the result that it shows.
    #[error("expected verify.json in the folder of the page of a session, found none")]
    NoResult,
}

impl Page {
    /// The page as HTML.
    #[must_use]
    pub fn render(&self) -> String {
        match self {
            Self::Session(input) => render(input),
            Self::Shapes(input) => render_shapes(input),
            Self::Sweeps(input) => render_sweeps(input),
            Self::Twin(input) => render_twin(input),
            Self::Dynamics(input) => render_dynamics(input),
        }
    }

    /// The document, on one line.
    ///
    /// # Errors
    /// None that a page can cause.
    pub fn to_json(&self) -> Result<String, PageError> {
        let document = json!({"format": REPORT_FORMAT, "page": serde_json::to_value(self).map_err(DocumentError::from)?});
        Ok(format!("{document}\n"))
    }

    /// Reads the document; `verify` is the text of the `verify.json` in the same folder, which a session needs.
    ///
    /// # Errors
    /// Another format, a document that is cut off or lacks keys, or a session without its result.
    pub fn from_json(text: &str, verify: Option<&str>) -> Result<Self, PageError> {
        let mut document = json_text(text)?;
        format::expect(REPORT_FORMAT, document["format"].as_str())
            .map_err(|e| PageError::Format(e.to_string()))?;
        ranges::check(&document, &[RANGES]).map_err(|e| PageError::Format(e.to_string()))?;
        let mut page = document["page"].take();
        if let Some(Value::Object(session)) = page.get_mut("session") {
            let verify = verify.ok_or(PageError::NoResult)?;
            let verify = json_text(verify).map_err(PageError::Result)?;
            format::expect(VERIFY_FORMAT, verify["format"].as_str())
                .map_err(|e| PageError::ResultFormat(e.to_string()))?;
            ranges::check(&verify, &[RANGES]).map_err(|e| PageError::ResultFormat(e.to_string()))?;
            session.insert("verify".to_owned(), verify);
        }
        Ok(serde_json::from_value(page).map_err(DocumentError::from)?)
    }
}
