//! The catalogue of undeclared effects, each with its laws, and effects outside the catalogue.

use rand::{Rng, RngExt};
use serde_json::{Value, json};

use crate::bench::LENGTH_MM;
use crate::section::{MomentLaw, Taper};

/// One law of one effect. The name is `effect/law`; see [`Kind::name`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Kind {
    FrictionCoulomb,
    FrictionPresliding,
    FrictionStribeck,
    BacklashApproach,
    BacklashSymmetric,
    StageScale,
    PeriodicLead,
    PeriodicHarmonics,
    PeriodicDouble,
    LagPose,
    LagDelay,
    LagLowPass,
    OffsetGroove,
    ComplianceIsotropic,
    ComplianceTwoAxes,
    TemperatureLinear,
    DriftLinear,
    CreepProny1,
    CreepProny2,
    CreepLog,
    HysteresisBoucWen,
    HysteresisPlay,
    HysteresisVector,
    SofteningBilinear,
    SofteningPlateau,
    FbgThree,
    FbgFull,
    FbgChannel,
    DeadZoneRadial,
    DeadZoneComponent,
    TaperLinear,
    TaperCone,
    SlipOutliers,
    UnknownSineTime,
    UnknownStepTime,
    UnknownTrajectoryGain,
    UnknownExponentialTime,
    UnknownTemperatureGain,
    UnknownQuadraticDrift,
    UnknownDirectionSign,
    UnknownDepthKink,
    UnknownPermanentSet,
    UnknownRipple,
    UnknownTemperatureGradient,
}

use Kind::*;

/// Every law, catalogue first.
pub const ALL: [Kind; 44] = [
    FrictionCoulomb,
    FrictionPresliding,
    FrictionStribeck,
    BacklashApproach,
    BacklashSymmetric,
    StageScale,
    PeriodicLead,
    PeriodicHarmonics,
    PeriodicDouble,
    LagPose,
    LagDelay,
    LagLowPass,
    OffsetGroove,
    ComplianceIsotropic,
    ComplianceTwoAxes,
    TemperatureLinear,
    DriftLinear,
    CreepProny1,
    CreepProny2,
    CreepLog,
    HysteresisBoucWen,
    HysteresisPlay,
    HysteresisVector,
    SofteningBilinear,
    SofteningPlateau,
    FbgThree,
    FbgFull,
    FbgChannel,
    DeadZoneRadial,
    DeadZoneComponent,
    TaperLinear,
    TaperCone,
    SlipOutliers,
    UnknownSineTime,
    UnknownStepTime,
    UnknownTrajectoryGain,
    UnknownExponentialTime,
    UnknownTemperatureGain,
    UnknownQuadraticDrift,
    UnknownDirectionSign,
    UnknownDepthKink,
    UnknownPermanentSet,
    UnknownRipple,
    UnknownTemperatureGradient,
];

/// How an effect's size grows with its amplitude, and the amplitude's physical range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Range {
    /// Smallest amplitude.
    pub low: f64,
    /// Largest amplitude.
    pub high: f64,
}

impl Kind {
    /// Identifier of docs/src/formats.md (`unknown` outside it), and the law.
    pub fn name(self) -> (&'static str, &'static str) {
        match self {
            FrictionCoulomb => ("groove-friction", "coulomb"),
            FrictionPresliding => ("groove-friction", "presliding"),
            FrictionStribeck => ("groove-friction", "stribeck"),
            BacklashApproach => ("stage-backlash", "approach"),
            BacklashSymmetric => ("stage-backlash", "symmetric"),
            StageScale => ("stage-scale", "linear"),
            PeriodicLead => ("stage-periodic", "lead"),
            PeriodicHarmonics => ("stage-periodic", "harmonics"),
            PeriodicDouble => ("stage-periodic", "double-pitch"),
            LagPose => ("time-lag", "pose"),
            LagDelay => ("time-lag", "delay"),
            LagLowPass => ("time-lag", "low-pass"),
            OffsetGroove => ("contact-offset", "groove"),
            ComplianceIsotropic => ("base-compliance", "isotropic"),
            ComplianceTwoAxes => ("base-compliance", "two-axes"),
            TemperatureLinear => ("temperature-mismatch", "linear"),
            DriftLinear => ("zero-drift", "linear"),
            CreepProny1 => ("creep", "prony-1"),
            CreepProny2 => ("creep", "prony-2"),
            CreepLog => ("creep", "log-time"),
            HysteresisBoucWen => ("hysteresis", "bouc-wen"),
            HysteresisPlay => ("hysteresis", "play-stack"),
            HysteresisVector => ("hysteresis", "vector-play"),
            SofteningBilinear => ("superelastic-softening", "bilinear"),
            SofteningPlateau => ("superelastic-softening", "plateau"),
            FbgThree => ("fbg-nonlinearity", "three-coefficients"),
            FbgFull => ("fbg-nonlinearity", "full-quadratic"),
            FbgChannel => ("fbg-nonlinearity", "channel-square"),
            DeadZoneRadial => ("dead-zone", "radial"),
            DeadZoneComponent => ("dead-zone", "component"),
            TaperLinear => ("wire-taper", "linear"),
            TaperCone => ("wire-taper", "cone"),
            SlipOutliers => ("slip-outliers", "random"),
            UnknownSineTime => ("unknown", "sinusoid-time"),
            UnknownStepTime => ("unknown", "step-time"),
            UnknownTrajectoryGain => ("unknown", "trajectory-gain"),
            UnknownExponentialTime => ("unknown", "exponential-time"),
            UnknownTemperatureGain => ("unknown", "temperature-gain"),
            UnknownQuadraticDrift => ("unknown", "quadratic-drift"),
            UnknownDirectionSign => ("unknown", "direction-sign"),
            UnknownDepthKink => ("unknown", "depth-kink"),
            UnknownPermanentSet => ("unknown", "permanent-set"),
            UnknownRipple => ("unknown", "ripple"),
            UnknownTemperatureGradient => ("unknown", "temperature-gradient"),
        }
    }

