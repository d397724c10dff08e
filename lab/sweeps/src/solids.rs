//! Closed and oriented solids that the built-in objects are made of.
//!
//! Bodies of revolution (r cos a, r sin a, z) about z, profiles smoothed by Catmull-Rom splines: 2
//! p(t) = 2 p1 + (p2 - p0) t + (2 p0 - 5 p1 + 4 p2 - p3) t^2 + (3 p1 - p0 - 3 p2 + p3) t^3 (E.
//! Catmull & R. Rom, 1974); prisms over polygons that their centre sees whole; a torus. Normals
//! point outward: triangles run counter-clockwise as seen from outside.

use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// Corners around an axis.
const AROUND: usize = 96;

/// Points and triangles.
pub(crate) type Parts = (Vec<Vector3<f64>>, Vec<[u32; 3]>);

/// Radii and heights turned about z; ends that are off the axis are closed flat.
pub(crate) fn revolved(profile: &[[f64; 2]]) -> Parts {
    let mut profile = profile.to_vec();
    if profile[0][0] > 0.0 {
        profile.insert(0, [0.0, profile[0][1]]);
    }
    let last = profile[profile.len() - 1];
    if last[0] > 0.0 {
        profile.push([0.0, last[1]]);
    }
    let rings = profile.len();
    let mut points = Vec::new();
    for [r, z] in &profile {
        for k in 0..AROUND {
            let a = TAU * k as f64 / AROUND as f64;
            points.push(Vector3::new(r * a.cos(), r * a.sin(), *z));
        }
    }
    let at = |ring: usize, k: usize| (ring * AROUND + k % AROUND) as u32;
    let mut triangles = Vec::new();
    for ring in 0..rings - 1 {
        for k in 0..AROUND {
            let [a, b, c, d] = [
                at(ring, k),
                at(ring, k + 1),
                at(ring + 1, k),
                at(ring + 1, k + 1),
            ];
            triangles.push([a, b, d]);
            triangles.push([a, d, c]);
        }
    }
    (points, triangles)
}

/// A curve through points (Catmull-Rom).
pub(crate) fn smooth(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = points.len();
    let mut curve = Vec::new();
    for k in 0..n - 1 {
        let [p0, p1, p2, p3] =
            [k.saturating_sub(1), k, k + 1, (k + 2).min(n - 1)].map(|i| points[i]);
        for step in 0..8 {
            let t = f64::from(step) / 8.0;
            curve.push([0, 1].map(|i| {
                0.5 * (2.0 * p1[i]
                    + (p2[i] - p0[i]) * t
                    + (2.0 * p0[i] - 5.0 * p1[i] + 4.0 * p2[i] - p3[i]) * t * t
                    + (3.0 * p1[i] - p0[i] - 3.0 * p2[i] + p3[i]) * t * t * t)
            }));
        }
    }
    curve.push(points[n - 1]);
    curve
}

pub(crate) fn half_circle(radius_mm: f64, steps: usize) -> Vec<[f64; 2]> {
    (0..=steps)
        .map(|k| {
            let a = PI * k as f64 / steps as f64;
            let r = if k == 0 || k == steps {
                0.0
            } else {
                radius_mm * a.sin()
            };
            [r, -radius_mm * a.cos()]
        })
        .collect()
}

pub(crate) fn polygon(corners: usize, radius_mm: impl Fn(usize) -> f64) -> Vec<[f64; 2]> {
    (0..corners)
        .map(|k| {
            let a = TAU * k as f64 / corners as f64;
            [radius_mm(k) * a.cos(), radius_mm(k) * a.sin()]
        })
        .collect()
}

/// A polygon that its centre sees whole, counter-clockwise, with a height about z.
pub(crate) fn prism(polygon: &[[f64; 2]], height_mm: f64) -> Parts {
    let n = polygon.len() as f64;
    let centre = polygon
        .iter()
        .fold([0.0, 0.0], |a, p| [a[0] + p[0] / n, a[1] + p[1] / n]);
    prism_from(polygon, height_mm, centre)
}

/// The same with a place that sees the polygon whole.
pub(crate) fn prism_from(polygon: &[[f64; 2]], height_mm: f64, centre: [f64; 2]) -> Parts {
    let n = polygon.len();
    let ring = |z: f64| polygon.iter().map(move |[x, y]| Vector3::new(*x, *y, z));
    let mut points: Vec<Vector3<f64>> = ring(-height_mm / 2.0)
        .chain(ring(height_mm / 2.0))
        .collect();
    points.push(Vector3::new(centre[0], centre[1], -height_mm / 2.0));
    points.push(Vector3::new(centre[0], centre[1], height_mm / 2.0));
    let (below, above) = ((2 * n) as u32, (2 * n + 1) as u32);
    let mut triangles = Vec::new();
    for k in 0..n {
        let [a, b] = [k as u32, ((k + 1) % n) as u32];
        let [c, d] = [a + n as u32, b + n as u32];
        triangles.extend([[a, b, d], [a, d, c], [below, b, a], [above, c, d]]);
    }
    (points, triangles)
}

pub(crate) fn ring(radius_mm: f64, tube_mm: f64) -> Parts {
    const TUBE: usize = 48;
    let mut points = Vec::new();
    for i in 0..AROUND {
        for k in 0..TUBE {
            let (a, b) = (TAU * i as f64 / AROUND as f64, TAU * k as f64 / TUBE as f64);
            let r = radius_mm + tube_mm * b.cos();
            points.push(Vector3::new(r * a.cos(), r * a.sin(), tube_mm * b.sin()));
        }
    }
    let at = |i: usize, k: usize| ((i % AROUND) * TUBE + k % TUBE) as u32;
    let mut triangles = Vec::new();
    for i in 0..AROUND {
        for k in 0..TUBE {
            let [a, b, c, d] = [at(i, k), at(i + 1, k), at(i, k + 1), at(i + 1, k + 1)];
            triangles.push([a, b, d]);
            triangles.push([a, d, c]);
        }
    }
    (points, triangles)
}

/// A ball with bumps.
pub(crate) fn rock() -> Parts {
    let (points, triangles) = revolved(&half_circle(1.0, 64));
    let bumps = |p: &Vector3<f64>| {
        1.0 + 0.12 * (2.3 * p.x + 0.7).sin() * (1.9 * p.y - 0.4).cos()
            + 0.07 * (4.1 * p.z + 2.0 * p.x).sin()
            + 0.03 * (7.0 * p.y + 5.0 * p.z).cos()
    };
    let stretch = Vector3::new(38.0, 30.0, 26.0);
    (
        points
            .iter()
            .map(|p| (p * bumps(p)).component_mul(&stretch))
            .collect(),
        triangles,
    )
}
