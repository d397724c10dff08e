//! Physics of sweeps (SIMULATED): friction, softening and medium as drawn, and base moments against
//! the continuous rod.

use nalgebra::Vector3;
use wcal_core::observation::WhiskerSpec;
use wcal_lab_sweeps::physics::{Medium, PhysicsPlan};
use wcal_lab_sweeps::rod_engine::{LINKS, Run};
use wcal_lab_sweeps::{RodEngine, Sweep, SweepPlan, Verdict, objects};
use wcal_rod::{Guess, Rod, Shape, Tangential};

fn whisker() -> WhiskerSpec {
    WhiskerSpec::nominal()
}

fn plan(physics: PhysicsPlan) -> SweepPlan {
    SweepPlan {
        physics,
        ..SweepPlan::default()
    }
}

fn runs(names: &[&str], plan: &SweepPlan, count: u64) -> Vec<(Sweep, Run)> {
    let engine = RodEngine::new(&whisker(), LINKS).unwrap();
    let mut all = Vec::new();
    for name in names {
        let mesh = objects::built_in(name).unwrap();
        for k in 0..count {
            let Some(sweep) = Sweep::draw(&mesh, plan, 5, k, engine.reach_mm()) else {
                continue;
            };
            let run = engine.run(&mesh, &sweep, plan);
            all.push((sweep, run));
        }
    }
    all
}

fn kept(all: &[(Sweep, Run)]) -> usize {
    all.iter()
        .filter(|(_, r)| r.verdict == Verdict::Kept)
        .count()
}

#[test]
fn friction_stays_in_its_cone_and_the_root_carries_it() {
    let names = ["can", "vase", "hexagon-bar", "ball"];
    let rough = plan(PhysicsPlan {
        friction: [0.05, 0.4],
        ..PhysicsPlan::default()
    });
    let all = runs(&names, &rough, 3);
    let smooth = runs(&names, &plan(PhysicsPlan::default()), 3);
    assert!(
        kept(&all) * 10 >= kept(&smooth) * 8,
        "{} of {}",
        kept(&all),
        kept(&smooth)
    );
    let (mut slides, mut sticks, mut imbalance, mut unsettled, mut without) =
        (0, 0, Vec::new(), 0, Vec::new());
    for (sweep, run) in &all {
        let mu = sweep.physics.friction;
        assert!((0.05..=0.4).contains(&mu));
        for sample in &run.samples {
            unsettled += usize::from(!sample.settled);
            if !sample.settled || sample.contacts.is_empty() {
                continue;
            }
            let (mut applied, mut normal) = (Vector3::zeros(), Vector3::zeros());
            for c in &sample.contacts {
                let share = c.friction_n.norm() / (mu * c.force_n);
                assert!(
                    share < 1.0 + 1e-9 && c.friction_n.dot(&c.normal).abs() < 1e-9,
                    "{c:?}"
                );
                slides += usize::from(share > 0.98);
                sticks += usize::from(share <= 0.98);
                normal += c.centre_mm.cross(&(c.normal * c.force_n));
                applied += c.centre_mm.cross(&(c.normal * c.force_n + c.friction_n));
            }
            imbalance.push((sample.moment_nmm - applied).norm());
            without.push((sample.moment_nmm - normal).norm());
        }
    }
    let count: usize = all.iter().map(|(_, r)| r.samples.len()).sum();
    for x in [&mut imbalance, &mut without] {
        x.sort_by(f64::total_cmp);
    }
    let at = |x: &[f64], share: usize| x[x.len() * share / 100];
    println!(
        "friction: {slides} slide, {sticks} stick; {unsettled} of {count} samples not settled; imbalance p50 {:.1e} p95 {:.1e} N mm, without friction p50 {:.1e}",
        at(&imbalance, 50),
        at(&imbalance, 95),
        at(&without, 50)
    );
    assert!(slides > 300, "{slides} {sticks}");
    assert!(at(&imbalance, 95) < 2e-3, "{}", at(&imbalance, 95));
    assert!(
        at(&without, 50) > 1e-3,
        "negative control: friction matters ({})",
        at(&without, 50)
    );
    assert!(unsettled * 20 < count, "{unsettled} of {count}");
    // What is switched on leaves the way of the sweep as it was.
    for ((a, _), (b, _)) in all.iter().zip(&smooth) {
        assert!((a.turn, a.shift_mm, a.speed_mm_s) == (b.turn, b.shift_mm, b.speed_mm_s));
        assert_eq!(b.physics.friction, 0.0);
    }
}

#[test]
fn a_softened_wire_carries_less() {
    let soft = plan(PhysicsPlan {
        softening_onset_per_m: Some([25.0, 30.0]),
        ..PhysicsPlan::default()
    });
    let (soft, hard) = (
        runs(&["block"], &soft, 6),
        runs(&["block"], &plan(PhysicsPlan::default()), 6),
    );
    let largest = |run: &Run| {
        run.samples
            .iter()
            .map(|s| s.moment_nmm.norm())
            .fold(0.0, f64::max)
    };
    // EI times the onset: below it nothing changes, above it the soft wire carries less.
    let ei_nmm2 = 75e3 * std::f64::consts::PI * 0.3_f64.powi(4) / 64.0;
    let (mut above, mut below) = (0, 0);
    for ((sweep, a), (_, b)) in soft.iter().zip(&hard) {
        let onset_nmm = ei_nmm2 * sweep.physics.onset_per_m().unwrap() * 1e-3;
        if largest(b) < 0.95 * onset_nmm {
            assert!((largest(a) - largest(b)).abs() < 1e-6);
            below += 1;
        } else if largest(b) > 1.1 * onset_nmm && a.samples.len() == b.samples.len() {
            assert!(largest(a) < largest(b), "{} {}", largest(a), largest(b));
            above += 1;
        }
    }
    assert!(above > 0 && below > 0, "{above} {below}");
}

