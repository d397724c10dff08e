//! The `wcal` program: one file a command; results on stdout, progress and diagnostics on stderr.
//! What is public beside [`main`] is what `wcal-lab` shares with it.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program talks to its user"
)]

// First: what follows prints by its macros.
#[macro_use]
pub mod printing;

mod column_words;
mod demo;
pub mod fit_gpr;
pub mod fit_whisker;
mod import;
mod input;
mod interrupt;
pub mod labels;
mod live_page;
pub mod output;
pub mod picture_output;
mod plan_check;
mod predict;
pub mod progress;
mod reduce;
mod report_input;
mod session_folder;
mod simulated;
mod stage_sweep;
mod stereo_calibrate;
mod stereo_shape;
pub mod track;
mod twin;
pub mod verify;
mod virtual_bench;

#[cfg(test)]
#[path = "../../tests/support/json_reference.rs"]
mod json_reference;
#[cfg(test)]
mod schemas_test;

use anyhow::Result;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use std::process::ExitCode;
use wcal_core::text::{brief, printable};

/// Calibrates whisker touch sensors, and any instrument that gives a table of readings: finds what
/// the model of it lacks.
#[derive(Debug, Parser)]
#[command(name = "wcal", version, arg_required_else_help = true, after_help = START)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What to type first.
const START: &str = "\
Start:
  wcal demo --out demo-out                      the whole loop on recorded data
  wcal import TABLE.csv --kind transducer --stimulus COL --response COL --model linear --out SESSION
  wcal verify SESSION --out RESULT              then open RESULT/report.html
  wcal stage-sweep --help                       a whisker on a bench";

#[allow(clippy::large_enum_variant, reason = "one a program run")]
#[derive(Debug, Subcommand)]
enum Command {
    /// The whole loop on the recordings that come with the program
    Demo(demo::DemoArgs),
    /// Turn a plain table into a session
    Import(import::ImportArgs),
    /// The residual loop: find what the model lacks, add it, show the held-out error
    #[command(alias = "calibrate")]
    Verify(verify::VerifyArgs),
    /// Wavelength-to-moment map of a session
    FitGpr(fit_gpr::FitGprArgs),
    /// Readings of a table through a calibration: moments, or the stimulus
    Predict(predict::PredictArgs),
    /// Both cameras from pairs of pictures of a board
    StereoCalibrate(stereo_calibrate::StereoCalibrateArgs),
    /// The wire's shape and the groove's contact from pairs of pictures
    StereoShape(stereo_shape::StereoShapeArgs),
    /// The whisker's rest geometry from measured shapes
    FitWhisker(fit_whisker::FitWhiskerArgs),
    /// The twin's base moments at a session's poses
    Twin(twin::TwinArgs),
    /// Contact points from a recording of wavelengths, through a calibration and a trained tracker
    Track(track::TrackArgs),
    /// Drive the stage through a plan, record every stream, reduce to a session
    StageSweep(stage_sweep::StageSweepArgs),
    /// Rebuild the tables of a recorded session from its raw streams
    Reduce(reduce::ReduceArgs),
    /// Serve simulated devices that speak the real ones' protocols
    VirtualBench(virtual_bench::VirtualBenchArgs),
}

/// Runs the command line of the process; its exit code.
pub fn main() -> ExitCode {
    let cli = match Cli::from_arg_matches(&command().get_matches()) {
        Ok(cli) => cli,
        Err(e) => e.exit(),
    };
    end("wcal", dispatch(&cli.command))
}

/// The exit code of what a command gave; an error is said on stderr.
pub fn end(program: &str, result: Result<ExitCode>) -> ExitCode {
    let unwritten = printing::failed().map(anyhow::Error::msg);
    unwritten.map_or(result, Err).unwrap_or_else(|error| {
        eprintln!("{program}: {}", with_causes(&error));
        ExitCode::from(1)
    })
}

