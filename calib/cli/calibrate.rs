//! `wcal calibrate`: from the bench to a verified calibration, one step after another.
//!
//! Every step is one of the program's own commands. Its result is its checkpoint: where the
//! document lies the step is done, and the same command line goes on behind it.

use crate::kept::{Printed, Stop, keep};
use crate::output::{Overwrite, ResultKind};
use crate::simulated::word;
use anyhow::{Context, Result, ensure};
use clap::Args;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use wcal_acquisition::run_file::RunFile;
use wcal_core::files::{read_text, write_atomic};
use wcal_core::map_document::MapDocument;
use wcal_core::provenance::sha256_hex;
use wcal_core::verify_document::{ContactComparison, VerifyDocument};
use wcal_core::{InputFile, Provenance};
use wcal_report::{ReportInput, render_index};

/// Arguments of `wcal calibrate`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal calibrate --out calibrated
  wcal calibrate --rig rig.toml --plan plan.toml --cameras stereo.json \\
      --home --out calibrated

Without --rig a virtual bench is swept that has an effect which nobody declared (SIMULATED). After Ctrl-C or a fault the same command
goes on with the step that was not finished.
Exit code: that of the step that stopped it, else that of verify (wcal verify --help).")]
pub(crate) struct CalibrateArgs {
    /// Rig: rig.toml or the folder that holds it
    #[arg(long, value_name = "RIG", requires = "plan")]
    pub rig: Option<PathBuf>,
    /// Plan file
    #[arg(long, value_name = "plan.toml", requires = "rig")]
    pub plan: Option<PathBuf>,
    /// Addresses as `wcal virtual-bench` prints them; they replace those of the rig
    #[arg(long, value_name = "ADDRESSES.json", requires = "rig")]
    pub bench: Option<PathBuf>,
    /// Calibration of the rig's cameras: the wire's shapes are taken from their pictures
    #[arg(long, value_name = "FILE", requires = "rig")]
    pub cameras: Option<PathBuf>,
    /// Home the stage if it has no reference (moves to the home switch)
    #[arg(long)]
    pub home: bool,
    /// Folder for everything
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Write beside unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Seed of every random draw
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// What a folder was calibrated from, and its steps so far.
#[derive(Debug, Default, Serialize, Deserialize, JsonSchema)]
pub(crate) struct CalibrateDocument {
    /// Format and version.
    #[schemars(extend("const" = FORMAT))]
    format: String,
    /// Hash of rig, plan and scenario.
    made_of: String,
    /// The bench is simulated.
    simulated: bool,
    /// Steps that were done, in order.
    steps: Vec<StepDocument>,
}

/// A step that was done.
#[derive(Debug, Clone, Serialize, Deserialize, JsonSchema)]
struct StepDocument {
    /// Name.
    name: String,
    /// Command line.
    command: Vec<String>,
    /// Time that it took, s.
    seconds: f64,
    /// What came out.
    result: String,
    /// Its exit code.
    exit_code: u8,
}

const FORMAT: &str = "wcal-calibrate/1";
const DOCUMENT: &str = "calibrate.json";
const PAGE: &str = "report.html";
const LOG: &str = "calibrate.log";

/// The bench that comes with the program: a clamp that yields, which nobody declared.
const BENCH: [(&str, &str); 3] = [
    ("rig.toml", include_str!("../../rigs/virtual/rig.toml")),
    ("plan.toml", include_str!("../../rigs/plans/rich.toml")),
    (
        "scenario.toml",
        include_str!("../../fixtures/recorded/clamp/scenario.toml"),
    ),
];

/// Runs a command line of the program.
type RunWords = fn(&[&str]) -> Result<ExitCode>;

/// One step: name, command line, document by which it is done, and what that says.
struct Step {
    name: &'static str,
    words: Vec<String>,
    /// A file without which there is nothing to do.
    needs: Option<PathBuf>,
    is_done: Box<dyn Fn() -> bool>,
    says: Box<dyn Fn() -> Result<String>>,
}

/// Runs the command; its steps by `run_words`.
///
/// # Errors
/// A folder with something else in it, or a step that failed.
pub(crate) fn run(args: &CalibrateArgs, run_words: RunWords) -> Result<ExitCode> {
    let own = ResultKind {
        kept: &[
            "bench",
            "session",
            "verify",
            "map",
            "track.csv",
            "track.json",
            PAGE,
            LOG,
        ],
        resumes: true,
        ..ResultKind::new("calibrate", DOCUMENT, "wcal-calibrate/", &[])
    };
    own.check(&args.out, args.overwrite.force)?;
    std::fs::create_dir_all(&args.out)
        .with_context(|| format!("creating {}", args.out.display()))?;
    let bench = bench_files(args)?;
    let made_of = made_of(&bench)?;
    let mut document = begun(&args.out, &made_of)?;
    document.simulated = args.rig.is_none();
    let steps = steps(args, &bench);
    let (mut again, mut code) = (false, 0);
    for (k, step) in steps.iter().enumerate() {
        let place = format!("{}/{} {}", k + 1, steps.len(), step.name);
        // What verify did not accept locates nothing.
        if let Some(needed) = step.needs.as_ref().filter(|f| !f.exists()) {
            println!("{place}: left out: there is no {}", needed.display());
            continue;
        }
        if !again && (step.is_done)() {
            println!("{place}: done before: {}", (step.says)()?);
            continue;
        }
        // What follows was made of what is made anew.
        again = true;
        let begin = Instant::now();
        let words: Vec<&str> = step.words.iter().map(String::as_str).collect();
        eprintln!("{place} ...");
        let (ended, printed) = keep(&words, Stop::default(), || run_words(&words));
        log(args, &words, &printed)?;
        let ended = ended.with_context(|| format!("{place} ({})", words.join(" ")))?;
        let seconds = begin.elapsed().as_secs_f64();
        if !(step.is_done)() {
            println!(
                "{place}: stopped after {seconds:.0} s; see {}",
                args.out.join(LOG).display()
            );
            println!("go on with the same command");
            return Ok(ended);
        }
        let exit_code = number_of(ended);
        let result = (step.says)()?;
        println!("{place}: {seconds:.0} s: {result}");
        document.steps.retain(|s| s.name != step.name);
        document.steps.push(StepDocument {
            name: step.name.to_owned(),
            command: step.words.clone(),
            seconds,
            result,
            exit_code,
        });
        let text = serde_json::to_vec_pretty(&document)?;
        write_atomic(&args.out.join(DOCUMENT), &text)?;
    }
    if let Some(verify) = document.steps.iter().find(|s| s.name == "verify") {
        code = verify.exit_code;
    }
    finish(args, &document)?;
    Ok(ExitCode::from(code))
}

/// Keeps what a step printed.
fn log(args: &CalibrateArgs, words: &[&str], printed: &Printed) -> Result<()> {
    let mut options = OpenOptions::new();
    options.create(true).append(true);
    let mut log = options.open(args.out.join(LOG)).context(LOG)?;
    let Printed { stdout, stderr } = printed;
    write!(log, "$ {}\n{stderr}{stdout}", words.join(" ")).context(LOG)
}

/// Exit codes have no number of their own.
fn number_of(code: ExitCode) -> u8 {
    (0..=u8::MAX)
        .find(|k| ExitCode::from(*k) == code)
        .unwrap_or(1)
}

/// Rig, plan and, of the bench that comes with the program, its scenario.
fn bench_files(args: &CalibrateArgs) -> Result<Vec<PathBuf>> {
    if let (Some(rig), Some(plan)) = (&args.rig, &args.plan) {
        let rig = if rig.is_dir() {
            rig.join("rig.toml")
        } else {
            rig.clone()
        };
        return Ok(vec![rig, plan.clone()]);
    }
    let folder = args.out.join("bench");
    std::fs::create_dir_all(&folder).with_context(|| format!("creating {}", folder.display()))?;
    let write = |(name, text): &(&str, &str)| {
        let path = folder.join(name);
        write_atomic(&path, text.as_bytes())?;
        Ok(path)
    };
    BENCH.iter().map(write).collect()
}

fn made_of(files: &[PathBuf]) -> Result<String> {
    let texts: Result<Vec<String>, _> = files.iter().map(read_text).collect();
    Ok(sha256_hex(texts?.join("\0").as_bytes()))
}

/// The document of an earlier start of the same calibration, or a new one.
fn begun(folder: &Path, made_of: &str) -> Result<CalibrateDocument> {
    let path = folder.join(DOCUMENT);
    if !path.exists() {
        let document = CalibrateDocument {
            format: FORMAT.to_owned(),
            made_of: made_of.to_owned(),
            ..CalibrateDocument::default()
        };
        write_atomic(&path, &serde_json::to_vec_pretty(&document)?)?;
        return Ok(document);
    }
    let document: CalibrateDocument =
        serde_json::from_str(&read_text(&path)?).with_context(|| path.display().to_string())?;
    ensure!(
        document.made_of == made_of,
        "{}: expected a new folder, or the rig and plan that it was begun with, found others",
        folder.display()
    );
    Ok(document)
}

fn steps(args: &CalibrateArgs, bench: &[PathBuf]) -> Vec<Step> {
    let at = |name: &str| args.out.join(name).display().to_string();
    let [session, verify, map, track] = ["session", "verify", "map", "track.csv"].map(at);
    let calibration = format!("{verify}/calibration.json");
    let words = |words: &[&str]| -> Vec<String> {
        let all = ["wcal"].iter().chain(words);
        all.map(|w| (*w).to_owned()).collect()
    };
    let has =
        |file: String| -> Box<dyn Fn() -> bool> { Box::new(move || Path::new(&file).exists()) };
    let mut all = vec![Step {
        name: "sweep",
        words: sweep_words(args, bench, &session),
        needs: None,
        is_done: {
            let folder = args.out.join("session");
            Box::new(move || is_finished(&folder))
        },
        says: {
            let folder = args.out.join("session");
            Box::new(move || rows_of(&folder))
        },
    }];
    if let Some(cameras) = &args.cameras {
        let cameras = cameras.display().to_string();
        all.push(Step {
            name: "shapes",
            words: words(&["stereo-shape", &session, "--cameras", &cameras]),
            needs: None,
            is_done: has(format!("{session}/shapes.json")),
            says: Box::new(|| Ok("shapes of the wire, in shapes.json".to_owned())),
        });
    }
    let seed = args.seed.to_string();
    let result = args.out.clone();
    all.push(Step {
        name: "verify",
        words: words(&["verify", &session, "--out", &verify, "--seed", &seed]),
        needs: None,
        is_done: has(format!("{verify}/verify.json")),
        says: Box::new(move || Ok(verdict(&verified(&result)?))),
    });
    let result = args.out.clone();
    all.push(Step {
        name: "map",
        words: words(&["fit-gpr", &session, "--out", &map]),
        needs: None,
        is_done: has(format!("{map}/calibration.json")),
        says: Box::new(move || {
            let text = read_text(result.join("map/fit-gpr.json"))?;
            let map: MapDocument = serde_json::from_str(&text)?;
            Ok(format!("map {} of {} poses", map.chosen, map.points))
        }),
    });
    let result = args.out.clone();
    all.push(Step {
        name: "track",
        words: words(&[
            "track",
            &session,
            "--calibration",
            &calibration,
            "--out",
            &track,
            "--force",
        ]),
        needs: Some(PathBuf::from(&calibration)),
        is_done: has(track),
        says: Box::new(move || {
            let rows = read_text(result.join("track.csv"))?.lines().count();
            Ok(format!("{} contacts in track.csv", rows.saturating_sub(1)))
        }),
    });
    all
}

/// A session that was begun goes on; the bench in this process starts without a reference.
fn sweep_words(args: &CalibrateArgs, bench: &[PathBuf], session: &str) -> Vec<String> {
    let text = |path: &Path| path.display().to_string();
    let mut words: Vec<String> = ["wcal", "stage-sweep", "--rig"].map(str::to_owned).to_vec();
    words.extend([text(&bench[0]), "--plan".to_owned(), text(&bench[1])]);
    if let Some(scenario) = bench.get(2) {
        words.extend(["--scenario".to_owned(), text(scenario), "--home".to_owned()]);
    } else if args.home {
        words.push("--home".to_owned());
    }
    if let Some(addresses) = &args.bench {
        words.extend(["--bench".to_owned(), text(addresses)]);
    }
    let begun = Path::new(session).join("run.json").exists();
    let way = if begun { "--resume" } else { "--out" };
    words.extend([way.to_owned(), session.to_owned()]);
    words
}

fn is_finished(session: &Path) -> bool {
    let run = read_text(session.join("run.json")).ok();
    let run = run.and_then(|text| RunFile::parse(&text).ok());
    let last = run.as_ref().and_then(|run| run.runs.last());
    last.is_some_and(|last| last.ending == "finished") && session.join("points.csv").exists()
}

fn rows_of(session: &Path) -> Result<String> {
    let rows = |name: &str| {
        let text = read_text(session.join(name)).unwrap_or_default();
        text.lines().count().saturating_sub(1)
    };
    let run = RunFile::parse(&read_text(session.join("run.json"))?)?;
    let lost: u64 = run.runs.iter().map(|r| r.lost_scans).sum();
    let (open, sealed) = (rows("points.csv"), rows("holdout.csv"));
    Ok(format!(
        "{open} readings, {sealed} more sealed, {lost} scans lost"
    ))
}

fn verified(folder: &Path) -> Result<VerifyDocument> {
    let path = folder.join("verify/verify.json");
    serde_json::from_str(&read_text(&path)?).with_context(|| path.display().to_string())
}

/// Verdict and names.
fn verdict(document: &VerifyDocument) -> String {
    let verdict = serde_json::to_value(document.verdict).unwrap_or_default();
    let names: Vec<&str> = document.effects.iter().map(|e| e.id.as_str()).collect();
    let names = match names.is_empty() {
        true => String::new(),
        false => format!(": {}", names.join(" + ")),
    };
    format!("{}{names}", verdict.as_str().unwrap_or_default())
}

/// What all of it is for, in a sentence.
fn sentence(contact: &ContactComparison) -> String {
    format!(
        "The error of a contact in the groove falls from {:.2} mm to {:.2} mm; {:.2} mm is expected from the noise.",
        contact.before.rms_mm, contact.after.rms_mm, contact.bound_mm
    )
}

/// The page, and the last lines.
fn finish(args: &CalibrateArgs, document: &CalibrateDocument) -> Result<()> {
    let verify = verified(&args.out)?;
    let said = verdict(&verify);
    let located = verify.contact.as_ref().map(sentence);
    let steps = document.steps.iter();
    let steps: Vec<String> = steps
        .map(|s| format!("{} ({:.0} s): {}.", s.name, s.seconds, s.result))
        .collect();
    let introduction: Vec<&str> = [&verify.reason]
        .into_iter()
        .chain(&steps)
        .map(String::as_str)
        .collect();
    let title = format!("Calibration in {}", args.out.display());
    let simulated = verify.simulated;
    let calibration = args.out.join("verify/calibration.json");
    let provenance = Provenance {
        program: format!("wcal {}", env!("CARGO_PKG_VERSION")),
        command: std::env::args().collect(),
        created: jiff::Timestamp::now().to_string(),
        seed: args.seed,
        inputs: Vec::<InputFile>::new(),
        simulated,
    };
    let report = ReportInput::new(verify.clone(), provenance);
    let page = args.out.join(PAGE);
    let reports = [("verify/report.html".to_owned(), report)];
    write_atomic(
        &page,
        render_index(&title, &introduction, &reports).as_bytes(),
    )?;
    println!("verdict{}: {said}", word(simulated));
    if let Some(line) = located {
        println!("{line}");
    }
    println!("page: {}", page.display());
    if calibration.exists() {
        println!(
            "next: wcal track READINGS --calibration {} --out contacts.csv",
            calibration.display()
        );
    } else {
        println!("no calibration was written: the page says why");
    }
    Ok(())
}
