//! How a contact may get from one node to another between two samples.

use super::BayesSettings;
use super::cell::{Cell, FARTHEST, Linked, Within};
use super::side::{Place, Side};
use crate::{Candidate, StaticInverse};
use nalgebra::Vector3;
use statrs::function::erf::erfc;
use std::f64::consts::SQRT_2;

/// Ways along the wire beyond so many standard deviations are left to springs.
const REACH: f64 = 5.0;
/// Length of the wire that a contact may spring to when it goes anywhere, mm.
const WIRE_MM: f64 = 56.0;
/// Probability that a tip under a square force moves on to the wire, and how fast it falls with the lean, rad.
const LEAVES: f64 = 0.1;
const LEANT: f64 = 0.05;
/// Least share of a first touch's probability where wires are hardly touched first.
const TOUCH_LEAST: f64 = 0.02;
/// Length of wire that the tip stands for at a first touch, mm.
const TIP_MM: f64 = 1.0;
/// Weights below this share of all are dropped.
const SMALL: f64 = 5e-5;
/// Share of the belief from which on a place can be sprung from.
const SPRINGS_FROM: f64 = 1e-3;

/// Candidates of two samples, with what the rule needs of each.
pub(super) struct Rule<'a> {
    settings: &'a BayesSettings,
    inverse: &'a StaticInverse,
    before: Side<'a>,
    now: Side<'a>,
    /// Nodes from here on are the tip's.
    first_tip: usize,
}

/// What one step of the base allows.
struct Step {
    /// Way of the base along +z, mm, and its variance where the speed is one of several.
    way_mm: f64,
    way_variance_mm2: f64,
    /// Part of the force along the surface against a slide, and its variance.
    drag: f64,
    drag_variance: f64,
    /// Variances of the way along the wire, mm^2, and of the turn at the tip, rad^2: steady, unsteady, changed.
    slides: [f64; 3],
    turns: [f64; 3],
    /// Reach along the wire, mm, and scale of ways beyond its end, mm.
    reach_mm: f64,
    slide_mm: f64,
}

/// What the rule says of a place before and a node now.
struct Off {
    /// First measurement, by which the touched point leaves the object's surface.
    rule: Linked,
    /// Its variance where the rule is broken, mm^2.
    wide: f64,
    way_on_surface: Vector3<f64>,
}

impl<'a> Rule<'a> {
    pub(super) fn new(
        settings: &'a BayesSettings,
        inverse: &'a StaticInverse,
        before: &'a [Candidate],
        now: &'a [Candidate],
    ) -> Self {
        let first_tip = inverse.first_tip();
        let side = |all| Side::new(all, first_tip);
        Self { settings, inverse, before: side(before), now: side(now), first_tip }
    }

    /// Weights at a first touch: as probable along the wire and round it everywhere, but no deeper than the base went since the wire was at
    /// rest (mm; `None`: unknown).
    pub(super) fn touched(&self, way_mm: Option<f64>, way_sd_mm: f64) -> Vec<Cell> {
        let now = &self.now;
        let turned: f64 = now.turns[self.first_tip..].iter().map(Vector3::norm).sum();
        let pitch_mm = self.node_mm();
        let end_mm = self.inverse.nodes.last().map_or(1.0, |n| n.arclength_mm);
        let one = |(j, c): (usize, &Candidate)| {
            if !c.reachable {
                return Cell::default();
            }
            let length_mm =
                if j < self.first_tip { pitch_mm } else { TIP_MM * now.turns[j].norm() / turned.max(1e-12) };
            let [mean, sd] = self.settings.touch_at;
            let off = (self.inverse.nodes[j].arclength_mm / end_mm - mean) / sd;
            let here = TOUCH_LEAST + (-0.5 * off * off).exp();
            let deep = way_mm.map_or(1.0, |way_mm| {
                let off = c.normal.dot(&(c.point_mm - self.before.all[j].point_mm + Vector3::z() * way_mm));
                let variance = self.variance(way_mm)
                    + (self.settings.noise_nmm * c.give_mm_per_nmm).powi(2)
                    + (c.normal.z * way_sd_mm).powi(2);
                0.5 * erfc(off / (SQRT_2 * variance.sqrt()))
            });
            Cell::evenly(length_mm * here * c.give_mm_per_nmm * deep)
        };
        now.all.iter().enumerate().map(one).collect()
    }

    /// Distance of two nodes on the wire, mm.
    fn node_mm(&self) -> f64 {
        match self.inverse.nodes[..] {
            [a, b, ..] => b.arclength_mm - a.arclength_mm,
            _ => 1.0,
        }
    }