/// Runs a command.
fn dispatch(asked: &Command) -> Result<ExitCode> {
    match asked {
        Command::Verify(args) => verify::run(args),
        Command::FitGpr(args) => fit_gpr::run(args),
        Command::Predict(args) => predict::run(args),
        Command::Demo(args) => demo::run(args, run_words),
        Command::Import(args) => import::run(args),
        Command::StereoCalibrate(args) => stereo_calibrate::run(args),
        Command::StereoShape(args) => stereo_shape::run(args),
        Command::FitWhisker(args) => fit_whisker::run(args),
        Command::Twin(args) => twin::run(args),
        Command::Track(args) => track::run(args),
        Command::StageSweep(args) => stage_sweep::run(args, plan_check::of_plan),
        Command::Reduce(args) => reduce::run(args),
        Command::VirtualBench(args) => virtual_bench::run(args),
    }
}

/// Runs a command line within the program.
///
/// # Errors
/// Those of the command.
pub(crate) fn run_words(words: &[&str]) -> Result<ExitCode> {
    dispatch(&Cli::try_parse_from(words)?.command)
}

/// An error and its causes, each once: some say their cause themselves. Messages are short where
/// they are made; what a library says of a file is cut here at the latest.
fn with_causes(error: &anyhow::Error) -> String {
    /// Longest message, characters.
    const LONGEST: usize = 1500;
    let whole =
        error
            .chain()
            .map(ToString::to_string)
            .fold(String::new(), |text, cause| match text.as_str() {
                "" => cause,
                said if said.ends_with(&cause) => text,
                said => format!("{said}: {cause}"),
            });
    if whole.chars().count() > LONGEST {
        brief(&whole)
    } else {
        printable(&whole)
    }
}

/// The command line with its help in whole paragraphs: the terminal's width breaks them, not the
/// source's.
fn command() -> clap::Command {
    in_paragraphs(Cli::command())
}

/// A command line with the help of its commands in whole paragraphs.
pub fn in_paragraphs(all: clap::Command) -> clap::Command {
    let names: Vec<String> = all
        .get_subcommands()
        .map(|c| c.get_name().to_owned())
        .collect();
    names.iter().fold(all, |all, name| {
        all.mut_subcommand(name, |c| {
            match c.get_after_help().map(|text| paragraphs(&text.to_string())) {
                Some(text) => c.after_help(text),
                None => c,
            }
        })
    })
}

/// Joins lines that follow each other; indented lines and blank ones stay as they are.
fn paragraphs(text: &str) -> String {
    let mut out = String::new();
    let mut joins = false;
    for line in text.lines() {
        let prose = !line.is_empty() && !line.starts_with(' ');
        if !out.is_empty() {
            out.push(if prose && joins { ' ' } else { '\n' });
        }
        out.push_str(line);
        // A heading stands above what is indented.
        joins = prose && !line.ends_with(':');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is wrong with a help text as a person reads it on a wide terminal.
    fn faults(help: &str) -> Vec<String> {
        let mut found = Vec::new();
        if help.contains("\\\"") || help.contains("\\n") {
            found.push("a literal escape".to_owned());
        }
        let lines: Vec<&str> = help.lines().collect();
        for pair in lines.windows(2) {
            let prose = |line: &str| !line.is_empty() && !line.starts_with(' ');
            let wrapped = prose(pair[0]) && prose(pair[1]) && !pair[0].ends_with([':', '.']);
            if wrapped {
                found.push(format!("broken by hand: {:?} / {:?}", pair[0], pair[1]));
            }
        }
        found
    }

    #[test]
    fn every_help_reads_as_paragraphs_without_escapes() {
        let mut all = command();
        all.build();
        let mut seen = 0;
        for sub in all.get_subcommands_mut().filter(|c| c.get_name() != "help") {
            let name = sub.get_name().to_owned();
            let help = sub
                .clone()
                .term_width(10_000)
                .render_long_help()
                .to_string();
            assert_eq!(
                faults(&help),
                Vec::<String>::new(),
                "wcal {name} --help:\n{help}"
            );
            seen += 1;
        }
        assert!(seen >= 13, "{seen} commands");
        // The same texts as the source has them, and an escape that a raw string would show.
        let raw = Cli::command()
            .find_subcommand_mut("twin")
            .map(|c| c.render_long_help().to_string());
        assert!(
            !faults(&raw.unwrap_or_default()).is_empty(),
            "negative control"
        );
        assert!(!faults("kind \\\"axis\\\"").is_empty(), "negative control");
    }
}
