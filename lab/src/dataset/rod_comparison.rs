//! MuJoCo's sweeps of a dataset against the rod's on the same sweeps, as its shards hold them (SIMULATED).

use super::{Dataset, read, shard};
use crate::LabError;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_lab_sweeps::SweepPlan;
use wcal_lab_sweeps::rod_comparison::{BothEngines, ComparisonSum, RodComparison, State};

/// Width of a bin of speeds, mm/s, and most bins.
const BIN_MM_S: f64 = 1.0;
const MAX_BINS: usize = 8;

/// Edges of bins over a plan's speeds.
fn speed_edges(plan: &SweepPlan) -> Vec<f64> {
    let [low, high] = plan.speed_mm_s;
    let bins = (((high - low) / BIN_MM_S).ceil() as usize).clamp(1, MAX_BINS);
    (0..=bins).map(|k| low + (high - low) * k as f64 / bins as f64).collect()
}

/// MuJoCo's sweeps of a dataset in `folder` against the rod's, over the shards that are there.
///
/// # Errors
/// Where a shard cannot be read.
pub fn of_dataset(dataset: &Dataset, folder: &Path) -> Result<RodComparison, LabError> {
    let edges = speed_edges(&dataset.plan);
    let mut sum = ComparisonSum::new(edges.windows(2).map(|w| [w[0], w[1]]).collect());
    for name in dataset.shards() {
        if !folder.join(format!("{name}.json")).exists() {
            continue;
        }
        let table = |kind: &str| read::table(&folder.join(format!("{name}.{kind}.parquet")));
        let (sweeps, samples, contacts, rod) =
            (table("sweeps")?, table("samples")?, table("contacts")?, table(shard::ROD)?);
        let mut overlaps: BTreeMap<[i64; 2], f64> = BTreeMap::new();
        let places = contacts.whole("sweep")?.iter().zip(contacts.whole("sample")?);
        for ((&sweep, &sample), gap) in places.zip(contacts.real("gap_mm")?) {
            let deepest = overlaps.entry([sweep, sample]).or_default();
            *deepest = deepest.max(-gap);
        }
        let mut quasi: BTreeMap<[i64; 2], State> = BTreeMap::new();
        let states = states_of(&rod, "rod_")?;
        let places = rod.whole("sweep")?.iter().zip(rod.whole("sample")?);
        for ((&sweep, &sample), state) in places.zip(states) {
            quasi.insert([sweep, sample], state);
        }
        let mut by_sweep: BTreeMap<i64, Vec<BothEngines>> = BTreeMap::new();
        let (of, number) = (samples.whole("sweep")?, samples.whole("sample")?);
        let (speeds, settled) = (samples.real("speed_mm_s")?, samples.whole("settled")?);
        for (k, dynamic) in states_of(&samples, "")?.into_iter().enumerate() {
            let key = [of[k], number[k]];
            by_sweep.entry(of[k]).or_default().push(BothEngines {
                speed_mm_s: speeds[k],
                overlap_mm: overlaps.get(&key).copied().unwrap_or(0.0),
                settled: settled[k] == 1,
                dynamic,
                quasi: quasi.get(&key).copied(),
            });
        }
        let verdicts = sweeps.text("verdict")?.iter().zip(sweeps.text("rod_verdict")?);
        for (index, (dynamic, quasi)) in sweeps.whole("sweep")?.iter().zip(verdicts) {
            sum.add([dynamic, quasi], by_sweep.get(index).map_or(&[], Vec::as_slice));
        }
    }
    Ok(sum.table())
}

/// Moments and contacts of a table whose columns begin so.
fn states_of(table: &read::Table, prefix: &str) -> Result<Vec<State>, LabError> {
    let mut moments = Vec::new();
    let mut points = Vec::new();
    for axis in ["x", "y", "z"] {
        moments.push(table.real(&format!("{prefix}moment_{axis}_nmm"))?);
        points.push(table.maybe(&format!("{prefix}contact_{axis}_mm"))?);
    }
    let moment = |k: usize| Vector3::new(moments[0][k], moments[1][k], moments[2][k]);
    let point = |k: usize| Some(Vector3::new(points[0][k]?, points[1][k]?, points[2][k]?));
    Ok((0..moments[0].len()).map(|k| (moment(k), point(k))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_cover_the_plans_speeds() {
        assert_eq!(speed_edges(&SweepPlan::default()), [3.0, 4.0, 5.0, 6.0, 7.0]);
    }
}
