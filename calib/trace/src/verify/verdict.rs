//! The verdict from what the search found, in the order of FORMATS.md.

use crate::candidate::System;
use crate::engine::gate::Gate;
use crate::engine::inference::{in_class, parameters};
use crate::engine::null::f_test;
use crate::engine::search::{Found, Hypothesis};
use crate::error::TraceError;
use crate::whisker::WhiskerSystem;
use wcal_core::verify_document::{NamedEffect, TwinFault, UnknownEffect, Verdict};

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
    /// What drives an unexplained rest.
    pub unknown: Option<UnknownEffect>,
    /// The explanation that predictions use.
    pub accepted: Hypothesis,
    /// Readings marked as outliers.
    pub flagged: Vec<usize>,
}

impl Conclusion {
    /// Takes the surviving explanation with exactly the effects `asked`.
    ///
    /// # Errors
    /// Where no surviving explanation has these effects.
    pub fn accept(
        &mut self,
        system: &WhiskerSystem,
        found: &Found,
        asked: &[String],
    ) -> Result<(), TraceError> {
        let mut wanted = asked.to_vec();
        wanted.sort_unstable();
        let same = |h: &&Hypothesis| {
            let mut own = ids(system, h);
            own.sort_unstable();
            own == wanted
        };
        let Some(chosen) = found.survivors.iter().find(same) else {
            let survivors: Vec<String> = self.alternatives.iter().map(|a| a.join(",")).collect();
            return Err(TraceError::NotASurvivor {
                asked: asked.join(","),
                survivors: if survivors.is_empty() { "none".to_owned() } else { survivors.join("; ") },
            });
        };
        self.effects = named(system, found, chosen, &[]);
        self.accepted = chosen.clone();
        self.flagged = chosen.flagged.clone();
        self.reason = format!("Accepted by request: {}. {}", join(asked), self.reason);
        Ok(())
    }

    /// The accepted effects make the unsealed readings worse: they are no explanation, and nothing of them stays accepted.
    pub fn withdrawn(&mut self, base: &Hypothesis, [before, after]: [f64; 2], contradicted: bool) {
        let names: Vec<String> = self.effects.iter().map(|e| e.id.clone()).collect();
        let found = format!(
            "The calibration readings asked for {}, but with it the held-out error rises from {before:.3} to {after:.3} pm: it is not accepted.",
            join(&names)
        );
        self.effects = Vec::new();
        self.alternatives = Vec::new();
        self.accepted = base.clone();
        self.flagged = base.flagged.clone();
        (self.verdict, self.reason) = if contradicted {
            (
                Verdict::UnknownEffect,
                format!("{found} Something is left that nothing in the catalogue explains."),
            )
        } else {
            (
                Verdict::Adequate,
                format!("The declared model and the noise explain the held-out readings. {found}"),
            )
        };
    }

    /// The unsealed readings contradict the accepted model: nothing may be called adequate, explained or accepted on request then.
    /// No driver is named: the calibration readings show none.
    pub fn contradicted(&mut self, p: f64, on_request: bool) {
        let claimed = match self.verdict {
            Verdict::Adequate | Verdict::Effect | Verdict::TwinFault => true,
            Verdict::Ambiguous => on_request,
            _ => false,
        };
        if !claimed {
            return;
        }
        self.verdict = Verdict::UnknownEffect;
        self.reason = format!(
            "The held-out readings contradict what the calibration readings allow (p = {p:.1e}): something acts there that \
             the calibration poses do not show. {}",
            self.reason
        );
    }
}

fn outliers(system: &WhiskerSystem) -> Option<usize> {
    system.catalogue().iter().position(|c| c.id() == crate::effects::SLIP_OUTLIERS)
}

fn ids(system: &WhiskerSystem, h: &Hypothesis) -> Vec<String> {
    h.effects(outliers(system)).iter().map(|&e| system.catalogue()[e].id().to_owned()).collect()
}

fn join(ids: &[String]) -> String {
    match ids {
        [] => "nothing".into(),
        [one] => one.clone(),
        [head @ .., last] => format!("{} and {last}", head.join(", ")),
    }
}

/// p-value of dropping `effect` from `h`, every other parameter refitted, adjusted by the first gate's family.
fn removal_p(system: &WhiskerSystem, found: &Found, h: &Hypothesis, effect: usize) -> f64 {
    if Some(effect) == outliers(system) {
        return h.flag_p;
    }
    let terms: Vec<_> = h.fit.terms.iter().filter(|t| t.effect != effect).cloned().collect();
    let Some(without) = crate::engine::fit::fit(system, &terms, &h.weights, 15) else { return 1.0 };
    let extra = without.dof - h.fit.dof;
    let single = f_test(without.ssr - h.fit.ssr, without.ssr, without.dof, extra.max(1.0) as usize);
    found.first_gate.family.adjusted(single)
}

