//! The whisker session as a system: pose -> rod -> moment -> memory -> wavelength, with effects at
//! every stage.

use super::effects::whisker_catalogue;
use super::path::{Node, ReadoutOrigin, WhiskerPath, averaged_readings, temperature_walk};
use super::pictures::Pictures;
use super::rod_parameters::RodParameters;
use super::rod_tables::RodTables;
use super::stage_motion::velocity;
use super::temperature::RandomWalkModel;
use super::whisker_effect::{ActiveEffect, Observers};
use crate::effect::{Effect, EffectTerm, LawRequirement};
use crate::measurement_model::finite;
use crate::method::Fit;
use nalgebra::{DMatrix, Matrix2, Vector2};
use std::sync::Arc;
use wcal_core::observation::{RestShape, WhiskerData, WhiskerRow};

/// Two moment components a reading, N mm.
pub type Moments = Vec<[f64; 2]>;

/// Largest share of the gratings' noise that they can share.
const MAX_SHARED: f64 = 0.95;

/// A whisker session, its declared model and the catalogue.
#[derive(Clone)]
pub struct WhiskerSystem {
    /// The session.
    pub data: WhiskerData,
    /// The readings on their path.
    pub path: WhiskerPath,
    /// The rod's tables.
    pub rod_tables: Arc<RodTables>,
    pub(super) catalogue: Arc<[Effect]>,
    pub(super) measured: DMatrix<f64>,
    pub(super) groups: Vec<u32>,
    rows: Arc<Vec<WhiskerRow>>,
    /// Readings whose rows were sealed.
    pub sealed: Vec<bool>,
    /// Those of them that count in the held-out error.
    pub(super) scored: Vec<bool>,
    pub(super) seatings: u32,
    pub(super) origin: ReadoutOrigin,
    walk: Option<RandomWalkModel>,
    pub(super) whitening: Matrix2<f64>,
    pub(super) pictures: Option<Arc<Pictures>>,
    pub(super) picture_scale: f64,
    /// By how much the stage's clock is set, s.
    pub(super) stage_clock_s: f64,
    pub(super) refuted: Arc<[String]>,
}

/// The readings in the channels of a mixture, which is never singular: a unit matrix with one
/// direction stretched.
fn measured_in(path: &WhiskerPath, whitening: &Matrix2<f64>) -> DMatrix<f64> {
    let shifts = DMatrix::from_fn(path.readings.len(), 2, |i, c| path.readings[i].shift_pm[c]);
    shifts * dynamic(&whitening.try_inverse().unwrap_or_else(Matrix2::identity))
}

pub(super) fn dynamic(m: &Matrix2<f64>) -> DMatrix<f64> {
    DMatrix::from_column_slice(2, 2, m.as_slice())
}

/// Effective stage positions of a path's nodes, mm, and the rod, without what only `unseen` see;
/// the stage's clock set by `stage_clock_s`.
pub(super) fn effective_poses(
    path: &WhiskerPath,
    active: &[ActiveEffect],
    unseen: Observers,
    stage_clock_s: f64,
) -> (Vec<f64>, RodParameters) {
    // An answer is stamped when it arrives: at its stamp the groove is v delta further on.
    let stamped = |n: &Node| n.x_mm + velocity(path, n) * stage_clock_s;
    let mut xs: Vec<f64> = path.nodes.iter().map(stamped).collect();
    let mut rod_parameters = RodParameters::default();
    // In the order of the catalogue, which is that of the signal: the reading lags behind a groove
    // that lags behind the screw.
    let mut acting: Vec<&ActiveEffect> = active
        .iter()
        .filter(|a| a.effect.observers != unseen)
        .collect();
    acting.sort_by_key(|a| a.term.effect);
    for a in acting {
        (a.effect.pose)(&a.values(), path, &mut xs);
        (a.effect.rod)(&a.values(), &mut rod_parameters);
    }
    (xs, rod_parameters)
}

impl WhiskerSystem {
    /// System of a session, the rows that were unsealed behind those of its table.
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn new(data: &WhiskerData, unsealed: &[WhiskerRow]) -> Result<Self, wcal_rod::RodError> {
        // The sealed rows have no part in it, not even by their temperature.
        let walk = temperature_walk(&data.rows, &data.fbg);
        let system = Self::assemble(data, unsealed, walk, None)?;
        let pictures = Pictures::new(&system.rows, &system.path, data.shapes.as_ref());
        Ok(Self {
            pictures: pictures.map(Arc::new),
            ..system
        })
    }

