//! `wcal check`: does a calibration still hold?

use crate::output::{OutputFolder, Overwrite, ResultKind};
use crate::session_folder::{expect_session, kind_of_table};
use crate::simulated::{is_simulated, word};
use anyhow::{Context, Result, anyhow, bail};
use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_calibration::{
    CalibrationHistory, CalibrationModel, GivenCalibration, HistoryEntry, QuantityHistory,
    SessionSystem, TrustIssue, history, read_calibration, rows_to_check, trust_issues,
};
use wcal_core::provenance::sha256_hex;
use wcal_core::text::{chance, number, with_unit};
use wcal_core::verify_document::CalibrationJudgement;
use wcal_core::{InputFile, Provenance, Purpose};
use wcal_report::{Fact, HistoryChart, HistoryInput, render_history};
use wcal_session::load;
use wcal_verify::change::{CalibrationChange, CalibrationCheck, TaredZero, Tested};
use wcal_verify::scalar::ScalarModel;
use wcal_verify::whisker::WhiskerSystem;

/// Arguments of `wcal check`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal check readings.csv --calibration calibration/calibration.json
  wcal check later-session --calibration calibration/calibration.json
  wcal check readings.csv --tare --calibration calibration/calibration.json
  wcal check --history calibrations --out drift

READINGS is a table with the columns that the calibration's session was imported from (stimulus and response), or a session. Ten readings over
the range suffice. Answers: OK; DEGRADED, with what changed and what it costs; EXPIRED; MISMATCH (another kind or unit); NOT TESTED (too few
readings, with how many are needed).
Exit code 0: OK; 4: any other answer; 1: an error.")]
pub(crate) struct CheckArgs {
    /// New readings: a table or a session
    #[arg(
        value_name = "READINGS",
        required_unless_present = "history",
        requires = "calibration"
    )]
    pub readings: Option<PathBuf>,
    /// calibration.json of verify or fit-gpr
    #[arg(long, value_name = "FILE", requires = "readings")]
    pub calibration: Option<PathBuf>,
    /// Take the zero from the unloaded readings of READINGS, at stimulus 0
    ///
    /// A zero that shifted since the calibration then counts as no change.
    #[arg(long, requires = "readings")]
    pub tare: bool,
    /// Folder with calibrations of one unit, in it or one folder below: their drift
    #[arg(long, value_name = "DIR", conflicts_with = "readings")]
    pub history: Option<PathBuf>,
    /// Folder for the page of --history: a control chart of each quantity
    #[arg(long, value_name = "OUT", requires = "history")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// How an earlier page of a history is distinguished.
const RESULT: ResultKind<'_> = ResultKind {
    command: "check --history",
    document: "history.json",
    format_prefix: "wcal-history/",
    files: &["report.html"],
    kept: &[],
    resumes: false,
    made_of: |_| None,
};

/// The answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
enum Answer {
    /// Nothing changed that these readings would show.
    Ok,
    /// Something changed.
    Degraded,
    /// Its time is over.
    Expired,
    /// It is of another kind of instrument, or of other units.
    Mismatch,
    /// The readings are too few to show a change that matters.
    NotTested,
}

impl Answer {
    fn words(self) -> &'static str {
        match self {
            Self::Ok => "OK",
            Self::Degraded => "DEGRADED",
            Self::Expired => "EXPIRED",
            Self::Mismatch => "MISMATCH",
            Self::NotTested => "NOT TESTED",
        }
    }
}

/// What `wcal check` found.
#[derive(Serialize, JsonSchema)]
pub(crate) struct CalibrationCheckDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-calibration-check/1"))]
    format: &'static str,
    /// The calibration or the readings are not measured.
    simulated: bool,
    /// The answer.
    answer: Answer,
    /// In words.
    why: &'a str,
    /// Calibration.
    calibration: &'a Path,
    /// Readings.
    readings: &'a Path,
    /// What the readings say of what changed; null of a map.
    check: Option<&'a CalibrationCheck>,
    /// What a session says of a map; null of the others.
    judgement: Option<&'a CalibrationJudgement>,
}

/// Runs the command.
///
/// # Errors
/// Files that cannot be read, or readings that the calibration cannot be applied to.
pub(crate) fn run(args: &CheckArgs) -> Result<ExitCode> {
    if let Some(folder) = &args.history {
        return of_history(folder, args);
    }
    let (Some(readings), Some(calibration)) = (&args.readings, &args.calibration) else {
        bail!("expected READINGS and --calibration FILE, or --history DIR");
    };
    let file = read_calibration(calibration)?;
    let issues = trust_issues(&file, jiff::Timestamp::now())?;
    let mut found = match &file.model {
        CalibrationModel::Scalar(model) => {
            of_scalar(model, &file.provenance, (readings, args.tare))?
        }
        _ if args.tare => {
            bail!(
                "--tare: expected the calibration of a transducer or an axis, found a whisker's (its session has readings at rest)"
            )
        }
        model => of_whisker(model, &file.provenance, readings, calibration)?,
    };
    if let Some(issue) = issues.first() {
        let answer = match issue {
            TrustIssue::Expired(_) => Answer::Expired,
            _ => Answer::Degraded,
        };
        // What the readings say stands behind it.
        found.why = format!(
            "{issue}; its readings: {}, {}",
            found.answer.words(),
            found.why
        );
        found.answer = answer;
    }
    let simulated = file.provenance.simulated || is_simulated(readings);
    if args.json {
        let document = CalibrationCheckDocument {
            format: "wcal-calibration-check/1",
            simulated,
            answer: found.answer,
            why: &found.why,
            calibration,
            readings,
            check: found.check.as_ref(),
            judgement: found.judgement.as_ref(),
        };
        println!("{}", serde_json::to_string_pretty(&document)?);
    } else {
        println!("{}{}: {}", found.answer.words(), word(simulated), found.why);
        found.lines.iter().for_each(|line| println!("  {line}"));
    }
    Ok(ExitCode::from(match found.answer {
        Answer::Ok => 0,
        _ => 4,
    }))
}

