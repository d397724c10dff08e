//! What speaks against tracking with a calibration and a model.

use crate::artefact::{CalibrationModel, read_unsealed, standing};
use anyhow::{Result, bail};
use std::path::{Path, PathBuf};
use wcal_core::{CalibrationFile, VerificationStatus};
use wcal_map::OutputMap;
use wcal_track::filter::FilterBank;
use wcal_track::model_file::Card;
use wcal_track::tracker::trained_steps_s;
use wcal_track::{Tracker, TrackerStream};

/// TrustIssues, each with a short code for the rows and a sentence for people.
#[derive(Debug, Clone, Default)]
pub struct TrustIssues {
    codes: Vec<&'static str>,
    messages: Vec<String>,
}

impl TrustIssues {
    fn add(&mut self, code: &'static str, sentence: String) {
        self.codes.push(code);
        self.messages.push(sentence);
    }

    /// Whether there are none.
    pub fn none(&self) -> bool {
        self.codes.is_empty()
    }

    /// Codes with `|` between them.
    pub fn codes(&self) -> String {
        self.codes.join("|")
    }

    /// Sentences.
    pub fn messages(&self) -> &[String] {
        &self.messages
    }
}

/// A whisker's calibration and model.
pub struct WhiskerModel<'a> {
    /// Name in the rig.
    pub name: String,
    /// Where the calibration lies.
    pub place: PathBuf,
    /// Calibration.
    pub file: CalibrationFile<CalibrationModel>,
    /// Model.
    pub tracker: &'a Tracker,
    /// Its card.
    pub card: Card,
    /// What speaks against them.
    pub doubts: TrustIssues,
}

/// Share of the noise from pose to pose that is white from one averaged reading to the next; the rest is slow. An assumption.
const WHITE: f64 = 0.2;
/// Share by which the zero may be off in a recording. An assumption too.
const ZERO: f64 = 0.5;

/// Filters with the measurement noise of moments that come through a calibration.
pub fn filters_for(filters: FilterBank, model: &CalibrationModel) -> FilterBank {
    let noise_nmm = match model {
        CalibrationModel::Map(map) => map.outputs.iter().map(OutputMap::noise_sd_nmm).fold(0.0, f64::max),
        CalibrationModel::Physical(model) => {
            model.noise_sd_pm / model.sensitivity().singular_values().min().max(1e-9)
        }
        CalibrationModel::Scalar(_) => 0.0,
    };
    filters.with_measurement_noise(WHITE * noise_nmm, ZERO * noise_nmm)
}

impl WhiskerModel<'_> {
    /// A stream whose filters have the calibration's noise.
    pub fn stream(&self) -> TrackerStream<'_> {
        self.tracker.stream_with(filters_for(self.tracker.filters, &self.file.model))
    }
}

/// Why `verify` wrote no calibration at this place; none where there is one, or no `verify.json` beside it.
fn never_written(place: &Path) -> Option<String> {
    if place.exists() {
        return None;
    }
    let beside = place.with_file_name("verify.json");
    let document: serde_json::Value = serde_json::from_slice(&std::fs::read(&beside).ok()?).ok()?;
    let text = |key: &str| document[key].as_str().unwrap_or_default().to_owned();
    let ids = document["effects"].as_array().into_iter().flatten().filter_map(|e| e["id"].as_str());
    let ids = ids.collect::<Vec<_>>().join(", ");
    let verdict = text("verdict");
    let accepted = match (verdict.as_str(), ids.as_str()) {
        ("ambiguous", _) => {
            "several explanations are left and none was accepted (--accept chooses one)".to_owned()
        }
        ("unknown-effect", "") => {
            "it accepted no effect: nothing in its catalogue explains what is left".to_owned()
        }
        ("unknown-effect", some) => {
            format!("it accepted {some}, and nothing in its catalogue explains what is left")
        }
        _ => "it accepted none".to_owned(),
    };
    let (place, beside) = (place.display(), beside.display());
    Some(format!(
        "{place}: not there: the verdict of verify is \"{verdict}\" ({beside}); {accepted}. So it wrote no calibration. {}",
        text("reason")
    ))
}

/// A whisker's calibration judged beside a model's card, before the model itself is loaded.
pub struct CheckedCalibration {
    name: String,
    place: PathBuf,
    file: CalibrationFile<CalibrationModel>,
    card: Card,
    /// What speaks against them.
    pub doubts: TrustIssues,
}

impl CheckedCalibration {
    /// Name in the rig.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// With its model.
    pub fn with(self, tracker: &Tracker) -> WhiskerModel<'_> {
        let Self { name, place, file, card, doubts } = self;
        WhiskerModel { name, place, file, tracker, card, doubts }
    }

    /// Reads a calibration and judges it beside the model.
    ///
    /// # Errors
    /// Where the calibration cannot be read, or was changed so that its content means nothing any more.
    pub fn read(name: &str, place: &Path, card: Card) -> Result<Self> {
        if let Some(why) = never_written(place) {
            bail!(why);
        }
        let (file, changed) = read_unsealed(place)?;
        super::refuse_scalar(place, &file)?;
        let mut doubts = TrustIssues::default();
        if let Some(changed) = changed {
            doubts.add("changed", changed);
        }
        for doubt in standing(&file, jiff::Timestamp::now())? {
            let code = if doubt.contains("expired") { "expired" } else { "failed" };
            doubts.add(code, doubt);
        }
        if file.verification == VerificationStatus::Unverified {
            doubts.add("unverified", "the calibration was never verified".to_owned());
        }
        match file.whisker.as_ref().map(|w| w.difference(&card.whisker)) {
            Some(Some(found)) => doubts.add(
                "other-whisker",
                format!("the model was trained for another whisker than the calibration's: {found}"),
            ),
            Some(None) => {}
            None => eprintln!(
                "warning: {}: it does not say of which whisker; the model is taken to fit",
                place.display()
            ),
        }
        Ok(Self { name: name.to_owned(), place: place.to_owned(), file, card, doubts })
    }

    /// Judges the time between readings (s) by those that the network was trained with.
    pub fn check_step(&mut self, step_s: Option<f64>) {
        let [low, high] = trained_steps_s(self.card.training.time_factor);
        if let Some(step_s) = step_s.filter(|s| !(low..=high).contains(s)) {
            self.doubts.add(
                "sample-rate",
                format!("the network was trained with {low:.3} to {high:.3} s between readings, found {step_s:.3} s"),
            );
        }
    }
}
