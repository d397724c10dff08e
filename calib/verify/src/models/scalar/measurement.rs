//! A transducer or axis session as a measurement model of the procedure.

use super::admission;
use super::bends::compete;
use super::effects::{ERROR_TABLE, HETEROSCEDASTIC_NOISE, ZERO_BY_SERIES};
use super::floor::{noise_floor, repeat_keys};
use super::frame::Declared;
use super::model::ScalarModel;
use super::parameters::{self, of_effect, zero_scatter};
use super::polynomial::{Polynomial, polynomial};
use super::predictions::{Fitted, Grouping, folds, follows_neighbours, predict};
use super::spread_trend::with_spread_of;
use super::stationarity::{UNSTEADY, stationarity};
use super::system::{SWEPT_ONCE, ScalarSystem};
use super::table::{deviations, prefer_error_table};
use super::usable::{domain_error, non_invertible_reason, untested};
use super::{ScalarRow, next};
use crate::levels::CATALOGUE;
use crate::method::{
    Hypothesis, LackOfFit, Noise, Options, SearchResult, SpreadLaw, is_rounding, split, t95,
};
use crate::verify::{
    Explained, FloorStatement, Folds, HeldOut, Origin, Quantity, SessionModel, SessionText,
};
use crate::{EffectTerm, MeasurementModel, VerifyError};
use nalgebra::DVector;
use wcal_core::Sealed;
use wcal_core::order_statistics::median;
use wcal_core::verify_document::{EffectParameter, NamedEffect, NextMeasurement, NoiseFloor};

/// Predictions at every row, in the system's own values, with half widths of 95 % intervals and how
/// many standard deviations those are.
#[derive(Debug, Clone, PartialEq)]
pub struct ScalarPredictions {
    value: DVector<f64>,
    half95: Vec<f64>,
    quantile: f64,
}

/// Covariates over which a period can run.
const PERIOD_RUNS_OVER: [&str; 4] = ["stimulus", "commanded_mm", "t_s", "order"];

impl ScalarSystem {
    fn axis(&self) -> bool {
        self.frame.declared == Declared::Axis
    }

    /// An explanation that holds the effect `id`.
    fn has(&self, h: &Hypothesis, id: &str) -> bool {
        let mut terms = h.fit.terms.iter();
        terms.any(|t| self.catalogue()[t.effect].id == id)
    }

    /// The declared model as a polynomial in the stimulus (none for an axis), and the accepted one
    /// where it is one of higher degree.
    pub(super) fn polynomials(
        &self,
        base: &Hypothesis,
        accepted: &Hypothesis,
    ) -> [Option<Polynomial>; 2] {
        let (x, y): (Vec<f64>, Vec<f64>) = self.frame.rows.iter().map(|r| (r.x, r.y)).unzip();
        let of = |h: &Hypothesis, degree: usize| polynomial(&x, &y, h.weights.relative(), degree);
        let Declared::Polynomial(declared) = self.frame.declared else {
            return [None, None];
        };
        let richer = self
            .degree(declared, accepted)
            .and_then(|d| of(accepted, d));
        [of(base, declared), richer]
    }

    /// Degree of the polynomial that the accepted effects make of the declared one.
    fn degree(&self, declared: usize, accepted: &Hypothesis) -> Option<usize> {
        let degree = |t: &EffectTerm| self.effects[t.effect].degree;
        let powers = accepted.fit.terms.iter().map(degree);
        let mut powers: Vec<usize> = powers.collect::<Option<_>>()?;
        powers.sort_unstable();
        let degree = declared + powers.len();
        // A polynomial has every power up to its degree: a cube without a square is none.
        let whole = powers.iter().copied().eq(declared + 1..=degree);
        (whole && degree > declared).then_some(degree)
    }

