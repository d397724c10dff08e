//! Transducers and axes: the response at a stimulus, the stimulus of a response, the error of a
//! position.

use crate::apply::{AppliedTable, Calibration, SessionSystem, WhiskerCalibration};
use crate::error::CalibrationError;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::SessionData;
use wcal_core::observation::Role;
use wcal_core::text::{number, with_unit};
use wcal_session::{InputError, TextTable, TextTableLayout, asked_name, load, read_text_table};
use wcal_verify::scalar::{ScalarModel, ScalarRow, judgement};
use wcal_verify::verify::HeldOut;

/// A table's columns by the session's names; a table that has none of such a name may have the
/// column that the session's table was made of.
struct Columns<'a> {
    table: &'a TextTable,
    own: &'a BTreeMap<String, String>,
}

impl Columns<'_> {
    /// Numbers of a column that may have gaps; none where the table has no such column.
    fn gappy(&self, name: &str) -> Result<Option<Vec<Option<f64>>>, CalibrationError> {
        let column = self.table.imported(name, self.own);
        Ok(column
            .map(|column| self.table.values(name, &column))
            .transpose()?)
    }

    /// A column of numbers without gaps; none where the table has no such column.
    fn numbers(&self, name: &str, required: bool) -> Result<Option<Vec<f64>>, CalibrationError> {
        let Some(values) = self.gappy(name)? else {
            if required {
                let own = self.own.get(name).map(String::as_str);
                self.table.asked(own.unwrap_or(name))?;
            }
            return Ok(None);
        };
        let whole: Option<Vec<f64>> = values.iter().copied().collect();
        whole.map(Some).ok_or_else(|| {
            let gap = values.iter().position(Option::is_none).unwrap_or_default();
            let line = self.table.rows[gap].0;
            let detail =
                format!("line {line}: field {name}: expected a number in every row, found nothing");
            CalibrationError::content(Path::new(&self.table.file), detail)
        })
    }
}

/// A table as the model sees it.
struct TableRows {
    table: TextTable,
    rows: Vec<ScalarRow>,
    /// It has the response alone.
    inverse: bool,
    /// What was measured at the places that are predicted.
    measured: Option<Vec<Option<f64>>>,
}

/// Reads a table of stimuli, of responses or of both.
///
/// # Errors
/// Where it cannot be read, has other units, or lacks a column.
fn table_rows(model: &ScalarModel, table: &Path) -> Result<TableRows, CalibrationError> {
    // A table of the form that the session was imported from is read as it was then.
    let own = model
        .columns
        .iter()
        .flat_map(|(name, own)| [name.as_str(), own, asked_name(own)])
        .map(str::to_owned);
    let asked = (!model.columns.is_empty()).then(|| own.collect());
    let table = read_text_table(
        table,
        &TextTableLayout {
            asked,
            ..TextTableLayout::default()
        },
    )?;
    let axis = model.session_kind == "axis";
    let columns = Columns {
        table: &table,
        own: &model.columns,
    };
    for (name, unit) in [
        ("stimulus", &model.stimulus_unit),
        ("response", &model.response_unit),
    ] {
        let column = table.imported(name, &model.columns);
        let other = |e: InputError| CalibrationError::OtherUnit(e.to_string());
        column.map_or(Ok(()), |column| {
            table.check_unit(&column, unit).map_err(other)
        })?;
    }
    let stimulus = columns.numbers(if axis { "commanded_mm" } else { "stimulus" }, axis)?;
    let inverse = stimulus.is_none();
    let response = if inverse {
        columns.numbers("response", true)?
    } else {
        None
    };
    // What was measured at the places that are predicted is written next to the prediction.
    let measured = match (inverse, axis) {
        (true, _) => None,
        (false, true) => columns.gappy("measured_mm")?,
        (false, false) => columns.gappy("response")?,
    };
    let optional = |name| columns.numbers(name, false);
    let (t_s, temperature) = (optional("t_s")?, optional("temperature_degc")?);
    let (direction, cycle) = (optional("direction")?, optional("cycle")?);
    let point = optional("point")?;
    let needed = model.effects.iter().any(|e| e.id == "cross-axis");
    let further = model.covariates.iter();
    let covariates = further.map(|name| columns.numbers(name, needed));
    let covariates = covariates.collect::<Result<Vec<_>, _>>()?;
    // The inverse searches the whole range: the stimulus that stands here is replaced there.
    let middle = 0.5 * (model.stimulus_range[0] + model.stimulus_range[1]);
    let rows: Vec<ScalarRow> = (0..table.rows.len())
        .map(|k| {
            let at = |values: &Option<Vec<f64>>| values.as_ref().map(|v| v[k]);
            ScalarRow {
                origin: (
                    table.file.clone(),
                    table.rows[k].0,
                    at(&point).map_or(k as i64, |p| p as i64),
                ),
                role: Role::Verification,
                x: at(&stimulus).unwrap_or(middle),
                x_sd: None,
                y: at(&response).unwrap_or_default(),
                t_s: at(&t_s),
                temperature_degc: at(&temperature),
                direction: at(&direction),
                cycle: at(&cycle).map(|c| c as u32),
                covariates: covariates
                    .iter()
                    .map(|c| at(c).unwrap_or_default())
                    .collect(),
                place: None,
            }
        })
        .collect();
    Ok(TableRows {
        table,
        rows,
        inverse,
        measured,
    })
}

