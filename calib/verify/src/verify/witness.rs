//! Sources of data beside the readings, that hypotheses about the same instrument are held against.

use super::evidence::{Evidence, MAX_ROUNDS};
use super::request::VerifyRequest;
use super::session_model::SessionModel;
use crate::error::VerifyError;
use crate::method::hypothesis::{Gate, Hypothesis, Rejection};
use crate::method::search_result::SearchResult;
use wcal_core::verify_document::WitnessTest;

/// A measurement of the same instrument with its own noise.
pub trait Witness<M: SessionModel>: Sync {
    /// How unlikely its data are if `h` is right within its uncertainty; none where it cannot tell.
    ///
    /// # Errors
    /// Where its data cannot be used.
    fn test(&self, model: &M, h: &Hypothesis) -> Result<Option<WitnessTest>, VerifyError>;
}

/// Holds the declared model and every explanation that remains against each witness. What a witness
/// refutes no longer remains. None where it refutes all that remain: effects that all of them have
/// are left out, and the search begins anew, since while one of them stands it is the answer.
///
/// # Errors
/// Where a witness cannot use its data.
pub(crate) fn test_witnesses<M: SessionModel>(
    e: &mut Evidence<M>,
    mut found: SearchResult,
    witnesses: &[&dyn Witness<M>],
    request: &VerifyRequest,
) -> Result<Option<SearchResult>, VerifyError> {
    let mut more: Vec<String> = Vec::new();
    for witness in witnesses {
        test(*witness, &e.model, &found.base, &mut e.tests)?;
        let mut refuted = Vec::new();
        for h in &found.survivors {
            refuted.push(test(*witness, &e.model, h, &mut e.tests)?.is_some_and(|t| t.refuted));
        }
        // What is to be accepted by request is judged when it is accepted.
        if !refuted.contains(&true) || !request.accept.is_empty() {
            continue;
        }
        let (gone, left): (Vec<_>, Vec<_>) = found
            .survivors
            .iter()
            .cloned()
            .zip(refuted)
            .partition(|(_, refuted)| *refuted);
        let names: Vec<Vec<String>> = gone
            .iter()
            .map(|(h, _)| h.term_ids(e.model.catalogue()))
            .collect();
        if left.is_empty() {
            // What only some of them have may be right: all of the refuted share the wrong one.
            let shared = |id: &&String| names.iter().all(|effects| effects.contains(id));
            more.extend(names[0].iter().filter(shared).cloned());
        } else {
            found.survivors = left.into_iter().map(|(h, _)| h).collect();
            found.best = found.survivors[0].clone();
        }
        let rejected = |effects| Rejection {
            effects,
            gate: Gate::Witness,
            why: String::new(),
        };
        e.rejections.extend(names.into_iter().map(rejected));
    }
    if more.is_empty() || e.rounds >= MAX_ROUNDS {
        return Ok(Some(found));
    }
    e.refuted.extend(more);
    let model = e.model.without(&e.refuted);
    Ok(if e.begin_anew(model) {
        None
    } else {
        Some(found)
    })
}

/// What a witness says of `h`, kept in `tests` where it is new.
pub(crate) fn test<M: SessionModel>(
    witness: &dyn Witness<M>,
    model: &M,
    h: &Hypothesis,
    tests: &mut Vec<WitnessTest>,
) -> Result<Option<WitnessTest>, VerifyError> {
    let effects = h.term_ids(model.catalogue());
    let Some(test) = witness.test(model, h)? else {
        return Ok(None);
    };
    let test = WitnessTest { effects, ..test };
    if tests
        .iter()
        .all(|t| (&t.witness, &t.effects) != (&test.witness, &test.effects))
    {
        tests.push(test.clone());
    }
    Ok(Some(test))
}
