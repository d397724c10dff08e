//! The calibration that `verify` writes: wavelengths from moments with the accepted effects, and
//! its inverse.
//!
//! Readout of a reading: `y = B' c(m, v)`, with
//! `c = [1, m1, m2, zeros of seatings, effect columns]`, coefficients `B` and the effects'
//! nonlinear values `v`; the inverse is `m = f(y; B, v)`, its uncertainty in `uncertainty`.

use super::system::WhiskerSystem;
use super::whisker_effect::ActiveEffect;
use crate::effect::{EffectTerm, LawRequirement};
use crate::measurement_model::MeasurementModel;
use crate::method::hypothesis::Hypothesis;
use crate::method::inference::covariance;
use crate::method::noise::Noise;
use crate::scalar::ModelError;
use crate::scalar::model::square;
use crate::whisker::path::{Reading, ReadoutOrigin, WhiskerPath, typical_samples};
use nalgebra::{DMatrix, Matrix2, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::FbgSpec;
use wcal_core::verify_document::EffectParameter;

/// An accepted effect with its fitted values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AcceptedEffect {
    /// Identifier.
    pub id: String,
    /// Law.
    pub law: String,
    /// Nonlinear values in the law's order.
    pub values: Vec<f64>,
    /// Every parameter with its interval (physical).
    pub parameters: Vec<EffectParameter>,
}

/// The part of the readings' noise that is correlated in time (first-order Gauss-Markov process).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CorrelatedReadings {
    /// Standard deviation, pm.
    pub sd_pm: f64,
    /// Standard deviation of the rest of a typical loaded reading's noise, pm.
    pub own_sd_pm: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
}

/// How the variance of a reading depends on the samples n that it averages:
/// `(common + samples / n) / (common + 1)` of a typical one's.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Averaging {
    /// Samples of a typical loaded reading.
    pub samples: f64,
    /// Variance that averaging does not lower, beside 1 of a typical reading's average.
    pub common: f64,
}

/// Wavelengths as a function of base moments, with accepted effects: `y = B' [1, m, columns]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PhysicalModel {
    /// Coefficients, one row a design column (zero, the two moments, zeros of later seatings,
    /// effect columns), one column a channel.
    pub coefficients: Vec<[f64; 2]>,
    /// Covariance of the coefficients, channel by channel, and of the nonlinear values after them.
    pub covariance: Vec<Vec<f64>>,
    /// Standard deviation of a typical loaded reading at a repeated pose, pm.
    pub noise_sd_pm: f64,
    /// The part of the readings' noise that is correlated in time (first-order Gauss-Markov
    /// process), for predictions; absent where it predicts no better.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correlated_noise: Option<CorrelatedReadings>,
    /// What the readings' noise is the noise of; absent where the session does not say how many
    /// samples it averaged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub averaging: Option<Averaging>,
    /// By how much the session's stage clock was set to agree with the readings', s: its positions
    /// are those of so much later.
    #[serde(default)]
    pub stage_clock_s: f64,
    /// Where the effects' columns of time and temperature are zero; files of before these were
    /// stored have them from 0.
    #[serde(default)]
    pub readout_origin: ReadoutOrigin,
    /// Accepted effects.
    pub effects: Vec<AcceptedEffect>,
    /// Seatings that the fit saw; each after the first has its own zero, and new readings belong to
    /// the last.
    #[serde(default = "one")]
    pub seatings: u32,
    /// Gratings.
    pub fbg: FbgSpec,
    /// Largest moment, N mm, that the fitted readings reach; beyond 1.1 times it the calibration is
    /// not valid.
    pub largest_moment_nmm: f64,
}

fn one() -> u32 {
    1
}

/// Moments from wavelengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Inferred {
    /// Base moments, N mm.
    pub moment_nmm: [f64; 2],
    /// Standard deviations, N mm.
    pub sd_nmm: [f64; 2],
    /// Inside the region that the calibration was fitted in.
    pub valid: bool,
}

