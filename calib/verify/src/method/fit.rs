//! Variable projection: the coefficients are solved for exactly, the few nonlinear parameters by
//! bounded Levenberg-Marquardt.
//!
//! ```text
//! min over a within bounds of  |y - X(a) b(a)|^2 + |w(a)|^2,   b(a) = X(a)^+ y
//! ```
//!
//! with y the whitened readings, X the design, b its coefficients, w what the second witness
//! leaves. Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973), with Kaufman's Jacobian: the tangents'
//! part that b cannot take up. Bounds carry the physics (friction and creep do not go below zero).

pub use super::fitted::{Fit, Status};
use super::linear::stack_with;
pub use super::noise::Weights;
use crate::effect::{EffectTerm, Role, grid_spacing};
use crate::measurement_model::MeasurementModel;
use nalgebra::{DMatrix, DVector};
use std::cell::{Cell, OnceCell};
use wcal_core::least_squares::{
    BoundedNormalEquations, Damping, Ending, Linearised, NormalEquations, minimise,
};

/// Coefficients and residual of `y` on `design` by Householder QR on scaled columns.
pub(crate) fn linear(
    design: &DMatrix<f64>,
    y: &DMatrix<f64>,
) -> (DMatrix<f64>, DMatrix<f64>, bool) {
    // Columns in units of their norm: one threshold on R's diagonal then judges rank, whatever the
    // parameters' units.
    let scale: Vec<f64> = design.column_iter().map(|c| c.norm()).collect();
    let scaled = DMatrix::from_fn(design.nrows(), design.ncols(), |i, j| {
        if scale[j] > 0.0 {
            design[(i, j)] / scale[j]
        } else {
            0.0
        }
    });
    // QR, not the normal equations, which would square the condition number.
    let qr = scaled.clone().qr();
    let (q, r) = (qr.q(), qr.r());
    let qty = q.transpose() * y;
    let count = design.ncols();
    let mut b = DMatrix::zeros(count, y.ncols());
    // Fewer readings than columns leave the last ones undetermined.
    let determined = count.min(design.nrows());
    let mut full_rank = determined == count;
    for i in (0..determined).rev() {
        // A column that the earlier ones already span keeps the coefficient 0.
        if r[(i, i)].abs() < 1e-9 {
            full_rank = false;
            continue;
        }
        for c in 0..y.ncols() {
            let mut v = qty[(i, c)];
            for k in i + 1..count {
                v -= r[(i, k)] * b[(k, c)];
            }
            b[(i, c)] = v / r[(i, i)];
        }
    }
    let residual = y - &scaled * &b;
    for (i, s) in scale.iter().enumerate() {
        for c in 0..y.ncols() {
            b[(i, c)] = if *s > 0.0 { b[(i, c)] / s } else { 0.0 };
        }
    }
    (b, residual, full_rank)
}

/// One evaluation at fixed nonlinear values.
struct Evaluation {
    raw: DMatrix<f64>,
    design: DMatrix<f64>,
    coefficients: DMatrix<f64>,
    residual: DMatrix<f64>,
    auxiliary_residual: DVector<f64>,
    ssr: f64,
    full_rank: bool,
}

fn evaluate(
    system: &dyn MeasurementModel,
    terms: &[EffectTerm],
    weights: &Weights,
    y: &DMatrix<f64>,
) -> Option<Evaluation> {
    let raw = system.design(terms)?;
    let design = weights.apply(&raw);
    let (coefficients, residual, full_rank) = linear(&design, y);
    let auxiliary_residual = system.auxiliary_residual(terms, weights)?;
    let ssr = residual.norm_squared() + auxiliary_residual.norm_squared();
    ssr.is_finite().then_some(Evaluation {
        raw,
        design,
        coefficients,
        residual,
        auxiliary_residual,
        ssr,
        full_rank,
    })
}

/// (term, value) of every nonlinear parameter in order.
fn slots(terms: &[EffectTerm]) -> Vec<(usize, usize)> {
    terms
        .iter()
        .enumerate()
        .flat_map(|(t, term)| (0..term.values.len()).map(move |k| (t, k)))
        .collect()
}

fn step_size(system: &dyn MeasurementModel, term: &EffectTerm, k: usize) -> f64 {
    let p = system.catalogue()[term.effect].law(term.law).parameters[k];
    match p.role {
        Role::Amplitude { probe } => 0.02 * probe.abs().max(0.1 * term.values[k].abs()),
        Role::Shape { grid } => {
            // A shape acts over its grid's spacing: a wider step would average over the curvature.
            let plain = 0.01 * term.values[k].abs().max(1e-3 * (p.range[1] - p.range[0]));
            plain.min(0.02 * grid_spacing(grid, term.values[k]))
        }
    }
}

