//! Structure that is no law, and laws that are more than one: what rests on one level is no name,
//! what acts twice is found twice, a floor is the scatter of a new reading. SIMULATED, each with a
//! control.

use super::{Noise, names};
use rand::seq::SliceRandom;
use rayon::prelude::*;
use std::f64::consts::TAU;
use wcal_core::Sealed;
use wcal_core::observation::{Role, TransducerData, TransducerModel, TransducerRow};
use wcal_core::verify_document::{EffectParameter, Verdict, VerifyDocument};
use wcal_verify::method::options::Options;
use wcal_verify::scalar::{ScalarRow, ScalarVerification, verify_scalar};
use wcal_verify::verify::VerifyRequest;

/// A linear transducer at `stimuli` in their order, one reading a second where `timed`; further
/// columns `a`, `b`, ...
fn table(
    stimuli: &[f64],
    timed: bool,
    columns: &[&[f64]],
    mut response: impl FnMut(usize, f64) -> f64,
) -> TransducerData {
    let row = |(k, x): (usize, &f64)| TransducerRow {
        stimulus_sd: None,
        source: "simulated".into(),
        line: k + 2,
        point: k as i64,
        role: Role::Calibration,
        stimulus: *x,
        response: response(k, *x),
        t_s: timed.then_some(k as f64),
        temperature_degc: None,
        direction: None,
        replicate: None,
        covariates: columns.iter().map(|c| c[k]).collect(),
    };
    TransducerData {
        deviation: false,
        reference_sd: 0.0,
        stimulus_unit: "N".into(),
        response_unit: "V".into(),
        model: TransducerModel::Linear,
        covariates: ["a", "b", "c"]
            .iter()
            .take(columns.len())
            .map(|n| (*n).to_owned())
            .collect(),
        rows: stimuli.iter().enumerate().map(row).collect(),
    }
}

fn run(data: &TransducerData, seed: u64) -> ScalarVerification {
    let options = VerifyRequest {
        search: Options {
            seed,
            draws: 400,
            ..Options::default()
        },
        ..VerifyRequest::default()
    };
    verify_scalar("simulated", data, Sealed::default(), &options).unwrap()
}

fn value<'a>(v: &'a ScalarVerification, name: &str) -> Option<&'a EffectParameter> {
    v.document
        .effects
        .iter()
        .flat_map(|e| &e.parameters)
        .find(|p| p.name == name)
}

/// `sweeps` times from `low` to `high` and back in `half` steps.
fn triangles(low: f64, high: f64, half: usize, sweeps: usize) -> Vec<f64> {
    let place = |k: usize| (k % (2 * half)) as f64 / half as f64;
    (0..2 * half * sweeps)
        .map(|k| low + (high - low) * (1.0 - (place(k) - 1.0).abs()))
        .collect()
}

/// Share of `draws` seeds for which `holds`.
fn share(draws: u64, holds: impl Fn(u64) -> bool + Sync) -> f64 {
    (0..draws).into_par_iter().filter(|s| holds(*s)).count() as f64 / draws as f64
}

#[test]
fn a_name_that_rests_on_one_level_is_none() {
    let loads: Vec<f64> = (0..36).map(|k| f64::from(k % 12)).collect();
    // One load reads 8 noises too high: the last (a knee), or the one at zero (a dead zone).
    let moved = |seed: u64| {
        let mut rng = Noise::new(seed);
        let wrong = if seed.is_multiple_of(2) { 11.0 } else { 0.0 };
        let shift = |x: f64| if x == wrong { 0.08 } else { 0.0 };
        run(
            &table(&loads, false, &[], |_, x| {
                0.2 * x + shift(x) + 0.01 * rng.next()
            }),
            seed,
        )
    };
    let found: Vec<ScalarVerification> = (0..12u64).into_par_iter().map(moved).collect();
    for v in &found {
        println!(
            "{:?} {:?} {:?}",
            v.document.verdict,
            names(v),
            v.document.notes
        );
    }
    let none = found
        .iter()
        .filter(|v| names(v).is_empty() && v.document.verdict == Verdict::UnknownEffect);
    assert!(none.count() >= 11);
    // Of the load at zero a dead zone would be the best description.
    let said = found.iter().filter(|v| {
        v.document
            .notes
            .iter()
            .any(|n| n.contains("rests on one level"))
    });
    assert!(said.count() >= 5);
    // Control: the same knee over the last four loads. Another bend may describe it as well on
    // left-out readings; then both are told.
    let knee = |seed: u64| {
        let mut rng = Noise::new(seed);
        let response = |_: usize, x: f64| 0.2 * x - 0.05 * (x - 7.4).max(0.0) + 0.01 * rng.next();
        run(&table(&loads, false, &[], response), seed)
    };
    let knees: Vec<ScalarVerification> = (0..12).into_par_iter().map(knee).collect();
    for v in &knees {
        println!(
            "{:?} {:?} {:?}",
            v.document.verdict,
            names(v),
            v.document.alternatives
        );
    }
    let named = |v: &&ScalarVerification| {
        v.document.verdict == Verdict::Effect && names(v) == ["saturation"]
    };
    let among = |v: &&ScalarVerification| {
        v.document
            .alternatives
            .iter()
            .any(|a| a.iter().any(|e| e == "saturation"))
    };
    let count = |of: &dyn Fn(&&ScalarVerification) -> bool| knees.iter().filter(|v| of(v)).count();
    assert!(
        count(&named) >= 9 && count(&among) == 12,
        "{} {}",
        count(&named),
        count(&among)
    );
}

