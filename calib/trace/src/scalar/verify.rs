//! `wcal verify` for one value a reading: the stages in order.

use super::admission::{clock_fault, number, refusal, thin};
use super::floor::{noise_floor, replicate_keys};
use super::frame::{Declared, Frame, ScalarData, ScalarRow, Scaling};
use super::held_out::{HeldOut, coverage95, cross_validate, folds, on_sealed, summarise};
use super::model::ScalarModel;
use super::notes::notes;
use super::parameters::Names;
use super::polynomial::{LackOfFit, Polynomial, lack_of_fit, polynomial};
use super::steadiness::{Steadiness, UNSTEADY, steadiness};
use super::system::ScalarSystem;
use super::verdict::{Conclusion, conclude};
use super::{detect, next, records};
use crate::candidate::System;
use crate::engine::atoms::nuisance;
use crate::engine::explain::{Explained, explain};
use crate::engine::search::{Evidence, Found, Hypothesis, Options};
use crate::engine::spread::{SPREAD_LEVEL, SPREAD_REMARK, Spread, spread_test};
use crate::verify::noise_report::{noise_document, noise_sentences};
use wcal_core::residual::ResidualRecord;
use wcal_core::verify_document::{FlaggedReading, Verdict, VerifyDocument};

/// Settings of the loop.
#[derive(Debug, Clone, Copy)]
pub struct ScalarOptions {
    /// Search: seed, null draws a family, effects in one explanation.
    pub search: Options,
    /// Permutations of the spread test.
    pub permutations: usize,
}

impl Default for ScalarOptions {
    fn default() -> Self {
        Self { search: Options::default(), permutations: 4999 }
    }
}

/// Why no document could be made.
#[derive(Debug, thiserror::Error, Clone, PartialEq)]
pub enum ScalarError {
    /// The declared model has no fit on rows that passed the checks.
    #[error("fitting the declared model: expected a finite solution on {rows} readings, found none")]
    NoFit {
        /// Readings.
        rows: usize,
    },
}

/// Everything that a scalar session's verification found.
#[derive(Debug, Clone)]
pub struct ScalarVerification {
    /// `verify.json`; `inputs` is left for the caller.
    pub document: VerifyDocument,
    /// One record a reading, sealed ones included, in the order of the measurement.
    pub residuals: Vec<ResidualRecord>,
    /// Declared model as a polynomial in the stimulus (none for an axis).
    pub declared: Option<Polynomial>,
    /// Accepted model, where it is a polynomial of higher degree than the declared one.
    pub accepted: Option<Polynomial>,
    /// The accepted model for predictions; none where the data were refused.
    pub model: Option<ScalarModel>,
    /// Lack of fit of the declared model against replicates.
    pub lack_of_fit_before: Option<LackOfFit>,
    /// Lack of fit of the accepted model.
    pub lack_of_fit_after: Option<LackOfFit>,
    /// Trend of the spread, tested on the accepted model's residuals.
    pub spread: Option<Spread>,
    /// Halves compared, where a period was accepted.
    pub steadiness: Option<Steadiness>,
    /// Residual standard deviations of the declared and the accepted model.
    pub residual_sd: [f64; 2],
    /// Explanations that were refitted, best first.
    pub evidence: Vec<Evidence>,
    /// The gate's families (catalogue, generic, serial) on the declared and on the best model; none where the data were refused.
    pub gates: Option<[[f64; 3]; 2]>,
}

/// A residual below this share of the largest response is rounding.
const ROUNDING: f64 = 1e-13;

/// Residuals of a fit, each divided by the share of its variance that the fit leaves; unweighted.
fn standardised(h: &Hypothesis) -> Vec<f64> {
    let basis = nuisance(&h.fit);
    (0..h.fit.residual.nrows())
        .map(|i| {
            let leverage: f64 = basis.vectors().iter().map(|q| q[i] * q[i]).sum();
            // What neighbours share is taken out, the law of the spread is not.
            let own = h.weights.of(i).max(1e-300);
            h.fit.residual[(i, 0)] / own / (1.0 - leverage).max(0.05).sqrt()
        })
        .collect()
}

