//! The residual loop for kind "whisker", stage by stage.

use super::between::between_seatings;
use super::floor::{Floor, noise_floor};
use super::heldout::wavelength_rmse_pm;
use super::holdout_check::{self, holdout_p};
use super::listings::{Branch, PredictionRow, branches, isolability, prediction_rows, records};
use super::noise_report::{noise_document, noise_sentences};
use super::physical::PhysicalModel;
use super::predictions::{Predicted, held_out, predict};
use super::twin_check::{LabelReport, check_labels};
use super::unseal::{Errors, held_out_errors};
use super::verdict::{Conclusion, conclude};
use super::{detect, next};
use crate::candidate::System;
use crate::engine::explain::{Explained, explain};
use crate::engine::fit::Weights;
use crate::engine::inference::in_class;
use crate::engine::lasso::group_lasso;
use crate::engine::linear::stack;
use crate::engine::noise_parts::Noise;
use crate::engine::search::{Found, Hypothesis, Options, declared};
use crate::error::TraceError;
use crate::whisker::WhiskerSystem;
use std::collections::BTreeMap;
use wcal_core::observation::{Role, WhiskerData, WhiskerRow};
use wcal_core::verify_document::{
    FlaggedReading, HeldOutError, NoiseFloor, TwinCheck, VERIFY_FORMAT, Verdict, VerifyDocument,
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
/// Rise of the sealed error with which accepted effects are no explanation.
const SEALED_RISE: f64 = 1.1;
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
        .filter(|h| h.sealed)
        .filter(|h| {
            data.rows.iter().any(|r| {
                r.role != Role::Rest && r.shift_pm == h.shift_pm && r.stage_mm == h.stage_mm && r.t_s == h.t_s
            })
        })
        .count();
    if copied > 0 {
        return Some(format!(
            "{copied} rows of the holdout are also in the points table; a holdout that was in the fit proves nothing."
        ));
    }
    copied_rows(&data.rows)
}

