//! `dataset.json`, and its summary for a person.

use super::arguments::SimulateArgs;
use crate::dataset::{Dataset, Total, mujoco, shard};
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use wcal::picture_output::provenance;
use wcal_core::Provenance;
use wcal_lab_sweeps::SweepPlan;
use wcal_lab_sweeps::convex::Convex;
use wcal_lab_sweeps::rod_comparison::{ComparisonSum, RodComparison};
use wcal_lab_sweeps::rod_engine::LINKS;
use wcal_mujoco::mjcf::MjcfOptions;

/// What the summary warns of.
pub struct Faults {
    /// Objects that are left out.
    pub left_out: Vec<String>,
    /// Remarks on meshes.
    pub notes: Vec<String>,
    /// What is not there.
    pub missing: Vec<String>,
}

/// What MuJoCo's sweeps get wrong, as far as it can be measured without a whisker.
#[derive(Debug, Default, Serialize, JsonSchema)]
pub struct Twin {
    /// MuJoCo's sweeps against the rod's (engine mujoco).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against_rod: Option<RodComparison>,
    /// Convex parts by object (engine mujoco).
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub convex: BTreeMap<String, ConvexRow>,
}

/// An object's convex parts.
#[derive(Debug, Serialize, JsonSchema)]
pub struct ConvexRow {
    /// Parts.
    pub parts: usize,
    /// Largest distance of the parts from the mesh, and of the mesh from the parts, mm.
    pub beyond_mm: f64,
    /// Largest distance of the mesh from the parts, mm.
    pub short_mm: f64,
    /// The larger of the two, mm.
    pub hausdorff_mm: f64,
}

impl Twin {
    /// Of a dataset in a folder; nothing where the rod made it.
    pub fn of(dataset: &Dataset, totals: &BTreeMap<String, Total>, folder: &Path) -> Self {
        let mut sum: Option<ComparisonSum> = None;
        for more in totals.values().filter_map(|t| t.against_rod.as_ref()) {
            sum.get_or_insert_default().merge(more);
        }
        let row = |c: Convex| ConvexRow {
            parts: c.parts.len(),
            beyond_mm: c.beyond_mm,
            short_mm: c.short_mm,
            hausdorff_mm: c.hausdorff_mm(),
        };
        let Some(sum) = sum else {
            return Self::default();
        };
        let parts = mujoco::convex_parts(dataset, folder).into_iter();
        Self {
            against_rod: Some(sum.table()),
            convex: parts.map(|(name, c)| (name, row(c))).collect(),
        }
    }
}

/// Summary of a folder of SIMULATED sweeps.
#[derive(Debug, Serialize, JsonSchema)]
pub struct DatasetDocument {
    /// Format and version.
    #[schemars(extend("const" = shard::FORMAT))]
    pub format: &'static str,
    /// Always true.
    pub simulated: bool,
    /// Engine and its settings, in words.
    pub engine: String,
    /// Seed.
    pub seed: u64,
    /// Sweeps over each object.
    pub sweeps_per_object: u64,
    /// Share of the work, i/n.
    pub share: String,
    /// How sweeps are drawn (the plan's keys).
    pub plan: SweepPlan,
    /// The wire that the sweeps are of.
    pub whisker: String,
    /// Sweeps.
    pub sweeps: u64,
    /// Of them kept.
    pub kept: u64,
    /// Samples.
    pub samples: u64,
    /// Sweeps by verdict: kept, no-section, no-contact, starts-inside, torque-too-high,
    /// contact-jump, no-equilibrium, engine-died.
    pub verdicts: BTreeMap<String, u64>,
    /// How often the wire touched, came free, sprang or slipped: onset, release, jump, slip.
    pub events: BTreeMap<String, u64>,
    /// By object.
    pub objects: BTreeMap<String, ObjectRow>,
    /// Objects left out, with the reason.
    pub left_out: Vec<String>,
    /// Remarks on meshes and engine.
    pub notes: Vec<String>,
    /// Shards that are missing or damaged (with --check); absent where none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<String>,
    /// Sweeps a second and core.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sweeps_per_core_s: Option<f64>,
    /// What the paper's whole set would take at this rate, processor hours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub core_h_per_15600_sweeps: Option<f64>,
    /// What MuJoCo's sweeps get wrong.
    #[serde(flatten)]
    pub twin: Twin,
    /// What made the document.
    pub provenance: Provenance,
}