    /// Weights after a step of the base, mm, with its standard deviation, under a coefficient of friction, from those before, which are
    /// some of all that make `total`.
    pub(super) fn moved(&self, row: &[Cell], total: f64, way: [f64; 2], friction: f64) -> Vec<Cell> {
        let s = self.settings;
        let [way_mm, way_sd_mm] = way;
        // Of a force at the friction cone's edge the part along the surface.
        let along = |f: f64| f / (1.0 + f * f).sqrt();
        let way = way_mm.abs().max(1e-3);
        let by_way = |of: [f64; 2]| (of[0] + of[1] * way).powi(2);
        let slides = [s.steady, s.unsteady, s.changed].map(by_way);
        let step = Step {
            way_mm,
            way_variance_mm2: way_sd_mm * way_sd_mm,
            drag: along(friction),
            drag_variance: if friction > 0.0 { s.friction_sd * s.friction_sd } else { 0.0 },
            slides,
            turns: [s.tip_steady, s.tip_unsteady, s.tip_changed].map(by_way),
            reach_mm: (1.0 + s.changed_mean.abs()) * way + REACH * slides[2].sqrt(),
            slide_mm: slides[2].sqrt(),
        };
        let mut new = vec![Within::default(); self.now.all.len()];
        let share = (s.spring_per_mm * way).min(0.5);
        for (k, cell) in row.iter().enumerate().filter(|(_, c)| c.weight > SMALL * total) {
            let from = self.before.place(k, cell);
            self.along_wire(k, (1.0 - share) * cell.weight, &from, &step, &mut new);
            self.round_tip(k, (1.0 - share) * cell.weight, &from, &step, &mut new);
            if cell.weight > SPRINGS_FROM * total {
                self.sprung(k, share * cell.weight, &from, &step, &mut new);
            }
        }
        let both = new.iter().zip(self.now.all);
        both.map(|(w, c)| if c.reachable { w.cell() } else { Cell::default() }).collect()
    }

    /// To nodes that a contact springs to: against the force, away from what held it; not far along the wire as a rule, rarely anywhere.
    fn sprung(&self, k: usize, weight: f64, from: &Place<'_>, step: &Step, new: &mut [Within]) {
        let s = self.settings;
        let node_mm = self.node_mm();
        let at_tip = k >= self.first_tip;
        let to_tip = if at_tip { s.spring_at_tip } else { s.spring_to_tip };
        let from_mm = self.inverse.nodes[k].arclength_mm;
        let [inward, outward] = s.spring_mm;
        let turned: f64 = self.now.turns[self.first_tip..].iter().map(Vector3::norm).sum();
        for (j, new) in new.iter_mut().enumerate() {
            let c = &self.now.all[j];
            if !c.reachable {
                continue;
            }
            let share = if j < self.first_tip {
                let along = self.inverse.nodes[j].arclength_mm - from_mm;
                let scale = if along > 0.0 { outward } else { inward };
                let near = (-along.abs() / scale).exp() / (inward + outward);
                (1.0 - to_tip) * node_mm * ((1.0 - s.spring_anywhere) * near + s.spring_anywhere / WIRE_MM)
            } else {
                to_tip * self.now.turns[j].norm() / turned.max(1e-9)
            };
            let normal = (from.normal + c.normal).try_normalize(0.1).unwrap_or(c.normal);
            let off = normal.dot(&(c.point_mm - from.point_mm + Vector3::z() * step.way_mm));
            let fallen = if off < 0.0 {
                let one = |mm: f64| (off / mm).exp() / mm;
                0.5 * (1.0 - s.spring_back) * (one(s.spring_off_mm[0]) + one(s.spring_off_mm[1]))
            } else {
                s.spring_back * (-off / s.spring_off_mm[0]).exp() / s.spring_off_mm[0]
            };
            let turn = self.now.asides[j]
                .map_or(0.0, |aside| fall(aside.dot(&(c.normal - from.normal)), s.spring_turn));
            new.add(
                &Within::anywhere(weight * share * fallen * turn * c.give_mm_per_nmm * c.turn_per_nmm),
                1.0,
            );
        }
    }

