//! `shapes.json` (format `wcal-shapes/1`): what the cameras saw of the wire in each pair of
//! pictures, and how wrong it may be.
//!
//! A pair's observations are stacked in one vector `z` = (centre line at the stations, groove
//! position, contact arc length, length), base frame, mm. Its error is
//!
//! ```text
//! dz_i = sum_k own_ik a_ik + sum_p shared_ip q_p + floor_i b_i      a_ik, b_i ~ N(0, 1) independent,  q ~ N(0, shared_covariance)
//! cov(z_i, z_j) = delta_ij (sum_k own_ik own_ik^T + floor_i^2 I) + S_i C S_j^T
//! ```
//! with a pair's own errors (the pictures' noise: pieces of the wire, corners of its tags) and the
//! derivatives `S_i` = `shared` of what all pairs share: the cameras' calibration, the base's tags,
//! the rig tag's orientation, the light across the line, the form of the wire's end. A parameter of
//! zero variance is taken as known by `stereo-shape`; its derivative says what an error of it would
//! do (`board-scale`, a rig tag glued askew). Source: JCGM 102:2011, 6.2 (propagation of a
//! covariance matrix).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Format tag of `shapes.json`.
pub const SHAPES_FORMAT: &str = "wcal-shapes/1";

/// A tag in one picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TagDocument {
    /// Number.
    pub id: u32,
    /// `left` or `right`.
    pub camera: String,
    /// Corners, px, in the tag's frame: (-,+), (+,+), (+,-), (-,-).
    pub corners_px: [[f64; 2]; 4],
    /// Standard deviations of the corners, px.
    #[serde(default)]
    pub corners_sd_px: [f64; 4],
}

/// A stretch that a picture does not show.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Gap {
    /// Start, arc length, mm.
    pub from_mm: f64,
    /// End, arc length, mm.
    pub to_mm: f64,
    /// `left`, `right`: the pictures that hide it.
    #[serde(default)]
    pub hidden_in: Vec<String>,
}

/// The groove's contact.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GrooveDocument {
    /// The wire's centre in the vertex, base frame, mm.
    pub position_mm: [f64; 3],
    /// Standard deviations, mm.
    pub sd_mm: [f64; 3],
    /// Arc length of the contact from the root, mm.
    pub contact_arclength_mm: f64,
    /// Its standard deviation, mm.
    pub contact_arclength_sd_mm: f64,
    /// Unit tangent of the wire in the groove, base frame: the groove's axis follows it.
    #[serde(default)]
    pub axis: [f64; 3],
    /// `vertex` (on both flanks), `double` (arched over the vertex, on the two rims),
    /// `out-of-vertex` (on one flank), `none`.
    #[serde(default)]
    #[schemars(extend("enum" = ["vertex", "double", "out-of-vertex", "none"]))]
    pub contact: String,
    /// Arc lengths of the contacts, mm: none, one, or the two rims.
    #[serde(default)]
    pub contacts_mm: Vec<f64>,
    /// Distance of the wire from the vertex position that the tag states, mm.
    #[serde(default)]
    pub distance_from_vertex_mm: f64,
    /// Where the groove's flanks meet, base frame, mm; none where the wire is not deflected enough
    /// to tell the push's direction.
    pub apex_mm: Option<[f64; 3]>,
    /// Vertex position by the rig tag alone, base frame, mm.
    #[serde(default)]
    pub by_tag_mm: [f64; 3],
    /// Covariance of the position, base frame, mm^2, shared errors included.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub covariance_mm2: Option<[[f64; 3]; 3]>,
}

/// A parameter whose error all pairs share; its place in [`ShapesDocument::shared_parameters`] is
/// its place in every list.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
pub struct SharedParameter {
    /// Name, e.g. `left fx`, `right_from_left tz`, `board-scale`, `base-tag rx`, `rig-tag y`,
    /// `line`, `end`.
    pub name: String,
    /// Unit: `px`, `rad`, `mm`, or `1`.
    pub unit: String,
    /// Effect or step that it belongs to: `cameras` (calibration), `board-scale`, `base-tag`,
    /// `rig-tag`, `line`, `end`.
    pub cause: String,
}

