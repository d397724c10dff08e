//! The accepted model of a scalar session as it is kept in `calibration.json`, and its predictions
//! at new readings.

use super::effects::{ERROR_TABLE, left_out_rms, share_of_gap};
use super::frame::{Declared, Frame, ScalarRow, Scaling};
use super::polynomial::Polynomial;
use super::predictions::{Fitted, predict};
use super::row::all;
use super::system::{ScalarSystem, relative_sd_at};
use crate::effect::LawRequirement;
use crate::method::{Hypothesis, LackOfFit, SpreadLaw, t95};
use crate::models::{range, rows};
use crate::{Effect, EffectTerm, MeasurementModel};
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ops::Range;

/// An accepted effect with its fitted values (units of the catalogue: half ranges, durations,
/// cycles).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelTerm {
    /// Identifier of docs/src/method.md.
    pub id: String,
    /// Law.
    pub law: String,
    /// Further column that it follows; none: the first one, or a law that follows none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub column: Option<String>,
    /// Nonlinear values of the law.
    pub values: Vec<f64>,
}

/// How the spread of the noise follows the stimulus.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelSpread {
    /// Law.
    pub law: SpreadLaw,
    /// Exponent.
    pub exponent: f64,
    /// Where the relative spread is one, on the law's own scale.
    pub centre: f64,
}

/// Everything that predictions at new readings need.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScalarModel {
    /// `transducer` or `axis`.
    #[schemars(extend("enum" = ["transducer", "axis"]))]
    pub session_kind: String,
    /// Unit of the stimulus.
    pub stimulus_unit: String,
    /// Unit of the response (um for an axis: measured less commanded).
    pub response_unit: String,
    /// Names of further covariates.
    pub covariates: Vec<String>,
    /// Columns of the table that the session was imported from, by their names in the session;
    /// `COLUMN*FACTOR` where a factor applies.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub columns: BTreeMap<String, String>,
    /// Declared model: `{"polynomial": degree}` or `"axis"`.
    pub declared: Declared,
    /// Normalisation of the covariates.
    pub scaling: Scaling,
    /// Accepted effects.
    pub effects: Vec<ModelTerm>,
    /// Free coefficients on the normalised covariates: declared model, then effects.
    pub coefficients: Vec<f64>,
    /// Joint covariance of coefficients and nonlinear values, row by row.
    pub covariance: Vec<Vec<f64>>,
    /// Variance of the noise.
    pub variance: f64,
    /// Residual degrees of freedom.
    pub dof: f64,
    /// Standard uncertainty of the reference, in the unit of the stimulus; 0: not stated.
    #[serde(default, skip_serializing_if = "is_unstated")]
    pub reference_sd: f64,
    /// Added to every value inside the model (0 for transducers).
    pub offset: f64,
    /// Spread of the noise, where it is not the same everywhere.
    pub spread: Option<ModelSpread>,
    /// Stimuli that were fitted: the valid region.
    pub stimulus_range: [f64; 2],
    /// Temperatures that were fitted, deg C, where they vary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_range: Option<[f64; 2]>,
    /// The model as a polynomial in the stimulus as measured, where it is one.
    pub polynomial: Option<Polynomial>,
    /// Lack of fit against repetitions, declared and accepted model.
    pub lack_of_fit: [Option<LackOfFit>; 2],
}

// Serde hands a reference.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_unstated(sd: &f64) -> bool {
    *sd == 0.0
}

/// What an accepted effect takes of a new reading beside its stimulus or response.
#[derive(Debug, Clone, PartialEq)]
pub struct EffectInputs {
    /// Identifier of the effect.
    pub id: String,
    /// Some of its laws follow earlier readings.
    pub has_memory: bool,
    /// What its law needs.
    pub needs: Vec<LawRequirement>,
}

/// Prediction at one new reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ScalarPrediction {
    /// Response, or position error in um.
    pub value: f64,
    /// Half width of its 95 % interval, the noise of one reading included.
    pub half95: f64,
    /// The stimulus lies in the fitted range.
    pub valid: bool,
}

