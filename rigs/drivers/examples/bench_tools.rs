//! `virtual-bench`, `stage-sweep` and `reduce` without the rest of wcal: for the peer scripts and bench work.

#[path = "../../../calib/cli/reduce.rs"]
mod reduce;
#[path = "../../../calib/cli/stage_sweep.rs"]
mod stage_sweep;
#[path = "../../../calib/cli/virtual_bench.rs"]
mod virtual_bench;

use clap::Parser;
use std::io::Write;
use std::process::ExitCode;

/// Bench tools of wcal
#[derive(Debug, Parser)]
enum Tool {
    VirtualBench(virtual_bench::VirtualBenchArgs),
    StageSweep(stage_sweep::StageSweepArgs),
    Reduce(reduce::ReduceArgs),
}

fn main() -> ExitCode {
    let result = match Tool::parse() {
        Tool::VirtualBench(a) => virtual_bench::run(&a),
        Tool::StageSweep(a) => stage_sweep::run(&a),
        Tool::Reduce(a) => reduce::run(&a),
    };
    result.unwrap_or_else(|e| {
        let _ = writeln!(std::io::stderr(), "error: {e:#}");
        ExitCode::FAILURE
    })
}
