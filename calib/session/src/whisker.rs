//! Tables of whisker readings: `points.csv`, `holdout.csv`, `twin.csv`, and free tables for `predict`.

use crate::error::{InputError, SessionError};
use crate::left_out::LeftOut;
use crate::row::Column;
use crate::row::{Clock, PointNumbers, Row};
use crate::table::Table;
use crate::warning::{SessionWarning, WarningKind};
use crate::whisker_meta::WAVELENGTH_NM;
use nalgebra::Vector3;
use std::collections::HashSet;
use std::path::Path;
use wcal_core::{FbgSpec, InputFile, Role, Trajectory, TwinLabel, WhiskerRow};

/// No strain within the fibre's limit shifts a grating further than this, nm.
const LARGEST_SHIFT_NM: f64 = 20.0;
const PM_PER_NM: f64 = 1000.0;

/// What a table must hold.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum ColumnRequirement {
    /// Role, trajectory and groove as in a session.
    Session,
    /// Wavelengths are enough.
    Readings,
}

/// Readings with what was noticed while reading them.
#[derive(Debug, Clone, PartialEq)]
pub struct ReadingTable {
    /// Rows in file order.
    pub rows: Vec<WhiskerRow>,
    /// The file and its hash.
    pub input: InputFile,
    /// What deserves attention.
    pub warnings: Vec<SessionWarning>,
    /// Optional columns that are present, by name.
    pub columns: Vec<String>,
}

/// Reads a free table of whisker readings for prediction: only the fbg columns are required. A row without `point` gets
/// its order (from 0), a row without `role` is [`Role::Verification`].
///
/// # Errors
/// As [`crate::load`]: the first cell that cannot be used.
pub fn load_table(path: &Path, fbg: &FbgSpec) -> Result<ReadingTable, SessionError> {
    let name = path.display().to_string();
    read_rows(path, &name, &mut fbg.clone(), &[], ColumnRequirement::Readings)
}

struct Columns {
    point: Option<Column>,
    role: Option<Column>,
    trajectory: Option<Column>,
    groove: Option<[Column; 3]>,
    fbg: Wavelengths,
    replicate: Option<Column>,
    t_s: Option<Column>,
    stage: Option<Column>,
    direction: Option<Column>,
    speed: Option<Column>,
    dwell: Option<Column>,
    temperature: Option<Column>,
    sd: [Option<Column>; 2],
    samples: Option<Column>,
    average: Option<Column>,
    stream: Option<Column>,
}

impl Columns {
    /// Columns of instruments that write an overflow value for a reading that failed.
    fn sensed(&self) -> impl Iterator<Item = Column> + use<> {
        let (gratings, reference) = match &self.fbg {
            Wavelengths::Absolute { columns, reference, .. } | Wavelengths::Shift { columns, reference } => {
                (*columns, *reference)
            }
        };
        gratings.into_iter().chain(reference).chain(self.temperature)
    }
}

enum Wavelengths {
    Absolute { columns: [Column; 2], nominal_nm: [f64; 2], reference: Option<Column> },
    Shift { columns: [Column; 2], reference: Option<Column> },
}

/// Columns of a whisker's table in the order of the reference: those that an import takes by their names, and a recorded session has with
/// `stream` after them.
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

fn find_columns(
    table: &mut Table,
    fbg: &FbgSpec,
    requirement: ColumnRequirement,
) -> Result<Columns, InputError> {
    let in_session = requirement == ColumnRequirement::Session;
    let need = |table: &mut Table, name: &'static str| {
        if in_session { table.required(name).map(Some) } else { table.optional(name) }
    };
    let point = need(table, "point")?;
    let role = need(table, "role")?;
    let trajectory = need(table, "trajectory")?;
    let groove = match (need(table, "groove_x_mm")?, need(table, "groove_y_mm")?, need(table, "groove_z_mm")?)
    {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    Ok(Columns {
        point,
        role,
        trajectory,
        groove,
        fbg: find_wavelengths(table, fbg)?,
        replicate: table.optional("replicate")?,
        t_s: table.optional("t_s")?,
        stage: table.optional("stage_mm")?,
        direction: table.optional("direction")?,
        speed: table.optional("speed_mm_s")?,
        dwell: table.optional("dwell_s")?,
        temperature: table.optional("temperature_degc")?,
        sd: [table.optional("fbg_1_sd_pm")?, table.optional("fbg_2_sd_pm")?],
        samples: table.optional("samples")?,
        average: table.optional("average_s")?,
        // A free table may use the word for something else.
        stream: if in_session { table.optional("stream")? } else { None },
    })
}