    /// True outside the catalogue.
    pub fn is_unknown(self) -> bool {
        self.name().0 == "unknown"
    }

    /// Driver covariates (any of them is a right answer) and shape of an effect outside the
    /// catalogue.
    pub fn driver(self) -> Option<(&'static [&'static str], &'static str)> {
        Some(match self {
            UnknownSineTime => (&["t_s", "time", "order", "point"], "sinusoid"),
            UnknownStepTime => (&["t_s", "time", "order", "point"], "step"),
            UnknownTrajectoryGain => (&["trajectory"], "irregular"),
            UnknownExponentialTime => (&["t_s", "time", "order", "point"], "exponential"),
            UnknownTemperatureGain => (&["temperature_degc", "temperature"], "linear"),
            UnknownQuadraticDrift => (&["t_s", "time", "order", "point"], "quadratic"),
            UnknownDirectionSign => (&["direction"], "sign"),
            UnknownDepthKink => (&["stage_mm", "depth", "depth_mm", "stage"], "dead-zone"),
            UnknownPermanentSet => (&["largest_moment_nmm"], "dead-zone"),
            UnknownRipple => (&["fbg_1_pm", "fbg_2_pm"], "sinusoid"),
            UnknownTemperatureGradient => (&["temperature_rate_degc_s"], "linear"),
            _ => return None,
        })
    }

    /// Amplitude's range (docs/src/method.md's table; the unit is that of the amplitude in
    /// [`Effect::parameters`]).
    pub fn range(self) -> Range {
        let (low, high) = match self {
            FrictionCoulomb | FrictionPresliding => (0.05, 0.40),
            FrictionStribeck => (0.05, 0.36),
            BacklashApproach | BacklashSymmetric => (0.002, 0.1),
            StageScale => (1e-4, 2e-2),
            PeriodicLead | PeriodicHarmonics | PeriodicDouble => (0.002, 0.05),
            LagPose | LagDelay | LagLowPass => (0.005, 0.3),
            OffsetGroove => (0.1, 1.5),
            ComplianceIsotropic | ComplianceTwoAxes => (1e-3, 6e-2),
            TemperatureLinear => (0.1, 10.0),
            DriftLinear => (0.01, 2.0),
            CreepProny1 | CreepProny2 | CreepLog => (0.005, 0.06),
            HysteresisBoucWen | HysteresisPlay | HysteresisVector => (0.005, 0.05),
            // Onset of 70 - 45 a per metre.
            SofteningBilinear | SofteningPlateau => (0.0, 1.0),
            FbgThree | FbgFull | FbgChannel => (0.001, 0.04),
            DeadZoneRadial | DeadZoneComponent => (0.02, 0.8),
            TaperLinear | TaperCone => (0.02, 0.3),
            SlipOutliers => (0.02, 0.6),
            UnknownSineTime | UnknownStepTime | UnknownDirectionSign | UnknownDepthKink => {
                (0.05, 40.0)
            }
            UnknownExponentialTime | UnknownQuadraticDrift => (0.05, 80.0),
            UnknownPermanentSet => (1e-3, 0.5),
            UnknownRipple => (0.05, 40.0),
            UnknownTemperatureGradient => (0.05, 200.0),
            UnknownTrajectoryGain => (1e-4, 0.3),
            UnknownTemperatureGain => (1e-4, 0.2),
        };
        Range { low, high }
    }

    /// Whether rows with `design` can carry it at all (approach-only rows move no backlash).
    pub fn observable(self, rich: bool) -> bool {
        rich || !matches!(
            self,
            BacklashApproach
                | BacklashSymmetric
                | LagPose
                | LagDelay
                | LagLowPass
                | UnknownDirectionSign
                | StageScale
        )
    }
}

