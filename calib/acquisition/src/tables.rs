//! Text of the reduced tables and of `session.toml`.

use crate::clocks::ClockFit;
use crate::error::AcquisitionError;
use crate::reduction::Reduction;
use crate::rig::{Rig, TrajectoryRig};
use crate::run_file::RunFile;
use crate::windows::WindowMean;
use nalgebra::Vector3;
use serde_json::{Value, json};
use wcal_core::FbgSpec;
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
pub(crate) enum Stream {
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
    fn word(self) -> &'static str {
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
pub(crate) struct Row {
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
    let failed = |e: &dyn std::error::Error| AcquisitionError::Recorder(e.to_string());
    let mut writer = csv::Writer::from_writer(Vec::new());
    write(&mut writer).map_err(|e| failed(&e))?;
    writer.into_inner().map_err(|e| failed(&e))
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
) -> Result<Vec<(&'static str, Vec<u8>)>, AcquisitionError> {
    let (holdout, points): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|r| r.sealed);
    let both = [("points.csv", points), ("holdout.csv", holdout)];
    let mut files = Vec::new();
    for (file, rows) in &both {
        // A session needs points.csv, even where every row is held out.
        if !rows.is_empty() || *file == "points.csv" {
            files.push((*file, rows_csv(rows, simulated)?));
        }
    }
    let mut numbered: Vec<(&str, usize, &Row)> = Vec::new();
    for (file, rows) in &both {
        numbered.extend(rows.iter().enumerate().map(|(k, row)| (*file, k, *row)));
    }
    let compensation = csv_text(|out| {
        out.write_record(COMPENSATION)?;
        numbered.iter().try_for_each(|(file, k, row)| {
            out.write_record(compensation_fields(rig, file, *k, row))
        })
    })?;
    files.push(("compensation.csv", compensation));
    let outliers = csv_text(|out| {
        out.write_record(["file", "point", "scan"])?;
        for (file, k, row) in &numbered {
            for serial in &row.serials {
                out.write_record([*file, &k.to_string(), &serial.to_string()])?;
            }
        }
        Ok(())
    })?;
    files.push(("outliers.csv", outliers));
    Ok(files)
}

