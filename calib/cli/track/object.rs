//! How far contacts lie from the object of an imported sweep.

use anyhow::Result;
use nalgebra::Vector3;
use std::path::Path;
use wcal_contact::mesh_score::{MeshScore, mesh_score};
use wcal_contact::sweep_session::SweepSession;
use wcal_sim::Mesh;

/// Score of contact points in the frame of the base's poses, mm; none for a table of another kind, or with too few.
///
/// # Errors
/// Where the mesh cannot be read.
pub fn object_score(table: &Path, contacts_mm: &[Vector3<f64>]) -> Result<Option<MeshScore>> {
    let sweep = table.parent().map(SweepSession::of).transpose()?.flatten();
    let Some((object, pose)) = sweep.and_then(|s| Some((s.object?, s.world_from_object))) else {
        return Ok(None);
    };
    Ok(mesh_score(contacts_mm, &Mesh::read(&object)?, pose))
}

/// Contacts farther than this from a mesh whose place is known do not belong to it, mm, in the median.
const MAX_MEDIAN_MM: f64 = 1.0;

/// What speaks against contacts that lie off an object whose place is known; none where nothing does.
pub fn off_object(score: Option<&MeshScore>) -> Option<String> {
    let s = score.filter(|s| !s.placed_by_points && s.median_mm > MAX_MEDIAN_MM)?;
    Some(format!(
        "contacts and object do not belong together: expected a median distance of at most {MAX_MEDIAN_MM} mm, found {:.2} mm (the place or unit of the \
         mesh, the motion or its clock, the calibration, the wire, or the object)",
        s.median_mm
    ))
}

/// The score for people.
pub fn say_object_score(score: Option<&MeshScore>) {
    let Some(s) = score else { return };
    eprintln!(
        "{} contacts lie {:.2} mm RMS from the object's mesh (median {:.2}, 95 % below {:.2}){}",
        s.points,
        s.rmse_mm,
        s.median_mm,
        s.p95_mm,
        if s.placed_by_points {
            "; its place was fitted to them (six numbers: --object-pose of wcal import takes it where it is known)"
        } else {
            ""
        }
    );
}
