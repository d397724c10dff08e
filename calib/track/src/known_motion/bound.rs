//! The smallest covariance that an estimate of the contact can have: the Bayesian Cramer-Rao bound.
//!
//! ```text
//! E[(P^ - P)(P^ - P)^T] >= T J^-1 T^T + s_p^2 I,   T = dP/dtheta,   theta = (s, x, g),   s_p: error of the interpolated wire
//! J = G^T S^-1 G + diag(12 / L_s^2, 12 / L_x^2, 1 / s_g^2),   G = dm/dtheta
//! ```
//!
//! S is the covariance of the moments at the truth: each reading's own noise, what motion and table
//! add, the part that is correlated in time, and the columns of what all readings share (module
//! head of [`super`]), as the filter linearises the readings ([`NodeFilter`]).
//!
//! A uniform prior has no own Fisher information; those of s and x (widths L_s, L_x) count as
//! Gaussians of their variance L^2 / 12. Source: H. L. Van Trees, "Detection, Estimation, and
//! Modulation Theory" I, 1968, 2.4.3.

use super::contact_path::{BEFORE_MM, ContactPath, State, loaded};
use super::episode::{TABLE_MM, TABLE_SHARE};
use super::node::{COMMON, Linearised, NodeFilter, Reading};
use super::{CorrelatedNoise, Episode, MomentField, MotionRow, Settings};
use crate::TrackError;
use crate::reading::squares;
use nalgebra::{DMatrix, DVector, Matrix2};

/// Step of differences, mm.
const STEP_MM: f64 = 0.02;

/// Root of the trace of the bound at an episode's true state, mm: what an RMS error in space is
/// compared with. None where the rod has no derivative there.
///
/// # Errors
/// Where the covariance of the moments is not positive definite.
pub fn bound_mm(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
    truth: &State,
) -> Result<Option<f64>, TrackError> {
    let Some(path) = ContactPath::new(field, episode) else {
        return Ok(None);
    };
    let before = |k: usize| &path.rows[k.saturating_sub(1)];
    let readings: Vec<Reading<'_>> = (0..path.rows.len())
        .map(|k| {
            Reading::new(
                (field, settings),
                (path.push, path.reference),
                before(k),
                &path.rows[k],
            )
        })
        .collect();
    let Some((rates, at)) = rates(&path, &readings, truth).zip(NodeFilter::along(&readings, truth))
    else {
        return Ok(None);
    };
    let (slopes, turn) = (rates.rows(0, 2 * at.len()), rates.rows(2 * at.len(), 3));
    let Some(factor) = covariance(path.rows, settings, &at).cholesky() else {
        let what = "covariance of the moments";
        return Err(TrackError::value(
            what,
            "positive definite",
            "one that is not",
        ));
    };
    // Fisher information of Gaussian readings, G' S^-1 G.
    let mut information = slopes.tr_mul(&factor.solve(&slopes));
    // The uniform priors of arc length and onset as Gaussians of variance L^2 / 12.
    let along_mm = |row: &MotionRow| path.displacement(row).dot(&path.push);
    // As the filter has them: the touch began where the free readings were, or before these.
    let free = path.rows.iter().take_while(|row| !loaded(row));
    let lowest = free.map(along_mm).fold(0.0, f64::min);
    let widths = [field.length_mm() - settings.first_mm, BEFORE_MM - lowest];
    (0..2).for_each(|k| information[(k, k)] += 12.0 / widths[k].powi(2));
    information[(2, 2)] += 1.0 / settings.gap_sd_mm.powi(2);
    // What all readings have of the interpolated wire's error, in each coordinate.
    let table_mm2 = 3.0 * TABLE_MM.powi(2);
    let bound = |inverse: DMatrix<f64>| (turn * inverse * turn.transpose()).trace() + table_mm2;
    Ok(information
        .try_inverse()
        .map(|inverse| bound(inverse).max(0.0).sqrt()))
}

/// d(moments, place at the first reading)/d(s, onset, gap), by differences; from one side where the
/// other has no equilibrium.
fn rates(path: &ContactPath<'_>, readings: &[Reading<'_>], state: &State) -> Option<DMatrix<f64>> {
    let seen = |k: usize, step: f64| {
        let mut state = *state;
        *[&mut state.s_mm, &mut state.onset_mm, &mut state.gap_mm][k] += step;
        let (at, place) = (NodeFilter::along(readings, &state)?, path.place(&state, 0)?);
        let moments = at.iter().flat_map(|at| &at.moment_nmm);
        let all = moments.chain(&place).copied();
        Some(DVector::from_iterator(2 * at.len() + 3, all))
    };
    // Central differences err by O(h^2), one-sided ones by O(h): the latter only at the edge of the
    // equilibria.
    let column = |k: usize| match (seen(k, -STEP_MM), seen(k, STEP_MM)) {
        (Some(a), Some(b)) => Some((b - a) / (2.0 * STEP_MM)),
        (Some(a), None) => Some((seen(k, 0.0)? - a) / STEP_MM),
        (None, Some(b)) => Some((b - seen(k, 0.0)?) / STEP_MM),
        (None, None) => None,
    };
    let columns: Vec<DVector<f64>> = (0..3).map(column).collect::<Option<_>>()?;
    Some(DMatrix::from_columns(&columns))
}

/// S, of readings linearised at a state.
fn covariance(rows: &[MotionRow], settings: &Settings, at: &[Linearised]) -> DMatrix<f64> {
    let (size, shared) = (2 * rows.len(), rows[0].shared_nmm.len());
    let mut all = DMatrix::zeros(size, size);
    // One column for each common unknown, the last for the clock's offset.
    let mut columns = DMatrix::zeros(size, shared + 1);
    for (k, (row, here)) in rows.iter().zip(at).enumerate() {
        let slope = here.slope.columns(COMMON, shared + 1);
        columns.rows_mut(2 * k, 2).copy_from(&slope);
        // Relative errors are those of every reading; a held one has them already.
        let relative = if here.contact.is_some() {
            0.0
        } else {
            TABLE_SHARE
        };
        let relative_nmm2 = relative.powi(2) * squares(&[row.moment_nmm]);
        let own = here.own + Matrix2::identity() * relative_nmm2;
        all.fixed_view_mut::<2, 2>(2 * k, 2 * k).copy_from(&own);
    }
    let mut clock = columns.column_mut(shared);
    clock *= settings.clock_sd_s;
    // First-order Gauss-Markov part: its covariance falls as exp(-|dt| / tau); the white part is on
    // the diagonal alone.
    if let Some(noise @ CorrelatedNoise::InTime { .. }) = settings.correlated {
        for (k, l) in (0..rows.len()).flat_map(|k| (0..rows.len()).map(move |l| (k, l))) {
            let [a, b] = [k, l].map(|k| at[k].slope.fixed_columns::<2>(COMMON + shared + 1));
            let mut block = all.fixed_view_mut::<2, 2>(2 * k, 2 * l);
            block += a * b.transpose() * noise.correlation(0.0, rows[k].t_s - rows[l].t_s);
        }
    }
    // Common unknowns of unit variance, marginalised: each adds a rank-one term to S.
    all + &columns * columns.transpose()
}
