//! Acceptance of the tracker along a known motion: regions and weights of the regimes on contacts
//! that stay, creep and slide, along a reversed motion, and on a wire of another diameter
//! (SIMULATED; seeds on which nothing was chosen).
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod plant_sweep;

use nalgebra::{Matrix2, Rotation3, Vector3};
use plant_sweep::{calibrated, moments, readings, whisker};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use wcal_core::observation::WhiskerSpec;
use wcal_plant::sweep::SweepCase;
use wcal_track::calibrated_wire::CalibratedWire;
use wcal_track::estimator::{Contact, Estimator};
use wcal_track::known_motion::MomentField;
use wcal_track::reading::{Moments, MotionAccuracy, Reading, RowMotion};
use wcal_track::regimes::ANY_OBJECT;
use wcal_track::tracker::ContactTracker;

const NOISE_NMM: f64 = 1e-3;
const MOVED_SD_MM: f64 = 0.002;
/// Squared radius of the 95 % region of three Gaussian numbers.
const CHI2_95: f64 = 7.815;
/// Presses of a family, and sweeps.
const PRESSES: u64 = 24;
const SWEEPS: u64 = 4;
/// Seeds: none of them was looked at when anything was chosen.
const SEED: u64 = 41_000;
/// Relative standard deviation of another wire's diameter, and of the moments by it.
const DIAMETER_SHARE: f64 = 0.01;
/// Mesh of the rods, mm.
const MESH_MM: f64 = 4.0;

/// How a contact moves on what it touches.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Family {
    Fixed,
    Creeping,
    Reversed,
    OtherWire,
    Sliding,
}

/// A reading with the true contact: its place and its arc length, mm.
struct Known {
    reading: Reading,
    touch: Option<(Vector3<f64>, f64)>,
}

fn reading(
    k: usize,
    moment_nmm: [f64; 2],
    (moved_mm, velocity_mm_s): (Vector3<f64>, Vector3<f64>),
) -> Reading {
    let noise_nmm2 = Matrix2::identity() * NOISE_NMM * NOISE_NMM;
    let moments = moments(moment_nmm, noise_nmm2, Vec::new());
    let motion = RowMotion {
        moved_mm,
        turn: Rotation3::identity(),
        velocity_mm_s,
        piece: 0,
        push: None,
    };
    Reading {
        motion: Ok(motion),
        ..Reading::alone(k as i64, 0.1 * k as f64, Some(moments))
    }
}

/// A point pressed along z from 1 mm before the wire to 5 mm past it.
fn press(field: &MomentField, family: Family, seed: u64) -> Vec<Known> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (s_mm, turn): (f64, f64) = (
        rng.random_range(16.0..50.0),
        rng.random_range(0.0..std::f64::consts::TAU),
    );
    let creep = if family == Family::Creeping {
        rng.random_range(0.02..0.3)
    } else {
        0.0
    };
    let thicker: f64 = DIAMETER_SHARE * rng.sample::<f64, _>(StandardNormal);
    let stiffer = if family == Family::OtherWire {
        (1.0 + thicker).powi(4)
    } else {
        1.0
    };
    let way = if family == Family::Reversed {
        -1.0
    } else {
        1.0
    };
    // What the tracker calls unknown is drawn: the gap, and the motion's jitter.
    let mut normal = |sd: f64| -> f64 { sd * rng.sample::<f64, _>(StandardNormal) };
    let (wire, tangent) = field.free(s_mm);
    let touch = wire + tangent.cross(&Vector3::z()).normalize() * normal(0.5);
    let goes_on = Vector3::new(turn.cos(), turn.sin(), 0.0) * creep;
    let one = |k: usize| {
        let depth = 0.12 * k as f64 - 1.0;
        let held = (depth > 0.0).then(|| touch + Vector3::z() * depth + goes_on * depth);
        let moment = held.map_or([0.0; 2], |p| field.held(&p, 0.0).unwrap().moment_nmm);
        let read = moment.map(|m| stiffer * m + normal(NOISE_NMM));
        let jitter = Vector3::from_fn(|_, _| normal(MOVED_SD_MM));
        let motion = (
            Vector3::z() * depth * way + jitter,
            Vector3::z() * 1.2 * way,
        );
        let now = |p: Vector3<f64>| (p, field.held(&p, 0.0).unwrap().arclength_mm);
        Known {
            reading: reading(k, read, motion),
            touch: held.map(now),
        }
    };
    (0..50).map(one).collect()
}

