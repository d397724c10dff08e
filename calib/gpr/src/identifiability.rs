//! How well the wavelengths determine each moment.
//!
//! Affine law of the shifts: s = z + K m + e, by least squares. Condition of K: ratio of its
//! singular values. Explained share: 1 - RMSE_loo^2 / var(labels). Source: G. Golub & C. Van Loan,
//! "Matrix Computations" (2013), sec. 2.6 and 5.3; G. Seber & A. Lee, "Linear Regression Analysis"
//! (2003), ch. 3.

use crate::error::MapError;
use crate::training::MapTraining;
use nalgebra::{DMatrix, Matrix2, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Share of a moment's variance that left-out predictions must explain for it to count as
/// determined.
const EXPLAINED_ENOUGH: f64 = 0.5;
/// Condition number above which one direction of moment is called barely visible.
const CONDITION_LIMIT: f64 = 10.0;
/// Ratio of the cloud's principal deviations below which it is called nearly one-dimensional.
const FLAT_CLOUD: f64 = 0.1;

/// Affine law of the shifts: shift = zero + K m.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct WavelengthFromMoment {
    /// Shift at zero moment, pm.
    pub zero_pm: [f64; 2],
    /// K, row = grating, column = moment, pm per N mm.
    pub k_pm_per_nmm: [[f64; 2]; 2],
    /// Residual standard deviation of each grating, pm.
    pub residual_sd_pm: [f64; 2],
}

impl WavelengthFromMoment {
    /// Shifts at a moment, pm.
    pub fn shift_pm(&self, moment_nmm: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|g| {
            let k = self.k_pm_per_nmm[g];
            self.zero_pm[g] + k[0] * moment_nmm[0] + k[1] * moment_nmm[1]
        })
    }

    /// Standard deviations of the moments (N mm) by independent ones of the shifts (pm):
    /// `m = K^-1 (shift - zero)`.
    pub fn moment_sd_nmm(&self, shift_sd_pm: [f64; 2]) -> Option<[f64; 2]> {
        let [[a, b], [c, d]] = self.k_pm_per_nmm;
        // Independent errors of the shifts add in squares through the rows of K^-1.
        let determinant = a * d - b * c;
        let inverse = [[d, -b], [-c, a]].map(|row| row.map(|v| v / determinant));
        let sd = inverse.map(|row| (row[0] * shift_sd_pm[0]).hypot(row[1] * shift_sd_pm[1]));
        sd.iter().all(|s| s.is_finite()).then_some(sd)
    }
}

/// Numbers and sentences on what the readings determine.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct IdentifiabilityReport {
    /// Affine law of the shifts.
    pub law: WavelengthFromMoment,
    /// Condition number of K.
    pub condition: f64,
    /// Singular values of K, pm per N mm, largest first.
    pub singular_pm_per_nmm: [f64; 2],
    /// Standard deviation of each moment's labels, N mm.
    pub label_sd_nmm: [f64; 2],
    /// Share of each moment's variance that the chosen map explains when a reading is omitted.
    pub explained: [f64; 2],
    /// Principal deviations of the readings, pm, largest first.
    pub cloud_sd_pm: [f64; 2],
    /// Readings lie nearly on a line: a map across it is a guess.
    pub nearly_one_dimensional: bool,
    /// Plain sentences.
    pub warnings: Vec<String>,
}

