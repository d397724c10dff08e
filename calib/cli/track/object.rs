//! The object of a sweep: distances of the contacts from it.

use anyhow::Result;
use std::path::Path;
use wcal_mesh::Mesh;
use wcal_session::sweep_session::SweepSession;
use wcal_track::mesh_score::{KnownObject, MeshScore};

/// Contacts farther than this from a mesh whose place is known do not belong to it, mm, in the
/// median.
const MAX_MEDIAN_MM: f64 = 1.0;

/// The object of the sweep session that a table belongs to; stated places lie a radius from its
/// surface. None where no mesh is known, or not where it lies.
///
/// # Errors
/// A description or mesh that cannot be read.
pub(crate) fn passed_object(table: &Path, radius_mm: f64) -> Result<Option<KnownObject>> {
    let Some(sweep) = table.parent().map(SweepSession::of).transpose()?.flatten() else {
        return Ok(None);
    };
    let (Some(mesh), Some(world_from_object)) = (sweep.object, sweep.world_from_object) else {
        return Ok(None);
    };
    Ok(Some(KnownObject::new(
        Mesh::read(&mesh)?,
        world_from_object,
        radius_mm,
    )?))
}

/// What speaks against contacts that lie off an object whose place is known; none where nothing
/// does.
pub(crate) fn off_object(score: Option<&MeshScore>) -> Option<String> {
    let s = score.filter(|s| s.distances.median_mm > MAX_MEDIAN_MM)?;
    Some(format!(
        "contacts and object do not belong together: expected a median distance of at most {MAX_MEDIAN_MM} mm, found {:.2} mm (the place or unit of the \
         mesh, the motion or its clock, the calibration, the wire, or the object)",
        s.distances.median_mm
    ))
}

/// The score for people; nothing without one.
pub(crate) fn said_of_object(score: Option<&MeshScore>) -> Vec<String> {
    let said = |s: &MeshScore| {
        let d = &s.distances;
        format!(
            "{} contacts lie {:.2} mm RMS from the outside of the object's mesh (mean {:.2}, median {:.2}, 95 % below {:.2})",
            s.points, d.rmse_mm, d.mean_mm, d.median_mm, d.p95_mm
        )
    };
    score.map(said).into_iter().collect()
}
