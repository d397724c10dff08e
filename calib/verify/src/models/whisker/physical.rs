//! The calibration that `verify` writes: wavelengths from moments with the accepted effects, and
//! its inverse (`stream`).
//!
//! Readout of a reading: `y = B' c(m, v)`, with
//! `c = [1, m1, m2, zeros of seatings, effect columns]`, coefficients `B` and the effects'
//! nonlinear values `v`.

use super::effects::whisker_catalogue;
use super::path::{Reading, ReadoutOrigin, WhiskerPath, typical_samples};
use super::rod_parameters::RodParameters;
use super::system::WhiskerSystem;
use super::whisker_effect::ActiveEffect;
use crate::MeasurementModel;
use crate::effect::LawRequirement;
use crate::method::{Hypothesis, Noise, covariance};
use crate::models::{root, rows};
use crate::scalar::ModelError;
use crate::scalar::model::{require, square, term_named};
use nalgebra::{DMatrix, Matrix2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::FbgSpec;
use wcal_core::stream::{MomentSpread, StreamMoments};
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

/// Moments of a reading through a calibration, and what their spread is made of.
pub type CalibratedReading = (StreamMoments, MomentSpread);

/// More samples than any reading averages, and a clock that is farther off than any stage's, s.
const MAX_SAMPLES: f64 = 1e9;
const MAX_STAGE_CLOCK_S: f64 = 10.0;
/// Share of the largest fitted moment that is still valid.
const VALID_SHARE: f64 = 1.1;

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
        // vec(B P) = (P' x I) vec(B): the covariance turns with the same matrix.
        let mut turn = DMatrix::identity(size + fit.tangents.len(), size + fit.tangents.len());
        turn.view_mut((0, 0), (size, size))
            .copy_from(&pm.transpose().kronecker(&DMatrix::identity(count, count)));
        let covariance = &turn * covariance(fit, fit.variance()) * turn.transpose();
        let largest = system.moments(&fit.terms).map_or(0.0, |(_, base)| {
            base.iter().map(|m| m[0].hypot(m[1])).fold(0.0, f64::max)
        });
        Self {
            coefficients: coefficients.row_iter().map(|r| [r[0], r[1]]).collect(),
            covariance: rows(&covariance),
            noise_sd_pm,
            correlated_noise: None,
            averaging: None,
            stage_clock_s: system.stage_clock_s,
            readout_origin: system.origin,
            effects,
            seatings: system.seatings,
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
            // Repeat and pose noise are independent: their variances add.
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

    /// Standard deviation of each reading's noise, pm.
    pub(super) fn noise_of(&self, readings: &[Reading]) -> Vec<f64> {
        // Noise of samples falls with their number; what they share does not.
        let variance = |r: &Reading| match (self.averaging, r.samples) {
            (Some(a), Some(n)) => (a.common + a.samples / f64::from(n.max(1))) / (a.common + 1.0),
            _ => 1.0,
        };
        let sd_pm = |r: &Reading| self.noise_sd_pm * variance(r).sqrt();
        readings.iter().map(sd_pm).collect()
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
        // The zero and the two moments stand before the columns of effects.
        let (mut columns, mut values) = (3, 0);
        for term in self.named_terms() {
            let ActiveEffect { effect, term } = term?;
            columns += effect.effect.law(term.law).linear.len();
            values += term.values.len();
        }
        // Each seating after the first has its own column: reject a mounting count inconsistent
        // with the coefficients.
        let count = self.coefficients.len();
        let seatings = (count + 1).checked_sub(columns).filter(|s| *s > 0);
        let least = format!("at least {columns} rows");
        require(seatings.is_some(), "coefficients", least, count)?;
        let expected = format!("{}, as the coefficients have it", seatings.unwrap_or(0));
        let stated = usize::try_from(self.seatings.max(1)).ok();
        require(seatings == stated, "seatings", expected, self.seatings)?;
        square(&self.covariance, 2 * count, 2 * count + values)?;
        let invertible = self.sensitivity().try_inverse().is_some();
        let expected = "a sensitivity that can be inverted";
        require(invertible, "coefficients", expected, "a singular one")?;
        let sd_pm = self.noise_sd_pm;
        require(!(sd_pm < 0.0), "noise_sd_pm", "0 or more", sd_pm)?;
        if let Some(a) = &self.averaging {
            let known = a.samples >= 1.0 && a.samples <= MAX_SAMPLES && a.common >= 0.0;
            let expected = "1 to 1e9 samples, a variance of 0 or more";
            let found = format!("{:?}", (a.samples, a.common));
            require(known, "averaging", expected, found)?;
        }
        let near = self.stage_clock_s.abs() <= MAX_STAGE_CLOCK_S;
        require(near, "stage_clock_s", "at most 10 s", self.stage_clock_s)?;
        if let Some(c) = &self.correlated_noise {
            let sound = c.sd_pm >= 0.0 && c.own_sd_pm > 0.0 && c.time_constant_s > 0.0;
            let expected = "positive deviations and a positive time";
            let found = format!(
                "{} and {} pm, {} s",
                c.sd_pm, c.own_sd_pm, c.time_constant_s
            );
            require(sound, "correlated_noise", expected, found)?;
        }
        Ok(())
    }

    /// The accepted effects with their values by name, those of this version's catalogue.
    pub(super) fn terms(&self) -> Vec<ActiveEffect> {
        self.named_terms().flatten().collect()
    }

    fn named_terms(&self) -> impl Iterator<Item = Result<ActiveEffect, ModelError>> {
        let catalogue = whisker_catalogue();
        self.effects.iter().map(move |a| -> Result<_, ModelError> {
            let effects = catalogue.iter().map(|e| &e.effect);
            let term = term_named(effects, &a.id, &a.law, &a.values)?;
            let effect = &catalogue[term.effect];
            Ok(ActiveEffect { effect, term })
        })
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

    /// Inside the region that the calibration was fitted in.
    pub(super) fn is_valid(&self, moment_nmm: [f64; 2]) -> bool {
        moment_nmm[0].hypot(moment_nmm[1]) <= VALID_SHARE * self.largest_moment_nmm
    }
}

/// Whether an effect changes the wire: rod or friction.
fn is_mechanical(effect: &ActiveEffect) -> bool {
    let mut mechanics = RodParameters::default();
    (effect.effect.rod)(&effect.values(), &mut mechanics);
    RodParameters {
        offset_mm: [0.0; 3],
        ..mechanics
    } != RodParameters::default()
}

/// F with cov(theta) = F F', and how many of its first columns change the wire.
pub(super) fn covariance_root(model: &PhysicalModel) -> (DMatrix<f64>, usize) {
    let size = model.covariance.len();
    // Values of the wire's effects first.
    let mut order: Vec<usize> = Vec::with_capacity(size);
    let mut slot = 2 * model.coefficients.len();
    for (effect, term) in model.effects.iter().zip(model.terms()) {
        let slots = slot..slot + effect.values.len();
        slot = slots.end;
        if is_mechanical(&term) {
            order.extend(slots);
        }
    }
    let mechanical = order.len();
    let others: Vec<usize> = (0..size).filter(|k| !order.contains(k)).collect();
    order.extend(others);
    // QR of F' makes F triangular: its first columns alone move the first values.
    let ordered = root(&model.covariance).select_rows(&order);
    let triangle = ordered.transpose().qr().r().transpose();
    let mut factor = DMatrix::zeros(size, size);
    for (i, &at) in order.iter().enumerate() {
        factor.set_row(at, &triangle.row(i));
    }
    (factor, mechanical)
}
