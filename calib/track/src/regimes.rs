//! Ways in which a contact may move on what it touches, weighed by what each predicts of the same
//! readings.
//!
//! ```text
//! fixed       at one point of the object                                          (known_motion)
//! creeping    goes on from it across the push by a share q of the motion, q ~ N(0, c^2) in each direction, c of CREEP_SDS
//! sliding     over one rigid surface                                              (sliding)
//! misstated   any of these, but the motion has its sign reversed or the moments are too large or too small by a factor g
//! anywhere    the motion says nothing:  p(m) = 1 / (pi M^2),  M = 3 N mm          (arc)
//!
//! p(m_1 .. m_n | h) = prod_k p(m_k | m_1 .. m_(k-1), h)      over means of the readings over 0.7 mm of the motion, the same for all
//! w_h ~ pi_h p(m | h)^T                                      T < 1: readings share the errors of the wire's model
//! p(s, P | m) = sum_h w_h p(s, P | m, h)
//! ```
//!
//! What is misstated is so in all contacts c of a record: `p(g | m) ~ pi_g prod_c p(m_c | g)`. A
//! point that holds the wire shows g to a tenth or so, several together to less. One surface takes
//! up any g, and a creep nearly so: theirs is the same for all g.
//!
//! Sources: A. P. Dawid, J. R. Stat. Soc. A 147 (1984) 278 (prequential evidence); J. A. Hoeting,
//! D. Madigan, A. E. Raftery, C. T. Volinsky, Stat. Sci. 14 (1999) 382 (model averaging).

use crate::arc_posterior::ln_sum;
use crate::calibrated_wire::CalibratedWire;
use crate::known_motion::{LN_ANYTHING, MotionRow, RecursivePosterior, Settings};
use crate::reading::squares;
use crate::sliding::{model_nmm2, reversed};
use nalgebra::Vector3;
use wcal_core::stream::Flags;

/// Of an object of which nothing is known the touched point may go on by so much of the motion
/// (standard deviations, each as probable). An assumption.
pub(crate) const CREEP_SDS: [f64; 3] = [0.02, 0.1, 0.4];
/// T: the power of the evidence. An assumption.
const POWER: f64 = 0.8;
/// A regime of less weight is omitted from what is stated.
pub const MIN_WEIGHT: f64 = 1e-3;
/// A mistake is stated from this weight on: a 95 % region need not hold a rarer one, which is far
/// off and would be most of the covariance.
const MIN_MISTAKE: f64 = 0.05;
/// Factors by which moments may be misstated: this one's powers up to so many, on both sides of 1;
/// what lies between two is an unknown.
const FACTOR: f64 = 1.2;
const FACTORS: i32 = 5;
/// What is said once of a record with contacts.
pub(crate) const GAIN: &str = "gain: moments along a motion hardly show an error of the calibration's gain or of the clock, which are taken to be as certain as \
     they are stated; a known object or groove shows them";
/// ln p(m) of a way that is not looked at.
pub const OUT: f64 = f64::NEG_INFINITY;

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
    Misstated,
    /// See the module.
    Anywhere,
}

/// All of them, in the order of their weights.
pub(crate) const REGIMES: [Regime; 5] = [
    Regime::Fixed,
    Regime::Creeping,
    Regime::Sliding,
    Regime::Misstated,
    Regime::Anywhere,
];

impl Regime {
    /// Name.
    pub fn name(self) -> &'static str {
        ["fixed", "creeping", "sliding", "misstated", "anywhere"][self as usize]
    }
}

/// Prior probabilities where nothing is known of the object. An assumption.
pub const ANY_OBJECT: RegimeWeights = RegimeWeights([0.38, 0.32, 0.28, 0.015, 0.005]);
/// The same in a sweep over an object.
pub const SWEPT_OBJECT: RegimeWeights = RegimeWeights([0.1, 0.1, 0.78, 0.015, 0.005]);
/// The same in a groove.
pub(crate) const GROOVE: RegimeWeights = RegimeWeights([0.92, 0.0, 0.05, 0.02, 0.01]);
/// A wire with what is assumed of its contacts.
pub(crate) struct Assumed {
    /// Wire.
    pub wire: CalibratedWire,
    /// Of a fixed point.
    pub settings: Settings,
    /// Of how a contact may move.
    pub prior: RegimeWeights,
}

/// Probabilities of the regimes; they sum to 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegimeWeights([f64; 5]);

impl RegimeWeights {
    /// Probability of a regime.
    pub fn of(&self, regime: Regime) -> f64 {
        self.0[regime as usize]
    }

