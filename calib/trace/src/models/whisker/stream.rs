//! The accepted effects reading by reading: what [`PhysicalModel::infer`] does for a table, for a stream.

use super::physical::{PhysicalModel, VALID_SHARE, hidden};
use super::system::{ActiveEffect, Memory};
use crate::whisker::path::{Columns, Node, Reading, WhiskerPath};
use nalgebra::Matrix2;
use wcal_core::MomentAxes;
use wcal_core::stream::{MomentStream, StreamMoments};

/// A calibration with accepted effects that takes readings one by one. New readings belong to the last seating that it saw.
pub struct PhysicalStream {
    model: PhysicalModel,
    terms: Vec<ActiveEffect>,
    inverse: Matrix2<f64>,
    memories: Vec<Box<dyn Memory>>,
    last_s: Option<f64>,
    /// Path of the one reading at hand.
    now: WhiskerPath,
}

impl PhysicalStream {
    /// Ready for the first reading; `None` where the sensitivity cannot be inverted.
    #[must_use]
    pub fn new(model: PhysicalModel) -> Option<Self> {
        let inverse = model.sensitivity().try_inverse()?;
        let terms = model.terms();
        let memories = terms.iter().filter_map(|a| a.effect.memory(&a.values())).collect();
        let reading = Reading {
            line: None,
            x_mm: 0.0,
            rest: false,
            direction: 0.0,
            velocity_mm_s: 0.0,
            t_s: 0.0,
            dwell_s: 0.0,
            rise_degc: 0.0,
            temperature_loo_degc: 0.0,
            shift_pm: [0.0; 2],
            sample_sd_pm: [0.0; 2],
            group: 0,
            replicate: 0,
            holdout: false,
            seating: model.seatings.saturating_sub(1),
        };
        let node = Node { t_s: 0.0, line: None, x_mm: 0.0, rest: false, moving: false, reading: Some(0) };
        let now = WhiskerPath {
            readings: vec![reading],
            rows: vec![0],
            nodes: vec![node],
            lines: Vec::new(),
            reach_mm: Vec::new(),
            start_mm: Vec::new(),
            moments: MomentAxes::default(),
            columns: Columns { time: true, temperature: true, ..Columns::default() },
        };
        Some(Self { model, terms, inverse, memories, last_s: None, now })
    }

