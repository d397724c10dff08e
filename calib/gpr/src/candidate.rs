//! The candidate maps, their fits and their left-out errors.
//!
//! With left-out errors e_i, scales s_i and degrees of freedom nu: RMSE^2 = sum e_i^2 / n; negative
//! log predictive density sum (ln s_i - ln t_nu(e_i / s_i)) / n; reach r_i = |e_i| / (t_(0.975, nu)
//! s_i), coverage = share of r_i <= 1. Inflation: the ceil(0.95 (n + 1))-th smallest r_i, where the
//! coverage lies below the binomial bounds. Source: C. Rasmussen & C. Williams, "Gaussian Processes
//! for Machine Learning" (2006), sec. 5.4.2; the rank: V. Vovk, A. Gammerman & G. Shafer,
//! "Algorithmic Learning in a Random World" (2005) (split-conformal prediction).

use crate::error::MapError;
use crate::evidence::{ShapeSearch, choose_hyperparameters, log_evidence};
use crate::kernel::{Kernel, RADIUS_PER_DIAMETER};
use crate::process::{LeftOut, Process, ProcessModel};
use crate::student::{binomial_bounds, half95, log_density};
use crate::training::MapTraining;
use crate::trend::Trend;

/// Candidates, simplest first: the order in which ties are decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MapKind {
    /// Affine least squares.
    Affine,
    /// Quadratic least squares.
    Quadratic,
    /// Thin plate about an affine mean. The radius cancels: with an affine mean only r^3 remains of
    /// the kernel.
    ThinPlate,
    /// Thin plate about a constant mean; the radius sets how steep the map is expected to be.
    ThinPlateConstant,
    /// Matern 5/2 about an affine mean.
    Matern52Affine,
    /// Matern 5/2 about a constant mean.
    Matern52,
}

impl MapKind {
    /// Every candidate, simplest first.
    pub const ALL: [Self; 6] = [
        Self::Affine,
        Self::Quadratic,
        Self::ThinPlate,
        Self::ThinPlateConstant,
        Self::Matern52Affine,
        Self::Matern52,
    ];

    /// Name in `fit-gpr.json`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Affine => "affine",
            Self::Quadratic => "quadratic",
            Self::ThinPlate => "thin-plate",
            Self::ThinPlateConstant => "thin-plate-constant",
            Self::Matern52Affine => "matern52-affine",
            Self::Matern52 => "matern52",
        }
    }

    fn trend(self) -> Trend {
        match self {
            Self::Affine | Self::ThinPlate | Self::Matern52Affine => Trend::Affine,
            Self::Quadratic => Trend::Quadratic,
            Self::ThinPlateConstant | Self::Matern52 => Trend::Constant,
        }
    }

    /// Whether fitting it costs the cube of the number of readings.
    pub(crate) fn is_process(self) -> bool {
        !matches!(self, Self::Affine | Self::Quadratic)
    }

    /// Starting kernel and range of its shape, for a region of this diameter (scaled input units).
    fn kernel(self, diameter: f64, radius: f64) -> (Kernel, Option<ShapeSearch>) {
        // From a tenth of the cloud, where neighbours tell nothing, to twenty of it, where only the
        // trend remains.
        let length = ShapeSearch {
            low: 0.1 * diameter,
            high: 20.0 * diameter,
            steps: 10,
        };
        match self {
            Self::Affine | Self::Quadratic => (Kernel::None, None),
            Self::ThinPlate => (Kernel::ThinPlate { radius }, None),
            // From the smallest safe radius on; a large one leaves an affine map and r^3.
            Self::ThinPlateConstant => (
                Kernel::ThinPlate { radius },
                Some(ShapeSearch {
                    low: radius,
                    high: 64.0 * radius,
                    steps: 7,
                }),
            ),
            Self::Matern52 | Self::Matern52Affine => {
                (Kernel::Matern52 { length: diameter }, Some(length))
            }
        }
    }
}

/// Training set in scaled units and the region that the kernels must serve.
#[derive(Debug, Clone)]
pub struct Scaled {
    /// Scaled inputs.
    pub inputs: Vec<[f64; 2]>,
    /// Labels of each moment, output units of the map.
    pub outputs: [Vec<f64>; 2],
    /// Diameter of readings and declared domain, scaled input units.
    pub diameter: f64,
    /// Smallest thin-plate radius in use, scaled input units.
    pub radius: f64,
}

