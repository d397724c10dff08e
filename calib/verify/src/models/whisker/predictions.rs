//! Every reading of points and holdout under the declared and the accepted model.

use super::physical::PhysicalModel;
use super::system::WhiskerSystem;
use crate::MeasurementModel;
use crate::method::{Hypothesis, Weights, prediction_sd};
use nalgebra::{DMatrix, Matrix2, Vector2};

/// One reading under one model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// Base moment inferred from the wavelengths, N mm.
    pub moment_nmm: [f64; 2],
    /// Its standard deviation, N mm.
    pub moment_sd_nmm: [f64; 2],
    /// Compensated shift predicted from the pose, pm, zero included.
    pub shift_pm: [f64; 2],
    /// Standard deviation of the measured shift less this one, pm; NaN where the model states none.
    pub shift_sd_pm: [f64; 2],
    /// Base moment predicted from the pose, N mm.
    pub pose_moment_nmm: [f64; 2],
    /// Distance of the contact that the cameras saw from the one that the pose predicts, mm; none
    /// without a picture.
    pub contact_error_mm: Option<f64>,
}

/// Every reading under one model, in the order of the path.
pub type Predictions = Vec<Predicted>;

/// All readings of `system` (points and holdout on one path) under `h`, fitted elsewhere, with the
/// noise of each in the engine's channels; none where the model has no solution.
pub fn predict(system: &WhiskerSystem, h: &Hypothesis, noise_sd: &[f64]) -> Option<Predictions> {
    let factor = system.noise_factor();
    let noise_sd_pm: Vec<f64> = noise_sd.iter().map(|sd| sd * factor).collect();
    let shift_sd_pm = prediction_sd(system, h, noise_sd)?;
    let terms = &h.fit.terms;
    let shifts = system.design(terms)? * &h.fit.coefficients * system.channels_pm();
    let (memory, base) = system.memory(terms)?;
    let model = PhysicalModel::new(system, h, 0.0);
    let inferred = model.infer_under(&system.path, Some(&memory), &noise_sd_pm);
    let mut contact = vec![None; base.len()];
    if let Some(pictures) = system.pictures() {
        for ((i, _, shown), predicted) in pictures.each().zip(system.predict_pictures(terms)?) {
            contact[i] = Some((shown.groove_mm - predicted.groove_mm).norm());
        }
    }
    let of = |i: usize| Predicted {
        moment_nmm: inferred[i].moment_nmm,
        moment_sd_nmm: inferred[i].sd_nmm,
        shift_pm: [0, 1].map(|c| shifts[(i, c)]),
        shift_sd_pm: [0, 1].map(|c| shift_sd_pm[(i, c)]),
        pose_moment_nmm: base[i],
        contact_error_mm: contact[i],
    };
    Some((0..base.len()).map(of).collect())
}

/// Linear map on outside labels, fitted on the weighted readings.
pub(crate) fn by_labels(
    system: &WhiskerSystem,
    moments: &[[f64; 2]],
    weights: &Weights,
) -> Option<Predictions> {
    let n = moments.len();
    let design = DMatrix::from_fn(n, 3, |i, j| if j == 0 { 1.0 } else { moments[i][j - 1] });
    let w = DMatrix::from_fn(n, 3, |i, j| design[(i, j)] * weights.of(i));
    let y = DMatrix::from_fn(n, 2, |i, c| {
        system.path.readings[i].shift_pm[c] * weights.of(i)
    });
    let b = w.clone().svd(true, true).solve(&y, 1e-12).ok()?;
    let residual = &y - &w * &b;
    // Three coefficients a channel; the noise of the shifts goes through the inverse of K.
    let variance = residual.norm_squared() / (2.0 * (weights.active() as f64 - 3.0)).max(1.0);
    let k = Matrix2::from_fn(|c, j| b[(j + 1, c)]);
    let inverse = k.try_inverse()?;
    let spread = inverse * inverse.transpose() * variance;
    let shifts = &design * &b;
    let of = |i: usize| {
        let shift = system.path.readings[i].shift_pm;
        let m = inverse * Vector2::new(shift[0] - b[(0, 0)], shift[1] - b[(0, 1)]);
        Predicted {
            moment_nmm: [m[0], m[1]],
            moment_sd_nmm: [spread[(0, 0)].sqrt(), spread[(1, 1)].sqrt()],
            shift_pm: [0, 1].map(|c| shifts[(i, c)]),
            shift_sd_pm: [variance.sqrt(); 2],
            pose_moment_nmm: moments[i],
            contact_error_mm: None,
        }
    };
    Some((0..n).map(of).collect())
}
