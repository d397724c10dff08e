//! Two contacts at once, 3 mm apart or more (`SweepSample::contacts`): how well the two moments distinguish them from one, on SIMULATED
//! sweeps.
//!
//! At any one time a single contact explains any two moments: the curve of inverse solutions has a point for every arc length. Only the change of
//! the moments over time can rule out one contact on a rigid body: the Bayes filter's evidence. The test is
//!
//! ```text
//! two contacts  <=>  log p(m_t | m_1 .. m_{t-1}, one contact) < limit,   limit = argmax F1 on other sweeps
//! ```
//!
//! and with the true count of the sample before, the share of two in each bin of (count before, evidence).

use crate::filter::{BayesFilter, BayesSettings};
use crate::inverse::StaticInverse;
use crate::score::{Detection, detection};
use crate::sweep_series::{SweepSample, SweepSeries};
use crate::tracker::{Sample, Tracker};
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;

/// A sample with contact.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactEvidence {
    /// Logarithm of the filter's evidence for one contact; 0 where it had no prediction.
    pub log_evidence: f64,
    /// Whether there were two contacts or more one sample before.
    pub two_before: bool,
    /// Whether there are two or more.
    pub two: bool,
}

/// All samples with contact; the base's speed is known. `given_truth`: before each step the filter is given the true place of the contact. That bounds
/// what this evidence can show; a model of two contacts might show more.
#[must_use]
pub fn contact_evidence<'a>(
    inverse: &StaticInverse,
    all_series: impl Iterator<Item = &'a SweepSeries>,
    settings: BayesSettings,
    given_truth: bool,
) -> Vec<ContactEvidence> {
    let all_series: Vec<&SweepSeries> = all_series.collect();
    let one = |series: &&SweepSeries| {
        let mut filter = BayesFilter::new(inverse, settings);
        let (mut last_s, mut two_before) = (0.0, false);
        let mut found = Vec::new();
        for i in &series.samples {
            let dt_s = i.t_s - std::mem::replace(&mut last_s, i.t_s);
            filter.step(dt_s, i.moment_nmm, Some(i.speed_mm_s));
            let two = i.contacts >= 2;
            if let Some(truth) = i.contact {
                found.push(ContactEvidence { log_evidence: filter.log_evidence(), two_before, two });
                // Given the truth: the posterior collapses to the node nearest to the true contact.
                let off = |k: &usize| (filter.solutions()[*k].point_mm - truth.point_mm).norm();
                let nearest = (0..filter.solutions().len()).min_by(|a, b| off(a).total_cmp(&off(b)));
                if let Some(nearest) = nearest.filter(|_| given_truth) {
                    filter.condition_on(nearest);
                }
            }
            two_before = two;
        }
        found
    };
    all_series.par_iter().flat_map_iter(one).collect()
}

/// The same with the network's own probability of several contacts, as the logarithm of what it leaves to one.
#[must_use]
pub fn network_evidence<'a>(
    tracker: &Tracker,
    all_series: impl Iterator<Item = &'a SweepSeries>,
) -> Vec<ContactEvidence> {
    let all_series: Vec<&SweepSeries> = all_series.collect();
    let one = |series: &&SweepSeries| {
        let sample =
            |i: &SweepSample| Sample { t_s: i.t_s, moment_nmm: i.moment_nmm, base_mm_s: Some(i.speed_mm_s) };
        let answers = tracker.track_series(&series.samples.iter().map(sample).collect::<Vec<_>>());
        let mut two_before = false;
        let mut found = Vec::new();
        for (i, answer) in series.samples.iter().zip(&answers) {
            let two = i.contacts >= 2;
            if i.contact.is_some() {
                let one_contact = (1.0 - f64::from(answer.several)).max(1e-9);
                found.push(ContactEvidence { log_evidence: one_contact.ln().min(-1e-12), two_before, two });
            }
            two_before = two;
        }
        found
    };
    all_series.par_iter().flat_map_iter(one).collect()
}

/// Detection of two contacts given the truth of the sample before.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct OneStepDetection {
    /// By the count before alone: as many as before.
    pub f1_as_before: f64,
    /// By that and by how well one contact explains the path from the true place before.
    pub f1: f64,
}

/// Bins of the evidence, equally filled.
const EVIDENCE_BINS: usize = 20;

/// Shares of two by count before and evidence are learned on `chosen_on`, judged on `judged_on`; none without a sample in either.
#[must_use]
pub fn two_contacts_given_previous(
    chosen_on: &[ContactEvidence],
    judged_on: &[ContactEvidence],
) -> Option<OneStepDetection> {
    if chosen_on.is_empty() || judged_on.is_empty() {
        return None;
    }
    let edges = [false, true].map(|before| {
        let own = chosen_on.iter().filter(|w| w.two_before == before);
        let mut own: Vec<f64> = own.map(|w| w.log_evidence).collect();
        own.sort_by(f64::total_cmp);
        (1..EVIDENCE_BINS)
            .filter_map(|k| own.get(own.len() * k / EVIDENCE_BINS).copied())
            .collect::<Vec<f64>>()
    });
    let bin = |w: &ContactEvidence| {
        let before = usize::from(w.two_before);
        before * EVIDENCE_BINS + edges[before].partition_point(|limit| *limit <= w.log_evidence)
    };
    let mut counts = vec![[0.0_f64; 2]; 2 * EVIDENCE_BINS];
    chosen_on.iter().for_each(|w| counts[bin(w)][usize::from(w.two)] += 1.0);
    let share = |w: &ContactEvidence| {
        let [one, two] = counts[bin(w)];
        two / (one + two).max(1.0)
    };
    // Bins are called two in order of decreasing share, down to the limit with the best F1.
    let limit = best_limit(chosen_on.iter().map(|w| (-share(w), w.two)).collect())?;
    let pairs: Vec<(bool, bool)> = judged_on.iter().map(|w| (-share(w) < limit, w.two)).collect();
    let before: Vec<(bool, bool)> = judged_on.iter().map(|w| (w.two_before, w.two)).collect();
    Some(OneStepDetection { f1_as_before: detection(&before).f1, f1: detection(&pairs).f1 })
}

