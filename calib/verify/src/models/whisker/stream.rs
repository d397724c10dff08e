//! The inverse of a calibration with accepted effects, reading by reading; a table is followed the
//! same way. Memory is a small correction, so plain fixed-point iteration undoes it.
//!
//! The inverse `m = f(y; B, v)` has the uncertainty of its noise and of everything that was fitted
//! (GUM 5.2.2, correlated inputs): `cov(m) = K^-1 (s^2 I) K^-T + G C G'`, `G = [dm/dB, dm/dv]`,
//! `dm/dB_(c,k) = -K^-1 e_c c_k`, `dm/dv` by differences over the whole history (memory carries a
//! value's error from reading to reading), `C = F F'` the joint covariance of `B` (channel by
//! channel) and `v`.

use super::path::{Node, Reading, WhiskerPath};
use super::physical::{CalibratedReading, PhysicalModel, covariance_root};
use super::system::dynamic;
use super::whisker_effect::{ActiveEffect, SensorMemory};
use nalgebra::{DMatrix, Matrix2, Vector2};
use wcal_core::stream::{MomentSpread, MomentStream, StreamMoments};

/// Step of the differences by a nonlinear value, in its standard deviations.
const VALUE_STEP: f64 = 0.1;

/// The effects at one set of values, with what they remember.
struct EffectMemories {
    terms: Vec<ActiveEffect>,
    memories: Vec<SensorMemory>,
    /// The base moment of the last reading.
    last: [f64; 2],
}

impl EffectMemories {
    fn new(terms: Vec<ActiveEffect>) -> Self {
        let memories = vec![SensorMemory::default(); terms.len()];
        Self {
            terms,
            memories,
            last: [0.0; 2],
        }
    }

    /// Remembers that `base` stands after each of `steps_s`, that of the last reading where none is
    /// stated.
    fn stand(&mut self, steps_s: &[Option<f64>], base: Option<[f64; 2]>) {
        self.memories = self.recalled(steps_s, base.unwrap_or(self.last)).1;
    }

    /// What the sensor makes of a base moment that stands after each of `steps_s`, and what it
    /// remembers then.
    fn recalled(&self, steps_s: &[Option<f64>], base: [f64; 2]) -> ([f64; 2], Vec<SensorMemory>) {
        let (mut sensed, mut memories) = (base, self.memories.clone());
        // The load is taken as standing from the arrival on, the same at every node of the dwell.
        for dt_s in steps_s {
            let effects = self.terms.iter().zip(&mut memories);
            sensed = effects.fold(base, |m, (term, memory)| term.sensed(memory, *dt_s, m));
        }
        (sensed, memories)
    }

    /// The base moment that is sensed so, remembered from now on. One below three times
    /// `visible`, the noise's standard deviations, keeps what it shows: a dead zone hides the moment there.
    fn base(
        &mut self,
        steps_s: &[Option<f64>],
        sensed: Vector2<f64>,
        visible: [f64; 2],
    ) -> [f64; 2] {
        let hidden = sensed.norm() < 3.0 * visible[0].hypot(visible[1]);
        let (mut base, rounds) = (sensed, if hidden { 0 } else { 40 });
        for _ in 0..rounds {
            let left = sensed - Vector2::from(self.recalled(steps_s, base.into()).0);
            base += left;
            if left.amax() < 1e-10 {
                break;
            }
        }
        self.last = base.into();
        self.stand(steps_s, None);
        self.last
    }
}

impl PhysicalModel {
    /// Columns of the readout at one sensed moment.
    fn readout_row(
        &self,
        terms: &[ActiveEffect],
        now: &WhiskerPath,
        sensed: Vector2<f64>,
    ) -> Vec<f64> {
        let columns =
            now.readout_columns(self.seatings, terms, &self.readout_origin, &[sensed.into()]);
        columns.iter().map(|column| column[0]).collect()
    }

