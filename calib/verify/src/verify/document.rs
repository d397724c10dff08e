//! verify.json from what was decided and what the sealed readings say of it.

use super::assessment::{Assessment, fill_missing};
use super::conclusion::{Conclusion, ids, laws};
use super::decision::Decision;
use super::detect;
use super::explained::Explained;
use super::left_out::Errors;
use super::session_model::{FloorStatement, SessionModel};
use crate::method::hypothesis::{Gate, Hypothesis};
use crate::method::noise::{Noise, NoiseInputs};
use nalgebra::DVector;
use wcal_core::text::{readable, with_unit};
use wcal_core::verify_document::{
    CorrelatedNoise, FlaggedReading, NoiseDocument, NoiseLaw, NoisePart, TwinCheck, Verdict,
    VerifyDocument, WitnessTest,
};

/// The document; session, files and mark are the caller's.
pub(crate) fn document<M: SessionModel>(
    decision: &Decision<M>,
    assessment: &Assessment<M>,
) -> VerifyDocument {
    let Decision {
        of,
        conclusion,
        floor,
        ..
    } = decision;
    let (model, explained) = (&of.model, &of.explained);
    let found = &explained.found;
    let between = model.seating_repeatability(&conclusion.accepted);
    let noise = (!explained.exact).then(|| noise_document(&of.noise, between, &model.unit()));
    let rivals: Vec<&Hypothesis> = conclusion.rivals.iter().collect();
    let next = (conclusion.verdict == Verdict::Ambiguous && !rivals.is_empty())
        .then(|| model.next_measurement(&found.best, &rivals));
    let (test, tested) = if ids(model, &conclusion.accepted) == ids(model, &found.best) {
        (&found.last_test, &found.best)
    } else {
        (&found.first_test, &found.base)
    };
    let in_turn = &of.left_out.errors;
    let errors = match &assessment.errors {
        Some(sealed) => fill_missing(model, sealed.clone(), in_turn),
        None => in_turn.clone(),
    };
    VerifyDocument {
        effects: conclusion.effects.clone(),
        alternatives: conclusion.alternatives.clone(),
        unknown: conclusion.unknown.clone(),
        twin: TwinCheck {
            faults: of.faults.clone(),
        },
        noise_floor: floor.floor.clone(),
        flagged: flagged_readings(decision, assessment),
        before: errors.before.clone(),
        after: errors.after.clone(),
        after_trimmed: errors.trimmed.as_ref().and_then(|[_, after]| after.clone()),
        coverage95: errors.coverage95,
        next_measurement: next.flatten(),
        detectable: detect::table(model, tested, test),
        cautions: (model.cautions(&conclusion.accepted).into_iter())
            .chain(
                noise
                    .as_ref()
                    .and_then(|n| slow_noise(n, &model.noise_inputs())),
            )
            .chain(noise_by_column(model, &conclusion.accepted, &of.noise))
            .chain(tails_by_one(model, &conclusion.accepted, &of.noise))
            .map(|c| model.format_text(&c))
            .collect(),
        notes: notes(model, explained, conclusion, floor, &noise, in_turn),
        leave_one_effect_out: decision.ablations.clone(),
        holdout: assessment.holdout.clone(),
        tests: explained
            .tests
            .iter()
            .cloned()
            .chain(replicates(model, explained, conclusion))
            .collect(),
        noise,
        verdict: conclusion.verdict,
        ..VerifyDocument::refused(
            "",
            model.kind(),
            reason(model, conclusion, floor, &errors),
            decision.seed,
        )
    }
}

/// The verdict's reason, caveats and how the errors were found.
fn reason(
    model: &impl SessionModel,
    c: &Conclusion,
    floor: &FloorStatement,
    errors: &Errors,
) -> String {
    let caveat = model
        .caveat(&c.accepted)
        .map_or_else(String::new, |text| format!(" {text}"));
    format!(
        "{}{caveat}{}{}",
        c.reason,
        floor.reason,
        model.format_text(&errors.remark)
    )
}

/// The declared and the accepted model before readings that agree in every setting.
fn replicates(
    model: &impl SessionModel,
    explained: &Explained,
    conclusion: &Conclusion,
) -> Vec<WitnessTest> {
    let (base, accepted) = (&explained.found.base, &conclusion.accepted);
    let more = Some(accepted).filter(|a| a.fit.terms != base.fit.terms);
    let test = |h: &Hypothesis| {
        let l = model.lack_of_fit(h)?;
        Some(WitnessTest {
            witness: "replicates".to_owned(),
            effects: h.term_ids(model.catalogue()),
            statistic: l.f,
            dof: l.dof,
            p: l.p_value?,
            refuted: l.is_significant(),
            magnitude: l.pure_sd * model.noise_factor(),
            unit: model.unit(),
            sentence: format!(
                "Lack of fit, F on {} and {} degrees of freedom",
                l.dof, l.pure_dof
            ),
        })
    };
    std::iter::once(base).chain(more).filter_map(test).collect()
}

