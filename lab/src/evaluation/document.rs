//! `evaluation.json`: errors with their intervals, mean over objects and object by object. Numbers
//! that do not exist (a mean over nothing) are NaN here and null there.

use crate::bootstrap::{ErrorOf, mean_interval95, object_interval95};
use crate::evaluate::ObjectScores;
use crate::score::{Detection, Scores};
use schemars::JsonSchema;
use serde::Serialize;
use std::collections::BTreeMap;
use wcal_core::provenance::Provenance;
use wcal_core::verify_document::Verdict;

/// Format of evaluation.json.
pub const FORMAT: &str = "wcal-evaluation/1";

/// 95 % interval; none where there is too little to draw from.
pub type Interval = Option<[f64; 2]>;

/// The document.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct EvaluationDocument {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    pub format: &'static str,
    /// Always true.
    pub simulated: bool,
    /// SHA-256 of the weights.
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    pub model: String,
    /// Always null: the virtual bench makes its own.
    pub calibration: Option<String>,
    /// Sweeps as the network was trained on.
    pub simulation: Simulation,
    /// How intervals were made.
    pub bootstrap: Bootstrap,
    /// Every method on every set.
    pub methods: Vec<MethodRow>,
    /// Inputs and program.
    pub provenance: Provenance,
    /// The tracker on the groove of the bench's session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub known_motion: Option<KnownMotion>,
    /// On the virtual bench.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub virtual_real: Option<VirtualReal>,
    /// Objects set aside for tests.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub test_objects: Option<TestObjects>,
}

/// Errors on sweeps as the network was trained on.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Simulation {
    /// Method of these numbers.
    pub method: &'static str,
    /// Mean RMSE to the surface over the objects, mm.
    #[serde(flatten)]
    pub means: Means,
}

/// Means over seen and unseen objects, mm, and the objects' rows.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Means {
    /// Seen objects.
    pub seen_mean_mm: f64,
    /// Unseen objects.
    pub unseen_mean_mm: f64,
    /// Intervals of both.
    pub interval95: BTreeMap<&'static str, Interval>,
    /// By object.
    pub objects: Vec<ObjectRow>,
}

impl Means {
    /// Of the scores of both sets.
    pub fn of(seen: &[ObjectScores], unseen: &[ObjectScores]) -> Self {
        let objects = seen.iter().map(|o| ObjectRow::of(o, "seen"));
        Self {
            seen_mean_mm: mean(seen, |o| o.all.rmse_mm),
            unseen_mean_mm: mean(unseen, |o| o.all.rmse_mm),
            interval95: both_means(seen, unseen),
            objects: objects
                .chain(unseen.iter().map(|o| ObjectRow::of(o, "unseen")))
                .collect(),
        }
    }
}

/// How intervals were made.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct Bootstrap {
    /// Level.
    pub level: f64,
    /// For means.
    pub means: &'static str,
    /// For one object.
    pub object: &'static str,
}

impl Default for Bootstrap {
    fn default() -> Self {
        Self {
            level: 0.95,
            means: "whole objects are drawn again",
            object: "whole sweeps are drawn again",
        }
    }
}

/// A method on a set of objects.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct MethodRow {
    /// Set.
    pub set: &'static str,
    /// Method.
    pub method: &'static str,
    /// RMSE to the surface, mm.
    pub rmse_mm: f64,
    /// To the true contact, mm.
    pub true_contact_rmse_mm: f64,
    /// 95 % quantile of the error, mm.
    pub p95_mm: f64,
    /// RMSE once the contact is followed, mm.
    pub followed_rmse_mm: f64,
    /// To the true contact, mm.
    pub followed_true_contact_rmse_mm: f64,
    /// F1 of contact.
    pub detection_f1: f64,
    /// Intervals by key.
    pub interval95: BTreeMap<&'static str, Interval>,
}

impl MethodRow {
    /// Means over the objects.
    pub fn of(set: &'static str, method: &'static str, rows: &[ObjectScores]) -> Self {
        Self {
            set,
            method,
            rmse_mm: mean(rows, |o| o.all.rmse_mm),
            true_contact_rmse_mm: mean(rows, |o| o.all.true_contact_rmse_mm),
            p95_mm: mean(rows, |o| o.all.p95_mm),
            followed_rmse_mm: mean(rows, |o| o.followed.rmse_mm),
            followed_true_contact_rmse_mm: mean(rows, |o| o.followed.true_contact_rmse_mm),
            detection_f1: mean(rows, |o| o.detection.f1),
            interval95: intervals(rows),
        }
    }
}

/// An object.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct ObjectRow {
    /// Name.
    pub name: String,
    /// Set.
    pub set: &'static str,
    /// RMSE to the surface, mm.
    pub rmse_mm: f64,
    /// To the true contact, mm.
    pub true_contact_rmse_mm: f64,
    /// Along the base's way, mm.
    pub along_track_mm: f64,
    /// 95 % quantile of the error, mm.
    pub p95_mm: f64,
    /// Share of true contacts in their 90 % regions.
    pub coverage90: Option<f64>,
    /// Once the contact is followed.
    pub followed: Scores,
    /// Contact or not.
    pub detection: Detection,
    /// Sweeps.
    pub sweeps: usize,
    /// Intervals by key.
    pub interval95: BTreeMap<&'static str, Interval>,
}

