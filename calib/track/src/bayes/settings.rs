//! What the filters below a network assume.

use serde::{Deserialize, Serialize};

/// Coefficients of friction that the filter weighs against each other at most.
const FRICTIONS: usize = 3;

/// What the filter assumes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BayesSettings {
    /// Moment above which there is a contact, N mm.
    pub onset_nmm: f64,
    /// Standard deviation of the moments' noise, N mm.
    pub noise_nmm: f64,
    /// Spread of the rule: a constant part, mm, and a part of the base's step.
    pub rule_mm: f64,
    /// See `rule_mm`.
    pub rule_share: f64,
    /// Coefficients of friction considered, in rising order (the last one again where there are fewer), and the standard deviation of those
    /// that each above 0 stands for.
    pub friction: [f64; FRICTIONS],
    /// See `friction`.
    pub friction_sd: f64,
    /// Spread by a turn of the force, as a part of it times the way on the surface.
    pub edge: f64,
    /// Share of steps that break the rule otherwise (several contacts, contact along a line), and by how much: a constant part, mm, and a part
    /// of the way on the surface.
    pub wide: f64,
    /// See `wide`.
    pub wide_mm: f64,
    /// See `wide`.
    pub wide_share: f64,
    /// Standard deviation of the way along the wire about the one foretold: a constant part, mm, and a part of the base's step; where it goes
    /// on as before, where it does roughly, and where it is another one, of mean `changed_mean` by the base's way.
    pub steady: [f64; 2],
    /// See `steady`.
    pub unsteady: [f64; 2],
    /// See `steady`.
    pub changed: [f64; 2],
    /// See `steady`.
    pub changed_mean: f64,
    /// Shares of such steps.
    pub unsteady_share: f64,
    /// See `unsteady_share`.
    pub changed_share: f64,
    /// The same of the force's turn at the tip: rad, and rad/mm.
    pub tip_steady: [f64; 2],
    /// See `tip_steady`.
    pub tip_unsteady: [f64; 2],
    /// See `tip_steady`.
    pub tip_changed: [f64; 2],
    /// Probability that the force at the tip turns to anywhere (an edge).
    pub turn_any: f64,
    /// Mean turn of the force about the wire over a step: a constant part, rad, and one by the base's way, rad/mm.
    pub bend: [f64; 2],
    /// The same where the object is sharp, and the share of such steps.
    pub sharp: [f64; 2],
    /// See `sharp`.
    pub sharp_share: f64,
    /// Where wires are touched first: mean and standard deviation of the arc length, as shares of the wire's length.
    pub touch_at: [f64; 2],
    /// Probability that the contact springs, by the base's way, 1/mm.
    pub spring_per_mm: f64,
    /// Mean way of a spring along the wire, toward the root and toward the tip, mm.
    pub spring_mm: [f64; 2],
    /// Mean way of a spring against the force, where short and where long, mm; share of springs along it.
    pub spring_off_mm: [f64; 2],
    /// See `spring_off_mm`.
    pub spring_back: f64,
    /// Mean turn of the force about the wire, rad.
    pub spring_turn: f64,
    /// Share of springs to anywhere on the wire.
    pub spring_anywhere: f64,
    /// Share of springs to the tip: from the wire, and from the tip.
    pub spring_to_tip: f64,
    /// See `spring_to_tip`.
    pub spring_at_tip: f64,
    /// Speeds considered where the base's is not known, mm/s, and their number.
    pub speed_mm_s: [f64; 2],
    /// See `speed_mm_s`.
    pub speeds: usize,
    /// Share of the speed's weight that moves to each neighbour in one second.
    pub speed_change_per_s: f64,
}

impl BayesSettings {
    /// For objects with friction: three coefficients are weighed against each other, and rule and moments, which friction along the wire
    /// breaks, are taken for less exact. The default is a wire that slides freely.
    #[must_use]
    pub fn rough() -> Self {
        Self {
            noise_nmm: 0.0007,
            friction: [0.0, 0.15, 0.3],
            wide: 0.7,
            wide_mm: 0.03,
            wide_share: 0.1,
            bend: [0.003, 0.03],
            ..Self::default()
        }
    }

    /// The same beside one that slides freely (`Filters`): objects without friction are left to that one.
    #[must_use]
    pub fn dragged() -> Self {
        Self { friction: [0.1, 0.25, 0.25], ..Self::rough() }
    }

    /// Coefficients considered, each once.
    pub(super) fn frictions(&self) -> &[f64] {
        let distinct = 1 + self.friction.windows(2).filter(|pair| pair[0] < pair[1]).count();
        &self.friction[..distinct]
    }

    /// The same for moments with this white noise, and with a zero that is off by so much, N mm.
    #[must_use]
    pub fn told(self, noise_nmm: f64, zero_nmm: f64) -> Self {
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
            rule_mm: 0.0015,
            rule_share: 0.008,
            friction: [0.0; FRICTIONS],
            friction_sd: 0.04,
            edge: 0.25,
            wide: 0.05,
            wide_mm: 0.1,
            wide_share: 0.3,
            steady: [0.002, 0.02],
            unsteady: [0.02, 0.3],
            changed: [0.2, 0.8],
            changed_mean: 0.4,
            unsteady_share: 0.3,
            changed_share: 0.2,
            tip_steady: [0.0005, 0.004],
            tip_unsteady: [0.005, 0.1],
            tip_changed: [0.02, 0.5],
            turn_any: 0.01,
            bend: [0.001, 0.012],
            sharp: [0.015, 0.2],
            sharp_share: 0.25,
            touch_at: [0.73, 0.15],
            spring_per_mm: 0.045,
            spring_mm: [1.5, 4.0],
            spring_off_mm: [0.4, 3.0],
            spring_back: 0.15,
            spring_turn: 0.25,
            spring_anywhere: 0.041,
            spring_to_tip: 0.17,
            spring_at_tip: 0.95,
            speed_mm_s: [2.5, 7.5],
            speeds: 11,
            speed_change_per_s: 0.05,
        }
    }
}

/// The filters below a network, which weighs them against each other.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Filters {
    /// The one for all objects, or for those with friction.
    pub first: BayesSettings,
    /// One beside it, for objects without friction.
    pub beside: Option<BayesSettings>,
}

impl Filters {
    /// Both for moments with this white noise, and with a zero that is off by so much, N mm.
    #[must_use]
    pub fn told(self, noise_nmm: f64, zero_nmm: f64) -> Self {
        let told = |s: BayesSettings| s.told(noise_nmm, zero_nmm);
        Self { first: told(self.first), beside: self.beside.map(told) }
    }
}

impl From<BayesSettings> for Filters {
    fn from(first: BayesSettings) -> Self {
        Self { first, beside: None }
    }
}
