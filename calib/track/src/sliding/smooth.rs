//! Least squares over the states of all readings, from a first path: Levenberg and Marquardt, first
//! with normal residuals, then with heavy tails.

use super::contact_state::{ContactQuantities, STATE, State};
use super::factors::{Chain, Common, KINDS, Kind, ln_norm};
use crate::known_motion::larger;
use nalgebra::{DVector, Matrix3, SMatrix, Vector3};
use std::f64::consts::{PI, TAU};
use std::ops::Range;
use wcal_core::order_statistics::median;

/// Iterations of a descent, and the improvement at which it ends.
const MAX_STEPS: usize = 30;
const SMALL: f64 = 3e-3;
/// Damping: first, least, most.
const DAMPING: [f64; 3] = [1e-3, 1e-9, 1e6];

/// Descents to sums of squares so near to each other lead to one minimum.
pub(super) const SAME_COST: f64 = 1.0;

/// A smoothed contact.
#[derive(Debug, Clone)]
pub(super) struct Smoothed {
    pub x: Vec<State>,
    pub common: DVector<f64>,
    /// Sum of the squares.
    pub cost: f64,
    /// Descents that ended here.
    pub starts: usize,
}

/// What a smoothed contact says of one block of readings.
#[derive(Debug, Clone, Copy)]
pub(super) struct BlockPosterior {
    /// Axis of the wire at the contact on the object, mm, and its covariance, mm^2.
    pub axis_mm: Vector3<f64>,
    pub covariance_mm2: Matrix3<f64>,
    /// Arc length and its standard deviation, mm.
    pub arclength_mm: f64,
    pub sd_mm: f64,
}

/// From a first path under all friction coefficients, in their order: each begins where its
/// neighbour's descent ended, upward and then back, since a descent that begins far off ends in
/// another minimum.
fn smooth(chain: &mut Chain<'_>, first: Vec<State>, frictions: &[f64]) -> Vec<Smoothed> {
    let start = Smoothed {
        x: first,
        common: chain.prior(),
        cost: f64::INFINITY,
        starts: 1,
    };
    // Friction by the slip comes in last: a descent that begins far off ends elsewhere.
    let start = [(false, false), (false, true)]
        .into_iter()
        .fold(start, |found, (by_slip, heavy)| {
            descend(chain, found, frictions[0], by_slip, heavy)
        });
    let mut found: Vec<Smoothed> = Vec::new();
    for mu in frictions {
        let from = found.last().unwrap_or(&start).clone();
        found.push(descend(chain, from, *mu, true, true));
    }
    // Back again: what a descent from below missed, one from above may find.
    for k in (0..frictions.len() - 1).rev() {
        let back = descend(chain, found[k + 1].clone(), frictions[k], true, true);
        // One branch, both ways along the friction.
        if (back.cost - found[k].cost).abs() <= SAME_COST {
            found[k..k + 2].iter_mut().for_each(|f| f.starts = 2);
        }
        if back.cost < found[k].cost {
            found[k] = Smoothed {
                starts: found[k].starts,
                ..back
            };
        }
    }
    found
}

/// Differences of the sum of squares that tell a coefficient, and halvings of the step between two.
const MIN_COST_RISE: f64 = 2.0;
pub(super) const HALVINGS: usize = 3;

