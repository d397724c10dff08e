//! Detectability: the smallest size of every effect with which 90 % of such sessions are not called
//! adequate. Its name is a choice among rivals and may take more.
//!
//! ```text
//! |P s| a / sigma >= t + z_0.9 sqrt(1 + t^2 / (2 n)),    t^2 = d F_{d, n}(1 - level)       s: signature for a unit amplitude, n: degrees of freedom
//! ```
//!
//! (Noncentral t; Johnson & Kotz, "Continuous Univariate Distributions" 2, ch. 31.) P takes off the
//! nuisances and what is accepted. A name has to pass the search, at the level beside noise that
//! neighbours share where there is some, and the tests that the design asks for
//! ([`MeasurementModel::design_tests`]). What all readings share and no number of them averages out
//! (the alignment of two clocks) is added in squares.

use super::session_model::SessionModel;
use crate::effect::{EffectTerm, Parameter, Role};
use crate::levels::{CATALOGUE, RETAIN_BESIDE_CORRELATED};
use crate::measurement_model::DesignTest;
use crate::method::fit::Fit;
use crate::method::hypothesis::Hypothesis;
use crate::method::omnibus::OmnibusTest;
use crate::method::signature::Signature;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use std::collections::BTreeMap;
use wcal_core::text::{number, with_unit};
use wcal_core::verify_document::Detectable;

/// Normal quantile of 90 % power.
const POWER_90: f64 = 1.281_551_565_545;

/// A size this many times larger than with the second witness says that the readings do not show it
/// at all.
const MUCH_LARGER: f64 = 1e3;

