//! Preset `released`: the map of the code released with arXiv 2410.14005.
//!
//! There (WhiskerFBG, commit fe9700e) one zero-mean process a moment is conditioned on min-max
//! scaled data with the unscaled kernel (2 r^3 - 3 R r^2 + R^3)/12, R = 1000. Its parameter
//! `variance` = 3 is a noise standard deviation: 3^2 goes on the diagonal of the square covariance,
//! on top of the Gaussian likelihood's default variance of 1. Nothing is optimised. The released
//! program also moves each record's first prediction to zero moment, which is tare, not map.

use crate::error::MapError;
use crate::kernel::Kernel;
use crate::process::ProcessModel;
use crate::training::MapTraining;
use crate::trend::Trend;

/// Shift at scaled input 0, pm.
pub(crate) const SHIFT_OFFSET_PM: f64 = -370.0;
/// Shift per unit of scaled input, pm.
pub(crate) const SHIFT_SCALE_PM: f64 = 490.0;
/// Moment at scaled output 0, N mm.
pub(crate) const MOMENT_OFFSET_NMM: f64 = -4.0;
/// Moment per unit of scaled output, N mm.
const MOMENT_SCALE_NMM: f64 = 7.0;
/// R of the released kernel, scaled input units.
const RADIUS: f64 = 1000.0;
/// `variance` of the released kernel squared, plus the likelihood's default.
const NOISE_VARIANCE: f64 = 3.0 * 3.0 + 1.0;

/// The process of either moment.
pub fn model() -> ProcessModel {
    // (2 r^3 - 3 R r^2 + R^3) / 12 at r = 0: the kernel here is 1 there.
    let variance = RADIUS.powi(3) / 12.0;
    ProcessModel {
        trend: Trend::Zero,
        kernel: Kernel::ThinPlate { radius: RADIUS },
        nugget: NOISE_VARIANCE / variance,
        fixed_variance: Some(variance * MOMENT_SCALE_NMM.powi(2)),
    }
}

/// The training set in the released scaling; moments keep their zero at scaled output 0 and their
/// unit.
///
/// # Errors
/// [`MapError::RadiusTooSmall`] where the readings spread over more than R / 1.6 scaled units.
pub fn scale(
    training: &MapTraining,
    diameter_pm: f64,
) -> Result<crate::candidate::Scaled, MapError> {
    // The stored map adds this offset to its mean.
    let mut moved = training.clone();
    moved
        .moments_nmm
        .iter_mut()
        .flatten()
        .for_each(|m| *m -= MOMENT_OFFSET_NMM);
    // In the released scaling the radius is a constant.
    let radius_pm = Some(RADIUS * SHIFT_SCALE_PM);
    crate::candidate::Scaled::new(
        &moved,
        [SHIFT_OFFSET_PM; 2],
        SHIFT_SCALE_PM,
        diameter_pm,
        radius_pm,
    )
}