    fn sensed(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> [f64; 2] {
        let reading = &mut self.now.readings[0];
        (reading.t_s, reading.shift_pm, reading.rise_degc) = (t_s, shift_pm, rise_degc);
        self.model.sensed(&self.terms, &self.now, &self.inverse)[0]
    }

    /// What the sensor makes of a base moment now.
    fn remembered(&self, dt_s: Option<f64>, base: [f64; 2]) -> [f64; 2] {
        self.memories.iter().fold(base, |m, memory| memory.sensed(dt_s, m))
    }
}

impl MomentStream for PhysicalStream {
    fn quick_nmm(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> [f64; 2] {
        self.sensed(t_s, shift_pm, rise_degc)
    }

    fn moments(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> StreamMoments {
        let sensed = self.sensed(t_s, shift_pm, rise_degc);
        let columns = self.model.columns(&self.terms, &self.now, &[sensed]);
        let row: Vec<f64> = columns.iter().map(|c| c[0]).collect();
        let sd_nmm = self.model.sd_nmm(&self.inverse, &row, self.model.noise_sd_pm);
        let dt_s = self.last_s.map(|last| t_s - last);
        self.last_s = Some(t_s);
        let mut base = sensed;
        // Memory is a small correction: plain fixed-point iteration undoes it, as for a table.
        for _ in 0..40 {
            if self.memories.is_empty() || hidden(&sensed, &sd_nmm) {
                break;
            }
            let m = self.remembered(dt_s, base);
            let left = [sensed[0] - m[0], sensed[1] - m[1]];
            base = [base[0] + left[0], base[1] + left[1]];
            if left[0].abs().max(left[1].abs()) < 1e-10 {
                break;
            }
        }
        let mut driven = base;
        for memory in &mut self.memories {
            let next = memory.sensed(dt_s, driven);
            memory.accept(dt_s, driven);
            driven = next;
        }
        let valid = base[0].hypot(base[1]) <= VALID_SHARE * self.model.largest_moment_nmm;
        StreamMoments { moment_nmm: base, sd_nmm, valid }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::physical::AcceptedEffect;
    use wcal_core::{FbgSpec, Role, WhiskerRow};

    fn effect(id: &str, law: &str, values: &[f64]) -> AcceptedEffect {
        let (id, law) = (id.to_owned(), law.to_owned());
        AcceptedEffect { id, law, values: values.to_vec(), parameters: Vec::new() }
    }

    fn model() -> PhysicalModel {
        let effects = vec![
            effect("zero-drift", "linear", &[]),
            effect("fbg-nonlinearity", "quadratic", &[]),
            effect("creep", "prony", &[0.04, 8.0]),
            effect("hysteresis", "play", &[0.02, 0.1]),
            effect("dead-zone", "radial", &[0.03]),
        ];
        let coefficients =
            vec![[3.0, -2.0], [72.0, -6.0], [9.0, 78.0], [0.2, 0.1], [1.5, 0.3], [-0.4, 0.2], [0.6, -1.0]];
        let q = coefficients.len() * 2;
        PhysicalModel {
            coefficients,
            covariance: vec![vec![0.0; q]; q],
            noise_sd_pm: 0.05,
            effects,
            seatings: 1,
            fbg: FbgSpec { temperature_compensated: true, ..FbgSpec::default() },
            largest_moment_nmm: 1.0,
        }
    }

    fn shifts(n: usize) -> Vec<(f64, [f64; 2])> {
        let at = |k: usize| {
            let t = 0.1 * k as f64;
            (t, [70.0 * (0.3 * t).sin().max(0.0), 40.0 * (0.5 * t).sin()])
        };
        (0..n).map(at).collect()
    }

    fn of_table(model: &PhysicalModel, shifts: &[(f64, [f64; 2])]) -> Vec<[f64; 2]> {
        let row = |(k, (t_s, shift_pm)): (usize, &(f64, [f64; 2]))| WhiskerRow {
            source: String::new(),
            line: k,
            point: k as i64,
            role: Role::Verification,
            trajectory: None,
            replicate: None,
            t_s: Some(*t_s),
            stage_mm: None,
            direction: None,
            speed_mm_s: None,
            dwell_s: None,
            groove_mm: None,
            temperature_degc: None,
            shift_pm: *shift_pm,
            reference_shift_pm: None,
            shift_sd_pm: None,
            samples: None,
            seating: 0,
            sealed: false,
            pair: None,
        };
        let rows: Vec<WhiskerRow> = shifts.iter().enumerate().map(row).collect();
        let rows: Vec<&WhiskerRow> = rows.iter().collect();
        let path = WhiskerPath::new(&rows, &[], &MomentAxes::default(), &model.fbg, None, None);
        model.infer(&path, None).iter().map(|m| m.moment_nmm).collect()
    }

    #[test]
    fn a_stream_gives_what_the_table_gives() {
        let (model, shifts) = (model(), shifts(300));
        let table = of_table(&model, &shifts);
        let mut stream = PhysicalStream::new(model.clone()).unwrap();
        let mut largest: f64 = 0.0;
        for ((t_s, shift), expected) in shifts.iter().zip(&table) {
            let m = stream.moments(*t_s, *shift, 0.0);
            let off = (m.moment_nmm[0] - expected[0]).hypot(m.moment_nmm[1] - expected[1]);
            assert!(off < 1e-7, "{t_s}: {m:?} {expected:?}");
            let quick = stream.quick_nmm(*t_s, *shift, 0.0);
            largest = largest.max((quick[0] - expected[0]).hypot(quick[1] - expected[1]));
        }
        // Control: without memory the answers differ.
        assert!(largest > 0.01, "{largest}");
    }
}
