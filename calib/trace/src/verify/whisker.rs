//! The residual loop for kind "whisker", stage by stage.

use super::between::between_seatings;
use super::floor::{Floor, noise_floor};
use super::holdout_check::{HOLDOUT_LEVEL, holdout_p};
use super::listings::{Branch, PredictionRow, branches, isolability, prediction_rows, records};
use super::physical::PhysicalModel;
use super::predictions::predict;
use super::twin_check::{LabelReport, check_labels};
use super::unseal::{Errors, held_out_errors};
use super::verdict::{Conclusion, conclude};
use super::{detect, next};
use crate::candidate::System;
use crate::engine::fit::{Weights, fit};
use crate::engine::inference::in_class;
use crate::engine::lasso::group_lasso;
use crate::engine::linear::stack;
use crate::engine::search::{Found, Hypothesis, Options, search};
use crate::error::TraceError;
use crate::whisker::WhiskerSystem;
use std::collections::BTreeMap;
use wcal_core::observation::{Role, WhiskerData, WhiskerRow};
use wcal_core::verify_document::{
    HeldOutError, NoiseFloor, TwinCheck, VERIFY_FORMAT, Verdict, VerifyDocument,
};
use wcal_core::{InputFile, ResidualRecord};

/// Settings of `verify`.
#[derive(Debug, Clone, Default)]
pub struct VerifyOptions {
    /// Settings of the search.
    pub search: Options,
    /// Effects of a surviving explanation to be accepted; empty leaves the choice to the verdict.
    pub accept: Vec<String>,
}

/// Everything that `verify` found.
pub struct WhiskerVerification {
    /// verify.json.
    pub document: VerifyDocument,
    /// predictions.csv.
    pub predictions: Vec<PredictionRow>,
    /// Residual records of every reading and channel.
    pub residuals: Vec<ResidualRecord>,
    /// Twin check.
    pub labels: LabelReport,
    /// Accepted calibration.
    pub model: PhysicalModel,
    /// The search, for the report.
    pub found: Found,
    /// Held-out errors beside before and after: (name, error).
    pub further: Vec<(String, HeldOutError)>,
    /// Rod branch along each trajectory: (identifier, stage positions, moments).
    pub branches: Vec<Branch>,
    /// Names and matrix of cosines between explanations of one effect.
    pub isolability: (Vec<String>, Vec<Vec<f64>>),
}

/// Change of the channels' shared noise from which the search is made again.
const MIXTURE_CHANGED: f64 = 1.1;
/// Fewest loaded readings that carry K, the zero and a residual.
const FEWEST_LOADED: usize = 9;

/// Why the readings cannot be used at all.
fn unusable(data: &WhiskerData) -> Option<String> {
    let loaded = data.rows.iter().filter(|r| r.role != Role::Rest).count();
    if loaded < FEWEST_LOADED {
        return Some(format!(
            "The session has {loaded} loaded readings; K, the zero and a residual need at least {FEWEST_LOADED}."
        ));
    }
    let times: Vec<f64> = data.rows.iter().filter_map(|r| r.t_s).collect();
    if let Some(k) = times.windows(2).position(|w| w[1] < w[0]) {
        return Some(format!(
            "The clock runs backwards after reading {} (t_s {} follows {}).",
            k + 1,
            times[k + 1],
            times[k]
        ));
    }
    let copied = data
        .holdout
        .iter()
        .filter(|h| h.role == Role::Holdout)
        .filter(|h| {
            data.rows
                .iter()
                .any(|r| r.role != Role::Rest && r.shift_pm == h.shift_pm && r.stage_mm == h.stage_mm)
        })
        .count();
    if copied > 0 {
        return Some(format!(
            "{copied} rows of the holdout are also in the points table; a holdout that was in the fit proves nothing."
        ));
    }
    let mut seen: BTreeMap<[u64; 2], usize> = BTreeMap::new();
    for r in &data.rows {
        *seen.entry(r.shift_pm.map(f64::to_bits)).or_default() += 1;
    }
    let copies: usize = seen.values().filter(|c| **c > 1).map(|c| c - 1).sum();
    // Wavelengths carry 1e-7 nm: two channels agreeing to the last digit by chance does not happen twice.
    (copies >= 3).then(|| format!("{copies} readings repeat another to the last digit in both channels; copied rows are no replicates."))
}

