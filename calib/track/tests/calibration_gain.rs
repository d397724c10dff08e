//! What an error of the calibration's gain does to a track along a known motion: contacts that
//! slide one way, that slide there and back, and that stay at a point (SIMULATED by the independent
//! plant, and by the rod where a point holds the wire).
#![allow(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that fails should say where, and one that measures says what it found"
)]

mod plant_sweep;

use nalgebra::{Matrix2, Matrix3, Rotation3, Vector3};
use plant_sweep::{calibrated, moments, readings, whisker};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rayon::prelude::*;
use wcal_core::observation::WhiskerSpec;
use wcal_plant::sweep::SweepCase;
use wcal_track::calibrated_wire::CalibratedWire;
use wcal_track::estimator::Estimator;
use wcal_track::reading::{Moments, MotionAccuracy, Reading, RowMotion};
use wcal_track::regimes::ANY_OBJECT;
use wcal_track::tracker::ContactTracker;

const GAINS: [f64; 3] = [1.0, 1.1, 1.5];
/// The limits below are those of a regression: they were set after these seeds were seen.
const SEED: u64 = 52_000;
const RECORDS: u64 = 3;
/// Points of a record that several hold the wire.
const PRESSES: u32 = 8;
const MESH_MM: f64 = 4.0;
const NOISE_NMM: f64 = 1e-3;
const ACCURACY: MotionAccuracy = MotionAccuracy {
    moved_sd_mm: 0.005,
    clock_sd_s: 0.001,
    window_sd_s: 0.0,
};
/// Squared radius of the 95 % region of three Gaussian numbers.
const CHI2_95: f64 = 7.815;

/// Readings of a wire with the true places of its axis, mm.
struct Record {
    wire: CalibratedWire,
    readings: Vec<Reading>,
    places: Vec<Option<Vector3<f64>>>,
}

/// A contact that slides over an object; `back`: up to the middle and the same way back, which is
/// in equilibrium without friction alone.
fn slide(seed: u64, back: bool) -> Record {
    let cases = (0..).filter_map(|k| SweepCase::draw(seed + 1000 * k).ok());
    let case = cases
        .into_iter()
        .find(|case| !back || case.scene.friction == 0.0)
        .unwrap();
    let places: Vec<Option<Vector3<f64>>> = case
        .readings
        .iter()
        .map(|r| r.touch.as_ref().map(|t| t.axis_mm))
        .collect();
    let (mut all, mut at) = (readings(&case, 1.0), places);
    if back {
        let touches: Vec<usize> = (0..at.len()).filter(|k| at[*k].is_some()).collect();
        let turn = touches[2 * touches.len() / 3];
        all.truncate(turn + 1);
        at.truncate(turn + 1);
        let way: Vec<(Reading, Option<Vector3<f64>>)> = all
            .iter()
            .cloned()
            .zip(at.iter().copied())
            .rev()
            .skip(1)
            .collect();
        let (turned_s, step_s) = (all[turn].t_s, all[turn].t_s - all[turn - 1].t_s);
        for (n, (mut reading, place)) in way.into_iter().enumerate() {
            reading.t_s = turned_s + step_s * (n + 1) as f64;
            reading.point = all.len() as i64;
            if let Ok(motion) = &mut reading.motion {
                motion.velocity_mm_s = -motion.velocity_mm_s;
            }
            all.push(reading);
            at.push(place);
        }
    }
    Record {
        wire: calibrated(&whisker(&case), MESH_MM),
        readings: all,
        places: at,
    }
}

