//! `wcal demo`: the whole loop on the recordings that come with the project.

use crate::verify::{print_text, verify_session};
use anyhow::Context;
use clap::Args;
use std::path::PathBuf;
use std::process::ExitCode;
use wcal_report::{Fact, IndexEntry, render_index};
use wcal_session::{load, write_atomic};

/// Arguments of `wcal demo`.
#[derive(Debug, Args)]
#[command(after_help = "Example:
  wcal demo --out demo-out

Exit code 0 when it ran, whatever the verdicts.")]
pub struct DemoArgs {
    /// Folder for every result
    #[arg(long, value_name = "DIR", default_value = "demo-out")]
    pub out: PathBuf,
    /// Seed of every random draw
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// A recording compiled into the program: name, simulated or not, files.
struct Recording {
    name: &'static str,
    simulated: Option<&'static str>,
    files: &'static [(&'static str, &'static str)],
}

macro_rules! recording {
    ($name:literal, $folder:literal, $simulated:expr, [$($file:literal),*]) => {
        Recording {
            name: $name,
            simulated: $simulated,
            files: &[$(($file, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/", $folder, "/", $file)))),*],
        }
    };
}

const SIMULATED: Option<&str> = Some("drawn from physics code that is not the project's (fixtures/practice)");

/// The measured one last: its table is what a terminal shows at the end.
const RECORDINGS: &[Recording] = &[
    recording!("practice-004", "practice/case-004", SIMULATED, ["session.toml", "points.csv", "holdout.csv"]),
    recording!("practice-008", "practice/case-008", SIMULATED, ["session.toml", "points.csv", "holdout.csv"]),
    recording!(
        "whiskerfbg",
        "whiskerfbg",
        None,
        ["session.toml", "points.csv", "twin.csv", "rest_shape.csv"]
    ),
];

/// Runs the command.
///
/// # Errors
/// A file that cannot be written.
pub fn run(args: &DemoArgs) -> anyhow::Result<ExitCode> {
    let mut entries = Vec::new();
    let progress = crate::progress::Progress::new("demo");
    progress.hear_search();
    for r in RECORDINGS {
        eprintln!("{} ...", r.name);
        let folder = args.out.join(r.name).join("session");
        std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
        for (name, content) in r.files {
            write_atomic(&folder.join(name), content.as_bytes())?;
        }
        let out = args.out.join(r.name);
        // A demonstration starts afresh: its seal is that of the recording, not of an earlier run.
        let _ = std::fs::remove_file(out.join("unsealed.json"));
        let session = load(&folder)?;
        let mut report = verify_session(&session, &out, args.seed, &[])?;
        if let Some(how) = r.simulated {
            report.simulated = Some(how.to_owned());
            report.facts.insert(0, Fact::new("data", "SIMULATED"));
            write_atomic(&out.join("report.html"), wcal_report::render(&report).as_bytes())?;
        }
        print_text(&report.verify, &out);
        entries.push(IndexEntry::of(&report, format!("{}/report.html", r.name)));
    }
    drop(progress);
    // The page starts with what was measured.
    entries.reverse();
    let introduction = ["Every recording that comes with the project, through the whole residual loop."];
    let page = args.out.join("report.html");
    write_atomic(&page, render_index("wcal demo", &introduction, &entries).as_bytes())?;
    println!("report: {}", page.display());
    Ok(ExitCode::SUCCESS)
}
