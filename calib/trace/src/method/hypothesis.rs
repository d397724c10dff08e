//! An explanation, what it costs, and what a search found.
//!
//! ```text
//! C = ssr / s^2 + 2 k + flags (2 c + 2 ln n)          (Akaike; k parameters, c channels, n readings)
//! ```
//!
//! H. Akaike, IEEE Trans. Automat. Contr. 19 (1974), 716-723; a flagged reading is a free shift in every channel, chosen among n.

use super::fit::{Fit, Status, Weights, fit};
use super::min_p::{MinPDistribution, f_test};
use super::omnibus::OmnibusTest;
use super::range_check::range_check;
use crate::effect::{EffectTerm, Role, TermKey, keys};
use crate::measurement_model::MeasurementModel;

/// Level at which a rival is rejected. The chance that the true explanation is left out is at most this for each rival that beats it.
pub const AMBIGUITY_LEVEL: f64 = 0.01;

/// An explanation: effects with fitted parameters.
#[derive(Debug, Clone)]
pub struct Hypothesis {
    /// The fit.
    pub fit: Fit,
    /// Weights, flagged readings at zero.
    pub weights: Weights,
    /// Readings flagged as outliers.
    pub flagged: Vec<usize>,
    /// Chance that noise with tails as heavy as the data allow gives the flagged readings; 1 where none is.
    pub flag_p: f64,
}

/// One-sided amplitudes below this share of their usual size are no explanation. The least usual sizes lie at 0.2 of it (1e-3 of base
/// compliance, 2 um of backlash), and estimates scatter about them.
const MIN_SHARE: f64 = 0.1;
/// Price of one flagged reading: it must stand out among all readings, in every channel.
const PRICE_A_FLAG: f64 = 2.0;

impl Hypothesis {
    /// Indices of its effects, ascending; outliers included.
    pub fn effects(&self, outliers: Option<usize>) -> Vec<usize> {
        let mut ids: Vec<usize> = self.fit.terms.iter().map(|t| t.effect).collect();
        if let (Some(o), false) = (outliers, self.flagged.is_empty()) {
            ids.push(o);
        }
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// What its terms stand for, ascending, and the outliers where readings are flagged: explanations of one key are one.
    pub fn key(&self, system: &dyn MeasurementModel, outliers: Option<usize>) -> Vec<TermKey> {
        let mut key = keys(&self.fit.terms, system.catalogue());
        if let (Some(effect), false) = (outliers, self.flagged.is_empty()) {
            key.push(TermKey { effect, law: 0, instance: 0 });
            key.sort_unstable();
        }
        key
    }

    /// Parameters that the explanation spends beyond the declared model.
    pub fn parameters(&self, base: &Fit) -> f64 {
        let columns = (self.fit.design.ncols() - base.design.ncols()) * self.fit.residual.ncols();
        let values: usize = self.fit.terms.iter().map(|t| t.values.len()).sum();
        (columns + values) as f64
    }

    /// Misfit in units of `variance` plus twice the parameters (Akaike); smaller is better.
    pub fn criterion(&self, base: &Fit, variance: f64) -> f64 {
        let n = self.fit.residual.nrows() as f64;
        let channels = self.fit.residual.ncols() as f64;
        // A flagged reading is a free shift in every channel, chosen among n.
        let flags = self.flagged.len() as f64 * (2.0 * channels + PRICE_A_FLAG * n.ln());
        self.fit.ssr / variance + 2.0 * self.parameters(base) + flags
    }

    /// Every parameter lies inside its physical range, every amplitude is there, and no two terms stand for the same.
    pub fn physical(&self, system: &dyn MeasurementModel) -> bool {
        let mut slot = 0;
        for t in &self.fit.terms {
            let law = &system.catalogue()[t.effect].law(t.law);
            for (p, v) in law.parameters.iter().zip(&t.values) {
                let at_bound = self.fit.at_bound[slot];
                slot += 1;
                // A share of one is complete, not out of range.
                let complete = matches!(p.role, Role::Amplitude { .. }) && p.range[1] == 1.0 && *v > 0.5;
                // Far below the usual size the effect is a correction to something else, not an explanation.
                let negligible = match p.role {
                    Role::Amplitude { probe } => p.range[0] == 0.0 && *v < MIN_SHARE * probe,
                    Role::Shape { .. } => false,
                };
                if (at_bound && !complete) || negligible {
                    return false;
                }
            }
        }
        let terms = &self.fit.terms;
        let apart = |k: usize| terms[..k].iter().all(|t| t.beside(&terms[k], system.catalogue()));
        (1..terms.len()).all(apart)
            && self.fit.status != Status::RankDeficient
            && range_check(system, &self.fit)
    }

    /// The same without the terms that `leaves`, everything else refitted in `steps` at most; none where that has no fit.
    pub fn without(
        &self,
        system: &dyn MeasurementModel,
        leaves: impl Fn(usize, &EffectTerm) -> bool,
        steps: usize,
    ) -> Option<Self> {
        let kept = self.fit.terms.iter().enumerate().filter(|(k, t)| !leaves(*k, t));
        let terms: Vec<EffectTerm> = kept.map(|(_, t)| t.clone()).collect();
        Some(Self { fit: fit(system, &terms, &self.weights, steps)?, ..self.clone() })
    }

    /// p-value of what it lacks of `with`, adjusted by the family that was searched.
    pub fn removal_p(&self, with: &Fit, family: &MinPDistribution) -> f64 {
        let extra = (self.fit.dof - with.dof).max(1.0) as usize;
        family.adjusted(f_test(self.fit.ssr - with.ssr, self.fit.ssr, self.fit.dof, extra))
    }

    /// Whether it may be accepted: physical, and its sum of squares no longer falls.
    pub fn acceptable(&self, system: &dyn MeasurementModel) -> bool {
        self.fit.status != Status::NotConverged && self.physical(system)
    }
}

/// An effect that the design of the experiment does not tell from others.
#[derive(Debug, Clone, PartialEq)]
pub struct NotIdentified {
    /// Index in the catalogue.
    pub effect: usize,
    /// Why.
    pub why: String,
}

/// A gate at which a name falls.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Gate {
    /// Its fit was still falling when the iterations ran out.
    NotConverged,
    /// The design of the experiment does not tell it from others.
    Identifiability,
    /// It lowers the error of readings that are left out by less than that gain scatters.
    LeftOutError,
    /// Another measurement of the instrument refutes it.
    Witness,
}

/// A name that fell, at which gate and why.
#[derive(Debug, Clone, PartialEq)]
pub struct Rejection {
    /// Effects of the explanation.
    pub effects: Vec<String>,
    /// Gate.
    pub gate: Gate,
    /// Why, in words; empty where the gate says it all.
    pub why: String,
}

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
    pub fn survives(&self) -> bool {
        self.p_value >= AMBIGUITY_LEVEL
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
    /// What was never named or was taken back, and at which gate.
    pub rejections: Vec<Rejection>,
    /// A generic driver explains more than the catalogue does.
    pub covariate_beats_catalogue: bool,
}

impl SearchResult {
    /// The omnibus test that says what is left, where something is: on the declared model where a generic driver beats the catalogue.
    pub fn left(&self) -> Option<&OmnibusTest> {
        if self.covariate_beats_catalogue {
            Some(&self.first_test)
        } else {
            self.last_test.rejected().then_some(&self.last_test)
        }
    }

    /// The explanation that predictions use: the best one, but for where a generic driver explains more than the catalogue does.
    pub fn accepted(&self) -> &Hypothesis {
        if self.covariate_beats_catalogue { &self.base } else { &self.best }
    }
}
