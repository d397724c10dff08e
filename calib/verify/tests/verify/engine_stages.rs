//! The engine's stages one by one on a toy system with known answers (SIMULATED), each with a
//! negative control.

use crate::search;
use crate::toy::{
    BEND, BEND_SHARE, LINE, NOISE, OUTLIERS, READINGS, SCALE, SHELF, ToySystem, shelf,
};
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{Binomial, DiscreteCDF};
use std::sync::atomic::{AtomicU32, Ordering};
use wcal_verify::effect::{Effect, EffectTerm};
use wcal_verify::measurement_model::MeasurementModel;
use wcal_verify::method::fit::{Fit, Status, Weights, fit};
use wcal_verify::method::hypothesis::{Gate, Hypothesis, Rejection};
use wcal_verify::method::inference::parameters;
use wcal_verify::method::linear::{Basis, stack};
use wcal_verify::method::min_p::{MinPDistribution, f_test};
use wcal_verify::method::omnibus::omnibus_test;
use wcal_verify::method::options::Options;
use wcal_verify::method::outliers::reject_outliers;
use wcal_verify::method::signature::{nuisance_basis, signatures_of_effect};

const HEIGHT: f64 = 0.03;
const PLACE: f64 = 0.55;

fn shelved(seed: u64) -> ToySystem {
    ToySystem::draw(seed, |_, x| LINE[1] * HEIGHT * shelf(x, PLACE))
}

fn plain(seed: u64) -> ToySystem {
    ToySystem::draw(seed, |_, _| 0.0)
}

fn base(system: &ToySystem) -> Fit {
    fit(system, &[], &Weights::equal(READINGS), 15).unwrap()
}

/// 99.9 % upper quantile of the hits that chance at `rate` gives in `trials`.
fn most(rate: f64, trials: u64) -> u64 {
    Binomial::new(rate, trials).unwrap().inverse_cdf(0.999)
}

// The baseline fit.

#[test]
fn the_fit_recovers_a_shelf_and_its_coefficients() {
    let system = shelved(1);
    let start = EffectTerm {
        effect: SHELF,
        law: 0,
        values: vec![0.01, 0.4],
    };
    let f = fit(&system, &[start], &Weights::equal(READINGS), 30).unwrap();
    assert_eq!(f.status, Status::Converged);
    assert!(
        (f.terms[0].values[0] - HEIGHT).abs() < 0.006,
        "{:?}",
        f.terms
    );
    assert!((f.terms[0].values[1] - PLACE).abs() < 0.03, "{:?}", f.terms);
    assert!((f.variance().sqrt() / NOISE - 1.0).abs() < 0.3);
    assert_eq!(f.dof, READINGS as f64 - 4.0);
}

#[test]
fn a_parameter_that_wants_to_leave_its_range_stays_at_the_bound_and_is_no_explanation() {
    let system = ToySystem::draw(2, |_, x| -LINE[1] * HEIGHT * shelf(x, PLACE));
    let start = EffectTerm {
        effect: SHELF,
        law: 0,
        values: vec![0.01, PLACE],
    };
    let f = fit(&system, &[start], &Weights::equal(READINGS), 30).unwrap();
    assert_eq!(f.terms[0].values[0], 0.0);
    assert!(f.at_bound[0]);
    let h = Hypothesis {
        fit: f,
        weights: Weights::equal(READINGS),
        flagged: Vec::new(),
        flag_p: 1.0,
    };
    assert!(!h.is_physical(&system));
}

#[test]
fn a_fit_that_did_not_converge_is_no_explanation() {
    let system = shelved(1);
    let start = EffectTerm {
        effect: SHELF,
        law: 0,
        values: vec![0.02, 0.5],
    };
    let after = |steps: usize| {
        let fit = fit(
            &system,
            std::slice::from_ref(&start),
            &Weights::equal(READINGS),
            steps,
        )
        .unwrap();
        Hypothesis {
            fit,
            weights: Weights::equal(READINGS),
            flagged: Vec::new(),
            flag_p: 1.0,
        }
    };
    let (short, whole) = (after(1), after(30));
    assert_eq!(
        (short.fit.status, whole.fit.status),
        (Status::NotConverged, Status::Converged)
    );
    assert!(
        short.is_physical(&system) && !short.is_admissible(&system),
        "{:?}",
        short.fit.terms
    );
    assert!(whole.is_admissible(&system), "{:?}", whole.fit.terms);
}