    /// Splits what a fit leaves by its replicates.
    pub(crate) fn pure_error(&self, h: &Hypothesis) -> Option<LackOfFit> {
        let lack = LackOfFit::of(split(
            &h.fit,
            &h.weights,
            &repeat_keys(&self.frame),
            &self.frame.read_u,
        ))?;
        // Repeats of a coarse read-out agree; that says nothing of how well a model does.
        let rounded = lack.is_significant() && is_rounding(self, &h.fit, &h.weights);
        Some(LackOfFit {
            p_value: lack.p_value.filter(|_| !rounded),
            ..lack
        })
    }
}

impl SessionText for ScalarSystem {
    fn kind(&self) -> &'static str {
        if self.axis() { "axis" } else { "transducer" }
    }

    fn unit(&self) -> String {
        self.names.response.clone()
    }

    fn format_text(&self, sentence: &str) -> String {
        self.frame.declared.format_text(sentence)
    }

    fn law_name(&self, name: &str) -> String {
        if self.axis() {
            name.replace("stimulus", "position")
        } else {
            name.to_owned()
        }
    }

    fn caveat(&self, accepted: &Hypothesis) -> Option<String> {
        if self.has(accepted, ZERO_BY_SERIES) && self.frame.scaling.series.len() == 2 {
            return Some(
                "The zero of a further series is known from two alone: intervals of predictions hold it, 13 times as wide as from many.".to_owned(),
            );
        }
        let s = stationarity(self, accepted).filter(|s| s.z > UNSTEADY)?;
        Some(format!(
            "The frequency is not steady: {:.3} +- {:.3} cycles over the range by the first half, {:.3} +- {:.3} by the second.",
            s.cycles[0], s.standard_errors[0], s.cycles[1], s.standard_errors[1]
        ))
    }

    fn physical(&self, unit: &str, value: f64, law: usize) -> (f64, String) {
        parameters::physical(unit, value, law, &self.frame, &self.names)
    }

    fn nuisances(&self) -> &'static str {
        "the declared model"
    }

    fn cautions(&self, accepted: &Hypothesis) -> Vec<String> {
        let limits = self.limits.iter().map(|l| l.sentence(&self.names.response));
        limits.chain(untested(self, accepted)).collect()
    }

    fn notes(&self, _found: &SearchResult, accepted: &Hypothesis) -> Vec<String> {
        let (used, total) = (self.frame.rows.len(), self.points.len());
        let mut notes = Vec::new();
        if used < total {
            notes.push(format!(
                "The search used {used} of {total} readings, chosen evenly by stimulus, direction and cycle; all are predicted, and places \
                 and periods are in rows of the table."
            ));
        }
        if let (Some(ways), true) = (
            &self.frame.direction,
            self.frame.rows.iter().all(|r| r.direction.is_none()),
        ) {
            let falling = ways.iter().filter(|way| **way < 0.0).count();
            notes.push(self.format_text(&format!(
                "The direction follows from the order of the readings: {} rising, {falling} falling stimuli.",
                ways.len() - falling
            )));
        }
        if !self.noise_inputs().averaged.is_empty() {
            notes.push("Readings are weighed by the stated uncertainties of their stimuli (stimulus_sd), beside a part of the noise that is alike for all.".to_owned());
        }
        if self.frame.swept_once() && !accepted.fit.terms.is_empty() {
            notes.push(self.format_text(&format!("Nothing is said of the time: {SWEPT_ONCE}.")));
        }
        if self.spread.is_some() {
            notes.push(
                "Readings were weighted by the spread found; held-out errors are not weighted."
                    .to_owned(),
            );
        }
        notes.extend(self.caveat(accepted));
        notes
    }
}

impl SessionModel for ScalarSystem {
    type Row = ScalarRow;
    type Predictions = ScalarPredictions;
    type Calibration = ScalarModel;

    fn origin(&self, reading: usize) -> Origin {
        let row = &self.frame.rows[reading];
        let (source, line, point) = row.origin.clone();
        Origin {
            source,
            line,
            point,
            role: row.role,
        }
    }

