//! How contacts slide in a set of sweeps: the densities of the transition, and the Fisher information of their location.
//!
//! Innovations at the true contacts, by the base's travel z between two samples of an undisturbed slide:
//!
//! ```text
//! w_n = n . (p' - p + z e_z) / z,   w_t = a . (n' - n) / z,   w_v = (q'' - q') / z' - (q' - q) / z
//! ```
//!
//! Each is fitted by Student's t about zero, `p(w) ~ (1 + w^2 / (nu s^2))^(-(nu + 1) / 2)`, s by the fixed point of its likelihood equation,
//! `s^2 = mean((nu + 1) w^2 / (nu + w^2 / s^2))`, nu over a grid; the information is `(nu + 1) / ((nu + 3) s^2)`. Source: K. L. Lange, R. J. A.
//! Little, J. M. G. Taylor, J. Am. Stat. Assoc. 84 (1989) 881. Scales have a floor: facets and edges of meshes have innovations of exactly 0.

use super::SweepContacts;
use super::curve_state::CurveState;
use nalgebra::Vector3;
use serde::Serialize;
use statrs::function::gamma::ln_gamma;

/// Fewer innovations fit nothing.
const MIN_SAMPLES: usize = 30;
/// Degrees of freedom that are tried.
const DOFS: [f64; 9] = [0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 30.0];
/// Iterations of the scale.
const ITERATIONS: usize = 60;
/// Floors of the scales: constraint, mm/mm, turn, rad/mm, velocities, nodes/mm. What the tables of the rod and the meshes resolve.
const FLOORS: [f64; 4] = [0.003, 0.002, 0.02, 0.005];
/// Velocity of a contact of which nothing is known: wire and tip, nodes/mm; variance of a uniform number in [-2, 2] of them.
const VELOCITY_VARIANCE: f64 = 16.0 / 12.0;
/// Jumps along the curve where the sweeps have too few: scale (nodes) and degrees of freedom.
const JUMP: Density = Density { scale: 10.0, dof: 1.0, samples: 0 };
/// Standard deviation of first contacts along the curve where the sweeps have too few, nodes.
const ONSET_NODES: f64 = 60.0;

/// Student's t about zero.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Density {
    /// Scale, by mm of travel.
    pub scale: f64,
    /// Degrees of freedom.
    pub dof: f64,
    /// Innovations that it is fitted to.
    pub samples: usize,
}

impl Density {
    /// Fitted by maximum likelihood; none with too few.
    #[must_use]
    pub fn fitted(innovations: &[f64], floor: f64) -> Option<Self> {
        let n = innovations.len();
        if n < MIN_SAMPLES {
            return None;
        }
        let of = |dof: f64| {
            let mut square = innovations.iter().map(|w| w * w).sum::<f64>() / n as f64;
            for _ in 0..ITERATIONS {
                let weighted = |w: &f64| (dof + 1.0) * w * w / (dof + w * w / square);
                square = (innovations.iter().map(weighted).sum::<f64>() / n as f64).max(floor * floor);
            }
            let each = |w: &f64| -0.5 * (dof + 1.0) * (w * w / (dof * square)).ln_1p();
            let constant = ln_gamma(0.5 * (dof + 1.0))
                - ln_gamma(0.5 * dof)
                - 0.5 * (std::f64::consts::PI * dof * square).ln();
            (
                Self { scale: square.sqrt(), dof, samples: n },
                innovations.iter().map(each).sum::<f64>() + n as f64 * constant,
            )
        };
        DOFS.into_iter().map(of).max_by(|a, b| a.1.total_cmp(&b.1)).map(|found| found.0)
    }

    /// Fisher information of the location over a travel, mm, with an independent error of that variance.
    #[must_use]
    pub fn information_with(&self, travel_mm: f64, variance: f64) -> f64 {
        let own = (self.dof + 3.0) / (self.dof + 1.0) * (self.scale * travel_mm).powi(2);
        1.0 / (own + variance)
    }
}

/// Densities of the transition of a set of sweeps.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TransitionDensities {
    /// Constraint of the rigid object, mm/mm.
    pub constraint: Density,
    /// Turn of the force about the wire, rad/mm.
    pub turn: Density,
    /// Change of the velocity along the wire, nodes/mm.
    pub wire_velocity: Density,
    /// The same of the force's tilt at the tip.
    pub tip_velocity: Density,
    /// Jumps along the curve, nodes.
    pub jump: Density,
    /// Variance of first contacts along the curve, nodes^2.
    pub onset_variance: f64,
}

/// Innovations of a series.
#[derive(Debug, Default)]
struct Innovations {
    constraint: Vec<f64>,
    turn: Vec<f64>,
    wire_velocity: Vec<f64>,
    tip_velocity: Vec<f64>,
    jumps: Vec<f64>,
    onsets: Vec<f64>,
}

