//! Located places beside a groove that is known: errors, bound, coverage of the regions, and what
//! that makes of a contact's uncertainty.

use crate::arc_posterior::REGION;
use crate::known_groove::too_few;
use std::collections::{BTreeMap, BTreeSet};
use wcal_core::verify_document::{CalibrationContact, ContactUncertainty, GrooveTracking};

/// A located place beside the groove's.
#[derive(Debug, Clone, Copy, PartialEq)]
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

/// Trajectories of which fewer than half of the readings lie in their regions.
fn lost(compared: &[Compared]) -> usize {
    let mut by_trajectory: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
    for c in compared {
        by_trajectory.entry(c.trajectory).or_default()[usize::from(c.held)] += 1;
    }
    by_trajectory
        .values()
        .filter(|[outside, inside]| inside < outside)
        .count()
}

/// Whether the groove is not where it was said to be: the stated regions hold too few trajectories
/// for an accident, and the error is more than the bound explains. Of nine trajectories three that
/// miss by hundredths of a millimetre happen where the noise is that small.
pub(crate) fn coverage_rejected(t: &GrooveTracking) -> bool {
    const MAX_ERROR_OVER_BOUND: f64 = 1.3;
    too_few(t.trajectories_held, t.trajectories, REGION)
        && t.rmse_mm > MAX_ERROR_OVER_BOUND * t.bound_mm
}

pub(crate) fn rms(all: &[Compared], of: fn(&Compared) -> f64) -> f64 {
    (all.iter().map(|c| of(c).powi(2)).sum::<f64>() / all.len() as f64).sqrt()
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
        let each: Vec<Compared> = each.into_values().collect();
        let rms = |of: fn(&Compared) -> f64| rms(&each, of);
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
    let n = compared.len() as f64;
    let trajectories = |of: fn(&Compared) -> bool| {
        compared
            .iter()
            .filter(|c| of(c))
            .map(|c| c.trajectory)
            .collect::<BTreeSet<_>>()
            .len()
    };
    (!compared.is_empty()).then(|| GrooveTracking {
        rmse_mm: rms(compared, |c| c.error_mm),
        bound_mm: rms(compared, |c| c.bound_mm),
        coverage95: compared.iter().filter(|c| c.held).count() as f64 / n,
        points: compared.len(),
        trajectories: trajectories(|_| true),
        trajectories_held: trajectories(|_| true) - lost(compared),
        doubted: trajectories(|c| c.doubted),
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
    format!(
        "tracker on the groove: {:.2} mm RMS at {} {of}, expected {:.2} mm; the stated 95 % regions hold the groove on {} of {} trajectories",
        t.rmse_mm, t.points, t.bound_mm, t.trajectories_held, t.trajectories
    )
}
