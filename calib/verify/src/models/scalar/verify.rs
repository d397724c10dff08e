//! `verify` for kinds "transducer" and "axis": admission of the data, the procedure, and what
//! reports and calibration need of it.

use super::admission::{number, thin};
use super::frame::{Declared, Frame, Names, Scaling};
use super::model::ScalarModel;
use super::polynomial::Polynomial;
use super::range_limit::range_limits;
use super::spread_trend::heteroscedasticity_note;
use super::stationarity::{Stationarity, stationarity};
use super::system::ScalarSystem;
use crate::VerifyError;
use crate::method::{LackOfFit, RankedHypothesis, Spread};
use crate::verify::{Verification, Verified, VerifyRequest, verify};
use wcal_core::Sealed;
use wcal_core::observation::{TransducerData, TransducerRow};
use wcal_core::residual::ResidualRecord;
use wcal_core::verify_document::VerifyDocument;

/// Everything that a scalar session's verification found.
#[derive(Default)]
pub struct ScalarVerification {
    /// `verify.json`; `inputs` is for the caller to fill.
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
    pub evidence: Vec<RankedHypothesis>,
    /// The omnibus test's families (catalogue, generic, serial) on the declared and on the best
    /// model; none where the data were refused.
    pub gates: Option<[[f64; 3]; 2]>,
    /// Every reading of the session, unsealed ones among them; none where the data were refused.
    pub whole: Option<ScalarSystem>,
}

/// A session whose data cannot be used.
fn refused(session: &str, data: &TransducerData, seed: u64, why: &str) -> ScalarVerification {
    ScalarVerification {
        document: VerifyDocument::refused(session, data.model.kind().to_string(), why, seed),
        residual_sd: [f64::NAN; 2],
        ..ScalarVerification::default()
    }
}

/// Verifies a transducer or axis session; data that cannot be used give the verdict "refused".
///
/// # Errors
/// Where the declared model has no fit, or the explanation to be accepted is not open.
pub fn verify_scalar(
    session: &str,
    data: &TransducerData,
    sealed: Sealed<TransducerRow>,
    request: &VerifyRequest,
) -> Result<ScalarVerification, VerifyError> {
    let declared = Declared::from(data.model);
    let mut points = declared.rows(&data.rows);
    number(&mut points);
    let limits = range_limits(&points, declared);
    points.retain(|r| !limits.iter().any(|l| l.origins.contains(&r.origin)));
    let rows = thin(points.clone());
    let scaling = Scaling::of_session(&rows, declared, &data.stimulus_unit, points.len());
    let names = Names {
        stimulus: data.stimulus_unit.clone(),
        response: data.response_unit.clone(),
        deviation: data.deviation,
        reference_sd: data.reference_sd,
        covariates: data.covariates.clone(),
    };
    let frame = Frame::new(rows, &scaling, declared, false);
    let model = ScalarSystem::new(frame, &names.covariates).of_session(names, points, limits);
    let verified = verify(model, declared.sealed(sealed), &[], request)?;
    Ok(match verified {
        Verified::Done(v) => for_report(session, *v, request),
        Verified::Refused(why) => refused(session, data, request.search.seed, &why),
    })
}

/// What a report shows of a verification.
fn for_report(
    session: &str,
    v: Verification<ScalarSystem>,
    request: &VerifyRequest,
) -> ScalarVerification {
    let mut document = VerifyDocument {
        session: session.to_owned(),
        ..v.document()
    };
    let system = v.decision.model();
    let (found, accepted) = (
        &v.decision.explained().found,
        &v.decision.conclusion().accepted,
    );
    if system.spread.is_none() {
        let remark = heteroscedasticity_note(system, accepted, request.search.seed);
        document
            .notes
            .extend(remark.map(|note| system.frame.declared.format_text(&note)));
    }
    let [declared, richer] = system.polynomials(&found.base, accepted);
    let lack = [&found.base, accepted].map(|h| system.pure_error(h));
    ScalarVerification {
        document,
        residuals: v.assessment.residuals,
        declared,
        accepted: richer,
        model: Some(v.decision.calibration().clone()),
        lack_of_fit_before: lack[0],
        lack_of_fit_after: lack[1],
        spread: system.spread.clone(),
        stationarity: stationarity(system, accepted),
        residual_sd: [
            found.base.fit.variance().sqrt(),
            accepted.fit.variance().sqrt(),
        ],
        gates: Some([found.first_test.p_values(), found.last_test.p_values()]),
        evidence: found.evidence.clone(),
        whole: Some(v.assessment.whole),
    }
}
