//! Which terms of an explanation the data support: each passes, beside the others, the level at which the search names, and the joint 95 % region of
//! its amplitudes does not hold zero.

use super::session_model::SessionModel;
use crate::effect::Role;
use crate::levels::CATALOGUE;
use crate::method::distributions::f_tail;
use crate::method::fit::Fit;
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use crate::method::search_result::SearchResult;
use nalgebra::{DMatrix, DVector};

/// `h` without the terms that are none: beside the others each has to pass the level at which the search names. The least supported one
/// first; itself where all are.
pub fn drop_unsupported<M: SessionModel>(model: &M, found: &SearchResult, h: &Hypothesis) -> Hypothesis {
    let weakest = |kept: &Hypothesis, dropped: Vec<(usize, Hypothesis)>| {
        let judged = dropped.into_iter().map(|d| (d.1.removal_p(&kept.fit, &found.first_test.family), d));
        let none = |(p, (term, _)): &(f64, (usize, Hypothesis))| {
            *p >= CATALOGUE || amplitudes_hold_zero(model, &kept.fit, *term)
        };
        judged.filter(none).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, d)| d)
    };
    h.eliminate(model, weakest).0
}

/// The joint 95 % region of a term's amplitudes, linear coefficients among them, holds zero (Wald). Each by itself may well hold it: sine and
/// cosine of an error whose period is not known exactly do.
fn amplitudes_hold_zero<M: SessionModel>(model: &M, fit: &Fit, term: usize) -> bool {
    let (q, channels) = (fit.design.ncols(), fit.residual.ncols());
    let (slots, of) = (&fit.slots(model.catalogue())[term], &fit.terms[term]);
    let law = model.catalogue()[of.effect].law(of.law);
    let linear = slots.columns.clone();
    let linear = linear.flat_map(|j| (0..channels).map(move |k| (fit.coefficients[(j, k)], k * q + j)));
    let values = law.parameters.iter().zip(of.values.iter().zip(slots.values.clone()));
    let values = values
        .filter(|(p, _)| matches!(p.role, Role::Amplitude { .. }))
        .map(|(_, (value, k))| (*value, q * channels + k));
    let amplitudes: Vec<(f64, usize)> = linear.chain(values).collect();
    let (n, c) = (amplitudes.len(), covariance(fit, fit.variance()));
    let values = DVector::from_iterator(n, amplitudes.iter().map(|a| a.0));
    let spread = DMatrix::from_fn(n, n, |i, j| c[(amplitudes[i].1, amplitudes[j].1)]);
    let Some(factor) = spread.cholesky() else { return true };
    let f = values.dot(&factor.solve(&values)) / n as f64;
    f_tail(f, [n as f64, fit.dof]).is_none_or(|p| p >= 0.05)
}
