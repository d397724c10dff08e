//! Likelihood of an episode's moments, the errors that the readings share integrated out.
//!
//! `S = B + U U'`, B 2 x 2 blocks (a reading's own) and few columns U (what is shared). With `B_k = L_k L_k'` and the thin decomposition
//! `L^-1 U = Q diag(l) V'`, residuals are whitened by `S^-1/2 = (1 + Q (diag(1 / sqrt(1 + l^2)) - 1) Q') L^-1`, and
//! `ln det S = sum ln det B_k + sum ln(1 + l^2)`: linear in the number of readings.
//!
//! Outliers, with the squared normalised residual e^2 of a reading:
//!
//! ```text
//! regular     p0 = (1 - eps) exp(-e^2 / 2)
//! noisy       p1 = eps / h^2 exp(-e^2 / 2 h^2)                 h = 10
//! anything    p2 = eps 2 |R|^1/2 / M^2                         uniform over moments up to M = 3 N mm: no information
//! R_k / w,    w = (p0 + p1 / h^2) / (p0 + p1 + p2)             expected inverse variance
//! ```
//!
//! Sources: the E step of A. P. Dempster, N. M. Laird, D. B. Rubin, J. R. Stat. Soc. B 39 (1977) 1; the uniform part: D. W. Hogg, J. Bovy, D. Lang,
//! arXiv:1008.4686, 3.

use super::Settings;
use super::contact_path::{ContactPath, State};
use crate::ContactError;
use nalgebra::{DMatrix, DVector, Matrix2, Vector2, Vector3};

/// Standard deviation of noisy outliers in units of the noise.
pub(crate) const GROSS: f64 = 10.0;
/// Largest moment of a wire pressed near its root, N mm: outliers that are anything lie below.
const MAX_NMM: f64 = 3.0;
/// Weight of a reading that is certainly an outlier.
const NO_WEIGHT: f64 = 1e-9;
/// A column with a norm below this (in standard deviations) is zero: the square root of the rounding error of its square.
const MIN_NORM: f64 = 1e-6;
/// Error of an interpolated moment as a share of it (`field`, and tests/known_motion.rs).
pub(crate) const TABLE_SHARE: f64 = 3e-4;
/// Error of the interpolated wire where its curvature jumps (straight to arc), in each coordinate, mm.
pub(crate) const TABLE_MM: f64 = 0.003;
/// Step of differences, mm.
const STEP_MM: f64 = 0.02;

/// Covariance of an episode, whitened.
pub struct Likelihood {
    /// `L_k^-1`.
    own: Vec<Matrix2<f64>>,
    /// Q, and `1 / sqrt(1 + l^2) - 1`.
    shared: (DMatrix<f64>, DVector<f64>),
    /// Probability that each reading is no outlier.
    pub(crate) regular: Vec<f64>,
    ln_determinant: f64,
}

impl Likelihood {
    /// With a state, the terms that depend on it are evaluated there: clock, noise of the motion, common unknowns of stage and rod, and the
    /// outliers (from the residuals under the previous likelihood).
    ///
    /// # Errors
    /// Where the covariance is not positive definite.
    pub fn new(
        path: &ContactPath<'_>,
        settings: &Settings,
        at: Option<(&State, &Self)>,
    ) -> Result<Self, ContactError> {
        let plain = vec![Weight::REGULAR; path.rows.len()];
        let weights = at.map_or(plain, |(state, _)| weights(path, settings, state));
        Self::weighted(path, settings, at.map(|(state, _)| state), &weights)
    }

    /// The plain one without a reading.
    ///
    /// # Errors
    /// Where the covariance is not positive definite.
    pub(crate) fn without(
        path: &ContactPath<'_>,
        settings: &Settings,
        reading: usize,
    ) -> Result<Self, ContactError> {
        let mut weights = vec![Weight::REGULAR; path.rows.len()];
        weights[reading] = Weight::OUTLIER;
        Self::weighted(path, settings, None, &weights)
    }

