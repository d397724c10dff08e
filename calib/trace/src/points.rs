//! Few readings on a line: the rod is solved at each of them instead of on a table's grid.

use crate::mechanics::{ANCHORS, Bench, Mechanics, NEAR};
use crate::path::Node;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use wcal_rod::{Anchor, Rod};

/// Equilibria of a wire that was walked from first touch along one line, by stage position.
struct Walked {
    mechanics: Mechanics,
    nodes: Vec<(f64, Anchor)>,
}

/// Moments at the nodes of one path, N mm.
type Moments = Arc<Vec<[f64; 2]>>;

/// What is kept of solved points.
pub(crate) struct PointStore {
    walked: Vec<Mutex<Vec<Arc<Walked>>>>,
    solved: Mutex<HashMap<Vec<u64>, Moments>>,
}

/// Sets of stage positions and wires whose moments are kept.
const SOLVED_SETS: usize = 256;
/// Largest gap between the equilibria of a walked wire, mm.
const LARGEST_GAP_MM: f64 = 2.0;

impl PointStore {
    pub(crate) fn new(lines: usize) -> Self {
        Self {
            walked: (0..lines).map(|_| Mutex::new(Vec::new())).collect(),
            solved: Mutex::new(HashMap::new()),
        }
    }
}

/// Distinct loaded stage positions on every line, ascending.
pub(crate) fn positions(nodes: &[Node], xs_mm: &[f64], lines: usize) -> Vec<Vec<f64>> {
    let mut out = vec![Vec::new(); lines];
    for (node, &x) in nodes.iter().zip(xs_mm) {
        if let Some(l) = node.line.filter(|_| !node.rest) {
            out[l].push(x);
        }
    }
    for xs in &mut out {
        xs.sort_by(f64::total_cmp);
        xs.dedup();
    }
    out
}

impl Bench {
    /// Frictionless moments at the nodes, N mm, each solved for; none where the branch ends before one of them.
    pub(crate) fn solved_moments(
        &self,
        nodes: &[Node],
        xs_mm: &[f64],
        mechanics: &Mechanics,
    ) -> Option<Moments> {
        let mut key = mechanics.key();
        key.extend(xs_mm.iter().map(|x| x.to_bits()));
        if let Some(found) = self.points.solved.lock().ok()?.get(&key) {
            return Some(found.clone());
        }
        let rod = self.rod(mechanics)?;
        let wanted = positions(nodes, xs_mm, self.lines.len());
        let solved: Vec<Vec<[f64; 2]>> = wanted
            .par_iter()
            .enumerate()
            .map(|(l, xs)| self.solve_line(&rod, l, mechanics, xs))
            .collect::<Option<_>>()?;
        let mut out = Vec::with_capacity(nodes.len());
        for (node, x) in nodes.iter().zip(xs_mm) {
            out.push(match node.line.filter(|_| !node.rest) {
                Some(l) => solved[l][wanted[l].binary_search_by(|w| w.total_cmp(x)).ok()?],
                None => [0.0; 2],
            });
        }
        let out = Arc::new(out);
        let mut kept = self.points.solved.lock().ok()?;
        if kept.len() >= SOLVED_SETS {
            kept.clear();
        }
        kept.insert(key, out.clone());
        Some(out)
    }

    fn solve_line(&self, rod: &Rod, l: usize, mechanics: &Mechanics, xs: &[f64]) -> Option<Vec<[f64; 2]>> {
        if xs.is_empty() {
            return Some(Vec::new());
        }
        let touch_mm = self.touch(rod, l, mechanics).x_mm;
        let loaded = xs.iter().position(|x| *x > touch_mm).unwrap_or(xs.len());
        let mut out = vec![[0.0; 2]; loaded];
        let rest = &xs[loaded..];
        match self.near_neighbour(rod, l, mechanics, rest) {
            Some(near) => out.extend(near),
            None => out.extend(self.walk(rod, l, mechanics, touch_mm, rest)?),
        }
        Some(out)
    }

