//! Residual records of every reading, sealed ones included.

use super::frame::{Declared, Frame};
use super::system::ScalarSystem;
use crate::candidate::System;
use crate::engine::search::Hypothesis;
use crate::engine::spread::{Spread, SpreadLaw};
use wcal_core::observation::Role;
use wcal_core::residual::ResidualRecord;

/// Standard deviation of the noise at every row of `all` in units of the repeat noise, by the law found on the rows of `fitted` and with
/// what readings share (its variance `shared`).
#[must_use]
pub fn relative_sd(
    all: &ScalarSystem,
    fitted: &ScalarSystem,
    spread: Option<&Spread>,
    shared: f64,
) -> Vec<f64> {
    let own = match spread {
        None => vec![1.0; all.frame.rows.len()],
        Some(s) => {
            let scale = s.law.scale(&fitted.frame);
            let centre = scale.iter().sum::<f64>() / scale.len() as f64;
            relative_sd_at(&all.frame, s.law, s.exponent, centre)
        }
    };
    own.into_iter().map(|sd| (sd * sd + shared).sqrt()).collect()
}

/// Relative standard deviation at every row of `frame`; one at `centre`.
#[must_use]
pub fn relative_sd_at(frame: &Frame, law: SpreadLaw, exponent: f64, centre: f64) -> Vec<f64> {
    law.scale(frame).iter().map(|v| (exponent * (v - centre)).exp()).collect()
}

fn role(role: Role) -> &'static str {
    match role {
        Role::Rest => "rest",
        Role::Calibration => "calibration",
        Role::Verification => "verification",
        Role::Holdout => "holdout",
    }
}

/// One record a reading of `all`; `sealed` rows were in no fit.
#[must_use]
#[allow(clippy::too_many_arguments)]
pub fn records(
    all: &ScalarSystem,
    fitted: &ScalarSystem,
    sealed: &[bool],
    base: &Hypothesis,
    accepted: &Hypothesis,
    spread: Option<&Spread>,
    shared: f64,
    unit: &str,
) -> Vec<ResidualRecord> {
    let predict = |h: &Hypothesis| {
        all.design(&h.fit.terms)
            .map(|d| d * h.fit.coefficients.column(0))
            .map(|p| p.add_scalar(-all.offset()))
    };
    let (Some(before), Some(after)) = (predict(base), predict(accepted)) else { return Vec::new() };
    let relative = relative_sd(all, fitted, spread, shared);
    let sd = accepted.fit.variance().sqrt();
    let axis = all.frame.declared == Declared::Axis;
    let covariates = all.covariates();
    let flagged: Vec<_> = accepted.flagged.iter().map(|&i| &fitted.frame.rows[i].origin).collect();
    let used: std::collections::BTreeSet<_> = fitted.frame.rows.iter().map(|r| &r.origin).collect();
    let rejection = |i: usize| {
        let origin = &all.frame.rows[i].origin;
        if flagged.contains(&origin) {
            return Some("outlier".to_owned());
        }
        (!sealed[i] && !used.contains(origin)).then(|| "left out of the search: too many readings".to_owned())
    };
    (0..all.frame.rows.len())
        .map(|i| {
            let row = &all.frame.rows[i];
            ResidualRecord {
                source: row.origin.0.clone(),
                line: row.origin.1,
                point: row.origin.2,
                role: role(row.role).to_owned(),
                group: all.frame.groups[i],
                channel: if axis { "error" } else { "response" }.to_owned(),
                unit: unit.to_owned(),
                measured: row.y,
                predicted_before: before[i],
                predicted_after: after[i],
                noise_sd: sd * relative[i],
                rejected: rejection(i),
                covariates: covariates.iter().map(|(n, v)| (n.clone(), v[i])).collect(),
            }
        })
        .collect()
}
