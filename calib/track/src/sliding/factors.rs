//! What ties the states of a sliding contact together: residuals of moments, motion and friction,
//! each in its standard deviation.
//!
//! Reading k has the state x_k (`contact_state`); seen from the object it shows the point P_k, the
//! normal n_k, the wire's direction t_k. The calibration's errors c_j ~ N(0, 1) are common to all
//! readings; the friction coefficient mu is a hypothesis.
//!
//! ```text
//! moments     R_k^-1/2 (m_k - m(x_k) - H_k c)                        R_k: noise of a reading and error of the wire's model
//! surface     (P_k - P_(k-1)) . (n_k + n_(k-1)) / 2  ~ 0             exact for an arc; a change of curvature kappa within h errs by kappa h^2 / 16
//! friction    (a, c)_k + mu w / sqrt(|w|^2 + e^2) ~ 0                w = dP - t ds in the directions along and across: slip of the wire's matter
//! slip rate   (q_(k+1) - q_k) - g (q_k - q_(k-1)) ~ 0,  g = d_k . d_(k-1) / |d_(k-1)|^2     by step d of the motion; heavy tails: sticking, edges
//! press       min(f, 0) = 0
//! touch       |P_1 - free wire at q_1| ~ 0                          within a step of the motion and what the noise hides; not after a slip
//! end         L - q_last ~ 0 where the load is lost at once: the wire has slipped off at its tip
//! ```
//!
//! What is seen of s: with m known, `surface` is in the limit of small steps
//! `A ds/dt + (dP/dm . n) dm/dt + v . n = 0`, `A = dP/ds|_m . n`, which vanishes with the load:
//! while the load rises an error of s falls as |m|^-4 (a straight cantilever), while it falls it
//! grows. So each end of a contact is found from its middle and from how fast the load grows there.

use super::banded::Normal;
use super::contact_state::{ContactQuantities, Rates, STATE, State, TouchedWire};
use crate::known_motion::MotionRow;
use nalgebra::{DVector, Matrix2, Vector2, Vector3};
use statrs::function::gamma::ln_gamma;
use std::f64::consts::TAU;

/// Relative error of the wire's model, and of the links, N mm.
const MODEL_SHARE: f64 = 0.002;
const MODEL_NMM: f64 = 3e-4;
/// Error of a step along the surface: constant (mm), and for each radian and millimetre by which it
/// turns and goes on.
const SURFACE_MM: f64 = 0.004;
const SURFACE_TURN: f64 = 0.08;
/// How far a contact leaps along the surface: steps of the motion, and mm.
const LEAP_STEPS: f64 = 3.0;
const LEAP_MM: f64 = 0.5;
/// Slip between two readings at which friction has 0.7 of its size, mm; standard deviation of
/// friction beside its law.
const STICK_MM: f64 = 0.02;
const FRICTION_SD: f64 = 0.02;
/// Changes of the slip rate from reading to reading, as a share of the motion's step, and constant,
/// mm.
const SLIP_SHARE: f64 = 0.15;
const SLIP_MM: f64 = 0.02;
/// Steps of the motion in a row are so unequal at most: where the object hardly moved its slip says
/// nothing.
const MAX_RATIO: f64 = 3.0;
/// Standard deviation of a force that draws, N.
const PULL_N: f64 = 1e-3;
/// How far from its tip the wire is when it slips off, beside a step, mm.
const OFF_MM: f64 = 0.3;

/// Step of the differences of residuals.
const H: f64 = 1e-6;
/// Readings that a residual ties together at most.
const TIED: usize = 3;

/// Kinds of residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Kind {
    Moments,
    Surface,
    Friction,
    SlipRate,
    Press,
    End,
    Touch,
}

pub(super) const KINDS: [Kind; 7] = [
    Kind::Moments,
    Kind::Surface,
    Kind::Friction,
    Kind::SlipRate,
    Kind::Press,
    Kind::End,
    Kind::Touch,
];

/// A reading's state with what it shows on the object.
#[derive(Debug, Clone, Copy)]
pub(super) struct Local {
    pub x: State,
    pub y: ContactQuantities,
}

/// How the readings of a contact begin and end.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ends {
    /// Whether the wire was free before; else the contact slipped here from another place.
    pub from_free: bool,
    /// Whether the load is lost at once after the last reading.
    pub slips_off: bool,
}

