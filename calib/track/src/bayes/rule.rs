//! How a contact may get from one node to another between two samples.

use super::BayesSettings;
use crate::{Candidate, StaticInverse};
use nalgebra::Vector3;
use statrs::function::erf::erfc;
use std::f64::consts::{SQRT_2, TAU};

/// Ways on the surface beyond so many times the mean one are left to springs.
const REACH: f64 = 6.0;
/// Space in which a sprung contact may be anywhere, mm^3.
const SPRING_MM3: f64 = 2e4;
/// Probability that a sprung contact is the tip's, and moments that it may then have, (N mm)^2.
const TIP_SHARE: f64 = 0.3;
const SPRING_NMM2: f64 = 10.0;
/// Length of wire that the tip stands for at a first touch, mm.
const TIP_MM: f64 = 1.0;

/// Candidates of two samples, with what the rule needs of each.
pub(super) struct Rule<'a> {
    settings: &'a BayesSettings,
    inverse: &'a StaticInverse,
    before: &'a [Candidate],
    now: &'a [Candidate],
    /// Variance by rounding to nodes and by the moments' noise, mm^2.
    spread_before: Vec<f64>,
    spread: Vec<f64>,
    /// How the force turns from node to node.
    turns: Vec<Vector3<f64>>,
    /// Nodes from here on are the tip's.
    first_tip: usize,
}

/// What one step of the base allows.
struct Step {
    /// Way of the base along +z, mm.
    way_mm: f64,
    /// Mean way on the surface, mm.
    slide_mm: f64,
    /// Mean turn of the force at the tip, rad.
    turn: f64,
}

/// Half the difference between a node's neighbours.
fn pitch(candidates: &[Candidate], k: usize, of: fn(&Candidate) -> Vector3<f64>) -> Vector3<f64> {
    let (low, high) = (k.saturating_sub(1), (k + 1).min(candidates.len() - 1));
    (of(&candidates[high]) - of(&candidates[low])) / (high - low) as f64
}

/// How far the rule is off where a contact lies anywhere between a node's neighbours' middles, and by the noise, as variance, mm^2.
fn spread(candidates: &[Candidate], noise_nmm: f64) -> Vec<f64> {
    let one = |(k, c): (usize, &Candidate)| {
        c.normal.dot(&pitch(candidates, k, |c| c.point_mm)).powi(2) / 12.0
            + (noise_nmm * c.give_mm_per_nmm).powi(2)
    };
    candidates.iter().enumerate().map(one).collect()
}

impl<'a> Rule<'a> {
    pub(super) fn new(
        settings: &'a BayesSettings,
        inverse: &'a StaticInverse,
        before: &'a [Candidate],
        now: &'a [Candidate],
    ) -> Self {
        Self {
            settings,
            inverse,
            before,
            now,
            spread_before: spread(before, settings.noise_nmm),
            spread: spread(now, settings.noise_nmm),
            turns: (0..now.len()).map(|k| pitch(now, k, |c| c.normal)).collect(),
            first_tip: inverse.nodes.iter().position(|n| n.lean > 0.0).unwrap_or(now.len()),
        }
    }

    /// Weights at a first touch: anywhere in space, but no deeper than the base went since the wire was at rest (mm; `None`: unknown).
    pub(super) fn touched(&self, way_mm: Option<f64>) -> Vec<f64> {
        let turned: f64 = self.turns[self.first_tip..].iter().map(Vector3::norm).sum();
        let one = |(j, c): (usize, &Candidate)| {
            if !c.reachable {
                return 0.0;
            }
            let space = if j < self.first_tip {
                c.volume
            } else {
                TIP_MM * self.across(c) * self.turns[j].norm() / turned.max(1e-12)
            };
            let deep = way_mm.map_or(1.0, |way_mm| {
                let off = c.normal.dot(&(c.point_mm - self.before[j].point_mm + Vector3::z() * way_mm));
                let variance = self.variance(way_mm) + self.spread[j];
                0.5 * erfc(off / (SQRT_2 * variance.sqrt()))
            });
            space * deep
        };
        self.now.iter().enumerate().map(one).collect()
    }

    /// Weights after a step of the base, mm, from those before; smaller ones than `least` are dropped.
    pub(super) fn moved(&self, row: &[f64], least: f64, way_mm: f64) -> Vec<f64> {
        let s = self.settings;
        let step = Step {
            way_mm,
            slide_mm: s.slide_mm + s.slide_share * way_mm.abs(),
            turn: s.turn + s.turn_per_mm * way_mm.abs(),
        };
        let mut new = vec![0.0; self.now.len()];
        for (k, weight) in row.iter().enumerate().filter(|(_, w)| **w > least) {
            self.along_wire(k, *weight, &step, &mut new);
            self.round_tip(k, *weight, &step, &mut new);
        }
        let total: f64 = row.iter().sum();
        let tip_nodes = (self.now.len() - self.first_tip).max(1) as f64;
        for (j, (w, c)) in new.iter_mut().zip(self.now).enumerate() {
            // After a spring the contact is anywhere in space, or at the tip with any moments.
            let anywhere = if j < self.first_tip {
                (1.0 - TIP_SHARE) * c.volume / SPRING_MM3
            } else {
                TIP_SHARE / (tip_nodes * SPRING_NMM2)
            };
            *w = if c.reachable { *w + s.spring * total * anywhere } else { 0.0 };
        }
        new
    }