    /// The same rod with further rows, none deeper than those that it was made for, and without
    /// pictures.
    pub(super) fn with_rows(&self, further: &[WhiskerRow]) -> Option<Self> {
        let rod_tables = Some(self.rod_tables.clone());
        let system = Self::assemble(&self.data, further, self.walk, rod_tables).ok()?;
        Some(
            system
                .with_whitening_of(self)
                .without_effects(&self.refuted),
        )
    }

    /// The same system without effects that another measurement of the instrument refutes, by
    /// identifier.
    pub(crate) fn without_effects(self, refuted: &[String]) -> Self {
        Self {
            refuted: refuted.into(),
            ..self
        }
    }

    fn assemble(
        data: &WhiskerData,
        further: &[WhiskerRow],
        walk: Option<RandomWalkModel>,
        rod_tables: Option<Arc<RodTables>>,
    ) -> Result<Self, wcal_rod::RodError> {
        let rows = [&data.rows[..], further].concat();
        let path = WhiskerPath::new(&rows, &data.trajectories, &data.fbg, walk.as_ref());
        let rod_tables = match rod_tables {
            Some(known) => known,
            None => Arc::new(RodTables::new(data, &path)?),
        };
        let whitening = Matrix2::identity();
        let effects = whisker_catalogue().iter().map(|e| e.effect.clone());
        let (sealed, readings) = (|row: &usize| *row >= data.rows.len(), &path.readings);
        Ok(Self {
            pictures: None,
            picture_scale: 1.0,
            stage_clock_s: 0.0,
            refuted: Arc::default(),
            measured: measured_in(&path, &whitening),
            whitening,
            groups: readings.iter().map(|r| r.group).collect(),
            // Unsealed rows stand behind those of the points table.
            sealed: path.rows.iter().map(sealed).collect(),
            // Where the groove stood on a ramp is not known well enough to be scored.
            scored: readings.iter().map(|r| r.holdout && !r.unsteady).collect(),
            rows: Arc::new(rows),
            seatings: data.rows.iter().map(|r| r.seating + 1).max().unwrap_or(1),
            origin: ReadoutOrigin::of(data),
            data: data.clone(),
            walk,
            path,
            rod_tables,
            catalogue: effects.collect(),
        })
    }

    /// The effects of `terms` with their values by name.
    pub(super) fn active(&self, terms: &[EffectTerm]) -> Vec<ActiveEffect> {
        let catalogue = whisker_catalogue();
        terms
            .iter()
            .map(|t| ActiveEffect {
                effect: &catalogue[t.effect],
                term: t.clone(),
            })
            .collect()
    }

