//! Coefficients of a polynomial in the stimulus, to the digits that double precision allows.

use nalgebra::{DMatrix, DVector};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Least-squares polynomial in the stimulus as measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Polynomial {
    /// Coefficients, constant first.
    pub coefficients: Vec<f64>,
    /// Their standard errors.
    pub standard_errors: Vec<f64>,
    /// Residual standard deviation.
    pub residual_sd: f64,
    /// Residual degrees of freedom.
    pub dof: f64,
}

/// a*b as a sum of two doubles (fused multiply-add gives the rounding error exactly).
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let p = a * b;
    (p, a.mul_add(b, -p))
}

/// y - sum b_k x^k with the products and sums compensated (Ogita, Rump & Oishi 2005), so that
/// refinement has something to work on.
fn residual(y: f64, powers: &[f64], b: &[f64]) -> f64 {
    let (mut sum, mut low) = (y, 0.0);
    for (p, c) in powers.iter().zip(b) {
        let (term, error) = two_product(-p, *c);
        let next = sum + term;
        // Knuth's sum of two doubles: what `next` lost to rounding is found exactly.
        let back = next - sum;
        low += (sum - (next - back)) + (term - back) + error;
        sum = next;
    }
    sum + low
}

/// Fits a polynomial of `degree` with weights (1 / relative sd). None with too few readings or too
/// few different stimuli.
pub fn polynomial(x: &[f64], y: &[f64], weights: &[f64], degree: usize) -> Option<Polynomial> {
    let n = weights.iter().filter(|w| **w > 0.0).count();
    let q = degree + 1;
    if n <= q {
        return None;
    }
    let powers: Vec<Vec<f64>> = x
        .iter()
        .map(|x| (0..q).map(|k| x.powi(k as i32)).collect::<Vec<f64>>())
        .collect();
    let design = DMatrix::from_fn(x.len(), q, |i, j| weights[i] * powers[i][j]);
    // Columns of unit length: powers of a stimulus differ by many orders of magnitude.
    let scale: Vec<f64> = design.column_iter().map(|c| c.norm()).collect();
    if scale.iter().any(|s| !(*s > 0.0)) {
        return None;
    }
    let scaled = DMatrix::from_fn(x.len(), q, |i, j| design[(i, j)] / scale[j]);
    let qr = scaled.qr();
    let (q_matrix, r) = (qr.q(), qr.r());
    let r_inverse = r
        .clone()
        .try_inverse()
        .filter(|m| m.iter().all(|v| v.is_finite() && v.abs() < 1e12))?;
    let mut b = vec![0.0; q];
    let left =
        |b: &[f64]| DVector::from_fn(x.len(), |i, _| weights[i] * residual(y[i], &powers[i], b));
    // Iterative refinement: each pass solves for what the last left in the residual.
    for _ in 0..4 {
        let step = &r_inverse * (q_matrix.transpose() * left(&b));
        for k in 0..q {
            b[k] += step[k] / scale[k];
        }
    }
    let dof = (n - q) as f64;
    let residual_sd = (left(&b).norm_squared() / dof).sqrt();
    // s sqrt((X' X)^-1_kk), by the rows of R^-1.
    let standard_errors = (0..q)
        .map(|k| residual_sd * r_inverse.row(k).norm() / scale[k])
        .collect();
    Some(Polynomial {
        coefficients: b,
        standard_errors,
        residual_sd,
        dof,
    })
}
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_cubic_comes_back_to_the_last_digits() {
        let x: Vec<f64> = (0..21).map(f64::from).collect();
        let y: Vec<f64> = x
            .iter()
            .map(|x| 1.0 - 3.0 * x + 0.5 * x * x - 0.25 * x * x * x)
            .collect();
        let fit = polynomial(&x, &y, &[1.0; 21], 3).unwrap();
        for (got, want) in fit.coefficients.iter().zip([1.0, -3.0, 0.5, -0.25]) {
            assert!((got / want - 1.0).abs() < 1e-14, "{got} {want}");
        }
    }

    #[test]
    fn too_few_stimuli_are_refused() {
        assert!(polynomial(&[1.0, 1.0, 1.0, 1.0], &[1.0, 2.0, 3.0, 4.0], &[1.0; 4], 1).is_none());
    }
}
