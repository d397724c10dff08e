//! The object of a sweep: distances of the contacts, and whether moments, motion and object belong together.

use super::TrackArgs;
use anyhow::{Context, Result, bail, ensure};
use nalgebra::Vector3;
use std::path::Path;
use wcal_contact::mesh_score::{KnownObject, MeshScore, placed_score};
use wcal_contact::object_judgement::ObjectJudgement;
use wcal_contact::sweep_session::{SweepSession, pose_of};
use wcal_contact::sweep_witness::SweepWitness;
use wcal_contact::trust::WhiskerModel;
use wcal_core::CalibrationFrame;
use wcal_core::observation::MomentAxes;
use wcal_core::stream::Flags;
use wcal_sim::Mesh;

/// Largest standard deviation of a place, mm.
const MAX_SD_MM: f64 = 100.0;
/// Loaded poses of a calibration that does not say how many it has: the paper's.
const USUAL_POSES: usize = 27;
/// Contacts farther than this from a mesh whose place is known do not belong to it, mm, in the median.
const MAX_MEDIAN_MM: f64 = 1.0;

/// The object that a table passes.
pub struct PassedObject {
    sweep: SweepSession,
}

impl PassedObject {
    /// Of the options, else of the sweep that the table belongs to; none where no mesh is known.
    ///
    /// # Errors
    /// A pose or a deviation that is none.
    pub fn of(args: &TrackArgs, table: &Path) -> Result<Option<Self>> {
        let motion = (args.motion.clone().unwrap_or_else(|| table.to_owned()), args.motion_offset_s);
        let own = table.parent().map(SweepSession::of).transpose()?.flatten();
        let sweep = match &args.object {
            None => own.map(|sweep| SweepSession { motion, ..sweep }),
            Some(mesh) => {
                let pose = args.object_pose.as_ref().map(|numbers| {
                    pose_of(numbers).with_context(|| {
                        format!("--object-pose: expected x,y,z (mm) and a unit quaternion qw,qx,qy,qz, found {numbers:?}")
                    })
                });
                let sd_mm = args.object_sd_mm;
                ensure!(
                    (0.0..=MAX_SD_MM).contains(&sd_mm),
                    "--object-sd-mm: expected 0 to {MAX_SD_MM} mm, found {sd_mm}"
                );
                Some(SweepSession {
                    id: table.display().to_string(),
                    points: table.to_owned(),
                    motion,
                    object: Some(mesh.clone()),
                    world_from_object: pose.transpose()?,
                    object_sd_mm: sd_mm,
                })
            }
        };
        Ok(sweep.filter(|s| s.object.is_some()).map(|sweep| Self { sweep }))
    }

    fn mesh(&self) -> Result<Mesh> {
        match &self.sweep.object {
            Some(mesh) => Ok(Mesh::read(mesh)?),
            None => bail!("{}: expected a mesh, found none", self.sweep.id),
        }
    }

    /// Judges a calibration along the motion; none where the place of the object is not known.
    ///
    /// # Errors
    /// Where mesh or table cannot be read.
    pub fn judge(&self, loaded: &WhiskerModel<'_>) -> Result<Option<ObjectJudgement>> {
        let Some(declared) = loaded.file.whisker.as_ref().filter(|_| self.sweep.world_from_object.is_some())
        else {
            return Ok(None);
        };
        let axes = loaded.file.frame.as_ref().map_or_else(MomentAxes::default, CalibrationFrame::moments);
        let calibration = loaded.calibration()?;
        let poses = calibration.poses().unwrap_or(USUAL_POSES);
        let witness = SweepWitness::new(self.sweep.clone(), (declared, &axes), poses)?;
        Ok(Some(ObjectJudgement::new(&witness, calibration, declared)?))
    }

    /// The object with what its contacts are flagged with, where its place is known; stated places lie a radius from its surface.
    ///
    /// # Errors
    /// Where the mesh cannot be read.
    pub fn known(&self, radius_mm: f64, agrees: bool) -> Result<Option<(KnownObject, Flags)>> {
        let Some(world_from_object) = self.sweep.world_from_object else { return Ok(None) };
        let flags = if agrees { Flags::default() } else { Flags::OBJECT_DISAGREES };
        Ok(Some((KnownObject::new(self.mesh()?, world_from_object, radius_mm)?, flags)))
    }

    /// Scores contacts in the frame of the base's poses; none where there are too few.
    ///
    /// # Errors
    /// Where the mesh cannot be read.
    pub fn score(&self, contacts_mm: &[Vector3<f64>], radius_mm: f64) -> Result<Option<MeshScore>> {
        Ok(match self.known(radius_mm, true)? {
            Some((object, _)) => object.score(contacts_mm),
            None => placed_score(contacts_mm, &self.mesh()?.outside()?),
        })
    }
}

/// What speaks against contacts that lie off an object whose place is known; none where nothing does.
pub fn off_object(score: Option<&MeshScore>) -> Option<String> {
    let s = score.filter(|s| !s.placed_by_points && s.distances.median_mm > MAX_MEDIAN_MM)?;
    Some(format!(
        "contacts and object do not belong together: expected a median distance of at most {MAX_MEDIAN_MM} mm, found {:.2} mm (the place or unit of the \
         mesh, the motion or its clock, the calibration, the wire, or the object)",
        s.distances.median_mm
    ))
}

/// The score for people.
pub fn say_object_score(score: Option<&MeshScore>) {
    let Some(s) = score else { return };
    let d = &s.distances;
    let placed = match &s.place_free {
        Some(free) => format!(
            "; with its place free within 1 mm (moved by {:.2}, {:.2}, {:.2} mm): mean {:.2}, {:.2} RMS, 95 % below {:.2}",
            free.moved_mm[0],
            free.moved_mm[1],
            free.moved_mm[2],
            free.distances.mean_mm,
            free.distances.rmse_mm,
            free.distances.p95_mm
        ),
        None => "; its place was fitted to them (six numbers: --object-pose takes it where it is known)"
            .to_owned(),
    };
    let any_face = s.any_face.map_or_else(String::new, |any| {
        format!("; from the nearest of all its faces, inner walls included, {:.2} in the mean", any.mean_mm)
    });
    eprintln!(
        "{} contacts lie {:.2} mm RMS from the outside of the object's mesh (mean {:.2}, median {:.2}, 95 % below {:.2}{any_face}){placed}",
        s.points, d.rmse_mm, d.mean_mm, d.median_mm, d.p95_mm
    );
}
