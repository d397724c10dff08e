//! `wcal predict`: moments, responses or position errors at new readings.

use crate::output::{check_file, write_file};
use crate::picture_output::provenance;
use crate::simulated::{is_simulated, mark_table};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_calibration::{read_calibration, trust_issues};
use wcal_core::VerificationStatus;
use wcal_session::{SessionLedger, WarningKind};

/// Arguments of `wcal predict`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal predict readings.csv --calibration calibration/calibration.json --out moments.csv

For a whisker TABLE needs fbg_1_nm and fbg_2_nm, or fbg_1_shift_nm and fbg_2_shift_nm; fbg_ref_nm and point are used where present. For a
transducer it needs stimulus (the response follows) or response alone (the stimulus follows); for an axis commanded_mm.
An effect with memory (hysteresis, creep) follows the times or directions of the readings; without them half95 holds half the loop.
Where the table has the measured value too (response beside stimulus, measured_mm), it is repeated with its residual.
A table that a session beside it keeps sealed is recorded as opened (unsealed.json).
Covariates that an accepted effect needs (t_s, temperature_degc, direction, ...) must be there too.
Exit code 4: readings outside the valid region (written, and marked), or a calibration that expired or failed
verification; --force turns these into warnings.")]
pub(crate) struct PredictArgs {
    /// Table of readings
    pub table: PathBuf,
    /// calibration.json of fit-gpr or verify
    #[arg(long, value_name = "FILE")]
    pub calibration: PathBuf,
    /// Table to write [default: on stdout]
    #[arg(long, value_name = "CSV")]
    pub out: Option<PathBuf>,
    /// Exit with 0 although the calibration does not vouch for the result, and write although --out
    /// is another file
    #[arg(long)]
    pub force: bool,
    /// Print a summary as JSON on stdout
    #[arg(long, requires = "out")]
    pub json: bool,
}

/// Whoever sees a sealed table has seen it: written down before anything of it is given.
///
/// # Errors
/// Where that cannot be written.
pub(crate) fn record_if_sealed(table: &Path, out: &Path) -> anyhow::Result<()> {
    if SessionLedger::of_table(table, out, &provenance([table]))? {
        let table = table.display();
        eprintln!("warning: {table} is sealed; that it was opened is recorded in unsealed.json");
    }
    Ok(())
}

/// Runs the command.
///
/// # Errors
/// A table or calibration that cannot be read, or a file that cannot be written.
pub(crate) fn run(args: &PredictArgs) -> anyhow::Result<ExitCode> {
    if let Some(out) = &args.out {
        check_file(out, "predict", is_prediction, args.force)?;
    }
    let file = read_calibration(&args.calibration)?;
    let applied = file.model.apply(&args.table)?;
    // What follows from a grating that does not change means nothing: a doubt, not a warning.
    let (stuck, odd): (Vec<_>, Vec<_>) = applied
        .warnings
        .iter()
        .partition(|w| w.kind == WarningKind::Stuck);
    for warning in odd {
        eprintln!("warning: {warning}");
    }
    for remark in &applied.remarks {
        eprintln!("note: {remark}");
    }
    // Where the session cannot be written to, the record lies beside the result.
    let beside = args.out.as_deref().unwrap_or(&args.table);
    record_if_sealed(&args.table, beside)?;
    if file.verification == VerificationStatus::Reverified {
        eprintln!(
            "note: the calibration was verified on sealed readings that another decision had met before"
        );
    }
    let simulated = file.provenance.simulated || is_simulated(&args.table);
    // A table from simulated data says so in a column.
    let table = mark_table(&applied.csv, simulated);
    match &args.out {
        Some(out) => write_file(out, table.as_bytes())?,
        None => print!("{table}"),
    }
    let mut doubts: Vec<String> = trust_issues(&file, jiff::Timestamp::now())?
        .iter()
        .map(ToString::to_string)
        .collect();
    let place = args.table.display();
    doubts.extend(stuck.iter().map(ToString::to_string));
    doubts.extend(
        applied
            .outside
            .map(|o| format!("{place}: {o}; marked in outside_valid_region")),
    );
    for doubt in &doubts {
        eprintln!(
            "{}: {doubt}",
            if args.force {
                "warning"
            } else {
                "written, but not to be trusted"
            }
        );
    }
    if simulated {
        eprintln!("SIMULATED: the calibration or the readings are not measured");
    }
    match &args.out {
        Some(out) if args.json => {
            let summary = PredictionDocument {
                format: "wcal-predict/1",
                simulated,
                rows: applied.rows,
                map: file.model.name(),
                doubts: &doubts,
                out,
            };
            println!("{}", serde_json::to_string_pretty(&summary)?);
        }
        Some(out) if doubts.is_empty() => eprintln!("{} rows: {}", applied.rows, out.display()),
        _ => {}
    }
    Ok(ExitCode::from(if doubts.is_empty() || args.force {
        0
    } else {
        4
    }))
}

/// Summary of a prediction.
#[derive(Serialize, JsonSchema)]
pub(crate) struct PredictionDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-predict/1"))]
    format: &'static str,
    /// The calibration or the readings are not measured.
    simulated: bool,
    /// Rows.
    rows: usize,
    /// Model that was applied.
    map: &'a str,
    /// What speaks against trusting it.
    doubts: &'a [String],
    /// The table.
    out: &'a Path,
}

/// Whether a table with this first line is a result of `predict`.
fn is_prediction(first: &str) -> bool {
    let has = |name: &str| first.split(',').any(|column| column == name);
    // A track has moments and the mark, too, and the time.
    first.starts_with("point,") && has("outside_valid_region") && !has("t_s")
}