    /// Sensed moment of one reading by Newton's method, each step halved until the misfit falls:
    /// where a bent readout never gives the shift, the moment at its fold, the closest one, comes
    /// out. The slope is taken by differences because effects add columns.
    fn sensed(
        &self,
        terms: &[ActiveEffect],
        now: &WhiskerPath,
        inverse: &Matrix2<f64>,
    ) -> Vector2<f64> {
        const STEP_NMM: f64 = 1e-5;
        // A longer step would leave the branch of a quadratic readout that starts at rest.
        const MAX_STEP_NMM: f64 = 0.5;
        let readout = |m: Vector2<f64>| -> Vector2<f64> {
            let row = self.readout_row(terms, now, m);
            let terms = row.iter().zip(&self.coefficients);
            terms.map(|(u, b)| Vector2::from(*b) * *u).sum()
        };
        let shift = Vector2::from(now.readings[0].shift_pm);
        let (mut sensed, mut from, mut step) =
            (Vector2::zeros(), Vector2::zeros(), Vector2::zeros());
        let mut misfit = f64::INFINITY;
        for _ in 0..80 {
            let here = readout(sensed);
            let left = shift - here;
            if left.norm() > misfit {
                step *= 0.5;
            } else {
                (from, misfit) = (sensed, left.norm());
                let along = [Vector2::new(STEP_NMM, 0.0), Vector2::new(0.0, STEP_NMM)];
                let slopes = along.map(|by| (readout(sensed + by) - here) / STEP_NMM);
                let slope = Matrix2::from_columns(&slopes);
                step = (slope.try_inverse().unwrap_or(*inverse) * left).cap_magnitude(MAX_STEP_NMM);
            }
            sensed = from + step;
            if step.norm() < 1e-12 {
                break;
            }
        }
        sensed
    }

    /// Base moments from the shifts of `path`, in time order. `memory` is what memory effects take
    /// from each reading's moment where the poses are known (base less sensed, N mm); without it
    /// the effects run over the readings' own history.
    pub fn infer(&self, path: &WhiskerPath, memory: Option<&[[f64; 2]]>) -> Vec<StreamMoments> {
        self.infer_under(path, memory, &self.noise_of(&path.readings))
    }

    /// The same where the noise of each reading is known, pm.
    pub(super) fn infer_under(
        &self,
        path: &WhiskerPath,
        memory: Option<&[[f64; 2]]>,
        noise_sd_pm: &[f64],
    ) -> Vec<StreamMoments> {
        let unknown = StreamMoments {
            moment_nmm: [f64::NAN; 2],
            sd_nmm: [f64::NAN; 2],
            valid: false,
        };
        let Some(stream) = PhysicalStream::new(self.clone()) else {
            return vec![unknown; path.readings.len()];
        };
        let of = |(i, (sensed, moments, _)): (usize, FollowedReading)| {
            let Some(memory) = memory else { return moments };
            // Base less sensed is known from the poses there: no memory has to be inverted.
            let moment_nmm = [0, 1].map(|c| sensed[c] + memory[i][c]);
            StreamMoments {
                moment_nmm,
                valid: self.is_valid(moment_nmm),
                ..moments
            }
        };
        let followed = stream.follow(path, noise_sd_pm).into_iter();
        followed.enumerate().map(of).collect()
    }

    /// A path's readings through the calibration: moments, and what their spread is made of; none
    /// where the sensitivity cannot be inverted.
    pub fn calibrated(&self, path: &WhiskerPath) -> Option<Vec<CalibratedReading>> {
        let stream = PhysicalStream::new(self.clone())?;
        let followed = stream.follow(path, &self.noise_of(&path.readings));
        Some(followed.into_iter().map(|(_, m, s)| (m, s)).collect())
    }
}

/// A reading that was followed: what is sensed, its base moments, and what their spread is made of.
type FollowedReading = ([f64; 2], StreamMoments, MomentSpread);

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
    /// F with cov(theta) = F F', and the gradient and the noise (pm) at the last reading.
    factor: DMatrix<f64>,
    gradient: DMatrix<f64>,
    noise_sd_pm: f64,
    /// Path of the one reading at hand.
    now: WhiskerPath,
}

