//! Renders the results of a session to one self-contained HTML page that reads well offline, in
//! print, in light and in dark.
//!
//! The crate computes nothing: it shows what other crates computed. The only arithmetic is that of
//! display: scaling of axes, the difference measured − predicted, and the ratio of an error to what
//! the model after expects.
//!
//! - [`render`]: the page of one session, from a [`ReportInput`].
//! - [`render_index`]: an overview page that links to reports in the same folder.
//! - [`render_history`]: the page of one unit's calibrations over time, from a [`HistoryInput`].
//! - [`render_shapes`]: the page of shapes from stereo pictures, from a [`ShapesInput`].
//!
//! ```
//! let verify = wcal_core::verify_document::VerifyDocument::refused("session", "axis", "no readings", 1);
//! let input = wcal_report::ReportInput::new(verify, wcal_core::Provenance::default());
//! let page = wcal_report::render(&input);
//! assert!(page.starts_with("<!DOCTYPE html>"));
//! ```

mod history;
mod input;
mod markup;
mod number;
mod page;
mod plot;
mod sections;
mod shapes;

pub use history::{HistoryChart, HistoryInput, render_history};
pub use input::{EvidenceRow, Fact, GateTest, ReportInput, TwinMark, TwinTrajectory, model_after};
pub use number::{number, p_value, percent, with_interval};
pub use page::{render, render_index};
pub use shapes::{ShapePair, ShapePicture, ShapesInput, render_shapes};
