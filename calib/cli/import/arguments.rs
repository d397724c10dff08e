//! What `wcal import` is asked.

use crate::output::Overwrite;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use wcal_core::TransducerModel;
use wcal_session::{Separator, TextTableLayout, WHISKER_COLUMNS, asked_name, column_name};

/// Columns of a sweep that tell its header.
const SWEEP_COLUMNS: [&str; 3] = ["t_s", "fbg_1_nm", "fbg_2_nm"];

/// Arguments of `wcal import`.
#[derive(Debug, Args)]
#[command(after_help = "Examples:
  wcal import cell.csv --kind transducer --stimulus load --response out --model linear --out cell
  wcal import stage.csv --kind axis --commanded cmd_mm --measured 'laser_um*0.001' --out axis-x
  wcal import bench.csv --kind whisker --model rig.toml \\
      --covariate groove_x_mm=object_x --covariate groove_y_mm=object_y --covariate groove_z_mm=object_z --out whisker

'COL*FACTOR' multiplies a column; 'column 3' is one without a name.
A file SIMULATED beside the table marks all that is made of it.")]
pub(crate) struct ImportArgs {
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
    /// Table of sealed readings with the same layout
    #[arg(long, value_name = "FILE")]
    pub holdout: Option<PathBuf>,

    /// Column of the stimulus
    ///
    /// --model constant does without.
    #[arg(help_heading = "Transducer", long, value_name = "COL")]
    pub stimulus: Option<String>,
    /// Column of the stimulus' standard uncertainties
    ///
    /// Each weighs its reading; COL*0.5 of expanded ones with k = 2.
    #[arg(
        help_heading = "Transducer",
        long,
        value_name = "COL",
        requires = "stimulus"
    )]
    pub stimulus_sd: Option<String>,
    /// Standard uncertainty of the reference, in the unit of the stimulus
    ///
    /// Common to all readings: it weighs none, and is a part of every stated U.
    #[arg(
        help_heading = "Transducer",
        long,
        value_name = "SD",
        value_parser = not_negative,
        requires = "stimulus"
    )]
    pub reference_sd: Option<f64>,
    /// Column of the response
    #[arg(
        help_heading = "Transducer",
        long,
        value_name = "COL",
        required_if_eq("kind", "transducer")
    )]
    pub response: Option<String>,
    /// constant, linear, quadratic, or WHISKER.toml of a whisker
    #[arg(long, value_name = "MODEL", value_parser = declared, required_if_eq_any([("kind", "transducer"), ("kind", "whisker")]))]
    pub model: Option<Declared>,
    /// Unit of the stimulus [default: of the table, else 1]
    #[arg(help_heading = "Transducer", long, value_name = "UNIT")]
    pub stimulus_unit: Option<String>,
    /// Unit of the response [default: of the table, else 1]
    #[arg(help_heading = "Transducer", long, value_name = "UNIT")]
    pub response_unit: Option<String>,
    /// Further column and its name in the session
    ///
    /// May be repeated; COL alone keeps its name. Errors of an axis in place of positions:
    /// error_um=COL (or error_mm, error_in).
    #[arg(
        help_heading = "Further columns",
        long = "covariate",
        value_name = "NAME=COL"
    )]
    pub covariates: Vec<String>,
    /// Column of the commanded position
    #[arg(
        help_heading = "Axis",
        long,
        value_name = "COL",
        required_if_eq("kind", "axis")
    )]
    pub commanded: Option<String>,
    /// Column of the measured position
    #[arg(help_heading = "Axis", long, value_name = "COL")]
    pub measured: Option<String>,

    /// Column of the time
    ///
    /// In s, another unit that it names, or time stamps; where date and clock have columns of their
    /// own, either of them. 'COL since STAMP' counts from another time stamp than the first.
    #[arg(help_heading = "Further columns", long, value_name = "COL")]
    pub time: Option<String>,
    /// Column of the direction: +1 or -1, + or -, up or down
    #[arg(help_heading = "Further columns", long, value_name = "COL")]
    pub direction: Option<String>,
    /// Column of the temperature, deg C
    #[arg(help_heading = "Further columns", long, value_name = "COL")]
    pub temperature: Option<String>,
    /// Column of the cycle (axis)
    #[arg(help_heading = "Further columns", long, value_name = "COL")]
    pub cycle: Option<String>,
    /// Column of the repetition; of an axis it is the cycle
    #[arg(help_heading = "Further columns", long, value_name = "COL")]
    pub replicate: Option<String>,
    /// Column of the role [default: every row is "calibration"]
    #[arg(help_heading = "Further columns", long, value_name = "COL")]
    pub role: Option<String>,

    /// Log with t_s and base_x_mm .. or object_x_mm ..
    #[arg(
        help_heading = "Sweep",
        long,
        value_name = "LOG",
        required_if_eq("kind", "sweep")
    )]
    pub motion: Option<PathBuf>,
    /// Mesh of the object: STL, OBJ or PLY
    #[arg(help_heading = "Sweep", long, value_name = "MESH")]
    pub object: Option<PathBuf>,
    /// Place of the mesh in the frame of the base's poses
    ///
    /// X,Y,Z in mm and the unit quaternion QW,QX,QY,QZ.
    #[arg(
        help_heading = "Sweep",
        long,
        value_name = "POSE",
        value_delimiter = ',',
        allow_hyphen_values = true
    )]
    pub object_pose: Option<Vec<f64>>,

    /// Lines before the table (NIST Dataplot 25, StRD 60)
    #[arg(
        help_heading = "Form of the table",
        long,
        value_name = "N",
        default_value_t = 0
    )]
    pub skip_lines: usize,
    /// Names of the columns, where there is no header line
    ///
    /// Without a name, a column of a header is called by its place: 'column 3'.
    #[arg(
        help_heading = "Form of the table",
        long,
        value_name = "NAMES",
        value_delimiter = ','
    )]
    pub columns: Option<Vec<String>>,
    /// comma, semicolon, tab or whitespace
    ///
    /// Default: what the file says, else the one by which a line has the columns that are asked
    /// for.
    #[arg(help_heading = "Form of the table", long, value_name = "SEPARATOR")]
    pub separator: Option<Separator>,
    /// Short for --separator whitespace
    #[arg(help_heading = "Form of the table", long, conflicts_with = "separator")]
    pub whitespace: bool,
    /// Decimals are written with a comma
    #[arg(help_heading = "Form of the table", long)]
    pub decimal_comma: bool,
    /// Sheet of a spreadsheet (.xlsx, .ods). Default: the one with the columns that are asked for
    #[arg(help_heading = "Form of the table", long, value_name = "NAME")]
    pub sheet: Option<String>,
    /// Print the result as JSON on stdout
    #[arg(long)]
    pub json: bool,
}