    /// Why the session does not give what a law needs; none where it does.
    pub(super) fn missing_requirement(&self, need: LawRequirement) -> Option<&'static str> {
        use LawRequirement::*;
        let has = &self.path.columns;
        let moving = |i: usize| self.path.readings[i].velocity_mm_s != 0.0;
        let (met, why) = match need {
            Time | Clock => (has.time, "the session has no time stamps"),
            Temperature => (has.temperature, "the session has no temperature"),
            Motion => (has.speeds, "no reading was taken while the stage moved"),
            StagePosition => (has.stage, "the session has no positions of the stage"),
            Weight if self.data.whisker.gravity_direction.is_none() => {
                (false, "the session does not give the direction of gravity")
            }
            Weight => (
                self.data.whisker.density_kg_m3.is_some(),
                "the session does not give the density of the wire",
            ),
            BothDirections => (
                has.both_directions,
                "the session has no readings of both directions",
            ),
            Pictures => (
                self.pictures.is_some(),
                "the session has no pictures (shapes.json) that can be used",
            ),
            StraightArc => (
                matches!(self.data.whisker.rest_shape, RestShape::StraightArc { .. }),
                "the session declares the wire's points, not a straight part and an arc",
            ),
            MovingPictures => (
                self.pictures
                    .iter()
                    .any(|p| p.each().any(|(i, ..)| moving(i))),
                "no pair of pictures was taken while the stage moved",
            ),
            RestReadings => (
                self.path.readings.iter().any(|r| r.rest),
                "no reading was taken at rest",
            ),
            Order | Slope | Covariate => return None,
        };
        (!met).then_some(why)
    }

    /// Effective moments at the readings, N mm, memory included, and the base moments before it.
    pub fn moments(&self, terms: &[EffectTerm]) -> Option<(Moments, Moments)> {
        let path = &self.path;
        let active = self.active(terms);
        terms
            .iter()
            .try_for_each(|t| finite(&t.values).map(|_| ()))?;
        // An offset of the cameras' clock moves no groove.
        let (xs, rod_parameters) =
            effective_poses(path, &active, Observers::Cameras, self.stage_clock_s);
        let base = self
            .rod_tables
            .moments(&path.nodes, &finite(xs)?, &rod_parameters)?;
        let mut sensed = base.clone();
        // Memory runs over all nodes: what happened between the readings is remembered, too.
        for a in &active {
            finite(sensed.as_flattened())?;
            a.sensor(path, &mut sensed);
        }
        let pick = |all: Moments| {
            let nodes = path.nodes.iter().zip(all);
            nodes.filter_map(|(n, m)| n.reading.map(|_| m)).collect()
        };
        Some((pick(sensed), pick(base)))
    }

    /// What memory takes from the moment of each reading, base less sensed, and the base moments, N mm.
    pub(super) fn memory(&self, terms: &[EffectTerm]) -> Option<(Moments, Moments)> {
        let (sensed, base) = self.moments(terms)?;
        let taken = |(b, f): (&[f64; 2], [f64; 2])| [b[0] - f[0], b[1] - f[1]];
        Some((base.iter().zip(sensed).map(taken).collect(), base))
    }

    /// The same readings in channels whose noise is uncorrelated and of one variance, as far as
    /// `fit` shows it.
    ///
    /// Both gratings are compensated with one reference reading, so its noise, `k_T` times the
    /// temperature's, is in both: their covariance is `s^2 I + k_T k_T' s_T^2`. Across `k_T`
    /// nothing is shared, which gives `s`; the temperature's walk gives `s_T`. K, zero and every
    /// column have coefficients of their own in each channel, so a mixture of channels is the same
    /// model.
    pub fn whitened(self, fit: &Fit) -> Self {
        let whitening = self.shared_noise(fit).unwrap_or_else(Matrix2::identity);
        self.in_channels(whitening)
    }

    /// The same readings in other channels.
    fn in_channels(self, whitening: Matrix2<f64>) -> Self {
        Self {
            measured: measured_in(&self.path, &whitening),
            whitening,
            ..self
        }
    }

    /// The same readings with the stage's clock set by `stage_clock_s`.
    pub(super) fn with_stage_clock(mut self, stage_clock_s: f64) -> Self {
        self.stage_clock_s = stage_clock_s;
        self
    }

    /// Readings were recorded while the stage moved, each the average of a short window.
    pub(super) fn is_read_in_motion(&self) -> bool {
        self.path.columns.speeds && averaged_readings(&self.path.readings).is_some()
    }

    /// Direction and size of the variance of the reference's noise, which both gratings share, pm^2;
    /// none where no reference noise is shared.
    fn reference_noise(&self) -> Option<(Vector2<f64>, f64)> {
        let compensated = self.data.fbg.needs_reference()
            && self
                .data
                .rows
                .iter()
                .all(|r| r.reference_shift_pm.is_some());
        let k = Vector2::from(
            self.data
                .fbg
                .temperature_pm_per_degc
                .filter(|_| compensated)?,
        );
        let shared = k.norm_squared() * self.walk?.noise_sd.powi(2);
        Some((k.try_normalize(0.0)?, shared))
    }

    /// Covariance of the gratings' noise of one reading in units of `noise_sd_pm`^2, the mean of both
    /// variances.
    pub(super) fn shared_by_reference(&self, noise_sd_pm: f64) -> Matrix2<f64> {
        let Some((along, shared)) = self.reference_noise() else {
            return Matrix2::identity();
        };
        // Where more is shared than there is, nothing of its own is left but rounding.
        let share = (shared / (2.0 * noise_sd_pm * noise_sd_pm)).min(MAX_SHARED);
        Matrix2::identity() * (1.0 - share) + along * along.transpose() * (2.0 * share)
    }

    /// Mixture that gives the gratings' noise from uncorrelated noise of one variance, pm; none
    /// where no reference noise is shared.
    fn shared_noise(&self, fit: &Fit) -> Option<Matrix2<f64>> {
        let (along, shared) = self.reference_noise()?;
        let across = Vector2::new(-along[1], along[0]);
        // Across k_T only the gratings' own noise is left; half of the degrees of freedom lie there.
        let own = (&fit.residual * across).norm_squared() / (0.5 * fit.readings_dof()).max(1.0);
        // cov = s^2 I + k k' s_T^2 has the root s (I + (stretch - 1) along along').
        let stretch = (1.0 + shared / own).sqrt();
        stretch
            .is_finite()
            .then(|| Matrix2::identity() + along * along.transpose() * (stretch - 1.0))
    }

    /// The same readings in the channels of `other`, its pictures weighed alike.
    pub(crate) fn with_whitening_of(self, other: &Self) -> Self {
        self.in_channels(other.whitening)
            .with_picture_scale(other.picture_scale)
            .with_own_share(other.own_share())
            .with_stage_clock(other.stage_clock_s)
    }

    /// The row of a reading.
    pub fn row(&self, reading: usize) -> &WhiskerRow {
        &self.rows[self.path.rows[reading]]
    }
}