/// An effect with its numbers.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// Effect and law.
    pub kind: Kind,
    /// The number that sets the size.
    pub amplitude: f64,
    /// Further numbers, by law.
    pub shape: Vec<f64>,
}

/// A unit vector of `n` random components.
fn unit(rng: &mut impl Rng, n: usize) -> Vec<f64> {
    loop {
        let v: Vec<f64> = (0..n).map(|_| rng.random_range(-1.0..1.0_f64)).collect();
        let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (0.3..1.0).contains(&norm) {
            return v.iter().map(|x| x / norm).collect();
        }
    }
}

fn log_uniform(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    rng.random_range(low.ln()..high.ln()).exp()
}

impl Effect {
    /// Draws everything but the amplitude (which starts at the middle of its range). `end_s` is the
    /// session's end.
    pub fn draw(kind: Kind, end_s: f64, rng: &mut impl Rng) -> Self {
        let tau = std::f64::consts::TAU;
        let shape = match kind {
            FrictionPresliding => vec![rng.random_range(0.02..0.2)],
            FrictionStribeck => vec![rng.random_range(0.6..0.95)],
            // Screw lead of the LSM-A stage, 0.6096 mm (docs/src/method.md).
            PeriodicLead => vec![0.6096, rng.random_range(0.0..tau)],
            PeriodicHarmonics => {
                vec![
                    0.6096,
                    rng.random_range(0.0..tau),
                    rng.random_range(0.2..0.6),
                    rng.random_range(0.0..tau),
                ]
            }
            PeriodicDouble => vec![1.2192, rng.random_range(0.0..tau)],
            OffsetGroove => unit(rng, 3),
            ComplianceTwoAxes => vec![1.0, rng.random_range(0.2..0.8)],
            // Both gratings sit on one wire, so their mismatches are alike.
            TemperatureLinear => vec![1.0, rng.random_range(0.4..1.4)],
            DriftLinear => unit(rng, 2),
            CreepProny1 => vec![log_uniform(rng, 3.0, 400.0)],
            CreepProny2 => {
                vec![
                    log_uniform(rng, 2.0, 20.0),
                    log_uniform(rng, 40.0, 600.0),
                    rng.random_range(0.3..0.7),
                ]
            }
            HysteresisBoucWen => vec![rng.random_range(0.03..0.15), rng.random_range(0.3..0.8)],
            HysteresisPlay => vec![rng.random_range(0.05..0.1), rng.random_range(0.12..0.3)],
            HysteresisVector => vec![rng.random_range(0.08..0.2)],
            SofteningBilinear => vec![rng.random_range(0.4..0.8)],
            FbgThree => unit(rng, 3),
            FbgFull => unit(rng, 6),
            FbgChannel => unit(rng, 2),
            SlipOutliers => {
                // Share of the settled rows, then a private stream for which and how much.
                vec![
                    rng.random_range(0.01..0.03),
                    f64::from(rng.random_range(0..1_000_000_u32)),
                ]
            }
            UnknownSineTime => [
                unit(rng, 2),
                vec![rng.random_range(100.0..600.0), rng.random_range(0.0..tau)],
            ]
            .concat(),
            UnknownStepTime => [unit(rng, 2), vec![end_s * rng.random_range(0.25..0.75)]].concat(),
            UnknownTrajectoryGain => {
                let mut v: Vec<f64> = (0..15).map(|_| rng.random_range(-1.0..1.0)).collect();
                // A pattern without the sign balance of the turns, so that K cannot take it up.
                v.iter_mut()
                    .enumerate()
                    .for_each(|(i, v)| *v += if i % 2 == 0 { 0.7 } else { -0.7 });
                v
            }
            UnknownExponentialTime => {
                [unit(rng, 2), vec![end_s * rng.random_range(0.08..0.3)]].concat()
            }
            UnknownQuadraticDrift => {
                [unit(rng, 2), vec![end_s, rng.random_range(0.3..0.7)]].concat()
            }
            UnknownDirectionSign => unit(rng, 2),
            UnknownDepthKink => [unit(rng, 2), vec![rng.random_range(0.35..0.65)]].concat(),
            // Onset as a share of the largest moment.
            UnknownPermanentSet => vec![rng.random_range(0.3..0.6)],
            // Pitch, pm, and phase of each channel.
            UnknownRipple => {
                vec![
                    rng.random_range(60.0..200.0),
                    rng.random_range(0.0..tau),
                    rng.random_range(0.0..tau),
                ]
            }
            // Time constant by which the mount lags behind the wire, s.
            UnknownTemperatureGradient => {
                [unit(rng, 2), vec![rng.random_range(30.0..150.0)]].concat()
            }
            _ => Vec::new(),
        };
        let range = kind.range();
        Self {
            kind,
            amplitude: 0.5 * (range.low + range.high),
            shape,
        }
    }

