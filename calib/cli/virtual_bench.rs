//! `wcal virtual-bench`: serves the simulated devices until its input closes.

use anyhow::{Context, Result};
use clap::Args;
use std::io::{BufRead, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_drivers::bench::scenario::Scenario;
use wcal_drivers::bench::{VirtualBench, faults};

/// Serve the simulated devices of a scenario; faults may be typed while it runs
#[derive(Debug, Args)]
pub struct VirtualBenchArgs {
    /// Scenario file
    #[arg(long, value_name = "S.toml")]
    pub scenario: PathBuf,
    /// Run this many times as fast as real time, instead of the scenario's `speed`
    #[arg(long)]
    pub speed: Option<f64>,
    /// Seed, instead of the scenario's
    #[arg(long)]
    pub seed: Option<u64>,
}

/// Prints one JSON line of addresses, then obeys fault commands from its input until that closes.
///
/// # Errors
/// When the scenario cannot be used or a port cannot be opened.
pub fn run(arguments: &VirtualBenchArgs) -> Result<ExitCode> {
    let place = arguments.scenario.display();
    let text = std::fs::read_to_string(&arguments.scenario).with_context(|| format!("reading {place}"))?;
    let mut scenario = Scenario::parse(&text).map_err(|e| anyhow::anyhow!("{place}: {e}"))?;
    if let Some(speed) = arguments.speed {
        anyhow::ensure!(
            speed > 0.0 && speed.is_finite(),
            "--speed: expected a number above 0, found {speed}"
        );
        scenario.speed = speed;
    }
    scenario.seed = arguments.seed.unwrap_or(scenario.seed);
    let bench = VirtualBench::start(scenario, None).context("opening the ports of the bench")?;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", serde_json::to_string(bench.addresses())?)?;
    out.flush()?;
    for line in std::io::stdin().lock().lines() {
        let line = line?;
        if line.trim().is_empty() {
            continue;
        }
        // A typing error must not end a running bench.
        match faults::parse(&line) {
            Ok(fault) => bench.inject(fault),
            Err(e) => writeln!(std::io::stderr(), "virtual-bench: {e}")?,
        }
    }
    Ok(ExitCode::SUCCESS)
}
