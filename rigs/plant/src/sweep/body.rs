//! Rigid objects that a wire slides over: a convex outline in the plane (u, v), extruded along its own axis.
//!
//! ```text
//! ellipse       u^2/a^2 + v^2/b^2 = 1
//! rounded box   all points at the distance r from the box |u| <= a - r, |v| <= b - r
//! world = centre + R (u, w, v),  w along the axis
//! ```

use nalgebra::{Matrix3, Vector2, Vector3};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::fmt::Write as _;

/// Outline of a body.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outline {
    /// Semi-axes, mm.
    Ellipse {
        /// Along u.
        a_mm: f64,
        /// Along v.
        b_mm: f64,
    },
    /// Half widths and radius of the edges, mm.
    RoundedBox {
        /// Along u.
        a_mm: f64,
        /// Along v.
        b_mm: f64,
        /// Of the edges.
        edge_mm: f64,
    },
}

/// An extruded outline in space.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Cross-section.
    pub outline: Outline,
    /// World place of the middle, mm.
    pub centre_mm: Vector3<f64>,
    /// Columns: u, axis, v in the world.
    pub turn: Matrix3<f64>,
    /// Half length along the axis, mm.
    pub half_mm: f64,
}

/// Pieces of the outline of a mesh.
const PIECES: usize = 240;

impl Outline {
    /// Signed distance (mm, positive outside) and outward normal at the nearest point of the outline.
    #[must_use]
    pub fn closest(&self, at: &Vector2<f64>) -> (f64, Vector2<f64>) {
        match *self {
            Self::Ellipse { a_mm, b_mm } => ellipse(a_mm, b_mm, at),
            Self::RoundedBox { a_mm, b_mm, edge_mm } => rounded(a_mm - edge_mm, b_mm - edge_mm, edge_mm, at),
        }
    }

    /// Points around the outline, counter-clockwise from u toward v.
    fn points(&self) -> Vec<Vector2<f64>> {
        let along = |k: usize| {
            let angle = TAU * k as f64 / PIECES as f64;
            let (sin, cos) = angle.sin_cos();
            match *self {
                Self::Ellipse { a_mm, b_mm } => Vector2::new(a_mm * cos, b_mm * sin),
                Self::RoundedBox { a_mm, b_mm, edge_mm } => {
                    let corner = Vector2::new((a_mm - edge_mm).copysign(cos), (b_mm - edge_mm).copysign(sin));
                    corner + Vector2::new(cos, sin) * edge_mm
                }
            }
        };
        (0..PIECES).map(along).collect()
    }
}

/// Nearest point of an ellipse by its angle: Newton's iteration on `d/dt |(a cos t, b sin t) - p|^2 = 0` in the first quadrant, bracketed.
fn ellipse(a: f64, b: f64, at: &Vector2<f64>) -> (f64, Vector2<f64>) {
    let p = at.abs();
    let slope = |t: f64| (b * b - a * a) * t.sin() * t.cos() + p.x * a * t.sin() - p.y * b * t.cos();
    let (mut low, mut high) = (0.0, FRAC_PI_2);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if slope(middle) < 0.0 { low = middle } else { high = middle }
    }
    let (sin, cos) = (0.5 * (low + high)).sin_cos();
    let normal = Vector2::new(b * cos, a * sin).normalize();
    let distance = (p - Vector2::new(a * cos, b * sin)).dot(&normal);
    (distance, Vector2::new(normal.x.copysign(at.x), normal.y.copysign(at.y)))
}

fn rounded(a: f64, b: f64, edge: f64, at: &Vector2<f64>) -> (f64, Vector2<f64>) {
    let over = at.abs() - Vector2::new(a, b);
    let (distance, normal) = if over.x > 0.0 && over.y > 0.0 {
        (over.norm(), over.normalize())
    } else if over.x > over.y {
        (over.x, Vector2::x())
    } else {
        (over.y, Vector2::y())
    };
    (distance - edge, Vector2::new(normal.x.copysign(at.x), normal.y.copysign(at.y)))
}

impl Body {
    /// Signed distance (mm) and outward normal of the surface at the point nearest to a place in the world; the ends are far away.
    #[must_use]
    pub fn closest(&self, place_mm: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let local = self.turn.tr_mul(&(place_mm - self.centre_mm));
        let (distance, n) = self.outline.closest(&Vector2::new(local.x, local.z));
        (distance, self.turn * Vector3::new(n.x, 0.0, n.y))
    }

    /// The surface as text of an STL file, mm, world frame.
    #[must_use]
    pub fn stl(&self) -> String {
        let ring = self.outline.points();
        let at = |p: &Vector2<f64>, w: f64| self.centre_mm + self.turn * Vector3::new(p.x, w, p.y);
        let mut out = "solid body\n".to_owned();
        let mut facet = |corners: [Vector3<f64>; 3]| {
            let n = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).normalize();
            let _ = write!(out, "facet normal {} {} {}\nouter loop\n", n.x, n.y, n.z);
            for c in corners {
                let _ = writeln!(out, "vertex {} {} {}", c.x, c.y, c.z);
            }
            out.push_str("endloop\nendfacet\n");
        };
        let h = self.half_mm;
        for (k, p) in ring.iter().enumerate() {
            let q = &ring[(k + 1) % ring.len()];
            // (u, w, v) is left-handed: the axis points away from u x v.
            facet([at(p, -h), at(p, h), at(q, -h)]);
            facet([at(q, -h), at(p, h), at(q, h)]);
            facet([at(&Vector2::zeros(), h), at(q, h), at(p, h)]);
            facet([at(&Vector2::zeros(), -h), at(p, -h), at(q, -h)]);
        }
        out.push_str("endsolid body\n");
        out
    }
}