/// Residuals of a contact's readings.
#[derive(Clone)]
pub(super) struct Chain<'a> {
    pub wire: &'a TouchedWire,
    pub rows: &'a [MotionRow],
    /// Inverse square roots of the moments' covariances.
    whiten: Vec<Matrix2<f64>>,
    /// Derivative of the moments' two residuals by the common unknowns.
    by_common: Vec<[Vec<f64>; 2]>,
    /// Way of the object from the reading before, mm, and its part along the way before that, over
    /// that: -1 where the motion turns back.
    pub step_mm: Vec<f64>,
    goes_on: Vec<f64>,
    pub ends: Ends,
    /// Common unknowns of the moments, and which of them are constants.
    pub shared: usize,
    constant: Vec<bool>,
    /// Friction coefficient.
    pub friction: f64,
    /// Whether friction follows the slip, or is that of a contact that slides toward the tip.
    pub by_slip: bool,
    /// Whether changes of the contact's course have heavy tails.
    pub heavy: bool,
}

/// What becomes of the errors that all readings share and that change with the load. A surface of
/// which nothing is known takes up any gain of the moments, so that a fit learns none of it: the
/// path is fitted with these errors at their mean (S. F. Schmidt's considered parameters, Adv.
/// Control Syst. 3 (1966) 293), and their whole prior is in its covariance. A constant, the zero,
/// shows at first touch and is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Common {
    Held,
    Free,
}

/// Weight that holds a common unknown at its mean.
const HELD: f64 = 1e12;
/// A column that changes by less than this share of its size is a constant.
const CONSTANT: f64 = 1e-3;

/// Covariance of what the wire's model is off at a block of readings, (N mm)^2.
pub(crate) fn model_nmm2(row: &MotionRow) -> Matrix2<f64> {
    let size = row.moment_nmm[0].hypot(row.moment_nmm[1]);
    Matrix2::identity() * ((MODEL_SHARE * size).powi(2) + MODEL_NMM * MODEL_NMM)
}

/// Logarithm of the norm of Student's t over that of a normal density.
pub(super) fn ln_norm(nu: f64) -> f64 {
    ln_gamma(0.5 * (nu + 1.0)) - ln_gamma(0.5 * nu) - 0.5 * (0.5 * nu).ln()
}

/// Whether a common unknown is the same error in every reading.
fn is_constant(rows: &[MotionRow], j: usize) -> bool {
    let of = |k: usize| Vector2::from(rows[k].shared_nmm[j]);
    let largest = (0..rows.len()).map(|k| of(k).norm()).fold(0.0, f64::max);
    (0..rows.len()).all(|k| (of(k) - of(0)).norm() <= CONSTANT * largest)
}

impl<'a> Chain<'a> {
    pub(crate) fn new(wire: &'a TouchedWire, rows: &'a [MotionRow], ends: Ends) -> Self {
        let whiten: Vec<Matrix2<f64>> = rows
            .iter()
            .map(|r| {
                // Noise of the reading and error of the wire's model are independent.
                let covariance = r.noise_nmm2 + model_nmm2(r);
                covariance
                    .cholesky()
                    .and_then(|c| c.l().try_inverse())
                    .unwrap_or_else(Matrix2::zeros)
            })
            .collect();
        let step = |k: usize| match k {
            0 => 0.0,
            k => (rows[k].moved_mm - rows[k - 1].moved_mm).norm(),
        };
        let way = |k: usize| rows[k].moved_mm - rows[k - 1].moved_mm;
        let goes_on = |k: usize| match k {
            0 | 1 => 1.0,
            k => (way(k).dot(&way(k - 1)) / way(k - 1).norm_squared().max(1e-12))
                .clamp(-MAX_RATIO, MAX_RATIO),
        };
        let shared = rows.first().map_or(0, |r| r.shared_nmm.len());
        // The residual is W (m - m(x) - H c): its derivative by c is -W H.
        let by_common = rows.iter().zip(&whiten).map(|(r, whiten)| {
            [0, 1].map(|i| {
                r.shared_nmm
                    .iter()
                    .map(|h| -(whiten * Vector2::from(*h))[i])
                    .collect()
            })
        });
        Self {
            wire,
            rows,
            by_common: by_common.collect(),
            whiten,
            step_mm: (0..rows.len()).map(step).collect(),
            goes_on: (0..rows.len()).map(goes_on).collect(),
            ends,
            shared,
            constant: (0..shared).map(|j| is_constant(rows, j)).collect(),
            friction: 0.0,
            heavy: true,
            by_slip: false,
        }
    }