/// A sweep of the independent plant.
fn sweep(case: &SweepCase) -> Vec<Known> {
    let touch = |k: usize| {
        case.readings[k]
            .touch
            .as_ref()
            .map(|t| (t.axis_mm, t.arclength_mm))
    };
    readings(case, 1.0)
        .into_iter()
        .enumerate()
        .map(|(k, reading)| Known {
            reading,
            touch: touch(k),
        })
        .collect()
}

/// What the tracker states of the readings of one record.
#[derive(Default)]
struct Stated {
    /// By reading in contact whether the ellipsoid in space holds the true place, whether the
    /// region along the wire holds its arc length, and the standard deviation in space, mm.
    rows: Vec<(bool, bool, f64)>,
    /// Of them those that are in doubt.
    flagged: usize,
    /// Largest weight of the family over the contacts.
    weight: f64,
}

fn tracked(wire: CalibratedWire, record: &[Known], family: Family) -> Stated {
    let accuracy = MotionAccuracy {
        moved_sd_mm: MOVED_SD_MM,
        clock_sd_s: 0.0,
        window_sd_s: 0.0,
    };
    let mut table = ContactTracker::of_record(wire, accuracy, ANY_OBJECT);
    record
        .iter()
        .for_each(|k| assert!(table.push(&k.reading).unwrap().is_empty()));
    let found = table.finish().unwrap();
    let one = |(contact, known): (&Contact, &Known)| {
        let (estimate, (place, s_mm)) = contact.estimate.zip(known.touch)?;
        let (off, covariance) = (estimate.place_mm - place, estimate.covariance_mm2);
        let inside = covariance
            .cholesky()
            .is_some_and(|c| off.dot(&c.solve(&off)) <= CHI2_95);
        let held = contact
            .regions
            .iter()
            .any(|r| (r.from_mm - 1e-9..=r.to_mm + 1e-9).contains(&s_mm));
        Some((inside, held, covariance.trace().sqrt()))
    };
    let rows = found.iter().zip(record).filter_map(one).collect();
    let in_doubt =
        |(contact, known): &(&Contact, &Known)| known.touch.is_some() && !contact.flags.none();
    let flagged = found.iter().zip(record).filter(in_doubt).count();
    let contacts = table.findings().document.contacts.unwrap();
    let own = match family {
        Family::Fixed | Family::OtherWire => "fixed",
        Family::Creeping => "creeping",
        Family::Reversed => "misstated",
        Family::Sliding => "sliding",
    };
    let weight = contacts
        .iter()
        .map(|c| c.weights.as_ref().unwrap()[own])
        .fold(0.0, f64::max);
    Stated {
        rows,
        flagged,
        weight,
    }
}

/// Shares of the readings that ellipsoids and regions hold and that are in doubt, and of the
/// records that have the right regime.
fn judged(family: Family, tolerance: f64) -> [f64; 4] {
    let tolerance = (family == Family::OtherWire && tolerance > 0.0).then_some(tolerance);
    let wire = calibrated(&WhiskerSpec::nominal(), MESH_MM).with_tolerance(tolerance);
    let one = |k: u64| match family {
        Family::Sliding => {
            let case = SweepCase::draw(SEED + 500 + k).unwrap();
            tracked(calibrated(&whisker(&case), MESH_MM), &sweep(&case), family)
        }
        _ => tracked(
            wire.clone(),
            &press(&wire.field, family, SEED + 100 * family as u64 + k),
            family,
        ),
    };
    let records = if family == Family::Sliding {
        SWEEPS
    } else {
        PRESSES
    };
    let all: Vec<Stated> = (0..records).into_par_iter().map(one).collect();
    let mut sds: Vec<f64> = all
        .iter()
        .flat_map(|s| s.rows.iter().map(|r| r.2))
        .collect();
    sds.sort_by(f64::total_cmp);
    let n = sds.len().max(1) as f64;
    let share = |of: fn(&(bool, bool, f64)) -> bool| {
        all.iter().flat_map(|s| &s.rows).filter(|r| of(r)).count() as f64 / n
    };
    let right = all.iter().filter(|s| s.weight > 0.5).count() as f64 / records as f64;
    let flagged = all.iter().map(|s| s.flagged).sum::<usize>() as f64 / n;
    let found = [share(|r| r.0), share(|r| r.1), flagged, right];
    println!(
        "SIMULATED {family:?}: {records} records, {n} readings: in space {:.3}, along the wire {:.3}, sd median {:.3} mm, in doubt {flagged:.3}, right \
         regime {right:.2}",
        found[0],
        found[1],
        sds.get(sds.len() / 2).copied().unwrap_or(f64::NAN)
    );
    found
}

