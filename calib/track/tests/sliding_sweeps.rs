//! Contacts that slide over ellipses and boxes, from moments and the known motion, beside the truth
//! of an independent plant (SIMULATED).
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]
#![allow(missing_docs, reason = "tests")]

mod plant_sweep;

use plant_sweep::{calibrated, readings, whisker};
use rayon::prelude::*;
use std::sync::LazyLock;
use wcal_core::stream::Flags;
use wcal_plant::sweep::{SweepCase, SweepReading};
use wcal_track::estimator::{Contact, Estimator};
use wcal_track::known_motion::MotionRow;
use wcal_track::reading::{MotionAccuracy, Reading};
use wcal_track::regimes::ANY_OBJECT;
use wcal_track::sliding::{SlidingContact, TouchedWire, locate_sliding};
use wcal_track::tracker::ContactTracker;

/// Sweeps that the model was not made on: those were 0 to 39.
const SEEDS: std::ops::Range<u64> = 500..508;
/// Sweeps with a slip on which the rule of slips was chosen: a regression, no judgement. Others are
/// rarely drawn in few trials.
const SLIP_SEEDS: [u64; 3] = [1, 5, 6];
/// Rounding of a region's end at the tip, mm.
const ROUNDING_MM: f64 = 1e-9;
/// Short ones of them, for a stream: each reading takes the time of a fit.
const STREAMED: std::ops::Range<usize> = 4..7;
/// Mesh of the rod of a field, mm, and what is assumed of the motion.
const MESH_MM: f64 = 2.0;
const ACCURACY: MotionAccuracy = MotionAccuracy {
    moved_sd_mm: 0.005,
    clock_sd_s: 0.001,
    window_sd_s: 0.0,
};
/// By how much the truth of the control is shifted along the wire, mm.
const SHIFT_MM: f64 = 4.0;

/// The rows of a sweep; the motion times a factor.
fn rows(case: &SweepCase, way: f64) -> Vec<MotionRow> {
    let wire = calibrated(&whisker(case), MESH_MM);
    readings(case, way)
        .iter()
        .map(|r| MotionRow {
            free_nmm2: None,
            ..wire.row(r, &ACCURACY).unwrap()
        })
        .collect()
}

fn wire(case: &SweepCase) -> TouchedWire {
    calibrated(&whisker(case), MESH_MM).touched().unwrap()
}

/// Errors in space (mm), whether the region along the wire holds the truth shifted by `shift_mm`,
/// and whether the ellipsoid in space holds the truth; one a reading in contact.
fn judged(case: &SweepCase, found: &SlidingContact, shift_mm: f64) -> Vec<(f64, bool, bool)> {
    let all = case.readings.iter().zip(&found.places);
    all.filter_map(|(reading, place)| {
        let (truth, at) = (reading.touch?, place.place_mm?);
        let off = at - truth.axis_mm;
        let inside = off.dot(&(place.covariance_mm2.try_inverse()? * off)) < 7.815;
        let s = truth.arclength_mm - shift_mm;
        let held = place
            .arc
            .regions()
            .iter()
            .any(|r| (r.from_mm - ROUNDING_MM..=r.to_mm + ROUNDING_MM).contains(&s));
        Some((off.norm(), held, inside))
    })
    .collect()
}

/// The sweeps of [`SEEDS`] and where their contacts are found, for all tests once.
fn followed() -> &'static [(SweepCase, SlidingContact)] {
    static FOLLOWED: LazyLock<Vec<(SweepCase, SlidingContact)>> = LazyLock::new(|| {
        let one = |seed: u64| {
            let case = SweepCase::draw(seed).unwrap();
            let found = locate_sliding(&wire(&case), &rows(&case, 1.0));
            (case, found)
        };
        SEEDS.into_par_iter().map(one).collect()
    });
    &FOLLOWED
}

#[test]
fn sweeps_of_foreign_wires_are_followed_and_their_regions_hold() {
    let one = |(case, found): &(SweepCase, SlidingContact)| {
        (
            case.seed,
            judged(case, found, 0.0),
            judged(case, found, SHIFT_MM),
            found.clone(),
        )
    };
    let found: Vec<_> = followed().iter().map(one).collect();
    println!("SIMULATED; error of the wire's axis in space, mm");
    for (seed, rows, _, contact) in &found {
        let cost = contact.cost / contact.predicted.max(1) as f64;
        let sure = if contact.sure() { "sure" } else { "not sure" };
        println!("{seed}: {} J / n {cost:.2}, {sure}", said(rows));
    }
    let of = |sure: bool, shifted: bool| -> Vec<(f64, bool, bool)> {
        let those = found.iter().filter(|f| f.3.sure() == sure);
        those
            .flat_map(|f| if shifted { f.2.clone() } else { f.1.clone() })
            .collect()
    };
    let (followed, others) = (of(true, false), of(false, false));
    let sure = found.iter().filter(|f| f.3.sure()).count();
    println!(
        "{sure} of {} sure: {}; the others: {}",
        found.len(),
        said(&followed),
        said(&others)
    );
    // Five of eight on these seeds; seven of eight were on seeds 300 to 307, before answers with
    // gaps in the surface were not sure any more.
    assert!(sure * 2 > found.len(), "{sure}");
    let [median, rms, held, inside] = summary(&followed);
    // A regression limit: these seeds had 0.39 and 0.78 mm at first sight.
    assert!(
        followed.len() > 300 && median < 0.5 && rms < 1.0,
        "{median} {rms}"
    );
    // Readings of a sweep share their errors: a dozen sweeps determine the coverage to some per
    // cent. The ellipsoids in space are too small: 84 % for 95 at first sight.
    assert!(
        (0.9..=1.0).contains(&held) && inside > 0.75,
        "{held} {inside}"
    );
    // Control: places beside the truth are mostly not held.
    let [.., beside_held, _] = summary(&of(true, true));
    assert!(beside_held < 0.4, "{beside_held}");
}

