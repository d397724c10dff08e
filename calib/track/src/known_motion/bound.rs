//! The smallest covariance that an estimate of the contact can have: the Bayesian Cramer-Rao bound.
//!
//! ```text
//! E[(P^ - P)(P^ - P)^T] >= T J^-1 T^T + s_p^2 I,   T = dP/dtheta,   theta = (s, x, g),   s_p: error of the interpolated wire
//! J = G^T S^-1 G + diag(12 / L_s^2, 12 / L_x^2, 1 / s_g^2),   G = dm/dtheta
//! ```
//!
//! S is the covariance of the moments at the truth: each reading's own noise, what motion and table
//! add, the part that is correlated in time, and the columns of what all readings share (module
//! head of [`super`]).
//!
//! A uniform prior has no own Fisher information; those of s and x (widths L_s, L_x) count as
//! Gaussians of their variance L^2 / 12. Source: H. L. Van Trees, "Detection, Estimation, and
//! Modulation Theory" I, 1968, 2.4.3.

use super::contact_path::{ContactPath, State};
use super::{CorrelatedNoise, Episode, MomentField, Settings, TABLE_MM, TABLE_SHARE};
use crate::TrackError;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Vector2, Vector3};

/// Step of differences, mm.
const STEP_MM: f64 = 0.02;

/// Bayesian Cramer-Rao bound of the contact point at an episode's true state, mm^2: `T J^-1 T'` of
/// the module's head. None where the rod has no derivative there.
///
/// # Errors
/// Where the covariance of the moments is not positive definite.
pub fn bound_mm2(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    truth: &State,
) -> Result<Option<Matrix3<f64>>, TrackError> {
    let Some(path) = ContactPath::new(field, episode) else {
        return Ok(None);
    };
    let fails = || {
        TrackError::value(
            "covariance of the moments",
            "positive definite",
            "one that is not",
        )
    };
    let Some((slopes, covariance)) = slopes(&path, truth).zip(covariance(&path, settings, truth))
    else {
        return Ok(None);
    };
    // Fisher information of Gaussian readings, G' S^-1 G.
    let mut information = slopes.tr_mul(&covariance.cholesky().ok_or_else(fails)?.solve(&slopes));
    information[(2, 2)] += 1.0 / settings.gap_sd_mm.powi(2);
    // The uniform priors of arc length and onset as Gaussians of variance L^2 / 12.
    information[(0, 0)] += 12.0 / (field.length_mm() - settings.first_mm).powi(2);
    information[(1, 1)] += 12.0 / (path.onset_mm[1] - path.onset_mm[0]).powi(2);
    let (Some(covariance), Some(turn)) = (information.try_inverse(), place_rates(&path, truth))
    else {
        return Ok(None);
    };
    let covariance = Matrix3::from_fn(|i, j| covariance[(i, j)]);
    // What all readings have of the interpolated wire's error.
    let table_mm2 = Matrix3::identity() * TABLE_MM.powi(2);
    Ok(Some(turn * covariance * turn.transpose() + table_mm2))
}

/// Root of the bound's trace, mm: what an RMS error in space is compared with.
///
/// # Errors
/// As [`bound_mm2`].
pub fn bound_mm(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    truth: &State,
) -> Result<Option<f64>, TrackError> {
    Ok(bound_mm2(field, episode, settings, truth)?.map(|b| b.trace().max(0.0).sqrt()))
}

/// G = dm/d(s, onset, gap), by differences; from one side where the other has no equilibrium.
fn slopes(path: &ContactPath<'_>, state: &State) -> Option<DMatrix<f64>> {
    let moments = |k: usize, step: f64| {
        let all = path.moments(&moved(state, k, step))?;
        Some(DVector::from_iterator(
            2 * all.len(),
            all.into_iter().flatten(),
        ))
    };
    // Central differences err by O(h^2), one-sided ones by O(h): the latter only at the edge of the
    // equilibria.
    let column = |k: usize| match (moments(k, -STEP_MM), moments(k, STEP_MM)) {
        (Some(a), Some(b)) => Some((b - a) / (2.0 * STEP_MM)),
        (Some(a), None) => Some((moments(k, 0.0)? - a) / STEP_MM),
        (None, Some(b)) => Some((b - moments(k, 0.0)?) / STEP_MM),
        (None, None) => None,
    };
    Some(DMatrix::from_columns(
        &(0..3).map(column).collect::<Option<Vec<_>>>()?,
    ))
}

