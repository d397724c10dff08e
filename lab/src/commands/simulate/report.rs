//! `report.html` of a sweep dataset: counts from the summary, and a sweep of each kind drawn from the shards.

use super::document::{DatasetDocument, Twin};
use crate::commands::page::{Curves, Page, PlainTable};
use crate::dataset::columns::{Column, read};
use anyhow::{Context, bail};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use wcal_report::{Fact, number, percent};

/// Shards that are searched for sweeps to draw.
const MAX_SHARDS: usize = 40;
/// Samples below which a sweep shows nothing.
const MIN_SAMPLES: usize = 8;

type Table = BTreeMap<String, Column>;
type Counts = BTreeMap<String, u64>;

/// The page; `shards` by name, in `folder`.
///
/// # Errors
/// Where a shard cannot be read.
pub fn page(document: &DatasetDocument, folder: &Path, shards: &[String]) -> anyhow::Result<Page> {
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
    let mut notes: Vec<String> = faults.into_iter().flatten().cloned().collect();
    let mut tables = vec![
        counted("Sweeps by verdict", &document.verdicts),
        counted("Events in all sweeps, rejected ones too", &document.events),
        objects(document),
    ];
    if let Some((remarks, table)) = engines(&document.twin) {
        notes.extend(remarks);
        tables.push(table);
    }
    let curves = examples(folder, shards)?;
    let title = format!("{} sweeps over {} objects", document.sweeps, document.objects.len());
    Ok(Page { over: "Sweep dataset".into(), title, facts, notes, curves, tables })
}

/// What the words of verdicts and events mean.
fn meaning(word: &str) -> &'static str {
    match word {
        "kept" => "usable",
        "no-section" => "the drawn plane misses the object within the wire's reach",
        "no-contact" => "the wire never touched",
        "starts-inside" => "the wire began inside the object",
        "torque-too-high" => "the wire's skin was strained past the plan's limit",
        "contact-jump" => "the wire sprang from one equilibrium to another, and the plan rejects that",
        "no-equilibrium" => "the wire did not come to rest in too many samples",
        "onset" => "first touch",
        "release" => "the wire came free",
        "unstable" => "a step went wrong: a value is not finite",
        "penetration" => "the wire sank into the object by more than its radius",
        "chatter" => "the contact opened and closed from step to step",
        "engine-died" => "MuJoCo's program ended; a second run makes these sweeps again",
        "model-refused" => "MuJoCo cannot take one of the object's convex parts",
        "no-convex-parts" => "the object could not be taken apart into convex parts",
        "jump" => "the wire sprang from one equilibrium to another",
        "slip" => "the contact ran along the wire several times faster than the base",
        _ => "",
    }
}

/// Words that were counted, what each means and its share.
fn counted(caption: &str, counts: &Counts) -> PlainTable {
    let all = counts.values().sum::<u64>().max(1) as f64;
    let mut rows: Vec<(&String, &u64)> = counts.iter().collect();
    rows.sort_by_key(|(name, n)| (*name != "kept", std::cmp::Reverse(**n)));
    let row = |(name, n): (&String, &u64)| {
        vec![name.clone(), meaning(name).to_owned(), n.to_string(), percent(*n as f64 / all)]
    };
    PlainTable {
        caption: caption.to_owned(),
        columns: ["what", "meaning", "#number", "#share"].map(str::to_owned).into(),
        rows: rows.into_iter().map(row).collect(),
    }
}

fn objects(document: &DatasetDocument) -> PlainTable {
    let words = |counts: &Counts| {
        let words = counts.iter().filter(|(name, _)| *name != "kept").map(|(name, n)| format!("{name} {n}"));
        words.collect::<Vec<_>>().join(", ")
    };
    let rows = document.objects.iter().map(|(name, row)| {
        let share = percent(row.kept as f64 / row.sweeps.max(1) as f64);
        let counts = [row.sweeps.to_string(), row.kept.to_string(), share];
        let texts = [words(&row.verdicts), words(&row.events)];
        std::iter::once(name.clone()).chain(counts).chain(texts).collect()
    });
    PlainTable {
        caption: "Sweeps over each object".to_owned(),
        columns: ["object", "#sweeps", "#kept", "#share kept", "rejected for", "events"]
            .map(str::to_owned)
            .into(),
        rows: rows.collect(),
    }
}

