//! `wcal reduce`: rebuilds the tables of a session from its recordings.

use anyhow::Result;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_acquisition::clocks::ClockFit;
use wcal_acquisition::reduce::{Reduction, reduce};

/// Arguments of `wcal reduce`.
#[derive(Debug, Args)]
#[command(
    after_help = "Exit code 0: good; 1: cannot be reduced, the tables stay as they are; 3: reduced, with scans lost, a recording cut off or another
warning."
)]
pub struct ReduceArgs {
    /// Session folder with rig.toml, run.json and recording.mcap
    pub session: PathBuf,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Reduces and reports; exit code 3 when something was lost.
///
/// # Errors
/// When the session cannot be read or written.
pub fn run(arguments: &ReduceArgs) -> Result<ExitCode> {
    let result = reduce(&arguments.session)?;
    report(&result, arguments.json)?;
    let warnings = result.warnings();
    for warning in &warnings {
        eprintln!("reduce: warning: {warning}");
    }
    Ok(ExitCode::from(if warnings.is_empty() { 0 } else { 3 }))
}

/// One line for people on stderr, or a JSON document on stdout.
pub(crate) fn report(result: &Reduction, as_json: bool) -> Result<()> {
    if as_json {
        let document = json!({
            "format": "wcal-reduction/1", "rows": result.rows, "holdout": result.holdout,
            "scans": result.scans, "lost_scans": result.lost, "gaps": result.gaps, "outliers": result.outliers,
            "late_scans": result.late, "longest_delay_s": result.longest_delay_s, "rows_lost": result.marked[0],
            "rows_late": result.marked[1], "empty_windows": result.empty_windows, "damaged_chunks": result.damaged_chunks,
            "cut_off": result.cut_off, "lag_s": result.lag_s, "warnings": result.warnings(),
            "camera_pairs": result.pairs[0], "camera_pairs_refused": result.pairs[1],
            "clocks": result.clocks.iter().map(|c| clock(c, None)).collect::<Vec<_>>(),
            "camera_clocks":
                result.camera_clocks.iter().map(|(name, c)| clock(c, Some(name))).collect::<Vec<_>>(),
        });
        println!("{document}");
        return Ok(());
    }
    eprintln!(
        "{} rows, {} holdout rows from {} scans ({} lost, {} marked, {} recordings cut off)",
        result.rows, result.holdout, result.scans, result.lost, result.outliers, result.cut_off
    );
    Ok(())
}

fn clock(fit: &ClockFit, name: Option<&str>) -> serde_json::Value {
    json!({
        "name": name, "device_minus_host_s": fit.offset_s, "drift_ppm": fit.drift * 1e6,
        "drift_sd_ppm": fit.drift_sd.is_finite().then_some(fit.drift_sd * 1e6), "scatter_ms": fit.scatter_s * 1e3
    })
}