    /// With all residuals, under a coefficient of friction.
    pub(crate) fn under(&self, friction: f64) -> Self {
        Self {
            friction,
            by_slip: true,
            heavy: true,
            ..self.clone()
        }
    }

    /// The common unknowns before any reading.
    pub(crate) fn prior(&self) -> DVector<f64> {
        DVector::zeros(self.shared)
    }

    /// The readings that a residual of reading k ties together; none where there is no such
    /// residual.
    fn readings(&self, kind: Kind, k: usize) -> Option<std::ops::RangeInclusive<usize>> {
        let last = self.rows.len() - 1;
        match kind {
            Kind::Moments | Kind::Press => Some(k..=k),
            Kind::Friction => Some(k.saturating_sub(1)..=k),
            Kind::Surface => (k > 0).then(|| k - 1..=k),
            Kind::SlipRate => (k > 1).then(|| k - 2..=k),
            Kind::End => (k == last && k > 0 && self.ends.slips_off).then(|| k - 1..=k),
            Kind::Touch => (k == 0 && self.ends.from_free).then_some(k..=k),
        }
    }

    /// Degrees of freedom of Student's distribution of a residual; none: normal.
    fn tails(&self, kind: Kind) -> Option<f64> {
        // Edges and gaps of a surface, sticking and the end are rare, but large where they occur.
        match kind {
            _ if !self.heavy => None,
            Kind::Surface => Some(4.0),
            Kind::SlipRate => Some(2.0),
            Kind::End => Some(4.0),
            _ => None,
        }
    }

    fn numbers(kind: Kind) -> usize {
        if matches!(kind, Kind::Moments | Kind::Surface | Kind::Friction) {
            2
        } else {
            1
        }
    }

    /// Residuals of reading k; `all` are the readings that it ties together.
    fn residual(&self, kind: Kind, k: usize, all: &[Local], c: &DVector<f64>) -> Vector2<f64> {
        let here = &all[all.len() - 1];
        let single = |v: f64| Vector2::new(v, 0.0);
        match kind {
            Kind::Moments => {
                let row = &self.rows[k];
                let shared: Vector2<f64> = row
                    .shared_nmm
                    .iter()
                    .zip(c.iter())
                    .map(|(h, c)| Vector2::from(*h) * *c)
                    .sum();
                self.whiten[k] * (Vector2::from(row.moment_nmm) - shared - here.y.moment_nmm())
            }
            Kind::Surface => {
                let before = &all[0];
                // A step on a surface lies in its tangent plane: exact for an arc with the mean of
                // both normals.
                let step = here.y.point_mm() - before.y.point_mm();
                let turned = (here.y.normal() - before.y.normal()).norm();
                let off = step.dot(&(here.y.normal() + before.y.normal())) * 0.5;
                let moved_sd = self.rows[k].moved_sd_mm.hypot(self.rows[k - 1].moved_sd_mm);
                let way = step.norm();
                // A change of curvature within a step errs by about its turn times its way.
                let sd = SURFACE_MM
                    .hypot(SURFACE_TURN * turned.min(0.5) * way.min(3.0 * self.step_mm[k]))
                    .hypot(moved_sd);
                let leap = way - LEAP_STEPS * self.step_mm[k] - LEAP_MM;
                Vector2::new(off / sd, leap.max(0.0) / LEAP_MM)
            }
            Kind::Friction => {
                // Coulomb: friction opposes the slip, with mu times the normal force once it slips.
                let acting = Vector2::new(here.x[3], here.x[4]);
                let pull = match all {
                    [before, here] if self.by_slip => self.friction_of(before, here),
                    _ => Vector2::new(self.friction, 0.0),
                };
                // At the first reading no slip is known: friction is held to its law loosely.
                (acting - pull) / if all.len() == 1 { 0.1 } else { FRICTION_SD }
            }
            Kind::SlipRate => {
                // The same slip for the same way of the object, to what the motion's step allows.
                let [a, b] = [all[1].x[0] - all[0].x[0], all[2].x[0] - all[1].x[0]];
                let sd = SLIP_SHARE * self.step_mm[k] + SLIP_MM;
                single((b - a * self.goes_on[k]) / sd)
            }
            Kind::Touch => single(self.deflection(k, &here.x, &here.y)),
            Kind::Press => single(here.x[1].min(0.0) / PULL_N),
            Kind::End => {
                // Before it slips off, the wire lies within a step of its tip.
                let short = (self.wire.length_mm - here.x[0]).max(0.0);
                let step = (here.x[0] - all[0].x[0]).abs().max(self.step_mm[k]);
                single(short / (step + OFF_MM))
            }
        }
    }

