//! Simulated transducer and axis sessions: nothing is named where nothing is, and every effect of
//! the catalogue is named where it is.

use super::Noise;
use rayon::prelude::*;
use statrs::distribution::{Beta, ContinuousCDF};
use wcal_core::Sealed;
use wcal_core::observation::{Role, TransducerData, TransducerModel, TransducerRow};
use wcal_core::verify_document::{HoldoutOutcome, Verdict};
use wcal_verify::method::options::Options;
use wcal_verify::scalar::{ScalarVerification, verify_scalar};
use wcal_verify::verify::VerifyRequest;

/// Reading of a simulated sweep, before the response is known.
pub(super) struct Reading {
    pub(super) x: f64,
    pub(super) t_s: f64,
    pub(super) rise: f64,
    pub(super) direction: f64,
    pub(super) other: f64,
}

/// `cycles` triangles 0 - 10 - 0 of 2 `half` readings, one a 2 s, with a wandering temperature and
/// a second quantity.
pub(super) fn triangles(cycles: usize, half: usize, rng: &mut Noise) -> Vec<Reading> {
    let n = cycles * 2 * half;
    let phase = rng.uniform();
    (0..n)
        .map(|k| {
            let place = (k % (2 * half)) as f64 / half as f64;
            let (x, direction) = if place < 1.0 {
                (10.0 * place, 1.0)
            } else {
                (10.0 * (2.0 - place), -1.0)
            };
            Reading {
                x,
                t_s: 2.0 * k as f64,
                rise: 2.0 * (std::f64::consts::TAU * (1.7 * k as f64 / n as f64 + phase)).sin()
                    + 0.2 * rng.next(),
                direction,
                other: rng.next(),
            }
        })
        .collect()
}

pub(super) fn transducer(
    sweep: &[Reading],
    model: TransducerModel,
    response: impl FnMut(&Reading) -> f64,
) -> TransducerData {
    let responses: Vec<f64> = sweep.iter().map(response).collect();
    TransducerData {
        deviation: false,
        reference_sd: 0.0,
        stimulus_unit: "N".into(),
        response_unit: "V".into(),
        model,
        covariates: vec!["other".into()],
        rows: sweep
            .iter()
            .zip(responses)
            .enumerate()
            .map(|(k, (r, y))| TransducerRow {
                stimulus_sd: None,
                source: "simulated".into(),
                line: k + 2,
                point: k as i64,
                role: Role::Calibration,
                stimulus: r.x,
                response: y,
                t_s: Some(r.t_s),
                temperature_degc: Some(20.0 + r.rise),
                direction: Some(r.direction),
                replicate: None,
                covariates: vec![r.other],
            })
            .collect(),
    }
}

fn axis(sweep: &[Reading], mut error_um: impl FnMut(usize, &Reading) -> f64) -> TransducerData {
    let rows = sweep
        .iter()
        .enumerate()
        .map(|(k, r)| TransducerRow {
            source: "simulated".into(),
            line: k + 2,
            point: k as i64,
            role: Role::Calibration,
            stimulus: r.x,
            response: r.x + 1e-3 * error_um(k, r),
            t_s: Some(r.t_s),
            direction: Some(r.direction),
            replicate: None,
            temperature_degc: Some(20.0 + r.rise),
            stimulus_sd: None,
            covariates: Vec::new(),
        })
        .collect();
    TransducerData::axis(rows)
}

fn quick(seed: u64) -> VerifyRequest {
    VerifyRequest {
        search: Options {
            seed,
            draws: 400,
            largest: 2,
            ..Options::default()
        },
        ..VerifyRequest::default()
    }
}

pub(super) fn run(data: &TransducerData, seed: u64) -> ScalarVerification {
    verify_scalar("simulated", data, Sealed::default(), &quick(seed)).unwrap()
}

/// Upper end of the one-sided 95 % interval of a rate (Clopper & Pearson).
fn upper95(hits: usize, draws: usize) -> f64 {
    Beta::new(hits as f64 + 1.0, (draws - hits) as f64)
        .unwrap()
        .inverse_cdf(0.95)
}

