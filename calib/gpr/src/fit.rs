//! From a training set to a chosen map.

use crate::artefact::{ARTEFACT_VERSION, MapArtefact};
use crate::candidate::{CandidateFit, MapKind, Scaled, fit_candidate};
use crate::choose::{Choice, choose};
use crate::error::MapError;
use crate::identifiability::{IdentifiabilityReport, identify};
use crate::process::ProcessModel;
use crate::region::ValidRegion;
use crate::released;
use crate::training::MapTraining;
use wcal_core::FbgSpec;

/// Readings above which the processes are left to the polynomial rivals: their cost grows with the
/// cube.
pub(crate) const MAX_PROCESS_READINGS: usize = 800;

/// How to fit.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// Candidates, simplest first.
    pub candidates: Vec<MapKind>,
    /// The released code's map instead of the candidates.
    pub released: bool,
    /// Further points of the declared domain, pm.
    pub domain_pm: Vec<[f64; 2]>,
    /// Where the labels came from.
    pub labels: String,
    /// Gratings, kept in the artefact.
    pub fbg: FbgSpec,
}

impl Default for FitOptions {
    fn default() -> Self {
        Self {
            candidates: MapKind::ALL.to_vec(),
            released: false,
            domain_pm: Vec::new(),
            labels: "unnamed".into(),
            fbg: FbgSpec::default(),
        }
    }
}

/// Everything that a fit found.
#[derive(Debug, Clone)]
pub struct MapFit {
    /// The chosen map.
    pub artefact: MapArtefact,
    /// Every candidate that could be fitted, in the given order.
    pub candidates: Vec<CandidateFit>,
    /// The choice.
    pub choice: Choice,
    /// What the readings determine.
    pub identifiability: IdentifiabilityReport,
    /// Candidates that could not be fitted, with the reason.
    pub skipped: Vec<(&'static str, String)>,
}

/// Fits every candidate, chooses one and keeps it as an artefact.
///
/// # Errors
/// A training set that cannot be used, or no candidate that can be fitted: [`MapError`].
pub fn fit_map(training: &MapTraining, options: &FitOptions) -> Result<MapFit, MapError> {
    training.validate()?;
    let valid_region = ValidRegion::new(&training.shifts_pm, &options.domain_pm);
    // The released map has constants for its scaling, whatever the readings.
    let (centre_pm, scale_pm, offset_nmm) = if options.released {
        (
            [released::SHIFT_OFFSET_PM; 2],
            released::SHIFT_SCALE_PM,
            released::MOMENT_OFFSET_NMM,
        )
    } else {
        let (centre, scale) = training.input_scaling();
        (centre, scale, 0.0)
    };
    let (candidates, skipped) = fit_all(training, options, &valid_region, centre_pm, scale_pm)?;
    if candidates.is_empty() {
        let reasons: Vec<_> = skipped
            .iter()
            .map(|(name, why)| format!("{name}: {why}"))
            .collect();
        return Err(MapError::NoCandidate {
            reasons: reasons.join("; "),
        });
    }
    let choice = choose(&candidates, training);
    let chosen = &candidates[choice.chosen];
    let identifiability = identify(training, chosen.loo.each_ref().map(|s| s.rmse_nmm))?;
    let artefact = MapArtefact {
        version: ARTEFACT_VERSION,
        name: chosen.name.into(),
        labels: options.labels.clone(),
        centre_pm,
        scale_pm,
        training_pm: training.shifts_pm.clone(),
        outputs: MapArtefact::outputs_of(chosen, offset_nmm),
        valid_region,
        law: identifiability.law,
        fbg: options.fbg.clone(),
        rest: None,
        // The readings' own noise, through the affine law.
        reading_sd_nmm: training
            .noise_sd_pm
            .and_then(|sd| identifiability.law.moment_sd_nmm(sd)),
    };
    artefact.check()?;
    Ok(MapFit {
        artefact,
        candidates,
        choice,
        identifiability,
        skipped,
    })
}

type Fitted = (Vec<CandidateFit>, Vec<(&'static str, String)>);

fn fit_all(
    training: &MapTraining,
    options: &FitOptions,
    region: &ValidRegion,
    centre_pm: [f64; 2],
    scale_pm: f64,
) -> Result<Fitted, MapError> {
    let (mut candidates, mut skipped) = (Vec::new(), Vec::new());
    if options.released {
        let scaled = released::scale(training, region.diameter_pm())?;
        let mut fit = fit_candidate(
            "released",
            &|_, _, _| Ok(released::model()),
            &scaled,
            training,
        )?;
        // The released map is reproduced as it is, its deviations too.
        fit.inflation = [1.0; 2];
        return Ok((vec![fit], skipped));
    }
    let scaled = Scaled::new(training, centre_pm, scale_pm, region.diameter_pm(), None)?;
    for candidate in &options.candidates {
        // Each trial of the search and each fold factorises an n x n matrix, at n^3.
        if candidate.is_process() && training.len() > MAX_PROCESS_READINGS {
            let why = format!(
                "{} readings, more than the {MAX_PROCESS_READINGS} that it is fitted to",
                training.len()
            );
            skipped.push((candidate.name(), why));
            continue;
        }
        let recipe = |x: &[[f64; 2]], y: &[f64], near: Option<&ProcessModel>| {
            candidate.searched(&scaled, x, y, near)
        };
        match fit_candidate(candidate.name(), &recipe, &scaled, training) {
            Ok(fit) => candidates.push(fit),
            Err(why) => skipped.push((candidate.name(), why.to_string())),
        }
    }
    Ok((candidates, skipped))
}
