//! Labelled series simulated on the spot by the rod engine. All of them are SIMULATED.

use crate::LabError;
use crate::sweep_series::{Contact, SweepSample, SweepSeries};
use crate::sweep_series::{count_contacts, nearest_contact};
use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion};
use rayon::prelude::*;
use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::rod_engine::{LINKS, Run};
use wcal_lab_sweeps::{RodEngine, Sample, Sweep, SweepPlan, Verdict};
use wcal_mesh::Mesh;

/// What to simulate.
#[derive(Debug, Clone)]
pub struct SweepRequest<'a> {
    /// Whisker.
    pub whisker: &'a WhiskerSpec,
    /// Speeds, physics and rate.
    pub plan: &'a SweepPlan,
    /// Seed.
    pub seed: u64,
    /// Usable sweeps over each object.
    pub sweeps: usize,
}

/// Upper limit of sweeps tried for each usable one.
const MAX_TRIES: usize = 6;

/// Sweep series over an object; fewer than requested where the whisker rarely touches it.
///
/// # Errors
/// Where whisker or plan cannot be used.
pub fn generate_sweeps(
    mesh: &Mesh,
    request: &SweepRequest<'_>,
) -> Result<Vec<SweepSeries>, LabError> {
    request.plan.check()?;
    let engine = RodEngine::new(request.whisker, LINKS)?;
    let one = |index: u64| {
        let sweep = Sweep::draw(mesh, request.plan, request.seed, index, engine.reach_mm())?;
        let run = engine.run(mesh, &sweep, request.plan);
        (run.verdict == Verdict::Kept).then(|| series(mesh, &sweep, &run))
    };
    let mut kept = Vec::new();
    let chunk = request.sweeps.max(1) as u64;
    for from in (0..chunk * MAX_TRIES as u64).step_by(request.sweeps.max(1)) {
        let tried: Vec<Option<SweepSeries>> =
            (from..from + chunk).into_par_iter().map(one).collect();
        kept.extend(tried.into_iter().flatten());
        if kept.len() >= request.sweeps {
            break;
        }
    }
    kept.truncate(request.sweeps);
    Ok(kept)
}

fn series(mesh: &Mesh, sweep: &Sweep, run: &Run) -> SweepSeries {
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(sweep.turn));
    let sample = |s: &Sample| {
        let touched: Vec<_> = s
            .contacts
            .iter()
            .map(|c| {
                (
                    Contact {
                        point_mm: c.point_mm,
                        arclength_mm: c.arclength_mm,
                    },
                    c.force_n,
                )
            })
            .collect();
        SweepSample {
            t_s: s.t_s,
            travel_mm: s.travel_mm,
            speed_mm_s: s.speed_mm_s,
            moment_nmm: [s.moment_nmm.y, s.moment_nmm.z],
            contact: nearest_contact(&touched),
            contacts: count_contacts(touched.iter().map(|(c, _)| c.arclength_mm)),
            settled: s.settled,
            event: s.event.name().to_owned(),
        }
    };
    SweepSeries {
        object: mesh.name.clone(),
        sweep: sweep.index,
        base_from_object: Isometry3::from_parts(Translation3::from(sweep.shift_mm), turn),
        samples: run.samples.iter().map(sample).collect(),
    }
    .tared()
}
