//! Later readings against a calibration: how often an unchanged unit is said to hold, and a change
//! of four standard deviations is named.

use super::Noise;
use super::scalar_simulated::{run, transducer, triangles};
use rayon::prelude::*;
use wcal_core::observation::{Role, TransducerModel};
use wcal_verify::change::CalibrationCheck;
use wcal_verify::scalar::{ScalarModel, ScalarRow};

const NOISE: f64 = 2e-3;
const DRAWS: u64 = 200;

/// A straight load cell of 0.1 V + 0.2 V/N by two triangles.
fn calibrated(seed: u64) -> ScalarModel {
    let mut rng = Noise::new(seed);
    let sweep = triangles(2, 20, &mut rng);
    let data = transducer(&sweep, TransducerModel::Linear, |r| {
        0.1 + 0.2 * r.x + NOISE * rng.next()
    });
    run(&data, seed).model.unwrap()
}

/// `count` quick readings over the range, up and down, of `response`.
fn checked(
    model: &ScalarModel,
    seed: u64,
    count: usize,
    response: &dyn Fn(f64, f64) -> f64,
) -> CalibrationCheck {
    model
        .check_readings(&later(seed, count, response), false)
        .unwrap()
}

fn later(seed: u64, count: usize, response: &dyn Fn(f64, f64) -> f64) -> Vec<ScalarRow> {
    let mut rng = Noise::new(9000 + seed);
    let row = |k: usize| {
        let place = 2.0 * k as f64 / (count - 1) as f64;
        let (x, direction) = if place <= 1.0 {
            (10.0 * place, 1.0)
        } else {
            (10.0 * (2.0 - place), -1.0)
        };
        ScalarRow {
            origin: ("later".to_owned(), k + 2, k as i64),
            role: Role::Verification,
            x,
            x_sd: None,
            y: response(x, direction) + NOISE * rng.next(),
            t_s: Some(2.0 * k as f64),
            temperature_degc: Some(20.0),
            direction: Some(direction),
            cycle: None,
            covariates: vec![0.0],
            place: None,
        }
    };
    (0..count).map(row).collect()
}

#[test]
fn a_tare_takes_out_the_zero_and_nothing_else() {
    let models: Vec<ScalarModel> = (0..40).into_par_iter().map(calibrated).collect();
    let named = |tare: bool, response: &dyn Fn(f64, f64) -> f64, name: &str| {
        let each = models.iter().enumerate().map(|(seed, model)| {
            let check = model.check_readings(&later(seed as u64, 10, response), tare);
            let check = check.unwrap();
            assert_eq!(check.tare.is_some(), tare);
            assert_eq!(check.tested.iter().any(|t| t.name == "zero"), !tare);
            usize::from(check.changes.iter().any(|c| c.name == name))
        });
        each.sum::<usize>()
    };
    let shifted = |x: f64, _: f64| 0.15 + 0.2 * x;
    let steeper = |x: f64, _: f64| 0.15 + 0.2 * x * 1.02;
    assert!(named(true, &shifted, "sensitivity") <= 3);
    assert!(named(true, &steeper, "sensitivity") >= 38);
    assert!(named(false, &shifted, "zero") >= 38, "negative control");
    // Without an unloaded reading there is no zero to take.
    let loaded: Vec<ScalarRow> = later(0, 10, &shifted)
        .into_iter()
        .filter(|r| r.x > 0.0)
        .collect();
    assert!(models[0].check_readings(&loaded, true).is_err());
}

/// Shares of draws in which nothing is said, and in which `name` alone is.
fn shares(
    models: &[ScalarModel],
    name: &str,
    response: &(dyn Fn(f64, f64) -> f64 + Sync),
) -> [f64; 2] {
    let each = models.par_iter().enumerate().map(|(seed, model)| {
        let check = checked(model, seed as u64, 10, response);
        let named = check.changes.len() == 1
            && check.changes[0].name == name
            && check.changes[0].or.is_empty();
        assert!(
            check.tested[..2].iter().all(|t| t.is_tested),
            "{:?}",
            check.tested
        );
        [u64::from(check.changes.is_empty()), u64::from(named)]
    });
    let sum = each.reduce(|| [0, 0], |a, b| [a[0] + b[0], a[1] + b[1]]);
    sum.map(|count| count as f64 / DRAWS as f64)
}

