//! Transition: how a contact gets from one node to another between two samples; `likelihood` says
//! how well that explains the moments.
//!
//! Between samples the base travels by `z = u dt` along its +z, so that the object moves by w = -z
//! e_z. From a contact (p_j, n_j), which goes to (p_j + w, n_j), to node k, with
//! `d = p_k - p_j - w` the path on the object and n the mean direction of the force:
//!
//! ```text
//! constraint     e_1 = n . d + f D,  f = mu / sqrt(1 + mu^2),  D = slip_x^2 / |slip|      (Coulomb friction across the wire)
//! its variance   r_1 = s_c^2 + (q z)^2 + s_m^2 (c_j^2 + c_k^2) + n_z^2 var_z + s_f^2 D^2 + (h |n_k - n_j| |slip|)^2
//! path           e_2 = (s_k - s_j) - v_i z,  r_2 = var_i       i: constant velocity, perturbed, reset
//! turn           about the wire: Laplace mixture of smooth and sharp objects
//! likelihood     p(m) = p(e_1, e_2) p(turn) c_k b_k            c_k = |dg/dm|, b_k = |dturn/dm| (change of variables to the moments)
//! jump           rate per mm of travel; against the force, exponential along the wire or uniform
//! first contact  p(k) ~ length_k  (l + exp(-((s_k / L - a) / sd)^2 / 2))  c_k  Phi(n . (w - p_k + p_k^rest) / sd_g)
//! ```
//!
//! `s_m`: noise of the moments, `c`: compliance of the point along the force by the moments. Source
//! of the scheme: see `filter`; the mixture of outliers is that of G. E. P. Box, G. C. Tiao,
//! Biometrika 55 (1968) 119.

mod likelihood;

use super::exp::exp;
use super::grid_cell::{
    GridCell, LinearGaussianPair, MAX_MAHALANOBIS2, MAX_TRUNCATED_SDS, MomentSums,
};
use super::sample_geometry::{ContactState, SampleGeometry};
use super::settings::BayesSettings;
use crate::inverse::{InverseSolution, StaticInverse};
pub(super) use likelihood::TransitionModel;
use likelihood::{BaseStep, ConstraintResidual, laplace_pdf};
use statrs::function::erf::erfc;
use std::f64::consts::SQRT_2;

/// Paths along the wire beyond this many standard deviations count as jumps, whose density there is
/// tens of times as large.
const MAX_PATH_SDS: f64 = 4.0;
/// Length of wire over which a jump to anywhere is uniform, mm.
const WIRE_MM: f64 = 56.0;
/// Probability that a contact of the tip under a perpendicular force moves on to the wire, and its
/// decay with the tilt, rad.
const TIP_TO_WIRE: f64 = 0.1;
const TIP_TO_WIRE_TILT: f64 = 0.05;
/// Floor of the density of first contacts, where wires are rarely touched first.
const MIN_FIRST_CONTACT: f64 = 0.02;
/// Weights below this share of all are dropped: a larger share loses contacts that would have been
/// found again.
const MIN_WEIGHT: f64 = 5e-5;
/// Smallest share of the posterior, and of the row, for which jumps are computed: while next to
/// nothing is known of the place, none are needed.
const MIN_JUMP_WEIGHT: f64 = 1e-3;
const MIN_JUMP_WEIGHT_OF_ROW: f64 = 0.01;
/// Probability to pass the end of the wire below which nothing does.
const MIN_PAST_END: f64 = 1e-4;

/// A step of the object with what is known of it.
#[derive(Debug, Clone, Copy)]
pub(super) struct KnownStep {
    /// Travel of the base along its +z, mm, and its standard deviation where the base's speed is
    /// one of several.
    pub travel_mm: f64,
    /// See `travel_mm`.
    pub travel_sd_mm: f64,
}

/// Distance of two nodes on the wire, mm.
fn node_mm(inverse: &StaticInverse) -> f64 {
    match inverse.nodes[..] {
        [a, b, ..] => b.arclength_mm - a.arclength_mm,
        _ => 1.0,
    }
}

