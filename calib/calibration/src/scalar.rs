//! Transducers and axes: the response at a stimulus, the stimulus of a response, the error of a
//! position.

use crate::apply::{AppliedTable, Calibration, SessionSystem, WhiskerCalibration};
use crate::error::CalibrationError;
use std::collections::BTreeMap;
use std::path::Path;
use wcal_core::observation::Role;
use wcal_core::text::number;
use wcal_session::{TextTable, TextTableLayout, asked_name, read_text_table};
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
        // A table of the form that the session was imported from is read as it was then.
        let own = self
            .columns
            .iter()
            .flat_map(|(name, own)| [name.as_str(), own, asked_name(own)])
            .map(str::to_owned);
        let asked = (!self.columns.is_empty()).then(|| own.collect());
        let table = read_text_table(
            table,
            &TextTableLayout {
                asked,
                ..TextTableLayout::default()
            },
        )?;
        let axis = self.session_kind == "axis";
        let columns = Columns {
            table: &table,
            own: &self.columns,
        };
        for (name, unit) in [
            ("stimulus", &self.stimulus_unit),
            ("response", &self.response_unit),
        ] {
            let column = table.imported(name, &self.columns);
            column.map_or(Ok(()), |column| table.check_unit(&column, unit))?;
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
        let needed = self.effects.iter().any(|e| e.id == "cross-axis");
        let further = self.covariates.iter();
        let covariates = further.map(|name| columns.numbers(name, needed));
        let covariates = covariates.collect::<Result<Vec<_>, _>>()?;
        // The inverse searches the whole range: the stimulus that stands here is replaced there.
        let middle = 0.5 * (self.stimulus_range[0] + self.stimulus_range[1]);
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
        let predicted = if inverse {
            self.invert(&rows)
        } else {
            self.predict(&rows)
        };
        let predicted =
            predicted.map_err(|e| CalibrationError::content(Path::new(&table.file), e))?;
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
                "{outside} of {} readings lie outside the fitted {}, {low} to {high} {}",
                rows.len(),
                self.declared.format_text("stimuli"),
                self.stimulus_unit
            )
        });
        Ok(AppliedTable {
            csv,
            rows: rows.len(),
            outside,
            warnings: table.warning().into_iter().collect(),
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
