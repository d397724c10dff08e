//! What of a sweep is not known beside the calibration, and the gap between wire and object under
//! it.
//!
//! ```text
//! eta = (clock tau, place x, turn w, size s, friction mu - mu_0) / standard deviations       ~ N(0, 1) each, before the sweep
//! q  -> c + (1 + s) R(w) (q - c) + x            the object about its centre c;        base at t: its pose at t + tau
//! n' ~ n + mu v_t / |v_t|                       force n without its friction, which acts against the sliding v_t
//! d  = D(p + (a + rho) n') - a - rho            D: distance from the object, p: the axis, a: radius of the wire
//! s* = argmin_s  d^2 + (L angle(n', grad D))^2  along the curve that the moments allow
//! ```
//!
//! A contact presses along the surface's normal: with n' = grad D a point that is rho farther out
//! lies rho farther from the surface, and there normals turn evenly about edges.

use crate::sweep_record::SweepRow;
use nalgebra::{Isometry3, SVector, Translation3, UnitQuaternion, Vector3};
use wcal_core::WireFrame;
use wcal_mesh::Mesh;
use wcal_network::InverseSolution;

/// Numbers of the unknowns: clock, place (3), turn (3), size, friction.
pub(super) const UNKNOWNS: usize = 9;
/// The unknowns, each in its standard deviation.
pub(super) type Unknowns = SVector<f64, UNKNOWNS>;

/// Friction of a wire on an object, 0 to 0.3 equally likely: mean and standard deviation.
const FRICTION: [f64; 2] = [0.15, 0.087];
/// What an angle between force and normal counts, mm/rad: the wire's lever, some centimetres.
const LEVER_MM_PER_RAD: f64 = 30.0;
/// Surfaces farther away than this are not looked for, mm.
pub(super) const REACH_MM: f64 = 50.0;
/// So far outside the wire the object's normals are taken, mm.
const OUTSIDE_MM: f64 = 3.0;
/// Each so many nodes of the curve are looked at first.
const STRIDE: usize = 4;

/// Where the base is at any time; beyond its ends it goes on as it did there.
pub(super) struct BasePath(Vec<(f64, Isometry3<f64>)>);

impl BasePath {
    /// Of a sweep's readings, in order of time.
    pub(crate) fn new(rows: &[SweepRow]) -> Self {
        let mut path: Vec<_> = rows.iter().map(|r| (r.t_s, r.world_from_base)).collect();
        // Between two poses of one time there is no speed.
        path.dedup_by(|later, first| later.0 <= first.0);
        Self(path)
    }

    /// Pose at a time.
    pub(crate) fn at(&self, t_s: f64) -> Isometry3<f64> {
        let path = &self.0;
        let k = path
            .partition_point(|p| p.0 <= t_s)
            .clamp(1, path.len().max(2) - 1);
        let (Some(from), Some(to)) = (path.get(k - 1), path.get(k)) else {
            return path[0].1;
        };
        let u = (t_s - from.0) / (to.0 - from.0);
        // The turn between two poses goes at an even rate about one axis.
        let turn = UnitQuaternion::from_scaled_axis(
            (from.1.rotation.inverse() * to.1.rotation).scaled_axis() * u,
        );
        let place = from.1.translation.vector.lerp(&to.1.translation.vector, u);
        Isometry3::from_parts(Translation3::from(place), from.1.rotation * turn)
    }
}

/// A place on the curve, by node and share of the way to the next.
#[derive(Debug, Clone, Copy)]
pub(super) struct Gap {
    pub d_mm: f64,
    pub node: usize,
}

/// The object with what is not known of it, and the wire's frame.
pub(super) struct Scene<'a> {
    pub mesh: &'a Mesh,
    pub world_from_object: Isometry3<f64>,
    pub frame: &'a WireFrame,
    pub radius_mm: f64,
    pub path: BasePath,
    /// Standard deviations: clock (s), place (mm), turn (degrees), size (relative).
    pub sd: [f64; 4],
}