/// An answer with what it rests on.
struct Found {
    answer: Answer,
    why: String,
    lines: Vec<String>,
    check: Option<CalibrationCheck>,
    judgement: Option<CalibrationJudgement>,
}

impl Found {
    fn new(answer: Answer, why: String) -> Self {
        Self {
            answer,
            why,
            lines: Vec::new(),
            check: None,
            judgement: None,
        }
    }
}

/// What it was fitted to agrees with it whatever happened since.
fn own(readings: &Path) -> anyhow::Error {
    anyhow!(
        "{}: expected readings that the calibration was not fitted to, found its own",
        readings.display()
    )
}

/// A transducer's or axis' calibration by new readings.
fn of_scalar(
    model: &ScalarModel,
    made: &Provenance,
    (readings, tare): (&Path, bool),
) -> Result<Found> {
    let table = match readings.is_dir() {
        true => readings.join("points.csv"),
        false => readings.to_owned(),
    };
    let hash = sha256_hex(&wcal_core::files::read(&table)?);
    let is_fitted = |i: &InputFile| i.sha256 == hash && i.purpose != Purpose::Holdout;
    if made.inputs.iter().any(is_fitted) {
        return Err(own(&table));
    }
    let rows = match rows_to_check(model, readings) {
        Err(e) if e.is_mismatch() => return Ok(Found::new(Answer::Mismatch, e.to_string())),
        // Columns that are missing may be those of another kind of instrument.
        Err(e) => {
            let found = kind_of_table(readings).filter(|kind| *kind != model.session_kind);
            let Some(found) = found else {
                return Err(e.into());
            };
            let expected = &model.session_kind;
            let why =
                format!("expected readings of kind {expected}, found a table of kind {found}: {e}");
            return Ok(Found::new(Answer::Mismatch, why));
        }
        Ok(rows) => rows,
    };
    let [low, high] = model.stimulus_range;
    if !rows.iter().any(|r| (low..=high).contains(&r.x)) {
        let why = format!(
            "none of {} readings lies within the calibrated {} to {}",
            rows.len(),
            number(low, 6),
            with_unit(&number(high, 6), &model.stimulus_unit)
        );
        return Ok(Found::new(Answer::Mismatch, why));
    }
    let check = model.check_readings(&rows, tare);
    Ok(of_check(
        check.with_context(|| readings.display().to_string())?,
    ))
}

fn of_check(check: CalibrationCheck) -> Found {
    let unit = check.unit.clone();
    let sized = |size: f64| with_unit(&number(size, 3), &unit);
    let change = |c: &CalibrationChange| {
        // Shares read better in percent.
        let (times, unit) = match c.unit.as_str() {
            "1" => (100.0, "%"),
            unit => (1.0, unit),
        };
        let [value, low, high] =
            [c.value, c.interval95[0], c.interval95[1]].map(|v| number(times * v, 3));
        let size = with_unit(&format!("{value} [{low}, {high}]"), unit);
        let sized = format!("{size}, which costs {}", sized(c.cost));
        match &c.or[..] {
            [] => format!("{} changed by {sized}", c.name),
            or => format!(
                "{} or {}: cannot be told apart on these readings ({} by {sized})",
                c.name,
                or.join(" or "),
                c.name
            ),
        }
    };
    let untested: Vec<&Tested> = check.tested.iter().filter(|t| !t.is_tested).collect();
    let needed = |t: &&Tested| {
        let more = t.readings_needed.map_or_else(
            || "; no number of readings shows less".to_owned(),
            |n| format!("; {n} readings would do"),
        );
        match t.smallest {
            Some(smallest) => format!(
                "{}: a change below {} would not be seen{more}",
                t.name,
                sized(smallest)
            ),
            None => format!("{}: these readings show none of its changes", t.name),
        }
    };
    let tared = |t: &TaredZero| {
        format!(
            "tare: the zero is that of {} unloaded readings, {} from the calibration's, and is not tested; subtract it from readings before predict",
            t.readings,
            with_unit(&number(t.zero, 3), &t.unit)
        )
    };
    let lines: Vec<String> = check
        .tare
        .iter()
        .map(tared)
        .chain(untested.iter().map(needed))
        .collect();
    let stated = sized(check.stated);
    let (answer, why) = match &check.changes[..] {
        [] if !check.is_tested() => (
            Answer::NotTested,
            format!(
                "{} readings are too few to show a change as large as the stated {stated}",
                check.readings
            ),
        ),
        [] => (
            Answer::Ok,
            format!(
                "{} readings show no change ({}); one as large as the stated {stated} would be seen",
                check.readings,
                chance(check.p)
            ),
        ),
        changes => {
            let changes: Vec<String> = changes.iter().map(change).collect();
            (
                Answer::Degraded,
                format!("{} readings: {}", check.readings, changes.join("; ")),
            )
        }
    };
    Found {
        lines,
        check: Some(check),
        ..Found::new(answer, why)
    }
}

