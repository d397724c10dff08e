//! The readings' noise: how large it is from reading to reading and what neighbouring readings
//! share of it.
//!
//! In one channel the noise of reading i is
//!
//! ```text
//! n_i = s (h_i e_i + rho_c c(t_i) + rho_p g_i p_k(i)),   e, p white with unit variance,
//! cov(c(t), c(t')) = exp(-|t - t'| / tau)                (first-order Gauss-Markov process)
//! ```
//!
//! with `s` the repeat noise, `h` its law (1 for a typical loaded reading), `c` noise correlated in
//! time, and `p` what setting a pose adds: one draw for all readings k(i) that were taken without
//! moving in between; `g` is 0 at rest, where no pose is set. Whitening is the innovation form of
//! the Kalman filter with the two states (c, p): linear in the data, unit lower triangular up to
//! scale, O(readings). (Harvey, "Forecasting, Structural Time Series Models and the Kalman Filter",
//! 1989, ch. 3.)

use nalgebra::DMatrix;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What readings share of their noise, in units of the repeat noise `s`.
#[derive(Debug, Clone, PartialEq)]
pub struct SharedNoise {
    /// Clock of the readings, s (places in the order where there is none); rising.
    pub clock: Arc<Vec<f64>>,
    /// Number of the pose setting of each reading: equal where nothing moved in between.
    pub settings: Arc<Vec<usize>>,
    /// Whether setting a pose enters the reading (not at rest).
    pub posed: Arc<Vec<bool>>,
    /// Standard deviation and time constant (in units of the clock) of the part that is correlated
    /// in time.
    pub correlated: Option<[f64; 2]>,
    /// Standard deviation of what setting a pose adds.
    pub pose: f64,
}

/// Innovation form of one reading.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Innovation {
    /// Decay of the correlated part since the reading before.
    decay: f64,
    /// Another pose was set.
    new_setting: bool,
    /// 1 where the pose enters.
    posed: f64,
    /// Kalman gains of both states.
    gain: [f64; 2],
    /// One over the innovation's standard deviation; 0 for readings that do not count.
    scale: f64,
}

/// Rows that count, their standard deviations and what they share: everything that turns readings
/// into white ones.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// 1 / h; 0 for readings that can never count.
    own: Vec<f64>,
    /// 1 / h; 0 for readings that do not count.
    relative: Vec<f64>,
    shared: Option<SharedNoise>,
    filter: Vec<Innovation>,
}

impl Weights {
    /// Every reading alike.
    pub fn equal(n: usize) -> Self {
        Self::independent(vec![1.0; n])
    }

    /// Independent readings with these weights (1 / relative standard deviation; 0 = does not
    /// count).
    pub fn independent(relative: Vec<f64>) -> Self {
        Self {
            own: relative.clone(),
            relative,
            shared: None,
            filter: Vec::new(),
        }
    }

    /// Readings that share part of their noise.
    pub(crate) fn sharing(relative: Vec<f64>, shared: SharedNoise) -> Self {
        if shared.correlated.is_none() && shared.pose == 0.0 {
            return Self::independent(relative);
        }
        // Innovations of the Kalman filter are white: each reading less what those before it say.
        let filter = innovations(&relative, &shared);
        Self {
            own: relative.clone(),
            relative,
            shared: Some(shared),
            filter,
        }
    }

    /// The same noise where only readings with `keep` count.
    pub fn masked(&self, keep: impl Fn(usize) -> bool) -> Self {
        let relative = self
            .relative
            .iter()
            .enumerate()
            .map(|(i, w)| if keep(i) { *w } else { 0.0 })
            .collect();
        self.with(relative)
    }

    /// The same noise where every reading that can be used counts.
    pub(crate) fn unmasked(&self) -> Self {
        self.with(self.own.clone())
    }

    fn with(&self, relative: Vec<f64>) -> Self {
        let filter = self
            .shared
            .as_ref()
            .map_or_else(Vec::new, |s| innovations(&relative, s));
        Self {
            own: self.own.clone(),
            relative,
            shared: self.shared.clone(),
            filter,
        }
    }

    /// Weight of a reading by itself, 1 / h; 0 where it does not count.
    pub fn of(&self, i: usize) -> f64 {
        self.relative[i]
    }

    /// The weights by themselves.
    pub fn relative(&self) -> &[f64] {
        &self.relative
    }

    /// Whether a reading counts.
    pub fn counts(&self, i: usize) -> bool {
        self.relative[i] > 0.0
    }

    /// Readings in the table.
    pub fn len(&self) -> usize {
        self.relative.len()
    }

    /// No readings.
    pub fn is_empty(&self) -> bool {
        self.relative.is_empty()
    }

    /// Readings that count.
    pub fn active(&self) -> usize {
        self.relative.iter().filter(|w| **w > 0.0).count()
    }

