//! The omnibus test: is anything left beyond noise? One family-wise level, shared (Bonferroni)
//! between four kinds of alternative:
//!
//! ```text
//! 0.01 named signatures + 0.002 generic drivers + 0.0015 serial correlation + 0.002 lack of fit against pure error = 0.0155
//! ```

use super::covariates::{CovariateSignature, signatures_of_covariates};
use super::fit::{Fit, Weights};
use super::min_p::{MinPDistribution, signature_p, strongest};
use super::options::Options;
use super::rounding::is_rounding;
use super::signature::{Signature, nuisance_basis, signatures_of_catalogue};
use crate::levels::{CATALOGUE, GENERIC, OMNIBUS, REPLICATES, SERIAL};
use crate::measurement_model::MeasurementModel;
use nalgebra::DVector;
use statrs::distribution::{ContinuousCDF, Normal};
use std::sync::Arc;

/// A covariate along which the residual varies, with its best shape.
#[derive(Debug, Clone)]
pub struct CovariateScore {
    /// Covariate, by its name in [`MeasurementModel::covariates`].
    pub covariate: String,
    /// Shape.
    pub shape: &'static str,
    /// Period for a sinusoid.
    pub period: Option<f64>,
    /// Single p-value.
    pub p_single: f64,
    /// Fall of the sum of squares.
    pub gain: f64,
    /// Degrees of freedom.
    pub dimension: usize,
    /// Its columns, free in every channel.
    pub columns: Vec<Vec<f64>>,
}

/// Result of the omnibus test on one model.
#[derive(Clone)]
pub struct OmnibusTest {
    /// Signatures of the catalogue on top of the model.
    pub signatures: Arc<[Signature]>,
    /// Their joint null distribution.
    pub family: MinPDistribution,
    /// Distribution of the smallest p of the generic signatures.
    pub covariate_family: MinPDistribution,
    /// Smallest single p-value of the catalogue.
    smallest_catalogue: f64,
    /// Smallest single p-value of the generic signatures.
    smallest_covariate: f64,
    /// p-value of serial correlation along the sweeps.
    pub p_serial: f64,
    /// Best shape of each covariate, strongest first.
    pub covariates: Vec<CovariateScore>,
    /// Correlation of neighbouring residuals.
    pub serial_correlation: f64,
    /// The residual is significant, but so small a part of the misfit that the model of the
    /// recording itself may leave it.
    pub within_model_error: bool,
    /// The residual is what rounding makes of the model's responses.
    pub is_rounding: bool,
}

/// Share of the sum of squares from which what remains is no model error: a tenth of the noise,
/// root mean square.
const MODEL_ERROR: f64 = 0.01;
/// Correlation of neighbours from which it is none.
const MODEL_CORRELATION: f64 = 0.1;

impl OmnibusTest {
    /// Something beyond noise remains.
    pub fn rejected(&self) -> bool {
        let named = || self.family.rejects(self.smallest_catalogue, CATALOGUE);
        self.is_unexplained() && (self.generic() || named())
    }

    /// Something remains that need not be in the catalogue.
    pub fn generic(&self) -> bool {
        let driven = || {
            self.covariate_family
                .rejects(self.smallest_covariate, GENERIC)
        };
        self.is_unexplained() && (self.p_serial < SERIAL || driven())
    }

    /// The residual is neither rounding nor the model's own error.
    fn is_unexplained(&self) -> bool {
        !self.within_model_error && !self.is_rounding
    }

    /// Judges the catalogue without `effects`, which were tried on `fit` and withdrawn.
    pub fn leave_out(&mut self, fit: &Fit, effects: &[usize]) {
        let residual = fit.stacked();
        let others = self
            .signatures
            .iter()
            .filter(|s| !effects.contains(&s.term.effect));
        self.smallest_catalogue = strongest(others, &residual, fit).map_or(1.0, |(p, _)| p);
    }

    /// Whether everything that `fit` leaves is a small part of its misfit.
    pub(crate) fn is_small(&self, fit: &Fit) -> bool {
        let residual = fit.stacked();
        let catalogue = self
            .signatures
            .iter()
            .map(|s| s.gain(&residual))
            .fold(0.0, f64::max);
        let generic = self.covariates.iter().map(|s| s.gain).fold(0.0, f64::max);
        catalogue.max(generic) < MODEL_ERROR * fit.ssr
            && self.serial_correlation < MODEL_CORRELATION
    }

    /// Family-wise p-value of the catalogue.
    pub fn p_catalogue(&self) -> f64 {
        self.family.family_wise_p(self.smallest_catalogue)
    }

    /// Family-wise p-value of the generic signatures.
    pub fn p_covariates(&self) -> f64 {
        self.covariate_family.family_wise_p(self.smallest_covariate)
    }

    /// Family-wise p-values: catalogue, generic signatures, serial correlation.
    pub fn p_values(&self) -> [f64; 3] {
        [self.p_catalogue(), self.p_covariates(), self.p_serial]
    }

