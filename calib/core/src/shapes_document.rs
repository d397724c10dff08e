//! `shapes.json` (format `wcal-shapes/1`).

use serde::{Deserialize, Serialize};

/// Format tag of `shapes.json`.
pub const SHAPES_FORMAT: &str = "wcal-shapes/1";

/// A tag in one picture.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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
    /// `vertex` (on both flanks), `double` (arched over the vertex, on the two rims), `out-of-vertex` (on one flank), `none`.
    #[serde(default)]
    pub contact: String,
    /// Arc lengths of the contacts, mm: none, one, or the two rims.
    #[serde(default)]
    pub contacts_mm: Vec<f64>,
    /// Distance of the wire from the vertex position that the tag states, mm.
    #[serde(default)]
    pub distance_from_vertex_mm: f64,
    /// Where the groove's flanks meet, base frame, mm; none where the wire is not deflected enough to tell the push's direction.
    #[serde(default)]
    pub apex_mm: Option<[f64; 3]>,
    /// Vertex position by the rig tag alone, base frame, mm.
    #[serde(default)]
    pub by_tag_mm: [f64; 3],
}

/// What one standard deviation of an error does to a wire.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct SharedError {
    /// "cameras", "line" or "end".
    pub cause: String,
    /// Displacement of each point of the centre line, base frame, mm; empty: none moves.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub displacement_mm: Vec<[f64; 3]>,
    /// Change of the length, mm.
    pub length_mm: f64,
}

/// One pair.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct PairDocument {
    /// Name.
    pub name: String,
    /// `ok` or `rejected`.
    pub status: String,
    /// Reason of a rejection.
    #[serde(default)]
    pub why: String,
    /// Takes base coordinates to left camera coordinates, mm.
    #[serde(default)]
    pub left_from_base: Vec<[f64; 4]>,
    /// Tags seen.
    #[serde(default)]
    pub tags: Vec<TagDocument>,
    /// Centre line from root to tip, base frame, mm.
    #[serde(default)]
    pub centreline_mm: Vec<[f64; 3]>,
    /// Standard deviation across the line: the 95 % radius in the plane across it, over 2.4477.
    #[serde(default)]
    pub centreline_sd_mm: Vec<f64>,
    /// Length, mm.
    #[serde(default)]
    pub length_mm: f64,
    /// Standard deviation of the length, mm.
    #[serde(default)]
    pub length_sd_mm: f64,
    /// Independent errors that all pairs share, in the same order for every pair: the cameras' calibration, largest part first, the whole
    /// line (uneven light), and the form of the wire's end. They are in the standard deviations above too.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shared_errors: Vec<SharedError>,
    /// Stretches not seen.
    #[serde(default)]
    pub gaps: Vec<Gap>,
    /// Groove; none where the rig tag is not seen.
    #[serde(default)]
    pub groove: Option<GrooveDocument>,
    /// RMS distance of the measured pieces from the reprojected curve, left and right, px.
    #[serde(default)]
    pub residual_rms_px: [f64; 2],
    /// Remarks.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// `shapes.json`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct ShapesDocument {
    /// Always [`SHAPES_FORMAT`].
    pub format: String,
    /// Pairs in order of their names.
    pub pairs: Vec<PairDocument>,
    /// Remarks on the folder as a whole.
    #[serde(default)]
    pub warnings: Vec<String>,
    /// What made it.
    #[serde(default)]
    pub provenance: crate::Provenance,
}
