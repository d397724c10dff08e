//! Restricted likelihood of a noise model, every coefficient of the mean refitted.
//!
//! With p columns X in all, Sigma(theta) the covariance of the readings in units of the repeat
//! noise, and r the whitened residual:
//!
//! ```text
//! -2 log L(theta) = (N - p) log(r' r) + log|Sigma(theta)| + log|X' Sigma^-1 X|          (parts of one mean model)
//! -2 log L(theta) = N log(r' r) + log|Sigma(theta)|                                     (models with different means)
//! ```
//!
//! Patterson & Thompson, Biometrika 58 (1971), 545-554; the scale is concentrated out.

use super::whitening::Weights;
use crate::method::fitted::Fit;
use crate::method::linear::{Basis, stack};
use nalgebra::{DMatrix, DVector};

/// The mean model that residuals are left by: everything refitted at each theta.
pub struct MeanModel<'a> {
    pub(super) design: &'a DMatrix<f64>,
    pub(super) tangents: &'a [DMatrix<f64>],
    pub(super) residual: &'a DMatrix<f64>,
    pub(super) extra: Vec<Vec<f64>>,
}

impl<'a> MeanModel<'a> {
    /// Around a fit.
    pub fn of(fit: &'a Fit) -> Self {
        Self {
            design: &fit.raw_design,
            tangents: &fit.raw_tangents,
            residual: &fit.raw_residual,
            extra: Vec::new(),
        }
    }

    /// With more columns, free in every channel.
    pub fn with(mut self, columns: &[Vec<f64>]) -> Self {
        self.extra.extend_from_slice(columns);
        self
    }

    /// Every column that is free in each channel.
    fn columns(&self) -> DMatrix<f64> {
        let own = self.design.ncols();
        DMatrix::from_fn(self.design.nrows(), own + self.extra.len(), |i, j| match j
            .checked_sub(own)
        {
            None => self.design[(i, j)],
            Some(k) => self.extra[k][i],
        })
    }
}

/// Misfit of a mean model under given weights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RestrictedLikelihood {
    /// Sum of squares of the whitened residual.
    pub ssr: f64,
    /// Values less parameters.
    pub dof: f64,
    /// Values.
    pub values: f64,
    /// -2 log restricted likelihood.
    pub restricted: f64,
    /// -2 log likelihood.
    pub plain: f64,
}

/// Guards columns of unit length that depend on each other.
const RIDGE: f64 = 1e-9;

/// Misfit of `model` with all its coefficients refitted under `weights`; none where they cannot be.
pub(crate) fn restricted_likelihood(
    model: &MeanModel,
    weights: &Weights,
) -> Option<RestrictedLikelihood> {
    let channels = model.residual.ncols();
    let mut x = weights.apply(&model.columns());
    let q = x.ncols();
    let y = weights.apply(model.residual);
    // Columns of one length, so that the ridge that guards dependent ones means the same to all.
    let mut log_scale = 0.0;
    for mut column in x.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
            log_scale += 2.0 * norm.ln();
        }
    }
    let gram = (x.transpose() * &x) + DMatrix::identity(q, q) * RIDGE;
    let chol = gram.cholesky()?;
    let log_det: f64 = chol.l_dirty().diagonal().iter().map(|v| 2.0 * v.ln()).sum();
    // Projection off the design, I - X (X'X)^-1 X': the linear coefficients are refitted at every
    // theta.
    let off = |m: &DMatrix<f64>| m - &x * chol.solve(&(x.transpose() * m));
    let r = off(&y);
    let mut log_x = channels as f64 * (log_det + log_scale);
    let mut ssr = r.norm_squared();
    // A tangent may be nothing at all: the place of a step moves no reading at first.
    let tangents: Vec<DMatrix<f64>> = model
        .tangents
        .iter()
        .map(|t| off(&weights.apply(t)))
        .collect();
    let live: Vec<&DMatrix<f64>> = tangents
        .iter()
        .filter(|t| t.norm_squared() > 1e-200)
        .collect();
    let m = live.len();
    if m > 0 {
        // The determinant of X'X factorises: tangents enter by their part off the design (Schur
        // complement).
        let size: Vec<f64> = live.iter().map(|t| t.norm()).collect();
        let small = DMatrix::from_fn(m, m, |a, b| live[a].dot(live[b]) / (size[a] * size[b]))
            + DMatrix::identity(m, m) * RIDGE;
        let right = DVector::from_fn(m, |a, _| live[a].dot(&r) / size[a]);
        let chol = small.cholesky()?;
        ssr -= right.dot(&chol.solve(&right));
        log_x += chol
            .l_dirty()
            .diagonal()
            .iter()
            .map(|v| 2.0 * v.ln())
            .sum::<f64>()
            + size.iter().map(|s| 2.0 * s.ln()).sum::<f64>();
    }
    let values = (weights.active() * channels) as f64;
    let dof = values - (q * channels + model.tangents.len()) as f64;
    if !(dof >= 1.0 && ssr > 0.0) {
        return None;
    }
    // Channels share one covariance of the readings: its determinant counts once for each.
    let log_sigma = channels as f64 * weights.log_determinant();
    Some(RestrictedLikelihood {
        ssr,
        dof,
        values,
        restricted: dof * ssr.ln() + log_sigma + log_x,
        plain: values * ssr.ln() + log_sigma,
    })
}