/// Judges the training set; `loo_rmse_nmm` is the chosen map's leave-one-out error of each moment.
///
/// # Errors
/// [`MapError::RankDeficient`] where the labels lie on a line.
pub fn identify(
    training: &MapTraining,
    loo_rmse_nmm: [f64; 2],
) -> Result<IdentifiabilityReport, MapError> {
    let law = fit_law(training)?;
    let singular = Matrix2::from_fn(|i, j| law.k_pm_per_nmm[i][j]).singular_values();
    let singular = [singular.max(), singular.min()];
    let label_sd_nmm = covariance(&training.moments_nmm).diagonal().map(f64::sqrt);
    // Principal deviations of the cloud: readings on a line say nothing across it.
    let cloud = covariance(&training.shifts_pm)
        .symmetric_eigenvalues()
        .map(|v| v.max(0.0).sqrt());
    let cloud_sd_pm = [cloud.max(), cloud.min()];
    // In label units: a map no better than the labels' mean explains nothing.
    let explained = [0, 1].map(|m| 1.0 - (loo_rmse_nmm[m] / label_sd_nmm[m].max(1e-12)).powi(2));
    let mut report = IdentifiabilityReport {
        law,
        condition: singular[0] / singular[1],
        singular_pm_per_nmm: singular,
        label_sd_nmm: label_sd_nmm.into(),
        explained,
        cloud_sd_pm,
        nearly_one_dimensional: cloud_sd_pm[1] < FLAT_CLOUD * cloud_sd_pm[0],
        warnings: Vec::new(),
    };
    report.warnings = sentences(&report, loo_rmse_nmm);
    Ok(report)
}

fn sentences(r: &IdentifiabilityReport, loo_rmse_nmm: [f64; 2]) -> Vec<String> {
    let barely = (0..2).filter(|m| r.explained[*m] < EXPLAINED_ENOUGH).map(|m| {
        format!(
            "The {} moment is barely determined by these readings and labels: left out, it is predicted to {:.2} N mm rms while its labels \
             spread by only {:.2} N mm: check the twin (wcal verify) before trusting it.",
            ["first", "second"][m],
            loo_rmse_nmm[m],
            r.label_sd_nmm[m],
        )
    });
    let one_plane = (r.condition > CONDITION_LIMIT).then(|| {
        format!(
            "The gratings see one direction of moment {:.0} times better than the other: they lie nearly in one plane through the wire.",
            r.condition
        )
    });
    let line = "The readings lie nearly on a line in the wavelength plane: the map across it is a guess; add poses that load the other moment.";
    let one_line = r.nearly_one_dimensional.then(|| line.to_owned());
    barely.chain(one_plane).chain(one_line).collect()
}

/// Least squares of both shifts on (1, m_1, m_2).
fn fit_law(training: &MapTraining) -> Result<WavelengthFromMoment, MapError> {
    let n = training.len();
    let deficient = MapError::RankDeficient {
        trend: "affine wavelength-from-moment",
        readings: n,
    };
    let h = DMatrix::from_fn(n, 3, |i, j| {
        if j == 0 {
            1.0
        } else {
            training.moments_nmm[i][j - 1]
        }
    });
    let y = DMatrix::from_fn(n, 2, |i, g| training.shifts_pm[i][g]);
    // Labels on a line leave one column of K open.
    let svd = h.clone().svd(true, true);
    if svd.singular_values.min() < 1e-9 * svd.singular_values.max() {
        return Err(deficient);
    }
    let b = svd.solve(&y, 0.0).map_err(|_| deficient)?;
    let e = y - h * &b;
    // Three coefficients a grating are estimated.
    let sd_pm = |g: usize| (e.column(g).norm_squared() / (n as f64 - 3.0)).sqrt();
    Ok(WavelengthFromMoment {
        zero_pm: [b[(0, 0)], b[(0, 1)]],
        k_pm_per_nmm: [[b[(1, 0)], b[(2, 0)]], [b[(1, 1)], b[(2, 1)]]],
        residual_sd_pm: [sd_pm(0), sd_pm(1)],
    })
}

/// Covariance with divisor n: deviations next to the root mean square errors.
fn covariance(pairs: &[[f64; 2]]) -> Matrix2<f64> {
    let n = pairs.len() as f64;
    let mean = pairs
        .iter()
        .map(|p| Vector2::from(*p))
        .sum::<Vector2<f64>>()
        / n;
    pairs
        .iter()
        .map(|p| (Vector2::from(*p) - mean) * (Vector2::from(*p) - mean).transpose())
        .sum::<Matrix2<f64>>()
        / n
}
