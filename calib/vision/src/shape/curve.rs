//! The wire as an inextensible curve: curvature = nominal + cubic B-splines along the arc length,
//! carried by a twist-free frame. Length is kept by construction; the root stands at the base's
//! origin, pointing along x, up to small offsets.
//!
//! ```text
//! R' = R hat(0, -k2, k1),  p' = R e_x,    k_d(s) = k_d,rest(s) + sum_j c_dj B_j(s)
//! d p(s) / d c_dj = integral_0^s B_j(u) a_d(u) x (p(s) - p(u)) du,    a_1 = R e_z, a_2 = -R e_y
//! roughness = sum_d sum_j (c_d,j-1 - 2 c_dj + c_d,j+1)^2        without the j about a force (the groove's)
//! ```
//! Integrated by half steps of constant curvature. Sources: Bishop, "There Is More than One Way to
//! Frame a Curve", 1975 (frame without twist); Eilers and Marx, "Flexible Smoothing with B-splines
//! and Penalties", 1996 (roughness).

use crate::rig::RigWhisker;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

/// Root offsets: y, z (mm) and tilts about z and y (rad).
pub const ROOT: usize = 4;

/// Fixed data of the curve model.
#[derive(Debug, Clone)]
pub struct CurveModel {
    /// Distance of nodes, mm.
    pub step_mm: f64,
    /// Nodes, root included.
    pub nodes: usize,
    /// Splines a direction.
    pub splines: usize,
    /// Nominal curvature toward -z at every interval's middle, 1/mm.
    nominal: Vec<f64>,
    /// First spline and the four values at every interval's middle.
    basis: Vec<(usize, [f64; 4])>,
    /// The roughness: the sum of squared second differences of both directions' coefficients, as a
    /// quadratic form.
    pub penalty: DMatrix<f64>,
    /// Second differences of each direction that the penalty leaves out.
    unpunished: usize,
}

/// Parameters of a curve.
#[derive(Debug, Clone)]
pub struct CurveState {
    /// Root offsets.
    pub root: [f64; ROOT],
    /// Coefficients: all of direction 1, then all of direction 2.
    pub coefficients: Vec<f64>,
}

impl CurveState {
    /// All parameters, root offsets left at zero: what the penalty acts on.
    pub(crate) fn bends(&self) -> DVector<f64> {
        DVector::from_vec([&[0.0; ROOT][..], &self.coefficients].concat())
    }

    /// Adds a change of all parameters.
    pub fn add(&mut self, step: &[f64]) {
        let values = self.root.iter_mut().chain(&mut self.coefficients);
        values.zip(step).for_each(|(value, by)| *value += by);
    }
}

/// Nodes of a curve, base frame.
#[derive(Debug, Clone)]
pub struct CurveShape {
    /// Positions, mm.
    pub points: Vec<Vector3<f64>>,
    /// Unit tangents.
    pub tangents: Vec<Vector3<f64>>,
    /// Second derivative by the arc length that the rest shape's bending has there, 1/mm.
    pub rest_bends: Vec<Vector3<f64>>,
}

impl CurveModel {
    /// A model that reaches `reach_mm` with one spline every `knot_mm`.
    pub fn new(whisker: &RigWhisker, reach_mm: f64, knot_mm: f64) -> Self {
        let step_mm = 0.25;
        let intervals = (reach_mm / step_mm).ceil() as usize;
        let segments = (reach_mm / knot_mm).ceil().max(1.0) as usize;
        let width = intervals as f64 * step_mm / segments as f64;
        let mut nominal = Vec::with_capacity(intervals);
        let mut basis = Vec::with_capacity(intervals);
        for i in 0..intervals {
            let (from, to) = (i as f64 * step_mm, (i + 1) as f64 * step_mm);
            // The share of the interval beyond the straight part.
            let share = ((to - whisker.straight_mm.max(from)) / step_mm).clamp(0.0, 1.0);
            nominal.push(share * whisker.arc_curvature_per_mm);
            let x = (0.5 * (from + to) / width).min(segments as f64 - 1e-9);
            let (k, u) = (x.floor() as usize, x.fract());
            let v = 1.0 - u;
            // The four uniform cubic B-splines that reach an interval, at its middle.
            basis.push((
                k,
                [
                    v * v * v / 6.0,
                    (3.0 * u * u * u - 6.0 * u * u + 4.0) / 6.0,
                    (3.0 * v * v * v - 6.0 * v * v + 4.0) / 6.0,
                    u * u * u / 6.0,
                ],
            ));
        }
        // Over n intervals of knots there are n + 3 cubic B-splines.
        let splines = segments + 3;
        let penalty = penalty(splines, |_| true);
        Self {
            step_mm,
            nodes: intervals + 1,
            splines,
            nominal,
            basis,
            penalty,
            unpunished: 0,
        }
    }

