//! One reading of a whisker as every source gives it and every estimator takes it.
//!
//! ```text
//! m = m_true + h c - z + b + n,    c ~ N(0, 1),   z ~ N(0, Z),   b ~ N(0, B),   n ~ N(0, R)
//! ```
//!
//! h: by how much one standard deviation of each unknown of the calibration, which all readings
//! share, makes the moments too large; z: what is not known of the record's zero, drift included;
//! B: noise from pose to pose, as the calibration's own readings have it about its law, one draw
//! for readings of one pose; R: the reading's own noise, where it is known. B - R is the law's
//! misfit: no noise of a reading, but an error that readings of like moments share.

use nalgebra::{Matrix2, Rotation3, Vector3};
use wcal_core::stream::Flags;
use wcal_network::stream::BasePose;
use wcal_session::{Motion, MotionUnknown};

/// Sum of squares of moments, (N mm)^2.
pub(crate) fn squares(moments_nmm: &[[f64; 2]]) -> f64 {
    moments_nmm.as_flattened().iter().map(|m| m * m).sum()
}

/// Moments of a reading with the parts of their uncertainty.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Moments {
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviations over all parts, N mm.
    pub sd_nmm: [f64; 2],
    /// Whether the calibration vouches for them.
    pub valid: bool,
    /// Covariance B of the noise from pose to pose, (N mm)^2.
    pub pose_nmm2: Matrix2<f64>,
    /// Covariance R of the reading's own noise, where it is known, (N mm)^2.
    pub own_nmm2: Option<Matrix2<f64>>,
    /// Statistical inefficiency of the reading's own noise: so many in a row say as much as one
    /// that is independent; 0 where it is not known.
    pub inefficiency: f64,
    /// Covariance of the drift of the zero within a record, (N mm)^2; 0 where none is known.
    pub drift_nmm2: Matrix2<f64>,
    /// Covariance Z of what is not known of the zero, (N mm)^2 ([`crate::zero`]).
    pub zero_nmm2: Matrix2<f64>,
    /// Columns h, N mm; as many in every reading of a source.
    pub shared_nmm: Vec<[f64; 2]>,
}

/// Motion of the object with respect to the base at a reading.
#[derive(Debug, Clone, Copy)]
pub struct RowMotion {
    /// Displacement, base frame, mm, up to a constant in the piece: a point is at `turn p + moved`.
    pub moved_mm: Vector3<f64>,
    /// Rotation.
    pub turn: Rotation3<f64>,
    /// Velocity, mm/s.
    pub velocity_mm_s: Vector3<f64>,
    /// Counts up where the motion before says nothing about the one after.
    pub piece: u32,
    /// Direction of the push, where it is known.
    pub push: Option<Vector3<f64>>,
}

impl From<Motion> for RowMotion {
    fn from(m: Motion) -> Self {
        let Motion {
            turn,
            moved_mm,
            velocity_mm_s,
            piece,
        } = m;
        Self {
            moved_mm,
            turn,
            velocity_mm_s,
            piece,
            push: None,
        }
    }
}

/// What is assumed of the motion.
#[derive(Debug, Clone, Copy, Default)]
pub struct MotionAccuracy {
    /// Standard deviation of the displacement in each coordinate, mm.
    pub moved_sd_mm: f64,
    /// Standard deviation of the clock's offset, s.
    pub clock_sd_s: f64,
    /// Standard deviation of the times within the window of a reading's moments, s.
    pub window_sd_s: f64,
}

/// What is known at a time.
#[derive(Debug, Clone)]
pub struct Reading {
    /// Number of the reading or of the scan.
    pub point: i64,
    /// Time of validity, s.
    pub t_s: f64,
    /// What was wrong with the reading.
    pub flags: Flags,
    /// Moments; none where the reading cannot be used.
    pub moments: Option<Moments>,
    /// Motion, or why it is not known.
    pub motion: Result<RowMotion, MotionUnknown>,
    /// Pose of the base.
    pub base: Option<BasePose>,
    /// Speed of the base along its +z, mm/s.
    pub base_mm_s: Option<f64>,
    /// Velocity of the base past what it touches, base frame, mm/s.
    pub velocity_mm_s: Option<Vector3<f64>>,
    /// In the beginning of a stream that must be free of contact, before its noise is known.
    pub in_prefix: bool,
    /// What happened since the reading before is not known.
    pub gap: bool,
    /// By how much one standard deviation of each common unknown changes the displacement, base
    /// frame, mm; empty where none does.
    pub shared_displacement_mm: Vec<Vector3<f64>>,
    /// Counts up where the contact was left, as far as the source knows.
    pub visit: u32,
}

impl Reading {
    /// A reading of whose motion nothing is known.
    pub fn alone(point: i64, t_s: f64, moments: Option<Moments>) -> Self {
        Self {
            point,
            t_s,
            flags: Flags::default(),
            moments,
            motion: Err(MotionUnknown::Unknown),
            base: None,
            base_mm_s: None,
            velocity_mm_s: None,
            in_prefix: false,
            gap: false,
            shared_displacement_mm: Vec::new(),
            visit: 0,
        }
    }
}
