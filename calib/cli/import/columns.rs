//! Column mapping: cells of the foreign table under the session's names.

use super::arguments::{Declared, ImportArgs, Kind};
use super::units;
use crate::column_words::is_deviation;
use anyhow::{bail, ensure};
use wcal_core::TransducerModel;
use wcal_session::{
    AskedColumn, IN_SESSION, Stamps, TextTable, WHISKER_COLUMNS, asked_name, named,
};

/// Columns of the other kinds that are taken along wherever a table has them under these names.
const SCALAR_COLUMNS: &[&str] = &[
    "stimulus_sd",
    "t_s",
    "direction",
    "temperature_degc",
    "replicate",
    "cycle",
];

/// Columns whose cells are not numbers.
const TEXT_COLUMNS: &[&str] = &["role"];

/// Where a column of the session comes from.
enum Source {
    /// A column of the foreign table, times a factor.
    Column { index: usize, factor: f64 },
    /// A column of time stamps.
    Stamps { index: usize, stamps: Stamps },
    /// A commanded position and the error of the measured one, each times a factor: their sum.
    Position {
        commanded: (usize, f64),
        error: (usize, f64),
    },
    /// Number of the row, from 1.
    Order,
    /// The role "calibration".
    Calibration,
}

/// Where the columns of the session come from.
pub(super) struct Plan {
    columns: Vec<(String, Source)>,
    /// Unit of the stimulus and of the response.
    pub(super) units: [String; 2],
    /// How the table was read, in words.
    pub(super) remarks: Vec<String>,
    /// What is odd about it.
    pub(super) warnings: Vec<String>,
}

/// The session's table, and the rows of the foreign one that are in it.
pub(super) struct Points {
    pub(super) csv: Vec<u8>,
    /// Indices of the rows.
    pub(super) rows: Vec<usize>,
}

impl Points {
    /// Line of the foreign table that a line of the session's comes from.
    pub(super) fn line(&self, table: &TextTable, line: usize) -> usize {
        // The header is line 1.
        self.rows
            .get(line.saturating_sub(2))
            .map_or(line, |&row| table.rows[row].0)
    }
}

impl Plan {
    /// The session's table. Rows without a value that each row needs are left out and said.
    ///
    /// # Errors
    /// Where a cell is not what its column needs, or most rows lack one.
    pub(super) fn points(&mut self, table: &TextTable, kind: Kind) -> anyhow::Result<Points> {
        let mut csv = self
            .columns
            .iter()
            .map(|(name, _)| name.as_str())
            .collect::<Vec<_>>()
            .join(",");
        csv.push('\n');
        let (mut rows, mut without) = (Vec::new(), Vec::new());
        for row in 0..table.rows.len() {
            let cells: Vec<String> = self
                .columns
                .iter()
                .map(|column| cell(table, row, column))
                .collect::<anyhow::Result<_>>()?;
            let needed = |name: &str| {
                kind != Kind::Whisker
                    && !matches!(
                        name,
                        "t_s" | "direction" | "temperature_degc" | "cycle" | "replicate"
                    )
            };
            let lacks = self
                .columns
                .iter()
                .zip(&cells)
                .position(|((name, _), cell)| cell.is_empty() && needed(name));
            if let Some(column) = lacks {
                without.push((column, row));
                continue;
            }
            rows.push(row);
            csv += &cells.join(",");
            csv.push('\n');
        }
        self.say_missing(table, &without)?;
        Ok(Points {
            csv: csv.into_bytes(),
            rows,
        })
    }

    fn say_missing(&mut self, table: &TextTable, without: &[(usize, usize)]) -> anyhow::Result<()> {
        let line = |row: &usize| table.rows[*row].0;
        if let Some((column, row)) = without
            .first()
            .filter(|_| 2 * without.len() > table.rows.len())
        {
            let (column, found) = self.cell_of(table, *column, *row);
            bail!(
                "{}, row at line {}, field {column}: expected a number in most rows, found {found:?} and the like in {} of {} rows",
                table.file,
                line(row),
                without.len(),
                table.rows.len()
            );
        }
        for (k, _) in self.columns.iter().enumerate() {
            let rows: Vec<usize> = without.iter().filter(|w| w.0 == k).map(|w| w.1).collect();
            if let Some(first) = rows.first() {
                let (column, _) = self.cell_of(table, k, *first);
                let lines = named(&rows.iter().map(line).collect::<Vec<_>>());
                self.warnings.push(format!(
                    "{}: no value of {column} in {} of {} rows, left out as missing: line(s) {lines}",
                    table.file,
                    rows.len(),
                    table.rows.len()
                ));
            }
        }
        Ok(())
    }

