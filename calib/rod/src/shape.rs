//! Rest shape: body curvature u0(s) along the wire, piecewise linear on a fixed mesh.
//!
//! Straight part and arc: u0 = (0, 1/radius, 0) past the straight part (the tangent turns toward
//! -z). Polyline: at an inner vertex u0 = R^T theta a / l with the turning angle theta about a and
//! l the mean length of the two edges; R is carried without twist (Bishop's frame: R. L. Bishop,
//! Amer. Math. Monthly 82, 1975).

use crate::error::RodError;
use crate::se3::{Pose, matrix_of, rows_of, step};
use nalgebra::{Matrix3, Rotation3, Unit, Vector3};
use wcal_core::observation::RestShape;

/// One mesh interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    /// Arc length of its start, mm.
    pub start_mm: f64,
    /// Its length, mm.
    pub length_mm: f64,
    /// Rest curvature at its start (body frame), 1/mm.
    pub u_start: [f64; 3],
    /// Slope of the rest curvature, 1/mm^2.
    pub u_slope: [f64; 3],
}

/// Stress-free wire on a mesh.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Intervals from root to tip.
    pub intervals: Vec<Interval>,
    /// Total length, mm.
    pub length_mm: f64,
    /// Body frame at the root; its first column is the tangent.
    pub root: Matrix3<f64>,
    /// Centre line at the interval ends, mm.
    pub nodes_mm: Vec<Vector3<f64>>,
    /// Body frame at the interval ends.
    pub frames: Vec<Matrix3<f64>>,
}

impl Shape {
    /// Mesh with intervals no longer than `step_mm`, breaks of the rest curvature on nodes.
    ///
    /// # Errors
    /// Where lengths are not positive, or the polyline has fewer than three distinct points.
    pub fn new(rest: &RestShape, step_mm: f64) -> Result<Self, RodError> {
        if !(step_mm > 0.0) {
            return Err(RodError::Shape {
                expected: "a mesh step above 0 mm",
                found: format!("{step_mm} mm"),
            });
        }
        match rest {
            RestShape::StraightArc {
                straight_mm,
                arc_radius_mm,
                length_mm,
            } => {
                if !(*length_mm > 0.0 && *arc_radius_mm > 0.0 && *straight_mm >= 0.0) {
                    return Err(RodError::Shape {
                        expected: "length and arc radius above 0 mm, straight part at least 0 mm",
                        found: format!("{length_mm}, {arc_radius_mm}, {straight_mm} mm"),
                    });
                }
                let straight = straight_mm.min(*length_mm);
                let mut pieces = Vec::new();
                if straight > 0.0 {
                    pieces.push((straight, [0.0; 3], [0.0; 3]));
                }
                if *length_mm > straight {
                    // +u2 turns the tangent toward -z.
                    let u = [0.0, 1.0 / arc_radius_mm, 0.0];
                    pieces.push((length_mm - straight, u, u));
                }
                Ok(Self::from_pieces(Matrix3::identity(), &pieces, step_mm))
            }
            RestShape::Polyline(points) => Self::from_polyline(points, step_mm),
        }
    }

    /// Both transverse curvatures (1/mm) linear between places that are spread evenly from root to
    /// tip; the root's tangent is x.
    ///
    /// # Errors
    /// For fewer than two places, or a length or step that is not positive.
    pub fn from_curvature(
        length_mm: f64,
        bends: &[[f64; 2]],
        step_mm: f64,
    ) -> Result<Self, RodError> {
        if !(length_mm > 0.0 && step_mm > 0.0) || bends.len() < 2 {
            return Err(RodError::Shape {
                expected: "two curvatures or more, length and mesh step above 0 mm",
                found: format!("{}, {length_mm} and {step_mm} mm", bends.len()),
            });
        }
        let cell_mm = length_mm / (bends.len() - 1) as f64;
        let pieces: Vec<_> = bends
            .windows(2)
            .map(|w| (cell_mm, [0.0, w[0][0], w[0][1]], [0.0, w[1][0], w[1][1]]))
            .collect();
        Ok(Self::from_pieces(Matrix3::identity(), &pieces, step_mm))
    }