#[test]
fn nothing_is_named_in_null_sessions() {
    const DRAWS: usize = 400;
    let outcomes: Vec<(Verdict, Vec<String>)> = (0..DRAWS as u64)
        .into_par_iter()
        .map(|seed| {
            let mut rng = Noise::new(seed);
            let v = match seed % 3 {
                // A plain table of loads: two runs, neither time nor direction.
                0 => {
                    let mut data = {
                        let sweep = triangles(1, 12 + (seed % 7) as usize, &mut rng);
                        transducer(&sweep, TransducerModel::Linear, |r| {
                            0.1 + 0.2 * r.x + 1e-3 * rng.next()
                        })
                    };
                    data.covariates.clear();
                    for r in &mut data.rows {
                        (r.t_s, r.temperature_degc, r.direction) = (None, None, None);
                        r.covariates.clear();
                    }
                    run(&data, seed)
                }
                1 => {
                    let sweep = triangles(2, 9, &mut rng);
                    let data = transducer(&sweep, TransducerModel::Quadratic, |r| {
                        r.x - 0.01 * r.x * r.x + 0.02 * rng.next()
                    });
                    run(&data, seed)
                }
                _ => {
                    let sweep = triangles(2, 10, &mut rng);
                    let data = axis(&sweep, |_, _| 3.0 + 1.5 * rng.next());
                    run(&data, seed)
                }
            };
            let named = v.document.effects.iter().map(|e| e.id.clone()).collect();
            (v.document.verdict, named)
        })
        .collect();
    let named: Vec<&Vec<String>> = outcomes
        .iter()
        .map(|o| &o.1)
        .filter(|n| !n.is_empty())
        .collect();
    let unknown = outcomes
        .iter()
        .filter(|o| o.0 == Verdict::UnknownEffect && o.1.is_empty())
        .count();
    println!(
        "named {} unknown {unknown} of {DRAWS}: {named:?}",
        named.len()
    );
    assert!(
        upper95(named.len(), DRAWS) <= 0.05,
        "{} of {DRAWS}",
        named.len()
    );
    assert!(
        upper95(unknown, DRAWS) <= 0.05,
        "{unknown} of {DRAWS} unknown"
    );
}

/// Share of `draws` sessions in which `id` is named alone, or with its class; prints what else
/// came.
fn share(id: &str, draws: u64, make: impl Fn(u64) -> ScalarVerification + Sync) -> f64 {
    let outcomes: Vec<(bool, String)> = (0..draws)
        .into_par_iter()
        .map(|seed| {
            let v = make(seed);
            let effects = &v.document.effects;
            let right = effects.len() == 1 && effects[0].class.iter().any(|c| c == id);
            (
                right && v.document.verdict == Verdict::Effect,
                format!(
                    "{seed}: {:?} {:?} {}",
                    v.document.verdict, v.document.alternatives, v.document.reason
                ),
            )
        })
        .collect();
    let right = outcomes.iter().filter(|o| o.0).count();
    let wrong: Vec<&String> = outcomes.iter().filter(|o| !o.0).map(|o| &o.1).collect();
    println!("{id}: {right} of {draws}; else {wrong:?}");
    right as f64 / draws as f64
}

/// Linear transducer, 3 cycles of 2 x 20 readings, noise 0.01 V on 0..2 V, with `extra` added to
/// the response.
fn linear_with(seed: u64, extra: impl Fn(&Reading) -> f64) -> ScalarVerification {
    let mut rng = Noise::new(seed);
    let sweep = triangles(3, 20, &mut rng);
    let data = transducer(&sweep, TransducerModel::Linear, |r| {
        0.1 + 0.2 * r.x + extra(r) + 0.01 * rng.next()
    });
    run(&data, seed)
}

const DRAWS: u64 = 6;