    /// Of a contact at or near one point of the object.
    pub(crate) fn at_a_point(&self) -> f64 {
        self.of(Regime::Fixed) + self.of(Regime::Creeping)
    }

    /// That the motion does not belong to the moments.
    fn no_motion(&self) -> f64 {
        self.of(Regime::Misstated) + self.of(Regime::Anywhere)
    }

    /// By the logarithms of the evidence, in the order of [`REGIMES`]. A way that could not be
    /// looked at keeps its probability: what its readings would have said is not known.
    pub fn after(&self, ln_evidence: &[Option<f64>; 5]) -> Self {
        // Bayes' rule with the evidence to a power (a power posterior: readings are not as
        // independent as they count).
        let ln = |k: usize| ln_evidence[k].map(|e| self.0[k].ln() + POWER * e);
        let best = (0..5).filter_map(ln).fold(OUT, f64::max);
        let all: [Option<f64>; 5] = std::array::from_fn(|k| Some((ln(k)? - best).exp()));
        let total = all.iter().flatten().sum::<f64>() / (1.0 - self.untried(ln_evidence));
        if !total.is_finite() {
            return *self;
        }
        Self(std::array::from_fn(|k| {
            all[k].map_or(self.0[k], |w| w / total)
        }))
    }

    /// Probability of the ways that could not be looked at.
    fn untried(&self, ln_evidence: &[Option<f64>; 5]) -> f64 {
        self.0
            .iter()
            .zip(ln_evidence)
            .filter(|(_, ln)| ln.is_none())
            .map(|(p, _)| p)
            .sum()
    }

    /// Where a surface explains all blocks, and better along the motion than along the reversed
    /// one: creeping is the first order of sliding over it, straight and steady; what its few
    /// numbers save in evidence says nothing of which it is. The surface, which has that course
    /// among others, takes its probability.
    fn of_one_surface(mut self) -> Self {
        self.0[Regime::Sliding as usize] += std::mem::take(&mut self.0[Regime::Creeping as usize]);
        self
    }

    /// The regime that is more probable than all others together.
    pub fn certain(&self) -> Option<Regime> {
        REGIMES.into_iter().find(|r| self.of(*r) > 0.5)
    }
}

/// What may be misstated of a record.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Misstatement {
    /// Whether the motion has the other sign.
    pub reversed: bool,
    /// Stated moments over true ones.
    pub factor: f64,
}

impl Misstatement {
    /// Nothing is.
    pub const NONE: Self = Self {
        reversed: false,
        factor: 1.0,
    };

    fn all(factors: i32) -> impl Iterator<Item = Self> {
        let of = |(reversed, factor)| Self { reversed, factor };
        let factors = (-factors..=factors).filter(|k| *k != 0);
        let scaled = factors.map(|k| (false, FACTOR.powi(k)));
        [(true, 1.0)].into_iter().chain(scaled).map(of)
    }

    /// Readings as they would have been stated rightly, with what is assumed of them.
    pub fn undone(&self, rows: &[MotionRow], settings: &Settings) -> (Vec<MotionRow>, Settings) {
        let mut rows = if self.reversed {
            reversed(rows)
        } else {
            rows.to_vec()
        };
        let (mut settings, square) = (*settings, self.factor * self.factor);
        if self.factor != 1.0 {
            // Moments, their common errors and their noise are misstated by one factor.
            for row in &mut rows {
                let moments = row.shared_nmm.iter_mut().chain([&mut row.moment_nmm]);
                moments.flatten().for_each(|m| *m /= self.factor);
                row.noise_nmm2 /= square;
                row.free_nmm2 = row.free_nmm2.map(|n| n / square);
                // The unknown of the stiffness is the rest of the factor.
                if settings.stiffness_sd == 0.0 {
                    row.shared_nmm.push([0.0; 2]);
                }
            }
            // Half the step between two factors, in logarithm: what lies between them is covered.
            settings.stiffness_sd = settings.stiffness_sd.hypot(0.5 * FACTOR.ln());
        }
        (rows, settings)
    }

    /// For people.
    pub fn sentence(&self) -> String {
        match self.reversed {
            true => "moments and motion disagree: with its sign reversed the motion explains them"
                .to_owned(),
            false => format!(
                "moments and motion disagree: moments {:.2} times as large explain them (another calibration or wire)",
                1.0 / self.factor
            ),
        }
    }
}

