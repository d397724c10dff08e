//! Flat surfaces: blocks, tags, a chessboard.

use nalgebra::{Isometry3, Point3, Vector2, Vector3};

use super::tags::TAG_CELLS;

/// What a face shows at a place in its plane.
#[derive(Debug, Clone, PartialEq)]
pub enum Paint {
    /// One reflectance.
    Plain(f64),
    /// A tag about the plane's origin (x right, y down).
    Tag {
        /// White cells.
        cells: [[bool; TAG_CELLS]; TAG_CELLS],
        /// Side of the black square, mm.
        size_mm: f64,
        /// Reflectances of black and white.
        shades: [f64; 2],
    },
    /// A chessboard about the plane's origin on a white sheet.
    Board {
        /// Squares across and down.
        squares: [usize; 2],
        /// Side of a square, mm.
        square_mm: f64,
        /// Reflectances of black and white.
        shades: [f64; 2],
    },
}

impl Paint {
    /// Reflectance at (a, b) mm in the plane.
    fn at(&self, p: Vector2<f64>) -> f64 {
        match self {
            Self::Plain(shade) => *shade,
            Self::Tag {
                cells,
                size_mm,
                shades,
            } => {
                // The black square is eight cells wide, with one more of white on each side.
                let cell =
                    |v: f64| ((v * 8.0 / size_mm + 5.0).max(0.0) as usize).min(TAG_CELLS - 1);
                shades[usize::from(cells[cell(p.y)][cell(p.x)])]
            }
            Self::Board {
                squares,
                square_mm,
                shades,
            } => {
                let index = |k: usize| (p[k] / square_mm + 0.5 * squares[k] as f64).floor();
                let [x, y] = [index(0), index(1)];
                let inside = |v: f64, n: usize| v >= 0.0 && v < n as f64;
                let on = inside(x, squares[0]) && inside(y, squares[1]);
                shades[usize::from(!(on && (x + y) % 2.0 == 0.0))]
            }
        }
    }
}

/// A convex polygon of a plane.
#[derive(Debug, Clone, PartialEq)]
pub struct Face {
    /// Takes plane coordinates (x, y in the plane, z its normal) to base coordinates, mm.
    pub base_from_plane: Isometry3<f64>,
    /// Corners in the plane, mm, in order.
    pub corners: Vec<[f64; 2]>,
    /// What it shows.
    pub paint: Paint,
}

impl Face {
    /// A plain face through base points, in order.
    pub fn through(points: &[Vector3<f64>], shade: f64) -> Option<Self> {
        let [a, b, c] = [points.first()?, points.get(1)?, points.last()?];
        let x = (b - a).normalize();
        let z = x.cross(&(c - a)).normalize();
        let axes = nalgebra::Matrix3::from_columns(&[x, z.cross(&x), z]);
        let turn = nalgebra::UnitQuaternion::from_rotation_matrix(
            &nalgebra::Rotation3::from_matrix_unchecked(axes),
        );
        let base_from_plane = Isometry3::from_parts((*a).into(), turn);
        let flat = |p: &Vector3<f64>| {
            let q = base_from_plane.inverse_transform_point(&Point3::from(*p));
            [q.x, q.y]
        };
        Some(Self {
            base_from_plane,
            corners: points.iter().map(flat).collect(),
            paint: Paint::Plain(shade),
        })
    }

    /// A rectangle about the plane's origin, `half` mm each way.
    pub fn sheet(base_from_plane: Isometry3<f64>, half: [f64; 2], paint: Paint) -> Self {
        let [a, b] = half;
        Self {
            base_from_plane,
            corners: vec![[-a, -b], [a, -b], [a, b], [-a, b]],
            paint,
        }
    }

    /// The face as a camera sees it.
    pub(super) fn view(&self, camera_from_base: &Isometry3<f64>) -> SeenFace<'_> {
        let pose = camera_from_base * self.base_from_plane;
        let turn = pose.rotation.to_rotation_matrix();
        let axis = |k: usize| turn.matrix().column(k).into_owned();
        let [u, v, normal] = [axis(0), axis(1), axis(2)];
        let origin = pose.translation.vector;
        // Inside a convex polygon: on the same side of every edge.
        let n = self.corners.len();
        // Twice the signed area: its sign tells which way round the corners run.
        let area: f64 = (0..n)
            .map(|k| {
                let ([ax, ay], [bx, by]) = (self.corners[k], self.corners[(k + 1) % n]);
                ax * by - bx * ay
            })
            .sum();
        let edges = (0..n)
            .map(|k| {
                let ([ax, ay], [bx, by]) = (self.corners[k], self.corners[(k + 1) % n]);
                let (nx, ny) = ((ay - by) * area.signum(), (bx - ax) * area.signum());
                [nx, ny, -(nx * ax + ny * ay)]
            })
            .collect();
        SeenFace {
            origin,
            u,
            v,
            normal,
            offset: origin.dot(&normal),
            edges,
            paint: &self.paint,
        }
    }
}

/// A face in the camera's frame.
pub(super) struct SeenFace<'a> {
    origin: Vector3<f64>,
    u: Vector3<f64>,
    v: Vector3<f64>,
    normal: Vector3<f64>,
    offset: f64,
    edges: Vec<[f64; 3]>,
    paint: &'a Paint,
}

impl SeenFace<'_> {
    /// Depth (mm) and reflectance where the ray (x, y, 1) meets the face.
    pub(super) fn hit(&self, ray: &Vector2<f64>) -> Option<(f64, f64)> {
        let along = self.normal.x * ray.x + self.normal.y * ray.y + self.normal.z;
        let depth = self.offset / along;
        // A ray along the plane meets it nowhere, or farther off than anything is.
        if !(depth > 0.0 && depth < 1e6) {
            return None;
        }
        let off = Vector3::new(ray.x * depth, ray.y * depth, depth) - self.origin;
        let p = Vector2::new(off.dot(&self.u), off.dot(&self.v));
        let inside = self
            .edges
            .iter()
            .all(|[a, b, c]| a * p.x + b * p.y + c >= 0.0);
        inside.then(|| (depth, self.paint.at(p)))
    }
}