/// Runs stages 0 to 11.
///
/// # Errors
/// Where the wire's description cannot be used or the declared model has no solution at the poses.
pub fn verify_whisker(
    session: &str,
    data: &WhiskerData,
    inputs: &[InputFile],
    options: &VerifyOptions,
) -> Result<Result<WhiskerVerification, VerifyDocument>, TraceError> {
    let seed = options.search.seed;
    if let Some(reason) = unusable(data) {
        let mut document = VerifyDocument::refused(session, "whisker", reason, seed);
        document.inputs = inputs.to_vec();
        return Ok(Err(document));
    }
    let rows: Vec<&WhiskerRow> = data.rows.iter().collect();
    let system = WhiskerSystem::new(data, &rows)?;
    // Stage 0: the twin before reality.
    let labels = check_labels(data, &system.path, &system.bench);
    // Stages 2-9: the points table only; the holdout stays sealed.
    let no_solution = || TraceError::NoEquilibrium(session.to_owned());
    let weights = weights_of(&system);
    let declared = fit(&system, &[], &weights, 15).ok_or_else(no_solution)?;
    let mut system = system.apart(&declared);
    let mut found = search(&system, &weights, &options.search).ok_or_else(no_solution)?;
    let mut conclusion = conclude(&system, &found, &labels.faults);
    // An effect that was not declared hides how much noise the channels share.
    let again = system.clone().apart(&conclusion.accepted.fit);
    if again.mixture_change(&system) > MIXTURE_CHANGED {
        system = again;
        found = search(&system, &weights, &options.search).ok_or_else(no_solution)?;
        conclusion = conclude(&system, &found, &labels.faults);
    }
    if !options.accept.is_empty() {
        conclusion.accept(&system, &found, &options.accept)?;
    }
    // Stage 1 on the residuals of the accepted model.
    let floor = noise_floor(&system, &conclusion.accepted);
    let model_before = PhysicalModel::new(&system, &found.base);
    let model_after = PhysicalModel::new(&system, &conclusion.accepted);
    // Stage 11: the seal is broken here, once.
    let all_rows: Vec<&WhiskerRow> = data.rows.iter().chain(&data.holdout).collect();
    let whole = WhiskerSystem::new(data, &all_rows)?.mixed_as(&system);
    let before = predict(&whole, &found.base, &model_before).ok_or_else(no_solution)?;
    let after = predict(&whole, &conclusion.accepted, &model_after).ok_or_else(no_solution)?;
    if let Some(p) = holdout_p(&whole, &conclusion.accepted, &after).filter(|p| *p < HOLDOUT_LEVEL) {
        conclusion.contradicted(p, !options.accept.is_empty());
    }
    let errors = held_out_errors(
        data,
        &system,
        &whole,
        &found,
        &conclusion,
        &before,
        &after,
        &model_before.sensitivity(),
        !options.accept.is_empty(),
        seed,
    );
    let document = document(
        session,
        data,
        inputs,
        options,
        &system,
        &found,
        &conclusion,
        &labels,
        floor,
        &model_after,
        &errors,
    );
    let predictions = prediction_rows(&whole, &all_rows, &before, &after);
    let residuals = records(&whole, &all_rows, &before, &after, model_after.noise_sd_pm, &conclusion);
    let branches = branches(&system);
    let isolability = isolability(&system, &found);
    Ok(Ok(WhiskerVerification {
        document,
        predictions,
        residuals,
        labels,
        model: model_after,
        found,
        further: errors.further,
        branches,
        isolability,
    }))
}

/// Readings with larger known sample noise count less; the common part is not known yet, so only the worst ones feel it.
fn weights_of(system: &WhiskerSystem) -> Weights {
    let known = system.known_noise();
    let mut sizes: Vec<f64> = known.row_iter().map(|r| r.norm()).collect();
    let own = sizes.clone();
    sizes.sort_by(f64::total_cmp);
    let typical = sizes[sizes.len() / 2];
    if typical <= 0.0 {
        return Weights::equal(own.len());
    }
    // Sample noise is a small part of the point-to-point noise; readings with ten times the usual are averaged over far fewer samples.
    Weights(own.iter().map(|s| if *s > 10.0 * typical { 10.0 * typical / s } else { 1.0 }).collect())
}

