//! The accepted effects reading by reading: what [`PhysicalModel::infer`] does for a table, for a
//! stream.

use super::groove_motion::covariance_root;
use super::physical::{PhysicalModel, VALID_SHARE, is_below_noise};
use super::uncertainty::VALUE_STEP;
use super::whisker_effect::{ActiveEffect, Memory};
use crate::whisker::path::{Columns, Node, Reading, WhiskerPath};
use nalgebra::{DMatrix, Matrix2};
use wcal_core::stream::{MomentSpread, MomentStream, StreamMoments};

/// The effects at one set of values, with what they remember.
struct EffectMemories {
    terms: Vec<ActiveEffect>,
    memories: Vec<Box<dyn Memory>>,
}

impl EffectMemories {
    fn new(terms: Vec<ActiveEffect>) -> Self {
        let memories = terms.iter().filter_map(ActiveEffect::memory).collect();
        Self { terms, memories }
    }

    /// What the sensor makes of a base moment now.
    fn recalled(&self, dt_s: Option<f64>, base: [f64; 2]) -> [f64; 2] {
        self.memories
            .iter()
            .fold(base, |m, memory| memory.sensed(dt_s, m))
    }

    /// The base moment that is sensed so, remembered from now on. One below `visible`, the noise's
    /// standard deviations, keeps what it shows.
    fn base(&mut self, dt_s: Option<f64>, sensed: [f64; 2], visible: [f64; 2]) -> [f64; 2] {
        let mut base = sensed;
        // Memory is a small correction: plain fixed-point iteration undoes it, as for a table.
        for _ in 0..40 {
            if self.memories.is_empty() || is_below_noise(&sensed, &visible) {
                break;
            }
            let m = self.recalled(dt_s, base);
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
        base
    }
}

/// A calibration with accepted effects that takes readings one by one. New readings belong to the
/// last seating that it saw.
pub struct PhysicalStream {
    model: PhysicalModel,
    effects: EffectMemories,
    /// Each uncertain value: its place in the covariance, the step, and the effects with the value
    /// one step lower and higher.
    moved: Vec<(usize, f64, [EffectMemories; 2])>,
    inverse: Matrix2<f64>,
    last_s: Option<f64>,
    /// F with cov(theta) = F F', and the gradient at the last reading.
    factor: DMatrix<f64>,
    gradient: DMatrix<f64>,
    /// Path of the one reading at hand.
    now: WhiskerPath,
}

impl PhysicalStream {
    /// Ready for the first reading; `None` where the sensitivity cannot be inverted.
    pub fn new(model: PhysicalModel) -> Option<Self> {
        let inverse = model.sensitivity().try_inverse()?;
        let effects = EffectMemories::new(model.terms());
        let at = |place, by| EffectMemories::new(model.terms_moved(Some((place, by))));
        let moved = model.uncertain_values().into_iter().map(|(place, sd)| {
            let step = VALUE_STEP * sd;
            (place, step, [at(place, -step), at(place, step)])
        });
        let moved = moved.collect();
        let now = WhiskerPath {
            readings: vec![Reading {
                seating: model.seatings.saturating_sub(1),
                ..Reading::default()
            }],
            rows: vec![0],
            nodes: vec![Node {
                reading: Some(0),
                ..Node::default()
            }],
            columns: Columns {
                time: true,
                temperature: true,
                ..Columns::default()
            },
            ..WhiskerPath::default()
        };
        let factor = covariance_root(&model).0;
        let gradient = DMatrix::zeros(2, model.covariance.len());
        Some(Self {
            model,
            effects,
            moved,
            inverse,
            last_s: None,
            factor,
            gradient,
            now,
        })
    }

