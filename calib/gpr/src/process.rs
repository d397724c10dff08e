//! One output: generalised least squares with a trend and a correlated part, its leave-out errors
//! and its predictions.
//!
//! y = H b + f + e, cov(f) = s2 K, cov(e) = s2 nu I, C = K + nu I = L L^T, G = L^-1 H: b = (G^T
//! G)^-1 G^T L^-1 y, a = C^-1 (y - H b), s2 = |L^-1 (y - H b)|^2 / (n - terms). At z: mean = h .
//! b + k . a, variance = s2 [k(0) - |v|^2 + u . (G^T G)^-1 u], v = L^-1 k, u = h - G^T v; noise
//! adds s2 nu. Left out as a group g: e_g = (P_gg)^-1 (P y)_g, P = C^-1 - C^-1 H (H^T C^-1 H)^-1
//! H^T C^-1, P y = a. Source: C. Rasmussen & C. Williams, "Gaussian Processes for Machine
//! Learning" (2006), sec. 2.7 and 5.4.2; O. Dubrule, Math. Geol. 15 (1983).

use crate::error::MapError;
use crate::geometry::distance;
use crate::kernel::Kernel;
use crate::trend::Trend;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Trend, correlation and noise of one output.
///
/// y = H b + f + e with cov(f) = s2 K and cov(e) = s2 nugget I; s2 is profiled out unless it is
/// given.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProcessModel {
    /// Mean.
    pub trend: Trend,
    /// Correlation of the deviation from the mean.
    pub kernel: Kernel,
    /// Noise variance over signal variance; 1 where there is no kernel.
    pub nugget: f64,
    /// Signal variance where it is not estimated.
    pub fixed_variance: Option<f64>,
}

/// A process conditioned on data.
#[derive(Debug, Clone)]
pub struct Process {
    /// Model.
    pub model: ProcessModel,
    /// Scaled inputs.
    pub inputs: Vec<[f64; 2]>,
    /// Trend coefficients.
    pub beta: DVector<f64>,
    /// C^-1 (y - H beta).
    pub alpha: DVector<f64>,
    /// Signal variance s2, output units squared.
    pub variance: f64,
    /// Degrees of freedom of s2; none where it was given.
    pub dof: Option<f64>,
    factor: Factor,
}

/// Cholesky factor of C = K + nugget I, G = L^-1 H, and the Cholesky factor of G'G.
#[derive(Debug, Clone)]
struct Factor {
    l: DMatrix<f64>,
    g: DMatrix<f64>,
    a: Option<Cholesky<f64, Dyn>>,
}

impl Factor {
    fn new(model: &ProcessModel, inputs: &[[f64; 2]]) -> Result<Self, MapError> {
        let readings = inputs.len();
        let h = model.trend.matrix(inputs);
        // Without a kernel C = nu I, whose factor is sqrt(nu) I.
        let l = if model.kernel == Kernel::None {
            DMatrix::from_diagonal_element(readings, readings, model.nugget.sqrt())
        } else {
            let mut c = model.kernel.matrix(inputs);
            for i in 0..readings {
                c[(i, i)] += model.nugget;
            }
            Cholesky::new(c)
                .ok_or(MapError::NotPositiveDefinite { readings })?
                .unpack()
        };
        let g = l
            .solve_lower_triangular(&h)
            .ok_or(MapError::NotPositiveDefinite { readings })?;
        let a = if model.trend.terms() == 0 {
            None
        } else {
            let deficient = MapError::RankDeficient {
                trend: model.trend.name(),
                readings,
            };
            let gram = g.transpose() * &g;
            // Columns differ in size, so rank is judged on the correlation of the basis functions.
            let size = gram.diagonal().map(f64::sqrt);
            let scaled = DMatrix::from_fn(gram.nrows(), gram.ncols(), |i, j| {
                gram[(i, j)] / (size[i] * size[j])
            });
            let smallest = scaled.symmetric_eigenvalues().min();
            if smallest.is_nan() || smallest < 1e-10 {
                return Err(deficient);
            }
            Some(Cholesky::new(gram).ok_or(deficient)?)
        };
        Ok(Self { l, g, a })
    }
}

