//! A calibration that `verify` is to judge, on readings that were not in its fit.

use crate::artefact::{CalibrationModel, read_calibration};
use anyhow::{Context, bail};
use std::path::Path;
use wcal_core::verify_document::CalibrationJudgement;
use wcal_core::{CalibrationFile, InputFile, Purpose, VerificationStatus};
use wcal_session::LoadedSession;
use wcal_trace::scalar::{self, ScalarSystem};
use wcal_trace::verify::SessionModel;
use wcal_trace::verify::judgement::{Judged, judge};
use wcal_trace::whisker::{WhiskerSystem, judgement};

/// A calibration and which of the session's readings it can be judged on.
pub struct GivenCalibration {
    path: String,
    file: CalibrationFile<CalibrationModel>,
    /// The session's open readings were in its fit.
    only_sealed: bool,
}

impl GivenCalibration {
    /// Reads it. A holdout whose file was fitted for it proves nothing, nor does its own session without a holdout.
    pub fn read(path: &Path, session: &LoadedSession) -> anyhow::Result<Self> {
        let file = read_calibration(path)?;
        let fitted = |input: &&InputFile| {
            file.provenance.inputs.iter().any(|i| i.sha256 == input.sha256 && i.purpose != Purpose::Holdout)
        };
        let of = |purpose: Purpose| session.inputs.iter().filter(move |i| i.purpose == purpose);
        if let Some(seen) = of(Purpose::Holdout).find(fitted) {
            bail!(
                "{}: expected a holdout that was not in the fit, found it among the inputs of {}",
                seen.path,
                path.display()
            );
        }
        let only_sealed = of(Purpose::Fit).any(|i| fitted(&i));
        if only_sealed && of(Purpose::Holdout).next().is_none() {
            bail!(
                "--calibration {}: expected readings that were not in its fit (a holdout, or another session), found only those that it was \
                 fitted to",
                path.display()
            );
        }
        Ok(Self { path: path.display().to_string(), file, only_sealed })
    }

    /// Judged by the moments of a whisker session's poses.
    pub fn on_whisker(&self, whole: &WhiskerSystem, seed: u64) -> anyhow::Result<CalibrationJudgement> {
        let readings = match &self.file.model {
            CalibrationModel::Physical(model) => judgement::of_model(whole, model, self.only_sealed),
            CalibrationModel::Map(map) => judgement::of_map(whole, map, self.only_sealed),
            CalibrationModel::Scalar(model) => return self.other_kind(&model.session_kind, whole.kind()),
        };
        let readings =
            readings.with_context(|| format!("{}: no moments at the session's poses", self.path))?;
        self.judged(judge(&readings, &judgement::QUANTITIES, seed))
    }

    /// Judged by the responses of a transducer or axis session.
    pub fn on_scalar(&self, whole: &ScalarSystem, seed: u64) -> anyhow::Result<CalibrationJudgement> {
        let CalibrationModel::Scalar(model) = &self.file.model else {
            return self.other_kind("whisker", whole.kind());
        };
        if model.session_kind != whole.kind() {
            return self.other_kind(&model.session_kind, whole.kind());
        }
        let readings: Vec<Judged> = scalar::judgement::of_model(whole, model, self.only_sealed)?;
        self.judged(judge(&readings, whole.quantities(), seed))
    }

    fn other_kind<T>(&self, found: &str, expected: &str) -> anyhow::Result<T> {
        bail!("--calibration {}: expected one of a session of kind {expected:?}, found {found:?}", self.path)
    }

    fn judged(&self, judgement: Option<CalibrationJudgement>) -> anyhow::Result<CalibrationJudgement> {
        let judgement = judgement.with_context(|| {
            format!("--calibration {}: expected readings to judge it on, found none", self.path)
        })?;
        let content_sha256 = self.file.content_sha256.clone();
        Ok(CalibrationJudgement { path: self.path.clone(), content_sha256, ..judgement })
    }

    /// The same calibration, marked as one that failed.
    pub fn failed(&self) -> anyhow::Result<CalibrationFile<CalibrationModel>> {
        let mut file = CalibrationFile { verification: VerificationStatus::Failed, ..self.file.clone() };
        file.content_sha256 = file.compute_hash()?;
        Ok(file)
    }
}
