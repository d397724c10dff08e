//! Readings of a sweep beside the object: moments, poses of the base, and the sweep's own zero.

use crate::ContactError;
use crate::known_motion::MotionLog;
use crate::motion_table;
use crate::sweep_session::SweepSession;
use crate::table_source::base_pose;
use crate::zero::steady;
use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};
use wcal_calibration::{SensedRow, WhiskerCalibration};
use wcal_core::observation::WhiskerSpec;
use wcal_core::wire_frame::WireFrame;

/// Free readings that a zero needs at least.
const MIN_FREE: usize = 3;
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
        let log = motion_table::read(&session.points)?.log;
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

    /// The readings at which the base's pose is known.
    pub fn rows(&self) -> Vec<SweepRow> {
        let one = |r: &SweepRow| {
            let motion = self.log.at(r.t_s, &Vector3::zeros()).ok()?;
            Some(SweepRow { world_from_base: base_pose(&motion).world_from_base, ..r.clone() })
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
        let zero = moments[..free].iter().sum::<Vector2<f64>>() / free as f64;
        let variance = moments[..free].iter().map(|m| (m - zero).norm_squared()).sum::<f64>()
            / (2.0 * (free - 1) as f64);
        let largest_nmm = moments.iter().map(|m| (m - zero).norm()).fold(0.0, f64::max);
        let count = rows.iter().map(|r| r.shared_nmm.len()).min().unwrap_or(0);
        let shared =
            |k: usize| rows[..free].iter().map(|r| r.shared_nmm[k]).sum::<Vector2<f64>>() / free as f64;
        let shared_nmm = (0..count).map(shared).collect();
        Some(Self { free, moment_nmm: zero, variance_nmm2: variance, shared_nmm, largest_nmm })
    }
}