    fn weighted(
        path: &ContactPath<'_>,
        settings: &Settings,
        at: Option<&State>,
        weights: &[Weight],
    ) -> Result<Self, ContactError> {
        let rows = path.rows;
        let n = rows.len();
        // The interpolation error belongs to the prediction, so that an outlier's weight does not scale it.
        let table = |row: &super::MotionRow| {
            let size2 = row.moment_nmm[0].powi(2) + row.moment_nmm[1].powi(2);
            Matrix2::identity() * TABLE_SHARE.powi(2) * size2
        };
        let mut blocks: Vec<Matrix2<f64>> = rows
            .iter()
            .zip(weights)
            .map(|(row, w)| row.noise_nmm2 / w.inverse_variance + table(row))
            .collect();
        let shared = rows.first().map_or(0, |r| r.shared_nmm.len());
        // Columns U: one for each common unknown, the last for the clock's offset.
        let mut modes = DMatrix::zeros(2 * n, shared + 1);
        for (k, row) in rows.iter().enumerate() {
            for (j, by) in row.shared_nmm.iter().enumerate() {
                (0..2).for_each(|c| modes[(2 * k + c, j)] = by[c]);
            }
        }
        if let Some(state) = at {
            add_rod_changes(path, state, &mut modes);
            for (k, row) in rows.iter().enumerate().filter(|(k, _)| path.held(state, *k)) {
                let Some(rate) = rate_by_place(path, state, k) else { continue };
                blocks[k] += rate * rate.transpose() * (row.moved_sd_mm.powi(2) + TABLE_MM.powi(2));
                let drift = row.velocity_mm_s * settings.clock_sd_s;
                // Errors of the displacement enter through dm/dP: independent ones in the block, shared ones in the columns.
                let shifts = row.shared_displacement_mm.iter().enumerate().chain([(shared, &drift)]);
                for (j, shift) in shifts {
                    let change = rate * shift;
                    (0..2).for_each(|c| modes[(2 * k + c, j)] += change[c]);
                }
            }
        }
        let fails =
            || ContactError::value("covariance of the moments", "positive definite", "one that is not");
        // Whitening by each reading's own block: L_k^-1 from B_k = L_k L_k'.
        let mut own = Vec::with_capacity(n);
        let mut ln_determinant = 0.0;
        for (k, block) in blocks.iter().enumerate() {
            let factor = block.cholesky().ok_or_else(fails)?.unpack();
            ln_determinant += 2.0 * (factor[(0, 0)] * factor[(1, 1)]).ln();
            let inverse = factor.try_inverse().ok_or_else(fails)?;
            let white = inverse * modes.view((2 * k, 0), (2, shared + 1));
            modes.view_mut((2 * k, 0), (2, shared + 1)).copy_from(&white);
            own.push(inverse);
        }
        // Q and l by the eigenvalues of the small matrix (L^-1 U)' L^-1 U; zero columns span nothing.
        let eigen = (modes.transpose() * &modes).symmetric_eigen();
        let sizes = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
        ln_determinant += eigen.eigenvalues.iter().map(|v| v.max(0.0).ln_1p()).sum::<f64>();
        let mut span = &modes * &eigen.eigenvectors;
        for (mut column, size) in span.column_iter_mut().zip(&sizes) {
            column.scale_mut(if *size > MIN_NORM { 1.0 / size } else { 0.0 });
        }
        let shrink = sizes.map(|l| 1.0 / (1.0 + l * l).sqrt() - 1.0);
        let regular = weights.iter().map(|w| w.regular).collect();
        Ok(Self { own, shared: (span, shrink), regular, ln_determinant })
    }

    /// `S^-1/2` times measured less predicted moments.
    fn whitened(&self, path: &ContactPath<'_>, moments: &[[f64; 2]]) -> DVector<f64> {
        let mut white = DVector::zeros(2 * moments.len());
        for (k, ((row, m), own)) in path.rows.iter().zip(moments).zip(&self.own).enumerate() {
            let off = Vector2::new(row.moment_nmm[0] - m[0], row.moment_nmm[1] - m[1]);
            white.fixed_rows_mut::<2>(2 * k).copy_from(&(own * off));
        }
        let (span, shrink) = &self.shared;
        let along = span.tr_mul(&white).component_mul(shrink);
        white + span * along
    }

    /// Whitened residuals of a state, the gap's prior as the last one; none where it has no equilibrium.
    pub(crate) fn residuals(
        &self,
        path: &ContactPath<'_>,
        settings: &Settings,
        state: &State,
    ) -> Option<DVector<f64>> {
        let moments = path.moments(state)?;
        let white = self.whitened(path, &moments);
        Some(white.push(state.gap_mm / settings.gap_sd_mm))
    }