#[test]
fn a_second_period_stands_beside_the_first() {
    let stimuli = triangles(0.0, 10.0, 60, 2);
    let with = |seed: u64, second: f64| {
        let mut rng = Noise::new(seed);
        let waves = |x: f64| 0.015 * (TAU * x / 1.37).sin() + second * (TAU * x / 0.61 + 1.0).sin();
        run(
            &table(&stimuli, true, &[], |_, x| {
                0.2 * x + waves(x) + 0.01 * rng.next()
            }),
            seed,
        )
    };
    let both = share(10, |seed| {
        let v = with(seed, 0.012);
        let mut periods =
            [value(&v, "period"), value(&v, "period_2")].map(|p| p.map_or(0.0, |p| p.value));
        periods.sort_by(f64::total_cmp);
        let near = |p: f64, truth: f64| (p / truth - 1.0).abs() < 0.01;
        names(&v) == ["periodic"] && near(periods[0], 0.61) && near(periods[1], 1.37)
    });
    // Control: one wave has one period.
    let one = share(10, |seed| {
        let v = with(seed, 0.0);
        names(&v) == ["periodic"]
            && value(&v, "period").is_some()
            && value(&v, "period_2").is_none()
    });
    assert!(both >= 0.9 && one >= 0.9, "{both} {one}");
}

#[test]
fn each_column_that_acts_is_found_and_predicts() {
    let stimuli = triangles(0.0, 10.0, 20, 3);
    let with = |seed: u64, slopes: [f64; 2]| {
        let mut rng = Noise::new(seed);
        let columns: Vec<Vec<f64>> = (0..2)
            .map(|_| stimuli.iter().map(|_| rng.next()).collect())
            .collect();
        let data = table(&stimuli, true, &[&columns[0], &columns[1]], |k, x| {
            0.2 * x + slopes[0] * columns[0][k] + slopes[1] * columns[1][k] + 0.01 * rng.next()
        });
        let v = run(&data, seed);
        let rows: Vec<ScalarRow> = data.rows.iter().map(Into::into).collect();
        let predicted = v.model.as_ref().unwrap().predict(&rows).unwrap();
        let square: f64 = rows
            .iter()
            .zip(&predicted)
            .map(|(r, p)| (r.y - p.value).powi(2))
            .sum();
        (
            names(&v) == ["cross-axis"],
            value(&v, "slope_2").is_some(),
            (square / rows.len() as f64).sqrt(),
        )
    };
    let both = share(
        7,
        |s| matches!(with(s, [0.01, 0.02]), (true, true, left) if left < 0.012),
    );
    // Control: the second column alone; its model predicts by that column.
    let second = share(
        7,
        |s| matches!(with(s, [0.0, 0.02]), (true, false, left) if left < 0.012),
    );
    assert!(both >= 0.85 && second >= 0.85, "{both} {second}");
}

#[test]
fn the_floor_is_the_scatter_of_a_new_reading() {
    // White noise of 0.03 beside a part of 0.04 that neighbours share (8 readings): a new reading
    // scatters by 0.05.
    let floors = |stimuli: &[f64], shared: f64| -> f64 {
        let of = |seed: u64| {
            let mut rng = Noise::new(seed);
            let (mut zero, decay) = (shared * rng.next(), f64::exp(-1.0 / 8.0));
            let data = table(stimuli, true, &[], |_, x| {
                zero = decay * zero + shared * (1.0 - decay * decay).sqrt() * rng.next();
                0.2 * x + zero + 0.03 * rng.next()
            });
            run(&data, seed).document.noise_floor.response.unwrap()
        };
        let mut all: Vec<f64> = (0..7u64).into_par_iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all[3]
    };
    let repeats: Vec<f64> = (0..240).map(|k| f64::from(k * 7 % 12)).collect();
    let held: Vec<f64> = (0..240).map(|k| f64::from(k / 10 * 5 % 12)).collect();
    let once: Vec<f64> = (0..240).map(|k| f64::from(k * 101 % 240) / 24.0).collect();
    for (name, stimuli) in [("repeats", &repeats), ("held", &held), ("once", &once)] {
        let [both, white] = [0.04, 0.0].map(|shared| floors(stimuli, shared));
        println!("{name}: {both} of 0.05, {white} of 0.03");
        assert!((both / 0.05 - 1.0).abs() < 0.15, "{name}: {both}");
        // Control: nothing shared.
        assert!((white / 0.03 - 1.0).abs() < 0.07, "{name}: {white}");
    }
}

