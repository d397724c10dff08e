//! Readings of a table: moments through a calibration, and the motion by a log or by the poses in
//! its rows.

use crate::TrackError;
use crate::known_groove::{KnownPlace, known_places, velocities};
use crate::reading::{Moments, Reading, RowMotion};
use nalgebra::{Matrix2, Vector2, Vector3};
use std::path::Path;
use wcal_calibration::{SensedRow, SensedTable, WhiskerCalibration};
use wcal_core::order_statistics::median;
use wcal_core::stream::Flags;
use wcal_core::{CalibrationNoise, WhiskerSpec};
use wcal_network::stream::BasePose;
use wcal_session::motion_table::{LoggedMotion, is_motion_column};
use wcal_session::{Motion, SessionWarning, TextTableLayout, WarningKind, read_text_table};
use wcal_verify::whisker::groove_motion::AcceptedWire;

/// A step this many times the median is a gap.
const GAP_STEPS: f64 = 4.0;

/// A table through a calibration.
pub struct TableSource {
    rows: Vec<SensedRow>,
    /// What the calibration's errors are made of, where it says.
    noise: CalibrationNoise,
    /// Whether the calibration needs the strain-isolated grating in every row.
    needs_reference: bool,
    /// The wire as the calibration has it, and by one standard deviation of each of the first
    /// common unknowns.
    pub wire: AcceptedWire,
    /// See `wire`.
    pub changed: Vec<AcceptedWire>,
    /// What is odd about the table, motion columns aside.
    pub warnings: Vec<SessionWarning>,
    /// Readings with a known groove.
    pub places: Vec<KnownPlace>,
}

impl TableSource {
    /// Reads a table; times go forward, and the reference is there where the calibration needs one.
    ///
    /// # Errors
    /// Where the table cannot be used, by line.
    pub fn read(
        path: &Path,
        (calibration, noise): (&dyn WhiskerCalibration, CalibrationNoise),
        whisker: &WhiskerSpec,
    ) -> Result<Self, TrackError> {
        let SensedTable { rows, warnings } = calibration.sensed(path)?;
        let (wire, changed) = calibration.wire(whisker)?;
        let of_motion = |w: &SessionWarning| matches!(&w.kind, WarningKind::UnknownColumn(c) if is_motion_column(c));
        let needs_reference = calibration.fbg().needs_reference();
        let mut last_s = f64::NEG_INFINITY;
        for row in &rows {
            let what = || format!("{}: line {}: t_s", path.display(), row.line);
            let t_s = row
                .t_s
                .ok_or_else(|| TrackError::value(what(), "a time", "none"))?;
            if !(t_s > last_s) {
                let expected = format!("a later time than {last_s}");
                return Err(TrackError::value(what(), expected, t_s.to_string()));
            }
            last_s = t_s;
        }
        if needs_reference && !rows.iter().any(|m| m.reference) {
            let what = format!("{}: fbg_ref_nm", path.display());
            const EXPECTED: &str = "the strain-isolated grating, since the calibration compensates temperature with it";
            return Err(TrackError::value(what, EXPECTED, "none"));
        }
        let warnings = warnings.into_iter().filter(|w| !of_motion(w)).collect();
        let places = known_places(path)?;
        Ok(Self {
            rows,
            noise,
            needs_reference,
            wire,
            changed,
            warnings,
            places,
        })
    }

    /// First and last time, s; none without readings.
    pub fn span_s(&self) -> Option<[f64; 2]> {
        Some([self.rows.first()?.t_s?, self.rows.last()?.t_s?])
    }

    /// Readings of whose motion nothing is known.
    pub fn alone(&self) -> Vec<Reading> {
        self.rows.iter().map(|row| self.reading(row)).collect()
    }

