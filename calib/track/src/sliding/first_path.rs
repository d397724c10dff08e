//! A first path of the contact along the wire: the most probable one over a grid of places, by
//! dynamic programming (Viterbi).
//!
//! At each node q of the grid the frictionless contact that explains the moments is known
//! (`TouchedWire::frictionless`); from reading to reading
//!
//! ```text
//! cost = 5 ln(1 + e^2 / 4) + (dq / (2 |d| + 1 mm))^2,     e = dP . (n + n') / 2 / sd,   d: step of the motion
//! ```
//!
//! where the force does not jump (that is another branch of equilibria); e with the noise of the
//! moments, moved along the normal by the compliance s^2 / (3 E I), and half a node.

use super::contact_state::{ContactQuantities, State, TIP_MM, TouchedWire};
use super::factors::Chain;
use crate::known_motion::MotionRow;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// Spacing of the solved nodes and their parts, mm; the least place.
const NODE_MM: f64 = 2.0;
const PARTS: usize = 4;
const FIRST_MM: f64 = 6.0;
/// Largest tilt at the tip, rad.
const MAX_TILT: f64 = 1.55;
/// Tilt at first touch that parts starts at the tip from the side and from ahead, rad.
const AHEAD: f64 = 0.5;
/// At first touch the wire lies no farther from its free shape than this many steps; a force that
/// jumps by more than this share.
const MAX_DEFLECTION: f64 = 3.0;
const MAX_JUMP: f64 = 0.2;
/// Standard deviation of a step along the surface, mm.
const STEP_SD_MM: f64 = 0.02;

/// A node at a reading: none where no force gives the moments.
pub(super) type Candidate = Option<(State, ContactQuantities)>;

/// The nodes' places, mm.
fn places(length_mm: f64) -> Vec<f64> {
    // Past the tip the coordinate counts tilt, TIP_MM for one radian.
    let end = length_mm + MAX_TILT * TIP_MM;
    let count = ((end - FIRST_MM) / NODE_MM).floor() as usize;
    // One node is the tip: there the curve has a corner.
    let first = length_mm - ((length_mm - FIRST_MM) / NODE_MM).floor() * NODE_MM;
    (0..count).map(|k| first + NODE_MM * k as f64).collect()
}

/// The best paths that begin on the wire, at its tip from the side, and at its tip from ahead; none
/// where some reading is explained by no contact. `contacts`: of `candidates`.
pub(super) fn first_paths(chain: &Chain<'_>, contacts: &[Vec<Candidate>]) -> Vec<Vec<State>> {
    let seen = |(row, contacts): (&MotionRow, &Vec<Candidate>)| -> Vec<Candidate> {
        let of = |(x, y): &(State, ContactQuantities)| (*x, y.on_object(&row.turn, &row.moved_mm));
        contacts.iter().map(|c| c.as_ref().map(of)).collect()
    };
    let solved: Vec<Vec<Candidate>> = chain.rows.iter().zip(contacts).map(seen).collect();
    let Some(n) = solved.first().map(Vec::len) else {
        return Vec::new();
    };
    let tip = chain.wire.length_mm;
    let starts = [
        (0.0, tip),
        (tip, tip + AHEAD * TIP_MM),
        (tip + AHEAD * TIP_MM, f64::INFINITY),
    ];
    let mut searches = starts.map(|(low, high)| {
        let begins = |x: &State| x[0] > low && x[0] <= high;
        let costs = solved[0]
            .iter()
            .map(|c| start_cost(chain, c.as_ref().filter(|c| begins(&c.0))));
        Search {
            costs: costs.collect(),
            from: Vec::new(),
        }
    });
    let mut before = spreads(chain, &solved, 0);
    for k in 1..solved.len() {
        let here = spreads(chain, &solved, k);
        let steps = steps(chain, &solved, k, [&before, &here]);
        searches
            .iter_mut()
            .for_each(|search| search.go_on(&steps, n));
        before = here;
    }
    searches
        .into_iter()
        .filter_map(|search| search.best_path(chain, &solved))
        .collect()
}

/// Cost of a contact as the first one.
fn start_cost(chain: &Chain<'_>, contact: Option<&(State, ContactQuantities)>) -> f64 {
    let Some((x, y)) = contact else {
        return f64::INFINITY;
    };
    // After a slip from another place nothing says how deep the first contact is.
    if !chain.ends.from_free {
        return 0.0;
    }
    let deflection = chain.deflection(0, x, y);
    if deflection < MAX_DEFLECTION {
        deflection * deflection
    } else {
        f64::INFINITY
    }
}

/// Standard deviation of each node of a reading across the surface: noise by compliance, and half
/// the distance of two nodes along the normal.
fn spreads(chain: &Chain<'_>, solved: &[Vec<Candidate>], k: usize) -> Vec<f64> {
    let n = solved[k].len();
    // Compliance of a cantilever, s^2 / (3 E I) of displacement for a moment.
    let of = |i: usize| -> f64 {
        let Some((x, y)) = &solved[k][i] else {
            return f64::INFINITY;
        };
        let noise = (chain.rows[k].noise_nmm2.trace() / 2.0).sqrt() * y.arclength_mm().powi(2)
            / (3.0 * chain.wire.ei_nmm2);
        let next = solved[k][(i + 1).min(n - 1)]
            .as_ref()
            .map_or(0.0, |(z, w)| {
                if z[0] > x[0] {
                    (w.point_mm() - y.point_mm()).dot(&y.normal()) / 2.0
                } else {
                    0.0
                }
            });
        noise.hypot(next)
    };
    (0..n).map(of).collect()
}