/// Along the wire: two-sided exponential about where it was, or uniform over the wire.
fn jump_paths(s: &BayesSettings, node_mm: f64, first_tip: usize) -> Vec<f64> {
    let [inward, outward] = s.jump_path_mm;
    let density = |nodes: usize| {
        let along = (nodes as f64 - first_tip as f64) * node_mm;
        let scale = if along > 0.0 { outward } else { inward };
        // inward + outward is the norm of both sides together.
        let near = exp(-along.abs() / scale) / (inward + outward);
        let uniform = s.jump_anywhere_fraction;
        node_mm * ((1.0 - uniform) * near + uniform / WIRE_MM)
    };
    (0..2 * first_tip).map(density).collect()
}

impl<'a> TransitionModel<'a> {
    pub(super) fn new(
        settings: &'a BayesSettings,
        inverse: &'a StaticInverse,
        before: &'a [InverseSolution],
        now: &'a [InverseSolution],
    ) -> Self {
        let first_tip = inverse.first_tip();
        let geometry = |all| SampleGeometry::new(all, first_tip);
        let jump_paths = jump_paths(settings, node_mm(inverse), first_tip);
        Self {
            settings,
            inverse,
            before: geometry(before),
            now: geometry(now),
            first_tip,
            jump_paths,
        }
    }

    /// Prior of a first contact: its density along the wire, uniform round it, and no deeper than
    /// the base's travel since the wire was at rest (`None`: unknown).
    pub(super) fn first_contact_prior(&self, step: Option<&KnownStep>) -> Vec<GridCell> {
        let now = &self.now;
        let pitch_mm = self.node_mm();
        let end_mm = self.inverse.nodes.last().map_or(1.0, |n| n.arclength_mm);
        let one = |(j, c): (usize, &InverseSolution)| {
            if !c.reachable {
                return GridCell::default();
            }
            // Length of wire that the node stands for; the tip's nodes share a millimetre in
            // proportion to the turn of the force.
            let length_mm = if j < self.first_tip {
                pitch_mm
            } else {
                now.turns[j] / now.tip_turn.max(1e-12)
            };
            let [mean, sd] = self.settings.first_contact_at;
            let off = (self.inverse.nodes[j].arclength_mm / end_mm - mean) / sd;
            let along = MIN_FIRST_CONTACT + exp(-0.5 * off * off);
            // Probability that the deflection is at most the base's travel: Phi of the distance
            // over its standard deviation.
            let depth = step.map_or(1.0, |step| {
                let rest = self.before.solutions[j].point_mm;
                let off = c.normal.dot(&(c.point_mm - rest)) + c.normal.z * step.travel_mm;
                let variance = self.constraint_variance(step.travel_mm)
                    + (self.settings.noise_nmm * c.compliance_mm_per_nmm).powi(2)
                    + (c.normal.z * step.travel_sd_mm).powi(2);
                0.5 * erfc(off / (SQRT_2 * variance.sqrt()))
            });
            GridCell::uniform(length_mm * along * c.compliance_mm_per_nmm * depth)
        };
        now.solutions.iter().enumerate().map(one).collect()
    }

    /// Distance of two nodes on the wire, mm.
    fn node_mm(&self) -> f64 {
        node_mm(self.inverse)
    }

