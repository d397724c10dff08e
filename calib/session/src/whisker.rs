//! Tables of whisker readings: `points.csv`, `holdout.csv`, `twin.csv`, and free tables for
//! `predict`.

use crate::error::{InputError, SessionError};
use crate::row::{PointNumbers, Row, clock_problem};
use crate::screening::{copied, overflow};
use crate::table::{TextTable, read_own};
use crate::warning::{SessionWarning, WarningKind, named};
use crate::whisker_meta::WAVELENGTH_NM;
use nalgebra::Vector3;
use std::collections::HashSet;
use std::path::Path;
use wcal_core::text::brief;
use wcal_core::{FbgSpec, InputFile, Purpose, Role, Trajectory, TwinLabel, WhiskerRow};

/// No strain within the fibre's limit shifts a grating further than this, nm.
const LARGEST_SHIFT_NM: f64 = 20.0;
pub(crate) const PM_PER_NM: f64 = 1000.0;

/// Readings with what was noticed while reading them.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingTable {
    /// Rows in file order.
    pub rows: Vec<WhiskerRow>,
    /// What deserves attention.
    pub warnings: Vec<SessionWarning>,
}

/// Reads a free table of whisker readings for prediction: only the fbg columns are required. A row
/// without `point` gets its order (from 0), a row without `role` is [`Role::Verification`].
///
/// # Errors
/// As [`crate::load`]: the first cell that cannot be used.
pub fn load_table(path: &Path, fbg: &FbgSpec) -> Result<ReadingTable, SessionError> {
    let table = read_own(path, &path.display().to_string())?;
    Ok(read_rows(&table, &mut fbg.clone(), None)?)
}

/// Columns of a whisker's table in the order of the reference: those that an import takes by their
/// names, and a recorded session has with `stream` after them.
pub const WHISKER_COLUMNS: [&str; 23] = [
    "point",
    "role",
    "trajectory",
    "replicate",
    "t_s",
    "stage_mm",
    "direction",
    "speed_mm_s",
    "dwell_s",
    "groove_x_mm",
    "groove_y_mm",
    "groove_z_mm",
    "temperature_degc",
    "fbg_ref_nm",
    "fbg_1_nm",
    "fbg_2_nm",
    "fbg_ref_shift_nm",
    "fbg_1_shift_nm",
    "fbg_2_shift_nm",
    "fbg_1_sd_pm",
    "fbg_2_sd_pm",
    "samples",
    "average_s",
];

/// Columns that every session has.
pub const IN_SESSION: [&str; 6] = [
    "point",
    "role",
    "trajectory",
    "groove_x_mm",
    "groove_y_mm",
    "groove_z_mm",
];
/// Those of the gratings and of the strain-isolated one, as shifts from nominal and as wavelengths.
const SHIFTS: [&str; 3] = ["fbg_1_shift_nm", "fbg_2_shift_nm", "fbg_ref_shift_nm"];
const WAVELENGTHS: [&str; 3] = ["fbg_1_nm", "fbg_2_nm", "fbg_ref_nm"];

