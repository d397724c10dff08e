//! `verify`: the residual loop, one procedure for every kind of session. One function a stage, in
//! the order of the work; the numbers are the rows of docs/src/method.md.

mod acceptance;
pub mod assessment;
pub mod conclusion;
mod cross_validate;
mod decision;
pub mod detect;
mod document;
pub mod error_summary;
mod estimate_noise;
mod evidence;
mod explained;
mod fold;
pub mod judgement;
mod left_out;
pub mod prediction_residual;
mod request;
pub(crate) mod sealed_in_fit;
mod session_model;
mod witness;

use crate::error::VerifyError;
use crate::method::search::{
    compare_rivals, project_signatures, refit, screen_subsets, select_model, test_adequacy,
};
pub use assessment::Assessment;
use assessment::assess;
use cross_validate::cross_validate;
pub use decision::Decision;
use decision::decide;
use estimate_noise::{estimate_noise, fit_baseline};
use evidence::MAX_ROUNDS;
pub use explained::Explained;
pub use left_out::FoldCalibrations;
pub use request::VerifyRequest;
pub use session_model::{
    FloorStatement, Folds, HeldOut, Origin, Quantity, SessionModel, SessionText,
};
use wcal_core::Sealed;
use wcal_core::verify_document::VerifyDocument;
pub use witness::Witness;
use witness::test_witnesses;

/// Runs the stages on a model of the open readings; the sealed ones come out once, against a
/// decision that is complete.
///
/// # Errors
/// Where the declared model has no solution at the readings, a witness cannot use its data, the
/// explanation to be accepted is not open, or the ledger cannot be written.
pub fn verify<M: SessionModel>(
    model: M,
    sealed: Sealed<M::Row>,
    witnesses: &[&dyn Witness<M>],
    request: &VerifyRequest,
) -> Result<Verified<M>, VerifyError> {
    // 1 data validation
    if let Some(why) = model.refusal(&sealed) {
        return Ok(Verified::Refused(why));
    }
    // 2 variable projection, gross readings set apart
    let mut e = fit_baseline(model, request)?;
    let found = loop {
        // 4 omnibus test
        while test_adequacy(&e.model, &e.search) {
            // 5 off the nuisances
            let signatures = project_signatures(&e.model, &e.search);
            // 6 on the projected Gram matrix
            let candidates = screen_subsets(&e.model, signatures);
            // 7 full forward model
            let refitted = refit(&e.model, &e.search, &candidates);
            // 8 Akaike, F test of the step, ranges, design
            if !select_model(&e.model, &mut e.search, refitted) {
                break;
            }
        }
        // 3 restricted likelihood; channels, clock, pictures
        e.rounds += 1;
        if e.rounds < MAX_ROUNDS && estimate_noise(&mut e) {
            continue;
        }
        // 10 Cox's test by parametric bootstrap
        let found = compare_rivals(&e.model, &e.search);
        // 9 a sweep over a known object
        match test_witnesses(&mut e, found, witnesses, request)? {
            Some(found) => break found,
            None => continue,
        }
    };
    // 11 keeps what predicts readings left out in turn
    let validated = cross_validate(e, found, request)?;
    // 12 verdict, calibration, claims: complete
    let decision = decide(validated, witnesses, request)?;
    let opened = sealed
        .unseal(decision, &request.ledger)
        .map_err(VerifyError::NoLedger)?;
    // 13 once; nothing can be chosen after it
    let (decision, assessment) = opened.assess(assess);
    Ok(Verified::Done(Box::new(Verification {
        decision,
        assessment: assessment?,
    })))
}

/// A session's result, or why its data cannot be used.
pub enum Verified<M: SessionModel> {
    /// The stages ran.
    Done(Box<Verification<M>>),
    /// The data were refused, and why.
    Refused(String),
}

/// Everything that `verify` found.
pub struct Verification<M: SessionModel> {
    /// What was decided on the open readings.
    pub decision: Decision<M>,
    /// What the sealed readings say of it.
    pub assessment: Assessment<M>,
}

impl<M: SessionModel> Verification<M> {
    /// verify.json, without session and files.
    pub fn document(&self) -> VerifyDocument {
        document::document(&self.decision, &self.assessment)
    }
}
