//! Ways in which a contact may move on what it touches, weighed by what each predicts of the same readings.
//!
//! ```text
//! fixed       at one point of the object                                          (known_motion)
//! creeping    goes on from it across the push by a share q of the motion, q ~ N(0, 0.03^2) or N(0, 0.15^2) in each direction
//! sliding     over one rigid surface                                              (sliding)
//! reversed    fixed or sliding along the motion with its sign reversed
//! anywhere    the motion says nothing:  p(m) = 1 / (pi M^2),  M = 3 N mm          (arc)
//!
//! p(m_1 .. m_n | h) = prod_k p(m_k | m_1 .. m_(k-1), h)      over means of the readings over 0.7 mm of the motion, the same for all
//! w_h ~ pi_h p(m | h)^T                                      T < 1: readings share the errors of the wire's model
//! p(s, P | m) = sum_h w_h p(s, P | m, h)
//! ```
//!
//! Sources: A. P. Dawid, J. R. Stat. Soc. A 147 (1984) 278 (prequential evidence); J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, Stat.
//! Sci. 14 (1999) 382 (model averaging).

use crate::arc_posterior::{ArcDensity, mixed_place};
use crate::known_motion::{EpisodeContact, MomentField, MotionRow, RecursivePosterior, Settings};
use crate::sliding::{LN_ANYTHING, model_nmm2};
use nalgebra::Vector3;

/// Of an object of which nothing is known the touched point may go on by so much of the motion (standard deviations, each as probable). An
/// assumption.
pub const CREEP_SDS: [f64; 2] = [0.03, 0.15];
/// T: the power of the evidence. An assumption; `tests/contact_regimes.rs` passes with 0.6 and with 1.0 in its place, too.
const POWER: f64 = 0.8;
/// A regime of less weight is left out of what is stated.
pub const MIN_WEIGHT: f64 = 1e-3;

/// A way in which a contact may move.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Regime {
    /// See the module.
    Fixed,
    /// See the module.
    Creeping,
    /// See the module.
    Sliding,
    /// See the module.
    Reversed,
    /// See the module.
    Anywhere,
}

/// All of them, in the order of their weights.
pub const REGIMES: [Regime; 5] =
    [Regime::Fixed, Regime::Creeping, Regime::Sliding, Regime::Reversed, Regime::Anywhere];

impl Regime {
    /// Name.
    pub fn name(self) -> &'static str {
        ["fixed", "creeping", "sliding", "reversed", "anywhere"][self as usize]
    }
}

/// Prior probabilities where nothing is known of the object. An assumption.
pub const ANY_OBJECT: RegimeWeights = RegimeWeights([0.38, 0.32, 0.28, 0.015, 0.005]);
/// The same in a sweep over an object.
pub const SWEPT_OBJECT: RegimeWeights = RegimeWeights([0.1, 0.1, 0.78, 0.015, 0.005]);
/// The same in a groove.
pub const GROOVE: RegimeWeights = RegimeWeights([0.92, 0.0, 0.05, 0.02, 0.01]);

/// Probabilities of the regimes; they sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegimeWeights([f64; 5]);

impl RegimeWeights {
    /// Probability of a regime.
    pub fn of(&self, regime: Regime) -> f64 {
        self.0[regime as usize]
    }

    /// Of a contact at or near one point of the object.
    pub fn at_a_point(&self) -> f64 {
        self.of(Regime::Fixed) + self.of(Regime::Creeping)
    }

    /// That the motion does not belong to the moments.
    pub fn no_motion(&self) -> f64 {
        self.of(Regime::Reversed) + self.of(Regime::Anywhere)
    }

    /// By the logarithms of the evidence, in the order of [`REGIMES`].
    pub fn after(&self, ln_evidence: &[f64; 5]) -> Self {
        let ln = |k: usize| self.0[k].ln() + POWER * ln_evidence[k];
        let best = (0..5).map(ln).fold(f64::NEG_INFINITY, f64::max);
        let all: [f64; 5] = std::array::from_fn(|k| (ln(k) - best).exp());
        let total: f64 = all.iter().sum();
        if total.is_finite() { Self(all.map(|w| w / total)) } else { *self }
    }

    /// Where a surface explains all blocks: creeping is the first order of sliding over it, straight and steady, and what its few numbers save
    /// in evidence says nothing of which it is. Both have half of their sum.
    pub fn moving_alike(mut self) -> Self {
        let [creeping, sliding] = [Regime::Creeping, Regime::Sliding].map(|r| r as usize);
        let half = 0.5 * (self.0[creeping] + self.0[sliding]);
        if self.0[creeping] > half {
            (self.0[creeping], self.0[sliding]) = (half, half);
        }
        self
    }

