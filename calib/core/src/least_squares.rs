//! Nonlinear least squares by Levenberg and Marquardt: the loop that the fits of this workspace
//! share.
//!
//! min over x of F(x) = sum_i r_i(x)^2. With J = dr/dx the step d at damping lambda solves
//!
//! (J^T J + lambda diag(J^T J)) d = -J^T r.
//!
//! It is taken where F does not rise, and lambda falls; else lambda grows and a shorter step,
//! nearer to steepest descent, is tried. Source: D. W. Marquardt, J. SIAM 11 (1963); J. Nocedal &
//! S. Wright, "Numerical Optimization" (2006), sec. 10.3.
//!
//! A problem says how it is linearised at a place ([`Linearised`]; [`NormalEquations`] where its
//! normal matrix is small) and how a step moves the place: unknowns may be poses, and steps
//! clamped.

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DVector, DefaultAllocator, Dim, DimMin, Dyn, OMatrix, OVector};

/// A least-squares problem linearised at a place.
pub trait Linearised {
    /// Change of the unknowns.
    type Step;

    /// Sum of the squared residuals.
    fn cost(&self) -> f64;

    /// Step at a damping; none where the damped normal matrix is not positive definite.
    fn step(&self, damping: f64) -> Option<Self::Step>;
}

/// Cost, J^T J and -J^T r of D unknowns; of the matrix the lower triangle is read.
#[derive(Debug, Clone)]
pub struct NormalEquations<D: Dim>
where
    DefaultAllocator: Allocator<D, D> + Allocator<D>,
{
    /// Sum of the squared residuals.
    pub cost: f64,
    /// J^T J.
    pub matrix: OMatrix<f64, D, D>,
    /// -J^T r: points down the hill.
    pub descent: OVector<f64, D>,
}

impl<D: DimMin<D, Output = D>> Linearised for NormalEquations<D>
where
    DefaultAllocator: Allocator<D, D> + Allocator<D>,
{
    type Step = OVector<f64, D>;

    fn cost(&self) -> f64 {
        self.cost
    }

    fn step(&self, damping: f64) -> Option<Self::Step> {
        let mut damped = self.matrix.clone();
        // Marquardt's scaling: the damping does not depend on the units of the unknowns.
        for k in 0..damped.nrows() {
            damped[(k, k)] *= 1.0 + damping;
        }
        Some(damped.cholesky()?.solve(&self.descent))
    }
}

/// Normal equations of unknowns that stay within bounds: what a bound holds back takes no part in
/// the step (active set; Nocedal & Wright, sec. 16.7). The step may still cross a bound that was
/// not yet reached: `moved` cuts it there.
#[derive(Debug, Clone)]
pub struct BoundedNormalEquations {
    /// Without bounds.
    pub free: NormalEquations<Dyn>,
    /// Whether each unknown may fall and rise.
    pub may: Vec<[bool; 2]>,
}

impl Linearised for BoundedNormalEquations {
    type Step = DVector<f64>;

    fn cost(&self) -> f64 {
        self.free.cost
    }

    fn step(&self, damping: f64) -> Option<DVector<f64>> {
        let size = self.free.descent.len();
        let mut open: Vec<usize> = (0..size).collect();
        // Each pass takes out one unknown that pushes against its bound.
        loop {
            let mut step = DVector::zeros(size);
            if open.is_empty() {
                return Some(step);
            }
            let at = |i: usize, j: usize| self.free.matrix[(open[i], open[j])];
            let matrix = DMatrix::from_fn(open.len(), open.len(), at);
            let descent = DVector::from_fn(open.len(), |i, _| self.free.descent[open[i]]);
            let short = NormalEquations {
                cost: self.free.cost,
                matrix,
                descent,
            }
            .step(damping)?;
            open.iter()
                .zip(short.iter())
                .for_each(|(k, d)| step[*k] = *d);
            let pushing = open.iter().position(|&k| {
                (step[k] < 0.0 && !self.may[k][0]) || (step[k] > 0.0 && !self.may[k][1])
            });
            match pushing {
                Some(at) => {
                    open.remove(at);
                }
                None => return Some(step),
            }
        }
    }
}

