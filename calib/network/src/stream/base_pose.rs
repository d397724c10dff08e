//! Where the whisker's base is in the world, and how fast it moves.
//!
//! `p_world = R p + t`, `C_world = R C R^T`; on a stage `t(t) = t_0 + R_0 a x(t)` along the
//! direction a, x linear between two readings.

use nalgebra::{Isometry3, Matrix3, Vector3};
use std::collections::VecDeque;

/// Pose and velocity of the base at an instant.
#[derive(Debug, Clone, Copy)]
pub struct BasePose {
    /// Base coordinates to the world's, mm.
    pub world_from_base: Isometry3<f64>,
    /// Velocity, base frame, mm/s, where it is known.
    pub velocity_mm_s: Option<Vector3<f64>>,
}

impl BasePose {
    /// Speed along the base's +z, mm/s, where it is known.
    pub fn along_z_mm_s(&self) -> Option<f64> {
        self.velocity_mm_s.map(|v| v.z)
    }

    /// A point (mm) and its covariance (mm^2) in the world frame.
    pub fn to_world(
        &self,
        point_mm: &Vector3<f64>,
        covariance_mm2: &Matrix3<f64>,
    ) -> (Vector3<f64>, Matrix3<f64>) {
        let turn = self.world_from_base.rotation.to_rotation_matrix();
        let point =
            self.world_from_base.rotation * point_mm + self.world_from_base.translation.vector;
        (point, turn * covariance_mm2 * turn.inverse())
    }
}

/// A base at rest or moved along a line by a stage whose position is read from time to time.
#[derive(Debug, Clone)]
pub struct BaseMotion {
    at_zero: Isometry3<f64>,
    along: Option<Vector3<f64>>,
    way: VecDeque<(f64, f64)>,
}

/// Longest interval between positions over which they are interpolated, s.
const MAX_GAP_S: f64 = 0.5;
/// Positions that differ by less are equal, mm.
const STILL_MM: f64 = 1e-3;
/// Time by which the last positions are continued, s: the filter's last weights fall on positions
/// that are still to come.
const AHEAD_S: f64 = 0.1;
/// Positions that are kept, s.
const KEPT_S: f64 = 10.0;

impl BaseMotion {
    /// `along`: direction of the stage's travel in the base frame; none where the base stands
    /// still.
    pub fn new(at_zero: Isometry3<f64>, along: Option<Vector3<f64>>) -> Self {
        Self {
            at_zero,
            along: along.and_then(|a| a.try_normalize(1e-9)),
            way: VecDeque::new(),
        }
    }

    /// Takes a position of the stage (mm from its zero).
    pub fn push(&mut self, t_s: f64, way_mm: f64) {
        // Two positions of one time have no speed between them.
        if self.way.back().is_some_and(|last| !(t_s > last.0)) {
            return;
        }
        self.way.push_back((t_s, way_mm));
        while self.way.front().is_some_and(|first| first.0 < t_s - KEPT_S) {
            self.way.pop_front();
        }
    }

    /// Displacement along the stage's travel and its velocity, base frame (mm, mm/s), averaged over
    /// a filter's times and weights ([`LowPass::kernel`](super::LowPass::kernel)); none where the
    /// base is not carried or its positions do not reach so far.
    pub fn averaged(
        &self,
        t_s: f64,
        kernel: &[(f64, f64)],
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let along = self.along?;
        let (mut way_mm, mut speed_mm_s) = (0.0, 0.0);
        for (offset_s, weight) in kernel {
            let (way, speed) = self.way(t_s + offset_s)?;
            way_mm += weight * way;
            speed_mm_s += weight * speed;
        }
        Some((along * way_mm, along * speed_mm_s))
    }

    /// Position and speed of the stage at a time (mm, mm/s); the last positions are continued for
    /// [`AHEAD_S`].
    fn way(&self, t_s: f64) -> Option<(f64, f64)> {
        let after = self
            .way
            .partition_point(|p| p.0 <= t_s)
            .min(self.way.len().checked_sub(1)?);
        let (a, b) = (self.way.get(after.checked_sub(1)?)?, self.way.get(after)?);
        let speed = (b.1 - a.1) / (b.0 - a.0);
        // Equal positions at both ends are a standstill.
        let known = b.0 - a.0 <= MAX_GAP_S || (b.1 - a.1).abs() < STILL_MM;
        (known && t_s <= b.0 + AHEAD_S).then_some((a.1 + speed * (t_s - a.0), speed))
    }

