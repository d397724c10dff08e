//! The stimulus of a response.
//!
//! ```text
//! without memory   y = f(x)                                      by bisection in the fitted range
//! with memory      y_k = f(x_k; x_1 .. x_(k-1), s)               x <- x + (y - f(x)) / b, b: mean slope
//! x = mean of the least and the largest x over s,  U = hypot(U(f) / b, k u(reference)) + half their difference
//! ```
//!
//! The state `s` before the first reading is not known: it is that of a stimulus held at either end
//! of the range. Where the readings have led the state somewhere else, both give one stimulus. A
//! reading whose place in the order is not known stands alone: its stimulus is the mean of the ways
//! up and down.

use super::frame::ScalarRow;
use super::model::{ModelError, ScalarModel, ScalarPrediction};
use super::row::all;
use crate::MeasurementModel;
use crate::effect::LawRequirement;
use crate::method::t95;

/// Places at which the inverse checks that the response goes one way.
const PLACES: usize = 64;
/// Halvings that bring a bracket below the rounding of the stimulus.
const HALVINGS: usize = 60;
/// Steps of the iteration with memory; half loops far below the range need ten.
const STEPS: usize = 100;
/// Durations of the session for which a stimulus is held before the first reading: what fades has
/// faded.
const HELD: f64 = 100.0;

/// What came before a reading.
#[derive(Debug, Clone, Copy)]
pub(super) struct Before {
    /// Stimulus that was held.
    pub(super) stimulus: f64,
    /// +1: the reading is above it.
    pub(super) direction: f64,
    /// The reading is taken long after its stimulus was reached.
    pub(super) late: bool,
}

impl ScalarModel {
    /// Stimuli at which `rows` would have read their `y`, with half widths of 95 % intervals, for
    /// models whose response rises or falls throughout. Readings beyond the fitted responses are
    /// marked invalid. Effects with memory follow the rows where [`Self::follows`] them, else every
    /// reading stands alone, see the module.
    ///
    /// # Errors
    /// As [`Self::predict`], and where the response does not determine the stimulus.
    pub fn invert(&self, rows: &[ScalarRow]) -> Result<Vec<ScalarPrediction>, ModelError> {
        if self.remembering().is_none() {
            return self.invert_alone(rows);
        }
        let [low, high] = self.stimulus_range;
        let follows = self.follows(rows);
        if let Some(id) = self.timed(false).filter(|_| !follows) {
            return Err(ModelError::Column {
                effect: id,
                needs: "t_s in every row".to_owned(),
            });
        }
        let ends = [(low, 1.0), (high, -1.0)];
        let lates = if follows || self.timed(true).is_none() {
            &[false][..]
        } else {
            &[false, true]
        };
        let before = lates.iter().flat_map(|late| {
            ends.map(|(stimulus, direction)| Before {
                stimulus,
                direction,
                late: *late,
            })
        });
        let before: Vec<Before> = before.collect();
        // Slopes by readings that stand alone: over the range for the steps, locally for the width.
        let alone = |x: &[f64]| self.after(&at(rows, x), before[0], false);
        let slope = self.one_way(rows.len(), alone)?;
        // Within its play a memory hides the stimulus: the steepest of the pasts counts.
        let local_slope = |x: &[f64]| -> Result<Vec<f64>, ModelError> {
            let h = 0.005 * (high - low);
            let moved = [h, -h].map(|h| at(rows, &x.iter().map(|x| x + h).collect::<Vec<f64>>()));
            let mut steepest = vec![0.0_f64; rows.len()];
            for before in &before {
                let [up, down] = &moved;
                let up = self.after(up, *before, false)?;
                let down = self.after(down, *before, false)?;
                for (k, steepest) in steepest.iter_mut().enumerate() {
                    let slope = (up[k].value - down[k].value) / (2.0 * h);
                    *steepest = steepest.max(slope.abs());
                }
            }
            Ok(steepest)
        };
        let found = before.iter().map(|before| {
            let mut x = vec![0.5 * (low + high); rows.len()];
            let mut step = vec![0.0; rows.len()];
            for _ in 0..STEPS {
                let here = self.after(&at(rows, &x), *before, follows)?;
                for k in 0..rows.len() {
                    step[k] = (rows[k].y - here[k].value) / slope[k];
                    // Far outside, what the model says leads nowhere.
                    let margin = 0.5 * (high - low);
                    x[k] = (x[k] + step[k]).clamp(low - margin, high + margin);
                }
                if step.iter().all(|s| s.abs() < 1e-12 * (high - low)) {
                    break;
                }
            }
            Ok((self.after(&at(rows, &x), *before, follows)?, x, step))
        });
        let found = found.collect::<Result<Vec<_>, ModelError>>()?;
        let middle = |k: usize| {
            let of = |pick: fn(f64, f64) -> f64| found.iter().map(|f| f.1[k]).reduce(pick);
            [of(f64::min), of(f64::max)].map(Option::unwrap_or_default)
        };
        let x: Vec<f64> = (0..rows.len())
            .map(|k| 0.5 * middle(k).iter().sum::<f64>())
            .collect();
        let local = local_slope(&x)?;
        let of = |k: usize| {
            let [least, most] = middle(k);
            let half = |(here, _, step): &(Vec<ScalarPrediction>, Vec<f64>, Vec<f64>)| {
                // What the iteration did not settle is not known.
                self.beside_reference(here[k].half95 / local[k]) + step[k].abs()
            };
            let half95 = found.iter().map(half).fold(0.0, f64::max) + 0.5 * (most - least);
            ScalarPrediction {
                value: x[k],
                half95,
                valid: x[k] >= low - half95 && x[k] <= high + half95,
            }
        };
        Ok((0..rows.len()).map(of).collect())
    }