/// S at a state; none where the rod has no equilibrium there.
fn covariance(path: &ContactPath<'_>, settings: &Settings, state: &State) -> Option<DMatrix<f64>> {
    let rows = path.rows;
    let shared = rows.first().map_or(0, |r| r.shared_nmm.len());
    let mut all = DMatrix::zeros(2 * rows.len(), 2 * rows.len());
    // One column for each common unknown, the last for the clock's offset.
    let mut columns = DMatrix::zeros(2 * rows.len(), shared + 1);
    for (k, row) in rows.iter().enumerate() {
        let size2 = row.moment_nmm[0].powi(2) + row.moment_nmm[1].powi(2);
        let mut own = row.noise_nmm2 + Matrix2::identity() * TABLE_SHARE.powi(2) * size2;
        let mut column = columns.rows_mut(2 * k, 2);
        for (j, by) in row.shared_nmm.iter().enumerate() {
            column.set_column(j, &Vector2::from(*by));
        }
        // A free wire shows neither place nor motion.
        if path.held(state, k) {
            // Errors of the displacement enter through dm/dP.
            let (here, rate) = path.field.held_and_rate(&path.place(state, k)?, 0.0)?;
            own += rate * rate.transpose() * (row.moved_sd_mm.powi(2) + TABLE_MM.powi(2));
            for (j, by) in row.shared_displacement_mm.iter().enumerate() {
                let mut column = column.column_mut(j);
                column += rate * by;
            }
            column.set_column(shared, &(rate * row.velocity_mm_s * settings.clock_sd_s));
            for (j, changed) in path.field.changed.iter().enumerate() {
                let there = changed.held(&path.place(state, k)?, 0.0)?;
                let mut column = column.column_mut(j);
                column += Vector2::from(there.moment_nmm) - Vector2::from(here.moment_nmm);
            }
        }
        all.view_mut((2 * k, 2 * k), (2, 2)).copy_from(&own);
    }
    // First-order Gauss-Markov part: its covariance falls as exp(-|dt| / tau); the white part is on
    // the diagonal alone.
    if let Some(CorrelatedNoise::InTime {
        variance_share,
        time_constant_s,
    }) = settings.correlated
    {
        let factors = rows
            .iter()
            .map(|r| Some(r.noise_nmm2.cholesky()?.l()))
            .collect::<Option<Vec<Matrix2<f64>>>>()?;
        for (k, l) in (0..rows.len()).flat_map(|k| (0..k).map(move |l| (k, l))) {
            let correlation =
                (-(rows[k].t_s - rows[l].t_s).abs() / time_constant_s.max(1e-9)).exp();
            let block = factors[k] * factors[l].transpose() * (variance_share * correlation);
            all.view_mut((2 * k, 2 * l), (2, 2)).copy_from(&block);
            all.view_mut((2 * l, 2 * k), (2, 2))
                .copy_from(&block.transpose());
        }
    }
    // Common unknowns of unit variance, marginalised: each adds a rank-one term to S.
    Some(all + &columns * columns.transpose())
}

/// A state with one of its three numbers moved.
fn moved(state: &State, k: usize, by: f64) -> State {
    let mut state = *state;
    *[&mut state.s_mm, &mut state.onset_mm, &mut state.gap_mm][k] += by;
    state
}

/// dP/d(s, onset, gap).
fn place_rates(path: &ContactPath<'_>, state: &State) -> Option<Matrix3<f64>> {
    let columns: Vec<Vector3<f64>> = (0..3)
        .map(|k| {
            let [a, b] = [-STEP_MM, STEP_MM].map(|h| path.place(&moved(state, k, h), 0));
            Some((b? - a?) / (2.0 * STEP_MM))
        })
        .collect::<Option<_>>()?;
    Some(Matrix3::from_columns(&columns))
}
