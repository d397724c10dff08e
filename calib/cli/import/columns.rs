//! Column mapping: cells of the foreign table under the session's names.

use super::arguments::{Declared, ImportArgs, Kind};
use super::noticed::Noticed;
use super::units;
use crate::column_words::{is_deviation, quoted};
use anyhow::{Result, bail, ensure};
use wcal_core::TransducerModel;
use wcal_session::{AskedColumn, IN_SESSION, TextTable, WHISKER_COLUMNS, asked_name, named};

/// Columns of the other kinds that are taken along wherever a table has them under these names.
const SCALAR_COLUMNS: &[&str] = &[
    "stimulus_sd",
    "t_s",
    "direction",
    "temperature_degc",
    "replicate",
    "cycle",
];

/// Likeness of names from which a column is proposed for another, 1 for the same.
const GUESSED: f64 = 0.4;

/// A column of the session.
#[derive(Default)]
struct Column {
    name: String,
    cells: Vec<String>,
    /// Columns of the foreign table that it is made of, the one that names it last.
    made_of: Vec<usize>,
    /// The time stamp that times are counted from.
    since: Option<String>,
    /// How a later table of the same instrument is asked for it.
    asked: Option<String>,
}

/// The session's table, and where its columns come from.
pub(super) struct Plan<'t> {
    pub(super) table: &'t TextTable,
    columns: Vec<Column>,
    /// Unit of the stimulus and of the response.
    pub(super) units: [String; 2],
    /// How the table was read, and what is odd about it.
    pub(super) noticed: Noticed,
    /// The session's table.
    pub(super) csv: String,
    /// Rows of the foreign table that are in it.
    pub(super) rows: Vec<usize>,
}

impl<'t> Plan<'t> {
    /// Line of the foreign table that a line of the session's comes from.
    pub(super) fn line(&self, line: usize) -> usize {
        // The header is line 1.
        let row = self.rows.get(line.saturating_sub(2));
        row.map_or(line, |&row| self.table.rows[row].0)
    }

    /// Makes the session's table. Rows without a value that each row needs are left out and said.
    ///
    /// # Errors
    /// Where most rows lack one.
    fn fill(&mut self, kind: Kind) -> anyhow::Result<()> {
        let names: Vec<&str> = self.columns.iter().map(|c| c.name.as_str()).collect();
        self.csv = names.join(",") + "\n";
        let needed = |name: &str| {
            kind != Kind::Whisker
                && !matches!(
                    name,
                    "t_s" | "direction" | "temperature_degc" | "cycle" | "replicate"
                )
        };
        let (table, of) = (self.table, self.table.rows.len());
        let mut without: Vec<(usize, usize)> = Vec::new();
        for row in 0..of {
            let cells: Vec<&str> = self.columns.iter().map(|c| c.cells[row].as_str()).collect();
            match (0..cells.len()).find(|&k| cells[k].is_empty() && needed(names[k])) {
                Some(column) => without.push((column, row)),
                None => {
                    self.rows.push(row);
                    self.csv += &(cells.join(",") + "\n");
                }
            }
        }
        let line = |row: usize| table.rows[row].0;
        let source = |column: usize| self.columns[column].made_of.last();
        // Where most rows lack a number, the wrong column is likelier than gaps.
        if let Some(&(column, row)) = without.first().filter(|_| 2 * without.len() > of) {
            let (name, found) = source(column).map_or(("", ""), |&k| {
                (table.columns[k].as_str(), &table.rows[row].1[k])
            });
            bail!(
                "{}, row at line {}, field {name}: expected a number in most rows, found {found:?} and the like in {} of {of} rows",
                table.file,
                line(row),
                without.len()
            );
        }
        for k in 0..names.len() {
            let missing = without.iter().filter(|w| w.0 == k);
            let lines: Vec<usize> = missing.map(|w| line(w.1)).collect();
            if !lines.is_empty() {
                self.noticed.warnings.push(format!(
                    "{}: no value of {} in {} of {of} rows, left out as missing: line(s) {}",
                    table.file,
                    source(k).map_or("", |k| &table.columns[*k]),
                    lines.len(),
                    named(&lines)
                ));
            }
        }
        Ok(())
    }

