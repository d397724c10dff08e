use std::error::Error;
use std::path::PathBuf;

/// Errors of an evaluation.
#[derive(Debug, thiserror::Error)]
pub enum EvaluateError {
    /// Tracker or series.
    #[error(transparent)]
    Track(#[from] wcal_track::TrackError),
    /// Objects or sweeps.
    #[error(transparent)]
    Sim(#[from] wcal_sim::SimError),
    /// The mesh of an object.
    #[error("object {name}: expected it built in, or its mesh in --meshes DIR: {source}")]
    Mesh {
        /// Object.
        name: String,
        /// Why not.
        source: wcal_sim::SimError,
    },
    /// Readings put through a calibration.
    #[error(transparent)]
    Calibration(#[from] wcal_calibration::CalibrationError),
    /// The virtual bench and its session.
    #[error("virtual bench: {0}")]
    Plant(#[from] wcal_plant::PlantError),
    /// The calibration of the virtual bench, which the caller makes.
    #[error("calibrating the virtual bench: {0}")]
    Calibrate(Box<dyn Error + Send + Sync>),
    /// A value that cannot be used.
    #[error("{what}: expected {expected}, found {found}")]
    Value {
        /// Which.
        what: String,
        /// What it may be.
        expected: &'static str,
        /// What it is.
        found: &'static str,
    },
    /// A file of what is in between.
    #[error("writing {}: {source}", path.display())]
    Write {
        /// File.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
}