    /// Weights after a step of the object under a coefficient of friction, from those before, which
    /// are part of all that sum to `total`.
    pub(super) fn predict(
        &self,
        row: &[GridCell],
        total: f64,
        known: &KnownStep,
        friction: f64,
    ) -> Vec<GridCell> {
        let s = self.settings;
        let (travel_mm, travel_sd_mm) = (known.travel_mm, known.travel_sd_mm);
        // Of a force at the edge of the friction cone the part along the surface: sin(atan(mu)).
        let along = |mu: f64| mu / (1.0 + mu * mu).sqrt();
        // A velocity is a path by the travel, which must not be zero.
        let travel = travel_mm.abs().max(1e-3);
        let variance = |sd: [f64; 2]| (sd[0] + sd[1] * travel).powi(2);
        let path_variances = [s.constant_velocity, s.perturbed, s.reset].map(variance);
        let step = BaseStep {
            travel_mm,
            travel_variance_mm2: travel_sd_mm * travel_sd_mm,
            drag: along(friction),
            drag_variance: if friction > 0.0 {
                s.friction_sd * s.friction_sd
            } else {
                0.0
            },
            path_variances,
            tip_variances: [s.tip_constant_velocity, s.tip_perturbed, s.tip_reset].map(variance),
            reach_mm: (1.0 + s.reset_mean.abs()) * travel + MAX_PATH_SDS * path_variances[2].sqrt(),
            path_sd_mm: path_variances[2].sqrt(),
        };
        // Negligible weights are dropped: they cost as much as the others.
        let mut new = vec![MomentSums::default(); self.now.solutions.len()];
        let jump_share = (s.jump_per_mm * travel).min(0.5);
        let of_row: f64 = row.iter().map(|c| c.weight).sum();
        let least_jump = (MIN_JUMP_WEIGHT * total).max(MIN_JUMP_WEIGHT_OF_ROW * of_row);
        for (k, cell) in row
            .iter()
            .enumerate()
            .filter(|(_, c)| c.weight > MIN_WEIGHT * total)
        {
            let from = self.before.contact(k, cell).carried(travel_mm);
            self.wire_transition(k, (1.0 - jump_share) * cell.weight, &from, &step, &mut new);
            self.tip_transition(k, (1.0 - jump_share) * cell.weight, &from, &step, &mut new);
            if cell.weight > least_jump {
                self.jump_density(k, jump_share * cell.weight, &from, &mut new);
            }
        }
        let both = new.iter().zip(self.now.solutions);
        both.map(|(w, c)| {
            if c.reachable {
                w.cell()
            } else {
                GridCell::default()
            }
        })
        .collect()
    }

    /// Jumps: against the force, away from the surface that held the wire; mostly a short path
    /// along it, rarely to anywhere.
    fn jump_density(&self, k: usize, weight: f64, from: &ContactState<'_>, new: &mut [MomentSums]) {
        let s = self.settings;
        let at_tip = k >= self.first_tip;
        let nearest = k.min(self.first_tip - 1);
        let to_tip = if at_tip {
            s.jump_at_tip_fraction
        } else {
            s.jump_to_tip_fraction
        };
        for (j, new) in new.iter_mut().enumerate() {
            let c = &self.now.solutions[j];
            if !c.reachable {
                continue;
            }
            let share = if j < self.first_tip {
                (1.0 - to_tip) * self.jump_paths[j + self.first_tip - nearest]
            } else {
                to_tip * self.now.turns[j] / self.now.tip_turn.max(1e-9)
            };
            // Off the surface: the wire springs back against the force, mixture of a short and a
            // long scale; rarely in its direction.
            let normal = (from.normal + c.normal)
                .try_normalize(0.1)
                .unwrap_or(c.normal);
            let off = normal.dot(&(c.point_mm - from.point_mm));
            let off_density = if off < 0.0 {
                let one = |mm: f64| exp(off / mm) / mm;
                0.5 * (1.0 - s.jump_back_fraction) * (one(s.jump_off_mm[0]) + one(s.jump_off_mm[1]))
            } else {
                s.jump_back_fraction * exp(-off / s.jump_off_mm[0]) / s.jump_off_mm[0]
            };
            let turn = self.now.turn_axes[j].map_or(0.0, |axis| {
                laplace_pdf(axis.dot(&(c.normal - from.normal)), s.jump_turn_rad)
            });
            // Jacobian from distance and turn to the moments.
            new.add(
                &MomentSums::uniform(
                    weight
                        * share
                        * off_density
                        * turn
                        * c.compliance_mm_per_nmm
                        * c.turn_rad_per_nmm,
                ),
                1.0,
            );
        }
    }

