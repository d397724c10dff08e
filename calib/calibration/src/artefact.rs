//! `calibration.json`: what it may hold, how it is sealed and read.

use crate::apply::{Calibration, WhiskerCalibration};
use crate::error::CalibrationError;
use crate::trust_issue::TrustIssue;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::path::Path;
use wcal_core::calibration::CALIBRATION_FORMAT;
use wcal_core::covariance;
use wcal_core::format;
use wcal_core::ranges::{self, Range};
use wcal_core::verify_document::CalibrationContact;
use wcal_core::{
    CalibrationFile, CalibrationFrame, MomentAxes, Provenance, VerificationStatus, WhiskerSpec,
    WireFrame,
};
use wcal_gpr::MapArtefact;
use wcal_session::LoadedSession;
use wcal_verify::scalar::ScalarModel;
use wcal_verify::whisker::PhysicalModel;

/// The model in a calibration, distinguished by `kind`.
#[allow(clippy::large_enum_variant, reason = "one a program run")]
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
pub enum CalibrationModel {
    /// A wavelength-to-moment map of `fit-gpr`.
    Map(MapArtefact),
    /// Sensitivity with accepted effects, of `verify`.
    Physical(PhysicalModel),
    /// Response or position error with accepted effects, of `verify` on a transducer or axis
    /// session.
    Scalar(ScalarModel),
}

/// Program, command, time, seed, files, and whether the session is simulated.
pub fn provenance(session: &LoadedSession, seed: u64) -> Provenance {
    Provenance {
        program: format!("wcal {}", env!("CARGO_PKG_VERSION")),
        command: std::env::args().collect(),
        created: jiff::Timestamp::now().to_string(),
        seed,
        // The table that it was imported from holds its readings, too.
        inputs: session
            .inputs
            .iter()
            .cloned()
            .chain(session.imported_from())
            .collect(),
        simulated: session.simulated,
    }
}

/// The one place that distinguishes the kinds.
impl std::ops::Deref for CalibrationModel {
    type Target = dyn Calibration;

    fn deref(&self) -> &Self::Target {
        match self {
            Self::Map(map) => map,
            Self::Physical(model) => model,
            Self::Scalar(model) => model,
        }
    }
}

/// A calibration with its content hash; `wire`: of a whisker, what it was made with.
///
/// # Errors
/// Where the model cannot be written as JSON.
pub fn seal(
    session: &str,
    verification: VerificationStatus,
    expires: Option<String>,
    model: CalibrationModel,
    provenance: Provenance,
    wire: Option<WireParts<'_>>,
) -> Result<CalibrationFile<CalibrationModel>, serde_json::Error> {
    let file = CalibrationFile {
        format: CALIBRATION_FORMAT.to_owned(),
        session: session.to_owned(),
        verification,
        expires,
        provenance,
        whisker: wire.as_ref().map(|w| w.whisker.clone()),
        frame: wire.as_ref().map(|w| frame(w.whisker, w.moments)),
        noise: wire.as_ref().and_then(|_| Some(model.whisker()?.noise())),
        contact_uncertainty: wire.and_then(|w| w.contact),
        model,
        content_sha256: String::new(),
    };
    // Through JSON once, so that the hash is that of what is written.
    let mut file: CalibrationFile<CalibrationModel> =
        serde_json::from_str(&serde_json::to_string(&file)?)?;
    file.content_sha256 = file.compute_hash()?;
    Ok(file)
}

/// What a whisker's calibration was made with.
#[derive(Debug, Clone)]
pub struct WireParts<'a> {
    /// Wire.
    pub whisker: &'a WhiskerSpec,
    /// Moment components.
    pub moments: &'a MomentAxes,
    /// What its uncertainty makes of a contact.
    pub contact: Option<CalibrationContact>,
}

/// What a calibration says of the frame of its session.
fn frame(whisker: &WhiskerSpec, axes: &MomentAxes) -> CalibrationFrame {
    CalibrationFrame {
        rest_shape: whisker.rest_shape.clone(),
        moment_axes: axes.axes,
        moment_sign: axes.sign,
        sweep_direction: WireFrame::new(whisker, axes)
            .ok()
            .map(|frame| frame.sweep_direction()),
    }
}

/// Numbers that a calibration may hold; what a model's own parameters can be, the model says.
const RANGES: &[Range] = &[
    Range::whole("seed", 0.0, 1.9e19),
    Range::whole("model.seatings", 0.0, 4.3e9),
    Range::whole("model.version", 0.0, 1e6),
    Range::whole("model.declared.polynomial", 0.0, 1e18),
    Range::whole("model.scaling.count", 0.0, 1e12),
    Range::real("model.outputs.nugget", 1e-30, 1e30),
    Range::real("model.outputs.variance_nmm2", 0.0, 1e30),
    Range::real("model.outputs.inflation", 0.0, 1e30),
    Range::real("dof", 0.0, 1e12),
    Range::real("", -1e30, 1e30),
];

