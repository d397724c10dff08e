//! The readings of a whisker session, and the pictures beside them, as the statistics see them.

use super::covariates::covariates;
use super::path::{ReadoutOrigin, WhiskerPath};
use super::pictures::{PairObservation, Pictures};
use super::stage_clock::CLOCK_SD_S;
use super::system::{WhiskerSystem, dynamic, effective_poses};
use super::whisker_effect::{ActiveEffect, Observers};
use crate::effect::{Effect, EffectTerm, LawRequirement};
use crate::measurement_model::{MeasurementModel, design_of, finite};
use crate::method::{NoiseInputs, Weights};
use nalgebra::{DMatrix, DVector};
use std::sync::Arc;
use wcal_rod::{Equilibrium, interpolated_point};

/// A node with the equilibrium there, and the pair that was taken: its reading, arc lengths of its
/// stations and what it shows.
type Expected<'a> = (
    (usize, Option<Equilibrium>),
    (usize, &'a [f64], &'a PairObservation),
);

impl WhiskerPath {
    /// Columns of the readout at `sensed` moments, one value a reading each: zero, both moments,
    /// zeros of seatings, those of effects.
    pub(super) fn readout_columns(
        &self,
        seatings: u32,
        effects: &[ActiveEffect],
        origin: &ReadoutOrigin,
        sensed: &[[f64; 2]],
    ) -> Vec<Vec<f64>> {
        let moment = |c: usize| sensed.iter().map(|m| m[c]).collect();
        let mut columns = vec![vec![1.0; sensed.len()], moment(0), moment(1)];
        columns.extend(self.seating_columns(seatings));
        columns.extend(
            effects
                .iter()
                .flat_map(|a| (a.effect.columns)(&a.values(), self, origin, sensed)),
        );
        columns
    }
}

impl WhiskerSystem {
    /// What the pairs would show under `terms`, in their order; none where the model has no
    /// solution.
    pub(crate) fn predict_pictures(&self, terms: &[EffectTerm]) -> Option<Vec<PairObservation>> {
        let Some(pictures) = &self.pictures else {
            return Some(Vec::new());
        };
        let active = self.active(terms);
        // The cameras see where the groove is, not where late gratings read it.
        let (xs, rod_parameters) =
            effective_poses(&self.path, &active, Observers::Gratings, self.stage_clock_s);
        let nodes = pictures.nodes();
        let held = self
            .rod_tables
            .contacts(&self.path.nodes, &xs, &rod_parameters, &nodes)?;
        let rod = self.rod_tables.rod(&rod_parameters)?;
        let pair = |((node, e), (_, stations_mm, shown)): Expected<'_>| {
            let l = self.path.nodes[node].line?;
            let groove_mm = self.rod_tables.line(l, &rod_parameters).point(xs[node]);
            let loaded = e.map(|e| rod.loaded_shape(&e));
            let station = |s: &f64| match &loaded {
                Some(nodes) => interpolated_point(nodes, *s),
                // Before first touch the wire is where it rests.
                None => rod.shape.rest_point(*s),
            };
            let untouched = || self.rod_tables.touch(&rod, l, &rod_parameters).arclength_mm;
            Some(PairObservation {
                groove_mm,
                arclength_mm: e.map_or_else(untouched, |e| e.arclength_mm),
                tangent: e.map_or(shown.tangent, |e| e.tangent),
                stations_mm: stations_mm.iter().map(station).collect(),
                ..shown.clone()
            })
        };
        let all = nodes.into_iter().zip(held).zip(pictures.each());
        let mut seen: Vec<PairObservation> = all.map(pair).collect::<Option<_>>()?;
        for a in &active {
            (a.effect.pictures)(&a.values(), &mut seen);
        }
        Some(seen)
    }

    /// The pairs that count together with the wavelengths.
    pub fn pictures(&self) -> Option<&Pictures> {
        self.pictures.as_deref()
    }

    /// The same readings with pictures whose stated standard deviation weighs as much as `sd` of a
    /// reading, in the engine's channels.
    pub(crate) fn with_picture_scale(mut self, sd: f64) -> Self {
        self.picture_scale = sd;
        self
    }

    /// The same readings with pictures of which `share` of the stated own errors counts.
    pub(crate) fn with_own_share(mut self, share: f64) -> Self {
        self.pictures = self.pictures.map(|p| Arc::new(p.with_own_share(share)));
        self
    }

    /// Share of the own errors that the pictures state which counts.
    pub(super) fn own_share(&self) -> f64 {
        self.pictures.as_ref().map_or(1.0, |p| p.own_sd_share)
    }
}

impl MeasurementModel for WhiskerSystem {
    fn channels_pm(&self) -> DMatrix<f64> {
        dynamic(&self.whitening)
    }

    fn measured(&self) -> &DMatrix<f64> {
        &self.measured
    }

    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>> {
        let (sensed, _) = self.moments(terms)?;
        design_of(&self.path.readout_columns(
            self.seatings,
            &self.active(terms),
            &self.origin,
            &sensed,
        ))
    }

    fn auxiliary_residual(&self, terms: &[EffectTerm], weights: &Weights) -> Option<DVector<f64>> {
        let Some(pictures) = &self.pictures else {
            return Some(DVector::zeros(0));
        };
        let seen = self.predict_pictures(terms)?;
        // White with the variance of a reading's noise: one variance holds for both witnesses.
        let w = pictures.whitened(&seen, |i| weights.counts(i)) * self.picture_scale;
        finite(w.as_slice())?;
        Some(w)
    }

    fn auxiliary_readings(&self) -> Arc<Vec<usize>> {
        self.pictures
            .as_ref()
            .map_or_else(Arc::default, |p| p.readings.clone())
    }

    fn auxiliary_variance(&self) -> f64 {
        self.picture_scale.powi(2)
    }

    fn catalogue(&self) -> &[Effect] {
        &self.catalogue
    }

    fn not_observable(&self, effect: usize) -> Option<String> {
        let effect = &self.catalogue[effect];
        if self.refuted.iter().any(|id| id == effect.id) {
            return Some("another measurement of this whisker refutes it".to_owned());
        }
        effect
            .needs()
            .iter()
            .find_map(|need| self.missing_requirement(*need))
            .map(str::to_owned)
    }

    fn groups(&self) -> &[u32] {
        &self.groups
    }

    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        covariates(self)
    }

    fn cross_validates_terms(&self) -> bool {
        true
    }

    fn systematic_sd(&self, effect: usize, parameter: &str) -> f64 {
        // What the stamps of the stage's answers leave open looks like a lag.
        let stamped = self.catalogue[effect]
            .needs()
            .contains(&LawRequirement::Motion)
            && parameter == "lag_s";
        if stamped && self.is_read_in_motion() {
            CLOCK_SD_S
        } else {
            0.0
        }
    }

    fn noise_inputs(&self) -> NoiseInputs {
        super::noise::noise_inputs(&self.data, &self.path)
    }
}
