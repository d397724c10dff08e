//! Rest geometry of the whisker from measured centre lines: the rod, held where the groove held the wire, laid through all of them.
//!
//! A held wire's shape depends on the rest shape, the clamp and the groove point alone: stiffness only scales the force. Unknown are
//! the straight length, the arc's radius, the whole length and the clamp (three small turns, offsets across the wire). The sd of
//! each is a jackknife over the shapes (Efron & Stein, Ann. Statist. 9, 1981): neighbouring points of one centre line share their errors.
//! Errors that all shapes share (the cameras' scale) are not in it: [`RestFit::add_common`] fits shapes that were moved by each.

use crate::integrate::unloaded;
use crate::{Guess, Rod, RodError, Tangential, WORKING_STEP_MM};
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Owned, Rotation3, SVector, Vector3};
use wcal_core::observation::{RestShape, WhiskerSpec};

/// Parts in which the groove is brought to its place.
const LEGS: usize = 8;
/// Unknowns: straight, radius, length (mm); turns about x, y, z (rad); offsets along y, z (mm).
const UNKNOWNS: usize = 8;
/// Differences for the Jacobian: far above Newton's tolerance, far below what is measured.
const NUDGES: [f64; UNKNOWNS] = [1e-3, 1e-3, 1e-3, 1e-5, 1e-5, 1e-5, 1e-4, 1e-4];
/// Standard deviation of the length that a pair states, where it states none, mm.
const LENGTH_SD_MM: f64 = 0.05;

/// Names and units of the unknowns, in order.
pub const NAMES: [&str; UNKNOWNS] = [
    "straight_mm",
    "arc_radius_mm",
    "length_mm",
    "root_turn_x_rad",
    "root_turn_y_rad",
    "root_turn_z_rad",
    "root_offset_y_mm",
    "root_offset_z_mm",
];

/// A measured centre line.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredShape {
    /// Name of the pair.
    pub name: String,
    /// Points from the root to the tip, base frame, mm.
    pub centreline_mm: Vec<Vector3<f64>>,
    /// Standard deviation across the line, one a point, mm.
    pub sd_mm: Vec<f64>,
    /// Length and its standard deviation, mm.
    pub length_mm: [f64; 2],
    /// The wire's centre in the groove, base frame, mm, and its arc length, mm; none for a free wire.
    pub groove: Option<(Vector3<f64>, f64)>,
}

/// What a shape leaves over.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeResidual {
    /// Name of the pair.
    pub name: String,
    /// Root mean square distance of its points from the rod, mm.
    pub rms_mm: f64,
    /// Largest distance, mm, and where along the wire, mm.
    pub largest_mm: [f64; 2],
}

/// The fitted rest geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct RestFit {
    /// Values in the order of [`NAMES`].
    pub values: SVector<f64, UNKNOWNS>,
    /// Their covariance by the jackknife over shapes, and by common errors once added; none for fewer than three shapes.
    pub covariance: Option<DMatrix<f64>>,
    /// The part of it that comes from errors common to all shapes.
    pub common: Option<DMatrix<f64>>,
    /// Residuals of the shapes used.
    pub shapes: Vec<ShapeResidual>,
    /// Shapes left out, with the reason.
    pub left_out: Vec<(String, String)>,
    /// Root mean square distance over all points, mm.
    pub rms_mm: f64,
    /// The same of the distances along either transverse axis over their stated standard deviation; some 1 where the model holds.
    pub rms_over_sd: f64,
}

impl RestFit {
    /// Standard deviation of an unknown.
    #[must_use]
    pub fn sd(&self, index: usize) -> Option<f64> {
        self.covariance.as_ref().map(|c| c[(index, index)].sqrt())
    }