/// Kind of session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Kind {
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
pub(crate) enum Declared {
    /// Law of a transducer.
    Law(TransducerModel),
    /// File that describes a whisker.
    Whisker(PathBuf),
}

fn not_negative(text: &str) -> Result<f64, String> {
    let number = text.parse().ok();
    number
        .filter(|v: &f64| v.is_finite() && *v >= 0.0)
        .ok_or_else(|| "expected a number of 0 or more".to_owned())
}

fn declared(text: &str) -> Result<Declared, String> {
    if text.ends_with(".toml") {
        return Ok(Declared::Whisker(text.into()));
    }
    let law: Result<TransducerModel, toml::de::Error> = toml::Value::from(text).try_into();
    law.map(Declared::Law).map_err(|_| {
        format!("expected constant, linear, quadratic, or a file WHISKER.toml, found {text}")
    })
}

pub(super) fn name_of(value: impl ValueEnum) -> String {
    value
        .to_possible_value()
        .map(|v| v.get_name().to_owned())
        .unwrap_or_default()
}

/// How the table is laid out, and which of its columns are asked for.
pub(super) fn layout(args: &ImportArgs) -> TextTableLayout {
    let separator = if args.whitespace {
        Some(Separator::Whitespace)
    } else {
        args.separator
    };
    let mapped = args
        .covariates
        .iter()
        .map(|c| c.split_once('=').map_or(c.as_str(), |(_, column)| column));
    let named = [
        &args.stimulus,
        &args.stimulus_sd,
        &args.response,
        &args.commanded,
        &args.measured,
        &args.time,
        &args.direction,
        &args.temperature,
        &args.cycle,
        &args.replicate,
        &args.role,
    ];
    let named = named
        .into_iter()
        .flatten()
        .map(String::as_str)
        .chain(mapped);
    // Those that are taken along by their own names tell a header, too.
    let known: &[&str] = match args.kind {
        Kind::Transducer | Kind::Axis => &[],
        Kind::Whisker => &WHISKER_COLUMNS,
        Kind::Sweep => &SWEEP_COLUMNS,
    };
    let asked = named
        .flat_map(|column| [column, asked_name(column)])
        .chain(known.iter().copied());
    TextTableLayout {
        skip_lines: args.skip_lines,
        columns: args.columns.clone(),
        separator,
        decimal_comma: args.decimal_comma,
        asked: Some(asked.map(column_name).collect()),
        sheet: args.sheet.clone(),
    }
}