#[test]
fn additive_effects_of_a_transducer_are_named() {
    let at_least = |id: &str, share: f64| assert!(share >= 0.8, "{id}: {share}");
    let check = |id: &str, extra: &(dyn Fn(&Reading) -> f64 + Sync)| {
        at_least(id, share(id, DRAWS, |s| linear_with(s, extra)))
    };
    check("nonlinearity-quadratic", &|r| 0.002 * (r.x - 5.0).powi(2));
    check("nonlinearity-cubic", &|r| 0.0008 * (r.x - 5.0).powi(3));
    check("saturation", &|r| -0.1 * (r.x - 7.3).max(0.0));
    check("dead-zone", &|r| -0.2 * r.x.min(1.3));
    check("periodic", &|r| {
        0.015 * (std::f64::consts::TAU * r.x / 1.37).sin()
    });
    check("drift", &|r| 3e-4 * r.t_s);
    check("temperature", &|r| 0.015 * r.rise);
    check("step", &|r| if r.t_s > 133.0 { 0.02 } else { 0.0 });
    check("cross-axis", &|r| 0.01 * r.other);
    check("hysteresis", &|r| 0.01 * r.direction);
}

#[test]
fn memory_effects_of_a_transducer_are_named() {
    let beside = |noise: f64, seed: u64, response: &dyn Fn(&[Reading]) -> Vec<f64>| {
        let mut rng = Noise::new(seed);
        let sweep = triangles(3, 20, &mut rng);
        let clean = response(&sweep);
        let mut k = 0;
        let data = transducer(&sweep, TransducerModel::Linear, |_| {
            k += 1;
            0.1 + 0.2 * clean[k - 1] + noise * rng.next()
        });
        run(&data, seed)
    };
    let with = |seed: u64, response: &dyn Fn(&[Reading]) -> Vec<f64>| beside(0.01, seed, response);
    // A fine Euler integration of its own, not the catalogue's exact step.
    let creep = |sweep: &[Reading]| -> Vec<f64> {
        let mut slow = 0.0;
        let mut before = 0.0;
        sweep
            .iter()
            .map(|r| {
                for j in 0..200 {
                    let x = before + (r.x - before) * f64::from(j) / 200.0;
                    slow += (x - slow) / 60.0 * 2.0 / 200.0;
                }
                before = r.x;
                r.x + 0.15 * slow
            })
            .collect()
    };
    let lag = |sweep: &[Reading]| -> Vec<f64> {
        let x = |t: f64| {
            let place = (t / 40.0).rem_euclid(2.0);
            10.0 * if place < 1.0 { place } else { 2.0 - place }
        };
        sweep
            .iter()
            .map(|r| if r.t_s < 1.4 { 0.0 } else { x(r.t_s - 1.4) })
            .collect()
    };
    let play = |width: f64| {
        move |sweep: &[Reading]| -> Vec<f64> {
            let mut held: f64 = 0.0;
            sweep
                .iter()
                .map(|r| {
                    held = r.x.max(held).min(r.x + width);
                    held
                })
                .collect()
        }
    };
    assert!(share("creep", DRAWS, |s| with(s, &creep)) >= 0.8);
    assert!(share("lag", DRAWS, |s| with(s, &lag)) >= 0.8);
    assert!(share("backlash", DRAWS, |s| with(s, &play(0.8))) >= 0.8);
    // A precise instrument: 0.04 % of the range, far below what is usual.
    let small = play(0.004);
    assert!(share("backlash", DRAWS, |s| beside(1e-4, s, &small)) >= 0.8);
}

#[test]
fn noise_effects_are_named() {
    let grows = share("heteroscedastic-noise", DRAWS, |seed| {
        let mut rng = Noise::new(seed);
        let sweep = triangles(3, 20, &mut rng);
        let data = transducer(&sweep, TransducerModel::Linear, |r| {
            0.2 * r.x + (0.001 + 0.004 * r.x) * rng.next()
        });
        run(&data, seed)
    });
    let single = share("outliers", DRAWS, |seed| {
        linear_with(seed, |r| {
            if (r.t_s - 58.0).abs() < 0.1 || (r.t_s - 140.0).abs() < 0.1 {
                0.15
            } else {
                0.0
            }
        })
    });
    assert!(grows >= 0.8 && single >= 0.8, "{grows} {single}");
}