    /// The same curve with a force at an arc length. The curvature's slope jumps there by the force
    /// over the bending stiffness (n' = -F delta, m' = -t x n): a corner that smoothing must not
    /// round, or the fitted wire would be short of the contact.
    pub(crate) fn with_force_at(&self, arc_mm: f64) -> Self {
        let knot_mm = (self.nodes - 1) as f64 * self.step_mm / (self.splines - 3) as f64;
        // The second difference `row` is centred on knot `row`.
        let punished = |row: usize| (row as f64 * knot_mm - arc_mm).abs() >= knot_mm;
        let unpunished = (0..self.splines - 2).filter(|row| !punished(*row)).count();
        Self {
            penalty: penalty(self.splines, punished),
            unpunished,
            ..self.clone()
        }
    }

    /// Parameters: root offsets and both directions' coefficients.
    pub fn parameters(&self) -> usize {
        ROOT + 2 * self.splines
    }

    /// The nominal curve.
    pub fn rest(&self) -> CurveState {
        CurveState {
            root: [0.0; ROOT],
            coefficients: vec![0.0; 2 * self.splines],
        }
    }

    fn curvature(&self, state: &CurveState, i: usize) -> (f64, f64) {
        let (first, values) = &self.basis[i];
        let sum = |offset: usize| -> f64 {
            values
                .iter()
                .enumerate()
                .map(|(k, v)| v * state.coefficients[offset + first + k])
                .sum()
        };
        (sum(0), sum(self.splines) - self.nominal[i])
    }