    /// Predictions at `rows` of which neither time nor direction is known: the mean of both ways, and
    /// half of what lies between them in the width. None where an accepted effect follows the time,
    /// or something is known of the order.
    pub fn predict_both_ways(&self, rows: &[ScalarRow]) -> Option<Vec<ScalarPrediction>> {
        let known = rows
            .iter()
            .any(|r| r.t_s.is_some() || r.direction.is_some());
        let timed = [true, false]
            .iter()
            .any(|memory| self.timed(*memory).is_some());
        if known || timed || self.remembering().is_none() {
            return None;
        }
        let [low, high] = self.stimulus_range;
        let of = |stimulus: f64, direction: f64| {
            let before = Before {
                stimulus,
                direction,
                late: false,
            };
            self.after(rows, before, false).ok()
        };
        let (up, down) = (of(low, 1.0)?, of(high, -1.0)?);
        let mean = |(a, b): (&ScalarPrediction, &ScalarPrediction)| ScalarPrediction {
            value: 0.5 * (a.value + b.value),
            half95: a.half95.max(b.half95) + 0.5 * (a.value - b.value).abs(),
            valid: a.valid,
        };
        Some(up.iter().zip(&down).map(mean).collect())
    }

    /// How the stimuli of `rows` are found where an accepted effect has memory.
    pub fn inverse_remark(&self, rows: &[ScalarRow]) -> Option<String> {
        let effect = self.remembering()?;
        Some(match self.follows(rows) {
            true => format!(
                "{effect} is followed from reading to reading; where the readings do not tell the state that they began in, half95 is wider"
            ),
            false => format!(
                "each reading stands alone, since neither t_s nor direction says how it was reached: the value is the mean of both ways, and half95 holds half of what {effect} makes between them"
            ),
        })
    }

    /// The accepted effect that depends on what came before, if any.
    fn remembering(&self) -> Option<&str> {
        let system = self.system(Vec::new());
        let remembers = |id: &str| {
            let mut catalogue = system.catalogue().iter();
            catalogue.any(|e| e.id == id && e.has_memory)
        };
        let mut effects = self.effects.iter().map(|t| t.id.as_str());
        effects.find(|id| remembers(id))
    }

    /// Whether the order of `rows` is known as far as the accepted effects need it: by times, or by
    /// directions where no effect follows the time.
    fn follows(&self, rows: &[ScalarRow]) -> bool {
        let timed = all(rows, |r| r.t_s).is_some();
        timed || all(rows, |r| r.direction).is_some() && self.timed(true).is_none()
    }

    /// The first accepted effect that follows the time, of those with memory or of the others.
    fn timed(&self, has_memory: bool) -> Option<String> {
        let system = self.system(Vec::new());
        let of_time =
            |need: &LawRequirement| matches!(need, LawRequirement::Time | LawRequirement::Clock);
        let terms = self.terms(&system).ok()?;
        let mut found = terms.iter().filter(|t| {
            let effect = &system.catalogue()[t.effect];
            effect.has_memory == has_memory && effect.law(t.law).needs.iter().any(of_time)
        });
        Some(system.catalogue()[found.next()?.effect].id.to_owned())
    }

