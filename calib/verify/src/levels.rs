//! The error budget. Every test that can change a verdict spends from one of two accounts; a
//! threshold in other units is computed from its level.
//!
//! ```text
//! sum of the shares of FALSE_ALARM = FALSE_ALARM,     sum of the shares of FALSE_DROP = FALSE_DROP          (Bonferroni)
//! ```
//!
//! The exam prints the rejections of clean sessions beside FALSE_ALARM: a search that is made again
//! under another noise looks again, and only the last look decides.

use statrs::distribution::{ChiSquared, ContinuousCDF, Normal};

/// Chance that a session in which nothing acts gets a name, is called unknown or loses its
/// calibration.
const FALSE_ALARM: f64 = 0.025;
/// Share of the catalogue: names an effect.
pub(crate) const CATALOGUE: f64 = 0.40 * FALSE_ALARM;
/// Share of the generic drivers: says that something remains.
pub(crate) const GENERIC: f64 = 0.08 * FALSE_ALARM;
/// Share of a smooth course that predicts what the accepted model leaves of readings left out.
pub(crate) const SMOOTH_RIVAL: f64 = 0.14 * FALSE_ALARM;
/// Share of the correlation of neighbours.
pub const SERIAL: f64 = 0.06 * FALSE_ALARM;
/// Share of the lack of fit against pure error, where readings repeat.
pub(crate) const REPLICATES: f64 = 0.08 * FALSE_ALARM;
/// Share of single open readings far outside the noise, over all numbers of them, see
/// `extreme_values`.
pub(crate) const SINGLE_READINGS: f64 = 0.07 * FALSE_ALARM;
/// Odds of Gaussian noise against each of eight heavier tails, before values are seen. A reading 8
/// standard deviations off among 60 is then flagged in four of five tables; of Student's noise with
/// 3 degrees of freedom one table of 60 in 22 loses a reading. No test does much better at both.
pub(crate) const GAUSSIAN_ODDS: f64 = 200.0;
/// Share of single sealed ones, which only set readings aside.
pub(crate) const SEALED_SINGLE_READINGS: f64 = 0.01 * FALSE_ALARM;
/// Share of the law of the spread, over all columns that it may follow: small, since weighing anew
/// moves every other number.
pub const SPREAD: f64 = 0.04 * FALSE_ALARM;
/// Share of further measurements of the instrument.
pub const WITNESSES: f64 = 0.08 * FALSE_ALARM;
/// Share of the sealed readings over all looks, see `Look::level`: the first has half of it. Far
/// below the rest, since a memory effect's curvature is only linearised there.
pub const HOLDOUT: f64 = 0.008 * FALSE_ALARM;
/// Share of an error far above the floor on open readings that are left out in turn.
pub(crate) const ABOVE_FLOOR: f64 = 0.016 * FALSE_ALARM;
/// Share of the same on sealed readings, over all looks.
pub(crate) const SEALED_ABOVE_FLOOR: f64 = 0.016 * FALSE_ALARM;

/// Chance that any verdict-changing test of the omnibus family rejects where nothing is there.
pub(crate) const OMNIBUS: f64 = CATALOGUE + GENERIC + SERIAL + REPLICATES;

/// Chance that a true name is withdrawn.
const FALSE_DROP: f64 = 0.08;
/// Share of the noise that would stand in its place.
pub(crate) const RETAIN: f64 = 2.0 * FALSE_DROP / 8.0;
/// Share of readings left out in turn that show no gain, of names just at CATALOGUE; see
/// LEFT_OUT_GAIN.
pub const LEFT_OUT: f64 = FALSE_DROP / 8.0;
/// Share of what remains without one level of the stimulus or one cycle.
pub(crate) const DELETION: f64 = FALSE_DROP / 8.0;
/// Share of what physics allows of a parameter.
pub(crate) const RANGE: f64 = FALSE_DROP / 8.0;
/// Share of a rival that seems better.
pub(crate) const RIVAL: f64 = FALSE_DROP / 8.0;
/// Share of a course without physics that seems to describe the readings better.
pub(crate) const COURSE: f64 = FALSE_DROP / 8.0;
/// Share of the paired test of the declared and the accepted model on sealed readings over all
/// looks, see `Look::level`.
pub(crate) const SEALED_RIVAL: f64 = FALSE_DROP / 8.0;

