//! A true contact on the curve of inverse solutions, with derivatives by place and moments.
//!
//! `p(q, m)`, `n(q, m)`: point and direction of the force at node q, linear between nodes; derivatives by q from node to node, by m by
//! differences over `STEP_NMM`; depth `n . (p(q, m) - p(q, 0))`, 0 the limit of small moments in the direction of m.

use crate::inverse::{InverseSolution, StaticInverse};
use crate::sweep_series::{Contact, SweepSample};
use nalgebra::{Matrix3, Vector3};

/// Step of the moments for derivatives, N mm.
const STEP_NMM: f64 = 0.01;
/// Moment of a wire practically at rest, N mm.
const REST_NMM: f64 = 1e-5;
/// Contacts farther from the curve than this are not explained by one force across the wire, mm.
const MAX_OFF_MM: f64 = 0.5;
/// Nodes so far from the true arc length are looked at, mm.
const NEAR_MM: f64 = 1.5;

/// A contact on the curve of its moments.
#[derive(Debug, Clone, PartialEq)]
pub struct CurveState {
    /// Place on the curve, nodes.
    pub q: f64,
    /// Whether the end of the wire touches.
    pub at_tip: bool,
    /// The true contact point, mm.
    pub point_mm: Vector3<f64>,
    /// Direction of the force.
    pub normal: Vector3<f64>,
    /// Derivatives of the point (columns by q, m_y, m_z), mm by nodes and N mm.
    pub point_by: Matrix3<f64>,
    /// The same of the direction.
    pub normal_by: Matrix3<f64>,
    /// The same of the deflection along the force.
    pub depth_by: [f64; 3],
    /// Axis about which a force cannot turn without moments that turn: across the curve and the force.
    pub axis: Option<Vector3<f64>>,
}

impl CurveState {
    /// The place on the curve of a sample's moments that is nearest to the true contact; none where no single contact explains both.
    pub fn of_contact(inverse: &StaticInverse, sample: &SweepSample, truth: &Contact) -> Option<Self> {
        let [y, z] = sample.moment_nmm;
        let size = y.hypot(z);
        if !(size > REST_NMM) {
            return None;
        }
        let at = |moment_nmm: [f64; 2]| {
            let mut all = Vec::new();
            inverse.solutions(moment_nmm, &mut all);
            all
        };
        let here = at([y, z]);
        let (low, u) = nearest(inverse, &here, truth)?;
        let at_tip = low >= inverse.first_tip().saturating_sub(1) && inverse.first_tip() < here.len();
        let mixed = |all: &[InverseSolution]| {
            let mix =
                |of: fn(&InverseSolution) -> Vector3<f64>| of(&all[low]) * (1.0 - u) + of(&all[low + 1]) * u;
            (mix(|s| s.point_mm), mix(|s| s.normal))
        };
        let (point, normal) = mixed(&here);
        // From node to node on this part of the curve.
        let by_q = (here[low + 1].point_mm - here[low].point_mm, here[low + 1].normal - here[low].normal);
        let [by_y, by_z] = [[y + STEP_NMM, z], [y, z + STEP_NMM]].map(|m| {
            let (p, n) = mixed(&at(m));
            ((p - point) / STEP_NMM, (n - normal) / STEP_NMM)
        });
        let rest = at([y / size * REST_NMM, z / size * REST_NMM]);
        let rest_by_q = rest[low + 1].point_mm - rest[low].point_mm;
        let normal = normal.try_normalize(0.1)?;
        let point_by = Matrix3::from_columns(&[by_q.0, by_y.0, by_z.0]);
        let mut depth = point_by.transpose() * normal;
        depth.x -= normal.dot(&rest_by_q);
        let along = if at_tip { point } else { by_q.0 };
        Some(Self {
            q: low as f64 + u,
            at_tip,
            point_mm: truth.point_mm,
            normal,
            point_by,
            normal_by: Matrix3::from_columns(&[by_q.1, by_y.1, by_z.1]),
            depth_by: depth.into(),
            axis: along.cross(&normal).try_normalize(1e-12),
        })
    }
}

/// Segment of the curve, and the share along it, nearest to a true contact.
fn nearest(inverse: &StaticInverse, here: &[InverseSolution], truth: &Contact) -> Option<(usize, f64)> {
    let near = |k: usize| {
        let usable = here[k].reachable && here[k + 1].reachable;
        usable && (inverse.nodes[k].arclength_mm - truth.arclength_mm).abs() < NEAR_MM
    };
    let on = |k: usize| {
        let (a, b) = (here[k].point_mm, here[k + 1].point_mm);
        let along = b - a;
        let u = ((truth.point_mm - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
        (k, u, (a + along * u - truth.point_mm).norm())
    };
    (0..here.len().saturating_sub(1))
        .filter(|k| near(*k))
        .map(on)
        .min_by(|a, b| a.2.total_cmp(&b.2))
        .filter(|(.., off_mm)| *off_mm <= MAX_OFF_MM)
        .map(|(k, u, _)| (k, u))
}
