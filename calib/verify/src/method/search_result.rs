//! What a search found, and what each of its explanations is worth.

use super::hypothesis::{Hypothesis, Rejection};
use super::omnibus::OmnibusTest;
use crate::levels::RIVAL;

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

    /// Lead (Akaike) of the strongest generic driver alone over `h`; none where none is significant.
    pub(crate) fn lead_of_driver(&self, h: &Hypothesis) -> Option<f64> {
        let (base, test, variance) = (&self.base.fit, &self.first_test, h.fit.variance());
        let score = test.covariates.first().filter(|_| test.generic())?;
        // Periods and steps were scanned: some forty places each.
        let scanned = if matches!(score.shape, "sinusoid" | "step") {
            2.0 * 40f64.ln()
        } else {
            2.0
        };
        let parameters = 2.0 * score.dimension as f64 + scanned;
        Some(h.aic(base, variance) - (base.ssr - score.gain) / variance - parameters)
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