#[test]
fn the_medium_bends_the_free_wire() {
    let still = plan(PhysicsPlan {
        medium: Medium::Air,
        weight: true,
        ..PhysicsPlan::default()
    });
    let shape = Shape::new(&whisker().rest_shape, 0.25).unwrap();
    let points = (0..600).map(|k| shape.rest_point(0.05 + 0.1 * f64::from(k)));
    let arm: Vector3<f64> = points.map(|p| p * 0.1).sum();
    let per_mm =
        (6450.0 - 1.204) * std::f64::consts::PI / 4.0 * 0.3e-3_f64.powi(2) * 9.80665 * 1e-3;
    for (sweep, run) in runs(&["can"], &still, 4) {
        let weight = arm.cross(&(sweep.physics.gravity.unwrap() * per_mm));
        let first = run.samples[0].moment_nmm;
        // The rest shape's moment; the wire's own sag changes it by a few per cent.
        assert!(
            (first - weight).norm() < 0.06 * arm.norm() * per_mm,
            "{first} {weight}"
        );
    }
    let current = PhysicsPlan {
        medium: Medium::Water,
        current_mm_s: [100.0; 2],
        ..PhysicsPlan::default()
    };
    let drag = runs(&["can"], &plan(current), 4);
    assert!(
        drag.iter()
            .all(|(_, r)| (5e-4..0.05).contains(&r.samples[0].moment_nmm.norm()))
    );
    // Negative control: neither weight nor current.
    let none = runs(&["can"], &plan(PhysicsPlan::default()), 4);
    assert!(
        none.iter()
            .all(|(_, r)| r.samples[0].moment_nmm.norm() < 1e-9)
    );
}

#[test]
fn physics_that_cannot_be_is_named() {
    for (physics, words) in [
        (
            PhysicsPlan {
                friction: [0.4, 0.1],
                ..PhysicsPlan::default()
            },
            "friction: expected 0 <= low <= high <= 2",
        ),
        (
            PhysicsPlan {
                weight: true,
                ..PhysicsPlan::default()
            },
            "medium: expected \"air\" or \"water\"",
        ),
        (
            PhysicsPlan {
                friction: [f64::NAN; 2],
                ..PhysicsPlan::default()
            },
            "friction",
        ),
        (
            PhysicsPlan {
                softening_onset_per_m: Some([0.0, 1.0]),
                ..PhysicsPlan::default()
            },
            "softening_onset_per_m",
        ),
    ] {
        let error = plan(physics).check().unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// The links' base moment against the continuous rod's, held at the same place by a frictionless
/// point (ideal contact of docs/src/method.md).
#[test]
fn base_moments_of_sweeps_are_the_rods() {
    let names = ["can", "vase", "ball", "rock"];
    let all = runs(&names, &plan(PhysicsPlan::default()), 4);
    let rod = Rod::new(&whisker(), 1.0).unwrap();
    let (mut errors, mut of_scale, mut skipped) = (Vec::new(), Vec::new(), 0);
    let scale = all
        .iter()
        .flat_map(|(_, r)| &r.samples)
        .map(|s| s.moment_nmm.norm())
        .fold(0.0, f64::max);
    for (_, run) in all.iter().filter(|(_, r)| r.verdict == Verdict::Kept) {
        for sample in run.samples.iter().filter(|s| s.settled) {
            // One contact between root and tip: a tip that rests on a surface is held along the
            // wire too.
            let [c] = sample.contacts[..] else { continue };
            if c.arclength_mm > 59.5 || sample.moment_nmm.norm() < 0.05 {
                continue;
            }
            let guess = Guess {
                force_n: c.normal * c.force_n,
                arclength_mm: c.arclength_mm,
            };
            let Ok(found) = rod.solve(&c.centre_mm, &guess, Tangential::Frictionless) else {
                skipped += 1;
                continue;
            };
            let error = (sample.moment_nmm - found.moment_nmm).norm();
            errors.push(error / found.moment_nmm.norm());
            of_scale.push(error / scale);
        }
    }
    for x in [&mut errors, &mut of_scale] {
        x.sort_by(f64::total_cmp);
    }
    let at = |x: &[f64], share: usize| 100.0 * x[(x.len() - 1) * share / 100];
    println!(
        "{} samples, {skipped} without a rod's equilibrium: base moment off by p50 {:.3} p95 {:.3} max {:.3} % of itself, p50 {:.3} p95 {:.3} max {:.3} % of {scale:.2} N mm",
        errors.len(),
        at(&errors, 50),
        at(&errors, 95),
        at(&errors, 100),
        at(&of_scale, 50),
        at(&of_scale, 95),
        at(&of_scale, 100)
    );
    assert!(
        errors.len() > 300 && skipped * 20 < errors.len(),
        "{} {skipped}",
        errors.len()
    );
    assert!(
        at(&errors, 95) < 0.5 && at(&of_scale, 95) < 0.1,
        "{} {}",
        at(&errors, 95),
        at(&of_scale, 95)
    );
}
