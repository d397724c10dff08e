//! The field's laws compete: which bend, whose zero, whose clock. SIMULATED, each with a control.

use super::Noise;
use rayon::prelude::*;
use std::f64::consts::TAU;
use wcal_core::Sealed;
use wcal_core::observation::{Role, TransducerData, TransducerModel, TransducerRow};
use wcal_core::verify_document::Verdict;
use wcal_verify::method::options::Options;
use wcal_verify::scalar::{ScalarVerification, verify_scalar};
use wcal_verify::verify::VerifyRequest;

/// A reading: stimulus, time, series.
type At = (f64, Option<f64>, Option<u32>);

/// A transducer in the units `[stimulus, response]`, its readings in this order.
fn table(
    units: [&str; 2],
    model: TransducerModel,
    at: &[At],
    mut response: impl FnMut(usize, f64) -> f64,
) -> TransducerData {
    let row = |(k, (x, t_s, series)): (usize, &At)| TransducerRow {
        stimulus_sd: None,
        source: "simulated".into(),
        line: k + 2,
        point: k as i64,
        role: Role::Calibration,
        stimulus: *x,
        response: response(k, *x),
        t_s: *t_s,
        temperature_degc: None,
        direction: None,
        replicate: *series,
        covariates: Vec::new(),
    };
    TransducerData {
        deviation: false,
        reference_sd: 0.0,
        stimulus_unit: units[0].into(),
        response_unit: units[1].into(),
        model,
        covariates: Vec::new(),
        rows: at.iter().enumerate().map(row).collect(),
    }
}

fn run(data: &TransducerData) -> ScalarVerification {
    let search = Options {
        seed: 1,
        draws: 400,
        largest: 3,
        ..Options::default()
    };
    let request = VerifyRequest {
        search,
        ..VerifyRequest::default()
    };
    verify_scalar("simulated", data, Sealed::default(), &request).unwrap()
}

/// `count` places from `low` to `high`, `times` over.
fn places(low: f64, high: f64, count: usize, times: usize) -> Vec<At> {
    let place = |k: usize| low + (high - low) * (k % count) as f64 / (count - 1) as f64;
    (0..times * count).map(|k| (place(k), None, None)).collect()
}

/// Verdict and names of a session.
fn answer(v: &ScalarVerification) -> (Verdict, Vec<&str>) {
    (
        v.document.verdict,
        v.document.effects.iter().map(|e| e.id.as_str()).collect(),
    )
}

/// A session that is explained by `names`, to within `error` on readings left out.
fn explained(v: &ScalarVerification, names: &[&str], error: f64) {
    assert_eq!(
        answer(v),
        (Verdict::Effect, names.to_vec()),
        "{}",
        v.document.reason
    );
    let left_out = v.document.after.as_ref().unwrap().rmse["response_rmse"];
    assert!(left_out < error, "{names:?}: {left_out}");
}

fn value(v: &ScalarVerification, name: &str) -> f64 {
    v.document
        .effects
        .iter()
        .flat_map(|e| &e.parameters)
        .find(|p| p.name == name)
        .unwrap()
        .value
}