    /// To nodes on the wire. From the tip only where its force is about perpendicular to the wire:
    /// there both parts of the curve meet.
    fn wire_transition(
        &self,
        k: usize,
        weight: f64,
        from: &ContactState<'_>,
        step: &BaseStep,
        new: &mut [MomentSums],
    ) {
        let mut weight = weight;
        let at_tip = k >= self.first_tip;
        if at_tip {
            let across = self.before.solutions[self.first_tip - 1].normal;
            let tilt = (from.normal - across).norm();
            weight *= TIP_TO_WIRE * exp(-tilt / (TIP_TO_WIRE_TILT + step.tip_variances[2].sqrt()));
            if weight < 1e-12 {
                return;
            }
        }
        // Only nodes that the fastest path of this step reaches.
        let node_mm = self.node_mm();
        let nearest = k.min(self.first_tip - 1);
        let from_mm = self.inverse.nodes[nearest].arclength_mm
            + if at_tip {
                0.0
            } else {
                from.cell.offset * node_mm
            };
        let nodes = (step.reach_mm / node_mm).ceil() as usize;
        // Contacts move outward as an object loads the wire.
        let modes = self.velocity_modes(
            &step.path_variances,
            from.cell,
            step,
            self.settings.reset_mean,
        );
        for (j, new) in new
            .iter_mut()
            .enumerate()
            .take((nearest + nodes + 1).min(self.first_tip))
            .skip(nearest.saturating_sub(nodes))
        {
            if !self.now.solutions[j].reachable {
                continue;
            }
            let along = self.inverse.nodes[j].arclength_mm - from_mm;
            // The offset before shortens the path, that now lengthens it; at the tip it is a turn.
            let by_before = if at_tip { 0.0 } else { -node_mm };
            let residual = self.constraint(from, j, step);
            let path = [along, by_before, node_mm];
            self.accumulate(
                from,
                j,
                weight * node_mm,
                step,
                &residual,
                &modes,
                path,
                new,
            );
        }
    }

    /// Predicted path along the curve and its variance: constant velocity, perturbed, reset.
    fn velocity_modes(
        &self,
        variances: &[f64; 3],
        cell: &GridCell,
        step: &BaseStep,
        reset_mean: f64,
    ) -> [(f64, f64); 3] {
        let travel = step.travel_mm.abs();
        let carried = cell.velocity_variance * travel * travel;
        let mean = cell.velocity * travel;
        [
            (mean, variances[0] + carried),
            (mean, variances[1] + carried),
            (reset_mean * travel, variances[2]),
        ]
    }

