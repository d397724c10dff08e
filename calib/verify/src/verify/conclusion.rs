//! The verdict, written once from what was found on the open readings, in the order of
//! docs/src/formats.md.

use super::acceptance::{Unfit, format_significant};
use super::explained::Explained;
use super::session_model::SessionModel;
use crate::effect::{EffectTerm, LawRequirement};
use crate::error::VerifyError;
use crate::levels::OMNIBUS;
use crate::method::hypothesis::{Gate, Hypothesis};
use crate::method::inference::equivalence_class;
use crate::method::lack_of_fit::LackOfFit;
use crate::method::omnibus::{CovariateScore, OmnibusTest};
use crate::method::search_result::SearchResult;
use wcal_core::text::with_unit;
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
    /// It was accepted by request.
    pub on_request: bool,
}

/// Whether a verdict says that the accepted model holds; one of several explanations does so where
/// it was accepted by request.
pub fn asserts_validity(verdict: Verdict, on_request: bool) -> bool {
    match verdict {
        Verdict::Adequate | Verdict::Effect | Verdict::TwinFault => true,
        Verdict::Ambiguous => on_request,
        Verdict::UnknownEffect | Verdict::Refused => false,
    }
}

/// Effects that were withdrawn, since they do not predict readings left out in turn better than
/// chance would.
pub struct Withdrawn {
    /// Their identifiers.
    pub names: Vec<String>,
    /// Error before and after.
    pub errors: [f64; 2],
}

/// What the verdict is read off.
pub struct Facts<'a, M> {
    model: &'a M,
    explained: &'a Explained,
    faults: &'a [TwinFault],
    /// Effects were found, and no generic driver explains more than they do.
    something: bool,
    /// Of each survivor: is it of the best one's class?
    same_class: Vec<bool>,
    /// Survivors of another class, or of the same names driven by something else.
    rivals: Vec<Hypothesis>,
    /// A test says that something remains.
    left: bool,
    /// Lack of fit against pure error where it is significant, and what it would follow.
    lack: Option<UnknownEffect>,
    p_lack_of_fit: Option<f64>,
}

/// Identifiers of an explanation's effects, flagged readings among them.
pub fn ids(model: &impl SessionModel, h: &Hypothesis) -> Vec<String> {
    h.effects(model.outliers())
        .iter()
        .map(|&e| model.catalogue()[e].id.to_owned())
        .collect()
}

/// Law of a term, and its further column.
fn law(model: &impl SessionModel, t: &EffectTerm) -> String {
    let effect = &model.catalogue()[t.effect];
    let column = effect
        .column(t.law, model.further_columns())
        .map_or(String::new(), |c| format!(" {c}"));
    format!("{}{column}", model.law_name(effect.law(t.law).name))
}

/// Names and laws of an explanation's terms.
pub fn laws(model: &impl SessionModel, h: &Hypothesis) -> Vec<String> {
    let of = |t: &EffectTerm| format!("{} {}", model.catalogue()[t.effect].id, law(model, t));
    h.fit.terms.iter().map(of).collect()
}