    /// Adds errors common to all shapes. `moved`: for each independent one the shapes as they would be with one standard deviation more.
    ///
    /// # Errors
    /// Where a fit does not converge.
    pub fn add_common(
        &mut self,
        nominal: &WhiskerSpec,
        moved: &[Vec<MeasuredShape>],
    ) -> Result<(), RodError> {
        let mut sum = DMatrix::zeros(UNKNOWNS, UNKNOWNS);
        for shapes in moved {
            let held: Vec<Held<'_>> = shapes
                .iter()
                .filter(|s| self.shapes.iter().any(|used| used.name == s.name))
                .map(|shape| {
                    let (_, guess) = bent(nominal, &self.values, &Held { shape, guess: None })
                        .map_err(|why| RodError::RestFit(format!("{}: {why}", shape.name)))?;
                    Ok(Held { shape, guess })
                })
                .collect::<Result<_, RodError>>()?;
            let off = solve(nominal, &self.values, &held)? - self.values;
            sum += DMatrix::from_fn(UNKNOWNS, UNKNOWNS, |i, j| off[i] * off[j]);
        }
        if let Some(covariance) = &mut self.covariance {
            *covariance += &sum;
        }
        self.common = Some(sum);
        Ok(())
    }
}

/// Fits the rest geometry, starting at the nominal one.
///
/// # Errors
/// Where the nominal shape is not a straight part with an arc, no shape can be followed, or the fit does not converge.
pub fn fit_rest(nominal: &WhiskerSpec, shapes: &[MeasuredShape]) -> Result<RestFit, RodError> {
    let RestShape::StraightArc { straight_mm, arc_radius_mm, length_mm } = nominal.rest_shape else {
        return Err(RodError::RestFit("expected a straight part with an arc, found a polyline".to_owned()));
    };
    let start = SVector::from([straight_mm, arc_radius_mm, length_mm, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let mut left_out = Vec::new();
    let mut used = Vec::new();
    for shape in shapes {
        let mut held = Held { shape, guess: None };
        match bent(nominal, &start, &held) {
            Ok((_, guess)) => {
                held.guess = guess;
                used.push(held);
            }
            Err(why) => left_out.push((shape.name.clone(), why)),
        }
    }
    if used.is_empty() {
        let reasons: Vec<String> = left_out.iter().map(|(n, w)| format!("{n}: {w}")).collect();
        return Err(RodError::RestFit(format!(
            "expected at least one usable shape, found none ({})",
            reasons.join("; ")
        )));
    }
    let values = solve(nominal, &start, &used)?;
    let mut covariance = None;
    if used.len() >= 3 {
        let n = used.len() as f64;
        let mut deleted = Vec::with_capacity(used.len());
        for skip in 0..used.len() {
            let rest: Vec<Held<'_>> =
                used.iter().enumerate().filter(|(k, _)| *k != skip).map(|(_, s)| *s).collect();
            deleted.push(solve(nominal, &values, &rest)?);
        }
        let mean = deleted.iter().sum::<SVector<f64, UNKNOWNS>>() / n;
        let mut sum = DMatrix::zeros(UNKNOWNS, UNKNOWNS);
        for d in &deleted {
            let off = d - mean;
            sum += DMatrix::from_fn(UNKNOWNS, UNKNOWNS, |i, j| off[i] * off[j]);
        }
        covariance = Some(sum * ((n - 1.0) / n));
    }
    let (mut residuals, mut squares, mut count, mut scaled) = (Vec::new(), 0.0, 0, 0.0);
    for held in &used {
        let (shape, across) = (held.shape, distances(nominal, &values, held).map_err(RodError::RestFit)?);
        let norms: Vec<f64> = across.iter().map(|(_, d)| d[0].hypot(d[1])).collect();
        let sum: f64 = norms.iter().map(|d| d * d).sum();
        squares += sum;
        scaled += norms.iter().zip(&shape.sd_mm).map(|(d, sd)| 0.5 * (d / sd).powi(2)).sum::<f64>();
        count += norms.len();
        let largest = (0..norms.len()).max_by(|&a, &b| norms[a].total_cmp(&norms[b])).unwrap_or(0);
        residuals.push(ShapeResidual {
            name: shape.name.clone(),
            rms_mm: (sum / norms.len() as f64).sqrt(),
            largest_mm: [norms[largest], across[largest].0],
        });
    }
    let [rms_mm, rms_over_sd] = [squares, scaled].map(|sum| (sum / count as f64).sqrt());
    Ok(RestFit { values, covariance, common: None, shapes: residuals, left_out, rms_mm, rms_over_sd })
}

/// A shape and where Newton starts for it: the equilibrium at the nominal geometry, if it is held.
#[derive(Clone, Copy)]
struct Held<'a> {
    shape: &'a MeasuredShape,
    guess: Option<Guess>,
}

/// Nodes of a wire: arc length, position, frame; base frame.
type Nodes = Vec<(f64, Vector3<f64>, Matrix3<f64>)>;

/// The wire under a shape's load, and its equilibrium.
fn bent(
    nominal: &WhiskerSpec,
    v: &SVector<f64, UNKNOWNS>,
    held: &Held<'_>,
) -> Result<(Nodes, Option<Guess>), String> {
    let rest_shape = RestShape::StraightArc { straight_mm: v[0], arc_radius_mm: v[1], length_mm: v[2] };
    let rod = Rod::new(&WhiskerSpec { rest_shape, ..nominal.clone() }, WORKING_STEP_MM)
        .map_err(|e| e.to_string())?;
    let turn = Rotation3::new(Vector3::new(v[3], v[4], v[5]));
    let offset = Vector3::new(0.0, v[6], v[7]);
    let Some((point, arclength_mm)) = &held.shape.groove else {
        let (positions, frames) = unloaded(&rod.shape);
        let ends = rod.shape.intervals.iter().map(|i| i.start_mm).chain([rod.shape.length_mm]);
        let nodes = ends.zip(positions).zip(frames).map(|((s, p), f)| (s, turn * p + offset, turn * f));
        return Ok((nodes.collect(), None));
    };
    let point = turn.inverse() * (point - offset);
    let solve = |at: &Vector3<f64>, guess: &Guess| rod.solve(at, guess, Tangential::Frictionless);
    let near = held.guess.and_then(|guess| solve(&point, &guess).ok());
    let found = match near {
        Some(found) => found,
        None => {
            let from = rod.shape.rest_point(*arclength_mm);
            let mut guess = Guess { force_n: Vector3::zeros(), arclength_mm: *arclength_mm };
            for leg in 1..LEGS {
                let at = from + (point - from) * (leg as f64 / LEGS as f64);
                guess = Guess::from(&solve(&at, &guess).map_err(unreached)?);
            }
            solve(&point, &guess).map_err(unreached)?
        }
    };
    let nodes = rod.loaded_shape(&found).into_iter().map(|(s, p, f)| (s, turn * p + offset, turn * f));
    Ok((nodes.collect(), Some(Guess::from(&found))))
}

fn unreached(failure: crate::Failure) -> String {
    format!("the rod does not reach the groove ({failure:?})")
}

/// Of every measured point: arc length and distances along the rod's two transverse axes, mm.
fn distances(
    nominal: &WhiskerSpec,
    v: &SVector<f64, UNKNOWNS>,
    held: &Held<'_>,
) -> Result<Vec<(f64, [f64; 2])>, String> {
    let (shape, (nodes, _)) = (held.shape, bent(nominal, v, held)?);
    let mut s_mm = 0.0;
    let mut out = Vec::with_capacity(shape.centreline_mm.len());
    for (k, p) in shape.centreline_mm.iter().enumerate() {
        if k > 0 {
            s_mm += (p - shape.centreline_mm[k - 1]).norm();
        }
        // The nearest place: from equal arc length along the tangent, twice.
        let mut s = s_mm;
        let mut at = on_curve(&nodes, s);
        for _ in 0..2 {
            s += (p - at.0).dot(&at.1.column(0));
            at = on_curve(&nodes, s);
        }
        let off = p - at.0;
        out.push((s_mm, [off.dot(&at.1.column(1)), off.dot(&at.1.column(2))]));
    }
    Ok(out)
}

/// Place and frame at an arc length: a cubic through two nodes and their tangents, straight on beyond the ends.
fn on_curve(nodes: &[(f64, Vector3<f64>, Matrix3<f64>)], s_mm: f64) -> (Vector3<f64>, Matrix3<f64>) {
    let after = nodes.partition_point(|n| n.0 < s_mm).clamp(1, nodes.len() - 1);
    let ((s0, p0, f0), (s1, p1, f1)) = (&nodes[after - 1], &nodes[after]);
    let h = s1 - s0;
    if s_mm < *s0 {
        return (p0 + f0.column(0) * (s_mm - s0), *f0);
    }
    if s_mm > *s1 {
        return (p1 + f1.column(0) * (s_mm - s1), *f1);
    }
    let t = if h > 0.0 { (s_mm - s0) / h } else { 0.0 };
    let (t2, t3) = (t * t, t * t * t);
    let position = p0 * (2.0 * t3 - 3.0 * t2 + 1.0)
        + f0.column(0) * (h * (t3 - 2.0 * t2 + t))
        + p1 * (3.0 * t2 - 2.0 * t3)
        + f1.column(0) * (h * (t3 - t2));
    (position, if t < 0.5 { *f0 } else { *f1 })
}

/// The least-squares problem of the crate `levenberg-marquardt`; a place where the rod has no solution has no residuals.
struct Problem<'a> {
    nominal: &'a WhiskerSpec,
    shapes: &'a [Held<'a>],
    values: SVector<f64, UNKNOWNS>,
}

