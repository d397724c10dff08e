//! Column mapping: cells of the foreign table under the session's names.

use super::arguments::{Declared, ImportArgs, Kind};
use anyhow::{Context, bail, ensure};
use wcal_core::TransducerModel;
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

/// Where the columns of the session come from.
pub(super) struct Plan {
    columns: Vec<(String, Source)>,
    /// Columns that stand in the table more than once, with the same cells, in words.
    pub(super) repeated: Vec<String>,
}

impl Plan {
    /// The session's table as CSV.
    ///
    /// # Errors
    /// Where a cell is not what its column needs.
    pub(super) fn csv(&self, table: &TextTable) -> anyhow::Result<Vec<u8>> {
        for (name, source) in &self.columns {
            if let Source::Column { index, .. } = source
                && !TEXT_COLUMNS.contains(&name.as_str())
            {
                table.check_thousands(*index)?;
            }
        }
        let mut out = self.columns.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(",");
        out.push('\n');
        for row in 0..table.rows.len() {
            for (position, (name, source)) in self.columns.iter().enumerate() {
                if position > 0 {
                    out.push(',');
                }
                match source {
                    Source::Order => out.push_str(&(row + 1).to_string()),
                    Source::Calibration => out.push_str("calibration"),
                    Source::Position { commanded, error } => {
                        let [commanded, error] = [commanded, error].map(|(index, factor)| {
                            table.number(row, *index).map(|value| Some(value? * factor))
                        });
                        if let (Some(commanded), Some(error)) = (commanded?, error?) {
                            out.push_str(&format!("{}", commanded + error));
                        }
                    }
                    Source::Column { index, .. } if TEXT_COLUMNS.contains(&name.as_str()) => {
                        let text = table.rows[row].1[*index].trim();
                        ensure!(
                            !text.contains([',', '"', '\n']),
                            "{}: role {text:?} is not a word",
                            table.file
                        );
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
    pub(super) fn left_out(&self, table: &TextTable) -> Vec<String> {
        let taken = |k: usize| {
            self.columns.iter().any(|(_, source)| match source {
                Source::Column { index, .. } => *index == k,
                Source::Position { commanded, error } => commanded.0 == k || error.0 == k,
                Source::Order | Source::Calibration => false,
            })
        };
        let left = table.columns.iter().enumerate().filter(|(k, _)| !taken(*k));
        left.map(|(_, name)| name.clone()).collect()
    }

    /// What the arguments ask of a table.
    ///
    /// # Errors
    /// Where a column is missing, or a mapping is malformed.
    pub(super) fn new(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Self> {
        let wanted = wanted(args, table)?;
        let mut columns = Vec::new();
        for (name, fallback) in [("point", Source::Order), ("role", Source::Calibration)] {
            if !wanted.iter().any(|(n, _)| n == name) {
                columns.push((name.to_owned(), fallback));
            }
        }
        if args.kind == Kind::Transducer && args.stimulus.is_none() {
            ensure!(
                args.model == Some(Declared::Law(TransducerModel::Constant)),
                "--stimulus is missing: expected the column of the stimulus (only --model constant does without)"
            );
            columns.push(("stimulus".to_owned(), Source::Order));
        }
        let place = wanted.iter().find(|(name, _)| name == "commanded_mm");
        let place = place.map(|(_, column)| scaled(table, column)).transpose()?;
        let mut repeated = Vec::new();
        for (name, column) in wanted {
            let (index, factor) = scaled(table, &column)?;
            let count = table.columns_named(&table.columns[index]).len();
            if count > 1 {
                let text = format!("{count} columns named {column} with the same cells; counted once");
                repeated.push(format!("{}: {text}", table.file));
            }
            let unit_mm = error_unit_mm(&name).filter(|_| args.kind == Kind::Axis);
            columns.push(match (unit_mm, place) {
                (Some(unit_mm), Some((place, own))) => {
                    let commanded = (place, own.unwrap_or(1.0));
                    let error = (index, unit_mm * factor.unwrap_or(1.0));
                    ("measured_mm".to_owned(), Source::Position { commanded, error })
                }
                _ => (name, Source::Column { index, factor }),
            });
        }
        Ok(Self { columns, repeated })
    }
}

/// The option that takes a further column.
pub(super) const WAY_IN: &str =
    "; --covariate COLUMN takes one, --covariate NAME=COLUMN under its name in the session";

/// A column of the foreign table and the factor that its cells are multiplied by: `COL` or `COL*FACTOR`.
///
/// # Errors
/// Where the table has no such column.
fn scaled(table: &TextTable, text: &str) -> anyhow::Result<(usize, Option<f64>)> {
    let split = text.rsplit_once('*').filter(|_| table.columns_named(text).is_empty());
    let Some((name, factor)) = split else { return Ok((table.column(text)?, None)) };
    let value = factor.trim().parse::<f64>().ok().filter(|f| f.is_finite() && *f != 0.0);
    let value = value.with_context(|| {
        format!("{text}: expected COLUMN*FACTOR with a finite factor other than 0, found {factor:?}")
    })?;
    Ok((table.column(name.trim())?, Some(value)))
}

/// Millimetres in the unit of a column of an axis' errors; none for another column.
fn error_unit_mm(name: &str) -> Option<f64> {
    let units = [("error_um", 1e-3), ("error_mm", 1.0), ("error_in", 25.4)];
    units.into_iter().find(|(unit, _)| *unit == name).map(|(_, mm)| mm)
}

/// Name in the session and name in the foreign table of every column to import.
fn wanted(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<(String, String)>> {
    // Of an axis the repetition of a stroke is its cycle.
    let axis = args.kind == Kind::Axis;
    ensure!(
        !(axis && args.cycle.is_some() && args.replicate.is_some()),
        "--replicate: expected --cycle or --replicate for an axis (the repetition of a stroke is its cycle), found both"
    );
    let errors = || args.covariates.iter().any(|c| c.split('=').next().and_then(error_unit_mm).is_some());
    ensure!(
        !axis || args.measured.is_some() != errors(),
        "--measured: expected the column of the measured position, or of its error (--covariate error_um=COLUMN), found {}",
        if args.measured.is_some() { "both" } else { "neither" }
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
        ("role", &args.role),
        ("stimulus", &args.stimulus),
        ("response", &args.response),
        ("commanded_mm", &args.commanded),
        ("measured_mm", &args.measured),
        ("t_s", &args.time),
        ("direction", &args.direction),
        ("temperature_degc", &args.temperature),
        ("cycle", &cycle),
        ("replicate", &replicate),
    ];
    let given = flags.iter().filter_map(|(name, column)| Some(((*name).to_owned(), (*column).clone()?)));
    let mut wanted: Vec<(String, String)> = given.collect();
    for text in &args.covariates {
        // Without a name of its own a column keeps that of the table.
        let (name, column) = text.split_once('=').unwrap_or((text, text));
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
