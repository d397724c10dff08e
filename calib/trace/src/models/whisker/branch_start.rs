//! Equilibria that are solved from a branch which is known, and what is kept for that.

use crate::whisker::branch_cache::Branch;
use crate::whisker::rod_parameters::RodParameters;
use crate::whisker::rod_tables::RodTables;
use wcal_rod::{Equilibrium, Rod};

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
