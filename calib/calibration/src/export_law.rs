//! A scalar model as a function of the present reading.

use crate::error::CalibrationError;
use wcal_core::observation::Role;
use wcal_verify::effect::LawRequirement::{self, Clock, Covariate, Order, Time};
use wcal_verify::scalar::{EffectInputs, ScalarModel, ScalarRow};

/// Steps of a fraction that fill a plane evenly (Roberts' R2 sequence).
const FILL: [f64; 2] = [0.754_877_666_2, 0.569_840_290_998];

/// The model over input, temperature (deg C) and direction.
pub(crate) struct Law<'a> {
    model: &'a ScalarModel,
    /// From the response to the stimulus.
    pub(crate) inverse: bool,
}

impl<'a> Law<'a> {
    /// Refuses effects that follow more than the present reading, and a model of one place.
    pub(crate) fn new(
        model: &'a ScalarModel,
        effects: &[EffectInputs],
    ) -> Result<Self, CalibrationError> {
        let inverse = model.session_kind != "axis";
        let law = Self { model, inverse };
        for e in effects {
            let needs = |asked: &[LawRequirement]| e.needs.iter().any(|n| asked.contains(n));
            let follows = if needs(&[Time, Clock, Order]) {
                "the time or the order of the readings"
            } else if needs(&[Covariate]) {
                "a further column"
            } else if e.has_memory && (inverse || law.has_memory()?) {
                "earlier readings"
            } else {
                continue;
            };
            return Err(CalibrationError::NotExported(format!(
                "expected effects of the present reading alone, found {}, which follows {follows}",
                e.id
            )));
        }
        let [low, high] = model.stimulus_range;
        if high > low {
            return Ok(law);
        }
        let why = format!("expected a range of stimuli, found {low} alone");
        Err(CalibrationError::NotExported(why))
    }

    fn rows(&self, inputs: &[[f64; 3]]) -> Vec<ScalarRow> {
        // The inverse searches the whole range: the stimulus that stands here is replaced there.
        let [low, _] = self.model.stimulus_range;
        let row = |&[input, degc, direction]: &[f64; 3]| ScalarRow {
            origin: (String::new(), 0, 0),
            role: Role::Verification,
            x: if self.inverse { low } else { input },
            x_sd: None,
            y: input,
            t_s: None,
            temperature_degc: Some(degc),
            direction: Some(direction),
            cycle: None,
            covariates: vec![0.0; self.model.covariates.len()],
            place: None,
        };
        inputs.iter().map(row).collect()
    }

    /// The model's values and half widths.
    pub(crate) fn values(&self, inputs: &[[f64; 3]]) -> Result<Vec<[f64; 2]>, CalibrationError> {
        let rows = self.rows(inputs);
        let answers = if self.inverse {
            self.model.invert(&rows)
        } else {
            self.model.predict(&rows)
        };
        let answers = answers.map_err(|e| CalibrationError::NotExported(e.to_string()))?;
        Ok(answers.iter().map(|p| [p.value, p.half95]).collect())
    }

    /// Lowest and highest input, and what is valid beyond them: of a transducer the responses at
    /// the ends of the stimulus, and their half widths.
    pub(crate) fn ends(&self, degc: f64, direction: f64) -> Result<[f64; 4], CalibrationError> {
        let [low, high] = self.model.stimulus_range;
        if !self.inverse {
            return Ok([low, high, 1e-9 * (high - low), 1e-9 * (high - low)]);
        }
        let mut rows = self.rows(&[[low, degc, direction]; 2]);
        rows[1].x = high;
        let mut at = self.model.predict(&rows)?;
        at.sort_by(|a, b| a.value.total_cmp(&b.value));
        Ok([at[0].value, at[1].value, at[0].half95, at[1].half95])
    }

    /// Valid inputs that fill the range between these temperatures, directions in turn.
    pub(crate) fn places(
        &self,
        count: usize,
        directions: &[f64],
        [cold, warm]: [f64; 2],
    ) -> Result<Vec<[f64; 3]>, CalibrationError> {
        let place = |k: usize| {
            let [share, rise] = FILL.map(|step| (k as f64 * step).fract());
            let (degc, direction) = (
                cold + rise * (warm - cold),
                directions[k % directions.len()],
            );
            // Beyond the ends, too, as far as readings are valid.
            let [low, high, below, above] = self.ends(degc, direction)?;
            let input = low - below + share * (high - low + below + above);
            Ok([input, degc, direction])
        };
        (1..=count).map(place).collect()
    }

    /// Whether an answer depends on the readings before it: up and down at once, and one by one.
    fn has_memory(&self) -> Result<bool, CalibrationError> {
        let [low, high] = self.model.stimulus_range;
        let place = |k: i32| low + (high - low) * f64::from(8 - (k - 8).abs()) / 8.0;
        let input = |k: i32| [place(k), 0.0, if k < 8 { 1.0 } else { -1.0 }];
        let inputs: Vec<[f64; 3]> = (0..16).map(input).collect();
        for (input, together) in inputs.iter().zip(self.values(&inputs)?) {
            let alone = self.values(&[*input])?[0][0];
            if (alone - together[0]).abs() > 1e-9 * together[1] {
                return Ok(true);
            }
        }
        Ok(false)
    }
}
