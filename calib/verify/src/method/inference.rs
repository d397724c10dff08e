//! Covariance of everything that was fitted, intervals, and which explanations are one class on
//! this data.

use super::fit::{Fit, Weights, fit};
use super::hypothesis::Hypothesis;
use super::linear::Basis;
use super::search_result::SearchResult;
use super::signature::nuisance_basis;
use crate::effect::{EffectTerm, LawRequirement, Role};
use crate::levels::{LEAD, NORMAL_95};
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};
use wcal_core::verify_document::EffectParameter;
use wcal_gpr::half95;

/// Joint covariance: coefficients channel by channel, then nonlinear values in term order.
pub fn covariance(fit: &Fit, variance: f64) -> DMatrix<f64> {
    let jacobian = fit.jacobian();
    let size = jacobian.ncols();
    let scale: Vec<f64> = jacobian
        .column_iter()
        .map(|v| v.norm().max(1e-300))
        .collect();
    let scaled = DMatrix::from_fn(jacobian.nrows(), jacobian.ncols(), |i, j| {
        jacobian[(i, j)] / scale[j]
    });
    // Columns of unit length: the condition does not depend on the units of the parameters.
    let gram = scaled.transpose() * &scaled;
    let inverse = gram
        .pseudo_inverse(1e-12)
        .unwrap_or_else(|_| DMatrix::zeros(size, size));
    // What moves no prediction (the place of a step between two readings) has no covariance: 0,
    // never an infinity.
    let dead: Vec<bool> = jacobian.column_iter().map(|v| v.norm() < 1e-150).collect();
    DMatrix::from_fn(size, size, |i, j| {
        if dead[i] || dead[j] {
            0.0
        } else {
            inverse[(i, j)] * variance / (scale[i] * scale[j])
        }
    })
}

/// Standard deviations of measured less predicted values, in the sensor's channels (readings x
/// channels):
///
/// ```text
/// sd_ic^2 = noise_i^2 sum_a P_ac^2 + G V G',     G = sum_a P_ac J_ia        P: channels_pm, J: tangents at the fitted values, V: their covariance
/// ```
///
/// of `h`, fitted on readings of `system` or part of them; `noise_sd` of each reading, in the
/// engine's channels. None where the model has no solution there.
pub(crate) fn prediction_sd(
    system: &dyn MeasurementModel,
    h: &Hypothesis,
    noise_sd: &[f64],
) -> Option<DMatrix<f64>> {
    let n = noise_sd.len();
    // Tangents alone: the coefficients of this call are not used.
    let jacobian = fit(system, &h.fit.terms, &Weights::equal(n), 0)?.jacobian();
    let (spread, shares) = (covariance(&h.fit, h.fit.variance()), system.channels_pm());
    if spread.nrows() != jacobian.ncols() {
        return None;
    }
    let sd = |i: usize, c: usize| {
        let shares = shares.column(c);
        let rows = DMatrix::from_fn(shares.len(), jacobian.ncols(), |a, k| {
            jacobian[(a * n + i, k)]
        });
        let gradient = shares.transpose() * rows;
        // First order: the parameters' covariance through the tangents.
        let fitted = (&gradient * &spread * gradient.transpose())[0];
        (noise_sd[i].powi(2) * shares.norm_squared() + fitted.max(0.0)).sqrt()
    };
    Some(DMatrix::from_fn(n, shares.ncols(), sd))
}

/// Quantile of Student's t for a two-sided 95 % interval.
pub(crate) fn t95(dof: f64) -> f64 {
    half95(Some(dof.max(1.0)))
}

/// Parameters of one effect of an explanation with 95 % intervals.
pub fn parameters(
    system: &dyn MeasurementModel,
    h: &Hypothesis,
    effect: usize,
) -> Vec<EffectParameter> {
    let fit = &h.fit;
    let covariance = covariance(fit, fit.variance());
    let pm = system.channels_pm();
    let (q, c) = (fit.design.ncols(), fit.residual.ncols());
    let t = t95(fit.dof);
    let mut out = Vec::new();
    let all = fit.terms.iter().zip(fit.slots(system.catalogue()));
    for (term, slots) in all.filter(|(term, _)| term.effect == effect) {
        let law = system.catalogue()[effect].law(term.law);
        for ((p, v), k) in law.parameters.iter().zip(&term.values).zip(slots.values) {
            let shared = NORMAL_95 * system.systematic_sd(effect, p.name);
            // What readings average out by Student's t; what they share is known beforehand and
            // normal.
            let half = (t * covariance[(q * c + k, q * c + k)].max(0.0).sqrt()).hypot(shared);
            let one_sided = matches!(p.role, Role::Amplitude { .. }) && p.range[0] == 0.0;
            let low = if one_sided {
                (v - half).max(0.0)
            } else {
                v - half
            };
            out.push(EffectParameter {
                name: p.name.to_owned(),
                value: *v,
                unit: p.unit.to_owned(),
                interval95: [low, v + half],
            });
        }
        for ((name, unit), column) in law.linear.iter().zip(slots.columns) {
            for channel in 0..c {
                let shares = pm.column(channel);
                let of = |a: usize, b: usize| {
                    // Var(sum P_a b_a): coefficients of the engine's channels share their errors.
                    shares[a] * shares[b] * covariance[(a * q + column, b * q + column)]
                };
                let variance: f64 = (0..c)
                    .flat_map(|a| (0..c).map(move |b| (a, b)))
                    .map(|(a, b)| of(a, b))
                    .sum();
                let half = t * variance.max(0.0).sqrt();
                let v = (fit.coefficients.row(column) * shares)[0];
                out.push(EffectParameter {
                    name: if c > 1 {
                        format!("{name}_{}", channel + 1)
                    } else {
                        (*name).to_owned()
                    },
                    value: v,
                    unit: (*unit).to_owned(),
                    interval95: [v - half, v + half],
                });
            }
        }
    }
    out
}

