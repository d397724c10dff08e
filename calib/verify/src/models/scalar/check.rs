//! Does a calibration still hold, and what changed since?
//!
//! Columns of [`crate::models::change`]: zero 1; sensitivity f(x) - f(x0), relative; what each
//! accepted effect adds to f(x), relative; where none is accepted, temperature T - T0 and the
//! direction. A tared zero is one of which nothing is known beforehand, V + L^2 1 1' with L without
//! bound: its column goes.

use super::frame::{Declared, ScalarRow};
use super::model::{ModelError, ScalarModel};
use super::predictions::{Fitted, gradient};
use super::sequence::ways;
use crate::MeasurementModel;
use crate::effect::{EffectTerm, Role};
use crate::method::{Basis, settings};
use crate::models::change::{CalibrationCheck, Column, NewReadings, TaredZero, Tested};
use nalgebra::{DMatrix, DVector};

/// What readings must show before a calibration is said to hold.
const MATTERS: [&str; 2] = [ZERO, "sensitivity"];
/// The change that a tare takes out.
const ZERO: &str = "zero";
/// Standard deviation of a zero that is not known, in units of the largest of a reading.
const UNKNOWN: f64 = 1e4;

impl ScalarModel {
    /// Judges the calibration by `rows` with their responses, which it was not fitted to; `tare`: by
    /// the zero of their own unloaded readings.
    ///
    /// # Errors
    /// As [`Self::predict`], and where no reading lies within the range, or with `tare` at stimulus 0.
    pub fn check_readings(
        &self,
        rows: &[ScalarRow],
        tare: bool,
    ) -> Result<CalibrationCheck, ModelError> {
        // Readings for a check are taken one after another: their order says the directions.
        let mut ordered = rows.to_vec();
        if rows
            .iter()
            .all(|r| r.direction.is_none() && r.t_s.is_none())
        {
            let x: Vec<f64> = rows.iter().map(|r| r.x).collect();
            let found = ways(&settings(&x));
            ordered.iter_mut().zip(found).for_each(|(r, way)| {
                r.direction = Some(if way < 0.0 { -1.0 } else { 1.0 });
            });
        }
        let rows = &ordered[..];
        let predicted = self.predict(rows)?;
        let inside = (0..rows.len()).filter(|&k| predicted[k].valid);
        let mut numbered: Vec<ScalarRow> = inside.map(|k| rows[k].clone()).collect();
        (0..numbered.len()).for_each(|k| numbered[k].origin.1 = k);
        let shape = |expected: &str, found: &str| ModelError::Shape {
            what: "readings".to_owned(),
            expected: expected.to_owned(),
            found: found.to_owned(),
        };
        if numbered.is_empty() {
            return Err(shape("readings within the calibrated range", "none"));
        }
        let system = self.system(numbered);
        let fitted = self.fitted(self.terms(&system)?)?;
        let design = || {
            shape(
                "a design of the calibration's columns",
                "none at these rows",
            )
        };
        let (values, slopes) = gradient(&system, &fitted).ok_or_else(design)?;
        let rows = &system.frame.rows;
        let n = rows.len();
        let noise = self.noise_sd(&system.frame);
        let shared = &slopes * &fitted.covariance * slopes.transpose();
        let errors = DVector::from_fn(n, |i, _| rows[i].y + self.offset - values[i]);
        // A response's error is worth so much of the stimulus.
        let slope = self.mean_slope()?;
        let mut columns = self.columns_of_change(rows, &fitted, &values, &slopes)?;
        columns.iter_mut().for_each(|c| c.cost /= slope);
        let missing: Vec<&str> = (MATTERS.into_iter())
            .filter(|name| columns.iter().all(|c| c.name != *name))
            .collect();
        let mut of_noise = DMatrix::from_diagonal(&DVector::from_fn(n, |i, _| noise[i] * noise[i]));
        let tared = tare.then(|| self.tared(rows, &errors)).transpose()?;
        if tared.is_some() {
            // Any zero is as probable: what all readings share alone says nothing.
            let most = of_noise.diagonal().max() + shared.diagonal().max();
            of_noise.add_scalar_mut(UNKNOWN * UNKNOWN * most);
            columns.retain(|c| c.name != ZERO);
        }
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max) / slope;
        let stated = largest(&mut predicted.iter().filter(|p| p.valid).map(|p| p.half95));
        let found = NewReadings {
            readings: n,
            errors,
            noise: of_noise,
            dof: self.dof,
            columns,
            noise_cost: largest(&mut noise.iter().copied()),
            shared_cost: largest(&mut shared.diagonal().iter().map(|v| v.max(0.0).sqrt())),
            shared,
            stated,
            unit: match self.declared {
                Declared::Axis => self.response_unit.clone(),
                Declared::Polynomial(_) => self.stimulus_unit.clone(),
            },
        };
        let mut check = (found.check(None)).ok_or_else(|| shape("noise above 0", "none"))?;
        check.tare = tared;
        check.tested.extend(missing.into_iter().map(|name| Tested {
            name: name.to_owned(),
            sd: None,
            smallest: None,
            is_tested: false,
            is_required: true,
            readings_needed: None,
        }));
        Ok(check)
    }

    /// The zero by the readings at stimulus 0.
    fn tared(&self, rows: &[ScalarRow], errors: &DVector<f64>) -> Result<TaredZero, ModelError> {
        let unloaded = rows
            .iter()
            .zip(errors.iter())
            .filter(|(row, _)| row.x == 0.0);
        let unloaded: Vec<f64> = unloaded.map(|(_, e)| *e).collect();
        if unloaded.is_empty() {
            return Err(ModelError::Shape {
                what: "--tare".to_owned(),
                expected: "unloaded readings, at stimulus 0".to_owned(),
                found: "none".to_owned(),
            });
        }
        Ok(TaredZero {
            readings: unloaded.len(),
            zero: unloaded.iter().sum::<f64>() / unloaded.len() as f64,
            unit: self.response_unit.clone(),
        })
    }

    /// What can have changed, as the readings show it.
    fn columns_of_change(
        &self,
        rows: &[ScalarRow],
        fitted: &Fitted,
        values: &DVector<f64>,
        slopes: &DMatrix<f64>,
    ) -> Result<Vec<Column>, ModelError> {
        let n = rows.len();
        let of = |name: &str, unit: &str, largest: f64, value: &dyn Fn(usize) -> f64| Column {
            name: name.to_owned(),
            unit: unit.to_owned(),
            values: DVector::from_fn(n, |i, _| value(i)),
            cost: largest,
            one_sided: false,
            is_required: MATTERS.contains(&name),
        };
        let y = &self.response_unit;
        let mut columns = vec![of(ZERO, y, 1.0, &|_| 1.0)];
        let [low, high] = self.stimulus_range;
        if self.declared == Declared::Axis {
            // Relative, of the travel from the low end: um of a mm are 1e3.
            let travel = high - low;
            columns.push(of("sensitivity", "1", 1e3 * travel, &|i| {
                1e3 * (rows[i].x - low)
            }));
        } else if self.declared != Declared::Polynomial(0) {
            let origin = if low <= 0.0 && high >= 0.0 { 0.0 } else { low };
            let at = |x: f64| ScalarRow {
                x,
                ..rows[0].clone()
            };
            let ends = self.predict(&[at(origin), at(low), at(high)])?;
            let zero = ends[0].value;
            let largest = (ends[1].value - zero)
                .abs()
                .max((ends[2].value - zero).abs());
            columns.push(of("sensitivity", "1", largest, &|i| {
                values[i] - self.offset - zero
            }));
        }
        columns.extend(self.columns_of_effects(fitted, slopes));
        let accepted = |id: &str| self.effects.iter().any(|t| t.id == id);
        let spreads = |values: &[f64]| {
            let [least, most] = crate::models::range(values.iter().copied());
            most > least
        };
        let warm: Option<Vec<f64>> = rows.iter().map(|r| r.temperature_degc).collect();
        if let (Some(mean), Some(warm)) = (self.scaling.temperature, warm)
            && spreads(&warm)
            && !accepted("temperature")
        {
            let rise = warm.iter().map(|t| (t - mean).abs()).fold(0.0, f64::max);
            columns.push(of("temperature", &format!("{y}/K"), rise, &|i| {
                warm[i] - mean
            }));
        }
        let ways: Option<Vec<f64>> = rows.iter().map(|r| r.direction).collect();
        let looped = ["hysteresis", "backlash"].iter().any(|id| accepted(id));
        if let Some(ways) = ways.filter(|w| spreads(w) && !looped) {
            columns.push(of("hysteresis", y, 1.0, &|i| ways[i]));
        }
        // A column that is a sum of others shows nothing of its own.
        let mut basis = Basis::default();
        columns.retain(|c| {
            let own = basis.project_off(&c.values).norm_squared();
            basis.push(&c.values);
            own > 1e-9 * c.values.norm_squared()
        });
        Ok(columns)
    }

    /// What each accepted effect adds to the responses: as much more of it is one.
    fn columns_of_effects(&self, fitted: &Fitted, slopes: &DMatrix<f64>) -> Vec<Column> {
        let system = self.system(Vec::new());
        let law = |t: &EffectTerm| system.catalogue()[t.effect].law(t.law);
        let mut out = Vec::new();
        let terms = fitted.terms.iter().zip(&self.effects);
        for ((t, named), [columns, nonlinear]) in terms.zip(self.slots(&fitted.terms)) {
            let mut values = DVector::zeros(slopes.nrows());
            for k in columns {
                values += slopes.column(k) * fitted.coefficients[k];
            }
            let sizes = law(t).parameters.iter().zip(nonlinear).zip(&t.values);
            for ((p, slot), size) in sizes {
                if matches!(p.role, Role::Amplitude { .. }) {
                    values += slopes.column(slot) * *size;
                }
            }
            let largest = values.iter().fold(0.0, |a: f64, b| a.max(b.abs()));
            out.push(Column {
                name: named.id.clone(),
                unit: "1".to_owned(),
                values,
                cost: largest,
                one_sided: false,
                is_required: false,
            });
        }
        out
    }

    /// Mean slope of the response over the range; 1 of an axis, whose error is of its position.
    fn mean_slope(&self) -> Result<f64, ModelError> {
        if !matches!(self.declared, Declared::Polynomial(degree) if degree > 0) {
            return Ok(1.0);
        }
        let sheet = self.data_sheet();
        let found = sheet.as_ref().and_then(|s| s.characteristics.first());
        found
            .map(|c| c.value.abs())
            .ok_or_else(|| ModelError::Shape {
                what: "the response".to_owned(),
                expected: "a sensitivity".to_owned(),
                found: "none".to_owned(),
            })
    }
}