#[test]
fn a_cubic_about_zero_is_one_effect() {
    let with = |low: f64, high: f64, bend: &(dyn Fn(f64) -> f64 + Sync), name: &str| {
        share(7, |seed| {
            let mut rng = Noise::new(seed);
            let stimuli = triangles(low, high, 25, 2);
            let v = run(
                &table(&stimuli, true, &[], |_, x| {
                    0.2 * x + bend(x) + 0.01 * rng.next()
                }),
                seed,
            );
            if names(&v) != [name] {
                println!(
                    "{name} {low} {high}: {:?} {:?} {}",
                    v.document.verdict,
                    names(&v),
                    v.document.reason
                );
            }
            names(&v) == [name]
        })
    };
    let cubic = |x: f64| 6e-4 * x.powi(3);
    assert!(with(-3.0, 7.0, &cubic, "nonlinearity-cubic") >= 0.8);
    assert!(with(0.0, 10.0, &cubic, "nonlinearity-cubic") >= 0.8);
    // Control: a square keeps its name on the same range.
    assert!(
        with(
            0.0,
            10.0,
            &|x| 0.002 * (x - 5.0).powi(2),
            "nonlinearity-quadratic"
        ) >= 0.8
    );
}

#[test]
fn a_response_that_recovers_creeps_backward() {
    // Loads held for twelve readings each; after a change 8 % of it come back with a time constant
    // of 6 s.
    let steps = [2.0, 8.0, 4.0, 10.0, 0.0, 6.0, 1.0, 9.0, 3.0, 7.0];
    let stimuli: Vec<f64> = (0..240).map(|k| steps[k / 12 % 10]).collect();
    let with = |seed: u64, fraction: f64| {
        let mut rng = Noise::new(seed);
        let (mut slow, mut before) = (stimuli[0], stimuli[0]);
        let data = table(&stimuli, true, &[], |k, x| {
            for j in 0..100 {
                let now = before + (x - before) * f64::from(j) / 100.0;
                slow += if k == 0 { 0.0 } else { (now - slow) / 600.0 };
            }
            before = x;
            0.2 * (x + fraction * slow) + 0.01 * rng.next()
        });
        let v = run(&data, seed);
        let sign = value(&v, "creep_fraction").map_or(0.0, |p| p.value.signum());
        if names(&v) != ["creep"] {
            println!(
                "{fraction}: {:?} {:?} {}",
                v.document.verdict,
                names(&v),
                v.document.reason
            );
        }
        (names(&v) == ["creep"]).then_some(sign)
    };
    let back = share(7, |s| with(s, -0.08) == Some(-1.0));
    // Control: the other sign.
    let onward = share(7, |s| with(s, 0.08) == Some(1.0));
    assert!(back >= 0.85 && onward >= 0.85, "{back} {onward}");
}

#[test]
fn a_squiggle_is_no_period() {
    // In random order: in steps of a fixed number of places a wave over time is one over the
    // stimulus, too.
    let periodic = |cycles: f64| {
        share(7, |seed| {
            let mut rng = Noise::new(seed);
            let mut stimuli: Vec<f64> = (0..120).map(|k| f64::from(k) / 12.0).collect();
            stimuli.shuffle(&mut rng.0);
            let wave =
                |k: usize| 0.03 * (TAU * cycles * k as f64 / 119.0 + 0.4 * seed as f64).sin();
            let v = run(
                &table(&stimuli, true, &[], |k, x| {
                    0.2 * x + wave(k) + 0.01 * rng.next()
                }),
                seed,
            );
            names(&v).contains(&"periodic")
        })
    };
    let (squiggle, control) = (periodic(1.4), periodic(5.3));
    assert!(squiggle == 0.0 && control >= 0.85, "{squiggle} {control}");
}

