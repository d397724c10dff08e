//! Readings of a sweep beside the object: moments, poses of the base, and the sweep's own zero.

use crate::ContactError;
use crate::known_motion::MotionLog;
use crate::motion_table;
use crate::sweep_session::SweepSession;
use crate::table_source::base_pose;
use crate::zero::steady;
use nalgebra::{Isometry3, Matrix2, Matrix3, Translation3, Vector2, Vector3};
use wcal_calibration::{SensedRow, WhiskerCalibration};
use wcal_core::observation::WhiskerSpec;
use wcal_core::wire_frame::WireFrame;

/// Free readings that a zero needs at least.
const MIN_FREE: usize = 3;
/// A zero that is this many standard deviations off at the end, and this share of the largest moment, has drifted.
const DRIFT_SDS: f64 = 5.0;
const DRIFT_SHARE: f64 = 0.03;

/// What is taken for wrong, one thing at a time; the default is nothing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Trial {
    /// Factor on the moments.
    pub gain: f64,
    /// What the clock of the motion is ahead beyond what is known, s.
    pub clock_s: f64,
    /// Turn and scale of the base's places.
    pub motion: Matrix3<f64>,
    /// Standard deviation of the object's place, mm, in place of the stated one.
    pub placed_sd_mm: Option<f64>,
}

impl Default for Trial {
    fn default() -> Self {
        Self { gain: 1.0, clock_s: 0.0, motion: Matrix3::identity(), placed_sd_mm: None }
    }
}

/// A reading, moments in the frame of the wire.
#[derive(Debug, Clone)]
pub(crate) struct SweepRow {
    t_s: f64,
    pub moment_nmm: Vector2<f64>,
    pub noise_nmm2: Matrix2<f64>,
    pub shared_nmm: Vec<Vector2<f64>>,
    pub world_from_base: Isometry3<f64>,
}

/// Readings of a sweep through a calibration, and the motion.
pub(crate) struct SweepRecord {
    rows: Vec<SweepRow>,
    log: MotionLog,
}

impl SweepRecord {
    /// Of a sweep.
    ///
    /// # Errors
    /// Where its tables cannot be read, or a reading has no time.
    pub fn new(
        session: &SweepSession,
        calibration: &dyn WhiskerCalibration,
        (whisker, frame): (&WhiskerSpec, &WireFrame),
    ) -> Result<Self, ContactError> {
        let sensed = calibration.sensed(&session.points, whisker)?;
        let (file, offset_s) = &session.motion;
        let log = motion_table::read(file, *offset_s)?.log;
        let place = session.points.display();
        let row = |r: &SensedRow| {
            let what = || format!("{place}: line {}: t_s", r.line);
            let t_s = r.t_s.ok_or_else(|| ContactError::value(what(), "a time", "none"))?;
            Ok(SweepRow {
                t_s,
                moment_nmm: Vector2::from(frame.moment(r.sensed.moment_nmm)),
                noise_nmm2: frame.covariance(&r.sensed.noise_nmm2),
                shared_nmm: r.sensed.shared_nmm.iter().map(|h| frame.moment(*h).into()).collect(),
                world_from_base: Isometry3::identity(),
            })
        };
        let rows = sensed.rows.iter().map(row).collect::<Result<Vec<_>, ContactError>>()?;
        Ok(Self { rows, log })
    }

    /// The readings at which the base's pose is known, as a trial has them.
    pub fn rows(&self, trial: &Trial) -> Vec<SweepRow> {
        let one = |r: &SweepRow| {
            let motion = self.log.at(r.t_s + trial.clock_s, &Vector3::zeros()).ok()?;
            let pose = base_pose(&motion).world_from_base;
            let place = Translation3::from(trial.motion * pose.translation.vector);
            let world_from_base = Isometry3::from_parts(place, pose.rotation);
            Some(SweepRow { moment_nmm: r.moment_nmm * trial.gain, world_from_base, ..r.clone() })
        };
        self.rows.iter().filter_map(one).collect()
    }
}

/// The zero of a sweep: the mean of its readings before the wire comes near the object.
pub(crate) struct SweepZero {
    /// Number of those readings.
    pub free: usize,
    pub moment_nmm: Vector2<f64>,
    /// Variance of a reading in each moment, (N mm)^2.
    pub variance_nmm2: f64,
    /// Mean of what the calibration's readings share.
    pub shared_nmm: Vec<Vector2<f64>>,
    /// Largest moment from it, N mm.
    pub largest_nmm: f64,
    /// Moment where the wire is clear of the object again at the end, where it is no longer the zero, N mm.
    pub drift_nmm: Option<f64>,
}

impl SweepZero {
    /// From rows and where the free wire is clear of the object; a reading that is clear, but no longer steady, counts as loaded. None where
    /// too few readings are free.
    pub fn new(rows: &[SweepRow], clear: &[bool]) -> Option<Self> {
        let moments: Vec<Vector2<f64>> = rows.iter().map(|r| r.moment_nmm).collect();
        let before = clear.iter().take_while(|c| **c).count();
        let free = steady(&moments, 0.0).map_or(before, |s| s.count.min(before));
        if free < MIN_FREE {
            return None;
        }
        let mean = |range: std::ops::Range<usize>| {
            moments[range.clone()].iter().sum::<Vector2<f64>>() / range.len() as f64
        };
        let zero = mean(0..free);
        let variance = moments[..free].iter().map(|m| (m - zero).norm_squared()).sum::<f64>()
            / (2.0 * (free - 1) as f64);
        let largest_nmm = moments.iter().map(|m| (m - zero).norm()).fold(0.0, f64::max);
        let count = rows.iter().map(|r| r.shared_nmm.len()).min().unwrap_or(0);
        let shared =
            |k: usize| rows[..free].iter().map(|r| r.shared_nmm[k]).sum::<Vector2<f64>>() / free as f64;
        let shared_nmm = (0..count).map(shared).collect();
        // A wire may hang on where the free one is clear: the end is free where it is steady, too.
        let after = clear[free..].iter().rev().take_while(|c| **c).count();
        let backward: Vec<Vector2<f64>> = moments[rows.len() - after..].iter().rev().copied().collect();
        let end = rows.len() - steady(&backward, 0.0).map_or(0, |s| s.count)..rows.len();
        let drift_nmm = (end.len() >= MIN_FREE).then(|| (mean(end.clone()) - zero).norm()).filter(|off| {
            let sd = (2.0 * variance * (1.0 / free as f64 + 1.0 / end.len() as f64)).sqrt();
            *off > (DRIFT_SDS * sd).max(DRIFT_SHARE * largest_nmm)
        });
        Some(Self { free, moment_nmm: zero, variance_nmm2: variance, shared_nmm, largest_nmm, drift_nmm })
    }
}
