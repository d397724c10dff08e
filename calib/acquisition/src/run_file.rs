//! `run.json`: who recorded a session, with what, and when. Written before the first move; what
//! came of each run is added when it ends.

use crate::error::AcquisitionError;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::device::DeviceIdentity;
use wcal_core::document::from_json;
use wcal_core::ranges::Range;

/// `format` of the file.
pub(crate) const RUN_FORMAT: &str = "wcal-run/1";

const RANGES: &[Range] = &[
    Range::real("clock_scale", 1e-3, 1e4),
    Range::whole("", 0.0, 1.9e19),
];

/// Everything about a run that the raw streams do not contain.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunFile {
    /// Format and version.
    #[schemars(extend("const" = RUN_FORMAT))]
    pub format: String,
    /// Identifier of the session.
    pub id: String,
    /// Medium.
    pub medium: String,
    /// Time of creation, RFC 3339.
    pub created: String,
    /// Program and version.
    pub program: String,
    /// Command line.
    pub command: Vec<String>,
    /// Hash of rig.toml.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub rig_sha256: String,
    /// Hash of plan.toml.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub plan_sha256: String,
    /// Devices by role.
    pub devices: BTreeMap<String, DeviceIdentity>,
    /// Host seconds per wall second; other than 1: an accelerated virtual bench.
    pub clock_scale: f64,
    /// Recorded from simulated devices; absent in files from before the mark.
    #[serde(default)]
    pub simulated: bool,
    /// What came of each run, one a recording; a run that was killed has none.
    #[serde(default)]
    pub runs: Vec<RunOutcome>,
}

/// What came of one run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RunOutcome {
    /// File of its raw streams.
    pub recording: String,
    /// `finished` or `stopped`.
    #[schemars(extend("enum" = ["finished", "stopped"]))]
    pub ending: String,
    /// Why it stopped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
    /// Scans received.
    pub scans: u64,
    /// Scans that were lost.
    pub lost_scans: u64,
    /// What was lost or not as it should be in the session up to here; each was a reason for exit
    /// code 3.
    pub warnings: Vec<String>,
}

impl RunFile {
    /// Whether the devices were simulated. Files from before this key are recognised by the names
    /// that the virtual bench's devices give themselves, and by its clock.
    pub fn is_simulated(&self) -> bool {
        self.simulated
            || self.clock_scale != 1.0
            || self.devices.values().any(DeviceIdentity::is_virtual)
    }

    /// Reads a run file.
    ///
    /// # Errors
    /// Where it cannot be read, or as [`Self::parse`].
    pub(crate) fn read(path: &Path) -> Result<Self, AcquisitionError> {
        Self::parse(&wcal_core::files::read_text(path)?)
    }

    /// Parses the file.
    ///
    /// # Errors
    /// What was expected and what was found.
    pub fn parse(text: &str) -> Result<Self, AcquisitionError> {
        from_json(text, RUN_FORMAT, &[RANGES])
            .map_err(|e| AcquisitionError::document("run.json", "a run file", e))
    }
}