fn find_wavelengths(table: &mut Table, fbg: &FbgSpec) -> Result<Wavelengths, InputError> {
    let shifts = [table.optional("fbg_1_shift_nm")?, table.optional("fbg_2_shift_nm")?];
    if let [Some(first), Some(second)] = shifts {
        let reference = table.optional("fbg_ref_shift_nm")?;
        return Ok(Wavelengths::Shift { columns: [first, second], reference });
    }
    let columns = [table.required("fbg_1_nm")?, table.required("fbg_2_nm")?];
    let reference = table.optional("fbg_ref_nm")?;
    match fbg.nominal_nm {
        Some(nominal_nm) => Ok(Wavelengths::Absolute { columns, nominal_nm, reference }),
        None => Err(InputError::new(
            "session.toml",
            "two nominal wavelengths in nm, since the table holds fbg_1_nm",
            "nothing",
        )
        .field("fbg.nominal_nm")),
    }
}

/// Reads a table of readings. A missing `reference_nominal_nm` is set from the first reading (its offset is part of the zero).
pub(crate) fn read_rows(
    path: &Path,
    name: &str,
    fbg: &mut FbgSpec,
    trajectories: &[Trajectory],
    requirement: ColumnRequirement,
) -> Result<ReadingTable, SessionError> {
    let mut table = Table::open(path, name)?;
    let columns = find_columns(&mut table, fbg, requirement)?;
    let mut warnings = unused_columns(&table);
    let known: HashSet<u32> = trajectories.iter().map(|t| t.id).collect();
    let (mut points, mut clock, mut rows) = (PointNumbers::default(), Clock::default(), Vec::new());
    let [mut lost, mut late, mut moved] = [(); 3].map(|()| Vec::new());
    let mut left_out = LeftOut::of(path, name, columns.sensed().collect())?;
    let (mut places, mut order) = (Vec::new(), 0);
    // A free table may hold the same rounded readings many times; a session's points are poses.
    let numbered = columns.point.filter(|_| requirement == ColumnRequirement::Session);
    while let Some(row) = table.next_row()? {
        order += 1;
        if let Some(code) = left_out.overflowed(&row)? {
            let point = columns.point.map_or(Ok(order - 1), |c| row.point(c))?;
            points.note(&row, point)?;
            left_out.note_overflow(code, row.line, point);
            continue;
        }
        // A mean over several places is a reading of none of them.
        if row.stream(columns.stream)? == Some("moved") {
            let point = columns.point.map_or(Ok(order - 1), |c| row.point(c))?;
            points.note(&row, point)?;
            moved.push(point);
            continue;
        }
        let reading = read_row(&row, &columns, fbg, &known, requirement, order - 1)?;
        places.push((reading.line, reading.point));
        let timed = reading.t_s.is_some();
        if numbered.is_some() && left_out.note_cells(&row, numbered, timed) {
            // Its point number and its time were noted with the row that it copies.
            rows.push(reading);
            continue;
        }
        points.note(&row, reading.point)?;
        clock.note(row.line, reading.t_s);
        match row.stream(columns.stream)? {
            Some("lost") => lost.push(reading.point),
            Some("late") => late.push(reading.point),
            _ => {}
        }
        rows.push(reading);
    }
    if !lost.is_empty() {
        warnings.push(SessionWarning::new(name, WarningKind::ScansLost(lost)));
    }
    if !late.is_empty() {
        warnings.push(SessionWarning::new(name, WarningKind::ScansLate(late)));
    }
    if !moved.is_empty() {
        warnings.push(SessionWarning::new(name, WarningKind::StageMoved(moved)));
    }
    let copies = left_out.copies();
    let copied = copies.iter().map(|&k| places[k]).collect();
    let mut place = 0;
    rows.retain(|_| {
        place += 1;
        copies.binary_search(&(place - 1)).is_err()
    });
    warnings.extend(left_out.warnings(name, copied, rows.len())?);
    warnings.extend(
        stuck(&rows).map(|column| SessionWarning::new(name, WarningKind::Stuck { column, rows: rows.len() })),
    );
    warnings.extend(clock.warning(name));
    warnings.extend(table.open_end());
    let columns = table.present();
    Ok(ReadingTable { rows, input: table.finish()?, warnings, columns })
}

/// Readings of a table that a grating at work does not repeat to the last digit.
const MIN_STUCK: usize = 20;
/// Values that another grating takes meanwhile: the instrument is at work.
const MIN_VALUES: usize = 5;

