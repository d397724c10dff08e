//! What the procedure asks of a kind of session: its measurement model, in the words of its
//! catalogue.

use crate::measurement_model::MeasurementModel;
use crate::method::fit::Weights;
use crate::method::hypothesis::Hypothesis;
use crate::method::lack_of_fit::LackOfFit;
use crate::method::noise::Noise;
use crate::method::options::Options;
use crate::method::search_result::SearchResult;
use crate::verify::explained::Explained;
use wcal_core::Sealed;
use wcal_core::observation::Role;
use wcal_core::verify_document::{
    EffectParameter, NamedEffect, NextMeasurement, NoiseFloor, NoisePart, TwinFault,
};

/// A held-out error of `verify.json`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Quantity {
    /// Key, e.g. `wavelength_rmse_pm`.
    pub key: &'static str,
    /// Unit in sentences; empty where the session names it.
    pub unit: &'static str,
}

/// Errors of one held-out reading.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// Group that is resampled whole.
    pub group: u32,
    /// Measured less predicted, one list a [`Quantity`]; the first quantity is the measured one,
    /// channel by channel.
    pub errors: Vec<Vec<f64>>,
    /// Standard deviations that the model states for them, of the same shape; NaN where it states
    /// none.
    pub stated_sd: Vec<Vec<f64>>,
    /// Whether each stated 95 % interval holds its value.
    pub inside95: Vec<bool>,
}

/// Where a reading comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Origin {
    /// File.
    pub source: String,
    /// Line in it, header = 1.
    pub line: usize,
    /// Point number.
    pub point: i64,
    /// Use of the reading.
    pub role: Role,
}

/// How readings are left out in turn where nothing is sealed.
#[derive(Debug, Clone, PartialEq)]
pub struct Folds {
    /// `loto` (trajectories, cycles) or `loo` (stimuli or readings).
    pub split: &'static str,
    /// In words.
    pub words: String,
    /// Fold of each reading; none where it stays in every fit (at rest).
    pub fold: Vec<Option<usize>>,
    /// Steps of a refit without a fold, from the optimum with it.
    pub refit_steps: usize,
}

/// The noise floor and what a reader must know of it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FloorStatement {
    /// Floor.
    pub floor: NoiseFloor,
    /// Added to the verdict's reason.
    pub reason: String,
    /// Added to the notes.
    pub note: Option<String>,
    /// Standard deviation of a typical reading under it, in the sensor's unit.
    pub sd: f64,
    /// Degrees of freedom of the replicates that it comes from, where they are counted.
    pub dof: Option<f64>,
}

/// What a reader of this kind of session calls things: units, names, sentences. No statistics.
pub trait SessionText: MeasurementModel {
    /// Kind as in docs/src/formats.md.
    fn kind(&self) -> &'static str;
    /// Unit of the measured values.
    fn unit(&self) -> String;
    /// A sentence of the catalogue in the words of the session.
    fn format_text(&self, sentence: &str) -> String {
        sentence.to_owned()
    }
    /// Name of a law as a reader of this kind of session has it; calibration.json keeps the
    /// catalogue's.
    fn law_name(&self, name: &str) -> String {
        name.to_owned()
    }
    /// What the verdict's reason must say of the accepted model.
    fn caveat(&self, _accepted: &Hypothesis) -> Option<String> {
        None
    }
    /// A value of the catalogue in the session's unit.
    fn physical(&self, unit: &str, value: f64, _law: usize) -> (f64, String) {
        (value, unit.to_owned())
    }
    /// What takes up a signature of which nothing remains.
    fn nuisances(&self) -> &'static str;
    /// What limits the use of the accepted model although nothing contradicts it: what no reading
    /// tests, what is no measurement.
    fn cautions(&self, _accepted: &Hypothesis) -> Vec<String> {
        Vec::new()
    }
    /// Remarks of this kind of session.
    fn notes(&self, _found: &SearchResult, _accepted: &Hypothesis) -> Vec<String> {
        Vec::new()
    }
}

/// A session as a measurement model: prediction, nuisances and catalogue by [`MeasurementModel`],
/// words by [`SessionText`]; predictions, noise and checks here.
pub trait SessionModel: SessionText + Sized + Send {
    /// A row as it was loaded.
    type Row;
    /// Predictions at every reading.
    type Predictions;
    /// The accepted model as a calibration keeps it.
    type Calibration;

    /// Where a reading comes from.
    fn origin(&self, reading: usize) -> Origin;
    /// Fitted values of an effect with intervals, in the session's units.
    fn parameters(&self, h: &Hypothesis, effect: usize) -> Vec<EffectParameter>;

