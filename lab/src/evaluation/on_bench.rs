//! The tracker on the virtual bench. All of it is SIMULATED.

use crate::LabError;
use crate::bootstrap::worst_interval95;
use crate::evaluate::{Method, ObjectScores, score_objects};
use crate::evaluation::document::{BySet, KnownMotion, Means, VirtualReal, both_means, coverage90};
use crate::evaluation::request::{Model, Order, Surroundings, meshes};
use crate::evaluation::virtual_bench::VirtualBench;
use crate::generate_sweeps::{SweepRequest, generate_sweeps};
use crate::sweep_series::SweepSeries;
use std::collections::BTreeMap;
use wcal_network::Tracker;

/// Sweeps that were trained on have small seeds: the same number must not draw the same sweeps
/// here.
const ON_THE_SPOT: u64 = 0x6576_616c_7561_7465;

/// Known motion: the tracker on the groove of the bench's session by `verify`'s own calibration,
/// beside the posterior Cramer-Rao bound.
fn known_motion(bench: &VirtualBench) -> Option<KnownMotion> {
    bench.calibration.groove.as_ref().map(|g| KnownMotion {
        is_virtual: true,
        error_mm: g.rmse_mm,
        bound_mm: g.bound_mm,
        error_over_bound: g.rmse_mm / g.bound_mm,
        trajectories: g.trajectories,
        trajectories_held: g.trajectories_held,
        readings: g.points,
        split: g.split.clone(),
    })
}

/// The network with the base's speed known, on sweeps over seen and unseen objects as the bench's
/// own calibration measures them.
pub(crate) fn on_bench(
    model: &Model<'_>,
    order: &Order<'_>,
    around: &Surroundings<'_>,
) -> Result<(VirtualReal, Option<KnownMotion>), LabError> {
    let folder =
        tempfile::tempdir().map_err(LabError::file("making a folder in", &std::env::temp_dir()))?;
    let (tracker, card) = (model.tracker, model.card);
    (around.progress)("calibrating the virtual bench");
    let bench = VirtualBench::new(&card.whisker, order.seed, folder.path(), around.calibrate)?;
    let calibration = &bench.calibration;
    (around.note)(&format!(
        "virtual bench: {} act; verify says {:?} and accepts {:?}",
        bench.acting.join(", "),
        calibration.verdict,
        calibration.accepted
    ));
    let by = calibration.best();
    // Measurement noise of the calibration and the standard deviations of a stream, as `wcal track`
    // has them.
    let tracker = Tracker {
        filters: (around.filters_for)(tracker.filters, by),
        sd_factors: card.sd_on_bench.clone(),
        ..tracker.clone()
    };
    let plan = VirtualBench::plan();
    let (seed, sweeps) = (order.seed ^ ON_THE_SPOT, order.sweeps_each);
    let request = SweepRequest {
        whisker: &bench.whisker,
        plan: &plan,
        seed,
        sweeps,
    };
    let score = |names: &[String]| -> Result<Vec<ObjectScores>, LabError> {
        let meshes = meshes(names.iter().take(order.objects), order.meshes, around.note)?;
        let mut measured: BTreeMap<String, Vec<SweepSeries>> = BTreeMap::new();
        for (name, mesh) in &meshes {
            let all = generate_sweeps(mesh, &request)?;
            let seen = all
                .iter()
                .map(|c| bench.through(c, by, order.seed, folder.path()));
            let seen = seen.collect::<Result<Vec<_>, _>>()?;
            if !seen.is_empty() {
                measured.insert(name.clone(), seen);
            }
        }
        score_objects(
            &|c: &SweepSeries| Method::Network(&tracker, true).run(c),
            &measured,
            &meshes,
        )
    };
    (around.progress)("virtual bench");
    let (seen, unseen) = (score(&card.objects.training)?, score(&card.objects.unseen)?);
    let every: Vec<&ObjectScores> = seen.iter().chain(&unseen).collect();
    let mut interval95 = both_means(&seen, &unseen);
    interval95.insert("worst_mm", worst_interval95(&every, |s| s.surface));
    let means = Means::of(&seen, &unseen);
    let real = VirtualReal {
        coverage90: BySet {
            seen: coverage90(&seen),
            unseen: coverage90(&unseen),
        },
        is_virtual: true,
        seen_mean_mm: means.seen_mean_mm,
        unseen_mean_mm: means.unseen_mean_mm,
        worst_mm: every.iter().map(|o| o.all.rmse_mm).fold(0.0, f64::max),
        interval95,
        acting: bench.acting.clone(),
        verdict: calibration.verdict,
        accepted: calibration.accepted.clone(),
        calibration: if calibration.verified.is_some() {
            "verify"
        } else {
            "fit-gpr"
        },
        objects: means.objects,
    };
    Ok((real, known_motion(&bench)))
}