/// Detection of two contacts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
pub struct TwoContacts {
    /// Samples with contact, and the share of those with two or more.
    pub instants: usize,
    /// Share with two or more.
    pub share: f64,
    /// Evidence below which two are called, chosen on other sweeps.
    pub limit_log_evidence: f64,
    /// What that gives.
    pub detection: Detection,
    /// F1 of calling two always.
    pub f1_always: f64,
    /// Share of the samples with two contacts whose evidence for one contact is above the 5 % quantile of samples with one: no limit on
    /// this evidence separates these.
    pub explained_by_one: f64,
}

/// The limit with the best F1 on `chosen_on`, judged on `judged_on`, where the filter had a prediction; none without an instant in
/// either.
#[must_use]
pub fn two_contacts(chosen_on: &[ContactEvidence], judged_on: &[ContactEvidence]) -> Option<TwoContacts> {
    let predicted = |of: &[ContactEvidence]| -> Vec<(f64, bool)> {
        of.iter().filter(|w| w.log_evidence != 0.0).map(|w| (w.log_evidence, w.two)).collect()
    };
    let (limit, judged_on) = (best_limit(predicted(chosen_on))?, predicted(judged_on));
    let pairs: Vec<(bool, bool)> = judged_on.iter().map(|(e, two)| (*e < limit, *two)).collect();
    let two = judged_on.iter().filter(|w| w.1).count();
    let mut of_one: Vec<f64> = judged_on.iter().filter(|w| !w.1).map(|w| w.0).collect();
    of_one.sort_by(f64::total_cmp);
    let twentieth = *of_one.get(of_one.len() / 20)?;
    let explained = judged_on.iter().filter(|w| w.1 && w.0 >= twentieth).count();
    let always: Vec<(bool, bool)> = judged_on.iter().map(|w| (true, w.1)).collect();
    Some(TwoContacts {
        instants: judged_on.len(),
        share: two as f64 / judged_on.len() as f64,
        limit_log_evidence: limit,
        detection: detection(&pairs),
        f1_always: detection(&always).f1,
        explained_by_one: explained as f64 / two.max(1) as f64,
    })
}

/// Evidence below which to call two, from evidence and whether there are two, so that F1 is best.
fn best_limit(mut sorted: Vec<(f64, bool)>) -> Option<f64> {
    // F1 = 2 hits / (called + true), over every limit between two distinct evidences.
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let all = sorted.iter().filter(|w| w.1).count() as f64;
    let (mut hits, mut best) = (0.0, None);
    for (k, pair) in sorted.windows(2).enumerate() {
        hits += f64::from(u8::from(pair[0].1));
        let f1 = 2.0 * hits / ((k + 1) as f64 + all);
        if pair[0].0 < pair[1].0 && best.is_none_or(|(score, _)| f1 > score) {
            best = Some((f1, pair[1].0));
        }
    }
    best.map(|b| b.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_that_tells_scores_and_evidence_that_does_not_is_called_so() {
        // One contact: evidence 0 to 1; two: -1 to 0.
        let of = |log_evidence, two| ContactEvidence { log_evidence, two_before: false, two };
        let apart: Vec<ContactEvidence> =
            (0..200).map(|k| of(f64::from(k) / 100.0 - 0.995, k < 100)).collect();
        let found = two_contacts(&apart, &apart).unwrap();
        assert!(found.detection.f1 > 0.98 && found.explained_by_one < 0.05, "{found:?}");
        // Negative control: the same evidence for both.
        let alike: Vec<ContactEvidence> = (0..400).map(|k| of(f64::from(k / 2 + 1), k % 2 == 0)).collect();
        let found = two_contacts(&alike, &alike).unwrap();
        assert!(found.detection.f1 < 0.7 && found.explained_by_one > 0.9, "{found:?}");
        assert!((found.f1_always - 2.0 / 3.0).abs() < 1e-9);
        assert_eq!(two_contacts(&[], &alike), None);
    }

    #[test]
    fn one_who_is_told_the_count_before_needs_the_evidence_only_where_it_changes() {
        // Two last four instants; evidence is low where they begin and high where they end, or says nothing.
        let series = |says: bool| -> Vec<ContactEvidence> {
            (0..800)
                .map(|k| {
                    let (two, two_before) = (k % 8 >= 4, k > 0 && (k - 1) % 8 >= 4);
                    let log_evidence =
                        if says { if two { -5.0 } else { 5.0 } } else { (k * 37 % 101) as f64 };
                    ContactEvidence { log_evidence, two_before, two }
                })
                .collect()
        };
        let clear = two_contacts_given_previous(&series(true), &series(true)).unwrap();
        assert!((clear.f1_as_before - 0.75).abs() < 0.01 && clear.f1 > 0.99, "{clear:?}");
        let dumb = two_contacts_given_previous(&series(false), &series(false)).unwrap();
        assert!(dumb.f1 < 0.85, "{dumb:?}");
        assert_eq!(two_contacts_given_previous(&[], &series(true)), None);
    }
}
