//! Consistency of motion and moments: the innovations at the best state, and the mistake that explains them.
//!
//! ```text
//! chi2 = |S^-1/2 (y - m(theta))|^2 ~ chi-squared(2 n - 3)            n readings of two moments, three fitted numbers
//! inconsistent where P(chi-squared > chi2) < 1e-4 and chi2 > 1.5 (2 n - 3)
//! ```
//!
//! An inconsistent episode is fitted again with the motion under common mistakes (sign, unit); one that restores consistency is named.
//! Source of the test: Y. Bar-Shalom, X. R. Li, T. Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, 5.4.

use super::contact_path::ContactPath;
use super::{Episode, MomentField, Settings, recursive};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Innovations are too large below this p-value and above this ratio to the degrees of freedom.
const LEVEL: f64 = 1e-4;
const RATIO: f64 = 1.5;
/// A mistake is accepted where correcting it restores consistency and lowers chi-squared by this: a likelihood ratio of e^10.
const MIN_DROP: f64 = 20.0;
/// One reading in this many may be an outlier.
const MAX_GROSS: usize = 10;

/// Kind of disagreement between motion and moments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disagreement {
    /// The motion fits with its sign reversed.
    Reversed,
    /// The motion fits when read as metres.
    Metres,
    /// The motion fits when divided by a thousand.
    Thousandths,
    /// No such correction helps: the calibration, the clock or the kind of contact.
    Unexplained,
}

impl Disagreement {
    /// Code for a row's status.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Reversed => "motion-reversed",
            Self::Metres => "motion-in-metres",
            Self::Thousandths => "motion-too-large",
            Self::Unexplained => "motion-disagrees",
        }
    }

    /// For people.
    #[must_use]
    pub fn sentence(self) -> &'static str {
        match self {
            Self::Reversed => {
                "moments and motion agree only with the motion reversed: expected the displacement of the object with respect to the base"
            }
            Self::Metres => {
                "moments and motion agree only with the motion taken as metres: expected millimetres"
            }
            Self::Thousandths => {
                "moments and motion agree only with a thousandth of the motion: expected millimetres, perhaps found micrometres"
            }
            Self::Unexplained => {
                "moments and motion disagree: another calibration or wire, another clock, or a contact that is no fixed point"
            }
        }
    }
}

/// Innovations of an episode at its best state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovations {
    /// Chi-squared with every reading taken as regular.
    pub plain: f64,
    /// Chi-squared with the larger noise for the outliers.
    pub robust: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Outliers.
    pub outlier: usize,
    /// Readings.
    pub rows: usize,
}

impl Innovations {
    /// Of an episode that no state explains.
    #[must_use]
    pub fn unexplained(rows: usize) -> Self {
        Self { plain: f64::INFINITY, robust: f64::INFINITY, dof: 2.0 * rows as f64, outlier: 0, rows }
    }

    /// Whether the innovations are consistent, a few outliers allowed.
    pub(crate) fn consistent(&self) -> bool {
        !too_large(self.robust, self.dof) && self.outlier <= (self.rows / MAX_GROSS).max(1)
    }
}

/// The disagreement of an episode; none where its innovations are consistent.
pub(crate) fn disagreement(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    found: &Innovations,
) -> Option<Disagreement> {
    if found.consistent() {
        return None;
    }
    let mistakes =
        [(-1.0, Disagreement::Reversed), (1e3, Disagreement::Metres), (1e-3, Disagreement::Thousandths)];
    let explained = mistakes.into_iter().find(|(factor, _)| {
        best_chi2(field, &scaled(episode, *factor), settings)
            .is_some_and(|c| !too_large(c, found.dof) && c + MIN_DROP < found.plain)
    });
    Some(explained.map_or(Disagreement::Unexplained, |m| m.1))
}

/// Whether a chi-squared is too large for its degrees of freedom.
pub(super) fn too_large(chi2: f64, dof: f64) -> bool {
    let chance = ChiSquared::new(dof.max(1.0)).map_or(1.0, |c| c.sf(chi2));
    !chi2.is_finite() || chance < LEVEL && chi2 > RATIO * dof
}

/// The same episode with its motion multiplied.
#[must_use]
pub fn scaled(episode: &Episode, factor: f64) -> Episode {
    let mut episode = episode.clone();
    if factor < 0.0 {
        episode.push = episode.push.map(|p| -p);
    }
    for row in &mut episode.rows {
        row.moved_mm *= factor;
        row.velocity_mm_s *= factor;
    }
    episode
}

/// Chi-squared of an episode; none where no contact explains it, or more than a few readings are outliers.
fn best_chi2(field: &MomentField, episode: &Episode, settings: &Settings) -> Option<f64> {
    let path = ContactPath::new(field, episode)?;
    let found = recursive::run(field, path.push, &episode.rows, settings)?.innovations;
    (found.outlier <= (found.rows / MAX_GROSS).max(1)).then_some(found.plain)
}