    /// The regime that is more probable than all others together.
    pub fn certain(&self) -> Option<Regime> {
        REGIMES.into_iter().find(|r| self.of(*r) > 0.5)
    }
}

/// ln p(m) of a contact at or near one point, over blocks of readings; `before` is the last free reading.
pub fn point_evidence(
    field: &MomentField,
    settings: &Settings,
    push: Vector3<f64>,
    before: Option<&MotionRow>,
    blocks: &[MotionRow],
) -> f64 {
    let noisy = |row: &MotionRow| MotionRow { noise_nmm2: row.noise_nmm2 + model_nmm2(row), ..row.clone() };
    let settings = Settings { correlated: None, ..*settings };
    let lead: Vec<MotionRow> = before.map(noisy).into_iter().collect();
    let Some((first, others)) = blocks.split_first() else { return f64::NEG_INFINITY };
    let started = RecursivePosterior::start(field, settings, push, &lead, &noisy(first));
    let Some(mut posterior) = started else { return f64::NEG_INFINITY };
    others.iter().for_each(|row| posterior.push(field, &noisy(row)));
    // Every regime predicts the free reading alike.
    let free = |row: &MotionRow| {
        let column = |h: &[f64; 2]| Vector3::new(h[0], h[1], 0.0).norm_squared();
        let variance = 0.5 * (row.noise_nmm2.trace() + row.shared_nmm.iter().map(column).sum::<f64>());
        let size2 = row.moment_nmm[0].powi(2) + row.moment_nmm[1].powi(2);
        -0.5 * size2 / variance - (std::f64::consts::TAU * variance).ln()
    };
    posterior.ln_evidence(field) - lead.iter().map(free).sum::<f64>()
}

/// The same of one that creeps, and how much it does so most probably; [`point_evidence`] is its logarithm for a standard deviation.
pub fn creeping_evidence(of: impl Fn(f64) -> f64) -> (f64, f64) {
    let [(a, small), (b, large)] = CREEP_SDS.map(|sd| (of(sd), sd));
    let (most, least, sd) = if a > b { (a, b, small) } else { (b, a, large) };
    (if most.is_finite() { most + (0.5 * (1.0 + (least - most).exp())).ln() } else { most }, sd)
}

/// ln p(m) of blocks of which nothing is predicted.
pub fn anywhere_evidence(blocks: &[MotionRow]) -> f64 {
    blocks.len() as f64 * LN_ANYTHING
}

/// What a regime states of a reading, with its weight.
pub struct Alternative {
    /// Weight.
    pub weight: f64,
    /// Place.
    pub place: EpisodeContact,
    /// Density along the wire.
    pub arc: ArcDensity,
}

/// What all of them state together; none where no alternative has a place.
pub fn averaged(all: &[Alternative]) -> Option<(EpisodeContact, ArcDensity)> {
    let located = || all.iter().filter_map(|a| Some((a, a.place.place_mm?)));
    let parts = located().map(|(a, at)| (a.weight, at, a.place.covariance_mm2));
    let (mean, covariance_mm2) = mixed_place(parts)?;
    let total: f64 = located().map(|(a, _)| a.weight).sum();
    let contact = located().map(|(a, _)| a.weight * a.place.contact).sum::<f64>() / total;
    let outlier = all.iter().any(|a| a.place.outlier);
    let arc = ArcDensity::mixture(located().map(|(a, _)| (a.weight, &a.arc)));
    Some((EpisodeContact { place_mm: Some(mean), covariance_mm2, contact, outlier }, arc))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_moves_the_weights_and_no_evidence_leaves_them() {
        assert_eq!(ANY_OBJECT.after(&[0.0; 5]).certain(), None);
        let told = ANY_OBJECT.after(&[0.0, 0.0, 10.0, -5.0, 0.0]);
        assert_eq!(told.certain(), Some(Regime::Sliding));
        assert!(told.at_a_point() + told.no_motion() < 1e-2);
        assert_eq!(ANY_OBJECT.after(&[f64::NEG_INFINITY; 5]), ANY_OBJECT);
        // A straight creep and the surface that it approximates; the surface alone stays what it is.
        let creeps = ANY_OBJECT.after(&[-20.0, 20.0, 0.0, -99.0, -99.0]);
        assert_eq!((creeps.certain(), creeps.moving_alike().certain()), (Some(Regime::Creeping), None));
        assert_eq!(told.moving_alike(), told);
        // A groove holds the wire at one point, whatever the evidence of creeping.
        assert_eq!(GROOVE.after(&[0.0, 100.0, 0.0, 0.0, 0.0]).of(Regime::Creeping), 0.0);
    }
}
