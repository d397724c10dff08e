//! How far the contacts of a session lie from its groove, by the declared and by the accepted
//! model, on trajectories that had no part in the calibrations that locate them.
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

use crate::TrackError as Error;
use crate::groove_comparison::{Compared, rms};
use crate::session_groove::compared;
use rayon::prelude::*;
use std::collections::BTreeMap;
use wcal_calibration::WhiskerCalibration;
use wcal_core::jackknife::interval95;
use wcal_core::verify_document::{ContactComparison, TrackError, TrajectoryContact};
use wcal_verify::verify::{Decision, FoldCalibrations};
use wcal_verify::whisker::{PhysicalModel, WhiskerSystem};

/// Places that the tracker finds through a calibration beside the groove's, on the `chosen`
/// readings of a system; none where the stage's way is not recorded, or the wire cannot be bent.
///
/// # Errors
/// Where moments or motion cannot be used.
pub fn groove_places(
    system: &WhiskerSystem,
    model: &PhysicalModel,
    chosen: impl Fn(usize) -> bool,
) -> Result<Vec<Compared>, Error> {
    let mut readings = 0..system.path.readings.len();
    let recorded =
        readings.all(|i| system.path.readings[i].rest || system.row(i).stage_mm.is_some());
    let Some(motion) = model.groove_motion(system).filter(|_| recorded) else {
        return Ok(Vec::new());
    };
    compared(system, motion, chosen, |i| system.row(i).groove_mm)
}

/// Loaded readings among the `chosen`, whose groove is stated.
pub fn loaded(system: &WhiskerSystem, chosen: impl Fn(usize) -> bool) -> usize {
    let stated = |i: &usize| !system.path.readings[*i].rest && system.row(*i).groove_mm.is_some();
    (0..system.path.readings.len())
        .filter(|i| chosen(*i))
        .filter(stated)
        .count()
}

/// Contacts of all open trajectories by the declared and the accepted model, each left out in turn.
///
/// # Errors
/// As [`groove_places`].
pub fn left_out_places(decision: &Decision<WhiskerSystem>) -> Result<[Vec<Compared>; 2], Error> {
    let of_fold = |fold: &FoldCalibrations<'_, WhiskerSystem>| {
        let readings = &fold.model.path.readings;
        let group = readings
            .iter()
            .zip(&fold.left_out)
            .find(|(_, out)| **out)
            .map(|(r, _)| r.group);
        // Its readings at rest stand in every fit, and say where its contact begins.
        let own = |i: usize| Some(readings[i].group) == group;
        let places = |model: &PhysicalModel| groove_places(fold.model, model, own);
        Ok([places(&fold.declared)?, places(&fold.chosen)?])
    };
    let folds = decision.fold_calibrations();
    let each = folds
        .par_iter()
        .map(of_fold)
        .collect::<Result<Vec<_>, Error>>()?;
    let of = |k: usize| {
        each.iter()
            .flat_map(|places: &[Vec<Compared>; 2]| places[k].clone())
            .collect()
    };
    Ok([of(0), of(1)])
}

/// Readings of a trajectory and the sums of their squared errors by both models, mm^2.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Squares {
    readings: f64,
    mm2: [f64; 2],
}

impl Squares {
    /// Root mean squares by both models over trajectories, mm.
    fn rms(all: impl Iterator<Item = Self>) -> [f64; 2] {
        let total = all.fold(Self::default(), |a, b| Self {
            readings: a.readings + b.readings,
            mm2: [a.mm2[0] + b.mm2[0], a.mm2[1] + b.mm2[1]],
        });
        total.mm2.map(|mm2| (mm2 / total.readings).sqrt())
    }
}

/// Readings that both models locate, among so many `loaded` ones; none where there is none.
pub fn contact_comparison(
    [before, after]: [&[Compared]; 2],
    loaded: usize,
) -> Option<ContactComparison> {
    let declared: BTreeMap<usize, Compared> = before.iter().map(|c| (c.reading, *c)).collect();
    let mut by_trajectory: BTreeMap<u32, Squares> = BTreeMap::new();
    let mut both = Vec::new();
    for (declared, accepted) in after
        .iter()
        .filter_map(|c| Some((declared.get(&c.reading)?, c)))
    {
        let squares = by_trajectory.entry(accepted.trajectory).or_default();
        squares.readings += 1.0;
        squares.mm2[0] += declared.error_mm.powi(2);
        squares.mm2[1] += accepted.error_mm.powi(2);
        both.push(*accepted);
    }
    let each: Vec<Squares> = by_trajectory.values().copied().collect();
    let without = |k: usize| {
        Squares::rms(
            each.iter()
                .enumerate()
                .filter(|(j, _)| *j != k)
                .map(|(_, s)| *s),
        )
    };
    let without: Vec<[f64; 2]> = (0..each.len()).map(without).collect();
    let interval = |whole: f64, of: &dyn Fn(&[f64; 2]) -> f64| {
        interval95(whole, &without.iter().map(of).collect::<Vec<_>>())
    };
    let whole = Squares::rms(each.iter().copied());
    let error = |k: usize| TrackError {
        rms_mm: whole[k],
        interval95: interval(whole[k].ln(), &|e| e[k].ln()).map(|ends| ends.map(f64::exp)),
    };
    let first: BTreeMap<u32, f64> = both
        .iter()
        .map(|c| (c.trajectory, c.arclength_mm))
        .collect();
    let trajectory = |(&trajectory, squares): (&u32, &Squares)| {
        let [before_mm, after_mm] = Squares::rms(std::iter::once(*squares));
        Some(TrajectoryContact {
            trajectory,
            arclength_mm: *first.get(&trajectory)?,
            before_mm,
            after_mm,
        })
    };
    (!both.is_empty()).then(|| ContactComparison {
        before: error(0),
        after: error(1),
        difference_mm: whole[1] - whole[0],
        difference_interval95: interval(whole[1] - whole[0], &|e| e[1] - e[0]),
        bound_mm: rms(&both, |c| c.bound_mm),
        readings: both.len(),
        not_located: loaded.saturating_sub(both.len()),
        inside95: both.iter().filter(|c| c.held).count(),
        groove_moved_mm: rms(&both, |c| c.moved_mm),
        trajectories: by_trajectory.iter().filter_map(trajectory).collect(),
        sealed: None,
    })
}