/// What drives an explanation's terms: what their laws need of the session, and their columns.
fn drivers(
    model: &impl SessionModel,
    h: &Hypothesis,
) -> Vec<(usize, Vec<LawRequirement>, Option<String>)> {
    let driver = |t: &EffectTerm| {
        let effect = &model.catalogue()[t.effect];
        let column = effect
            .column(t.law, model.further_columns())
            .map(str::to_owned);
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

/// p-value of dropping `effect` from `h`, every other parameter refitted, adjusted by the first
/// gate's family.
fn removal_p(
    model: &impl SessionModel,
    found: &SearchResult,
    h: &Hypothesis,
    effect: usize,
) -> f64 {
    if Some(effect) == model.outliers() {
        return h.flag_p;
    }
    let without = h.without(model, |_, t| t.effect == effect);
    without.map_or(1.0, |without| {
        without.removal_p(&h.fit, &found.first_test.family)
    })
}

/// Names the effects of `h`; `class` comes from the survivors of its class.
fn named_effects(
    model: &impl SessionModel,
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
            // The mate has other effects in place of some of ours: those replace this one if the
            // rest is common.
            let common = own.iter().filter(|x| theirs.contains(x)).count();
            if !theirs.contains(&e) && common + 1 == own.len() {
                let others: Vec<String> = theirs
                    .iter()
                    .filter(|t| !own.contains(t))
                    .map(|t| id(*t))
                    .collect();
                class.extend(
                    others
                        .into_iter()
                        .filter(|t| !class.contains(t))
                        .collect::<Vec<_>>(),
                );
            }
        }
        class
    };
    own.iter()
        .map(|&e| NamedEffect {
            id: id(e),
            laws: h
                .fit
                .terms
                .iter()
                .filter(|t| t.effect == e)
                .map(|t| law(model, t))
                .collect(),
            class: class_of(e),
            p_value: removal_p(model, found, h, e),
            parameters: model.parameters(h, e),
            sentence: model.format_text(model.catalogue()[e].sentence),
        })
        .collect()
}

/// What the effects do, in their catalogue's words, and what they cannot be distinguished from.
fn sentences(effects: &[NamedEffect]) -> String {
    let sentence = |e: &NamedEffect| match &e.class[..] {
        [] | [_] => e.sentence.clone(),
        [_, others @ ..] => {
            format!(
                "{} These readings do not distinguish it from {}.",
                e.sentence,
                others.join(" or ")
            )
        }
    };
    effects.iter().map(sentence).collect::<Vec<_>>().join(" ")
}

fn unknown(test: &OmnibusTest) -> Option<UnknownEffect> {
    let first = test.covariates.first()?;
    Some(UnknownEffect {
        driver: first.covariate.clone(),
        shape: first.shape.to_owned(),
        drivers_ranked: test
            .covariates
            .iter()
            .map(|d| d.covariate.clone())
            .collect(),
        period: first.period,
    })
}

/// What follows `driver` in no shape that is known.
fn irregular(driver: &str) -> UnknownEffect {
    UnknownEffect {
        driver: driver.to_owned(),
        shape: "irregular".to_owned(),
        drivers_ranked: vec![driver.to_owned()],
        period: None,
    }
}

/// What levels that reproduce better than they fit follow: their setting.
fn by_setting(model: &impl SessionModel) -> Option<UnknownEffect> {
    let covariates = model.covariates();
    covariates.first().map(|(driver, _)| irregular(driver))
}

fn unknown_reason(unknown: Option<&UnknownEffect>, beyond: &[NamedEffect]) -> String {
    let names: Vec<String> = beyond.iter().map(|e| e.id.clone()).collect();
    let beyond = if names.is_empty() {
        String::new()
    } else {
        format!(" beyond {}", join(&names))
    };
    let follows = unknown.map_or(String::new(), |u| {
        format!("; it follows {} ({})", u.driver, u.shape)
    });
    format!("A residual{beyond} remains that no catalogued effect explains{follows}.")
}

impl<'a, M: SessionModel> Facts<'a, M> {
    /// Gathers them.
    pub fn of(model: &'a M, explained: &'a Explained, faults: &'a [TwinFault]) -> Self {
        let found = &explained.found;
        // What a generic driver explains better than the catalogue does is named after no effect.
        let covariate_wins = found.covariate_beats_catalogue;
        let something = !explained.exact && !ids(model, &found.best).is_empty() && !covariate_wins;
        let same_class = equivalence_class(model, found);
        let names = ids(model, &found.best);
        let rival = |h: &Hypothesis, of_class: bool| {
            other_driver(model, found, h) || (!of_class && ids(model, h) != names)
        };
        let all = found
            .survivors
            .iter()
            .zip(&same_class)
            .filter(|_| something);
        let rivals = all
            .filter(|(h, of_class)| rival(h, **of_class))
            .map(|(h, _)| h.clone())
            .collect();
        let against_pure_error = model
            .lack_of_fit(found.accepted())
            .filter(|_| !explained.exact);
        Self {
            model,
            explained,
            faults,
            something,
            same_class,
            rivals,
            left: !explained.exact
                && (covariate_wins
                    || (found.last_test.rejected() && !model.residual_explained(found))),
            p_lack_of_fit: against_pure_error.and_then(|l| l.p_value),
            lack: against_pure_error
                .filter(LackOfFit::is_significant)
                .and_then(|_| by_setting(model)),
        }
    }