/// The wire slips off a body and snaps onto another one: before and after the slip the contact is
/// followed.
#[test]
fn a_contact_is_followed_past_a_slip() {
    let one = |seed: u64| {
        let case = SweepCase::draw_with_slip(seed).unwrap();
        let found = locate_sliding(&wire(&case), &rows(&case, 1.0));
        // Control: without a slip none is found.
        let plain = SweepCase::draw(seed).unwrap();
        let control = locate_sliding(&wire(&plain), &rows(&plain, 1.0));
        (seed, judged(&case, &found, 0.0), found, control.slips.len())
    };
    let all: Vec<_> = SLIP_SEEDS.into_par_iter().map(one).collect();
    for (seed, rows, found, plain) in &all {
        println!(
            "{seed}: {} slips (without one {plain}), sure {}; {}",
            found.slips.len(),
            found.sure(),
            said(rows)
        );
    }
    assert!(all.iter().all(|a| a.2.slips.len() == 1));
    assert!(all.iter().all(|a| a.3 == 0));
    let pooled: Vec<_> = all.iter().flat_map(|a| a.1.clone()).collect();
    let [median, ..] = summary(&pooled);
    assert!(pooled.len() > 200 && median < 0.6, "{median}");
}

#[test]
fn a_wrong_motion_is_worse_than_the_true_one() {
    let one = |(case, right): &(SweepCase, SlidingContact)| {
        let backward = locate_sliding(&wire(case), &rows(case, -1.0));
        (
            right.evidence > backward.evidence,
            right.supported(),
            backward.supported(),
        )
    };
    let all: Vec<_> = followed()[..4].par_iter().map(one).collect();
    println!("{all:?}");
    assert!(all.iter().filter(|a| a.0 && a.1).count() >= 3 && all.iter().all(|a| !(a.1 && a.2)));
}

/// What the stream knows at each reading: once no fixed point explains the moments, the contact is
/// followed as one that slides. The motion reversed: it is not.
#[test]
fn a_stream_follows_a_contact_that_slides() {
    // Errors of the readings of a sweep that are followed as sliding, along the motion times a
    // factor.
    let slid = |case: &SweepCase, way: f64| {
        let stream = {
            let wire = calibrated(&whisker(case), MESH_MM);
            let mut stream = ContactTracker::of_stream(wire, ACCURACY, ANY_OBJECT);
            let push = |r: Reading| stream.push(&r).unwrap().remove(0);
            readings(case, way)
                .into_iter()
                .map(push)
                .collect::<Vec<Contact>>()
        };
        let error = |(c, r): (&Contact, &SweepReading)| {
            let at = c
                .estimate
                .filter(|_| c.flags.has(Flags::SLIDING_ASSUMED))?
                .place_mm;
            Some((at - r.touch?.axis_mm).norm())
        };
        stream
            .iter()
            .zip(&case.readings)
            .filter_map(error)
            .collect::<Vec<f64>>()
    };
    let streamed = &followed()[STREAMED];
    let pooled = |way: f64| {
        let mut errors: Vec<f64> = streamed.iter().flat_map(|f| slid(&f.0, way)).collect();
        errors.sort_by(f64::total_cmp);
        errors
    };
    let (right, reversed) = (pooled(1.0), pooled(-1.0));
    let median = |errors: &[f64]| {
        errors
            .get(errors.len() / 2)
            .copied()
            .unwrap_or(f64::INFINITY)
    };
    let touching: usize = streamed
        .iter()
        .map(|f| f.0.readings.iter().filter(|r| r.touch.is_some()).count())
        .sum();
    println!(
        "SIMULATED: {} of {touching} readings slide, median {:.2} mm; the motion reversed {}, {:.2} mm",
        right.len(),
        median(&right),
        reversed.len(),
        median(&reversed)
    );
    assert!(right.len() * 2 > touching && median(&right) < 1.0);
    // Control: with the motion reversed.
    assert!(median(&reversed) > 3.0 * median(&right));
}

fn summary(rows: &[(f64, bool, bool)]) -> [f64; 4] {
    let n = rows.len().max(1) as f64;
    let mut errors: Vec<f64> = rows.iter().map(|r| r.0).collect();
    errors.sort_by(f64::total_cmp);
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    let share =
        |of: fn(&(f64, bool, bool)) -> bool| rows.iter().filter(|r| of(r)).count() as f64 / n;
    [
        errors.get(errors.len() / 2).copied().unwrap_or(f64::NAN),
        rms,
        share(|r| r.1),
        share(|r| r.2),
    ]
}

fn said(rows: &[(f64, bool, bool)]) -> String {
    let [median, rms, held, inside] = summary(rows);
    format!(
        "{} readings, median {median:.3}, rms {rms:.3}; regions hold {:.1} %, in space {:.1} %",
        rows.len(),
        100.0 * held,
        100.0 * inside
    )
}