    /// Name and cell in the foreign table of a column of the session.
    fn cell_of(&self, table: &TextTable, column: usize, row: usize) -> (String, String) {
        let index = self.columns[column].1.index();
        index.map_or_else(Default::default, |k| {
            (table.columns[k].clone(), table.rows[row].1[k].to_owned())
        })
    }

    /// Name in the foreign table of a column of the session.
    pub(super) fn source_of(&self, table: &TextTable, name: &str) -> Option<String> {
        let (_, source) = self.columns.iter().find(|(own, _)| own == name)?;
        Some(table.columns[source.index()?].clone())
    }

    /// Columns of the session that have another name in the foreign table, or a factor: by their
    /// names in the session.
    pub(super) fn renamed(&self, table: &TextTable) -> toml::Table {
        let text = |(name, source): &(String, Source)| match source {
            Source::Column { index, factor } => {
                let column = &table.columns[*index];
                let text = if *factor == 1.0 {
                    column.clone()
                } else {
                    format!("{column}*{factor}")
                };
                (text != *name).then(|| (name.clone(), text.into()))
            }
            // Without a date it is not known how long after the first of these another clock
            // begins.
            Source::Stamps { index, stamps } => {
                let since = if stamps.dated {
                    format!(" since {}", stamps.first)
                } else {
                    String::new()
                };
                Some((
                    name.clone(),
                    format!("{}{since}", table.columns[*index]).into(),
                ))
            }
            _ => None,
        };
        self.columns.iter().filter_map(text).collect()
    }

    /// Columns of the foreign table that the session does not have, in their order.
    pub(super) fn left_out(&self, table: &TextTable) -> Vec<String> {
        let taken = |k: usize| {
            self.columns.iter().any(|(_, source)| match source {
                Source::Column { index, .. } => *index == k,
                Source::Stamps { index, stamps } => *index == k || stamps.other == Some(k),
                Source::Position { commanded, error } => commanded.0 == k || error.0 == k,
                Source::Order | Source::Calibration => false,
            })
        };
        let holds = |k: usize| table.rows.iter().any(|(_, cells)| !cells[k].is_empty());
        let left = table
            .columns
            .iter()
            .enumerate()
            .filter(|(k, _)| !taken(*k) && holds(*k));
        left.map(|(_, name)| name.clone()).collect()
    }

    /// The time stamp that the times are counted from.
    pub(super) fn since(&self) -> Option<&str> {
        let mut stamps = self.columns.iter().filter_map(|(_, source)| match source {
            Source::Stamps { stamps, .. } => Some(stamps.first.as_str()),
            _ => None,
        });
        stamps.next()
    }

