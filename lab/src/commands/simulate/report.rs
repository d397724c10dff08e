//! `report.html` of a sweep dataset: counts from the summary, and a sweep of each kind drawn from the shards.

use super::document::{DatasetDocument, Twin};
use crate::dataset::columns::{Column, read};
use anyhow::{Context, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use wcal_report::{
    EnginesCompared, ExampleSample, ExampleSweep, Fact, SpeedDifference, SweepsInput, SweptObject,
};

/// Shards that are searched for sweeps to draw.
const MAX_SHARDS: usize = 40;
/// Samples below which a sweep shows nothing.
const MIN_SAMPLES: usize = 8;

type Table = BTreeMap<String, Column>;

/// The page; `shards` by name, in `folder`.
///
/// # Errors
/// Where a shard cannot be read.
pub fn page(document: &DatasetDocument, folder: &Path, shards: &[String]) -> anyhow::Result<SweepsInput> {
    let counts = |of: &BTreeMap<String, u64>| of.iter().map(|(k, n)| (k.clone(), *n)).collect::<Vec<_>>();
    let mut verdicts = counts(&document.verdicts);
    verdicts.sort_by_key(|(name, n)| (name != "kept", std::cmp::Reverse(*n)));
    let objects = document.objects.iter().map(|(name, row)| SweptObject {
        name: name.clone(),
        sweeps: row.sweeps,
        kept: row.kept,
        rejected: counts(&row.verdicts).into_iter().filter(|(v, _)| v != "kept").collect(),
        events: counts(&row.events),
    });
    let mut facts = vec![
        Fact::new("engine", document.engine.clone()),
        Fact::new("sweeps", document.sweeps.to_string()),
        Fact::new("kept", document.kept.to_string()),
        Fact::new("samples", document.samples.to_string()),
        Fact::new("seed", document.seed.to_string()),
        Fact::new("share", document.share.clone()),
        Fact::new("medium", document.plan.physics.medium.name()),
        Fact::new("friction", range(document.plan.physics.friction)),
    ];
    if let Some(rate) = document.sweeps_per_core_s {
        facts.push(Fact::new("sweeps a second and core", format!("{rate:.1}")));
    }
    let faults = [&document.missing, &document.left_out, &document.notes];
    Ok(SweepsInput {
        title: format!("{} sweeps over {} objects", document.sweeps, document.objects.len()),
        facts,
        warnings: faults.into_iter().flatten().cloned().collect(),
        verdicts,
        events: counts(&document.events),
        objects: objects.collect(),
        engines: engines(&document.twin),
        examples: examples(folder, shards)?,
    })
}

fn engines(twin: &Twin) -> Option<EnginesCompared> {
    let table = twin.against_rod.as_ref()?;
    let verdicts: Vec<String> = table.verdicts.iter().map(|(v, n)| format!("{v} {n}")).collect();
    let mut remarks = vec![format!(
        "Both engines kept {} of {} sweeps (verdicts by MuJoCo / by the rod: {}).",
        table.kept[0],
        table.kept[1],
        verdicts.join(", ")
    )];
    if let Some([slope, sd]) = table.bias_per_mm_s {
        remarks.push(format!(
            "The mean moment changes by {:.2} +- {:.2} % a mm/s against the rod's (one standard deviation).",
            slope * 100.0,
            sd * 100.0
        ));
    }
    if let Some(s) = &twin.statics {
        remarks.push(format!(
            "The links alone ({}), under the continuous rod's own force: base moment off by {:.3} %, loaded point by {:.3} %.",
            s.links,
            s.moment_error * 100.0,
            s.point_error * 100.0
        ));
    }
    let worst = twin.convex.iter().max_by(|a, b| a.1.hausdorff_mm.total_cmp(&b.1.hausdorff_mm));
    if let Some((name, c)) = worst {
        remarks.push(format!(
            "Convex parts: at most {:.3} mm from the mesh (Hausdorff; {name}, {} parts).",
            c.hausdorff_mm, c.parts
        ));
    }
    let by_speed = table.by_speed.iter().map(|r| SpeedDifference {
        speed_mm_s: r.speed_mm_s,
        samples: r.samples,
        elsewhere: r.elsewhere,
        moment_nmm: r.moment_nmm,
        bias: r.bias,
        contact_mm: r.contact_mm,
        ripple_nmm: r.ripple_nmm,
        overlap_mm: r.overlap_mm,
        chatter: r.chatter,
    });
    Some(EnginesCompared { remarks, by_speed: by_speed.collect() })
}

/// One sweep for each verdict and each event, the first that there is.
fn examples(folder: &Path, shards: &[String]) -> anyhow::Result<Vec<ExampleSweep>> {
    let (mut seen, mut found) = (BTreeSet::new(), Vec::new());
    // Spread over the objects.
    let step = shards.len().div_ceil(MAX_SHARDS).max(1);
    for shard in shards.iter().step_by(step) {
        let table = |kind: &str| -> anyhow::Result<Option<Table>> {
            let path = folder.join(format!("{shard}.{kind}.parquet"));
            if !path.exists() {
                return Ok(None);
            }
            Ok(Some(read(&path).with_context(|| format!("reading {}", path.display()))?))
        };
        let (Some(sweeps), Some(samples)) = (table("sweeps")?, table("samples")?) else { continue };
        let by_sweep = by_sweep(&samples)?;
        for (index, verdict) in whole(&sweeps, "sweep")?.iter().zip(text(&sweeps, "verdict")?) {
            let Some(samples) = by_sweep.get(index).filter(|s| s.len() >= MIN_SAMPLES) else { continue };
            let events: BTreeSet<&str> =
                samples.iter().map(|s| s.event.as_str()).filter(|e| *e != "none").collect();
            let new: Vec<String> = [verdict.as_str()]
                .into_iter()
                .chain(events)
                .filter(|word| !seen.contains(*word))
                .map(str::to_owned)
                .collect();
            if !new.is_empty() {
                seen.extend(new);
                found.push(ExampleSweep {
                    title: format!("{shard}, sweep {index}: {verdict}"),
                    samples: samples.clone(),
                });
            }
        }
    }
    Ok(found)
}

fn by_sweep(table: &Table) -> anyhow::Result<BTreeMap<i64, Vec<ExampleSample>>> {
    let [t, y, z, arc] =
        ["t_s", "moment_y_nmm", "moment_z_nmm", "contact_arclength_mm"].map(|n| real(table, n));
    let (t, y, z, arc) = (t?, y?, z?, arc?);
    let (events, settled) = (text(table, "event")?, whole(table, "settled")?);
    let mut all: BTreeMap<i64, Vec<ExampleSample>> = BTreeMap::new();
    for (k, sweep) in whole(table, "sweep")?.iter().enumerate() {
        all.entry(*sweep).or_default().push(ExampleSample {
            t_s: t[k].unwrap_or(f64::NAN),
            moment_nmm: [y[k], z[k]].map(|m| m.unwrap_or(f64::NAN)),
            contact_arclength_mm: arc[k],
            event: events[k].clone(),
            settled: settled[k] == 1,
        });
    }
    Ok(all)
}

fn whole<'a>(table: &'a Table, name: &str) -> anyhow::Result<&'a [i64]> {
    match table.get(name) {
        Some(Column::Whole(values)) => Ok(values),
        None => Ok(&[]),
        _ => bail!("column {name}: expected whole numbers"),
    }
}

fn text<'a>(table: &'a Table, name: &str) -> anyhow::Result<&'a [String]> {
    match table.get(name) {
        Some(Column::Text(values)) => Ok(values),
        None => Ok(&[]),
        _ => bail!("column {name}: expected words"),
    }
}

fn real<'a>(table: &'a Table, name: &str) -> anyhow::Result<&'a [Option<f64>]> {
    match table.get(name) {
        Some(Column::Maybe(values)) => Ok(values),
        None => Ok(&[]),
        _ => bail!("column {name}: expected numbers"),
    }
}

/// What a drawn value ranges over.
fn range([low, high]: [f64; 2]) -> String {
    if low == high { format!("{low}") } else { format!("{low} to {high}") }
}
