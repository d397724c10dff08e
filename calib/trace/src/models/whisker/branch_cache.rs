//! Branches of equilibria, continued from first touch and kept: their neighbours are solved in a few steps from them.

use crate::whisker::rod_parameters::RodParameters;
use crate::whisker::rod_tables::RodTables;
use std::sync::{Arc, Mutex};
use wcal_rod::{Anchor, Equilibrium, Rod};

/// Walked wires kept a line.
const KEPT: usize = 12;
/// Wires farther from every known one than this are continued from first touch; nearer ones are first tried from the known one.
const NEAR: f64 = 2.0;

/// Equilibria of one wire along one line.
struct Branch {
    rod_parameters: RodParameters,
    /// By the share of the way from first touch to the line's end, ascending.
    nodes: Vec<(f64, Anchor)>,
}

/// Walked wires of every line.
pub(crate) struct BranchCache(Vec<Mutex<Vec<Arc<Branch>>>>);

impl BranchCache {
    pub(crate) fn new(lines: usize) -> Self {
        Self((0..lines).map(|_| Mutex::new(Vec::new())).collect())
    }

    fn keep(&self, l: usize, branch: Branch) {
        let Ok(mut kept) = self.0[l].lock() else { return };
        if kept.len() >= KEPT {
            // The first is the nominal wire.
            kept.remove(1);
        }
        kept.push(Arc::new(branch));
    }

    fn nearest(&self, l: usize, rod_parameters: &RodParameters) -> Option<Arc<Branch>> {
        let kept = self.0[l].lock().ok()?;
        let (distance, nearest) = kept
            .iter()
            .map(|w| (rod_parameters.distance(&w.rod_parameters), w))
            .min_by(|a, b| a.0.total_cmp(&b.0))?;
        (distance <= NEAR).then(|| nearest.clone())
    }
}

impl Branch {
    fn node(&self, share: f64) -> Option<&Anchor> {
        let after = self.nodes.partition_point(|n| n.0 < share);
        let beside = after.saturating_sub(1)..(after + 1).min(self.nodes.len());
        let near =
            self.nodes[beside].iter().min_by(|a, b| (a.0 - share).abs().total_cmp(&(b.0 - share).abs()));
        near.map(|n| &n.1)
    }
}

impl RodTables {
    /// Equilibria at `xs_mm` in small steps from the nearest wire whose branch is known; none where that is not near enough.
    pub(crate) fn warm_start(
        &self,
        rod: &Rod,
        l: usize,
        rod_parameters: &RodParameters,
        touch_mm: f64,
        xs_mm: &[f64],
    ) -> Option<Vec<Equilibrium>> {
        let branch = self.branches.nearest(l, rod_parameters)?;
        let line = self.line(l, rod_parameters);
        let way_mm = self.end_mm(l) - touch_mm;
        xs_mm.iter().map(|x| rod.solve_near(&line.point(*x), branch.node((x - touch_mm) / way_mm)?)).collect()
    }

    /// Keeps the equilibria of a wire that was followed from first touch.
    pub(crate) fn store_branch(
        &self,
        rod: &Rod,
        l: usize,
        rod_parameters: &RodParameters,
        touch_mm: f64,
        followed: &[(f64, Equilibrium)],
    ) {
        let way_mm = self.end_mm(l) - touch_mm;
        let node = |(x, e): &(f64, Equilibrium)| Some(((x - touch_mm) / way_mm, rod.anchor(e)?));
        let nodes: Option<Vec<_>> = followed.iter().map(node).collect();
        if let Some(nodes) = nodes.filter(|n| !n.is_empty()) {
            self.branches.keep(l, Branch { rod_parameters: *rod_parameters, nodes });
        }
    }
}