/// Why a model cannot predict.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
pub enum ModelError {
    /// The file names an effect or law that this program does not have.
    #[error(
        "using the calibration: expected an effect and a law of this version's catalogue, found effect {effect:?} with law {law:?}"
    )]
    UnknownEffect {
        /// Effect.
        effect: String,
        /// Law.
        law: String,
    },
    /// Numbers of the file do not belong together.
    #[error("using the calibration: `{what}`: expected {expected}, found {found}")]
    Shape {
        /// Field.
        what: String,
        /// Wanted.
        expected: String,
        /// There.
        found: String,
    },
    /// A column that an accepted effect needs.
    #[error("predicting with {effect}: expected {needs}, found none")]
    Column {
        /// Effect.
        effect: String,
        /// What is missing.
        needs: String,
    },
}

/// A term of a calibration by its names and values.
///
/// # Errors
/// What this version's catalogue does not have, or has with other values.
pub(crate) fn term_named<'a>(
    catalogue: impl IntoIterator<Item = &'a Effect>,
    id: &str,
    law: &str,
    values: &[f64],
) -> Result<EffectTerm, ModelError> {
    let mut all = catalogue.into_iter().enumerate();
    let found = all.find(|(_, e)| e.id == id);
    let found = found.and_then(|(effect, e)| Some((effect, e.law_named(law)?)));
    let (effect, (index, form)) = found.ok_or_else(|| ModelError::UnknownEffect {
        effect: id.to_owned(),
        law: law.to_owned(),
    })?;
    let (parameters, count) = (form.parameters.len(), values.len());
    let what = format!("values of {id} ({law})");
    require(parameters == count, what, parameters, count)?;
    Ok(EffectTerm {
        effect,
        law: index,
        values: values.to_vec(),
    })
}

/// A field must hold what its neighbours ask for.
pub(crate) fn require(
    holds: bool,
    what: impl ToString,
    expected: impl ToString,
    found: impl ToString,
) -> Result<(), ModelError> {
    let shape = || ModelError::Shape {
        what: what.to_string(),
        expected: expected.to_string(),
        found: found.to_string(),
    };
    holds.then_some(()).ok_or_else(shape)
}

/// What an effect that follows the order of the fitted readings lacks in any other rows.
const ONLY_THAT_SESSION: &str =
    "an effect that depends on more than the order of that session's readings";

/// Largest degree of a declared model (constant, linear, quadratic).
const MAX_DEGREE: usize = 2;

impl ScalarModel {
    /// Checks that the parts belong together and every effect is of this version's catalogue,
    /// before anything is computed with them.
    ///
    /// # Errors
    /// [`ModelError::UnknownEffect`] or [`ModelError::Shape`], by name.
    pub fn check(&self) -> Result<(), ModelError> {
        let (degree, kind) = match self.declared {
            Declared::Polynomial(degree) => (degree, "transducer"),
            Declared::Axis => (0, "axis"),
        };
        let most = format!("a degree of at most {MAX_DEGREE}");
        require(degree <= MAX_DEGREE, "declared.polynomial", most, degree)?;
        let stated = &self.session_kind;
        require(stated == kind, "session_kind", kind, stated)?;
        // The design of an axis divides by the far offset.
        let seen_from_afar = self.declared != Declared::Axis || self.offset != 0.0;
        let expected = "a number other than 0";
        require(seen_from_afar, "offset", expected, self.offset)?;
        let [low, high] = self.stimulus_range;
        let (expected, found) = ("the lower end first", format!("{low}, {high}"));
        require(!(low > high), "stimulus_range", expected, found)?;
        if let Some([low, high]) = self.temperature_range {
            let found = format!("{low}, {high}");
            require(low < high, "temperature_range", expected, found)?;
        }
        let variance = self.variance;
        require(!(variance < 0.0), "variance", "0 or more", variance)?;
        let reference = self.reference_sd;
        require(reference >= 0.0, "reference_sd", "0 or more", reference)?;
        let (names, scales) = (self.covariates.len(), self.scaling.covariates.len());
        require(names == scales, "scaling.covariates", names, scales)?;
        // Laws do not depend on the rows.
        let system = self.system(Vec::new());
        let terms = self.terms(&system)?;
        let linear = |t: &EffectTerm| system.catalogue()[t.effect].law(t.law).linear.len();
        let columns = degree + 1 + terms.iter().map(linear).sum::<usize>();
        let count = self.coefficients.len();
        require(count == columns, "coefficients", columns, count)?;
        let slots = columns + terms.iter().map(|t| t.values.len()).sum::<usize>();
        square(&self.covariance, slots, slots)
    }

