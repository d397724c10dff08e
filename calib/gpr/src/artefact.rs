//! The fitted map as it is stored.

use crate::candidate::CandidateFit;
use crate::error::MapError;
use crate::identifiability::WavelengthFromMoment;
use crate::kernel::Kernel;
use crate::process::{Process, ProcessModel};
use crate::region::ValidRegion;
use crate::trend::Trend;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wcal_core::FbgSpec;
use wcal_core::map_document::RestZero;

/// Version of [`MapArtefact`] that this program writes.
pub(crate) const ARTEFACT_VERSION: u32 = 1;
/// Most readings of a map: its factors take their square in memory.
const MAX_READINGS: usize = 10_000;

/// A wavelength-to-moment map that can be evaluated without a refit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapArtefact {
    /// Always [`ARTEFACT_VERSION`].
    #[schemars(extend("const" = ARTEFACT_VERSION))]
    pub version: u32,
    /// Name of the candidate.
    pub name: String,
    /// Where the moments came from.
    pub labels: String,
    /// Shift at scaled input 0, pm.
    pub centre_pm: [f64; 2],
    /// Shift per unit of scaled input, pm.
    pub scale_pm: f64,
    /// Readings that it was fitted to, pm.
    pub training_pm: Vec<[f64; 2]>,
    /// One map a moment: offset + trend(z) beta + k(z) alpha.
    pub outputs: [OutputMap; 2],
    /// Where it may be used.
    pub valid_region: ValidRegion,
    /// Affine law of the shifts, for the wavelengths that a moment should show.
    pub law: WavelengthFromMoment,
    /// Gratings, for tables of absolute wavelengths and for temperature.
    pub fbg: FbgSpec,
    /// Noise of a single reading in the two moments, N mm; absent where the session has neither
    /// samples nor their deviation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reading_sd_nmm: Option<[f64; 2]>,
    /// Readings at rest, tested by the map of the loaded poses alone; absent where there are none,
    /// or too few loaded ones.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rest: Option<RestZero>,
}

/// One moment: mean = offset + trend(z) beta + k(z) alpha.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OutputMap {
    /// Basis of the mean: constant, affine, quadratic.
    pub trend: Trend,
    /// Correlation, scaled input units.
    pub kernel: Kernel,
    /// Noise variance over signal variance.
    pub nugget: f64,
    /// Signal variance, (N mm)^2.
    pub variance_nmm2: f64,
    /// Degrees of freedom of the variance; none: normal.
    pub dof: Option<f64>,
    /// Factor on the standard deviations, from left-out coverage.
    pub inflation: f64,
    /// Added to the mean, N mm.
    pub offset_nmm: f64,
    /// Coefficients of the trend, N mm.
    pub beta: Vec<f64>,
    /// Weights of the readings, N mm; empty without a kernel.
    pub alpha: Vec<f64>,
}

impl OutputMap {
    pub(crate) fn new(fit: &Process, inflation: f64, offset_nmm: f64) -> Self {
        let plain = fit.model.kernel == Kernel::None;
        Self {
            trend: fit.model.trend,
            kernel: fit.model.kernel,
            nugget: fit.model.nugget,
            variance_nmm2: fit.variance,
            dof: fit.dof,
            inflation,
            offset_nmm,
            beta: fit.beta.as_slice().to_vec(),
            alpha: if plain {
                Vec::new()
            } else {
                fit.alpha.as_slice().to_vec()
            },
        }
    }

    /// The process that it states, on scaled readings.
    pub(crate) fn process(&self, inputs: &[[f64; 2]]) -> Result<Process, MapError> {
        let model = ProcessModel {
            trend: self.trend,
            kernel: self.kernel,
            nugget: self.nugget,
            fixed_variance: Some(self.variance_nmm2),
        };
        Process::known(model, self.variance_nmm2, inputs, [&self.beta, &self.alpha])
    }

    /// Noise standard deviation, N mm, before inflation.
    pub fn noise_sd_nmm(&self) -> f64 {
        (self.variance_nmm2 * self.nugget).sqrt()
    }