/// The grating that reads the same in every row while another grating changes.
fn stuck(rows: &[WhiskerRow]) -> Option<String> {
    let values = |of: &dyn Fn(&WhiskerRow) -> Option<f64>| -> usize {
        rows.iter().filter_map(of).map(f64::to_bits).collect::<HashSet<u64>>().len()
    };
    let counts = [
        values(&|r| Some(r.shift_pm[0])),
        values(&|r| Some(r.shift_pm[1])),
        values(&|r| r.reference_shift_pm),
    ];
    let moves = counts.iter().any(|n| *n >= MIN_VALUES);
    let still = (0..2).find(|&g| counts[g] == 1).filter(|_| moves && rows.len() >= MIN_STUCK);
    still.map(|g| format!("fbg_{}", g + 1))
}

pub(crate) fn unused_columns(table: &Table) -> Vec<SessionWarning> {
    let of = |column: String| SessionWarning::new(table.file(), WarningKind::UnknownColumn(column));
    table.unused().into_iter().map(|(_, column)| of(column)).collect()
}

fn read_row(
    row: &Row<'_>,
    columns: &Columns,
    fbg: &mut FbgSpec,
    known: &HashSet<u32>,
    requirement: ColumnRequirement,
    order: i64,
) -> Result<WhiskerRow, InputError> {
    let role = columns.role.map_or(Ok(Role::Verification), |c| row.role(c))?;
    let mut trajectory = row.count(columns.trajectory, 0)?;
    let groove_mm = groove(row, columns.groove)?;
    if requirement == ColumnRequirement::Session {
        let is_known = trajectory.is_some_and(|id| known.contains(&id));
        if role == Role::Rest {
            trajectory = trajectory.filter(|_| is_known);
        } else if !is_known {
            let found = trajectory.map_or("nothing".to_owned(), |id| format!("{id}"));
            return Err(row.error("trajectory", "the id of a [[trajectory]] in session.toml", found));
        } else if groove_mm.is_none() {
            return Err(row.error("groove_x_mm", "a number (only a rest row needs no groove)", "nothing"));
        }
    }
    let (shift_pm, reference_shift_pm) = shifts(row, &columns.fbg, fbg)?;
    let sd = [row.not_negative(columns.sd[0])?, row.not_negative(columns.sd[1])?];
    let speed_mm_s = row.not_negative(columns.speed)?;
    // A settled row is the mean over a window that its times end: the mean is of its middle.
    let settled = speed_mm_s.is_none_or(|v| v == 0.0);
    let average_s = row.not_negative(columns.average.filter(|_| settled))?;
    let half_s = average_s.unwrap_or(0.0) / 2.0;
    Ok(WhiskerRow {
        source: row.file.to_owned(),
        line: row.line,
        point: columns.point.map_or(Ok(order), |c| row.point(c))?,
        role,
        trajectory,
        replicate: row.count(columns.replicate, 0)?,
        t_s: row.number(columns.t_s)?.map(|end_s| end_s - half_s),
        stage_mm: row.number(columns.stage)?,
        direction: row.sign(columns.direction)?,
        speed_mm_s,
        dwell_s: row.not_negative(columns.dwell)?.map(|end_s| (end_s - half_s).max(0.0)),
        average_s,
        groove_mm,
        temperature_degc: row.temperature(columns.temperature)?,
        shift_pm,
        reference_shift_pm,
        shift_sd_pm: if let [Some(a), Some(b)] = sd { Some([a, b]) } else { None },
        samples: row.count(columns.samples, 1)?,
        seating: 0,
        sealed: false,
        pair: None,
    })
}

fn groove(row: &Row<'_>, columns: Option<[Column; 3]>) -> Result<Option<Vector3<f64>>, InputError> {
    let Some(columns) = columns else { return Ok(None) };
    let cells = [row.number(Some(columns[0]))?, row.number(Some(columns[1]))?, row.number(Some(columns[2]))?];
    match cells {
        [Some(x), Some(y), Some(z)] => Ok(Some(Vector3::new(x, y, z))),
        [None, None, None] => Ok(None),
        _ => {
            let empty = cells.iter().position(Option::is_none).unwrap_or(0);
            Err(row.error(columns[empty].name, "a number (its neighbours are given)", "nothing"))
        }
    }
}