/// More samples than any reading averages, and a clock that is farther off than any stage's, s.
const MAX_SAMPLES: f64 = 1e9;
const MAX_STAGE_CLOCK_S: f64 = 10.0;
/// Share of the largest fitted moment that is still valid.
pub(super) const VALID_SHARE: f64 = 1.1;

impl PhysicalModel {
    /// The model of an explanation.
    pub fn new(system: &WhiskerSystem, h: &Hypothesis, noise_sd_pm: f64) -> Self {
        let fit = &h.fit;
        let effects = fit
            .terms
            .iter()
            .map(|t| {
                let effect = &system.catalogue()[t.effect];
                AcceptedEffect {
                    id: effect.id.to_owned(),
                    law: effect.law(t.law).name.to_owned(),
                    values: t.values.clone(),
                    parameters: crate::method::inference::parameters(system, h, t.effect),
                }
            })
            .collect();
        // From the engine's channels, whose noise is uncorrelated and of one variance, to the
        // gratings'.
        let pm = system.channels_pm();
        let coefficients = &fit.coefficients * &pm;
        let (count, size) = (coefficients.nrows(), coefficients.len());
        let mut turn = DMatrix::identity(size + fit.tangents.len(), size + fit.tangents.len());
        turn.view_mut((0, 0), (size, size))
            .copy_from(&pm.transpose().kronecker(&DMatrix::identity(count, count)));
        let covariance = &turn * covariance(fit, fit.variance()) * turn.transpose();
        let largest = system.moments(&fit.terms).map_or(0.0, |(_, base)| {
            base.iter().map(|m| m[0].hypot(m[1])).fold(0.0, f64::max)
        });
        Self {
            coefficients: coefficients.row_iter().map(|r| [r[0], r[1]]).collect(),
            covariance: covariance
                .row_iter()
                .map(|r| r.iter().copied().collect())
                .collect(),
            noise_sd_pm,
            correlated_noise: None,
            averaging: None,
            stage_clock_s: system.stage_clock_s(),
            readout_origin: system.origin,
            effects,
            seatings: system.seatings(),
            fbg: system.data.fbg.clone(),
            largest_moment_nmm: largest,
        }
    }

    /// With the correlated part of the readings' noise, where there is a clock to which it belongs,
    /// and how the variance of a reading depends on the samples that it averages, where the session
    /// says how many.
    pub(crate) fn with_noise(self, system: &WhiskerSystem, noise: &Noise) -> Self {
        let (pose, factor) = (noise.pose.map_or(0.0, |p| p.value), system.noise_factor());
        let part = noise
            .correlated
            .as_ref()
            .filter(|_| system.path.columns.time);
        let correlated_noise = part.map(|(sd, tau)| CorrelatedReadings {
            sd_pm: sd.value * factor,
            own_sd_pm: noise.repeat.value.hypot(pose) * factor,
            time_constant_s: *tau,
        });
        let averaging = typical_samples(&system.path.readings).map(|samples| Averaging {
            samples,
            common: noise.common,
        });
        Self {
            correlated_noise,
            averaging,
            ..self
        }
    }

    /// Variances of a path's readings beside 1 of a typical reading of the calibration's own
    /// session.
    pub(crate) fn relative_variances(&self, readings: &[Reading]) -> Vec<f64> {
        // Noise of samples falls with their number; what they share does not.
        let of = |r: &Reading| match (self.averaging, r.samples) {
            (Some(a), Some(n)) => (a.common + a.samples / f64::from(n.max(1))) / (a.common + 1.0),
            _ => 1.0,
        };
        readings.iter().map(of).collect()
    }

    /// Sensitivity K, pm/(N mm): rows are channels.
    pub fn sensitivity(&self) -> Matrix2<f64> {
        Matrix2::from_fn(|c, j| self.coefficients[j + 1][c])
    }

