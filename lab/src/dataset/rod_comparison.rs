//! MuJoCo's sweeps of a dataset against the rod's on the same sweeps, as its shards hold them (SIMULATED).

use super::{Dataset, read, shard};
use crate::LabError;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::fmt::{Display, Formatter};
use std::path::Path;
use wcal_mujoco::rod_comparison::{BothEngines, ComparisonSum, RodComparison, State};
use wcal_sim::SweepPlan;

/// Width of a bin of speeds, mm/s, and most bins.
const BIN_MM_S: f64 = 1.0;
const MAX_BINS: usize = 8;

/// Edges of bins over a plan's speeds.
pub fn speed_edges(plan: &SweepPlan) -> Vec<f64> {
    let [low, high] = plan.speed_mm_s;
    let bins = (((high - low) / BIN_MM_S).ceil() as usize).clamp(1, MAX_BINS);
    (0..=bins).map(|k| low + (high - low) * k as f64 / bins as f64).collect()
}

/// MuJoCo's sweeps of a dataset in `folder` against the rod's, over the shards that are there.
///
/// # Errors
/// Where a shard cannot be read.
pub fn of_dataset(dataset: &Dataset, folder: &Path) -> Result<RodComparison, LabError> {
    let mut names = dataset.shards();
    names.retain(|name| folder.join(format!("{name}.json")).exists());
    of_shards(folder, &names, &speed_edges(&dataset.plan))
}

/// The table over shards that MuJoCo made.
///
/// # Errors
/// Where a shard cannot be read.
pub fn of_shards(folder: &Path, shards: &[String], edges: &[f64]) -> Result<RodComparison, LabError> {
    let mut sum = ComparisonSum::new(edges.windows(2).map(|w| [w[0], w[1]]).collect());
    for name in shards {
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

/// The table for a person.
pub struct Printed<'a>(pub &'a RodComparison);

impl Display for Printed<'_> {
    fn fmt(&self, f: &mut Formatter<'_>) -> std::fmt::Result {
        let Self(comparison) = self;
        writeln!(
            f,
            "{:>11} {:>8} {:>9} {:>24} {:>20} {:>7} {:>16} {:>10} {:>11} {:>8}",
            "speed mm/s",
            "samples",
            "elsewhere",
            "moment off, p50 p95 N mm",
            "RMS of the rod's RMS",
            "bias",
            "contact off mm",
            "ripple",
            "overlap mm",
            "chatter"
        )?;
        for r in &comparison.by_speed {
            let [from, to] = r.speed_mm_s;
            let speeds = if from == to { format!("{from:.1}") } else { format!("{from:.1}-{to:.1}") };
            if r.samples == 0 {
                writeln!(f, "{speeds:>11} {:>8}   (no sample that both engines kept)", 0)?;
                continue;
            }
            writeln!(
                f,
                "{speeds:>11} {:>8} {:>8.1}% {:>15.4} {:>8.4} {:>11.4} {:>8.4} {:>6.2}% {:>7.3} {:>8.3} {:>10.4} {:>11.3} {:>7.2}%",
                r.samples,
                r.elsewhere * 100.0,
                r.moment_nmm[0],
                r.moment_nmm[1],
                r.moment_rms_nmm[0],
                r.moment_rms_nmm[1],
                r.bias * 100.0,
                r.contact_mm[0],
                r.contact_mm[1],
                r.ripple_nmm,
                r.overlap_mm,
                r.chatter * 100.0
            )?;
        }
        let verdicts: Vec<String> = comparison.verdicts.iter().map(|(v, n)| format!("{v}: {n}")).collect();
        writeln!(
            f,
            "both kept {} of {}; verdicts by MuJoCo / rod: {}",
            comparison.kept[0],
            comparison.kept[1],
            verdicts.join(", ")
        )?;
        match comparison.bias_per_mm_s {
            Some([slope, sd]) => writeln!(
                f,
                "speed bias of the mean moment: {:.2} +- {:.2} % a mm/s (one standard deviation)",
                slope * 100.0,
                sd * 100.0
            ),
            None => writeln!(f, "speed bias of the mean moment: not known, the speeds are too few"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_cover_the_plans_speeds() {
        assert_eq!(speed_edges(&SweepPlan::default()), [3.0, 4.0, 5.0, 6.0, 7.0]);
    }
}