impl Problem<'_> {
    fn residuals_at(&self, v: &SVector<f64, UNKNOWNS>) -> Option<DVector<f64>> {
        let mut all = Vec::new();
        for held in self.shapes {
            let (shape, across) = (held.shape, distances(self.nominal, v, held).ok()?);
            for ((_, d), sd) in across.iter().zip(&shape.sd_mm) {
                all.extend(d.map(|d| d / sd));
            }
            let sd = if shape.length_mm[1] > 0.0 { shape.length_mm[1] } else { LENGTH_SD_MM };
            all.push((shape.length_mm[0] - v[2]) / sd);
        }
        Some(DVector::from_vec(all))
    }
}

impl LeastSquaresProblem<f64, Dyn, nalgebra::Const<UNKNOWNS>> for Problem<'_> {
    type ParameterStorage = nalgebra::ArrayStorage<f64, UNKNOWNS, 1>;
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, nalgebra::Const<UNKNOWNS>>;

    fn set_params(&mut self, x: &SVector<f64, UNKNOWNS>) {
        self.values = *x;
    }

    fn params(&self) -> SVector<f64, UNKNOWNS> {
        self.values
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        self.residuals_at(&self.values)
    }

    fn jacobian(&self) -> Option<nalgebra::OMatrix<f64, Dyn, nalgebra::Const<UNKNOWNS>>> {
        let mut columns = Vec::with_capacity(UNKNOWNS);
        for (k, nudge) in NUDGES.into_iter().enumerate() {
            let mut up = self.values;
            up[k] += nudge;
            let mut down = self.values;
            down[k] -= nudge;
            columns.push((self.residuals_at(&up)? - self.residuals_at(&down)?) / (2.0 * nudge));
        }
        Some(nalgebra::OMatrix::<f64, Dyn, nalgebra::Const<UNKNOWNS>>::from_columns(&columns))
    }
}

fn solve(
    nominal: &WhiskerSpec,
    start: &SVector<f64, UNKNOWNS>,
    shapes: &[Held<'_>],
) -> Result<SVector<f64, UNKNOWNS>, RodError> {
    let problem = Problem { nominal, shapes, values: *start };
    // Steps far below the standard deviations are not worth a Jacobian.
    let method = LevenbergMarquardt::new().with_patience(20).with_ftol(1e-9).with_xtol(1e-8);
    let (problem, report) = method.minimize(problem);
    if !report.termination.was_successful() {
        return Err(RodError::RestFit(format!("the fit did not converge: {:?}", report.termination)));
    }
    Ok(problem.values)
}