    /// By how much a light force changes in a step of the motion and by noise, N.
    pub(crate) fn jump_n(&self, k: usize) -> f64 {
        let row = &self.rows[k];
        let noise = (row.noise_nmm2.trace() / 2.0).sqrt();
        // Cantilever: F = 3 E I d / s^3 for a step d, and noise over the lever.
        let s = 0.3 * self.wire.length_mm;
        3.0 * self.wire.ei_nmm2 / s.powi(3) * self.step_mm[k] + 8.0 * noise / s
    }

    /// How far the contact lies from the free wire, over how far it may lie there at first touch or
    /// at the end: a step of the motion, and what the noise hides.
    pub(crate) fn deflection(&self, k: usize, x: &State, y: &ContactQuantities) -> f64 {
        // The same state without force is the free wire.
        let mut light = *x;
        light[1] = 0.0;
        let row = &self.rows[k];
        let free = self.wire.show(&light).on_object(&row.turn, &row.moved_mm);
        // A cantilever loaded at s deflects there by m s^2 / (3 E I): noise hides as much.
        let hidden = 4.0 * (row.noise_nmm2.trace() / 2.0).sqrt() * y.arclength_mm().powi(2)
            / (3.0 * self.wire.ei_nmm2);
        // The first reading has no step before it: the next one stands for it.
        let step = self.step_mm.get(k.max(1)).copied().unwrap_or(0.0);
        (y.point_mm() - free.point_mm()).norm() / (step + hidden)
    }

    /// Friction along and across by the slip between two readings.
    fn friction_of(&self, before: &Local, here: &Local) -> Vector2<f64> {
        // The contact goes on by dP over the object and by ds along the wire: the rest is slip.
        let along_wire = here.y.tangent() * (here.y.arclength_mm() - before.y.arclength_mm());
        let w = here.y.point_mm() - before.y.point_mm() - along_wire;
        let w = Vector2::new(w.dot(&here.y.along()), w.dot(&here.y.across()));
        // Coulomb's law made smooth within STICK_MM, so that it has a slope at rest.
        -w * (self.friction / w.norm().hypot(STICK_MM))
    }

    /// What all states show on the object.
    pub(super) fn locals(&self, x: &[State]) -> Vec<Local> {
        x.iter()
            .zip(self.rows)
            .map(|(x, r)| Local {
                x: *x,
                y: self.wire.show(x).on_object(&r.turn, &r.moved_mm),
            })
            .collect()
    }

    /// Sum of squares of the residuals of a kind, heavy tails included.
    fn sum(&self, kind: Kind, all: &[Local], c: &DVector<f64>) -> f64 {
        let one = |k: usize| {
            let r2 = self
                .residual(kind, k, &all[self.readings(kind, k)?], c)
                .norm_squared();
            // Student: minus twice the logarithm of the density.
            Some(
                self.tails(kind)
                    .map_or(r2, |nu| (nu + 1.0) * (r2 / nu).ln_1p()),
            )
        };
        (0..all.len()).filter_map(one).sum()
    }

    /// Sum of squares of what parts the contacts from one surface.
    pub(crate) fn gaps(&self, x: &[State], c: &DVector<f64>) -> f64 {
        self.sum(Kind::Surface, &self.locals(x), c)
    }

    /// Sum of squares of everything.
    pub(crate) fn cost(&self, x: &[State], c: &DVector<f64>) -> f64 {
        let all = self.locals(x);
        c.norm_squared()
            + KINDS
                .iter()
                .map(|kind| self.sum(*kind, &all, c))
                .sum::<f64>()
    }