    /// What readings share.
    pub fn shared(&self) -> Option<&SharedNoise> {
        self.shared.as_ref()
    }

    /// Standard deviation of a new reading at a new pose and another time, in units of `s`, for
    /// each reading's law.
    pub(crate) fn total_sd(&self, i: usize) -> f64 {
        let own = if self.own[i] > 0.0 {
            1.0 / self.own[i]
        } else {
            1.0
        };
        let shared = self.shared.as_ref().map_or(0.0, |s| {
            let pose = if s.posed[i] { s.pose } else { 0.0 };
            s.correlated.map_or(0.0, |c| c[0] * c[0]) + pose * pose
        });
        // A new pose at a distant time shares nothing with the readings: variances add.
        (own * own + shared).sqrt()
    }

    /// Whitens every column; rows that do not count become zero.
    pub fn apply(&self, m: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = m.clone();
        for mut column in out.column_iter_mut() {
            self.whiten(column.as_mut_slice());
        }
        out
    }

    /// Whitens one column.
    pub(crate) fn apply_to(&self, column: &[f64]) -> Vec<f64> {
        let mut out = column.to_vec();
        self.whiten(&mut out);
        out
    }

    fn whiten(&self, column: &mut [f64]) {
        if self.shared.is_none() {
            column
                .iter_mut()
                .zip(&self.relative)
                .for_each(|(v, w)| *v *= w);
            return;
        }
        let (mut correlated, mut pose) = (0.0, 0.0);
        for (v, f) in column.iter_mut().zip(&self.filter) {
            correlated *= f.decay;
            if f.new_setting {
                pose = 0.0;
            }
            if f.scale == 0.0 {
                *v = 0.0;
                continue;
            }
            // Innovation: what the readings before did not let expect; its standard deviation makes
            // it white.
            let surprise = *v - correlated - f.posed * pose;
            correlated += f.gain[0] * surprise;
            pose += f.gain[1] * surprise;
            *v = surprise * f.scale;
        }
    }

    /// Makes of white values readings with this noise: the inverse of whitening, readings that do
    /// not count stay zero.
    pub fn colour(&self, column: &mut [f64]) {
        let (mut correlated, mut pose) = (0.0, 0.0);
        for (v, f) in column.iter_mut().zip(&self.filter) {
            correlated *= f.decay;
            if f.new_setting {
                pose = 0.0;
            }
            if f.scale > 0.0 {
                let surprise = *v / f.scale;
                *v = surprise + correlated + f.posed * pose;
                correlated += f.gain[0] * surprise;
                pose += f.gain[1] * surprise;
            }
        }
    }

    /// Logarithm of the determinant of the covariance of the readings that count, `s` = 1.
    pub fn log_determinant(&self) -> f64 {
        // Whitening is triangular: the determinant is the product of the innovations' variances.
        if self.shared.is_some() {
            self.filter
                .iter()
                .filter(|f| f.scale > 0.0)
                .map(|f| -2.0 * f.scale.ln())
                .sum()
        } else {
            self.relative
                .iter()
                .filter(|w| **w > 0.0)
                .map(|w| -2.0 * w.ln())
                .sum()
        }
    }

    /// Variance of the sum of readings times `share` of each one's own noise, `s` = 1.
    pub fn variance_of(&self, share: &[f64]) -> f64 {
        let own: f64 = share.iter().map(|v| v * v).sum();
        let Some(s) = &self.shared else { return own };
        let [sd, tau] = s.correlated.unwrap_or([0.0, 1.0]);
        // Sum over pairs of an exponential: each reading carries on the decayed sum of those before
        // it.
        let (mut before, mut correlated, mut clock) = (0.0, 0.0, s.clock[0]);
        let mut poses: BTreeMap<usize, f64> = BTreeMap::new();
        for (i, (v, weight)) in share.iter().zip(&self.relative).enumerate() {
            before *= (-(s.clock[i] - clock).max(0.0) / tau).exp();
            clock = s.clock[i];
            let v = v * weight;
            // v_i^2 and both mixed terms with all readings before.
            correlated += v * (v + 2.0 * before);
            before += v;
            if s.posed[i] {
                *poses.entry(s.settings[i]).or_insert(0.0) += v;
            }
        }
        own + sd * sd * correlated + s.pose * s.pose * poses.values().map(|v| v * v).sum::<f64>()
    }

    /// Covariance of readings `rows`, `s` = 1 (dense; for few readings).
    pub fn covariance(&self, rows: &[usize]) -> DMatrix<f64> {
        DMatrix::from_fn(rows.len(), rows.len(), |a, b| {
            let (i, j) = (rows[a], rows[b]);
            let own = if a == b {
                self.own[i].max(1e-6).powi(-2)
            } else {
                0.0
            };
            let Some(s) = &self.shared else { return own };
            let correlated = s.correlated.map_or(0.0, |[sd, tau]| {
                sd * sd * (-(s.clock[i] - s.clock[j]).abs() / tau).exp()
            });
            let same = s.settings[i] == s.settings[j] && s.posed[i] && s.posed[j];
            own + correlated + if same { s.pose * s.pose } else { 0.0 }
        })
    }
}