    /// Name in the foreign table of a column of the session.
    pub(super) fn source_of(&self, name: &str) -> Option<String> {
        let column = self.columns.iter().find(|c| c.name == name)?;
        Some(self.table.columns[*column.made_of.last()?].clone())
    }

    /// Columns of the session that have another name in the foreign table, or a factor: by their
    /// names in the session.
    pub(super) fn renamed(&self) -> toml::Table {
        let asked = |c: &Column| Some((c.name.clone(), c.asked.clone()?.into()));
        self.columns.iter().filter_map(asked).collect()
    }

    /// Columns of the foreign table that the session does not have, in their order.
    pub(super) fn left_out(&self) -> Vec<String> {
        let taken = |k: usize| self.columns.iter().any(|c| c.made_of.contains(&k));
        let holds = |k: usize| {
            self.table
                .rows
                .iter()
                .any(|(_, cells)| !cells[k].is_empty())
        };
        (0..self.table.columns.len())
            .filter(|&k| !taken(k) && holds(k))
            .map(|k| self.table.columns[k].clone())
            .collect()
    }

    /// The time stamp that the times are counted from.
    pub(super) fn since(&self) -> Option<String> {
        self.columns.iter().find_map(|c| c.since.clone())
    }

    /// What the arguments ask of a table; dated time stamps count from `since`, where another table
    /// of the session begins.
    ///
    /// # Errors
    /// Where a column is missing, a mapping is malformed, or a cell is not what its column needs.
    pub(super) fn new(
        args: &ImportArgs,
        table: &'t TextTable,
        since: Option<&str>,
    ) -> Result<Self> {
        let wanted = wanted(args, table)?;
        for (_, column) in wanted.iter().filter(|(name, _)| name != "role") {
            if let Some(index) = table.columns_named(asked_name(column)).first() {
                table.check_thousands(*index)?;
            }
        }
        let mut plan = Self {
            table,
            columns: Vec::new(),
            units: Default::default(),
            noticed: Noticed::default(),
            csv: String::new(),
            rows: Vec::new(),
        };
        let rows = table.rows.len();
        let given = |name: &str, cells: Vec<String>| Column {
            name: name.to_owned(),
            cells,
            ..Column::default()
        };
        let order = || (1..=rows).map(|row| row.to_string()).collect::<Vec<_>>();
        let asks = |name: &str| wanted.iter().any(|(own, _)| own == name);
        if !asks("point") {
            plan.columns.push(given("point", order()));
        }
        if !asks("role") {
            let role = vec!["calibration".to_owned(); rows];
            plan.columns.push(given("role", role));
        }
        if args.kind == Kind::Transducer && args.stimulus.is_none() {
            ensure!(
                args.model == Some(Declared::Law(TransducerModel::Constant)),
                "--stimulus is missing: expected the column of the stimulus (only --model constant does without)"
            );
            plan.columns.push(given("stimulus", order()));
        }
        if args.kind == Kind::Whisker {
            let has = |name: &str| asks(name) || plan.columns.iter().any(|c| c.name == name);
            let shifts = ["fbg_1_shift_nm", "fbg_2_shift_nm"];
            let read = match shifts.iter().any(|name| has(name)) {
                true => shifts,
                false => ["fbg_1_nm", "fbg_2_nm"],
            };
            let all = IN_SESSION.into_iter().chain(read);
            let missing: Vec<&str> = all.filter(|name| !has(name)).collect();
            if !missing.is_empty() {
                let mut line: Vec<String> = vec!["wcal".to_owned()];
                line.extend(crate::kept::command().into_iter().skip(1));
                let mut taken: Vec<&str> = wanted.iter().map(|(_, c)| asked_name(c)).collect();
                for name in &missing {
                    let free = |c: &str| !taken.contains(&c) && !WHISKER_COLUMNS.contains(&c);
                    let column = table.alike(name, GUESSED, free);
                    let column = column.map_or("COLUMN", String::as_str);
                    taken.push(column);
                    line.extend(["--covariate".to_owned(), format!("{name}={column}")]);
                }
                let line: Vec<String> = line.iter().map(|word| quoted(word)).collect();
                let missing = table.without(&missing);
                bail!(
                    "{missing}; name your columns of them:\n  {}",
                    line.join(" ")
                );
            }
        }
        let commanded = wanted.iter().find(|(name, _)| name == "commanded_mm");
        let commanded = commanded
            .map(|(name, column)| plan.scaled(name, column))
            .transpose()?;
        for (name, column) in wanted {
            let column = plan.column(args.kind, (name, &column), commanded, since)?;
            plan.columns.push(column);
        }
        // One column in both places would fit perfectly and say nothing.
        for (set, read) in [("stimulus", "response"), ("commanded_mm", "measured_mm")] {
            let [set_in, read_in] = [set, read].map(|name| plan.source_of(name));
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
        for (own, (option, unit, column)) in plan.units.iter_mut().zip(signals) {
            let (stated, remarks) = ((option, unit.as_deref()), &mut plan.noticed.remarks);
            *own = units::signal(stated, column.as_deref(), table, remarks)?;
        }
        if let Some(column) = args.response.as_deref().filter(|name| is_deviation(name)) {
            let said = "taken as a deviation of the stimulus, by its name: it needs no slope";
            let said = format!("{}: {column} is {said}", table.file);
            plan.noticed.remarks.push(said);
        }
        // A commanded position is looked up twice.
        plan.noticed.remarks.sort();
        plan.noticed.remarks.dedup();
        plan.fill(args.kind)?;
        Ok(plan)
    }

    /// A column of the session by its name there, and the text that asks for it.
    fn column(
        &mut self,
        kind: Kind,
        (name, text): (String, &str),
        commanded: Option<(usize, f64)>,
        since: Option<&str>,
    ) -> anyhow::Result<Column> {
        let table = self.table;
        let (index, factor) = self.scaled(&name, text)?;
        let source = &table.columns[index];
        let count = table.columns_named(source).len();
        if count > 1 {
            let said = format!("{count} columns named {text} with the same cells; counted once");
            self.noticed
                .warnings
                .push(format!("{}: {said}", table.file));
        }
        let known = ["point", "role", "stimulus", "response"];
        let covariate =
            kind == Kind::Transducer && !SCALAR_COLUMNS.iter().chain(&known).any(|n| *n == name);
        if covariate && units::is_uncertainty(text) {
            let said = "looks like an uncertainty: as a covariate it counts as a cause";
            let said = format!("{}: {text} {said}", table.file);
            self.noticed.warnings.push(said);
        }
        let mut column = Column {
            made_of: vec![index],
            ..Column::default()
        };
        let scaled = |(index, factor): (usize, f64)| {
            let factor = Some(factor);
            table.values(
                &name,
                &AskedColumn {
                    index,
                    factor,
                    since: None,
                },
            )
        };
        if name == "role" {
            for (_, cells) in &table.rows {
                let text = cells[index].trim();
                // A comma or a quote would break the row of the session's table.
                ensure!(
                    !text.contains([',', '"', '\n']),
                    "{}: role {text:?} is not a word",
                    table.file
                );
                column.cells.push(text.to_owned());
            }
        }
        let values = if name == "role" {
            Vec::new()
        } else if let (Kind::Axis, Some(unit_mm), Some(commanded)) =
            (kind, error_unit_mm(&name), commanded)
        {
            // A commanded position and the error of the measured one: their sum.
            let errors = scaled((index, unit_mm * factor))?;
            column.made_of.insert(0, commanded.0);
            column.name = "measured_mm".to_owned();
            let positions = scaled(commanded)?.into_iter().zip(errors);
            positions
                .map(|(place, error)| Some(place? + error?))
                .collect()
        } else if name == "t_s"
            && let asked = table.asked(text)?
            && let since = asked.since.or(since.map(str::to_owned))
            && let Some(stamps) = table.stamps(&AskedColumn { since, ..asked })?
        {
            let with = stamps
                .other
                .map_or(String::new(), |k| format!(" with {}", table.columns[k]));
            self.noticed.remarks.push(format!(
                "{}: {}{with} holds time stamps: seconds after {}",
                table.file,
                asked_name(text),
                stamps.first
            ));
            // Without a date it is not known how long after the first of these another clock
            // begins.
            column.asked = Some(match stamps.dated {
                true => format!("{source} since {}", stamps.first),
                false => source.clone(),
            });
            column.since = Some(stamps.first);
            column.made_of.splice(0..0, stamps.other);
            stamps.times
        } else {
            scaled((index, factor))?
        };
        if column.name.is_empty() {
            let asked = match factor {
                1.0 => source.clone(),
                _ => format!("{source}*{factor}"),
            };
            column.asked = column.asked.or((asked != name).then_some(asked));
            column.name = name;
        }
        if column.cells.is_empty() {
            // `{}` prints the shortest text that reads back as the same number: nothing is lost.
            let shown = |v: Option<f64>| v.map_or_else(String::new, |v| v.to_string());
            column.cells = values.into_iter().map(shown).collect();
        }
        Ok(column)
    }

    /// A column of the foreign table and the factor that its cells are multiplied by: that of
    /// `COL*FACTOR`, else that of its unit to the session's.
    ///
    /// # Errors
    /// Where the table has no such column, or states two units of it.
    fn scaled(&mut self, name: &str, text: &str) -> Result<(usize, f64)> {
        let AskedColumn { index, factor, .. } = self.table.asked(text)?;
        let of_unit = || units::factor(self.table, index, name, &mut self.noticed);
        Ok((index, factor.map_or_else(of_unit, Ok)?))
    }
}

/// Millimetres in the unit of a column of an axis' errors; none for another column.
fn error_unit_mm(name: &str) -> Option<f64> {
    match name {
        "error_um" => Some(1e-3),
        "error_mm" => Some(1.0),
        "error_in" => Some(25.4),
        _ => None,
    }
}

/// Name in the session and name in the foreign table of every column to import.
fn wanted(args: &ImportArgs, table: &TextTable) -> Result<Vec<(String, String)>> {
    // Of an axis the repetition of a stroke is its cycle.
    let axis = args.kind == Kind::Axis;
    ensure!(
        !(axis && args.cycle.is_some() && args.replicate.is_some()),
        "--replicate: expected --cycle or --replicate for an axis (the repetition of a stroke is its cycle), found both"
    );
    let errors = || {
        let mut names = args.covariates.iter().filter_map(|c| c.split('=').next());
        names.any(|name| error_unit_mm(name).is_some())
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
    // The cycle of a transducer is its repetition: readings of one are left out together, and it is
    // no quantity that acts.
    let (cycle, replicate) = match args.kind {
        Kind::Axis => (args.cycle.as_ref().or(args.replicate.as_ref()), None),
        Kind::Transducer => (None, args.replicate.as_ref().or(args.cycle.as_ref())),
        _ => (args.cycle.as_ref(), args.replicate.as_ref()),
    };
    let flags = [
        ("role", args.role.as_ref()),
        ("stimulus", args.stimulus.as_ref()),
        ("stimulus_sd", args.stimulus_sd.as_ref()),
        ("response", args.response.as_ref()),
        ("commanded_mm", args.commanded.as_ref()),
        ("measured_mm", args.measured.as_ref()),
        ("t_s", args.time.as_ref()),
        ("direction", args.direction.as_ref()),
        ("temperature_degc", args.temperature.as_ref()),
        ("cycle", cycle),
        ("replicate", replicate),
    ];
    let given = flags
        .into_iter()
        .filter_map(|(name, column)| Some((name, column?.as_str())));
    // Without a name here a column keeps that of the table.
    let further = args.covariates.iter();
    let further = further.map(|text| text.split_once('=').unwrap_or((text, text)));
    let mut wanted: Vec<(&str, &str)> = given.chain(further).collect();
    let known: &[&str] = if args.kind == Kind::Whisker {
        &WHISKER_COLUMNS
    } else {
        SCALAR_COLUMNS
    };
    for name in known {
        let here = table.columns.iter().any(|c| c == name);
        if here && !wanted.iter().any(|(n, c)| n == name || c == name) {
            wanted.push((name, name));
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
    let owned = |(name, column): (&str, &str)| (name.to_owned(), column.to_owned());
    Ok(wanted.into_iter().map(owned).collect())
}
