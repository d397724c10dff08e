//! A wire that slides over a body: one contact, Coulomb friction in the tangent plane, step by step
//! along the motion.
//!
//! Unknowns are the place P of the wire's axis at the contact, the normal force f and the arc
//! length s; N(P) is the body's normal:
//!
//! ```text
//! r(s; F) = P,   d(P) = a,   N . t = 0         r, t: wire under F applied at P (`rod`); d: distance from the body, a: the wire's radius
//! at the tip     s = L  instead of  N . t = 0   while N . t <= 0
//! F = f (N + mu q),   q = -w / sqrt(|w|^2 + e^2),   w = dP - t ds     slip of the wire's matter past the body since the last step
//! ```
//!
//! Sticking is w of the order of e = 4 um: rolling, as it has to be. The contact ends where f < 0.

use super::body::Body;
use crate::rod::Wire;
use crate::{PlantError, WireError};
use nalgebra::{SMatrix, SVector, Vector3};

type V3 = Vector3<f64>;
type V5 = SVector<f64, 5>;

/// Slip at which friction has 0.7 of its full size, mm.
const STICK_MM: f64 = 4e-3;
/// Steps of the motion, mm, and halvings of one that does not converge.
const STEP_MM: f64 = 0.1;
const HALVINGS: u32 = 7;
/// Residual at which an equilibrium is found, mm.
const SETTLED_MM: f64 = 1e-9;
/// A wire that loses its equilibrium nearer to its tip than this snaps off, mm.
const TIP_MM: f64 = 1.0;
/// Halvings of a Newton step that does not lead nearer.
const CUTS: usize = 6;
/// Spacing at which the free wire is held against the body, mm.
const SAMPLE_MM: f64 = 0.25;

/// A contact in equilibrium.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Touch {
    /// Axis of the wire at the contact, base frame, mm.
    pub axis_mm: V3,
    /// Arc length, mm.
    pub arclength_mm: f64,
    /// Outward normal of the body there.
    pub normal: V3,
    /// Direction of the wire there.
    pub tangent: V3,
    /// Normal force, N.
    pub normal_n: f64,
    /// Force on the wire, N.
    pub force_n: V3,
    /// Moment on the base, N mm.
    pub moment_nmm: V3,
    /// Tangential over normal force, over the friction coefficient: below 1 the contact sticks.
    pub mobilised: f64,
    /// Axis at the contact in the world, mm.
    world_mm: V3,
}

/// The wire, the body and where the base is.
pub struct Slide<'a> {
    wire: &'a Wire,
    body: &'a Body,
    friction: f64,
    base_mm: V3,
    /// The contact; none where the wire is free.
    pub touch: Option<Touch>,
}

impl<'a> Slide<'a> {
    /// A free wire with its base at a place in the world.
    pub fn new(wire: &'a Wire, body: &'a Body, friction: f64, base_mm: V3) -> Self {
        Self {
            wire,
            body,
            friction,
            base_mm,
            touch: None,
        }
    }

    /// Smallest gap between the free wire and the body, mm, and the arc length there.
    pub fn free_gap(&self, base_mm: &V3) -> (f64, f64) {
        let radius = self.wire.radius_mm();
        let gap = |s: f64| self.body.closest(&(self.wire.rest(s).0 + base_mm)).0 - radius;
        let count = (self.wire.length_mm / SAMPLE_MM).ceil() as usize;
        let at = |k: usize| self.wire.length_mm * k as f64 / count as f64;
        let Some(k) = (0..=count).min_by(|a, b| gap(at(*a)).total_cmp(&gap(at(*b)))) else {
            return (f64::INFINITY, 0.0);
        };
        let (mut low, mut high) = (at(k.saturating_sub(1)), at((k + 1).min(count)));
        for _ in 0..40 {
            let (a, b) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
            if gap(a) < gap(b) { high = b } else { low = a }
        }
        // The tip itself is a place, not a limit.
        let (middle, tip) = (0.5 * (low + high), self.wire.length_mm);
        if gap(tip) <= gap(middle) {
            (gap(tip), tip)
        } else {
            (gap(middle), middle)
        }
    }

