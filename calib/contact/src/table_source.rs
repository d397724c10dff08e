//! Readings of a table: moments through a calibration, and the motion by a log or by the poses in its rows.

use crate::ContactError;
use crate::groove_table::known_places;
use crate::known_groove::{KnownPlace, velocities};
use crate::known_motion::Motion;
use crate::motion_table::{LoggedMotion, is_motion_column};
use crate::reading::{Moments, Reading, RowMotion};
use nalgebra::{Isometry3, Matrix2, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use wcal_calibration::{SensedRow, SensedTable, WhiskerCalibration};
use wcal_core::stream::Flags;
use wcal_core::{CalibrationNoise, WhiskerSpec};
use wcal_session::{SessionWarning, TextTable, TextTableLayout, WarningKind, read_text_table};
use wcal_trace::whisker::groove_motion::AcceptedWire;
use wcal_track::stream::BasePose;

/// A step this many times the median is a gap.
const GAP_STEPS: f64 = 4.0;

/// A table through a calibration.
pub struct TableSource {
    path: PathBuf,
    rows: Vec<SensedRow>,
    /// What the calibration's errors are made of, where it says.
    noise: CalibrationNoise,
    /// Whether the calibration needs the strain-isolated grating in every row.
    needs_reference: bool,
    /// The wire as the calibration has it, and by one standard deviation of each of the first common unknowns.
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
    ) -> Result<Self, ContactError> {
        let SensedTable { rows, wire, changed, warnings } = calibration.sensed(path, whisker)?;
        let of_motion =
            |w: &SessionWarning| matches!(&w.kind, WarningKind::UnknownColumn(c) if is_motion_column(c));
        let needs_reference = calibration.fbg().needs_reference();
        let mut last_s = f64::NEG_INFINITY;
        for row in &rows {
            let what = || format!("{}: line {}: t_s", path.display(), row.line);
            let t_s = row.t_s.ok_or_else(|| ContactError::value(what(), "a time", "none"))?;
            if !(t_s > last_s) {
                let expected = format!("a later time than {last_s}");
                return Err(ContactError::value(what(), expected, t_s.to_string()));
            }
            last_s = t_s;
        }
        if needs_reference && !rows.iter().any(|m| m.reference) {
            let what = format!("{}: fbg_ref_nm", path.display());
            const EXPECTED: &str =
                "the strain-isolated grating, since the calibration compensates temperature with it";
            return Err(ContactError::value(what, EXPECTED, "none"));
        }
        let warnings = warnings.into_iter().filter(|w| !of_motion(w)).collect();
        let places = known_places(path)?;
        Ok(Self { path: path.to_owned(), rows, noise, needs_reference, wire, changed, warnings, places })
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
            Reading {
                base: known.filter(|_| logged.posed).map(base_pose),
                base_mm_s: known.map(|m| -m.velocity_mm_s.z),
                velocity_mm_s: known.map(|m| -m.velocity_mm_s),
                motion: motion.map(row_motion),
                ..self.reading(row)
            }
        };
        self.rows.iter().map(one).collect()
    }

    /// Readings as a network takes them: poses of the base by the table's own columns, else a speed along +z, else the way past a known
    /// groove; a long step is a gap.
    ///
    /// # Errors
    /// Where a pose cannot be used.
    pub fn past_object(&self, base_mm_s: Option<f64>) -> Result<Vec<Reading>, ContactError> {
        let poses = base_poses(&self.path)?;
        let step_s = median(self.rows.windows(2).filter_map(|w| Some(w[1].t_s? - w[0].t_s?)).collect());
        let past_groove = velocities(&self.places, GAP_STEPS * step_s.unwrap_or_default());
        let mut last: Option<(f64, Option<BasePose>)> = None;
        let mut readings = Vec::with_capacity(self.rows.len());
        for row in &self.rows {
            let plain = self.reading(row);
            let gap =
                last.zip(step_s).is_some_and(|((before, _), step)| plain.t_s - before > GAP_STEPS * step);
            let base = poses.get(&row.line).copied();
            let velocity = last.and_then(|(before, old)| velocity_mm_s(&old?, &base?, plain.t_s - before));
            let base = base.map(|b| BasePose { velocity_mm_s: velocity, ..b });
            last = Some((plain.t_s, base));
            let known = velocity.or(past_groove.get(&row.line).copied());
            readings.push(Reading {
                flags: if gap { Flags::GAP.with(plain.flags) } else { plain.flags },
                base,
                base_mm_s: velocity.map(|v| v.z).or(base_mm_s),
                velocity_mm_s: known.or(base_mm_s.map(|v| Vector3::z() * v)),
                gap,
                ..plain
            });
        }
        Ok(readings)
    }

    /// A reading without its motion.
    fn reading(&self, row: &SensedRow) -> Reading {
        let usable = !self.needs_reference || row.reference;
        let s = &row.sensed;
        let moments = Moments {
            moment_nmm: s.moment_nmm,
            sd_nmm: row.sd_nmm(),
            valid: s.valid,
            pose_nmm2: s.noise_nmm2,
            own_nmm2: self.noise.misfit_sd_nmm.and(self.noise.reading_sd_nmm).map(diagonal),
            drift_nmm2: self.noise.drift_sd_nmm.map_or_else(Matrix2::zeros, diagonal),
            zero_nmm2: Matrix2::zeros(),
            shared_nmm: s.shared_nmm.clone(),
        };
        let flags = if usable { Flags::default() } else { Flags::REFERENCE_LOST };
        let alone = Reading::alone(row.point, row.t_s.unwrap_or_default(), usable.then_some(moments));
        Reading { flags, ..alone }
    }
}

