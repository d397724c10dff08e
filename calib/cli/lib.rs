//! The `wcal` program: one file a command; results on stdout, progress and diagnostics on stderr.
//! What is public beside [`main`] is what `wcal-lab` shares with it.
// The Python module has no commands for pictures, and does without what they alone use.
#![cfg_attr(not(feature = "pictures"), allow(dead_code))]
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "a program talks to its user"
)]

// First: what follows prints by its macros.
#[macro_use]
pub mod printing;

mod calibrate;
mod check;
mod column_words;
mod demo;
mod export;
pub mod fit_gpr;
#[cfg(feature = "pictures")]
pub mod fit_whisker;
mod import;
mod interrupt;
mod kept;
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
#[cfg(feature = "pictures")]
mod stereo_calibrate;
#[cfg(feature = "pictures")]
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
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
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
  wcal calibrate --out calibrated               a bench in one command (without --rig a virtual one)
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
    /// A bench from the sweep to the verified calibration, one command; goes on where it stopped
    Calibrate(calibrate::CalibrateArgs),
    /// The residual loop: find what the model lacks, add it, show the held-out error
    Verify(verify::VerifyArgs),
    /// Wavelength-to-moment map of a session
    FitGpr(fit_gpr::FitGprArgs),
    /// Does a calibration still hold, and what changed
    Check(check::CheckArgs),
    /// Readings of a table through a calibration: moments, or the stimulus
    Predict(predict::PredictArgs),
    /// A calibration as code in C or Python, or as a filter of ESPHome
    Export(export::ExportArgs),
    /// Both cameras from pairs of pictures of a board
    #[cfg(feature = "pictures")]
    StereoCalibrate(stereo_calibrate::StereoCalibrateArgs),
    /// The wire's shape and the groove's contact from pairs of pictures
    #[cfg(feature = "pictures")]
    StereoShape(stereo_shape::StereoShapeArgs),
    /// The whisker's rest geometry from measured shapes
    #[cfg(feature = "pictures")]
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
        Command::Check(args) => check::run(args),
        Command::Predict(args) => predict::run(args),
        Command::Export(args) => export::run(args),
        Command::Demo(args) => demo::run(args, run_words),
        Command::Calibrate(args) => calibrate::run(args, run_words),
        Command::Import(args) => import::run(args),
        #[cfg(feature = "pictures")]
        Command::StereoCalibrate(args) => stereo_calibrate::run(args),
        #[cfg(feature = "pictures")]
        Command::StereoShape(args) => stereo_shape::run(args),
        #[cfg(feature = "pictures")]
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

/// A command line that another program ran.
#[derive(Debug)]
pub struct Ran {
    /// Exit code, as of the program.
    pub code: u8,
    /// The error in one line, where there is one.
    pub error: Option<String>,
    /// What it printed.
    pub stdout: String,
    /// Warnings and diagnostics.
    pub stderr: String,
}

/// Runs a command line within another program, on this thread: nothing is printed, and no error or
/// panic ends that program. Where `stop` is set, the search of `verify` ends at its next step.
pub fn run_kept(words: &[&str], stop: Arc<AtomicBool>) -> Ran {
    let work = || {
        let cli = match Cli::try_parse_from(words) {
            Ok(cli) => cli,
            Err(e) => return (2, Some(usage(&e.to_string()))),
        };
        match catch_unwind(AssertUnwindSafe(|| dispatch(&cli.command))) {
            // The standard library does not give the number.
            Ok(Ok(code)) => (
                (0..=u8::MAX)
                    .find(|n| ExitCode::from(*n) == code)
                    .unwrap_or(1),
                None,
            ),
            Ok(Err(error)) => (1, Some(with_causes(&error))),
            Err(why) if why.is::<progress::Interrupted>() => (1, Some("interrupted".to_owned())),
            Err(_) => {
                let said =
                    "internal error: expected a result or an error, found a panic; see stderr";
                (1, Some(said.to_owned()))
            }
        }
    };
    let ((code, error), kept::Printed { stdout, stderr }) = kept::keep(words, stop, work);
    Ran {
        code,
        error,
        stdout,
        stderr,
    }
}

/// What is wrong with a command line, in one line: its first paragraph.
fn usage(said: &str) -> String {
    let first = said.split("\n\n").next().unwrap_or_default();
    let words: Vec<&str> = first.split_whitespace().collect();
    printable(words.join(" ").trim_start_matches("error: "))
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
pub fn command() -> clap::Command {
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
    use std::sync::atomic::Ordering;

    #[test]
    fn a_kept_command_gives_texts_and_errors_in_one_line_and_ends_when_asked() {
        let out = tempfile::tempdir().unwrap();
        let out = out.path().join("out").display().to_string();
        let session = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/nist/pontius");
        let verify = ["wcal", "verify", session, "--out", &out];
        let run = |words: &[&str]| run_kept(words, Arc::default());
        let check = run(&["wcal", "verify", session, "--check"]);
        assert!(check.stdout.contains("pontius"), "{check:?}");
        assert_eq!(check.error, None);
        let none = run(&["wcal", "verify", "no-such-folder", "--out", &out]);
        assert_eq!((none.code, none.stdout.as_str()), (1, ""), "{none:?}");
        assert!(none.error.is_some_and(|e| e.contains("no-such-folder")));
        let lacking = run(&["wcal", "verify", "--sugar"]);
        let said = lacking.error.unwrap();
        assert!(lacking.code == 2 && said.starts_with("unexpected") && !said.contains('\n'));
        let asked = Arc::<AtomicBool>::default();
        asked.store(true, Ordering::Relaxed);
        let ended = run_kept(&verify, asked);
        assert_eq!(ended.error.as_deref(), Some("interrupted"));
        // Negative control: the same to its end; nothing of the earlier ones is left.
        let whole = run(&verify);
        assert_eq!((whole.code, whole.error), (0, None), "{}", whole.stderr);
        assert!(whole.stdout.contains("nonlinearity-quadratic"));
        assert!(kept::stop().is_none());
    }

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
