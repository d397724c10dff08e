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
    /// Scans came late (the bench or the recording computer had fallen behind), or the clocks
    /// cannot be aligned: where the stage was is not known.
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

/// Files of the tables: points.csv, holdout.csv where there are such rows, compensation.csv,
/// outliers.csv. Simulated readings are marked in a last column.
///
/// # Errors
/// Practically none: text is written to memory.
pub(crate) fn write_tables(
    rig: &Rig,
    rows: &[Row],
    simulated: bool,
) -> Result<Vec<(String, Vec<u8>)>, AcquisitionError> {
    let (holdout, points): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|r| r.sealed);
    let mut files = vec![("points.csv".to_owned(), rows_csv(&points, simulated)?)];
    if !holdout.is_empty() {
        files.push(("holdout.csv".to_owned(), rows_csv(&holdout, simulated)?));
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

fn rows_csv(rows: &[&Row], simulated: bool) -> Result<Vec<u8>, AcquisitionError> {
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

/// Shift of each sensing grating per shift of the reference, from the rig's temperature
/// coefficients; 0 without them.
pub(crate) fn temperature_ratio(rig: &Rig) -> [f64; 2] {
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
pub(crate) const ADDED_LATER: [[&str; 2]; 4] = [
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
    let there = [
        (holdout, "holdout", "holdout.csv"),
        (result.pictures[0] > 0, "pictures", "pictures/"),
    ];
    let there = there
        .into_iter()
        .filter(|entry| entry.0)
        .map(|(_, key, file)| (key, file.into()));
    let files = [
        ("points", "points.csv".into()),
        ("recording", recordings[0].clone().into()),
    ];
    let nominal = |name: &str| rig.grating(name).map(|g| g.nominal_nm);
    let nominal_nm: Vec<f64> = ["fbg_1", "fbg_2"].into_iter().filter_map(nominal).collect();
    let reference = nominal("fbg_ref").map(|nm| ("reference_nominal_nm", nm.into()));
    let mut fbg = rig.fbg.clone();
    fbg.extend(table(
        [("nominal_nm", nominal_nm.into())]
            .into_iter()
            .chain(reference),
    ));
    let trajectories = rig.trajectory.iter().map(|t| {
        let unit = Vector3::from(t.direction).normalize();
        let entries = [
            ("id", t.id.into()),
            ("origin_mm", t.origin_mm.to_vec().into()),
            ("direction", unit.as_slice().to_vec().into()),
        ];
        let nominal = t
            .nominal_arclength_mm
            .map(|s| ("nominal_arclength_mm", s.into()));
        table(entries.into_iter().chain(nominal))
    });
    let simulated = [
        ("simulated", true.into()),
        ("simulated_by", "the virtual bench".into()),
    ];
    let provenance = [
        ("program", run.program.clone().into()),
        ("command", run.command.clone().into()),
        ("rig_sha256", run.rig_sha256.clone().into()),
        ("plan_sha256", run.plan_sha256.clone().into()),
    ];
    let provenance = provenance
        .into_iter()
        .chain(simulated.into_iter().filter(|_| run.is_simulated()));
    let entries = [
        ("format", "wcal-session/1".into()),
        ("id", run.id.clone().into()),
        ("kind", "whisker".into()),
        ("medium", run.medium.clone().into()),
        ("created", run.created.clone().into()),
        ("files", table(files.into_iter().chain(there)).into()),
        ("whisker", rig.whisker.clone().into()),
        ("fbg", fbg.into()),
        ("trajectory", trajectories.collect::<Vec<_>>().into()),
        ("devices", devices(run, recordings, result).into()),
        ("provenance", table(provenance).into()),
    ];
    let mut root = table(
        entries
            .into_iter()
            .chain(rig.moments.clone().map(|m| ("moments", m.into()))),
    );
    for [table, key, value] in added {
        if let Some(table) = root.get_mut(table).and_then(Value::as_table_mut) {
            table.insert(key.clone(), value.clone().into());
        }
    }
    toml::to_string(&root).map_err(|e| AcquisitionError::Recorder(e.to_string()))
}

fn table<'a>(entries: impl IntoIterator<Item = (&'a str, Value)>) -> Table {
    entries
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}

fn devices(run: &RunFile, recordings: &[String], result: &Reduction) -> Table {
    let mut devices = Table::new();
    for (role, identity) in &run.devices {
        let own = [
            ("driver", &identity.driver),
            ("model", &identity.model),
            ("serial", &identity.serial),
            ("firmware", &identity.firmware),
        ];
        let settings = identity.settings.iter().map(|(k, v)| (k.as_str(), v));
        let all = own
            .into_iter()
            .chain(settings)
            .map(|(key, value)| (key, value.clone().into()));
        devices.insert(role.clone(), table(all).into());
    }
    let count = |n: u64| Value::Integer(n as i64);
    let pairs = [("camera_pairs", 0), ("camera_pairs_refused", 1)];
    let pairs = pairs.into_iter().filter(|_| result.pairs != [0; 2]);
    let cameras = result
        .camera_clocks
        .iter()
        .map(|(name, fit)| clock(fit, Some(name)));
    let stream = [
        ("scans", count(result.scans)),
        ("lost_scans", count(result.lost)),
        ("gaps", count(result.gaps)),
        ("late_scans", count(result.late)),
        ("longest_delay_s", result.longest_delay_s.into()),
        ("damaged_chunks", count(result.damaged_chunks)),
        ("warnings", result.warnings().into()),
        ("recordings", recordings.to_vec().into()),
        ("clock_scale", run.clock_scale.into()),
        ("lag_s", result.lag_s.clone().into()),
        (
            "clocks",
            result
                .clocks
                .iter()
                .map(|fit| clock(fit, None))
                .collect::<Vec<_>>()
                .into(),
        ),
        ("camera_clocks", cameras.collect::<Vec<_>>().into()),
    ];
    let pairs = pairs.map(|(key, k)| (key, count(result.pairs[k])));
    devices.insert(
        "stream".to_owned(),
        table(stream.into_iter().chain(pairs)).into(),
    );
    devices
}

/// A clock fit, named where it is one of several.
fn clock(fit: &ClockFit, name: Option<&str>) -> Table {
    let entries = [
        ("device_minus_host_s", fit.offset_s.into()),
        ("drift_ppm", (fit.drift * 1e6).into()),
        ("scatter_ms", (fit.scatter_s * 1e3).into()),
    ];
    // A recording of a few seconds does not determine the drift.
    let sd = fit
        .drift_sd
        .is_finite()
        .then(|| ("drift_sd_ppm", (fit.drift_sd * 1e6).into()));
    table(
        entries
            .into_iter()
            .chain(sd)
            .chain(name.map(|name| ("name", name.into()))),
    )
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
