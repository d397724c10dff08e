//! A transducer or axis session as a system: stimulus -> effects on the stimulus -> declared model -> additive effects.

use super::effects;
use super::frame::{Declared, Frame};
use crate::candidate::{Candidate, System, Term};
use crate::engine::noise_parts::NoiseInputs;
use nalgebra::DMatrix;
use std::sync::Arc;

/// Where an effect of a scalar session acts; every hook does nothing by default and returns false where the law does not apply.
pub trait ScalarEffect: Candidate {
    /// Why the effect cannot be seen in this session; none where it can.
    fn not_observable(&self, _frame: &Frame) -> Option<String> {
        None
    }
    /// Changes the effective stimulus of every reading, in half ranges.
    fn warp(&self, _law: usize, _values: &[f64], _frame: &Frame, _u: &mut [f64]) -> bool {
        true
    }
    /// Appends columns (one value a reading) with free coefficients.
    fn columns(&self, _law: usize, _values: &[f64], _frame: &Frame, _out: &mut Vec<Vec<f64>>) -> bool {
        true
    }
}

/// A scalar session, its declared model and the catalogue.
pub struct ScalarSystem {
    /// Rows and covariates.
    pub frame: Frame,
    effects: Vec<Arc<dyn ScalarEffect>>,
    catalogue: Vec<Arc<dyn Candidate>>,
    measured: DMatrix<f64>,
    known: DMatrix<f64>,
    /// 1 / relative standard deviation of each reading, where the spread follows the stimulus.
    weights: Vec<f64>,
    covariate_names: Vec<String>,
    /// The axis's known part enters with this far offset, see `design`.
    offset: f64,
}

/// An axis is measured from a point this many times the largest error away.
const FAR: f64 = 1e5;

impl ScalarSystem {
    /// System of a frame; `covariate_names` belong to the rows' further covariates.
    #[must_use]
    pub fn new(frame: Frame, covariate_names: &[String]) -> Self {
        let effects = effects::scalar_catalogue(&frame, covariate_names);
        let catalogue = effects.iter().map(|e| e.clone() as Arc<dyn Candidate>).collect();
        let n = frame.rows.len();
        let largest = frame.rows.iter().map(|r| r.y.abs()).fold(0.0, f64::max);
        let offset = match frame.declared {
            Declared::Axis => FAR * if largest > 0.0 { largest } else { 1.0 },
            Declared::Polynomial(_) => 0.0,
        };
        Self {
            measured: DMatrix::from_fn(n, 1, |i, _| frame.rows[i].y + offset),
            known: DMatrix::zeros(n, 1),
            weights: vec![1.0; n],
            covariate_names: covariate_names.to_vec(),
            frame,
            effects,
            catalogue,
            offset,
        }
    }

    /// The same effects seen on other rows (sealed ones), far offset kept.
    #[must_use]
    pub fn on(&self, frame: Frame) -> Self {
        Self::new(frame, &self.covariate_names).with_offset(self.offset)
    }

    /// The same rows seen from another far point.
    #[must_use]
    pub fn with_offset(mut self, offset: f64) -> Self {
        self.measured.add_scalar_mut(offset - self.offset);
        self.offset = offset;
        self
    }

    /// The same rows whose noise has these relative standard deviations.
    #[must_use]
    pub fn with_spread(mut self, relative_sd: &[f64]) -> Self {
        self.weights = relative_sd.iter().map(|sd| 1.0 / sd).collect();
        self
    }

    /// What is added to every measured value inside the system (0 for transducers).
    #[must_use]
    pub fn offset(&self) -> f64 {
        self.offset
    }
}

/// Coarsest decimal step of which all values are multiples; none where it is fine beside their range, as noise then hides it.
fn step(values: &[f64]) -> Option<f64> {
    let largest = values.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    if !(largest > 0.0) {
        return None;
    }
    let on = |step: f64| values.iter().all(|v| ((v / step) - (v / step).round()).abs() < 1e-6);
    (0..8).map(|k| 10f64.powi(largest.log10().floor() as i32 - k)).find(|s| on(*s))
}

