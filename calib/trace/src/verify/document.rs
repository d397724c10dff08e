//! verify.json from what the stages found.

use super::conclusion::{Conclusion, ids, laws};
use super::detect;
use super::held_out::{Errors, Unsealed};
use super::identifiability;
use super::noise_report::{noise_document, noise_sentences};
use super::session_model::{FloorStatement, SessionModel};
use crate::method::explain::Explained;
use crate::method::hypothesis::Hypothesis;
use wcal_core::verify_document::{FlaggedReading, TwinCheck, TwinFault, Verdict, VerifyDocument};

/// The document; session, files and mark are the caller's.
#[allow(clippy::too_many_arguments, reason = "one argument a stage, in their order")]
pub fn document<M: SessionModel>(
    model: &M,
    whole: &M,
    explained: &Explained,
    conclusion: &Conclusion,
    faults: &[TwinFault],
    floor: &FloorStatement,
    unsealed: &Unsealed<M::Predictions>,
    errors: &Errors,
    seed: u64,
) -> VerifyDocument {
    let found = &explained.found;
    let between = model.between_sessions(&conclusion.accepted);
    let noise = (!explained.exact).then(|| noise_document(&unsealed.noise, between, &model.unit()));
    let rivals: Vec<&Hypothesis> = conclusion.rivals.iter().collect();
    let next = (conclusion.verdict == Verdict::Ambiguous && !rivals.is_empty())
        .then(|| model.next_measurement(&found.best, &rivals));
    let test = if ids(model, &conclusion.accepted) == ids(model, &found.best) {
        &found.last_test
    } else {
        &found.first_test
    };
    let fit = if std::ptr::eq(test, &found.last_test) { &found.best.fit } else { &found.base.fit };
    let second = model.second_witness(found, &conclusion.accepted);
    VerifyDocument {
        effects: conclusion.effects.clone(),
        alternatives: conclusion.alternatives.clone(),
        unknown: conclusion.unknown.clone(),
        twin: TwinCheck { faults: faults.to_vec() },
        noise_floor: floor.floor.clone(),
        flagged: flagged(model, whole, conclusion, unsealed),
        before: errors.before.clone(),
        after: errors.after.clone(),
        after_trimmed: errors.trimmed.as_ref().and_then(|[_, after]| after.clone()),
        coverage95: errors.coverage95,
        next_measurement: next.flatten(),
        detectable: detect::table(model, fit, test),
        notes: notes(model, explained, conclusion, floor, &noise, errors),
        leave_one_effect_out: identifiability::left_out(
            model,
            whole,
            found,
            &conclusion.accepted,
            &unsealed.noise,
            &unsealed.left_out,
        ),
        witness: second.as_ref().and_then(|s| s.decided.clone()),
        pictures: second,
        noise,
        verdict: conclusion.verdict,
        ..VerifyDocument::refused("", model.kind(), reason(model, conclusion, floor, errors), seed)
    }
}

/// The verdict's reason, caveats and how the errors were found.
fn reason<M: SessionModel>(model: &M, c: &Conclusion, floor: &FloorStatement, errors: &Errors) -> String {
    let caveat = model.caveat(&c.accepted).map_or_else(String::new, |text| format!(" {text}"));
    format!("{}{caveat}{}{}", c.reason, floor.reason, model.format_text(&errors.remark))
}

/// Readings that count in no fit or no held-out error.
fn flagged<M: SessionModel>(
    model: &M,
    whole: &M,
    conclusion: &Conclusion,
    unsealed: &Unsealed<M::Predictions>,
) -> Vec<FlaggedReading> {
    let of = |m: &M, i: usize| {
        let origin = m.origin(i);
        FlaggedReading { source: origin.source, point: origin.point }
    };
    let fitted = conclusion.accepted.flagged.iter().map(|&i| of(model, i));
    fitted.chain(unsealed.left_out.iter().map(|&i| of(whole, i))).collect()
}

fn notes<M: SessionModel>(
    model: &M,
    explained: &Explained,
    conclusion: &Conclusion,
    floor: &FloorStatement,
    noise: &Option<wcal_core::verify_document::NoiseDocument>,
    errors: &Errors,
) -> Vec<String> {
    let mut notes: Vec<String> = floor.note.iter().cloned().collect();
    let points: Vec<String> =
        conclusion.accepted.flagged.iter().map(|&i| model.origin(i).point.to_string()).collect();
    if !points.is_empty() {
        notes.push(format!(
            "Readings marked and left out of the fit (kept in the table): points {}.",
            points.join(", ")
        ));
    }
    notes.extend(explained.found.not_converged.iter().map(|effects| {
        format!("The fit of {} did not converge: it is not among the explanations.", effects.join(" with "))
    }));
    notes.extend(not_identified(model, explained));
    notes.extend(other_laws(model, explained, conclusion));
    notes.extend(noise.iter().flat_map(noise_sentences));
    notes.extend(model.notes(&explained.found, &conclusion.accepted));
    let quantity = model.quantities()[0];
    notes.extend(errors.further.iter().filter_map(|(name, e)| {
        let value = e.rmse.get(quantity.key)?;
        Some(
            format!("Held-out error ({}), {name}: {value:.4} {}", quantity.key, quantity.unit)
                .trim_end()
                .to_owned()
                + ".",
        )
    }));
    notes
}

/// Effects that describe the readings better than what is named, each once: a name is none where the design does not tell it.
fn not_identified<M: SessionModel>(model: &M, explained: &Explained) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for n in &explained.found.not_identified {
        let sentence =
            format!("{} is not named: {}.", model.catalogue()[n.effect].id, model.format_text(&n.why));
        if !out.contains(&sentence) {
            out.push(sentence);
        }
    }
    out
}

/// Laws of the accepted names by which the data could be described as well: columns or clocks that this session does not tell apart.
fn other_laws<M: SessionModel>(model: &M, explained: &Explained, conclusion: &Conclusion) -> Option<String> {
    let accepted = &conclusion.accepted;
    let own = laws(model, accepted);
    let same = |h: &&Hypothesis| ids(model, h) == ids(model, accepted) && laws(model, h) != own;
    let others: Vec<String> =
        explained.found.survivors.iter().filter(same).map(|h| laws(model, h).join(" with ")).collect();
    (!others.is_empty() && !own.is_empty())
        .then(|| format!("{} cannot be distinguished from {}.", own.join(" with "), others.join(" or ")))
}