    /// What the arguments ask of a table; dated time stamps count from `since`, where another table
    /// of the session begins.
    ///
    /// # Errors
    /// Where a column is missing, or a mapping is malformed.
    pub(super) fn new(
        args: &ImportArgs,
        table: &TextTable,
        since: Option<&str>,
    ) -> anyhow::Result<Self> {
        let wanted = wanted(args, table)?;
        for (name, column) in &wanted {
            if !TEXT_COLUMNS.contains(&name.as_str()) {
                table
                    .columns_named(asked_name(column))
                    .first()
                    .map_or(Ok(()), |index| table.check_thousands(*index))?;
            }
        }
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
        if args.kind == Kind::Whisker {
            let has = |name: &str| {
                wanted.iter().any(|(own, _)| own == name)
                    || columns.iter().any(|(own, _)| own == name)
            };
            let missing: Vec<&str> = IN_SESSION.into_iter().filter(|name| !has(name)).collect();
            if !missing.is_empty() {
                return Err(table
                    .without(&missing)
                    .hint("--covariate NAME=COLUMN takes each")
                    .into());
            }
        }
        let mut plan = Self {
            columns,
            units: Default::default(),
            remarks: Vec::new(),
            warnings: Vec::new(),
        };
        let commanded = wanted.iter().find(|(name, _)| name == "commanded_mm");
        let commanded = commanded
            .map(|(name, column)| plan.scaled(table, name, column))
            .transpose()?;
        for (name, column) in wanted {
            let (index, factor) = plan.scaled(table, &name, &column)?;
            let count = table.columns_named(&table.columns[index]).len();
            if count > 1 {
                let text =
                    format!("{count} columns named {column} with the same cells; counted once");
                plan.warnings.push(format!("{}: {text}", table.file));
            }
            let of_the_kind = ["point", "role", "stimulus", "response"];
            let covariate = args.kind == Kind::Transducer
                && !SCALAR_COLUMNS
                    .iter()
                    .chain(&of_the_kind)
                    .any(|n| *n == name);
            if covariate && units::is_uncertainty(&column) {
                let text = "looks like an uncertainty: as a covariate it counts as a cause";
                plan.warnings
                    .push(format!("{}: {column} {text}", table.file));
            }
            let unit_mm = error_unit_mm(&name).filter(|_| args.kind == Kind::Axis);
            let stamps = if name == "t_s" {
                let asked = table.asked(&column)?;
                let since = asked.since.or(since.map(str::to_owned));
                table.stamps(&AskedColumn { since, ..asked })?
            } else {
                None
            };
            if let Some(Stamps { other, first, .. }) = &stamps {
                let with = other.map_or(String::new(), |k| format!(" with {}", table.columns[k]));
                let column = asked_name(&column);
                plan.remarks.push(format!(
                    "{}: {column}{with} holds time stamps: seconds after {first}",
                    table.file
                ));
            }
            plan.columns.push(match (unit_mm, commanded, stamps) {
                (Some(unit_mm), Some(commanded), _) => {
                    let error = (index, unit_mm * factor);
                    (
                        "measured_mm".to_owned(),
                        Source::Position { commanded, error },
                    )
                }
                (.., Some(stamps)) => (name, Source::Stamps { index, stamps }),
                _ => (name, Source::Column { index, factor }),
            });
        }
        for (set, read) in [("stimulus", "response"), ("commanded_mm", "measured_mm")] {
            let [set_in, read_in] = [set, read].map(|name| plan.source_of(table, name));
            ensure!(
                set_in.is_none() || set_in != read_in,
                "{}: expected one column of {set} and another of {read}, found {} for both",
                table.file,
                set_in.unwrap_or_default()
            );
        }
        let signals = [
            ("--stimulus", &args.stimulus_unit, &args.stimulus),
            ("--response", &args.response_unit, &args.response),
        ];
        let [stimulus, response] = signals.map(|(option, unit, column)| {
            units::signal(
                (option, unit.as_deref()),
                column.as_deref(),
                table,
                &mut plan.remarks,
            )
        });
        plan.units = [stimulus?, response?];
        if let Some(column) = args.response.as_deref().filter(|name| is_deviation(name)) {
            let said = "taken as a deviation of the stimulus, by its name: it needs no slope";
            plan.remarks
                .push(format!("{}: {column} is {said}", table.file));
        }
        // A commanded position is looked up twice.
        plan.remarks.sort();
        plan.remarks.dedup();
        Ok(plan)
    }

    /// A column of the foreign table and the factor that its cells are multiplied by: that of
    /// `COL*FACTOR`, else that of its unit to the session's.
    ///
    /// # Errors
    /// Where the table has no such column, or states two units of it.
    fn scaled(
        &mut self,
        table: &TextTable,
        name: &str,
        text: &str,
    ) -> anyhow::Result<(usize, f64)> {
        let AskedColumn { index, factor, .. } = table.asked(text)?;
        let of_unit = || units::factor(table, index, name, (&mut self.remarks, &mut self.warnings));
        Ok((index, factor.map_or_else(of_unit, Ok)?))
    }
}

impl Source {
    /// The column of the foreign table, where it is one.
    fn index(&self) -> Option<usize> {
        match self {
            Self::Column { index, .. } | Self::Stamps { index, .. } => Some(*index),
            Self::Position { error, .. } => Some(error.0),
            Self::Order | Self::Calibration => None,
        }
    }
}