/// Rows that repeat another in every column, clock included. Without a clock, rounded readings agree by chance: then copies are no evidence.
fn copied_rows(rows: &[WhiskerRow]) -> Option<String> {
    if rows.iter().any(|r| r.t_s.is_none()) && rows.iter().any(|r| r.replicate.is_none()) {
        return None;
    }
    let mut seen: BTreeMap<String, usize> = BTreeMap::new();
    for r in rows {
        // The point is the row's name and the line its place: neither was measured.
        let row =
            WhiskerRow { point: 0, line: 0, role: Role::Calibration, source: String::new(), ..r.clone() };
        *seen.entry(format!("{row:?}")).or_default() += 1;
    }
    let copies: usize = seen.values().map(|c| c - 1).sum();
    (copies >= 3).then(|| {
        format!("{copies} readings repeat another in every column, the clock included; copied rows are no replicates.")
    })
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
    let known = Weights::independent(system.noise_inputs().known);
    let base = declared(&system, &known, seed).ok_or_else(no_solution)?;
    let mut system = system.apart(&base.fit);
    let mut explained = explain(&system, &options.search).ok_or_else(no_solution)?;
    let mut conclusion = conclude(&system, &explained.found, &labels.faults);
    // An effect that was not declared hides how much noise the channels share.
    let again = system.clone().apart(&conclusion.accepted.fit);
    if again.mixture_change(&system) > MIXTURE_CHANGED {
        system = again;
        explained = explain(&system, &options.search).ok_or_else(no_solution)?;
        conclusion = conclude(&system, &explained.found, &labels.faults);
    }
    let Explained { found, mut noise, declared_noise, .. } = explained;
    if !options.accept.is_empty() {
        conclusion.accept(&system, &found, &options.accept)?;
    }
    // Stage 1 on the residuals of the accepted model.
    let mut floor = noise_floor(&system, &conclusion.accepted, &noise, found.left().is_some());
    let noise_sd_pm = floor.map_or_else(|| noise.repeat.value * system.noise_factor(), |f| f.sd_pm);
    let model_before = PhysicalModel::new(&system, &found.base, noise_sd_pm);
    let model_after = PhysicalModel::new(&system, &conclusion.accepted, noise_sd_pm);
    // Stage 11: the seal is broken here, once.
    let all_rows: Vec<&WhiskerRow> = data.rows.iter().chain(&data.holdout).collect();
    let whole = WhiskerSystem::new(data, &all_rows)?.mixed_as(&system);
    let factor = whole.noise_factor();
    let reading_sd_pm: Vec<f64> =
        noise.reading_sd(&whole.noise_inputs()).into_iter().map(|sd| sd * factor).collect();
    let before = predict(&whole, &found.base, &model_before, &reading_sd_pm).ok_or_else(no_solution)?;
    let after =
        predict(&whole, &conclusion.accepted, &model_after, &reading_sd_pm).ok_or_else(no_solution)?;
    let mut left_out = holdout_check::flagged(&whole, &noise, &after);
    let mut after = after;
    let mut model_after = model_after;
    let sealed_rmse =
        |p: &[Predicted], left_out: &[usize]| wavelength_rmse_pm(&held_out(&whole, p, left_out));
    let errors = [sealed_rmse(&before, &left_out), sealed_rmse(&after, &left_out)];
    if options.accept.is_empty()
        && !conclusion.accepted.fit.terms.is_empty()
        && errors[1] > SEALED_RISE * errors[0]
    {
        // The sealed error has the last word.
        noise = declared_noise;
        floor = noise_floor(&system, &found.base, &noise, false);
        let noise_sd_pm = floor.map_or_else(|| noise.repeat.value * system.noise_factor(), |f| f.sd_pm);
        model_after = PhysicalModel::new(&system, &found.base, noise_sd_pm);
        let reading_sd_pm: Vec<f64> =
            noise.reading_sd(&whole.noise_inputs()).into_iter().map(|sd| sd * factor).collect();
        after = predict(&whole, &found.base, &model_after, &reading_sd_pm).ok_or_else(no_solution)?;
        left_out = holdout_check::flagged(&whole, &noise, &after);
        let p = holdout_p(&whole, &found.base, &noise, &after, &left_out);
        conclusion.withdrawn(&found.base, errors, p.is_some_and(|p| p < holdout_check::HOLDOUT_LEVEL));
    }
    if let Some(p) = holdout_p(&whole, &conclusion.accepted, &noise, &after, &left_out)
        .filter(|p| *p < holdout_check::HOLDOUT_LEVEL)
    {
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
        noise_sd_pm,
        &left_out,
        !options.accept.is_empty(),
        seed,
    );
    let mut document = document(
        session,
        data,
        inputs,
        options,
        &system,
        &found,
        &noise,
        &conclusion,
        &labels,
        floor,
        &model_after,
        &errors,
    );
    document.flagged.extend(left_out.iter().map(|&i| {
        let row = all_rows[whole.path.rows[i]];
        FlaggedReading { source: row.source.clone(), point: row.point }
    }));
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

#[allow(clippy::too_many_arguments)]
fn document(
    session: &str,
    data: &WhiskerData,
    inputs: &[InputFile],
    options: &VerifyOptions,
    system: &WhiskerSystem,
    found: &Found,
    noise: &Noise,
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
            " Provisional: no loaded pose was set again, so the noise floor is an estimate from neighbours.",
        );
    }
    notes.extend(floor.and_then(|f| f.remark()));
    reason.push_str(&errors.remark);
    if !conclusion.flagged.is_empty() {
        let points: Vec<String> =
            conclusion.flagged.iter().map(|&i| data.rows[system.path.rows[i]].point.to_string()).collect();
        notes.push(format!(
            "Readings marked and left out of the fit (kept in the table): points {}.",
            points.join(", ")
        ));
    }
    notes.extend(noise_sentences(&noise_document(noise, "pm")));
    notes.push("Moments are in the twin's scale: an error of EI is absorbed by K.".to_owned());
    notes.extend(cross_check(system, found));
    notes.extend(between_seatings(system, &conclusion.accepted.fit).map(|b| b.note()));
    notes.extend(errors.further.iter().filter_map(|(name, e)| {
        Some(format!("Held-out wavelength error, {name}: {:.3} pm.", e.rmse.get("wavelength_rmse_pm")?))
    }));
    let same = in_class(system, found);
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
        noise: Some(noise_document(noise, "pm")),
        flagged: conclusion
            .flagged
            .iter()
            .map(|&i| {
                let row = &data.rows[system.path.rows[i]];
                FlaggedReading { source: row.source.clone(), point: row.point }
            })
            .collect(),
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