#[test]
fn an_unchanged_unit_holds_and_a_change_has_its_name() {
    let models: Vec<ScalarModel> = (0..DRAWS).into_par_iter().map(calibrated).collect();
    let [unchanged, _] = shares(&models, "zero", &|x, _| 0.1 + 0.2 * x);
    println!("unchanged: holds in {unchanged:.3}");
    assert!(unchanged >= 0.94, "{unchanged}");
    // Ten readings beside forty: four standard deviations of a zero over the range.
    for (name, response) in [
        (
            "zero",
            &(|x: f64, _: f64| 0.1 + 0.2 * x + 0.009) as &(dyn Fn(f64, f64) -> f64 + Sync),
        ),
        ("sensitivity", &|x, _| 0.1 + 0.2 * x * 1.008),
        ("hysteresis", &|x, d| 0.1 + 0.2 * x + 0.006 * d),
    ] {
        let [holds, named] = shares(&models, name, response);
        println!("{name}: holds in {holds:.3}, named alone in {named:.3}");
        assert!(holds < 0.05 && named >= 0.85, "{name}: {holds} {named}");
    }
}

#[test]
fn two_changes_are_fitted_together_and_a_loop_that_grew_is_its_own_effect() {
    let models: Vec<ScalarModel> = (0..40).into_par_iter().map(calibrated).collect();
    let both = |seed: usize| checked(&models[seed], seed as u64, 10, &|x, _| 0.07 + 0.206 * x);
    let mut inside = 0;
    for seed in 0..models.len() {
        let check = both(seed);
        let of = |name: &str| check.changes.iter().find(|c| c.name == name);
        let (Some(zero), Some(gain)) = (of("zero"), of("sensitivity")) else {
            panic!("seed {seed}: {:?}", check.changes);
        };
        // Of the scatter one draw in a hundred says that it grew.
        let named = check.changes.iter().filter(|c| c.name != "scatter");
        assert_eq!(named.count(), 2, "seed {seed}: {:?}", check.changes);
        let holds = |[low, high]: [f64; 2], truth: f64| usize::from(low <= truth && truth <= high);
        // The gain is that of the response above zero load.
        inside += holds(zero.interval95, -0.03) + holds(gain.interval95, 0.03);
    }
    assert!(inside >= 70, "{inside} of 80");

    // A calibration with a loop; twice the loop is the same effect, once more.
    let mut rng = Noise::new(3);
    let sweep = triangles(6, 20, &mut rng);
    let looped = |x: f64, d: f64, h: f64| 0.2 * x + h * d * (1.0 - (0.2 * x - 1.0).powi(2));
    let data = transducer(&sweep, TransducerModel::Linear, |r| {
        looped(r.x, r.direction, 0.02) + NOISE * rng.next()
    });
    let model = run(&data, 3).model.unwrap();
    let check = checked(&model, 3, 20, &|x, d| looped(x, d, 0.04));
    let names: Vec<&str> = check.changes.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["hysteresis"], "{:?}", check.changes);
    assert!(
        (check.changes[0].value - 1.0).abs() < 0.2,
        "{:?}",
        check.changes
    );
}

#[test]
fn few_readings_say_how_many_are_needed_and_scatter_is_no_change_of_the_curve() {
    let model = calibrated(1);
    let few = checked(&model, 1, 3, &|x, _| 0.1 + 0.2 * x);
    let sensitivity = few.tested.iter().find(|t| t.name == "sensitivity").unwrap();
    assert!(!sensitivity.is_tested, "{sensitivity:?}");
    assert!(
        (3..=20).contains(&sensitivity.readings_needed.unwrap()),
        "{sensitivity:?}"
    );
    // Every other reading is off by five standard deviations, one way and the other.
    let odd = |x: f64, _: f64| {
        0.1 + 0.2 * x
            + 5.0
                * NOISE
                * if (x * 9.0).round() as i64 % 4 < 2 {
                    1.0
                } else {
                    -1.0
                }
    };
    let noisy = checked(&model, 2, 40, &odd);
    assert!(
        noisy.changes.iter().any(|c| c.name == "scatter"),
        "{:?}",
        noisy.changes
    );
}