/// Names the effects of `h`; `class` comes from the survivors of its class.
fn named(
    system: &WhiskerSystem,
    found: &Found,
    h: &Hypothesis,
    classmates: &[&Hypothesis],
) -> Vec<NamedEffect> {
    let o = outliers(system);
    let own = h.effects(o);
    own.iter()
        .map(|&e| {
            let mut class = vec![system.catalogue()[e].id().to_owned()];
            for mate in classmates {
                let theirs = mate.effects(o);
                // The mate has other effects in place of some of ours: those replace this one if the rest is common.
                let common = own.iter().filter(|x| theirs.contains(x)).count();
                if !theirs.contains(&e) && common + 1 == own.len() {
                    for t in theirs.iter().filter(|t| !own.contains(t)) {
                        let id = system.catalogue()[*t].id().to_owned();
                        if !class.contains(&id) {
                            class.push(id);
                        }
                    }
                }
            }
            NamedEffect {
                id: system.catalogue()[e].id().to_owned(),
                class,
                p_value: removal_p(system, found, h, e),
                parameters: parameters(system, h, e),
                sentence: system.catalogue()[e].sentence().to_owned(),
            }
        })
        .collect()
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

/// Applies the order of FORMATS.md: ambiguous, effect, unknown-effect, twin-fault, adequate.
#[must_use]
pub fn conclude(system: &WhiskerSystem, found: &Found, faults: &[TwinFault]) -> Conclusion {
    let same = in_class(system, found);
    let classmates: Vec<&Hypothesis> =
        found.survivors.iter().zip(&same).filter(|(_, s)| **s).map(|(h, _)| h).collect();
    let alternatives: Vec<Vec<String>> = found.survivors.iter().map(|h| ids(system, h)).collect();
    let something = !ids(system, &found.best).is_empty();
    let left = found.last_gate.rejected();
    let plain = |verdict, reason, accepted: &Hypothesis| Conclusion {
        verdict,
        reason,
        effects: Vec::new(),
        alternatives: Vec::new(),
        unknown: None,
        accepted: accepted.clone(),
        flagged: accepted.flagged.clone(),
    };
    if found.driver_beats_catalogue || (left && !something) {
        let mut c = plain(Verdict::UnknownEffect, String::new(), &found.base);
        c.unknown = unknown(&found.first_gate);
        c.reason = unknown_reason(&c.unknown, "");
        return c;
    }
    if !something {
        return if faults.is_empty() {
            let p = found.first_gate.p_value();
            plain(
                Verdict::Adequate,
                format!("Nothing beyond noise is left by the declared model (omnibus p = {p:.2})."),
                &found.base,
            )
        } else {
            let count: usize = faults.iter().map(|f| f.points.len()).sum();
            plain(
                Verdict::TwinFault,
                format!(
                    "{count} labels of the outside twin are faulty; with them repaired nothing else is found."
                ),
                &found.base,
            )
        };
    }
    let effects = named(system, found, &found.best, &classmates);
    let mut c = Conclusion { effects, alternatives, ..plain(Verdict::Effect, String::new(), &found.best) };
    if same.iter().any(|s| !s) {
        c.verdict = Verdict::Ambiguous;
        let names: Vec<String> = c.alternatives.iter().map(|a| a.join(" with ")).collect();
        c.reason = format!("The data ask for an effect but cannot decide between {}.", names.join("; "));
    } else if left {
        c.verdict = Verdict::UnknownEffect;
        c.unknown = unknown(&found.last_gate);
        c.reason = unknown_reason(&c.unknown, &format!(" beyond {}", join(&ids(system, &found.best))));
    } else {
        let sentences: Vec<&str> = c.effects.iter().map(|e| e.sentence.as_str()).collect();
        c.reason = sentences.join(" ");
    }
    c
}

fn unknown_reason(unknown: &Option<UnknownEffect>, beyond: &str) -> String {
    match unknown {
        Some(u) => format!(
            "Something{beyond} is left that nothing in the catalogue explains; it follows {} ({}).",
            u.driver, u.shape
        ),
        None => format!("Something{beyond} is left that nothing in the catalogue explains."),
    }
}
