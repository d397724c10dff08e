//! Shards: what a block of sweeps over one object gave, in three tables and a manifest that is
//! written last.
//!
//! `OBJECT-FIRST.sweeps.parquet`, a row a sweep: `sweep`, `kept` (0 or 1), `verdict` (kept,
//! no-section, no-contact, starts-inside, torque-too-high, contact-jump, no-equilibrium),
//! `speed_mm_s` at the start, `gap_mm`, and the object's pose in the base frame at the start:
//! `base_from_object_q{w,x,y,z}`, `base_from_object_{x,y,z}_mm`; in time it moves along -z by
//! `travel_mm`. Then the drawn physics: `friction_coefficient`, `softening_onset_per_m` (absent:
//! linear), `medium` (none, air, water), `current_{x,y,z}_mm_s` (of the medium, base directions),
//! `gravity_{x,y,z}` (unit vector, base directions; absent: weightless).
//!
//! `.samples.parquet`, a row a sample: `sweep`, `sample`, `t_s`, `travel_mm`, `speed_mm_s`,
//! `moment_{x,y,z}_nmm` at the root (the gratings see y and z), `contacts` (their number),
//! `contact_{x,y,z}_mm`, `contact_arclength_mm` and `contact_force_n` of the one nearest to the
//! base (absent without contact), `settled` (0 or 1), `event` (none, onset, release, jump, slip).
//!
//! `.contacts.parquet`, a row a contact: `sweep`, `sample`, `contact` (from the base on), `x_mm`,
//! `y_mm`, `z_mm` (a point of the mesh), `normal_{x,y,z}` (direction of the force on the wire),
//! `arclength_mm`, `force_n` along the normal, `gap_mm` (negative: overlap), `friction_{x,y,z}_n`
//! (force on the wire across the normal), `sticks` (1: within the friction cone; 0: slides, or has
//! no friction).
//!
//! Manifests of shards by MuJoCo sum up how far the rod is on the same sweeps.

use super::columns::{Column, to_bytes};
use super::engine::{Block, Outcome};
use crate::LabError;
use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::document::from_json;
use wcal_core::files::write_atomic;
use wcal_core::provenance::sha256_hex;
use wcal_core::ranges::Range;
use wcal_lab_sweeps::contact::Contact;
use wcal_lab_sweeps::rod_comparison::ComparisonSum;
use wcal_lab_sweeps::rod_engine::Run;
use wcal_lab_sweeps::sweep::{ENGINE_DIED, Event};
use wcal_lab_sweeps::{Sample, Sweep, Verdict};

/// Version of the tables.
pub const FORMAT: &str = "wcal-sweeps/1";

/// What a shard holds, and the checksums of its tables.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Manifest {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    pub format: String,
    /// Always true: no shard is measured.
    #[schemars(extend("const" = true))]
    pub simulated: bool,
    /// Object.
    pub object: String,
    /// SHA-256 of engine, whisker, plan, mesh and seed: what the tables follow from.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub made_from: String,
    /// First sweep and their number.
    pub sweeps: [u64; 2],
    /// Processor seconds of the making: not part of what is reproducible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub core_s: Option<f64>,
    /// How many were kept, and how many were rejected for which reason.
    pub verdicts: BTreeMap<String, u64>,
    /// Samples in all.
    pub samples: u64,
    /// How often the wire touched, came free, sprang or slipped.
    #[serde(default)]
    pub events: BTreeMap<String, u64>,
    /// What went wrong with the object or the engine, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// MuJoCo's sweeps beside the rod's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub against_rod: Option<ComparisonSum>,
    /// SHA-256 of each table.
    pub sha256: BTreeMap<String, String>,
}

const RANGES: &[Range] = &[
    Range::real("core_s", 0.0, 1e12),
    Range::real("speed_mm_s", 0.0, 1e12),
    Range::real("squares", 0.0, 1e12),
    Range::real("sizes", 0.0, 1e12),
    Range::real("overlap_mm", 0.0, 1e12),
    Range::whole("", 0.0, 1e12),
];

