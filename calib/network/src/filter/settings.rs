//! Parameters of the Bayes filters below a network; `filter` and `filter::transition` have the
//! equations that they enter.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::ranges::Range;

/// Largest number of hypotheses for the coefficient of friction.
const MAX_FRICTIONS: usize = 3;

/// Parameters of one filter. A pair of numbers is a constant part and a part by the base's travel,
/// unless stated otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct BayesSettings {
    /// Moment above which there is a contact, N mm.
    pub onset_nmm: f64,
    /// Standard deviation of the moments' noise, N mm.
    pub noise_nmm: f64,
    /// Standard deviation of the rigid-body constraint: a constant part, mm, and a part of the
    /// base's travel.
    pub constraint_sd_mm: f64,
    /// See `constraint_sd_mm`.
    pub constraint_sd_share: f64,
    /// Coefficients of friction considered, in rising order (the last one repeated where there are
    /// fewer), and the standard deviation about each above 0.
    pub friction: [f64; MAX_FRICTIONS],
    /// See `friction`.
    pub friction_sd: f64,
    /// Standard deviation of the constraint by a turn of the force, as a part of the turn times the
    /// slip on the surface.
    pub turn_share: f64,
    /// Fraction of steps that violate the constraint (several contacts, contact along a line), and
    /// their standard deviation: a constant part, mm, and a part of the slip on the surface.
    pub outlier_fraction: f64,
    /// See `outlier_fraction`.
    pub outlier_sd_mm: f64,
    /// See `outlier_fraction`.
    pub outlier_sd_share: f64,
    /// Standard deviation of the path along the wire about the predicted one, mm and by the base's
    /// travel: at constant velocity, at a perturbed one, and where the velocity is redrawn, with
    /// the mean `reset_mean` by the base's travel.
    pub constant_velocity: [f64; 2],
    /// See `constant_velocity`.
    pub perturbed: [f64; 2],
    /// See `constant_velocity`.
    pub reset: [f64; 2],
    /// See `constant_velocity`.
    pub reset_mean: f64,
    /// Fractions of such steps.
    pub perturbed_fraction: f64,
    /// See `perturbed_fraction`.
    pub reset_fraction: f64,
    /// The same of the force's turn at the tip: rad, and rad/mm.
    pub tip_constant_velocity: [f64; 2],
    /// See `tip_constant_velocity`.
    pub tip_perturbed: [f64; 2],
    /// See `tip_constant_velocity`.
    pub tip_reset: [f64; 2],
    /// Probability that the force at the tip turns to any direction (an edge).
    pub tip_uniform_fraction: f64,
    /// Mean turn of the force about the wire over a step: rad, and rad/mm.
    pub turn: [f64; 2],
    /// The same where the object is sharp, and the fraction of such steps.
    pub sharp_turn: [f64; 2],
    /// See `sharp_turn`.
    pub sharp_fraction: f64,
    /// Where wires are touched first: mean and standard deviation of the arc length, as shares of
    /// the wire's length.
    pub first_contact_at: [f64; 2],
    /// Probability that the contact jumps, by the base's travel, 1/mm.
    pub jump_per_mm: f64,
    /// Mean path of a jump along the wire, toward the root and toward the tip, mm.
    pub jump_path_mm: [f64; 2],
    /// Mean distance of a jump against the force, where short and where long, mm; fraction of jumps
    /// along it.
    pub jump_off_mm: [f64; 2],
    /// See `jump_off_mm`.
    pub jump_back_fraction: f64,
    /// Mean turn of the force about the wire in a jump, rad.
    pub jump_turn_rad: f64,
    /// Fraction of jumps to anywhere on the wire.
    pub jump_anywhere_fraction: f64,
    /// Fraction of jumps to the tip: from the wire, and from the tip.
    pub jump_to_tip_fraction: f64,
    /// See `jump_to_tip_fraction`.
    pub jump_at_tip_fraction: f64,
    /// Speeds considered where the base's is not known, mm/s, and their number.
    pub speed_mm_s: [f64; 2],
    /// See `speed_mm_s`.
    pub speeds: usize,
    /// Share of a speed's weight that moves to each neighbour in one second.
    pub speed_change_per_s: f64,
}

