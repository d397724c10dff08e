//! Renders the results of a session to one self-contained HTML page that reads well offline, in print, in light and in dark.
//!
//! The crate computes nothing: it shows what other crates computed. The only arithmetic is that of display: scaling of
//! axes, the difference measured − predicted, and the ratio of an error to the noise floor.
//!
//! - [`render`]: the page of one session, from a [`ReportInput`].
//! - [`render_many`]: several sessions on one page, an overview table at the top.
//! - [`render_index`]: an overview page that links to reports in the same folder.
//! - [`render_twin`]: the page of a twin's labels, from a [`TwinInput`].
//! - [`render_dynamics`]: the page of a fit of damping and contact, from a [`DynamicsInput`].
//! - [`render_tracking`]: the page of a tracker's training or evaluation, from a [`TrackingInput`].
//! - [`render_shapes`]: the page of shapes from stereo pictures, from a [`ShapesInput`].
//! - [`render_sweeps`]: the page of a (simulated) sweep dataset, from a [`SweepsInput`].
//! - [`render_map`]: the page of a map from wavelengths to moments, from `fit-gpr.json`.
//! - [`Page`]: any of them as `report.json` stores it, to be made again.
//!
//! ```
//! let verify = wcal_core::verify_document::VerifyDocument::refused("session", "axis", "no readings", 1);
//! let input = wcal_report::ReportInput::new(verify, wcal_core::Provenance::default());
//! let page = wcal_report::render(&input);
//! assert!(page.starts_with("<!DOCTYPE html>"));
//! ```

mod document;
mod dynamics;
mod input;
mod map;
mod markup;
mod nullable;
mod number;
mod page;
mod plot;
mod sections;
mod shapes;
mod sweep_picture;
mod sweeps;
mod tracking;
mod twin;

pub use document::{Page, PageError, REPORT_FORMAT};
pub use dynamics::{DynamicsInput, DynamicsTrial, render_dynamics};
pub use input::{
    EvidenceRow, Explanation, Fact, GateTest, IndexEntry, Isolability, NamedError, ReportInput, RodBranch,
    TwinMark, TwinTrajectory, model_after,
};
pub use map::render_map;
pub use number::{number, p_value, percent, with_interval};
pub use page::{is_page, render, render_index, render_many};
pub use shapes::{ShapePair, ShapePicture, ShapesInput, render_shapes};
pub use sweep_picture::SweepPicture;
pub use sweeps::{
    EnginesCompared, ExampleSample, ExampleSweep, SpeedDifference, SweepsInput, SweptObject, render_sweeps,
};
pub use tracking::{Curves, NumberTable, TrackingInput, render_tracking};
pub use twin::{TipEffect, TwinInput, render_twin};