/// A step of a path: to a node, from one of the reading before, and its cost.
type Step = (usize, usize, f64);

/// All steps to a reading.
fn steps(
    chain: &Chain<'_>,
    solved: &[Vec<Candidate>],
    k: usize,
    spreads: [&[f64]; 2],
) -> Vec<Step> {
    let n = solved[k].len();
    let reach = 4.0 * chain.step_mm[k] + 4.0;
    let slip = 2.0 * chain.step_mm[k] + 1.0;
    let jump_n = chain.jump_n(k);
    // Both branches of the equilibria have the same places in the same order.
    let (branch, nodes) = (n / 2, (reach / NODE_MM * PARTS as f64).ceil() as usize);
    let mut steps = Vec::new();
    for (i, to) in solved[k].iter().enumerate() {
        let Some((x, y)) = to else { continue };
        let at = i % branch;
        let near = at.saturating_sub(nodes)..(at + nodes + 1).min(branch);
        for j in near.clone().chain(near.start + branch..near.end + branch) {
            let Some((x0, y0)) = &solved[k - 1][j] else {
                continue;
            };
            let dq = x[0] - x0[0];
            // A jump of the force leads to another branch of equilibria.
            let jump = (x[1] - x0[1]).abs() > MAX_JUMP * (x[1] + x0[1]) + jump_n;
            if dq.abs() > reach || jump {
                continue;
            }
            let off = (y.point_mm() - y0.point_mm()).dot(&(y.normal() + y0.normal())) * 0.5;
            // Errors of both places across the surface add.
            let variance = STEP_SD_MM.powi(2) + spreads[0][j].powi(2) + spreads[1][i].powi(2);
            // Student's t of 4 degrees of freedom across the surface, a normal step along the wire.
            let cost = 5.0 * (off * off / variance / 4.0).ln_1p() + (dq / slip).powi(2);
            steps.push((i, j, cost));
        }
    }
    steps
}

/// The best path to each node from a start: its cost so far, and for each reading the node of the
/// one before.
struct Search {
    costs: Vec<f64>,
    from: Vec<Vec<usize>>,
}

impl Search {
    fn go_on(&mut self, steps: &[Step], nodes: usize) {
        let (mut next, mut best) = (vec![f64::INFINITY; nodes], vec![0; nodes]);
        for (to, from, cost) in steps {
            // Bellman: the best path to a node goes on from the best one to its predecessor.
            let cost = self.costs[*from] + cost;
            if cost < next[*to] {
                (next[*to], best[*to]) = (cost, *from);
            }
        }
        self.costs = next;
        self.from.push(best);
    }

    /// None where no path explains all readings.
    fn best_path(mut self, chain: &Chain<'_>, solved: &[Vec<Candidate>]) -> Option<Vec<State>> {
        let last = solved.last()?;
        if chain.ends.slips_off {
            // The wire slips off at its tip: 2 mm short of it are one standard deviation.
            for (cost, contact) in self.costs.iter_mut().zip(last) {
                if let Some((x, _)) = contact {
                    *cost += ((chain.wire.length_mm - x[0]).max(0.0) / 2.0)
                        .powi(2)
                        .min(30.0);
                }
            }
        }
        let costs = &self.costs;
        let best = (0..costs.len()).min_by(|a, b| costs[*a].total_cmp(&costs[*b]));
        let mut at = best.filter(|i| costs[*i].is_finite())?;
        // Backwards along the best predecessors.
        let mut path = vec![last[at]?.0];
        for (from, solved) in self.from.iter().zip(solved).rev() {
            at = from[at];
            path.push(solved[at]?.0);
        }
        path.reverse();
        Some(path)
    }
}

/// A share of the way from one state to another; azimuths the short way round.
pub(super) fn between_states(a: &State, b: &State, u: f64) -> State {
    let mut b = *b;
    b[2] += TAU * ((a[2] - b[2]) / TAU).round();
    a * (1.0 - u) + b * u
}

/// Contacts at all nodes and parts of each reading, base frame: whatever the motion is.
pub(super) fn candidates(wire: &TouchedWire, rows: &[MotionRow]) -> Vec<Vec<Candidate>> {
    let places = places(wire.length_mm);
    let mut last: Vec<Option<State>> = vec![None; places.len()];
    let mut high: Vec<Option<State>> = vec![None; places.len()];
    let mut all = Vec::with_capacity(rows.len());
    for row in rows {
        let moment = Vector2::from(row.moment_nmm);
        // From the reading before, whose branch of equilibria goes on; else from a light force.
        for (state, q) in last.iter_mut().zip(&places) {
            *state = wire
                .frictionless(*q, &moment, *state)
                .or_else(|| wire.frictionless(*q, &moment, None));
        }
        for (state, low) in high.iter_mut().zip(&last) {
            // The second branch of equilibria, where the wire has one.
            *state = low.as_ref().and_then(|low| wire.past_fold(low, &moment));
        }
        let mut fine = Vec::with_capacity(2 * places.len() * PARTS);
        for last in [&last, &high] {
            for (i, state) in last.iter().enumerate() {
                let parts = if i + 1 < places.len() { PARTS } else { 1 };
                for part in 0..parts {
                    let u = part as f64 / PARTS as f64;
                    let between = match (part, state, last.get(i + 1).copied().flatten()) {
                        (0, here, _) => *here,
                        (_, Some(a), Some(b)) => Some(between_states(a, &b, u)),
                        _ => None,
                    };
                    fine.push(between.map(|x| (x, wire.show(&x))));
                }
            }
        }
        all.push(fine);
    }
    all
}
