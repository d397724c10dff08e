//! `wcal predict`: moments, responses or position errors at new readings.

use crate::output::{check_file, write_file};
use crate::simulated::{is_simulated, mark_table};
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_calibration::{read_calibration, standing};

/// Arguments of `wcal predict`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal predict readings.csv --calibration calibration/calibration.json --out moments.csv

For a whisker TABLE needs fbg_1_nm and fbg_2_nm, or fbg_1_shift_nm and fbg_2_shift_nm; fbg_ref_nm and point are used where present. For a
transducer it needs stimulus (the response follows) or response alone (the stimulus follows); for an axis commanded_mm.
Where the table has the measured value too (response beside stimulus, measured_mm), it is repeated with its residual.
Covariates that an accepted effect needs (t_s, temperature_degc, direction, ...) must be there too.
Exit code 4: readings outside the valid region (written, and marked), or a calibration that expired or failed
verification; --force turns these into warnings.")]
pub struct PredictArgs {
    /// Table of readings
    pub table: PathBuf,
    /// calibration.json of fit-gpr or verify
    #[arg(long, value_name = "FILE")]
    pub calibration: PathBuf,
    /// Table to write
    #[arg(long, value_name = "CSV")]
    pub out: PathBuf,
    /// Exit with 0 although the calibration does not vouch for the result, and write although --out is another file
    #[arg(long)]
    pub force: bool,
    /// Print a summary as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// A table or calibration that cannot be read, or a file that cannot be written.
pub fn run(args: &PredictArgs) -> anyhow::Result<ExitCode> {
    check_file(&args.out, "predict", is_prediction, args.force)?;
    let file = read_calibration(&args.calibration)?;
    let applied = file.model.apply(&args.table)?;
    for warning in &applied.warnings {
        eprintln!("warning: {warning}");
    }
    let simulated = file.provenance.simulated || is_simulated(&args.table);
    // A table from simulated data says so in a column.
    write_file(&args.out, mark_table(&applied.csv, simulated).as_bytes())?;
    let mut doubts: Vec<String> =
        standing(&file, jiff::Timestamp::now())?.iter().map(ToString::to_string).collect();
    let place = args.table.display();
    doubts.extend(applied.outside.map(|o| format!("{place}: {o}; marked in outside_valid_region")));
    for doubt in &doubts {
        eprintln!("{}: {doubt}", if args.force { "warning" } else { "refused" });
    }
    if simulated {
        eprintln!("SIMULATED: the calibration or the readings are not measured");
    }
    if args.json {
        let (rows, name) = (applied.rows, file.model.name());
        let summary = serde_json::json!({
            "format": "wcal-predict/1", "simulated": simulated, "rows": rows, "map": name, "doubts": doubts, "out": args.out,
        });
        println!("{}", serde_json::to_string_pretty(&summary)?);
    }
    Ok(ExitCode::from(if doubts.is_empty() || args.force { 0 } else { 4 }))
}

/// Whether a table with this first line is a result of `predict`.
fn is_prediction(first: &str) -> bool {
    let has = |name: &str| first.split(',').any(|column| column == name);
    // A track has moments and the mark, too, and the time.
    first.starts_with("point,") && has("outside_valid_region") && !has("t_s")
}
<<<<<<< HEAD

/// Through a fitted map.
fn by_map(
    args: &PredictArgs,
    file: &CalibrationFile<CalibrationModel>,
    artefact: &MapArtefact,
) -> anyhow::Result<ExitCode> {
    let mut predictor =
        MapPredictor::new(artefact).with_context(|| args.calibration.display().to_string())?;
    let table = load_table(&args.table, &artefact.fbg)?;
    warn(&table.warnings);
    let mut csv = String::from(
        "point,fbg_1_pm,fbg_2_pm,moment_1_nmm,moment_2_nmm,moment_1_sd_nmm,moment_2_sd_nmm,\
         moment_1_half95_nmm,moment_2_half95_nmm,fbg_1_fitted_pm,fbg_2_fitted_pm,outside_valid_region,outside_by_pm\n",
    );
    let (mut outside, mut first) = (0_usize, None);
    for row in &table.rows {
        let shift_pm = row.compensated_pm(&artefact.fbg);
        let p = predictor.predict(shift_pm);
        if !p.is_valid() {
            outside += 1;
            first.get_or_insert((row.line, p.outside_by_pm));
        }
        let fitted = artefact.law.shift_pm(p.moment_nmm);
        write!(csv, "{},{:.4},{:.4}", row.point, shift_pm[0], shift_pm[1])?;
        for pair in [p.moment_nmm, p.sd_nmm, p.half95_nmm] {
            write!(csv, ",{:.6},{:.6}", pair[0], pair[1])?;
        }
        writeln!(
            csv,
            ",{:.4},{:.4},{},{:.3}",
            fitted[0],
            fitted[1],
            u8::from(!p.is_valid()),
            p.outside_by_pm
        )?;
    }
    write_table(args, file, &csv)?;
    let outside = first.map(|(line, by_pm)| {
        format!(
            "{outside} of {} readings lie outside the valid region, first in line {line} by {by_pm:.1} pm",
            table.rows.len()
        )
    });
    finish(args, file, &artefact.name, table.rows.len(), outside)
}

/// Through the sensitivity and the accepted effects; memory effects run over the table's own history.
fn by_model(
    args: &PredictArgs,
    file: &CalibrationFile<CalibrationModel>,
    model: &PhysicalModel,
) -> anyhow::Result<ExitCode> {
    let rows = moments_of_model(&args.table, model)?;
    let mut csv = String::from(
        "point,fbg_1_pm,fbg_2_pm,moment_1_nmm,moment_2_nmm,moment_1_sd_nmm,moment_2_sd_nmm,outside_valid_region\n",
    );
    for r in &rows {
        writeln!(
            csv,
            "{},{:.4},{:.4},{:.6},{:.6},{:.6},{:.6},{}",
            r.point,
            r.shift_pm[0],
            r.shift_pm[1],
            r.moment_nmm[0],
            r.moment_nmm[1],
            r.sd_nmm[0],
            r.sd_nmm[1],
            u8::from(!r.valid)
        )?;
    }
    let outside = rows.iter().filter(|r| !r.valid).count();
    write_table(args, file, &csv)?;
    let doubt = (outside > 0).then(|| {
        format!("{outside} of {} readings ask for moments beyond those that were fitted", rows.len())
    });
    finish(args, file, "physical", rows.len(), doubt)
}

/// Moments of one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moments {
    /// Number of the reading.
    pub point: i64,
    /// Its line in the table.
    pub line: usize,
    /// Whether the strain-isolated grating was read.
    pub reference: bool,
    /// Time, s, where the table has it.
    pub t_s: Option<f64>,
    /// Shifts, pm.
    pub shift_pm: [f64; 2],
    /// Moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Their standard deviations, N mm.
    pub sd_nmm: [f64; 2],
    /// Whether the calibration vouches for them.
    pub valid: bool,
}