/// Tangent of the prediction by one nonlinear parameter: of the readings as they are, and of the
/// second witness, whitened.
type Tangent = (DMatrix<f64>, DVector<f64>);

fn tangents(
    system: &dyn MeasurementModel,
    terms: &[EffectTerm],
    weights: &Weights,
    here: &Evaluation,
) -> Option<Vec<Tangent>> {
    let at = |terms: &[EffectTerm]| {
        Some((
            system.design(terms)?,
            system.auxiliary_residual(terms, weights)?,
        ))
    };
    slots(terms)
        .iter()
        .map(|&(t, k)| {
            let p = system.catalogue()[terms[t].effect]
                .law(terms[t].law)
                .parameters[k];
            // One-sided difference, backwards at the upper bound: a law holds only within its
            // bounds.
            let mut h = step_size(system, &terms[t], k);
            if terms[t].values[k] + h > p.range[1] {
                h = -h;
            }
            let mut moved = terms.to_vec();
            moved[t].values[k] += h;
            let (design, auxiliary_residual) = match at(&moved) {
                Some(found) => found,
                None => {
                    h = -h;
                    moved[t].values[k] = terms[t].values[k] + h;
                    at(&moved)?
                }
            };
            // A residual falls by what its prediction gains.
            Some((
                (design - &here.raw) * &here.coefficients / h,
                (&here.auxiliary_residual - auxiliary_residual) / h,
            ))
        })
        .collect()
}

/// Bounds of a nonlinear parameter.
fn range(system: &dyn MeasurementModel, terms: &[EffectTerm], (t, k): (usize, usize)) -> [f64; 2] {
    system.catalogue()[terms[t].effect]
        .law(terms[t].law)
        .parameters[k]
        .range
}

/// The problem at given nonlinear values.
struct FitPoint<'a> {
    system: &'a dyn MeasurementModel,
    weights: &'a Weights,
    terms: Vec<EffectTerm>,
    here: Evaluation,
    /// Tangents are dear: they are taken where a step goes on from.
    linearised: OnceCell<Option<(Vec<Tangent>, BoundedNormalEquations)>>,
}

impl FitPoint<'_> {
    fn linearised(&self) -> Option<&(Vec<Tangent>, BoundedNormalEquations)> {
        let make = || {
            let tangents = tangents(self.system, &self.terms, self.weights, &self.here)?;
            // What the coefficients cannot take up.
            let off = |(t, w): &Tangent| {
                stack_with(&linear(&self.here.design, &self.weights.apply(t)).1, w)
            };
            let columns: Vec<DVector<f64>> = tangents.iter().map(off).collect();
            let r = stack_with(&self.here.residual, &self.here.auxiliary_residual);
            let m = columns.len();
            // A parameter that moves nothing has a zero column: it stays.
            let free = NormalEquations {
                cost: self.here.ssr,
                matrix: DMatrix::from_fn(m, m, |i, j| {
                    columns[i].dot(&columns[j]) + if i == j { 1e-300 } else { 0.0 }
                }),
                descent: DVector::from_fn(m, |i, _| columns[i].dot(&r)),
            };
            // Active set: at a bound only steps into the interior are admissible.
            let may = slots(&self.terms)
                .into_iter()
                .map(|(t, k)| {
                    let ([low, high], v) = (
                        range(self.system, &self.terms, (t, k)),
                        self.terms[t].values[k],
                    );
                    [v > low, v < high]
                })
                .collect();
            Some((tangents, BoundedNormalEquations { free, may }))
        };
        self.linearised.get_or_init(make).as_ref()
    }
}

impl Linearised for FitPoint<'_> {
    type Step = DVector<f64>;

    fn cost(&self) -> f64 {
        self.here.ssr
    }

    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        self.linearised()?.1.step(damping)
    }
}

/// Halvings of the grid's spacing at which a place is looked for.
const HALVINGS: i32 = 7;

/// `point` with a change at the place beside it that leaves least: it moves no reading until it
/// passes one, and has no tangent. None where no place within its grid's spacing leaves less.
fn nearer_place(point: &FitPoint<'_>, y: &DMatrix<f64>) -> Option<Vec<EffectTerm>> {
    let tangents = &point.linearised()?.0;
    let still = slots(&point.terms)
        .into_iter()
        .zip(tangents)
        .filter(|(_, (readings, _))| readings.norm() == 0.0);
    let beside = still.flat_map(|((t, k), _)| {
        let value = point.terms[t].values[k];
        let Role::Shape { grid } = point.system.catalogue()[point.terms[t].effect]
            .law(point.terms[t].law)
            .parameters[k]
            .role
        else {
            return Vec::new();
        };
        let [low, high] = range(point.system, &point.terms, (t, k));
        let at = |way: f64, halvings: i32| {
            let mut terms = point.terms.clone();
            terms[t].values[k] =
                (value + way * grid_spacing(grid, value) * 0.5f64.powi(halvings)).clamp(low, high);
            terms
        };
        (0..HALVINGS)
            .flat_map(|h| [at(1.0, h), at(-1.0, h)])
            .collect()
    });
    let left = |terms: Vec<EffectTerm>| {
        Some((evaluate(point.system, &terms, point.weights, y)?.ssr, terms))
    };
    let least = beside.filter_map(left).min_by(|a, b| a.0.total_cmp(&b.0));
    least
        .filter(|(ssr, _)| *ssr < (1.0 - SETTLED) * point.here.ssr)
        .map(|(_, terms)| terms)
}