    /// Checks that the parts belong together and every effect is of this version's catalogue,
    /// before anything is computed with them.
    ///
    /// # Errors
    /// [`ModelError::UnknownEffect`] or [`ModelError::Shape`], by name.
    pub fn check(&self) -> Result<(), ModelError> {
        let catalogue = crate::whisker::effects::whisker_catalogue();
        let (mut columns, mut values) = (3, 0);
        for a in &self.effects {
            let unknown = || ModelError::UnknownEffect {
                effect: a.id.clone(),
                law: a.law.clone(),
            };
            let effect = catalogue
                .iter()
                .find(|e| e.effect.id == a.id)
                .ok_or_else(unknown)?;
            let (_, law) = effect.effect.law_named(&a.law).ok_or_else(unknown)?;
            if a.values.len() != law.parameters.len() {
                let what = format!("values of {} ({})", a.id, a.law);
                return Err(ModelError::shape(
                    what,
                    law.parameters.len(),
                    a.values.len(),
                ));
            }
            columns += law.linear.len();
            values += a.values.len();
        }
        // Each seating after the first has its own column: reject a mounting count inconsistent
        // with the coefficients.
        let count = self.coefficients.len();
        let seatings = (count + 1).checked_sub(columns).filter(|s| *s > 0);
        if seatings.is_none() {
            return Err(ModelError::shape(
                "coefficients",
                format!("at least {columns} rows"),
                count,
            ));
        }
        if seatings != usize::try_from(self.seatings.max(1)).ok() {
            let expected = format!("{}, as the coefficients have it", seatings.unwrap_or(0));
            return Err(ModelError::shape("seatings", expected, self.seatings));
        }
        square(&self.covariance, 2 * count, 2 * count + values)?;
        if self.sensitivity().try_inverse().is_none() {
            return Err(ModelError::shape(
                "coefficients",
                "a sensitivity that can be inverted",
                "a singular one",
            ));
        }
        if self.noise_sd_pm < 0.0 {
            return Err(ModelError::shape(
                "noise_sd_pm",
                "0 or more",
                self.noise_sd_pm,
            ));
        }
        let known = |a: &Averaging| a.samples >= 1.0 && a.samples <= MAX_SAMPLES && a.common >= 0.0;
        if let Some(a) = self.averaging.filter(|a| !known(a)) {
            let (expected, found) = (
                "1 to 1e9 samples, a variance of 0 or more",
                (a.samples, a.common),
            );
            return Err(ModelError::shape(
                "averaging",
                expected,
                format!("{found:?}"),
            ));
        }
        if !(self.stage_clock_s.abs() <= MAX_STAGE_CLOCK_S) {
            return Err(ModelError::shape(
                "stage_clock_s",
                "at most 10 s",
                self.stage_clock_s,
            ));
        }
        let sound =
            |c: &CorrelatedReadings| c.sd_pm >= 0.0 && c.own_sd_pm > 0.0 && c.time_constant_s > 0.0;
        if let Some(c) = self.correlated_noise.filter(|c| !sound(c)) {
            let found = format!(
                "{} and {} pm, {} s",
                c.sd_pm, c.own_sd_pm, c.time_constant_s
            );
            return Err(ModelError::shape(
                "correlated_noise",
                "positive deviations and a positive time",
                found,
            ));
        }
        Ok(())
    }

    /// The accepted effects with their values by name.
    pub(super) fn terms(&self) -> Vec<ActiveEffect> {
        self.terms_moved(None)
    }

    /// [`Self::terms`] with one value (its place in the covariance) moved by some amount.
    pub(super) fn terms_moved(&self, moved: Option<(usize, f64)>) -> Vec<ActiveEffect> {
        let mut place = 2 * self.coefficients.len();
        let catalogue = crate::whisker::effects::whisker_catalogue();
        self.effects
            .iter()
            .filter_map(|a| {
                let index = catalogue.iter().position(|e| e.effect.id == a.id)?;
                let (law, _) = catalogue[index].effect.law_named(&a.law)?;
                let mut values = a.values.clone();
                if let Some(v) =
                    moved.and_then(|(k, by)| Some((values.get_mut(k.checked_sub(place)?)?, by)))
                {
                    *v.0 += v.1;
                }
                place += a.values.len();
                let term = EffectTerm {
                    effect: index,
                    law,
                    values,
                };
                Some(ActiveEffect {
                    effect: &catalogue[index],
                    term,
                })
            })
            .collect()
    }