    /// Predictions at `rows` after `before`: of the rows as one record, or of each alone.
    pub(super) fn after(
        &self,
        rows: &[ScalarRow],
        before: Before,
        follows: bool,
    ) -> Result<Vec<ScalarPrediction>, ModelError> {
        let duration = self.scaling.time.map_or(1.0, |[_, duration]| duration);
        let (held, moment) = (HELD * duration, 1e-9 * duration);
        let mut path = Vec::new();
        let mut kept = Vec::new();
        for (k, row) in rows.iter().enumerate() {
            // Readings that stand alone come one after another, each after its own past.
            let start = match (follows, row.t_s) {
                (true, t_s) => t_s,
                (false, _) => Some(3.0 * held * k as f64),
            };
            // The way that the past says, where nothing else does.
            let way = |stated: Option<f64>, way: f64| match follows {
                true => stated.map(|_| way),
                false => Some(way),
            };
            let earlier = |by: f64| ScalarRow {
                x: before.stimulus,
                t_s: start.map(|t| t - by),
                direction: way(row.direction, -before.direction),
                ..row.clone()
            };
            if !follows || k == 0 {
                path.extend([earlier(held), earlier(moment)]);
            }
            let reading = ScalarRow {
                t_s: start,
                direction: row.direction.or(way(None, before.direction)),
                ..row.clone()
            };
            if before.late {
                path.push(reading.clone());
            }
            kept.push(path.len());
            path.push(ScalarRow {
                t_s: start.map(|t| t + if before.late { held } else { 0.0 }),
                ..reading
            });
        }
        let all = self.predict(&path)?;
        Ok(kept.into_iter().map(|k| all[k]).collect())
    }

    /// Mean slope of each row's response over the range.
    ///
    /// # Errors
    /// Where a response turns round: it has several stimuli.
    fn one_way(
        &self,
        count: usize,
        at: impl Fn(&[f64]) -> Result<Vec<ScalarPrediction>, ModelError>,
    ) -> Result<Vec<f64>, ModelError> {
        let [low, high] = self.stimulus_range;
        let place = |k: usize| low + (high - low) * k as f64 / PLACES as f64;
        let curves = (0..=PLACES).map(|k| at(&vec![place(k); count]));
        let curves = curves.collect::<Result<Vec<_>, _>>()?;
        let goes = |i: usize, sign: f64| {
            let mut steps = curves.windows(2);
            steps.all(|c| sign * c[1][i].value > sign * c[0][i].value)
        };
        let slope = |i: usize| {
            let one_way = goes(i, 1.0) || goes(i, -1.0);
            let rise = curves[PLACES][i].value - curves[0][i].value;
            one_way.then(|| rise / (high - low))
        };
        let slopes: Option<Vec<f64>> = (0..count).map(slope).collect();
        slopes.ok_or_else(|| ModelError::Column {
            effect: "the inverse".into(),
            needs: "a response that rises or falls throughout; give the stimulus".to_owned(),
        })
    }

    /// A half width of a stimulus, with what the reference is uncertain by.
    pub(super) fn beside_reference(&self, half95: f64) -> f64 {
        half95.hypot(t95(self.dof) * self.reference_sd)
    }

    /// The same of models without memory.
    fn invert_alone(&self, rows: &[ScalarRow]) -> Result<Vec<ScalarPrediction>, ModelError> {
        let predicted = |x: &[f64]| self.predict(&at(rows, x));
        let [low, high] = self.stimulus_range;
        // Only a response that goes one way has one stimulus for each value.
        let slope = self.one_way(rows.len(), predicted)?;
        let (mut a, mut b) = (vec![low; rows.len()], vec![high; rows.len()]);
        let middle = |a: &[f64], b: &[f64]| -> Vec<f64> {
            a.iter().zip(b).map(|(a, b)| 0.5 * (a + b)).collect()
        };
        for _ in 0..HALVINGS {
            let x = middle(&a, &b);
            for (i, p) in predicted(&x)?.iter().enumerate() {
                let below = slope[i].signum() * (rows[i].y - p.value) > 0.0;
                let end = if below { &mut a } else { &mut b };
                end[i] = x[i];
            }
        }
        let x = middle(&a, &b);
        let here = predicted(&x)?;
        // Slope over a hundredth of the range turns the response's interval into the stimulus's.
        let step = 0.005 * (high - low);
        let moved = |by: f64| predicted(&x.iter().map(|x| x + by).collect::<Vec<f64>>());
        let (up, down) = (moved(step)?, moved(-step)?);
        let ends = [low, high].map(|end| predicted(&vec![end; rows.len()]));
        let [first, last] = ends;
        let (first, last) = (first?, last?);
        let of = |i: usize| {
            let local = (up[i].value - down[i].value) / (2.0 * step);
            let inside = |end: &[ScalarPrediction], s: f64| {
                s * slope[i].signum() * (rows[i].y - end[i].value) >= -here[i].half95
            };
            ScalarPrediction {
                value: x[i],
                // To first order dx = dy / (dy/dx).
                half95: self.beside_reference(here[i].half95 / local.abs()),
                valid: inside(&first, 1.0) && inside(&last, -1.0),
            }
        };
        Ok((0..rows.len()).map(of).collect())
    }
}

/// `rows` at the stimuli `x`.
fn at(rows: &[ScalarRow], x: &[f64]) -> Vec<ScalarRow> {
    let moved = rows.iter().zip(x);
    moved
        .map(|(r, x)| ScalarRow { x: *x, ..r.clone() })
        .collect()
}
