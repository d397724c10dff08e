//! The stimulus of a response where the instrument has memory.

use super::Noise;
use super::scalar_simulated::{Reading, run, transducer, triangles};
use wcal_core::observation::{Role, TransducerModel};
use wcal_verify::scalar::{ScalarModel, ScalarRow};

const NOISE: f64 = 2e-3;

/// A model of a load cell whose response is `acts` beside its sensitivity of 0.2 V/N, by a session
/// of six triangles; it must name `effect`.
fn calibrated(seed: u64, effect: &str, acts: &dyn Fn(&[Reading]) -> Vec<f64>) -> ScalarModel {
    let mut rng = Noise::new(seed);
    let mut sweep = triangles(6, 20, &mut rng);
    // The second half goes four times as slowly: a lag and a play are two things then.
    let half = sweep.len() / 2;
    for (k, r) in sweep.iter_mut().enumerate().skip(half) {
        r.t_s = (2 * half + 8 * (k - half)) as f64;
    }
    let mut added = acts(&sweep).into_iter();
    let data = transducer(&sweep, TransducerModel::Linear, |r| {
        0.2 * r.x + added.next().unwrap() + NOISE * rng.next()
    });
    let v = run(&data, seed);
    let names: Vec<&str> = v.document.effects.iter().map(|e| e.id.as_str()).collect();
    assert_eq!(names, [effect], "seed {seed}: {}", v.document.reason);
    v.model.unwrap()
}

/// Rows of a new record as `predict` reads them, with what is known of their order.
fn rows(sweep: &[Reading], responses: &[f64], timed: bool, directed: bool) -> Vec<ScalarRow> {
    let row = |(k, (r, y)): (usize, (&Reading, &f64))| ScalarRow {
        origin: ("new".to_owned(), k + 2, k as i64),
        role: Role::Verification,
        x: 5.0,
        x_sd: None,
        y: *y,
        t_s: timed.then_some(r.t_s),
        temperature_degc: Some(20.0 + r.rise),
        direction: directed.then_some(r.direction),
        cycle: None,
        covariates: vec![r.other],
        place: None,
    };
    sweep.iter().zip(responses).enumerate().map(row).collect()
}

/// Share of the stimuli within their half widths, and the mean half width.
fn covered(model: &ScalarModel, rows: &[ScalarRow], sweep: &[Reading]) -> [f64; 2] {
    let found = model.invert(rows).unwrap();
    let n = sweep.len() as f64;
    let inside = found
        .iter()
        .zip(sweep)
        .filter(|(p, r)| (p.value - r.x).abs() <= p.half95);
    [
        inside.count() as f64 / n,
        found.iter().map(|p| p.half95).sum::<f64>() / n,
    ]
}

/// Shares and widths over several calibrations with as many new records each.
fn over_seeds(
    effect: &str,
    acts: &dyn Fn(&[Reading]) -> Vec<f64>,
    timed: bool,
    directed: bool,
) -> [f64; 2] {
    let each: Vec<[f64; 2]> = (0..6u64)
        .map(|seed| {
            let model = calibrated(seed, effect, acts);
            let mut rng = Noise::new(100 + seed);
            let sweep = triangles(3, 25, &mut rng);
            let added = acts(&sweep);
            let read = sweep
                .iter()
                .zip(added)
                .map(|(r, a)| 0.2 * r.x + a + NOISE * rng.next());
            let read: Vec<f64> = read.collect();
            covered(&model, &rows(&sweep, &read, timed, directed), &sweep)
        })
        .collect();
    [0, 1].map(|k| each.iter().map(|e| e[k]).sum::<f64>() / 6.0)
}

