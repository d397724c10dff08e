//! Readings of an episode with their motion, and what is assumed where nothing is known.

use crate::TrackError;
use crate::arc_posterior::ArcDensity;
use nalgebra::{Matrix2, Matrix3, Rotation3, Vector3};

/// Error of an interpolated moment as a share of it (`field`, and tests/known_motion.rs).
pub(crate) const TABLE_SHARE: f64 = 3e-4;
/// Error of the interpolated wire where its curvature jumps (straight to arc), in each coordinate,
/// mm.
pub(crate) const TABLE_MM: f64 = 0.003;

/// Logarithm of the density of moments of which nothing is predicted: anywhere in a circle of 3 N
/// mm, the largest moment of a wire pressed near its root.
pub(crate) const LN_ANYTHING: f64 = -3.341_954_5;

/// One reading with the motion at its time.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionRow {
    /// Time, s.
    pub t_s: f64,
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Covariance of this reading's own noise, (N mm)^2.
    pub noise_nmm2: Matrix2<f64>,
    /// Errors shared with the other readings: by how much one standard deviation of each common
    /// unknown makes the moments too large, N mm; the same number in every row.
    pub shared_nmm: Vec<[f64; 2]>,
    /// Covariance of the moments of a free wire, where it is less than noise and shared errors make
    /// here, (N mm)^2: an error that grows with the moment is none there.
    pub free_nmm2: Option<Matrix2<f64>>,
    /// By how much each changes the displacement, base frame, mm; the same number, or empty where
    /// the displacement depends on none.
    pub shared_displacement_mm: Vec<Vector3<f64>>,
    /// Displacement of the object with respect to the base, base frame, mm, up to a constant in the
    /// episode: a point is at `turn p + moved`.
    pub moved_mm: Vector3<f64>,
    /// Rotation of the object with respect to the base, up to a constant.
    pub turn: Rotation3<f64>,
    /// Velocity of the object, mm/s; zero at standstill.
    pub velocity_mm_s: Vector3<f64>,
    /// Standard deviation of the displacement in each coordinate, mm.
    pub moved_sd_mm: f64,
    /// Known to be free of contact.
    pub free: bool,
    /// Readings of one visit follow each other without the contact being left in between unseen.
    pub contact_segment: u32,
}

impl MotionRow {
    /// Motion since another reading: a point is at `turn p + moved`, mm.
    pub(crate) fn since(&self, other: &Self) -> (Rotation3<f64>, Vector3<f64>) {
        // From p0 = Q0 q + d0 and p = Q q + d: p = Q Q0^-1 (p0 - d0) + d.
        let turn = self.turn * other.turn.inverse();
        (turn, self.moved_mm - turn * other.moved_mm)
    }

    /// Displacement of a point since another reading, mm.
    pub(crate) fn displacement_mm(&self, other: &Self, point_mm: &Vector3<f64>) -> Vector3<f64> {
        let (turn, moved_mm) = self.since(other);
        turn * point_mm + moved_mm - point_mm
    }
}

/// Readings whose moments are larger by 1 %.
pub(crate) fn larger(rows: &[MotionRow]) -> Vec<MotionRow> {
    const PERCENT: f64 = 1.01;
    let mut rows = rows.to_vec();
    let moments = rows.iter_mut().flat_map(|row| &mut row.moment_nmm);
    moments.for_each(|m| *m *= PERCENT);
    rows
}

/// Readings over which the displacement is known up to one constant, in order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Episode {
    /// Readings.
    pub rows: Vec<MotionRow>,
    /// Unit vector along which the object pushes at first touch; taken from the motion where it is
    /// not known.
    pub push: Option<Vector3<f64>>,
}

/// What is assumed where nothing is known.
#[derive(Debug, Clone, Copy)]
pub struct Settings {
    /// Standard deviation of the gap at which the object passes the free wire before it holds it,
    /// mm.
    pub gap_sd_mm: f64,
    /// Standard deviation of the clock of the motion against that of the moments, s.
    pub clock_sd_s: f64,
    /// Standard deviation of the times within the window that a reading's moments are a mean over,
    /// s; 0: they are of one time.
    pub window_sd_s: f64,
    /// Smallest arc length of a contact, mm.
    pub first_mm: f64,
    /// Standard deviation of the way of the touched point over the object as a share of the
    /// motion's; 0: it stays, as in a groove.
    pub creep_sd: f64,
    /// Relative standard deviation of the wire's stiffness, the last of the common unknowns; 0: it
    /// has none among them.
    pub stiffness_sd: f64,
    /// Prior probability that a reading is an outlier.
    pub gross_share: f64,
    /// Readings of an episode that the posterior is made of; of more, every second, third, ...
    pub max_rows: usize,
    /// Noise of which successive readings share part; none where every reading has its own noise
    /// alone.
    pub correlated: Option<CorrelatedNoise>,
}

