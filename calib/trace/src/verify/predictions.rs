//! Every reading of points and holdout under the declared and the accepted model.

use super::heldout::HeldOut;
use super::physical::PhysicalModel;
use crate::candidate::{System, Term};
use crate::engine::search::Hypothesis;
use crate::whisker::WhiskerSystem;
use nalgebra::DMatrix;

/// One reading under one model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// Base moment inferred from the wavelengths, N mm.
    pub moment_nmm: [f64; 2],
    /// Its standard deviation, N mm.
    pub moment_sd_nmm: [f64; 2],
    /// Compensated shift predicted from the pose, pm, zero included.
    pub shift_pm: [f64; 2],
    /// Base moment predicted from the pose, N mm.
    pub pose_moment_nmm: [f64; 2],
}

/// All readings of `system` (points and holdout on one path) under `h`, fitted elsewhere, with the noise of each, pm; none where the model has no solution.
#[must_use]
pub fn predict(
    system: &WhiskerSystem,
    h: &Hypothesis,
    model: &PhysicalModel,
    noise_sd_pm: &[f64],
) -> Option<Vec<Predicted>> {
    let terms: &[Term] = &h.fit.terms;
    let design: DMatrix<f64> = system.design(terms)?;
    let shifts = design * &h.fit.coefficients * system.channels_pm();
    let (felt, base) = system.moments(terms)?;
    let memory: Vec<[f64; 2]> = base.iter().zip(&felt).map(|(b, f)| [b[0] - f[0], b[1] - f[1]]).collect();
    let inferred = model.infer_under(&system.path, Some(&memory), noise_sd_pm);
    Some(
        inferred
            .iter()
            .zip(&base)
            .enumerate()
            .map(|(i, (m, b))| Predicted {
                moment_nmm: m.moment_nmm,
                moment_sd_nmm: m.sd_nmm,
                shift_pm: [shifts[(i, 0)], shifts[(i, 1)]],
                pose_moment_nmm: *b,
            })
            .collect(),
    )
}

/// The held-out readings among `predicted`, but for single ones that are left out.
#[must_use]
pub fn held_out(system: &WhiskerSystem, predicted: &[Predicted], left_out: &[usize]) -> Vec<HeldOut> {
    let readings = &system.path.readings;
    (0..readings.len())
        .filter(|i| readings[*i].holdout && !left_out.contains(i))
        .map(|i| of_reading(readings[i].group, readings[i].shift_pm, &predicted[i]))
        .collect()
}

/// Residuals of one reading.
#[must_use]
pub fn of_reading(group: u32, shift_pm: [f64; 2], p: &Predicted) -> HeldOut {
    HeldOut {
        group,
        wavelength_pm: [shift_pm[0] - p.shift_pm[0], shift_pm[1] - p.shift_pm[1]],
        moment_nmm: [p.moment_nmm[0] - p.pose_moment_nmm[0], p.moment_nmm[1] - p.pose_moment_nmm[1]],
        moment_sd_nmm: p.moment_sd_nmm,
    }
}