fn shifts(
    row: &Row<'_>,
    columns: &Wavelengths,
    fbg: &mut FbgSpec,
) -> Result<([f64; 2], Option<f64>), InputError> {
    match columns {
        Wavelengths::Shift { columns, reference } => {
            let shift = |c: Column| checked_shift(row, c, row.required(c)?);
            let reference = match (reference, row.number(*reference)?) {
                (Some(c), Some(nm)) => Some(checked_shift(row, *c, nm)?),
                _ => None,
            };
            Ok(([shift(columns[0])?, shift(columns[1])?], reference))
        }
        Wavelengths::Absolute { columns, nominal_nm, reference } => {
            let shift = |i: usize| {
                let nm = checked_wavelength(row, columns[i], row.required(columns[i])?)?;
                checked_shift(row, columns[i], nm - nominal_nm[i])
            };
            let reference = match (reference, row.number(*reference)?) {
                (Some(c), Some(nm)) => {
                    let nm = checked_wavelength(row, *c, nm)?;
                    let nominal_nm = *fbg.reference_nominal_nm.get_or_insert(nm);
                    Some(checked_shift(row, *c, nm - nominal_nm)?)
                }
                _ => None,
            };
            Ok(([shift(0)?, shift(1)?], reference))
        }
    }
}

fn checked_wavelength(row: &Row<'_>, column: Column, nm: f64) -> Result<f64, InputError> {
    let (low, high) = WAVELENGTH_NM;
    if (low..=high).contains(&nm) {
        return Ok(nm);
    }
    let hint = if (low..=high).contains(&(nm * PM_PER_NM)) {
        "um instead of nm?"
    } else if (low..=high).contains(&(nm / PM_PER_NM)) {
        "pm instead of nm?"
    } else if nm.abs() < LARGEST_SHIFT_NM {
        "a shift? name the columns fbg_1_shift_nm, fbg_2_shift_nm"
    } else {
        "check the unit"
    };
    Err(row
        .error(column.name, format!("a wavelength between {low} and {high} nm"), format!("{nm}"))
        .hint(hint))
}

/// Shift in pm.
fn checked_shift(row: &Row<'_>, column: Column, shift_nm: f64) -> Result<f64, InputError> {
    if shift_nm.abs() <= LARGEST_SHIFT_NM {
        return Ok(shift_nm * PM_PER_NM);
    }
    let expected = format!("a shift from nominal of at most {LARGEST_SHIFT_NM} nm");
    let error = row.error(column.name, expected, format!("{shift_nm}"));
    Err(error.hint(if column.name.ends_with("shift_nm") {
        "pm instead of nm?"
    } else {
        "wrong nominal_nm or grating?"
    }))
}

/// Reads `twin.csv`; every label must belong to a point of the points table.
pub(crate) fn read_twin(
    path: &Path,
    name: &str,
    rows: &[WhiskerRow],
    warnings: &mut Vec<SessionWarning>,
) -> Result<(Vec<TwinLabel>, InputFile), SessionError> {
    let mut table = Table::open(path, name)?;
    let point = table.required("point")?;
    let moments = [table.required("moment_1_nmm")?, table.required("moment_2_nmm")?];
    // `wcal twin` writes these with the labels, and no moment where it finds no equilibrium.
    for extra in ["contact_arclength_mm", "settled"] {
        table.optional(extra)?;
    }
    let may_be_empty = table.optional("branch")?.is_some();
    warnings.extend(unused_columns(&table));
    let known: HashSet<i64> = rows.iter().map(|r| r.point).collect();
    let left_out: HashSet<i64> = warnings.iter().flat_map(SessionWarning::left_out).copied().collect();
    let (mut points, mut labels) = (PointNumbers::default(), Vec::new());
    while let Some(row) = table.next_row()? {
        if may_be_empty && row.number(Some(moments[0]))?.is_none() && row.number(Some(moments[1]))?.is_none()
        {
            points.note(&row, row.point(point)?)?;
            continue;
        }
        let label = TwinLabel {
            point: row.point(point)?,
            moment_nmm: [row.required(moments[0])?, row.required(moments[1])?],
        };
        points.note(&row, label.point)?;
        if left_out.contains(&label.point) && !known.contains(&label.point) {
            continue;
        }
        if !known.contains(&label.point) {
            return Err(row.error("point", "a point of the points table", format!("{}", label.point)).into());
        }
        labels.push(label);
    }
    warnings.extend(table.open_end());
    let input = table.finish()?;
    if labels.len() < known.len() {
        let kind = WarningKind::Unlabelled { points: known.len() - labels.len(), of: known.len() };
        warnings.push(SessionWarning::new(name, kind));
    }
    Ok((labels, input))
}