impl Scaled {
    /// Scales the readings about `centre_pm`; the radius is the declared one or the smallest safe
    /// one.
    ///
    /// # Errors
    /// [`MapError::RadiusTooSmall`] where `radius_pm` is below 1.6 x `diameter_pm`.
    pub fn new(
        training: &MapTraining,
        centre_pm: [f64; 2],
        scale_pm: f64,
        diameter_pm: f64,
        radius_pm: Option<f64>,
    ) -> Result<Self, MapError> {
        // One scale for both gratings: the kernel stays isotropic in wavelength.
        let scale = |s: &[f64; 2]| [0, 1].map(|c| (s[c] - centre_pm[c]) / scale_pm);
        let diameter = diameter_pm / scale_pm;
        let radius = radius_pm.map_or(RADIUS_PER_DIAMETER * diameter, |r| r / scale_pm);
        Kernel::ThinPlate { radius }.check_radius(diameter)?;
        Ok(Self {
            inputs: training.shifts_pm.iter().map(scale).collect(),
            outputs: [training.moment_nmm(0), training.moment_nmm(1)],
            diameter,
            radius,
        })
    }
}

/// Left-out errors of one moment, summarised.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOutSummary {
    /// Root mean square error, N mm.
    pub rmse_nmm: f64,
    /// Mean negative log predictive density, nats, N mm.
    pub nll: f64,
    /// Every left-out reading.
    pub errors: Vec<LeftOut>,
}

impl LeftOutSummary {
    fn new(errors: Vec<LeftOut>) -> Self {
        let n = errors.len().max(1) as f64;
        // The scale of a moment's error, whatever interval is stated.
        let rmse_nmm = (errors.iter().map(|e| e.error * e.error).sum::<f64>() / n).sqrt();
        // Density of the error: that of e / s, over s.
        let nll = errors
            .iter()
            .map(|e| e.sd.ln() - log_density(e.error / e.sd, e.dof))
            .sum::<f64>()
            / n;
        Self {
            rmse_nmm,
            nll,
            errors,
        }
    }

    /// Share of the readings inside their 95 % interval once every interval is widened by
    /// `inflation`.
    pub(crate) fn coverage_with(&self, inflation: f64) -> f64 {
        let inside = self
            .errors
            .iter()
            .filter(|e| Self::reach(e) <= inflation)
            .count();
        inside as f64 / self.errors.len().max(1) as f64
    }

    /// Error in half widths of its 95 % interval.
    fn reach(e: &LeftOut) -> f64 {
        e.error.abs() / (half95(e.dof) * e.sd)
    }

    /// Factor on the standard deviation: 1 unless the left-out coverage lies below the binomial
    /// bounds of 95 %, then the smallest factor that brings the ceil(0.95 (n + 1))-th smallest error
    /// inside (split-conformal rank). Never below 1.
    pub fn inflation(&self) -> f64 {
        let n = self.errors.len();
        let inside = (self.coverage_with(1.0) * n as f64).round() as usize;
        if n == 0 || inside >= binomial_bounds(n, 0.95)[0] {
            return 1.0;
        }
        // Fewer inside than chance allows: the intervals are too narrow by a factor.
        let mut reach: Vec<f64> = self.errors.iter().map(Self::reach).collect();
        reach.sort_by(f64::total_cmp);
        let rank = ((0.95 * (n + 1) as f64).ceil() as usize).min(n);
        reach[rank - 1].max(1.0)
    }
}

/// One candidate: both moments' fits and their left-out errors.
#[derive(Debug, Clone)]
pub struct CandidateFit {
    /// Name in `fit-gpr.json`.
    pub name: &'static str,
    /// Fit of each moment.
    pub fits: [Process; 2],
    /// Leave-one-pose-out at the fit's hyperparameters, closed form.
    pub loo: [LeftOutSummary; 2],
    /// Leave-one-trajectory-out, everything refitted; none with fewer than three trajectories.
    pub loto: Option<[LeftOutSummary; 2]>,
    /// Restricted log likelihood, both moments together.
    pub log_evidence: Option<f64>,
    /// Factor on each moment's standard deviation (see [`LeftOutSummary::inflation`]).
    pub inflation: [f64; 2],
}

