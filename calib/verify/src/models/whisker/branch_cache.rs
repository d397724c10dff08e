//! Branches of equilibria, continued from first touch and kept: their neighbours are solved in a
//! few steps from them.

use crate::whisker::rod_parameters::RodParameters;
use std::sync::{Arc, Mutex};
use wcal_rod::Anchor;

/// Walked wires kept a line.
const KEPT: usize = 12;
/// Wires farther from every known one than this are continued from first touch; nearer ones are
/// first tried from the known one.
const NEAR: f64 = 2.0;

/// Equilibria of one wire along one line.
pub(crate) struct Branch {
    pub(super) rod_parameters: RodParameters,
    /// By the share of the way from first touch to the line's end, ascending.
    pub(super) nodes: Vec<(f64, Anchor)>,
}

/// Walked wires of every line.
pub(crate) struct BranchCache(Vec<Mutex<Vec<Arc<Branch>>>>);

impl BranchCache {
    pub(crate) fn new(lines: usize) -> Self {
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
        let (distance, nearest) = kept
            .iter()
            .map(|w| (rod_parameters.distance(&w.rod_parameters), w))
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        (distance <= NEAR).then(|| nearest.clone())
    }
}

impl Branch {
    pub(super) fn node(&self, share: f64) -> Option<&Anchor> {
        let after = self.nodes.partition_point(|n| n.0 < share);
        let beside = after.saturating_sub(1)..(after + 1).min(self.nodes.len());
        let near = self.nodes[beside]
            .iter()
            .min_by(|a, b| (a.0 - share).abs().total_cmp(&(b.0 - share).abs()));
        near.map(|n| &n.1)
    }
}
