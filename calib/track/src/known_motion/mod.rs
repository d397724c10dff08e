//! Where the wire is held when the relative motion of base and object is known: physics, no
//! network.
//!
//! An object holds the wire at one point (a V-groove, an edge, a tip) and moves with respect to the
//! base by d(t), known up to a constant within one episode. All in the base frame, lengths in mm,
//! moments in N mm.
//!
//! State of an episode, theta = (s, x, g): the free wire is first touched at arc length s when the
//! displacement along the push u is x, with a gap g between wire and point,
//!
//! `P_ref = r0(s) + g n(s) - (x - x_ref) u`, `n = t0(s) x u / |t0(s) x u|`, `P_k = Q_k P_ref + d_k`
//! (Q_k the rotation, 1 without one).
//!
//! Transition: none but the motion. Holds and reversals are d_k itself; before first touch,
//! `(P_k - r0(s) - g n(s)) . u <= 0`, the wire is free and m = 0. With friction the contact's arc
//! length s_c plays between the two slip branches of the rod,
//! `s_c(k) = clamp(s_c(k-1), s(P, -mu), s(P, +mu))`.
//!
//! Likelihood, with the rod's equilibrium m(P) ([`field`]), K the map's sensitivity and c what all
//! readings of a calibration share:
//!
//! `y_k = m(P_k) + H_k c + (dm/dP) (v_k tau + e_k) + n_k`, `c ~ N(0, 1)`, `tau ~ N(0, s_tau^2)`,
//! `e_k ~ N(0, s_d^2)`, n_k regular (covariance R_k, a part of it correlated from reading to
//! reading), noisy, or anything ([`recursive`]);
//!
//! A point that does not stay goes on over the object, across the push, by a share q of the motion
//! since the first load: `P_k = Q_k P_ref + d_k + |d_k| (q_1 e_1 + q_2 e_2)`, `q ~ N(0, s_q^2)`,
//! e_1 and e_2 across u. They are two common unknowns more.
//!
//! The stiffness of a foreign wire scales the moments: its column is that share of m(P), not of the
//! reading, whose noise would draw it up by 2 n times the share.
//!
//! One standard deviation of an unknown c_j changes the moments by h_kj (map), the displacement by
//! w_kj (an accepted effect of the stage) and the rod to another (an accepted effect of rod or
//! friction, m_j): `H_kj = h_kj + (dm/dP) w_kj + m_j(P_k) - m(P_k)`. The interpolated m(P) has its
//! own error, s_p (mm) and s_q (relative), which dominates where the noise is negligible.
//!
//! Posterior: the recursion over the readings on a grid of s, Gaussian in all else ([`recursive`]):
//! s uniform over the wire, x uniform over the episode, `g ~ N(0, s_g^2)`. The state of an episode
//! is constant, so that the posterior after its last reading is that of all of them. The 95 %
//! region is that of highest density ([`posterior`]).
//!
//! Bound: no estimator has a smaller mean squared error than `J^-1`,
//! `J = G' S^-1 G + diag(12/L_s^2, 12/L_x^2, 1/s_g^2)`, `G = dm/dtheta` at the truth, L_s and L_x
//! the widths of the uniform priors (Bayesian Cramer-Rao: H. L. Van Trees, "Detection,
//! Estimation, and Modulation Theory" I, 2.4.3; Tichavsky's recursion (IEEE Trans. Signal
//! Process. 46 (1998) 1386) for a constant state) ([`bound`]).

pub mod bound;
pub mod check;
pub mod contact_path;
pub mod episode;
pub mod field;
mod node;
pub mod posterior;
pub mod recursive;
pub mod segmenter;

pub use bound::bound_mm;
pub use check::Innovations;
pub use episode::EpisodeContact;
pub use episode::{CorrelatedNoise, Episode, MotionRow, Settings};
pub(crate) use episode::{LN_ANYTHING, check_row, larger};
pub use field::{Friction, MomentField};
pub use posterior::Posterior;
pub use recursive::RecursivePosterior;
pub use segmenter::{Segmenter, Step};

use crate::TrackError;
use contact_path::{ContactPath, loaded};

