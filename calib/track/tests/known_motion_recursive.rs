//! The recursive posterior of known motion on presses by the tracker's own rod (SIMULATED): its
//! regions on the way.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use nalgebra::{Matrix2, Rotation3, Vector3};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use wcal_core::observation::{MomentAxes, WhiskerSpec};
use wcal_rod::Rod;
use wcal_track::known_motion::contact_path::State;
use wcal_track::known_motion::{
    CorrelatedNoise, Friction, Innovations, MomentField, MotionRow, RecursivePosterior, Segmenter,
    Settings, Step,
};

const NOISE_NMM: f64 = 4e-3;
const CLOCK_SD_S: f64 = 0.01;
const MOVED_SD_MM: f64 = 0.02;

fn field(friction: Friction) -> MomentField {
    MomentField::new(
        &Rod::new(&WhiskerSpec::nominal(), 4.0).unwrap(),
        &MomentAxes::default(),
        friction,
    )
}

fn settings(correlated: Option<CorrelatedNoise>) -> Settings {
    Settings {
        clock_sd_s: CLOCK_SD_S,
        correlated,
        ..Settings::default()
    }
}

fn normal(rng: &mut impl Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// A press, a hold, half of the way back and on again, with everything that the model calls unknown
/// drawn from its prior.
struct Press {
    rows: Vec<MotionRow>,
    push: Vector3<f64>,
    /// Arc length, gap and displacement at first touch.
    truth: State,
}

/// What is drawn of what is not known, as shares of the stated standard deviations.
#[derive(Clone, Copy)]
struct Draws {
    gap: f64,
    motion: f64,
    /// Factor on the moments that the filter is given.
    scale: f64,
}

/// All that the model calls unknown.
const ALL: Draws = Draws {
    gap: 1.0,
    motion: 1.0,
    scale: 1.0,
};

fn press(field: &MomentField, seed: u64, draws: Draws) -> Option<Press> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let s_mm: f64 = rng.random_range(10.0..56.0);
    let (wire, tangent) = field.free(s_mm);
    let aside = Vector3::new(-tangent.z, 0.0, tangent.x).normalize();
    let turn: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let push = (aside * turn.cos()
        + aside.cross(&tangent) * turn.sin()
        + tangent * rng.random_range(-0.3..0.3))
    .normalize();
    let gap_mm = 0.5 * draws.gap * normal(&mut rng);
    let touch = wire + tangent.cross(&push).normalize() * gap_mm;
    // Ways past first touch, mm, a row every 0.1 s.
    let (step, deepest) = (rng.random_range(0.15..0.5), 0.15 * s_mm);
    let mut way: f64 = -2.0 - step * rng.random_range(0.0..1.0);
    let mut ways = Vec::new();
    let mut go = |to: f64, way: &mut f64| {
        while (to - *way).abs() > step {
            *way += step * (to - *way).signum();
            ways.push(*way);
        }
    };
    go(deepest, &mut way);
    let hold = way;
    go(0.5 * deepest, &mut way);
    go(deepest, &mut way);
    let at = ways.iter().position(|w| *w == hold).unwrap_or(0);
    ways.splice(at..at, [hold; 5]);
    let (clock_s, common): (f64, [f64; 4]) = (
        CLOCK_SD_S * draws.motion * normal(&mut rng),
        std::array::from_fn(|_| normal(&mut rng)),
    );
    let mut rows = Vec::new();
    for (k, way) in ways.iter().enumerate() {
        let before = if k == 0 { way - step } else { ways[k - 1] };
        let after = ways.get(k + 1).copied().unwrap_or(*way);
        let velocity_mm_s = push * ((after - before) / 0.2);
        // The readings' clock is off, and the motion is not where it is said to be.
        let jitter = Vector3::from_fn(|_, _| MOVED_SD_MM * draws.motion * normal(&mut rng));
        let place = touch + push * *way + velocity_mm_s * clock_s + jitter;
        let held = (place - touch).dot(&push) > 0.0;
        let m = if held {
            field.held(&place, 0.0)?.moment_nmm
        } else {
            [0.0; 2]
        };
        // Two gains and two zeros.
        let shared_nmm = vec![
            [0.005 * m[0], 0.0],
            [0.0, 0.005 * m[1]],
            [2e-3, 0.0],
            [0.0, 2e-3],
        ];
        let off = |c: usize| {
            shared_nmm
                .iter()
                .zip(common)
                .map(|(h, z)| h[c] * z)
                .sum::<f64>()
        };
        rows.push(MotionRow {
            t_s: 0.1 * k as f64,
            moment_nmm: [0, 1]
                .map(|c| draws.scale * (m[c] + off(c) + NOISE_NMM * normal(&mut rng))),
            noise_nmm2: Matrix2::identity() * NOISE_NMM * NOISE_NMM,
            shared_nmm,
            free_nmm2: None,
            shared_displacement_mm: Vec::new(),
            moved_mm: push * *way,
            turn: Rotation3::identity(),
            velocity_mm_s,
            moved_sd_mm: MOVED_SD_MM * draws.motion,
            free: false,
            contact_segment: 0,
        });
    }
    Some(Press {
        rows,
        push,
        truth: State {
            s_mm,
            onset_mm: 0.0,
            gap_mm,
        },
    })
}

fn loaded(row: &MotionRow) -> bool {
    let shared: f64 = row
        .shared_nmm
        .iter()
        .map(|h| h[0] * h[0] + h[1] * h[1])
        .sum();
    row.moment_nmm[0].hypot(row.moment_nmm[1]) > 4.0 * (row.noise_nmm2.trace() + shared).sqrt()
}