    /// To nodes on the wire. From the tip only where its force is about square to the wire: there both meet.
    fn along_wire(&self, k: usize, weight: f64, from: &Place<'_>, step: &Step, new: &mut [Within]) {
        let mut weight = weight;
        let at_tip = k >= self.first_tip;
        if at_tip {
            let leant = (from.normal - self.before.all[self.first_tip - 1].normal).norm();
            weight *= LEAVES * (-leant / (LEANT + step.turns[2].sqrt())).exp();
            if weight < 1e-12 {
                return;
            }
        }
        let node_mm = self.node_mm();
        let here = k.min(self.first_tip - 1);
        let from_mm =
            self.inverse.nodes[here].arclength_mm + if at_tip { 0.0 } else { from.cell.at * node_mm };
        let nodes = (step.reach_mm / node_mm).ceil() as usize;
        let paces = self.paces(&step.slides, from.cell, step, self.settings.changed_mean);
        for (j, new) in new
            .iter_mut()
            .enumerate()
            .take((here + nodes + 1).min(self.first_tip))
            .skip(here.saturating_sub(nodes))
        {
            if !self.now.all[j].reachable {
                continue;
            }
            let along = self.inverse.nodes[j].arclength_mm - from_mm;
            let by_from = if at_tip { 0.0 } else { -node_mm };
            let off = self.off(from, j, step);
            self.arrive(from, j, weight * node_mm, step, &off, &paces, [along, by_from, node_mm], new);
        }
    }

    /// Foretold way along the curve and its variance: steady, unsteady, changed.
    fn paces(&self, variances: &[f64; 3], cell: &Cell, step: &Step, changed_mean: f64) -> [(f64, f64); 3] {
        let way = step.way_mm.abs();
        let kept = cell.pace_variance * way * way;
        let mean = cell.pace * way;
        [(mean, variances[0] + kept), (mean, variances[1] + kept), (changed_mean * way, variances[2])]
    }

    /// Adds what comes from a place to node `j`, whose way along the curve, and how that changes with the place before and now, is `along`.
    #[allow(clippy::too_many_arguments)]
    fn arrive(
        &self,
        from: &Place<'_>,
        j: usize,
        weight: f64,
        step: &Step,
        off: &Off,
        paces: &[(f64, f64); 3],
        along: [f64; 3],
        new: &mut Within,
    ) {
        let (s, c) = (self.settings, &self.now.all[j]);
        // What no place of the node and about the one before can mend.
        let mended =
            0.5 * off.rule.by_to[0].abs() + 3.0 * off.rule.by_from[0].abs() * off.rule.variance.sqrt();
        let left = (off.rule.off[0].abs() - mended).max(0.0).powi(2);
        if left > FARTHEST * off.wide {
            return;
        }
        let way = step.way_mm.abs().max(1e-3);
        let [unsteady, changed] = [s.unsteady_share, s.changed_share];
        let shares = [1.0 - unsteady - changed, unsteady, changed];
        let mut within = Within::default();
        let mut add = |share: f64, noise: f64, (mean, variance): (f64, f64)| {
            let linked = Linked {
                off: [off.rule.off[0], along[0] - mean],
                by_from: [off.rule.by_from[0], along[1]],
                by_to: [off.rule.by_to[0], along[2]],
                noise: [noise, variance],
                variance: off.rule.variance,
            };
            within.add(&Within::linked(&linked, mean, way), share);
        };
        for (share, pace) in shares.into_iter().zip(paces).filter(|_| left < FARTHEST * off.rule.noise[0]) {
            add(share * (1.0 - s.wide), off.rule.noise[0], *pace);
        }
        add(s.wide, off.wide, paces[2]);
        if within.weight > 0.0 {
            let turned = self.turn_density(from, j, step);
            new.add(
                &within,
                weight * turned * self.far(&off.way_on_surface, step) * c.give_mm_per_nmm * c.turn_per_nmm,
            );
        }
    }

    /// Density of the force's turn about the wire, 1/rad.
    fn turn_density(&self, from: &Place<'_>, j: usize, step: &Step) -> f64 {
        let (s, c) = (self.settings, &self.now.all[j]);
        let Some(aside) = &self.now.asides[j] else { return 0.0 };
        let turn = aside.dot(&(c.normal - from.normal));
        let noise = s.noise_nmm * root(from.turn_per_nmm, c.turn_per_nmm);
        let scale = |of: [f64; 2]| root(of[0] + of[1] * step.way_mm.abs(), noise);
        let [gentle, sharp] = [scale(s.bend), scale(s.sharp)];
        (1.0 - s.sharp_share) * fall(turn, gentle) + s.sharp_share * fall(turn, sharp)
    }

    /// What speaks against a way on the surface that is longer than the base's.
    fn far(&self, slid: &Vector3<f64>, step: &Step) -> f64 {
        let over = slid.norm() - 1.2 * step.way_mm.abs();
        if over > 0.0 { (-over / step.slide_mm).exp() } else { 1.0 }
    }