    /// Why the readings cannot be used at all.
    fn refusal(&self, sealed: &Sealed<Self::Row>) -> Option<String>;
    /// Twin check: faults of an outside twin.
    fn twin_faults(&self) -> Vec<TwinFault> {
        Vec::new()
    }
    /// The instrument as the declared model shows it before anything is searched; `declared` fits
    /// that.
    fn prepared(self, _declared: &dyn Fn(&Self) -> Option<Hypothesis>) -> Option<Self> {
        Some(self)
    }
    /// The instrument as the accepted model shows it: how channels mix, how clocks lie, how good
    /// pictures are, how the spread follows the stimulus. None where that is what it is taken for,
    /// within its uncertainty. `settled`: the noise no longer changes.
    fn renewed(&self, accepted: &Hypothesis, settled: bool, seed: u64) -> Option<Self>;
    /// The same before a law of its noise was estimated; none where there is none.
    fn before_noise(&self) -> Option<Self> {
        None
    }
    /// The same without effects that a witness refutes, by identifier.
    fn without(&self, refuted: &[String]) -> Self;
    /// What is no law of the catalogue and is asked for by repeats alone (a table of errors) in the
    /// place of what was found.
    fn complete(&self, _explained: &mut Explained, _options: &Options) {}
    /// A law of the noise that is an effect of the catalogue.
    fn noise_effect(&self) -> Option<NamedEffect> {
        None
    }
    /// The residual follows from an accepted effect that is not quite of its law.
    fn residual_explained(&self, _found: &SearchResult) -> bool {
        false
    }
    /// A driver of what remains that repeats with the protocol: its columns explain nothing among
    /// readings that are equal in every input.
    fn repeats_with_protocol(&self, _h: &Hypothesis, _columns: &[Vec<f64>]) -> bool {
        false
    }
    /// Lack of fit against the pure error of readings that agree in every setting.
    fn lack_of_fit(&self, _h: &Hypothesis) -> Option<LackOfFit> {
        None
    }
    /// Floor under the accepted model; `left`: something remains, so that only replicates tell.
    fn floor(&self, h: &Hypothesis, noise: &Noise, left: bool) -> FloorStatement;

    /// Next measurement: what would decide between the best explanation and its rivals of another
    /// class.
    fn next_measurement(
        &self,
        best: &Hypothesis,
        rivals: &[&Hypothesis],
    ) -> Option<NextMeasurement>;

    /// The model at every reading of the session, unsealed ones behind.
    ///
    /// # Errors
    /// Where the rows cannot be modelled.
    fn with_holdout(&self, unsealed: &[Self::Row]) -> Result<Self, crate::VerifyError>;
    /// Readings that were sealed.
    fn sealed(&self) -> &[bool];
    /// Sealed readings that count in the held-out error (not at rest in the session's own table).
    fn scored(&self) -> &[bool] {
        self.sealed()
    }
    /// Every reading under an explanation that was fitted on this model's rows or part of them;
    /// `reading_sd`: noise of each.
    fn predict(&self, h: &Hypothesis, reading_sd: &[f64]) -> Option<Self::Predictions>;
    /// Errors that are stated.
    fn quantities(&self) -> &'static [Quantity];
    /// Errors of one reading.
    fn errors(&self, predictions: &Self::Predictions, reading: usize) -> HeldOut;
    /// Folds where nothing is sealed, as the accepted model asks for: what it learned of a place
    /// cannot be left out with all readings there.
    fn folds(&self, accepted: &Hypothesis) -> Folds;
    /// Why a model cannot serve as a calibration at all: no sensitivity, or nothing that its own
    /// rows could be predicted by.
    fn unusable_reason(&self, _accepted: &Hypothesis) -> Option<String> {
        None
    }
    /// Noise under which further readings are predicted, where it is not the one that a verdict
    /// rests on.
    fn prediction_noise(&self, _accepted: &Hypothesis, _seed: u64) -> Option<Noise> {
        None
    }
    /// The calibration of `accepted` under its noise, `base` the declared model and `floor_sd` the
    /// floor of a reading in the sensor's unit.
    fn calibration(
        &self,
        base: &Hypothesis,
        accepted: &Hypothesis,
        noise: &Noise,
        floor_sd: f64,
    ) -> Self::Calibration;
    /// The declared model on the labels of an outside twin, where there are some, fitted with these
    /// weights.
    fn predict_by_labels(&self, _weights: &Weights) -> Option<Self::Predictions> {
        None
    }
    /// Channels of a reading: name, measured value, and what both models predict.
    fn channels(
        &self,
        before: &Self::Predictions,
        after: &Self::Predictions,
        reading: usize,
    ) -> Vec<(String, [f64; 3])>;
    /// How the zero varies from session to session, where several were joined.
    fn seating_repeatability(&self, _accepted: &Hypothesis) -> Option<NoisePart> {
        None
    }
}
