use std::path::PathBuf;

/// What can go wrong from sweeps to a model and its scores.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// An object or a plan of sweeps.
    #[error(transparent)]
    Sim(#[from] wcal_mesh::MeshError),
    /// MuJoCo.
    #[error(transparent)]
    Mujoco(#[from] wcal_mujoco::TwinError),
    /// A model or a filter.
    #[error(transparent)]
    Track(#[from] wcal_network::NetworkError),
    /// Readings put through a calibration.
    #[error(transparent)]
    Calibration(#[from] wcal_calibration::CalibrationError),
    /// The virtual bench and its session.
    #[error("virtual bench: {0}")]
    Plant(#[from] wcal_plant::PlantError),
    /// The calibration of the virtual bench, which the caller makes.
    #[error("calibrating the virtual bench: {0}")]
    Calibrate(Box<dyn std::error::Error + Send + Sync>),
    /// The mesh of an object.
    #[error("object {name}: expected it built in, or its mesh in --meshes DIR: {source}")]
    Mesh {
        /// Object.
        name: String,
        /// Why not.
        source: wcal_mesh::MeshError,
    },
    /// The file system refused.
    #[error(transparent)]
    Refused(#[from] wcal_core::files::FileError),
    /// A file could not be read or written.
    #[error("{action} {}: {detail}", path.display())]
    File {
        /// What was tried.
        action: &'static str,
        /// Where.
        path: PathBuf,
        /// Why not.
        detail: String,
    },
    /// A value that cannot be used.
    #[error("{what}: expected {expected}, found {found}")]
    Value {
        /// Which.
        what: String,
        /// What it may be.
        expected: String,
        /// What it is.
        found: String,
    },
    /// A folder that holds another dataset, or several.
    #[error("{}: expected one dataset, found another or a mixture ({differences}); use another folder", folder.display())]
    Mixture {
        /// Which.
        folder: PathBuf,
        /// What differs.
        differences: String,
    },
    /// A shard that is damaged.
    #[error("shard {}: {detail}", path.display())]
    Shard {
        /// Which.
        path: PathBuf,
        /// How.
        detail: String,
    },
}

impl LabError {
    /// For `map_err` on file operations.
    pub fn file<E: std::fmt::Display>(
        action: &'static str,
        path: &std::path::Path,
    ) -> impl FnOnce(E) -> Self {
        let path = path.to_owned();
        move |e| Self::File {
            action,
            path,
            detail: e.to_string(),
        }
    }

    /// A value that cannot be used.
    pub fn value(
        what: impl Into<String>,
        expected: impl Into<String>,
        found: impl Into<String>,
    ) -> Self {
        Self::Value {
            what: what.into(),
            expected: expected.into(),
            found: found.into(),
        }
    }
}