/// MuJoCo against the rod on the same sweeps, where they were made by both: remarks, and the table by speed.
fn engines(twin: &Twin) -> Option<(Vec<String>, PlainTable)> {
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
    remarks.push(
        "Elsewhere: the contacts are so far apart that the wire is in another equilibrium (one engine has let it spring, the other not yet); \
         the other columns leave these samples out. Bias: mean size of MuJoCo's moment over the rod's, less one; it grows with the speed where \
         damping makes it."
            .to_owned(),
    );
    let row = |r: &wcal_mujoco::rod_comparison::SpeedRow| {
        let [from, to] = r.speed_mm_s.map(number);
        let speed = if from == to { from } else { format!("{from} to {to}") };
        let [moment, moment95] = r.moment_nmm.map(number);
        let [contact, contact95] = r.contact_mm.map(number);
        let rest = [number(r.ripple_nmm), number(r.overlap_mm), percent(r.chatter)];
        let first = [speed, r.samples.to_string(), percent(r.elsewhere), moment, moment95];
        first.into_iter().chain([percent(r.bias), contact, contact95]).chain(rest).collect()
    };
    let columns = [
        "speed, mm/s",
        "#samples",
        "#elsewhere",
        "#moment off, p50, N mm",
        "#p95, N mm",
        "#bias",
        "#contact off, p50, mm",
        "#p95, mm",
        "#ripple, N mm",
        "#overlap, mm",
        "#chatter",
    ];
    let by_speed = PlainTable {
        caption: "The same sweeps by MuJoCo against the rod, by the base's speed".to_owned(),
        columns: columns.map(str::to_owned).into(),
        rows: table.by_speed.iter().map(row).collect(),
    };
    Some((remarks, by_speed))
}

/// A sample of a drawn sweep.
struct Sample {
    t_s: f64,
    /// Transverse base moments y and z, N mm.
    moment_nmm: [f64; 2],
    /// Arc length of the contact nearest to the base, mm; NaN without one.
    arclength_mm: f64,
    /// Event since the sample before; "none" where nothing happened.
    event: String,
}

/// Moments and contact of a sweep; vertical lines at events.
fn drawn(title: &str, samples: &[Sample]) -> [Curves; 2] {
    let line = |of: &dyn Fn(&Sample) -> f64| samples.iter().map(|s| [s.t_s, of(s)]).collect();
    let happened = samples.iter().filter(|s| s.event != "none");
    let moments = Curves {
        title: title.to_owned(),
        x: "time, s".to_owned(),
        y: "moment, N mm".to_owned(),
        lines: vec![
            ("moment y".to_owned(), line(&|s| s.moment_nmm[0])),
            ("moment z".to_owned(), line(&|s| s.moment_nmm[1])),
        ],
        marks: happened.map(|s| (s.t_s, s.event.clone())).collect(),
    };
    let contact = Curves {
        y: "arc length, mm".to_owned(),
        lines: vec![("contact nearest to the base".to_owned(), line(&|s| s.arclength_mm))],
        ..moments.clone()
    };
    [moments, contact]
}

/// One sweep for each verdict and each event, the first that there is.
fn examples(folder: &Path, shards: &[String]) -> anyhow::Result<Vec<Curves>> {
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
                found.extend(drawn(&format!("{shard}, sweep {index}: {verdict}"), samples));
            }
        }
    }
    Ok(found)
}

fn by_sweep(table: &Table) -> anyhow::Result<BTreeMap<i64, Vec<Sample>>> {
    let [t, y, z, arc] =
        ["t_s", "moment_y_nmm", "moment_z_nmm", "contact_arclength_mm"].map(|n| real(table, n));
    let (t, y, z, arc) = (t?, y?, z?, arc?);
    let events = text(table, "event")?;
    let mut all: BTreeMap<i64, Vec<Sample>> = BTreeMap::new();
    for (k, sweep) in whole(table, "sweep")?.iter().enumerate() {
        all.entry(*sweep).or_default().push(Sample {
            t_s: t[k].unwrap_or(f64::NAN),
            moment_nmm: [y[k], z[k]].map(|m| m.unwrap_or(f64::NAN)),
            arclength_mm: arc[k].unwrap_or(f64::NAN),
            event: events[k].clone(),
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
