//! Convex programmes by clarabel (interior point): min 1/2 x'Px + q'x with `bounds - rows x` in a product of cones.

use clarabel::algebra::CscMatrix;
use clarabel::solver::{DefaultSettings, DefaultSolver, IPSolver, SolverStatus, SupportedConeT};
use nalgebra::DMatrix;

/// The minimiser; none where the solver gives up.
pub(super) fn minimise(
    quadratic: &DMatrix<f64>,
    linear: &[f64],
    rows: &[Vec<(usize, f64)>],
    bounds: &[f64],
    cones: &[SupportedConeT<f64>],
) -> Option<Vec<f64>> {
    let n = linear.len();
    let upper: Vec<Vec<(usize, f64)>> =
        (0..n).map(|i| (i..n).map(|j| (j, quadratic[(i, j)])).filter(|e| e.1 != 0.0).collect()).collect();
    let (p, a) = (sparse(&upper, n, n), sparse(rows, rows.len(), n));
    let settings = DefaultSettings { verbose: false, ..DefaultSettings::default() };
    let mut solver = DefaultSolver::new(&p, linear, &a, bounds, cones, settings).ok()?;
    solver.solve();
    let solved = matches!(solver.solution.status, SolverStatus::Solved | SolverStatus::AlmostSolved);
    solved.then(|| solver.solution.x.clone())
}

fn sparse(rows: &[Vec<(usize, f64)>], height: usize, width: usize) -> CscMatrix<f64> {
    let (mut i, mut j, mut v) = (Vec::new(), Vec::new(), Vec::new());
    for (r, row) in rows.iter().enumerate() {
        for (c, x) in row {
            i.push(r);
            j.push(*c);
            v.push(*x);
        }
    }
    CscMatrix::new_from_triplets(height, width, i, j, v)
}