/// Lowest value of a function of a few variables by a shrinking star, from `start` with steps
/// `step`.
pub(super) fn pattern_search<const K: usize>(
    start: [f64; K],
    step: [f64; K],
    low: [f64; K],
    high: [f64; K],
    f: &dyn Fn(&[f64; K]) -> f64,
) -> ([f64; K], f64) {
    let (mut at, mut step) = (start, step);
    let mut best = f(&at);
    // Compass search needs no derivatives; seven rounds take the step down to 1/64 of the first.
    for _ in 0..7 {
        let mut moved = true;
        let mut rounds = 0;
        while moved && rounds < 6 {
            moved = false;
            rounds += 1;
            for k in 0..K {
                for sign in [1.0, -1.0] {
                    let mut next = at;
                    next[k] = (next[k] + sign * step[k]).clamp(low[k], high[k]);
                    let value = f(&next);
                    if value < best {
                        (at, best, moved) = (next, value, true);
                    }
                }
            }
        }
        step = step.map(|s| 0.5 * s);
    }
    (at, best)
}

/// Lowest of several descents.
pub(super) fn best_of<const K: usize>(
    starts: &[f64],
    run: impl Fn(&f64) -> ([f64; K], f64),
) -> ([f64; K], f64) {
    let all = starts.iter().map(run).collect::<Vec<_>>();
    all.into_iter()
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .unwrap_or(([0.0; K], f64::INFINITY))
}

/// Whitened residuals in standard deviations, each over the share of its variance that the whole
/// mean model leaves, channel by channel; only readings that count.
pub(super) fn studentised_residuals(model: &MeanModel, weights: &Weights, s: f64) -> Vec<f64> {
    studentised_by_channel(model, weights, s)
        .into_iter()
        .flat_map(|(_, z)| z)
        .collect()
}

/// Reading and its standardised residuals in every channel.
pub(super) fn studentised_by_channel(
    model: &MeanModel,
    weights: &Weights,
    s: f64,
) -> Vec<(usize, Vec<f64>)> {
    let (n, channels) = model.residual.shape();
    // Every column is free in each channel; a tangent moves all of them at once.
    let columns = weights.apply(&model.columns());
    let in_channel = |k: usize| {
        let mut direction = DMatrix::zeros(n, channels);
        direction.set_column(k % channels, &columns.column(k / channels));
        stack(&direction)
    };
    let tangents = model.tangents.iter().map(|t| stack(&weights.apply(t)));
    let basis = Basis::of(
        (0..columns.ncols() * channels)
            .map(in_channel)
            .chain(tangents),
    );
    let left = basis.project_off(&stack(&weights.apply(model.residual)));
    let of = |i: usize| {
        let studentised = |k: usize| left[k] / (s * basis.unexplained_sd(k));
        (i, (0..channels).map(|c| studentised(c * n + i)).collect())
    };
    (0..n).filter(|&i| weights.counts(i)).map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::method::noise::tails::tails;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// How many of 60 SIMULATED sessions of Gaussian noise have heavy tails, where a driver lifts
    /// one reading of twelve: by a column, by a tangent, or unknown to the model.
    fn heavy(known: impl Fn(&DVector<f64>) -> (Vec<Vec<f64>>, Vec<DMatrix<f64>>)) -> usize {
        let n = 120;
        let design = DMatrix::from_fn(n, 2, |i, j| if j == 0 { 1.0 } else { (i % 7) as f64 });
        let driver = DVector::from_fn(n, |i, _| f64::from(u8::from(i % 12 == 5)));
        let one = |seed: u64| {
            let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
            let residual = DMatrix::from_fn(n, 1, |i, _| {
                let z: f64 = StandardNormal.sample(&mut rng);
                z + 7.0 * driver[i]
            });
            let (extra, tangents) = known(&driver);
            let model = MeanModel {
                design: &design,
                tangents: &tangents,
                residual: &residual,
                extra,
            };
            let weights = Weights::equal(n);
            let m = restricted_likelihood(&model, &weights).unwrap();
            tails(&studentised_residuals(
                &model,
                &weights,
                (m.ssr / m.dof).sqrt(),
            ))
            .unwrap()
            .heavy
        };
        (0..60).filter(|seed| one(*seed)).count()
    }

    #[test]
    fn tails_are_those_of_what_the_whole_model_leaves() {
        let column = heavy(|d| (vec![d.iter().copied().collect()], Vec::new()));
        let tangent = heavy(|d| {
            (
                Vec::new(),
                vec![DMatrix::from_column_slice(d.len(), 1, d.as_slice())],
            )
        });
        let unknown = heavy(|_| (Vec::new(), Vec::new()));
        // At a level of 0.01 four or more come by chance once in 300 such tests. Control: what
        // nothing knows looks heavy.
        assert!(
            column <= 3 && tangent <= 3 && unknown >= 50,
            "{column} {tangent} {unknown}"
        );
    }
}
