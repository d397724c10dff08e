//! What `verify` shows along the trajectories.

use super::system::WhiskerSystem;

/// Trajectory, stage positions (mm) and moments (N mm) of the rod's branch.
pub type Branch = (u32, Vec<f64>, Vec<[f64; 2]>);

/// The rod's branch along each trajectory, as far as the readings reach.
pub(super) fn branches(system: &WhiskerSystem) -> Vec<Branch> {
    let Some(tables) = system.rod_tables.tables(&crate::whisker::rod_parameters::RodParameters::default())
    else {
        return Vec::new();
    };
    system
        .data
        .trajectories
        .iter()
        .zip(tables.iter())
        .zip(&system.path.reach_mm)
        .filter(|(_, reach)| **reach > 0.0)
        .map(|((t, table), reach)| {
            let xs: Vec<f64> = (0..=60).map(|k| reach * f64::from(k) / 60.0).collect();
            let kept: Vec<(f64, [f64; 2])> =
                xs.iter().filter_map(|x| Some((*x, table.moment(*x)?))).collect();
            (t.id, kept.iter().map(|k| k.0).collect(), kept.iter().map(|k| k.1).collect())
        })
        .collect()
}