    /// To the tip: past the wire's end the way on the surface goes on as a turn of the force.
    fn round_tip(&self, k: usize, weight: f64, from: &Place<'_>, step: &Step, new: &mut [Within]) {
        if self.first_tip == self.now.all.len() {
            return;
        }
        let nodes = &self.inverse.nodes;
        let at_tip = k >= self.first_tip;
        let past = if at_tip {
            1.0
        } else {
            let left_mm = nodes[self.first_tip].arclength_mm - nodes[k].arclength_mm;
            0.5 * (-left_mm / step.slide_mm).exp()
        };
        if past < 1e-6 {
            return;
        }
        let turned: f64 = self.now.turns[self.first_tip..].iter().map(Vector3::norm).sum();
        let unknown = Cell { weight: 0.0, ..Cell::default() };
        let paces = self.paces(&step.turns, if at_tip { from.cell } else { &unknown }, step, 0.0);
        let any = self.settings.turn_any;
        for (j, new) in new.iter_mut().enumerate().skip(self.first_tip) {
            let c = &self.now.all[j];
            let pitch = self.now.turns[j].norm();
            if !c.reachable || pitch < 1e-6 {
                continue;
            }
            let lean = self.now.turns[j] / pitch;
            let along = [
                lean.dot(&(c.normal - from.normal)),
                if at_tip { -lean.dot(&from.turn) } else { 0.0 },
                pitch,
            ];
            let off = self.off(from, j, step);
            self.arrive(from, j, weight * past * (1.0 - any) * pitch, step, &off, &paces, along, new);
            let anywhere = Within::first(&off.rule);
            if anywhere.weight > 0.0 {
                let turn = self.turn_density(from, j, step) * self.far(&off.way_on_surface, step);
                let share = any * pitch / turned.max(1e-9);
                new.add(&anywhere, weight * past * share * turn * c.give_mm_per_nmm * c.turn_per_nmm);
            }
        }
    }

    fn variance(&self, way_mm: f64) -> f64 {
        self.settings.rule_mm.powi(2) + (self.settings.rule_share * way_mm).powi(2)
    }

    /// Slide over the object across the wire times its share of the whole slide, mm: by so much times the force's part along the surface
    /// that force, and not the surface's normal, finds the touched point to go in.
    fn dragged(&self, from: &Place<'_>, j: usize, way: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
        let pitch = self.now.pitches[j];
        let Some(along) = (pitch - normal * normal.dot(&pitch)).try_normalize(1e-9) else { return 0.0 };
        let across = way.dot(&along.cross(normal));
        // What the wire itself went along with is no slide.
        let nodes = &self.inverse.nodes;
        let last = self.first_tip - 1;
        let gone = nodes[j.min(last)].arclength_mm
            - nodes[from.node.min(last)].arclength_mm
            - from.cell.at * self.node_mm();
        let slid = root(across, way.dot(&along) - gone);
        if slid > 1e-9 { across * across / slid } else { 0.0 }
    }

    /// By how much a place before and node `j` now break the rule, mm.
    fn off(&self, from: &Place<'_>, j: usize, step: &Step) -> Off {
        let (s, to, way_mm) = (self.settings, &self.now.all[j], step.way_mm);
        let (pitch, turn) = (self.now.pitches[j], self.now.turns[j]);
        let way = to.point_mm - from.point_mm + Vector3::z() * way_mm;
        let normal = (from.normal + to.normal).try_normalize(0.1).unwrap_or(to.normal);
        let dragged = if step.drag > 0.0 { self.dragged(from, j, &way, &normal) } else { 0.0 };
        let out = normal.dot(&way);
        let off = out + step.drag * dragged;
        // How that changes from node to node: with the place and with the force, half of whose turn counts.
        let by_to = normal.dot(&pitch) + 0.5 * turn.dot(&way);
        let by_from = -normal.dot(&from.pitch) + 0.5 * from.turn.dot(&way);
        let gives = from.give_mm_per_nmm.powi(2) + to.give_mm_per_nmm.powi(2);
        let slid = way - normal * out;
        // On a bent surface the way before the middle and that behind it count half the turn, one for and one against.
        let bent = (to.normal - from.normal).norm_squared() * slid.norm_squared() * s.edge * s.edge;
        let noise = self.variance(way_mm)
            + s.noise_nmm.powi(2) * gives
            + normal.z * normal.z * step.way_variance_mm2
            + step.drag_variance * dragged * dragged
            + bent;
        let rule = Linked {
            off: [off, 0.0],
            by_from: [by_from, 0.0],
            by_to: [by_to, 0.0],
            noise: [noise, 1.0],
            variance: from.cell.variance,
        };
        let wide = noise + s.wide_mm.powi(2) + s.wide_share.powi(2) * slid.norm_squared();
        Off { rule, wide, way_on_surface: slid }
    }
}

/// Root of two squares.
fn root(a: f64, b: f64) -> f64 {
    (a * a + b * b).sqrt()
}

/// Laplace's density.
fn fall(x: f64, scale: f64) -> f64 {
    (-x.abs() / scale).exp() / (2.0 * scale)
}
