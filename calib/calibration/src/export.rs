//! A calibration as numbers for programs that run where the reading is made.
//!
//! Of a transducer the stimulus over the response is tabulated, of an axis the error over the
//! commanded position: one table for each direction and place of the temperature that the law
//! needs. Between Chebyshev places the temperature is interpolated by Lagrange's formula. The
//! tables come from the model's own predictions, whatever effects it has, and are compared with
//! them.

use crate::artefact::CalibrationModel;
use crate::error::CalibrationError;
use crate::export_law::Law;
use crate::export_map;
use crate::export_table::Table;
use crate::exported::Export;
use std::f64::consts::PI;
use wcal_verify::effect::LawRequirement::{BothDirections, Temperature};
use wcal_verify::scalar::ScalarModel;

/// Most pieces of all tables.
const MAX_PIECES: usize = 4096;
/// Largest misfit of a piece, and of the whole, as a share of what value and half width span.
const TOLERANCE: f64 = 1e-7;
const LIMIT: f64 = 1e-6;
/// Places at which the tables are compared with the model, and how many are kept for the self-test.
const PLACES: usize = 400;
const KEPT: usize = 32;

/// What a calibration is as code.
///
/// # Errors
/// [`CalibrationError::NotExported`] where an answer depends on more than the present reading, or
/// the tables miss the model.
pub fn export(model: &CalibrationModel) -> Result<Export, CalibrationError> {
    match model {
            CalibrationModel::Scalar(model) => of_scalar(model),
            CalibrationModel::Map(map) => export_map::of_map(map),
            CalibrationModel::Physical(_) => Err(CalibrationError::NotExported(
                "expected a map, found a whisker's calibration of verify (wcal fit-gpr makes the map of its session)".to_owned(),
            )),
        }
}

/// Tables of one law, direction by direction and in each by temperature.
struct Tables {
    directions: Vec<f64>,
    temperatures_degc: Vec<f64>,
    tables: Vec<Table>,
}

fn of_scalar(model: &ScalarModel) -> Result<Export, CalibrationError> {
    let effects = model.inputs()?;
    let law = Law::new(model, &effects)?;
    let needs = |asked| effects.iter().any(|e| e.needs.contains(&asked));
    let stated = || {
        let why = "expected `temperature_range` beside an effect of the temperature, found none (verify the session anew)";
        model
            .temperature_range
            .ok_or(CalibrationError::NotExported(why.to_owned()))
    };
    let warm = needs(Temperature).then(stated).transpose()?;
    let directions = if needs(BothDirections) {
        vec![1.0, -1.0]
    } else {
        vec![1.0]
    };
    let places = law.places(PLACES, &directions, warm.unwrap_or_default())?;
    let known: Vec<[f64; 2]> = law.values(&places)?;
    let span = |c: usize| {
        let values = || known.iter().map(move |k| k[c]);
        values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
    };
    let half = known.iter().map(|k| k[1]).fold(0.0, f64::max);
    // A constant spans nothing: its half width is its scale.
    let size = [span(0).max(half), half];
    // As few places of the temperature as hold the limit.
    let counts: &[usize] = if warm.is_some() { &[3, 5, 9, 17] } else { &[1] };
    let mut missed = [0.0; 2];
    for &count in counts {
        // Chebyshev places of the second kind: the ends of the range are two of them.
        let share = |k: usize| 0.5 - 0.5 * (PI * k as f64 / (count as f64 - 1.0)).cos();
        let of = |[a, b]: [f64; 2]| (0..count).map(|k| a + (b - a) * share(k)).collect();
        let mut tables = Tables {
            directions: directions.clone(),
            temperatures_degc: warm.map_or(vec![0.0], of),
            tables: Vec::new(),
        };
        tables.fill(&law, size)?;
        missed = tables.misfit(&places, &known);
        if (0..2).all(|c| missed[c] <= LIMIT * size[c]) {
            let points = law.inverse && tables.tables.len() == 1;
            let points = points.then(|| tables.tables[0].points(LIMIT * size[0]));
            let mut units = [&model.stimulus_unit, &model.response_unit].map(String::clone);
            units.rotate_left(usize::from(law.inverse));
            let input = if law.inverse {
                "response"
            } else {
                "commanded_mm"
            };
            return Ok(Export {
                template: "scalar",
                inputs: [
                    Some(input),
                    warm.map(|_| "temperature_degc"),
                    needs(BothDirections).then_some("direction"),
                ],
                units,
                numbers: tables.numbers(&places, &known, size),
                // A chord misses the table, which misses the model.
                points: points.map(|(points, miss)| (points, miss + missed[0])),
            });
        }
    }
    Err(CalibrationError::NotExported(format!(
        "expected tables within {LIMIT:e} of what value and half width span, {size:.3?}, found them off by {missed:?}"
    )))
}

