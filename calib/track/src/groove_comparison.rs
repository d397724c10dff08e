//! Located places beside a groove that is known: errors, bound, coverage of the regions, and what
//! that makes of a contact's uncertainty; by the declared and by the accepted model on trajectories
//! that had no part in the calibrations that locate them.
//!
//! ```text
//! e_k = |p_k - (g_k + a_k d + o)|             p: located by moments and motion, g: stated place of the groove, d: its direction
//! rms = sqrt(mean of e_k^2),   difference = rms of the accepted model less rms of the declared one, over readings that both locate
//! ```
//!
//! By what a_k the effects of the fold's model correct the stage and by what o the place of the
//! groove are fitted without the trajectory, so that nothing of it is in its own answer; the
//! declared model corrects nothing. Intervals leave out each trajectory, whose readings share one
//! error: of a root mean square on the scale of its logarithm, of a difference as it is
//! ([`wcal_core::jackknife`]).

use crate::arc_posterior::REGION;
use statrs::distribution::{Binomial, DiscreteCDF};
use std::collections::{BTreeMap, BTreeSet};
use wcal_core::jackknife::interval95;
use wcal_core::text::chance;
use wcal_core::verify_document::{
    CalibrationContact, ContactComparison, ContactUncertainty, GrooveTracking, TrackError,
    TrajectoryContact,
};

/// A located place beside the groove's.
#[derive(Debug, Clone, Copy)]
pub struct Compared {
    /// Index of the reading in the system's path.
    pub reading: usize,
    /// Identifier of the trajectory.
    pub trajectory: u32,
    /// True arc length at which the free wire is met, mm.
    pub arclength_mm: f64,
    /// Distance in space, mm.
    pub error_mm: f64,
    /// How far from its stated place the calibration's effects put the groove, mm.
    pub moved_mm: f64,
    /// Cramer-Rao bound of that distance, mm, and without the readings' own noise.
    pub bound_mm: f64,
    /// See `bound_mm`.
    pub bound_by_map_mm: f64,
    /// Largest moment of the trajectory and its standard deviation by what all readings share, N
    /// mm.
    pub moment_nmm: [f64; 2],
    /// Whether the 95 % region holds the groove.
    pub held: bool,
    /// Whether moments and motion disagree on the trajectory.
    pub doubted: bool,
}

/// Level of significance of a test against the stated coverage.
const LEVEL: f64 = 0.01;

/// Visits, and those of which half of the readings or more lie in their 95 % regions, from the
/// visit of each reading and whether it does: readings of one visit are not independent.
pub(crate) fn visits_held<K: Ord>(readings: impl Iterator<Item = (K, bool)>) -> [usize; 2] {
    let mut visits: BTreeMap<K, [usize; 2]> = BTreeMap::new();
    readings.for_each(|(visit, held)| visits.entry(visit).or_default()[usize::from(held)] += 1);
    let held = visits
        .values()
        .filter(|[outside, inside]| inside >= outside);
    [visits.len(), held.count()]
}

/// Whether the 95 % regions hold fewer visits than chance explains.
pub(crate) fn too_few([visits, held]: [usize; 2]) -> bool {
    visits > 0 && binomial_cdf(held, visits, REGION) < LEVEL
}

/// Chance of `hits` or fewer of `n` with probability `p` each.
pub(crate) fn binomial_cdf(hits: usize, n: usize, p: f64) -> f64 {
    // Visits are independent; each is held with probability p where the regions are right.
    Binomial::new(p, n as u64).map_or(1.0, |b| b.cdf(hits as u64))
}

/// Whether the groove is not where it was said to be: the stated regions hold too few trajectories
/// for an accident, and the error is more than the bound explains. Of nine trajectories three that
/// miss by hundredths of a millimetre happen where the noise is that small.
pub(crate) fn coverage_rejected(t: &GrooveTracking) -> bool {
    const MAX_ERROR_OVER_BOUND: f64 = 1.3;
    too_few([t.trajectories, t.trajectories_held]) && t.rmse_mm > MAX_ERROR_OVER_BOUND * t.bound_mm
}

