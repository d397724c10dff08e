//! Does a calibration still hold, and what changed since?
//!
//! ```text
//! e = y - f(x),     V = diag(s^2) + G C G'                     noise of each reading, and what the calibration has wrong in all of them
//! d = c' V^-1 e / c' V^-1 c,     sd(d)^2 = 1 / c' V^-1 c       of a change d along the column c
//! T = e' V^-1 X (X' V^-1 X)^-1 X' V^-1 e  ~  chi2_k            all k changes at once
//! tare      V + L^2 1 1',  L -> infinity                        a zero of which nothing is known beforehand: its column goes
//! ```
//!
//! Columns: zero 1; sensitivity f(x) - f(x0), relative; what each accepted effect adds to f(x),
//! relative; where none is accepted, temperature T - T0 and the direction. Named changes are fitted
//! together. One is named where no other one explains the readings nearly as well.

use super::frame::{Declared, ScalarRow};
use super::model::{ModelError, ScalarModel};
use super::predictions::{Fitted, gradient};
use super::sequence::ways;
use crate::MeasurementModel;
use crate::effect::{EffectTerm, Role};
use crate::levels::{LEAD, NORMAL_95};
use crate::method::distributions::{f_tail, sd_interval95};
use crate::method::settings;
use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::Serialize;

/// Chance that a unit that did not change is said to have.
const CHANGED: f64 = 0.02;
/// The same of its scatter.
const SCATTER: f64 = 0.01;
/// Of a second change beside the first.
const FURTHER: f64 = 0.01;
/// Quantile of a normal for a power of 90 %.
const POWER_90: f64 = 1.2816;
/// Falls of the statistic within which two changes are not distinguished.
const ALIKE: f64 = 0.5 * LEAD;

/// Fewest readings that say anything.
const LEAST: usize = 3;
/// What readings must show before a calibration is said to hold.
const MATTERS: [&str; 2] = [ZERO, "sensitivity"];
/// The change that a tare takes out.
const ZERO: &str = "zero";
/// Standard deviation of a zero that is not known, in units of the largest of a reading.
const UNKNOWN: f64 = 1e4;

/// A change since the calibration.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct CalibrationChange {
    /// `zero`, `sensitivity`, an accepted effect, `temperature`, `hysteresis`, `scatter`.
    pub name: String,
    /// Size.
    pub value: f64,
    /// Its 95 % interval.
    pub interval95: [f64; 2],
    /// Unit of both.
    pub unit: String,
    /// What it costs at most within the range, in the unit of the quantity that is measured.
    pub cost: f64,
    /// Changes that explain the readings nearly as well.
    pub or: Vec<String>,
}

/// What the readings can show of a change.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Tested {
    /// Change.
    pub name: String,
    /// Cost of the smallest change that is seen in nine of ten such tests; null where none is.
    pub smallest: Option<f64>,
    /// That is no more than the stated uncertainty of one reading.
    pub is_tested: bool,
    /// Readings that would be needed, spread as these are; null where none are enough.
    pub readings_needed: Option<usize>,
}

/// The zero of readings that were tared.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct TaredZero {
    /// Unloaded readings.
    pub readings: usize,
    /// Their mean error: how far the zero is from the calibration's.
    pub zero: f64,
    /// Unit of the zero.
    pub unit: String,
}

/// What readings say of a calibration.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct CalibrationCheck {
    /// Readings.
    pub readings: usize,
    /// Chance of readings as far off, had nothing changed.
    pub p: f64,
    /// What changed; empty where nothing did.
    pub changes: Vec<CalibrationChange>,
    /// What the readings can show.
    pub tested: Vec<Tested>,
    /// Expanded uncertainty of one reading that the calibration states, largest of these readings.
    pub stated: f64,
    /// Unit of costs.
    pub unit: String,
    /// Zero that was taken from the readings themselves; null without --tare.
    pub tare: Option<TaredZero>,
}

struct Column {
    name: String,
    unit: String,
    values: DVector<f64>,
    /// Largest size over the calibrated range.
    largest: f64,
}

impl CalibrationCheck {
    /// The readings would show a change of zero and sensitivity that matters.
    pub fn is_tested(&self) -> bool {
        let untested = |t: &Tested| !t.is_tested && MATTERS.contains(&t.name.as_str());
        !self.tested.iter().any(untested)
    }
}