/// Reads the file and checks format, model and content hash.
///
/// # Errors
/// Where the file cannot be read, is no calibration, or was changed.
pub fn read_calibration(
    path: &Path,
) -> Result<CalibrationFile<CalibrationModel>, CalibrationError> {
    match read_unsealed(path)? {
        (file, None) => Ok(file),
        (_, Some(changed)) => Err(CalibrationError::Changed(changed)),
    }
}

/// Reads the file and checks its format and its model; says so where the content is not what was
/// sealed.
///
/// # Errors
/// Where the file cannot be read or is no calibration.
pub fn read_unsealed(
    path: &Path,
) -> Result<(CalibrationFile<CalibrationModel>, Option<TrustIssue>), CalibrationError> {
    // A result's folder stands for the calibration in it.
    let within = path.join("calibration.json");
    let path = if path.is_dir() { &within } else { path };
    let refuse = |expected: &str, e: serde_json::Error| {
        CalibrationError::content(path, format!("{expected}: {e}"))
    };
    let text = wcal_core::files::read_text(path).map_err(|e| CalibrationError::Io {
        path: e.path,
        source: e.source,
    })?;
    let value: serde_json::Value =
        serde_json::from_str(&text).map_err(|e| refuse("expected a calibration in JSON", e))?;
    // The format before anything else: another version may have other fields.
    format::expect(
        CALIBRATION_FORMAT,
        value.get("format").and_then(serde_json::Value::as_str),
    )
    .map_err(|why| CalibrationError::content(path, why))?;
    ranges::check(&value, &[RANGES]).map_err(|e| CalibrationError::content(path, e))?;
    // Of the models that state one; what else it has to be, the model says.
    if let Ok(stated) =
        serde_json::from_value::<Vec<Vec<f64>>>(value["model"]["covariance"].clone())
    {
        let wrong = |why| CalibrationError::content(path, format!("model.covariance: {why}"));
        covariance::check(&stated, stated.len()).map_err(wrong)?;
    }
    // The model stays as it stands in the file: a newer one may have keys that are not known here.
    let raw: CalibrationFile<serde_json::Value> =
        serde_json::from_value(value).map_err(|e| refuse("expected a calibration", e))?;
    let found = raw
        .compute_hash()
        .map_err(|e| refuse("expected a calibration", e))?;
    let changed = (found != raw.content_sha256).then(|| TrustIssue::Changed {
        place: path.display().to_string(),
        content_sha256: found,
        stated_sha256: raw.content_sha256,
    });
    let file: CalibrationFile<CalibrationModel> = serde_json::from_str(&text).map_err(|e| {
        refuse(
            "expected a model of kind \"map\", \"physical\" or \"scalar\"",
            e,
        )
    })?;
    file.model
        .check()
        .map_err(|e| CalibrationError::content(path, e))?;
    if let Some(whisker) = &file.whisker {
        whisker
            .check()
            .map_err(|e| CalibrationError::content(path, format!("whisker.{e}")))?;
    }
    if let Some(frame) = &file.frame {
        let unit = frame
            .moment_axes
            .iter()
            .all(|a| (a.norm() - 1.0).abs() < 1e-3);
        if !unit || frame.moment_sign.abs() != 1.0 {
            let found = format!("{:?}, {}", frame.moment_axes, frame.moment_sign);
            let detail = format!(
                "frame.moment_axes, frame.moment_sign: expected two unit vectors and 1 or -1, found {found}"
            );
            return Err(CalibrationError::content(path, detail));
        }
    }
    Ok((file, changed))
}

/// As one of a whisker.
///
/// # Errors
/// Where it is of another kind of session.
pub fn of_whisker<'a>(
    path: &Path,
    file: &'a CalibrationFile<CalibrationModel>,
) -> Result<&'a dyn WhiskerCalibration, CalibrationError> {
    file.model.whisker().ok_or_else(|| {
        let detail = format!(
            "expected a whisker's calibration, found one of kind {:?}",
            file.model.session_kind()
        );
        CalibrationError::content(path, detail)
    })
}

/// What speaks against using the calibration at the time `now`.
///
/// # Errors
/// Where `expires` is no RFC 3339 time.
pub fn trust_issues(
    file: &CalibrationFile<CalibrationModel>,
    now: jiff::Timestamp,
) -> Result<Vec<TrustIssue>, CalibrationError> {
    let mut issues = Vec::new();
    if let Some(expires) = &file.expires {
        let until: jiff::Timestamp = expires.parse().map_err(|e| {
            let detail =
                format!("field `expires`: expected an RFC 3339 time, found {expires:?}: {e}");
            CalibrationError::content(Path::new("calibration"), detail)
        })?;
        if now > until {
            issues.push(TrustIssue::Expired(expires.clone()));
        }
    }
    if file.verification == VerificationStatus::Failed {
        issues.push(TrustIssue::FailedVerification);
    }
    Ok(issues)
}