/// As `smooth`, with further coefficients around the best one while the sum of squares tells it
/// from its neighbours.
pub(super) fn refined(
    chain: &mut Chain<'_>,
    first: Vec<State>,
    frictions: &[f64],
    halvings: usize,
) -> Vec<(f64, Smoothed)> {
    let mut found: Vec<(f64, Smoothed)> = frictions
        .iter()
        .copied()
        .zip(smooth(chain, first, frictions))
        .collect();
    for _ in 0..halvings {
        let Some(best) =
            (0..found.len()).min_by(|a, b| found[*a].1.cost.total_cmp(&found[*b].1.cost))
        else {
            break;
        };
        let (mu, at) = found[best].clone();
        let near = [best.checked_sub(1), Some(best + 1)]
            .into_iter()
            .flatten()
            .filter_map(|k| found.get(k));
        let between = near
            .filter(|n| n.1.cost > at.cost + MIN_COST_RISE)
            .map(|n| 0.5 * (n.0 + mu))
            .collect::<Vec<_>>();
        if between.is_empty() {
            break;
        }
        for mu in between {
            let next = descend(chain, at.clone(), mu, true, true);
            found.push((
                mu,
                Smoothed {
                    starts: at.starts,
                    ..next
                },
            ));
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
    }
    found
}

pub(super) fn descend(
    chain: &mut Chain<'_>,
    from: Smoothed,
    friction: f64,
    by_slip: bool,
    heavy: bool,
) -> Smoothed {
    (chain.friction, chain.by_slip, chain.heavy) = (friction, by_slip, heavy);
    let cost = chain.cost(&from.x, &from.common);
    let mut here = Smoothed {
        cost,
        starts: 1,
        ..from
    };
    let [mut damping, least, most] = DAMPING;
    for _ in 0..MAX_STEPS {
        let normal = chain.linearise(&here.x, &here.common, Common::Held, &KINDS);
        let better = loop {
            // Levenberg and Marquardt: more damping until the sum falls, less after it has.
            if let Some(factored) = normal.factor(damping) {
                let (dx, dc) = normal.step(&factored);
                let moved = |(k, x): (usize, &State)| x + dx.fixed_rows::<STATE>(STATE * k);
                let x: Vec<State> = here.x.iter().enumerate().map(moved).collect();
                let common = &here.common + dc;
                let cost = chain.cost(&x, &common);
                if cost < here.cost {
                    damping = (0.1 * damping).max(least);
                    break Some(Smoothed {
                        x,
                        common,
                        cost,
                        starts: 1,
                    });
                }
            }
            damping *= 10.0;
            if damping > most {
                break None;
            }
        };
        let Some(better) = better else { break };
        let gain = here.cost - better.cost;
        here = better;
        if gain < SMALL * (1.0 + 1e-3 * here.cost) {
            break;
        }
    }
    here
}

/// Turn of the normal about the wire from block to block: scale, rad, and degrees of freedom of
/// Student's distribution; edges turn it at once.
const TURN_RAD: f64 = 0.15;
const TURN_TAILS: f64 = 1.0;

/// ln p(m), natural units of 1/(N mm)^2 a block, by Laplace's approximation: the integral over all
/// states and common errors, over that of their prior, which is a density in its own residuals.
/// What has none there is given one: the first azimuth is uniform and turns from block to block as
/// the normal of a surface does; the first place is uniform on the wire, the second one as near as
/// a slip goes.
///
/// The prior at the fit is `|J' J|^1/2 prod_i c_i k(r_i)`, J its residuals' slope, c the norm of
/// each: `1 / sqrt(2 pi)`, or that of Student's t,
/// `Gamma((nu + 1) / 2) / (sqrt(pi nu) Gamma(nu / 2))`, whatever weight the residual has in the
/// fit.
pub(super) fn ln_evidence(chain: &Chain<'_>, found: &Smoothed) -> Option<f64> {
    let turns = found
        .x
        .windows(2)
        .map(|w| (w[1][2] - w[0][2] + PI).rem_euclid(TAU) - PI);
    let turns: Vec<f64> = turns.map(|turn| (turn / TURN_RAD).powi(2)).collect();
    // A Gaussian of precision w integrates to sqrt(2 pi / w): w = 1 / (2 pi) stands for a turn, 2
    // pi / L^2 for L.
    let factored = |chain: &Chain<'_>, kinds: &[Kind]| {
        let mut normal = chain.linearise(&found.x, &found.common, Common::Free, kinds);
        normal.add(1.0 / TAU, 0.0, 2, &[1.0], &[]);
        for (k, turn2) in turns.iter().enumerate() {
            // Student's t as a reweighted square, weight (nu + 1) / (nu + u^2), as in iteratively
            // reweighted least squares.
            let weight = if chain.heavy {
                (TURN_TAILS + 1.0) / (TURN_TAILS + turn2)
            } else {
                1.0
            };
            normal.add(
                weight / TURN_RAD.powi(2),
                0.0,
                STATE * k + 2,
                &[-1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
                &[],
            );
        }
        normal.add(TAU / chain.wire.length_mm.powi(2), 0.0, 0, &[1.0], &[]);
        if let Some(step) = chain.step_mm.get(1) {
            normal.add((2.0 * step + 1.0).powi(-2), 0.0, STATE, &[1.0], &[]);
        }
        Some((normal.factor(0.0)?, normal))
    };
    let mut light = chain.clone();
    light.heavy = false;
    // A path that is so far off its own course that the weights of its tails leave the prior no
    // curvature is none.
    factored(chain, &KINDS[1..])?;
    let ((with, normal), (prior, _)) = (factored(chain, &KINDS)?, factored(&light, &KINDS[1..])?);
    // Laplace: the posterior's volume over the prior's, by their curvatures.
    let occam = 0.5 * (prior.ln_determinant() - with.ln_determinant());
    let turning: f64 = turns
        .iter()
        .map(|turn2| (TURN_TAILS + 1.0) * (turn2 / TURN_TAILS).ln_1p())
        .sum();
    let norms = chain.ln_norms() + turns.len() as f64 * ln_norm(TURN_TAILS);
    Some(norms + chain.ln_densities() - 0.5 * (found.cost + turning - normal.gain(&with)) + occam)
}

/// The posterior at some blocks, by the curvature of the sum of squares; none where it has none.
pub(super) fn posterior(
    chain: &Chain<'_>,
    found: &Smoothed,
    blocks: Range<usize>,
) -> Option<Vec<BlockPosterior>> {
    let factored = chain
        .linearise(&found.x, &found.common, Common::Free, &KINDS)
        .factor(0.0)?;
    let of = |k: usize| {
        let (y, by_state) = axis_by_state(chain, &found.x[k]);
        let own = factored.covariance(STATE * k, STATE);
        let own = SMatrix::<f64, STATE, STATE>::from_fn(|i, j| own[(i, j)]);
        let back = chain.rows[k].turn.inverse();
        let turn = back.matrix();
        BlockPosterior {
            axis_mm: back * (chain.wire.axis_mm(&y) - chain.rows[k].moved_mm),
            covariance_mm2: turn * by_state * own * by_state.transpose() * turn.transpose(),
            arclength_mm: y.arclength_mm(),
            sd_mm: own[(0, 0)].max(0.0).sqrt(),
        }
    };
    Some(blocks.map(of).collect())
}

/// What a contact shows, and the derivative of the wire's axis there by its state.
fn axis_by_state(chain: &Chain<'_>, x: &State) -> (ContactQuantities, SMatrix<f64, 3, STATE>) {
    let (y, rates) = chain.wire.rates(x);
    let radius_mm = (chain.wire.axis_mm(&y) - y.point_mm()).norm();
    // Error propagation from the state to the axis: point and normal times the radius.
    (
        y,
        rates.fixed_rows::<3>(2) + rates.fixed_rows::<3>(5) * radius_mm,
    )
}

/// How far moments that are larger by 1 % move the contact, median over the blocks, mm; none where
/// the sum has no curvature.
pub(super) fn mm_by_gain(chain: &Chain<'_>, found: &Smoothed) -> Option<f64> {
    let larger = larger(chain.rows);
    let mut chain = chain.clone();
    let here = chain.linearise(&found.x, &found.common, Common::Held, &KINDS);
    chain.rows = &larger;
    let there = chain.linearise(&found.x, &found.common, Common::Held, &KINDS);
    // At the least sum its gradient stays zero: the states move by the step that undoes what the
    // gain adds to it.
    let factored = here.factor(0.0)?;
    let moved = there.step(&factored).0 - here.step(&factored).0;
    let of = |(k, x): (usize, &State)| {
        (axis_by_state(&chain, x).1 * moved.fixed_rows::<STATE>(STATE * k)).norm()
    };
    median(found.x.iter().enumerate().map(of))
}