    /// Logarithm of the moments' densities where they are as the states have them.
    pub(crate) fn ln_densities(&self) -> f64 {
        self.whiten
            .iter()
            .map(|w| w.determinant().abs().max(f64::MIN_POSITIVE).ln() - TAU.ln())
            .sum()
    }

    /// Logarithm of the norms of all residuals with heavy tails over those of normal ones.
    pub(crate) fn ln_norms(&self) -> f64 {
        let of = |kind: &Kind| {
            let count = (0..self.rows.len())
                .filter(|k| self.readings(*kind, *k).is_some())
                .count();
            self.tails(*kind)
                .map_or(0.0, |nu| count as f64 * ln_norm(nu))
        };
        KINDS.iter().map(of).sum()
    }

    /// What a state shows on the object, with its derivative.
    fn rates(&self, x: &State, row: &MotionRow) -> (Local, Rates) {
        let (y, mut rates) = self.wire.rates(x);
        for k in 0..STATE {
            // Differences turn with the object, but do not move with it.
            let seen = ContactQuantities(rates.column(k).into_owned())
                .on_object(&row.turn, &Vector3::zeros());
            rates.set_column(k, &seen.0);
        }
        (
            Local {
                x: *x,
                y: y.on_object(&row.turn, &row.moved_mm),
            },
            rates,
        )
    }

    /// The linearised problem; residuals with heavy tails by their weights.
    pub(crate) fn linearise(
        &self,
        x: &[State],
        c: &DVector<f64>,
        common: Common,
        kinds: &[Kind],
    ) -> Normal {
        let (locals, rates): (Vec<Local>, Vec<Rates>) = x
            .iter()
            .zip(self.rows)
            .map(|(x, r)| self.rates(x, r))
            .unzip();
        let mut normal = Normal::new(STATE * x.len(), self.shared, TIED * STATE);
        for &kind in kinds {
            for k in 0..x.len() {
                let Some(range) = self.readings(kind, k) else {
                    continue;
                };
                let all = &locals[range.clone()];
                let r = self.residual(kind, k, all, c);
                // A square with this weight has the gradient of Student's t.
                let weight = self
                    .tails(kind)
                    .map_or(1.0, |nu| (nu + 1.0) / (nu + r.norm_squared()));
                let (mut near, mut by_state) = ([all[0]; TIED], [[0.0; TIED * STATE]; 2]);
                near[..all.len()].copy_from_slice(all);
                // By the chain rule: only the rates of the wire take solutions of it.
                for (n, rates) in rates[range.clone()].iter().enumerate() {
                    for a in 0..STATE {
                        near[n].x[a] += H;
                        near[n].y.0 += rates.column(a) * H;
                        let by = (self.residual(kind, k, &near[..all.len()], c) - r) / H;
                        near[n] = all[n];
                        (0..2).for_each(|i| by_state[i][STATE * n + a] = by[i]);
                    }
                }
                for i in 0..Self::numbers(kind) {
                    let by_common = if kind == Kind::Moments {
                        self.by_common[k][i].as_slice()
                    } else {
                        &[]
                    };
                    let by_state = &by_state[i][..STATE * all.len()];
                    normal.add(weight, r[i], STATE * range.start(), by_state, by_common);
                }
            }
        }
        for n in 0..self.shared {
            let held = common == Common::Held && !self.constant[n];
            normal.add_common(if held { HELD } else { 1.0 }, c[n], n);
        }
        normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// c k(u) of the head of smooth.rs integrates to 1, as the normal density's 1 / sqrt(2 pi)
    /// exp(-u^2 / 2) does.
    #[test]
    fn students_density_has_mass_one() {
        for nu in [3.0, 5.0, 30.0] {
            let density =
                |u: f64| (1.0 + u * u / nu).powf(-0.5 * (nu + 1.0)) / std::f64::consts::TAU.sqrt();
            let kernel: f64 = (-200_000..=200_000)
                .map(|k| 1e-3 * density(1e-3 * f64::from(k)))
                .sum();
            assert!(
                (kernel * ln_norm(nu).exp() - 1.0).abs() < 1e-4,
                "{nu}: {kernel}"
            );
            // Control: the normal density's norm has other mass.
            assert!((kernel - 1.0).abs() > 0.005, "{nu}: {kernel}");
        }
    }
}