impl ObjectRow {
    /// The row of an object's scores.
    pub fn of(o: &ObjectScores, set: &'static str) -> Self {
        let interval = |of: ErrorOf| object_interval95(&o.sweeps, of);
        Self {
            name: o.name.clone(),
            set,
            rmse_mm: o.all.rmse_mm,
            true_contact_rmse_mm: o.all.true_contact_rmse_mm,
            along_track_mm: o.all.along_track_mm,
            p95_mm: o.all.p95_mm,
            coverage90: o.all.coverage90,
            followed: o.followed,
            detection: o.detection,
            sweeps: o.sweeps.len(),
            interval95: BTreeMap::from([
                ("rmse_mm", interval(|s| s.surface)),
                ("true_contact_rmse_mm", interval(|s| s.contact)),
                ("along_track_mm", interval(|s| s.along)),
            ]),
        }
    }
}

/// The tracker on the groove of a session, whose motion is known, by `verify`'s own calibration,
/// beside the bound on its error.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct KnownMotion {
    /// Always true: SIMULATED.
    #[serde(rename = "virtual")]
    pub is_virtual: bool,
    /// RMSE, mm.
    pub error_mm: f64,
    /// Bound, mm.
    pub bound_mm: f64,
    /// One over the other.
    pub error_over_bound: f64,
    /// Trajectories.
    pub trajectories: usize,
    /// Those whose 95 % region holds the truth.
    pub trajectories_held: usize,
    /// Readings.
    pub readings: usize,
    /// What was held out.
    pub split: String,
}

/// The tracker on the virtual bench, through its own calibration.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct VirtualReal {
    /// Coverage of 90 % regions.
    pub coverage90: BySet,
    /// Always true: SIMULATED.
    #[serde(rename = "virtual")]
    pub is_virtual: bool,
    /// Mean over seen objects, mm.
    pub seen_mean_mm: f64,
    /// Mean over unseen objects, mm.
    pub unseen_mean_mm: f64,
    /// Worst object, mm.
    pub worst_mm: f64,
    /// Intervals of these.
    pub interval95: BTreeMap<&'static str, Interval>,
    /// Effects that act.
    pub acting: Vec<String>,
    /// What `verify` said.
    pub verdict: Verdict,
    /// Effects that it accepted.
    pub accepted: Vec<String>,
    /// Command whose calibration was used.
    pub calibration: &'static str,
    /// By object.
    pub objects: Vec<ObjectRow>,
}

/// A number for each set.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct BySet {
    /// Seen objects.
    pub seen: f64,
    /// Unseen objects.
    pub unseen: f64,
}

/// Objects set aside for tests.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct TestObjects {
    /// Since when.
    pub set_aside: &'static str,
    /// Which.
    pub names: Vec<&'static str>,
    /// By method and draw.
    pub rows: Vec<TestRow>,
}

/// A method on a draw of the objects set aside.
#[derive(Debug, Clone, Serialize, JsonSchema)]
pub struct TestRow {
    /// How the objects are turned.
    pub turns: &'static str,
    /// Method.
    pub method: &'static str,
    /// Whether the base's speed is known to it.
    pub speed_known: bool,
    /// RMSE to the surface, mm.
    pub rmse_mm: f64,
    /// To the true contact, mm.
    pub true_contact_rmse_mm: f64,
    /// Share of true contacts in their 90 % regions.
    pub coverage90: f64,
    /// Intervals by key.
    pub interval95: BTreeMap<&'static str, Interval>,
    /// By object.
    pub objects: Vec<ObjectRow>,
}

/// Mean over objects; not a number without any.
pub fn mean(rows: &[ObjectScores], value: impl Fn(&ObjectScores) -> f64) -> f64 {
    rows.iter().map(value).sum::<f64>() / rows.len() as f64
}

/// Mean share of true contacts in their 90 % regions.
pub(crate) fn coverage90(rows: &[ObjectScores]) -> f64 {
    mean(rows, |o| o.all.coverage90.unwrap_or(f64::NAN))
}

/// Errors of a row that are means over objects.
const MEANS: [(&str, ErrorOf); 4] = [
    ("rmse_mm", |s| s.surface),
    ("true_contact_rmse_mm", |s| s.contact),
    ("followed_rmse_mm", |s| s.followed_surface),
    ("followed_true_contact_rmse_mm", |s| s.followed_contact),
];

/// 95 % intervals of the means over objects.
pub(crate) fn intervals(rows: &[ObjectScores]) -> BTreeMap<&'static str, Interval> {
    MEANS
        .iter()
        .map(|(name, of)| (*name, mean_interval95(rows, *of)))
        .collect()
}

/// 95 % intervals of the two means.
pub(crate) fn both_means(
    seen: &[ObjectScores],
    unseen: &[ObjectScores],
) -> BTreeMap<&'static str, Interval> {
    let of: ErrorOf = |s| s.surface;
    BTreeMap::from([
        ("seen_mean_mm", mean_interval95(seen, of)),
        ("unseen_mean_mm", mean_interval95(unseen, of)),
    ])
}
