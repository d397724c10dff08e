//! Detectability: the smallest size of every effect that is found with 90 % power.
//!
//! ```text
//! |P s| a / sigma >= sqrt(chi2_{d, 1 - level}) + z_0.9      s: signature for a unit amplitude, P: off nuisances and what is accepted
//! ```
//!
//! What all readings share and no number of them averages out (the alignment of two clocks) is added in squares.

use super::session_model::SessionModel;
use crate::effect::{EffectTerm, Parameter, Role};
use crate::levels::CATALOGUE;
use crate::method::fit::Fit;
use crate::method::omnibus::OmnibusTest;
use statrs::distribution::{ChiSquared, ContinuousCDF};
use wcal_core::verify_document::Detectable;

/// Normal quantile of 90 % power.
const POWER_90: f64 = 1.281_551_565_545;

/// A size this many times larger than with the second witness says that the readings do not show it at all.
const MUCH_LARGER: f64 = 1e3;

/// Smallest size by one law.
struct DetectableSize {
    law: usize,
    size: f64,
    unit: String,
    share_left: f64,
    /// Size that the readings alone would show; none where there is no second witness.
    alone: Option<f64>,
}

/// One row an effect. `test` is the omnibus test on `fit`.
pub fn table<M: SessionModel>(model: &M, fit: &Fit, test: &OmnibusTest) -> Vec<Detectable> {
    (0..model.catalogue().len())
        .map(|effect| row(model, fit, test, effect))
        .collect()
}

fn row<M: SessionModel>(model: &M, fit: &Fit, test: &OmnibusTest, effect: usize) -> Detectable {
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
    match smallest(model, fit, test, effect) {
        Some(s) => {
            let law = model.law_name(laws[s.law].name);
            let left = 100.0 * s.share_left;
            let by_readings = s.alone.filter(|alone| *alone <= MUCH_LARGER * s.size);
            let only = s.alone.is_some() && by_readings.is_none();
            let pictures = if only {
                "; only the pictures show it"
            } else {
                ""
            };
            let why = format!(
                "law {law}; {left:.0} % of its signature is independent of {} and of the accepted effects{pictures}",
                model.nuisances()
            );
            let row = entry("testable", Some(s.size), s.unit, why);
            Detectable {
                smallest_without_pictures: by_readings,
                ..row
            }
        }
        None if !has_answer(model, fit, effect) => {
            let why = "the model has no answer with it at some of the poses";
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

/// Whether the model has an answer for every reading with some law of the effect at its typical size.
fn has_answer<M: SessionModel>(model: &M, fit: &Fit, effect: usize) -> bool {
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

/// By the plainest law that this session can show, at the shape that it shows best.
fn smallest<M: SessionModel>(
    model: &M,
    fit: &Fit,
    test: &OmnibusTest,
    effect: usize,
) -> Option<DetectableSize> {
    let sd = fit.variance().sqrt();
    let critical = test.family.critical_p(CATALOGUE);
    let laws = &model.catalogue()[effect].laws;
    let signatures = test.signatures.iter().filter(|a| a.term.effect == effect);
    signatures
        .filter_map(|a| {
            let law = a.term.law;
            let chi = ChiSquared::new(a.dimension() as f64).ok()?;
            // Noncentrality that is found with 90 %: critical value of the family and the quantile of the power.
            let needed = chi.inverse_cdf(1.0 - critical).sqrt() + POWER_90;
            let (unit, probe) = match a.amplitudes.first() {
                Some((slot, probe)) => (laws[law].parameters[*slot].unit, probe.abs()),
                None => (laws[law].linear.first()?.1, 1.0),
            };
            let signature = a.projected.first()?.norm();
            let shared = a.amplitudes.first().map_or(0.0, |(slot, _)| {
                needed * model.systematic_sd(effect, laws[law].parameters[*slot].name)
            });
            let readings = fit.residual.len();
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
            (signature > 0.0).then_some(DetectableSize {
                law,
                size,
                unit,
                share_left: a.share_left,
                alone,
            })
        })
        .min_by(|a, b| a.law.cmp(&b.law).then(a.size.total_cmp(&b.size)))
}