#[test]
fn effects_of_an_axis_are_named() {
    let with = |seed: u64, error: &(dyn Fn(&Reading) -> f64 + Sync)| {
        let mut rng = Noise::new(seed);
        let sweep = triangles(3, 20, &mut rng);
        let data = axis(&sweep, |_, r| 4.0 + error(r) + 1.0 * rng.next());
        run(&data, seed)
    };
    let check = |id: &str, error: &(dyn Fn(&Reading) -> f64 + Sync)| {
        // A drift is named alone in eight of ten: fewer draws say little of that.
        let found = share(id, 10, |s| with(s, error));
        assert!(found >= 0.8, "{id}: {found}");
    };
    // Swept up and down three times, a slope is close to a wave in time or order and to a cubic: it
    // is named alone in about half the draws, and otherwise the set must hold it.
    let in_set = |id: &str, error: &(dyn Fn(&Reading) -> f64 + Sync)| {
        let holds = |seed: &u64| {
            with(*seed, error)
                .document
                .alternatives
                .iter()
                .any(|a| a == &[id.to_owned()])
        };
        let kept = (0..14u64).into_par_iter().filter(holds).count();
        println!("{id} in the set: {kept} of 14");
        assert!(kept >= 12, "{id}: {kept}");
    };
    in_set("scale", &|r| 0.4 * r.x);
    // The temperature of these sessions is itself a wave in time.
    in_set("temperature", &|r| 1.2 * r.rise);
    check("backlash", &|r| if r.direction < 0.0 { 3.0 } else { 0.0 });
    check("periodic", &|r| {
        1.5 * (std::f64::consts::TAU * r.x / 0.6096 + 0.7).sin()
    });
    check("drift", &|r| 0.02 * r.t_s);
}

/// Slope of y over x with its 95 % interval by the textbook's straight line.
fn straight_line(x: &[f64], y: &[f64]) -> [f64; 3] {
    let n = x.len() as f64;
    let mean = |v: &[f64]| v.iter().sum::<f64>() / n;
    let (mx, my) = (mean(x), mean(y));
    let sxx: f64 = x.iter().map(|v| (v - mx).powi(2)).sum();
    let slope = x
        .iter()
        .zip(y)
        .map(|(a, b)| (a - mx) * (b - my))
        .sum::<f64>()
        / sxx;
    let left: f64 = x
        .iter()
        .zip(y)
        .map(|(a, b)| (b - my - slope * (a - mx)).powi(2))
        .sum();
    let t = statrs::distribution::StudentsT::new(0.0, 1.0, n - 2.0)
        .unwrap()
        .inverse_cdf(0.975);
    let half = t * (left / (n - 2.0) / sxx).sqrt();
    [slope, slope - half, slope + half]
}

#[test]
fn the_interval_of_a_scale_is_the_one_of_the_straight_line() {
    // Of the draws that are explained by the scale alone.
    let found: Vec<([f64; 3], [f64; 3])> = (0..30u64)
        .into_par_iter()
        .filter_map(|seed| {
            let mut rng = Noise::new(seed);
            let sweep = triangles(3, 20, &mut rng);
            let data = axis(&sweep, |_, r| 4.0 + 0.4 * r.x + rng.next());
            let v = run(&data, seed);
            let p = &v.document.effects[0].parameters[0];
            let x: Vec<f64> = data.rows.iter().map(|r| r.stimulus).collect();
            let y: Vec<f64> = data.rows.iter().map(|r| r.response - r.stimulus).collect();
            (p.name == "relative_scale" && v.document.effects.len() == 1).then(|| {
                (
                    [p.value, p.interval95[0], p.interval95[1]],
                    straight_line(&x, &y),
                )
            })
        })
        .collect();
    assert!(found.len() >= 20, "{}", found.len());
    let covered = found
        .iter()
        .filter(|(_, line)| line[1] <= 4e-4 && 4e-4 <= line[2])
        .count();
    println!(
        "the textbook's intervals cover {covered} of {}",
        found.len()
    );
    for (stated, line) in found {
        let width = line[2] - line[1];
        // Ends that are off by 2 % of the width (0.08 sd) change the coverage by less than 1 %.
        assert!(
            stated
                .iter()
                .zip(line)
                .all(|(a, b)| (a - b).abs() < 0.02 * width),
            "{stated:?} {line:?}"
        );
    }
}