impl Default for Settings {
    fn default() -> Self {
        // The mouth of a V-groove and the offsets of a bench (0.1-1.5 mm) set the gap; no better is
        // known.
        Self {
            gap_sd_mm: 0.5,
            clock_sd_s: 0.0,
            window_sd_s: 0.0,
            first_mm: 8.0,
            creep_sd: 0.0,
            stiffness_sd: 0.0,
            gross_share: 0.01,
            max_rows: 400,
            correlated: None,
        }
    }
}

/// Noise of which successive readings share part.
#[derive(Debug, Clone, Copy)]
pub enum CorrelatedNoise {
    /// Noise from pose to pose, beside each reading's own: readings at poses near each other share
    /// one draw.
    ByPose {
        /// Covariance, (N mm)^2.
        covariance_nmm2: Matrix2<f64>,
        /// Displacement over which a draw is forgotten (correlation `exp(-d / length)`), mm.
        length_mm: f64,
    },
    /// A share of each reading's noise is a first-order Gauss-Markov process.
    InTime {
        /// Share of the noise variance, 0 to 1.
        variance_share: f64,
        /// Time constant, s.
        time_constant_s: f64,
    },
}

impl CorrelatedNoise {
    /// F_k: what one unit of the draw makes of a reading's moments; none where the noise is no
    /// covariance.
    pub(super) fn factor(&self, row: &MotionRow) -> Option<Matrix2<f64>> {
        match self {
            Self::ByPose { .. } => Some(Matrix2::identity()),
            Self::InTime { variance_share, .. } => {
                // F F' = q R: the lasting part has the shape of the reading's own noise.
                Some(row.noise_nmm2.cholesky()?.l() * variance_share.sqrt())
            }
        }
    }

    /// B: covariance of a draw.
    pub(super) fn draw(&self) -> Matrix2<f64> {
        match self {
            Self::ByPose {
                covariance_nmm2, ..
            } => *covariance_nmm2,
            Self::InTime { .. } => Matrix2::identity(),
        }
    }

    /// A reading's noise beside it, (N mm)^2.
    pub(super) fn own_nmm2(&self, row: &MotionRow) -> Matrix2<f64> {
        match self {
            Self::ByPose { .. } => row.noise_nmm2,
            // The white part has the rest of the variance: both together are R.
            Self::InTime { variance_share, .. } => row.noise_nmm2 * (1.0 - variance_share),
        }
    }

    /// Correlation of two successive readings.
    pub(super) fn correlation(&self, moved_mm: f64, passed_s: f64) -> f64 {
        match self {
            Self::ByPose { length_mm, .. } => (-moved_mm / length_mm.max(1e-9)).exp(),
            Self::InTime {
                time_constant_s, ..
            } => (-passed_s.abs() / time_constant_s.max(1e-9)).exp(),
        }
    }
}

/// Where the wire is held at one reading; by default nowhere.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EpisodeContact {
    /// Mean place of the wire's axis at the contact, mm; none where the episode has no usable
    /// contact.
    pub place_mm: Option<Vector3<f64>>,
    /// Covariance, mm^2.
    pub covariance_mm2: Matrix3<f64>,
    /// Probability that the wire is held.
    pub contact: f64,
    /// Whether the reading was treated as an outlier.
    pub outlier: bool,
    /// Density along the wire.
    pub arc: ArcDensity,
}

/// A reading after one at `last_s`, of a record with `shared` common unknowns.
pub(crate) fn check_row(
    row: &MotionRow,
    last_s: f64,
    shared: usize,
    what: &str,
) -> Result<(), TrackError> {
    let numbers = row
        .moment_nmm
        .iter()
        .chain(row.moved_mm.iter())
        .chain(row.velocity_mm_s.iter());
    if !numbers.copied().all(f64::is_finite) || !row.noise_nmm2.iter().all(|v| v.is_finite()) {
        return Err(TrackError::value(
            what,
            "finite moments, noise and motion",
            "one that is not",
        ));
    }
    if !(row.t_s >= last_s) {
        return Err(TrackError::value(
            what,
            format!("a time from {last_s} s on"),
            row.t_s.to_string(),
        ));
    }
    for count in [
        row.shared_nmm.len(),
        row.shared_displacement_mm.len().max(shared),
    ] {
        if count != shared {
            let expected = format!("{shared} common unknowns as in the first");
            return Err(TrackError::value(what, expected, count.to_string()));
        }
    }
    Ok(())
}