/// How the damping goes, and how long.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damping {
    /// At the start.
    pub start: f64,
    /// Factor after a step that was taken, and the smallest damping.
    pub shrink: f64,
    /// See `shrink`.
    pub min: f64,
    /// Factor after a step that was refused, and the damping past which no shorter step is tried.
    pub grow: f64,
    /// See `grow`.
    pub max: f64,
    /// Steps tried at most.
    pub max_steps: usize,
}

impl Default for Damping {
    fn default() -> Self {
        Self {
            start: 1e-3,
            shrink: 0.2,
            min: 1e-9,
            grow: 8.0,
            max: 1e8,
            max_steps: 40,
        }
    }
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// The caller's condition holds.
    Converged,
    /// No step goes down any more, however short.
    Stalled,
    /// The damped normal matrix is not positive definite, whatever the damping.
    Singular,
    /// Steps ran out.
    Exhausted,
}

/// Where a search ended.
#[derive(Debug, Clone)]
pub struct Minimum<X, L> {
    /// Unknowns.
    pub place: X,
    /// The problem linearised there.
    pub at: L,
    /// Why it ended.
    pub ending: Ending,
}

/// Goes down from a place and the problem linearised there. `linearise` gives none where the
/// residuals do not exist; `moved` applies a step to a place linearised so; `converged` judges a
/// step that was taken by itself and the costs before and after.
pub fn minimise<X, L: Linearised>(
    (place, at): (X, L),
    damping: &Damping,
    linearise: impl Fn(&X) -> Option<L>,
    moved: impl Fn(&X, &L, &L::Step) -> X,
    converged: impl Fn(&L::Step, [f64; 2]) -> bool,
) -> Minimum<X, L> {
    let mut here = Minimum {
        place,
        at,
        ending: Ending::Exhausted,
    };
    let mut lambda = damping.start;
    for _ in 0..damping.max_steps {
        let step = here.at.step(lambda);
        // A cost that is no number is refused as one that rises.
        let next = step.as_ref().and_then(|step| {
            let place = moved(&here.place, &here.at, step);
            let next = linearise(&place).filter(|next| next.cost() <= here.at.cost())?;
            Some((place, next))
        });
        match (step, next) {
            (Some(step), Some((place, next))) => {
                let costs = [here.at.cost(), next.cost()];
                (here.place, here.at) = (place, next);
                lambda = (lambda * damping.shrink).max(damping.min);
                if converged(&step, costs) {
                    here.ending = Ending::Converged;
                    return here;
                }
            }
            (step, _) => {
                // A step may be too long, or its matrix near singular: more damping mends both.
                lambda *= damping.grow;
                if lambda > damping.max {
                    here.ending = if step.is_some() {
                        Ending::Stalled
                    } else {
                        Ending::Singular
                    };
                    return here;
                }
            }
        }
    }
    here
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Const, Matrix2, Vector2};

    /// Rosenbrock's valley as residuals: r = (10 (y - x^2), 1 - x); its minimum is 0 at (1, 1).
    fn valley(p: &Vector2<f64>) -> Option<NormalEquations<Const<2>>> {
        let r = Vector2::new(10.0 * (p.y - p.x * p.x), 1.0 - p.x);
        let j = Matrix2::new(-20.0 * p.x, 10.0, -1.0, 0.0);
        Some(NormalEquations {
            cost: r.norm_squared(),
            matrix: j.tr_mul(&j),
            descent: -j.tr_mul(&r),
        })
    }

    fn settle(
        start: Vector2<f64>,
        damping: &Damping,
    ) -> Minimum<Vector2<f64>, NormalEquations<Const<2>>> {
        let first = (start, valley(&start).unwrap());
        minimise(
            first,
            damping,
            valley,
            |p, _, d| p + d,
            |d, _| d.norm() < 1e-12,
        )
    }

    #[test]
    fn the_bottom_of_a_bent_valley_is_found() {
        let found = settle(Vector2::new(-1.2, 1.0), &Damping::default());
        assert_eq!(found.ending, Ending::Converged);
        assert!(
            (found.place - Vector2::repeat(1.0)).norm() < 1e-9,
            "{}",
            found.place
        );
        // Controls: too few steps do not get there and say so; a wrong descent stalls.
        let few = settle(
            Vector2::new(-1.2, 1.0),
            &Damping {
                max_steps: 3,
                ..Damping::default()
            },
        );
        assert!(few.ending == Ending::Exhausted && (few.place - Vector2::repeat(1.0)).norm() > 0.1);
        let uphill = |p: &Vector2<f64>| {
            valley(p).map(|n| NormalEquations {
                descent: -n.descent,
                ..n
            })
        };
        let damping = Damping {
            max_steps: 200,
            ..Damping::default()
        };
        let start = Vector2::new(-1.2, 1.0);
        let first = (start, uphill(&start).unwrap());
        let stalled = minimise(first, &damping, uphill, |p, _, d| p + d, |_, _| false);
        assert!(
            stalled.ending == Ending::Stalled && stalled.place == start,
            "{:?}",
            stalled.ending
        );
    }

    #[test]
    fn no_step_leaves_where_residuals_exist() {
        // Beside the edge of what exists, steps across it are refused and shorter ones taken.
        let fenced = |p: &Vector2<f64>| valley(p).filter(|_| p.x < 0.5);
        let damping = Damping {
            max_steps: 200,
            ..Damping::default()
        };
        let start = Vector2::new(-1.2, 1.0);
        let first = (start, fenced(&start).unwrap());
        let found = minimise(first, &damping, fenced, |p, _, d| p + d, |_, _| false);
        assert!(
            found.place.x < 0.5 && found.place.x > 0.4,
            "{}",
            found.place
        );
    }

    #[test]
    fn a_bound_holds_one_unknown_and_lets_the_others_go_down() {
        // r = (x + y - 3, x - y - 1): the bottom is (2, 1); with x <= 1.5 it is (1.5, 1), by hand.
        let top = 1.5;
        let bounded_at = |top: f64, p: &DVector<f64>| {
            let r = Vector2::new(p[0] + p[1] - 3.0, p[0] - p[1] - 1.0);
            let j = Matrix2::new(1.0, 1.0, 1.0, -1.0);
            let (matrix, descent) = (j.tr_mul(&j), -j.tr_mul(&r));
            let free = NormalEquations {
                cost: r.norm_squared(),
                matrix: DMatrix::from_column_slice(2, 2, matrix.as_slice()),
                descent: DVector::from_column_slice(descent.as_slice()),
            };
            Some(BoundedNormalEquations {
                free,
                may: vec![[true, p[0] < top], [true, true]],
            })
        };
        let at = |p: &DVector<f64>| bounded_at(top, p);
        let cut = |p: &DVector<f64>, d: &DVector<f64>| {
            DVector::from_vec(vec![(p[0] + d[0]).min(top), p[1] + d[1]])
        };
        let start = DVector::from_vec(vec![0.0, 0.0]);
        let first = (start.clone(), at(&start).unwrap());
        let found = minimise(
            first,
            &Damping::default(),
            at,
            |p, _, d| cut(p, d),
            |d, _| d.norm() < 1e-12,
        );
        assert!((found.place - DVector::from_vec(vec![1.5, 1.0])).norm() < 1e-6);
        // Control: without the bound the bottom lies beyond it.
        let free = |p: &DVector<f64>| bounded_at(f64::INFINITY, p);
        let found = minimise(
            (start.clone(), free(&start).unwrap()),
            &Damping::default(),
            free,
            |p, _, d| p + d,
            |d, _| d.norm() < 1e-12,
        );
        assert!((found.place - DVector::from_vec(vec![2.0, 1.0])).norm() < 1e-6);
    }

    #[test]
    fn a_direction_without_curvature_is_singular() {
        let flat = |p: &Vector2<f64>| {
            let r = p.x - 1.0;
            let matrix = Matrix2::new(1.0, 0.0, 0.0, 0.0);
            Some(NormalEquations {
                cost: r * r,
                matrix,
                descent: Vector2::new(-r, 0.0),
            })
        };
        let first = (Vector2::zeros(), flat(&Vector2::zeros()).unwrap());
        let found = minimise(
            first,
            &Damping::default(),
            flat,
            |p, _, d| p + d,
            |_, _| false,
        );
        assert_eq!(found.ending, Ending::Singular);
    }
}