    /// New rows as the model sees them.
    pub(super) fn system(&self, rows: Vec<ScalarRow>) -> ScalarSystem {
        let frame = Frame::new(rows, &self.scaling, self.declared, true);
        ScalarSystem::new(frame, &self.covariates).with_offset(self.offset)
    }

    /// The model of an accepted explanation; `polynomial` and lack of fit are carried for the
    /// reader.
    pub fn of(
        system: &ScalarSystem,
        accepted: &Hypothesis,
        shared: f64,
        polynomial: Option<Polynomial>,
        lack_of_fit: [Option<LackOfFit>; 2],
    ) -> Self {
        let fitted = Fitted::of(&accepted.fit);
        let (frame, names) = (&system.frame, &system.names);
        let axis = frame.declared == Declared::Axis;
        let (s, half) = (&frame.scaling, frame.scaling.half.max(0.0));
        let term = |t: &EffectTerm| {
            let effect = &system.catalogue()[t.effect];
            let column = effect.column(t.law, &names.covariates);
            ModelTerm {
                id: effect.id.to_owned(),
                law: effect.law(t.law).name.to_owned(),
                column: column.map(str::to_owned),
                values: t.values.clone(),
            }
        };
        // Settings that lie on the digits of a coarse read-out hide what it rounds by: a further
        // reading anywhere between them does not.
        let step = system.step();
        Self {
            session_kind: if axis { "axis" } else { "transducer" }.to_owned(),
            stimulus_unit: names.stimulus.clone(),
            response_unit: names.response.clone(),
            covariates: names.covariates.clone(),
            columns: BTreeMap::new(),
            declared: frame.declared,
            scaling: s.clone(),
            effects: fitted.terms.iter().map(term).collect(),
            covariance: rows(&fitted.covariance),
            coefficients: fitted.coefficients,
            // A uniform error within a step has the variance step^2 / 12.
            variance: (fitted.variance * (1.0 + shared)).max(step * step / 12.0),
            dof: fitted.dof,
            reference_sd: names.reference_sd,
            offset: system.offset,
            spread: system.spread.as_ref().map(|s| ModelSpread {
                law: s.law,
                exponent: s.exponent,
                centre: s.law.centre(frame),
            }),
            stimulus_range: [s.mid - half, s.mid + half],
            temperature_range: s.temperature.and_then(|_| {
                let fitted = all(&frame.rows, |r| r.temperature_degc)?;
                Some(range(fitted.into_iter())).filter(|[low, high]| low < high)
            }),
            polynomial,
            lack_of_fit,
        }
    }

    /// What was fitted, with its terms.
    pub(super) fn fitted(&self, terms: Vec<EffectTerm>) -> Result<Fitted, ModelError> {
        let slots = self.coefficients.len() + terms.iter().map(|t| t.values.len()).sum::<usize>();
        square(&self.covariance, slots, slots)?;
        Ok(Fitted {
            terms,
            coefficients: self.coefficients.clone(),
            covariance: DMatrix::from_fn(slots, slots, |i, j| self.covariance[i][j]),
            variance: self.variance,
            dof: self.dof,
        })
    }