    /// The pose at a time between two positions that are near enough; none where there are none.
    pub fn at(&self, t_s: f64) -> Option<BasePose> {
        let Some(along) = self.along else {
            return Some(BasePose {
                world_from_base: self.at_zero,
                velocity_mm_s: Some(Vector3::zeros()),
            });
        };
        let after = self.way.partition_point(|p| p.0 <= t_s);
        let (a, b) = (self.way.get(after.checked_sub(1)?)?, self.way.get(after)?);
        if b.0 - a.0 > MAX_GAP_S {
            return None;
        }
        let speed = (b.1 - a.1) / (b.0 - a.0);
        // Between two positions the stage goes evenly.
        let moved = along * (a.1 + speed * (t_s - a.0));
        // The stage carries the base along the base's own axes: its way acts before the pose.
        let world_from_base = self.at_zero * Isometry3::translation(moved.x, moved.y, moved.z);
        Some(BasePose {
            world_from_base,
            velocity_mm_s: Some(along * speed),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_carried_base_is_where_the_stage_is_and_nowhere_without_it() {
        let at_zero = Isometry3::new(
            Vector3::new(5.0, 0.0, 0.0),
            Vector3::z() * std::f64::consts::FRAC_PI_2,
        );
        let mut motion = BaseMotion::new(at_zero, Some(Vector3::new(0.0, 0.0, 2.0)));
        (0..20).for_each(|k| motion.push(0.05 * f64::from(k), 0.2 * f64::from(k)));
        let pose = motion.at(0.525).unwrap();
        assert!((pose.along_z_mm_s().unwrap() - 4.0).abs() < 1e-9);
        let spread = Matrix3::from_diagonal(&Vector3::new(1.0, 4.0, 9.0));
        let (point, spread) = pose.to_world(&Vector3::new(1.0, 0.0, 0.0), &spread);
        assert!(
            (point - Vector3::new(5.0, 1.0, 2.1)).norm() < 1e-9,
            "{point}"
        );
        assert!((spread[(0, 0)] - 4.0).abs() < 1e-9 && (spread[(1, 1)] - 1.0).abs() < 1e-9);
        // Outside the readings, and across a gap, there is no pose.
        assert!(motion.at(0.97).is_none() && motion.at(-0.1).is_none());
        motion.push(2.0, 0.0);
        assert!(motion.at(1.5).is_none());
        // Averaged over a filter: a ramp stays what it is, a corner is rounded, and nothing is
        // known far past the last position.
        let kernel: Vec<(f64, f64)> = (-10..=10)
            .map(|k| (0.01 * f64::from(k), 1.0 / 21.0))
            .collect();
        let mut ramp = BaseMotion::new(at_zero, Some(Vector3::z()));
        (0..20).for_each(|k| ramp.push(0.05 * f64::from(k), 0.2 * f64::from(k).min(10.0)));
        let (moved, velocity) = ramp.averaged(0.3, &kernel).unwrap();
        assert!(
            (moved.z - 1.2).abs() < 1e-9 && (velocity.z - 4.0).abs() < 1e-9,
            "{moved} {velocity}"
        );
        let corner = ramp.averaged(0.5, &kernel).unwrap();
        assert!(
            (1.8..1.95).contains(&corner.0.z) && (1.5..2.5).contains(&corner.1.z),
            "{corner:?}"
        );
        assert!(ramp.averaged(0.94, &kernel).is_some() && ramp.averaged(1.0, &kernel).is_none());
        ramp.push(3.0, 2.0);
        assert!(
            ramp.averaged(2.0, &kernel).is_some(),
            "a standstill is no gap"
        );
        ramp.push(5.0, 3.0);
        assert!(ramp.averaged(4.0, &kernel).is_none());
        assert!(
            BaseMotion::new(at_zero, None)
                .averaged(0.3, &kernel)
                .is_none()
        );
        assert_eq!(
            BaseMotion::new(at_zero, None)
                .at(7.0)
                .unwrap()
                .along_z_mm_s(),
            Some(0.0)
        );
    }
}
