//! Courses drawn on the spot by the rod engine. All of them are SIMULATED.

use crate::course::{apart, first};
use crate::{Contact, Course, Instant, TrackError};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion};
use rayon::prelude::*;
use wcal_core::observation::WhiskerSpec;
use wcal_mujoco::rod_engine::{LINKS, Run};
use wcal_mujoco::{Mesh, RodEngine, Sample, Sweep, SweepPlan, Verdict};

/// What is drawn.
#[derive(Debug, Clone)]
pub struct Order<'a> {
    /// Whisker that is dragged along.
    pub whisker: &'a WhiskerSpec,
    /// Speeds, physics and rate.
    pub plan: &'a SweepPlan,
    /// Seed.
    pub seed: u64,
    /// Usable sweeps over each object.
    pub sweeps: usize,
}

/// Sweeps tried for each usable one at most.
const TRIES: usize = 6;

/// Courses over an object; fewer than asked for where it is hardly ever touched.
///
/// # Errors
/// Where whisker or plan cannot be used.
pub fn drawn(mesh: &Mesh, order: &Order<'_>) -> Result<Vec<Course>, TrackError> {
    order.plan.check()?;
    let engine = RodEngine::new(order.whisker, LINKS)?;
    let one = |index: u64| {
        let sweep = Sweep::draw(mesh, order.plan, order.seed, index, engine.reach_mm())?;
        let run = engine.run(mesh, &sweep, order.plan);
        (run.verdict == Verdict::Kept).then(|| course(mesh, &sweep, &run))
    };
    let mut kept = Vec::new();
    let chunk = order.sweeps.max(1) as u64;
    for from in (0..chunk * TRIES as u64).step_by(order.sweeps.max(1)) {
        let made: Vec<Option<Course>> = (from..from + chunk).into_par_iter().map(one).collect();
        kept.extend(made.into_iter().flatten());
        if kept.len() >= order.sweeps {
            break;
        }
    }
    kept.truncate(order.sweeps);
    Ok(kept)
}

fn course(mesh: &Mesh, sweep: &Sweep, run: &Run) -> Course {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(sweep.turn));
    let instant = |s: &Sample| {
        let touched: Vec<_> = s
            .contacts
            .iter()
            .map(|c| (Contact { point_mm: c.point_mm, arclength_mm: c.arclength_mm }, c.force_n))
            .collect();
        Instant {
            t_s: s.t_s,
            travel_mm: s.travel_mm,
            speed_mm_s: s.speed_mm_s,
            moment_nmm: [s.moment_nmm.y, s.moment_nmm.z],
            contact: first(&touched),
            contacts: apart(touched.iter().map(|(c, _)| c.arclength_mm)),
            settled: s.settled,
            event: s.event.name().to_owned(),
        }
    };
    Course {
        object: mesh.name.clone(),
        sweep: sweep.index,
        base_from_object: Isometry3::from_parts(Translation3::from(sweep.shift_mm), turn),
        instants: run.samples.iter().map(instant).collect(),
    }
    .tared()
}