    /// Moments at `xs` from the nearest wire already walked; none where that is not near enough.
    fn near_neighbour(
        &self,
        rod: &Rod,
        l: usize,
        mechanics: &Mechanics,
        xs: &[f64],
    ) -> Option<Vec<[f64; 2]>> {
        let walked = {
            let kept = self.points.walked[l].lock().ok()?;
            let (distance, nearest) = kept
                .iter()
                .map(|w| (mechanics.distance(&w.mechanics), w))
                .min_by(|a, b| a.0.total_cmp(&b.0))?;
            (distance <= NEAR).then(|| nearest.clone())?
        };
        let line = self.line(l, mechanics);
        xs.iter()
            .map(|x| {
                let gap = |n: &&(f64, Anchor)| (n.0 - x).abs();
                let (_, anchor) = walked.nodes.iter().min_by(|a, b| gap(a).total_cmp(&gap(b)))?;
                let e = rod.solve_near(&line.point(*x), anchor)?;
                Some(self.axes.components_nmm(&e.moment_nmm))
            })
            .collect()
    }

    /// Moments at `xs` by following the branch from first touch; the equilibria are kept for neighbours.
    fn walk(
        &self,
        rod: &Rod,
        l: usize,
        mechanics: &Mechanics,
        touch_mm: f64,
        xs: &[f64],
    ) -> Option<Vec<[f64; 2]>> {
        let mut stops = Vec::new();
        let mut from = touch_mm;
        for &x in xs {
            let pieces = ((x - from) / LARGEST_GAP_MM).ceil().max(1.0) as usize;
            stops.extend(
                (1..=pieces)
                    .map(|k| if k == pieces { x } else { from + (x - from) * k as f64 / pieces as f64 }),
            );
            from = x;
        }
        let followed = rod.follow(&self.line(l, mechanics), &stops);
        let mut nodes = Vec::with_capacity(stops.len());
        let mut out = Vec::with_capacity(xs.len());
        for (x, outcome) in stops.iter().zip(&followed) {
            let e = outcome.equilibrium()?;
            if xs.binary_search_by(|w| w.total_cmp(x)).is_ok() {
                out.push(self.axes.components_nmm(&e.moment_nmm));
            }
            if let Some(anchor) = rod.anchor(e) {
                nodes.push((*x, anchor));
            }
        }
        let mut kept = self.points.walked[l].lock().ok()?;
        if kept.len() >= ANCHORS {
            // The first is the nominal wire.
            kept.remove(1);
        }
        kept.push(Arc::new(Walked { mechanics: *mechanics, nodes }));
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::whisker::WhiskerSystem;
    use wcal_core::observation::WhiskerRow;

    #[test]
    fn neighbours_and_walks_from_first_touch_agree() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/whiskerfbg");
        let session = wcal_session::load(&folder).unwrap();
        let wcal_core::SessionData::Whisker(data) = session.data else { panic!("kind") };
        let rows: Vec<&WhiskerRow> = data.rows.iter().collect();
        let system = WhiskerSystem::new(&data, &rows).unwrap();
        let xs: Vec<f64> = system.path.nodes.iter().map(|n| n.x_mm).collect();
        for mechanics in [
            Mechanics::default(),
            Mechanics { taper: 0.05, ..Mechanics::default() },
            Mechanics {
                offset_mm: [0.1, -0.2, 0.1],
                compliance_rad_per_nmm: [2e-3, 1e-3],
                ..Mechanics::default()
            },
        ] {
            let by_points = system.bench.solved_moments(&system.path.nodes, &xs, &mechanics).unwrap();
            let rod = system.bench.rod(&mechanics).unwrap();
            for (i, (node, point)) in system.path.nodes.iter().zip(by_points.iter()).enumerate() {
                let Some(l) = node.line.filter(|_| !node.rest) else { continue };
                let followed = rod.follow(&system.bench.line(l, &mechanics), &[xs[i]]);
                let m = followed[0]
                    .equilibrium()
                    .map_or([0.0; 2], |e| system.bench.axes.components_nmm(&e.moment_nmm));
                for c in 0..2 {
                    assert!((point[c] - m[c]).abs() < 1e-6, "{i} {point:?} {m:?}");
                }
            }
        }
    }
}