/// Signature cosine above which two explanations are one class (docs/src/formats.md).
pub(crate) const CLASS_COSINE: f64 = 0.995;

/// What an explanation takes out of the declared model's residual.
fn explained_part(base: &Hypothesis, h: &Hypothesis) -> DVector<f64> {
    let mut v = base.fit.stacked() - h.fit.stacked();
    // Flagged readings count as explained whole in both, so that they do not dominate the angle.
    for direction in h.flagged.iter().flat_map(|&i| h.fit.directions_of(i)) {
        v.component_mul_assign(&direction.map(|x| 1.0 - x));
    }
    v
}

/// Cosine between what two explanations explain.
pub fn cosine(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    let size = a.norm() * b.norm();
    if size > 0.0 { a.dot(b) / size } else { 0.0 }
}

/// Cosine between what two explanations explain by themselves, without sign; 1 where neither has a
/// part that the other lacks. What both share (effects in common, whatever both leave unexplained)
/// is projected off first: a large common effect makes any two look alike.
fn signature_cosine(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    best: &Hypothesis,
    h: &Hypothesis,
) -> f64 {
    let whole = explained_part(base, best);
    // The angle between what is each one's own.
    let common = common_effects(system, base, best, h);
    let (a, b) = (
        common.project_off(&whole),
        common.project_off(&explained_part(base, h)),
    );
    let own = a.norm().max(b.norm());
    if own <= 1e-9 * whole.norm() {
        1.0
    } else {
        cosine(&a, &b).abs()
    }
}

/// For every survivor: is it of the best one's class?
pub(crate) fn equivalence_class(system: &dyn MeasurementModel, found: &SearchResult) -> Vec<bool> {
    let like = |h| signature_cosine(system, &found.base, &found.best, h);
    found
        .survivors
        .iter()
        .map(|h| like(h) > CLASS_COSINE)
        .collect()
}

/// Cosine and lag in the criterion up to which a law of a measured column and one of another are
/// not distinguished by their misfit.
const MEASURED_COSINE: f64 = 0.97;
const MEASURED_BEHIND: f64 = 2.0 * LEAD;

/// Whether `h`, which is `behind` the best explanation in the criterion, is not distinguished from
/// it because one of them follows a temperature: that is measured itself, and the comparison takes
/// columns for exact. Over minutes a room that warms steadily is as good as a clock.
pub(crate) fn indistinguishable(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    best: &Hypothesis,
    h: &Hypothesis,
    behind: f64,
) -> bool {
    let measured = |h: &Hypothesis| {
        let needs = |t: &EffectTerm| &system.catalogue()[t.effect].law(t.law).needs;
        h.fit
            .terms
            .iter()
            .any(|t| needs(t).contains(&LawRequirement::Temperature))
    };
    measured(best) != measured(h)
        && behind < MEASURED_BEHIND
        && signature_cosine(system, base, best, h) > MEASURED_COSINE
}

/// Directions in which the effects that two explanations share move the prediction, off the
/// declared model: columns and tangents of `a`'s terms that `b` has, too.
fn common_effects(
    system: &dyn MeasurementModel,
    base: &Hypothesis,
    a: &Hypothesis,
    b: &Hypothesis,
) -> Basis {
    let declared = nuisance_basis(&base.fit);
    let key = |t: &EffectTerm| t.key(system.catalogue());
    let all = a.fit.terms.iter().zip(a.fit.slots(system.catalogue()));
    let shared = all.filter(|(term, _)| b.fit.terms.iter().any(|t| key(t) == key(term)));
    let directions = shared.flat_map(|(_, slots)| {
        let columns = slots.columns.flat_map(|j| a.fit.column_directions(j));
        columns.chain(a.fit.tangents[slots.values].iter().cloned())
    });
    Basis::of(directions.map(|v| declared.project_off(&v)))
}