    /// Onset of softening in 1/mm.
    fn onset_per_mm(&self) -> f64 {
        (70.0 - 45.0 * self.amplitude) / 1e3
    }

    /// Moment law of the wire, where this effect changes it.
    pub fn moment_law(&self) -> Option<MomentLaw> {
        let onset_per_mm = self.onset_per_mm();
        match self.kind {
            SofteningBilinear => Some(MomentLaw::Bilinear {
                onset_per_mm,
                ratio: self.shape[0],
            }),
            SofteningPlateau => Some(MomentLaw::Plateau { onset_per_mm }),
            _ => None,
        }
    }

    /// Stiffness along the wire, where this effect changes it.
    pub fn taper(&self) -> Option<Taper> {
        match self.kind {
            TaperLinear => Some(Taper::Linear(-self.amplitude)),
            TaperCone => Some(Taper::Cone(-self.amplitude)),
            _ => None,
        }
    }

    /// Parameters as truth.json writes them (practice's own form where practice has the effect).
    pub fn parameters(&self) -> Value {
        let a = self.amplitude;
        let s = &self.shape;
        let scaled = |s: &[f64]| s.iter().map(|v| v * a).collect::<Vec<_>>();
        match self.kind {
            FrictionCoulomb | BacklashApproach | StageScale | LagPose | ComplianceIsotropic => {
                json!(a)
            }
            FrictionPresliding => json!({"friction_coefficient": a, "presliding_mm": s[0]}),
            FrictionStribeck => json!({"friction_coefficient": a, "moving_share": s[0]}),
            BacklashSymmetric => json!({"width_mm": a}),
            PeriodicLead | PeriodicDouble => {
                json!({"amplitude_mm": a, "pitch_mm": s[0], "phase_rad": s[1]})
            }
            PeriodicHarmonics => {
                json!({"amplitude_mm": a, "pitch_mm": s[0], "phase_rad": s[1], "second_share": s[2], "second_phase_rad": s[3]})
            }
            LagDelay => json!({"delay_s": a}),
            LagLowPass => json!({"time_constant_s": a}),
            OffsetGroove | TemperatureLinear | DriftLinear | ComplianceTwoAxes => json!(scaled(s)),
            CreepProny1 => json!({"amplitude": a, "tau_s": s[0]}),
            CreepProny2 => json!({"amplitude": a, "tau_s": [s[0], s[1]], "first_share": s[2]}),
            CreepLog => json!({"amplitude": a}),
            HysteresisBoucWen => json!({"amplitude": a, "width_nmm": s[0], "beta": s[1]}),
            HysteresisPlay => json!({"amplitude": a, "radii_nmm": s}),
            HysteresisVector => json!({"amplitude": a, "radius_nmm": s[0]}),
            SofteningBilinear => {
                json!({"onset_per_m": 1e3 * self.onset_per_mm(), "tangent_ratio": s[0]})
            }
            SofteningPlateau => json!({"onset_per_m": 1e3 * self.onset_per_mm()}),
            // pm/(N mm)^2 at 80 pm/(N mm).
            FbgThree | FbgFull | FbgChannel => {
                json!(scaled(s).iter().map(|v| v * FBG_PM).collect::<Vec<_>>())
            }
            DeadZoneRadial | DeadZoneComponent => json!(a),
            TaperLinear | TaperCone => json!({"ei_change_at_tip": -a, "length_mm": LENGTH_MM}),
            SlipOutliers => json!({"share_of_rows": s[0], "size": a}),
            _ => json!({"amplitude": a, "shape": s}),
        }
    }
}

/// Full-scale sensitivity in pm that relative nonlinearities refer to.
pub const FBG_PM: f64 = 80.0;
