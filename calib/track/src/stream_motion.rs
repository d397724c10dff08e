//! How base and object move at the rows of a stream: by the stage's positions in it, or by its own
//! log.
//!
//! ```text
//! [base] carried_along a      base at world_from_base a x(t), object at rest: d = -a x
//! mount of a trajectory       the stage carries the groove along its direction p: d = p x, push p; each mount begins a new piece
//! --motion LOG, poses         d(t), Q(t) by the log
//! ```
//!
//! A row's moments went through a low-pass; the motion is averaged by the same weights.

use crate::reading::{Reading, RowMotion};
use crate::track_document::StreamMotionDocument;
use nalgebra::{Isometry3, Rotation3, Vector3};
use std::collections::BTreeMap;
use wcal_acquisition::message::SweepEvent;
use wcal_acquisition::rig::{BaseRig, Rig};
use wcal_network::stream::BaseMotion;
use wcal_session::{MotionLog, MotionUnknown};

/// Times at which a motion is averaged over the filter.
pub(crate) const KERNEL: usize = 21;

/// The motion of a stream.
pub(crate) struct StreamMotion {
    base: Option<BaseMotion>,
    base_mm_s: Option<f64>,
    /// Groove that the stage carries, base frame, since a trajectory was mounted, with the
    /// trajectory's direction.
    groove: Option<(BaseMotion, Vector3<f64>)>,
    mounts: u32,
    trajectories: BTreeMap<u32, Vector3<f64>>,
    zero_mm: f64,
    log: Option<MotionLog>,
}

impl StreamMotion {
    /// Of a rig; a log takes the place of its stage.
    pub(crate) fn new(rig: &Rig, base_mm_s: Option<f64>, log: Option<MotionLog>) -> Self {
        let carried =
            |b: &BaseRig| BaseMotion::new(b.world_from_base.0, b.carried_along.map(Vector3::from));
        Self {
            base: rig.base.as_ref().map(carried),
            base_mm_s,
            groove: None,
            mounts: 0,
            trajectories: rig
                .trajectory
                .iter()
                .map(|t| (t.id, Vector3::from(t.direction)))
                .collect(),
            zero_mm: rig.stage.zero_mm,
            log,
        }
    }

    /// Takes a position of the stage, mm, at a time since the first scan, s.
    pub(crate) fn stage(&mut self, t_s: f64, measured_mm: f64) {
        let groove = self.groove.as_mut().map(|(motion, _)| motion);
        for carried in self.base.iter_mut().chain(groove) {
            carried.push(t_s, measured_mm - self.zero_mm);
        }
    }

    /// Takes what a sweep did: from a mount on, the stage carries the groove along that trajectory,
    /// unless the rig says that it carries the base.
    pub(crate) fn sweep_event(&mut self, event: &SweepEvent) {
        let direction = self
            .trajectories
            .get(&event.trajectory)
            .filter(|_| event.kind == "mount" && self.base.is_none());
        if let Some(direction) = direction {
            self.groove = Some((
                BaseMotion::new(Isometry3::identity(), Some(*direction)),
                *direction,
            ));
            self.mounts += 1;
        }
    }

    /// A reading without moments, whose motion is averaged over the filter's kernel; `middle` is the
    /// free wire's middle, mm.
    pub(crate) fn reading(
        &self,
        (point, t_s): (i64, f64),
        kernel: &[(f64, f64)],
        middle: &Vector3<f64>,
    ) -> Reading {
        let base = self.base.as_ref().and_then(|b| b.at(t_s));
        // The groove goes on as the base would go back.
        let groove = self.groove.as_ref().and_then(|(g, _)| g.at(t_s));
        let past_groove = groove.and_then(|g| g.velocity_mm_s).map(|v| -v);
        let velocity = base.and_then(|b| b.velocity_mm_s).or(past_groove);
        Reading {
            motion: self.relative(t_s, kernel, middle),
            base,
            base_mm_s: base.and_then(|b| b.along_z_mm_s()).or(self.base_mm_s),
            velocity_mm_s: velocity.or(self.base_mm_s.map(|v| Vector3::z() * v)),
            ..Reading::alone(point, t_s, None)
        }
    }

    /// The motion of the object with respect to the base; or why it is not known.
    fn relative(
        &self,
        t_s: f64,
        kernel: &[(f64, f64)],
        middle: &Vector3<f64>,
    ) -> Result<RowMotion, MotionUnknown> {
        if let Some(log) = &self.log {
            return Ok(log.averaged(t_s, middle, kernel)?.into());
        }
        let along = |motion: &BaseMotion, sign: f64, push: Option<Vector3<f64>>| {
            // The weights of the moments' filter: motion and moments are of one time.
            let (moved, velocity) = motion.averaged(t_s, kernel).ok_or(MotionUnknown::Outside)?;
            Ok(RowMotion {
                moved_mm: moved * sign,
                turn: Rotation3::identity(),
                velocity_mm_s: velocity * sign,
                piece: self.mounts,
                push,
            })
        };
        match (&self.base, &self.groove) {
            // The object rests and the base goes: in base coordinates the object goes back.
            (Some(base), _) => along(base, -1.0, None),
            (None, Some((groove, direction))) => along(groove, 1.0, Some(*direction)),
            (None, None) => Err(MotionUnknown::Unknown),
        }
    }

    /// Where the motion comes from, for track.json.
    pub(crate) fn document(&self) -> StreamMotionDocument {
        let log = self.log.as_ref();
        StreamMotionDocument {
            source: match (log, &self.base, self.mounts) {
                (Some(_), ..) => "log",
                (None, Some(_), _) => "stage carries the base",
                (None, None, 0) => "none",
                (None, None, _) => "stage carries the groove",
            },
            span_s: log.map(MotionLog::span_s),
            jump_lines: log.map(|l| l.jumps().collect()),
        }
    }
}