fn test_spread(frame: &Frame, h: &Hypothesis, options: &ScalarOptions) -> Option<Spread> {
    let kept: Vec<usize> = (0..frame.rows.len()).filter(|&i| h.weights.counts(i)).collect();
    let residual = standardised(h);
    let pick = |f: &dyn Fn(usize) -> f64| kept.iter().map(|&i| f(i)).collect::<Vec<f64>>();
    let x = pick(&|i| frame.rows[i].x);
    let mut spread = spread_test(
        &pick(&|i| residual[i]),
        &x,
        &pick(&|i| frame.u[i]),
        options.permutations,
        options.search.seed,
    )?;
    // Readings that do not count keep the mean spread.
    let mut relative = vec![1.0; frame.rows.len()];
    for (&i, sd) in kept.iter().zip(&spread.relative_sd) {
        relative[i] = *sd;
    }
    spread.relative_sd = relative;
    Some(spread)
}

/// Search with equal weights; where the spread turns out to follow the stimulus, again with the readings weighted by it.
fn look(system: ScalarSystem, options: &ScalarOptions) -> Option<(ScalarSystem, Explained, Option<Spread>)> {
    let plain = explain(&system, &options.search)?;
    // A period that is not steady leaves more toward the ends: that is no law of the noise.
    let of = |e: &Explained, system: &ScalarSystem| {
        test_spread(&system.frame, &e.found.best, options)
            .filter(|s| s.p_value <= SPREAD_LEVEL)
            .filter(|_| steadiness(system, &e.found.best).is_none_or(|s| s.z <= UNSTEADY))
    };
    let Some(spread) = of(&plain, &system) else { return Some((system, plain, None)) };
    let weighted_system = system.with_spread(&spread.relative_sd);
    let weighted = explain(&weighted_system, &options.search)?;
    // The trend must outlive the effects that the weighted search adds.
    match of(&weighted, &weighted_system) {
        Some(again) => {
            let spread = Spread { relative_sd: spread.relative_sd, ..again };
            Some((weighted_system, weighted, Some(spread)))
        }
        None => {
            let n = weighted_system.frame.rows.len();
            Some((weighted_system.with_spread(&vec![1.0; n]), plain, None))
        }
    }
}

/// A trend of the spread too weak to be called an effect.
fn remark(spread: Option<Spread>) -> Option<String> {
    let p = spread.filter(|s| s.p_value <= SPREAD_REMARK)?.p_value;
    Some(format!(
        "The spread of the readings may change with the stimulus (p = {p:.1e}): too weak to be named."
    ))
}

/// Degree of the polynomial that the accepted effects make of the declared one.
fn degree(system: &ScalarSystem, accepted: &Hypothesis) -> Option<usize> {
    let Declared::Polynomial(declared) = system.frame.declared else { return None };
    let mut powers: Vec<usize> = Vec::new();
    for t in &accepted.fit.terms {
        powers.push(match system.catalogue()[t.effect].id() {
            "scale" => 1,
            "nonlinearity-quadratic" => 2,
            "nonlinearity-cubic" => 3,
            _ => return None,
        });
    }
    powers.sort_unstable();
    let wanted: Vec<usize> = (declared + 1..=declared + powers.len()).collect();
    (powers == wanted && !powers.is_empty()).then_some(declared + powers.len())
}

fn refused(session: &str, data: &ScalarData, seed: u64, why: String) -> ScalarVerification {
    ScalarVerification {
        document: document(session, data, seed, Verdict::Refused, format!("The data cannot be used: {why}.")),
        residuals: Vec::new(),
        declared: None,
        accepted: None,
        model: None,
        lack_of_fit_before: None,
        lack_of_fit_after: None,
        spread: None,
        steadiness: None,
        residual_sd: [f64::NAN; 2],
        evidence: Vec::new(),
        gates: None,
    }
}

fn document(session: &str, data: &ScalarData, seed: u64, verdict: Verdict, reason: String) -> VerifyDocument {
    VerifyDocument { verdict, ..VerifyDocument::refused(session, data.kind(), reason, seed) }
}

/// Held-out errors of the declared and the accepted model, the split and how to say it.
fn held_out(
    system: &ScalarSystem,
    sealed: Option<(&ScalarSystem, &[bool])>,
    found: &Found,
    accepted: &Hypothesis,
    spread: Option<&Spread>,
    shared: f64,
) -> ([Vec<HeldOut>; 2], &'static str, String) {
    if let Some((all, mask)) = sealed {
        // The sealed readings' spread follows the same law of the stimulus.
        let relative = records::relative_sd(all, system, spread, shared);
        let rows = [&found.base.fit, &accepted.fit].map(|f| on_sealed(all, f, mask, &relative));
        return (rows, "holdout", "on the sealed readings".to_owned());
    }
    let folds = folds(&system.frame);
    // Readings marked as outliers count in neither.
    let mut plain = found.base.weights.clone();
    for &i in &accepted.flagged {
        plain = plain.masked(|k| k != i);
    }
    let before = cross_validate(system, &[], &plain, &folds);
    let after = cross_validate(system, &accepted.fit.terms, &accepted.weights, &folds);
    let words = format!(
        "{}; effects were chosen with all readings, their sizes refitted without those left out",
        folds.words
    );
    ([before, after], folds.split, words)
}

