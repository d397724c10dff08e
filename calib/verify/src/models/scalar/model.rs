//! The accepted model of a scalar session as it is kept in `calibration.json`, and its predictions
//! at new readings.

use super::effects::scalar_catalogue;
use super::frame::{Declared, Frame, ScalarRow, Scaling};
use super::polynomial::Polynomial;
use super::predictions::{Fitted, predict};
use super::system::{ScalarSystem, relative_sd_at};
use crate::effect::{EffectTerm, LawRequirement};
use crate::measurement_model::MeasurementModel;
use crate::method::hypothesis::Hypothesis;
use crate::method::lack_of_fit::LackOfFit;
use crate::method::noise::spread::SpreadLaw;
use nalgebra::DMatrix;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use wcal_core::observation::Role;

/// An accepted effect with its fitted values (units of the catalogue: half ranges, durations,
/// cycles).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelTerm {
    /// Identifier of docs/src/formats.md.
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
    /// Added to every value inside the model (0 for transducers).
    pub offset: f64,
    /// Spread of the noise, where it is not the same everywhere.
    pub spread: Option<ModelSpread>,
    /// Stimuli that were fitted: the valid region.
    pub stimulus_range: [f64; 2],
    /// The model as a polynomial in the stimulus as measured, where it is one.
    pub polynomial: Option<Polynomial>,
    /// Lack of fit against repetitions, declared and accepted model.
    pub lack_of_fit: [Option<LackOfFit>; 2],
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