/// Sweeps over an object.
#[derive(Debug, Serialize, JsonSchema)]
pub struct ObjectRow {
    /// Sweeps.
    pub sweeps: u64,
    /// Of them kept.
    pub kept: u64,
    /// Sweeps by verdict: kept, no-section, no-contact, starts-inside, torque-too-high,
    /// contact-jump, no-equilibrium, engine-died.
    pub verdicts: BTreeMap<String, u64>,
    /// How often the wire touched, came free, sprang or slipped: onset, release, jump, slip.
    pub events: BTreeMap<String, u64>,
}

/// Sweeps of the paper's set: 78 objects, 200 each.
const PAPER_SWEEPS: f64 = 15_600.0;

/// The document of a dataset.
pub fn document(
    args: &SimulateArgs,
    dataset: &Dataset,
    mujoco: Option<&MjcfOptions>,
    totals: &BTreeMap<String, Total>,
    faults: Faults,
    twin: Twin,
) -> DatasetDocument {
    let summed = |of: fn(&Total) -> &BTreeMap<String, u64>| {
        let mut sum: BTreeMap<String, u64> = BTreeMap::new();
        for (name, count) in totals.values().flat_map(of) {
            *sum.entry(name.clone()).or_default() += count;
        }
        sum
    };
    let row = |t: &Total| ObjectRow {
        sweeps: t.sweeps,
        kept: t.kept(),
        verdicts: t.verdicts.clone(),
        events: t.events.clone(),
    };
    let (made, core_s) = totals
        .values()
        .fold((0, 0.0), |a, t| (a.0 + t.made, a.1 + t.core_s));
    let rate = (core_s > 0.0).then(|| made as f64 / core_s);
    DatasetDocument {
        format: shard::FORMAT,
        simulated: true,
        engine: match mujoco {
            None => format!("rod, quasi-static, {LINKS} links"),
            Some(MjcfOptions {
                links,
                damping_s,
                step_s,
                ..
            }) => {
                format!(
                    "MuJoCo, {links} links, damping {damping_s} s, step {step_s} s, convex parts"
                )
            }
        },
        seed: dataset.seed,
        sweeps_per_object: dataset.sweeps,
        share: args.shard.clone(),
        plan: dataset.plan.clone(),
        whisker: format!("{:?}", dataset.whisker),
        sweeps: totals.values().map(|t| t.sweeps).sum(),
        kept: totals.values().map(Total::kept).sum(),
        samples: totals.values().map(|t| t.samples).sum(),
        verdicts: summed(|t| &t.verdicts),
        events: summed(|t| &t.events),
        objects: totals
            .iter()
            .map(|(name, t)| (name.clone(), row(t)))
            .collect(),
        left_out: faults.left_out,
        notes: faults.notes,
        missing: faults.missing,
        sweeps_per_core_s: rate,
        core_h_per_15600_sweeps: rate.map(|rate| PAPER_SWEEPS / rate / 3600.0),
        twin,
        provenance: Provenance {
            seed: dataset.seed,
            ..provenance(
                args.whisker
                    .iter()
                    .chain(&args.plan)
                    .chain(&args.meshes)
                    .map(PathBuf::as_path),
            )
        },
    }
}

/// The same for people.
pub fn print(document: &DatasetDocument, totals: &BTreeMap<String, Total>) {
    println!(
        "{:<32} {:>7} {:>7}  rejected",
        "object (SIMULATED)", "sweeps", "kept"
    );
    for (name, total) in totals {
        let why: Vec<String> = total
            .verdicts
            .iter()
            .filter(|(v, _)| *v != "kept")
            .map(|(v, n)| format!("{v} {n}"))
            .collect();
        println!(
            "{name:<32} {:>7} {:>7}  {}",
            total.sweeps,
            total.kept(),
            why.join(", ")
        );
    }
    let events: Vec<String> = document
        .events
        .iter()
        .map(|(e, n)| format!("{n} {e}"))
        .collect();
    println!(
        "{} sweeps, {} kept, {} samples",
        document.sweeps, document.kept, document.samples
    );
    println!(
        "events: {}",
        if events.is_empty() {
            "none".to_owned()
        } else {
            events.join(", ")
        }
    );
    if let Some(rate) = document.sweeps_per_core_s {
        println!("{rate:.1} sweeps a second and core");
    }
    if let Some(hours) = document.core_h_per_15600_sweeps {
        println!("15,600 sweeps (78 objects, 200 each) at this rate: {hours:.2} core hours");
    }
    let twin = &document.twin;
    for (name, c) in &twin.convex {
        println!(
            "{name}: {} convex parts; Hausdorff distance from the mesh {:.3} mm ({:.3} beyond it, {:.3} short of it)",
            c.parts, c.hausdorff_mm, c.beyond_mm, c.short_mm
        );
    }
    if let Some(table) = &twin.against_rod {
        print!("{table}");
    }
}
