//! Hyperparameters by restricted likelihood.
//!
//! Contrasts z = Q^T y with Q^T H = 0 (Householder), K_Q = Q^T K Q, n' = n - terms: ln L = -1/2 [n'
//! (ln 2 pi s2 + 1) + ln det(K_Q + nu I)], s2 = z . (K_Q + nu I)^-1 z / n'. With K_Q = V T V^T, T
//! tridiagonal, it costs O(n) for each further noise ratio nu: pivots p_i = T_ii + nu - T_(i,i-1)^2
//! / p_(i-1), w_i = (V^T z)_i - T_(i,i-1) w_(i-1) / p_(i-1), ln det = sum ln p_i, n' s2 = sum w_i^2
//! / p_i. Source: H. Patterson & R. Thompson, Biometrika 58 (1971); G. Golub & C. Van Loan, "Matrix
//! Computations" (2013), sec. 5.1, 8.3 and 4.3.

use crate::error::MapError;
use crate::kernel::Kernel;
use crate::process::ProcessModel;
use crate::trend::Trend;
use nalgebra::{DMatrix, DVector, Dyn, QR, SymmetricTridiagonal};

/// Range of noise over signal variance. The upper end is "no correlated part to be seen", the lower
/// one keeps C well conditioned.
const LOG10_NUGGET: [f64; 2] = [-9.0, 6.0];

/// Range of the shape parameter that is searched, and the number of grid points on it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ShapeSearch {
    /// Smallest value, scaled input units.
    pub low: f64,
    /// Largest value, scaled input units.
    pub high: f64,
    /// Grid points before refinement.
    pub steps: usize,
}

impl ShapeSearch {
    /// A bracket of a factor 3 either way about a value, inside the range: folds start from the
    /// full fit.
    pub fn about(&self, value: f64) -> Self {
        Self {
            low: (value / 3.0).max(self.low),
            high: (value * 3.0).min(self.high),
            steps: 3,
        }
    }
}

/// Residual contrasts of one output: the data with the trend projected off, in the basis that makes
/// K tridiagonal.
struct Contrasts {
    diagonal: DVector<f64>,
    off: DVector<f64>,
    y: DVector<f64>,
}

/// The space at right angles to the trend's columns: the last rows of Q^T (Householder).
struct TrendNull {
    qr: QR<f64, Dyn, Dyn>,
    terms: usize,
}

impl TrendNull {
    fn new(trend: Trend, inputs: &[[f64; 2]]) -> Self {
        Self {
            qr: trend.matrix(inputs).qr(),
            terms: trend.terms(),
        }
    }

    fn project(&self, mut columns: DMatrix<f64>) -> DMatrix<f64> {
        self.qr.q_tr_mul(&mut columns);
        // Q^T carries the trend to the first rows: the others know nothing of it.
        columns.remove_rows(0, self.terms)
    }

    fn project_vector(&self, y: &[f64]) -> DVector<f64> {
        let column = DMatrix::from_column_slice(y.len(), 1, y);
        self.project(column).column(0).into_owned()
    }
}

impl Contrasts {
    fn new(null: &TrendNull, kernel: &Kernel, inputs: &[[f64; 2]], y: &[f64]) -> Self {
        // Orthonormal contrasts: their likelihood is the restricted one, up to a constant in the
        // hyperparameters.
        let projected = null.project(null.project(kernel.matrix(inputs)).transpose());
        let y = null.project_vector(y);
        if y.len() < 2 {
            return Self {
                diagonal: projected.diagonal(),
                off: DVector::zeros(0),
                y,
            };
        }
        // Adding nu I leaves V as it is: one reduction serves every noise ratio.
        let (q, diagonal, off) = SymmetricTridiagonal::new(projected).unpack();
        Self {
            diagonal,
            off,
            y: q.tr_mul(&y),
        }
    }

    /// Restricted log likelihood with s2 profiled out, in O(n); none where the matrix is not
    /// positive definite.
    fn log_evidence(&self, nugget: f64) -> Option<f64> {
        let n = self.y.len();
        // One sweep of the tridiagonal factorisation gives the determinant and the quadratic form.
        let (mut log_det, mut square, mut pivot, mut carried) = (0.0, 0.0, 1.0, 0.0);
        for i in 0..n {
            let below = if i == 0 { 0.0 } else { self.off[i - 1] };
            let factor = if i == 0 { 0.0 } else { below / pivot };
            // Forward substitution with the bidiagonal factor.
            carried = self.y[i] - factor * carried;
            pivot = self.diagonal[i] + nugget - factor * below;
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            log_det += pivot.ln();
            square += carried * carried / pivot;
        }
        Some(profiled(n, square, log_det))
    }
}