/// How a moment's model is chosen from inputs and outputs, for the whole set and for every fold;
/// last the full fit's model, from which a fold may start.
pub(crate) type Recipe<'a> =
    &'a dyn Fn(&[[f64; 2]], &[f64], Option<&ProcessModel>) -> Result<ProcessModel, MapError>;

impl MapKind {
    /// Hyperparameters by the evidence, anew in each fold.
    pub(crate) fn searched(
        self,
        scaled: &Scaled,
        inputs: &[[f64; 2]],
        y: &[f64],
        near: Option<&ProcessModel>,
    ) -> Result<ProcessModel, MapError> {
        let (kernel, full) = self.kernel(scaled.diameter, scaled.radius);
        let search = match (full, near.and_then(|m| m.kernel.shape())) {
            (Some(range), Some(shape)) => Some(range.about(shape)),
            (range, _) => range,
        };
        choose_hyperparameters(self.trend(), kernel, search, inputs, y)
    }
}

/// Fits both moments and leaves out poses and trajectories. Each moment has its own
/// hyperparameters: the two are determined to very different degrees, and a shared noise ratio
/// would smooth the good one for the bad one's sake.
pub(crate) fn fit_candidate(
    name: &'static str,
    recipe: Recipe<'_>,
    scaled: &Scaled,
    training: &MapTraining,
) -> Result<CandidateFit, MapError> {
    let poses = training.pose_groups();
    let trajectories = training.trajectories();
    let one = |moment: usize| -> Result<_, MapError> {
        let y = &scaled.outputs[moment];
        let model = recipe(&scaled.inputs, y, None)?;
        let fit = Process::fit(model, &scaled.inputs, y)?;
        // Readings of one pose share its error: left out alone, one would be known from the others.
        let loo = LeftOutSummary::new(fit.leave_out(&poses));
        let loto = (trajectories.len() >= 3).then(|| {
            leave_trajectories_out(recipe, &fit.model, scaled, y, training, &trajectories)
        });
        // A likelihood with a given variance is on another scale.
        let evidence = match model.fixed_variance {
            None => log_evidence(&model, &scaled.inputs, y),
            Some(_) => None,
        };
        Ok((fit, loo, loto.transpose()?, evidence))
    };
    let (fit_1, loo_1, loto_1, evidence_1) = one(0)?;
    let (fit_2, loo_2, loto_2, evidence_2) = one(1)?;
    let (loo, loto) = ([loo_1, loo_2], loto_1.zip(loto_2).map(<[_; 2]>::from));
    // Readings of one trajectory share errors: whole ones left out judge the width of intervals.
    Ok(CandidateFit {
        name,
        fits: [fit_1, fit_2],
        inflation: loto
            .as_ref()
            .unwrap_or(&loo)
            .each_ref()
            .map(LeftOutSummary::inflation),
        loo,
        loto,
        log_evidence: evidence_1.zip(evidence_2).map(|(a, b)| a + b),
    })
}

/// Refits without each trajectory in turn and predicts its readings.
fn leave_trajectories_out(
    recipe: Recipe<'_>,
    full: &ProcessModel,
    scaled: &Scaled,
    y: &[f64],
    training: &MapTraining,
    trajectories: &[u32],
) -> Result<LeftOutSummary, MapError> {
    let mut out = Vec::new();
    for trajectory in trajectories {
        let (held, kept): (Vec<usize>, Vec<usize>) =
            (0..y.len()).partition(|i| training.trajectory[*i] == Some(*trajectory));
        let inputs: Vec<[f64; 2]> = kept.iter().map(|i| scaled.inputs[*i]).collect();
        let outputs: Vec<f64> = kept.iter().map(|i| y[*i]).collect();
        // Hyperparameters anew: those of all readings have seen the ones that are held.
        let model = recipe(&inputs, &outputs, Some(full))?;
        let fit = Process::fit(model, &inputs, &outputs)?;
        for index in held {
            let (mean, _, variance) = fit.predict(scaled.inputs[index]);
            out.push(LeftOut {
                index,
                error: y[index] - mean,
                sd: variance.sqrt(),
                dof: fit.dof,
            });
        }
    }
    Ok(LeftOutSummary::new(out))
}
