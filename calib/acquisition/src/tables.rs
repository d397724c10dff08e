//! Text of the reduced tables and of `session.toml`.

use crate::clocks::ClockFit;
use crate::error::AcquisitionError;
use crate::reduction::Reduction;
use crate::rig::Rig;
use crate::run_file::RunFile;
use crate::windows::WindowMean;
use nalgebra::Vector3;
use toml::{Table, Value};
use wcal_session::SIMULATED_COLUMN;

/// Columns of points.csv and holdout.csv.
const COLUMNS: [&str; 21] = [
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
    "fbg_1_sd_pm",
    "fbg_2_sd_pm",
    "samples",
    "average_s",
    "stream",
];
/// Columns of compensation.csv: shifts with temperature taken out, and the uncertainty of the mean.
const COMPENSATION: [&str; 8] = [
    "file",
    "point",
    "fbg_1_pm",
    "fbg_1_u_pm",
    "fbg_2_pm",
    "fbg_2_u_pm",
    "settled",
    "unusable_scans",
];

/// What the stream did in the averaging window of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    /// Its scans are there, and came in time.
    Whole,
    /// Scans are missing.
    Lost,
    /// Scans came late (the bench or the recording computer had fallen behind), or the clocks cannot be aligned: where the stage was is not
    /// known.
    Late,
    /// The stage moved, or stood where it had not been sent: the row is of no one place.
    Moved,
}

impl Stream {
    /// As in the column `stream`.
    pub fn word(self) -> &'static str {
        match self {
            Self::Whole => "ok",
            Self::Lost => "lost",
            Self::Late => "late",
            Self::Moved => "moved",
        }
    }
}

/// A reduced reading.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Role.
    pub role: String,
    /// Recording, from 0.
    pub part: usize,
    /// Step of the plan.
    pub step: u32,
    /// Belongs to the holdout file.
    pub sealed: bool,
    /// Trajectory.
    pub trajectory: u32,
    /// Repetition.
    pub replicate: u32,
    /// Time since the first scan, s.
    pub t_s: f64,
    /// Depth, mm.
    pub stage_mm: f64,
    /// +1 or -1.
    pub direction: i32,
    /// Speed, mm/s.
    pub speed_mm_s: f64,
    /// Time since arrival, s.
    pub dwell_s: f64,
    /// Length of the averaging window of a settled row, s: its times are the window's end.
    pub average_s: Option<f64>,
    /// Groove centre, base frame; absent without contact.
    pub groove_mm: Option<Vector3<f64>>,
    /// Whether the drift gate opened.
    pub settled: bool,
    /// What the stream did.
    pub stream: Stream,
    /// Scans of the window with a lost or crossing peak.
    pub unusable: u32,
    /// Numbers of the marked scans.
    pub serials: Vec<u64>,
    /// Wavelengths.
    pub mean: WindowMean,
}

fn csv_text(
    write: impl FnOnce(&mut csv::Writer<Vec<u8>>) -> csv::Result<()>,
) -> Result<Vec<u8>, AcquisitionError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    write(&mut writer).map_err(|e| AcquisitionError::Recorder(e.to_string()))?;
    writer
        .into_inner()
        .map_err(|e| AcquisitionError::Recorder(e.to_string()))
}

/// Files of the tables: points.csv, holdout.csv where there are such rows, compensation.csv, outliers.csv. Simulated readings are
/// marked in a last column.
///
/// # Errors
/// Practically none: text is written to memory.
pub fn write_tables(
    rig: &Rig,
    rows: &[Row],
    simulated: bool,
) -> Result<Vec<(String, Vec<u8>)>, AcquisitionError> {
    let (holdout, points): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|r| r.sealed);
    let mut files = vec![("points.csv".to_owned(), table(&points, simulated)?)];
    if !holdout.is_empty() {
        files.push(("holdout.csv".to_owned(), table(&holdout, simulated)?));
    }
    let both = [("points.csv", &points), ("holdout.csv", &holdout)];
    let compensation = csv_text(|out| {
        out.write_record(COMPENSATION)?;
        for (file, rows) in both {
            for (k, row) in rows.iter().enumerate() {
                out.write_record(compensation_fields(rig, file, k, row))?;
            }
        }
        Ok(())
    })?;
    files.push(("compensation.csv".to_owned(), compensation));
    let outliers = csv_text(|out| {
        out.write_record(["file", "point", "scan"])?;
        for (file, rows) in both {
            for (k, row) in rows.iter().enumerate() {
                for serial in &row.serials {
                    out.write_record([file.to_owned(), k.to_string(), serial.to_string()])?;
                }
            }
        }
        Ok(())
    })?;
    files.push(("outliers.csv".to_owned(), outliers));
    Ok(files)
}

