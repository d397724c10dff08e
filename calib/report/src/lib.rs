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
//! # use wcal_core::verify_document::*;
//! # let verify = VerifyDocument { format: VERIFY_FORMAT.into(), session: "s".into(), simulated: false, kind: "axis".into(),
//! #     verdict: Verdict::Adequate, reason: "Nothing is left.".into(), twin: TwinCheck::default(), effects: vec![],
//! #     noise: None, flagged: vec![],
//! #     alternatives: vec![], unknown: None, noise_floor: NoiseFloor::default(), before: None, after: None,
//! #     coverage95: None, next_measurement: None, detectable: vec![], seed: 1, inputs: vec![], notes: vec![],
//! #     leave_one_effect_out: vec![], identifiability: vec![], calibration: None, groove_tracking: None, sweep: None,
//! #     witness: None, pictures: None };
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
pub use sweeps::{
    EnginesCompared, ExampleSample, ExampleSweep, SpeedDifference, SweepsInput, SweptObject, render_sweeps,
};
pub use tracking::{Curves, NumberTable, TrackingInput, render_tracking};
pub use twin::{TipEffect, TwinInput, render_twin};