/// A point that is pressed along z.
fn press(seed: u64) -> Record {
    let wire = calibrated(&WhiskerSpec::nominal(), MESH_MM);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (held, tangent) = wire.field.free(rng.random_range(16.0..50.0));
    let mut normal = |sd: f64| -> f64 { sd * rng.sample::<f64, _>(StandardNormal) };
    let touch = held + tangent.cross(&Vector3::z()).normalize() * normal(0.5);
    let one = |k: usize| {
        let depth = 0.12 * k as f64 - 1.0;
        let place = (depth > 0.0).then(|| touch + Vector3::z() * depth);
        let moment = place.map_or([0.0; 2], |p| wire.field.held(&p, 0.0).unwrap().moment_nmm);
        let moment_nmm = moment.map(|m| m + normal(NOISE_NMM));
        let noise_nmm2 = Matrix2::identity() * NOISE_NMM * NOISE_NMM;
        let share = moment_nmm.map(|m| 0.003 * m);
        let moments = moments(
            moment_nmm,
            noise_nmm2,
            vec![[share[0], 0.0], [0.0, share[1]]],
        );
        let moved_mm = Vector3::z() * depth + Vector3::from_fn(|_, _| normal(0.002));
        let motion = RowMotion {
            moved_mm,
            turn: Rotation3::identity(),
            velocity_mm_s: Vector3::z() * 1.2,
            piece: 0,
            push: None,
        };
        (
            Reading {
                motion: Ok(motion),
                ..Reading::alone(k as i64, 0.1 * k as f64, Some(moments))
            },
            place,
        )
    };
    let (readings, places) = (0..50).map(one).unzip();
    Record {
        wire,
        readings,
        places,
    }
}

/// Points that are pressed one after the other; the motion of one says nothing of the next.
fn presses(seed: u64) -> Record {
    let mut all = press(seed);
    for n in 1..PRESSES {
        let next = press(seed + 100 * u64::from(n));
        all.places.extend(next.places);
        for mut reading in next.readings {
            reading.point = all.readings.len() as i64;
            reading.t_s = 0.1 * reading.point as f64;
            reading
                .motion
                .iter_mut()
                .for_each(|motion| motion.piece = n);
            all.readings.push(reading);
        }
    }
    all
}

/// Readings as a calibration states them whose gain is off by a factor.
fn with_gain(record: &Record, gain: f64) -> Vec<Reading> {
    let scaled = |h: [f64; 2]| h.map(|m| m * gain);
    let one = |r: &Reading| {
        let m = r.moments.clone().unwrap();
        let g2 = gain * gain;
        let moments = Moments {
            moment_nmm: scaled(m.moment_nmm),
            sd_nmm: scaled(m.sd_nmm),
            pose_nmm2: m.pose_nmm2 * g2,
            own_nmm2: m.own_nmm2.map(|own| own * g2),
            drift_nmm2: m.drift_nmm2 * g2,
            zero_nmm2: m.zero_nmm2 * g2,
            shared_nmm: m.shared_nmm.iter().map(|h| scaled(*h)).collect(),
            ..m
        };
        Reading {
            moments: Some(moments),
            ..r.clone()
        }
    };
    record.readings.iter().map(one).collect()
}

/// How the contact of a record moves on what it touches.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Family {
    Slides,
    ThereAndBack,
    Stays,
    SeveralStay,
}

/// What is stated of the readings in contact of one record.
struct Stated {
    /// Errors, mm.
    errors_mm: Vec<f64>,
    /// Readings whose region holds the true place: as it is stated, and with the error of the gain
    /// taken into account.
    held: usize,
    held_by_gain: usize,
    /// Readings in doubt.
    flagged: usize,
    /// How far 1 % of gain moves the contact, mm.
    mm_by_gain: f64,
}

/// The records of a family, which all gains are tried on.
fn records(family: Family) -> Vec<Record> {
    let one = |seed: u64| match family {
        Family::Stays => press(seed),
        Family::SeveralStay => presses(seed),
        _ => slide(seed, family == Family::ThereAndBack),
    };
    (SEED..SEED + RECORDS).into_par_iter().map(one).collect()
}