    fn parameters(&self, h: &Hypothesis, effect: usize) -> Vec<EffectParameter> {
        if self.catalogue()[effect].id == ERROR_TABLE {
            return deviations(self, &h.fit);
        }
        of_effect(self, h, effect, &self.names)
    }

    fn refusal(&self, sealed: &Sealed<ScalarRow>) -> Option<String> {
        let why = admission::refusal(
            &self.points,
            sealed,
            &self.frame.scaling,
            self.frame.declared,
        )?;
        Some(format!("The data cannot be used: {why}."))
    }

    /// What neighbours share can look like a law of the spread: that is asked last.
    fn renewed(&self, accepted: &Hypothesis, settled: bool, seed: u64) -> Option<Self> {
        settled
            .then(|| with_spread_of(self, accepted, seed))
            .flatten()
    }

    fn without(&self, _refuted: &[String]) -> Self {
        self.clone()
    }

    fn before_noise(&self) -> Option<Self> {
        self.spread
            .as_ref()
            .map(|_| self.clone().with_equal_noise())
    }

    fn complete(&self, explained: &mut Explained, options: &Options) {
        prefer_error_table(self, explained, options);
        compete(self, explained, options);
    }

    fn noise_effect(&self) -> Option<NamedEffect> {
        let spread = self.spread.as_ref()?;
        let (law, name) = match spread.law {
            SpreadLaw::Power => ("power", "exponent"),
            SpreadLaw::Exponential => ("exponential", "log_sd_per_half_range"),
        };
        let mut catalogue = self.catalogue().iter();
        let sentence = catalogue.find(|c| c.id == HETEROSCEDASTIC_NOISE);
        Some(NamedEffect {
            id: HETEROSCEDASTIC_NOISE.to_owned(),
            laws: vec![law.to_owned()],
            class: vec![HETEROSCEDASTIC_NOISE.to_owned()],
            p_value: spread.p_value,
            parameters: vec![EffectParameter {
                name: name.to_owned(),
                value: spread.exponent,
                unit: "1".to_owned(),
                interval95: spread.interval95,
            }],
            sentence: self.format_text(sentence.map_or("", |c| c.sentence)),
        })
    }

    /// A law of the clock that cells do not bear out is none. A period that wanders leaves its own
    /// traces along what it runs over; the reason says that it is not steady.
    fn residual_explained(&self, found: &SearchResult) -> bool {
        if self.is_time_confounded(found) {
            return true;
        }
        let driver = found.last_test.covariates.first();
        stationarity(self, &found.best).is_some_and(|s| s.z > UNSTEADY)
            && driver.is_some_and(|d| PERIOD_RUNS_OVER.contains(&d.covariate.as_str()))
            && found.last_test.p_catalogue() >= CATALOGUE
    }

    fn repeats_with_protocol(&self, h: &Hypothesis, columns: &[Vec<f64>]) -> bool {
        self.is_block_effect(h, columns)
    }

    fn lack_of_fit(&self, h: &Hypothesis) -> Option<LackOfFit> {
        self.pure_error(h)
    }

    fn floor(&self, h: &Hypothesis, noise: &Noise, _left: bool) -> FloorStatement {
        let floor = noise_floor(self, h, noise);
        let sd = floor.map(|f| f.sd);
        let axis = self.axis();
        FloorStatement {
            floor: NoiseFloor {
                error_um: sd.filter(|_| axis),
                response: sd.filter(|_| !axis),
                source: floor.map_or("none", |f| f.source).to_owned(),
                ..NoiseFloor::default()
            },
            sd: sd.unwrap_or(noise.repeat.value),
            dof: self.pure_error(h).map(|l| l.pure_dof),
            ..FloorStatement::default()
        }
    }

    fn next_measurement(
        &self,
        best: &Hypothesis,
        rivals: &[&Hypothesis],
    ) -> Option<NextMeasurement> {
        next::next_measurement(self, best, rivals)
    }

