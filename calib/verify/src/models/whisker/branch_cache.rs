//! Branches of equilibria, continued from first touch and kept: their neighbours are solved in a
//! few steps from them.

use super::rod_parameters::RodParameters;
use std::sync::{Arc, Mutex};
use wcal_rod::Anchor;

/// Walked wires kept a line.
const KEPT: usize = 12;
/// Wires farther from every known one than this are continued from first touch; nearer ones are
/// first tried from the known one.
const NEAR: f64 = 2.0;

/// Equilibria of one wire along one line.
pub(super) struct Branch {
    pub(super) rod_parameters: RodParameters,
    /// By the share of the way from first touch to the line's end, ascending.
    pub(super) nodes: Vec<(f64, Anchor)>,
}

/// Walked wires of every line.
pub(super) struct BranchCache(Vec<Mutex<Vec<Arc<Branch>>>>);

impl BranchCache {
    pub(super) fn new(lines: usize) -> Self {
        Self((0..lines).map(|_| Mutex::new(Vec::new())).collect())
    }

    pub(super) fn keep(&self, l: usize, branch: Branch) {
        let Ok(mut kept) = self.0[l].lock() else {
            return;
        };
        if kept.len() >= KEPT {
            // The first is the nominal wire.
            kept.remove(1);
        }
        kept.push(Arc::new(branch));
    }

    pub(super) fn nearest(&self, l: usize, rod_parameters: &RodParameters) -> Option<Arc<Branch>> {
        let kept = self.0[l].lock().ok()?;
        let near = |w: &&Arc<Branch>| rod_parameters.distance(&w.rod_parameters);
        let nearest = kept.iter().min_by(|a, b| near(a).total_cmp(&near(b)))?;
        (near(&nearest) <= NEAR).then(|| nearest.clone())
    }
}

impl Branch {
    pub(super) fn node(&self, share: f64) -> Option<&Anchor> {
        let off = |n: &(f64, Anchor)| (n.0 - share).abs();
        let nearest = self.nodes.iter().min_by(|a, b| off(a).total_cmp(&off(b)));
        nearest.map(|n| &n.1)
    }
}