/// Weights of a contact's regimes, and of what they are made of.
#[derive(Debug, Clone, Copy)]
pub struct ContactWeights {
    /// Of the regimes.
    pub regimes: RegimeWeights,
    /// Shares of [`CREEP_SDS`] among those that creep.
    pub creeping: [f64; 3],
    /// Weight of the ways that could not be looked at.
    pub untried: f64,
    /// The likeliest misstatement, and with it the probabilities of a fixed point and of one that
    /// slides.
    pub misstatement: Option<(Misstatement, [f64; 2])>,
}

impl ContactWeights {
    /// Before any reading; ways that are not looked at yet have none.
    pub fn prior(prior: RegimeWeights) -> Self {
        let regimes = prior.after(&[0.0, 0.0, OUT, OUT, OUT].map(Some));
        Self {
            regimes,
            creeping: [1.0 / 3.0; 3],
            untried: 0.0,
            misstatement: None,
        }
    }

    /// Whether it slides rather than anything else.
    pub fn slides(&self) -> bool {
        self.certain() == Some(Regime::Sliding)
    }

    /// The regime that is more probable than all others together; none where a way that may be
    /// could not be looked at.
    pub fn certain(&self) -> Option<Regime> {
        self.regimes
            .certain()
            .filter(|_| self.untried <= MIN_MISTAKE)
    }

    /// Of one that slides, whatever is misstated.
    pub fn sliding(&self) -> f64 {
        let misstated = self.misstatement.map_or(0.0, |(_, [_, slides])| slides);
        self.regimes.of(Regime::Sliding) + self.regimes.of(Regime::Misstated) * misstated
    }

    /// What is misstated of one that slides, where that is more probable than all else.
    pub(crate) fn misstated_slide(&self) -> Option<Misstatement> {
        let (misstated, [_, slides]) = self.misstatement?;
        (self.regimes.of(Regime::Misstated) * slides > 0.5).then_some(misstated)
    }

    /// What stays in doubt: moments and motion that do not belong together, by the weights or by
    /// what a point leaves (`point_disagrees`), and a sliding contact that may be lost (not
    /// `sure`), or a way that could not be looked at.
    pub fn flags(&self, point_disagrees: bool, sure: bool) -> Flags {
        let undecided = if self.untried > MIN_MISTAKE {
            Flags::UNDECIDED
        } else {
            Flags::default()
        };
        undecided.with(match (self.regimes.no_motion() > 0.5, self.slides()) {
            (false, true) if sure => Flags::default(),
            (false, true) => Flags::SLIDING_ASSUMED,
            (false, false) if !point_disagrees => Flags::default(),
            _ => Flags::MOTION_DISAGREES,
        })
    }

    /// The ways of a contact at or near a point with their weights: how much it creeps, and what is
    /// misstated.
    pub fn points(&self) -> Vec<(f64, f64, Misstatement)> {
        let own = |regime| self.regimes.of(regime);
        let mut all = vec![(own(Regime::Fixed), 0.0, Misstatement::NONE)];
        let creeping = CREEP_SDS.into_iter().zip(self.creeping);
        all.extend(
            creeping.map(|(sd, share)| (own(Regime::Creeping) * share, sd, Misstatement::NONE)),
        );
        let mistaken = self
            .misstatement
            .map(|(m, [fixed, _])| (own(Regime::Misstated) * fixed, 0.0, m));
        all.extend(mistaken.filter(|(weight, ..)| *weight > MIN_MISTAKE));
        all
    }
}

/// A contact's blocks of readings.
pub(crate) struct Weighed<'a> {
    /// What is assumed.
    pub of: &'a Assumed,
    /// Direction of the push.
    pub push: Vector3<f64>,
    /// The last free reading before them, where there is one, and the blocks.
    pub before: Option<MotionRow>,
    pub blocks: Vec<MotionRow>,
    /// Whether factors of the moments are looked at, which takes more time than a stream has.
    pub factors: bool,
}