/// Reads the rows of a table of readings: of a session with role, one of its `trajectories` and
/// groove, else wavelengths are enough. A missing `reference_nominal_nm` is set from the first
/// reading (its offset is part of the zero).
pub(crate) fn read_rows(
    table: &TextTable,
    fbg: &mut FbgSpec,
    trajectories: Option<&[Trajectory]>,
) -> Result<ReadingTable, InputError> {
    let name = &table.file;
    let in_session = trajectories.is_some();
    let shifts = SHIFTS[..2]
        .iter()
        .all(|column| table.place(column).is_some());
    let (gratings, foreign) = if shifts {
        (SHIFTS, WAVELENGTHS)
    } else {
        (WAVELENGTHS, SHIFTS)
    };
    let required = [
        if in_session { &IN_SESSION[..] } else { &[] },
        &gratings[..2],
    ]
    .concat();
    let known = WHISKER_COLUMNS
        .iter()
        .copied()
        .filter(|column| !foreign.contains(column));
    // Sweeps write it; a free table may use the word for something else.
    let known: Vec<&str> = known.chain(["stream"]).collect();
    let mut warnings = unknown_columns(name, table.others(&required, &known)?);
    // Shifts count from nominal wavelengths: without them absolute ones have no zero.
    if !shifts && fbg.nominal_nm.is_none() {
        let expected = "two nominal wavelengths in nm, since the table holds fbg_1_nm";
        return Err(InputError::new("session.toml", expected, "nothing").field("fbg.nominal_nm"));
    }
    let mut out = vec![false; table.rows.len()];
    let sensed = [&gratings[..], &["temperature_degc"]].concat();
    warnings.extend(overflow(table, [&[], &sensed], &mut out)?);
    let [mut lost, mut late, mut moved] = [(); 3].map(|()| Vec::new());
    // A mean over several places is a reading of none of them.
    let coded = out.clone();
    for row in Row::all(table).filter(|row| in_session && !coded[row.index]) {
        if row.stream()? == "moved" {
            moved.push(row.point()?);
            out[row.index] = true;
        }
    }
    let without_copies = out.clone();
    // A free table may hold the same rounded readings many times; a session's points are poses.
    if in_session {
        warnings.extend(copied(table, None, &mut out)?);
    }
    let (mut points, mut rows) = (PointNumbers::default(), Vec::new());
    for row in Row::all(table) {
        // The number of a copy was noted with the row that it copies.
        if !out[row.index] || without_copies[row.index] {
            points.note(&row, row.point_or_order()?)?;
        }
        if out[row.index] {
            continue;
        }
        let reading = read_row(&row, gratings, fbg, trajectories)?;
        if in_session {
            match row.stream()? {
                "lost" => lost.push(reading.point),
                "late" => late.push(reading.point),
                _ => {}
            }
        }
        rows.push(reading);
    }
    for (points, kind, says) in [
        (
            lost,
            WarningKind::Other,
            ": scans are missing in the averaging window",
        ),
        (
            late,
            WarningKind::ScansLate,
            ": scans came late, or the clocks could not be aligned: the bench or the recording computer had fallen behind",
        ),
        (
            moved,
            WarningKind::StageMoved,
            " left out: the stage moved in their averaging window, or stood where it had not been sent",
        ),
    ] {
        let text = format!("points {}{says}", named(&points));
        warnings.extend((!points.is_empty()).then(|| SessionWarning::new(name, kind, text)));
    }
    warnings.extend(stuck(&rows).map(|column| {
        let rows = rows.len();
        let text = format!("no sensitivity: {column} reads the same in all {rows} rows while another grating changes; it is dead, stuck or not connected");
        SessionWarning::new(name, WarningKind::Stuck, text)
    }));
    warnings.extend(clock_problem(name, rows.iter().map(|r| (r.line, r.t_s))));
    warnings.extend(table.warning());
    Ok(ReadingTable { rows, warnings })
}

/// Readings of a table that a grating at work does not repeat to the last digit.
const MIN_STUCK: usize = 20;
/// Values that another grating takes meanwhile: the instrument is at work.
const MIN_VALUES: usize = 5;

/// The grating that reads the same in every row while another grating changes.
fn stuck(rows: &[WhiskerRow]) -> Option<String> {
    let values = |of: &dyn Fn(&WhiskerRow) -> Option<f64>| -> usize {
        rows.iter()
            .filter_map(of)
            .map(f64::to_bits)
            .collect::<HashSet<u64>>()
            .len()
    };
    let counts = [
        values(&|r| Some(r.shift_pm[0])),
        values(&|r| Some(r.shift_pm[1])),
        values(&|r| r.reference_shift_pm),
    ];
    let moves = counts.iter().any(|n| *n >= MIN_VALUES);
    let still = (0..2)
        .find(|&g| counts[g] == 1)
        .filter(|_| moves && rows.len() >= MIN_STUCK);
    still.map(|g| format!("fbg_{}", g + 1))
}