impl Scene<'_> {
    /// The gap of the contacts that a reading's moments allow; near a node where one is given. None
    /// where the object is out of reach.
    pub(crate) fn gap(
        &self,
        curve: &[InverseSolution],
        t_s: f64,
        eta: &Unknowns,
        near: Option<usize>,
    ) -> Option<Gap> {
        let [clock_s, place_mm, turn_deg, size] = self.sd;
        let t_s = t_s + eta[0] * clock_s;
        let step_s = 1e-3;
        let (base, next) = (self.path.at(t_s), self.path.at(t_s + step_s));
        let scale = 1.0 + size * eta[7];
        let friction = FRICTION[0] + FRICTION[1] * eta[8];
        let middle = self.world_from_object
            * nalgebra::Point3::from((self.mesh.low_mm + self.mesh.high_mm) / 2.0);
        let moved = Vector3::new(eta[1], eta[2], eta[3]) * place_mm;
        let turn = UnitQuaternion::from_scaled_axis(
            Vector3::new(eta[4], eta[5], eta[6]) * turn_deg.to_radians(),
        );
        // From the world to the object as declared.
        let back =
            |p: &Vector3<f64>| turn.inverse() * (p - middle.coords - moved) / scale + middle.coords;
        // Gap and cost of a touched point with the direction of its force.
        let at = |point: &Vector3<f64>, force: &Vector3<f64>| -> Option<(f64, f64)> {
            // The force on the wire points off the object: the axis lies one radius along it.
            let axis = self.frame.rotation().inverse() * (point + force * self.radius_mm);
            let (place, later) = (
                base * nalgebra::Point3::from(axis),
                next * nalgebra::Point3::from(axis),
            );
            let n = base.rotation * (self.frame.rotation().inverse() * force);
            let slide = (later - place) / step_s;
            // What of the wire's motion is along the surface, the friction opposes.
            let along = (slide - n * n.dot(&slide))
                .try_normalize(1e-6)
                .unwrap_or_default();
            let normal = (n + along * friction).normalize();
            let out = place.coords + normal * (self.radius_mm + OUTSIDE_MM);
            let seen = self.world_from_object.inverse() * nalgebra::Point3::from(back(&out));
            let near = self.mesh.closest_point(&seen.coords, REACH_MM)?;
            // Distances are measured on the object as declared; true ones are larger by its scale.
            let d = near.distance_mm * scale - self.radius_mm - OUTSIDE_MM;
            let outward = turn * (self.world_from_object.rotation * near.normal);
            let angle = normal.dot(&outward).clamp(-1.0, 1.0).acos();
            Some((d, d.hypot(LEVER_MM_PER_RAD * angle)))
        };
        let cost = |k: usize| {
            let s = curve.get(k).filter(|s| s.reachable)?;
            at(&s.point_mm, &s.normal).map(|(_, cost)| cost)
        };
        let least = |nodes: &mut dyn Iterator<Item = usize>| {
            nodes
                .filter_map(|k| Some((k, cost(k)?)))
                .min_by(|a, b| a.1.total_cmp(&b.1))
        };
        let coarse = match near {
            Some(node) => node,
            None => least(&mut (0..curve.len()).step_by(STRIDE))?.0,
        };
        let (node, here) = least(&mut (coarse.saturating_sub(2 * STRIDE)..=coarse + 2 * STRIDE))?;
        // Between the nodes: the least of a parabola through the squares of three costs.
        let square = |k: Option<usize>| k.and_then(cost).map(|c| c * c);
        let part = match (square(node.checked_sub(1)), square(Some(node + 1))) {
            (Some(a), Some(b)) => {
                let bend = a - 2.0 * here * here + b;
                if bend > 1e-12 {
                    (0.5 * (a - b) / bend).clamp(-1.0, 1.0)
                } else {
                    0.0
                }
            }
            _ => 0.0,
        };
        let other = if part < 0.0 {
            node - 1
        } else {
            (node + 1).min(curve.len() - 1)
        };
        let (a, b, u) = (&curve[node], &curve[other], part.abs());
        let force = a.normal.lerp(&b.normal, u).try_normalize(1e-9)?;
        let (d_mm, _) = at(&a.point_mm.lerp(&b.point_mm, u), &force)?;
        Some(Gap { d_mm, node })
    }
}