/// Share of the friction cone below which a contact counts as sticking.
const STICKS: f64 = 0.98;

/// A shard that is there, whole, of the same making, and of these sweeps (first and number).
///
/// # Errors
/// Says what is missing, damaged or of another making.
pub fn done(
    folder: &Path,
    name: &str,
    made_from: &str,
    sweeps: [u64; 2],
) -> Result<Manifest, LabError> {
    let path = folder.join(format!("{name}.json"));
    let manifest = read_manifest(&path)?;
    let other = |detail: String| LabError::Shard {
        path: path.clone(),
        detail,
    };
    if manifest.made_from != made_from {
        return Err(other(
            "made from another wire, plan, mesh or seed, or by an earlier version of wcal"
                .to_owned(),
        ));
    }
    if manifest.sweeps != sweeps {
        return Err(other(format!(
            "expected first sweep and number {sweeps:?}, found {:?}",
            manifest.sweeps
        )));
    }
    if let Some(died) = manifest.verdicts.get(ENGINE_DIED) {
        return Err(other(format!("the engine died in {died} of its sweeps")));
    }
    check(folder, &manifest)?;
    Ok(manifest)
}

/// # Errors
/// Where the manifest cannot be read.
pub fn read_manifest(path: &Path) -> Result<Manifest, LabError> {
    let text = wcal_core::files::read_text(path)?;
    from_json(&text, FORMAT, &[RANGES]).map_err(|e| LabError::Shard {
        path: path.to_owned(),
        detail: e.to_string(),
    })
}

/// Compares the tables with their checksums.
///
/// # Errors
/// Names the first table that is missing or differs.
pub fn check(folder: &Path, manifest: &Manifest) -> Result<(), LabError> {
    for (table, expected) in &manifest.sha256 {
        let path = folder.join(table);
        let bytes = wcal_core::files::read(&path)?;
        let found = sha256_hex(&bytes);
        if found != *expected {
            return Err(LabError::Shard {
                path,
                detail: format!("expected SHA-256 {expected}, found {found}"),
            });
        }
    }
    Ok(())
}

/// Writes a shard; each file is complete or not there.
///
/// # Errors
/// Where the folder cannot be written.
pub(crate) fn write(
    folder: &Path,
    name: &str,
    object: &str,
    made_from: &str,
    block: &Block,
    core_s: f64,
) -> Result<Manifest, LabError> {
    let outcomes = &block.outcomes[..];
    let about = [
        ("format", FORMAT.to_owned()),
        ("simulated", "true".to_owned()),
        ("object", object.to_owned()),
    ];
    let mut manifest = Manifest {
        format: FORMAT.to_owned(),
        simulated: true,
        object: object.to_owned(),
        made_from: made_from.to_owned(),
        sweeps: [outcomes.first().map_or(0, |o| o.0), outcomes.len() as u64],
        core_s: Some(core_s),
        verdicts: BTreeMap::new(),
        samples: 0,
        events: BTreeMap::new(),
        notes: block.notes.clone(),
        against_rod: block.against_rod.clone(),
        sha256: BTreeMap::new(),
    };
    for (_, outcome) in outcomes {
        let name = outcome
            .as_ref()
            .map_or("no-section", |(_, run)| run.verdict.name());
        *manifest.verdicts.entry(name.to_owned()).or_default() += 1;
        for sample in outcome.iter().flat_map(|(_, run)| &run.samples) {
            manifest.samples += 1;
            if sample.event != Event::None {
                *manifest
                    .events
                    .entry(sample.event.name().to_owned())
                    .or_default() += 1;
            }
        }
    }
    let tables = [
        ("sweeps", sweeps(outcomes)),
        ("samples", samples(outcomes)),
        ("contacts", contacts(outcomes)),
    ];
    for (table, columns) in tables {
        let file = format!("{name}.{table}.parquet");
        let bytes = to_bytes(&columns, &about).map_err(|e| LabError::Shard {
            path: folder.join(&file),
            detail: e.to_string(),
        })?;
        manifest.sha256.insert(file.clone(), sha256_hex(&bytes));
        write_whole(&folder.join(&file), &bytes)?;
    }
    let path = folder.join(format!("{name}.json"));
    let text = serde_json::to_string_pretty(&manifest).map_err(|e| LabError::Shard {
        path: path.clone(),
        detail: e.to_string(),
    })?;
    write_whole(&path, text.as_bytes())?;
    Ok(manifest)
}

