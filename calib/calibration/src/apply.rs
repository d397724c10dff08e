//! One way to apply any calibration.

use crate::error::CalibrationError;
use std::path::Path;
use wcal_core::stream::{MomentSpread, MomentStream, StreamMoments};
use wcal_core::{CalibrationNoise, FbgSpec, WhiskerRow, WhiskerSpec};
use wcal_session::SessionWarning;
use wcal_verify::scalar::ScalarSystem;
use wcal_verify::verify::{HeldOut, Quantity, SessionModel, SessionText};
use wcal_verify::whisker::groove_motion::{AcceptedWire, GrooveMotion};
use wcal_verify::whisker::physical::CalibratedReading;
use wcal_verify::whisker::{WhiskerSystem, judgement};

/// A calibration of any kind: from readings to the quantity that they stand for.
pub trait Calibration {
    /// What summaries call it, e.g. `thin-plate`, `physical`.
    fn name(&self) -> &str;
    /// Kind of the sessions that it is of: `whisker`, `transducer` or `axis`.
    fn session_kind(&self) -> &str;
    /// Checks effects, laws, versions and sizes by name, before anything is computed with them.
    ///
    /// # Errors
    /// What is damaged or of another version.
    fn check(&self) -> Result<(), CalibrationError>;
    /// Applied to every reading of a table.
    ///
    /// # Errors
    /// Where the table cannot be read, or lacks a column that the calibration needs.
    fn apply(&self, table: &Path) -> Result<AppliedTable, CalibrationError>;
    /// Applied to the readings of a session, or to those that were sealed, against what the session
    /// knows of them; none where nothing can be computed at its poses.
    ///
    /// # Errors
    /// [`CalibrationError::OtherKind`], or where it cannot answer.
    fn judged_readings(
        &self,
        session: SessionSystem<'_>,
        only_sealed: bool,
    ) -> Result<Option<Vec<HeldOut>>, CalibrationError>;
    /// As one of a whisker, which streams can use; none for other kinds.
    fn whisker(&self) -> Option<&dyn WhiskerCalibration>;
}

/// A calibration from wavelengths to moments.
pub trait WhiskerCalibration {
    /// The gratings that it was made with.
    fn fbg(&self) -> &FbgSpec;
    /// Standard deviation of its moments from pose to pose, N mm.
    fn noise_sd_nmm(&self) -> f64;
    /// Whether its zero is that of the free wire.
    fn knows_zero(&self) -> bool {
        true
    }
    /// Readings that it was fitted to, where it says.
    fn poses(&self) -> Option<usize> {
        None
    }
    /// What the errors of its moments are made of.
    fn noise(&self) -> CalibrationNoise;
    /// Reading by reading, memory carried on from one to the next.
    ///
    /// # Errors
    /// Where it cannot be inverted.
    fn stream(&self) -> Result<Box<dyn MomentStream>, CalibrationError>;
    /// A table's moments.
    ///
    /// # Errors
    /// Where the table cannot be read, or lacks a column that the calibration needs.
    fn sensed(&self, table: &Path) -> Result<SensedTable, CalibrationError>;
    /// The wire that `whisker` describes, in air, as the calibration has it, and by one standard
    /// deviation of each of the first common unknowns.
    ///
    /// # Errors
    /// Where the wire cannot be bent.
    fn wire(
        &self,
        whisker: &WhiskerSpec,
    ) -> Result<(AcceptedWire, Vec<AcceptedWire>), CalibrationError>;
    /// A session's moments and the ways of its groove, not its place; none where nothing can be
    /// computed.
    fn groove_motion(&self, system: &WhiskerSystem) -> Option<GrooveMotion>;
}

/// The error of [`WhiskerCalibration::wire`].
pub(crate) fn no_wire() -> CalibrationError {
    CalibrationError::content(Path::new("calibration"), "expected a wire that can be bent")
}

/// A session as its kind's measurement model sees it.
#[derive(Clone, Copy)]
pub enum SessionSystem<'a> {
    /// A whisker: its readings are judged by the moments of the poses.
    Whisker(&'a WhiskerSystem),
    /// A transducer or an axis: judged by the responses.
    Scalar(&'a ScalarSystem),
}

impl<'a> SessionSystem<'a> {
    /// The whisker that it is.
    ///
    /// # Errors
    /// [`CalibrationError::OtherKind`] for other kinds.
    pub(crate) fn as_whisker(&self) -> Result<&'a WhiskerSystem, CalibrationError> {
        match self {
            Self::Whisker(system) => Ok(system),
            Self::Scalar(system) => Err(CalibrationError::other_kind(system.kind(), "whisker")),
        }
    }

    /// Kind of the session.
    pub fn kind(&self) -> &str {
        match self {
            Self::Whisker(system) => system.kind(),
            Self::Scalar(system) => system.kind(),
        }
    }

    /// Quantities that readings are judged by.
    pub fn quantities(&self) -> &[Quantity] {
        match self {
            Self::Whisker(_) => &judgement::QUANTITIES,
            Self::Scalar(system) => system.quantities(),
        }
    }
}

/// What `predict` writes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AppliedTable {
    /// Table with its header.
    pub csv: String,
    /// Readings.
    pub rows: usize,
    /// How many readings lie outside the valid region, in words; none where all lie inside.
    pub outside: Option<String>,
    /// What is odd about the table of readings.
    pub warnings: Vec<SessionWarning>,
    /// How the values were found, where there is more than one way.
    pub remarks: Vec<String>,
}

/// A table through a calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct SensedTable {
    /// Rows in the table's order.
    pub rows: Vec<SensedRow>,
    /// What is odd about the table of readings.
    pub warnings: Vec<SessionWarning>,
}

/// A row of [`SensedTable`].
#[derive(Debug, Clone, PartialEq)]
pub struct SensedRow {
    /// Number of the reading.
    pub point: i64,
    /// Its line in the table.
    pub line: usize,
    /// Time, s, where the table has it.
    pub t_s: Option<f64>,
    /// Whether the strain-isolated grating was read.
    pub reference: bool,
    /// Moments.
    pub moments: StreamMoments,
    /// What their spread is made of.
    pub spread: MomentSpread,
}

impl SensedRow {
    pub(crate) fn new(row: &WhiskerRow, (moments, spread): CalibratedReading) -> Self {
        Self {
            point: row.point,
            line: row.line,
            t_s: row.t_s,
            reference: row.reference_shift_pm.is_some(),
            moments,
            spread,
        }
    }
}