fn table(rows: &[&Row], simulated: bool) -> Result<Vec<u8>, AcquisitionError> {
    csv_text(|out| {
        out.write_record(
            COLUMNS
                .iter()
                .copied()
                .chain(simulated.then_some(SIMULATED_COLUMN)),
        )?;
        for (k, row) in rows.iter().enumerate() {
            let groove = |axis: usize| {
                row.groove_mm
                    .map_or(String::new(), |g| format!("{:.6}", g[axis]))
            };
            let fields = [
                k.to_string(),
                row.role.clone(),
                row.trajectory.to_string(),
                row.replicate.to_string(),
                format!("{:.4}", row.t_s),
                format!("{:.6}", row.stage_mm),
                row.direction.to_string(),
                format!("{:.4}", row.speed_mm_s),
                format!("{:.4}", row.dwell_s),
                groove(0),
                groove(1),
                groove(2),
                String::new(),
                row.mean
                    .reference_nm
                    .map_or(String::new(), |nm| format!("{nm:.7}")),
                format!("{:.7}", row.mean.sensing_nm[0]),
                format!("{:.7}", row.mean.sensing_nm[1]),
                format!("{:.4}", row.mean.sensing_sd_pm[0]),
                format!("{:.4}", row.mean.sensing_sd_pm[1]),
                row.mean.samples.to_string(),
                row.average_s.map_or(String::new(), |s| format!("{s:.4}")),
                row.stream.word().to_owned(),
            ];
            out.write_record(fields.into_iter().chain(simulated.then(|| "1".to_owned())))?;
        }
        Ok(())
    })
}

fn compensation_fields(rig: &Rig, file: &str, point: usize, row: &Row) -> Vec<String> {
    let ratios = temperature_ratio(rig);
    let heat_pm = match (row.mean.reference_nm, rig.grating("fbg_ref")) {
        (Some(nm), Some(g)) => (nm - g.nominal_nm) * 1e3,
        _ => 0.0,
    };
    let n = row.mean.samples as f64;
    let mut fields = vec![file.to_owned(), point.to_string()];
    for (k, name) in ["fbg_1", "fbg_2"].iter().enumerate() {
        let nominal = rig.grating(name).map_or(0.0, |g| g.nominal_nm);
        let shift = (row.mean.sensing_nm[k] - nominal) * 1e3 - ratios[k] * heat_pm;
        // Var(y) = var_g + r^2 var_ref: the temperature correction adds the reference's noise.
        let variance =
            row.mean.sensing_sd_pm[k].powi(2) + (ratios[k] * row.mean.reference_sd_pm).powi(2);
        fields.extend([
            format!("{shift:.4}"),
            format!("{:.4}", (variance / n).sqrt()),
        ]);
    }
    fields.extend([row.settled.to_string(), row.unusable.to_string()]);
    fields
}

/// Shift of each sensing grating per shift of the reference, from the rig's temperature coefficients; 0 without them.
pub fn temperature_ratio(rig: &Rig) -> [f64; 2] {
    let number = |v: &Value| v.as_float().or_else(|| v.as_integer().map(|i| i as f64));
    let reference = rig
        .fbg
        .get("reference_temperature_pm_per_degc")
        .and_then(number);
    let own = rig
        .fbg
        .get("temperature_pm_per_degc")
        .and_then(Value::as_array);
    match (reference, own) {
        (Some(r), Some(list))
            if r != 0.0 && list.len() == 2 && rig.grating("fbg_ref").is_some() =>
        {
            [0, 1].map(|k| number(&list[k]).unwrap_or(0.0) / r)
        }
        _ => [0.0; 2],
    }
}