    /// Curvature at an inner vertex = turning angle over the mean length of its two edges, in a
    /// frame carried without twist.
    fn from_polyline(points: &[Vector3<f64>], step_mm: f64) -> Result<Self, RodError> {
        let edges: Vec<Vector3<f64>> = points.windows(2).map(|w| w[1] - w[0]).collect();
        if edges.len() < 2 || edges.iter().any(|e| !(e.norm() > 1e-9)) {
            return Err(RodError::Shape {
                expected: "a polyline of at least three distinct points",
                found: format!("{} points", points.len()),
            });
        }
        let tangents: Vec<Vector3<f64>> = edges.iter().map(|e| e.normalize()).collect();
        // A round wire has no preferred normal: any direction across the tangent starts the frame.
        let helper = if tangents[0].z.abs() < 0.9 {
            Vector3::z()
        } else {
            Vector3::y()
        };
        let e2 = helper.cross(&tangents[0]).normalize();
        let mut frame = Matrix3::from_columns(&[tangents[0], e2, tangents[0].cross(&e2)]);
        let root = frame;
        let mut bend = vec![[0.0; 3]; points.len()];
        for j in 1..edges.len() {
            // The least turn from edge to edge: no twist. It stands for half of either edge.
            let axis = tangents[j - 1].cross(&tangents[j]);
            let angle = axis.norm().atan2(tangents[j - 1].dot(&tangents[j]));
            let turn = if axis.norm() > 1e-12 {
                Rotation3::from_axis_angle(&Unit::new_normalize(axis), angle)
            } else {
                Rotation3::identity()
            };
            let dual_length = 0.5 * (edges[j - 1].norm() + edges[j].norm());
            let u = frame.transpose() * turn.scaled_axis() / dual_length;
            frame = turn.matrix() * frame;
            bend[j] = [0.0, u.y, u.z];
        }
        // No turning angle is known at the ends.
        bend[0] = bend[1];
        bend[points.len() - 1] = bend[points.len() - 2];
        let pieces: Vec<_> = edges
            .iter()
            .enumerate()
            .map(|(j, e)| (e.norm(), bend[j], bend[j + 1]))
            .collect();
        Ok(Self::from_pieces(root, &pieces, step_mm))
    }

    fn from_pieces(root: Matrix3<f64>, pieces: &[(f64, [f64; 3], [f64; 3])], step_mm: f64) -> Self {
        let mut intervals = Vec::new();
        let mut s = 0.0;
        for (length, u_a, u_b) in pieces {
            // Equal intervals within a piece: breaks of the curvature fall on nodes, where the
            // integrator keeps its order.
            let count = (length / step_mm).ceil().max(1.0);
            let h = length / count;
            let slope = [0, 1, 2].map(|i| (u_b[i] - u_a[i]) / length);
            for k in 0..count as usize {
                let offset = k as f64 * h;
                intervals.push(Interval {
                    start_mm: s + offset,
                    length_mm: h,
                    u_start: [0, 1, 2].map(|i| u_a[i] + slope[i] * offset),
                    u_slope: slope,
                });
            }
            s += length;
        }
        let mut shape = Self {
            intervals,
            length_mm: s,
            root,
            nodes_mm: Vec::new(),
            frames: Vec::new(),
        };
        (shape.nodes_mm, shape.frames) = shape.rest_curve();
        shape
    }

