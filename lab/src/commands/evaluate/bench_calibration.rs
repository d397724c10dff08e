//! The virtual bench's session calibrated as a user would: by `fit-gpr` and by `verify`.

use crate::evaluation::BenchCalibration;
use anyhow::bail;
use std::path::Path;
use wcal::fit_gpr::training_set;
use wcal::labels::{LabelSource, moment_labels};
use wcal::output::OutputFolder;
use wcal::verify::{self, verify_session};
use wcal_calibration::{CalibrationModel, read_calibration};
use wcal_core::SessionData;
use wcal_gpr::{FitOptions, fit_map};

/// Calibrates the session; the results of `verify` go into a folder beside it.
pub(crate) fn calibrate(folder: &Path, seed: u64) -> anyhow::Result<BenchCalibration> {
    let session = wcal_session::load(folder)?;
    let SessionData::Whisker(data) = &session.data else {
        bail!("expected a whisker's session")
    };
    let labels = moment_labels(data, LabelSource::Rod)?;
    let options = FitOptions {
        labels: labels.source.clone(),
        fbg: data.fbg.clone(),
        ..FitOptions::default()
    };
    let training = training_set(data, &labels).0;
    let map = CalibrationModel::Map(fit_map(&training, &options)?.artefact);
    let results = folder.with_file_name("verify");
    let mut out = OutputFolder::open(&verify::RESULT, &results, false)?;
    let report = verify_session(session, &mut out, verify::searching(seed, None), None, None)?;
    out.finish()?;
    let calibration = results.join("calibration.json");
    let verified = if calibration.exists() {
        Some(read_calibration(&calibration)?.model)
    } else {
        None
    };
    Ok(BenchCalibration {
        map,
        verified,
        verdict: report.verify.verdict,
        accepted: report.verify.effects.iter().map(|e| e.id.clone()).collect(),
        groove: report.verify.groove_tracking,
    })
}
