//! Sessions of kind "transducer": one stimulus, one response.

use crate::error::InputError;
use crate::row::{PointNumbers, Row, clock_problem};
use crate::screening::{contradiction, copied, exchanged, overflow};
use crate::table::TextTable;
use crate::warning::SessionWarning;
use serde::Deserialize;
use wcal_core::text::brief;
use wcal_core::{InputFile, Purpose, TransducerModel, TransducerRow};

/// `[transducer]`.
#[derive(Deserialize)]
pub(crate) struct TransducerSection {
    pub(crate) stimulus_unit: String,
    pub(crate) response_unit: String,
    pub(crate) model: TransducerModel,
    #[serde(default)]
    pub(crate) deviation: bool,
}

/// Rows, names of the covariates, the file's hash.
pub(crate) struct TransducerTable {
    pub(crate) rows: Vec<TransducerRow>,
    pub(crate) covariates: Vec<String>,
    pub(crate) input: InputFile,
}

/// Reads the rows of a table. Columns beyond the known ones are covariates when their first cell is
/// a number.
pub(crate) fn read_rows(
    table: &TextTable,
    purpose: Purpose,
    warnings: &mut Vec<SessionWarning>,
) -> Result<TransducerTable, InputError> {
    let name = &table.file;
    let group = table.group();
    let required = ["point", "role", "stimulus", "response"];
    let known = [
        &["stimulus_sd", "t_s", "temperature_degc", "direction"][..],
        &group,
    ]
    .concat();
    let others = table.others(&required, &known)?;
    let (covariates, without): (Vec<String>, Vec<String>) = others
        .into_iter()
        .partition(|column| matches!(Row::new(table, 0).number(column), Ok(Some(_))));
    let without = without
        .iter()
        .map(|column| format!("column {} holds no numbers and is not used", brief(column)));
    warnings.extend(without.map(|text| SessionWarning::other(name, text)));
    let mut points = PointNumbers::default();
    Row::all(table).try_for_each(|row| points.note(&row, row.point()?))?;
    let mut out = vec![false; table.rows.len()];
    let read: Vec<&str> = ["response", "temperature_degc"]
        .into_iter()
        .chain(covariates.iter().map(String::as_str))
        .collect();
    exchanged(table, ["stimulus", "response"])?;
    warnings.extend(overflow(table, [&["stimulus"], &read], &mut out)?);
    warnings.extend(copied(table, Some("response"), &mut out)?);
    let mut rows = Vec::new();
    for row in Row::all(table).filter(|row| !out[row.index]) {
        let covariate = |column: &String| {
            let missing = || row.error(column, "a number (a covariate in every row)", "nothing");
            row.number(column)?.ok_or_else(missing)
        };
        rows.push(TransducerRow {
            source: name.to_owned(),
            line: row.line,
            point: row.point()?,
            role: row.role()?,
            stimulus: row.required("stimulus")?,
            stimulus_sd: row.not_negative("stimulus_sd")?,
            response: row.required("response")?,
            t_s: row.number("t_s")?,
            temperature_degc: row.temperature()?,
            direction: row.sign("direction")?,
            replicate: row.count(group[0], 0)?,
            covariates: covariates
                .iter()
                .map(covariate)
                .collect::<Result<_, InputError>>()?,
        });
    }
    let steps: Vec<_> = rows
        .iter()
        .map(|r| (r.line, r.stimulus, r.t_s, r.direction))
        .collect();
    contradiction(name, "stimulus", &steps)?;
    warnings.extend(clock_problem(name, rows.iter().map(|r| (r.line, r.t_s))));
    warnings.extend(table.warning());
    Ok(TransducerTable {
        rows,
        covariates,
        input: table.input(purpose),
    })
}