/// The readings of a table or session with their responses, for
/// [`ScalarModel::check_readings`].
///
/// # Errors
/// Where they cannot be read, or lack a response; [`CalibrationError::is_mismatch`] where they are
/// of another kind or unit.
pub fn rows_to_check(
    model: &ScalarModel,
    readings: &Path,
) -> Result<Vec<ScalarRow>, CalibrationError> {
    if readings.is_dir() || readings.ends_with("session.toml") {
        let session = load(readings)?;
        let SessionData::Transducer(data) = &session.data else {
            let found = session.kind.to_string();
            return Err(CalibrationError::other_kind(&found, &model.session_kind));
        };
        if session.kind.to_string() != model.session_kind {
            let found = session.kind.to_string();
            return Err(CalibrationError::other_kind(&found, &model.session_kind));
        }
        if (&data.stimulus_unit, &data.response_unit)
            != (&model.stimulus_unit, &model.response_unit)
        {
            let detail = format!(
                "expected {} and {}, found {} and {}",
                model.stimulus_unit, model.response_unit, data.stimulus_unit, data.response_unit
            );
            return Err(CalibrationError::OtherUnit(detail));
        }
        return Ok(model.declared.rows(&data.rows));
    }
    let axis = model.session_kind == "axis";
    let read = table_rows(model, readings)?;
    let field = if axis { "measured_mm" } else { "response" };
    let Some(measured) = read.measured.filter(|_| !read.inverse) else {
        let field = if read.inverse { "stimulus" } else { field };
        let own = model.columns.get(field).map(String::as_str);
        read.table.asked(own.unwrap_or(field))?;
        let detail = format!("expected a column {field} with readings, found none");
        return Err(CalibrationError::content(readings, detail));
    };
    let mut rows = read.rows;
    let read = rows.iter_mut().zip(measured);
    // The error of an axis is in um, its positions in mm.
    let kept = read.filter_map(|(row, y)| {
        let y = y?;
        row.y = if axis { 1e3 * (y - row.x) } else { y };
        Some(row.clone())
    });
    Ok(kept.collect())
}

impl Calibration for ScalarModel {
    fn name(&self) -> &str {
        "scalar"
    }

    fn session_kind(&self) -> &str {
        &self.session_kind
    }

    fn check(&self) -> Result<(), CalibrationError> {
        Ok(ScalarModel::check(self)?)
    }

    fn apply(&self, table: &Path) -> Result<AppliedTable, CalibrationError> {
        let axis = self.session_kind == "axis";
        let TableRows {
            table,
            rows,
            inverse,
            measured,
        } = table_rows(self, table)?;
        let mut remark = inverse.then(|| self.inverse_remark(&rows)).flatten();
        let predicted = match inverse {
            true => self.invert(&rows),
            // Without an order the mean of both ways stands for an effect with memory.
            false => self.predict(&rows).or_else(|e| {
                let alone = self.predict_both_ways(&rows).ok_or(e);
                alone.inspect(|_| remark = self.inverse_remark(&rows))
            }),
        };
        let predicted =
            predicted.map_err(|e| CalibrationError::content(Path::new(&table.file), e))?;
        if self.has_gaps_at(&rows) {
            let gaps = "positions between the places of the table were not measured: half95 holds what leaving out every second place shows";
            remark.get_or_insert_with(|| gaps.to_owned());
        }
        let mut csv = match (axis, inverse) {
            (true, _) => {
                "point,commanded_mm,error_um,error_half95_um,expected_mm,outside_valid_region"
            }
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
            csv += &format!("{},{given},{},{}", row.origin.2, p.value, p.half95);
            // Errors are in um, positions in mm.
            if axis {
                csv += &format!(",{}", row.x + 1e-3 * p.value);
            }
            csv += &format!(",{}", u8::from(!p.valid));
            match measured.as_ref().map(|m| m[k]) {
                None => {}
                Some(None) => csv.push_str(",,"),
                Some(Some(v)) if axis => csv += &format!(",{v},{}", 1e3 * (v - row.x) - p.value),
                Some(Some(v)) => csv += &format!(",{v},{}", v - p.value),
            }
            csv.push('\n');
        }
        let outside = predicted.iter().filter(|p| !p.valid).count();
        let [low, high] = self.stimulus_range.map(|v| number(v, 10));
        let outside = (outside > 0).then(|| {
            format!(
                "{outside} of {} readings lie outside the fitted {}, {}",
                rows.len(),
                self.declared.format_text("stimuli"),
                with_unit(&format!("{low} to {high}"), &self.stimulus_unit)
            )
        });
        Ok(AppliedTable {
            csv,
            rows: rows.len(),
            outside,
            warnings: table.warning().into_iter().collect(),
            remarks: remark.into_iter().collect(),
        })
    }

    fn judged_readings(
        &self,
        session: SessionSystem<'_>,
        only_sealed: bool,
    ) -> Result<Option<Vec<HeldOut>>, CalibrationError> {
        match session {
            SessionSystem::Scalar(system) if session.kind() == self.session_kind => {
                Ok(Some(judgement::of_model(system, self, only_sealed)?))
            }
            _ => Err(CalibrationError::other_kind(
                session.kind(),
                &self.session_kind,
            )),
        }
    }

    fn whisker(&self) -> Option<&dyn WhiskerCalibration> {
        None
    }
}