    /// Terms by the catalogue of `system`.
    pub(super) fn terms(&self, system: &ScalarSystem) -> Result<Vec<EffectTerm>, ModelError> {
        let of = |t: &ModelTerm| {
            let mut term = term_named(system.catalogue(), &t.id, &t.law, &t.values)?;
            // Laws of one name follow a column each.
            if let Some(column) = &t.column {
                let effect = &system.catalogue()[term.effect];
                let is_own =
                    |l: &usize| effect.column(*l, &self.covariates) == Some(column.as_str());
                let own = (0..self.covariates.len()).find(is_own);
                term.law = own.ok_or_else(|| ModelError::UnknownEffect {
                    effect: t.id.clone(),
                    law: t.law.clone(),
                })?;
            }
            Ok(term)
        };
        self.effects.iter().map(of).collect()
    }

    /// What the accepted effects take of new readings, effect by effect.
    ///
    /// # Errors
    /// [`ModelError::UnknownEffect`].
    pub fn inputs(&self) -> Result<Vec<EffectInputs>, ModelError> {
        let system = self.system(Vec::new());
        let of = |t: EffectTerm| {
            let effect = &system.catalogue()[t.effect];
            EffectInputs {
                id: effect.id.to_owned(),
                has_memory: effect.has_memory,
                needs: effect.law(t.law).needs.clone(),
            }
        };
        Ok(self.terms(&system)?.into_iter().map(of).collect())
    }

    /// What an effect's law needs of new rows, where they lack it.
    fn missing(&self, needs: &[LawRequirement], frame: &Frame) -> Option<&'static str> {
        let lacks = |need: &LawRequirement| match need {
            LawRequirement::Order => Some(ONLY_THAT_SESSION),
            LawRequirement::Time | LawRequirement::Clock if self.scaling.time.is_none() => {
                Some(ONLY_THAT_SESSION)
            }
            LawRequirement::Time | LawRequirement::Clock => {
                frame.time.is_none().then_some("t_s in every row")
            }
            LawRequirement::Temperature => frame
                .temperature
                .is_none()
                .then_some("temperature_degc in every row"),
            LawRequirement::BothDirections => frame
                .direction
                .is_none()
                .then_some("direction, t_s or the cycles of a to-and-fro table in every row"),
            _ => None,
        };
        needs.iter().find_map(lacks)
    }

    /// Noise of one reading at each row of a frame, standard deviation in the response's unit.
    pub(super) fn noise_sd(&self, frame: &Frame) -> Vec<f64> {
        let relative = match &self.spread {
            Some(s) => relative_sd_at(frame, s.law, s.exponent, s.centre),
            None => vec![1.0; frame.rows.len()],
        };
        relative.iter().map(|r| self.variance.sqrt() * r).collect()
    }

    /// Half width of a 95 % interval of what lies between the places of a table of errors, at a
    /// position; 0 without one.
    fn gap_half(&self, fitted: &Fitted) -> impl Fn(f64) -> f64 {
        let places = self.scaling.places.clone();
        let table = self.effects.iter().position(|t| t.id == ERROR_TABLE);
        // The first place's deviation is the declared constant's.
        let slots = self.slots(&fitted.terms);
        let deviations = table.map(|at| {
            let rest = fitted.coefficients[slots[at][0].clone()].iter();
            let rest = rest.take(places.len().saturating_sub(1));
            [0.0].into_iter().chain(rest.copied()).collect::<Vec<f64>>()
        });
        let rms = deviations.and_then(|d| left_out_rms(&places, &d));
        // As many inner places estimate it.
        let t = t95(places.len().saturating_sub(2) as f64);
        move |x| rms.map_or(0.0, |rms| t * rms * share_of_gap(&places, x))
    }

    /// Where each term stands: its columns among the coefficients, its values behind all of them.
    pub(super) fn slots(&self, terms: &[EffectTerm]) -> Vec<[Range<usize>; 2]> {
        let system = self.system(Vec::new());
        let own = |t: &EffectTerm| system.catalogue()[t.effect].law(t.law).linear.len();
        let count = self.coefficients.len();
        // Columns of the declared model come first.
        let (mut column, mut value) = (count - terms.iter().map(own).sum::<usize>(), count);
        let of = |t: &EffectTerm| {
            let slots = [column..column + own(t), value..value + t.values.len()];
            (column, value) = (slots[0].end, slots[1].end);
            slots
        };
        terms.iter().map(of).collect()
    }

    /// Whether positions lie between the places of a table of errors.
    pub fn has_gaps_at(&self, rows: &[ScalarRow]) -> bool {
        let is_table = self.effects.iter().any(|t| t.id == ERROR_TABLE);
        let places = &self.scaling.places;
        is_table && rows.iter().any(|r| share_of_gap(places, r.x) > 1e-6)
    }

    /// Predicts at `rows` (their `y` is not used), in their order. Memory effects run over the rows
    /// in the order of their times.
    ///
    /// # Errors
    /// Where the rows lack a column that an accepted effect needs, or the model's parts do not
    /// belong together.
    pub fn predict(&self, rows: &[ScalarRow]) -> Result<Vec<ScalarPrediction>, ModelError> {
        // Each row finds its way back by its place here, whatever its line in the file.
        let mut numbered = rows.to_vec();
        (0..rows.len()).for_each(|k| numbered[k].origin.1 = k);
        let system = self.system(numbered);
        let terms = self.terms(&system)?;
        for t in &terms {
            let effect = &system.catalogue()[t.effect];
            if let Some(needs) = self.missing(&effect.law(t.law).needs, &system.frame) {
                return Err(ModelError::Column {
                    effect: effect.id.to_owned(),
                    needs: needs.to_owned(),
                });
            }
        }
        let fitted = self.fitted(terms)?;
        let no_design = || ModelError::Shape {
            what: "coefficients".to_owned(),
            expected: "a design of as many columns".to_owned(),
            found: "none at these rows".to_owned(),
        };
        let noise_sd = self.noise_sd(&system.frame);
        let gap_half = self.gap_half(&fitted);
        let (values, half) = predict(&system, &fitted, &noise_sd).ok_or_else(no_design)?;
        let [low, high] = self.stimulus_range;
        // Ends of the range that were rounded in the file still belong to it.
        let slack = 1e-9 * (high - low);
        let mut out = vec![
            ScalarPrediction {
                value: f64::NAN,
                half95: f64::NAN,
                valid: false
            };
            rows.len()
        ];
        for (i, row) in system.frame.rows.iter().enumerate() {
            out[row.origin.1] = ScalarPrediction {
                value: values[i] - self.offset,
                half95: half[i].hypot(gap_half(row.x)),
                valid: row.x >= low - slack && row.x <= high + slack,
            };
        }
        Ok(out)
    }
}