/// Root mean square.
pub(crate) fn rms(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / count).sqrt()
}

/// k of expanded uncertainties.
const COVERAGE_FACTOR: f64 = 2.0;

/// Expanded uncertainties by arc length of first touch, to whole millimetres.
fn uncertainty(compared: &[Compared]) -> Vec<ContactUncertainty> {
    let mut by_arclength: BTreeMap<i64, BTreeMap<u32, Compared>> = BTreeMap::new();
    for c in compared {
        by_arclength
            .entry(c.arclength_mm.round() as i64)
            .or_default()
            .insert(c.trajectory, *c);
    }
    // Trajectories are independent, their readings are not: one number a trajectory, root mean
    // square over them.
    let of = |(at, each): (i64, BTreeMap<u32, Compared>)| {
        let rms = |of: fn(&Compared) -> f64| rms(each.values().map(of));
        ContactUncertainty {
            arclength_mm: at as f64,
            trajectories: each.len(),
            moment_nmm: rms(|c| c.moment_nmm[0]),
            moment_u_nmm: COVERAGE_FACTOR * rms(|c| c.moment_nmm[1]),
            contact_u_by_map_mm: COVERAGE_FACTOR * rms(|c| c.bound_by_map_mm),
            contact_u_mm: COVERAGE_FACTOR * rms(|c| c.bound_mm),
        }
    };
    by_arclength.into_iter().map(of).collect()
}

/// Errors, bound and coverage over readings; none where nothing was compared.
pub fn groove_tracking(compared: &[Compared], split: &str) -> Option<GrooveTracking> {
    let each = || compared.iter();
    let [trajectories, trajectories_held] = visits_held(each().map(|c| (c.trajectory, c.held)));
    let doubted = each().filter(|c| c.doubted).map(|c| c.trajectory);
    (!compared.is_empty()).then(|| GrooveTracking {
        rmse_mm: rms(each().map(|c| c.error_mm)),
        bound_mm: rms(each().map(|c| c.bound_mm)),
        coverage95: each().filter(|c| c.held).count() as f64 / compared.len() as f64,
        points: compared.len(),
        trajectories,
        trajectories_held,
        doubted: doubted.collect::<BTreeSet<_>>().len(),
        split: split.to_owned(),
        uncertainty: uncertainty(compared),
    })
}

/// What the tracked groove tells a calibration's user of contacts; none where no trajectory was
/// compared.
pub fn calibration_contact(t: &GrooveTracking) -> Option<CalibrationContact> {
    const METHOD: &str = "Bayesian Cramer-Rao bound of the contact on the session's trajectories, motion known: covariance of the calibration, \
                          noise of the readings, place of the free wire; root mean square over the trajectories of an arc length";
    (!t.uncertainty.is_empty()).then(|| CalibrationContact {
        coverage_factor: COVERAGE_FACTOR,
        method: METHOD.to_owned(),
        split: t.split.clone(),
        rows: t.uncertainty.clone(),
    })
}

/// For people.
pub fn contact_sentence(c: &CalibrationContact) -> String {
    let at =
        |u: &ContactUncertainty| format!("{:.2} mm at {:.0} mm", u.contact_u_mm, u.arclength_mm);
    let rows: Vec<String> = c.rows.iter().map(at).collect();
    format!(
        "this calibration: contact U (k = {}, motion known) {}",
        c.coverage_factor,
        rows.join(", ")
    )
}

