//! `verify` for kinds "transducer" and "axis": admission of the data, the procedure, and what reports and calibration need of it.

use super::admission::{clock_fault, number, refusal, thin};
use super::frame::{Declared, Frame, ScalarData, Scaling};
use super::model::ScalarModel;
use super::parameters::Names;
use super::polynomial::{Polynomial, polynomial};
use super::spread_trend::weak_trend;
use super::stationarity::{Stationarity, stationarity};
use super::system::ScalarSystem;
use crate::error::TraceError;
use crate::method::hypothesis::{Evidence, Hypothesis};
use crate::method::lack_of_fit::LackOfFit;
use crate::method::noise::spread::Spread;
use crate::verify::{Verification, VerifyOptions, verify};
use wcal_core::Unsealing;
use wcal_core::residual::ResidualRecord;
use wcal_core::verify_document::VerifyDocument;

/// Everything that a scalar session's verification found.
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
    pub stationarity: Option<Stationarity>,
    /// Residual standard deviations of the declared and the accepted model.
    pub residual_sd: [f64; 2],
    /// Explanations that were refitted, best first.
    pub evidence: Vec<Evidence>,
    /// The omnibus test's families (catalogue, generic, serial) on the declared and on the best model; none where the data were refused.
    pub gates: Option<[[f64; 3]; 2]>,
    /// Every reading of the session, unsealed ones among them; none where the data were refused.
    pub whole: Option<ScalarSystem>,
    /// Record of the unsealing; none where nothing was sealed.
    pub unsealing: Option<Unsealing>,
}

/// Degree of the polynomial that the accepted effects make of the declared one.
fn degree(system: &ScalarSystem, accepted: &Hypothesis) -> Option<usize> {
    let Declared::Polynomial(declared) = system.frame.declared else { return None };
    let mut powers: Vec<usize> = Vec::new();
    for t in &accepted.fit.terms {
        powers.push(system.effects()[t.effect].degree?);
    }
    powers.sort_unstable();
    let wanted: Vec<usize> = (declared + 1..=declared + powers.len()).collect();
    (powers == wanted && !powers.is_empty()).then_some(declared + powers.len())
}

/// A session whose data cannot be used.
fn refused(session: &str, data: ScalarData<'_>, seed: u64, why: &str) -> ScalarVerification {
    let reason = format!("The data cannot be used: {why}.");
    ScalarVerification {
        document: VerifyDocument::refused(session, data.kind(), reason, seed),
        residuals: Vec::new(),
        declared: None,
        accepted: None,
        model: None,
        lack_of_fit_before: None,
        lack_of_fit_after: None,
        spread: None,
        stationarity: None,
        residual_sd: [f64::NAN; 2],
        evidence: Vec::new(),
        gates: None,
        whole: None,
        unsealing: None,
    }
}

/// Verifies a transducer or axis session; data that cannot be used give the verdict "refused".
///
/// # Errors
/// Where the declared model has no fit, or the explanation to be accepted is not open.
pub fn verify_scalar(
    session: &str,
    data: ScalarData<'_>,
    options: &VerifyOptions,
) -> Result<ScalarVerification, TraceError> {
    let (mut points, sealed, declared) = (data.rows(), data.sealed(), data.declared());
    let clock = clock_fault(points.iter().map(|r| r.t_s));
    number(&mut points);
    let rows = thin(points.clone());
    let scaling = Scaling { count: points.len(), ..Scaling::of(&rows) };
    let scaling = if declared == Declared::Axis { scaling.with_places(&rows) } else { scaling };
    if let Some(why) = clock.or_else(|| refusal(&rows, &sealed, &scaling, declared)) {
        return Ok(refused(session, data, options.search.seed, &why));
    }
    let (stimulus, response) = data.units();
    let names = Names { stimulus, response, covariates: data.covariate_names() };
    let model = ScalarSystem::new(Frame::new(rows, &scaling, declared), &names.covariates)
        .of_session(names.clone(), points);
    let v = verify(model, &sealed, options)?;
    Ok(with_coefficients(session, v, &names, options))
}

/// Adds the coefficients in the stimulus as measured, and what a report shows.
fn with_coefficients(
    session: &str,
    v: Verification<ScalarSystem>,
    names: &Names,
    options: &VerifyOptions,
) -> ScalarVerification {
    let Verification { mut document, model: system, explained, conclusion, unsealed, .. } = v;
    let (found, accepted) = (explained.found, conclusion.accepted);
    document.session = session.to_owned();
    if system.spread().is_none() {
        let remark = weak_trend(&system, &accepted, options);
        document.notes.extend(remark.map(|note| system.frame.declared.format_text(&note)));
    }
    let x: Vec<f64> = system.frame.rows.iter().map(|r| r.x).collect();
    let y: Vec<f64> = system.frame.rows.iter().map(|r| r.y).collect();
    let of_degree = |h: &Hypothesis, degree: usize| polynomial(&x, &y, h.weights.relative(), degree);
    let declared = match system.frame.declared {
        Declared::Polynomial(degree) => of_degree(&found.base, degree),
        Declared::Axis => None,
    };
    let richer = degree(&system, &accepted).and_then(|d| of_degree(&accepted, d));
    let plain = declared.clone().filter(|_| accepted.fit.terms.is_empty());
    let lack = [&found.base, &accepted].map(|h| system.pure_error(h));
    // Where the fit takes its readings for independent, its variance holds what they share already.
    let shared = accepted.weights.shared().map_or(0.0, |_| unsealed.noise.shared_variance());
    let calibration =
        ScalarModel::of(&system, &accepted, system.spread(), shared, names, richer.clone().or(plain), lack);
    ScalarVerification {
        document,
        residuals: v.residuals,
        declared,
        accepted: richer,
        model: Some(calibration),
        lack_of_fit_before: lack[0],
        lack_of_fit_after: lack[1],
        spread: system.spread().cloned(),
        stationarity: stationarity(&system, &accepted),
        residual_sd: [found.base.fit.variance().sqrt(), accepted.fit.variance().sqrt()],
        gates: Some([found.first_test.p_values(), found.last_test.p_values()]),
        evidence: found.evidence,
        whole: Some(v.whole),
        unsealing: v.unsealing,
    }
}