/// A reader never sees half a file.
///
/// # Errors
/// Where the folder cannot be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), LabError> {
    Ok(write_atomic(path, bytes)?)
}

type Columns = Vec<(&'static str, Column)>;

fn sweeps(outcomes: &[Outcome]) -> Columns {
    let real = |value: &dyn Fn(&Sweep) -> f64| {
        Column::Maybe(
            outcomes
                .iter()
                .map(|(_, o)| o.as_ref().map(|(s, _)| value(s)))
                .collect(),
        )
    };
    let maybe = |value: &dyn Fn(&Sweep) -> Option<f64>| {
        Column::Maybe(
            outcomes
                .iter()
                .map(|(_, o)| o.as_ref().and_then(|(s, _)| value(s)))
                .collect(),
        )
    };
    let medium = |o: &Option<(Sweep, Run)>| {
        o.as_ref()
            .map_or("none", |(s, _)| s.physics.medium.name())
            .to_owned()
    };
    let turn =
        |s: &Sweep| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(s.turn));
    let verdict = |o: &Option<(Sweep, Run)>| {
        o.as_ref()
            .map_or("no-section", |(_, run)| run.verdict.name())
            .to_owned()
    };
    let kept = |o: &Option<(Sweep, Run)>| {
        i64::from(o.as_ref().is_some_and(|(_, r)| r.verdict == Verdict::Kept))
    };
    vec![
        (
            "sweep",
            Column::Whole(outcomes.iter().map(|o| o.0 as i64).collect()),
        ),
        (
            "kept",
            Column::Whole(outcomes.iter().map(|o| kept(&o.1)).collect()),
        ),
        (
            "verdict",
            Column::Text(outcomes.iter().map(|o| verdict(&o.1)).collect()),
        ),
        ("speed_mm_s", real(&|s| s.speed_mm_s)),
        ("gap_mm", real(&|s| s.gap_mm)),
        ("base_from_object_qw", real(&|s| turn(s).w)),
        ("base_from_object_qx", real(&|s| turn(s).i)),
        ("base_from_object_qy", real(&|s| turn(s).j)),
        ("base_from_object_qz", real(&|s| turn(s).k)),
        ("base_from_object_x_mm", real(&|s| s.shift_mm.x)),
        ("base_from_object_y_mm", real(&|s| s.shift_mm.y)),
        ("base_from_object_z_mm", real(&|s| s.shift_mm.z)),
        ("friction_coefficient", real(&|s| s.physics.friction)),
        ("softening_onset_per_m", maybe(&|s| s.physics.onset_per_m())),
        (
            "medium",
            Column::Text(outcomes.iter().map(|o| medium(&o.1)).collect()),
        ),
        ("current_x_mm_s", real(&|s| s.physics.current_mm_s.x)),
        ("current_y_mm_s", real(&|s| s.physics.current_mm_s.y)),
        ("current_z_mm_s", real(&|s| s.physics.current_mm_s.z)),
        ("gravity_x", maybe(&|s| s.physics.gravity.map(|g| g.x))),
        ("gravity_y", maybe(&|s| s.physics.gravity.map(|g| g.y))),
        ("gravity_z", maybe(&|s| s.physics.gravity.map(|g| g.z))),
    ]
}

fn runs(outcomes: &[Outcome]) -> impl Iterator<Item = (i64, &Run)> {
    outcomes
        .iter()
        .filter_map(|(k, o)| Some((*k as i64, &o.as_ref()?.1)))
}

