//! Names by what drives a term: a step over the stimulus, an axis that is loaded by itself, a load
//! that stays, zeros of series. SIMULATED; every test has a control.

use super::names;
use super::scalar_inputs::{linear, noise, parameter, run};
use wcal_core::observation::TransducerModel;
use wcal_core::verify_document::Verdict;
use wcal_verify::scalar::ScalarVerification;

/// A sensor whose readings beyond a stimulus stand `height` noises higher: `n` stimuli, each read
/// once.
fn stepped(n: usize, at: f64, height: f64) -> ScalarVerification {
    let mut z = noise(n as u64);
    let row = |k: usize| {
        let x = 10.0 * k as f64 / (n as f64 - 1.0);
        let step = if x > 10.0 * at { 0.05 * height } else { 0.0 };
        (x, 0.3 + 2.0 * x + step + 0.05 * z(), None, Vec::new(), None)
    };
    linear((0..n).map(row).collect())
}

#[test]
fn a_step_over_the_stimulus_is_named_and_what_is_rejected_is_never_adequate() {
    for n in [10, 17, 25, 40, 80, 160] {
        for (at, height) in [(0.47, 20.0), (0.47, 136.0), (0.63, 136.0)] {
            let v = stepped(n, at, height);
            assert!(
                v.document.verdict != Verdict::Adequate,
                "{n} {at} {height}: {}",
                v.document.reason
            );
            if names(&v) == ["step"] {
                let [from, to] = parameter(&v, "place").1;
                assert!((from..=to).contains(&(10.0 * at)), "{n} {at}: {from} {to}");
            } else {
                // 160 readings: the noise beside it may be something, too.
                assert!(
                    n > 80 && names(&v).contains(&"step"),
                    "{n} {at} {height}: {}",
                    v.document.reason
                );
            }
        }
        // Controls: no step; and one of few noises is named, or unknown where a test rejects, and
        // adequate where none does.
        assert_eq!(
            stepped(n, 0.47, 0.0).document.verdict,
            Verdict::Adequate,
            "{n}"
        );
        let v = stepped(n, 0.47, 5.0);
        let rejected = v.gates.unwrap()[0]
            .iter()
            .zip([0.01, 0.005, 0.002])
            .any(|(p, level)| *p < level);
        assert!(
            !(rejected && v.document.verdict == Verdict::Adequate),
            "{n}: {}",
            v.document.reason
        );
    }
}

#[test]
fn what_is_loaded_by_itself_and_a_load_that_stays_keep_their_names() {
    let mut z = noise(70);
    // An axis that is loaded four times beside eleven loads of the other; `alone`: its last load by
    // itself moves the response.
    let mut axis = |slope: f64, alone: f64| {
        let main = (0..22).map(|k| (f64::from(k % 11), 0.0));
        let other = [1.0, 2.0, 3.0, 4.0, 1.0, 2.0, 3.0, 4.0].map(|load| (0.0, load));
        let row = |(x, load): (f64, f64)| {
            let moved = slope * load + if load == 4.0 { alone } else { 0.0 };
            (x, 0.8 * x + moved + 0.02 * z(), None, vec![load], None)
        };
        run(
            TransducerModel::Linear,
            &["fx"],
            main.chain(other).map(row).collect(),
        )
    };
    let v = axis(0.015, 0.0);
    assert_eq!(names(&v), ["cross-axis"], "{}", v.document.reason);
    // Controls: no cross-talk, and one load alone is no law.
    assert_eq!(axis(0.0, 0.0).document.verdict, Verdict::Adequate);
    assert_ne!(names(&axis(0.0, 0.08)), ["cross-axis"]);
    let mut held = |size: f64| {
        let row = |k: usize| {
            (
                10.0,
                1.0 + size * (-(k as f64) / 15.0).exp() + 0.01 * z(),
                None,
                Vec::new(),
                Some(10.0 * k as f64),
            )
        };
        run(TransducerModel::Constant, &[], (0..60).map(row).collect())
    };
    let v = held(0.5);
    assert_eq!(names(&v), ["creep"], "{}", v.document.reason);
    assert_eq!(held(0.0).document.verdict, Verdict::Adequate);
}

/// A zero of each series costs the repeats its degrees of freedom, and the places none.
#[test]
fn zeros_of_series_are_taken_off_the_repeats() {
    let of = |seed: u64, off: f64| {
        let mut z = noise(600 + seed);
        let zeros: Vec<f64> = (0..8).map(|_| 0.3 * z()).collect();
        let row = |k: usize| {
            let (x, series) = ((k % 10) as f64, k / 10);
            let place = if k % 10 == 4 { off } else { 0.0 };
            (
                x,
                0.3 + 2.0 * x + zeros[series] + place + 0.05 * z(),
                Some(1 + series as u32),
                Vec::new(),
                None,
            )
        };
        linear((0..80).map(row).collect())
    };
    let clean: Vec<ScalarVerification> = (0..12).map(|seed| of(seed, 0.0)).collect();
    let dof: Vec<[f64; 2]> = clean
        .iter()
        .filter_map(|v| v.lack_of_fit_after)
        .map(|l| [l.dof, l.pure_dof])
        .collect();
    assert!(
        dof.iter().filter(|d| **d == [8.0, 63.0]).count() >= 11,
        "{dof:?}"
    );
    let right = clean
        .iter()
        .filter(|v| v.document.verdict == Verdict::Effect && names(v) == ["zero-by-series"])
        .count();
    assert!(right >= 11, "{right}");
    // Control: a place that is off in every series is refuted by the repeats.
    let v = of(0, 0.3);
    assert!(
        v.lack_of_fit_after.unwrap().is_significant() && v.document.verdict != Verdict::Effect,
        "{}",
        v.document.reason
    );
}