    /// Signal standard deviation, N mm; 0 without a kernel.
    pub(crate) fn signal_sd_nmm(&self) -> f64 {
        (self.variance_nmm2 * self.kernel.at_zero()).sqrt()
    }
}

impl MapArtefact {
    pub(crate) fn outputs_of(candidate: &CandidateFit, offset_nmm: f64) -> [OutputMap; 2] {
        [0, 1].map(|m| OutputMap::new(&candidate.fits[m], candidate.inflation[m], offset_nmm))
    }

    /// A shift (pm) in the kernels' unit.
    pub(crate) fn scaled(&self, shift_pm: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|c| (shift_pm[c] - self.centre_pm[c]) / self.scale_pm)
    }

    /// Checks version, sizes, finiteness and the kernel's radius.
    ///
    /// # Errors
    /// [`MapError::Artefact`] or [`MapError::RadiusTooSmall`].
    pub fn check(&self) -> Result<(), MapError> {
        let require = |sound: bool, expected: &str, found: String| {
            if sound {
                Ok(())
            } else {
                Err(MapError::Artefact {
                    expected: expected.into(),
                    found,
                })
            }
        };
        require(
            self.version == ARTEFACT_VERSION,
            &format!("version {ARTEFACT_VERSION}"),
            self.version.to_string(),
        )?;
        let scale = self.scale_pm;
        require(
            scale.is_finite() && scale > 0.0,
            "`scale_pm` above 0",
            scale.to_string(),
        )?;
        let readings = self.training_pm.len();
        require(
            (1..=MAX_READINGS).contains(&readings),
            &format!("`training_pm` with 1 to {MAX_READINGS} readings"),
            readings.to_string(),
        )?;
        let kind = &self.valid_region.kind;
        require(
            kind == "hull",
            "`valid_region.kind` \"hull\"",
            format!("{kind:?}"),
        )?;
        let region = &self.valid_region.vertices_pm;
        let shifts = self
            .training_pm
            .iter()
            .chain(region)
            .chain([&self.centre_pm]);
        require(
            finite(shifts.flatten().copied()),
            "finite shifts",
            "NaN or infinity".into(),
        )?;
        let margin = self.valid_region.margin_pm;
        require(
            margin.is_finite() && margin >= 0.0,
            "`margin_pm` of at least 0",
            margin.to_string(),
        )?;
        require(
            !region.is_empty(),
            "`vertices_pm` with vertices",
            "none".into(),
        )?;
        for (m, out) in self.outputs.iter().enumerate() {
            let weights = if out.kernel == Kernel::None {
                0
            } else {
                readings
            };
            let count = |name: &str| format!("`outputs[{m}].{name}`");
            require(
                out.beta.len() == out.trend.terms(),
                &format!("{} of {} numbers", count("beta"), out.trend.terms()),
                out.beta.len().to_string(),
            )?;
            require(
                out.alpha.len() == weights,
                &format!("{} of {weights} numbers", count("alpha")),
                out.alpha.len().to_string(),
            )?;
            // Where readings coincide, C = K + nu I is positive definite by nu > 0 alone.
            let sizes = [out.nugget, out.variance_nmm2, out.inflation];
            let sound = finite(sizes) && sizes.iter().all(|v| *v >= 0.0) && out.nugget > 0.0;
            require(
                sound,
                &format!("outputs[{m}] with variances of at least 0"),
                format!("{sizes:?}"),
            )?;
            let shape = out.kernel.shape().unwrap_or(1.0);
            require(
                shape.is_finite() && shape > 0.0,
                &format!("{} above 0", count("kernel")),
                shape.to_string(),
            )?;
            let coefficients = out
                .beta
                .iter()
                .chain(&out.alpha)
                .copied()
                .chain([out.offset_nmm]);
            require(
                finite(coefficients),
                &format!("finite coefficients in outputs[{m}]"),
                "NaN or infinity".into(),
            )?;
            // The thin plate is positive definite within a part of its radius alone.
            out.kernel
                .check_radius(self.valid_region.diameter_pm() / scale)?;
        }
        Ok(())
    }
}

fn finite(values: impl IntoIterator<Item = f64>) -> bool {
    values.into_iter().all(f64::is_finite)
}