/// A whisker's calibration, by a session with its poses. A map says only whether it holds.
fn of_whisker(
    model: &CalibrationModel,
    made: &Provenance,
    readings: &Path,
    calibration: &Path,
) -> Result<Found> {
    if readings.is_file() && !readings.ends_with("session.toml") {
        let why = "a whisker's calibration is checked by a session with its poses, found a table";
        return Ok(Found::new(Answer::Mismatch, why.to_owned()));
    }
    expect_session(readings, "check")?;
    let session = load(readings)?;
    let Ok(data) = session.whisker() else {
        let why = format!("expected a session of kind whisker, found {}", session.kind);
        return Ok(Found::new(Answer::Mismatch, why));
    };
    let fitted = |i: &InputFile| i.purpose == Purpose::Fit && made.inputs.contains(i);
    if session.inputs.iter().any(fitted) {
        return Err(own(readings));
    }
    if let CalibrationModel::Physical(model) = model {
        let why = "none of the readings lies within the calibrated moments, at a pose that the wire can hold";
        return Ok(match model.check_session(data)? {
            Some(check) => of_check(check),
            None => Found::new(Answer::Mismatch, why.to_owned()),
        });
    }
    let given = GivenCalibration::read(calibration, &session)?;
    let system = WhiskerSystem::new(data, &[])?;
    let judgement = given.judge(SessionSystem::Whisker(&system))?;
    let answer = match judgement.holds {
        true => Answer::Ok,
        false => Answer::Degraded,
    };
    Ok(Found {
        judgement: Some(judgement.clone()),
        ..Found::new(
            answer,
            format!("{} readings: {}", judgement.error.points, judgement.why),
        )
    })
}

/// Drift of one unit over its calibrations, and its page.
fn of_history(folder: &Path, args: &CheckArgs) -> Result<ExitCode> {
    let out = args.out.as_ref();
    let out = out.map(|out| OutputFolder::open(&RESULT, out, args.overwrite.force));
    let out = out.transpose()?;
    let history: CalibrationHistory = history(folder)?;
    let json = serde_json::to_string_pretty(&history)?;
    if let Some(mut out) = out {
        out.put("report.html", history_page(folder, &history));
        out.put("history.json", json.clone());
        out.finish()?;
    }
    if args.json {
        println!("{json}");
    } else {
        history.lines().iter().for_each(|line| println!("{line}"));
    }
    Ok(match history.holds() {
        true => ExitCode::SUCCESS,
        false => ExitCode::from(4),
    })
}

/// A control chart of each quantity.
fn history_page(folder: &Path, history: &CalibrationHistory) -> String {
    let value = |quantity: &str, e: &HistoryEntry| match quantity {
        "sensitivity" => Some(e.sensitivity),
        _ => e.zero,
    };
    let chart = |q: &QuantityHistory| {
        let entries = history.entries.iter();
        let values: Vec<[f64; 2]> = entries.filter_map(|e| value(&q.quantity, e)).collect();
        let last = values.last().map(|v| v[0]);
        HistoryChart {
            quantity: format!("{} ({})", q.quantity, q.unit),
            limits: last.zip(q.limit).map(|(v, limit)| [v - limit, v + limit]),
            drift: q
                .at_first
                .zip(q.per_month)
                .map(|(first, [a_month, ..])| [first, a_month]),
            values,
        }
    };
    let date = |e: &HistoryEntry| (e.created[..10.min(e.created.len())].to_owned(), e.months);
    let by = history.recalibrate_by.clone();
    let [name, last] = ["recalibrate by", "last calibration"].map(str::to_owned);
    let made = history.entries.last().map(|e| date(e).0);
    let facts = [(name, by), (last, made)].into_iter();
    let folder = std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let title = folder
        .file_name()
        .map(|name| name.to_string_lossy().into_owned());
    render_history(&HistoryInput {
        title: title.unwrap_or_default(),
        simulated: history.simulated,
        facts: facts
            .filter_map(|(name, value)| {
                Some(Fact {
                    name,
                    value: value?,
                })
            })
            .collect(),
        dates: history.entries.iter().map(date).collect(),
        until: history.recalibrate_month,
        charts: history.quantities.iter().map(chart).collect(),
    })
}
