//! Whether an explanation may stand: inside what physics allows, with nothing in it that is none,
//! and its fit at an end.

use super::fit::{Fit, Status, Weights, fit};
use super::hypothesis::Hypothesis;
use super::min_p::{MinPDistribution, f_test};
use super::range_check::range_check;
use crate::effect::{EffectTerm, Role, TermKey, keys};
use crate::measurement_model::MeasurementModel;

/// Steps of a refit from an optimum beside it.
pub(crate) const REFIT_STEPS: usize = 15;

impl Hypothesis {
    /// What its terms stand for, ascending, and the outliers where readings are flagged:
    /// explanations of one key are one.
    pub fn key(&self, system: &dyn MeasurementModel, outliers: Option<usize>) -> Vec<TermKey> {
        let mut key = keys(&self.fit.terms, system.catalogue());
        if let (Some(effect), false) = (outliers, self.flagged.is_empty()) {
            key.push(TermKey {
                effect,
                law: 0,
                instance: 0,
            });
            key.sort_unstable();
        }
        key
    }

    /// Every parameter lies inside its physical range, every amplitude is there, and no two terms
    /// stand for the same.
    pub fn is_physical(&self, system: &dyn MeasurementModel) -> bool {
        let mut slot = 0;
        for t in &self.fit.terms {
            let law = &system.catalogue()[t.effect].law(t.law);
            for (p, v) in law.parameters.iter().zip(&t.values) {
                let at_bound = self.fit.at_bound[slot];
                slot += 1;
                // A share of one is complete, not out of range.
                let complete =
                    matches!(p.role, Role::Amplitude { .. }) && p.range[1] == 1.0 && *v > 0.5;
                if at_bound && !complete {
                    return false;
                }
            }
        }
        let terms = &self.fit.terms;
        let apart = |k: usize| {
            terms[..k]
                .iter()
                .all(|t| t.beside(&terms[k], system.catalogue()))
        };
        (1..terms.len()).all(apart)
            && self.fit.status != Status::RankDeficient
            && range_check(system, &self.fit)
    }

    /// `terms` on the readings of `weights`, nothing flagged; none where they have no fit.
    pub fn fitted(
        system: &dyn MeasurementModel,
        terms: &[EffectTerm],
        weights: &Weights,
        steps: usize,
    ) -> Option<Self> {
        let fit = fit(system, terms, weights, steps)?;
        Some(Self {
            fit,
            weights: weights.clone(),
            flagged: Vec::new(),
            flag_p: 1.0,
        })
    }

    /// The same without the terms that `leaves`, everything else refitted; none where that has no
    /// fit.
    pub fn without(
        &self,
        system: &dyn MeasurementModel,
        leaves: impl Fn(usize, &EffectTerm) -> bool,
    ) -> Option<Self> {
        let kept = self
            .fit
            .terms
            .iter()
            .enumerate()
            .filter(|(k, t)| !leaves(*k, t));
        let terms: Vec<EffectTerm> = kept.map(|(_, t)| t.clone()).collect();
        Some(Self {
            fit: fit(system, &terms, &self.weights, REFIT_STEPS)?,
            ..self.clone()
        })
    }

    /// p-value of what it lacks of `with`, adjusted by the family that was searched; 1 where
    /// nothing remains to test it by.
    pub(crate) fn removal_p(&self, with: &Fit, family: &MinPDistribution) -> f64 {
        let extra = (self.fit.dof - with.dof).max(1.0) as usize;
        let p = f_test(self.fit.ssr - with.ssr, self.fit.ssr, self.fit.dof, extra);
        p.map_or(1.0, |p| family.family_wise_p(p))
    }

    /// Whether it may be accepted: physical, and its sum of squares no longer falls.
    pub fn is_admissible(&self, system: &dyn MeasurementModel) -> bool {
        self.fit.status != Status::NotConverged && self.is_physical(system)
    }

    /// The same without each of its terms in turn, everything else refitted (R: `drop1`).
    pub(crate) fn drop1(&self, system: &dyn MeasurementModel) -> Vec<(usize, Self)> {
        let without = |k: usize| Some((k, self.without(system, |j, _| j == k)?));
        (0..self.fit.terms.len()).filter_map(without).collect()
    }

    /// Backward elimination: `weakest` picks the term that goes from those dropped in turn, until
    /// none has to. The remaining hypothesis, and effects that went.
    pub fn eliminate(
        &self,
        system: &dyn MeasurementModel,
        weakest: impl Fn(&Self, Vec<(usize, Self)>) -> Option<(usize, Self)>,
    ) -> (Self, Vec<usize>) {
        let (mut kept, mut gone) = (self.clone(), Vec::new());
        while !kept.fit.terms.is_empty()
            && let Some((k, without)) = weakest(&kept, kept.drop1(system))
        {
            gone.push(kept.fit.terms[k].effect);
            kept = without;
        }
        (kept, gone)
    }
}
