//! Which fitted values the data determine only together, in sentences, and what each accepted effect is worth.
//!
//! ```text
//! R_ij = C_ij / sqrt(C_ii C_jj);   for |R_ij| near 1:  var(a / s_a -+ b / s_b) = 2 (1 - |R_ij|)   is what the data determine well
//! ```

use super::error_summary::rmse;
use super::held_out::scored;
use super::session_model::SessionModel;
use crate::method::fit::{Fit, fit};
use crate::method::hypothesis::{Hypothesis, SearchResult};
use crate::method::inference::covariance;
use crate::method::min_p::f_test;
use crate::method::noise::Noise;
use wcal_core::verify_document::EffectAblation;

/// Correlation from which two values are said to trade off.
const TRADE_OFF: f64 = 0.95;
/// Pairs that are named at most, the strongest first.
const MAX_PAIRS: usize = 3;

/// A fitted value: name, whether it is an effect's, and its place in the covariance.
struct Value {
    name: String,
    of_effect: bool,
}

/// Every fitted value in the order of the covariance: coefficients channel by channel, then nonlinear values.
fn values<M: SessionModel>(model: &M, fit: &Fit) -> Vec<Value> {
    let (q, channels) = (fit.design.ncols(), fit.residual.ncols());
    let law = |k: usize| model.catalogue()[fit.terms[k].effect].law(fit.terms[k].law);
    let id = |k: usize| model.catalogue()[fit.terms[k].effect].id();
    let linear: Vec<String> = (0..fit.terms.len())
        .flat_map(|k| {
            law(k).linear.iter().map(|(name, _)| format!("{} of {}", name, id(k))).collect::<Vec<_>>()
        })
        .collect();
    let declared = q - linear.len().min(q);
    let mut out = Vec::new();
    for channel in 0..channels {
        let of = |name: String| if channels > 1 { format!("{name} (channel {})", channel + 1) } else { name };
        out.extend((0..declared).map(|j| Value { name: of(model.nuisance(j)), of_effect: false }));
        out.extend(linear.iter().map(|name| Value { name: of(name.clone()), of_effect: true }));
    }
    for k in 0..fit.terms.len() {
        let names = law(k).parameters.iter().map(|p| format!("{} of {}", p.name, id(k))).collect::<Vec<_>>();
        out.extend(names.into_iter().map(|name| Value { name, of_effect: true }));
    }
    out
}

/// Trade-offs, values at a bound and values that move no prediction, each in a sentence.
#[must_use]
pub fn sentences<M: SessionModel>(model: &M, h: &Hypothesis) -> Vec<String> {
    let fit = &h.fit;
    let (all, c) = (values(model, fit), covariance(fit, fit.variance()));
    if all.len() != c.nrows() {
        return Vec::new();
    }
    let first_value = all.len() - fit.tangents.len();
    let mut out = Vec::new();
    for (k, tangent) in fit.stacked_tangents().iter().enumerate() {
        let name = &all[first_value + k].name;
        if fit.at_bound.get(k) == Some(&true) {
            out.push(format!("{name} is at the end of its physical range."));
        }
        if tangent.norm() < 1e-150 {
            out.push(format!("{name} moves no prediction near its value: the data do not tell where between two readings it lies."));
        }
    }
    let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
    for i in 0..all.len() {
        for j in i + 1..all.len() {
            let r = c[(i, j)] / (c[(i, i)] * c[(j, j)]).sqrt();
            if (all[i].of_effect || all[j].of_effect) && r.abs() > TRADE_OFF && r.is_finite() {
                pairs.push((r.clamp(-1.0, 1.0), i, j));
            }
        }
    }
    pairs.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    out.extend(pairs.into_iter().take(MAX_PAIRS).map(|(r, i, j)| {
        let sign = if r > 0.0 { '-' } else { '+' };
        format!(
            "{a} and {b} trade off (correlation {r:.3}): 0.71 {a} {sign} 0.71 {b}, each in its own standard deviation, is known {times:.0} times \
             better than either.",
            a = all[i].name,
            b = all[j].name,
            times = 1.0 / (1.0 - r.abs()).max(1e-6).sqrt()
        )
    }));
    out
}

/// What the fit and the held-out readings lose without each accepted effect, the others refitted.
#[must_use]
pub fn left_out<M: SessionModel>(
    model: &M,
    whole: &M,
    found: &SearchResult,
    accepted: &Hypothesis,
    noise: &Noise,
    left_out: &[usize],
) -> Vec<EffectAblation> {
    let mut effects: Vec<usize> = accepted.fit.terms.iter().map(|t| t.effect).collect();
    effects.dedup();
    let sealed = whole.scored().contains(&true);
    let sd = noise.reading_sd(&whole.noise_inputs());
    let held_out = |h: &Hypothesis| {
        let predictions = whole.predict(h, &sd).filter(|_| sealed)?;
        Some(rmse(&scored(whole, &predictions, left_out), 0)).filter(|e| e.is_finite())
    };
    let with = held_out(accepted);
    effects
        .into_iter()
        .filter_map(|effect| {
            let terms: Vec<_> = accepted.fit.terms.iter().filter(|t| t.effect != effect).cloned().collect();
            let without = fit(model, &terms, &accepted.weights, 15)?;
            let (a, b) = (&accepted.fit, &without);
            let extra = (b.dof - a.dof).max(1.0) as usize;
            let single = f_test(b.ssr - a.ssr, b.ssr, b.dof, extra);
            Some(EffectAblation {
                id: model.catalogue()[effect].id().to_owned(),
                misfit_ratio: (b.ssr / a.ssr).sqrt(),
                p_value: found.first_test.family.adjusted(single),
                held_out: with,
                held_out_without: held_out(&Hypothesis { fit: without, ..accepted.clone() }),
            })
        })
        .collect()
}
