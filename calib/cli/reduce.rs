//! `wcal reduce`: rebuilds the tables of a session from its recordings.

use anyhow::Result;
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
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
pub(crate) struct ReduceArgs {
    /// Session folder with rig.toml, run.json and recording.mcap
    pub session: PathBuf,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Tables rebuilt from raw streams.
#[derive(Serialize, JsonSchema)]
pub(crate) struct ReductionDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-reduction/1"))]
    format: &'static str,
    /// Rows.
    rows: usize,
    /// Holdout rows.
    holdout: usize,
    /// Scans.
    scans: u64,
    /// Scans lost.
    lost_scans: u64,
    /// Gaps.
    gaps: u64,
    /// Scans marked as outliers.
    outliers: usize,
    /// Scans that came late.
    late_scans: u64,
    /// Longest delay, s.
    longest_delay_s: f64,
    /// Rows whose window met lost scans.
    rows_lost: usize,
    /// Rows whose window met late scans.
    rows_late: usize,
    /// Windows with fewer than two scans that count, or without an answer of the stage.
    empty_windows: usize,
    /// Damaged chunks.
    damaged_chunks: u64,
    /// Recordings cut off.
    cut_off: usize,
    /// Delay between stage and stream at each sync move, s.
    lag_s: &'a [f64],
    /// Remarks.
    warnings: Vec<String>,
    /// Pairs of pictures.
    camera_pairs: u64,
    /// Pairs refused.
    camera_pairs_refused: u64,
    /// The interrogator's clock, a recording each.
    clocks: Vec<ClockDocument<'a>>,
    /// The cameras' clocks.
    camera_clocks: Vec<ClockDocument<'a>>,
}

/// A device's clock beside the host's.
#[derive(Serialize, JsonSchema)]
struct ClockDocument<'a> {
    /// Camera; null: the interrogator.
    name: Option<&'a str>,
    /// Offset, s.
    device_minus_host_s: f64,
    /// Drift, parts per million.
    drift_ppm: f64,
    /// Its standard deviation; null where it is not known.
    drift_sd_ppm: Option<f64>,
    /// Scatter, ms.
    scatter_ms: f64,
}

/// Reduces and reports; exit code 3 when something was lost.
///
/// # Errors
/// When the session cannot be read or written.
pub(crate) fn run(arguments: &ReduceArgs) -> Result<ExitCode> {
    let result = reduce(&arguments.session)?;
    report(&result, arguments.json)?;
    let warnings = result.warnings();
    for warning in &warnings {
        eprintln!("reduce: warning: {warning}");
    }
    Ok(crate::printing::exit_code(warnings.is_empty()))
}

/// One line for people on stderr, or a JSON document on stdout.
pub(crate) fn report(result: &Reduction, as_json: bool) -> Result<()> {
    if as_json {
        let document = ReductionDocument {
            format: "wcal-reduction/1",
            rows: result.rows,
            holdout: result.holdout,
            scans: result.scans,
            lost_scans: result.lost,
            gaps: result.gaps,
            outliers: result.outliers,
            late_scans: result.late,
            longest_delay_s: result.longest_delay_s,
            rows_lost: result.marked[0],
            rows_late: result.marked[1],
            empty_windows: result.empty_windows,
            damaged_chunks: result.damaged_chunks,
            cut_off: result.cut_off,
            lag_s: &result.lag_s,
            warnings: result.warnings(),
            camera_pairs: result.pairs[0],
            camera_pairs_refused: result.pairs[1],
            clocks: result.clocks.iter().map(|c| clock(c, None)).collect(),
            camera_clocks: result
                .camera_clocks
                .iter()
                .map(|(name, c)| clock(c, Some(name)))
                .collect(),
        };
        println!("{}", serde_json::to_string(&document)?);
        return Ok(());
    }
    eprintln!(
        "{} rows, {} holdout rows from {} scans ({} lost, {} marked, {} recordings cut off)",
        result.rows, result.holdout, result.scans, result.lost, result.outliers, result.cut_off
    );
    if result.repeated > 0 {
        eprintln!(
            "{} messages stand in a recording more than once; each counts once",
            result.repeated
        );
    }
    Ok(())
}

fn clock<'a>(fit: &ClockFit, name: Option<&'a str>) -> ClockDocument<'a> {
    // JSON has no infinity: a standard deviation that is not known becomes null.
    ClockDocument {
        name,
        device_minus_host_s: fit.offset_s,
        drift_ppm: fit.drift * 1e6,
        drift_sd_ppm: fit.drift_sd.is_finite().then_some(fit.drift_sd * 1e6),
        scatter_ms: fit.scatter_s * 1e3,
    }
}