    /// Points and frames at the interval ends: g' = g (u0, e1) from the root on.
    fn rest_curve(&self) -> (Vec<Vector3<f64>>, Vec<Matrix3<f64>>) {
        let mut g = Pose {
            frame: rows_of(&self.root),
            position: [0.0; 3],
        };
        let (mut nodes, mut frames) = (vec![Vector3::zeros()], vec![self.root]);
        for (j, interval) in self.intervals.iter().enumerate() {
            let last = j + 1 == self.intervals.len();
            // The last one ends at the tip, however the lengths add up.
            let h = if last {
                self.length_mm - interval.start_mm
            } else {
                interval.length_mm
            };
            let u =
                |offset: f64| [0, 1, 2].map(|i| interval.u_start[i] + interval.u_slope[i] * offset);
            g = step(h, &g, |offset, _| (u(offset), [1.0, 0.0, 0.0]));
            nodes.push(Vector3::from(g.position));
            frames.push(matrix_of(&g.frame));
        }
        (nodes, frames)
    }

    /// The same wire with `by_mm` more beyond its tip, at the rest curvature of its last end:
    /// smooth functions of the wire go on there.
    pub fn extended(&self, by_mm: f64) -> Self {
        let Some(last) = self.intervals.last().filter(|_| by_mm > 0.0) else {
            return self.clone();
        };
        let u = [0, 1, 2].map(|i| last.u_start[i] + last.u_slope[i] * last.length_mm);
        let count = (by_mm / last.length_mm).ceil().max(1.0);
        let (start, length_mm) = (last.start_mm + last.length_mm, by_mm / count);
        let mut shape = self.clone();
        shape
            .intervals
            .extend((0..count as usize).map(|k| Interval {
                start_mm: start + length_mm * k as f64,
                length_mm,
                u_start: u,
                u_slope: [0.0; 3],
            }));
        shape.length_mm += by_mm;
        (shape.nodes_mm, shape.frames) = shape.rest_curve();
        shape
    }

    /// The same wire, turned about its root.
    pub fn turned(&self, turn: &Rotation3<f64>) -> Self {
        let mut shape = self.clone();
        shape.root = turn.matrix() * self.root;
        (shape.nodes_mm, shape.frames) = shape.rest_curve();
        shape
    }

    /// Interval that holds arc length `s_mm` (the last one past the tip).
    pub(crate) fn interval_at(&self, s_mm: f64) -> usize {
        self.intervals
            .partition_point(|i| i.start_mm <= s_mm)
            .saturating_sub(1)
    }

    /// Point of the unloaded wire at arc length `s_mm`, by cubic Hermite interpolation between
    /// nodes.
    pub fn rest_point(&self, s_mm: f64) -> Vector3<f64> {
        let j = self.interval_at(s_mm);
        let h = self.intervals[j].length_mm;
        let x = (s_mm - self.intervals[j].start_mm) / h;
        let node = |j: usize| (self.nodes_mm[j], self.frames[j]);
        hermite(x, h, node(j), node(j + 1))
    }
}

/// Point at the share `x` of an interval of length `h` between two places whose frames are known, by
/// Hermite's basis on places and tangents: error of fourth order in h.
pub(crate) fn hermite(
    x: f64,
    h: f64,
    (p0, f0): (Vector3<f64>, Matrix3<f64>),
    (p1, f1): (Vector3<f64>, Matrix3<f64>),
) -> Vector3<f64> {
    let (x2, x3) = (x * x, x * x * x);
    p0 * (2.0 * x3 - 3.0 * x2 + 1.0)
        + f0.column(0) * (h * (x3 - 2.0 * x2 + x))
        + p1 * (3.0 * x2 - 2.0 * x3)
        + f1.column(0) * (h * (x3 - x2))
}

/// The mesh from arc length `s_mm` on: the interval that holds it is cut there.
pub(crate) fn from_arclength(shape: &Shape, s_mm: f64) -> Vec<Interval> {
    let first = shape.interval_at(s_mm);
    let mut rest: Vec<Interval> = shape.intervals[first..].to_vec();
    if let Some(cut) = rest.first_mut() {
        let offset = (s_mm - cut.start_mm).clamp(0.0, cut.length_mm);
        // The linear law of the cut interval starts at the cut.
        cut.u_start = [0, 1, 2].map(|i| cut.u_start[i] + cut.u_slope[i] * offset);
        cut.start_mm += offset;
        cut.length_mm -= offset;
    }
    rest
}
