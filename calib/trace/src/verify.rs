//! `verify`: the residual loop, one procedure for every kind of session. One function a stage, in the order of the work; docs/src/method.md has the same
//! stages.

mod acceptance;
pub mod assessment;
pub mod conclusion;
mod decision;
pub mod detect;
mod document;
pub mod error_summary;
pub mod estimate_noise;
mod evidence;
pub mod held_out;
pub mod judgement;
pub mod noise_report;
pub mod options;
mod refutation;
pub(crate) mod sealed_in_fit;
pub mod session_model;
mod support;
pub mod witness;

use crate::error::TraceError;
use crate::method::search::{project_signatures, refit, screen_subsets, select_model, test_adequacy};
pub use assessment::Assessment;
use assessment::assess;
pub use decision::Decision;
use decision::decide;
use estimate_noise::{estimate_noise, explained, fit_baseline};
pub use evidence::Explained;
pub use options::VerifyRequest;
pub use session_model::{HeldOut, SessionModel, SessionText};
use wcal_core::Sealed;
use wcal_core::verify_document::VerifyDocument;
pub use witness::Witness;
use witness::test_witnesses;

/// Searches at most: each is made under the noise and the instrument that the one before shows.
const MAX_ROUNDS: usize = 5;

/// Runs the stages on a model of the open readings; the sealed ones come out once, against a decision that is complete.
///
/// # Errors
/// Where the declared model has no solution at the readings, a witness cannot use its data, the explanation to be accepted is not open, or the ledger
/// cannot be written.
pub fn verify<M: SessionModel>(
    model: M,
    sealed: Sealed<M::Row>,
    witnesses: &[&dyn Witness<M>],
    request: &VerifyRequest,
) -> Result<Verification<M>, TraceError> {
    let mut e = fit_baseline(model, request)?;
    let mut round = 1;
    let found = loop {
        while test_adequacy(&e.model, &e.search) {
            let signatures = project_signatures(&e.model, &e.search);
            let candidates = screen_subsets(&e.model, signatures);
            let refitted = refit(&e.model, &e.search, &candidates);
            if !select_model(&e.model, &mut e.search, refitted) {
                break;
            }
        }
        let last = round == MAX_ROUNDS;
        round += 1;
        if !last && estimate_noise(&mut e) {
            continue;
        }
        let mut found = e.search.compare_rivals(&e.model);
        if !test_witnesses(&mut e, &mut found, witnesses, request)? || last {
            break found;
        }
    };
    let (model, explained) = explained(e, found)?;
    let decision = decide(model, explained, witnesses, request)?;
    let opened = sealed.unseal(decision, &request.ledger).map_err(TraceError::NoLedger)?;
    let (decision, assessment) = opened.assess(assess);
    Ok(Verification { decision, assessment: assessment? })
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