#[test]
fn sealed_readings_are_predicted_and_never_fitted() {
    let mut rng = Noise::new(5);
    let sweep = triangles(3, 20, &mut rng);
    let mut data = transducer(&sweep, TransducerModel::Linear, |r| {
        0.2 * r.x + 0.002 * (r.x - 5.0).powi(2) + 0.01 * rng.next()
    });
    let held_out = data.rows.split_off(90);
    let run = |held_out: Vec<TransducerRow>| {
        let sealed = Sealed::new(held_out);
        verify_scalar("simulated", &data, sealed, &quick(1)).unwrap()
    };
    let clean = run(held_out.clone());
    assert_eq!(clean.document.after.as_ref().unwrap().split, "holdout");
    assert_eq!(clean.document.after.as_ref().unwrap().points, 30);
    // Sealed readings spoilt: every fitted value stays, only the held-out error gets worse.
    let moved = |r: TransducerRow| TransducerRow {
        response: r.response + 1.0,
        ..r
    };
    let spoilt = run(held_out.into_iter().map(moved).collect());
    assert_eq!(clean.residual_sd, spoilt.residual_sd);
    assert_eq!(clean.document.effects, spoilt.document.effects);
    let rmse = |v: &ScalarVerification| v.document.after.as_ref().unwrap().rmse["response_rmse"];
    assert!(rmse(&clean) < 0.02 && rmse(&spoilt) > 0.9);
    // They contradict the decision and do not change it.
    let outcome = |v: &ScalarVerification| v.document.holdout.outcome;
    assert_eq!(
        (outcome(&clean), outcome(&spoilt)),
        (HoldoutOutcome::Confirmed, HoldoutOutcome::Contradicted)
    );
    assert_eq!(clean.document.verdict, spoilt.document.verdict);
    assert_eq!(
        clean.document.holdout.decision_sha256,
        spoilt.document.holdout.decision_sha256
    );
}

#[test]
fn poor_data_are_refused_or_narrowed() {
    let mut rng = Noise::new(1);
    let sweep = triangles(2, 10, &mut rng);
    let mut data = transducer(&sweep, TransducerModel::Linear, |r| r.x + 0.01 * rng.next());
    let full = run(&data, 1);
    assert!(
        full.document
            .detectable
            .iter()
            .any(|d| d.id == "drift" && d.status == "testable")
    );
    assert!(
        full.document
            .detectable
            .iter()
            .any(|d| d.id == "scale" && d.status == "absorbed")
    );
    for r in &mut data.rows {
        (r.t_s, r.temperature_degc, r.direction) = (None, None, None);
    }
    // In the order of strokes the rows themselves tell the direction.
    let strokes = run(&data, 1);
    assert!(
        strokes
            .document
            .detectable
            .iter()
            .any(|d| d.id == "hysteresis" && d.status == "testable")
    );
    assert!(
        strokes
            .document
            .notes
            .iter()
            .any(|n| n.contains("order of the readings"))
    );
    data.rows = (0..40).map(|k| data.rows[k * 7 % 40].clone()).collect();
    let narrow = run(&data, 1);
    for id in ["hysteresis", "backlash", "temperature", "lag", "creep"] {
        let row = narrow
            .document
            .detectable
            .iter()
            .find(|d| d.id == id)
            .unwrap();
        assert_eq!(row.status, "not-observable", "{id}");
        assert!(!row.why.is_empty());
    }
    let mut constant = data.clone();
    for r in &mut constant.rows {
        r.stimulus = 3.0;
    }
    assert_eq!(run(&constant, 1).document.verdict, Verdict::Refused);
    data.rows.truncate(3);
    assert_eq!(run(&data, 1).document.verdict, Verdict::Refused);
    data.rows.clear();
    assert_eq!(run(&data, 1).document.verdict, Verdict::Refused);
}

#[test]
fn an_exact_line_is_adequate() {
    let mut rng = Noise::new(1);
    let sweep = triangles(2, 10, &mut rng);
    let data = transducer(&sweep, TransducerModel::Linear, |r| 0.5 + 0.3 * r.x);
    assert_eq!(run(&data, 1).document.verdict, Verdict::Adequate);
}

#[test]
fn the_same_seed_gives_the_same_document() {
    let a = linear_with(3, |r| 0.002 * (r.x - 5.0).powi(2));
    let b = linear_with(3, |r| 0.002 * (r.x - 5.0).powi(2));
    assert_eq!(format!("{:?}", a.document), format!("{:?}", b.document));
}