/// Result of an episode.
#[derive(Debug, Clone)]
pub struct EpisodeEstimate {
    /// The contact at each row.
    pub places: Vec<EpisodeContact>,
    /// The posterior of the state; none where no state explains anything.
    pub posterior: Option<Posterior>,
    /// Innovations at the best state.
    pub innovations: Innovations,
}

/// Locates the contact of an episode.
///
/// # Errors
/// For rows that cannot be used: no push direction, times that do not go forward, numbers that are
/// not finite.
pub fn estimate_contact(
    field: &MomentField,
    episode: &Episode,
    settings: &Settings,
) -> Result<EpisodeEstimate, TrackError> {
    let shared = episode.rows.first().map_or(0, |r| r.shared_nmm.len());
    let mut last_s = f64::NEG_INFINITY;
    for (k, row) in episode.rows.iter().enumerate() {
        check_row(row, last_s, shared, &format!("reading {k} of an episode"))?;
        last_s = row.t_s;
    }
    let Some(path) = ContactPath::new(field, episode) else {
        // A loaded wire whose motion has no direction is not explained; a free one has no contact.
        let loaded = episode.rows.iter().any(loaded);
        return Ok(if loaded {
            EpisodeEstimate::unexplained(episode)
        } else {
            EpisodeEstimate::nothing(episode)
        });
    };
    let chosen = thinned(episode, settings.max_rows);
    let rows: Vec<MotionRow> = chosen.iter().map(|&k| episode.rows[k].clone()).collect();
    let whole = recursive::run(field, path.push, &rows, settings);
    let consistent = |f: &recursive::Finished| f.innovations.consistent();
    let found = match whole {
        Some(found) if consistent(&found) => Some(found),
        // The first loaded reading sets the onset: where it is gross, the others stand out instead
        // (masking).
        whole => without_first(field, &path, &rows, settings)
            .filter(consistent)
            .or(whole),
    };
    let Some(found) = found else {
        return Ok(EpisodeEstimate::unexplained(episode));
    };
    // Readings that the thinning left out were never tested: none of them is an outlier.
    let outlier = |k: usize| chosen.binary_search(&k).is_ok_and(|n| found.outliers[n]);
    let place = |k| EpisodeContact {
        outlier: outlier(k),
        ..found.posterior.place(&path, k)
    };
    Ok(EpisodeEstimate {
        places: (0..episode.rows.len()).map(place).collect(),
        posterior: Some(found.posterior),
        innovations: found.innovations,
    })
}

/// An episode without its first loaded reading, as an outlier; none where none may be.
fn without_first(
    field: &MomentField,
    path: &ContactPath<'_>,
    rows: &[MotionRow],
    settings: &Settings,
) -> Option<recursive::Finished> {
    let first = rows
        .iter()
        .position(loaded)
        .filter(|_| settings.gross_share > 0.0)?;
    let others = [&rows[..first], &rows[first + 1..]].concat();
    let mut found = recursive::run(field, path.push, &others, settings)?;
    found.outliers.insert(first, true);
    // Displacements of that posterior count from the next loaded reading.
    let next = others.iter().find(|row| settings.is_loaded(row))?;
    found
        .posterior
        .move_onset((next.moved_mm - rows[first].moved_mm).dot(&path.push));
    Some(found)
}

impl EpisodeEstimate {
    /// Whether there is evidence against motion, map or rod.
    pub fn disagrees(&self) -> bool {
        !self.innovations.consistent()
    }

    /// Loaded readings that no contact on the wire explains.
    fn unexplained(episode: &Episode) -> Self {
        Self {
            innovations: Innovations::unexplained(episode.rows.len()),
            ..Self::nothing(episode)
        }
    }

    fn nothing(episode: &Episode) -> Self {
        let rows = episode.rows.len();
        Self {
            places: vec![EpisodeContact::default(); rows],
            posterior: None,
            innovations: Innovations {
                rows,
                ..Innovations::default()
            },
        }
    }
}

/// Readings used by the posterior: every n-th, with the first loaded one, from which displacements
/// count.
fn thinned(episode: &Episode, max_rows: usize) -> Vec<usize> {
    let n = episode.rows.len();
    let stride = n.div_ceil(max_rows.max(1)).max(1);
    let first = episode.rows.iter().position(loaded).unwrap_or(0);
    (first % stride..n).step_by(stride).collect()
}