    /// The first accepted effect that needs a column which `path` lacks to infer moments, and that
    /// column.
    pub fn missing_column(&self, path: &WhiskerPath) -> Option<(&str, &'static str)> {
        let lacks = |need: &LawRequirement| match need {
            LawRequirement::Temperature => {
                (!path.columns.temperature).then_some("a temperature or fbg_ref_nm")
            }
            LawRequirement::Time => (!path.columns.time).then_some("t_s"),
            _ => None,
        };
        let terms = self.terms();
        self.effects
            .iter()
            .zip(&terms)
            .find_map(|(a, t)| Some((a.id.as_str(), t.law().needs.iter().find_map(lacks)?)))
    }

    /// Predicted shifts at `sensed` moments, readings x channels, pm.
    fn readout(
        &self,
        terms: &[ActiveEffect],
        path: &WhiskerPath,
        sensed: &[[f64; 2]],
    ) -> DMatrix<f64> {
        let columns = self.columns(terms, path, sensed);
        DMatrix::from_fn(sensed.len(), 2, |i, c| {
            columns
                .iter()
                .zip(&self.coefficients)
                .map(|(col, b)| col[i] * b[c])
                .sum()
        })
    }

    /// Columns of the readout at `sensed` moments, one value a reading each.
    pub(super) fn columns(
        &self,
        terms: &[ActiveEffect],
        path: &WhiskerPath,
        sensed: &[[f64; 2]],
    ) -> Vec<Vec<f64>> {
        path.readout_columns(self.seatings, terms, &self.readout_origin, sensed)
    }

    /// Base moments from the shifts of `path`, in time order. `memory` is what memory effects take
    /// from each reading's moment where the poses are known (base less sensed, N mm); without it
    /// the effects run over the readings' own history.
    ///
    /// Memory is a small correction, so plain fixed-point iteration undoes it.
    pub fn infer(&self, path: &WhiskerPath, memory: Option<&[[f64; 2]]>) -> Vec<Inferred> {
        let noise_pm = |variance: f64| self.noise_sd_pm * variance.sqrt();
        let noise_pm: Vec<f64> = self
            .relative_variances(&path.readings)
            .into_iter()
            .map(noise_pm)
            .collect();
        self.infer_under(path, memory, &noise_pm)
    }

    /// The same where the noise of each reading is known, pm.
    pub(crate) fn infer_under(
        &self,
        path: &WhiskerPath,
        memory: Option<&[[f64; 2]]>,
        noise_sd_pm: &[f64],
    ) -> Vec<Inferred> {
        let terms = self.terms();
        let n = path.readings.len();
        let Some(inverse) = self.sensitivity().try_inverse() else {
            return vec![
                Inferred {
                    moment_nmm: [f64::NAN; 2],
                    sd_nmm: [f64::NAN; 2],
                    valid: false
                };
                n
            ];
        };
        let sensed = self.sensed(&terms, path, &inverse);
        let (gradients, visible) = self.gradients(&terms, path, &sensed, &inverse, noise_sd_pm);
        let sds: Vec<[f64; 2]> = gradients
            .iter()
            .zip(noise_sd_pm)
            .map(|(g, s)| self.sd_nmm(&inverse, g, *s))
            .collect();
        let base = match memory {
            Some(m) => sensed
                .iter()
                .zip(m)
                .map(|(f, d)| [f[0] + d[0], f[1] + d[1]])
                .collect(),
            None => undo_memory(&terms, path, &sensed, &visible),
        };
        sds.iter()
            .zip(base)
            .map(|(sd, m)| Inferred {
                moment_nmm: m,
                sd_nmm: *sd,
                valid: m[0].hypot(m[1]) <= VALID_SHARE * self.largest_moment_nmm,
            })
            .collect()
    }