/// -1/2 [n ln(2 pi s2) + n + ln det] with s2 = square / n.
fn profiled(n: usize, square: f64, log_det: f64) -> f64 {
    let free = n as f64;
    // Floored: a trend that interpolates the readings leaves no variance.
    let variance = (square / free).max(f64::MIN_POSITIVE);
    -0.5 * (free * ((2.0 * std::f64::consts::PI * variance).ln() + 1.0) + log_det)
}

/// Restricted log likelihood of a model with s2 profiled out; none where it is not positive
/// definite.
pub fn log_evidence(model: &ProcessModel, inputs: &[[f64; 2]], y: &[f64]) -> Option<f64> {
    let null = TrendNull::new(model.trend, inputs);
    if model.kernel == Kernel::None {
        // Without a kernel C = nu I, whose determinant is nu^n'.
        let free = null.project_vector(y);
        let log_det = free.len() as f64 * model.nugget.ln();
        return Some(profiled(
            free.len(),
            free.norm_squared() / model.nugget,
            log_det,
        ));
    }
    Contrasts::new(&null, &model.kernel, inputs, y).log_evidence(model.nugget)
}

/// Best noise ratio (log10) and evidence at one kernel.
fn best_nugget(null: &TrendNull, kernel: Kernel, inputs: &[[f64; 2]], y: &[f64]) -> (f64, f64) {
    let contrasts = Contrasts::new(null, &kernel, inputs, y);
    let evidence = |p: f64| {
        contrasts
            .log_evidence(10f64.powf(p))
            .unwrap_or(f64::NEG_INFINITY)
    };
    maximise(evidence, LOG10_NUGGET, 46, 20)
}

/// Chooses noise ratio and, where a range is given, the kernel's shape parameter.
///
/// # Errors
/// [`MapError::NotPositiveDefinite`] where no admissible value gives a positive definite matrix.
pub fn choose_hyperparameters(
    trend: Trend,
    kernel: Kernel,
    search: Option<ShapeSearch>,
    inputs: &[[f64; 2]],
    y: &[f64],
) -> Result<ProcessModel, MapError> {
    if kernel == Kernel::None {
        return Ok(ProcessModel {
            trend,
            kernel,
            nugget: 1.0,
            fixed_variance: None,
        });
    }
    // Nested: the best noise ratio is cheap for a given shape, which costs a factorisation.
    let null = TrendNull::new(trend, inputs);
    let best = |shape: f64| best_nugget(&null, kernel.with_shape(shape), inputs, y);
    let shape = match search {
        Some(s) => {
            // In logarithms: a length is known by its order of magnitude first.
            let range = [s.low.ln(), s.high.ln()];
            maximise(|p| best(p.exp()).1, range, s.steps, 8).0.exp()
        }
        None => kernel.shape().unwrap_or(1.0),
    };
    let (log_nugget, value) = best(shape);
    if value == f64::NEG_INFINITY {
        return Err(MapError::NotPositiveDefinite {
            readings: inputs.len(),
        });
    }
    Ok(ProcessModel {
        trend,
        kernel: kernel.with_shape(shape),
        nugget: 10f64.powf(log_nugget),
        fixed_variance: None,
    })
}

/// Largest value on a grid of `steps` points, refined by golden section between its neighbours.
fn maximise(
    mut f: impl FnMut(f64) -> f64,
    range: [f64; 2],
    steps: usize,
    refinements: usize,
) -> (f64, f64) {
    // The likelihood may have several maxima: the grid chooses one, golden section refines it.
    let spacing = (range[1] - range[0]) / (steps - 1) as f64;
    let mut best = (range[0], f64::NEG_INFINITY);
    for i in 0..steps {
        let x = range[0] + spacing * i as f64;
        let value = f(x);
        if value > best.1 {
            best = (x, value);
        }
    }
    // Golden section: each step keeps 0.618 of the bracket and one of its two inner values.
    let golden = (5.0_f64.sqrt() - 1.0) / 2.0;
    let (mut low, mut high) = (
        (best.0 - spacing).max(range[0]),
        (best.0 + spacing).min(range[1]),
    );
    let (mut a, mut b) = (high - golden * (high - low), low + golden * (high - low));
    let (mut fa, mut fb) = (f(a), f(b));
    for _ in 0..refinements {
        if fa > fb {
            (high, b, fb) = (b, a, fa);
            a = high - golden * (high - low);
            fa = f(a);
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + golden * (high - low);
            fb = f(b);
        }
    }
    for (x, value) in [(a, fa), (b, fb)] {
        if value > best.1 {
            best = (x, value);
        }
    }
    best
}
