//! The whisker session as a system: pose -> rod -> moment -> memory -> wavelength, with effects at
//! every stage.

use super::pictures::Pictures;
use super::whisker_effect::{ActiveEffect, Observers};
use crate::effect::{Effect, EffectTerm, LawRequirement};
use crate::measurement_model::finite;
use crate::method::fit::Fit;
use crate::whisker::effects::whisker_catalogue;
use crate::whisker::path::{Node, ReadoutOrigin, WhiskerPath, averaged_readings, temperature_walk};
use crate::whisker::rod_parameters::RodParameters;
use crate::whisker::rod_tables::RodTables;
use crate::whisker::temperature::RandomWalkModel;
use nalgebra::{DMatrix, Matrix2, Vector2};
use std::sync::Arc;
use wcal_core::observation::{RestShape, WhiskerData, WhiskerRow};

/// Two moment components a reading, N mm.
pub type Moments = Vec<[f64; 2]>;

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
    sealed: Vec<bool>,
    scored: Vec<bool>,
    pub(super) seatings: u32,
    pub(super) origin: ReadoutOrigin,
    walk: Option<RandomWalkModel>,
    pub(super) whitening: Matrix2<f64>,
    pub(super) pictures: Option<Arc<Pictures>>,
    pub(super) picture_scale: f64,
    stage_clock_s: f64,
    pub(super) refuted: Arc<[String]>,
}

/// Density of air, kg/m^3.
pub(crate) const AIR_KG_M3: f64 = 1.2;

/// Density of the medium, kg/m^3.
fn fluid_kg_m3(medium: &str) -> f64 {
    match medium {
        "water" => 998.2,
        _ => AIR_KG_M3,
    }
}

