//! A calibration that `verify` is to judge, on readings that were not in its fit.

use crate::apply::SessionSystem;
use crate::artefact::{CalibrationModel, read_calibration};
use crate::error::CalibrationError;
use std::path::Path;
use wcal_core::verify_document::CalibrationJudgement;
use wcal_core::{CalibrationFile, InputFile, Purpose, VerificationStatus};
use wcal_session::LoadedSession;
use wcal_verify::verify::judgement::judge;

/// A calibration and which of the session's readings it can be judged on.
pub struct GivenCalibration {
    path: String,
    file: CalibrationFile<CalibrationModel>,
    /// The session's open readings were in its fit.
    only_sealed: bool,
}

impl GivenCalibration {
    /// Reads it. A holdout whose file was fitted for it proves nothing, nor does its own session
    /// without a holdout.
    ///
    /// # Errors
    /// Where it cannot be read, or all readings were in its fit.
    pub fn read(path: &Path, session: &LoadedSession) -> Result<Self, CalibrationError> {
        let file = read_calibration(path)?;
        // The content decides: a copy by another name holds the same readings.
        let fitted = |input: &&InputFile| {
            file.provenance
                .inputs
                .iter()
                .any(|i| i.sha256 == input.sha256 && i.purpose != Purpose::Holdout)
        };
        let of = |purpose: Purpose| session.inputs.iter().filter(move |i| i.purpose == purpose);
        if let Some(seen) = of(Purpose::Holdout).find(fitted) {
            let found = path.display();
            let detail = format!(
                "expected a holdout that was not in the fit, found it among the inputs of {found}"
            );
            return Err(CalibrationError::content(Path::new(&seen.path), detail));
        }
        let only_sealed = of(Purpose::Fit).any(|i| fitted(&i));
        if only_sealed && of(Purpose::Holdout).next().is_none() {
            let detail = "expected readings that were not in its fit (a holdout, or another session), found only those that it was fitted to";
            return Err(Self::refused(&path.display().to_string(), detail));
        }
        Ok(Self {
            path: path.display().to_string(),
            file,
            only_sealed,
        })
    }

    /// Hash of its content.
    pub fn content_sha256(&self) -> &str {
        &self.file.content_sha256
    }

    fn refused(path: &str, detail: impl ToString) -> CalibrationError {
        CalibrationError::Content {
            place: format!("--calibration {path}"),
            detail: detail.to_string(),
        }
    }

    /// Judged by the moments of a whisker session's poses, or by the responses of a transducer or
    /// axis session.
    ///
    /// # Errors
    /// Where it is of another kind of session, or there is nothing to judge it by.
    pub fn judge(
        &self,
        session: SessionSystem<'_>,
    ) -> Result<CalibrationJudgement, CalibrationError> {
        let refused = |detail: &str| Self::refused(&self.path, detail);
        let readings = self
            .file
            .model
            .judged_readings(session, self.only_sealed)
            .map_err(|e| Self::refused(&self.path, e))?;
        let readings = readings.ok_or_else(|| refused("no moments at the session's poses"))?;
        let judgement = judge(&readings, session.quantities())
            .ok_or_else(|| refused("expected readings to judge it on, found none"))?;
        let content_sha256 = self.file.content_sha256.clone();
        Ok(CalibrationJudgement {
            path: self.path.clone(),
            content_sha256,
            ..judgement
        })
    }

    /// The same calibration, marked as one that failed.
    ///
    /// # Errors
    /// Where its model cannot be written as JSON.
    pub fn failed(&self) -> Result<CalibrationFile<CalibrationModel>, serde_json::Error> {
        let mut file = CalibrationFile {
            verification: VerificationStatus::Failed,
            ..self.file.clone()
        };
        file.content_sha256 = file.compute_hash()?;
        Ok(file)
    }
}