    /// Adds the density of a transition from a contact to node `j`; `path`: path along the curve
    /// and its derivatives by the offsets before and now.
    #[allow(clippy::too_many_arguments)]
    fn accumulate(
        &self,
        from: &ContactState<'_>,
        j: usize,
        weight: f64,
        step: &BaseStep,
        residual: &ConstraintResidual,
        modes: &[(f64, f64); 3],
        path: [f64; 3],
        new: &mut MomentSums,
    ) {
        let (s, c, pair) = (self.settings, &self.now.solutions[j], &residual.pair);
        // Part of the residual that no offset in both nodes can absorb: beyond a few standard
        // deviations the density is negligible.
        let absorbed =
            0.5 * pair.by_now[0].abs() + 3.0 * pair.by_before[0].abs() * pair.variance.sqrt();
        let left = (pair.residual[0].abs() - absorbed).max(0.0).powi(2);
        if left > MAX_MAHALANOBIS2 * residual.outlier_variance {
            return;
        }
        let travel = step.travel_mm.abs().max(1e-3);
        let [perturbed, reset] = [s.perturbed_fraction, s.reset_fraction];
        let shares = [1.0 - perturbed - reset, perturbed, reset];
        let mut sums = MomentSums::default();
        // The path by itself already rules out most nodes of a narrow mode, wherever in both nodes
        // the contact is.
        let path_variance = pair.variance * path[1] * path[1];
        let mut add = |share: f64, noise: f64, (mean, variance): (f64, f64)| {
            let beyond = (path[0] - mean).abs() - 0.5 * path[2].abs();
            if beyond > 0.0
                && beyond * beyond
                    > MAX_TRUNCATED_SDS * MAX_TRUNCATED_SDS * (path_variance + variance)
            {
                return;
            }
            let joint = LinearGaussianPair {
                residual: [pair.residual[0], path[0] - mean],
                by_before: [pair.by_before[0], path[1]],
                by_now: [pair.by_now[0], path[2]],
                noise: [noise, variance],
                variance: pair.variance,
            };
            sums.add(&MomentSums::of_pair(&joint, mean, travel), share);
        };
        // Mixture over velocity modes, and over outliers, whose velocity is reset.
        let inliers = shares
            .into_iter()
            .zip(modes)
            .filter(|_| left < MAX_MAHALANOBIS2 * pair.noise[0]);
        for (share, mode) in inliers {
            add(share * (1.0 - s.outlier_fraction), pair.noise[0], *mode);
        }
        add(s.outlier_fraction, residual.outlier_variance, modes[2]);
        if sums.weight > 0.0 {
            let turn = self.turn_density(from, j, step);
            let slip = self.excess_slip(&residual.slip_mm, step);
            // Jacobian from distance and turn to the moments.
            new.add(
                &sums,
                weight * turn * slip * c.compliance_mm_per_nmm * c.turn_rad_per_nmm,
            );
        }
    }

    /// To the tip: past the wire's end the path on the surface continues as a turn of the force.
    fn tip_transition(
        &self,
        k: usize,
        weight: f64,
        from: &ContactState<'_>,
        step: &BaseStep,
        new: &mut [MomentSums],
    ) {
        if self.first_tip == self.now.solutions.len() {
            return;
        }
        let nodes = &self.inverse.nodes;
        let at_tip = k >= self.first_tip;
        // Probability to pass the end of the wire: tail of a Laplace density.
        let past = if at_tip {
            1.0
        } else {
            let left_mm = nodes[self.first_tip].arclength_mm - nodes[k].arclength_mm;
            0.5 * exp(-left_mm / step.path_sd_mm)
        };
        if past < MIN_PAST_END {
            return;
        }
        let unknown = GridCell {
            weight: 0.0,
            ..GridCell::default()
        };
        let cell = if at_tip { from.cell } else { &unknown };
        let modes = self.velocity_modes(&step.tip_variances, cell, step, 0.0);
        let uniform = self.settings.tip_uniform_fraction;
        for (j, new) in new.iter_mut().enumerate().skip(self.first_tip) {
            let c = &self.now.solutions[j];
            let pitch = self.now.turns[j];
            if !c.reachable || pitch < 1e-6 {
                continue;
            }
            // Path: the turn of the force along the tip's part of the curve, rad.
            let direction = self.now.normal_slopes[j] / pitch;
            let path = [
                direction.dot(&(c.normal - from.normal)),
                if at_tip {
                    -direction.dot(&from.normal_slope)
                } else {
                    0.0
                },
                pitch,
            ];
            let residual = self.constraint(from, j, step);
            let onward = weight * past * (1.0 - uniform) * pitch;
            self.accumulate(from, j, onward, step, &residual, &modes, path, new);
            // At an edge of the object the force may turn to any tilt: the constraint alone counts.
            let anywhere = MomentSums::of_first(&residual.pair);
            if anywhere.weight > 0.0 {
                let turn =
                    self.turn_density(from, j, step) * self.excess_slip(&residual.slip_mm, step);
                let share = uniform * pitch / self.now.tip_turn.max(1e-9);
                new.add(
                    &anywhere,
                    weight * past * share * turn * c.compliance_mm_per_nmm * c.turn_rad_per_nmm,
                );
            }
        }
    }
}
