//! The verdict of a scalar session, in the order of FORMATS.md.

use super::effects::HETEROSCEDASTIC_NOISE;
use super::frame::Declared;
use super::parameters::{Names, of_effect};
use super::polynomial::LackOfFit;
use super::steadiness::{UNSTEADY, steadiness};
use super::system::ScalarSystem;
use crate::candidate::System;
use crate::engine::fit::fit;
use crate::engine::gate::{CATALOGUE_LEVEL, Gate};
use crate::engine::inference::in_class;
use crate::engine::null::f_test;
use crate::engine::search::{Found, Hypothesis};
use crate::engine::spread::{Spread, SpreadLaw};
use wcal_core::verify_document::{EffectParameter, NamedEffect, UnknownEffect, Verdict};

/// Conclusion in parts.
#[derive(Debug, Clone)]
pub struct Conclusion {
    /// Verdict.
    pub verdict: Verdict,
    /// One plain sentence.
    pub reason: String,
    /// Effects of the accepted explanation.
    pub effects: Vec<NamedEffect>,
    /// Every surviving explanation, best first.
    pub alternatives: Vec<Vec<String>>,
    /// Rivals of the best that are not of its class.
    pub rivals: Vec<Hypothesis>,
    /// What drives an unexplained rest.
    pub unknown: Option<UnknownEffect>,
    /// The explanation that predictions use.
    pub accepted: Hypothesis,
}

/// Level of the lack-of-fit test against replicates.
pub const LACK_OF_FIT_LEVEL: f64 = 0.002;

pub(super) fn outliers(system: &ScalarSystem) -> Option<usize> {
    system.catalogue().iter().position(|c| c.id() == "outliers")
}

fn ids(system: &ScalarSystem, h: &Hypothesis) -> Vec<String> {
    h.effects(outliers(system)).iter().map(|&e| system.catalogue()[e].id().to_owned()).collect()
}

/// p-value of dropping `effect`, the rest refitted, adjusted by the first gate's family.
fn removal_p(system: &ScalarSystem, found: &Found, h: &Hypothesis, effect: usize) -> f64 {
    if Some(effect) == outliers(system) {
        return h.flag_p;
    }
    let terms: Vec<_> = h.fit.terms.iter().filter(|t| t.effect != effect).cloned().collect();
    let Some(without) = fit(system, &terms, &h.weights, 15) else { return 1.0 };
    let extra = (without.dof - h.fit.dof).max(1.0) as usize;
    found.first_gate.family.adjusted(f_test(without.ssr - h.fit.ssr, without.ssr, without.dof, extra))
}

fn named(system: &ScalarSystem, found: &Found, names: &Names) -> Vec<NamedEffect> {
    let o = outliers(system);
    let best = &found.best;
    let own = best.effects(o);
    let mates: Vec<Vec<usize>> = found
        .survivors
        .iter()
        .zip(in_class(system, found))
        .filter(|(_, s)| *s)
        .map(|(h, _)| h.effects(o))
        .collect();
    own.iter()
        .map(|&e| {
            let candidate = &system.catalogue()[e];
            let mut class = vec![candidate.id().to_owned()];
            for mate in &mates {
                // A mate with one other effect in place of this one shares its class.
                let common = own.iter().filter(|x| mate.contains(x)).count();
                if !mate.contains(&e) && common + 1 == own.len() && mate.len() == own.len() {
                    class.extend(
                        mate.iter()
                            .filter(|t| !own.contains(t))
                            .map(|&t| system.catalogue()[t].id().to_owned()),
                    );
                }
            }
            class.dedup();
            NamedEffect {
                id: candidate.id().to_owned(),
                class,
                p_value: removal_p(system, found, best, e),
                parameters: of_effect(system, &best.fit, e, names),
                sentence: system.frame.declared.worded(candidate.sentence()),
            }
        })
        .collect()
}

fn named_spread(system: &ScalarSystem, spread: &Spread) -> NamedEffect {
    let name = match spread.law {
        SpreadLaw::Power => "exponent",
        SpreadLaw::Exponential => "log_sd_per_half_range",
    };
    let sentence =
        system.catalogue().iter().find(|c| c.id() == HETEROSCEDASTIC_NOISE).map_or("", |c| c.sentence());
    NamedEffect {
        id: HETEROSCEDASTIC_NOISE.to_owned(),
        class: vec![HETEROSCEDASTIC_NOISE.to_owned()],
        p_value: spread.p_value,
        parameters: vec![EffectParameter {
            name: name.to_owned(),
            value: spread.exponent,
            unit: "1".to_owned(),
            interval95: spread.interval95,
        }],
        sentence: system.frame.declared.worded(sentence),
    }
}