impl ModelError {
    /// A field that does not hold what its neighbours ask for.
    pub(crate) fn shape(
        what: impl Into<String>,
        expected: impl ToString,
        found: impl ToString,
    ) -> Self {
        Self::Shape {
            what: what.into(),
            expected: expected.to_string(),
            found: found.to_string(),
        }
    }
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
        let declared = match self.declared {
            Declared::Polynomial(degree) if degree > MAX_DEGREE => {
                return Err(ModelError::shape(
                    "declared.polynomial",
                    format!("a degree of at most {MAX_DEGREE}"),
                    degree,
                ));
            }
            Declared::Polynomial(degree) => degree + 1,
            Declared::Axis => 1,
        };
        let kind = if self.declared == Declared::Axis {
            "axis"
        } else {
            "transducer"
        };
        if self.session_kind != kind {
            return Err(ModelError::shape("session_kind", kind, &self.session_kind));
        }
        if self.declared == Declared::Axis && self.offset == 0.0 {
            return Err(ModelError::shape(
                "offset",
                "a number other than 0",
                self.offset,
            ));
        }
        let [low, high] = self.stimulus_range;
        if low > high {
            return Err(ModelError::shape(
                "stimulus_range",
                "the lower end first",
                format!("{low}, {high}"),
            ));
        }
        if self.variance < 0.0 {
            return Err(ModelError::shape("variance", "0 or more", self.variance));
        }
        let (names, scales) = (self.covariates.len(), self.scaling.covariates.len());
        if names != scales {
            return Err(ModelError::shape("scaling.covariates", names, scales));
        }
        // Laws do not depend on the rows: one row at the middle stands for any.
        let row = ScalarRow {
            origin: (String::new(), 0, 0),
            role: Role::Verification,
            x: self.scaling.mid,
            x_sd: None,
            y: 0.0,
            t_s: None,
            temperature_degc: None,
            direction: None,
            cycle: None,
            covariates: vec![0.0; names],
            place: None,
        };
        let frame = Frame::of_new_rows(vec![row], &self.scaling, self.declared);
        let system = ScalarSystem::new(frame, &self.covariates);
        let terms = self.terms(&system)?;
        let linear = |t: &EffectTerm| system.catalogue()[t.effect].law(t.law).linear.len();
        let columns = declared + terms.iter().map(linear).sum::<usize>();
        if self.coefficients.len() != columns {
            return Err(ModelError::shape(
                "coefficients",
                columns,
                self.coefficients.len(),
            ));
        }
        let slots = columns + terms.iter().map(|t| t.values.len()).sum::<usize>();
        square(&self.covariance, slots, slots)
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
            effects: fitted
                .terms
                .iter()
                .map(|t| {
                    let candidate = &system.catalogue()[t.effect];
                    ModelTerm {
                        id: candidate.id.to_owned(),
                        law: candidate.law(t.law).name.to_owned(),
                        column: candidate
                            .column(t.law, &names.covariates)
                            .map(str::to_owned),
                        values: t.values.clone(),
                    }
                })
                .collect(),
            coefficients: fitted.coefficients.clone(),
            covariance: fitted
                .covariance
                .row_iter()
                .map(|r| r.iter().copied().collect())
                .collect(),
            variance: (fitted.variance * (1.0 + shared)).max(step * step / 12.0),
            dof: fitted.dof,
            offset: system.offset,
            spread: system.spread.as_ref().map(|s| {
                let z = s.law.scale(frame);
                let centre = z.iter().sum::<f64>() / z.len() as f64;
                ModelSpread {
                    law: s.law,
                    exponent: s.exponent,
                    centre,
                }
            }),
            stimulus_range: [s.mid - half, s.mid + half],
            polynomial,
            lack_of_fit,
        }
    }

    /// Terms by the catalogue of `system`.
    fn terms(&self, system: &ScalarSystem) -> Result<Vec<EffectTerm>, ModelError> {
        self.effects
            .iter()
            .map(|t| {
                let unknown = || ModelError::UnknownEffect {
                    effect: t.id.clone(),
                    law: t.law.clone(),
                };
                let effect = system
                    .catalogue()
                    .iter()
                    .position(|c| c.id == t.id)
                    .ok_or_else(unknown)?;
                let (mut law, form) = system.catalogue()[effect]
                    .law_named(&t.law)
                    .ok_or_else(unknown)?;
                // Laws of one name follow a column each.
                if let Some(column) = &t.column {
                    let of = |l: &usize| {
                        system.catalogue()[effect].column(*l, &self.covariates)
                            == Some(column.as_str())
                    };
                    law = (0..self.covariates.len()).find(of).ok_or_else(unknown)?;
                }
                if form.parameters.len() != t.values.len() {
                    let what = format!("values of {} ({})", t.id, t.law);
                    return Err(ModelError::shape(
                        what,
                        form.parameters.len(),
                        t.values.len(),
                    ));
                }
                Ok(EffectTerm {
                    effect,
                    law,
                    values: t.values.clone(),
                })
            })
            .collect()
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

    /// Predicts at `rows` (their `y` is not used), in their order. Memory effects run over the rows
    /// in the order of their times.
    ///
    /// # Errors
    /// Where the rows lack a column that an accepted effect needs, or the model's parts do not
    /// belong together.
    pub fn predict(&self, rows: &[ScalarRow]) -> Result<Vec<ScalarPrediction>, ModelError> {
        // Each row finds its way back by its place here, whatever its line in the file.
        let numbered: Vec<ScalarRow> = rows
            .iter()
            .enumerate()
            .map(|(k, r)| {
                let mut row = r.clone();
                row.origin.1 = k;
                row
            })
            .collect();
        let frame = Frame::of_new_rows(numbered, &self.scaling, self.declared);
        let system = ScalarSystem::new(frame, &self.covariates).with_offset(self.offset);
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
        let slots = self.coefficients.len() + terms.iter().map(|t| t.values.len()).sum::<usize>();
        square(&self.covariance, slots, slots)?;
        let fitted = Fitted {
            terms,
            coefficients: self.coefficients.clone(),
            covariance: DMatrix::from_fn(slots, slots, |i, j| self.covariance[i][j]),
            variance: self.variance,
            dof: self.dof,
        };
        let relative = match &self.spread {
            Some(s) => relative_sd_at(&system.frame, s.law, s.exponent, s.centre),
            None => vec![1.0; rows.len()],
        };
        let no_design = || {
            ModelError::shape(
                "coefficients",
                "a design of as many columns",
                "none at these rows",
            )
        };
        let noise_sd: Vec<f64> = relative.iter().map(|r| self.variance.sqrt() * r).collect();
        let (values, half) = predict(&system, &fitted, &noise_sd).ok_or_else(no_design)?;
        let [low, high] = self.stimulus_range;
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
                half95: half[i],
                valid: row.x >= low - slack && row.x <= high + slack,
            };
        }
        Ok(out)
    }

    /// Stimuli at which `rows` would have read their `y`, with half widths of 95 % intervals; for
    /// models in which every reading stands alone and the response rises or falls throughout.
    /// Readings beyond the fitted responses are marked invalid, at the range's end.
    ///
    /// # Errors
    /// As [`Self::predict`], and where the response does not determine the stimulus.
    pub fn invert(&self, rows: &[ScalarRow]) -> Result<Vec<ScalarPrediction>, ModelError> {
        let no = |why: &str| ModelError::Column {
            effect: "the inverse".into(),
            needs: why.to_owned(),
        };
        let catalogue = scalar_catalogue(
            &Frame::of_new_rows(Vec::new(), &self.scaling, self.declared),
            self.covariates.len(),
        );
        let remembers = |t: &&ModelTerm| {
            catalogue
                .iter()
                .any(|e| e.effect.id == t.id && e.effect.has_memory)
        };
        if let Some(t) = self.effects.iter().find(remembers) {
            return Err(no(&format!(
                "a model without memory (it carries {}); give the stimulus",
                t.id
            )));
        }
        let at = |x: &[f64]| -> Result<Vec<ScalarPrediction>, ModelError> {
            let moved: Vec<ScalarRow> = rows
                .iter()
                .zip(x)
                .map(|(r, x)| ScalarRow { x: *x, ..r.clone() })
                .collect();
            self.predict(&moved)
        };
        let [low, high] = self.stimulus_range;
        let places: Vec<f64> = (0..=PLACES)
            .map(|k| low + (high - low) * k as f64 / PLACES as f64)
            .collect();
        let mut curves = Vec::new();
        for p in &places {
            curves.push(at(&vec![*p; rows.len()])?);
        }
        let rising = |i: usize| curves.windows(2).all(|c| c[1][i].value > c[0][i].value);
        let falling = |i: usize| curves.windows(2).all(|c| c[1][i].value < c[0][i].value);
        if (0..rows.len()).any(|i| !rising(i) && !falling(i)) {
            return Err(no(
                "a response that rises or falls throughout; give the stimulus",
            ));
        }
        let sign: Vec<f64> = (0..rows.len())
            .map(|i| if rising(i) { 1.0 } else { -1.0 })
            .collect();
        let (mut a, mut b) = (vec![low; rows.len()], vec![high; rows.len()]);
        for _ in 0..60 {
            let middle: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
            for (i, p) in at(&middle)?.iter().enumerate() {
                if sign[i] * (rows[i].y - p.value) > 0.0 {
                    a[i] = middle[i]
                } else {
                    b[i] = middle[i]
                }
            }
        }
        let ends = [&curves[0], &curves[PLACES]];
        let x: Vec<f64> = a.iter().zip(&b).map(|(a, b)| 0.5 * (a + b)).collect();
        let here = at(&x)?;
        // Slope over a hundredth of the range turns the response's interval into the stimulus's.
        let step = 0.005 * (high - low);
        let [up, down] = [1.0, -1.0].map(|s| x.iter().map(|x| x + s * step).collect::<Vec<f64>>());
        let (up, down) = (at(&up)?, at(&down)?);
        Ok((0..rows.len())
            .map(|i| {
                let slope = (up[i].value - down[i].value) / (2.0 * step);
                let inside = |k: usize, s: f64| {
                    s * sign[i] * (rows[i].y - ends[k][i].value) >= -here[i].half95
                };
                ScalarPrediction {
                    value: x[i],
                    half95: here[i].half95 / slope.abs(),
                    valid: inside(0, 1.0) && inside(1, -1.0),
                }
            })
            .collect())
    }
}

/// Refuses a covariance that is not square with a size from `least` to `most`.
pub(crate) fn square(covariance: &[Vec<f64>], least: usize, most: usize) -> Result<(), ModelError> {
    let size = covariance.len();
    let expected = || {
        let range = if least == most {
            format!("{least}")
        } else {
            format!("{least} to {most}")
        };
        format!("{range} rows of as many numbers")
    };
    if !(least..=most).contains(&size) {
        return Err(ModelError::shape(
            "covariance",
            expected(),
            format!("{size} rows"),
        ));
    }
    match covariance.iter().position(|row| row.len() != size) {
        Some(k) => {
            let found = format!("{} numbers in row {}", covariance[k].len(), k + 1);
            Err(ModelError::shape("covariance", expected(), found))
        }
        None => Ok(()),
    }
}

/// Places at which the inverse checks that the response goes one way.
const PLACES: usize = 64;

impl SpreadLaw {
    /// The scale on which the logarithm of the spread is a straight line.
    pub fn scale(self, frame: &Frame) -> Vec<f64> {
        match self {
            Self::Power => frame.rows.iter().map(|r| r.x.max(1e-300).ln()).collect(),
            Self::Exponential => frame.u.clone(),
        }
    }
}