    /// One omnibus p-value: Bonferroni over the families by their shares of the level;
    /// `p_lack_of_fit` where readings repeat.
    pub fn p_value(&self, p_lack_of_fit: Option<f64>) -> f64 {
        [
            (self.p_catalogue(), CATALOGUE),
            (self.p_covariates(), GENERIC),
            (self.p_serial, SERIAL),
            (p_lack_of_fit.unwrap_or(1.0), REPLICATES),
        ]
        .into_iter()
        // p over its share of the level, in units of the whole one.
        .map(|(p, level)| p * OMNIBUS / level)
        .fold(1.0, f64::min)
    }
}

/// p-value (normal approximation) and size of the lag-one correlation of neighbouring readings of
/// one group.
fn serial(system: &dyn MeasurementModel, fit: &Fit, weights: &Weights) -> (f64, f64) {
    let groups = system.groups();
    let (mut product, mut count) = (0.0, 0.0);
    let rows: Vec<usize> = (0..groups.len()).filter(|&i| weights.counts(i)).collect();
    // Neighbours of one group alone: between groups time passes that nothing tells of.
    for pair in rows.windows(2) {
        if groups[pair[0]] == groups[pair[1]] {
            for c in 0..fit.residual.ncols() {
                product += fit.residual[(pair[0], c)] * fit.residual[(pair[1], c)];
                count += 1.0;
            }
        }
    }
    if count < 10.0 || fit.ssr <= 0.0 {
        return (1.0, 0.0);
    }
    // Fitted parameters make residuals of white noise slightly negative neighbours: only positive
    // correlation counts.
    let mean_square =
        fit.residual.norm_squared() / (weights.active() * fit.residual.ncols()) as f64;
    // Of white noise the lag-one correlation of n pairs has the standard deviation 1/sqrt(n).
    let correlation = product / count / mean_square;
    (
        Normal::standard().sf(correlation * count.sqrt()),
        correlation,
    )
}

/// Share of a label's gain from which a continuous covariate does as well.
const AS_WELL: f64 = 0.6;

/// A label (which trajectory) takes up whatever is smooth while it lasts: it is offered only where
/// no continuous covariate does as well.
fn rank_steps_after_continuous(scores: &mut [CovariateScore]) {
    let is_label = |s: &CovariateScore| s.covariate == "trajectory";
    let Some(label) = scores.iter().position(is_label) else {
        return;
    };
    let gain = scores[label].gain;
    let last = scores
        .iter()
        .rposition(|s| !is_label(s) && s.gain >= AS_WELL * gain);
    if let Some(last) = last.filter(|l| *l > label) {
        scores[label..=last].rotate_left(1);
    }
}

fn generic(
    system: &dyn MeasurementModel,
    fit: &Fit,
    weights: &Weights,
    residual: &DVector<f64>,
    options: &Options,
) -> (f64, Vec<CovariateScore>, MinPDistribution) {
    let basis = nuisance_basis(fit);
    let signatures: Vec<CovariateSignature> =
        signatures_of_covariates(system, fit, weights, &basis)
            .into_iter()
            .filter(|a| (a.signature.dimension() as f64) < 0.5 * fit.dof)
            .collect();
    let family = MinPDistribution::new(
        signatures.iter().map(|a| a.signature.clone()).collect(),
        fit.dof,
        &Options {
            seed: options.seed ^ 0x5eed,
            ..options.clone()
        },
    );
    let mut scores: Vec<CovariateScore> = Vec::new();
    for a in &signatures {
        let gain = a.signature.gain(residual);
        let Some(p_single) = signature_p(&a.signature, gain, fit.ssr, fit.dof) else {
            continue;
        };
        let score = CovariateScore {
            covariate: a.covariate.clone(),
            shape: a.shape,
            period: a.period,
            p_single,
            gain,
            dimension: a.signature.dimension(),
            columns: a.columns.clone(),
        };
        // Of each covariate its best shape stands; the family corrects for the others.
        match scores.iter_mut().find(|s| s.covariate == a.covariate) {
            Some(kept) if kept.p_single <= p_single => {}
            Some(kept) => *kept = score,
            None => scores.push(score),
        }
    }
    // Where two p-values underflow, the larger gain decides.
    scores.sort_by(|a, b| {
        a.p_single
            .total_cmp(&b.p_single)
            .then(b.gain.total_cmp(&a.gain))
    });
    rank_steps_after_continuous(&mut scores);
    let p = scores.iter().map(|s| s.p_single).fold(1.0, f64::min);
    (p, scores, family)
}

/// Runs the omnibus test on a fitted model.
pub fn omnibus_test(
    system: &dyn MeasurementModel,
    fit: &Fit,
    weights: &Weights,
    options: &Options,
) -> OmnibusTest {
    let basis = nuisance_basis(fit);
    let signatures: Arc<[Signature]> = signatures_of_catalogue(system, fit, weights, &basis).into();
    let residual = fit.stacked();
    let (smallest_covariate, covariates, covariate_family) =
        generic(system, fit, weights, &residual, options);
    let (p_serial, serial_correlation) = serial(system, fit, weights);
    OmnibusTest {
        smallest_catalogue: strongest(signatures.iter(), &residual, fit).map_or(1.0, |(p, _)| p),
        smallest_covariate,
        p_serial,
        serial_correlation,
        within_model_error: false,
        is_rounding: is_rounding(system, fit, weights),
        family: MinPDistribution::new(signatures.clone(), fit.dof, options),
        signatures,
        covariate_family,
        covariates,
    }
}
