//! `wcal import`: a foreign table becomes a session.

mod columns;
mod description;
mod sweep;

use crate::output::{OutputFolder, Overwrite, ResultKind, first_line};
use crate::simulated::word;
use anyhow::Context;
use clap::{Args, ValueEnum};
use columns::Plan;
use schemars::JsonSchema;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use wcal_core::{InputFile, TransducerModel};
use wcal_session::{Separator, SessionFiles, TextTable, TextTableLayout, read_text_table, write_session};

/// Arguments of `wcal import`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal import cell.csv --kind transducer --stimulus load --response out --model linear --out cell
  wcal import stage.csv --kind axis --commanded cmd_mm --measured 'laser_um*0.001' --out axis-x

'COL*FACTOR' multiplies a column. Errors of an axis in place of positions: --covariate error_um=COL (or error_mm, error_in).
A file SIMULATED beside the table marks all that is made of it.")]
pub struct ImportArgs {
    /// Table to import (CSV, or text in columns)
    pub file: PathBuf,
    /// transducer, axis, whisker (in a V-groove) or sweep (past an object)
    #[arg(long, value_enum, hide_possible_values = true)]
    pub kind: Kind,
    /// Folder of the new session
    #[arg(long, value_name = "SESSION")]
    pub out: PathBuf,
    /// Overwrite unrelated files
    #[command(flatten)]
    pub overwrite: Overwrite,
    /// Log with t_s and base_x_mm .. base_z_mm, or object_x_mm .. (sweep)
    #[arg(long, value_name = "LOG", required_if_eq("kind", "sweep"))]
    pub motion: Option<PathBuf>,
    /// Mesh of the object (sweep)
    #[arg(long, value_name = "STL")]
    pub object: Option<PathBuf>,
    /// X,Y,Z (mm),QW,QX,QY,QZ of the mesh in the frame of the base's poses
    #[arg(long, value_name = "POSE", value_delimiter = ',', allow_hyphen_values = true)]
    pub object_pose: Option<Vec<f64>>,
    /// Table of sealed readings with the same layout
    #[arg(long, value_name = "FILE")]
    pub holdout: Option<PathBuf>,

    /// Column of the stimulus (transducer); --model constant does without
    #[arg(long, value_name = "COL")]
    pub stimulus: Option<String>,
    /// Column of the response (transducer)
    #[arg(long, value_name = "COL", required_if_eq("kind", "transducer"))]
    pub response: Option<String>,
    /// constant, linear, quadratic (transducer), or WHISKER.toml (whisker)
    #[arg(long, value_name = "MODEL", value_parser = declared, required_if_eq_any([("kind", "transducer"), ("kind", "whisker")]))]
    pub model: Option<Declared>,
    /// Unit of the stimulus (transducer)
    #[arg(long, value_name = "UNIT", default_value = "1")]
    pub stimulus_unit: String,
    /// Unit of the response (transducer)
    #[arg(long, value_name = "UNIT", default_value = "1")]
    pub response_unit: String,
    /// Further column, with its name in the session; may be repeated
    #[arg(long = "covariate", value_name = "NAME=COL")]
    pub covariates: Vec<String>,
    /// Column of the commanded position (axis)
    #[arg(long, value_name = "COL", required_if_eq("kind", "axis"))]
    pub commanded: Option<String>,
    /// Column of the measured position (axis)
    #[arg(long, value_name = "COL")]
    pub measured: Option<String>,

    /// Column of the time, s
    #[arg(long, value_name = "COL")]
    pub time: Option<String>,
    /// Column of the direction, +1 or -1
    #[arg(long, value_name = "COL")]
    pub direction: Option<String>,
    /// Column of the temperature, deg C
    #[arg(long, value_name = "COL")]
    pub temperature: Option<String>,
    /// Column of the cycle (axis)
    #[arg(long, value_name = "COL")]
    pub cycle: Option<String>,
    /// Column of the repetition; of an axis it is the cycle
    #[arg(long, value_name = "COL")]
    pub replicate: Option<String>,
    /// Column of the role [default: every row is "calibration"]
    #[arg(long, value_name = "COL")]
    pub role: Option<String>,