#[test]
fn a_loop_is_followed_by_directions_and_half_of_it_is_stated_without_them() {
    // Half loop 0.05 V, a quarter of a newton in the middle.
    let looped = |sweep: &[Reading]| -> Vec<f64> {
        let of = |r: &Reading| 0.05 * r.direction * (1.0 - (0.2 * r.x - 1.0).powi(2));
        sweep.iter().map(of).collect()
    };
    let [by_direction, narrow] = over_seeds("hysteresis", &looped, false, true);
    let [alone, wide] = over_seeds("hysteresis", &looped, false, false);
    println!("loop: {by_direction:.3} at {narrow:.4} N, alone {alone:.3} at {wide:.4} N");
    assert!((0.91..=0.99).contains(&by_direction), "{by_direction}");
    assert!(narrow < 0.025, "{narrow}");
    // Each reading is off by half the loop, one way or the other: the width holds it.
    assert!(alone > 0.93 && wide > 0.1 && wide < 0.3, "{alone} {wide}");
}

#[test]
fn a_place_without_its_direction_has_the_mean_of_both() {
    let looped = |sweep: &[Reading]| -> Vec<f64> {
        let of = |r: &Reading| 0.05 * r.direction * (1.0 - (0.2 * r.x - 1.0).powi(2));
        sweep.iter().map(of).collect()
    };
    let model = calibrated(0, "hysteresis", &looped);
    let mut rng = Noise::new(9);
    let sweep = triangles(1, 10, &mut rng);
    let mut places = rows(&sweep, &[0.0; 20], false, false);
    places
        .iter_mut()
        .zip(&sweep)
        .for_each(|(row, r)| row.x = r.x);
    let found = model.predict_both_ways(&places).unwrap();
    for (p, r) in found.iter().zip(&sweep) {
        let half_loop = 0.05 * (1.0 - (0.2 * r.x - 1.0).powi(2));
        assert!((p.value - 0.2 * r.x).abs() < 2e-3, "{p:?} at {}", r.x);
        assert!(p.half95 > half_loop && p.half95 < half_loop + 0.01, "{p:?}");
    }
    // Control: with directions nothing has to be guessed.
    let directed = rows(&sweep, &[0.0; 20], false, true);
    assert!(model.predict_both_ways(&directed).is_none());
}

#[test]
fn play_and_creep_are_followed_from_reading_to_reading() {
    let play = |sweep: &[Reading]| -> Vec<f64> {
        let mut held: f64 = 0.0;
        let mut moved = |r: &Reading| {
            held = r.x.max(held).min(r.x + 0.4);
            0.2 * (held - r.x)
        };
        sweep.iter().map(&mut moved).collect()
    };
    let creep = |sweep: &[Reading]| -> Vec<f64> {
        let mut slow = sweep[0].x;
        let mut out = vec![0.01 * slow];
        for p in sweep.windows(2) {
            // Exact for a stimulus that moves evenly between readings.
            let q = (p[1].t_s - p[0].t_s) / 30.0;
            let lead = (p[1].x - p[0].x) / q;
            slow = p[1].x - lead + (slow - p[0].x + lead) * (-q).exp();
            out.push(0.01 * slow);
        }
        out
    };
    let [followed, width] = over_seeds("backlash", &play, true, false);
    println!("play: {followed:.3} at {width:.4} N");
    assert!(
        (0.91..=0.99).contains(&followed) && width < 0.1,
        "{followed} {width}"
    );
    let [alone, wide] = over_seeds("backlash", &play, false, false);
    println!("play, alone: {alone:.3} at {wide:.4} N");
    assert!(alone > 0.93 && wide > 0.2, "{alone} {wide}");
    let [followed, width] = over_seeds("creep", &creep, true, false);
    println!("creep: {followed:.3} at {width:.4} N");
    assert!((0.91..=0.995).contains(&followed), "{followed} {width}");
    // Control: the sensitivity alone, as if nothing crept.
    let mut rng = Noise::new(1);
    let sweep = triangles(3, 25, &mut rng);
    let model = calibrated(0, "creep", &creep);
    let mut plain = model.clone();
    plain.effects.clear();
    plain.coefficients.truncate(2);
    plain.covariance = model.covariance[..2]
        .iter()
        .map(|r| r[..2].to_vec())
        .collect();
    let added = creep(&sweep);
    let read: Vec<f64> = sweep
        .iter()
        .zip(added)
        .map(|(r, a)| 0.2 * r.x + a)
        .collect();
    let [control, _] = covered(&plain, &rows(&sweep, &read, true, false), &sweep);
    assert!(control < 0.7, "{control}");
}