fn tracked(record: &Record, gain: f64) -> Stated {
    let mut table = ContactTracker::of_record(record.wire.clone(), ACCURACY, ANY_OBJECT);
    with_gain(record, gain)
        .iter()
        .for_each(|r| assert!(table.push(r).unwrap().is_empty()));
    let found = table.finish().unwrap();
    let findings = table.findings();
    let contacts = findings.document.contacts.unwrap();
    let mm_by_gain = contacts
        .iter()
        .filter_map(|c| c.mm_by_gain_percent)
        .fold(0.0, f64::max);
    // It is said once of a record.
    assert_eq!(
        findings
            .messages
            .iter()
            .filter(|m| m.starts_with("gain:"))
            .count(),
        1
    );
    let by_gain_mm2 = Matrix3::identity() * (100.0 * (gain - 1.0) * mm_by_gain).powi(2);
    let mut stated = Stated {
        errors_mm: Vec::new(),
        held: 0,
        held_by_gain: 0,
        flagged: 0,
        mm_by_gain,
    };
    for (contact, place) in found.iter().zip(&record.places) {
        let Some((estimate, place)) = contact.estimate.zip(*place) else {
            continue;
        };
        let off = estimate.place_mm - place;
        let holds = |c: Matrix3<f64>| {
            c.cholesky()
                .is_some_and(|c| off.dot(&c.solve(&off)) <= CHI2_95)
        };
        stated.errors_mm.push(off.norm());
        stated.held += usize::from(holds(estimate.covariance_mm2));
        stated.held_by_gain += usize::from(holds(estimate.covariance_mm2 + by_gain_mm2));
        stated.flagged += usize::from(!contact.flags.none());
    }
    stated
}

/// Shares of the readings that are held, that are held with the error of the gain taken into
/// account, and that are in doubt.
fn shares(family: Family, records: &[Record], gain: f64) -> [f64; 3] {
    let all: Vec<Stated> = records.par_iter().map(|r| tracked(r, gain)).collect();
    let mut errors_mm: Vec<f64> = all
        .iter()
        .flat_map(|s| s.errors_mm.iter().copied())
        .collect();
    errors_mm.sort_by(f64::total_cmp);
    let share = |of: fn(&Stated) -> usize| {
        all.iter().map(of).sum::<usize>() as f64 / errors_mm.len().max(1) as f64
    };
    let found = [
        share(|s| s.held),
        share(|s| s.held_by_gain),
        share(|s| s.flagged),
    ];
    let by_gain: Vec<String> = all.iter().map(|s| format!("{:.2}", s.mm_by_gain)).collect();
    println!(
        "SIMULATED {family:?}, gain {gain}: {} readings, median {:.2} mm, held {:.2}, with the gain {:.2}, in doubt {:.2}; 1 % moves {} mm",
        errors_mm.len(),
        errors_mm[errors_mm.len() / 2],
        found[0],
        found[1],
        found[2],
        by_gain.join(", ")
    );
    found
}

/// Moments and motion of one contact do not show an error of the gain. What is said of it has to be
/// enough: how far it moves the contact.
#[test]
fn what_a_wrong_gain_moves_is_what_the_track_says() {
    for family in [Family::Slides, Family::ThereAndBack, Family::Stays] {
        let records = records(family);
        for gain in GAINS {
            let [held, by_gain, flagged] = shares(family, &records, gain);
            assert!(by_gain >= 0.9, "{family:?} {gain}: {by_gain}");
            if gain == 1.0 {
                assert!(held >= 0.9, "{family:?}: {held}");
                // A motion that turns back says so.
                assert!(
                    (flagged > 0.05) == (family == Family::ThereAndBack),
                    "{family:?}: {flagged}"
                );
            }
            // Control: what is stated without it is not enough for a tenth.
            assert!(
                gain != 1.1 || family == Family::ThereAndBack || held < 0.5,
                "{family:?} {gain}: {held}"
            );
        }
    }
}

/// Contacts of one record share its gain: together they show what one of them hides.
#[test]
fn several_contacts_show_a_gain_that_one_hides() {
    let (several, one) = (records(Family::SeveralStay), records(Family::Stays));
    let flagged = |gain: f64| shares(Family::SeveralStay, &several, gain)[2];
    let (right, wrong) = ([1.0, 1.02].map(flagged), [1.15, 1.5].map(flagged));
    assert!(
        right[0] == 0.0 && right[1] < 0.34 && wrong.iter().all(|f| *f > 0.6),
        "{right:?} {wrong:?}"
    );
    // Control: one of them shows less.
    assert!(shares(Family::Stays, &one, 1.15)[2] < wrong[0]);
}