impl TransitionDensities {
    /// Of the true contacts of sweeps; none where they slide too little.
    #[must_use]
    pub fn of_sweeps<'a, 's: 'a>(sweeps: impl IntoIterator<Item = &'a SweepContacts<'s>>) -> Option<Self> {
        let parts: Vec<Innovations> = sweeps.into_iter().map(Innovations::of).collect();
        let pooled = |of: fn(&Innovations) -> &Vec<f64>| -> Vec<f64> {
            parts.iter().flat_map(|p| of(p).iter().copied()).collect()
        };
        let onsets = pooled(|i| &i.onsets);
        let mean = onsets.iter().sum::<f64>() / onsets.len() as f64;
        let onset_variance = match onsets.len() {
            n if n < MIN_SAMPLES => ONSET_NODES * ONSET_NODES,
            n => onsets.iter().map(|q| (q - mean).powi(2)).sum::<f64>() / (n - 1) as f64,
        };
        let wire_velocity = Density::fitted(&pooled(|i| &i.wire_velocity), FLOORS[2])?;
        Some(Self {
            constraint: Density::fitted(&pooled(|i| &i.constraint), FLOORS[0])?,
            turn: Density::fitted(&pooled(|i| &i.turn), FLOORS[1])?,
            wire_velocity,
            tip_velocity: Density::fitted(&pooled(|i| &i.tip_velocity), FLOORS[3]).unwrap_or(wire_velocity),
            jump: Density::fitted(&pooled(|i| &i.jumps), 1.0).unwrap_or(JUMP),
            onset_variance,
        })
    }

    /// Information about the velocity of a new contact.
    pub(super) fn velocity_prior(&self) -> f64 {
        1.0 / VELOCITY_VARIANCE
    }
}

impl Innovations {
    fn of(sweep: &SweepContacts<'_>) -> Self {
        let mut all = Self::default();
        let mut before: Option<(f64, &CurveState, Option<f64>)> = None;
        for (sample, now) in sweep.series.samples.iter().zip(&sweep.states) {
            let Some(now) = now else {
                before = None;
                continue;
            };
            if sample.event == "onset" {
                all.onsets.push(now.q);
            }
            let mut velocity = None;
            match &before {
                Some((_, from, _)) if ["jump", "slip"].contains(&sample.event.as_str()) => {
                    all.jumps.push(now.q - from.q);
                }
                Some((last_mm, from, last_velocity)) if sample.travel_mm - last_mm > super::MIN_TRAVEL_MM => {
                    let travel_mm = sample.travel_mm - last_mm;
                    let path = now.point_mm - from.point_mm + Vector3::z() * travel_mm;
                    if let Some(normal) = (from.normal + now.normal).try_normalize(0.1) {
                        all.constraint.push(normal.dot(&path) / travel_mm);
                    }
                    if let Some(axis) = now.axis {
                        all.turn.push(axis.dot(&(now.normal - from.normal)) / travel_mm);
                    }
                    let v = (now.q - from.q) / travel_mm;
                    if from.at_tip == now.at_tip {
                        let of = if now.at_tip { &mut all.tip_velocity } else { &mut all.wire_velocity };
                        of.extend(last_velocity.map(|last| v - last));
                        velocity = Some(v);
                    }
                }
                _ => {}
            }
            before = Some((sample.travel_mm, now, velocity));
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal, StudentT};

    /// 20,000 draws determine the scale to about 1 %.
    #[test]
    fn the_density_of_drawn_innovations_is_found_again() {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let t = StudentT::new(2.0).unwrap();
        let heavy: Vec<f64> = (0..20_000).map(|_| 0.05 * t.sample(&mut rng)).collect();
        let found = Density::fitted(&heavy, 1e-3).unwrap();
        assert!(found.dof == 2.0 && (found.scale / 0.05 - 1.0).abs() < 0.05, "{found:?}");
        let normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let plain: Vec<f64> = std::iter::repeat_with(normal).take(20_000).map(|x| 0.2 * x).collect();
        let found = Density::fitted(&plain, 1e-3).unwrap();
        // The information of a normal density is the inverse of its variance.
        assert!(
            found.dof >= 10.0 && (found.information_with(1.0, 0.0) * 0.04 - 1.0).abs() < 0.1,
            "{found:?}"
        );
        // An independent error lowers it, and so does the travel.
        assert!(found.information_with(1.0, 0.04) < 0.6 * found.information_with(1.0, 0.0));
        assert!(found.information_with(2.0, 0.0) < 0.3 * found.information_with(1.0, 0.0));
        assert!(Density::fitted(&plain[..10], 1e-3).is_none());
    }

    #[test]
    fn innovations_of_nothing_have_the_floor_for_a_scale() {
        let found = Density::fitted(&[0.0; 100], 0.003).unwrap();
        assert!((found.scale - 0.003).abs() < 1e-12, "{found:?}");
    }
}