    /// To nodes on the wire. From the tip only where its force is about square to the wire: there both meet.
    fn along_wire(&self, k: usize, weight: f64, step: &Step, new: &mut [f64]) {
        let from = &self.before[k];
        let mut weight = weight / (TAU * step.slide_mm.powi(2));
        if k >= self.first_tip {
            weight *= (-(from.normal - self.before[self.first_tip - 1].normal).norm() / step.turn).exp();
        }
        let reach_mm = step.way_mm.abs() + REACH * step.slide_mm;
        let near = |c: &&Candidate| (c.point_mm - from.point_mm).norm() < reach_mm;
        let here = k.min(self.first_tip - 1);
        let on = self.now[here..self.first_tip].iter().take_while(near).count();
        let inward = self.now[..here].iter().rev().take_while(near).count();
        for (j, new) in new.iter_mut().enumerate().take(here + on).skip(here - inward) {
            let (density, slid) = self.density(k, j, step.way_mm);
            *new += weight * density * (-slid.norm() / step.slide_mm).exp() * self.now[j].volume;
        }
    }

    /// To the tip: past the wire's end the way on the surface goes on as a turn of the force.
    fn round_tip(&self, k: usize, weight: f64, step: &Step, new: &mut [f64]) {
        if self.first_tip == self.now.len() {
            return;
        }
        let nodes = &self.inverse.nodes;
        let past = if k < self.first_tip {
            let left_mm = nodes[self.first_tip].arclength_mm - nodes[k].arclength_mm;
            0.5 * (-left_mm / step.slide_mm).exp()
        } else {
            1.0
        };
        if past < 1e-6 {
            return;
        }
        let shares = self.turned(&self.before[k].normal, step.turn);
        for (j, share) in (self.first_tip..).zip(shares).filter(|(_, share)| *share > 0.0) {
            let (density, slid) = self.density(k, j, step.way_mm);
            let c = &self.now[j];
            let Some(aside) = c.area.cross(&c.normal).try_normalize(1e-12) else { continue };
            let aside = (-slid.dot(&aside).abs() / step.slide_mm).exp() / (2.0 * step.slide_mm);
            new[j] += weight * past * share * density * aside * self.across(c);
        }
    }

    /// Area that a unit square of moments stands for, as the force sees it, mm^2/(N mm)^2.
    fn across(&self, c: &Candidate) -> f64 {
        (c.area.norm_squared() - c.area.dot(&c.normal).powi(2)).max(0.0).sqrt()
    }

    /// Shares of the tip's nodes after a turn of the force from a direction.
    fn turned(&self, from: &Vector3<f64>, turn: f64) -> Vec<f64> {
        let nodes = self.first_tip..self.now.len();
        let share = |j: usize| {
            if !self.now[j].reachable {
                return 0.0;
            }
            let pitch = self.turns[j].norm();
            let scale = turn.max(0.5 * pitch);
            pitch * (-(self.now[j].normal - from).norm() / scale).exp() / scale
        };
        let mut shares: Vec<f64> = nodes.clone().map(share).collect();
        let total: f64 = shares.iter().sum::<f64>().max(1e-12);
        let any = self.settings.turn_any;
        let each = any / nodes.len() as f64;
        for (share, j) in shares.iter_mut().zip(nodes) {
            *share = if self.now[j].reachable { (1.0 - any) * *share / total + each } else { 0.0 };
        }
        shares
    }

    fn variance(&self, way_mm: f64) -> f64 {
        self.settings.rule_mm.powi(2) + (self.settings.rule_share * way_mm).powi(2)
    }

    /// Density of what node `k` before and `j` now break the rule by, 1/mm, and the way on the surface, mm.
    fn density(&self, k: usize, j: usize, way_mm: f64) -> (f64, Vector3<f64>) {
        let (s, before, to) = (self.settings, &self.before[k], &self.now[j]);
        let way = to.point_mm - before.point_mm + Vector3::z() * way_mm;
        let normal = (before.normal + to.normal).try_normalize(0.1).unwrap_or(to.normal);
        let off = normal.dot(&way);
        let slid = way - normal * off;
        let variance = self.variance(way_mm)
            + self.spread_before[k]
            + self.spread[j]
            + self.turns[j].dot(&way).powi(2) / 12.0;
        // Round an edge the way before it and that behind it count half the turn, one for and one against.
        let edge = variance + ((to.normal - before.normal).norm_squared() * slid.norm_squared()) / 12.0;
        let wide = edge + s.wide_mm.powi(2) + s.wide_share.powi(2) * slid.norm_squared();
        let gauss = |variance: f64| (-0.5 * off * off / variance).exp() / (TAU * variance).sqrt();
        let narrow = (1.0 - s.edge - s.wide) * gauss(variance) + s.edge * gauss(edge);
        (narrow + s.wide * gauss(wide), slid)
    }
}
