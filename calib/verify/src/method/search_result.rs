//! What a search found, and what each of its explanations is worth.

use super::admissible::REFIT_STEPS;
use super::ambiguity::cox_test;
use super::fit::linear;
use super::hypothesis::{Hypothesis, Rejection};
use super::omnibus::{CovariateScore, OmnibusTest};
use super::options::Options;
use crate::levels::{COURSE, LEAD, PRICE, RIVAL};
use crate::measurement_model::MeasurementModel;

/// One line of the evidence table.
#[derive(Debug, Clone)]
pub struct RankedHypothesis {
    /// Effects of the explanation.
    pub effects: Vec<String>,
    /// Law of each.
    pub laws: Vec<String>,
    /// Fall of the misfit against the declared model, in units of the final variance.
    pub gain: f64,
    /// Criterion less the best's.
    pub behind: f64,
    /// Parameters that it spends.
    pub parameters: usize,
    /// Chance of falling this far behind were it true (parametric bootstrap; 1 for the best).
    pub p_value: f64,
}

impl RankedHypothesis {
    /// The data do not reject it.
    pub fn is_retained(&self) -> bool {
        self.p_value >= RIVAL
    }
}

/// What the search found.
#[derive(Clone)]
pub struct SearchResult {
    /// The declared model.
    pub base: Hypothesis,
    /// Omnibus test on the declared model.
    pub first_test: OmnibusTest,
    /// Best explanation (the declared model where nothing was accepted).
    pub best: Hypothesis,
    /// Omnibus test on the best explanation.
    pub last_test: OmnibusTest,
    /// Explanations that the data do not reject, best first, the best included.
    pub survivors: Vec<Hypothesis>,
    /// Every explanation of the final size that was refitted.
    pub evidence: Vec<RankedHypothesis>,
    /// The same as hypotheses, best first.
    pub refitted: Vec<Hypothesis>,
    /// What was never named or was withdrawn, and at which gate.
    pub rejections: Vec<Rejection>,
    /// A generic driver explains more than the catalogue does.
    pub covariate_beats_catalogue: bool,
}

impl SearchResult {
    /// The omnibus test that says what remains, where something does: on the declared model where a
    /// generic driver beats the catalogue.
    pub(crate) fn failed_adequacy_test(&self) -> Option<&OmnibusTest> {
        if self.covariate_beats_catalogue {
            Some(&self.first_test)
        } else {
            self.last_test.rejected().then_some(&self.last_test)
        }
    }

    /// The strongest generic driver of what the declared model leaves, and twice its parameters;
    /// none where none is significant.
    fn driver(&self) -> Option<(&CovariateScore, f64)> {
        let test = &self.first_test;
        let score = test.covariates.first().filter(|_| test.generic())?;
        // Periods and steps were scanned: some forty places each.
        let scanned = if matches!(score.shape, "sinusoid" | "step") {
            2.0 * 40f64.ln()
        } else {
            2.0
        };
        Some((score, 2.0 * score.dimension as f64 + scanned))
    }

    /// A generic driver alone leads the best explanation (Akaike) by more than chance gives.
    pub(crate) fn generic_driver_wins(&self) -> bool {
        let (base, variance) = (&self.base.fit, self.best.fit.variance());
        let lead = |(score, price): (&CovariateScore, f64)| {
            self.best.aic(base, variance) - (base.ssr - score.gain) / variance - price
        };
        self.driver().map(lead).is_some_and(|lead| lead > LEAD)
    }

    /// The generic driver that alone, in place of the terms of `h` and on the readings that count
    /// there, describes them better (Akaike), and so much that it would be chance were `h` true
    /// (Cox); none where none does.
    pub(crate) fn outdone_by(
        &self,
        system: &dyn MeasurementModel,
        h: &Hypothesis,
        options: &Options,
    ) -> Option<&str> {
        let (score, price) = self.driver()?;
        let declared = Hypothesis::fitted(system, &[], &h.weights, REFIT_STEPS)?;
        let spent = PRICE * h.parameters(&declared.fit);
        let course = with_columns(declared, &score.columns);
        let lead = (h.fit.ssr - course.fit.ssr) / h.fit.variance() + spent - price;
        let variance = course.fit.variance();
        let chance = || cox_test(&course, h, variance, options.draws, options.seed);
        (lead > 0.0 && chance() < COURSE).then_some(score.covariate.as_str())
    }

    /// The explanation that predictions use: the best one, but for where a generic driver explains
    /// more than the catalogue does.
    pub fn accepted(&self) -> &Hypothesis {
        if self.covariate_beats_catalogue {
            &self.base
        } else {
            &self.best
        }
    }
}

/// `h` with more columns, free in every channel; coefficients stay those without them.
fn with_columns(mut h: Hypothesis, columns: &[Vec<f64>]) -> Hypothesis {
    let fit = &mut h.fit;
    let own = fit.raw_design.ncols();
    let added = columns.len();
    fit.raw_design = std::mem::take(&mut fit.raw_design).resize_horizontally(own + added, 0.0);
    for (k, column) in columns.iter().enumerate() {
        fit.raw_design.column_mut(own + k).copy_from_slice(column);
    }
    fit.design = h.weights.apply(&fit.raw_design);
    fit.residual = linear(&fit.design, &h.weights.apply(&fit.raw_residual)).1;
    fit.ssr = fit.residual.norm_squared() + fit.auxiliary_residual.norm_squared();
    fit.dof -= (added * fit.residual.ncols()) as f64;
    h
}

#[cfg(test)]
mod tests {
    use super::super::columns_system_test::ColumnsSystem;
    use super::super::fit::Weights;
    use super::super::search::Search;
    use super::*;

    /// What outdoes a column that rises and swings, in readings that `acts` on by clock (0 to 1) and
    /// column.
    fn outdone(seed: u64, acts: impl Fn(f64, f64) -> f64) -> Option<String> {
        let clock: Vec<f64> = (0..120).map(|i| f64::from(i) / 119.0).collect();
        let column: Vec<f64> = clock.iter().map(|t| t + 0.2 * (40.0 * t).sin()).collect();
        let both = clock.iter().zip(&column);
        let clean: Vec<f64> = both.map(|(t, c)| acts(*t, *c)).collect();
        let system = ColumnsSystem::new(seed, vec![column], &clean)
            .with_covariates(vec![("t_s".to_owned(), clock)]);
        let (weights, options) = (Weights::equal(120), Options::default());
        let search = Search::new(&system, &weights, &options).unwrap();
        let named = Hypothesis::fitted(&system, &[ColumnsSystem::term(0)], &weights, 5).unwrap();
        let driver = search.found.outdone_by(&system, &named, &options);
        driver.map(str::to_owned)
    }

    #[test]
    fn a_course_outdoes_a_name_that_it_describes_better_than_and_no_true_one() {
        for seed in 0..5 {
            assert_eq!(outdone(seed, |t, _| 8.0 * t * t).as_deref(), Some("t_s"));
            assert_eq!(outdone(seed, |_, column| 8.0 * column), None);
        }
    }
}