/// What one error does to a pair's observations: a standard deviation of it (own errors) or a unit
/// of it (shared parameters).
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ErrorColumn {
    /// Displacement of the centre line at each of [`PairErrors::stations`], base frame, mm (a
    /// unit).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub centreline_mm: Vec<[f64; 3]>,
    /// Displacement of [`GrooveDocument::position_mm`], mm (a unit); zero without groove.
    pub groove_mm: [f64; 3],
    /// Change of [`GrooveDocument::contact_arclength_mm`], mm (a unit).
    pub contact_arclength_mm: f64,
    /// Change of [`PairDocument::length_mm`], mm (a unit).
    pub length_mm: f64,
}

/// Errors of a pair's observations; the module says what they add up to.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct PairErrors {
    /// Places of the centre line that count as observations: indices into
    /// [`PairDocument::centreline_mm`], rising.
    pub stations: Vec<usize>,
    /// Arc lengths of the stations from the root, mm.
    pub stations_mm: Vec<f64>,
    /// Errors of this pair alone, one standard deviation each, independent of each other and of
    /// other pairs' errors.
    pub own: Vec<ErrorColumn>,
    /// Standard deviation of what the list of own errors leaves out, every coordinate, mm.
    pub floor_mm: f64,
    /// Derivatives by the shared parameters, in their order.
    pub shared: Vec<ErrorColumn>,
}

/// What the shapes were made from: verified before they are used with other data.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct ShapesSource {
    /// SHA-256 of the file of the cameras; of all files in order where there are several; empty
    /// where it was not stated.
    pub cameras_sha256: String,
    /// SHA-256 of the rig's tables `whisker`, `tags` and `groove` as canonical JSON; empty where it
    /// was not stated.
    pub rig_sha256: String,
    /// `id` of the session whose pictures they are; none outside a session.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
}

/// Hash by which the rig of some shapes is recognised: [`crate::provenance::sha256_hex`] of the
/// tables `whisker`, `tags` and `groove` of a rig file as JSON with sorted keys. Addresses, speeds
/// and comments do not count.
pub fn rig_sha256(rig: &serde_json::Value) -> String {
    let parts: serde_json::Map<String, serde_json::Value> = ["groove", "tags", "whisker"]
        .into_iter()
        .filter_map(|key| Some((key.to_owned(), rig.get(key)?.clone())))
        .collect();
    crate::provenance::sha256_hex(crate::provenance::canonical_json(&parts.into()).as_bytes())
}

/// One pair.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct PairDocument {
    /// Name.
    pub name: String,
    /// `ok` or `rejected`.
    #[schemars(extend("enum" = ["ok", "rejected"]))]
    pub status: String,
    /// Reason of a rejection.
    pub why: String,
    /// Point of the session whose pose it shows; null where the pictures belong to none.
    pub point: Option<i64>,
    /// 4 x 4, mm: takes base coordinates to the left camera's; empty where the base is not seen.
    pub left_from_base: Vec<[f64; 4]>,
    /// Tags seen.
    pub tags: Vec<TagDocument>,
    /// Centre line from root to tip, base frame, mm.
    pub centreline_mm: Vec<[f64; 3]>,
    /// Standard deviation across the line: the 95 % radius in the plane across it, over 2.4477.
    pub centreline_sd_mm: Vec<f64>,
    /// Length, mm.
    pub length_mm: f64,
    /// Standard deviation of the length, mm.
    pub length_sd_mm: f64,
    /// Errors of the observations, a pair's own and shared ones; absent for pairs that were
    /// rejected.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub errors: Option<PairErrors>,
    /// Stretches not seen.
    pub gaps: Vec<Gap>,
    /// The groove's contact; null where the rig tag is not seen.
    pub groove: Option<GrooveDocument>,
    /// RMS distance of the measured pieces from the reprojected curve, left and right, px.
    pub residual_rms_px: [f64; 2],
    /// Remarks.
    pub warnings: Vec<String>,
}

/// The wire's shape in pairs of pictures, base frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
pub struct ShapesDocument {
    /// Format and version.
    #[schemars(extend("const" = SHAPES_FORMAT))]
    pub format: String,
    /// Pairs in order of their names.
    pub pairs: Vec<PairDocument>,
    /// Parameters whose errors all pairs share; their order is that of every list.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_parameters: Vec<SharedParameter>,
    /// Their covariance, in the order and units of the list, row by row.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_covariance: Vec<Vec<f64>>,
    /// What the shapes were made from.
    #[serde(default)]
    pub source: ShapesSource,
    /// Remarks on the folder as a whole.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// What made it.
    #[serde(default)]
    pub provenance: crate::Provenance,
}