impl PhysicalStream {
    /// Ready for the first reading; `None` where the sensitivity cannot be inverted.
    pub fn new(model: PhysicalModel) -> Option<Self> {
        let first = 2 * model.coefficients.len();
        let with = |value: usize, by: f64| {
            let mut terms = model.terms();
            let mut values = terms.iter_mut().flat_map(|t| &mut t.term.values);
            if let Some(value) = values.nth(value) {
                *value += by;
            }
            EffectMemories::new(terms)
        };
        let moved = (first..model.covariance.len()).map(|place| {
            let step = VALUE_STEP * model.covariance[place][place].max(0.0).sqrt();
            (place, step, [-step, step].map(|by| with(place - first, by)))
        });
        Some(Self {
            effects: EffectMemories::new(model.terms()),
            // A value without variance has no part in the spread.
            moved: moved.filter(|(_, step, _)| *step > 0.0).collect(),
            inverse: model.sensitivity().try_inverse()?,
            last_s: None,
            factor: covariance_root(&model).0,
            gradient: DMatrix::zeros(2, model.covariance.len()),
            noise_sd_pm: model.noise_sd_pm,
            now: WhiskerPath::default(),
            model,
        })
    }

    /// The readings of a path one after the other, `noise_sd_pm` of each.
    fn follow(mut self, path: &WhiskerPath, noise_sd_pm: &[f64]) -> Vec<FollowedReading> {
        let mut out = Vec::with_capacity(path.readings.len());
        let mut steps_s = Vec::new();
        let mut last: Option<&Node> = None;
        for node in &path.nodes {
            steps_s.push(self.last_s.replace(node.t_s).map(|last| node.t_s - last));
            let stays = |last: &Node| (last.line, last.x_mm) == (node.line, node.x_mm);
            if let Some(i) = node.reading {
                self.noise_sd_pm = noise_sd_pm[i];
                let (sensed, moments) = self.take(path.readings[i].clone(), &steps_s);
                out.push((sensed.into(), moments, self.spread()));
                last = Some(node);
            } else if node.rest && node.line.is_none() {
                // Between seatings the wire is free.
                self.stand(&steps_s, Some([0.0; 2]));
            } else if last.is_some_and(stays) {
                // The end of an average: the load of its reading goes on.
                self.stand(&steps_s, None);
            } else {
                // The arrival at the reading that follows, whose load begins here.
                continue;
            }
            steps_s.clear();
        }
        out
    }

    /// A base moment that stands after each of `steps_s`, with every value of the effects.
    fn stand(&mut self, steps_s: &[Option<f64>], base: Option<[f64; 2]>) {
        self.effects.stand(steps_s, base);
        let sides = self.moved.iter_mut().flat_map(|(.., sides)| sides);
        sides.for_each(|side| side.stand(steps_s, base));
    }

    /// What is sensed of a reading that stands after each of `steps_s`, and its base moments.
    fn take(&mut self, reading: Reading, steps_s: &[Option<f64>]) -> (Vector2<f64>, StreamMoments) {
        let sensed = self.sense(reading);
        let row = self
            .model
            .readout_row(&self.effects.terms, &self.now, sensed);
        // m = K^-1 (y - B u): a coefficient moves the moment by -K^-1 e_c u_k.
        let by_coefficients =
            -dynamic(&self.inverse).kronecker(&DMatrix::from_row_slice(1, row.len(), &row));
        self.gradient = by_coefficients.resize_horizontally(self.factor.nrows(), 0.0);
        let visible = self.sd_nmm();
        let moment_nmm = self.effects.base(steps_s, sensed, visible);
        for (place, step, sides) in &mut self.moved {
            let [low, high] = sides.each_mut().map(|side| {
                let sensed = self.model.sensed(&side.terms, &self.now, &self.inverse);
                Vector2::from(side.base(steps_s, sensed, visible))
            });
            // Each side keeps its own memory: a value's error is carried through the history.
            let slope = (high - low) / (2.0 * *step);
            self.gradient.set_column(*place, &slope);
        }
        let moments = StreamMoments {
            moment_nmm,
            sd_nmm: self.sd_nmm(),
            valid: self.model.is_valid(moment_nmm),
        };
        (sensed, moments)
    }

