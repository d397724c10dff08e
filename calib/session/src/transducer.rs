//! Sessions of kind "transducer": one stimulus, one response.

use crate::document::Section;
use crate::error::{InputError, SessionError, quote};
use crate::row::{Clock, PointNumbers};
use crate::screening::{Names, Screened, View, screen};
use crate::table::Table;
use crate::warning::{SessionWarning, WarningKind};
use crate::whisker_meta::warn_unknown;
use std::path::Path;
use wcal_core::{InputFile, TransducerModel, TransducerRow};

/// `[transducer]`.
pub(crate) struct TransducerMeta {
    pub(crate) stimulus_unit: String,
    pub(crate) response_unit: String,
    pub(crate) model: TransducerModel,
}

/// Reads `[transducer]`.
pub(crate) fn read_meta(
    root: &Section<'_>,
    warnings: &mut Vec<SessionWarning>,
) -> Result<TransducerMeta, InputError> {
    let section = root.section("transducer")?;
    let section = section.ok_or_else(|| root.error("transducer", "a table [transducer]", "nothing"))?;
    let expected = "\"constant\", \"linear\" or \"quadratic\"";
    let model = match section.required_text("model", expected)?.as_str() {
        "constant" => TransducerModel::Constant,
        "linear" => TransducerModel::Linear,
        "quadratic" => TransducerModel::Quadratic,
        other => return Err(section.error("model", expected, quote(other))),
    };
    let meta = TransducerMeta {
        stimulus_unit: section.required_text("stimulus_unit", "a unit, e.g. \"N\"")?,
        response_unit: section.required_text("response_unit", "a unit, e.g. \"V\"")?,
        model,
    };
    warn_unknown(&section, warnings);
    Ok(meta)
}

/// Rows, names of the covariates, the file's hash.
pub(crate) struct TransducerTable {
    pub(crate) rows: Vec<TransducerRow>,
    pub(crate) covariates: Vec<String>,
    pub(crate) input: InputFile,
}

impl Screened for TransducerRow {
    fn view(&self) -> View {
        View {
            line: self.line,
            point: self.point,
            role: self.role,
            setting: self.stimulus,
            reading: self.response,
            t_s: self.t_s,
            direction: self.direction,
            temperature_degc: self.temperature_degc,
            more: self.covariates.clone(),
        }
    }
}

/// Reads a table; `reference` are the rows of the points table, where this is another one. Columns beyond the known ones are covariates when their first cell is a number.
pub(crate) fn read_rows(
    path: &Path,
    name: &str,
    reference: &[TransducerRow],
    warnings: &mut Vec<SessionWarning>,
) -> Result<TransducerTable, SessionError> {
    let mut table = Table::open(path, name)?;
    let (point, role) = (table.required("point")?, table.required("role")?);
    let (stimulus, response) = (table.required("stimulus")?, table.required("response")?);
    let (t_s, temperature) = (table.optional("t_s")?, table.optional("temperature_degc")?);
    let (direction, replicate) = (table.optional("direction")?, table.group()?);
    let mut extra = table.unused();
    let mut points = PointNumbers::default();
    let mut rows: Vec<TransducerRow> = Vec::new();
    while let Some(row) = table.next_row()? {
        if rows.is_empty() {
            extra.retain(|(index, column)| {
                let usable = matches!(row.number_at(*index, column), Ok(Some(_)));
                if !usable {
                    let kind = WarningKind::ColumnWithoutNumbers(column.clone());
                    warnings.push(SessionWarning::new(name, kind));
                }
                usable
            });
        }
        let covariate = |(index, column): &(usize, String)| {
            row.number_at(*index, column)?
                .ok_or_else(|| row.error(column, "a number (a covariate in every row)", "nothing"))
        };
        let reading = TransducerRow {
            source: name.to_owned(),
            line: row.line,
            point: row.point(point)?,
            role: row.role(role)?,
            stimulus: row.required(stimulus)?,
            response: row.required(response)?,
            t_s: row.number(t_s)?,
            temperature_degc: row.number(temperature)?,
            direction: row.sign(direction)?,
            replicate: row.count(replicate, 0)?,
            covariates: extra.iter().map(covariate).collect::<Result<_, InputError>>()?,
        };
        points.note(&row, reading.point)?;
        rows.push(reading);
    }
    let covariates: Vec<String> = extra.into_iter().map(|(_, column)| column).collect();
    let names = Names { setting: "stimulus", reading: "response", more: &covariates };
    screen(name, &names, &mut rows, reference, warnings)?;
    warnings.extend(Clock::of(rows.iter().map(|r| (r.line, r.t_s))).warning(name));
    warnings.extend(table.open_end());
    Ok(TransducerTable { rows, covariates, input: table.finish()? })
}