fn rows_csv(rows: &[&Row], simulated: bool) -> Result<Vec<u8>, AcquisitionError> {
    csv_text(|out| {
        let mark = simulated.then_some(SIMULATED_COLUMN);
        out.write_record(COLUMNS.into_iter().chain(mark))?;
        for (k, row) in rows.iter().enumerate() {
            // Digits beyond the devices' resolution (0.05 um, 1 pm): rounding adds no noise.
            let digits = |value: Option<f64>, digits: usize| {
                value.map_or(String::new(), |v| format!("{v:.digits$}"))
            };
            let groove = |axis: usize| digits(row.groove_mm.map(|g| g[axis]), 6);
            let [first_nm, second_nm] = row.mean.sensing_nm;
            let [first_sd_pm, second_sd_pm] = row.mean.sensing_sd_pm;
            let fields = [
                k.to_string(),
                row.role.clone(),
                row.trajectory.to_string(),
                row.replicate.to_string(),
                digits(Some(row.t_s), 4),
                digits(Some(row.stage_mm), 6),
                row.direction.to_string(),
                digits(Some(row.speed_mm_s), 4),
                digits(Some(row.dwell_s), 4),
                groove(0),
                groove(1),
                groove(2),
                // A rig has no thermometer: the reference grating tells of temperature.
                String::new(),
                digits(row.mean.reference_nm, 7),
                digits(Some(first_nm), 7),
                digits(Some(second_nm), 7),
                digits(Some(first_sd_pm), 4),
                digits(Some(second_sd_pm), 4),
                row.mean.samples.to_string(),
                digits(row.average_s, 4),
                row.stream.word().to_owned(),
            ];
            let mark = simulated.then(|| "1".to_owned());
            out.write_record(fields.into_iter().chain(mark))?;
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
        let of_reference = ratios[k] * row.mean.reference_sd_pm;
        let variance = row.mean.sensing_sd_pm[k].powi(2) + of_reference.powi(2);
        let sd = (variance / n).sqrt();
        fields.extend([format!("{shift:.4}"), format!("{sd:.4}")]);
    }
    fields.extend([row.settled.to_string(), row.unusable.to_string()]);
    fields
}

/// Shift of each sensing grating per shift of the reference, from the rig's temperature
/// coefficients; 0 without them.
pub(crate) fn temperature_ratio(rig: &Rig) -> [f64; 2] {
    let fbg: FbgSpec = rig.fbg.clone().try_into().unwrap_or_default();
    let reference = fbg.reference_temperature_pm_per_degc;
    match (reference, fbg.temperature_pm_per_degc) {
        (Some(r), Some(own)) if r != 0.0 && rig.grating("fbg_ref").is_some() => own.map(|k| k / r),
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
pub(crate) fn session_toml(
    rig: &Rig,
    run: &RunFile,
    recordings: &[String],
    result: &Reduction,
    added: &[[String; 3]],
) -> Result<String, AcquisitionError> {
    let nominal = |name: &str| rig.grating(name).map(|g| g.nominal_nm);
    let trajectory = |t: &TrajectoryRig| {
        json!({
            "id": t.id,
            "origin_mm": t.origin_mm,
            "direction": Vector3::from(t.direction).normalize().as_slice(),
            "nominal_arclength_mm": t.nominal_arclength_mm,
        })
    };
    let simulated = run.is_simulated();
    let mut session = json!({
        "format": "wcal-session/1",
        "id": run.id,
        "kind": "whisker",
        "medium": run.medium,
        "created": run.created,
        "files": {
            "points": "points.csv",
            "recording": recordings[0],
            "holdout": (result.holdout > 0).then_some("holdout.csv"),
            "pictures": (result.pictures[0] > 0).then_some("pictures/"),
        },
        "whisker": rig.whisker,
        "moments": rig.moments,
        "fbg": rig.fbg,
        "trajectory": rig.trajectory.iter().map(trajectory).collect::<Vec<_>>(),
        "devices": run.devices,
        "provenance": {
            "program": run.program,
            "command": run.command,
            "rig_sha256": run.rig_sha256,
            "plan_sha256": run.plan_sha256,
            "simulated": simulated.then_some(true),
            "simulated_by": simulated.then_some("the virtual bench"),
        },
    });
    // A rig states nominal wavelengths with its gratings, a session under `[fbg]`.
    session["fbg"]["nominal_nm"] = json!([nominal("fbg_1"), nominal("fbg_2")]);
    session["fbg"]["reference_nominal_nm"] = json!(nominal("fbg_ref"));
    for (role, identity) in &run.devices {
        let device = &mut session["devices"][role];
        for (key, value) in &identity.settings {
            device[key] = json!(value);
        }
        device["settings"] = Value::Null;
    }
    session["devices"]["stream"] = stream(run, recordings, result);
    for [table, key, value] in added {
        if session[table].is_object() {
            session[table][key] = json!(value);
        }
    }
    prune(&mut session);
    // In the order of a table of TOML.
    toml::Table::try_from(&session)
        .and_then(|session| toml::to_string(&session))
        .map_err(|e| AcquisitionError::Recorder(e.to_string()))
}

/// TOML has no null: what is not there has no entry.
fn prune(value: &mut Value) {
    match value {
        Value::Object(entries) => {
            entries.retain(|_, value| !value.is_null());
            entries.values_mut().for_each(prune);
        }
        Value::Array(entries) => {
            entries.retain(|value| !value.is_null());
            entries.iter_mut().for_each(prune);
        }
        _ => {}
    }
}

fn stream(run: &RunFile, recordings: &[String], result: &Reduction) -> Value {
    let of_interrogator = result.clocks.iter().map(|fit| clock(fit, None));
    let cameras = result.camera_clocks.iter();
    let of_cameras = cameras.map(|(name, fit)| clock(fit, Some(name)));
    let pairs = (result.pairs != [0; 2]).then_some(result.pairs);
    json!({
        "scans": result.scans,
        "lost_scans": result.lost,
        "gaps": result.gaps,
        "late_scans": result.late,
        "longest_delay_s": result.longest_delay_s,
        "damaged_chunks": result.damaged_chunks,
        "warnings": result.warnings(),
        "recordings": recordings,
        "clock_scale": run.clock_scale,
        "lag_s": result.lag_s,
        "clocks": of_interrogator.collect::<Vec<_>>(),
        "camera_clocks": of_cameras.collect::<Vec<_>>(),
        "camera_pairs": pairs.map(|pairs| pairs[0]),
        "camera_pairs_refused": pairs.map(|pairs| pairs[1]),
    })
}

/// A clock fit, named where it is one of several.
fn clock(fit: &ClockFit, name: Option<&str>) -> Value {
    json!({
        "device_minus_host_s": fit.offset_s,
        "drift_ppm": fit.drift * 1e6,
        "scatter_ms": fit.scatter_s * 1e3,
        // A recording of a few seconds does not determine the drift: infinite, that is null.
        "drift_sd_ppm": fit.drift_sd * 1e6,
        "name": name,
    })
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
