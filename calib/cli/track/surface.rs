//! Cloud and surface of the contacts beside the table.

use anyhow::{Context, Result};
use std::path::Path;
use wcal_contact::contact_history::ContactHistory;
use wcal_contact::track_document::{SurfaceDocument, SurfaceMeshDocument};
use wcal_contact::track_table::companion;
use wcal_track::surface::{CloudPoint, ImplicitSurface, SurfaceSettings, cloud_ply};

/// Writes the cloud and the surface of all whiskers beside the table, and what they are for track.json.
///
/// # Errors
/// Where the disk does not take it.
pub fn write_surface(out: &Path, all: &[&ContactHistory]) -> Result<SurfaceDocument> {
    let cloud: Vec<CloudPoint> = all.iter().flat_map(|f| f.cloud().iter().copied()).collect();
    if cloud.is_empty() {
        eprintln!(
            "warning: --surface: no row with contact and a known place of the base: neither cloud nor surface"
        );
        return Ok(SurfaceDocument::default());
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
        return Ok(SurfaceDocument { frame: Some(frame), points: cloud.len(), ..SurfaceDocument::default() });
    };
    let mesh = surface.mesh();
    write("-surface.ply", mesh.ply(frame))?;
    Ok(SurfaceDocument {
        frame: Some(frame),
        points: cloud.len(),
        surface_points: surface.contacts().len(),
        mesh: Some(SurfaceMeshDocument {
            corners: mesh.corners_mm.len(),
            triangles: mesh.triangles.len(),
            cell_mm: settings.cell_mm,
            reach_mm: settings.reach_mm,
        }),
    })
}
