//! Cloud and surface of the contacts beside the table.

use super::output::companion;
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::path::Path;
use wcal_contact::contact_history::ContactHistory;
use wcal_track::surface::{CloudPoint, ImplicitSurface, SurfaceSettings, cloud_ply};

/// Writes the cloud and the surface of all whiskers beside the table, and what they are for track.json.
///
/// # Errors
/// Where the disk does not take it.
pub fn write_surface(out: &Path, all: &[&ContactHistory]) -> Result<Value> {
    let cloud: Vec<CloudPoint> = all.iter().flat_map(|f| f.cloud().iter().copied()).collect();
    if cloud.is_empty() {
        eprintln!(
            "warning: --surface: no row with contact and a known place of the base: neither cloud nor surface"
        );
        return Ok(json!({"frame": null, "points": 0, "surface_points": 0}));
    }
    let frame = if all.iter().any(|f| f.posed()) { "world" } else { "base at the first row" };
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
