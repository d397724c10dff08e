//! Transducers and axes: the response at a stimulus, the stimulus of a response, the error of a position.

use super::{PredictArgs, finish, write_table};
use crate::artefact::CalibrationModel;
use anyhow::{Context, bail};
use std::fmt::Write as _;
use std::process::ExitCode;
use wcal_core::CalibrationFile;
use wcal_core::observation::Role;
use wcal_session::{TextTable, TextTableLayout, read_text_table};
use wcal_trace::scalar::{ScalarModel, ScalarRow};

/// A column of numbers; none where the table has no such column.
fn column(table: &TextTable, name: &str, required: bool) -> anyhow::Result<Option<Vec<f64>>> {
    let Some(index) = table.columns.iter().position(|c| c == name) else {
        if required {
            table.column(name)?;
        }
        return Ok(None);
    };
    let mut values = Vec::with_capacity(table.rows.len());
    for row in 0..table.rows.len() {
        match table.number(row, index)? {
            Some(v) => values.push(v),
            None => bail!(
                "{}: line {}: field {name}: expected a number in every row, found nothing",
                table.file,
                table.rows[row].0
            ),
        }
    }
    Ok(Some(values))
}

/// Numbers of a column that may have gaps; none where the table has no such column.
fn gappy_column(table: &TextTable, name: &str) -> anyhow::Result<Option<Vec<Option<f64>>>> {
    let Some(index) = table.columns.iter().position(|c| c == name) else { return Ok(None) };
    Ok(Some((0..table.rows.len()).map(|row| table.number(row, index)).collect::<Result<_, _>>()?))
}

/// Through a transducer's or an axis's accepted model.
pub(super) fn by_scalar(
    args: &PredictArgs,
    file: &CalibrationFile<CalibrationModel>,
    model: &ScalarModel,
) -> anyhow::Result<ExitCode> {
    let table = read_text_table(&args.table, &TextTableLayout::default())?;
    let axis = model.session_kind == "axis";
    let stimulus = column(&table, if axis { "commanded_mm" } else { "stimulus" }, axis)?;
    let inverse = stimulus.is_none();
    let response = if inverse { column(&table, "response", true)? } else { None };
    // What was measured at the places that are predicted stands beside the prediction.
    let measured = match (inverse, axis) {
        (true, _) => None,
        (false, true) => gappy_column(&table, "measured_mm")?,
        (false, false) => gappy_column(&table, "response")?,
    };
    let [t_s, temperature, direction, point] =
        ["t_s", "temperature_degc", "direction", "point"].map(|name| column(&table, name, false));
    let (t_s, temperature, direction, point) = (t_s?, temperature?, direction?, point?);
    let needed = model.effects.iter().any(|e| e.id == "cross-axis");
    let mut covariates = Vec::new();
    for name in &model.covariates {
        covariates.push(column(&table, name, needed)?);
    }
    let middle = 0.5 * (model.stimulus_range[0] + model.stimulus_range[1]);
    let rows: Vec<ScalarRow> = (0..table.rows.len())
        .map(|k| {
            let at = |values: &Option<Vec<f64>>| values.as_ref().map(|v| v[k]);
            ScalarRow {
                origin: (table.file.clone(), table.rows[k].0, at(&point).map_or(k as i64, |p| p as i64)),
                role: Role::Verification,
                x: at(&stimulus).unwrap_or(middle),
                y: at(&response).unwrap_or(0.0),
                t_s: at(&t_s),
                temperature_degc: at(&temperature),
                direction: at(&direction),
                cycle: None,
                covariates: covariates.iter().map(|c| at(c).unwrap_or(0.0)).collect(),
                place: None,
            }
        })
        .collect();
    let predicted = if inverse { model.invert(&rows) } else { model.predict(&rows) };
    let predicted = predicted.with_context(|| table.file.clone())?;
    let mut csv = match (axis, inverse) {
        (true, _) => "point,commanded_mm,error_um,error_half95_um,expected_mm,outside_valid_region",
        (false, false) => "point,stimulus,response,response_half95,outside_valid_region",
        (false, true) => "point,response,stimulus,stimulus_half95,outside_valid_region",
    }
    .to_owned();
    csv += match (&measured, axis) {
        (None, _) => "\n",
        (Some(_), true) => ",measured_mm,residual_um\n",
        (Some(_), false) => ",response_measured,residual\n",
    };
    for (k, (row, p)) in rows.iter().zip(&predicted).enumerate() {
        let given = if inverse { row.y } else { row.x };
        write!(csv, "{},{given},{},{}", row.origin.2, p.value, p.half95)?;
        if axis {
            write!(csv, ",{}", row.x + 1e-3 * p.value)?;
        }
        write!(csv, ",{}", u8::from(!p.valid))?;
        match measured.as_ref().map(|m| m[k]) {
            None => {}
            Some(None) => csv.push_str(",,"),
            Some(Some(v)) if axis => write!(csv, ",{v},{}", 1e3 * (v - row.x) - p.value)?,
            Some(Some(v)) => write!(csv, ",{v},{}", v - p.value)?,
        }
        csv.push('\n');
    }
    write_table(args, file, &csv)?;
    let outside = predicted.iter().filter(|p| !p.valid).count();
    let [low, high] = model.stimulus_range;
    let doubt = (outside > 0).then(|| {
        format!(
            "{outside} of {} readings lie outside the fitted {}, {low} to {high} {}",
            rows.len(),
            model.declared.worded("stimuli"),
            model.stimulus_unit
        )
    });
    finish(args, file, "scalar", rows.len(), doubt)
}
