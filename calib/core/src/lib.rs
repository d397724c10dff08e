//! Quantities, observations, residual records and the documents that wcal's programs exchange.
//!
//! No device and no native code; of files only how they are opened, written and locked. Units are
//! in the names: `_mm`, `_pm` (wavelength shift), `_nmm` (N mm), `_s`, `_degc`. Frames: **base**
//! has its origin at the wire's root; `base_from_cam0` takes cam0 coordinates to base coordinates.

pub mod calibration;
pub mod clock;
pub mod covariance;
pub mod data_sheet;
pub mod deadline;
pub mod device;
pub mod document;
pub mod files;
pub mod format;
pub mod interpolation;
pub mod jackknife;
pub mod least_squares;
pub mod lock;
pub mod map_document;
pub mod observation;
pub mod order_statistics;
pub mod plan_check_document;
pub mod provenance;
pub mod ranges;
pub mod repeats;
pub mod residual;
pub mod rig_devices;
pub mod rigid;
pub mod sealed;
pub mod sealed_rows;
pub mod shapes_document;
pub mod shared_time;
pub mod standstill;
pub mod stream;
pub mod text;
pub mod verify_document;
pub(crate) mod whisker_spec;
pub mod wire_frame;

pub use calibration::{CalibrationFile, CalibrationFrame, CalibrationNoise, VerificationStatus};
pub use observation::{
    FbgSpec, MomentAxes, PairLeftOut, Role, SessionData, SessionKind, SessionShapes, Trajectory,
    TransducerData, TransducerModel, TransducerRow, TwinLabel, WhiskerData, WhiskerRow,
    WhiskerSpec,
};
pub use provenance::{InputFile, Provenance, Purpose};
pub use residual::ResidualRecord;

pub use sealed::{Decide, Labelled, Ledger, Look, Opening, RowLabel, Sealed, fingerprint};
pub use sealed_rows::SealedRows;
pub use wire_frame::WireFrame;