impl Weighed<'_> {
    /// ln p(m) of a point that creeps by a share with this standard deviation where something is
    /// misstated; none without blocks, and where the push runs along the wire.
    fn point(&self, creep_sd: f64, misstated: Misstatement) -> Option<f64> {
        let field = &self.of.wire.field;
        let all: Vec<MotionRow> = self.before.iter().chain(&self.blocks).cloned().collect();
        let (mut all, settings) = misstated.undone(&all, &self.of.settings);
        let settings = Settings {
            creep_sd,
            correlated: None,
            ..settings
        };
        // What the wire's model is off at a block is a draw for each block, as the sliding contact
        // has it.
        all.iter_mut()
            .for_each(|row| row.noise_nmm2 += model_nmm2(row));
        let (lead, blocks) = all.split_at(usize::from(self.before.is_some()));
        let (first, others) = blocks.split_first()?;
        let push = if misstated.reversed {
            -self.push
        } else {
            self.push
        };
        let mut posterior = RecursivePosterior::start(field, settings, push, lead, first)?;
        others.iter().for_each(|row| posterior.push(field, row));
        // Every regime predicts the free reading alike.
        let free = |row: &MotionRow| {
            let variance = 0.5 * (row.noise_nmm2.trace() + squares(&row.shared_nmm));
            -0.5 * squares(&[row.moment_nmm]) / variance - (std::f64::consts::TAU * variance).ln()
        };
        // A density per N mm of what was read.
        let by_factor = 2.0 * blocks.len() as f64 * misstated.factor.ln();
        Some(posterior.ln_evidence(field) - lead.iter().map(free).sum::<f64>() - by_factor)
    }

    /// What the blocks say, with ln p(m) of a surface along the motion and along the reversed one,
    /// where one could be made; `whole`: the surface explains all blocks.
    pub(crate) fn evidence(&self, sliding: Option<[f64; 2]>, whole: bool) -> ContactEvidence {
        let prior = self.of.prior;
        let point = |creep_sd: f64, m: Misstatement| self.point(creep_sd, m).unwrap_or(OUT);
        let creeping = if prior.of(Regime::Creeping) > 0.0 {
            CREEP_SDS.map(|sd| point(sd, Misstatement::NONE))
        } else {
            [OUT; 3]
        };
        let mut own = ContactEvidence {
            prior,
            fixed: self.point(0.0, Misstatement::NONE),
            creeping,
            sliding,
            anywhere: self.blocks.len() as f64 * LN_ANYTHING,
            whole,
            misstated: Vec::new(),
        };
        // A surface has no point; a stream looks at a mistake where a fixed point does not explain
        // the readings as they are.
        if self.factors || own.weights(&[]).regimes.of(Regime::Fixed) < 0.5 {
            let point = |m: Misstatement| if whole { OUT } else { point(0.0, m) };
            let all = Misstatement::all(if self.factors { FACTORS } else { 0 });
            own.misstated = all.map(|m| (m, point(m))).collect();
        }
        own
    }
}

/// Most that one contact says for or against what is misstated of a record, natural logarithm: its
/// ways leave out others.
const MAX_LN_EVIDENCE: f64 = 30.0;

/// ln p(m) of a contact's blocks by how it moves.
pub(crate) struct ContactEvidence {
    prior: RegimeWeights,
    /// None where it could not be looked at.
    fixed: Option<f64>,
    creeping: [f64; 3],
    sliding: Option<[f64; 2]>,
    anywhere: f64,
    whole: bool,
    /// Of a fixed point, by what is misstated.
    misstated: Vec<(Misstatement, f64)>,
}

impl ContactEvidence {
    /// ln p(m) as a fixed point, where it is this one, as one that creeps and as one that slides,
    /// each with its prior. Where a surface explains all blocks, a point is no other way: with
    /// moments by some factor it has the surface's curve, too.
    fn ways(&self, fixed: f64, reversed: bool) -> [f64; 3] {
        // Priors of the ways, given that the motion is the object's.
        let total = 1.0 - self.prior.no_motion();
        let fixed = if self.whole { OUT } else { fixed };
        let creeping = if reversed {
            OUT
        } else {
            ln_mean(&self.creeping)
        };
        let sliding = self.sliding.map_or(OUT, |s| s[usize::from(reversed)]);
        let prior = |way| (self.prior.of(way) / total).ln();
        [
            prior(Regime::Fixed) + fixed,
            prior(Regime::Creeping) + creeping,
            prior(Regime::Sliding) + sliding,
        ]
    }

    /// The same under each of what may be misstated.
    fn under(&self) -> impl Iterator<Item = (Misstatement, [f64; 3])> {
        self.misstated
            .iter()
            .map(|(m, fixed)| (*m, self.ways(*fixed, m.reversed)))
    }

    /// ln p(m) under each of what may be misstated, over that of the readings as they are.
    pub(crate) fn of_misstatements(&self) -> Vec<f64> {
        let stated = ln_sum(&self.ways(self.fixed.unwrap_or(OUT), false));
        let over = |ln: f64| {
            // Both may be minus infinity, whose difference is no number.
            if ln == stated {
                0.0
            } else {
                (ln - stated).clamp(-MAX_LN_EVIDENCE, MAX_LN_EVIDENCE)
            }
        };
        self.under().map(|(_, ways)| over(ln_sum(&ways))).collect()
    }