impl System for ScalarSystem {
    fn measured(&self) -> &DMatrix<f64> {
        &self.measured
    }

    fn design(&self, terms: &[Term]) -> Option<DMatrix<f64>> {
        let frame = &self.frame;
        let mut u = frame.u.clone();
        for t in terms {
            if !self.effects[t.effect].warp(t.law, &t.values, frame, &mut u) {
                return None;
            }
        }
        let mut columns: Vec<Vec<f64>> = match frame.declared {
            Declared::Polynomial(degree) => {
                (0..=degree).map(|k| u.iter().map(|v| v.powi(k as i32)).collect()).collect()
            }
            // measured - commanded = constant + (x_eff - x): the second part has no free coefficient. Seen from a far point it
            // rides on the constant's column, with a coefficient of one to within error / offset = 1e-5.
            Declared::Axis => {
                let um = 1e3 * frame.scaling.half / self.offset;
                vec![u.iter().zip(&frame.u).map(|(e, c)| 1.0 + um * (e - c)).collect()]
            }
        };
        for t in terms {
            if !self.effects[t.effect].columns(t.law, &t.values, frame, &mut columns) {
                return None;
            }
        }
        let design = DMatrix::from_fn(frame.rows.len(), columns.len(), |i, j| columns[j][i]);
        design.iter().all(|v| v.is_finite()).then_some(design)
    }

    fn catalogue(&self) -> &[Arc<dyn Candidate>] {
        &self.catalogue
    }

    fn not_observable(&self, effect: usize) -> Option<String> {
        self.effects[effect].not_observable(&self.frame)
    }

    fn groups(&self) -> &[u32] {
        &self.frame.groups
    }

    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        let frame = &self.frame;
        let stimulus = if frame.declared == Declared::Axis { "commanded_mm" } else { "stimulus" };
        let mut out = vec![(stimulus.to_owned(), frame.rows.iter().map(|r| r.x).collect::<Vec<f64>>())];
        if frame.ordered {
            out.push(("order".to_owned(), (0..frame.rows.len()).map(|k| k as f64).collect()));
        }
        if frame.time.is_some() {
            out.push(("t_s".to_owned(), frame.rows.iter().map(|r| r.t_s.unwrap_or(0.0)).collect()));
        }
        if frame.temperature.is_some() {
            let column = frame.rows.iter().map(|r| r.temperature_degc.unwrap_or(0.0)).collect();
            out.push(("temperature_degc".to_owned(), column));
        }
        if let Some(direction) = &frame.direction {
            out.push(("direction".to_owned(), direction.clone()));
        }
        for (k, name) in self.covariate_names.iter().enumerate() {
            if frame.covariates.get(k).is_some_and(Option::is_some) {
                out.push((name.clone(), frame.rows.iter().map(|r| r.covariates[k]).collect()));
            }
        }
        out
    }

    fn known_noise(&self) -> &DMatrix<f64> {
        &self.known
    }

    fn noise_inputs(&self) -> NoiseInputs {
        let frame = &self.frame;
        let n = frame.rows.len();
        let values: Vec<f64> = frame.rows.iter().map(|r| r.y).collect();
        // The order of the rows stands in for a clock where nothing speaks against it; a break between sweeps shows in the time constant.
        let clock = if frame.rows.iter().all(|r| r.t_s.is_some()) {
            Some(frame.rows.iter().filter_map(|r| r.t_s).collect())
        } else {
            frame.ordered.then(|| (0..n).map(|k| k as f64).collect())
        };
        NoiseInputs {
            clock: clock.map(Arc::new),
            known: self.weights.clone(),
            step: vec![step(&values)],
            ..NoiseInputs::none(n)
        }
    }
}
