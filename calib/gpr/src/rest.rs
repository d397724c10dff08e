//! Whether readings at rest share the zero of the loaded ones.
//!
//! The map of the loaded poses alone predicts the moments of the free wire, which are zero where
//! both share one zero:
//!
//! t_c = (m_c(w_0) - m_0c) / s_c,   p = min(1, 2 min_c P(|t_nu| >= |t_c|))
//!
//! w_0, m_0: mean shifts and labels at rest; s_c: stated deviation of one more pose, not of a mean,
//! since readings at rest share an error as those of a pose do; nu: its degrees of freedom; the
//! factor 2 for the two moments (Bonferroni). A map that is bent to a reading of another zero is
//! wrong everywhere; without that reading it is right but for its zero, which each record has for
//! itself.

use crate::error::MapError;
use crate::fit::{FitOptions, fit_map};
use crate::predictor::MapPredictor;
use crate::student::two_sided;
use crate::training::MapTraining;
use wcal_core::map_document::RestZero;

/// Below this p-value the readings at rest are left out.
pub(crate) const REST_LEVEL: f64 = 0.01;
/// Fewer loaded readings fit no map.
const MIN_LOADED: usize = 5;

/// Tests the readings at rest by the map of the loaded poses; none without rest, or with too few
/// loaded readings to tell.
///
/// # Errors
/// As for [`fit_map`].
pub fn test_rest(
    training: &MapTraining,
    options: &FitOptions,
) -> Result<Option<RestZero>, MapError> {
    let loaded = training.loaded();
    let rest: Vec<usize> = (0..training.len())
        .filter(|i| training.trajectory[*i].is_none())
        .collect();
    if rest.is_empty() || loaded.len() < MIN_LOADED {
        return Ok(None);
    }
    let fit = fit_map(&loaded, options)?;
    let n = rest.len() as f64;
    let mean = |of: &[[f64; 2]]| [0, 1].map(|c| rest.iter().map(|i| of[*i][c]).sum::<f64>() / n);
    // As one pose: readings at rest share an error, so that their mean is no surer than one of
    // them.
    let p = MapPredictor::new(&fit.artefact)?.predict(mean(&training.shifts_pm));
    let label_nmm = mean(&training.moments_nmm);
    let offset_nmm = [0, 1].map(|c| p.moment_nmm[c] - label_nmm[c]);
    let tail = |c: usize| two_sided(offset_nmm[c] / p.sd_nmm[c], fit.artefact.outputs[c].dof);
    let p_value = (2.0 * tail(0).min(tail(1))).min(1.0);
    Ok(Some(RestZero {
        readings: rest.len(),
        offset_nmm,
        sd_nmm: p.sd_nmm,
        p_value,
        left_out: p_value < REST_LEVEL,
    }))
}
