//! `verify` with a second, different measurement: explanations that a sweep over a known object refutes are not searched for again.

use crate::ContactError;
use crate::sweep_witness::{SweepVerdict, SweepWitness};
use wcal_core::verify_document::{SweepExplanation, SweepJudgement, Verdict};
use wcal_core::{InputFile, WhiskerData};
use wcal_trace::MeasurementModel;
use wcal_trace::method::hypothesis::Hypothesis;
use wcal_trace::verify::VerifyOptions;
use wcal_trace::whisker::{PhysicalModel, Verified, WhiskerVerification, verify_whisker};

/// Searches: each leaves out what the ones before it had refuted.
const MAX_SEARCHES: usize = 4;

/// Verifies a whisker session beside a sweep of the same whisker.
///
/// # Errors
/// As `verify_whisker`, or where the sweep cannot judge.
pub fn verify_with_sweep(
    session: &str,
    data: &WhiskerData,
    inputs: &[InputFile],
    options: &VerifyOptions,
    witness: &SweepWitness,
) -> Result<Verified, ContactError> {
    let mut options = options.clone();
    let mut judged: Vec<SweepExplanation> = Vec::new();
    let mut search = 0;
    loop {
        search += 1;
        let mut done = match verify_whisker(session, data, inputs, &options)? {
            Verified::Done(done) => done,
            refused => return Ok(refused),
        };
        let judge = |h: &Hypothesis| of_sweep(witness, &done, h, data);
        // Every surviving explanation, and the declared model.
        let before = judge(&done.found.base)?;
        let open = if done.found.survivors.is_empty() {
            vec![done.found.base.clone()]
        } else {
            done.found.survivors.clone()
        };
        let mut here = Vec::new();
        for h in &open {
            here.push((effects(&done, h), judge(h)?));
        }
        let after = witness.judge(&done.model, &data.whisker)?;
        for (names, verdict) in std::iter::once((Vec::new(), before.clone())).chain(here.iter().cloned()) {
            if !judged.iter().any(|j| j.effects == names) {
                judged.push(explanation(names, &verdict));
            }
        }
        let more = to_leave_out(&here);
        if search < MAX_SEARCHES && !more.is_empty() && options.accept.is_empty() {
            options.refuted.extend(more);
            continue;
        }
        let on_request = !options.accept.is_empty();
        say(&mut done, witness, (&options.refuted, on_request), &judged, &after);
        done.document.sweep = Some(SweepJudgement {
            session: witness.id.clone(),
            samples: after.samples,
            before: before.distance,
            after: after.distance,
            explanations: judged,
        });
        return Ok(Verified::Done(done));
    }
}

/// The calibration of an explanation before the sweep.
fn of_sweep(
    witness: &SweepWitness,
    done: &WhiskerVerification,
    h: &Hypothesis,
    data: &WhiskerData,
) -> Result<SweepVerdict, ContactError> {
    let sd_pm = h.fit.readings_variance().sqrt() * done.whole.noise_factor();
    witness.judge(&PhysicalModel::new(&done.whole, h, sd_pm), &data.whisker)
}

fn effects(done: &WhiskerVerification, h: &Hypothesis) -> Vec<String> {
    h.fit.terms.iter().map(|t| done.whole.catalogue()[t.effect].id.to_owned()).collect()
}

fn explanation(effects: Vec<String>, v: &SweepVerdict) -> SweepExplanation {
    SweepExplanation { effects, distance: v.distance, refuted: v.refuted(), p_value: v.p_value }
}

/// Where every explanation is refuted, the effects that all of them have: while one of them stands, it is the answer.
fn to_leave_out(here: &[(Vec<String>, SweepVerdict)]) -> Vec<String> {
    let [first, others @ ..] = here else { return Vec::new() };
    if here.iter().any(|h| !h.1.refuted()) {
        return Vec::new();
    }
    first.0.iter().filter(|e| others.iter().all(|h| h.0.contains(e))).cloned().collect()
}

/// The sweep has the last word on the verdict.
fn say(
    done: &mut WhiskerVerification,
    witness: &SweepWitness,
    (left_out, on_request): (&[String], bool),
    judged: &[SweepExplanation],
    after: &SweepVerdict,
) {
    let document = &mut done.document;
    if !left_out.is_empty() {
        let nearest = judged.iter().filter(|j| j.refuted).map(|j| j.distance.distance_median_mm);
        let nearest = nearest.fold(f64::INFINITY, f64::min);
        document.reason = format!(
            "The sweep {} refutes {}: with such moments no contact comes nearer to the object than {nearest:.2} mm in the median. Without it: {}",
            witness.id,
            left_out.join(" and "),
            document.reason
        );
    }
    let remain: Vec<String> = judged
        .iter()
        .filter(|j| !j.refuted && !j.effects.is_empty())
        .map(|j| j.effects.join(" with "))
        .collect();
    let open = document.verdict == Verdict::Ambiguous && !on_request && !remain.is_empty();
    if open && judged.iter().any(|j| j.refuted && !j.effects.is_empty()) {
        document.reason = format!(
            "The sweep {} refutes some of the explanations; it leaves {}. {}",
            witness.id,
            remain.join("; "),
            document.reason
        );
    } else if after.refuted() {
        document.reason = format!(
            "The sweep {} refutes the accepted model: the contacts that its moments allow lie {:.2} mm from the object in the median (p = {:.1e}). {}",
            witness.id, after.distance.distance_median_mm, after.p_value, document.reason
        );
        if !matches!(document.verdict, Verdict::Refused) {
            document.verdict = Verdict::UnknownEffect;
        }
    }
}