    /// Lines before the table (NIST Dataplot 25, StRD 60)
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub skip_lines: usize,
    /// Names of the columns, where there is no header line
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub columns: Option<Vec<String>>,
    /// comma, semicolon, tab or whitespace
    #[arg(long, value_name = "SEPARATOR", default_value = "comma")]
    pub separator: Separator,
    /// Short for --separator whitespace
    #[arg(long, conflicts_with = "separator")]
    pub whitespace: bool,
    /// Decimals are written with a comma
    #[arg(long)]
    pub decimal_comma: bool,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Kind of session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// One stimulus, one response.
    Transducer,
    /// Commanded against measured position.
    Axis,
    /// Whisker pressed by a V-groove.
    Whisker,
    /// Whisker passing an object along a known motion.
    Sweep,
}

/// What is declared of the instrument.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Declared {
    /// Law of a transducer.
    Law(TransducerModel),
    /// File that describes a whisker.
    Whisker(PathBuf),
}

fn declared(text: &str) -> Result<Declared, String> {
    if text.ends_with(".toml") {
        return Ok(Declared::Whisker(text.into()));
    }
    let law: Result<TransducerModel, toml::de::Error> = toml::Value::from(text).try_into();
    law.map(Declared::Law)
        .map_err(|_| format!("expected constant, linear, quadratic, or a file WHISKER.toml, found {text}"))
}

fn name_of(value: impl ValueEnum) -> String {
    value.to_possible_value().map(|v| v.get_name().to_owned()).unwrap_or_default()
}

/// An imported session: its description says which command made it.
const RESULT: ResultKind<'_> = ResultKind {
    command: "import",
    document: "session.toml",
    format_prefix: "command = [\"import\"",
    files: &["points.csv", "holdout.csv", "rest_shape.csv", sweep::OBJECT],
    kept: &["unsealed.json"],
    resumes: false,
    made_of,
};

/// The tables that an imported session was made of, and its columns.
fn made_of(folder: &Path) -> Option<String> {
    let names = earlier_inputs(folder)?.into_iter().map(|(name, _)| name).collect::<Vec<_>>().join(", ");
    let columns = first_line(&folder.join("points.csv")).unwrap_or_default();
    Some(described(&names, &columns))
}

fn described(tables: &str, columns: &str) -> String {
    format!("{tables} with the columns {columns}")
}

/// Name and hash of each table that an imported session was made of.
fn earlier_inputs(folder: &Path) -> Option<Vec<(String, String)>> {
    let text = wcal_core::files::read_text(folder.join("session.toml")).ok()?;
    let table = wcal_core::document::toml(&text).ok()?;
    let inputs = table.get("provenance")?.get("inputs")?.as_array()?;
    let text = |input: &toml::Value, key: &str| Some(input.get(key)?.as_str()?.to_owned());
    inputs.iter().map(|input| Some((text(input, "path")?, text(input, "sha256")?))).collect()
}

/// Refuses to replace the session of other tables. The same table may be imported again with other options, and a later state of it with the
/// same columns.
fn refuse_other_tables(out: &OutputFolder<'_>, tables: &[&TextTable], points: &[u8]) -> anyhow::Result<()> {
    let earlier = earlier_inputs(out.folder()).unwrap_or_default();
    // The first is the table of the points; a holdout may be added or left out.
    if earlier.first().zip(tables.first()).is_some_and(|((_, sha256), table)| *sha256 == table.sha256) {
        return Ok(());
    }
    let name = |table: &&TextTable| {
        let file = Path::new(&table.file).file_name();
        file.map_or_else(|| table.file.clone(), |n| n.to_string_lossy().into_owned())
    };
    let names = tables.iter().map(name).collect::<Vec<_>>().join(", ");
    let columns = String::from_utf8_lossy(points).lines().next().unwrap_or_default().to_owned();
    out.refuse_other(&described(&names, &columns))
}

