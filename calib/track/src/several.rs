//! Two contacts at once: how far the two moments can tell them from one, on SIMULATED sweeps.
//!
//! At any instant one contact explains any two moments: its curve of candidates has a point for every arc length. Only the way of the
//! moments over time can speak against one contact on a rigid body; the Bayes filter's evidence is that discrepancy.

use crate::bayes::{BayesFilter, BayesSettings};
use crate::score::{Detection, detection};
use crate::{Course, StaticInverse};
use rayon::prelude::*;
use serde::Serialize;

/// Instant with contact: logarithm of the filter's evidence for one contact, and whether there were two or more.
pub type Weighed = (f64, bool);

/// Evidence at all instants with contact that the filter had foretold; the base's speed is known.
#[must_use]
pub fn weighed<'a>(
    inverse: &StaticInverse,
    courses: impl Iterator<Item = &'a Course>,
    settings: BayesSettings,
) -> Vec<Weighed> {
    let courses: Vec<&Course> = courses.collect();
    let one = |course: &&Course| {
        let mut filter = BayesFilter::new(inverse, settings);
        let mut last_s = 0.0;
        let mut found = Vec::new();
        for i in &course.instants {
            let dt_s = i.t_s - std::mem::replace(&mut last_s, i.t_s);
            filter.step(dt_s, i.moment_nmm, Some(i.speed_mm_s));
            if i.contact.is_some() && filter.log_evidence() != 0.0 {
                found.push((filter.log_evidence(), i.contacts >= 2));
            }
        }
        found
    };
    courses.par_iter().flat_map_iter(one).collect()
}

/// How well two contacts are told.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TwoContacts {
    /// Instants with contact, and the share of those with two or more.
    pub instants: usize,
    /// See `instants`.
    pub share: f64,
    /// Evidence below which two are called, chosen on other sweeps.
    pub limit_log_evidence: f64,
    /// What that gives.
    pub detection: Detection,
    /// F1 of calling two always.
    pub f1_always: f64,
    /// Share of the instants with two contacts that one contact explains better than it does a twentieth of those with one: there no
    /// detector that leans on this discrepancy can tell them.
    pub explained_by_one: f64,
}

/// The limit with the best F1 on `chosen_on`, judged on `judged_on`; none without an instant in either.
#[must_use]
pub fn two_contacts(chosen_on: &[Weighed], judged_on: &[Weighed]) -> Option<TwoContacts> {
    let limit = best_limit(chosen_on)?;
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

fn best_limit(weighed: &[Weighed]) -> Option<f64> {
    let mut sorted = weighed.to_vec();
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
        let apart: Vec<Weighed> = (0..200).map(|k| (f64::from(k) / 100.0 - 1.0, k < 100)).collect();
        let told = two_contacts(&apart, &apart).unwrap();
        assert!(told.detection.f1 > 0.98 && told.explained_by_one < 0.05, "{told:?}");
        // Negative control: the same evidence for both.
        let alike: Vec<Weighed> = (0..400).map(|k| (f64::from(k / 2), k % 2 == 0)).collect();
        let told = two_contacts(&alike, &alike).unwrap();
        assert!(told.detection.f1 < 0.7 && told.explained_by_one > 0.9, "{told:?}");
        assert!((told.f1_always - 2.0 / 3.0).abs() < 1e-9);
        assert_eq!(two_contacts(&[], &alike), None);
    }
}