fn samples(outcomes: &[Outcome]) -> Columns {
    let all: Vec<_> = runs(outcomes)
        .flat_map(|(k, r)| r.samples.iter().enumerate().map(move |(i, s)| (k, i, s)))
        .collect();
    let whole = |value: &dyn Fn(&(i64, usize, &Sample)) -> i64| {
        Column::Whole(all.iter().map(value).collect())
    };
    let real =
        |value: &dyn Fn(&Sample) -> f64| Column::Real(all.iter().map(|s| value(s.2)).collect());
    let first = |value: &dyn Fn(&Contact) -> f64| {
        Column::Maybe(
            all.iter()
                .map(|s| s.2.contacts.first().map(value))
                .collect(),
        )
    };
    vec![
        ("sweep", whole(&|s| s.0)),
        ("sample", whole(&|s| s.1 as i64)),
        ("t_s", real(&|s| s.t_s)),
        ("travel_mm", real(&|s| s.travel_mm)),
        ("speed_mm_s", real(&|s| s.speed_mm_s)),
        ("moment_x_nmm", real(&|s| s.moment_nmm.x)),
        ("moment_y_nmm", real(&|s| s.moment_nmm.y)),
        ("moment_z_nmm", real(&|s| s.moment_nmm.z)),
        ("contacts", whole(&|s| s.2.contacts.len() as i64)),
        ("contact_x_mm", first(&|c| c.point_mm.x)),
        ("contact_y_mm", first(&|c| c.point_mm.y)),
        ("contact_z_mm", first(&|c| c.point_mm.z)),
        ("contact_arclength_mm", first(&|c| c.arclength_mm)),
        ("contact_force_n", first(&|c| c.force_n)),
        ("settled", whole(&|s| i64::from(s.2.settled))),
        (
            "event",
            Column::Text(all.iter().map(|s| s.2.event.name().to_owned()).collect()),
        ),
    ]
}

fn contacts(outcomes: &[Outcome]) -> Columns {
    let mut all = Vec::new();
    for (k, run) in runs(outcomes) {
        for (i, sample) in run.samples.iter().enumerate() {
            all.extend(
                sample
                    .contacts
                    .iter()
                    .enumerate()
                    .map(|(n, c)| (k, i as i64, n as i64, c)),
            );
        }
    }
    let coefficient: BTreeMap<i64, f64> = outcomes
        .iter()
        .filter_map(|(k, o)| Some((*k as i64, o.as_ref()?.0.physics.friction)))
        .collect();
    let sticks = |(k, _, _, c): &(i64, i64, i64, &Contact)| {
        i64::from(
            c.friction_n.norm() < STICKS * coefficient.get(k).copied().unwrap_or(0.0) * c.force_n,
        )
    };
    let real =
        |value: &dyn Fn(&Contact) -> f64| Column::Real(all.iter().map(|c| value(c.3)).collect());
    let axes = |value: fn(&Contact) -> Vector3<f64>, k: usize| real(&move |c| value(c)[k]);
    vec![
        ("sweep", Column::Whole(all.iter().map(|c| c.0).collect())),
        ("sample", Column::Whole(all.iter().map(|c| c.1).collect())),
        ("contact", Column::Whole(all.iter().map(|c| c.2).collect())),
        ("x_mm", axes(|c| c.point_mm, 0)),
        ("y_mm", axes(|c| c.point_mm, 1)),
        ("z_mm", axes(|c| c.point_mm, 2)),
        ("normal_x", axes(|c| c.normal, 0)),
        ("normal_y", axes(|c| c.normal, 1)),
        ("normal_z", axes(|c| c.normal, 2)),
        ("arclength_mm", real(&|c| c.arclength_mm)),
        ("force_n", real(&|c| c.force_n)),
        ("gap_mm", real(&|c| c.gap_mm)),
        ("friction_x_n", axes(|c| c.friction_n, 0)),
        ("friction_y_n", axes(|c| c.friction_n, 1)),
        ("friction_z_n", axes(|c| c.friction_n, 2)),
        ("sticks", Column::Whole(all.iter().map(sticks).collect())),
    ]
}