/// Runs every stage on a transducer or axis session.
///
/// # Errors
/// [`ScalarError::NoFit`]; data that cannot be used give the verdict "refused" instead.
pub fn verify_scalar(
    session: &str,
    data: ScalarData,
    options: &ScalarOptions,
) -> Result<ScalarVerification, ScalarError> {
    let (mut rows, mut sealed_rows) = data.rows();
    let seed = options.search.seed;
    let declared = data.declared();
    let total = rows.len();
    let clock = clock_fault(rows.iter().map(|r| r.t_s));
    number(&mut rows);
    // Sealed readings go on behind, unless the clock says otherwise.
    number(&mut sealed_rows);
    for r in &mut sealed_rows {
        r.place = r.place.map(|p| p + total);
    }
    let everything: Vec<ScalarRow> = rows.iter().chain(&sealed_rows).cloned().collect();
    let rows = thin(rows);
    let scaling = Scaling { count: total, ..Scaling::of(&rows) };
    if let Some(why) = clock {
        return Ok(refused(session, &data, seed, why));
    }
    if let Some(why) = refusal(&rows, &sealed_rows, &scaling, declared) {
        return Ok(refused(session, &data, seed, why));
    }
    let names_of = data.covariate_names();
    let (stimulus, response) = data.units();
    let names = Names { stimulus, response, covariates: names_of.clone() };

    // The sealed readings are in `all` only, whose measured values no fit sees.
    let system = ScalarSystem::new(Frame::new(rows, &scaling, declared), &names_of);
    let all = system.on(Frame::new(everything, &scaling, declared));
    let origins: Vec<_> = sealed_rows.iter().map(|r| &r.origin).collect();
    let mask: Vec<bool> = all.frame.rows.iter().map(|r| origins.contains(&&r.origin)).collect();

    // Search, spread, verdict.
    let rows = system.frame.rows.len();
    let no_fit = || ScalarError::NoFit { rows };
    let (system, explained, spread) = look(system, options).ok_or_else(no_fit)?;
    let Explained { mut found, noise, .. } = explained;
    let exact = exactly_fits(&system, &found.base);
    if exact {
        found.best = found.base.clone();
    }
    let keys = replicate_keys(&system.frame);
    let lack = |h: &Hypothesis| {
        let parameters = h.fit.design.ncols() + h.fit.tangents.len();
        let residual: Vec<f64> = h.fit.residual.column(0).iter().copied().collect();
        lack_of_fit(&residual, &keys, h.weights.relative(), parameters)
    };
    let lack_of_fit_before = lack(&found.base);
    let mut c = conclude(&system, &found, spread.as_ref(), lack(&found.best).as_ref(), &names);
    if exact {
        c = exact_conclusion(&found.base);
    }
    let lack_of_fit_after = lack(&c.accepted);

    // Held-out errors, floor, table of detectable sizes.
    let shared = if exact { 0.0 } else { noise.shared_variance() };
    let sealed = mask.iter().any(|m| *m).then_some((&all, mask.as_slice()));
    let ([before, after], split, words) =
        held_out(&system, sealed, &found, &c.accepted, spread.as_ref(), shared);
    let (after, words) = match sealed_rise([&before, &after])
        .filter(|_| split == "holdout" && !c.effects.is_empty())
    {
        // The sealed error has the last word.
        Some([low, high]) => {
            let names: Vec<&str> = c.effects.iter().map(|e| e.id.as_str()).collect();
            c.reason = format!(
                "The readings asked for {}, but with it the error on the sealed readings rises from {low:.4e} to {high:.4e}: it is not accepted.",
                names.join(" and ")
            );
            c = Conclusion { verdict: Verdict::Adequate, reason: c.reason, ..exact_conclusion(&found.base) };
            (before.clone(), words)
        }
        None => (after, words),
    };
    let key = if declared == Declared::Axis { "error_rmse_um" } else { "response_rmse" };
    let mut doc = document(
        session,
        &data,
        seed,
        c.verdict,
        format!("{} Held-out errors: {}.", c.reason, declared.worded(&words)),
    );
    doc.before = summarise(&before, split, key, seed);
    doc.after = summarise(&after, split, key, seed);
    doc.coverage95 = coverage95(&after);
    let floor = noise_floor(&system.frame, &c.accepted, shared);
    doc.noise_floor.source = floor.map_or("none", |f| f.source).to_owned();
    let sd = floor.map(|f| f.sd);
    if declared == Declared::Axis {
        doc.noise_floor.error_um = sd
    } else {
        doc.noise_floor.response = sd
    }
    let gate = if c.accepted.fit.terms.len() == found.best.fit.terms.len() {
        &found.last_gate
    } else {
        &found.first_gate
    };
    if !exact {
        let parts = noise_document(&noise, &names.response);
        doc.notes.extend(noise_sentences(&parts));
        doc.noise = Some(parts);
    }
    doc.flagged = c
        .accepted
        .flagged
        .iter()
        .map(|&i| {
            let origin = &system.frame.rows[i].origin;
            FlaggedReading { source: origin.0.clone(), point: origin.2 }
        })
        .collect();
    doc.detectable = detect::table(&system, &c.accepted.fit, gate, &names);
    doc.next_measurement = next::next_measurement(&system, &c);
    let steadiness = steadiness(&system, &c.accepted);
    notes(
        &mut doc,
        &system,
        &c,
        steadiness.as_ref(),
        spread.as_ref(),
        [lack_of_fit_before.as_ref(), lack_of_fit_after.as_ref()],
        total,
    );
    if spread.is_none() {
        doc.notes.extend(
            remark(test_spread(&system.frame, &c.accepted, options)).map(|note| declared.worded(&note)),
        );
    }
    doc.effects = c.effects.clone();
    doc.alternatives = c.alternatives.clone();
    doc.unknown = c.unknown.clone();

    // Coefficients as measured, records.
    let x: Vec<f64> = system.frame.rows.iter().map(|r| r.x).collect();
    let y: Vec<f64> = system.frame.rows.iter().map(|r| r.y).collect();
    let base_degree = if let Declared::Polynomial(d) = declared { d } else { 0 };
    let declared_polynomial = polynomial(&x, &y, found.base.weights.relative(), base_degree)
        .filter(|_| matches!(declared, Declared::Polynomial(_)));
    let accepted =
        degree(&system, &c.accepted).and_then(|d| polynomial(&x, &y, c.accepted.weights.relative(), d));
    let residual_sd = [found.base.fit.variance().sqrt(), c.accepted.fit.variance().sqrt()];
    Ok(ScalarVerification {
        residuals: records::records(
            &all,
            &system,
            &mask,
            &found.base,
            &c.accepted,
            spread.as_ref(),
            shared,
            &names.response,
        ),
        model: Some(ScalarModel::of(
            &system,
            &c.accepted,
            spread.as_ref(),
            shared,
            &names,
            accepted
                .clone()
                .or_else(|| declared_polynomial.clone().filter(|_| c.accepted.fit.terms.is_empty())),
            [lack_of_fit_before, lack_of_fit_after],
        )),
        declared: declared_polynomial,
        accepted,
        document: doc,
        lack_of_fit_before,
        lack_of_fit_after,
        spread,
        steadiness,
        residual_sd,
        gates: Some([found.first_gate.families(), found.last_gate.families()]),
        evidence: found.evidence,
    })
}

/// Rise of the sealed error with which accepted effects are no explanation.
const SEALED_RISE: f64 = 1.1;

/// Held-out errors before and after, where the second is larger.
fn sealed_rise(rows: [&[HeldOut]; 2]) -> Option<[f64; 2]> {
    let rms = rows.map(|r| (r.iter().map(|h| h.error * h.error).sum::<f64>() / r.len().max(1) as f64).sqrt());
    (rms[1] > SEALED_RISE * rms[0]).then_some(rms)
}

/// Nothing but rounding is left: structure in it means nothing.
fn exactly_fits(system: &ScalarSystem, base: &Hypothesis) -> bool {
    let largest = system.measured().iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    base.fit.residual.iter().all(|r| r.abs() <= ROUNDING * largest)
}

fn exact_conclusion(base: &Hypothesis) -> Conclusion {
    Conclusion {
        verdict: Verdict::Adequate,
        reason: "The declared model fits to the last digit.".to_owned(),
        effects: Vec::new(),
        alternatives: Vec::new(),
        rivals: Vec::new(),
        unknown: None,
        accepted: base.clone(),
    }
}