    /// Weights, with what the other contacts of the record say of what may be misstated.
    pub(crate) fn weights(&self, others: &[f64]) -> ContactWeights {
        let others = others.iter().copied().chain(std::iter::repeat(0.0));
        let all: Vec<(f64, Misstatement, [f64; 3])> = self
            .under()
            .zip(others)
            .map(|((m, ways), others)| (ln_sum(&ways) + others, m, ways))
            .collect();
        // What may be misstated is one way: its evidence is the mean over all of it.
        let misstated = ln_mean(&all.iter().map(|a| a.0).collect::<Vec<_>>());
        let ways = [
            self.fixed,
            self.fixed.map(|_| ln_mean(&self.creeping)),
            self.sliding.map(|s| s[0]),
            Some(misstated),
            Some(self.anywhere),
        ];
        let regimes = self.prior.after(&ways);
        let best = all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
        let shares_of = |ways: [f64; 3]| [ways[0], ways[2]].map(|ln| (ln - ln_sum(&ways)).exp());
        ContactWeights {
            regimes: if self.whole {
                regimes.of_one_surface()
            } else {
                regimes
            },
            creeping: shares(&self.creeping),
            untried: self.prior.untried(&ways),
            misstatement: best.map(|(_, m, ways)| (m, shares_of(ways))),
        }
    }
}

/// Probabilities by logarithms, each as probable before.
fn shares(ln: &[f64; 3]) -> [f64; 3] {
    // Bayes' rule with equal priors.
    let all = ln_sum(&ln.map(|l| POWER * l));
    ln.map(|l| {
        if all.is_finite() {
            (POWER * l - all).exp()
        } else {
            1.0 / 3.0
        }
    })
}

/// Logarithm of the mean of what has these logarithms; of nothing there is none.
fn ln_mean(ln: &[f64]) -> f64 {
    ln_sum(ln) - (ln.len().max(1) as f64).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evidence_moves_the_weights_and_no_evidence_leaves_them() {
        let after = |ln: [f64; 5]| ANY_OBJECT.after(&ln.map(Some));
        assert_eq!(after([0.0; 5]).certain(), None);
        let posterior = after([0.0, 0.0, 10.0, -5.0, 0.0]);
        assert_eq!(posterior.certain(), Some(Regime::Sliding));
        assert!(posterior.at_a_point() + posterior.no_motion() < 1e-2);
        assert_eq!(after([OUT; 5]), ANY_OBJECT);
        // A straight creep is the surface that it approximates; the surface alone stays what it is.
        let creeps = after([-20.0, 20.0, 0.0, -99.0, -99.0]);
        assert_eq!(creeps.certain(), Some(Regime::Creeping));
        assert_eq!(creeps.of_one_surface().certain(), Some(Regime::Sliding));
        assert!(posterior.of_one_surface().of(Regime::Sliding) >= posterior.of(Regime::Sliding));
        // A groove holds the wire at one point, whatever the evidence of creeping.
        assert_eq!(
            GROOVE
                .after(&[0.0, 100.0, 0.0, 0.0, 0.0].map(Some))
                .of(Regime::Creeping),
            0.0
        );
    }

    #[test]
    fn a_way_that_could_not_be_looked_at_keeps_its_prior() {
        let untried = [Some(30.0), Some(0.0), None, Some(0.0), Some(0.0)];
        let posterior = ANY_OBJECT.after(&untried);
        assert!(
            (posterior.of(Regime::Sliding) - 0.28).abs() < 1e-12
                && posterior.of(Regime::Fixed) > 0.7,
            "{posterior:?}"
        );
        let weights = |ln: &[Option<f64>; 5]| {
            let (regimes, untried) = (ANY_OBJECT.after(ln), ANY_OBJECT.untried(ln));
            ContactWeights {
                regimes,
                untried,
                ..ContactWeights::prior(ANY_OBJECT)
            }
        };
        assert_eq!(weights(&untried).certain(), None);
        assert!(weights(&untried).flags(false, false).has(Flags::UNDECIDED));
        // Control: one that was looked at and explains nothing has none.
        let tried = weights(&[Some(30.0), Some(0.0), Some(OUT), Some(0.0), Some(0.0)]);
        assert_eq!(
            (tried.regimes.of(Regime::Sliding), tried.certain()),
            (0.0, Some(Regime::Fixed))
        );
        assert!(tried.flags(false, false).none());
    }
}