/// Refuses a covariance that is not square with a size from `least` to `most`.
pub(crate) fn square(covariance: &[Vec<f64>], least: usize, most: usize) -> Result<(), ModelError> {
    let size = covariance.len();
    let range = if least == most {
        format!("{least}")
    } else {
        format!("{least} to {most}")
    };
    let expected = format!("{range} rows of as many numbers");
    let found = format!("{size} rows");
    require(
        (least..=most).contains(&size),
        "covariance",
        &expected,
        found,
    )?;
    covariance.iter().enumerate().try_for_each(|(k, row)| {
        let found = format!("{} numbers in row {}", row.len(), k + 1);
        require(row.len() == size, "covariance", &expected, found)
    })
}

impl SpreadLaw {
    /// The scale on which the logarithm of the spread is a straight line.
    pub fn scale(self, frame: &Frame) -> Vec<f64> {
        match self {
            // sd ~ x^k: ln sd is straight over ln x; exponential: over x.
            Self::Power => frame.rows.iter().map(|r| r.x.max(1e-300).ln()).collect(),
            Self::Exponential => frame.u.clone(),
        }
    }

    /// Its mean over the rows of a frame: where the relative spread is one.
    pub(super) fn centre(self, frame: &Frame) -> f64 {
        let scale = self.scale(frame);
        scale.iter().sum::<f64>() / scale.len() as f64
    }
}