/// Runs the command: exit code 0, or 3 where the new session carries warnings.
///
/// # Errors
/// Where the table or the resulting session cannot be used; nothing is written then.
pub fn run(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    if args.kind == Kind::Sweep {
        return sweep::run(args);
    }
    let mut out = OutputFolder::open(&RESULT, &args.out, args.overwrite.force)?;
    let layout = layout(args);
    let table = read_text_table(&args.file, &layout)?;
    let plan = Plan::new(args, &table)?;
    let mut files = SessionFiles::default();
    files.tables.push(("points.csv".to_owned(), plan.csv(&table)?));
    let mut columns_left_out = plan.left_out(&table);
    let mut sources = vec![&table];
    let holdout = args.holdout.as_deref().map(|path| read_text_table(path, &layout)).transpose()?;
    if let Some(holdout) = &holdout {
        let plan = Plan::new(args, holdout)?;
        files.tables.push(("holdout.csv".to_owned(), plan.csv(holdout)?));
        let more = plan.left_out(holdout);
        columns_left_out.extend(more.into_iter().filter(|name| !table.columns.contains(name)));
        sources.push(holdout);
    }
    refuse_other_tables(&out, &sources, &files.tables[0].1)?;
    let (text, more) = description::write(args, &sources)?;
    files.session_toml = text;
    files.tables.extend(more);
    // Every check on a copy first.
    let trial = tempfile::tempdir().context("making a folder to check the session in")?;
    let session = write_session(&trial.path().join("session"), &files)
        .with_context(|| format!("importing {} as a session", args.file.display()))?;
    for (name, bytes) in files.tables {
        out.put(&name, bytes);
    }
    out.put("session.toml", files.session_toml);
    out.finish()?;
    let document = ImportDocument {
        format: "wcal-import/1",
        session: session.id,
        kind: name_of(args.kind),
        folder: &args.out,
        simulated: session.simulated,
        rows: table.rows.len(),
        holdout_rows: holdout.as_ref().map_or(0, |h| h.rows.len()),
        columns_left_out,
        warnings: session.warnings.iter().map(ToString::to_string).chain(plan.repeated).collect(),
        inputs: session.inputs,
    };
    say(args, &document, &sources)
}

/// Says what was imported, and what was odd about it; exit code 3 where the new session carries warnings.
fn say(args: &ImportArgs, document: &ImportDocument<'_>, sources: &[&TextTable]) -> anyhow::Result<ExitCode> {
    let ImportDocument { session, kind, rows, warnings, columns_left_out, .. } = document;
    if args.json {
        println!("{}", serde_json::to_string_pretty(document)?);
    } else {
        let what = if kind == "sweep" { "sweep" } else { "session" };
        println!("{}: {rows} rows, {what} {session:?}{}", args.out.display(), word(document.simulated));
    }
    // Of the tables that were given: those of the session end as they should.
    for remark in sources.iter().filter_map(|table| table.warning()) {
        eprintln!("{remark}");
    }
    for (source, encoding) in sources.iter().filter_map(|s| Some((s, s.encoding?))) {
        eprintln!("{}: read as {encoding}", source.file);
    }
    if !columns_left_out.is_empty() {
        let way_in = if kind == "sweep" { "" } else { columns::WAY_IN };
        eprintln!("columns not imported: {}{way_in}", columns_left_out.join(", "));
    }
    for warning in warnings {
        eprintln!("warning: {warning}");
    }
    Ok(ExitCode::from(if warnings.is_empty() { 0 } else { 3 }))
}

/// A table that became a session.
#[derive(Serialize, JsonSchema)]
pub struct ImportDocument<'a> {
    /// Format and version.
    #[schemars(extend("const" = "wcal-import/1"))]
    format: &'static str,
    /// Identifier.
    session: String,
    /// Kind.
    #[schemars(extend("enum" = ["whisker", "transducer", "axis", "sweep"]))]
    kind: String,
    /// Folder.
    folder: &'a Path,
    /// Marked as simulated.
    simulated: bool,
    /// Rows.
    rows: usize,
    /// Sealed rows.
    holdout_rows: usize,
    /// Columns of the table that the session does not have.
    columns_left_out: Vec<String>,
    /// Remarks.
    warnings: Vec<String>,
    /// Files written; none of a sweep.
    inputs: Vec<InputFile>,
}

fn layout(args: &ImportArgs) -> TextTableLayout {
    let separator = if args.whitespace { Separator::Whitespace } else { args.separator };
    let (columns, skip_lines) = (args.columns.clone(), args.skip_lines);
    TextTableLayout { skip_lines, columns, separator, decimal_comma: args.decimal_comma }
}
