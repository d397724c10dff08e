//! Likelihood of an episode's moments: what the readings share is integrated out.

use super::Settings;
use super::contact_path::{ContactPath, State};
use crate::TrackError;
use nalgebra::{DMatrix, DVector, Matrix2, Vector3};

/// Gross readings scatter by so many times the noise.
const GROSS: f64 = 10.0;
/// Step of differences, mm.
const STEP_MM: f64 = 0.02;

/// Covariance of an episode, whitened.
pub struct Likelihood {
    /// `L^-1` with `S = L L'`.
    whitening: DMatrix<f64>,
    /// Probability of each reading to be none of the gross ones.
    pub(crate) regular: Vec<f64>,
    ln_determinant: f64,
}

impl Likelihood {
    /// With a state, what depends on it is taken there: clock, noise of the motion, common unknowns of stage and wire, and which readings
    /// are gross (from the residuals under the likelihood before).
    ///
    /// # Errors
    /// Where the covariance is not positive definite.
    pub fn new(
        path: &ContactPath<'_>,
        settings: &Settings,
        at: Option<(&State, &Self)>,
    ) -> Result<Self, TrackError> {
        let rows = path.rows;
        let n = rows.len();
        let mut covariance = DMatrix::zeros(2 * n, 2 * n);
        let regular = at.map_or_else(|| vec![1.0; n], |(state, _)| regular(path, settings, state));
        for (k, row) in rows.iter().enumerate() {
            // E[1/variance] of the mixture.
            let precision = regular[k] + (1.0 - regular[k]) / (GROSS * GROSS);
            let own = row.noise_nmm2 / precision;
            covariance.view_mut((2 * k, 2 * k), (2, 2)).copy_from(&own);
        }
        let shared = rows.first().map_or(0, |r| r.shared_nmm.len());
        let mut modes = DMatrix::from_fn(2 * n, shared, |i, j| rows[i / 2].shared_nmm[j][i % 2]);
        if let Some((state, _)) = at {
            by_other_wires(path, state, &mut modes);
            let mut clock = DVector::zeros(2 * n);
            for (k, row) in rows.iter().enumerate().filter(|(k, _)| path.held(state, *k)) {
                let Some(rate) = rate_by_place(path, state, k) else { continue };
                let by_motion = rate * rate.transpose() * row.moved_sd_mm.powi(2);
                let mut block = covariance.view_mut((2 * k, 2 * k), (2, 2));
                block += by_motion;
                let drift = rate * row.velocity_mm_s * settings.clock_sd_s;
                (clock[2 * k], clock[2 * k + 1]) = (drift[0], drift[1]);
                for (j, way) in row.shared_way_mm.iter().enumerate() {
                    let by_way = rate * way;
                    (0..2).for_each(|c| modes[(2 * k + c, j)] += by_way[c]);
                }
            }
            covariance += &clock * clock.transpose();
        }
        covariance += &modes * modes.transpose();
        let fails = || TrackError::value("covariance of the moments", "positive definite", "one that is not");
        let factor = covariance.cholesky().ok_or_else(fails)?.unpack();
        let ln_determinant = 2.0 * factor.diagonal().iter().map(|v| v.ln()).sum::<f64>();
        let whitening = factor.solve_lower_triangular(&DMatrix::identity(2 * n, 2 * n)).ok_or_else(fails)?;
        Ok(Self { whitening, regular, ln_determinant })
    }

    /// Whitened residuals of a state, the gap's prior as the last one; none where it has no equilibrium.
    pub(crate) fn residuals(
        &self,
        path: &ContactPath<'_>,
        settings: &Settings,
        state: &State,
    ) -> Option<DVector<f64>> {
        let moments = path.moments(state)?;
        let n = moments.len();
        let off = DVector::from_fn(2 * n, |i, _| path.rows[i / 2].moment_nmm[i % 2] - moments[i / 2][i % 2]);
        let white = &self.whitening * off;
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
        let n = moments.len();
        let off = DVector::from_fn(2 * n, |i, _| path.rows[i / 2].moment_nmm[i % 2] - moments[i / 2][i % 2]);
        ((&self.whitening * off).norm_squared(), (2.0 * n as f64 - 3.0).max(1.0))
    }
}

/// Adds to the common unknowns (columns) what another wire changes in the moments of every reading, `m_j(P_k) - m(P_k)`.
fn by_other_wires(path: &ContactPath<'_>, state: &State, modes: &mut DMatrix<f64>) {
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

/// How the moments of a reading change with the place, N mm/mm: frictionless.
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

/// Probability of each reading to be regular, given its residual under its own noise and what is shared.
fn regular(path: &ContactPath<'_>, settings: &Settings, state: &State) -> Vec<f64> {
    let Some(moments) = path.moments(state) else { return vec![1.0; path.rows.len()] };
    let one = |(row, m): (&super::MotionRow, &[f64; 2])| {
        let mut own = row.noise_nmm2;
        for h in &row.shared_nmm {
            own += Matrix2::new(h[0] * h[0], h[0] * h[1], h[0] * h[1], h[1] * h[1]);
        }
        let off = nalgebra::Vector2::new(row.moment_nmm[0] - m[0], row.moment_nmm[1] - m[1]);
        let Some(inverse) = own.try_inverse() else { return 1.0 };
        let squared = off.dot(&(inverse * off));
        let plain = (1.0 - settings.gross_share) * (-0.5 * squared).exp();
        let gross = settings.gross_share / (GROSS * GROSS) * (-0.5 * squared / (GROSS * GROSS)).exp();
        // Far away both vanish: gross then.
        if plain + gross > 0.0 { plain / (plain + gross) } else { 0.0 }
    };
    path.rows.iter().zip(&moments).map(one).collect()
}
