//! Readings of a sweep beside the object: moments, poses of the base, and the sweep's own zero.

use crate::TrackError;
use crate::frame::in_wire_frame;
use crate::reading::Reading;
use crate::table_source::TableSource;
use crate::zero::steady;
use nalgebra::{Isometry3, Matrix2, Vector2, Vector3};
use wcal_calibration::WhiskerCalibration;
use wcal_core::CalibrationNoise;
use wcal_core::observation::WhiskerSpec;
use wcal_core::wire_frame::WireFrame;
use wcal_session::motion_table;
use wcal_session::sweep_session::SweepSession;

/// Free readings that a zero needs at least.
const MIN_FREE: usize = 3;

/// A reading, moments in the frame of the wire.
pub(crate) struct SweepRow {
    pub t_s: f64,
    pub moment_nmm: Vector2<f64>,
    pub noise_nmm2: Matrix2<f64>,
    pub shared_nmm: Vec<Vector2<f64>>,
    pub world_from_base: Isometry3<f64>,
}

/// The readings of a sweep through a calibration at which the base's pose is known.
///
/// # Errors
/// Where its tables cannot be read, or a reading has no time.
pub(crate) fn sweep_rows(
    session: &SweepSession,
    calibration: &dyn WhiskerCalibration,
    (whisker, frame): (&WhiskerSpec, &WireFrame),
) -> Result<Vec<SweepRow>, TrackError> {
    let source = TableSource::read(
        &session.points,
        (calibration, CalibrationNoise::default()),
        whisker,
    )?;
    let log = motion_table::read(&session.points)?.log;
    let one = |reading: Reading| {
        let (t_s, m) = (reading.t_s, in_wire_frame(frame, &reading).moments?);
        Some(SweepRow {
            t_s,
            moment_nmm: m.moment_nmm.into(),
            noise_nmm2: m.pose_nmm2,
            shared_nmm: m.shared_nmm.iter().map(|h| Vector2::from(*h)).collect(),
            world_from_base: log.at(t_s, &Vector3::zeros()).ok()?.world_from_base(),
        })
    };
    Ok(source.alone().into_iter().filter_map(one).collect())
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
    /// From rows and how many of the first the free wire is clear of the object, as the clock is
    /// said to be and with one that is off; a reading that is clear, but no longer steady, counts
    /// as loaded. None where too few readings are free.
    pub(crate) fn new(rows: &[SweepRow], [clear, at_most]: [usize; 2]) -> Option<Self> {
        let moments: Vec<Vector2<f64>> = rows.iter().map(|r| r.moment_nmm).collect();
        // Where no steady beginning shows, only the least number counts: more may be loaded.
        let free = steady(&moments, 0.0).map_or(clear.min(MIN_FREE), |s| s.count.min(at_most));
        if free < MIN_FREE {
            return None;
        }
        // The free wire has no moment: what is read there is the zero, and its scatter the noise of
        // a reading.
        let zero = moments[..free].iter().sum::<Vector2<f64>>() / free as f64;
        // Two moments of n - 1 degrees of freedom each.
        let variance = moments[..free]
            .iter()
            .map(|m| (m - zero).norm_squared())
            .sum::<f64>()
            / (2.0 * (free - 1) as f64);
        let largest_nmm = moments
            .iter()
            .map(|m| (m - zero).norm())
            .fold(0.0, f64::max);
        let count = rows.iter().map(|r| r.shared_nmm.len()).min().unwrap_or(0);
        let shared = |k: usize| {
            rows[..free]
                .iter()
                .map(|r| r.shared_nmm[k])
                .sum::<Vector2<f64>>()
                / free as f64
        };
        let shared_nmm = (0..count).map(shared).collect();
        Some(Self {
            free,
            moment_nmm: zero,
            variance_nmm2: variance,
            shared_nmm,
            largest_nmm,
        })
    }
}
