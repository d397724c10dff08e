//! Whether motion and moments belong together: the innovations at the best state, and what would mend them.
//!
//! Under the likelihood the squared whitened residuals are chi-squared with two degrees of freedom a reading, less three. Where they are far
//! beyond it, the episode is fitted again with the motion as common mistakes would leave it; the one that mends it is named.

use super::contact_path::ContactPath;
use super::likelihood::Likelihood;
use super::posterior::{climb, modes};
use super::{Episode, MomentField, Settings};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Chance and ratio to the degrees of freedom from which on innovations are too large.
const LEVEL: f64 = 1e-4;
const RATIO: f64 = 1.5;
/// A mistake mends them where they are as they should be without it, and less by this: e^-10 as likelihood ratio.
const MENDS: f64 = 20.0;
/// One reading in so many may be gross.
const MAX_GROSS: usize = 10;

/// What speaks against motion and moments belonging together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disagreement {
    /// The motion fits once its sign is turned.
    Reversed,
    /// The motion fits once it is taken as metres.
    Metres,
    /// The motion fits once it is divided by a thousand.
    Thousandths,
    /// None of these mends it: the calibration, the clock or the kind of contact.
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
                "moments and motion agree only with the motion reversed: expected the way of the object with respect to the base"
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
    /// Squared, every reading taken as regular.
    pub plain: f64,
    /// Squared, with the noise of gross readings for those taken as such.
    pub robust: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Readings taken as gross.
    pub gross: usize,
    /// Readings.
    pub rows: usize,
}

impl Innovations {
    /// Of an episode that no state explains.
    #[must_use]
    pub fn unexplained(rows: usize) -> Self {
        Self { plain: f64::INFINITY, robust: f64::INFINITY, dof: 2.0 * rows as f64, gross: 0, rows }
    }

    /// Whether single gross readings explain what is too large.
    fn as_they_should_be(&self) -> bool {
        !too_large(self.robust, self.dof) && self.gross <= (self.rows / MAX_GROSS).max(1)
    }
}

/// What is wrong with an episode; none where its innovations are as they should be.
pub(crate) fn disagreement(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    found: &Innovations,
) -> Option<Disagreement> {
    if found.as_they_should_be() {
        return None;
    }
    let mistakes =
        [(-1.0, Disagreement::Reversed), (1e3, Disagreement::Metres), (1e-3, Disagreement::Thousandths)];
    let mended = mistakes.into_iter().find(|(factor, _)| {
        best_chi2(field, &scaled(episode, *factor), settings)
            .is_some_and(|c| !too_large(c, found.dof) && c + MENDS < found.plain)
    });
    Some(mended.map_or(Disagreement::Unexplained, |m| m.1))
}

fn too_large(chi2: f64, dof: f64) -> bool {
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

fn best_chi2(field: &MomentField, episode: &Episode, settings: &Settings) -> Option<f64> {
    let path = ContactPath::new(field, episode)?;
    let likelihood = Likelihood::new(&path, settings, None).ok()?;
    let mode = modes(&path, &likelihood, settings).into_iter().next()?;
    let mode = climb(&path, &likelihood, settings, &mode.state)?;
    Some(likelihood.innovation(&path, &mode.state).0)
}