/// Smallest size by one law.
struct DetectableSize {
    law: usize,
    /// Shape of the law at which it is that size: name, value, unit.
    shape: Vec<(&'static str, f64, String)>,
    size: f64,
    unit: String,
    share_left: f64,
    /// Size that the readings alone would show; none where there is no second witness.
    alone: Option<f64>,
}

/// One row an effect. `test` is the omnibus test on `fit`.
pub fn table(model: &impl SessionModel, h: &Hypothesis, test: &OmnibusTest) -> Vec<Detectable> {
    (0..model.catalogue().len())
        .map(|effect| row(model, h, test, effect))
        .collect()
}

fn row(model: &impl SessionModel, h: &Hypothesis, test: &OmnibusTest, effect: usize) -> Detectable {
    let fit = &h.fit;
    let candidate = &model.catalogue()[effect];
    let laws = &candidate.laws;
    let first = laws.first();
    let unit = first.and_then(|l| {
        l.parameters
            .first()
            .map(|p| p.unit)
            .or(l.linear.first().map(|c| c.1))
    });
    let unit = unit.map_or_else(|| "readings".to_owned(), |u| model.physical(u, 1.0, 0).1);
    let entry = |status: &str, smallest: Option<f64>, unit: String, why: String| Detectable {
        id: candidate.id.to_owned(),
        smallest,
        law: None,
        shape: BTreeMap::new(),
        smallest_without_pictures: None,
        unit,
        status: status.to_owned(),
        why,
    };
    if let Some(why) = model.not_observable(effect) {
        return entry("not-observable", None, unit, model.format_text(&why));
    }
    if laws.is_empty() {
        let why = "taken where repeats contradict every law";
        return entry("testable", None, model.unit(), why.into());
    }
    if laws
        .iter()
        .all(|l| l.parameters.is_empty() && l.linear.is_empty())
    {
        return if Some(effect) == model.outliers() {
            let why = "single readings far outside the noise are flagged";
            entry("testable", Some(1.0), "readings".into(), why.into())
        } else {
            let why = "tested by the trend of the squared residuals";
            entry("testable", None, "1".into(), why.into())
        };
    }
    if fit.terms.iter().any(|t| t.effect == effect) {
        return entry(
            "testable",
            None,
            unit,
            "part of the best explanation".into(),
        );
    }
    match smallest(model, h, test, effect) {
        Some(s) if !s.size.is_finite() => {
            let why = "the readings that repeat leave nothing to tell it from their protocol";
            entry("absorbed", None, unit, why.into())
        }
        Some(s) => {
            let law = model.law_name(laws[s.law].name);
            let shape = s.shape.iter().map(|(name, value, unit)| {
                with_unit(
                    &format!("{} {}", name.replace('_', " "), number(*value, 3)),
                    unit,
                )
            });
            let shape = shape.collect::<Vec<_>>().join(", ");
            let at = if shape.is_empty() {
                shape
            } else {
                format!(" ({shape})")
            };
            let left = 100.0 * s.share_left;
            let by_readings = s.alone.filter(|alone| *alone <= MUCH_LARGER * s.size);
            let only = s.alone.is_some() && by_readings.is_none();
            let pictures = if only {
                "; only the pictures show it"
            } else {
                ""
            };
            let why = format!(
                "law {law}{at}; {left:.0} % of its signature is independent of {} and of the accepted effects{pictures}",
                model.nuisances()
            );
            let row = entry("testable", Some(s.size), s.unit, why);
            let shape = s
                .shape
                .into_iter()
                .map(|(name, value, _)| (name.to_owned(), value))
                .collect();
            Detectable {
                smallest_without_pictures: by_readings,
                law: Some(law),
                shape,
                ..row
            }
        }
        None if !has_answer(model, fit, effect) => {
            let why = "the model has no answer with it at some of the readings";
            entry("not-observable", None, unit, why.into())
        }
        None => {
            let why = format!(
                "not identifiable: fully absorbed by {} and the accepted effects, so that it neither harms nor shows at the inputs that were measured",
                model.nuisances()
            );
            entry("absorbed", None, unit, why)
        }
    }
}

/// Whether the model has an answer for every reading with some law of the effect at its typical
/// size.
fn has_answer(model: &impl SessionModel, fit: &Fit, effect: usize) -> bool {
    let typical = |p: &Parameter| match p.role {
        Role::Amplitude { probe } => probe,
        Role::Shape { grid } => grid.first().copied().unwrap_or(0.0),
    };
    model.catalogue()[effect]
        .laws
        .iter()
        .enumerate()
        .any(|(law, l)| {
            let term = EffectTerm {
                effect,
                law,
                values: l.parameters.iter().map(typical).collect(),
            };
            let terms: Vec<EffectTerm> = fit.terms.iter().cloned().chain([term]).collect();
            model.design(&terms).is_some()
        })
}

/// Length of a signature, in standard deviations of a reading, that a test with `d` and `dof`
/// degrees of freedom finds with 90 %.
fn noncentrality(level: f64, d: f64, dof: f64) -> Option<f64> {
    // The critical value of the test, in the same unit as the signature's length.
    let t = (d * FisherSnedecor::new(d, dof).ok()?.inverse_cdf(1.0 - level)).sqrt();
    Some(t + POWER_90 * (1.0 + t * t / (2.0 * dof)).sqrt())
}

/// Values of a signature's shape, in the session's units.
fn shape(model: &impl SessionModel, signature: &Signature) -> Vec<(&'static str, f64, String)> {
    let term = &signature.term;
    let parameters = model.catalogue()[term.effect]
        .law(term.law)
        .parameters
        .iter()
        .zip(&term.values);
    let stated = parameters.filter(|(p, _)| matches!(p.role, Role::Shape { .. }));
    stated
        .map(|(p, value)| {
            let (value, unit) = model.physical(p.unit, *value, term.law);
            (p.name, value, unit)
        })
        .collect()
}

/// By the plainest law that this session can show, at the shape that it shows best.
fn smallest(
    model: &impl SessionModel,
    h: &Hypothesis,
    test: &OmnibusTest,
    effect: usize,
) -> Option<DetectableSize> {
    let fit = &h.fit;
    let sd = fit.variance().sqrt();
    let shared = h.weights.shared().is_some_and(|s| s.correlated.is_some());
    let critical = test.family.critical_p(if shared {
        RETAIN_BESIDE_CORRELATED
    } else {
        CATALOGUE
    });
    let laws = &model.catalogue()[effect].laws;
    let signatures = test.signatures.iter().filter(|a| a.term.effect == effect);
    signatures
        .filter_map(|a| {
            let law = a.term.law;
            let signature = a.projected.first()?.norm();
            // Of a law with one sign half the tail remains.
            let level = if a.one_sided {
                2.0 * critical
            } else {
                critical
            };
            let d = a.dimension() as f64;
            let of_search = noncentrality(level, d, fit.dof - d)?;
            // A stratum sees only its share of a signature: the whole has to be longer.
            let of_design = |t: DesignTest| {
                Some(noncentrality(t.level, d, t.dof)? * signature / t.norm.max(1e-300))
            };
            // A name passes every gate: the hardest of them decides.
            let tests = model.design_tests(h, &a.term, a.projected.first()?);
            let asked = !tests.is_empty();
            let of_design = tests
                .into_iter()
                .filter_map(of_design)
                .min_by(f64::total_cmp);
            let needed =
                of_search.max(of_design.unwrap_or(if asked { f64::INFINITY } else { 0.0 }));
            let (unit, probe) = match a.amplitudes.first() {
                Some((slot, probe)) => (laws[law].parameters[*slot].unit, probe.abs()),
                None => (laws[law].linear.first()?.1, 1.0),
            };
            // No number of readings averages out what all of them share.
            let shared = a.amplitudes.first().map_or(0.0, |(slot, _)| {
                needed * model.systematic_sd(effect, laws[law].parameters[*slot].name)
            });
            let readings = fit.residual.len();
            // Length of the signature in the readings alone, without what the pictures see.
            let alone = (!fit.auxiliary_residual.is_empty())
                .then(|| a.projected[0].rows(0, readings).norm())
                .map(|own| {
                    model
                        .physical(
                            unit,
                            (needed * sd * probe / own.max(1e-300)).hypot(shared),
                            law,
                        )
                        .0
                });
            let (size, unit) =
                model.physical(unit, (needed * sd * probe / signature).hypot(shared), law);
            let shape = shape(model, a);
            (signature > 0.0).then_some(DetectableSize {
                law,
                shape,
                size,
                unit,
                share_left: a.share_left,
                alone,
            })
        })
        .min_by(|a, b| a.law.cmp(&b.law).then(a.size.total_cmp(&b.size)))
}
