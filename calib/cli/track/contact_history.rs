//! What is made of all rows of a whisker: contact intervals, and the cloud of contacts for a surface.

use super::output::companion;
use anyhow::{Context, Result};
use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};
use serde_json::{Value, json};
use std::path::Path;
use wcal_track::network::Prediction;
use wcal_track::segments::SegmentFinder;
use wcal_track::stream::BasePose;
use wcal_track::surface::{CloudPoint, ImplicitSurface, SurfaceSettings, cloud_ply};

/// Contacts of this probability and more are points of the surface.
const TOUCHED: f32 = 0.9;

/// What is made of the rows of one whisker.
#[derive(Debug, Default)]
pub struct ContactHistory {
    segments: SegmentFinder,
    cloud: Vec<CloudPoint>,
    last_s: Option<f64>,
    /// Way of the base along its +z since the first row by its speed, mm.
    way_mm: f64,
    posed: bool,
}

impl ContactHistory {
    /// ErrorOf a whisker.
    pub fn new(whisker: &str) -> Self {
        Self { segments: SegmentFinder::new(whisker), ..Self::default() }
    }

    /// Takes a row and gives the segment that it belongs to.
    pub fn row(
        &mut self,
        t_s: f64,
        answer: Option<&Prediction>,
        base: Option<BasePose>,
        base_mm_s: Option<f64>,
    ) -> Option<u64> {
        let step_s = self.last_s.replace(t_s).map_or(0.0, |last| t_s - last);
        let step_mm = base_mm_s.unwrap_or(0.0) * step_s;
        self.way_mm += step_mm;
        let Some(p) = answer else {
            self.segments.gap();
            return None;
        };
        let point_mm = Vector3::from(p.point_mm.map(f64::from));
        let covariance = Matrix3::from_fn(|i, j| f64::from(p.covariance_mm2[i][j]));
        let known_way = base.map(|b| b.world_from_base).or_else(|| {
            base_mm_s.map(|_| {
                Isometry3::from_parts(
                    Translation3::new(0.0, 0.0, self.way_mm),
                    nalgebra::UnitQuaternion::identity(),
                )
            })
        });
        if let (Some(world_from_base), true) = (known_way, p.contact >= TOUCHED) {
            self.posed |= base.is_some();
            let pose = BasePose { world_from_base, velocity_mm_s: None };
            let (point_mm, covariance_mm2) = pose.to_world(&point_mm, &covariance);
            let normal = world_from_base.rotation * Vector3::from(p.normal.map(f64::from));
            self.cloud.push(CloudPoint { point_mm, covariance_mm2, normal });
        }
        self.segments.push(t_s, f64::from(p.contact), point_mm, covariance, step_mm)
    }

    /// Probable contacts where the way of the base is known, in the frame that it moves in, mm.
    pub fn contacts_mm(&self) -> Vec<Vector3<f64>> {
        self.cloud.iter().map(|c| c.point_mm).collect()
    }

    /// Readings are missing before the next row.
    pub fn gap(&mut self) {
        self.segments.gap();
    }

    /// SegmentFinder for track.json.
    pub fn segments(&self) -> Value {
        json!(self.segments.all())
    }
}

/// Writes the cloud and the surface of all whiskers beside the table, and what they are for track.json.
///
/// # Errors
/// Where the disk does not take it.
pub fn write_surface(out: &Path, all: &[&ContactHistory]) -> Result<Value> {
    let cloud: Vec<CloudPoint> = all.iter().flat_map(|f| f.cloud.iter().copied()).collect();
    if cloud.is_empty() {
        eprintln!(
            "warning: --surface: no row with contact and a known place of the base: neither cloud nor surface"
        );
        return Ok(json!({"frame": null, "points": 0, "surface_points": 0}));
    }
    let frame = if all.iter().any(|f| f.posed) { "world" } else { "base at the first row" };
    let write = |ending: &str, text: String| -> Result<()> {
        let path = companion(out, ending);
        wcal_core::files::write_atomic(&path, text.as_bytes())
            .with_context(|| format!("writing {}", path.display()))
    };
    write("-cloud.ply", cloud_ply(&cloud, frame))?;
    let settings = SurfaceSettings::default();
    let Some(surface) = ImplicitSurface::new(&cloud, settings) else {
        eprintln!(
            "warning: --surface: no contact is known to {} mm: a cloud, but no surface",
            settings.max_sd_mm
        );
        return Ok(json!({"frame": frame, "points": cloud.len(), "surface_points": 0}));
    };
    let mesh = surface.mesh();
    write("-surface.ply", mesh.ply(frame))?;
    Ok(json!({"frame": frame, "points": cloud.len(), "surface_points": surface.contacts().len(),
        "corners": mesh.corners_mm.len(), "triangles": mesh.triangles.len(), "cell_mm": settings.cell_mm, "reach_mm": settings.reach_mm}))
}
