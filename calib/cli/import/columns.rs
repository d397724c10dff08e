//! Column mapping: cells of the foreign table under the session's names.

use super::{ImportArgs, Kind, Model};
use anyhow::{Context, bail, ensure};
use std::collections::BTreeMap;
use wcal_session::{TextTable, WHISKER_COLUMNS};

/// Columns of the other kinds that are taken along wherever a table has them under these names.
const SCALAR_COLUMNS: &[&str] = &["t_s", "direction", "temperature_degc", "replicate", "cycle"];

/// Columns whose cells are not numbers.
const TEXT_COLUMNS: &[&str] = &["role"];

/// Where a column of the session comes from.
enum Source {
    /// A column of the foreign table, times a factor where one was given.
    Column { index: usize, factor: Option<f64> },
    /// A commanded position and the error of the measured one, each times a factor: their sum.
    Position { commanded: (usize, f64), error: (usize, f64) },
    /// Number of the row, from 1.
    Order,
    /// The role "calibration".
    Calibration,
}

/// The session's table as CSV.
///
/// # Errors
/// Where a column is missing, a mapping is malformed, or a cell is not what its column needs.
pub(super) fn convert(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<u8>> {
    let plan = plan(args, table)?;
    for (name, source) in &plan {
        if let Source::Column { index, .. } = source
            && !TEXT_COLUMNS.contains(&name.as_str())
        {
            table.check_thousands(*index)?;
        }
    }
    let mut out = plan.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(",");
    out.push('\n');
    for row in 0..table.rows.len() {
        for (position, (name, source)) in plan.iter().enumerate() {
            if position > 0 {
                out.push(',');
            }
            match source {
                Source::Order => out.push_str(&(row + 1).to_string()),
                Source::Calibration => out.push_str("calibration"),
                Source::Position { commanded, error } => {
                    let [commanded, error] = [commanded, error]
                        .map(|(index, factor)| table.number(row, *index).map(|value| Some(value? * factor)));
                    if let (Some(commanded), Some(error)) = (commanded?, error?) {
                        out.push_str(&format!("{}", commanded + error));
                    }
                }
                Source::Column { index, .. } if TEXT_COLUMNS.contains(&name.as_str()) => {
                    let text = table.rows[row].1[*index].trim();
                    ensure!(!text.contains([',', '"', '\n']), "{}: role {text:?} is not a word", table.file);
                    out.push_str(text);
                }
                Source::Column { index, factor } => {
                    // `{}` prints the shortest text that reads back as the same number: nothing is lost.
                    if let Some(value) = table.number(row, *index)? {
                        out.push_str(&format!("{}", value * factor.unwrap_or(1.0)));
                    }
                }
            }
        }
        out.push('\n');
    }
    Ok(out.into_bytes())
}

/// Columns of the foreign table that the session does not have, in their order.
///
/// # Errors
/// As [`convert`].
pub(super) fn left_out(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<String>> {
    let taken: Vec<usize> = plan(args, table)?
        .iter()
        .flat_map(|(_, source)| match source {
            Source::Column { index, .. } => vec![*index],
            Source::Position { commanded, error } => vec![commanded.0, error.0],
            Source::Order | Source::Calibration => Vec::new(),
        })
        .collect();
    let left = table.columns.iter().enumerate().filter(|(k, _)| !taken.contains(k));
    Ok(left.map(|(_, name)| name.clone()).collect())
}

/// The option that takes a further column.
pub(super) fn way_in(kind: Kind) -> &'static str {
    match kind {
        Kind::Transducer => "--covariate COLUMN takes one of numbers as what else may matter",
        Kind::Axis | Kind::Whisker | Kind::Sweep | Kind::WhiskerfbgSweep => {
            "--map NAME=COLUMN takes one under its name in the session"
        }
    }
}

fn plan(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<(String, Source)>> {
    let wanted = wanted(args, table)?;
    let mut factors = BTreeMap::new();
    for text in &args.scale {
        let (name, factor) = pair("scale", text)?;
        let value: f64 =
            factor.parse().with_context(|| format!("--scale {text}: expected a number, found {factor:?}"))?;
        ensure!(value.is_finite() && value != 0.0, "--scale {text}: expected a finite factor other than 0");
        ensure!(
            wanted.iter().any(|(n, _)| n == name),
            "--scale {text}: {name} is not among the imported columns"
        );
        factors.insert(name.to_owned(), value);
    }
    let mut plan = Vec::new();
    for (name, fallback) in [("point", Source::Order), ("role", Source::Calibration)] {
        if !wanted.iter().any(|(n, _)| n == name) {
            plan.push((name.to_owned(), fallback));
        }
    }
    if args.kind == Kind::Transducer && args.stimulus.is_none() {
        ensure!(
            args.model == Some(Model::Constant),
            "--stimulus is missing: expected the column of the stimulus (only --model constant does without)"
        );
        plan.push(("stimulus".to_owned(), Source::Order));
    }
    let commanded = wanted.iter().find(|(name, _)| name == "commanded_mm").cloned();
    for (name, column) in wanted {
        let (index, factor) = (table.column(&column)?, factors.get(&name).copied());
        let source = match &commanded {
            Some((_, place)) if name == "measured_mm" && args.error.is_some() => Source::Position {
                commanded: (table.column(place)?, factors.get("commanded_mm").copied().unwrap_or(1.0)),
                error: (index, args.error_unit.mm() * factor.unwrap_or(1.0)),
            },
            _ => Source::Column { index, factor },
        };
        plan.push((name, source));
    }
    Ok(plan)
}

/// Columns that stand in the table more than once, with the same cells, in words.
///
/// # Errors
/// As [`convert`].
pub(super) fn repeated(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<String>> {
    let wanted = wanted(args, table)?;
    let again = |(_, column): &(String, String)| {
        let count = table.columns_named(column).len();
        (count > 1).then(|| {
            format!("{}: {count} columns named {column} with the same cells; counted once", table.file)
        })
    };
    Ok(wanted.iter().filter_map(again).collect())
}

/// Name in the session and name in the foreign table of every column to import.
fn wanted(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<(String, String)>> {
    // Of an axis the repetition of a stroke is its cycle.
    let axis = args.kind == Kind::Axis;
    ensure!(
        !(axis && args.cycle.is_some() && args.replicate.is_some()),
        "--replicate: expected --cycle or --replicate for an axis (the repetition of a stroke is its cycle), found both"
    );
    ensure!(
        !axis
            || args.measured.is_some()
            || args.error.is_some()
            || args.map.iter().any(|m| m.starts_with("measured_mm=")),
        "--measured: expected the column of the measured position, or of its error (--error), found neither"
    );
    let (cycle, replicate) = if axis {
        (args.cycle.clone().or_else(|| args.replicate.clone()), None)
    } else if args.kind == Kind::Transducer {
        // The cycle of a transducer is its repetition: readings of one are left out together, and it is no quantity that acts.
        (None, args.replicate.clone().or_else(|| args.cycle.clone()))
    } else {
        (args.cycle.clone(), args.replicate.clone())
    };
    let flags = [
        ("point", &args.point),
        ("role", &args.role),
        ("stimulus", &args.stimulus),
        ("response", &args.response),
        ("commanded_mm", &args.commanded),
        ("measured_mm", if axis && args.error.is_some() { &args.error } else { &args.measured }),
        ("t_s", &args.time),
        ("direction", &args.direction),
        ("temperature_degc", &args.temperature),
        ("cycle", &cycle),
        ("replicate", &replicate),
    ];
    let given = flags.iter().filter_map(|(name, column)| Some(((*name).to_owned(), (*column).clone()?)));
    let mut wanted: Vec<(String, String)> = given.collect();
    for text in &args.covariates {
        let (name, column) = text.split_once('=').unwrap_or((text, text));
        wanted.push((name.to_owned(), column.to_owned()));
    }
    for text in &args.map {
        let (name, column) = pair("map", text)?;
        wanted.push((name.to_owned(), column.to_owned()));
    }
    let known: &[&str] = if args.kind == Kind::Whisker { &WHISKER_COLUMNS } else { SCALAR_COLUMNS };
    for name in known {
        let here = table.columns.iter().any(|c| c == name);
        if here && !wanted.iter().any(|(n, c)| n == name || c == name) {
            wanted.push(((*name).to_owned(), (*name).to_owned()));
        }
    }
    for (position, (name, _)) in wanted.iter().enumerate() {
        if wanted[..position].iter().any(|(n, _)| n == name) {
            bail!("column {name} of the session is given twice");
        }
        ensure!(
            !name.is_empty() && !name.contains([',', '"', '\n', ';']),
            "{name:?} cannot name a column: expected letters, digits and _"
        );
    }
    Ok(wanted)
}

/// `NAME=VALUE`, split.
fn pair<'a>(flag: &str, text: &'a str) -> anyhow::Result<(&'a str, &'a str)> {
    text.split_once('=').with_context(|| format!("--{flag} {text}: expected NAME=VALUE, found no \"=\""))
}
