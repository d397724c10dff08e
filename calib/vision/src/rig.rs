//! The parts of `rig.toml` that the pictures need: whisker, tags, groove.

use crate::error::VisionError;
use nalgebra::Vector3;
use serde::Deserialize;
use std::path::Path;
use wcal_core::document::{DocumentError, from_toml};
use wcal_core::observation::WHISKER_RANGES;
use wcal_core::rig_devices::{GrooveRig, RIG_FORMAT, RIG_RANGES, TagRig};

#[derive(Deserialize)]
struct RigFile {
    whisker: WhiskerFile,
    #[serde(default)]
    tags: Vec<TagRig>,
    groove: Option<GrooveRig>,
}

#[derive(Deserialize)]
struct WhiskerFile {
    diameter_mm: f64,
    length_mm: f64,
    straight_mm: Option<f64>,
    arc_radius_mm: Option<f64>,
}

/// Nominal whisker.
#[derive(Debug, Clone, PartialEq)]
pub struct RigWhisker {
    /// Wire diameter, mm.
    pub diameter_mm: f64,
    /// Nominal length, mm.
    pub length_mm: f64,
    /// Straight part, mm; the whole length where the file states none.
    pub straight_mm: f64,
    /// Curvature of the rest, 1/mm; 0 where the file states no radius.
    pub arc_curvature_per_mm: f64,
}

/// The groove.
#[derive(Debug, Clone, PartialEq)]
pub struct RigGroove {
    /// Tag that carries it.
    pub tag: u32,
    /// Centre of the wire in the vertex, in that tag's frame, mm.
    pub position_in_tag_mm: Vector3<f64>,
    /// Half angle of the V, degrees.
    pub half_angle_deg: f64,
    /// Extent along the wire, mm.
    pub width_along_wire_mm: f64,
}

/// What the pictures need of a rig.
#[derive(Debug, Clone, PartialEq)]
pub struct Rig {
    /// Whisker.
    pub whisker: RigWhisker,
    /// Tags.
    pub tags: Vec<TagRig>,
    /// Groove, where described by a tag.
    pub groove: Option<RigGroove>,
    /// What the file says twice.
    pub remarks: Vec<String>,
}

impl Rig {
    /// Reads `rig.toml`.
    ///
    /// # Errors
    /// Where the file is missing, no TOML, or a field is missing or out of range.
    pub fn read(path: &Path) -> Result<Self, VisionError> {
        let text = wcal_core::files::read_text(path)?;
        Self::parse(&path.display().to_string(), &text)
    }

    /// Parses the text of a `rig.toml`.
    ///
    /// # Errors
    /// As [`Rig::read`].
    pub fn parse(name: &str, text: &str) -> Result<Self, VisionError> {
        // Rigs for pictures alone have been written without a format.
        let named = text.lines().any(|l| l.trim_start().starts_with("format"));
        let whole = if named {
            text.to_owned()
        } else {
            format!("format = \"{RIG_FORMAT}\"\n{text}")
        };
        let file: RigFile =
            from_toml(&whole, RIG_FORMAT, &[RIG_RANGES, WHISKER_RANGES]).map_err(|e| match e {
                DocumentError::Range(e) => {
                    VisionError::content(name, format!("{}: {}", e.key, e.expected), e.found)
                }
                other => VisionError::content(
                    name,
                    "a rig with [whisker] and [[tags]]",
                    other.to_string(),
                ),
            })?;
        let w = file.whisker;
        let length_mm = w.length_mm;
        let whisker = RigWhisker {
            diameter_mm: w.diameter_mm,
            length_mm,
            straight_mm: w.straight_mm.unwrap_or(length_mm),
            arc_curvature_per_mm: w.arc_radius_mm.map_or(0.0, |radius_mm| 1.0 / radius_mm),
        };
        let (tags, remarks) = each_once(name, file.tags)?;
        if !tags.iter().any(|t| t.base_from_tag.is_some()) {
            return Err(VisionError::content(
                name,
                "a tag with base_from_tag (on the base)",
                "none",
            ));
        }
        let groove = file.groove.and_then(|g| {
            Some(RigGroove {
                tag: g.tag?,
                position_in_tag_mm: Vector3::from(g.position_in_tag_mm?),
                half_angle_deg: g.half_angle_deg.unwrap_or(45.0),
                width_along_wire_mm: g.width_along_wire_mm.unwrap_or(0.0),
            })
        });
        if let Some(g) = &groove
            && !tags.iter().any(|t| t.id == g.tag)
        {
            return Err(VisionError::content(
                name,
                format!("a [[tags]] entry for groove.tag = {}", g.tag),
                "none",
            ));
        }
        Ok(Self {
            whisker,
            tags,
            groove,
            remarks,
        })
    }
}

/// Counts a tag that is stated twice once.
fn each_once(name: &str, stated: Vec<TagRig>) -> Result<(Vec<TagRig>, Vec<String>), VisionError> {
    let (mut tags, mut remarks): (Vec<TagRig>, _) = (Vec::new(), Vec::new());
    for tag in stated {
        match tags
            .iter()
            .find(|t| t.id == tag.id && t.family == tag.family)
        {
            None => tags.push(tag),
            Some(same) if *same == tag => {
                remarks.push(format!(
                    "{name}: tag {} {} is stated twice: counted once",
                    tag.family, tag.id
                ));
            }
            Some(other) => {
                return Err(VisionError::content(
                    name,
                    format!("one [[tags]] entry for {} {}", tag.family, tag.id),
                    format!(
                        "two that differ (side {} and {} mm, body {:?} and {:?})",
                        other.size_mm, tag.size_mm, other.body, tag.body
                    ),
                ));
            }
        }
    }
    Ok((tags, remarks))
}