/// Kalman filter over the states (correlated part, pose's offset).
fn innovations(relative: &[f64], shared: &SharedNoise) -> Vec<Innovation> {
    let [sd, tau] = shared.correlated.unwrap_or([0.0, 1.0]);
    let (stationary, of_pose) = (sd * sd, shared.pose * shared.pose);
    // Covariance of the states: correlated, shared, pose.
    let [mut cc, mut cp, mut pp] = [stationary, 0.0, of_pose];
    (0..relative.len())
        .map(|i| {
            let dt = if i == 0 {
                f64::INFINITY
            } else {
                (shared.clock[i] - shared.clock[i - 1]).max(0.0)
            };
            // Prediction: the correlated part forgets with the time between, a repeated pose is
            // another draw.
            let decay = (-dt / tau).exp();
            let new_setting = i == 0 || shared.settings[i] != shared.settings[i - 1];
            // Stationary: what is forgotten comes in as new noise, and the variance stays.
            cc = decay * decay * cc + (1.0 - decay * decay) * stationary;
            cp *= decay;
            if new_setting {
                (cp, pp) = (0.0, of_pose);
            }
            let posed = f64::from(u8::from(shared.posed[i]));
            if relative[i] <= 0.0 {
                return Innovation {
                    decay,
                    new_setting,
                    posed,
                    gain: [0.0; 2],
                    scale: 0.0,
                };
            }
            // Update: covariance of the states with the reading, gain, and their remaining
            // covariance.
            let (c, p) = (cc + posed * cp, cp + posed * pp);
            let variance = c + posed * p + relative[i].powi(-2);
            let gain = [c / variance, p / variance];
            cc -= gain[0] * c;
            cp -= gain[0] * p;
            pp -= gain[1] * p;
            Innovation {
                decay,
                new_setting,
                posed,
                gain,
                scale: 1.0 / variance.sqrt(),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DVector;

    fn example() -> Weights {
        let clock: Vec<f64> = (0..9).map(|k| f64::from(k * k)).collect();
        let shared = SharedNoise {
            clock: Arc::new(clock),
            settings: Arc::new(vec![0, 0, 1, 1, 1, 2, 3, 3, 4]),
            posed: Arc::new(vec![true, true, true, true, true, false, true, true, true]),
            correlated: Some([1.3, 11.0]),
            pose: 2.1,
        };
        Weights::sharing(vec![1.0, 0.5, 2.0, 1.0, 1.0, 1.0, 0.7, 1.0, 1.0], shared)
    }

    /// Whitening W and covariance C belong together: W C W' = 1, and the determinants agree.
    #[test]
    fn whitened_readings_are_white() {
        for weights in [example(), example().masked(|i| i != 3 && i != 7)] {
            let rows: Vec<usize> = (0..9).filter(|&i| weights.counts(i)).collect();
            let covariance = weights.covariance(&rows);
            let w = weights.apply(&DMatrix::identity(9, 9));
            let w = w.select_rows(&rows).select_columns(&rows);
            let white = &w * &covariance * w.transpose();
            assert!((white - DMatrix::identity(rows.len(), rows.len())).norm() < 1e-10);
            assert!((covariance.determinant().ln() - weights.log_determinant()).abs() < 1e-9);
            // The variance of a sum is that of the covariance.
            let share: Vec<f64> = (0..9)
                .map(|i| {
                    if weights.counts(i) {
                        i as f64 - 3.5
                    } else {
                        0.0
                    }
                })
                .collect();
            let sum =
                DVector::from_iterator(rows.len(), rows.iter().map(|&i| share[i] * weights.of(i)));
            let variance = sum.dot(&(&covariance * &sum));
            assert!((weights.variance_of(&share) / variance - 1.0).abs() < 1e-10);
            // Coloured, they are readings again.
            let mut again = weights.apply_to(&[1.0, -2.0, 3.0, 0.5, 0.0, 1.5, -1.0, 2.0, 4.0]);
            weights.colour(&mut again);
            assert!(rows.iter().all(|&i| {
                (again[i] - [1.0, -2.0, 3.0, 0.5, 0.0, 1.5, -1.0, 2.0, 4.0][i]).abs() < 1e-12
            }));
            // Negative control: readings taken for independent are not white.
            let plain = Weights::independent(weights.relative().to_vec());
            let p = plain
                .apply(&DMatrix::identity(9, 9))
                .select_rows(&rows)
                .select_columns(&rows);
            assert!(
                (&p * covariance * p.transpose() - DMatrix::identity(rows.len(), rows.len()))
                    .norm()
                    > 1.0
            );
        }
    }
}