    /// Logarithm of likelihood and prior of the gap, from residuals.
    pub(crate) fn ln_posterior(&self, residuals: &DVector<f64>) -> f64 {
        -0.5 * (residuals.norm_squared() + self.ln_determinant)
    }

    /// Derivative of the whitened residuals by (s, onset, gap), by differences.
    pub(crate) fn slopes(
        &self,
        path: &ContactPath<'_>,
        settings: &Settings,
        state: &State,
    ) -> Option<DMatrix<f64>> {
        let columns: Vec<DVector<f64>> =
            (0..3).map(|k| self.slope(path, settings, state, k)).collect::<Option<_>>()?;
        Some(DMatrix::from_columns(&columns))
    }

    /// One column of [`Self::slopes`]; from one side where the other has no equilibrium.
    pub(crate) fn slope(
        &self,
        path: &ContactPath<'_>,
        settings: &Settings,
        state: &State,
        k: usize,
    ) -> Option<DVector<f64>> {
        let at = |step: f64| self.residuals(path, settings, &moved(state, k, step));
        match (at(-STEP_MM), at(STEP_MM)) {
            (Some(a), Some(b)) => Some((b - a) / (2.0 * STEP_MM)),
            (Some(a), None) => Some((at(0.0)? - a) / STEP_MM),
            (None, Some(b)) => Some((b - at(0.0)?) / STEP_MM),
            (None, None) => None,
        }
    }

    /// Squared whitened residuals of the readings, and their degrees of freedom.
    pub(crate) fn innovation(&self, path: &ContactPath<'_>, state: &State) -> (f64, f64) {
        let Some(moments) = path.moments(state) else { return (f64::INFINITY, 1.0) };
        (self.whitened(path, &moments).norm_squared(), (2.0 * moments.len() as f64 - 3.0).max(1.0))
    }
}

/// Adds to the columns of the common unknowns the moments that a changed rod causes at every reading, `m_j(P_k) - m(P_k)`.
fn add_rod_changes(path: &ContactPath<'_>, state: &State, modes: &mut DMatrix<f64>) {
    let Some(here) = path.moments(state).filter(|_| !path.field.changed.is_empty()) else { return };
    for (field, mut mode) in path.field.changed.iter().zip(modes.column_iter_mut()) {
        let Some(there) = path.past(field).moments(state) else { continue };
        for (k, (a, b)) in here.iter().zip(&there).enumerate() {
            (0..2).for_each(|c| mode[2 * k + c] += b[c] - a[c]);
        }
    }
}

/// A state with one of its three numbers moved.
pub(crate) fn moved(state: &State, k: usize, by: f64) -> State {
    let mut state = *state;
    *[&mut state.s_mm, &mut state.onset_mm, &mut state.gap_mm][k] += by;
    state
}

/// Derivative dm/dP of a reading's moments by the contact point, N mm/mm, without friction.
pub(crate) fn rate_by_place(
    path: &ContactPath<'_>,
    state: &State,
    row: usize,
) -> Option<nalgebra::Matrix2x3<f64>> {
    let place = path.place(state, row)?;
    let mut rate = nalgebra::Matrix2x3::zeros();
    for k in 0..3 {
        let step = Vector3::from_fn(|i, _| if i == k { STEP_MM } else { 0.0 });
        let [a, b] = [place - step, place + step].map(|p| path.field.held(&p, 0.0));
        let (a, b) = (a?.moment_nmm, b?.moment_nmm);
        (0..2).for_each(|c| rate[(c, k)] = (b[c] - a[c]) / (2.0 * STEP_MM));
    }
    Some(rate)
}

/// How much a reading counts.
#[derive(Debug, Clone, Copy)]
struct Weight {
    /// Probability that it is no outlier.
    regular: f64,
    /// Expected inverse variance in units of that of its noise (w of the module's head).
    inverse_variance: f64,
}

impl Weight {
    const REGULAR: Self = Self { regular: 1.0, inverse_variance: 1.0 };
    const OUTLIER: Self = Self { regular: 0.0, inverse_variance: NO_WEIGHT };
}