    fn sense(&mut self, reading: Reading) -> Vector2<f64> {
        self.now.readings = vec![reading];
        self.model
            .sensed(&self.effects.terms, &self.now, &self.inverse)
    }

    fn reading(&self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> Reading {
        Reading {
            seating: self.model.seatings.saturating_sub(1),
            t_s,
            shift_pm,
            rise_degc,
            temperature_loo_degc: rise_degc,
            ..Reading::default()
        }
    }

    /// Standard deviations of the last reading's moments, N mm.
    fn sd_nmm(&self) -> [f64; 2] {
        let (shared, noise) = (&self.gradient * &self.factor, self.noise_nmm2());
        [0, 1].map(|c| (noise[(c, c)] + shared.row(c).norm_squared()).sqrt())
    }

    /// Noise of the wavelengths through the inverse.
    fn noise_nmm2(&self) -> Matrix2<f64> {
        // K^-1 (s^2 I) K^-T: in both gratings independent and of one variance.
        self.inverse * self.inverse.transpose() * self.noise_sd_pm.powi(2)
    }
}

impl MomentStream for PhysicalStream {
    fn quick_nmm(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> [f64; 2] {
        let reading = self.reading(t_s, shift_pm, rise_degc);
        self.sense(reading).into()
    }

    fn moments(&mut self, t_s: f64, shift_pm: [f64; 2], rise_degc: f64) -> StreamMoments {
        let reading = self.reading(t_s, shift_pm, rise_degc);
        let dt_s = self.last_s.replace(t_s).map(|last| t_s - last);
        self.take(reading, &[dt_s]).1
    }

    fn spread(&self) -> MomentSpread {
        let common = &self.gradient * &self.factor;
        // Where the truth is theta + f, the stated moment is too large by -G f.
        MomentSpread {
            noise_nmm2: self.noise_nmm2(),
            shared_nmm: common.column_iter().map(|u| [-u[0], -u[1]]).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::path::{ReadoutOrigin, bare_row};
    use crate::whisker::physical::AcceptedEffect;
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

    fn path(model: &PhysicalModel, shifts: &[(f64, [f64; 2])]) -> WhiskerPath {
        let row = |(k, (t_s, shift_pm)): (usize, &(f64, [f64; 2]))| bare_row(k, *t_s, *shift_pm);
        let rows: Vec<WhiskerRow> = shifts.iter().enumerate().map(row).collect();
        WhiskerPath::new(&rows, &[], &model.fbg, None)
    }

    fn of_table(model: &PhysicalModel, shifts: &[(f64, [f64; 2])]) -> Vec<StreamMoments> {
        model.infer(&path(model, shifts), None)
    }

    /// The sensor and the readout make the shifts of the moments again.
    #[test]
    fn the_inverse_undoes_the_forward_model() {
        let (model, shifts) = (model(), shifts(300));
        let (path, terms) = (path(&model, &shifts), model.terms());
        let inferred = model.infer(&path, None);
        let mut sensed: Vec<[f64; 2]> = inferred.iter().map(|m| m.moment_nmm).collect();
        terms.iter().for_each(|t| t.sensor(&path, &mut sensed));
        let columns = path.readout_columns(1, &terms, &model.readout_origin, &sensed);
        let mut compared = 0;
        for (i, (_, shift)) in shifts.iter().enumerate() {
            // Below the noise a reading keeps what it shows.
            if sensed[i][0].hypot(sensed[i][1]) < 0.02 {
                continue;
            }
            compared += 1;
            for c in 0..2 {
                let terms = columns.iter().zip(&model.coefficients);
                let made: f64 = terms.map(|(column, b)| column[i] * b[c]).sum();
                assert!((made - shift[c]).abs() < 1e-6, "{i}: {made} {shift:?}");
            }
        }
        assert!(compared > 200, "{compared}");
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
        let loaded = |m: &StreamMoments| m.moment_nmm[0].abs().min(m.moment_nmm[1].abs()) > 0.1;
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