/// The search leaves it out and says which it was.
#[test]
fn an_effect_whose_fit_goes_on_falling_is_named_and_not_accepted() {
    let restless = Restless(shelved(10), AtomicU32::new(0));
    let found = search(&restless, &Weights::equal(READINGS), &Options::default()).unwrap();
    assert!(
        !names(&restless.0, &found.best).contains(&"shelf"),
        "{:?}",
        found.best.fit.terms
    );
    let shelf = |r: &Rejection| r.gate == Gate::NotConverged && r.effects == ["shelf"];
    assert!(found.rejections.iter().any(shelf), "{:?}", found.rejections);
    assert!(
        found
            .refitted
            .iter()
            .all(|h| h.fit.status != Status::NotConverged)
    );
    // Control: the same readings with a law that stands still.
    let found = search(&restless.0, &Weights::equal(READINGS), &Options::default()).unwrap();
    assert_eq!(
        (names(&restless.0, &found.best), found.rejections),
        (vec!["shelf"], Vec::new())
    );
}

/// A system whose shelf fits a little better each time it is asked: its sum of squares never
/// settles.
struct Restless(ToySystem, AtomicU32);

impl MeasurementModel for Restless {
    fn measured(&self) -> &DMatrix<f64> {
        self.0.measured()
    }
    fn design(&self, terms: &[EffectTerm]) -> Option<DMatrix<f64>> {
        let mut design = self.0.design(terms)?;
        if terms.iter().any(|t| t.effect == SHELF) {
            let off = 4e-3 * 0.999_f64.powf(f64::from(self.1.fetch_add(1, Ordering::SeqCst)));
            for i in 0..READINGS {
                design[(i, 1)] += off * (2.7 * i as f64).sin();
            }
        }
        Some(design)
    }
    fn catalogue(&self) -> &[Effect] {
        self.0.catalogue()
    }
    fn not_observable(&self, effect: usize) -> Option<String> {
        self.0.not_observable(effect)
    }
    fn groups(&self) -> &[u32] {
        self.0.groups()
    }
    fn covariates(&self) -> Vec<(String, Vec<f64>)> {
        self.0.covariates()
    }
}

#[test]
fn a_linear_effect_beyond_its_share_is_no_explanation() {
    // The part of c x^2 in 20 x + c x^2 is c / (20 + c).
    let physical = |share: f64, seed: u64| {
        let c = LINE[1] * share / (1.0 - share);
        let system = ToySystem::draw(seed, |_, x| c * x * x);
        let term = EffectTerm {
            effect: BEND,
            law: 0,
            values: Vec::new(),
        };
        let fit = fit(&system, &[term], &Weights::equal(READINGS), 5).unwrap();
        Hypothesis {
            fit,
            weights: Weights::equal(READINGS),
            flagged: Vec::new(),
            flag_p: 1.0,
        }
        .is_physical(&system)
    };
    // At the limit itself noise alone carries the estimate beyond it: 1 in 200 is refused
    // (one-sided, level 0.01).
    let kept = (0..200)
        .filter(|&seed| physical(BEND_SHARE, 7000 + seed))
        .count() as u64;
    assert!(200 - kept <= most(0.005, 200), "{kept} of 200");
    assert!(physical(0.5 * BEND_SHARE, 3));
    assert!(!physical(1.5 * BEND_SHARE, 3));
}

#[test]
fn columns_that_depend_on_each_other_are_said() {
    // A shelf of fixed place and the scale together with a free slope: the scale is the slope
    // again.
    let system = plain(3);
    let terms = [EffectTerm {
        effect: SCALE,
        law: 0,
        values: vec![0.1],
    }];
    let f = fit(&system, &terms, &Weights::equal(READINGS), 5).unwrap();
    let tangent = nuisance_basis(&base(&system)).project_off(&f.tangents[0]);
    assert!(tangent.norm() < 1e-9 * f.tangents[0].norm().max(1e-300));
}

// Signatures.

#[test]
fn what_the_slope_takes_up_has_no_signature() {
    let system = plain(4);
    let f = base(&system);
    let signatures = |e| {
        signatures_of_effect(
            &system,
            e,
            &f,
            &Weights::equal(READINGS),
            &nuisance_basis(&f),
        )
    };
    assert!(signatures(SCALE).is_empty(), "absorbed by the slope");
    assert_eq!(signatures(BEND).len(), 1);
    let shelves = signatures(SHELF);
    assert_eq!(shelves.len(), 4, "one a place of the grid");
    assert!(
        shelves
            .iter()
            .all(|a| a.one_sided && a.share_left > 0.05 && a.share_left < 1.0)
    );
}