#[test]
fn regions_hold_and_the_regime_is_told_in_every_family() {
    for family in [
        Family::Fixed,
        Family::Creeping,
        Family::Reversed,
        Family::OtherWire,
        Family::Sliding,
    ] {
        let [in_space, along, flagged, right] = judged(family, DIAMETER_SHARE);
        // 24 presses, or four sweeps, of which each is held or not: the goal is 0.92 to 0.97 and
        // 0.9, measured in the lab notes.
        assert!(
            in_space > 0.85 && along > 0.7 && right > 0.8,
            "{family:?}: {in_space} {along} {right}"
        );
        // A motion that is not the moments' is in doubt, a contact that creeps or slides is not.
        assert!(
            (flagged > 0.5) == (family == Family::Reversed),
            "{family:?}: {flagged}"
        );
    }
    // Control: a foreign wire that is taken for the calibration's own is mostly lost.
    let [in_space, ..] = judged(Family::OtherWire, 0.0);
    assert!(in_space < 0.5, "{in_space}");
}

/// Rows in contact that are located, of a press read so often whose readings have the noise from
/// pose to pose, or one of their own.
fn located(hz: f64, deepest_mm: f64, own: bool) -> (usize, usize) {
    let wire = calibrated(&WhiskerSpec::nominal(), MESH_MM);
    let (touch, _) = wire.field.free(30.0);
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut table = ContactTracker::of_record(
        wire.clone(),
        MotionAccuracy {
            moved_sd_mm: MOVED_SD_MM,
            clock_sd_s: 0.0,
            window_sd_s: 0.0,
        },
        ANY_OBJECT,
    );
    let (speed_mm_s, sd_nmm) = (5.0, 4.0 * NOISE_NMM);
    let count = ((1.0 + deepest_mm) / speed_mm_s * hz) as usize;
    let depth = |k: usize| speed_mm_s * k as f64 / hz - 1.0;
    for k in 0..count {
        let held = (depth(k) > 0.0).then(|| {
            wire.field
                .held(&(touch + Vector3::z() * depth(k)), 0.0)
                .unwrap()
        });
        let moment_nmm = held
            .map_or([0.0; 2], |h| h.moment_nmm)
            .map(|m| m + sd_nmm * rng.sample::<f64, _>(StandardNormal));
        let plain = reading(
            k,
            moment_nmm,
            (Vector3::z() * depth(k), Vector3::z() * speed_mm_s),
        );
        let noise_nmm2 = Matrix2::identity() * sd_nmm * sd_nmm;
        let moments = moments(moment_nmm, noise_nmm2, Vec::new());
        let moments = Moments {
            own_nmm2: own.then_some(noise_nmm2),
            ..moments
        };
        table
            .push(&Reading {
                t_s: k as f64 / hz,
                moments: Some(moments),
                ..plain
            })
            .unwrap();
    }
    let found = table.finish().unwrap();
    let of = |held: bool| (0..count).filter(move |k| (depth(*k) > 0.0) == held);
    let seen = |k: &usize| found[*k].estimate.is_some_and(|e| e.probability > 0.5);
    (
        of(true).filter(seen).count() * 100 / of(true).count().max(1),
        of(false).filter(seen).count(),
    )
}

#[test]
fn more_readings_locate_no_fewer_contacts() {
    for own in [true, false] {
        let ((few, _), (many, free)) = (located(10.0, 2.0, own), located(200.0, 2.0, own));
        assert!(
            few > 40 && many + 5 >= few && free < 20,
            "{own}: {few} % and {many} %, {free} free"
        );
        // Control: a wire that is not touched.
        assert_eq!(located(200.0, 0.0, own).1, 0);
    }
}