#[allow(clippy::too_many_arguments)]
fn document(
    session: &str,
    data: &WhiskerData,
    inputs: &[InputFile],
    options: &VerifyOptions,
    system: &WhiskerSystem,
    found: &Found,
    conclusion: &Conclusion,
    labels: &LabelReport,
    floor: Option<Floor>,
    model: &PhysicalModel,
    errors: &Errors,
) -> VerifyDocument {
    let gain = model.sensitivity().determinant().abs().sqrt();
    let mut notes = Vec::new();
    let mut reason = conclusion.reason.clone();
    if floor.is_none_or(|f| f.source != "replicates") {
        reason.push_str(
            " Provisional: the session has no replicates, so the noise floor is an estimate from neighbours.",
        );
    }
    reason.push_str(&errors.remark);
    if !conclusion.flagged.is_empty() {
        let points: Vec<String> =
            conclusion.flagged.iter().map(|&i| data.rows[system.path.rows[i]].point.to_string()).collect();
        notes.push(format!(
            "Readings marked and left out of the fit (kept in the table): points {}.",
            points.join(", ")
        ));
    }
    notes.push("Moments are in the twin's scale: an error of EI is absorbed by K.".to_owned());
    notes.extend(cross_check(system, found));
    notes.extend(between_seatings(system, &conclusion.accepted.fit).map(|b| b.note()));
    notes.extend(errors.further.iter().filter_map(|(name, e)| {
        Some(format!("Held-out wavelength error, {name}: {:.3} pm.", e.rmse.get("wavelength_rmse_pm")?))
    }));
    let same = in_class(found);
    let next_measurement = (conclusion.verdict == Verdict::Ambiguous)
        .then(|| {
            // Only what the poses are chosen against is promised to be separated.
            let others = found.survivors.iter().zip(&same).filter(|(_, s)| !**s).map(|(h, _)| h);
            let rivals: Vec<&Hypothesis> = others.take(next::RIVALS).collect();
            if rivals.is_empty() {
                return None;
            }
            let names = |h: &Hypothesis| {
                h.fit
                    .terms
                    .iter()
                    .map(|t| system.catalogue()[t.effect].id())
                    .collect::<Vec<_>>()
                    .join(" with ")
            };
            let all = std::iter::once(&found.best).chain(rivals.iter().copied()).map(names).collect();
            next::next_measurement(system, &found.best, &rivals, all)
        })
        .flatten();
    VerifyDocument {
        format: VERIFY_FORMAT.to_owned(),
        simulated: false,
        session: session.to_owned(),
        kind: "whisker".to_owned(),
        verdict: conclusion.verdict,
        reason,
        twin: TwinCheck { faults: labels.faults.clone() },
        effects: conclusion.effects.clone(),
        alternatives: conclusion.alternatives.clone(),
        unknown: conclusion.unknown.clone(),
        noise_floor: NoiseFloor {
            wavelength_pm: floor.map(|f| f.sd_pm),
            moment_nmm: floor.filter(|_| gain > 0.0).map(|f| f.sd_pm / gain),
            source: floor.map_or("none", |f| f.source).to_owned(),
            ..NoiseFloor::default()
        },
        before: errors.before.clone(),
        after: errors.after.clone(),
        coverage95: errors.coverage95,
        next_measurement,
        detectable: detect::table(system, &found.best.fit, &found.last_gate),
        seed: options.search.seed,
        inputs: inputs.to_vec(),
        notes,
    }
}

/// What the group lasso keeps on the declared model's residual.
fn cross_check(system: &WhiskerSystem, found: &Found) -> Option<String> {
    let base = &found.base.fit;
    let sd = found.best.fit.variance().sqrt();
    let kept = group_lasso(&found.first_gate.atoms, &stack(&base.residual), base.dof, sd)?;
    let names: Vec<String> =
        kept.iter().map(|k| format!("{} ({:.1} sd)", system.catalogue()[k.effect].id(), k.size_sd)).collect();
    let list = if names.is_empty() { "nothing".to_owned() } else { names.join(", ") };
    Some(format!("Cross-check by group lasso over the whole catalogue at the noise level: it keeps {list}."))
}
