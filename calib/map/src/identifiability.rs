//! How well the wavelengths determine each moment.
//!
//! Affine law of the shifts: s = z + K m + e, cov(e) = R, by least squares. A reading's scatter R is worth K^-1 R K^-T in the moment; its
//! diagonal gives the standard deviations. Condition of K: ratio of its singular values. What moment m alone moves, the other's direction
//! taken out: 1 / |row m of K^-1|. Explained share: 1 - RMSE_loo^2 / var(labels). Source: G. Golub & C. Van Loan, "Matrix Computations"
//! (2013), sec. 2.6 and 5.3; G. Seber & A. Lee, "Linear Regression Analysis" (2003), ch. 3.

use crate::error::MapError;
use crate::training::MapTraining;
use nalgebra::{DMatrix, Matrix2, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Share of a moment's variance that left-out predictions must explain for it to count as determined.
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
    #[must_use]
    pub fn shift_pm(&self, moment_nmm: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|g| {
            let k = self.k_pm_per_nmm[g];
            self.zero_pm[g] + k[0] * moment_nmm[0] + k[1] * moment_nmm[1]
        })
    }

    /// Standard deviations of the moments (N mm) by independent ones of the shifts (pm): `m = K^-1 (shift - zero)`.
    #[must_use]
    pub fn moment_sd_nmm(&self, shift_sd_pm: [f64; 2]) -> Option<[f64; 2]> {
        let [[a, b], [c, d]] = self.k_pm_per_nmm;
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
    /// Singular values of K with shifts in residual deviations and moments in label deviations: signal over noise, largest first.
    pub singular_scaled: [f64; 2],
    /// What each moment alone moves, the other one's direction taken out, pm per N mm.
    pub own_pm_per_nmm: [f64; 2],
    /// Deviation of each moment inferred from one reading, from the law's residuals, N mm.
    pub scatter_nmm: [f64; 2],
    /// The part of it that the readings' own noise explains, N mm; none where that noise is unknown.
    pub noise_nmm: Option<[f64; 2]>,
    /// Standard deviation of each moment's labels, N mm.
    pub label_sd_nmm: [f64; 2],
    /// Share of each moment's variance that the chosen map explains when a reading is left out.
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
pub fn identify(training: &MapTraining, loo_rmse_nmm: [f64; 2]) -> Result<IdentifiabilityReport, MapError> {
    let (law, residual) = fit_law(training)?;
    let k = Matrix2::from_fn(|i, j| law.k_pm_per_nmm[i][j]);
    let singular = sorted_singular(&k);
    let label_sd_nmm = covariance(&training.moments_nmm).diagonal().map(f64::sqrt);
    let scaled = Matrix2::from_fn(|i, j| k[(i, j)] * label_sd_nmm[j] / law.residual_sd_pm[i].max(1e-9));
    // K^-1 carries scatter of the readings to scatter of the inferred moment.
    let inverse = k.try_inverse().unwrap_or_else(|| Matrix2::from_element(f64::INFINITY));
    let to_moment = |c: &Matrix2<f64>| (inverse * c * inverse.transpose()).diagonal().map(f64::sqrt);
    let noise =
        training.noise_sd_pm.map(|sd| to_moment(&Matrix2::new(sd[0].powi(2), 0.0, 0.0, sd[1].powi(2))));
    // Principal deviations of the cloud: readings on a line say nothing across it.
    let cloud = covariance(&training.shifts_pm).symmetric_eigenvalues().map(|v| v.max(0.0).sqrt());
    let cloud_sd_pm = [cloud.max(), cloud.min()];
    // In label units: a map no better than the labels' mean explains nothing.
    let explained = [0, 1].map(|m| 1.0 - (loo_rmse_nmm[m] / label_sd_nmm[m].max(1e-12)).powi(2));
    let own = [0, 1].map(|m| 1.0 / inverse.row(m).norm());
    let mut report = IdentifiabilityReport {
        law,
        condition: singular[0] / singular[1],
        singular_pm_per_nmm: singular,
        singular_scaled: sorted_singular(&scaled),
        own_pm_per_nmm: own,
        scatter_nmm: to_moment(&residual).into(),
        noise_nmm: noise.map(Into::into),
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
    let mut out = Vec::new();
    for (m, ordinal) in ["first", "second"].into_iter().enumerate() {
        if r.explained[m] >= EXPLAINED_ENOUGH {
            continue;
        }
        let other = 1 - m;
        let weak = if r.own_pm_per_nmm[m] < r.own_pm_per_nmm[other] {
            format!(
                "Part of the cause is the sensor: this moment alone moves the gratings by {:.0} pm per N mm, the other one by {:.0}.",
                r.own_pm_per_nmm[m], r.own_pm_per_nmm[other]
            )
        } else {
            format!(
                "The sensor is not the cause: this moment alone moves the gratings by {:.0} pm per N mm, the other one by {:.0}.",
                r.own_pm_per_nmm[m], r.own_pm_per_nmm[other]
            )
        };
        let noise = match r.noise_nmm {
            Some(noise) => format!(
                "The readings' own noise is worth {:.3} N mm of it, so labels or model carry the rest.",
                noise[m]
            ),
            None => "The readings' own noise is unknown here.".into(),
        };
        out.push(format!(
            "The {ordinal} moment is barely determined by these readings and labels: left out, it is predicted to \
             {:.2} N mm rms while its labels spread by only {:.2} N mm ({:.0} % of their variance explained). {weak} \
             The wavelengths scatter about their best affine law by {:.1} and {:.1} pm, which is worth {:.2} N mm of this \
             moment. {noise} Wrong labels look the same as a deaf sensor: check the twin (wcal verify) before trusting this moment.",
            loo_rmse_nmm[m],
            r.label_sd_nmm[m],
            100.0 * r.explained[m].max(0.0),
            r.law.residual_sd_pm[0],
            r.law.residual_sd_pm[1],
            r.scatter_nmm[m],
        ));
    }
    if r.condition > CONDITION_LIMIT {
        out.push(format!(
            "The gratings see one direction of moment {:.0} times better than the other ({:.1} against {:.1} pm per N mm): \
             they lie nearly in one plane through the wire, and noise across it is magnified as much.",
            r.condition, r.singular_pm_per_nmm[0], r.singular_pm_per_nmm[1]
        ));
    }
    if r.nearly_one_dimensional {
        out.push(format!(
            "The readings lie nearly on a line in the wavelength plane (deviations {:.1} pm along, {:.1} pm across): the map \
             across that line is a guess; add poses that load the other moment.",
            r.cloud_sd_pm[0], r.cloud_sd_pm[1]
        ));
    }
    out
}

/// Least squares of both shifts on (1, m_1, m_2), with the residual covariance (pm^2).
fn fit_law(training: &MapTraining) -> Result<(WavelengthFromMoment, Matrix2<f64>), MapError> {
    let n = training.len();
    let deficient = MapError::RankDeficient { trend: "affine wavelength-from-moment", readings: n };
    let h = DMatrix::from_fn(n, 3, |i, j| if j == 0 { 1.0 } else { training.moments_nmm[i][j - 1] });
    let y = DMatrix::from_fn(n, 2, |i, g| training.shifts_pm[i][g]);
    // Labels on a line leave one column of K open.
    let svd = h.clone().svd(true, true);
    if svd.singular_values.min() < 1e-9 * svd.singular_values.max() {
        return Err(deficient);
    }
    let b = svd.solve(&y, 0.0).map_err(|_| deficient)?;
    let e = y - h * &b;
    let residual = Matrix2::from_fn(|i, j| e.column(i).dot(&e.column(j)) / (n as f64 - 3.0));
    let law = WavelengthFromMoment {
        zero_pm: [b[(0, 0)], b[(0, 1)]],
        k_pm_per_nmm: [[b[(1, 0)], b[(2, 0)]], [b[(1, 1)], b[(2, 1)]]],
        residual_sd_pm: [residual[(0, 0)].sqrt(), residual[(1, 1)].sqrt()],
    };
    Ok((law, residual))
}

fn sorted_singular(m: &Matrix2<f64>) -> [f64; 2] {
    let s = m.singular_values();
    [s.max(), s.min()]
}

/// Covariance with divisor n: deviations next to the root mean square errors.
fn covariance(pairs: &[[f64; 2]]) -> Matrix2<f64> {
    let n = pairs.len() as f64;
    let mean = pairs.iter().map(|p| Vector2::from(*p)).sum::<Vector2<f64>>() / n;
    pairs
        .iter()
        .map(|p| (Vector2::from(*p) - mean) * (Vector2::from(*p) - mean).transpose())
        .sum::<Matrix2<f64>>()
        / n
}