    fn sensed(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> [f64; 2] {
        let reading = &mut self.now.readings[0];
        (reading.t_s, reading.shift_pm, reading.rise_degc) = (t_s, shift_pm, rise_degc);
        reading.temperature_loo_degc = rise_degc;
        self.model
            .sensed(&self.effects.terms, &self.now, &self.inverse)[0]
    }
}

impl MomentStream for PhysicalStream {
    fn quick_nmm(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> [f64; 2] {
        self.sensed(t_s, shift_pm, rise_degc)
    }

    fn moments(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> StreamMoments {
        let sensed = self.sensed(t_s, shift_pm, rise_degc);
        let columns = self
            .model
            .columns(&self.effects.terms, &self.now, &[sensed]);
        let row: Vec<f64> = columns.iter().map(|c| c[0]).collect();
        let mut gradient = self.model.of_coefficients(&self.inverse, &row);
        let visible = self
            .model
            .sd_nmm(&self.inverse, &gradient, self.model.noise_sd_pm);
        let dt_s = self.last_s.map(|last| t_s - last);
        self.last_s = Some(t_s);
        let base = self.effects.base(dt_s, sensed, visible);
        for (place, step, sides) in &mut self.moved {
            let [low, high] = sides.each_mut().map(|side| {
                let sensed = self.model.sensed(&side.terms, &self.now, &self.inverse)[0];
                side.base(dt_s, sensed, visible)
            });
            for c in 0..2 {
                gradient[(c, *place)] = (high[c] - low[c]) / (2.0 * *step);
            }
        }
        let sd_nmm = self
            .model
            .sd_nmm(&self.inverse, &gradient, self.model.noise_sd_pm);
        let valid = base[0].hypot(base[1]) <= VALID_SHARE * self.model.largest_moment_nmm;
        self.gradient = gradient;
        StreamMoments {
            moment_nmm: base,
            sd_nmm,
            valid,
        }
    }

    fn spread(&self) -> MomentSpread {
        let common = &self.gradient * &self.factor;
        MomentSpread {
            noise_nmm2: self.inverse * self.inverse.transpose() * self.model.noise_sd_pm.powi(2),
            shared_nmm: common.column_iter().map(|u| [-u[0], -u[1]]).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::path::{ReadoutOrigin, bare_row};
    use crate::whisker::physical::{AcceptedEffect, Inferred};
    use wcal_core::MomentAxes;
    use wcal_core::{FbgSpec, WhiskerRow};

    fn effect(id: &str, law: &str, values: &[f64]) -> AcceptedEffect {
        let (id, law) = (id.to_owned(), law.to_owned());
        AcceptedEffect {
            id,
            law,
            values: values.to_vec(),
            parameters: Vec::new(),
        }
    }

    fn model() -> PhysicalModel {
        let effects = vec![
            effect("zero-drift", "linear", &[]),
            effect("fbg-nonlinearity", "quadratic", &[]),
            effect("creep", "prony", &[0.04, 8.0]),
            effect("hysteresis", "play", &[0.02, 0.1]),
            effect("dead-zone", "radial", &[0.03]),
        ];
        let coefficients = vec![
            [3.0, -2.0],
            [72.0, -6.0],
            [9.0, 78.0],
            [0.2, 0.1],
            [1.5, 0.3],
            [-0.4, 0.2],
            [0.6, -1.0],
        ];
        // Four values: size and time of creep, size and width of hysteresis, play of the dead zone
        // (five).
        let (q, sd) = (coefficients.len() * 2, [0.004, 0.8, 0.003, 0.01, 0.002]);
        let mut covariance = vec![vec![0.0; q + sd.len()]; q + sd.len()];
        sd.iter()
            .enumerate()
            .for_each(|(k, s)| covariance[q + k][q + k] = s * s);
        PhysicalModel {
            coefficients,
            covariance,
            noise_sd_pm: 0.05,
            correlated_noise: None,
            averaging: None,
            stage_clock_s: 0.0,
            readout_origin: ReadoutOrigin {
                t_s: 12.0,
                temperature_degc: 0.0,
            },
            effects,
            seatings: 1,
            fbg: FbgSpec {
                temperature_compensated: true,
                ..FbgSpec::default()
            },
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

    fn of_table(model: &PhysicalModel, shifts: &[(f64, [f64; 2])]) -> Vec<Inferred> {
        let row = |(k, (t_s, shift_pm)): (usize, &(f64, [f64; 2]))| bare_row(k, *t_s, *shift_pm);
        let rows: Vec<WhiskerRow> = shifts.iter().enumerate().map(row).collect();
        let rows: Vec<&WhiskerRow> = rows.iter().collect();
        let path = WhiskerPath::new(&rows, &[], &MomentAxes::default(), &model.fbg, None, None);
        model.infer(&path, None)
    }

    #[test]
    fn a_stream_gives_what_the_table_gives() {
        let (model, shifts) = (model(), shifts(300));
        let table = of_table(&model, &shifts);
        let mut stream = PhysicalStream::new(model.clone()).unwrap();
        let mut largest: f64 = 0.0;
        for ((t_s, shift), expected) in shifts.iter().zip(&table) {
            let m = stream.moments(*t_s, *shift, 0.0);
            let off = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
            assert!(
                off(m.moment_nmm, expected.moment_nmm) < 1e-7,
                "{t_s}: {m:?} {expected:?}"
            );
            assert!(
                off(m.sd_nmm, expected.sd_nmm) < 1e-6,
                "{t_s}: {m:?} {expected:?}"
            );
            // The parts of the spread are the whole.
            let spread = stream.spread();
            let shared = |c: usize| spread.shared_nmm.iter().map(|h| h[c] * h[c]).sum::<f64>();
            let parts = [0, 1].map(|c| (spread.noise_nmm2[(c, c)] + shared(c)).sqrt());
            assert!(off(parts, m.sd_nmm) < 1e-9, "{t_s}: {parts:?} {m:?}");
            let quick = stream.quick_nmm(*t_s, *shift, 0.0);
            largest = largest.max(off(quick, expected.moment_nmm));
        }
        // Control: without memory the answers differ.
        assert!(largest > 0.01, "{largest}");
    }

    #[test]
    fn stated_deviations_hold_the_values_of_effects() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let (model, shifts) = (model(), shifts(120));
        let first = 2 * model.coefficients.len();
        let mut without = model.clone();
        without
            .covariance
            .iter_mut()
            .flatten()
            .for_each(|v| *v = 0.0);
        let stated = of_table(&model, &shifts);
        let by_noise = of_table(&without, &shifts);
        // The spread of the answers when the values are drawn from their covariance; nothing else
        // varies.
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let draws = 400;
        let mut squares = vec![[0.0; 2]; shifts.len()];
        for _ in 0..draws {
            let mut drawn = model.clone();
            for (place, value) in
                (first..).zip(drawn.effects.iter_mut().flat_map(|e| &mut e.values))
            {
                let z: f64 = StandardNormal.sample(&mut rng);
                *value += z * model.covariance[place][place].sqrt();
            }
            for (s, (m, at)) in squares
                .iter_mut()
                .zip(of_table(&drawn, &shifts).iter().zip(&stated))
            {
                (0..2).for_each(|c| {
                    s[c] += (m.moment_nmm[c] - at.moment_nmm[c]).powi(2) / f64::from(draws)
                });
            }
        }
        // Loaded readings, not those at the edge of the dead zone, where the answer has a kink.
        let loaded = |m: &Inferred| m.moment_nmm[0].abs().min(m.moment_nmm[1].abs()) > 0.1;
        let mut ratios: Vec<[f64; 2]> = Vec::new();
        for ((s, with), noise) in squares
            .iter()
            .zip(&stated)
            .zip(&by_noise)
            .filter(|((_, m), _)| loaded(m))
        {
            for (c, values) in s.iter().enumerate() {
                let spread = values + noise.sd_nmm[c].powi(2);
                ratios.push([with.sd_nmm[c], noise.sd_nmm[c]].map(|sd| sd / spread.sqrt()));
            }
        }
        let mean = |k: usize| ratios.iter().map(|r| r[k]).sum::<f64>() / ratios.len() as f64;
        assert!(ratios.len() > 50, "{}", ratios.len());
        assert!((mean(0) - 1.0).abs() < 0.05, "{} of the spread", mean(0));
        // Control: noise alone states less than half of it.
        assert!(mean(1) < 0.5, "{}", mean(1));
    }
}
