//! Rigid objects that a wire slides over: a convex outline in the plane (u, v), extruded along its
//! own axis.
//!
//! ```text
//! ellipse       u^2/a^2 + v^2/b^2 = 1
//! rounded box   all points at the distance r from the box |u| <= a - r, |v| <= b - r
//! world = centre + R (u, w, v),  w along the axis
//! ```

use crate::rod::Wire;
use nalgebra::{Matrix3, Rotation3, Vector2, Vector3};
use rand::{Rng, RngExt};
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
    /// Draws one of some millimetres.
    pub(super) fn draw(rng: &mut impl Rng) -> Self {
        match rng.random_range(0..3_u32) {
            0 => {
                let r = rng.random_range(6.0..25.0);
                Self::Ellipse { a_mm: r, b_mm: r }
            }
            1 => Self::Ellipse {
                a_mm: rng.random_range(6.0..25.0),
                b_mm: rng.random_range(6.0..25.0),
            },
            _ => Self::RoundedBox {
                a_mm: rng.random_range(8.0..20.0),
                b_mm: rng.random_range(8.0..20.0),
                edge_mm: rng.random_range(2.0..6.0),
            },
        }
    }

    /// Signed distance (mm, positive outside) and outward normal at the nearest point of the
    /// outline.
    pub fn closest(&self, at: &Vector2<f64>) -> (f64, Vector2<f64>) {
        match *self {
            Self::Ellipse { a_mm, b_mm } => ellipse(a_mm, b_mm, at),
            Self::RoundedBox {
                a_mm,
                b_mm,
                edge_mm,
            } => rounded(a_mm - edge_mm, b_mm - edge_mm, edge_mm, at),
        }
    }

    /// Points around the outline, counter-clockwise from u toward v.
    fn points(&self) -> Vec<Vector2<f64>> {
        let along = |k: usize| {
            let angle = TAU * k as f64 / PIECES as f64;
            let (sin, cos) = angle.sin_cos();
            match *self {
                Self::Ellipse { a_mm, b_mm } => Vector2::new(a_mm * cos, b_mm * sin),
                Self::RoundedBox {
                    a_mm,
                    b_mm,
                    edge_mm,
                } => {
                    let corner = Vector2::new(
                        (a_mm - edge_mm).copysign(cos),
                        (b_mm - edge_mm).copysign(sin),
                    );
                    corner + Vector2::new(cos, sin) * edge_mm
                }
            }
        };
        (0..PIECES).map(along).collect()
    }
}

/// Nearest point of an ellipse by its angle: Newton's iteration on
/// `d/dt |(a cos t, b sin t) - p|^2 = 0` in the first quadrant, bracketed.
fn ellipse(a: f64, b: f64, at: &Vector2<f64>) -> (f64, Vector2<f64>) {
    let p = at.abs();
    let (mut low, mut high) = (0.0, FRAC_PI_2);
    // Off the axes, where deep inside a long ellipse the farthest point is stationary, too.
    let mut t = (p.y * a).atan2(p.x * b).clamp(1e-6, FRAC_PI_2 - 1e-6);
    for _ in 0..60 {
        let (sin, cos) = t.sin_cos();
        let slope = (b * b - a * a) * sin * cos + p.x * a * sin - p.y * b * cos;
        if slope < 0.0 {
            low = t
        } else {
            high = t
        }
        let rate = (b * b - a * a) * (cos * cos - sin * sin) + p.x * a * cos + p.y * b * sin;
        let newton = t - slope / rate;
        let next = if rate > 0.0 && (low..=high).contains(&newton) {
            newton
        } else {
            0.5 * (low + high)
        };
        let step = (next - t).abs();
        t = next;
        if step < 1e-15 {
            break;
        }
    }
    let (sin, cos) = t.sin_cos();
    let normal = Vector2::new(b * cos, a * sin).normalize();
    let distance = (p - Vector2::new(a * cos, b * sin)).dot(&normal);
    (
        distance,
        Vector2::new(normal.x.copysign(at.x), normal.y.copysign(at.y)),
    )
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
    (
        distance - edge,
        Vector2::new(normal.x.copysign(at.x), normal.y.copysign(at.y)),
    )
}

impl Body {
    /// Across the free wire, tilted about the world's x and z.
    pub(super) fn draw(
        outline: Outline,
        rng: &mut impl Rng,
        wire: &Wire,
        about_x: f64,
        about_z: f64,
    ) -> Self {
        let within = Rotation3::from_axis_angle(&Vector3::y_axis(), rng.random_range(-0.8..0.8));
        let turn: Matrix3<f64> = (Rotation3::from_axis_angle(&Vector3::x_axis(), about_x)
            * Rotation3::from_axis_angle(&Vector3::z_axis(), about_z)
            * within)
            .into();
        let mut body = Self {
            outline,
            centre_mm: Vector3::zeros(),
            turn,
            half_mm: 60.0,
        };
        // How near to the root the body reaches, as a share of the free wire's reach.
        let near = rng.random_range(0.55..0.88) * wire.rest(wire.length_mm).0.x;
        let extent = 1e4 - body.closest(&Vector3::new(-1e4, 0.0, 0.0)).0;
        body.centre_mm = Vector3::x() * (near + extent);
        body
    }

    /// Signed distance (mm) and outward normal of the surface at the point nearest to a place in
    /// the world; the ends are far away.
    pub fn closest(&self, place_mm: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let local = self.turn.tr_mul(&(place_mm - self.centre_mm));
        let (distance, n) = self.outline.closest(&Vector2::new(local.x, local.z));
        (distance, self.turn * Vector3::new(n.x, 0.0, n.y))
    }

    /// Facets of the surface for an STL file, mm, world frame.
    pub fn facets(&self) -> String {
        let ring = self.outline.points();
        let at = |p: &Vector2<f64>, w: f64| self.centre_mm + self.turn * Vector3::new(p.x, w, p.y);
        let mut out = String::new();
        let mut facet = |corners: [Vector3<f64>; 3]| {
            let n = (corners[1] - corners[0])
                .cross(&(corners[2] - corners[0]))
                .normalize();
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
        out
    }
}