/// The posterior from the first loaded reading on, with a call after every reading.
fn recursive(
    field: &MomentField,
    press: &Press,
    mut each: impl FnMut(usize, &RecursivePosterior, f64),
) {
    let first = press.rows.iter().position(loaded).unwrap();
    let reference_mm = press.rows[first].moved_mm.dot(&press.push);
    let lead = &press.rows[first.saturating_sub(12)..first];
    let start =
        RecursivePosterior::start(field, settings(None), press.push, lead, &press.rows[first]);
    let mut found = start.unwrap();
    each(0, &found, reference_mm);
    for (k, row) in press.rows[first + 1..].iter().enumerate() {
        found.push(field, row);
        each(k + 1, &found, reference_mm);
    }
}

/// Share of presses whose joint region holds the true state, and whose pieces hold the arc length,
/// after so many readings.
fn coverage(
    field: &MomentField,
    seeds: std::ops::Range<u64>,
    draws: Draws,
) -> Vec<(usize, usize, f64, f64)> {
    const AFTER: [usize; 6] = [0, 1, 3, 8, 15, 30];
    let held = seeds.into_par_iter().filter_map(|seed| {
        let press = press(field, seed, draws)?;
        let mut held = Vec::new();
        recursive(field, &press, |k, found, reference_mm| {
            if AFTER.contains(&k) {
                let posterior = found.posterior();
                let truth = State {
                    onset_mm: press.truth.onset_mm - reference_mm,
                    ..press.truth
                };
                let arc = posterior
                    .regions()
                    .iter()
                    .any(|r| (r.from_mm..=r.to_mm).contains(&truth.s_mm));
                held.push((k, posterior.holds(&truth), arc));
            }
        });
        Some(held)
    });
    let held: Vec<_> = held.flatten().collect();
    AFTER
        .iter()
        .map(|after| {
            let here: Vec<_> = held.iter().filter(|h| h.0 == *after).collect();
            let share = |n: usize| n as f64 / here.len() as f64;
            let [joint, arc] = [
                here.iter().filter(|h| h.1).count(),
                here.iter().filter(|h| h.2).count(),
            ];
            (*after, here.len(), share(joint), share(arc))
        })
        .collect()
}

#[test]
fn regions_hold_the_truth_all_along() {
    let field = field(Friction::NONE);
    let all = coverage(&field, 100..400, ALL);
    for (after, n, joint, arc) in &all {
        println!(
            "after {after} more readings: {n} presses, joint region {joint:.3}, pieces along the wire {arc:.3}"
        );
    }
    // Three hundred presses: 95 % within 3 sd of the binomial (1.3 %) at each, all together closer.
    for (after, _, joint, _) in &all {
        assert!((0.91..0.99).contains(joint), "{after}: {joint}");
    }
    let mean = all.iter().map(|c| c.2).sum::<f64>() / all.len() as f64;
    println!("mean over the way: {mean:.3}");
    assert!((0.92..0.975).contains(&mean), "{mean}");
    // Control: moments of another map.
    let wrong = coverage(&field, 100..160, Draws { scale: 1.15, ..ALL });
    let last = wrong.last().unwrap();
    assert!(last.2 < 0.6, "{wrong:?}");
}

/// Innovations of all contacts of rows as a stream takes them, and the readings at which motion and
/// moments disagree.
fn streamed(wire: &MomentField, press: &Press, factor: f64) -> (Vec<Innovations>, usize) {
    let (settings, mut segmenter) = (settings(None), Segmenter::new(wire));
    let mut posterior: Option<RecursivePosterior> = None;
    let (mut contacts, mut disagreeing) = (Vec::new(), 0);
    for row in &press.rows {
        let (moved_mm, velocity_mm_s) = (row.moved_mm * factor, row.velocity_mm_s * factor);
        let mut row = MotionRow {
            moved_mm,
            velocity_mm_s,
            ..row.clone()
        };
        let is_loaded = settings.is_loaded(&row);
        match segmenter.push(&mut row, 0, None, is_loaded) {
            Step::Begins(b) => posterior = RecursivePosterior::begin(wire, settings, &b),
            Step::Within => posterior.iter_mut().for_each(|p| p.push(wire, &row)),
            Step::Outside => {}
        }
        contacts.extend(
            segmenter
                .take_ended()
                .and_then(|_| Some(posterior.take()?.innovations())),
        );
        disagreeing += usize::from(
            posterior
                .as_ref()
                .is_some_and(|p| !p.innovations().consistent()),
        );
    }
    segmenter.interrupt();
    contacts.extend(
        segmenter
            .take_ended()
            .and_then(|_| Some(posterior.take()?.innovations())),
    );
    (contacts, disagreeing)
}

#[test]
fn a_stream_finds_its_episodes_and_doubts_a_reversed_motion() {
    let wire = field(Friction::NONE);
    let (mut named, mut doubted, mut plain, mut all) = (0, 0, 0, 0);
    for seed in 0..12 {
        let Some(press) = press(&wire, seed, ALL) else {
            continue;
        };
        all += 1;
        let (contacts, off) = streamed(&wire, &press, 1.0);
        assert_eq!(contacts.len(), 1, "{seed}: {contacts:?}");
        plain += usize::from(off == 0 && contacts[0].consistent());
        // Control: the object goes the other way.
        let (contacts, off) = streamed(&wire, &press, -1.0);
        doubted += usize::from(off > 5);
        named += usize::from(contacts.iter().any(|i| !i.consistent()));
    }
    println!("{all} presses: {plain} agree, reversed {doubted} doubted on the way, {named} named");
    assert!(
        plain + 1 >= all && doubted + 1 >= all && named * 10 >= all * 8,
        "{plain} {doubted} {named} of {all}"
    );
}