    fn with_holdout(&self, unsealed: &[ScalarRow]) -> Result<Self, VerifyError> {
        Ok(self.with_unsealed(unsealed))
    }

    fn sealed(&self) -> &[bool] {
        &self.sealed
    }

    fn predict(&self, h: &Hypothesis, reading_sd: &[f64]) -> Option<ScalarPredictions> {
        let (value, half95) = predict(self, &Fitted::of(&h.fit), reading_sd)?;
        Some(ScalarPredictions {
            value,
            half95,
            quantile: t95(h.fit.dof),
        })
    }

    fn quantities(&self) -> &'static [Quantity] {
        if self.axis() {
            &[Quantity {
                key: "error_rmse_um",
                unit: "um",
            }]
        } else {
            &[Quantity {
                key: "response_rmse",
                unit: "",
            }]
        }
    }

    fn errors(&self, predictions: &ScalarPredictions, reading: usize) -> HeldOut {
        let error = self.measured()[(reading, 0)] - predictions.value[reading];
        HeldOut {
            group: self.frame.groups[reading],
            errors: vec![vec![error]],
            stated_sd: vec![vec![predictions.half95[reading] / predictions.quantile]],
            inside95: vec![error.abs() <= predictions.half95[reading]],
        }
    }

    fn folds(&self, accepted: &Hypothesis) -> Folds {
        let grouping = if self.has(accepted, ERROR_TABLE) {
            Grouping::Repeats
        } else if self.has(accepted, ZERO_BY_SERIES) {
            Grouping::WithinSeries
        } else if follows_neighbours(self, accepted) {
            Grouping::Blocks
        } else {
            Grouping::Stimuli
        };
        let mut folds = folds(&self.frame, grouping);
        // What shows at one place alone (a count that starts again) is not predicted where that is
        // omitted.
        let local = |t: &EffectTerm| self.effects[t.effect].shows_on_one_level;
        let slots = accepted.fit.slots(self.catalogue());
        let terms = accepted.fit.terms.iter().zip(slots);
        for (_, slots) in terms.filter(|(t, _)| local(t)) {
            let column = accepted.fit.raw_design.column(slots.columns.start);
            // The reading farthest from the column's typical value shows the effect.
            let typical = median(column.iter().copied()).unwrap_or_default();
            let own = column.map(|v| (v - typical).abs()).imax();
            let kept = folds.fold[own];
            let place = folds.fold.iter_mut().filter(|fold| **fold == kept);
            place.for_each(|fold| *fold = None);
        }
        folds
    }

    fn calibration(
        &self,
        base: &Hypothesis,
        accepted: &Hypothesis,
        noise: &Noise,
        _floor_sd: f64,
    ) -> ScalarModel {
        let lack = [base, accepted].map(|h| self.pure_error(h));
        // Where the fit takes its readings for independent, its variance holds what they share
        // already.
        let shared = accepted
            .weights
            .shared()
            .map_or(0.0, |_| noise.shared_variance());
        // A further series has its own zero.
        let shared = shared + zero_scatter(self, &accepted.fit) / accepted.fit.variance();
        let [declared, richer] = self.polynomials(base, accepted);
        let polynomial = richer.or(declared.filter(|_| accepted.fit.terms.is_empty()));
        ScalarModel::of(self, accepted, shared, polynomial, lack)
    }

    fn unusable_reason(&self, accepted: &Hypothesis) -> Option<String> {
        non_invertible_reason(self, accepted).or_else(|| domain_error(self, accepted))
    }

    fn channels(
        &self,
        before: &ScalarPredictions,
        after: &ScalarPredictions,
        reading: usize,
    ) -> Vec<(String, [f64; 3])> {
        let channel = if self.axis() { "error" } else { "response" };
        let [before, after] = [before, after].map(|p| p.value[reading] - self.offset);
        let measured = self.frame.rows[reading].y;
        vec![(channel.to_owned(), [measured, before, after])]
    }
}