    /// Readings along a log; `middle_mm` is the middle of the free wire, whose velocity counts.
    pub fn along(&self, logged: &LoggedMotion, middle_mm: &Vector3<f64>) -> Vec<Reading> {
        let one = |row: &SensedRow| {
            let motion = logged.log.at(row.t_s.unwrap_or_default(), middle_mm);
            let known = motion.as_ref().ok();
            // The motion is the object's with respect to the base: the base goes the other way.
            Reading {
                base: known.filter(|_| logged.posed).map(base_pose),
                base_mm_s: known.map(|m| -m.velocity_mm_s.z),
                velocity_mm_s: known.map(|m| -m.velocity_mm_s),
                motion: motion.map(RowMotion::from),
                ..self.reading(row)
            }
        };
        self.rows.iter().map(one).collect()
    }

    /// Readings as a network takes them: along the poses of the table's own columns, else with a
    /// speed along +z, else past a known groove; a long step is a gap.
    pub fn past_object(
        &self,
        poses: Option<&LoggedMotion>,
        base_mm_s: Option<f64>,
    ) -> Vec<Reading> {
        let steps = self.rows.windows(2);
        let step_s = median(steps.filter_map(|w| Some(w[1].t_s? - w[0].t_s?)));
        let longest_s = step_s.map_or(f64::INFINITY, |step_s| GAP_STEPS * step_s);
        let past_groove = velocities(&self.places, GAP_STEPS * step_s.unwrap_or_default());
        let along = |poses| self.along(poses, &Vector3::zeros());
        let readings = poses.map_or_else(|| self.alone(), along);
        let mut last_s = f64::INFINITY;
        let one = |(row, plain): (&SensedRow, Reading)| {
            let gap = plain.t_s - std::mem::replace(&mut last_s, plain.t_s) > longest_s;
            let known = plain.velocity_mm_s.or(past_groove.get(&row.line).copied());
            let flags = if gap { Flags::GAP } else { Flags::default() };
            Reading {
                flags: flags.with(plain.flags),
                base_mm_s: plain.base_mm_s.or(base_mm_s),
                velocity_mm_s: known.or(base_mm_s.map(|v| Vector3::z() * v)),
                gap,
                ..plain
            }
        };
        self.rows.iter().zip(readings).map(one).collect()
    }

    /// A reading without its motion.
    fn reading(&self, row: &SensedRow) -> Reading {
        let usable = !self.needs_reference || row.reference;
        let (m, spread, noise) = (&row.moments, &row.spread, &self.noise);
        // A reading's own noise stands by itself only where the law's misfit beside it is known.
        let own = noise.misfit_sd_nmm.and(noise.reading_sd_nmm);
        let moments = Moments {
            moment_nmm: m.moment_nmm,
            sd_nmm: m.sd_nmm,
            valid: m.valid,
            pose_nmm2: spread.noise_nmm2,
            own_nmm2: own.map(diagonal),
            drift_nmm2: noise.drift_sd_nmm.map_or_else(Matrix2::zeros, diagonal),
            shared_nmm: spread.shared_nmm.clone(),
            ..Moments::default()
        };
        let mut reading = Reading::alone(row.point, row.t_s.unwrap_or_default(), Some(moments));
        if !usable {
            (reading.moments, reading.flags) = (None, Flags::REFERENCE_LOST);
        }
        reading
    }
}

fn diagonal(sd_nmm: [f64; 2]) -> Matrix2<f64> {
    Matrix2::from_diagonal(&Vector2::from(sd_nmm.map(|s| s * s)))
}

/// Median time between the rows of a table, s; none without times.
///
/// # Errors
/// Where the table cannot be read.
pub fn median_step_s(path: &Path) -> Result<Option<f64>, TrackError> {
    let table = read_text_table(path, &TextTableLayout::default())?;
    let Ok(column) = table.column("t_s") else {
        return Ok(None);
    };
    let times = (0..table.rows.len())
        .map(|k| table.number(k, column))
        .collect::<Result<Vec<_>, _>>()?;
    let times: Vec<f64> = times.into_iter().flatten().collect();
    Ok(median(times.windows(2).map(|w| w[1] - w[0])))
}

/// Pose of the base where the object's frame is the world's.
fn base_pose(motion: &Motion) -> BasePose {
    BasePose {
        world_from_base: motion.world_from_base(),
        velocity_mm_s: Some(-motion.velocity_mm_s),
    }
}
