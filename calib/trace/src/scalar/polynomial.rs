//! Coefficients of a polynomial in the stimulus, to the digits that double precision allows, and the lack-of-fit test.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Least-squares polynomial in the stimulus as measured.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
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

/// y - sum b_k x^k with the products and sums compensated (Ogita, Rump & Oishi 2005), so that refinement has something to work on.
fn residual(y: f64, powers: &[f64], b: &[f64]) -> f64 {
    let (mut sum, mut low) = (y, 0.0);
    for (p, c) in powers.iter().zip(b) {
        let (term, error) = two_product(-p, *c);
        let next = sum + term;
        let back = next - sum;
        low += (sum - (next - back)) + (term - back) + error;
        sum = next;
    }
    sum + low
}

/// Fits a polynomial of `degree` with weights (1 / relative sd). None with too few readings or too few different stimuli.
#[must_use]
pub fn polynomial(x: &[f64], y: &[f64], weights: &[f64], degree: usize) -> Option<Polynomial> {
    let n = weights.iter().filter(|w| **w > 0.0).count();
    let q = degree + 1;
    if n <= q {
        return None;
    }
    let powers: Vec<Vec<f64>> =
        x.iter().map(|x| (0..q).map(|k| x.powi(k as i32)).collect::<Vec<f64>>()).collect();
    let design = DMatrix::from_fn(x.len(), q, |i, j| weights[i] * powers[i][j]);
    let scale: Vec<f64> = design.column_iter().map(|c| c.norm()).collect();
    if scale.iter().any(|s| !(*s > 0.0)) {
        return None;
    }
    let scaled = DMatrix::from_fn(x.len(), q, |i, j| design[(i, j)] / scale[j]);
    let qr = scaled.qr();
    let (q_matrix, r) = (qr.q(), qr.r());
    let r_inverse = r.clone().try_inverse().filter(|m| m.iter().all(|v| v.is_finite() && v.abs() < 1e12))?;
    let mut b = vec![0.0; q];
    let left = |b: &[f64]| DVector::from_fn(x.len(), |i, _| weights[i] * residual(y[i], &powers[i], b));
    // Iterative refinement: each pass solves for what the last left in the residual.
    for _ in 0..4 {
        let step = &r_inverse * (q_matrix.transpose() * left(&b));
        for k in 0..q {
            b[k] += step[k] / scale[k];
        }
    }
    let dof = (n - q) as f64;
    let residual_sd = (left(&b).norm_squared() / dof).sqrt();
    let standard_errors = (0..q).map(|k| residual_sd * r_inverse.row(k).norm() / scale[k]).collect();
    Some(Polynomial { coefficients: b, standard_errors, residual_sd, dof })
}

/// Pure error from readings of one stimulus, and lack of fit against it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LackOfFit {
    /// Standard deviation of readings of one stimulus.
    pub pure_sd: f64,
    /// Degrees of freedom of the pure error.
    pub pure_dof: f64,
    /// F of the rest of the misfit.
    pub f: f64,
    /// Its degrees of freedom.
    pub dof: f64,
    /// p-value.
    pub p_value: f64,
}

/// Splits the misfit of a model with `parameters` free values. `keys` groups replicates; rows with weight 0 do not count.
/// None where nothing was repeated, or nothing is left to test.
#[must_use]
pub fn lack_of_fit(residual: &[f64], keys: &[u64], weights: &[f64], parameters: usize) -> Option<LackOfFit> {
    let mut rows: Vec<usize> = (0..residual.len()).filter(|&i| weights[i] > 0.0).collect();
    rows.sort_by_key(|&i| keys[i]);
    let (mut pure, mut levels) = (0.0, 0usize);
    for group in rows.chunk_by(|&a, &b| keys[a] == keys[b]) {
        // Weighted mean of the unweighted residuals: the weighted residual of one stimulus has one weight.
        let mean = group.iter().map(|&i| residual[i]).sum::<f64>() / group.len() as f64;
        pure += group.iter().map(|&i| (residual[i] - mean).powi(2)).sum::<f64>();
        levels += 1;
    }
    let pure_dof = (rows.len() - levels) as f64;
    let dof = levels as f64 - parameters as f64;
    if pure_dof < 1.0 || !(pure > 0.0) {
        return None;
    }
    let total: f64 = rows.iter().map(|&i| residual[i].powi(2)).sum();
    let pure_variance = pure / pure_dof;
    let (f, p_value) = if dof >= 1.0 {
        let f = ((total - pure).max(0.0) / dof) / pure_variance;
        (f, FisherSnedecor::new(dof, pure_dof).map_or(1.0, |d| d.sf(f)))
    } else {
        (0.0, 1.0)
    };
    Some(LackOfFit { pure_sd: pure_variance.sqrt(), pure_dof, f, dof, p_value })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_cubic_comes_back_to_the_last_digits() {
        let x: Vec<f64> = (0..21).map(f64::from).collect();
        let y: Vec<f64> = x.iter().map(|x| 1.0 - 3.0 * x + 0.5 * x * x - 0.25 * x * x * x).collect();
        let fit = polynomial(&x, &y, &[1.0; 21], 3).unwrap();
        for (got, want) in fit.coefficients.iter().zip([1.0, -3.0, 0.5, -0.25]) {
            assert!((got / want - 1.0).abs() < 1e-14, "{got} {want}");
        }
    }

    #[test]
    fn too_few_stimuli_are_refused() {
        assert!(polynomial(&[1.0, 1.0, 1.0, 1.0], &[1.0, 2.0, 3.0, 4.0], &[1.0; 4], 1).is_none());
    }

    #[test]
    fn lack_of_fit_rises_when_a_level_is_moved() {
        let keys: Vec<u64> = (0..12).map(|k| k / 3).collect();
        let noise = [0.1, -0.1, 0.0];
        let fair: Vec<f64> = (0..12).map(|k| noise[k % 3]).collect();
        let moved: Vec<f64> = (0..12).map(|k| noise[k % 3] + if k / 3 == 1 { 1.0 } else { 0.0 }).collect();
        let good = lack_of_fit(&fair, &keys, &[1.0; 12], 2).unwrap();
        let bad = lack_of_fit(&moved, &keys, &[1.0; 12], 2).unwrap();
        assert!(good.p_value > 0.5 && bad.p_value < 1e-4, "{good:?} {bad:?}");
    }
}
