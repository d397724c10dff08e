//! What the pairs of pictures would show under given effects, and how much they weigh against the readings.

use super::pictures::{PairObservation, Pictures};
use super::system::WhiskerSystem;
use super::whisker_effect::Observers;
use crate::effect::EffectTerm;
use std::sync::Arc;
use wcal_rod::interpolated_point;

impl WhiskerSystem {
    /// What the pairs would show under `terms`, in their order; none where the model has no solution.
    pub fn predict_pictures(&self, terms: &[EffectTerm]) -> Option<Vec<PairObservation>> {
        let Some(pictures) = &self.pictures else { return Some(Vec::new()) };
        let active = self.active(terms);
        let (xs, rod_parameters) = self.effective_poses(&active, Observers::Gratings);
        let nodes = pictures.nodes();
        let held = self.rod_tables.contacts(&self.path.nodes, &xs, &rod_parameters, &nodes)?;
        let rod = self.rod_tables.rod(&rod_parameters)?;
        let mut seen = Vec::with_capacity(nodes.len());
        for ((node, e), (_, stations_mm, shown)) in nodes.iter().zip(held).zip(pictures.each()) {
            let l = self.path.nodes[*node].line?;
            let groove_mm = self.rod_tables.line(l, &rod_parameters).point(xs[*node]);
            seen.push(match e {
                Some(e) => PairObservation {
                    groove_mm,
                    arclength_mm: e.arclength_mm,
                    tangent: e.tangent,
                    stations_mm: {
                        let nodes = rod.loaded_shape(&e);
                        stations_mm.iter().map(|s| interpolated_point(&nodes, *s)).collect()
                    },
                    ..shown.clone()
                },
                // Before first touch the wire is where it rests.
                None => PairObservation {
                    groove_mm,
                    arclength_mm: self.rod_tables.touch(&rod, l, &rod_parameters).arclength_mm,
                    stations_mm: stations_mm.iter().map(|s| rod.shape.rest_point(*s)).collect(),
                    ..shown.clone()
                },
            });
        }
        for a in &active {
            (a.effect.pictures)(&a.values(), &mut seen);
        }
        Some(seen)
    }

    /// The pairs that count together with the wavelengths.
    pub fn pictures(&self) -> Option<&Pictures> {
        self.pictures.as_deref()
    }

    /// The same readings with pictures whose stated standard deviation weighs as much as `sd` of a reading, in the engine's channels.
    pub fn with_picture_scale(mut self, sd: f64) -> Self {
        self.picture_scale = sd;
        self
    }

    /// The same readings with pictures of which `share` of the stated own errors counts.
    pub fn with_own_share(mut self, share: f64) -> Self {
        self.pictures = self.pictures.map(|p| Arc::new(p.with_own_share(share)));
        self
    }

    /// What a stated standard deviation of the pictures weighs, in the engine's channels.
    pub fn picture_scale(&self) -> f64 {
        self.picture_scale
    }
}
