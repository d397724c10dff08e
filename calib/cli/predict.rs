//! `wcal predict`: moments at new readings.

use anyhow::{Context, bail};
use clap::Args;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::calibration::CALIBRATION_FORMAT;
use wcal_core::{CalibrationFile, VerificationStatus};
use wcal_map::{CalibrationModel, MapArtefact, MapPredictor};
use wcal_session::{load_table, write_atomic};

/// Arguments of `wcal predict`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal predict readings.csv --calibration calibration/calibration.json --out moments.csv

TABLE needs fbg_1_nm and fbg_2_nm, or fbg_1_shift_nm and fbg_2_shift_nm; fbg_ref_nm and point are used where present.
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
    /// Exit with 0 although the calibration does not vouch for the result
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
    let (file, artefact) = read_calibration(&args.calibration)?;
    let mut predictor = MapPredictor::new(&artefact).with_context(|| args.calibration.display().to_string())?;
    let table = load_table(&args.table, &artefact.fbg)?;
    for warning in &table.warnings {
        eprintln!("warning: {warning}");
    }
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
        writeln!(csv, ",{:.4},{:.4},{},{:.3}", fitted[0], fitted[1], u8::from(!p.is_valid()), p.outside_by_pm)?;
    }
    write_atomic(&args.out, csv.as_bytes())?;
    let mut doubts = standing(&file, jiff::Timestamp::now())?;
    if let Some((line, by_pm)) = first {
        doubts.push(format!(
            "{}: {outside} of {} readings lie outside the valid region, first in line {line} by {by_pm:.1} pm; marked in \
             outside_valid_region",
            args.table.display(),
            table.rows.len()
        ));
    }
    for doubt in &doubts {
        eprintln!("{}: {doubt}", if args.force { "warning" } else { "refused" });
    }
    if args.json {
        let summary = serde_json::json!({
            "format": "wcal-predict/1", "rows": table.rows.len(), "outside_valid_region": outside,
            "map": artefact.name, "doubts": doubts, "out": args.out, "inputs": [table.input],
        });
        println!("{}", serde_json::to_string_pretty(&summary)?);
    }
    Ok(ExitCode::from(if doubts.is_empty() || args.force { 0 } else { 4 }))
}

/// Reads the file and checks format and content hash.
fn read_calibration(path: &Path) -> anyhow::Result<(CalibrationFile<CalibrationModel>, MapArtefact)> {
    let name = path.display();
    let bytes = std::fs::read(path).with_context(|| format!("reading {name}"))?;
    let raw: CalibrationFile<serde_json::Value> =
        serde_json::from_slice(&bytes).with_context(|| format!("{name}: expected a calibration in JSON"))?;
    if raw.format != CALIBRATION_FORMAT {
        bail!("{name}: field `format`: expected {CALIBRATION_FORMAT:?}, found {:?}", raw.format);
    }
    let found = raw.compute_hash()?;
    if found != raw.content_sha256 {
        bail!("{name}: field `content_sha256`: expected {found}, found {}: the file was changed", raw.content_sha256);
    }
    let file: CalibrationFile<CalibrationModel> =
        serde_json::from_slice(&bytes).with_context(|| format!("{name}: expected a model of kind \"map\""))?;
    let CalibrationModel::Map(artefact) = file.model.clone();
    Ok((file, artefact))
}

/// What speaks against using the calibration now.
fn standing(file: &CalibrationFile<CalibrationModel>, now: jiff::Timestamp) -> anyhow::Result<Vec<String>> {
    let mut doubts = Vec::new();
    if let Some(expires) = &file.expires {
        let until: jiff::Timestamp = expires
            .parse()
            .with_context(|| format!("calibration: field `expires`: expected an RFC 3339 time, found {expires:?}"))?;
        if now > until {
            doubts.push(format!("the calibration expired at {expires}"));
        }
    }
    if file.verification == VerificationStatus::Failed {
        doubts.push("the calibration failed its verification".to_owned());
    }
    Ok(doubts)
}