/// Leave-out error of one group at fixed hyperparameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOut {
    /// Reading.
    pub index: usize,
    /// Measured minus predicted, output units.
    pub error: f64,
    /// Scale of its t (or normal) distribution, noise included.
    pub sd: f64,
    /// Degrees of freedom of that scale.
    pub dof: Option<f64>,
}

impl Process {
    /// Conditions the model on data (n scaled inputs, n outputs).
    ///
    /// # Errors
    /// [`MapError::NotPositiveDefinite`], [`MapError::RankDeficient`] or, with too few readings for
    /// the trend, [`MapError::TooFew`].
    pub fn fit(model: ProcessModel, inputs: &[[f64; 2]], y: &[f64]) -> Result<Self, MapError> {
        let terms = model.trend.terms();
        if inputs.len() < terms + 2 {
            return Err(MapError::TooFew {
                expected: terms + 2,
                found: inputs.len(),
            });
        }
        let factor = Factor::new(&model, inputs)?;
        let readings = inputs.len();
        let lost = MapError::NotPositiveDefinite { readings };
        // Whitened by L, generalised least squares is ordinary least squares on G.
        let yt = factor
            .l
            .solve_lower_triangular(&DVector::from_column_slice(y))
            .ok_or(lost.clone())?;
        let beta = match &factor.a {
            Some(a) => a.solve(&(factor.g.transpose() * &yt)),
            None => DVector::zeros(0),
        };
        let whitened = &yt - &factor.g * &beta;
        // C^-1 (y - H b) = L^-T times the whitened residual: C is not inverted.
        let alpha = factor.l.tr_solve_lower_triangular(&whitened).ok_or(lost)?;
        // Restricted estimate: each coefficient of the trend takes a degree of freedom.
        let free = (readings - terms) as f64;
        let (variance, dof) = match model.fixed_variance {
            Some(v) => (v, None),
            None => (whitened.norm_squared() / free, Some(free)),
        };
        Ok(Self {
            model,
            inputs: inputs.to_vec(),
            beta,
            alpha,
            variance,
            dof,
            factor,
        })
    }

    /// A process of known variance and coefficients of trend and readings.
    pub(crate) fn known(
        model: ProcessModel,
        variance: f64,
        inputs: &[[f64; 2]],
        [beta, alpha]: [&[f64]; 2],
    ) -> Result<Self, MapError> {
        Ok(Self {
            model,
            inputs: inputs.to_vec(),
            beta: DVector::from_column_slice(beta),
            alpha: DVector::from_column_slice(alpha),
            variance,
            dof: None,
            factor: Factor::new(&model, inputs)?,
        })
    }

    /// Basis of the trend and correlations with the readings at a scaled input; without a kernel
    /// there are none.
    fn regressors(&self, z: [f64; 2]) -> [DVector<f64>; 2] {
        let ProcessModel { trend, kernel, .. } = self.model;
        let correlation = |x: &[f64; 2]| kernel.at(distance(*x, z));
        let correlated = if kernel == Kernel::None {
            0
        } else {
            self.inputs.len()
        };
        [
            DVector::from_column_slice(&trend.basis(z)[..trend.terms()]),
            DVector::from_iterator(
                correlated,
                self.inputs.iter().take(correlated).map(correlation),
            ),
        ]
    }

    fn mean_of(&self, [h, k]: &[DVector<f64>; 2]) -> f64 {
        h.dot(&self.beta) + k.iter().zip(&self.alpha).map(|(k, a)| k * a).sum::<f64>()
    }

    /// Mean at a scaled input.
    pub(crate) fn mean(&self, z: [f64; 2]) -> f64 {
        self.mean_of(&self.regressors(z))
    }

