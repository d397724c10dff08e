//! A first path of the contact along the wire: the most probable one over a grid of places, by dynamic programming (Viterbi).
//!
//! At each node q of the grid the frictionless contact that explains the moments is known (`TouchedWire::frictionless`); from reading to reading
//!
//! ```text
//! cost = 5 ln(1 + e^2 / 4) + (dq / (2 |d| + 1 mm))^2,     e = dP . (n + n') / 2 / sd,   d: step of the motion
//! ```
//!
//! where the force does not jump (that is another branch of equilibria); e with the noise of the moments, moved along the normal by the compliance s^2 / (3 E I), and half a node.

use super::contact_state::{ContactQuantities, State, TIP_MM};
use super::factors::Chain;
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
/// At first touch the wire lies no farther from its free shape than this many steps; a force that jumps by more than this share.
const MAX_DEFLECTION: f64 = 3.0;
const MAX_JUMP: f64 = 0.2;
/// Standard deviation of a step along the surface, mm.
const STEP_SD_MM: f64 = 0.02;

/// A node at a reading: none where no force gives the moments.
type Candidate = Option<(State, ContactQuantities)>;

/// The nodes' places, mm.
fn places(length_mm: f64) -> Vec<f64> {
    let end = length_mm + MAX_TILT * TIP_MM;
    let count = ((end - FIRST_MM) / NODE_MM).floor() as usize;
    // One node is the tip: there the curve has a corner.
    let first = length_mm - ((length_mm - FIRST_MM) / NODE_MM).floor() * NODE_MM;
    (0..count).map(|k| first + NODE_MM * k as f64).collect()
}

/// The best paths that begin on the wire, at its tip from the side, and at its tip from ahead; none where some reading is explained by no
/// contact.
pub(super) fn first_paths(chain: &Chain<'_>) -> Vec<Vec<State>> {
    let solved = candidates(chain);
    let tip = chain.wire.length_mm;
    let starts = [(0.0, tip), (tip, tip + AHEAD * TIP_MM), (tip + AHEAD * TIP_MM, f64::INFINITY)];
    let from = |(low, high): (f64, f64)| best_path(chain, &solved, |x| x[0] > low && x[0] <= high);
    starts.into_iter().filter_map(from).collect()
}

fn best_path(
    chain: &Chain<'_>,
    solved: &[Vec<Candidate>],
    begins: impl Fn(&State) -> bool,
) -> Option<Vec<State>> {
    let n = solved.first()?.len();
    let ei = chain.wire.ei_nmm2;
    // Spread of a node across the surface: noise by compliance, and half the distance of two nodes along the normal.
    let spread = |k: usize, i: usize| -> f64 {
        let Some((x, y)) = &solved[k][i] else { return f64::INFINITY };
        let noise = (chain.rows[k].noise_nmm2.trace() / 2.0).sqrt() * y.arclength_mm().powi(2) / (3.0 * ei);
        let next = solved[k][(i + 1).min(n - 1)].as_ref().map_or(0.0, |(z, w)| match z[0] > x[0] {
            true => (w.point_mm() - y.point_mm()).dot(&y.normal()) / 2.0,
            false => 0.0,
        });
        noise.hypot(next)
    };
    let first = |c: &Candidate| {
        let deflection = c.as_ref().filter(|c| begins(&c.0)).map(|(x, y)| chain.deflection(0, x, y));
        deflection.filter(|d| *d < MAX_DEFLECTION).map_or(f64::INFINITY, |d| d * d)
    };
    let mut costs: Vec<f64> = solved[0].iter().map(first).collect();
    let mut from: Vec<Vec<usize>> = Vec::new();
    for k in 1..solved.len() {
        let (next, best) = step(chain, solved, k, &costs, &spread);
        costs = next;
        from.push(best);
    }
    if chain.slips_off {
        for (i, cost) in costs.iter_mut().enumerate() {
            if let Some((x, _)) = &solved[solved.len() - 1][i] {
                *cost += ((chain.wire.length_mm - x[0]).max(0.0) / 2.0).powi(2).min(30.0);
            }
        }
    }
    let mut at = (0..n).min_by(|a, b| costs[*a].total_cmp(&costs[*b])).filter(|i| costs[*i].is_finite())?;
    let mut path = vec![solved[solved.len() - 1][at]?.0];
    for k in (0..from.len()).rev() {
        at = from[k][at];
        path.push(solved[k][at]?.0);
    }
    path.reverse();
    Some(path)
}

/// Costs of the nodes of reading k, and the node of the reading before that each comes from.
fn step(
    chain: &Chain<'_>,
    solved: &[Vec<Candidate>],
    k: usize,
    costs: &[f64],
    spread: &dyn Fn(usize, usize) -> f64,
) -> (Vec<f64>, Vec<usize>) {
    let n = costs.len();
    let (mut next, mut best) = (vec![f64::INFINITY; n], vec![0; n]);
    let reach = 4.0 * chain.step_mm[k] + 4.0;
    let slip = 2.0 * chain.step_mm[k] + 1.0;
    let spreads: [Vec<f64>; 2] = [k - 1, k].map(|k| (0..n).map(|i| spread(k, i)).collect());
    for (i, to) in solved[k].iter().enumerate() {
        let Some((x, y)) = to else { continue };
        for (j, at) in solved[k - 1].iter().enumerate() {
            let Some((x0, y0)) = at else { continue };
            let dq = x[0] - x0[0];
            // A jump of the force leads to another branch of equilibria.
            let jump = (x[1] - x0[1]).abs() > MAX_JUMP * (x[1] + x0[1]) + chain.jump_n(k);
            if dq.abs() > reach || jump {
                continue;
            }
            let off = (y.point_mm() - y0.point_mm()).dot(&(y.normal() + y0.normal())) * 0.5;
            let variance = STEP_SD_MM.powi(2) + spreads[0][j].powi(2) + spreads[1][i].powi(2);
            let cost = costs[j] + 5.0 * (off * off / variance / 4.0).ln_1p() + (dq / slip).powi(2);
            if cost < next[i] {
                (next[i], best[i]) = (cost, j);
            }
        }
    }
    (next, best)
}

/// A share of the way from one state to another; azimuths the short way round.
pub(super) fn between_states(a: &State, b: &State, u: f64) -> State {
    let mut b = *b;
    b[2] += TAU * ((a[2] - b[2]) / TAU).round();
    a * (1.0 - u) + b * u
}

/// Contacts at all nodes and parts of each reading.
fn candidates(chain: &Chain<'_>) -> Vec<Vec<Candidate>> {
    let places = places(chain.wire.length_mm);
    let mut last: Vec<Option<State>> = vec![None; places.len()];
    let mut high: Vec<Option<State>> = vec![None; places.len()];
    let mut all = Vec::with_capacity(chain.rows.len());
    for row in chain.rows {
        let moment = Vector2::from(row.moment_nmm);
        for (state, q) in last.iter_mut().zip(&places) {
            *state = chain
                .wire
                .frictionless(*q, &moment, *state)
                .or_else(|| chain.wire.frictionless(*q, &moment, None));
        }
        for (state, low) in high.iter_mut().zip(&last) {
            *state = low.as_ref().and_then(|low| chain.wire.past_fold(low, &moment));
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
                    fine.push(between.map(|x| (x, chain.wire.show(&x).on_object(&row.turn, &row.moved_mm))));
                }
            }
        }
        all.push(fine);
    }
    all
}