impl ScalarModel {
    /// Judges the calibration by `rows` with their responses, which it was not fitted to.
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
        let mut covariance = DMatrix::from_fn(n, n, |i, j| {
            shared[(i, j)] + if i == j { noise[i] * noise[i] } else { 0.0 }
        });
        let errors = DVector::from_fn(n, |i, _| rows[i].y + self.offset - values[i]);
        let mut columns = self.columns_of_change(rows, &fitted, &values, &slopes)?;
        let tared = tare.then(|| self.tared(rows, &errors)).transpose()?;
        if tared.is_some() {
            // Any zero is as probable: what all readings share alone says nothing.
            let unknown = UNKNOWN * UNKNOWN * covariance.diagonal().max();
            covariance.add_scalar_mut(unknown);
            columns.retain(|c| c.name != ZERO);
        }
        let degenerate = || shape("noise above 0", "none");
        let root = covariance.clone().cholesky().ok_or_else(degenerate)?.l();
        let white = |v: &DVector<f64>| root.solve_lower_triangular(v).unwrap_or_else(|| v.clone());
        let (e, x): (DVector<f64>, Vec<DVector<f64>>) = (
            white(&errors),
            columns.iter().map(|c| white(&c.values)).collect(),
        );
        // A response's error is worth so much of the stimulus.
        let slope = self.mean_slope()?;
        let cost = |k: usize, size: f64| size.abs() * columns[k].largest / slope;
        let all = explained(&x, &e);
        let left = (e.norm_squared() - all).max(0.0);
        // The noise is an estimate, too.
        let p_of =
            |squares: f64, count: f64| f_tail(squares / count, [count, self.dof]).unwrap_or(1.0);
        let p = p_of(all, x.len() as f64);
        let left_dof = n.saturating_sub(x.len()) as f64;
        let p_scatter = p_of(left, left_dof);
        let mut changes = Vec::new();
        let mut named: Vec<usize> = Vec::new();
        let mut or: Vec<Vec<String>> = Vec::new();
        let mut chance = (p, CHANGED);
        while chance.0 < chance.1 && named.len() < x.len() {
            // What each would explain beside those that are named.
            let with = |k: usize| {
                let all: Vec<DVector<f64>> =
                    named.iter().chain([&k]).map(|k| x[*k].clone()).collect();
                explained(&all, &e)
            };
            let free = (0..x.len()).filter(|k| !named.contains(k));
            let falls: Vec<(usize, f64)> = free.map(|k| (k, with(k))).collect();
            let Some(&(best, most)) = falls.iter().max_by(|a, b| a.1.total_cmp(&b.1)) else {
                break;
            };
            let rivals = falls
                .iter()
                .filter(|(k, fall)| *k != best && most - fall < ALIKE);
            or.push(rivals.map(|(k, _)| columns[*k].name.clone()).collect());
            named.push(best);
            chance = (
                p_of((all - most).max(0.0), (x.len() - named.len()) as f64),
                FURTHER,
            );
        }
        // Together, so that none is taken for a part of another.
        let joint: Vec<DVector<f64>> = named.iter().map(|k| x[*k].clone()).collect();
        for ((k, or), (size, sd)) in named.iter().zip(or).zip(together(&joint, &e)) {
            changes.push(CalibrationChange {
                name: columns[*k].name.clone(),
                value: size,
                interval95: [-1.0, 1.0].map(|s| size + s * NORMAL_95 * sd),
                unit: columns[*k].unit.clone(),
                cost: cost(*k, size),
                or,
            });
        }
        if p_scatter < SCATTER {
            let ratio = (left / left_dof).sqrt();
            changes.push(CalibrationChange {
                name: "scatter".to_owned(),
                value: ratio,
                interval95: sd_interval95(ratio, left_dof).unwrap_or([ratio; 2]),
                unit: "times the stated".to_owned(),
                cost: NORMAL_95 * ratio * noise.iter().fold(0.0, |a: f64, b| a.max(*b)) / slope,
                or: Vec::new(),
            });
        }
        let stated = predicted.iter().filter(|p| p.valid).map(|p| p.half95);
        let stated = stated.fold(0.0, f64::max) / slope;
        let tested = (0..x.len()).map(|k| {
            let smallest = cost(k, (NORMAL_95 + POWER_90) / x[k].norm());
            // One reading cannot distinguish a shift from a stray.
            let many = smallest > stated || n < LEAST;
            // What all readings share is no smaller by more of them.
            let share = shared
                .diagonal()
                .iter()
                .fold(0.0, |a: f64, b| a.max(*b))
                .sqrt();
            let floor = (NORMAL_95 + POWER_90) * share / slope;
            let factor = (smallest / stated).powi(2);
            let needed = (n as f64 * factor).ceil() as usize;
            Tested {
                name: columns[k].name.clone(),
                smallest: Some(smallest),
                is_tested: !many,
                readings_needed: (many && floor < stated).then_some(needed.max(LEAST)),
            }
        });
        let mut tested: Vec<Tested> = tested.collect();
        let shown = |name: &str| columns.iter().any(|c| c.name == name);
        tested.extend(
            MATTERS
                .iter()
                .filter(|name| !shown(name) && !(tare && **name == ZERO))
                .map(|name| Tested {
                    name: (*name).to_owned(),
                    smallest: None,
                    is_tested: false,
                    readings_needed: None,
                }),
        );
        Ok(CalibrationCheck {
            readings: n,
            p,
            tested,
            changes,
            stated,
            tare: tared,
            unit: match self.declared {
                Declared::Axis => self.response_unit.clone(),
                Declared::Polynomial(_) => self.stimulus_unit.clone(),
            },
        })
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
            largest,
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
        let mut kept: Vec<Column> = Vec::new();
        for column in columns {
            let others: Vec<DVector<f64>> = kept.iter().map(|c| c.values.clone()).collect();
            let own = column.values.norm_squared();
            if own - explained(&others, &column.values) > 1e-9 * own {
                kept.push(column);
            }
        }
        Ok(kept)
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
                largest,
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

/// Sizes of the columns fitted together to whitened errors, and their standard deviations.
fn together(columns: &[DVector<f64>], e: &DVector<f64>) -> Vec<(f64, f64)> {
    if columns.is_empty() {
        return Vec::new();
    }
    let x = DMatrix::from_columns(columns);
    let Some(inverse) = (x.transpose() * &x).try_inverse() else {
        return Vec::new();
    };
    let sizes = &inverse * (x.transpose() * e);
    let sd = |k: usize| inverse[(k, k)].max(0.0).sqrt();
    (0..columns.len()).map(|k| (sizes[k], sd(k))).collect()
}

/// Squares of `e` that the columns explain.
fn explained(columns: &[DVector<f64>], e: &DVector<f64>) -> f64 {
    if columns.is_empty() {
        return 0.0;
    }
    let x = DMatrix::from_columns(columns);
    let normal = x.transpose() * &x;
    let right = x.transpose() * e;
    let solved = normal.svd(true, true).solve(&right, 1e-12);
    solved.map_or(0.0, |b| b.dot(&right))
}
