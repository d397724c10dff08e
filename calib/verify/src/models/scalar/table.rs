//! Where no law describes the errors of an axis and repeats show that they belong to its places: a
//! table of them.

use super::effects::ERROR_TABLE;
use super::frame::Declared;
use super::system::ScalarSystem;
use crate::levels::{CATALOGUE, REPLICATES};
use crate::method::{
    Fit, Hypothesis, OmnibusTest, Options, Signature, Status, covariance, f_test, fit,
    noise_for_predictions, omnibus_test, strongest, t95,
};
use crate::verify::Explained;
use crate::{EffectTerm, MeasurementModel};
use nalgebra::DVector;
use wcal_core::verify_document::EffectParameter;

/// Index of the table in the catalogue.
fn index(system: &ScalarSystem) -> Option<usize> {
    system.catalogue().iter().position(|e| e.id == ERROR_TABLE)
}

/// Takes the table in place of an explanation that repeats contradict.
pub(super) fn prefer_error_table(
    system: &ScalarSystem,
    explained: &mut Explained,
    options: &Options,
) {
    let found = &explained.found;
    let contradicted = |h: &Hypothesis| system.pure_error(h).is_some_and(|l| l.is_significant());
    let Some(effect) = index(system).filter(|&e| system.not_observable(e).is_none()) else {
        return;
    };
    if system.frame.declared != Declared::Axis || explained.exact || !contradicted(found.accepted())
    {
        return;
    }
    let Some((table, tables)) = table(system, effect, &found.base) else {
        return;
    };
    let (table, last_test) = extended(system, table, &found.base, options);
    if let Some(noise) = noise_for_predictions(system, &table, options.seed) {
        explained.noise = noise;
    }
    let found = &mut explained.found;
    found.covariate_beats_catalogue = false;
    found.survivors = vec![table.clone()];
    // Each fold chooses among the tables.
    found.refitted = tables;
    (found.best, found.last_test) = (table, last_test);
}

/// Refit of `terms` with every reading that the declared model counts.
fn refitted(system: &ScalarSystem, terms: &[EffectTerm], base: &Hypothesis) -> Option<Hypothesis> {
    let fit =
        fit(system, terms, &base.weights, 15).filter(|f| f.status != Status::RankDeficient)?;
    Some(Hypothesis {
        fit,
        ..base.clone()
    })
}

/// The plainest table that no richer one beats, and all: by place, with one reversal value for all,
/// with one for each place.
fn table(
    system: &ScalarSystem,
    effect: usize,
    base: &Hypothesis,
) -> Option<(Hypothesis, Vec<Hypothesis>)> {
    let of = |law: usize| EffectTerm {
        effect,
        law,
        values: Vec::new(),
    };
    let mut catalogue = system.catalogue().iter().enumerate();
    let reversal = catalogue.find_map(|(effect, e)| {
        let (law, _) = e.law_named("reversal")?;
        Some(EffectTerm { effect, ..of(law) })
    });
    let common = reversal.map(|r| vec![of(0), r]);
    let richer = common.into_iter().chain([vec![of(1)]]);
    let mut all = vec![refitted(system, &[of(0)], base)?];
    all.extend(richer.filter_map(|terms| refitted(system, &terms, base)));
    let kept = all.iter().skip(1).fold(&all[0], |kept, rich| {
        if improves_on_laws(&kept.fit, &rich.fit) {
            rich
        } else {
            kept
        }
    });
    improves_on_laws(&base.fit, &kept.fit).then(|| (kept.clone(), all.clone()))
}

/// What the table leaves may follow the clock or another column: effects that the omnibus test asks
/// for and that earn their gain in cells.
fn extended(
    system: &ScalarSystem,
    table: Hypothesis,
    base: &Hypothesis,
    options: &Options,
) -> (Hypothesis, OmnibusTest) {
    let mut kept = table;
    let mut test = omnibus_test(system, &kept.fit, &kept.weights, options);
    for _ in 1..options.largest {
        let left = kept.fit.stacked();
        let other = |s: &&Signature| kept.fit.terms.iter().all(|t| t.effect != s.term.effect);
        let best = strongest(test.signatures.iter().filter(other), &left, &kept.fit);
        let Some((_, best)) = best.filter(|_| test.p_catalogue() < CATALOGUE) else {
            break;
        };
        let law = system.catalogue()[best.term.effect].law(best.term.law);
        let mut terms = kept.fit.terms.clone();
        terms.push(best.start(&left, law));
        match refitted(system, &terms, base)
            .filter(|h| h.is_physical(system) && system.unidentified_term(h).is_none())
        {
            Some(more) => kept = more,
            None => break,
        }
        test = omnibus_test(system, &kept.fit, &kept.weights, options);
    }
    (kept, test)
}

/// F test of a richer model at the level of lack of fit.
fn improves_on_laws(plain: &Fit, rich: &Fit) -> bool {
    let extra = plain.dof - rich.dof;
    let p = f_test(plain.ssr - rich.ssr, plain.ssr, plain.dof, extra as usize);
    extra >= 1.0 && p.is_some_and(|p| p < REPLICATES)
}

/// The table's deviations by place and direction with 95 % intervals, as measured less commanded.
pub fn deviations(system: &ScalarSystem, fit: &Fit) -> Vec<EffectParameter> {
    let is_table = |t: &EffectTerm| Some(t.effect) == index(system);
    let Some(at) = fit.terms.iter().position(is_table) else {
        return Vec::new();
    };
    let first = fit.slots(system.catalogue())[at].columns.start;
    let places = &system.frame.scaling.places;
    let by_direction = fit.terms[at].law == 1;
    let (c, t) = (covariance(fit, fit.variance()), t95(fit.dof));
    let coefficients = fit.coefficients.column(0);
    let ways: &[(&str, bool)] = if by_direction {
        &[(", rising", false), (", falling", true)]
    } else {
        &[("", false)]
    };
    let all = places.iter().enumerate();
    let all = all.flat_map(|(k, place)| ways.iter().map(move |way| (k, place, way)));
    let of = |(k, place, (way, falling)): (usize, &f64, &(&str, bool))| {
        // Deviation = constant + that of the place (+ reversal value): g' C g is its variance.
        let mut g = DVector::zeros(c.nrows());
        g[0] = 1.0;
        if k > 0 {
            g[first + k - 1] = 1.0;
        }
        if *falling {
            g[first + places.len() - 1 + k] = 1.0;
        }
        let value = g.rows(0, coefficients.len()).dot(&coefficients) - system.offset;
        let half = t * g.dot(&(&c * &g)).max(0.0).sqrt();
        EffectParameter {
            name: format!("deviation at {place}{way}"),
            value,
            unit: system.names.response.clone(),
            interval95: [value - half, value + half],
        }
    };
    all.map(of).collect()
}
