//! Choice between candidates.
//!
//! S_cm = sum_g S_cmg: squared left-out errors of candidate c, moment m, group g (trajectory or
//! pose). Best b: least prod_m S_cm. Excess of c over b: D_c = sum_g d_g, d_g = 1/2 sum_m (S_cmg -
//! S_bmg) / S_bm, with standard error sqrt(G / (G - 1) sum_g (d_g - D_c / G)^2) over G groups.
//! Chosen: the first (simplest) with D_c <= its standard error (or 0.001: refits agree to
//! rounding). Source: L. Breiman et al., "Classification and Regression Trees" (1984), sec. 3.4.3,
//! paired.

use crate::candidate::CandidateFit;
use crate::training::MapTraining;
use std::collections::BTreeMap;

/// Relative excess below which two candidates count as equal: refits agree to rounding, not to the
/// bit.
const EQUAL: f64 = 1e-3;

/// The choice and what it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    /// Index of the chosen candidate.
    pub chosen: usize,
    /// Index of the candidate with the smallest error.
    pub best: usize,
    /// `loto` or `loo`.
    pub by: &'static str,
    /// Mean relative excess of each candidate's squared error over the best one's.
    pub excess: Vec<f64>,
    /// Its standard error over trajectories (or poses).
    pub excess_se: Vec<f64>,
}

/// Chooses by leave-one-trajectory-out error (leave-one-out with fewer than three trajectories).
///
/// The best candidate has the smallest product of the two moments' mean squared errors. The first
/// candidate in the given order (simplest first) whose squared error exceeds the best one's by no
/// more than one standard error of the paired difference over trajectories is chosen (the
/// one-standard-error rule of Breiman et al. 1984, paired).
pub fn choose(candidates: &[CandidateFit], training: &MapTraining) -> Choice {
    let by_trajectory = candidates.iter().all(|c| c.loto.is_some());
    let group_of: Vec<usize> = if by_trajectory {
        training
            .trajectory
            .iter()
            .map(|t| t.map_or(usize::MAX, |t| t as usize))
            .collect()
    } else {
        let mut of = vec![0; training.len()];
        for (g, members) in training.pose_groups().iter().enumerate() {
            members.iter().for_each(|i| of[*i] = g);
        }
        of
    };
    // S_cmg: what is independent is the trajectory (or the pose), so errors are summed within it.
    let squares: Vec<[BTreeMap<usize, f64>; 2]> = candidates
        .iter()
        .map(|c| {
            let summaries = c.loto.as_ref().filter(|_| by_trajectory);
            summaries.unwrap_or(&c.loo).each_ref().map(|s| {
                let mut groups = BTreeMap::new();
                for e in &s.errors {
                    *groups.entry(group_of[e.index]).or_insert(0.0) += e.error * e.error;
                }
                groups
            })
        })
        .collect();
    // Labels that a map reproduces exactly would divide by zero.
    let total = |s: &BTreeMap<usize, f64>| s.values().sum::<f64>().max(1e-24);
    // The product of both moments' errors: the scale of neither decides.
    let score = |s: &[BTreeMap<usize, f64>; 2]| total(&s[0]).ln() + total(&s[1]).ln();
    let best = (0..candidates.len())
        .min_by(|a, b| score(&squares[*a]).total_cmp(&score(&squares[*b])))
        .unwrap_or(0);
    // Paired by group: what all candidates find hard in one trajectory drops out of the difference.
    let (mut excess, mut excess_se) = (Vec::new(), Vec::new());
    for candidate in &squares {
        let groups: Vec<f64> = squares[best][0]
            .keys()
            .map(|g| {
                let part = |m: usize| {
                    let of = |s: &[BTreeMap<usize, f64>; 2]| s[m].get(g).copied().unwrap_or(0.0);
                    (of(candidate) - of(&squares[best])) / total(&squares[best][m])
                };
                0.5 * (part(0) + part(1))
            })
            .collect();
        // Standard error of a sum over independent groups.
        let n = groups.len() as f64;
        let sum: f64 = groups.iter().sum();
        let spread: f64 = groups.iter().map(|d| (d - sum / n).powi(2)).sum();
        excess.push(sum);
        excess_se.push(if n > 1.0 {
            (spread * n / (n - 1.0)).sqrt()
        } else {
            0.0
        });
    }
    // The simplest that is not worse by more than chance.
    let chosen = (0..candidates.len())
        .find(|c| excess[*c] <= excess_se[*c].max(EQUAL))
        .unwrap_or(best);
    Choice {
        chosen,
        best,
        by: if by_trajectory { "loto" } else { "loo" },
        excess,
        excess_se,
    }
}