fn unknown(gate: &Gate) -> Option<UnknownEffect> {
    let first = gate.drivers.first()?;
    Some(UnknownEffect {
        driver: first.driver.clone(),
        shape: first.shape.to_owned(),
        drivers_ranked: gate.drivers.iter().map(|d| d.driver.clone()).collect(),
        period: first.period,
    })
}

fn unknown_reason(u: Option<&UnknownEffect>, beyond: &[String]) -> String {
    let beyond = if beyond.is_empty() { String::new() } else { format!(" beyond {}", beyond.join(" and ")) };
    let follows = u.map_or(String::new(), |u| format!("; it follows {} ({})", u.driver, u.shape));
    format!("Something{beyond} is left that nothing in the catalogue explains{follows}.")
}

/// Covariates over which a period can run.
const PERIOD_RUNS_OVER: [&str; 4] = ["stimulus", "commanded_mm", "t_s", "order"];

/// Applies the order of FORMATS.md: ambiguous, effect, unknown-effect, adequate.
#[must_use]
pub fn conclude(
    system: &ScalarSystem,
    found: &Found,
    spread: Option<&Spread>,
    lack: Option<&LackOfFit>,
    names: &Names,
) -> Conclusion {
    let best_ids = ids(system, &found.best);
    let with_spread = |mut v: Vec<String>| {
        v.extend(spread.map(|_| HETEROSCEDASTIC_NOISE.to_owned()));
        v
    };
    let mut c = Conclusion {
        verdict: Verdict::Adequate,
        reason: String::new(),
        effects: Vec::new(),
        alternatives: Vec::new(),
        rivals: Vec::new(),
        unknown: None,
        accepted: found.best.clone(),
    };
    let driver_wins = found.driver_beats_catalogue;
    if !best_ids.is_empty() && !driver_wins {
        c.effects = named(system, found, names);
        c.alternatives = found.survivors.iter().map(|h| with_spread(ids(system, h))).collect();
        c.rivals = found
            .survivors
            .iter()
            .zip(in_class(system, found))
            .filter(|(_, s)| !*s)
            .map(|(h, _)| h.clone())
            .collect();
    } else {
        c.accepted = found.base.clone();
        c.alternatives = if spread.is_some() { vec![with_spread(Vec::new())] } else { Vec::new() };
    }
    c.effects.extend(spread.map(|s| named_spread(system, s)));
    // A period that wanders leaves its own traces along what it runs over; the reason says that it is not steady.
    let wanders = steadiness(system, &found.best).is_some_and(|s| s.z > UNSTEADY)
        && found.last_gate.drivers.first().is_some_and(|d| PERIOD_RUNS_OVER.contains(&d.driver.as_str()))
        && found.last_gate.p_catalogue >= CATALOGUE_LEVEL;
    let gate_left = driver_wins || (found.last_gate.rejected() && !wanders);
    let unlike_replicates = lack.is_some_and(|l| l.p_value < LACK_OF_FIT_LEVEL);
    if !c.rivals.is_empty() {
        c.verdict = Verdict::Ambiguous;
        let all: Vec<String> = c.alternatives.iter().map(|a| a.join(" with ")).collect();
        c.reason = format!("The data ask for an effect but cannot decide between {}.", all.join("; "));
    } else if gate_left {
        c.verdict = Verdict::UnknownEffect;
        c.unknown = unknown(if driver_wins { &found.first_gate } else { &found.last_gate });
        c.reason =
            unknown_reason(c.unknown.as_ref(), &c.effects.iter().map(|e| e.id.clone()).collect::<Vec<_>>());
    } else if unlike_replicates {
        let driver = if system.frame.declared == Declared::Axis { "commanded_mm" } else { "stimulus" };
        c.verdict = Verdict::UnknownEffect;
        c.unknown = Some(UnknownEffect {
            driver: driver.to_owned(),
            shape: "irregular".to_owned(),
            drivers_ranked: vec![driver.to_owned()],
            period: None,
        });
        c.reason =
            unknown_reason(c.unknown.as_ref(), &c.effects.iter().map(|e| e.id.clone()).collect::<Vec<_>>());
    } else if c.effects.is_empty() {
        let p = found.first_gate.p_value();
        c.reason = format!("Nothing beyond noise is left by the declared model (omnibus p = {p:.2}).");
    } else {
        c.verdict = Verdict::Effect;
        c.reason = c.effects.iter().map(|e| e.sentence.as_str()).collect::<Vec<_>>().join(" ");
    }
    c
}