/// Each reading's weight from its residual under its own noise and the shared errors.
fn weights(path: &ContactPath<'_>, settings: &Settings, state: &State) -> Vec<Weight> {
    let eps = settings.gross_share;
    let Some(moments) = path.moments(state).filter(|_| eps > 0.0) else {
        return vec![Weight::REGULAR; path.rows.len()];
    };
    let one = |(row, m): (&super::MotionRow, &[f64; 2])| {
        let mut own = row.noise_nmm2;
        for h in &row.shared_nmm {
            own += Matrix2::new(h[0] * h[0], h[0] * h[1], h[0] * h[1], h[1] * h[1]);
        }
        let off = Vector2::new(row.moment_nmm[0] - m[0], row.moment_nmm[1] - m[1]);
        let Some(inverse) = own.try_inverse() else { return Weight::REGULAR };
        let squared = off.dot(&(inverse * off));
        let plain = (1.0 - eps) * (-0.5 * squared).exp();
        let noisy = eps / (GROSS * GROSS) * (-0.5 * squared / (GROSS * GROSS)).exp();
        let anything = eps * 2.0 * own.determinant().max(0.0).sqrt() / (MAX_NMM * MAX_NMM);
        let total = plain + noisy + anything;
        Weight {
            regular: plain / total,
            inverse_variance: ((plain + noisy / (GROSS * GROSS)) / total).max(NO_WEIGHT),
        }
    };
    path.rows.iter().zip(&moments).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::super::field::{Friction, MomentField};
    use super::super::{Episode, MotionRow};
    use super::*;
    use nalgebra::Rotation3;
    use wcal_core::observation::{MomentAxes, WhiskerSpec};
    use wcal_rod::Rod;

    #[test]
    fn whitening_by_the_shared_columns_is_that_of_the_whole_covariance() {
        let row = |k: u32| MotionRow {
            t_s: f64::from(k),
            moment_nmm: [0.3 + 0.1 * f64::from(k), -0.2 * f64::from(k)],
            noise_nmm2: Matrix2::new(2e-4, 5e-5, 5e-5, 1e-4) * f64::from(k + 1),
            // The third is the sum of the first two: of a covariance without full rank.
            shared_nmm: vec![[0.01, 0.0], [0.02 * f64::from(k), 0.03], [0.01 + 0.02 * f64::from(k), 0.03]],
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm: Vector3::z() * f64::from(k),
            turn: Rotation3::identity(),
            velocity_mm_s: Vector3::zeros(),
            moved_sd_mm: 0.0,
            free: false,
            contact_segment: 0,
        };
        let rod = Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap();
        let field = MomentField::new(&rod, &MomentAxes::default(), Friction::NONE);
        let episode = Episode { rows: (0..5).map(row).collect(), push: Some(Vector3::z()) };
        let path = ContactPath::new(&field, &episode).unwrap();
        let likelihood = Likelihood::new(&path, &Settings::default(), None).unwrap();
        let n = episode.rows.len();
        let mut whole = DMatrix::zeros(2 * n, 2 * n);
        for (k, r) in episode.rows.iter().enumerate() {
            whole.view_mut((2 * k, 2 * k), (2, 2)).copy_from(&r.noise_nmm2);
        }
        let u = DMatrix::from_fn(2 * n, 3, |i, j| episode.rows[i / 2].shared_nmm[j][i % 2]);
        whole += &u * u.transpose();
        for (k, r) in episode.rows.iter().enumerate() {
            let size2 = r.moment_nmm[0].powi(2) + r.moment_nmm[1].powi(2);
            (0..2).for_each(|c| whole[(2 * k + c, 2 * k + c)] += TABLE_SHARE.powi(2) * size2);
        }
        let factor = whole.cholesky().unwrap();
        let predicted = vec![[0.0; 2]; n];
        let off = DVector::from_fn(2 * n, |i, _| episode.rows[i / 2].moment_nmm[i % 2]);
        let (found, expected) =
            (likelihood.whitened(&path, &predicted).norm_squared(), off.dot(&factor.solve(&off)));
        assert!((found / expected - 1.0).abs() < 1e-9, "{found} {expected}");
        assert!((likelihood.ln_determinant - factor.ln_determinant()).abs() < 1e-9);
    }
}