pub(crate) fn unknown_columns(file: &str, columns: Vec<String>) -> Vec<SessionWarning> {
    let of = |column: String| {
        let text = format!("column {} is not known and not used", brief(&column));
        SessionWarning::new(file, WarningKind::UnknownColumn(column), text)
    };
    columns.into_iter().map(of).collect()
}

fn read_row(
    row: &Row<'_>,
    gratings: [&str; 3],
    fbg: &mut FbgSpec,
    trajectories: Option<&[Trajectory]>,
) -> Result<WhiskerRow, InputError> {
    let role = if row.table.place("role").is_some() {
        row.role()?
    } else {
        Role::Verification
    };
    let mut trajectory = row.count("trajectory", 0)?;
    let groove_mm = groove(row)?;
    if let Some(known) = trajectories {
        let is_known = known.iter().any(|t| trajectory == Some(t.id));
        // A rest row touches nothing: the path that it was on does not matter.
        if role == Role::Rest {
            trajectory = trajectory.filter(|_| is_known);
        } else if !is_known {
            let found = trajectory.map_or("nothing".to_owned(), |id| format!("{id}"));
            return Err(row.error(
                "trajectory",
                "the id of a [[trajectory]] in session.toml",
                found,
            ));
        } else if groove_mm.is_none() {
            return Err(row.error(
                "groove_x_mm",
                "a number (only a rest row needs no groove)",
                "nothing",
            ));
        }
    }
    let nominal_nm = (gratings == WAVELENGTHS).then(|| fbg.nominal_nm.unwrap_or_default());
    let shift = |g: usize| {
        shift_pm(
            row,
            gratings[g],
            row.required(gratings[g])?,
            nominal_nm.map(|n| n[g]),
        )
    };
    let reference_shift_pm = match row.number(gratings[2])? {
        Some(nm) => {
            let nominal_nm = nominal_nm.map(|_| fbg.reference_nominal_nm.unwrap_or(nm));
            let shift_pm = shift_pm(row, gratings[2], nm, nominal_nm)?;
            fbg.reference_nominal_nm = fbg.reference_nominal_nm.or(nominal_nm);
            Some(shift_pm)
        }
        None => None,
    };
    let sd = [
        row.not_negative("fbg_1_sd_pm")?,
        row.not_negative("fbg_2_sd_pm")?,
    ];
    let speed_mm_s = row.not_negative("speed_mm_s")?;
    // A settled row is the mean over a window that its times end: the mean is of its middle.
    let settled = speed_mm_s.is_none_or(|v| v == 0.0);
    let average_s = if settled {
        row.not_negative("average_s")?
    } else {
        None
    };
    let half_s = average_s.unwrap_or(0.0) / 2.0;
    Ok(WhiskerRow {
        source: row.table.file.clone(),
        line: row.line,
        point: row.point_or_order()?,
        role,
        trajectory,
        replicate: row.count("replicate", 0)?,
        t_s: row.number("t_s")?.map(|end_s| end_s - half_s),
        stage_mm: row.number("stage_mm")?,
        direction: row.sign("direction")?,
        speed_mm_s,
        dwell_s: row
            .not_negative("dwell_s")?
            .map(|end_s| (end_s - half_s).max(0.0)),
        average_s,
        groove_mm,
        temperature_degc: row.temperature()?,
        shift_pm: [shift(0)?, shift(1)?],
        reference_shift_pm,
        shift_sd_pm: if let [Some(a), Some(b)] = sd {
            Some([a, b])
        } else {
            None
        },
        samples: row.count("samples", 1)?,
        seating: 0,
        sealed: false,
        pair: None,
    })
}

fn groove(row: &Row<'_>) -> Result<Option<Vector3<f64>>, InputError> {
    let cells = [
        row.number(IN_SESSION[3])?,
        row.number(IN_SESSION[4])?,
        row.number(IN_SESSION[5])?,
    ];
    match cells {
        [Some(x), Some(y), Some(z)] => Ok(Some(Vector3::new(x, y, z))),
        [None, None, None] => Ok(None),
        _ => {
            let empty = cells.iter().position(Option::is_none).unwrap_or(0);
            Err(row.error(
                IN_SESSION[3 + empty],
                "a number (its neighbours are given)",
                "nothing",
            ))
        }
    }
}