/// Readings that count in no fit or no held-out error.
fn flagged_readings<M: SessionModel>(
    decision: &Decision<M>,
    assessment: &Assessment<M>,
) -> Vec<FlaggedReading> {
    let of = |m: &M, i: usize| {
        let origin = m.origin(i);
        FlaggedReading {
            source: origin.source,
            point: origin.point,
        }
    };
    let fitted = decision
        .conclusion
        .accepted
        .flagged
        .iter()
        .map(|&i| of(&decision.of.model, i));
    fitted
        .chain(assessment.flagged.iter().map(|&i| of(&assessment.whole, i)))
        .collect()
}

fn notes(
    model: &impl SessionModel,
    explained: &Explained,
    conclusion: &Conclusion,
    floor: &FloorStatement,
    noise: &Option<NoiseDocument>,
    errors: &Errors,
) -> Vec<String> {
    let mut notes: Vec<String> = floor.note.iter().cloned().collect();
    let points: Vec<String> = conclusion
        .accepted
        .flagged
        .iter()
        .map(|&i| model.origin(i).point.to_string())
        .collect();
    if !points.is_empty() {
        notes.push(format!(
            "Readings marked and left out of the fit (kept in the table): points {}.",
            points.join(", ")
        ));
    }
    notes.extend(rejections(model, explained));
    notes.extend(other_laws(model, explained, conclusion));
    let clock_unit = model.noise_inputs().clock_unit();
    notes.extend(
        noise
            .iter()
            .flat_map(|noise| noise_sentences(noise, clock_unit)),
    );
    notes.extend(model.notes(&explained.found, &conclusion.accepted));
    let quantity = model.quantities()[0];
    notes.extend(errors.further.iter().filter_map(|(name, e)| {
        let value = e.rmse.get(quantity.key)?;
        Some(
            format!(
                "Held-out error ({}), {name}: {value:.4} {}",
                quantity.key, quantity.unit
            )
            .trim_end()
            .to_owned()
                + ".",
        )
    }));
    notes
}

/// Names that fell, each once.
fn rejections(model: &impl SessionModel, explained: &Explained) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for r in &explained.found.rejections {
        let names = r.effects.join(" with ");
        let sentence = match r.gate {
            Gate::NotConverged => {
                format!("The fit of {names} did not converge: it is not among the explanations.")
            }
            Gate::Identifiability => {
                format!("{names} is not named: {}.", model.format_text(&r.why))
            }
            Gate::Witness => {
                format!("{names} is refuted by another measurement of this instrument.")
            }
            Gate::LeftOutError => format!(
                "Within model error: the fitted readings ask for {names}, which lowers the error of groups left out by less than its uncertainty; not \
                 named."
            ),
        };
        if !out.contains(&sentence) {
            out.push(sentence);
        }
    }
    out
}

/// Laws of the accepted names by which the data could be described as well: columns or clocks that
/// this session does not tell apart.
fn other_laws(
    model: &impl SessionModel,
    explained: &Explained,
    conclusion: &Conclusion,
) -> Option<String> {
    let accepted = &conclusion.accepted;
    let own = laws(model, accepted);
    let same = |h: &&Hypothesis| ids(model, h) == ids(model, accepted) && laws(model, h) != own;
    let others: Vec<String> = explained
        .found
        .survivors
        .iter()
        .filter(same)
        .map(|h| laws(model, h).join(" with "))
        .collect();
    (!others.is_empty() && !own.is_empty()).then(|| {
        format!(
            "{} cannot be distinguished from {}.",
            own.join(" with "),
            others.join(" or ")
        )
    })
}

/// Standard deviation of a value that is rounded to a step: uniform over the step.
fn rounding_sd(step: f64) -> f64 {
    step / 12f64.sqrt()
}

/// The parts, `session` from several sessions; what the design cannot tell is absent.
fn noise_document(noise: &Noise, session: Option<NoisePart>, unit: &str) -> NoiseDocument {
    let step = noise.step.iter().flatten().copied().fold(0.0, f64::max);
    let rounding = (step > 0.0).then(|| NoisePart {
        value: rounding_sd(step),
        interval95: [rounding_sd(step); 2],
    });
    let heavy = noise.tails.filter(|t| t.heavy);
    NoiseDocument {
        repeat: Some(noise.repeat),
        pose: noise.pose,
        session,
        correlated: noise.correlated.map(|(sd, tau)| CorrelatedNoise {
            sd: sd.value,
            interval95: sd.interval95,
            time_constant_s: tau,
        }),
        rounding,
        tails_dof: heavy.map(|t| NoisePart {
            value: t.dof,
            interval95: t.interval95.map(|nu| nu.min(1e3)),
        }),
        // Load and depth go from 0 to 1.
        law: noise.law.as_ref().map(|l| NoiseLaw {
            follows: l.follows.clone(),
            ratio: l.spread.exponent.exp(),
            interval95: l.spread.interval95.map(f64::exp),
        }),
        unit: unit.to_owned(),
    }
}

/// Swings of a slow part that a record must hold to show that it is noise: fewer are those of a
/// drift, or of a zero that moved once and came back.
const SWINGS: f64 = 10.0;
/// Times the scatter of neighbours from which a slow part matters.
const MANY: f64 = 2.0;

