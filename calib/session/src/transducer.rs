//! Sessions of kind "transducer" and "axis": one stimulus, one response.

use crate::axis::unit_mismatch;
use crate::error::InputError;
use crate::row::{PointNumbers, Row, clock_problem};
use crate::screening::{contradiction, copied, exchanged, overflow};
use crate::table::TextTable;
use crate::warning::SessionWarning;
use crate::whisker::unknown_columns;
use wcal_core::text::brief;
use wcal_core::{TransducerModel, TransducerRow};

/// Reads the rows of a table, and names its covariates: of a transducer columns beyond the known
/// ones whose first cell is a number.
pub(crate) fn read_rows(
    table: &TextTable,
    model: TransducerModel,
    warnings: &mut Vec<SessionWarning>,
) -> Result<(Vec<TransducerRow>, Vec<String>), InputError> {
    let (name, axis) = (&table.file, model == TransducerModel::Axis);
    let [set, read] = model.columns();
    // The repetition of a stroke is its cycle.
    let group = table.group();
    let mut known = [&["t_s", "temperature_degc", "direction"][..], &group].concat();
    known.extend((!axis).then_some("stimulus_sd"));
    let others = table.others(&["point", "role", set, read], &known)?;
    let (covariates, without): (Vec<String>, Vec<String>) = others
        .into_iter()
        .partition(|c| !axis && matches!(Row::new(table, 0).number(c), Ok(Some(_))));
    if axis {
        warnings.extend(unknown_columns(name, without));
    } else {
        warnings.extend(without.iter().map(|column| {
            let text = format!("column {} holds no numbers and is not used", brief(column));
            SessionWarning::other(name, text)
        }));
    }
    // Before rows are left out: a number that stands twice is an error in any case.
    let mut points = PointNumbers::default();
    Row::all(table).try_for_each(|row| points.note(&row, row.point()?))?;
    let mut out = vec![false; table.rows.len()];
    exchanged(table, [set, read])?;
    // A column that holds something else is named as that before its single values are judged.
    if axis {
        let rows = Row::all(table).map(|row| Ok([row.required(set)?, row.required(read)?]));
        unit_mismatch(name, &rows.collect::<Result<Vec<_>, InputError>>()?)?;
    }
    let mut sensed = vec![read, "temperature_degc"];
    sensed.extend(covariates.iter().map(String::as_str));
    warnings.extend(overflow(table, [&[set], &sensed], &mut out)?);
    warnings.extend(copied(table, Some(read), &mut out)?);
    let mut rows = Vec::new();
    for row in Row::all(table).filter(|row| !out[row.index]) {
        let covariate = |column: &String| {
            let missing = || row.error(column, "a number (a covariate in every row)", "nothing");
            row.number(column)?.ok_or_else(missing)
        };
        rows.push(TransducerRow {
            source: name.clone(),
            line: row.line,
            point: row.point()?,
            role: row.role()?,
            stimulus: row.required(set)?,
            stimulus_sd: row.not_negative("stimulus_sd")?.filter(|_| !axis),
            response: row.required(read)?,
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
    contradiction(name, set, &rows)?;
    warnings.extend(clock_problem(name, rows.iter().map(|r| (r.line, r.t_s))));
    warnings.extend(table.warning());
    Ok((rows, covariates))
}
