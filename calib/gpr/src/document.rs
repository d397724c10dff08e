//! A fit as `fit-gpr.json`.

use crate::fit::MapFit;
use crate::student::binomial_bounds;
use crate::training::MapTraining;
use serde_json::json;
use std::collections::BTreeMap;
use wcal_core::map_document::{Identifiability, MAP_FORMAT, MapCandidate, MapDocument};

/// The document of a fit; `poses` is the number of calibration poses (rest not counted).
pub fn document(fit: &MapFit, training: &MapTraining, poses: usize) -> MapDocument {
    let candidates = fit
        .candidates
        .iter()
        .map(|c| MapCandidate {
            name: c.name.into(),
            loo_rmse_nmm: c.loo.each_ref().map(|s| s.rmse_nmm),
            loto_rmse_nmm: c.loto.as_ref().map(|l| l.each_ref().map(|s| s.rmse_nmm)),
            coverage95: [0, 1].map(|m| c.loo[m].coverage_with(c.inflation[m])),
            nll: c.loo.each_ref().map(|s| s.nll),
            log_evidence: c.log_evidence,
        })
        .collect();
    MapDocument {
        format: MAP_FORMAT.into(),
        simulated: false,
        points: poses,
        labels: fit.artefact.labels.clone(),
        chosen: fit.artefact.name.clone(),
        rest: fit.artefact.rest.clone(),
        candidates,
        identifiability: Identifiability {
            condition: fit.identifiability.condition,
            warnings: fit.identifiability.warnings.clone(),
        },
        valid_region: json!(fit.artefact.valid_region),
        hyperparameters: hyperparameters(fit, training),
    }
}

fn hyperparameters(fit: &MapFit, training: &MapTraining) -> BTreeMap<String, serde_json::Value> {
    let chosen = &fit.candidates[fit.choice.chosen];
    let out = &fit.artefact.outputs;
    let judged = chosen.loto.as_ref().unwrap_or(&chosen.loo);
    let excess = |values: &[f64]| -> BTreeMap<&str, f64> {
        fit.candidates
            .iter()
            .zip(values)
            .map(|(c, v)| (c.name, *v))
            .collect()
    };
    BTreeMap::from([
        ("kernel".into(), json!(out.each_ref().map(|o| o.kernel))),
        ("trend".into(), json!(out.each_ref().map(|o| o.trend))),
        (
            "signal_sd_nmm".into(),
            json!(out.each_ref().map(|o| o.signal_sd_nmm())),
        ),
        (
            "noise_sd_nmm".into(),
            json!(out.each_ref().map(|o| o.noise_sd_nmm())),
        ),
        ("input_scale_pm".into(), json!(fit.artefact.scale_pm)),
        (
            "calibration".into(),
            json!({
                "by": fit.choice.by,
                "sd_inflation": chosen.inflation,
                "coverage95_before": judged.each_ref().map(|s| s.coverage_with(1.0)),
                "coverage95_after": ([0, 1].map(|m| judged[m].coverage_with(chosen.inflation[m]))),
                "coverage95_bounds": judged.each_ref().map(|s| {
                    let n = s.errors.len();
                    binomial_bounds(n, 0.95).map(|k| k as f64 / n.max(1) as f64)
                }),
            }),
        ),
        (
            "choice".into(),
            json!({
                "rule": "simplest candidate within one standard error of the best (paired over held-out groups)",
                "by": fit.choice.by,
                "best": fit.candidates[fit.choice.best].name,
                "relative_excess": excess(&fit.choice.excess),
                "relative_excess_se": excess(&fit.choice.excess_se),
            }),
        ),
        ("identifiability".into(), json!(fit.identifiability)),
        ("readings".into(), json!(training.len())),
        (
            "skipped".into(),
            json!(
                fit.skipped
                    .iter()
                    .map(|(name, why)| json!({"name": name, "why": why}))
                    .collect::<Vec<_>>()
            ),
        ),
    ])
}