    /// Moves the base to a place in the world.
    ///
    /// # Errors
    /// [`PlantError::Wire`] where the wire cannot follow: it would snap.
    pub fn advance(&mut self, base_mm: &V3) -> Result<(), PlantError> {
        let steps = ((base_mm - self.base_mm).norm() / STEP_MM).ceil().max(1.0) as usize;
        let from = self.base_mm;
        for k in 1..=steps {
            self.step(&(from + (base_mm - from) * (k as f64 / steps as f64)), 0)?;
        }
        Ok(())
    }

    fn step(&mut self, base_mm: &V3, depth: u32) -> Result<(), PlantError> {
        let next = match self.touch {
            Some(last) => self.next(base_mm, &last),
            None => self.first(base_mm),
        };
        match next {
            Ok(touch) => {
                (self.touch, self.base_mm) = (touch, *base_mm);
                Ok(())
            }
            Err(_) if depth < HALVINGS => {
                let middle = (self.base_mm + base_mm) * 0.5;
                self.step(&middle, depth + 1)?;
                self.step(base_mm, depth + 1)
            }
            // Past a fold at the tip there is no equilibrium left: the wire snaps off.
            Err(_) if self.at_tip() && self.free_gap(base_mm).0 > 0.0 => {
                (self.touch, self.base_mm) = (None, *base_mm);
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    fn at_tip(&self) -> bool {
        self.touch
            .is_some_and(|t| t.arclength_mm > self.wire.length_mm - TIP_MM)
    }

    /// First touch on the way to a place of the base; none where there is none.
    fn first(&self, base_mm: &V3) -> Result<Option<Touch>, PlantError> {
        let (gap, s) = self.free_gap(base_mm);
        if gap >= 0.0 {
            return Ok(None);
        }
        let (r, tangent) = self.wire.rest(s);
        let (_, normal) = self.body.closest(&(r + base_mm));
        let start = Touch {
            axis_mm: r - normal * gap,
            arclength_mm: s,
            normal,
            tangent,
            normal_n: -gap * 3.0 * self.wire.ei_nmm2 / s.powi(3),
            force_n: V3::zeros(),
            moment_nmm: V3::zeros(),
            mobilised: 0.0,
            world_mm: r + base_mm,
        };
        self.next(base_mm, &start)
    }

    /// The contact after a step; none where it has ended.
    fn next(&self, base_mm: &V3, last: &Touch) -> Result<Option<Touch>, PlantError> {
        let tip_mm = self.wire.length_mm;
        let was_tip = last.arclength_mm >= tip_mm && last.normal.dot(&last.tangent) < -1e-9;
        let mut touch = self.solve(base_mm, last, was_tip)?;
        if !was_tip && touch.arclength_mm > tip_mm {
            touch = self.solve(base_mm, last, true)?;
        } else if was_tip && touch.normal.dot(&touch.tangent) > 0.0 {
            touch = self.solve(base_mm, last, false)?;
        }
        Ok((touch.normal_n > 0.0).then_some(touch))
    }

    /// Force per normal force, and the share of the friction that acts, for a contact at a place of
    /// the axis and an arc length.
    fn pull(&self, world_mm: &V3, s: f64, normal: &V3, last: &Touch) -> (V3, f64) {
        let slip = (world_mm - last.world_mm) - last.tangent * (s - last.arclength_mm);
        let slip = slip - normal * slip.dot(normal);
        let drag = -slip / (slip.norm_squared() + STICK_MM * STICK_MM).sqrt();
        (normal + drag * self.friction, drag.norm())
    }

    fn residual(&self, x: &V5, base_mm: &V3, last: &Touch, tip: bool) -> V5 {
        let (place, f, s) = (V3::new(x[0], x[1], x[2]), x[3], x[4]);
        let world = place + base_mm;
        let (distance, normal) = self.body.closest(&world);
        let force = self.pull(&world, s, &normal, last).0 * f;
        let (r, t) = self.wire.march(&place, &force, s, 2);
        let gap = r - place;
        let last_row = if tip {
            s - self.wire.length_mm
        } else {
            10.0 * normal.dot(&t)
        };
        V5::new(
            gap.x,
            gap.y,
            gap.z,
            distance - self.wire.radius_mm(),
            last_row,
        )
    }

    /// Newton's iteration with differences, its derivative kept while the residual falls fast.
    fn solve(&self, base_mm: &V3, last: &Touch, tip: bool) -> Result<Touch, PlantError> {
        let moved = last.world_mm - base_mm;
        let place = 0.5 * (moved + last.axis_mm);
        let s = if tip {
            self.wire.length_mm
        } else {
            last.arclength_mm
        };
        let mut x = V5::new(place.x, place.y, place.z, last.normal_n, s);
        let of = |x: &V5| self.residual(x, base_mm, last, tip);
        let mut g = of(&x);
        let mut inverse: Option<SMatrix<f64, 5, 5>> = None;
        for _ in 0..60 {
            if g.norm() < SETTLED_MM {
                return Ok(self.touch_at(&x, base_mm, last));
            }
            let lost = PlantError::from(WireError::NoEquilibrium { residual: g.norm() });
            let by = match inverse {
                Some(by) => by,
                None => {
                    let mut j = SMatrix::<f64, 5, 5>::zeros();
                    for k in 0..5 {
                        let h = if k == 3 {
                            1e-6 * x[3].abs().max(1e-4)
                        } else {
                            1e-6
                        };
                        let mut y = x;
                        y[k] += h;
                        j.set_column(k, &((of(&y) - g) / h));
                    }
                    j.try_inverse().ok_or(lost)?
                }
            };
            let step = -(by * g);
            // Stay near: a long step leads to another equilibrium.
            let long = (step.fixed_rows::<3>(0).norm() / 0.3).max(step[4].abs() / 0.5);
            let mut step = step / long.max(1.0);
            let mut g_next = of(&(x + step));
            // Where friction turns, a full step may overshoot.
            for _ in 0..if inverse.is_none() { CUTS } else { 0 } {
                if g_next.norm() < g.norm() {
                    break;
                }
                step *= 0.4;
                g_next = of(&(x + step));
            }
            let next = x + step;
            let fast = g_next.norm() < 0.3 * g.norm();
            if inverse.is_some() && !fast {
                inverse = None;
                continue;
            }
            inverse = fast.then_some(by);
            (x, g) = (next, g_next);
        }
        Err(WireError::NoEquilibrium { residual: g.norm() }.into())
    }

    fn touch_at(&self, x: &V5, base_mm: &V3, last: &Touch) -> Touch {
        let (axis_mm, s) = (V3::new(x[0], x[1], x[2]), x[4]);
        let world_mm = axis_mm + base_mm;
        let normal = self.body.closest(&world_mm).1;
        let (pull, mobilised) = self.pull(&world_mm, s, &normal, last);
        let force_n = pull * x[3];
        let tangent = self.wire.march(&axis_mm, &force_n, s, 2).1;
        Touch {
            axis_mm,
            arclength_mm: s,
            normal,
            tangent,
            normal_n: x[3],
            force_n,
            moment_nmm: axis_mm.cross(&force_n),
            mobilised,
            world_mm,
        }
    }

    /// How deep the wire lies in a body away from the contact, mm: more than a little means a
    /// second contact.
    pub fn overlap_mm(&self, body: &Body) -> f64 {
        let line = match &self.touch {
            None => {
                return -Slide::new(self.wire, body, self.friction, self.base_mm)
                    .free_gap(&self.base_mm)
                    .0;
            }
            Some(t) => {
                let held = crate::rod::Equilibrium {
                    force_n: t.force_n,
                    arclength_mm: t.arclength_mm,
                    tangent: t.tangent,
                    moment_nmm: t.moment_nmm,
                };
                self.wire.centre_line(Some((&t.axis_mm, &held)), 1.0)
            }
        };
        let depth = |p: &V3| self.wire.radius_mm() - body.closest(&(p + self.base_mm)).0;
        line.iter().map(depth).fold(f64::NEG_INFINITY, f64::max)
    }
}