    /// Felt moments by Newton's method reading by reading, each step halved until the misfit falls:
    /// where a bent readout never gives the shift, the moment at its fold, the closest one, comes
    /// out. The slope is taken by differences because effects add columns.
    pub(super) fn sensed(
        &self,
        terms: &[ActiveEffect],
        path: &WhiskerPath,
        inverse: &Matrix2<f64>,
    ) -> Vec<[f64; 2]> {
        const STEP_NMM: f64 = 1e-5;
        // A longer step would leave the branch of a quadratic readout that starts at rest.
        const MAX_STEP_NMM: f64 = 0.5;
        let n = path.readings.len();
        let mut sensed = vec![[0.0; 2]; n];
        let mut from = vec![Vector2::zeros(); n];
        let mut steps: Vec<Vector2<f64>> = vec![Vector2::zeros(); n];
        let mut misfit = vec![f64::INFINITY; n];
        for _ in 0..80 {
            let here = self.readout(terms, path, &sensed);
            let moved = |c: usize| {
                let shifted: Vec<[f64; 2]> = sensed
                    .iter()
                    .map(|m| {
                        let mut m = *m;
                        m[c] += STEP_NMM;
                        m
                    })
                    .collect();
                (self.readout(terms, path, &shifted) - &here) / STEP_NMM
            };
            let slopes = [moved(0), moved(1)];
            let mut change: f64 = 0.0;
            for (i, m) in sensed.iter_mut().enumerate() {
                let shift = path.readings[i].shift_pm;
                let left = Vector2::new(shift[0] - here[(i, 0)], shift[1] - here[(i, 1)]);
                if left.norm() > misfit[i] {
                    steps[i] *= 0.5;
                } else {
                    from[i] = Vector2::from(*m);
                    misfit[i] = left.norm();
                    let slope = Matrix2::from_fn(|c, j| slopes[j][(i, c)]);
                    steps[i] = slope.try_inverse().unwrap_or(*inverse) * left;
                    let size = steps[i].norm();
                    if size > MAX_STEP_NMM {
                        steps[i] *= MAX_STEP_NMM / size;
                    }
                }
                *m = (from[i] + steps[i]).into();
                change = change.max(steps[i].norm());
            }
            if change < 1e-12 {
                break;
            }
        }
        sensed
    }
}

/// Whether nothing is sensed beyond noise.
pub(super) fn is_below_noise(sensed: &[f64; 2], sd: &[f64; 2]) -> bool {
    sensed[0].hypot(sensed[1]) < 3.0 * sd[0].hypot(sd[1])
}

/// Finds base moments whose memory gives the sensed ones, by fixed point over the whole history.
///
/// Where nothing is sensed beyond noise, a dead zone hides the moment: the reading keeps what it
/// shows.
pub(super) fn undo_memory(
    terms: &[ActiveEffect],
    path: &WhiskerPath,
    sensed: &[[f64; 2]],
    sds: &[[f64; 2]],
) -> Vec<[f64; 2]> {
    let mut base = sensed.to_vec();
    // A node without a reading is the arrival at the reading that follows it.
    let source: Vec<usize> = {
        let mut next = sensed.len().saturating_sub(1);
        let mut map: Vec<usize> = path
            .nodes
            .iter()
            .rev()
            .map(|n| {
                next = n.reading.unwrap_or(next);
                next
            })
            .collect();
        map.reverse();
        map
    };
    for _ in 0..40 {
        let mut at_nodes: Vec<[f64; 2]> = source.iter().map(|&i| base[i]).collect();
        for a in terms {
            a.sensor(path, &mut at_nodes);
        }
        let mut change: f64 = 0.0;
        for (node, m) in path.nodes.iter().zip(&at_nodes) {
            let Some(i) = node.reading else { continue };
            if is_below_noise(&sensed[i], &sds[i]) {
                continue;
            }
            for c in 0..2 {
                let step = sensed[i][c] - m[c];
                base[i][c] += step;
                change = change.max(step.abs());
            }
        }
        if change < 1e-10 {
            break;
        }
    }
    base
}