/// Moments of a table's readings through a fitted map.
///
/// # Errors
/// Where the table or the map cannot be used.
pub fn moments_of_map(path: &Path, artefact: &MapArtefact) -> anyhow::Result<Vec<Moments>> {
    let mut predictor = MapPredictor::new(artefact)?;
    let table = load_table(path, &artefact.fbg)?;
    warn(&table.warnings);
    let one = |row: &wcal_core::WhiskerRow| {
        let shift_pm = row.compensated_pm(&artefact.fbg);
        let p = predictor.predict(shift_pm);
        let (moment_nmm, sd_nmm, valid) = (p.moment_nmm, p.sd_nmm, p.is_valid());
        Moments {
            point: row.point,
            line: row.line,
            reference: row.reference_shift_pm.is_some(),
            t_s: row.t_s,
            shift_pm,
            moment_nmm,
            sd_nmm,
            valid,
        }
    };
    Ok(table.rows.iter().map(one).collect())
}

/// Moments of a table's readings through the sensitivity and the accepted effects.
///
/// # Errors
/// Where the table cannot be used, or lacks a column that an accepted effect needs.
pub fn moments_of_model(path: &Path, model: &PhysicalModel) -> anyhow::Result<Vec<Moments>> {
    let table = load_table(path, &model.fbg)?;
    warn(&table.warnings);
    // New readings belong to the last seating that the calibration saw.
    let last = model.seatings.saturating_sub(1);
    let table_rows: Vec<_> =
        table.rows.iter().map(|r| wcal_core::WhiskerRow { seating: last, ..r.clone() }).collect();
    let rows: Vec<_> = table_rows.iter().collect();
    let history = WhiskerPath::new(&rows, &[], &wcal_core::MomentAxes::default(), &model.fbg, None, None);
    if let Some((id, column)) = model.missing_column(&history) {
        bail!("{}: the calibration carries {id}: expected {column} in every row, found none", path.display());
    }
    let inferred = model.infer(&history, None);
    let mut order: Vec<usize> = (0..rows.len()).collect();
    order.sort_by_key(|&i| history.rows[i]);
    let one = |i: usize| {
        let (row, m) = (rows[history.rows[i]], &inferred[i]);
        let shift_pm = history.readings[i].shift_pm;
        Moments {
            point: row.point,
            line: row.line,
            reference: row.reference_shift_pm.is_some(),
            t_s: row.t_s,
            shift_pm,
            moment_nmm: m.moment_nmm,
            sd_nmm: m.sd_nmm,
            valid: m.valid,
        }
    };
    Ok(order.into_iter().map(one).collect())
}

fn warn(warnings: &[String]) {
    for warning in warnings {
        eprintln!("warning: {warning}");
    }
}

/// Whether the calibration or the readings are simulated.
fn simulated(args: &PredictArgs, file: &CalibrationFile<CalibrationModel>) -> bool {
    file.provenance.simulated || is_simulated(&args.table)
}

/// Writes the table; one from simulated data says so in a column.
fn write_table(
    args: &PredictArgs,
    file: &CalibrationFile<CalibrationModel>,
    csv: &str,
) -> anyhow::Result<()> {
    write_file(&args.out, mark_table(csv, simulated(args, file)).as_bytes())
}

/// Says what speaks against the result and picks the exit code.
fn finish(
    args: &PredictArgs,
    file: &CalibrationFile<CalibrationModel>,
    name: &str,
    rows: usize,
    outside: Option<String>,
) -> anyhow::Result<ExitCode> {
    let mut doubts = standing(file, jiff::Timestamp::now())?;
    doubts.extend(outside.map(|o| format!("{}: {o}; marked in outside_valid_region", args.table.display())));
    for doubt in &doubts {
        eprintln!("{}: {doubt}", if args.force { "warning" } else { "refused" });
    }
    let simulated = simulated(args, file);
    if simulated {
        eprintln!("SIMULATED: the calibration or the readings are not measured");
    }
    if args.json {
        let summary = serde_json::json!({
            "format": "wcal-predict/1", "simulated": simulated, "rows": rows, "map": name, "doubts": doubts, "out": args.out,
        });
        println!("{}", serde_json::to_string_pretty(&summary)?);
    }
    Ok(ExitCode::from(if doubts.is_empty() || args.force { 0 } else { 4 }))
}
=======
>>>>>>> main