/// The same against correlated noise: its time constant comes from a few stretches of the very
/// readings, and a slow effect looks like it.
pub(crate) const RETAIN_BESIDE_CORRELATED: f64 = 1e-3;
/// What chance gives once in a thousand sessions: beyond it something is there, even where the name
/// that was found for it is withdrawn; a sensitivity is one, a plainer law is contradicted, rows
/// that agree are the same rows.
pub(crate) const NEGLIGIBLE: f64 = 1e-3;
/// Within the strata of a protocol that repeats.
pub(crate) const WITHIN_STRATA: f64 = 1e-4;
/// Between them, where a law stands against an arbitrary table of as many places.
pub(crate) const BETWEEN_STRATA: f64 = 0.01;
/// The usual level: a slope beyond it is there, however weak; an amplitude is not zero.
pub(crate) const USUAL: f64 = 0.05;
/// What a name has to gain on readings that are left out in turn, on one side. Each reading is in
/// the fits of the other folds: t of an effect by itself is about |t| - 1 / |t| there, so that one
/// in seventeen passes where nothing acts (`prediction_residual`).
pub(crate) const LEFT_OUT_GAIN: f64 = 0.1;
/// What a part of the noise has to gain by chance.
pub(crate) const NOISE_PART: f64 = 0.003;
/// What a remark needs, and neighbours that are left out in blocks: neither changes a name.
pub(crate) const REMARK: f64 = 0.01;

const _: () = {
    let alarms = CATALOGUE
        + GENERIC
        + SMOOTH_RIVAL
        + SERIAL
        + REPLICATES
        + SINGLE_READINGS
        + SEALED_SINGLE_READINGS
        + SPREAD
        + WITNESSES
        + HOLDOUT
        + ABOVE_FLOOR
        + SEALED_ABOVE_FLOOR;
    let drops = RETAIN + LEFT_OUT + DELETION + RANGE + RIVAL + COURSE + SEALED_RIVAL;
    assert!((alarms - FALSE_ALARM).abs() < 1e-12 && (drops - FALSE_DROP).abs() < 1e-12);
};

/// Two-sided 95 % of a Gaussian.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;
/// Akaike's price of a parameter in -2 log L.
pub(crate) const PRICE: f64 = 2.0;
/// Lead in the criterion from which one description replaces another: e^(-10/2), "essentially none"
/// (Burnham & Anderson 2002, 2.6).
pub const LEAD: f64 = 10.0;

/// One-sided normal quantile of a level.
pub fn z(level: f64) -> f64 {
    -Normal::standard().inverse_cdf(level)
}

/// What -2 log L must gain by `parameters` more at a level.
pub fn gain(level: f64, parameters: u8) -> f64 {
    ChiSquared::new(f64::from(parameters.max(1)))
        .map_or(f64::INFINITY, |d| d.inverse_cdf(1.0 - level))
}

/// The same by one parameter at the bound of its range (Self & Liang 1987): half the draws gain
/// nothing.
pub(crate) fn gain_at_bound(level: f64) -> f64 {
    gain(2.0 * level, 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_in_other_units_are_those_of_the_tables() {
        assert!((z(0.025) - NORMAL_95).abs() < 1e-9);
        assert!(
            (gain(0.05, 1) - 3.841_459).abs() < 1e-5 && (gain(0.05, 2) - 5.991_465).abs() < 1e-5
        );
        assert!((gain_at_bound(0.05) - 2.705_543).abs() < 1e-5);
    }
}
