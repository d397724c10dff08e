//! Covariances: what a file may state as one (square, symmetric, no variance or combination of
//! parameters below zero), and the root of one.

use nalgebra::allocator::Allocator;
use nalgebra::{DMatrix, DefaultAllocator, Dim, OMatrix};

/// Relative size of a negative eigenvalue, and of a difference across the diagonal, that is
/// rounding.
const ROUNDING: f64 = 1e-6;
/// Largest standard deviation that is a number of something.
const LARGEST: f64 = 1e30;

/// Holds a matrix that a file states against what a covariance of `parameters` can be.
///
/// # Errors
/// Why it is none.
pub fn check(covariance: &[Vec<f64>], parameters: usize) -> Result<(), String> {
    let rows = covariance.len();
    if rows != parameters {
        return Err(format!(
            "{parameters} rows and columns expected, {rows} rows found"
        ));
    }
    if let Some(k) = (0..rows).find(|&k| covariance[k].len() != parameters) {
        return Err(format!(
            "{parameters} columns expected, {} numbers in row {} found",
            covariance[k].len(),
            k + 1
        ));
    }
    if let Some(k) = (0..parameters).find(|&k| !(covariance[k][k] >= 0.0)) {
        return Err(format!(
            "variances of 0 or more expected, {} found in row {}",
            covariance[k][k],
            k + 1
        ));
    }
    let (sd, correlation) = correlation(covariance);
    let numbers = correlation
        .iter()
        .chain(&sd)
        .all(|v| v.is_finite() && v.abs() <= LARGEST);
    let symmetric = numbers && (&correlation - correlation.transpose()).amax() <= ROUNDING;
    let positive = symmetric
        && correlation
            .symmetric_eigenvalues()
            .iter()
            .all(|v| *v >= -ROUNDING);
    if positive {
        Ok(())
    } else {
        Err("a symmetric matrix without negative eigenvalues expected".to_owned())
    }
}

/// Standard deviations and correlations: pixels and radians differ by orders of magnitude. A
/// parameter without variance is taken as known.
pub fn correlation(covariance: &[Vec<f64>]) -> (Vec<f64>, DMatrix<f64>) {
    let count = covariance.len();
    let sd: Vec<f64> = (0..count).map(|i| covariance[i][i].sqrt()).collect();
    let correlation = DMatrix::from_fn(count, count, |i, j| match sd[i] * sd[j] {
        scale if scale > 0.0 => covariance[i][j] / scale,
        scale => scale,
    });
    (sd, correlation)
}

/// The lower triangle L with L L^T = `covariance` (Cholesky): its columns are errors of one
/// standard deviation that are independent of each other. Zero, of what is known exactly, has the
/// root zero.
///
/// # Errors
/// Where it is no covariance: as zero, errors that nobody knows would count as none.
pub fn root<D: Dim>(covariance: &OMatrix<f64, D, D>) -> Result<OMatrix<f64, D, D>, String>
where
    DefaultAllocator: Allocator<D, D>,
{
    if covariance.iter().all(|v| *v == 0.0) {
        return Ok(covariance.clone());
    }
    let factor = covariance.clone().cholesky();
    factor
        .map(|c| c.l())
        .ok_or_else(|| "a matrix with eigenvalues above zero expected".to_owned())
}

#[cfg(test)]
mod tests {
    use super::{check, root};
    use nalgebra::Matrix2;

    #[test]
    fn a_root_makes_its_covariance_and_none_is_made_up() {
        let covariance = Matrix2::new(4.0, 1.0, 1.0, 2.0);
        let found = root(&covariance).unwrap();
        assert!(
            (found * found.transpose() - covariance).norm() < 1e-14,
            "{found}"
        );
        assert_eq!(root(&Matrix2::zeros()), Ok(Matrix2::zeros()));
        for none in [
            Matrix2::new(1.0, 2.0, 2.0, 1.0),
            Matrix2::identity() * f64::NAN,
            -covariance,
        ] {
            assert!(root(&none).is_err(), "{none}");
        }
    }

    #[test]
    fn what_no_parameters_can_have_is_refused() {
        let of = |a: f64, b: f64, c: f64| vec![vec![a, b], vec![b, c]];
        assert!(
            check(&of(4.0, 1.0, 1e-8), 2).is_err(),
            "correlation above 1"
        );
        for good in [of(4.0, 1.0, 1.0), of(1e-10, 0.0, 1e6), of(0.0, 0.0, 1.0)] {
            assert_eq!(check(&good, 2), Ok(()), "negative control");
        }
        for (bad, says) in [
            (of(-1e-12, 0.0, 1.0), "variances of 0 or more"),
            (of(f64::NAN, 0.0, 1.0), "variances of 0 or more"),
            (of(1.0, f64::INFINITY, 1.0), "symmetric"),
            (vec![vec![1.0, 0.5], vec![0.2, 1.0]], "symmetric"),
            (vec![vec![1.0]], "2 rows"),
            (vec![vec![1.0], vec![1.0]], "2 columns"),
        ] {
            let why = check(&bad, 2).unwrap_err();
            assert!(why.contains(says), "{says}: {why}");
        }
    }
}