    fn found(&self) -> &'a SearchResult {
        &self.explained.found
    }

    /// The explanation that stands before a term is withdrawn.
    pub fn accepted(&self) -> &'a Hypothesis {
        if self.explained.exact {
            &self.found().base
        } else {
            self.found().accepted()
        }
    }

    /// Explanations of more than one class remain, and repeats contradict none.
    pub(crate) fn is_ambiguous(&self) -> bool {
        !self.rivals.is_empty() && self.lack.is_none()
    }

    /// The surviving explanation with exactly the effects `asked`; none where nothing is asked.
    ///
    /// # Errors
    /// Where no surviving explanation has these effects.
    pub fn asked(&self, asked: &[String]) -> Result<Option<&'a Hypothesis>, VerifyError> {
        if asked.is_empty() {
            return Ok(None);
        }
        let sorted = |mut ids: Vec<String>| {
            ids.sort_unstable();
            ids
        };
        let wanted = sorted(asked.to_vec());
        let chosen = self
            .found()
            .survivors
            .iter()
            .find(|h| sorted(ids(self.model, h)) == wanted);
        let survivors: Vec<String> = self.alternatives().iter().map(|a| a.join(",")).collect();
        let error = || VerifyError::NotASurvivor {
            asked: asked.join(","),
            survivors: if survivors.is_empty() {
                "none".to_owned()
            } else {
                survivors.join("; ")
            },
        };
        chosen.ok_or_else(error).map(Some)
    }

    /// The names that a conclusion on `accepted` would list.
    pub fn effects(&self, accepted: &Hypothesis) -> Vec<NamedEffect> {
        let found = self.found();
        let whole = accepted.fit.terms == found.best.fit.terms;
        let mates = found
            .survivors
            .iter()
            .zip(&self.same_class)
            .filter(|(_, same)| whole && **same);
        let mates: Vec<&Hypothesis> = mates.map(|(h, _)| h).collect();
        let mut effects = if self.something {
            named_effects(self.model, found, accepted, &mates)
        } else {
            Vec::new()
        };
        effects.extend(self.model.noise_effect());
        effects
    }

    /// The omnibus test of `accepted`, or of the declared model where the best explanation was
    /// withdrawn, rejects it.
    fn rejects(&self, accepted: &Hypothesis) -> bool {
        let SearchResult {
            best,
            first_test,
            last_test,
            ..
        } = self.found();
        let is_best = accepted.fit.terms == best.fit.terms && accepted.flagged == best.flagged;
        !self.explained.exact && if is_best { last_test } else { first_test }.rejected()
    }

    /// The order of docs/src/formats.md: ambiguous, unknown-effect, effect, twin-fault, adequate.
    /// What the omnibus test rejects is never adequate.
    fn verdict(&self, accepted: &Hypothesis, effects: &[NamedEffect]) -> Verdict {
        if self.is_ambiguous() {
            Verdict::Ambiguous
        } else if self.left || self.lack.is_some() {
            Verdict::UnknownEffect
        } else if !effects.is_empty() {
            Verdict::Effect
        } else if self.rejects(accepted) {
            Verdict::UnknownEffect
        } else if !self.faults.is_empty() {
            Verdict::TwinFault
        } else {
            Verdict::Adequate
        }
    }

    /// Every surviving explanation, each once, the law of the noise with it.
    fn alternatives(&self) -> Vec<Vec<String>> {
        let noise = self.model.noise_effect();
        let mut listed = Vec::new();
        let mut all: Vec<Vec<String>> = Vec::new();
        for h in self.found().survivors.iter().filter(|_| self.something) {
            let own = (ids(self.model, h), drivers(self.model, h));
            if !listed.contains(&own) {
                all.push(own.0.clone());
                listed.push(own);
            }
        }
        if !self.something {
            all.push(Vec::new());
        }
        all.iter_mut()
            .for_each(|names| names.extend(noise.iter().map(|e| e.id.clone())));
        all.retain(|names| !names.is_empty());
        all
    }

    /// The conclusion that `accepted` is the model; `withdrawn` lost its name for it, `unfit` says
    /// why it cannot be called one that holds.
    pub fn conclude(
        &self,
        accepted: Hypothesis,
        on_request: bool,
        withdrawn: Option<&Withdrawn>,
        unfit: Option<Unfit>,
    ) -> Conclusion {
        let unit = self.model.quantities()[0].unit;
        let c = match withdrawn {
            Some(withdrawn) => self.conclude_withdrawal(accepted, withdrawn, unit),
            None => self.conclude_search(accepted, on_request),
        };
        match unfit.filter(|_| asserts_validity(c.verdict, c.on_request)) {
            Some(unfit) => Conclusion {
                verdict: Verdict::UnknownEffect,
                unknown: unfit.driver().map(irregular),
                reason: format!("{} {}", unfit.sentence(unit), c.reason),
                ..c
            },
            None => c,
        }
    }

    fn conclude_search(&self, accepted: Hypothesis, on_request: bool) -> Conclusion {
        let (model, found) = (self.model, self.found());
        let effects = self.effects(&accepted);
        let verdict = self.verdict(&accepted, &effects);
        // A term that is none was withdrawn: what else survives was found beside it.
        let reduced = accepted.fit.terms.len() < self.accepted().fit.terms.len() && !on_request;
        let own = || effects.iter().map(|e| e.id.clone()).collect::<Vec<_>>();
        let mut alternatives = if reduced {
            vec![own()]
        } else {
            self.alternatives()
        };
        alternatives.retain(|names| !names.is_empty());
        let mut unknown = None;
        let mut reason = match verdict {
            Verdict::Ambiguous => {
                let mut names: Vec<String> =
                    alternatives.iter().map(|a| a.join(" with ")).collect();
                if self.rivals.iter().any(|h| other_driver(model, found, h)) {
                    let all = std::iter::once(&found.best).chain(&self.rivals);
                    names = all.map(|h| laws(model, h).join(" with ")).collect();
                }
                if self.rivals.iter().any(|h| ids(model, h).is_empty()) {
                    names.push("nothing but noise that neighbours share".to_owned());
                }
                let names = names.join("; ");
                format!("The data show an unmodelled effect; these explanations remain: {names}.")
            }
            Verdict::UnknownEffect => {
                unknown = self.unknown(&accepted);
                let why = found
                    .rejections
                    .iter()
                    .rfind(|r| r.gate == Gate::Identifiability);
                let why = why.map_or(String::new(), |r| {
                    format!(" {} is not named: {}.", join(&r.effects), r.why)
                });
                unknown_reason(unknown.as_ref(), &effects) + &model.format_text(&why)
            }
            Verdict::Effect => sentences(&effects),
            Verdict::TwinFault => {
                let count: usize = self.faults.iter().map(|f| f.points.len()).sum();
                format!(
                    "{count} labels of the outside twin are faulty; after their repair the model is adequate."
                )
            }
            _ if self.explained.exact => "The declared model fits to the last digit.".to_owned(),
            _ if found.first_test.is_rounding => {
                "The readings are those of the declared model, rounded to their last digit."
                    .to_owned()
            }
            _ => {
                let p = found.first_test.p_value(self.p_lack_of_fit);
                let within = if p < OMNIBUS {
                    "its own error, a hundredth of the misfit"
                } else {
                    "the noise"
                };
                format!(
                    "The declared model explains the readings to within {within} (omnibus p = {p:.2})."
                )
            }
        };
        let refuted = found.rejections.iter().filter(|r| r.gate == Gate::Witness);
        let refuted: Vec<String> = refuted.map(|r| r.effects.join(" with ")).collect();
        if !refuted.is_empty() {
            let refuted = refuted.join("; ");
            reason = format!(
                "Another measurement of this instrument refutes {refuted}. Without it: {reason}"
            );
        }
        if on_request {
            reason = format!(
                "Accepted by request: {}. {reason}",
                join(&ids(model, &accepted))
            );
        }
        let rivals = if verdict == Verdict::UnknownEffect {
            Vec::new()
        } else {
            self.rivals.clone()
        };
        Conclusion {
            verdict,
            reason,
            effects,
            alternatives,
            rivals,
            unknown,
            accepted,
            on_request,
        }
    }

    /// What drives what `accepted` leaves.
    fn unknown(&self, accepted: &Hypothesis) -> Option<UnknownEffect> {
        let (model, found) = (self.model, self.found());
        let named = self.something && !accepted.fit.terms.is_empty();
        let (test, fitted, left) = if named {
            (&found.last_test, &found.best, self.left)
        } else {
            (&found.first_test, &found.base, self.rejects(accepted))
        };
        let clock = |s: &CovariateScore| matches!(s.covariate.as_str(), "order" | "t_s");
        // What repeats with the protocol follows its places, not the clock that counts them.
        let protocol =
            |s: &CovariateScore| clock(s) && model.repeats_with_protocol(fitted, &s.columns);
        let by_place = self.lack.is_some() && test.covariates.first().is_none_or(protocol);
        if left && !by_place {
            unknown(test)
        } else {
            self.lack.clone()
        }
    }

    /// The declared model, where the effects predict worse than it does: they are no explanation,
    /// and nothing of them stays.
    fn conclude_withdrawal(
        &self,
        base: Hypothesis,
        withdrawn: &Withdrawn,
        unit: &str,
    ) -> Conclusion {
        let effects: Vec<NamedEffect> = self.model.noise_effect().into_iter().collect();
        let [before, after] = withdrawn.errors.map(format_significant);
        let changes = if withdrawn.errors[1] > withdrawn.errors[0] {
            "rises"
        } else {
            "falls by no more than chance"
        };
        let found = format!(
            "The fitted readings support {}, but the error of readings left out in turn {changes} from {before} to {} with it: not accepted.",
            join(&withdrawn.names),
            with_unit(&after, unit)
        );
        let lack = self
            .model
            .lack_of_fit(&base)
            .is_some_and(|l| l.is_significant());
        let rejected = self.rejects(&base) || lack;
        let driver = || self.unknown(&base).or_else(|| by_setting(self.model));
        let unknown = if rejected { driver() } else { None };
        let (verdict, reason) = if rejected {
            (
                Verdict::UnknownEffect,
                format!("{found} {}", unknown_reason(unknown.as_ref(), &[])),
            )
        } else if let [noise] = &effects[..] {
            (Verdict::Effect, format!("{} {found}", noise.sentence))
        } else {
            let enough = "The declared model and the noise explain the readings.";
            (Verdict::Adequate, format!("{enough} {found}"))
        };
        let alternatives = effects.iter().map(|e| vec![e.id.clone()]).collect();
        let (rivals, on_request) = (Vec::new(), false);
        Conclusion {
            verdict,
            reason,
            effects,
            alternatives,
            rivals,
            unknown,
            accepted: base,
            on_request,
        }
    }
}

/// The same names as the best explanation's, driven by something else: a period over time, or over
/// the stimulus.
fn other_driver(model: &impl SessionModel, found: &SearchResult, h: &Hypothesis) -> bool {
    ids(model, h) == ids(model, &found.best) && drivers(model, h) != drivers(model, &found.best)
}
