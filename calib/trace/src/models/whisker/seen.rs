//! What the pairs of pictures would show under given effects, and how much they weigh beside the readings.
//!
//! Between nodes j and j + 1 of the loaded wire, with x = (s - s_j) / h, positions p and unit tangents t (cubic Hermite interpolation):
//!
//! ```text
//! p(s) = p_j (2x^3 - 3x^2 + 1) + h t_j (x^3 - 2x^2 + x) + p_j+1 (3x^2 - 2x^3) + h t_j+1 (x^3 - x^2)
//! ```

use super::pictures::{Pictures, Seen};
use super::system::WhiskerSystem;
use super::whisker_effect::Observers;
use crate::effect::EffectTerm;
use nalgebra::{Matrix3, Vector3};
use std::sync::Arc;

/// Points of the loaded wire at arc lengths, mm: cubic in between its nodes, whose tangents are known.
fn points_at(nodes: &[(f64, Vector3<f64>, Matrix3<f64>)], arclengths_mm: &[f64]) -> Vec<Vector3<f64>> {
    let at = |s: &f64| {
        let j = nodes.partition_point(|n| n.0 <= *s).clamp(1, nodes.len() - 1);
        let (a, b) = (&nodes[j - 1], &nodes[j]);
        let h = b.0 - a.0;
        if h <= 0.0 {
            return b.1;
        }
        let x = (s - a.0) / h;
        let (x2, x3) = (x * x, x * x * x);
        a.1 * (2.0 * x3 - 3.0 * x2 + 1.0)
            + a.2.column(0) * (h * (x3 - 2.0 * x2 + x))
            + b.1 * (3.0 * x2 - 2.0 * x3)
            + b.2.column(0) * (h * (x3 - x2))
    };
    arclengths_mm.iter().map(at).collect()
}

impl WhiskerSystem {
    /// What the pairs would show under `terms`, in their order; none where the model has no solution.
    #[must_use]
    pub fn seen(&self, terms: &[EffectTerm]) -> Option<Vec<Seen>> {
        let Some(pictures) = &self.pictures else { return Some(Vec::new()) };
        let active = self.active(terms);
        let (xs, rod_parameters) = self.driven(&active, Observers::Gratings);
        let nodes = pictures.nodes();
        let held = self.rod_tables.contacts(&self.path.nodes, &xs, &rod_parameters, &nodes)?;
        let rod = self.rod_tables.rod(&rod_parameters)?;
        let mut seen = Vec::with_capacity(nodes.len());
        for ((node, e), (_, stations_mm, shown)) in nodes.iter().zip(held).zip(pictures.each()) {
            let l = self.path.nodes[*node].line?;
            let groove_mm = self.rod_tables.line(l, &rod_parameters).point(xs[*node]);
            seen.push(match e {
                Some(e) => Seen {
                    groove_mm,
                    arclength_mm: e.arclength_mm,
                    tangent: e.tangent,
                    stations_mm: points_at(&rod.loaded_shape(&e), stations_mm),
                    ..shown.clone()
                },
                // Before first touch the wire is where it rests.
                None => Seen {
                    groove_mm,
                    arclength_mm: self.rod_tables.touch(&rod, l, &rod_parameters).arclength_mm,
                    stations_mm: stations_mm.iter().map(|s| rod.shape.rest_point(*s)).collect(),
                    ..shown.clone()
                },
            });
        }
        for a in &active {
            a.effect.pictures(&a.values(), &mut seen);
        }
        Some(seen)
    }

    /// The pairs that count beside the wavelengths.
    #[must_use]
    pub fn pictures(&self) -> Option<&Pictures> {
        self.pictures.as_deref()
    }

    /// The same readings beside pictures whose stated standard deviation weighs as much as `sd` of a reading, in the engine's channels.
    #[must_use]
    pub fn with_picture_scale(mut self, sd: f64) -> Self {
        self.picture_scale = sd;
        self
    }

    /// The same readings beside pictures of which `share` of the stated own errors counts.
    #[must_use]
    pub fn with_own_share(mut self, share: f64) -> Self {
        self.pictures = self.pictures.map(|p| Arc::new(p.with_own_share(share)));
        self
    }

    /// What a stated standard deviation of the pictures weighs, in the engine's channels.
    #[must_use]
    pub fn picture_scale(&self) -> f64 {
        self.picture_scale
    }

    /// The same readings without the pictures.
    #[must_use]
    pub fn without_pictures(mut self) -> Self {
        self.pictures = None;
        self
    }
}