fn diagonal(sd_nmm: [f64; 2]) -> Matrix2<f64> {
    Matrix2::from_diagonal(&Vector2::from(sd_nmm.map(|s| s * s)))
}

/// Median time between the rows of a table, s; none without times.
///
/// # Errors
/// Where the table cannot be read.
pub fn median_step_s(path: &Path) -> Result<Option<f64>, ContactError> {
    let table = read_text_table(path, &TextTableLayout::default())?;
    let Ok(column) = table.column("t_s") else { return Ok(None) };
    let times = (0..table.rows.len()).map(|k| table.number(k, column)).collect::<Result<Vec<_>, _>>()?;
    let times: Vec<f64> = times.into_iter().flatten().collect();
    Ok(median(times.windows(2).map(|w| w[1] - w[0]).collect()))
}

fn median(mut steps: Vec<f64>) -> Option<f64> {
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

fn row_motion(m: Motion) -> RowMotion {
    RowMotion {
        moved_mm: m.moved_mm,
        turn: m.turn,
        velocity_mm_s: m.velocity_mm_s,
        piece: m.piece,
        push: None,
    }
}

/// Pose of the base where the object's frame is the world's.
pub fn base_pose(motion: &Motion) -> BasePose {
    let back: Rotation3<f64> = motion.turn.inverse();
    let place = Translation3::from(back * -motion.moved_mm);
    let world_from_base = Isometry3::from_parts(place, UnitQuaternion::from_rotation_matrix(&back));
    BasePose { world_from_base, velocity_mm_s: Some(-motion.velocity_mm_s) }
}

const POSE: [&str; 7] = ["base_x_mm", "base_y_mm", "base_z_mm", "base_qw", "base_qx", "base_qy", "base_qz"];

/// Poses of the base by line, where the table has its columns.
fn base_poses(path: &Path) -> Result<HashMap<usize, BasePose>, ContactError> {
    let table: TextTable = read_text_table(path, &TextTableLayout::default())?;
    let present = POSE.iter().filter(|c| table.column(c).is_ok()).count();
    if present == 0 {
        return Ok(HashMap::new());
    }
    let columns = POSE.iter().map(|c| table.column(c)).collect::<Result<Vec<_>, _>>()?;
    let mut poses = HashMap::new();
    for (k, (line, _)) in table.rows.iter().enumerate() {
        let values = columns.iter().map(|c| table.number(k, *c)).collect::<Result<Vec<_>, _>>()?;
        let Some(v) = values.into_iter().collect::<Option<Vec<f64>>>() else { continue };
        let turn = Quaternion::new(v[3], v[4], v[5], v[6]);
        if (turn.norm() - 1.0).abs() >= 1e-3 {
            let what = format!("{}: line {line}: base_qw..base_qz", path.display());
            return Err(ContactError::value(what, "a unit quaternion", format!("norm {}", turn.norm())));
        }
        let place = Translation3::new(v[0], v[1], v[2]);
        let world_from_base = Isometry3::from_parts(place, UnitQuaternion::new_normalize(turn));
        poses.insert(*line, BasePose { world_from_base, velocity_mm_s: None });
    }
    Ok(poses)
}

/// Velocity of the base between two poses, base frame, mm/s.
fn velocity_mm_s(before: &BasePose, now: &BasePose, dt_s: f64) -> Option<Vector3<f64>> {
    // Difference of two places over the time between, seen from the base.
    let moved = now.world_from_base.translation.vector - before.world_from_base.translation.vector;
    (dt_s > 0.0).then(|| now.world_from_base.rotation.inverse() * moved / dt_s)
}