#[test]
fn each_bend_has_its_name() {
    let (linear, mut rng) = (TransducerModel::Linear, Noise::new(1));
    let of = |at: &[At], units, model, f: &mut dyn FnMut(usize, f64) -> f64| {
        run(&table(units, model, at, f))
    };
    let (n, v) = (["N", "V"], ["degC", "ohm"]);
    let wide = places(-10.0, 10.0, 41, 2);
    // Slopes of 2 and 3.2 beyond 4; a fifth of a slope is no dead zone, a tenth is.
    let two = of(&wide, n, linear, &mut |_, x| {
        2.0 * x + 1.2 * (x - 4.0).max(0.0) + 0.02 * rng.next()
    });
    explained(&two, &["knee"], 0.03);
    assert!(
        (value(&two, "slope_gained") - 0.6).abs() < 0.01 && (value(&two, "knee") - 4.0).abs() < 0.1
    );
    let dead = of(&wide, n, linear, &mut |_, x| {
        2.0 * (x - 0.9 * x.clamp(-1.2, 1.2)) + 0.02 * rng.next()
    });
    explained(&dead, &["dead-zone"], 0.03);
    let flat = of(&wide, n, linear, &mut |_, x| {
        3.0 * (x / 6.0).tanh() + 0.002 * rng.next()
    });
    explained(&flat, &["nonlinearity-polynomial"], 0.005);
    // A thermistor of 3950 K, and the platinum of IEC 60751 below 0 degC.
    let warm = places(-20.0, 100.0, 25, 2);
    let thermistor = |t: f64| 1e4 * f64::exp(3950.0 / (t + 273.15) - 3950.0 / 298.15);
    let ntc = of(&warm, v, linear, &mut |_, t| thermistor(t) + rng.next());
    explained(&ntc, &["logarithmic-scale"], 1.6);
    assert!((value(&ntc, "b") / 3950.0 - 1.0).abs() < 0.001);
    let cold = places(-80.0, 200.0, 15, 2);
    let platinum = |t: f64| {
        let below = if t < 0.0 {
            -4.183e-12 * (t - 100.0) * t.powi(3)
        } else {
            0.0
        };
        100.0 * (1.0 + 3.9083e-3 * t - 5.775e-7 * t * t + below)
    };
    // A fold without the coldest place may take the bend for a knee and miss that place by ten times
    // the noise: one draw says little of the error.
    let mut errors: Vec<f64> = (0..5)
        .map(|seed| {
            let mut rng = Noise::new(seed);
            let pt100 = of(&cold, v, TransducerModel::Quadratic, &mut |_, t| {
                platinum(t) + 4e-4 * rng.next()
            });
            explained(&pt100, &["callendar-van-dusen"], 2e-3);
            pt100.document.after.as_ref().unwrap().rmse["response_rmse"]
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    assert!(errors[2] < 6e-4, "{errors:?}");
    // Control: in another unit the same readings are a bend like any other, and a line is none.
    let named = of(&cold, n, TransducerModel::Quadratic, &mut |_, t| {
        platinum(t) + 4e-4 * rng.next()
    });
    assert!(
        !answer(&named).1.contains(&"callendar-van-dusen"),
        "{:?}",
        answer(&named)
    );
    let line = of(&wide, n, linear, &mut |_, x| 2.0 * x + 0.02 * rng.next());
    assert_eq!(answer(&line), (Verdict::Adequate, Vec::new()));
}

#[test]
fn a_bend_under_slow_noise_is_never_adequate_and_never_another_one_alone() {
    // 400 readings of one rising sweep; noise that remembers 20 of them.
    let dense = |seed: u64, square: f64| {
        let (mut rng, mut slow, decay) = (Noise::new(seed), 0.0, f64::exp(-0.05));
        let at: Vec<At> = (0..400)
            .map(|k| (f64::from(k) / 285.0, Some(0.1 * f64::from(k)), None))
            .collect();
        run(&table(
            ["l/s", "kPa"],
            TransducerModel::Linear,
            &at,
            |_, q| {
                slow = decay * slow + 0.02 * (1.0 - decay * decay).sqrt() * rng.next();
                0.4 * q + square * q * q + slow
            },
        ))
    };
    let bent: Vec<ScalarVerification> = (0..8u64).into_par_iter().map(|s| dense(s, 0.3)).collect();
    for v in &bent {
        let holds = v
            .document
            .alternatives
            .iter()
            .any(|a| a == &["nonlinearity-quadratic"]);
        assert!(
            holds && v.document.verdict != Verdict::Adequate,
            "{}",
            v.document.reason
        );
    }
    // Control: no bend.
    let straight: Vec<ScalarVerification> =
        (0..8u64).into_par_iter().map(|s| dense(s, 0.0)).collect();
    let right = straight
        .iter()
        .filter(|v| v.document.verdict == Verdict::Adequate)
        .count();
    assert!(right >= 6, "{right}");
}

#[test]
fn one_rising_series_names_no_law_of_the_time() {
    let mut rng = Noise::new(3);
    let rising: Vec<At> = (0..26)
        .map(|k| (10.0 * f64::from(k), Some(30.0 * f64::from(k)), None))
        .collect();
    let mut of = |at: &[At]| {
        run(&table(["N", "V"], TransducerModel::Linear, at, |k, x| {
            // What a clock of the same pace does, too.
            let settled = -0.3 * f64::exp(-at[k].1.unwrap() / 200.0);
            0.1 * x + settled + 0.003 * rng.next()
        }))
    };
    let v = of(&rising);
    let (_, names) = answer(&v);
    assert!(
        names.iter().all(|n| n.starts_with("nonlinearity")) && !names.is_empty(),
        "{names:?}"
    );
    let asked = |v: &ScalarVerification| {
        v.document
            .notes
            .iter()
            .any(|n| n.contains("a falling series"))
    };
    assert!(asked(&v), "{:?}", v.document.notes);
    // Control: the loads in another order.
    let mixed: Vec<At> = (0..26)
        .map(|k| {
            (
                10.0 * f64::from(k * 7 % 26),
                Some(30.0 * f64::from(k)),
                None,
            )
        })
        .collect();
    let v = of(&mixed);
    assert_eq!(
        answer(&v),
        (Verdict::Effect, vec!["creep"]),
        "{}",
        v.document.reason
    );
    assert!(!asked(&v));
}

#[test]
fn a_loop_that_closes_at_both_ends_is_hysteresis_in_the_order_of_the_rows() {
    let strokes: Vec<At> = (0..60)
        .map(|k| (k % 20, if k % 20 <= 10 { k % 20 } else { 20 - k % 20 }))
        .map(|(_, x)| (f64::from(x), None, None))
        .collect();
    let with = |half_loop: f64| {
        let mut rng = Noise::new(4);
        run(&table(
            ["MPa", "mV"],
            TransducerModel::Linear,
            &strokes,
            |k, x| {
                let way = if k % 20 <= 10 { -1.0 } else { 1.0 };
                0.2 * x + way * half_loop * (1.0 - (x / 5.0 - 1.0).powi(2)) + 5e-4 * rng.next()
            },
        ))
    };
    let v = with(3e-3);
    explained(&v, &["hysteresis"], 7e-4);
    assert!(
        (value(&v, "half_loop") / -3e-3 - 1.0).abs() < 0.1,
        "{}",
        value(&v, "half_loop")
    );
    assert!(
        v.document
            .notes
            .iter()
            .any(|n| n.contains("order of the readings")),
        "{:?}",
        v.document.notes
    );
    // Control: no loop.
    assert_eq!(answer(&with(0.0)), (Verdict::Adequate, Vec::new()));
}

#[test]
fn an_encoder_errs_once_and_twice_a_turn_and_its_count_wraps() {
    let mut rng = Noise::new(5);
    let turn = places(0.0, 350.0, 36, 2);
    let of = |f: &mut dyn FnMut(f64) -> f64| {
        run(&table(
            ["deg", "counts"],
            TransducerModel::Linear,
            &turn,
            |_, a| f(a),
        ))
    };
    let ideal = |a: f64| 16_384.0 * a / 360.0;
    let waves = |a: f64| {
        let phase = TAU * a / 360.0;
        60.0 * (phase + 0.4).sin() + 14.0 * (2.0 * phase).cos()
    };
    let v = of(&mut |a| (ideal(a) + waves(a) + 2.0 * rng.next()).round());
    explained(&v, &["periodic"], 2.6);
    let mut periods = [value(&v, "period"), value(&v, "period_2")];
    periods.sort_by(f64::total_cmp);
    assert_eq!(periods, [180.0, 360.0]);
    let v = of(&mut |a| {
        (ideal(a) + 5000.0 + 2.0 * rng.next())
            .round()
            .rem_euclid(16_384.0)
    });
    explained(&v, &["count-wrap"], 2.6);
    assert!((value(&v, "jump") + 16_384.0).abs() < 5.0);
    // Control: a true count.
    let v = of(&mut |a| (ideal(a) + 2.0 * rng.next()).round());
    assert_eq!(answer(&v), (Verdict::Adequate, Vec::new()));
}

#[test]
fn each_mounting_has_its_own_zero() {
    let mut rng = Noise::new(6);
    let at: Vec<At> = (0..44)
        .map(|k| (f64::from(k % 11), None, Some(1 + k as u32 / 11)))
        .collect();
    let zeros = [0.02, -0.03, 0.005, 0.012];
    let v = run(&table(
        ["kN", "mV/V"],
        TransducerModel::Linear,
        &at,
        |k, x| 0.2 * x + zeros[k / 11] + 3e-4 * rng.next(),
    ));
    explained(&v, &["zero-by-series"], 4e-4);
    // A further mounting is known to the scatter of the four zeros, s = 0.0222: t(3) s sqrt(1 +
    // 1/4) = 3.18 x 0.0222 x 1.118 = 0.079.
    let model = v.model.as_ref().unwrap();
    let new = wcal_verify::scalar::ScalarRow {
        x_sd: None,
        cycle: Some(9),
        ..(&table(["kN", "mV/V"], TransducerModel::Linear, &at[..1], |_, x| x).rows[0]).into()
    };
    let half = model.predict(&[new]).unwrap()[0].half95;
    assert!((0.077..0.083).contains(&half), "{half}");
    // Control: tared.
    let v = run(&table(
        ["kN", "mV/V"],
        TransducerModel::Linear,
        &at,
        |_, x| 0.2 * x + 3e-4 * rng.next(),
    ));
    assert_eq!(answer(&v), (Verdict::Adequate, Vec::new()));
}

#[test]
fn a_creep_test_begins_with_its_load_and_a_warm_up_is_told_from_two_loads() {
    let mut rng = Noise::new(7);
    // OIML R 60: half an hour with the load, half an hour without.
    let minutes = (1..=30).map(f64::from);
    let part = |from: f64, load: f64| {
        [20.0, 30.0]
            .into_iter()
            .chain(minutes.clone().map(|m| 60.0 * m))
            .map(move |t| (load, Some(from + t), None))
    };
    let at: Vec<At> = part(0.0, 500.0).chain(part(1800.0, 0.0)).collect();
    let of = |fraction: f64, rng: &mut Noise| {
        run(&table(
            ["kg", "mV/V"],
            TransducerModel::Linear,
            &at,
            |k, x| {
                let since = |t: f64| 500.0 * (1.0 - f64::exp(-t / 480.0));
                let t = at[k].1.unwrap();
                let slow = if x > 0.0 {
                    since(t)
                } else {
                    since(1800.0) * f64::exp(-(t - 1800.0) / 480.0)
                };
                4e-3 * (x + fraction * slow) + 5e-6 * rng.next()
            },
        ))
    };
    let v = of(3e-4, &mut rng);
    explained(&v, &["creep"], 8e-6);
    assert!((value(&v, "creep_fraction") / 3e-4 - 1.0).abs() < 0.05);
    assert_eq!(answer(&of(0.0, &mut rng)), (Verdict::Adequate, Vec::new()));
    // A warm-up while three loads take turns: without one of them the others still determine it.
    let loads = [0.0, 2.0, 5.0];
    let at: Vec<At> = (0..45)
        .map(|k| (loads[k % 3], Some(120.0 * k as f64), None))
        .collect();
    let v = run(&table(
        ["kg", "counts"],
        TransducerModel::Linear,
        &at,
        |k, x| 2000.0 + 4200.0 * x - 900.0 * f64::exp(-at[k].1.unwrap() / 900.0) + 8.0 * rng.next(),
    ));
    explained(&v, &["creep"], 14.0);
}

#[test]
fn a_deviation_needs_no_slope() {
    let mut rng = Noise::new(8);
    let at = places(20.0, 30.0, 12, 1);
    let mut of = |deviation: bool| {
        let flat = table(["degC", "degC"], TransducerModel::Linear, &at, |_, _| {
            -0.14 + 0.006 * rng.next()
        });
        run(&TransducerData { deviation, ..flat })
    };
    assert_eq!(answer(&of(true)), (Verdict::Adequate, Vec::new()));
    // Control: a reading that does not follow its stimulus is of a dead gauge.
    let v = of(false);
    assert!(
        v.document.reason.contains("does not depend"),
        "{}",
        v.document.reason
    );
}

/// Play by 8 sigma, three times up and down at one pace.
#[test]
fn a_play_at_one_pace_is_not_a_lag_alone() {
    let up_and_down: Vec<f64> = (0..61_i32)
        .map(|k| 25.0 * f64::from(10 - (k % 20 - 10).abs()))
        .collect();
    let at: Vec<At> = up_and_down
        .iter()
        .enumerate()
        .map(|(k, x)| (*x, Some(12.0 * k as f64), None))
        .collect();
    // Where the play stood at first: a virgin sensor, one that was unloaded before, one that was
    // loaded.
    for (k, first) in [0.0, 2.0, -2.0].into_iter().enumerate() {
        let (mut rng, mut held) = (Noise::new(40 + k as u64), first);
        let v = run(&table(
            ["N m", "V"],
            TransducerModel::Linear,
            &at,
            |_, x| {
                held = f64::clamp(held, x - 2.0, x + 2.0);
                0.004 * held + 0.001 * rng.next()
            },
        ));
        let (verdict, names) = answer(&v);
        let class: Vec<&str> = v
            .document
            .effects
            .iter()
            .flat_map(|e| &e.class)
            .map(String::as_str)
            .collect();
        let play = |name: &&&str| matches!(**name, "hysteresis" | "backlash");
        assert_eq!(
            (verdict, names.len()),
            (Verdict::Effect, 1),
            "{first}: {names:?} {}",
            v.document.reason
        );
        assert!(class.iter().any(|n| play(&n)), "{first}: {class:?}");
    }
    // Control: a lag of which the pace changes is one.
    let mut t_s = 0.0;
    let changing: Vec<At> = up_and_down
        .iter()
        .enumerate()
        .map(|(k, x)| {
            t_s += if k / 20 == 1 { 4.0 } else { 12.0 };
            (*x, Some(t_s), None)
        })
        .collect();
    let (mut rng, mut before) = (Noise::new(44), (0.0, 0.0));
    let v = run(&table(
        ["N m", "V"],
        TransducerModel::Linear,
        &changing,
        |k, x| {
            let (t, late) = (changing[k].1.unwrap(), 1.0);
            let at = if k == 0 {
                x
            } else {
                x - (x - before.1) * late / (t - before.0)
            };
            before = (t, x);
            0.004 * at + 0.001 * rng.next()
        },
    ));
    assert_eq!(
        answer(&v),
        (Verdict::Effect, vec!["lag"]),
        "{}",
        v.document.reason
    );
}

#[test]
fn a_smooth_curve_is_no_knee_and_no_wave() {
    // A thermocouple's excess over a line, mV, and an S-curve.
    let couple = |u: f64| 0.06 * (2.6 * u).sin() + 0.02 * (5.5 * u + 0.4).cos();
    let s_curve = |u: f64| 1.5 / (1.0 + (-6.0 * u).exp());
    for (k, curve) in [&couple as &dyn Fn(f64) -> f64, &s_curve]
        .into_iter()
        .enumerate()
    {
        let mut rng = Noise::new(60 + k as u64);
        let at = places(0.0, 500.0, 21, 3);
        let v = run(&table(
            ["degC", "mV"],
            TransducerModel::Linear,
            &at,
            |_, x| 0.04 * x + curve(x / 250.0 - 1.0) + 0.004 * rng.next(),
        ));
        let (_, names) = answer(&v);
        let pieces = ["knee", "saturation", "dead-zone", "periodic"];
        assert!(names.iter().all(|n| !pieces.contains(n)), "{k}: {names:?}");
    }
    // Control: a knee is one.
    let mut rng = Noise::new(70);
    let at = places(0.0, 500.0, 21, 3);
    let v = run(&table(
        ["degC", "mV"],
        TransducerModel::Linear,
        &at,
        |_, x| 0.04 * x + 0.01 * (x - 300.0).max(0.0) + 0.004 * rng.next(),
    ));
    assert_eq!(
        answer(&v),
        (Verdict::Effect, vec!["knee"]),
        "{}",
        v.document.reason
    );
}

/// A dial with marks of half a unit, whose needle hardly scatters: rounding repeats with its place.
#[test]
fn a_dial_read_to_its_marks_has_no_effect_but_a_bend_beyond_a_mark_is_one() {
    let dial = |seed: u64, bend: f64| {
        let mut rng = Noise::new(900 + seed);
        let (count, steps) = (7 + (seed % 6) as usize, 9.0 + 6.3 * seed as f64);
        let at = places(0.0, 100.0, count, 1 + (seed % 4) as usize);
        run(&table(["N", "mm"], TransducerModel::Linear, &at, |_, x| {
            let u = x / 100.0;
            let needle = 0.13 + steps * u + bend * 4.0 * u * (1.0 - u) + 0.05 * rng.next();
            0.5 * needle.round()
        }))
    };
    let straight: Vec<ScalarVerification> =
        (0..12u64).into_par_iter().map(|s| dial(s, 0.0)).collect();
    let right = straight
        .iter()
        .filter(|v| v.document.verdict == Verdict::Adequate)
        .count();
    assert!(right >= 11, "{right} of 12");
    let bent: Vec<ScalarVerification> = (0..12u64).into_par_iter().map(|s| dial(s, 4.0)).collect();
    assert!(bent.iter().all(|v| v.document.verdict != Verdict::Adequate));
}

#[test]
fn all_readings_of_a_setting_are_no_outliers() {
    // The root of a differential pressure bends most at zero.
    let mut rng = Noise::new(77);
    let at = places(0.0, 10.0, 21, 3);
    let v = run(&table(
        ["kPa", "V"],
        TransducerModel::Linear,
        &at,
        |_, x| 0.02 + 0.31 * (x + 0.05).sqrt() + 0.006 * rng.next(),
    ));
    assert!(!answer(&v).1.contains(&"outliers"), "{}", v.document.reason);
    // Control: one reading of a setting.
    let mut rng = Noise::new(78);
    let v = run(&table(
        ["kPa", "V"],
        TransducerModel::Linear,
        &at,
        |k, x| 0.3 * x + 0.006 * rng.next() + if k == 10 { 0.2 } else { 0.0 },
    ));
    assert_eq!(answer(&v).1, ["outliers"], "{}", v.document.reason);
}

/// A mass comparator: the certificate states each mass's uncertainty, which is nearly all of the
/// scatter.
#[test]
fn stated_uncertainties_of_the_stimulus_weigh_the_readings() {
    let masses = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0, 1000.0];
    let stated = |x: f64| 2e-4 * x.powf(0.6);
    let of = |seed: u64, states: bool| {
        let mut rng = Noise::new(300 + seed);
        let at: Vec<At> = (0..40).map(|k| (masses[k % 10], None, None)).collect();
        let mut data = table(["g", "V"], TransducerModel::Linear, &at, |_, x| {
            2e-3 + 0.01 * (x + stated(x) * rng.next()) + 2e-6 * rng.next()
        });
        data.rows
            .iter_mut()
            .for_each(|r| r.stimulus_sd = states.then(|| stated(r.stimulus)));
        run(&data)
    };
    let weighed: Vec<ScalarVerification> =
        (0..12u64).into_par_iter().map(|s| of(s, true)).collect();
    let right = weighed
        .iter()
        .filter(|v| v.document.verdict == Verdict::Adequate)
        .count();
    assert!(right >= 11, "{right} of 12");
    // Control: without the statement the spread is a finding, or a reason for false ones.
    let bare: Vec<ScalarVerification> = (0..12u64).into_par_iter().map(|s| of(s, false)).collect();
    assert!(
        bare.iter()
            .filter(|v| v.document.verdict == Verdict::Adequate)
            .count()
            <= 2
    );
    // The line is as well known as the certificate allows: 4e-8 V/g.
    let slope_error = |v: &ScalarVerification| {
        let line = v
            .model
            .as_ref()
            .and_then(|m| m.polynomial.as_ref())
            .map(|p| p.coefficients[1]);
        line.map_or(f64::INFINITY, |b| (b - 0.01).abs())
    };
    let rms = |all: &[ScalarVerification]| {
        all.iter()
            .map(|v| slope_error(v).min(1.0).powi(2))
            .sum::<f64>()
            .sqrt()
    };
    assert!(rms(&weighed) < 3e-7, "{}", rms(&weighed));
}

/// One false reading beside a bend that no law of the declared model has: the bend is named, and
/// that reading.
#[test]
fn a_gross_reading_beside_a_bend_is_told_from_it() {
    let trial = |seed: u64| {
        let mut rng = Noise::new(seed);
        let (count, own) = (10 + 2 * (seed as usize % 4), 3 + seed as usize % 4);
        let bend = if seed.is_multiple_of(2) { 0.02 } else { -0.04 };
        let noise: Vec<f64> = (0..count).map(|_| 0.01 * rng.next()).collect();
        let of = |off: f64| {
            let response =
                |k: usize, x: f64| x + bend * x * x + noise[k] + if k == own { off } else { 0.0 };
            run(&table(
                ["N", "V"],
                TransducerModel::Linear,
                &places(0.0, 10.0, count, 1),
                response,
            ))
        };
        let points = |v: &ScalarVerification| {
            v.document
                .flagged
                .iter()
                .map(|f| f.point)
                .collect::<Vec<_>>()
        };
        let v = of(0.6);
        assert_eq!(points(&v), [own as i64], "{seed}: {}", v.document.reason);
        explained(&v, &["nonlinearity-quadratic", "outliers"], 0.03);
        // Control: without it none is flagged.
        assert!(points(&of(0.0)).is_empty(), "{seed}");
    };
    (0..8).into_par_iter().for_each(trial);
}

/// A thermometer's log that begins while it still settles from another bath.
#[test]
fn a_log_that_begins_in_mid_run_gives_the_lag() {
    let record = |seed: u64, first: f64| {
        let mut rng = Noise::new(seed);
        let at: Vec<At> = (0..200_usize)
            .map(|k| {
                (
                    [40.0, 22.0, 35.0, 28.0][k / 25 % 4],
                    Some(10.0 * k as f64),
                    None,
                )
            })
            .collect();
        let mut shown = first;
        let response = |k: usize, bath: f64| {
            shown = if k == 0 {
                first
            } else {
                bath + (shown - bath) * (-10.0 / 70.0_f64).exp()
            };
            shown + 0.03 * rng.next()
        };
        run(&table(
            ["degC", "degC"],
            TransducerModel::Linear,
            &at,
            response,
        ))
    };
    for (seed, first) in [(1, 33.0), (2, 45.0), (3, 38.0)] {
        let v = record(seed, first);
        // Readings at the beginning are left out, too: without them nothing says what the first
        // state was.
        explained(&v, &["lag"], 0.2);
        assert!((value(&v, "time_constant") - 70.0).abs() < 0.5);
        assert!(
            (value(&v, "first_state") - (first - 40.0)).abs() < 0.1,
            "{first}"
        );
    }
    // Control: a log that begins at rest has the same lag.
    let v = record(4, 40.0);
    explained(&v, &["lag"], 0.04);
    assert!((value(&v, "time_constant") - 70.0).abs() < 0.5);
}

/// A stimulus that moved up and down, or swung, and was cut to whole degrees: nothing lags.
/// Control: what really lags does so in whole degrees, too.
#[test]
fn a_stimulus_recorded_in_steps_is_no_lag() {
    let ramps = |t: f64| 25.3 + 30.0 * (1.0 - (t / 400.0 - 1.0).abs());
    let swings = |t: f64| 40.3 + 12.0 * (TAU * t / 400.0).sin() + 6.0 * (TAU * t / 131.0).sin();
    let record = |seed: u64, truth: &dyn Fn(f64) -> f64, late_s: f64| {
        let mut rng = Noise::new(seed);
        let at: Vec<At> = (0..200)
            .map(|k| {
                (
                    truth(4.0 * f64::from(k)).floor(),
                    Some(4.0 * f64::from(k)),
                    None,
                )
            })
            .collect();
        let response =
            |k: usize, _: f64| 0.02 * truth(4.0 * k as f64 - late_s) + 0.004 * rng.next();
        run(&table(
            ["degC", "V"],
            TransducerModel::Linear,
            &at,
            response,
        ))
    };
    for seed in 0..4 {
        for (motion, v) in [record(seed, &ramps, 0.0), record(seed, &swings, 0.0)]
            .iter()
            .enumerate()
        {
            assert!(
                answer(v).0 != Verdict::Effect,
                "{seed} {motion}: {:?} {}",
                answer(v),
                v.document.reason
            );
        }
        let v = record(seed, &swings, 12.0);
        assert!(
            answer(&v).1.contains(&"lag"),
            "{seed}: {:?} {}",
            answer(&v),
            v.document.reason
        );
    }
}

/// A compass that reads 360 deg less from a heading on, which is one of the places, with a
/// deviation once and twice a turn.
#[test]
fn a_wrap_at_one_heading_is_taken_up_beside_the_deviation() {
    let record = |offset: f64, size: f64| {
        let mut rng = Noise::new(7);
        let deviation =
            |a: f64| offset + size * (7.0 * a.sin() - 4.0 * a.cos() + 2.5 * (2.0 * a).sin());
        let turn: Vec<At> = (0..72)
            .map(|k| (f64::from(15 * k % 360), None, None))
            .collect();
        run(&table(
            ["deg", "deg"],
            TransducerModel::Linear,
            &turn,
            |_, x| (x + deviation(x.to_radians()) + 0.4 * rng.next()).rem_euclid(360.0),
        ))
    };
    explained(&record(-2.5, 1.0), &["periodic", "count-wrap"], 0.6);
    explained(&record(-2.5, 0.0), &["count-wrap"], 0.6);
    // Control: nothing wraps.
    assert_eq!(answer(&record(4.0, 0.0)), (Verdict::Adequate, Vec::new()));
}