/// For people.
pub(crate) fn groove_sentence(t: &GrooveTracking) -> String {
    let of = if t.split == "holdout" {
        "held-out readings"
    } else {
        "readings"
    };
    let counts = [t.trajectories, t.trajectories_held];
    let missed = match t.trajectories - t.trajectories_held {
        0 => String::new(),
        missed => format!(
            "; {missed} outside: {} ({})",
            if too_few(counts) {
                "more than chance explains"
            } else {
                "chance explains as many"
            },
            chance(binomial_cdf(t.trajectories_held, t.trajectories, REGION))
        ),
    };
    format!(
        "tracker on the groove: {:.2} mm RMS at {} {of}, expected {:.2} mm; the stated 95 % regions hold the groove on {} of {} trajectories{missed}",
        t.rmse_mm, t.points, t.bound_mm, t.trajectories_held, t.trajectories
    )
}

/// Readings that both models locate, among so many `loaded` ones; none where there is none.
pub fn contact_comparison(
    [before, after]: [&[Compared]; 2],
    loaded: usize,
) -> Option<ContactComparison> {
    let declared: BTreeMap<usize, Compared> = before.iter().map(|c| (c.reading, *c)).collect();
    let both = after
        .iter()
        .filter_map(|c| Some([*declared.get(&c.reading)?, *c]));
    let both: Vec<[Compared; 2]> = both.collect();
    // Root mean squares by both models over the trajectories that are kept, mm.
    let rms_mm = |kept: &dyn Fn(u32) -> bool| {
        let kept: Vec<&[Compared; 2]> = both.iter().filter(|c| kept(c[1].trajectory)).collect();
        [0, 1].map(|k| rms(kept.iter().map(|c| c[k].error_mm)))
    };
    let trajectories: BTreeMap<u32, f64> = both
        .iter()
        .map(|[_, c]| (c.trajectory, c.arclength_mm))
        .collect();
    let without = trajectories
        .keys()
        .map(|left_out| rms_mm(&|t| t != *left_out));
    let without: Vec<[f64; 2]> = without.collect();
    let interval = |whole: f64, of: &dyn Fn(&[f64; 2]) -> f64| {
        interval95(whole, &without.iter().map(of).collect::<Vec<_>>())
    };
    let whole = rms_mm(&|_| true);
    // A root mean square is positive and skewed: its interval is that of the logarithm.
    let error = |k: usize| TrackError {
        rms_mm: whole[k],
        interval95: interval(whole[k].ln(), &|e| e[k].ln()).map(|ends| ends.map(f64::exp)),
    };
    let trajectory = |(&trajectory, &arclength_mm): (&u32, &f64)| {
        let [before_mm, after_mm] = rms_mm(&|t| t == trajectory);
        TrajectoryContact {
            trajectory,
            arclength_mm,
            before_mm,
            after_mm,
        }
    };
    (!both.is_empty()).then(|| ContactComparison {
        before: error(0),
        after: error(1),
        difference_mm: whole[1] - whole[0],
        difference_interval95: interval(whole[1] - whole[0], &|e| e[1] - e[0]),
        bound_mm: rms(both.iter().map(|c| c[1].bound_mm)),
        readings: both.len(),
        not_located: loaded.saturating_sub(both.len()),
        inside95: both.iter().filter(|c| c[1].held).count(),
        groove_moved_mm: rms(both.iter().map(|c| c[1].moved_mm)),
        trajectories: trajectories.iter().map(trajectory).collect(),
        sealed: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn trajectories_outside_their_regions_are_said_with_the_chance_of_it() {
        let said = |trajectories_held| {
            groove_sentence(&GrooveTracking {
                rmse_mm: 0.1,
                bound_mm: 0.1,
                coverage95: 0.9,
                points: 60,
                trajectories: 6,
                trajectories_held,
                doubted: 0,
                split: "fit".to_owned(),
                uncertainty: Vec::new(),
            })
        };
        // 1 - 0.95^6, and what two of six have.
        assert!(
            said(5).ends_with("; 1 outside: chance explains as many (p = 0.26)"),
            "{}",
            said(5)
        );
        assert!(
            said(3).contains("; 3 outside: more than chance explains (p = "),
            "{}",
            said(3)
        );
        assert!(
            said(6).ends_with("on 6 of 6 trajectories"),
            "negative control: {}",
            said(6)
        );
    }
}