/// Shift from nominal, pm, of what a column holds: a shift, or a wavelength where the nominal one
/// is given.
fn shift_pm(
    row: &Row<'_>,
    column: &str,
    nm: f64,
    nominal_nm: Option<f64>,
) -> Result<f64, InputError> {
    let (low, high) = WAVELENGTH_NM;
    let is_wavelength = |nm: f64| (low..=high).contains(&nm);
    if nominal_nm.is_some() && !is_wavelength(nm) {
        // A wrong unit is the usual mistake: the hint names the one in which the number fits.
        let hint = if is_wavelength(nm * PM_PER_NM) {
            "um instead of nm?"
        } else if is_wavelength(nm / PM_PER_NM) {
            "pm instead of nm?"
        } else if nm.abs() < LARGEST_SHIFT_NM {
            "a shift? name the columns fbg_1_shift_nm, fbg_2_shift_nm"
        } else {
            "check the unit"
        };
        let expected = format!("a wavelength between {low} and {high} nm");
        return Err(row.error(column, expected, nm.to_string()).hint(hint));
    }
    let shift_nm = nm - nominal_nm.unwrap_or(0.0);
    if shift_nm.abs() <= LARGEST_SHIFT_NM {
        return Ok(shift_nm * PM_PER_NM);
    }
    let expected = format!("a shift from nominal of at most {LARGEST_SHIFT_NM} nm");
    let hint = if nominal_nm.is_some() {
        "wrong nominal_nm or grating?"
    } else {
        "pm instead of nm?"
    };
    Err(row.error(column, expected, shift_nm.to_string()).hint(hint))
}

/// Reads `twin.csv`; every label must belong to a point of the points table.
pub(crate) fn read_twin(
    path: &Path,
    name: &str,
    rows: &[WhiskerRow],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(Vec<TwinLabel>, InputFile), SessionError> {
    const MOMENTS: [&str; 2] = ["moment_1_nmm", "moment_2_nmm"];
    let table: TextTable = read_own(path, name)?;
    // `wcal twin` writes these with the labels, and no moment where it finds no equilibrium.
    let others = table.others(
        &["point", MOMENTS[0], MOMENTS[1]],
        &["contact_arclength_mm", "settled", "branch"],
    )?;
    warnings.extend(unknown_columns(name, others));
    let may_be_empty = table.place("branch").is_some();
    let known: HashSet<i64> = rows.iter().map(|r| r.point).collect();
    // Rows that were left out may have their labels all the same.
    let left_out: HashSet<i64> = warnings
        .iter()
        .filter_map(|warning| match &warning.kind {
            WarningKind::LeftOut(points) => Some(points),
            _ => None,
        })
        .flatten()
        .copied()
        .collect();
    let (mut points, mut labels) = (PointNumbers::default(), Vec::new());
    for row in Row::all(&table) {
        let point = row.point()?;
        points.note(&row, point)?;
        if may_be_empty && row.number(MOMENTS[0])?.is_none() && row.number(MOMENTS[1])?.is_none() {
            continue;
        }
        let moment_nmm = [row.required(MOMENTS[0])?, row.required(MOMENTS[1])?];
        if known.contains(&point) {
            labels.push(TwinLabel { point, moment_nmm });
        } else if !left_out.contains(&point) {
            return Err(row
                .error("point", "a point of the points table", format!("{point}"))
                .into());
        }
    }
    warnings.extend(table.warning());
    if labels.len() < known.len() {
        let text = format!(
            "{} of {} points have no label",
            known.len() - labels.len(),
            known.len()
        );
        warnings.push(SessionWarning::other(name, text));
    }
    Ok((labels, table.input(Purpose::Description)))
}