/// Numbers that the settings may state: sizes, shares and probabilities as they are named above.
pub const FILTER_RANGES: &[Range] = &[
    Range::real("onset_nmm", 0.0, 1e3),
    Range::real("noise_nmm", 1e-9, 1e3),
    Range::real("constraint_sd_mm", 1e-9, 1e3),
    Range::real("constraint_sd_share", 0.0, 1e3),
    Range::real("friction", 0.0, 10.0),
    Range::real("friction_sd", 1e-9, 10.0),
    Range::real("turn_share", 0.0, 1e3),
    Range::real("outlier_fraction", 0.0, 1.0),
    Range::real("outlier_sd_mm", 1e-9, 1e3),
    Range::real("outlier_sd_share", 0.0, 1e3),
    Range::real("perturbed_fraction", 0.0, 1.0),
    Range::real("reset_fraction", 0.0, 1.0),
    Range::real("tip_uniform_fraction", 0.0, 1.0),
    Range::real("sharp_fraction", 0.0, 1.0),
    Range::real("jump_per_mm", 0.0, 1e3),
    Range::real("jump_back_fraction", 0.0, 1.0),
    Range::real("jump_anywhere_fraction", 0.0, 1.0),
    Range::real("jump_to_tip_fraction", 0.0, 1.0),
    Range::real("jump_at_tip_fraction", 0.0, 1.0),
    Range::real("speed_mm_s", 1e-6, 1e5),
    Range::whole("speeds", 1.0, 200.0),
    Range::real("speed_change_per_s", 0.0, 1e3),
    Range::real("constant_velocity", 0.0, 1e3),
    Range::real("perturbed", 0.0, 1e3),
    Range::real("reset", 0.0, 1e3),
    Range::real("reset_mean", 0.0, 1e3),
    Range::real("tip_constant_velocity", 0.0, 1e3),
    Range::real("tip_perturbed", 0.0, 1e3),
    Range::real("tip_reset", 0.0, 1e3),
    Range::real("turn", 0.0, 1e3),
    Range::real("sharp_turn", 0.0, 1e3),
    Range::real("first_contact_at", 1e-6, 10.0),
    Range::real("jump_path_mm", 1e-6, 1e3),
    Range::real("jump_off_mm", 1e-6, 1e3),
    Range::real("jump_turn_rad", 0.0, 1e3),
];

impl BayesSettings {
    /// For objects with friction: three coefficients as hypotheses, and larger uncertainties of
    /// constraint and moments, which friction along the wire disturbs. The default is a wire that
    /// slides without friction.
    pub fn multi_mu() -> Self {
        Self {
            noise_nmm: 0.0007,
            friction: [0.0, 0.15, 0.3],
            outlier_fraction: 0.7,
            outlier_sd_mm: 0.03,
            outlier_sd_share: 0.1,
            turn: [0.003, 0.03],
            ..Self::default()
        }
    }

    /// Coulomb friction, for a bank with a frictionless filter (`FilterBank`): objects without
    /// friction are left to that one.
    pub fn coulomb() -> Self {
        Self {
            friction: [0.1, 0.25, 0.25],
            ..Self::multi_mu()
        }
    }

    /// Coefficients considered, each once.
    pub(super) fn frictions(&self) -> &[f64] {
        let distinct = 1 + self
            .friction
            .windows(2)
            .filter(|pair| pair[0] < pair[1])
            .count();
        &self.friction[..distinct]
    }

    /// The same for moments with this white noise, and with a zero offset of this size, N mm.
    pub fn with_measurement_noise(self, noise_nmm: f64, zero_nmm: f64) -> Self {
        // Noise hardly ever passes five standard deviations; a zero that is off is no contact.
        Self {
            noise_nmm: self.noise_nmm.max(noise_nmm),
            onset_nmm: self.onset_nmm.max(5.0 * noise_nmm).max(2.0 * zero_nmm),
            ..self
        }
    }
}

impl Default for BayesSettings {
    fn default() -> Self {
        Self {
            onset_nmm: 0.0015,
            noise_nmm: 0.0001,
            constraint_sd_mm: 0.0015,
            constraint_sd_share: 0.008,
            friction: [0.0; MAX_FRICTIONS],
            friction_sd: 0.04,
            turn_share: 0.25,
            outlier_fraction: 0.05,
            outlier_sd_mm: 0.1,
            outlier_sd_share: 0.3,
            constant_velocity: [0.002, 0.02],
            perturbed: [0.02, 0.3],
            reset: [0.2, 0.8],
            reset_mean: 0.4,
            perturbed_fraction: 0.3,
            reset_fraction: 0.2,
            tip_constant_velocity: [0.0005, 0.004],
            tip_perturbed: [0.005, 0.1],
            tip_reset: [0.02, 0.5],
            tip_uniform_fraction: 0.01,
            turn: [0.001, 0.012],
            sharp_turn: [0.015, 0.2],
            sharp_fraction: 0.25,
            first_contact_at: [0.73, 0.15],
            jump_per_mm: 0.045,
            jump_path_mm: [1.5, 4.0],
            jump_off_mm: [0.4, 3.0],
            jump_back_fraction: 0.15,
            jump_turn_rad: 0.25,
            jump_anywhere_fraction: 0.041,
            jump_to_tip_fraction: 0.17,
            jump_at_tip_fraction: 0.95,
            speed_mm_s: [2.5, 7.5],
            speeds: 11,
            speed_change_per_s: 0.05,
        }
    }
}

/// The filters below a network, which weighs them against each other.
#[derive(Debug, Clone, Copy)]
pub struct FilterBank {
    /// For objects with friction; for all objects where it is the only one.
    pub frictional: BayesSettings,
    /// For objects without friction.
    pub frictionless: Option<BayesSettings>,
}

impl FilterBank {
    /// Both for moments with this white noise, and with a zero offset of this size, N mm.
    pub fn with_measurement_noise(self, noise_nmm: f64, zero_nmm: f64) -> Self {
        let informed = |s: BayesSettings| s.with_measurement_noise(noise_nmm, zero_nmm);
        Self {
            frictional: informed(self.frictional),
            frictionless: self.frictionless.map(informed),
        }
    }
}

impl From<BayesSettings> for FilterBank {
    fn from(frictional: BayesSettings) -> Self {
        Self {
            frictional,
            frictionless: None,
        }
    }
}
