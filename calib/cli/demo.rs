//! `wcal demo`: the whole loop on the recordings that come with the project.

use crate::output::{OutputFolder, Overwrite, ResultKind};
use crate::progress::Progress;
use crate::verify::{self, print_text, verify_session};
use anyhow::{Context, Result};
use clap::Args;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::files::write_atomic;
use wcal_report::{ReportInput, render_index};
use wcal_session::load;

/// Arguments of `wcal demo`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal demo --out demo-out

Exit code 0 when it ran, whatever the verdicts.")]
pub(crate) struct DemoArgs {
    /// Folder for every result
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Seed of every random draw
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// A recording compiled into the program: name and files. The session says whether it is simulated.
struct Recording {
    name: &'static str,
    /// What it shows, in a sentence.
    shows: &'static str,
    files: &'static [(&'static str, &'static [u8])],
    /// Folder of a sweep that judges its explanations.
    sweep: Option<&'static str>,
}

macro_rules! recording {
    ($name:literal, $shows:literal, $folder:literal, [$($file:literal),*], $sweep:expr) => {
        Recording {
            name: $name,
            shows: $shows,
            files: &[$(($file, include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/", $folder, "/", $file)))),*],
            sweep: $sweep,
        }
    };
}

/// First what it is all for: an effect that nobody declared, found, added, and the contacts before
/// and after. Then what was measured: explanations that another measurement refutes, and an effect
/// that halves the held-out error and more. Last a bench with nothing to find.
const RECORDINGS: &[Recording] = &[
    recording!(
        "bench-clamp",
        "A whisker's clamp yields, which nobody declared (SIMULATED): the effect is found, and the contact's error falls.",
        "recorded/clamp",
        ["session.toml", "points.csv", "holdout.csv"],
        None
    ),
    recording!(
        "whiskerfbg",
        "The whisker of a paper at 27 measured poses: a measured sweep over a bottle judges what might explain them.",
        "whiskerfbg",
        ["session.toml", "points.csv", "twin.csv", "rest_shape.csv"],
        Some(SWEEP.name)
    ),
    recording!(
        "pontius",
        "A load cell of NIST (measured), declared as a straight line: a quadratic term was missing.",
        "nist/pontius",
        ["session.toml", "points.csv"],
        None
    ),
    recording!(
        "practice-004",
        "A whisker's bench without any effect (SIMULATED): nothing is named.",
        "practice/case-004",
        ["session.toml", "points.csv", "holdout.csv"],
        None
    ),
];

/// The measured sweep of the paper's whisker over a bottle.
const SWEEP: Recording = recording!(
    "bottle",
    "The measured sweep of that whisker over a bottle.",
    "whiskerfbg_bottle",
    [
        "session.toml",
        "points.csv",
        "object.stl",
        "released_contacts.csv"
    ],
    None
);

/// Title of the first page, by which an earlier demonstration is recognised.
const TITLE: &str = "wcal demo";

/// Runs a command line of the program.
type RunWords = fn(&[&str]) -> Result<ExitCode>;

/// Runs the command; its own commands by `run_words`.
///
/// # Errors
/// A file that cannot be written.
pub(crate) fn run(args: &DemoArgs, run_words: RunWords) -> Result<ExitCode> {
    let names: Vec<&str> = RECORDINGS.iter().chain([&SWEEP]).map(|r| r.name).collect();
    let own = ResultKind {
        kept: &names,
        ..ResultKind::new("demo", "report.html", TITLE, &[])
    };
    own.check(&args.out, args.overwrite.force)?;
    let kind = ResultKind {
        command: "demo",
        kept: &["session", "unsealed.json"],
        ..verify::RESULT
    };
    // Before the first recording, not between two.
    for name in &names {
        kind.check(&args.out.join(name), args.overwrite.force)?;
    }
    // The sweep judges the explanations of a recording below, so it must lie there first.
    write_session(&args.out, &SWEEP)?;
    let mut reports = Vec::new();
    for r in RECORDINGS {
        println!("{}: {}", r.name, r.shows);
        let out = args.out.join(r.name);
        let mut results = OutputFolder::open(&kind, &out, args.overwrite.force)?;
        let folder = write_session(&args.out, r)?;
        // A demonstration starts afresh: its seal is that of the recording, not of an earlier run.
        let _ = std::fs::remove_file(out.join("unsealed.json"));
        let session = load(&folder)?;
        let sweep = r.sweep.map(|name| args.out.join(name).join("session"));
        let progress = Progress::new(&format!("demo: {}", r.name));
        let options = verify::searching(args.seed, Some(&progress));
        let mut report = verify_session(session, &mut results, options, None, sweep.as_deref())?;
        r.shows.clone_into(&mut report.about);
        results.finish()?;
        print_text(&report, &out);
        reports.push((format!("{}/report.html", r.name), report));
    }
    track_bottle(&args.out, run_words)?;
    println!("report: {}", write_index(&args.out, &reports)?.display());
    Ok(ExitCode::SUCCESS)
}

/// Writes a recording's session into its folder; the session's folder.
fn write_session(place: &Path, r: &Recording) -> Result<PathBuf> {
    let folder = place.join(r.name).join("session");
    std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    for (name, content) in r.files {
        write_atomic(&folder.join(name), content)?;
    }
    Ok(folder)
}

/// The contacts of the measured sweep, through the map of the 27 measured poses: as anybody would
/// make them, by the program's own commands.
fn track_bottle(place: &Path, run_words: RunWords) -> Result<()> {
    let at = |name: &str| place.join(name).display().to_string();
    let (session, map, sweep) = (
        at("whiskerfbg/session"),
        at("bottle/map"),
        at("bottle/session"),
    );
    let (calibration, track) = (at("bottle/map/calibration.json"), at("bottle/track.csv"));
    let fit = ["wcal", "fit-gpr", &session, "--out", &map, "--force"];
    // Forced: no verdict vouches for the map, and every row says so.
    let locate = [
        "wcal",
        "track",
        &sweep,
        "--calibration",
        &calibration,
        "--out",
        &track,
        "--force",
    ];
    for command in [&fit[..], &locate] {
        eprintln!("{} ...", command.join(" "));
        run_words(command)?;
    }
    Ok(())
}

/// Writes the first page; its path.
fn write_index(place: &Path, reports: &[(String, ReportInput)]) -> Result<PathBuf> {
    let introduction = [
        "Four recordings that come with the program: what does the declared model lack, and how far does the error on readings that it was not fitted to fall once that is added?",
        "bottle/track.csv has the contacts of the measured sweep.",
    ];
    let page = place.join("report.html");
    write_atomic(
        &page,
        render_index(TITLE, &introduction, reports).as_bytes(),
    )?;
    Ok(page)
}