impl Tables {
    /// Makes the tables.
    fn fill(&mut self, law: &Law<'_>, size: [f64; 2]) -> Result<(), CalibrationError> {
        let mut left = MAX_PIECES;
        for &direction in &self.directions {
            for &degc in &self.temperatures_degc {
                let ends = law.ends(degc, direction)?;
                let of = |shares: &[f64]| {
                    let input = |s: &f64| [ends[0] + s * (ends[1] - ends[0]), degc, direction];
                    law.values(&shares.iter().map(input).collect::<Vec<_>>())
                };
                let table = Table::of(ends, size.map(|s| TOLERANCE * s), left, of)?;
                left -= table.pieces.len();
                self.tables.push(table);
            }
        }
        Ok(())
    }

    /// Largest differences from the model in value and half width at places between the tables'.
    fn misfit(&self, places: &[[f64; 3]], known: &[[f64; 2]]) -> [f64; 2] {
        let miss = |(place, known): (&[f64; 3], &[f64; 2])| {
            let found = self.at(*place).unwrap_or([f64::INFINITY; 2]);
            // What is no number fits nothing.
            let miss = [0, 1].map(|c| (found[c] - known[c]).abs());
            miss.map(|m| if m.is_finite() { m } else { f64::INFINITY })
        };
        let all = places.iter().zip(known).map(miss);
        all.fold([0.0; 2], |most, miss| [0, 1].map(|c| most[c].max(miss[c])))
    }

    /// Value and half width at an input, temperature (deg C) and direction; none outside the valid
    /// range. The exported code does the same.
    fn at(&self, [input, degc, direction]: [f64; 3]) -> Option<[f64; 2]> {
        let places = &self.temperatures_degc;
        let of = self.directions.iter().position(|d| *d == direction)?;
        let tables = &self.tables[of * places.len()..(of + 1) * places.len()];
        // Lagrange: the polynomial in the temperature through the tables' answers.
        let weight = |k: usize| -> f64 {
            let others = (0..places.len()).filter(|j| *j != k);
            let factors = others.map(|j| (degc - places[j]) / (places[k] - places[j]));
            factors.product()
        };
        let weights: Vec<f64> = (0..places.len()).map(weight).collect();
        let sum = |of: &dyn Fn(&Table) -> f64| -> f64 {
            weights.iter().zip(tables).map(|(w, t)| w * of(t)).sum()
        };
        let [low, high, below, above] = [0, 1, 2, 3].map(|k| sum(&|t| t.ends[k]));
        let inside = input >= low - below && input <= high + above;
        let share = ((input - low) / (high - low)).clamp(0.0, 1.0);
        inside.then(|| [0, 1].map(|c| sum(&|t| t.at(share)[c])))
    }

    fn numbers(
        &self,
        places: &[[f64; 3]],
        known: &[[f64; 2]],
        size: [f64; 2],
    ) -> Vec<(&'static str, Vec<Vec<f64>>)> {
        let flat = |values: &[f64]| values.iter().map(|v| vec![*v]).collect::<Vec<_>>();
        let rows = |table: &Table| table.pieces.iter().map(|p| p.to_vec()).collect::<Vec<_>>();
        let mut first = vec![0.0];
        first.extend(self.tables.iter().scan(0.0, |all, table| {
            *all += table.pieces.len() as f64;
            Some(*all)
        }));
        // For the self-test: some of the model's answers, and one outside.
        let kept = places.iter().zip(known).take(KEPT);
        let kept = kept.map(|(place, known)| [&place[..], known, &[0.0]].concat());
        let mut stored: Vec<Vec<f64>> = kept.collect();
        let [low, high, _, above] = self.tables[0].ends;
        let outside = high + 2.0 * above + 0.1 * (high - low);
        let (degc, direction) = (self.temperatures_degc[0], self.directions[0]);
        stored.push(vec![outside, degc, direction, 0.0, 0.0, 1.0]);
        vec![
            ("DIRECTIONS", flat(&[self.directions.len() as f64])),
            ("PLACES", flat(&[self.temperatures_degc.len() as f64])),
            ("DEGC", flat(&self.temperatures_degc)),
            (
                "ENDS",
                self.tables.iter().map(|t| t.ends.to_vec()).collect(),
            ),
            ("FIRST", flat(&first)),
            ("PIECES", self.tables.iter().flat_map(rows).collect()),
            ("STORED", stored),
            ("TOLERANCE", flat(&size.map(|s| 2.0 * LIMIT * s))),
        ]
    }
}
