//! The log of a relative motion as a table: what the object does in the base frame, or the base in
//! the world where the object stands still.

use crate::error::{InputError, SessionError};
use crate::motion_log::{LogRow, MotionLog};
use crate::table::{TextTable, TextTableLayout, read_text_table};
use crate::warning::SessionWarning;
use nalgebra::{Quaternion, Rotation3, UnitQuaternion, Vector3};
use std::path::Path;

/// More rows than this are no log that was meant, and would fill the memory.
const MAX_ROWS: usize = 5_000_000;
const AXES: [&str; 3] = ["x", "y", "z"];
const TURN: [&str; 4] = ["base_qw", "base_qx", "base_qy", "base_qz"];

/// A log, and whether it has the base's pose in the world.
pub struct LoggedMotion {
    /// Motion.
    pub log: MotionLog,
    /// Poses of the base, not ways of the object.
    pub posed: bool,
    /// The file may have been cut off.
    pub warning: Option<SessionWarning>,
}

/// Columns of a place and the millimetres of their unit; none where the table has none of that
/// name.
fn place_columns(table: &TextTable, name: &str) -> Option<([usize; 3], f64)> {
    [("mm", 1.0), ("m", 1e3)]
        .into_iter()
        .find_map(|(unit, mm)| {
            let columns = AXES.map(|axis| table.column(&format!("{name}_{axis}_{unit}")).ok());
            let [Some(x), Some(y), Some(z)] = columns else {
                return None;
            };
            Some(([x, y, z], mm))
        })
}

/// Whether a column is one of a motion.
pub fn is_motion_column(name: &str) -> bool {
    let places = ["object", "base"]
        .iter()
        .flat_map(|of| AXES.map(|axis| format!("{of}_{axis}_")));
    TURN.contains(&name)
        || places
            .into_iter()
            .any(|p| matches!(name.strip_prefix(&p), Some("mm" | "m")))
}

/// Whether a table has the columns of a motion.
///
/// # Errors
/// Where it cannot be read.
pub fn has_motion(path: &Path) -> Result<bool, SessionError> {
    let table = read_text_table(path, &TextTableLayout::default())?;
    Ok(["object", "base"]
        .iter()
        .any(|name| place_columns(&table, name).is_some()))
}

/// Reads a log; rows with empty cells say nothing.
///
/// # Errors
/// What cannot be used, by line and column.
pub fn read(path: &Path) -> Result<LoggedMotion, SessionError> {
    const EITHER: &str = "either object_x_mm .. object_z_mm (base frame) or base_x_mm .. base_z_mm (world frame, the object at rest)";
    const ONE: &str = "object_x_mm .. object_z_mm or base_x_mm .. base_z_mm (_m for metres)";
    const ALL: &str =
        "base_qw, base_qx, base_qy and base_qz in addition to base_x_mm, or none of them";
    let table = read_text_table(path, &TextTableLayout::default())?;
    let wrong = |expected: &str, found: String| InputError::new(&table.file, expected, found);
    let count = table.rows.len();
    if count > MAX_ROWS {
        return Err(wrong(&format!("at most {MAX_ROWS} rows"), count.to_string()).into());
    }
    let time = table.column("t_s")?;
    let (columns, mm, posed) = match ["object", "base"].map(|of| place_columns(&table, of)) {
        [Some((columns, mm)), None] => (columns, mm, false),
        [None, Some((columns, mm))] => (columns, mm, true),
        [Some(_), Some(_)] => return Err(wrong(EITHER, "both".to_owned()).into()),
        [None, None] => {
            let found = format!("the columns {}", table.columns.join(", "));
            return Err(wrong(ONE, found).into());
        }
    };
    let turn = TURN.iter().filter_map(|c| table.column(c).ok());
    let turn: Vec<usize> = turn.collect();
    // The base may turn; of an object only its way is read.
    if !matches!((turn.len(), posed), (0, _) | (4, true)) {
        let found: Vec<&str> = turn.iter().map(|c| table.columns[*c].as_str()).collect();
        return Err(wrong(ALL, found.join(", ")).into());
    }
    let mut rows = Vec::with_capacity(count);
    for (k, (line, _)) in table.rows.iter().enumerate() {
        let cells = |columns: &[usize]| -> Result<Option<Vec<f64>>, InputError> {
            columns.iter().map(|c| table.number(k, *c)).collect()
        };
        let (Some(t_s), Some(place), Some(turn)) =
            (table.number(k, time)?, cells(&columns)?, cells(&turn)?)
        else {
            continue;
        };
        let place = Vector3::from_column_slice(&place) * mm;
        let (turn, moved_mm) = match (posed, &turn[..]) {
            (false, _) => (Rotation3::identity(), place),
            // In the base's frame the object goes the opposite way.
            (true, []) => (Rotation3::identity(), -place),
            (true, q) => {
                let q = Quaternion::new(q[0], q[1], q[2], q[3]);
                if !((q.norm() - 1.0).abs() < 1e-3) {
                    let error = wrong("a unit quaternion", format!("norm {}", q.norm()));
                    return Err(error.at(*line).field("base_qw..base_qz").into());
                }
                // The object's frame is the world's: p_base = R' (p - t).
                let back = UnitQuaternion::new_normalize(q)
                    .inverse()
                    .to_rotation_matrix();
                (back, back * -place)
            }
        };
        rows.push(LogRow {
            line: *line,
            t_s,
            turn,
            moved_mm,
        });
    }
    let in_file = |e: InputError| e.of_source(&table.file, |line| line, |_| None);
    let log = MotionLog::new(rows).map_err(in_file)?;
    Ok(LoggedMotion {
        log,
        posed,
        warning: table.warning(),
    })
}