/// A cell of the session's table; empty where nothing stands there.
fn cell(
    table: &TextTable,
    row: usize,
    (name, source): &(String, Source),
) -> anyhow::Result<String> {
    // `{}` prints the shortest text that reads back as the same number: nothing is lost.
    let text = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    Ok(match source {
        Source::Order => (row + 1).to_string(),
        Source::Calibration => "calibration".to_owned(),
        Source::Stamps { stamps, .. } => text(stamps.times[row]),
        Source::Position { commanded, error } => {
            let [commanded, error] = [commanded, error]
                .map(|(index, factor)| table.number(row, *index).map(|v| Some(v? * factor)));
            text(
                commanded?
                    .zip(error?)
                    .map(|(commanded, error)| commanded + error),
            )
        }
        Source::Column { index, .. } if TEXT_COLUMNS.contains(&name.as_str()) => {
            let text = table.rows[row].1[*index].trim();
            ensure!(
                !text.contains([',', '"', '\n']),
                "{}: role {text:?} is not a word",
                table.file
            );
            text.to_owned()
        }
        Source::Column { index, factor } if name == "direction" => {
            text(table.direction(row, *index)?.map(|v| v * factor))
        }
        Source::Column { index, factor } => text(table.number(row, *index)?.map(|v| v * factor)),
    })
}

/// The option that takes a further column.
pub(super) const WAY_IN: &str =
    "; --covariate COLUMN takes one, --covariate NAME=COLUMN under its name in the session";

/// Millimetres in the unit of a column of an axis' errors; none for another column.
fn error_unit_mm(name: &str) -> Option<f64> {
    let units = [("error_um", 1e-3), ("error_mm", 1.0), ("error_in", 25.4)];
    units
        .into_iter()
        .find(|(unit, _)| *unit == name)
        .map(|(_, mm)| mm)
}

/// Name in the session and name in the foreign table of every column to import.
fn wanted(args: &ImportArgs, table: &TextTable) -> anyhow::Result<Vec<(String, String)>> {
    // Of an axis the repetition of a stroke is its cycle.
    let axis = args.kind == Kind::Axis;
    ensure!(
        !(axis && args.cycle.is_some() && args.replicate.is_some()),
        "--replicate: expected --cycle or --replicate for an axis (the repetition of a stroke is its cycle), found both"
    );
    let errors = || {
        args.covariates
            .iter()
            .any(|c| c.split('=').next().and_then(error_unit_mm).is_some())
    };
    ensure!(
        !axis || args.measured.is_some() != errors(),
        "--measured: expected the column of the measured position, or of its error (--covariate error_um=COLUMN), found {}",
        if args.measured.is_some() {
            "both"
        } else {
            "neither"
        }
    );
    let (cycle, replicate) = if axis {
        (args.cycle.clone().or_else(|| args.replicate.clone()), None)
    } else if args.kind == Kind::Transducer {
        // The cycle of a transducer is its repetition: readings of one are left out together, and
        // it is no quantity that acts.
        (None, args.replicate.clone().or_else(|| args.cycle.clone()))
    } else {
        (args.cycle.clone(), args.replicate.clone())
    };
    let flags = [
        ("role", &args.role),
        ("stimulus", &args.stimulus),
        ("stimulus_sd", &args.stimulus_sd),
        ("response", &args.response),
        ("commanded_mm", &args.commanded),
        ("measured_mm", &args.measured),
        ("t_s", &args.time),
        ("direction", &args.direction),
        ("temperature_degc", &args.temperature),
        ("cycle", &cycle),
        ("replicate", &replicate),
    ];
    let given = flags
        .iter()
        .filter_map(|(name, column)| Some(((*name).to_owned(), (*column).clone()?)));
    let mut wanted: Vec<(String, String)> = given.collect();
    for text in &args.covariates {
        // Without a name here a column keeps that of the table.
        let (name, column) = text.split_once('=').unwrap_or((text, text));
        wanted.push((name.to_owned(), column.to_owned()));
    }
    let known: &[&str] = if args.kind == Kind::Whisker {
        &WHISKER_COLUMNS
    } else {
        SCALAR_COLUMNS
    };
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