/// Steps of 37 places in 120: the stimulus and the time count the same places in another order, so
/// that a wave over one is one over the other.
#[test]
fn a_lattice_of_stimuli_does_not_tell_a_wave_over_time_from_one_over_the_stimulus() {
    let in_steps: Vec<f64> = (0..120).map(|k| f64::from(k * 37 % 120) / 12.0).collect();
    let with = |seed: u64, in_order: bool, cycles: f64| {
        let mut rng = Noise::new(seed);
        let mut stimuli = in_steps.clone();
        if !in_order {
            stimuli.shuffle(&mut rng.0);
        }
        let wave = |k: usize| 0.03 * (TAU * cycles * k as f64 / 119.0 + 0.4 * seed as f64).sin();
        run(
            &table(&stimuli, true, &[], |k, x| {
                0.2 * x + wave(k) + 0.01 * rng.next()
            }),
            seed,
        )
        .document
    };
    let by_time = |d: &VerifyDocument| {
        d.effects
            .iter()
            .flat_map(|e| &e.parameters)
            .any(|p| p.name == "period" && p.unit == "s")
    };
    let sure_and_wrong = |d: &VerifyDocument| d.verdict == Verdict::Effect && !by_time(d);
    for cycles in [1.4, 5.0, 5.3] {
        let wrong = share(7, |seed| {
            let d = with(seed, true, cycles);
            println!(
                "{cycles}: {:?} {} {:?} {:?}",
                d.verdict,
                d.reason,
                d.effects
                    .iter()
                    .map(|e| (&e.laws, &e.parameters))
                    .collect::<Vec<_>>(),
                d.notes
            );
            sure_and_wrong(&d)
        });
        assert!(wrong == 0.0, "{cycles}: {wrong}");
    }
    // In whole cycles both are the same to within a place, which is said.
    let said = share(7, |seed| {
        let d = with(seed, true, 5.0);
        d.verdict == Verdict::Ambiguous
            && d.reason.contains("over-stimulus")
            && d.reason.contains("over-time")
    });
    assert!(said >= 0.75, "{said}");
    // Control: in random order the period is one of time, with confidence.
    let told = share(7, |seed| {
        let d = with(seed, false, 5.0);
        d.verdict == Verdict::Effect && by_time(&d)
    });
    assert!(told >= 0.85, "{told}");
}

/// Few repeats tell the floor to within a factor that chance makes large: a held-out error above it
/// says little. Many tell it.
#[test]
fn a_floor_from_a_few_repeats_that_happen_to_agree_speaks_against_nothing() {
    // Each of the last loads is read twice, with a fifth of the noise between.
    let with = |seed: u64, repeats: usize| {
        let mut rng = Noise::new(seed);
        let mut loads: Vec<f64> = (0..24).map(f64::from).collect();
        loads.extend((24 - repeats..24).map(|k| k as f64));
        let mut read: Vec<f64> = (0..24)
            .map(|k| 0.2 * f64::from(k) + 0.01 * rng.next())
            .collect();
        read.extend(
            (24 - repeats..24)
                .map(|k| read[k] + 2e-3 * rng.next())
                .collect::<Vec<f64>>(),
        );
        run(&table(&loads, false, &[], |k, _| read[k]), seed).document
    };
    let few = share(7, |s| with(s, 2).verdict == Verdict::Adequate);
    let many = share(7, |s| with(s, 12).verdict == Verdict::UnknownEffect);
    assert!(few >= 0.75 && many == 1.0, "{few} {many}");
}

#[test]
fn a_wave_over_a_further_column_is_its_driver() {
    let stimuli = triangles(0.0, 10.0, 30, 2);
    let with = |seed: u64, size: f64| {
        let mut rng = Noise::new(seed);
        let a: Vec<f64> = stimuli
            .iter()
            .map(|_| 10.0 * (0.5 + 0.5 * (3.0 * rng.next()).sin()))
            .collect();
        let data = table(&stimuli, true, &[&a], |k, x| {
            0.2 * x + size * (TAU * a[k] / 1.6).sin() + 0.01 * rng.next()
        });
        run(&data, seed).document
    };
    let named = share(7, |s| {
        let unknown = with(s, 0.03).unknown;
        unknown.is_some_and(|u| {
            u.driver == "a"
                && u.shape == "sinusoid"
                && u.period.is_some_and(|p| (p / 1.6 - 1.0).abs() < 0.1)
        })
    });
    // Control: nothing acts.
    let quiet = share(7, |s| with(s, 0.0).verdict == Verdict::Adequate);
    assert!(named >= 0.85 && quiet >= 0.85, "{named} {quiet}");
}

#[test]
fn a_response_through_the_square_alone_is_not_called_insensitive() {
    let stimuli = triangles(0.0, 10.0, 20, 2);
    let reason = |size: f64| {
        let mut rng = Noise::new(3);
        run(
            &table(&stimuli, true, &[], |_, x| {
                size * (x - 5.0).powi(2) + 0.01 * rng.next()
            }),
            3,
        )
        .document
        .reason
    };
    assert!(
        !reason(0.002).contains("does not depend"),
        "{}",
        reason(0.002)
    );
    // Control: noise alone.
    assert!(reason(0.0).contains("does not depend"), "{}", reason(0.0));
}
