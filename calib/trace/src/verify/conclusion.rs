//! The verdict from what the search found, in the order of docs/src/formats.md.

use super::session_model::SessionModel;
use super::support::supported;
use crate::effect::{EffectTerm, LawRequirement};
use crate::error::TraceError;
use crate::method::hypothesis::{Hypothesis, SearchResult};
use crate::method::inference::in_class;
use crate::method::omnibus::{CovariateScore, LACK_OF_FIT_LEVEL, OmnibusTest};
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
    /// Surviving explanations that are not of the best one's class.
    pub rivals: Vec<Hypothesis>,
    /// What drives an unexplained rest.
    pub unknown: Option<UnknownEffect>,
    /// The explanation that predictions use.
    pub accepted: Hypothesis,
}

impl Conclusion {
    /// Nothing but rounding is left: structure in it means nothing.
    pub fn exact(base: &Hypothesis) -> Self {
        Self {
            verdict: Verdict::Adequate,
            reason: "The declared model fits to the last digit.".to_owned(),
            effects: Vec::new(),
            alternatives: Vec::new(),
            rivals: Vec::new(),
            unknown: None,
            accepted: base.clone(),
        }
    }

    /// Takes the surviving explanation with exactly the effects `asked`.
    ///
    /// # Errors
    /// Where no surviving explanation has these effects.
    pub fn accept<M: SessionModel>(
        &mut self,
        model: &M,
        found: &SearchResult,
        asked: &[String],
    ) -> Result<(), TraceError> {
        let mut wanted = asked.to_vec();
        wanted.sort_unstable();
        let same = |h: &&Hypothesis| {
            let mut own = ids(model, h);
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
        self.effects = named(model, found, chosen, &[]);
        self.accepted = chosen.clone();
        self.reason = format!("Accepted by request: {}. {}", join(asked), self.reason);
        Ok(())
    }

    /// The accepted effects make the unsealed readings worse: they are no explanation, and nothing of them stays accepted.
    pub fn withdrawn(&mut self, base: &Hypothesis, noise: Option<NamedEffect>, errors: &str, left: bool) {
        let names: Vec<String> = self.effects.iter().map(|e| e.id.clone()).collect();
        let found = format!(
            "The fitted readings support {}, but the held-out error {errors} with it: not accepted.",
            join(&names)
        );
        self.alternatives = noise.iter().map(|e| vec![e.id.clone()]).collect();
        self.effects = noise.into_iter().collect();
        self.rivals = Vec::new();
        self.accepted = base.clone();
        (self.verdict, self.reason) = if left {
            let left = "A residual remains that no catalogued effect explains.";
            (Verdict::UnknownEffect, format!("{found} {left}"))
        } else if self.effects.is_empty() {
            let enough = "The declared model and the noise explain the readings.";
            (Verdict::Adequate, format!("{enough} {found}"))
        } else {
            (Verdict::Effect, format!("{} {found}", self.effects[0].sentence))
        };
    }

    /// Effects that are none are dropped: nothing of them stays accepted.
    pub fn only_supported<M: SessionModel>(&mut self, model: &M, found: &SearchResult) {
        if self.verdict == Verdict::Ambiguous || self.accepted.fit.terms.is_empty() {
            return;
        }
        let kept = supported(model, found, &self.accepted);
        if kept.fit.terms.len() == self.accepted.fit.terms.len() {
            return;
        }
        let noise = model.noise_effect();
        self.effects = named(model, found, &kept, &[]);
        self.effects.extend(noise);
        self.alternatives = vec![self.effects.iter().map(|e| e.id.clone()).collect()];
        self.alternatives.retain(|a| !a.is_empty());
        self.accepted = kept;
        if self.verdict == Verdict::Effect {
            (self.verdict, self.reason) = if self.effects.is_empty() {
                (Verdict::Adequate, "Nothing that the data support is left by the declared model.".to_owned())
            } else {
                (Verdict::Effect, sentences(&self.effects))
            };
        }
    }

    /// The model is not accepted, whatever the fitted readings say; effects that were found stay listed.
    pub fn not_accepted(&mut self, why: &str) {
        self.verdict = Verdict::UnknownEffect;
        self.reason = format!("{why} {}", self.reason);
    }

    /// The unsealed readings contradict the accepted model: nothing may be called adequate, explained or accepted on request then.
    /// No driver is named: the fitted readings show none.
    pub fn contradicted(&mut self, p: f64, on_request: bool) {
        if self.claims(on_request) {
            self.not_accepted(&format!(
                "The held-out readings contradict what the fitted readings allow (p = {p:.1e}): something acts there that they do not show."
            ));
        }
    }

    /// Whether the verdict claims that a model holds.
    pub fn claims(&self, on_request: bool) -> bool {
        match self.verdict {
            Verdict::Adequate | Verdict::Effect | Verdict::TwinFault => true,
            Verdict::Ambiguous => on_request,
            Verdict::UnknownEffect | Verdict::Refused => false,
        }
    }
}

/// Identifiers of an explanation's effects, flagged readings among them.
pub fn ids<M: SessionModel>(model: &M, h: &Hypothesis) -> Vec<String> {
    h.effects(model.outliers()).iter().map(|&e| model.catalogue()[e].id.to_owned()).collect()
}

/// Law of a term, and its further column.
fn law<M: SessionModel>(model: &M, t: &EffectTerm) -> String {
    let effect = &model.catalogue()[t.effect];
    let column = effect.column(t.law, model.further_columns()).map_or(String::new(), |c| format!(" {c}"));
    format!("{}{column}", model.law_name(effect.law(t.law).name))
}

/// Names and laws of an explanation's terms.
pub fn laws<M: SessionModel>(model: &M, h: &Hypothesis) -> Vec<String> {
    let of = |t: &EffectTerm| format!("{} {}", model.catalogue()[t.effect].id, law(model, t));
    h.fit.terms.iter().map(of).collect()
}

/// What drives an explanation's terms: what their laws need of the session, and their columns.
fn drivers<M: SessionModel>(model: &M, h: &Hypothesis) -> Vec<(usize, Vec<LawRequirement>, Option<String>)> {
    let driver = |t: &EffectTerm| {
        let effect = &model.catalogue()[t.effect];
        let column = effect.column(t.law, model.further_columns()).map(str::to_owned);
        (t.effect, effect.law(t.law).needs.clone(), column)
    };
    let mut all: Vec<_> = h.fit.terms.iter().map(driver).collect();
    all.sort_by_key(|(effect, needs, column)| (*effect, needs.len(), column.clone()));
    all
}

/// "a", "a and b", "a, b and c".
fn join(ids: &[String]) -> String {
    match ids {
        [] => "nothing".into(),
        [one] => one.clone(),
        [head @ .., last] => format!("{} and {last}", head.join(", ")),
    }
}

/// p-value of dropping `effect` from `h`, every other parameter refitted, adjusted by the first gate's family.
fn removal_p<M: SessionModel>(model: &M, found: &SearchResult, h: &Hypothesis, effect: usize) -> f64 {
    if Some(effect) == model.outliers() {
        return h.flag_p;
    }
    let without = h.without(model, |_, t| t.effect == effect, 15);
    without.map_or(1.0, |without| without.removal_p(&h.fit, &found.first_test.family))
}

/// Names the effects of `h`; `class` comes from the survivors of its class.
fn named<M: SessionModel>(
    model: &M,
    found: &SearchResult,
    h: &Hypothesis,
    classmates: &[&Hypothesis],
) -> Vec<NamedEffect> {
    let own = h.effects(model.outliers());
    let id = |e: usize| model.catalogue()[e].id.to_owned();
    let class_of = |e: usize| {
        let mut class = vec![id(e)];
        for mate in classmates {
            let theirs = mate.effects(model.outliers());
            // The mate has other effects in place of some of ours: those replace this one if the rest is common.
            let common = own.iter().filter(|x| theirs.contains(x)).count();
            if !theirs.contains(&e) && common + 1 == own.len() {
                let others: Vec<String> =
                    theirs.iter().filter(|t| !own.contains(t)).map(|t| id(*t)).collect();
                class.extend(others.into_iter().filter(|t| !class.contains(t)).collect::<Vec<_>>());
            }
        }
        class
    };
    own.iter()
        .map(|&e| NamedEffect {
            id: id(e),
            laws: h.fit.terms.iter().filter(|t| t.effect == e).map(|t| law(model, t)).collect(),
            class: class_of(e),
            p_value: removal_p(model, found, h, e),
            parameters: model.parameters(h, e),
            sentence: model.format_text(model.catalogue()[e].sentence),
        })
        .collect()
}

/// What the effects do, in their catalogue's words.
fn sentences(effects: &[NamedEffect]) -> String {
    effects.iter().map(|e| e.sentence.as_str()).collect::<Vec<_>>().join(" ")
}

fn unknown(test: &OmnibusTest) -> Option<UnknownEffect> {
    let first = test.covariates.first()?;
    Some(UnknownEffect {
        driver: first.covariate.clone(),
        shape: first.shape.to_owned(),
        drivers_ranked: test.covariates.iter().map(|d| d.covariate.clone()).collect(),
        period: first.period,
    })
}

fn unknown_reason(unknown: Option<&UnknownEffect>, beyond: &[NamedEffect]) -> String {
    let names: Vec<String> = beyond.iter().map(|e| e.id.clone()).collect();
    let beyond = if names.is_empty() { String::new() } else { format!(" beyond {}", join(&names)) };
    let follows = unknown.map_or(String::new(), |u| format!("; it follows {} ({})", u.driver, u.shape));
    format!("A residual{beyond} remains that no catalogued effect explains{follows}.")
}

/// Applies the order of docs/src/formats.md: ambiguous, unknown-effect, effect, twin-fault, adequate.
pub fn conclude<M: SessionModel>(model: &M, found: &SearchResult, faults: &[TwinFault]) -> Conclusion {
    // What a generic driver explains better than the catalogue does is named after no effect.
    let covariate_wins = found.covariate_beats_catalogue;
    let something = !ids(model, &found.best).is_empty() && !covariate_wins;
    let same = in_class(model, found);
    let part = |of_class: bool| -> Vec<&Hypothesis> {
        let all = found.survivors.iter().zip(&same);
        all.filter(|(_, s)| something && **s == of_class).map(|(h, _)| h).collect()
    };
    // The same names are rivals where something else drives them: a period over time, or over the stimulus.
    let (names, driven) = (ids(model, &found.best), drivers(model, &found.best));
    let other_driver = |h: &Hypothesis| ids(model, h) == names && drivers(model, h) != driven;
    let rivals = || {
        let all = found.survivors.iter().zip(&same).filter(|_| something);
        let rival =
            |(h, of_class): &(&Hypothesis, &bool)| other_driver(h) || (!**of_class && ids(model, h) != names);
        all.filter(rival).map(|(h, _)| h)
    };
    let noise = model.noise_effect();
    let with_noise = |mut ids: Vec<String>| {
        ids.extend(noise.as_ref().map(|e| e.id.clone()));
        ids
    };
    let mut effects = if something { named(model, found, &found.best, &part(true)) } else { Vec::new() };
    effects.extend(noise.clone());
    let mut listed = Vec::new();
    let mut alternatives: Vec<Vec<String>> = if something {
        let all = found.survivors.iter().filter(|h| {
            let own = (ids(model, h), drivers(model, h));
            let new = !listed.contains(&own);
            listed.push(own);
            new
        });
        all.map(|h| with_noise(ids(model, h))).collect()
    } else {
        vec![with_noise(Vec::new())]
    };
    alternatives.retain(|a| !a.is_empty());
    let mut c = Conclusion {
        verdict: Verdict::Adequate,
        reason: String::new(),
        effects,
        alternatives,
        rivals: rivals().cloned().collect(),
        unknown: None,
        accepted: found.accepted().clone(),
    };
    let left = covariate_wins || (found.last_test.rejected() && !model.residual_explained(found));
    let against_pure_error = model.lack_of_fit(&c.accepted);
    let p_lack_of_fit = against_pure_error.as_ref().map(|(l, _)| l.p_value);
    let lack = against_pure_error.filter(|(l, _)| l.p_value < LACK_OF_FIT_LEVEL);
    if !c.rivals.is_empty() && lack.is_none() {
        c.verdict = Verdict::Ambiguous;
        let mut names: Vec<String> = c.alternatives.iter().map(|a| a.join(" with ")).collect();
        if c.rivals.iter().any(other_driver) {
            names = std::iter::once(&found.best)
                .chain(&c.rivals)
                .map(|h| laws(model, h).join(" with "))
                .collect();
        }
        c.reason =
            format!("The data show an unmodelled effect; these explanations remain: {}.", names.join("; "));
    } else if left || lack.is_some() {
        c.verdict = Verdict::UnknownEffect;
        let test = if something { &found.last_test } else { &found.first_test };
        let clock = |s: &CovariateScore| matches!(s.covariate.as_str(), "order" | "t_s");
        let fitted = if something { &found.best } else { &found.base };
        // What repeats with the protocol follows its places, not the clock that counts them.
        let protocol = |s: &CovariateScore| clock(s) && model.repeats_with_protocol(fitted, &s.columns);
        let by_place = lack.is_some() && test.covariates.first().is_none_or(protocol);
        c.unknown = if left && !by_place { unknown(test) } else { lack.map(|(_, driver)| driver) };
        c.reason = unknown_reason(c.unknown.as_ref(), &c.effects);
        c.rivals.clear();
    } else if !c.effects.is_empty() {
        c.verdict = Verdict::Effect;
        c.reason = sentences(&c.effects);
    } else if !faults.is_empty() {
        c.verdict = Verdict::TwinFault;
        let count: usize = faults.iter().map(|f| f.points.len()).sum();
        c.reason = format!(
            "{count} labels of the outside twin are faulty; after their repair the model is adequate."
        );
    } else {
        let p = found.first_test.p_value(p_lack_of_fit);
        c.reason =
            format!("The declared model explains the readings to within the noise (omnibus p = {p:.2}).");
    }
    c
}