    /// Mean at a scaled input and the variances of the mean without and with noise, output units
    /// squared.
    pub fn predict(&self, z: [f64; 2]) -> (f64, f64, f64) {
        let at = self.regressors(z);
        let mean = self.mean_of(&at);
        let [mut u, k] = at;
        let mut spread = self.model.kernel.at_zero();
        // What the data tell of f takes its prior variance down; what they leave open of b puts
        // some on again.
        if !k.is_empty() {
            let v = self.factor.l.solve_lower_triangular(&k).unwrap_or(k);
            spread -= v.norm_squared();
            u -= self.factor.g.tr_mul(&v);
        }
        if let Some(a) = &self.factor.a {
            spread += u.dot(&a.solve(&u));
        }
        let spread = self.variance * spread.max(0.0);
        (mean, spread, spread + self.variance * self.model.nugget)
    }

    /// Lower triangle by rows of F = [L 0; G^T R] with R R^T = G^T G, which turns the variance into
    /// one forward substitution: F [v; w] = [k; h], variance = s2 [k(0) - |v|^2 + |w|^2].
    pub(crate) fn joint_factor(&self) -> Vec<f64> {
        let Factor { l, g, a } = &self.factor;
        let correlated = if self.model.kernel == Kernel::None {
            0
        } else {
            self.inputs.len()
        };
        let mut out = Vec::new();
        for i in 0..correlated {
            out.extend((0..=i).map(|j| l[(i, j)]));
        }
        if let Some(a) = a {
            let r = a.l();
            for i in 0..r.nrows() {
                out.extend((0..correlated).map(|j| g[(j, i)]));
                out.extend((0..=i).map(|j| r[(i, j)]));
            }
        }
        out
    }

    /// P = C^-1 - C^-1 H (H'C^-1 H)^-1 H'C^-1, n x n.
    fn projection(&self) -> DMatrix<f64> {
        let n = self.inputs.len();
        let linv = self
            .factor
            .l
            .solve_lower_triangular(&DMatrix::identity(n, n))
            .unwrap_or_else(|| DMatrix::zeros(n, n));
        // P in full: one O(n^3) product serves every group's block.
        let mut p = linv.transpose() * &linv;
        if let Some(a) = &self.factor.a {
            // C^-1 H = L^-T G: what refitting the trend takes off.
            let b = linv.transpose() * &self.factor.g;
            p -= &b * a.solve(&b.transpose());
        }
        p
    }

    /// Errors of each group when it is omitted, from the inverse alone (Dubrule 1983; Rasmussen &
    /// Williams 2006, eq. 5.12): e_g = (P_gg)^-1 (P y)_g. Hyperparameters stay; trend and, where it
    /// is estimated, s2 are those of the rest.
    pub fn leave_out(&self, groups: &[Vec<usize>]) -> Vec<LeftOut> {
        let p = self.projection();
        // s2 of all readings times their degrees of freedom is the sum of squares.
        let total = self.dof.map_or(0.0, |nu| nu * self.variance);
        let mut out = Vec::with_capacity(self.inputs.len());
        for group in groups {
            let m = group.len();
            let block = DMatrix::from_fn(m, m, |i, j| p[(group[i], group[j])]);
            // A group that alone determines a trend coefficient cannot be predicted from the rest.
            let Some(inverse) = Cholesky::new(block).map(|c| c.inverse()) else {
                continue;
            };
            // alpha is P y already (Dubrule 1983).
            let py = DVector::from_iterator(m, group.iter().map(|i| self.alpha[*i]));
            let error = &inverse * &py;
            // s2 of the rest: the group's own misfit comes off the sum of squares.
            let dof = self.dof.map(|nu| nu - m as f64).filter(|nu| *nu > 0.0);
            let variance = match dof {
                Some(nu) => ((total - py.dot(&error)) / nu).max(0.0),
                None => self.variance,
            };
            for (at, index) in group.iter().enumerate() {
                out.push(LeftOut {
                    index: *index,
                    error: error[at],
                    sd: (variance * inverse[(at, at)]).sqrt(),
                    dof,
                });
            }
        }
        out
    }
}
