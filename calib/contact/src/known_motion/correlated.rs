//! Noise that is correlated in time, as columns that the readings of an episode share.
//!
//! With the noise covariance R_k = L_k L_k' of a reading, of which the share q is a first-order Gauss-Markov process of time constant tau:
//!
//! ```text
//! cov(n_k, n_l) = L_k L_l' q c_kl + [k = l] (1 - q) R_k,   c_kl = exp(-|t_k - t_l| / tau)
//! c = V diag(lambda) V',   U = (q lambda_j)^1/2 v_kj L_k for the largest lambda_j that hold 99.9 % of the trace; the rest stays in R_k
//! ```
//!
//! Free readings of the episode show the process near the loaded ones. Sources: A. C. Harvey, "Forecasting, Structural Time Series Models and the
//! Kalman Filter", 1989, 3 (the process); the truncated decomposition: K. Karhunen, M. Loeve (C. E. Rasmussen, C. K. I. Williams, "Gaussian
//! Processes for Machine Learning", 2006, 4.3).

use super::MotionRow;
use nalgebra::{DMatrix, Vector3};

/// Share of the process that its columns hold.
const HELD: f64 = 0.999;

/// The part of the readings' noise that is correlated in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CorrelatedShare {
    /// Share q of the noise variance, 0 to 1.
    pub variance_share: f64,
    /// Time constant, s.
    pub time_constant_s: f64,
}

/// Moves the correlated part of the noise of an episode's readings from their own covariance to columns that they share, after those that are
/// there.
pub fn share_correlated(rows: &mut [MotionRow], noise: &CorrelatedShare) {
    let n = rows.len();
    let correlation = DMatrix::from_fn(n, n, |k, l| {
        (-(rows[k].t_s - rows[l].t_s).abs() / noise.time_constant_s.max(f64::MIN_POSITIVE)).exp()
    });
    let eigen = correlation.symmetric_eigen();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let mut held = 0.0;
    let count = order.iter().take_while(|j| {
        let more = held < HELD * n as f64;
        held += eigen.eigenvalues[**j];
        more
    });
    let columns: Vec<usize> = count.copied().collect();
    for (k, row) in rows.iter_mut().enumerate() {
        let Some(factor) = row.noise_nmm2.cholesky().map(|c| c.l()) else { continue };
        let mut moved = 0.0;
        for &j in &columns {
            let value = noise.variance_share * eigen.eigenvalues[j].max(0.0);
            let size = value.sqrt() * eigen.eigenvectors[(k, j)];
            row.shared_nmm.extend(factor.column_iter().map(|c| [size * c[0], size * c[1]]));
            moved += size * size;
        }
        row.noise_nmm2 *= 1.0 - moved;
        if !row.shared_displacement_mm.is_empty() {
            row.shared_displacement_mm.resize(row.shared_nmm.len(), Vector3::zeros());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Rotation3};

    fn row(t_s: f64, noise_nmm2: Matrix2<f64>) -> MotionRow {
        MotionRow {
            t_s,
            moment_nmm: [0.0; 2],
            noise_nmm2,
            shared_nmm: vec![[0.1, 0.2]],
            free_nmm2: None,
            shared_displacement_mm: vec![Vector3::x()],
            moved_mm: Vector3::zeros(),
            turn: Rotation3::identity(),
            velocity_mm_s: Vector3::zeros(),
            moved_sd_mm: 0.0,
            free: false,
            contact_segment: 0,
        }
    }

    /// What a thousandth of the trace is left in the readings' own covariance for is the tolerance.
    #[test]
    fn own_noise_and_columns_together_are_the_covariance_of_the_process() {
        let noises = [Matrix2::new(2e-4, 5e-5, 5e-5, 1e-4), Matrix2::new(1e-4, 0.0, 0.0, 3e-4)];
        let times = [0.0, 5.0, 12.0, 40.0, 300.0];
        let before: Vec<MotionRow> = (0..5).map(|k| row(times[k], noises[k % 2])).collect();
        for (share, tau) in [(0.8, 60.0), (0.3, 4.0), (0.0, 60.0)] {
            let mut rows = before.clone();
            share_correlated(&mut rows, &CorrelatedShare { variance_share: share, time_constant_s: tau });
            let columns = rows[0].shared_nmm.len();
            for (k, a) in rows.iter().enumerate() {
                assert_eq!((a.shared_nmm.len(), a.shared_displacement_mm.len()), (columns, columns));
                assert_eq!((a.shared_nmm[0], a.shared_displacement_mm[0]), ([0.1, 0.2], Vector3::x()));
                for (l, b) in rows.iter().enumerate() {
                    let mut found = if k == l { a.noise_nmm2 } else { Matrix2::zeros() };
                    for (u, v) in a.shared_nmm[1..].iter().zip(&b.shared_nmm[1..]) {
                        found += Matrix2::from_fn(|i, j| u[i] * v[j]);
                    }
                    let factor = |k: usize| before[k].noise_nmm2.cholesky().unwrap().l();
                    let correlation = (-(times[k] - times[l]).abs() / tau).exp();
                    let own = if k == l { 1.0 - share } else { 0.0 };
                    let expected = factor(k) * factor(l).transpose() * (share * correlation + own);
                    assert!(
                        (found - expected).norm() < 6e-3 * before[0].noise_nmm2.norm(),
                        "{share} {k} {l}"
                    );
                }
            }
        }
        // Slower than the episode: one column for each moment.
        let mut slow = before;
        share_correlated(&mut slow, &CorrelatedShare { variance_share: 0.5, time_constant_s: 1e6 });
        assert_eq!(slow[0].shared_nmm.len(), 3);
    }
}