    fn root(state: &CurveState) -> (Vector3<f64>, Matrix3<f64>) {
        let [y, z, about_z, about_y] = state.root;
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.0, about_y, about_z));
        (Vector3::new(0.0, y, z), *turn.matrix())
    }

    /// Positions and tangents of the nodes.
    pub fn shape(&self, state: &CurveState) -> CurveShape {
        let (mut p, mut frame) = Self::root(state);
        let mut shape = CurveShape {
            points: Vec::with_capacity(self.nodes),
            tangents: Vec::with_capacity(self.nodes),
            rest_bends: Vec::with_capacity(self.nodes),
        };
        for i in 0..self.nodes {
            let before_tip = i.min(self.nodes - 2);
            shape.points.push(p);
            shape.tangents.push(frame.column(0).into_owned());
            shape
                .rest_bends
                // At rest the wire bends toward -z.
                .push(frame.column(2) * -self.nominal[before_tip]);
            let (k1, k2) = self.curvature(state, before_tip);
            let half = half_turn(k1, k2, self.step_mm);
            let middle = frame * half;
            // Midpoint rule: the error falls with the square of the step.
            p += middle.column(0) * self.step_mm;
            frame = middle * half;
        }
        shape
    }

    /// The curve that follows nodes (index and place, each to `sd_mm`) as closely as this smoothing
    /// allows, from a nearby one.
    pub fn through(
        &self,
        start: &CurveState,
        nodes: &[(usize, Vector3<f64>)],
        sd_mm: f64,
        smoothing: f64,
    ) -> CurveState {
        let mut state = start.clone();
        for _ in 0..3 {
            let (points, all) = (self.shape(&state).points, self.jacobian(&state));
            let mut by_nodes = DMatrix::zeros(self.parameters(), 3 * nodes.len());
            let mut off = DVector::zeros(3 * nodes.len());
            for (n, (i, place)) in nodes.iter().enumerate() {
                by_nodes
                    .columns_mut(3 * n, 3)
                    .copy_from(&all.columns(3 * i, 3));
                off.rows_mut(3 * n, 3).copy_from(&(place - points[*i]));
            }
            // Penalised least squares: nodes, roughness, and a ridge for splines without nodes.
            let weight = sd_mm.powi(-2);
            let h = &by_nodes * by_nodes.transpose() * weight
                + &self.penalty * smoothing
                + DMatrix::identity(self.parameters(), self.parameters()) * 1e-3;
            let g = &by_nodes * off * weight - &self.penalty * state.bends() * smoothing;
            let Some(step) = h.cholesky().map(|c| c.solve(&g)) else {
                break;
            };
            state.add(step.as_slice());
        }
        state
    }

    /// Derivatives of every node's position: columns 3 i .. 3 i + 3 belong to node i, rows to the
    /// parameters.
    pub fn jacobian(&self, state: &CurveState) -> DMatrix<f64> {
        let n = self.parameters();
        let mut j = DMatrix::<f64>::zeros(n, 3 * self.nodes);
        let (_, mut frame) = Self::root(state);
        // Accumulated rotation and displacement of every parameter.
        let mut turn = vec![Vector3::<f64>::zeros(); n];
        let mut move_by = vec![Vector3::<f64>::zeros(); n];
        move_by[0] = Vector3::y();
        move_by[1] = Vector3::z();
        // The root's tilts are tiny, so that the two axes may be taken as those of the base.
        turn[2] = Vector3::z();
        turn[3] = Vector3::y();
        let mut write = |node: usize, p: usize, v: &Vector3<f64>| {
            j.fixed_view_mut::<1, 3>(p, 3 * node).tr_copy_from(v);
        };
        (0..2).for_each(|p| write(0, p, &move_by[p]));
        for i in 0..self.nodes - 1 {
            let (k1, k2) = self.curvature(state, i);
            let half = half_turn(k1, k2, self.step_mm);
            let middle = frame * half;
            let tangent = middle.column(0).into_owned();
            // Bending in direction 1 turns about axis 2, in direction 2 about minus axis 1.
            let axes = [middle.column(2).into_owned(), -middle.column(1)];
            let (first, values) = &self.basis[i];
            let start = |d: usize| ROOT + d * self.splines;
            let mut half_steps = [(0, Vector3::zeros()); 8];
            for (k, h) in half_steps.iter_mut().enumerate() {
                let (d, v) = (k / 4, values[k % 4]);
                *h = (start(d) + first + k % 4, axes[d] * (0.5 * v * self.step_mm));
            }
            for (p, w) in &half_steps {
                turn[*p] += w;
            }
            // Splines that begin farther along have no effect here.
            let begun = |d: usize| start(d)..start(d) + first + 4;
            for p in (0..ROOT).chain(begun(0)).chain(begun(1)) {
                // A turn w moves what lies ahead at the rate w x t.
                move_by[p] += turn[p].cross(&tangent) * self.step_mm;
                write(i + 1, p, &move_by[p]);
            }
            for (p, w) in &half_steps {
                turn[*p] += w;
            }
            frame = middle * half;
        }
        j
    }

    /// Rank of the penalty: second differences of both directions.
    pub(crate) fn penalty_rank(&self) -> usize {
        2 * (self.splines - 2 - self.unpunished)
    }

    /// The state that follows given curvature deviations (one a node) as closely as the splines
    /// can.
    pub(crate) fn state_of_curvatures(&self, deviations: &[[f64; 2]]) -> CurveState {
        // Past the last curvature splines have no data: a ridge keeps them at 0.
        let mut normal = DMatrix::<f64>::identity(self.splines, self.splines) * 1e-6;
        let mut rhs = DMatrix::<f64>::zeros(self.splines, 2);
        for (i, (first, values)) in self.basis.iter().enumerate() {
            let Some(target) = deviations.get(i.min(deviations.len().saturating_sub(1))) else {
                break;
            };
            for (a, va) in values.iter().enumerate() {
                for (b, vb) in values.iter().enumerate() {
                    normal[(first + a, first + b)] += va * vb;
                }
                rhs[(first + a, 0)] += va * target[0];
                rhs[(first + a, 1)] += va * target[1];
            }
        }
        let mut state = self.rest();
        if let Some(solution) = normal.cholesky().map(|c| c.solve(&rhs)) {
            state.coefficients.copy_from_slice(solution.as_slice());
        }
        state
    }
}

fn penalty(splines: usize, punished: impl Fn(usize) -> bool) -> DMatrix<f64> {
    let n = ROOT + 2 * splines;
    let mut form = DMatrix::<f64>::zeros(n, n);
    let rows: Vec<usize> = (0..splines - 2).filter(|row| punished(*row)).collect();
    for start in (0..2).flat_map(|d| rows.iter().map(move |r| ROOT + d * splines + r)) {
        for (i, a) in [1.0, -2.0, 1.0].into_iter().enumerate() {
            for (j, b) in [1.0, -2.0, 1.0].into_iter().enumerate() {
                form[(start + i, start + j)] += a * b;
            }
        }
    }
    form
}

/// Rotation over half an interval: bending k1 toward axis 1 and k2 toward axis 2.
fn half_turn(k1: f64, k2: f64, step: f64) -> Matrix3<f64> {
    *Rotation3::from_scaled_axis(Vector3::new(0.0, -k2, k1) * (0.5 * step)).matrix()
}
