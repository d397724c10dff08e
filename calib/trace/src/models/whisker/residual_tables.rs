//! What `verify` lists reading by reading and pose by pose, for tables and report.

use super::predictions::Predicted;
use super::system::WhiskerSystem;
use wcal_core::observation::Role;

/// A reading with both predictions, for predictions.csv.
#[derive(Debug, Clone)]
pub struct PredictionRow {
    /// File.
    pub source: String,
    /// Point number.
    pub point: i64,
    /// Role.
    pub role: Role,
    /// Declared model.
    pub before: Predicted,
    /// Accepted model.
    pub after: Predicted,
    /// What temperature adds to the compensated shift as read, pm.
    pub thermal_pm: [f64; 2],
}

/// Trajectory, stage positions (mm) and moments (N mm) of the rod's branch.
pub type Branch = (u32, Vec<f64>, Vec<[f64; 2]>);

/// Rows of predictions.csv in the order of the tables.
pub(super) fn prediction_rows(
    whole: &WhiskerSystem,
    before: &[Predicted],
    after: &[Predicted],
) -> Vec<PredictionRow> {
    let mut order: Vec<usize> = (0..whole.path.rows.len()).collect();
    order.sort_by_key(|&i| whole.path.rows[i]);
    let of = |i: usize| {
        let row = whole.row(i);
        let compensated = row.compensated_pm(&whole.data.fbg);
        PredictionRow {
            source: row.source.clone(),
            point: row.point,
            role: row.role,
            before: before[i],
            after: after[i],
            thermal_pm: [row.shift_pm[0] - compensated[0], row.shift_pm[1] - compensated[1]],
        }
    };
    order.into_iter().map(of).collect()
}

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
