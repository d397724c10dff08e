//! Calibrations as files: what `calibration.json` holds, how it is sealed, when it may be used, and
//! how it is applied.
//!
//! A calibration turns readings into the quantity that they stand for: wavelengths into moments (a
//! map of `fit-gpr`, or the traced model of `verify`), a transducer's response into its stimulus, a
//! commanded position into its error. [`Calibration`] applies any of them to a table;
//! [`WhiskerCalibration`] applies those of a whisker reading by reading, too. [`GivenCalibration`]
//! is one that is judged on readings that were not in its fit.

mod apply;
mod artefact;
mod error;
mod export;
mod export_law;
mod export_map;
mod export_table;
mod exported;
mod given;
mod history;
mod map;
mod physical;
mod scalar;
mod trust_issue;

pub use apply::{Calibration, SensedRow, SensedTable, SessionSystem, WhiskerCalibration};
pub use artefact::{
    CalibrationModel, WireParts, of_whisker, provenance, read_calibration, read_unsealed, seal,
    trust_issues,
};
pub use error::CalibrationError;
pub use export::export;
pub use exported::Export;
pub use given::GivenCalibration;
pub use history::{CalibrationHistory, HistoryEntry, QuantityHistory, history};
pub use scalar::rows_to_check;
pub use trust_issue::TrustIssue;