fn cloned_rows(rows: &[&WhiskerRow]) -> Arc<Vec<WhiskerRow>> {
    Arc::new(rows.iter().map(|r| (*r).clone()).collect())
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
    let stamped = |n: &Node| {
        let v = n.reading.map_or(0.0, |i| path.readings[i].velocity_mm_s);
        n.x_mm + v * stage_clock_s
    };
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
    /// System of the given rows (points, or points and sealed rows for prediction).
    ///
    /// # Errors
    /// Where the rest shape cannot be used.
    pub fn new(data: &WhiskerData, rows: &[&WhiskerRow]) -> Result<Self, wcal_rod::RodError> {
        // The sealed rows have no part in it, not even by their temperature.
        let walk = temperature_walk(&data.rows.iter().collect::<Vec<_>>(), &data.fbg);
        let path = Self::path(data, rows, walk);
        let rod_tables = RodTables::new(&data.whisker, fluid_kg_m3(&data.medium), &path)?;
        let rows = cloned_rows(rows);
        let pictures = Pictures::new(&rows, &path, data.shapes.as_ref()).map(Arc::new);
        let blank = Self::assemble(
            data,
            path,
            rows,
            walk,
            Arc::new(rod_tables),
            Matrix2::identity(),
        );
        Ok(Self { pictures, ..blank })
    }

    /// The same rod with other rows, none deeper than those that it was made for, and without
    /// pictures.
    pub(crate) fn with_rows(&self, rows: &[&WhiskerRow]) -> Self {
        Self::assemble(
            &self.data,
            Self::path(&self.data, rows, self.walk),
            cloned_rows(rows),
            self.walk,
            self.rod_tables.clone(),
            self.whitening,
        )
        .with_stage_clock(self.stage_clock_s)
        .without_effects(&self.refuted)
    }

    /// The same system without effects that another measurement of the instrument refutes, by
    /// identifier.
    pub(crate) fn without_effects(self, refuted: &[String]) -> Self {
        Self {
            refuted: refuted.into(),
            ..self
        }
    }

    fn path(
        data: &WhiskerData,
        rows: &[&WhiskerRow],
        walk: Option<RandomWalkModel>,
    ) -> WhiskerPath {
        let gravity = data.whisker.gravity_direction;
        WhiskerPath::new(
            rows,
            &data.trajectories,
            &data.moments,
            &data.fbg,
            gravity,
            walk.as_ref(),
        )
    }

    fn assemble(
        data: &WhiskerData,
        path: WhiskerPath,
        rows: Arc<Vec<WhiskerRow>>,
        walk: Option<RandomWalkModel>,
        rod_tables: Arc<RodTables>,
        whitening: Matrix2<f64>,
    ) -> Self {
        Self {
            pictures: None,
            picture_scale: 1.0,
            stage_clock_s: 0.0,
            refuted: Arc::default(),
            measured: measured_in(&path, &whitening),
            whitening,
            groups: path.readings.iter().map(|r| r.group).collect(),
            // Unsealed rows stand behind those of the points table.
            sealed: path
                .rows
                .iter()
                .map(|row| *row >= data.rows.len())
                .collect(),
            // Where the groove stood on a ramp is not known well enough to be scored.
            scored: path
                .readings
                .iter()
                .map(|r| r.holdout && !r.unsteady)
                .collect(),
            rows,
            seatings: data.rows.iter().map(|r| r.seating + 1).max().unwrap_or(1),
            origin: ReadoutOrigin::of(data),
            data: data.clone(),
            walk,
            path,
            rod_tables,
            catalogue: whisker_catalogue()
                .iter()
                .map(|e| e.effect.clone())
                .collect(),
        }
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
        let has = &self.path.columns;
        let moving = |p: &Arc<Pictures>| {
            p.each()
                .any(|(i, ..)| self.path.readings[i].velocity_mm_s != 0.0)
        };
        let (met, why) = match need {
            LawRequirement::Time | LawRequirement::Clock => {
                (has.time, "the session has no time stamps")
            }
            LawRequirement::Temperature => (has.temperature, "the session has no temperature"),
            LawRequirement::Motion => (has.speeds, "no reading was taken while the stage moved"),
            LawRequirement::Weight if !has.gravity => {
                (false, "the session does not give the direction of gravity")
            }
            LawRequirement::Weight => (
                self.data.whisker.density_kg_m3.is_some(),
                "the session does not give the density of the wire",
            ),
            LawRequirement::BothDirections => (
                has.both_directions,
                "the session has no readings of both directions",
            ),
            LawRequirement::Pictures => (
                self.pictures.is_some(),
                "the session has no pictures (shapes.json) that can be used",
            ),
            LawRequirement::StraightArc => (
                matches!(self.data.whisker.rest_shape, RestShape::StraightArc { .. }),
                "the session declares the wire's points, not a straight part and an arc",
            ),
            LawRequirement::MovingPictures => (
                self.pictures.as_ref().is_some_and(moving),
                "no pair of pictures was taken while the stage moved",
            ),
            LawRequirement::RestReadings => (
                self.path.readings.iter().any(|r| r.rest),
                "no reading was taken at rest",
            ),
            LawRequirement::Order | LawRequirement::Slope | LawRequirement::Covariate => {
                return None;
            }
        };
        (!met).then_some(why)
    }

    /// See [`effective_poses`].
    pub(super) fn effective_poses(
        &self,
        active: &[ActiveEffect],
        unseen: Observers,
    ) -> (Vec<f64>, RodParameters) {
        effective_poses(&self.path, active, unseen, self.stage_clock_s)
    }

    /// Effective moments at the readings, N mm, memory included, and the base moments before it.
    pub fn moments(&self, terms: &[EffectTerm]) -> Option<(Moments, Moments)> {
        let path = &self.path;
        let active = self.active(terms);
        terms
            .iter()
            .try_for_each(|t| finite(&t.values).map(|_| ()))?;
        let (xs, rod_parameters) = self.effective_poses(&active, Observers::Cameras);
        let base = self
            .rod_tables
            .moments(&path.nodes, &finite(xs)?, &rod_parameters)?;
        let mut sensed = base.clone();
        for a in &active {
            finite(sensed.as_flattened())?;
            a.sensor(path, &mut sensed);
        }
        let pick = |all: &[[f64; 2]]| -> Vec<[f64; 2]> {
            path.nodes
                .iter()
                .zip(all)
                .filter(|(n, _)| n.reading.is_some())
                .map(|(_, m)| *m)
                .collect()
        };
        Some((pick(&sensed), pick(&base)))
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

    /// By how much the stage's clock is set, s.
    pub(crate) fn stage_clock_s(&self) -> f64 {
        self.stage_clock_s
    }

    /// Readings were recorded while the stage moved, each the average of a short window.
    pub(super) fn is_read_in_motion(&self) -> bool {
        self.path.columns.speeds && !averaged_readings(&self.path.readings).is_empty()
    }

    /// Mixture that gives the gratings' noise from uncorrelated noise of one variance, pm; none
    /// where no reference noise is shared.
    fn shared_noise(&self, fit: &Fit) -> Option<Matrix2<f64>> {
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
        let along = k.try_normalize(0.0)?;
        let across = Vector2::new(-along[1], along[0]);
        let own = (&fit.residual * across).norm_squared() / (0.5 * fit.readings_dof()).max(1.0);
        let shared = k.norm_squared() * self.walk?.noise_sd().powi(2);
        let stretch = (1.0 + shared / own).sqrt();
        stretch
            .is_finite()
            .then(|| Matrix2::identity() + along * along.transpose() * (stretch - 1.0))
    }

    /// The same readings in the channels of `other`, its pictures weighed alike.
    pub(crate) fn with_whitening_of(self, other: &Self) -> Self {
        let share = other
            .pictures
            .as_ref()
            .map_or(1.0, |p| p.independent_variance_share());
        self.in_channels(other.whitening)
            .with_picture_scale(other.picture_scale)
            .with_own_share(share)
            .with_stage_clock(other.stage_clock_s)
    }

    /// Difference of two systems' mixtures of channels: largest ratio of their shared noise.
    pub(crate) fn whitening_change(&self, other: &Self) -> f64 {
        let (a, b) = (self.whitening.determinant(), other.whitening.determinant());
        (a / b).max(b / a)
    }

    /// Seatings in the points table.
    pub fn seatings(&self) -> u32 {
        self.seatings
    }

    /// The row of a reading.
    pub fn row(&self, reading: usize) -> &WhiskerRow {
        &self.rows[self.path.rows[reading]]
    }

    /// Readings whose rows were sealed, and those of them that count in the held-out error.
    pub fn held_out(&self) -> [&[bool]; 2] {
        [&self.sealed, &self.scored]
    }
}
