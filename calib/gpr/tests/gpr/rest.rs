//! Readings at rest are tested by the map of the loaded poses (draws are SIMULATED).

use crate::support::{Plant, whiskerfbg};
use wcal_gpr::{FitOptions, test_rest};

/// Draws of a plant whose readings at rest are off by a zero of their own, pm; how many were left
/// out.
fn left_out(bend: f64, zero_pm: [f64; 2], draws: u64) -> usize {
    let one = |seed: u64| {
        let plant = Plant {
            bend,
            noise_nmm: 0.05,
        };
        let mut training = plant.draw(9, seed);
        // The plant's law has no moment at rest.
        let at_rest = plant.moment_nmm([0.0; 2]);
        training
            .moments_nmm
            .iter_mut()
            .for_each(|m| (0..2).for_each(|c| m[c] -= at_rest[c]));
        let last = training.len() - 1;
        (0..2).for_each(|c| training.shifts_pm[last][c] += zero_pm[c]);
        test_rest(&training, &FitOptions::default())
            .unwrap()
            .unwrap()
            .left_out
    };
    (0..draws).filter(|seed| one(*seed)).count()
}

/// Control first: readings of one zero stay (at most 3 of 40 at a level of 1 % has a probability of
/// 0.9993), of a straight law and of a bent one.
#[test]
fn another_zero_is_left_out_and_the_common_one_stays() {
    let kept = [left_out(0.0, [0.0; 2], 40), left_out(0.2, [0.0; 2], 40)];
    assert!(kept.iter().all(|n| *n <= 3), "{kept:?}");
    let other = [
        left_out(0.0, [30.0, -20.0], 20),
        left_out(0.2, [30.0, -20.0], 20),
    ];
    assert!(other.iter().all(|n| *n >= 19), "{other:?}");
}

/// The measured set: the loaded poses put the free wire at -0.1 and -0.66 N mm (least squares of 27
/// rows by hand: -0.118, -0.661).
#[test]
fn the_measured_rest_reading_has_another_zero() {
    let training = whiskerfbg();
    let rest = test_rest(&training, &FitOptions::default())
        .unwrap()
        .unwrap();
    assert!(rest.left_out && rest.readings == 1, "{rest:?}");
    assert!(
        (rest.offset_nmm[0] + 0.118).abs() < 0.001 && (rest.offset_nmm[1] + 0.661).abs() < 0.001,
        "{rest:?}"
    );
    // Nothing to test, or nothing to test with.
    assert_eq!(
        test_rest(&training.loaded(), &FitOptions::default()).unwrap(),
        None
    );
}