#[test]
fn a_one_sided_signature_of_the_wrong_sign_gains_nothing() {
    let system = plain(5);
    let f = base(&system);
    let signature = &signatures_of_effect(
        &system,
        SHELF,
        &f,
        &Weights::equal(READINGS),
        &nuisance_basis(&f),
    )[2];
    let along: &DVector<f64> = &signature.projected[0];
    assert!((signature.gain(along) - along.norm_squared()).abs() < 1e-9 * along.norm_squared());
    assert_eq!(signature.gain(&-along), 0.0);
}

#[test]
fn a_basis_is_orthonormal_and_refuses_what_it_spans() {
    let mut basis = Basis::default();
    let a = DVector::from_fn(30, |i, _| (i as f64).sin());
    let b = DVector::from_fn(30, |i, _| (i as f64).cos());
    assert!(basis.push(&a) && basis.push(&b) && !basis.push(&(&a * 2.0 - &b)));
    assert!((basis.vectors()[0].dot(&basis.vectors()[1])).abs() < 1e-14);
    assert!(basis.project_off(&(&a + &b)).norm() < 1e-12);
}

// The omnibus test.

#[test]
fn the_family_holds_its_level_and_the_f_test_its_distribution() {
    let (mut family, mut single) = (0, 0);
    let trials = 400;
    for seed in 0..trials {
        let system = plain(1000 + seed);
        let f = base(&system);
        let basis = nuisance_basis(&f);
        let weights = Weights::equal(READINGS);
        let signatures: Vec<_> = [SHELF, BEND]
            .into_iter()
            .flat_map(|e| signatures_of_effect(&system, e, &f, &weights, &basis))
            .collect();
        let null = MinPDistribution::new(
            signatures.clone().into(),
            f.dof,
            &Options {
                seed,
                draws: 300,
                ..Options::default()
            },
        );
        let residual = stack(&f.residual);
        let p = |a| wcal_verify::method::min_p::signature_p(a, a.gain(&residual), f.ssr, f.dof);
        let smallest = signatures.iter().filter_map(p).fold(1.0, f64::min);
        family += u64::from(null.family_wise_p(smallest) < 0.05);
        let bend = signatures.last().unwrap();
        single += u64::from(f_test(bend.gain(&residual), f.ssr, f.dof, 1).unwrap() < 0.05);
    }
    assert!(
        family <= most(0.05, trials) && family >= 5,
        "family-wise {family} of {trials}"
    );
    assert!(
        single <= most(0.05, trials) && single >= 5,
        "single {single} of {trials}"
    );
}

#[test]
fn the_gate_lets_noise_pass_and_stops_an_effect() {
    let weights = Weights::equal(READINGS);
    let trials = 200;
    let rejected = (0..trials)
        .filter(|&s| {
            let system = plain(2000 + s);
            omnibus_test(
                &system,
                &base(&system),
                &weights,
                &Options {
                    seed: s,
                    draws: 500,
                    ..Options::default()
                },
            )
            .rejected()
        })
        .count() as u64;
    assert!(
        rejected <= most(0.02, trials),
        "{rejected} of {trials} nulls"
    );
    let system = shelved(6);
    let g = omnibus_test(
        &system,
        &base(&system),
        &weights,
        &Options {
            seed: 1,
            draws: 500,
            ..Options::default()
        },
    );
    assert!(
        g.rejected() && g.p_catalogue() < 1e-3,
        "{}",
        g.p_catalogue()
    );
}

#[test]
fn a_wave_in_time_is_seen_with_its_driver() {
    let system = ToySystem::draw(7, |i, _| {
        0.4 * (i as f64 * std::f64::consts::TAU / 13.0).sin()
    });
    let g = omnibus_test(
        &system,
        &base(&system),
        &Weights::equal(READINGS),
        &Options {
            seed: 1,
            draws: 500,
            ..Options::default()
        },
    );
    assert!(g.generic());
    assert_eq!(
        (g.covariates[0].covariate.as_str(), g.covariates[0].shape),
        ("t_s", "sinusoid")
    );
    let period = g.covariates[0].period.unwrap();
    assert!((period - 13.0).abs() < 1.5, "{period}");
}

// Single readings.

#[test]
fn exactly_the_moved_readings_are_flagged() {
    let system = ToySystem::draw(8, |i, _| {
        if i == 17 || i == 40 {
            12.0 * NOISE
        } else {
            0.0
        }
    });
    let weights = Weights::equal(READINGS);
    assert_eq!(
        reject_outliers(&system, &[], &base(&system), &weights)
            .unwrap()
            .flagged,
        [17, 40]
    );
    let trials = 300;
    let false_flags = (0..trials)
        .filter(|&s| {
            let system = plain(3000 + s);
            reject_outliers(&system, &[], &base(&system), &weights).is_some()
        })
        .count() as u64;
    // The level is shared over all readings; the median's own scatter adds a little.
    assert!(
        false_flags <= most(0.01, trials),
        "{false_flags} of {trials}"
    );
}