/// Entries of session.toml (table and key) that `stereo-shape` adds and a reduction keeps.
pub const ADDED_LATER: [[&str; 2]; 4] = [
    ["files", "shapes"],
    ["files", "holdout_shapes"],
    ["provenance", "cameras_sha256"],
    ["provenance", "shapes_rig_sha256"],
];

/// `session.toml`; `added`: table, key and text of entries that are kept.
///
/// # Errors
/// When the rig's tables cannot be written as TOML.
pub fn session_toml(
    rig: &Rig,
    run: &RunFile,
    recordings: &[String],
    holdout: bool,
    result: &Reduction,
    added: &[[String; 3]],
) -> Result<String, AcquisitionError> {
    let text = |s: &str| Value::String(s.to_owned());
    let mut files = Table::new();
    files.insert("points".to_owned(), text("points.csv"));
    if holdout {
        files.insert("holdout".to_owned(), text("holdout.csv"));
    }
    files.insert("recording".to_owned(), text(&recordings[0]));
    if result.pictures[0] > 0 {
        files.insert("pictures".to_owned(), text("pictures/"));
    }
    let mut fbg = rig.fbg.clone();
    let nominal = |name: &str| rig.grating(name).map(|g| Value::Float(g.nominal_nm));
    fbg.insert(
        "nominal_nm".to_owned(),
        Value::Array(
            ["fbg_1", "fbg_2"]
                .iter()
                .filter_map(|n| nominal(n))
                .collect(),
        ),
    );
    if let Some(reference) = nominal("fbg_ref") {
        fbg.insert("reference_nominal_nm".to_owned(), reference);
    }
    let trajectories = rig.trajectory.iter().map(|t| {
        let mut table = Table::new();
        let vector = |v: &[f64]| Value::Array(v.iter().map(|x| Value::Float(*x)).collect());
        let unit = Vector3::from(t.direction).normalize();
        table.insert("id".to_owned(), Value::Integer(t.id.into()));
        table.insert("origin_mm".to_owned(), vector(&t.origin_mm));
        table.insert("direction".to_owned(), vector(unit.as_slice()));
        if let Some(s) = t.nominal_arclength_mm {
            table.insert("nominal_arclength_mm".to_owned(), Value::Float(s));
        }
        Value::Table(table)
    });
    let mut root = Table::new();
    for (key, value) in [
        ("format", "wcal-session/1"),
        ("id", &run.id),
        ("kind", "whisker"),
        ("medium", &run.medium),
        ("created", &run.created),
    ] {
        root.insert(key.to_owned(), text(value));
    }
    root.insert("files".to_owned(), Value::Table(files));
    root.insert("whisker".to_owned(), Value::Table(rig.whisker.clone()));
    if let Some(moments) = &rig.moments {
        root.insert("moments".to_owned(), Value::Table(moments.clone()));
    }
    root.insert("fbg".to_owned(), Value::Table(fbg));
    root.insert(
        "trajectory".to_owned(),
        Value::Array(trajectories.collect()),
    );
    root.insert(
        "devices".to_owned(),
        Value::Table(devices(run, recordings, result)?),
    );
    let mut provenance = Table::new();
    provenance.insert("program".to_owned(), text(&run.program));
    provenance.insert(
        "command".to_owned(),
        Value::Array(run.command.iter().map(|c| text(c)).collect()),
    );
    if run.is_simulated() {
        provenance.insert("simulated".to_owned(), Value::Boolean(true));
        provenance.insert("simulated_by".to_owned(), text("the virtual bench"));
    }
    provenance.insert("rig_sha256".to_owned(), text(&run.rig_sha256));
    provenance.insert("plan_sha256".to_owned(), text(&run.plan_sha256));
    root.insert("provenance".to_owned(), Value::Table(provenance));
    for [table, key, value] in added {
        if let Some(table) = root.get_mut(table).and_then(Value::as_table_mut) {
            table.insert(key.clone(), text(value));
        }
    }
    toml::to_string(&root).map_err(|e| AcquisitionError::Recorder(e.to_string()))
}