/// Share of the sum of squares below which a fall is none.
const SETTLED: f64 = 1e-5;
/// Damping past which no shorter step is tried: steps are then a ten-thousandth of steepest
/// descent's.
const MAX_DAMPING: f64 = 1e4;
/// Lengths tried for a step.
const TRIES: usize = 8;

/// Fits `terms` from their present values.
pub fn fit(
    system: &dyn MeasurementModel,
    terms: &[EffectTerm],
    weights: &Weights,
    iterations: usize,
) -> Option<Fit> {
    let y = weights.apply(system.measured());
    let index = slots(terms);
    let linearise = |terms: &Vec<EffectTerm>| {
        let here = evaluate(system, terms, weights, &y)?;
        Some(FitPoint {
            system,
            weights,
            terms: terms.clone(),
            here,
            linearised: OnceCell::new(),
        })
    };
    let moved = |terms: &Vec<EffectTerm>, _: &FitPoint<'_>, step: &DVector<f64>| {
        let mut moved = terms.clone();
        for (&(t, k), d) in index.iter().zip(step.iter()) {
            // A step across a bound is projected onto it: the feasible set is a box.
            let [low, high] = range(system, terms, (t, k));
            moved[t].values[k] = (terms[t].values[k] + d).clamp(low, high);
        }
        moved
    };
    // Steps that were taken are counted: from a near optimum a few are enough, however many shorter
    // ones were refused on the way.
    let (taken, settled) = (Cell::new(0), Cell::new(false));
    let enough = |_: &DVector<f64>, [before, after]: [f64; 2]| {
        taken.set(taken.get() + 1);
        settled.set(before - after < SETTLED * after.max(1e-300));
        settled.get() || taken.get() >= iterations
    };
    let max_steps = if index.is_empty() {
        0
    } else {
        iterations * TRIES
    };
    let damping = Damping {
        max: MAX_DAMPING,
        max_steps,
        ..Damping::default()
    };
    let first = (terms.to_vec(), linearise(&terms.to_vec())?);
    let found = minimise(first, &damping, linearise, moved, enough);
    if let Some(nearer) = Some(&found.at)
        .filter(|_| iterations > 0)
        .and_then(|at| nearer_place(at, &y))
    {
        return fit(system, &nearer, weights, iterations);
    }
    let tangents = if index.is_empty() {
        Vec::new()
    } else {
        found.at.linearised()?.0.clone()
    };
    let (terms, here) = (found.place, found.at.here);
    let status = match found.ending {
        _ if !here.full_rank => Status::RankDeficient,
        Ending::Exhausted if !index.is_empty() => Status::NotConverged,
        Ending::Converged if !settled.get() => Status::NotConverged,
        _ => Status::Converged,
    };
    let at_bound = index
        .iter()
        .map(|&(t, k)| {
            let ([low, high], v) = (range(system, &terms, (t, k)), terms[t].values[k]);
            v <= low + 1e-6 * (high - low) || v >= high - 1e-6 * (high - low)
        })
        .collect();
    let channels = y.ncols() as f64;
    let seen = system.auxiliary_readings();
    let witness_count = seen.iter().filter(|i| weights.counts(**i)).count();
    // Each channel's coefficients and each nonlinear parameter take one degree of freedom
    // (linearised model).
    let used = here.design.ncols() as f64 * channels + index.len() as f64;
    Some(Fit {
        dof: weights.active() as f64 * channels + witness_count as f64 - used,
        witness_count,
        raw_residual: system.measured() - &here.raw * &here.coefficients,
        raw_design: here.raw,
        coefficients: here.coefficients,
        residual: here.residual,
        design: here.design,
        ssr: here.ssr,
        tangents: tangents
            .iter()
            .map(|(t, w)| stack_with(&weights.apply(t), w))
            .collect(),
        auxiliary_residual: here.auxiliary_residual,
        auxiliary_readings: seen,
        raw_tangents: tangents.into_iter().map(|(t, _)| t).collect(),
        at_bound,
        status,
        terms,
    })
}
