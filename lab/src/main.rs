//! The `wcal-lab` program: what makes, trains and judges what `wcal` uses. Results on stdout,
//! progress and diagnostics on stderr.

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::process::ExitCode;
use wcal_lab::commands::{evaluate, exam, man, simulate, train};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Sweeps of the simulated whisker, the contact tracker trained on them, its scores, and the exam
/// of `wcal verify`. All of it is SIMULATED.
#[derive(Debug, Parser)]
#[command(name = "wcal-lab", version, arg_required_else_help = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[allow(clippy::large_enum_variant, reason = "one a program run")]
#[derive(Debug, Subcommand)]
enum Command {
    /// Sweeps of the simulated whisker over objects, as shards
    Simulate(simulate::SimulateArgs),
    /// Train the contact tracker on simulated sweeps
    Train(train::TrainArgs),
    /// Score a trained tracker beside the baselines
    Evaluate(evaluate::EvaluateArgs),
    /// Examine `wcal verify` on drawn sessions: its verdicts, and what they are worth
    Exam(exam::ExamArgs),
    /// Manual pages and completions of `wcal`, for packages
    Man(man::ManArgs),
}

fn main() -> ExitCode {
    let asked = wcal::in_paragraphs(Cli::command()).get_matches();
    let cli = match Cli::from_arg_matches(&asked) {
        Ok(cli) => cli,
        Err(e) => e.exit(),
    };
    let result = match &cli.command {
        Command::Simulate(args) => simulate::run(args),
        Command::Train(args) => train::run(args),
        Command::Evaluate(args) => evaluate::run(args),
        Command::Exam(args) => exam::run(args),
        Command::Man(args) => man::run(args),
    };
    wcal::end("wcal-lab", result)
}