fn devices(
    run: &RunFile,
    recordings: &[String],
    result: &Reduction,
) -> Result<Table, AcquisitionError> {
    let mut devices = Table::new();
    for (role, identity) in &run.devices {
        let mut table = Table::new();
        let own = [
            ("driver", &identity.driver),
            ("model", &identity.model),
            ("serial", &identity.serial),
            ("firmware", &identity.firmware),
        ];
        let settings = identity.settings.iter().map(|(k, v)| (k.as_str(), v));
        for (key, value) in own.into_iter().chain(settings) {
            table.insert(key.to_owned(), Value::String(value.clone()));
        }
        devices.insert(role.clone(), Value::Table(table));
    }
    let mut stream = Table::new();
    stream.insert("scans".to_owned(), Value::Integer(result.scans as i64));
    stream.insert("lost_scans".to_owned(), Value::Integer(result.lost as i64));
    stream.insert("gaps".to_owned(), Value::Integer(result.gaps as i64));
    stream.insert("late_scans".to_owned(), Value::Integer(result.late as i64));
    stream.insert(
        "longest_delay_s".to_owned(),
        Value::Float(result.longest_delay_s),
    );
    stream.insert(
        "damaged_chunks".to_owned(),
        Value::Integer(result.damaged_chunks as i64),
    );
    stream.insert(
        "warnings".to_owned(),
        Value::Array(result.warnings().into_iter().map(Value::String).collect()),
    );
    stream.insert(
        "recordings".to_owned(),
        Value::Array(recordings.iter().map(|r| r.clone().into()).collect()),
    );
    if result.pairs != [0; 2] {
        let count = |n: u64| Value::Integer(n as i64);
        stream.insert("camera_pairs".to_owned(), count(result.pairs[0]));
        stream.insert("camera_pairs_refused".to_owned(), count(result.pairs[1]));
    }
    stream.insert("clock_scale".to_owned(), Value::Float(run.clock_scale));
    stream.insert(
        "lag_s".to_owned(),
        Value::Array(result.lag_s.iter().map(|s| Value::Float(*s)).collect()),
    );
    stream.insert(
        "clocks".to_owned(),
        Value::Array(result.clocks.iter().map(|f| clock(f, None)).collect()),
    );
    let cameras = result
        .camera_clocks
        .iter()
        .map(|(name, fit)| clock(fit, Some(name)));
    stream.insert("camera_clocks".to_owned(), Value::Array(cameras.collect()));
    devices.insert("stream".to_owned(), Value::Table(stream));
    Ok(devices)
}

/// A clock fit, named where it is one of several.
fn clock(fit: &ClockFit, name: Option<&str>) -> Value {
    let mut table = Table::new();
    if let Some(name) = name {
        table.insert("name".to_owned(), Value::String(name.to_owned()));
    }
    table.insert("device_minus_host_s".to_owned(), Value::Float(fit.offset_s));
    table.insert("drift_ppm".to_owned(), Value::Float(fit.drift * 1e6));
    // A recording of a few seconds does not determine the drift.
    if fit.drift_sd.is_finite() {
        table.insert("drift_sd_ppm".to_owned(), Value::Float(fit.drift_sd * 1e6));
    }
    table.insert("scatter_ms".to_owned(), Value::Float(fit.scatter_s * 1e3));
    Value::Table(table)
}

#[cfg(test)]
mod tests {
    use super::COLUMNS;
    use wcal_session::WHISKER_COLUMNS;

    #[test]
    fn a_recorded_table_has_the_columns_of_a_session_in_their_order() {
        let place = |name: &&str| WHISKER_COLUMNS.iter().position(|known| known == name);
        let (own, last) = COLUMNS.split_at(COLUMNS.len() - 1);
        assert_eq!(last, ["stream"]);
        let places: Vec<Option<usize>> = own.iter().map(&place).collect();
        assert!(
            places.iter().all(Option::is_some) && places.is_sorted(),
            "{places:?}"
        );
        assert_eq!(place(&"shoe_size"), None, "negative control");
    }
}
