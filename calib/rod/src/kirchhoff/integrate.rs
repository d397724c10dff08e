//! The loaded wire from the clamp outwards: g' = g (u, e1) ([`se3`](crate::se3)) with u(s) =
//! u0(s) + D^-1 R^T ((P - r) x F + M_w(s)).

use crate::dual::{Scalar, V3, cross, mat_t_vec, sub};
use crate::material::Section;
use crate::se3::{Pose, Twist, step};
use crate::shape::{Interval, Shape};
use nalgebra::Vector3;

/// What bends the wire: the contact force at the groove, and moments of distributed loads.
pub struct Load<'a, T> {
    /// Groove point, mm.
    pub point: V3<T>,
    /// Contact force on the wire, N.
    pub force: V3<T>,
    /// Moment about s of the weight distal to s, N mm, on a uniform grid.
    pub distributed: Option<&'a MomentTable>,
}

/// Moment vectors on a uniform grid of arc length, linear in between.
#[derive(Debug, Clone, PartialEq)]
pub struct MomentTable {
    /// Grid spacing, mm.
    pub step_mm: f64,
    /// Moments, N mm.
    pub moments_nmm: Vec<Vector3<f64>>,
}

impl MomentTable {
    /// Moment at arc length `s_mm`.
    pub fn at(&self, s_mm: f64) -> Vector3<f64> {
        let last = self.moments_nmm.len() - 1;
        let x = (s_mm / self.step_mm).clamp(0.0, last as f64);
        let j = (x as usize).min(last.saturating_sub(1));
        let f = x - j as f64;
        self.moments_nmm[j] * (1.0 - f) + self.moments_nmm[(j + 1).min(last)] * f
    }
}

#[inline(always)]
fn twist_at<T: Scalar>(
    section: &Section,
    length_mm: f64,
    interval: &Interval,
    offset_mm: f64,
    g: &Pose<T>,
    load: &Load<T>,
) -> Twist<T> {
    let s = interval.start_mm + offset_mm;
    // Moment about s of what acts beyond s: (P - r) x F + M_w(s).
    let mut moment = cross(&sub(&load.point, &g.position), &load.force);
    if let Some(table) = load.distributed {
        let extra = table.at(s);
        for i in 0..3 {
            moment[i] = moment[i] + T::constant(extra[i]);
        }
    }
    // Constitutive law in body axes; the inextensible wire goes along e1.
    let body = mat_t_vec(&g.frame, &moment);
    let du = section.curvature_change(&body, section.taper_factor(s / length_mm));
    let u = [0, 1, 2]
        .map(|i| du[i] + T::constant(interval.u_start[i] + interval.u_slope[i] * offset_mm));
    (u, [T::constant(1.0), T::constant(0.0), T::constant(0.0)])
}

/// Pose at arc length `end_mm` of the loaded wire, starting from `root`; `visit` sees every mesh
/// node passed, root included.
pub fn to_arclength<T: Scalar>(
    section: &Section,
    shape: &Shape,
    root: Pose<T>,
    load: &Load<T>,
    end_mm: f64,
    mut visit: impl FnMut(f64, &Pose<T>),
) -> Pose<T> {
    let mut g = root;
    visit(0.0, &g);
    for (j, interval) in shape.intervals.iter().enumerate() {
        let last = j + 1 == shape.intervals.len();
        let room = end_mm - interval.start_mm;
        if room <= 0.0 {
            break;
        }
        // Past the tip the last interval goes on with its curvature law, so that Newton sees a
        // smooth function there.
        let h = if last {
            room
        } else {
            room.min(interval.length_mm)
        };
        let twist = |offset_mm: f64, g: &Pose<T>| {
            twist_at(section, shape.length_mm, interval, offset_mm, g, load)
        };
        g = step(h, &g, twist);
        visit(interval.start_mm + h, &g);
    }
    g
}
