//! Few readings on a line: the rod is solved at each of them instead of on a table's grid.

use super::branch_cache::Branch;
use super::path::{Node, positions};
use super::rod_parameters::RodParameters;
use super::rod_tables::RodTables;
use rayon::prelude::*;
use std::sync::Arc;
use wcal_rod::{Equilibrium, Rod};

/// Largest gap between the equilibria of a continued branch, mm.
const MAX_GAP_MM: f64 = 2.0;

impl RodTables {
    /// Frictionless equilibria at the nodes, each solved for, none at a node where the wire is
    /// free; none where the branch ends before one of them.
    pub(super) fn solved_contacts(
        &self,
        nodes: &[Node],
        xs_mm: &[f64],
        rod_parameters: &RodParameters,
    ) -> Option<Arc<Vec<Option<Equilibrium>>>> {
        let mut key = rod_parameters.key();
        for (node, x) in nodes.iter().zip(xs_mm) {
            let line = node.loaded_line().map_or(u64::MAX, |l| l as u64);
            key.extend([x.to_bits(), line]);
        }
        self.points.get(key, || {
            let rod = self.rod(rod_parameters)?;
            let wanted = positions(nodes, xs_mm, self.lines.len());
            let lines = wanted.par_iter().enumerate();
            let solved: Vec<Vec<Option<Equilibrium>>> = lines
                .map(|(l, xs)| self.solve_line(&rod, l, rod_parameters, xs))
                .collect::<Option<_>>()?;
            let at = |(node, x): (&Node, &f64)| match node.loaded_line() {
                Some(l) => Some(solved[l][wanted[l].binary_search_by(|w| w.total_cmp(x)).ok()?]),
                None => Some(None),
            };
            nodes.iter().zip(xs_mm).map(at).collect()
        })
    }

    /// Frictionless moments at the nodes, N mm, each solved for; none where the branch ends before
    /// one of them.
    pub(super) fn solved_moments(
        &self,
        nodes: &[Node],
        xs_mm: &[f64],
        rod_parameters: &RodParameters,
    ) -> Option<Vec<[f64; 2]>> {
        let contacts = self.solved_contacts(nodes, xs_mm, rod_parameters)?;
        let moment = |e: &Option<Equilibrium>| {
            e.map_or([0.0; 2], |e| self.axes.components_nmm(&e.moment_nmm))
        };
        Some(contacts.iter().map(moment).collect())
    }

    fn solve_line(
        &self,
        rod: &Rod,
        l: usize,
        rod_parameters: &RodParameters,
        xs: &[f64],
    ) -> Option<Vec<Option<Equilibrium>>> {
        if xs.is_empty() {
            return Some(Vec::new());
        }
        let touch_mm = self.touch(rod, l, rod_parameters).x_mm;
        // Before first touch nothing holds the wire; positions ascend, so those come first.
        let free = xs.iter().position(|x| *x > touch_mm).unwrap_or(xs.len());
        let held = &xs[free..];
        let equilibria = self
            .warm_start(rod, l, rod_parameters, touch_mm, held)
            .or_else(|| self.walk(rod, l, rod_parameters, touch_mm, held))?;
        let held = equilibria.into_iter().map(Some);
        Some(std::iter::repeat_n(None, free).chain(held).collect())
    }

    /// Equilibria at `xs` by following the branch from first touch; kept for neighbours.
    fn walk(
        &self,
        rod: &Rod,
        l: usize,
        rod_parameters: &RodParameters,
        touch_mm: f64,
        xs: &[f64],
    ) -> Option<Vec<Equilibrium>> {
        let mut stops = Vec::new();
        let mut from = touch_mm;
        for &x in xs {
            let pieces = ((x - from) / MAX_GAP_MM).ceil().max(1.0) as usize;
            let between = |k: usize| from + (x - from) * k as f64 / pieces as f64;
            stops.extend((1..pieces).map(between));
            stops.push(x);
            from = x;
        }
        let followed = self.followed(rod, l, rod_parameters, touch_mm, &stops);
        let wanted = |(e, x): (Equilibrium, &f64)| xs.contains(x).then_some(e);
        (followed.len() == stops.len()).then(|| {
            followed
                .into_iter()
                .zip(&stops)
                .filter_map(wanted)
                .collect()
        })
    }

    /// Equilibria at `xs_mm` from first touch on, as far as the branch goes; kept for neighbours
    /// where it goes all the way.
    pub(super) fn followed(
        &self,
        rod: &Rod,
        l: usize,
        rod_parameters: &RodParameters,
        touch_mm: f64,
        xs_mm: &[f64],
    ) -> Vec<Equilibrium> {
        let outcomes = rod.follow(&self.line(l, rod_parameters), xs_mm);
        let found = outcomes.iter().map_while(|o| o.equilibrium().copied());
        let found: Vec<Equilibrium> = found.collect();
        // First touch moves with the wire: neighbours agree by the share of the way, not by x.
        let way_mm = self.end_mm(l) - touch_mm;
        let node = |(x, e): (&f64, &Equilibrium)| Some(((x - touch_mm) / way_mm, rod.anchor(e)?));
        let nodes: Option<Vec<_>> = xs_mm.iter().zip(&found).map(node).collect();
        if let Some(nodes) = nodes.filter(|n| !n.is_empty() && n.len() == xs_mm.len()) {
            let rod_parameters = *rod_parameters;
            let branch = Branch {
                rod_parameters,
                nodes,
            };
            self.branches.keep(l, branch);
        }
        found
    }

    /// Equilibria at `xs_mm` in small steps from the nearest wire whose branch is known; none where
    /// that is not near enough.
    pub(super) fn warm_start(
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
        xs_mm
            .iter()
            .map(|x| rod.solve_near(&line.point(*x), branch.node((x - touch_mm) / way_mm)?))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::WhiskerSystem;

    #[test]
    fn neighbours_and_walks_from_first_touch_agree() {
        let folder =
            std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/whiskerfbg");
        let session = wcal_session::load(&folder).unwrap();
        let wcal_core::SessionData::Whisker(data) = session.data else {
            panic!("kind")
        };
        let system = WhiskerSystem::new(&data, &[]).unwrap();
        let xs: Vec<f64> = system.path.nodes.iter().map(|n| n.x_mm).collect();
        for rod_parameters in [
            RodParameters::default(),
            RodParameters {
                taper: 0.05,
                ..RodParameters::default()
            },
            RodParameters {
                offset_mm: [0.1, -0.2, 0.1],
                compliance_rad_per_nmm: [2e-3, 1e-3],
                ..RodParameters::default()
            },
        ] {
            let by_points = system
                .rod_tables
                .solved_moments(&system.path.nodes, &xs, &rod_parameters)
                .unwrap();
            let rod = system.rod_tables.rod(&rod_parameters).unwrap();
            for (i, (node, point)) in system.path.nodes.iter().zip(by_points.iter()).enumerate() {
                let Some(l) = node.loaded_line() else {
                    continue;
                };
                let followed = rod.follow(&system.rod_tables.line(l, &rod_parameters), &[xs[i]]);
                let m = followed[0].equilibrium().map_or([0.0; 2], |e| {
                    system.rod_tables.axes.components_nmm(&e.moment_nmm)
                });
                for c in 0..2 {
                    assert!((point[c] - m[c]).abs() < 1e-6, "{i} {point:?} {m:?}");
                }
            }
        }
    }
}
