//! calibration.json: what it may hold, how it is sealed, read and judged.

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use std::path::Path;
use wcal_core::calibration::CALIBRATION_FORMAT;
use wcal_core::{CalibrationFile, Provenance, VerificationStatus, WhiskerSpec};
use wcal_map::MapArtefact;
use wcal_session::LoadedSession;
use wcal_trace::scalar::ScalarModel;
use wcal_trace::whisker::PhysicalModel;

/// The model in a calibration, told apart by `kind`.
#[allow(clippy::large_enum_variant, reason = "one a program run")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum CalibrationModel {
    /// A wavelength-to-moment map of `fit-gpr`.
    Map(MapArtefact),
    /// Sensitivity with accepted effects, of `verify`.
    Physical(PhysicalModel),
    /// Response or position error with accepted effects, of `verify` on a transducer or axis session.
    Scalar(ScalarModel),
}

/// Program, command, time, seed, files, and whether the session is simulated.
pub fn provenance(session: &LoadedSession, seed: u64) -> Provenance {
    Provenance {
        program: format!("wcal {}", env!("CARGO_PKG_VERSION")),
        command: std::env::args().collect(),
        created: jiff::Timestamp::now().to_string(),
        seed,
        inputs: session.inputs.clone(),
        simulated: session.simulated,
    }
}

impl CalibrationModel {
    /// Checks effects, laws, versions and sizes by name, before anything is computed with them: the one place for every command.
    fn check(&self) -> anyhow::Result<()> {
        match self {
            Self::Map(map) => map.check()?,
            Self::Physical(model) => model.check()?,
            Self::Scalar(model) => model.check()?,
        }
        Ok(())
    }
}

/// A calibration with its content hash; `whisker` is the wire that it was made with.
pub fn seal(
    session: &str,
    verification: VerificationStatus,
    expires: Option<String>,
    model: CalibrationModel,
    provenance: Provenance,
    whisker: Option<&WhiskerSpec>,
) -> anyhow::Result<CalibrationFile<CalibrationModel>> {
    let mut file = CalibrationFile {
        format: CALIBRATION_FORMAT.to_owned(),
        session: session.to_owned(),
        verification,
        expires,
        // Through JSON once, so that the hash is that of what is written.
        model: serde_json::from_str(&serde_json::to_string(&model)?)?,
        provenance,
        whisker: whisker.cloned(),
        content_sha256: String::new(),
    };
    file.content_sha256 = file.compute_hash()?;
    Ok(file)
}

/// Reads the file and checks format and content hash.
pub fn read_calibration(path: &Path) -> anyhow::Result<CalibrationFile<CalibrationModel>> {
    match read_unsealed(path)? {
        (file, None) => Ok(file),
        (_, Some(changed)) => bail!(changed),
    }
}

/// Reads the file and checks its format and its model; says so where the content is not what was sealed.
pub fn read_unsealed(path: &Path) -> anyhow::Result<(CalibrationFile<CalibrationModel>, Option<String>)> {
    let name = path.display();
    let bytes = std::fs::read(path).with_context(|| format!("reading {name}"))?;
    let value: serde_json::Value =
        serde_json::from_slice(&bytes).with_context(|| format!("{name}: expected a calibration in JSON"))?;
    // The format before anything else: another version may have other fields.
    let format = value.get("format").and_then(serde_json::Value::as_str);
    if format != Some(CALIBRATION_FORMAT) {
        let found = format.map_or_else(|| "nothing".to_owned(), |f| format!("{f:?}"));
        bail!("{name}: field `format`: expected {CALIBRATION_FORMAT:?}, found {found}");
    }
    let raw: CalibrationFile<serde_json::Value> =
        serde_json::from_value(value).with_context(|| format!("{name}: expected a calibration"))?;
    let found = raw.compute_hash()?;
    let changed = (found != raw.content_sha256).then(|| {
        format!(
            "{name}: field `content_sha256`: expected {found}, found {}: the file was changed",
            raw.content_sha256
        )
    });
    let file: CalibrationFile<CalibrationModel> = serde_json::from_slice(&bytes)
        .with_context(|| format!("{name}: expected a model of kind \"map\", \"physical\" or \"scalar\""))?;
    file.model.check().with_context(|| name.to_string())?;
    Ok((file, changed))
}

/// What speaks against using the calibration now.
pub fn standing(
    file: &CalibrationFile<CalibrationModel>,
    now: jiff::Timestamp,
) -> anyhow::Result<Vec<String>> {
    let mut doubts = Vec::new();
    if let Some(expires) = &file.expires {
        let until: jiff::Timestamp = expires.parse().with_context(|| {
            format!("calibration: field `expires`: expected an RFC 3339 time, found {expires:?}")
        })?;
        if now > until {
            doubts.push(format!("the calibration expired at {expires}"));
        }
    }
    if file.verification == VerificationStatus::Failed {
        doubts.push("the calibration failed its verification".to_owned());
    }
    Ok(doubts)
}