/// A correlated part of which the record holds a few swings alone, as a sentence: the fit takes it
/// for noise, and it may be none.
fn slow_noise(noise: &NoiseDocument, inputs: &NoiseInputs) -> Option<String> {
    let (slow, repeat) = (noise.correlated?, noise.repeat?.value);
    let whole = match &inputs.clock {
        Some(clock) => clock.last()? - clock.first()?,
        None => inputs.settings.len() as f64 - 1.0,
    };
    let unit = inputs.clock_unit();
    let tau = slow.time_constant_s;
    let [shared, own] = [slow.sd, repeat].map(|sd| with_unit(&readable(sd), &noise.unit));
    (SWINGS * tau > whole && slow.sd > MANY * repeat).then(|| {
        format!(
            "readings move together by {shared} within {tau:.0} of {whole:.0} {unit}, neighbours agree to {own}: taken as noise, but \
             a zero that moved and came back looks the same. Measure again, or for longer."
        )
    })
}

/// Share of what the accepted model leaves from which a recorded column may be its cause.
const FOLLOWED: f64 = 0.5;

/// Noise that is correlated in time and runs with a recorded column, as a sentence that names it.
fn noise_by_column(
    model: &impl SessionModel,
    accepted: &Hypothesis,
    noise: &Noise,
) -> Option<String> {
    noise.correlated?;
    let fit = &accepted.fit;
    let rows: Vec<usize> = (0..fit.raw_residual.nrows())
        .filter(|&i| accepted.weights.counts(i))
        .collect();
    let residual = fit.raw_residual.select_rows(&rows);
    // Squared multiple correlation with the column, all channels together; of the clock alone noise
    // this slow has as much.
    let share = |values: &[f64]| {
        let column = DVector::from_iterator(rows.len(), rows.iter().map(|&i| values[i]));
        let column = column.add_scalar(-column.mean());
        // Cosine squared of residual and centred column, summed over the channels.
        (residual.tr_mul(&column)).norm_squared()
            / (column.norm_squared() * residual.norm_squared())
    };
    let recorded = model
        .covariates()
        .into_iter()
        .filter(|(name, _)| !matches!(name.as_str(), "order" | "t_s"));
    let (name, found) = recorded
        .map(|(n, v)| (n, share(&v)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (found > FOLLOWED).then(|| {
        format!(
            "{:.0} % of what readings share with their neighbours, which is taken for noise, follow {name}: it may be an effect of it that these readings do not \
             tell from noise.",
            100.0 * found
        )
    })
}

/// Tails that are heavy by one reading alone, as a sentence that names it.
fn tails_by_one(model: &impl SessionModel, accepted: &Hypothesis, noise: &Noise) -> Option<String> {
    noise.tails.filter(|t| t.by_one)?;
    let sizes = accepted.fit.residual.row_iter().map(|r| r.norm());
    let (largest, _) = sizes.enumerate().max_by(|a, b| a.1.total_cmp(&b.1))?;
    Some(format!(
        "point {} alone makes the noise heavy-tailed, and the noise floor larger: a false reading, or one that chance gives now and then. Look at it.",
        model.origin(largest).point
    ))
}

/// The noise in one or two plain sentences; none where there is nothing to say beyond its size.
fn noise_sentences(noise: &NoiseDocument, clock_unit: &str) -> Vec<String> {
    let size = |value: f64| with_unit(&readable(value), &noise.unit);
    let range = |[low, high]: [f64; 2]| format!("[{}, {}]", readable(low), readable(high));
    let mut out = Vec::new();
    if let (Some(repeat), Some(pose)) = (noise.repeat, noise.pose.filter(|p| p.interval95[0] > 0.0))
    {
        out.push(format!(
            "Repeats of a held pose agree to {}; setting the pose anew adds {} {}.",
            size(repeat.value),
            size(pose.value),
            range(pose.interval95)
        ));
    }
    if let Some(c) = noise.correlated {
        out.push(format!(
            "Part of the noise is correlated in time: {} {} with a time constant of {:.0} {clock_unit}; an effect is named only where \
             it goes beyond that.",
            size(c.sd),
            range(c.interval95),
            c.time_constant_s
        ));
    }
    if let Some(law) = &noise.law {
        let (more, ratio) = if law.ratio >= 1.0 {
            ("more", law.ratio)
        } else {
            ("less", 1.0 / law.ratio)
        };
        out.push(format!(
            "The readings scatter {ratio:.1} times {more} at the largest {} than at the smallest.",
            law.follows
        ));
    }
    if let Some(tails) = noise.tails_dof {
        out.push(format!(
            "The noise has heavier tails than a Gaussian (Student's t with {:.0} degrees of freedom [{:.0}, {:.0}]).",
            tails.value, tails.interval95[0], tails.interval95[1]
        ));
    }
    if let Some(rounding) = noise.rounding {
        out.push(format!(
            "Values are rounded: {} of the noise at least.",
            size(rounding.value)
        ));
    }
    out
}