// Screening, refits, competing explanations, adequacy.

fn names(system: &ToySystem, h: &Hypothesis) -> Vec<&'static str> {
    h.effects(Some(OUTLIERS))
        .iter()
        .map(|&e| system.catalogue()[e].id)
        .collect()
}

#[test]
fn the_search_finds_nothing_one_or_two_effects() {
    let options = Options {
        draws: 500,
        ..Options::default()
    };
    let weights = Weights::equal(READINGS);
    let find = |system: &ToySystem| {
        let found = search(system, &weights, &options).unwrap();
        (names(system, &found.best), found.last_test.rejected())
    };
    assert_eq!(find(&plain(9)), (vec![], false));
    assert_eq!(find(&shelved(10)), (vec!["shelf"], false));
    let both = ToySystem::draw(11, |_, x| LINE[1] * HEIGHT * shelf(x, PLACE) - 2.0 * x * x);
    assert_eq!(find(&both), (vec!["shelf", "bend"], false));
    let (named, left) = find(&ToySystem::draw(12, |i, _| 0.4 * (i as f64 * 0.48).sin()));
    assert!(left && !named.contains(&"shelf"), "{named:?}");
}

/// A richer law of the same effect where the plain one leaves something, and only there.
#[test]
fn an_effect_is_refined_where_its_plain_law_leaves_something() {
    let fit_variance_function = |system: &ToySystem| {
        let found = search(system, &Weights::equal(READINGS), &Options::default()).unwrap();
        let laws: Vec<usize> = found.best.fit.terms.iter().map(|t| t.law).collect();
        (names(system, &found.best), laws, found.last_test.rejected())
    };
    let two = |seed| {
        ToySystem::draw(seed, |_, x| {
            LINE[1] * HEIGHT * (2.0 * shelf(x, 0.3) + shelf(x, 0.75))
        })
    };
    let found: Vec<_> = (0..10)
        .map(|seed| fit_variance_function(&two(9000 + seed)))
        .collect();
    let refined = found
        .iter()
        .filter(|f| **f == (vec!["shelf"], vec![1], false))
        .count();
    assert!(refined >= 8, "{refined} of 10: {found:?}");
    // Negative control: one shelf is not refined, but by chance.
    let alone = (0..20)
        .filter(|&seed| fit_variance_function(&shelved(9100 + seed)).1.contains(&1))
        .count() as u64;
    assert!(alone <= most(0.01, 20), "{alone} of 20");
}

#[test]
fn an_effect_too_small_to_tell_leaves_its_rival_in_the_set() {
    // A gentle bend looks like a broad shelf on noisy readings: the true one must stay among the
    // survivors.
    let options = Options {
        draws: 300,
        ..Options::default()
    };
    let trials = 60;
    let (mut named, mut kept) = (0, 0);
    for seed in 0..trials {
        let system = ToySystem::draw(4000 + seed, |_, x| -x * x);
        let found = search(&system, &Weights::equal(READINGS), &options).unwrap();
        if names(&system, &found.best).is_empty() {
            continue;
        }
        named += 1;
        kept += u64::from(
            found
                .survivors
                .iter()
                .any(|h| names(&system, h).contains(&"bend")),
        );
    }
    assert!(named > 30, "{named}");
    assert!(named - kept <= most(0.02, named), "{kept} of {named}");
}

#[test]
fn stated_intervals_cover() {
    let trials = 200;
    let mut inside = [0u64; 2];
    for seed in 0..trials {
        let system = shelved(5000 + seed);
        let weights = Weights::equal(READINGS);
        let start = EffectTerm {
            effect: SHELF,
            law: 0,
            values: vec![HEIGHT, PLACE],
        };
        let f = fit(&system, &[start], &weights, 30).unwrap();
        let h = Hypothesis {
            fit: f,
            weights,
            flagged: Vec::new(),
            flag_p: 1.0,
        };
        for (k, (p, truth)) in parameters(&system, &h, SHELF)
            .iter()
            .zip([HEIGHT, PLACE])
            .enumerate()
        {
            inside[k] += u64::from(p.interval95[0] <= truth && truth <= p.interval95[1]);
        }
    }
    for count in inside {
        let missed = trials - count;
        assert!(missed <= most(0.05, trials), "{inside:?} of {trials}");
    }
}
