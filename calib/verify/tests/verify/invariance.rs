//! What changes no physics changes no answer: a table of transformations of sessions of every kind
//! (SIMULATED; the whisker's recorded by the virtual bench).
//!
//! Where a clock, a thermometer or a count begins, in what unit a value is written, which way an
//! axis counts and which of two columns stands first is nobody's effect: the same verdict, and the
//! same numbers in the same units to a millionth.

use super::Noise;
use super::whisker_stages::data;
use std::f64::consts::TAU;
use wcal_core::Sealed;
use wcal_core::observation::{Role, TransducerData, TransducerModel, TransducerRow, WhiskerData};
use wcal_core::verify_document::{HeldOutError, VerifyDocument};
use wcal_verify::levels::NORMAL_95;
use wcal_verify::method::options::Options;
use wcal_verify::scalar::{ScalarVerification, verify_scalar};
use wcal_verify::verify::VerifyRequest;
use wcal_verify::whisker::{Verified, verify_whisker};

/// What a transformation did to the numbers: factors of response and stimulus, and seconds by which
/// the clock was set on.
#[derive(Clone, Copy)]
struct Change {
    response: f64,
    stimulus: f64,
    later_s: f64,
}

const NONE: Change = Change {
    response: 1.0,
    stimulus: 1.0,
    later_s: 0.0,
};

/// Verdict and names; numbers by name with what they are compared with, in the units of before.
#[derive(Debug)]
struct Answer(String, Vec<(String, f64, f64)>);

impl Answer {
    fn of(document: &VerifyDocument, change: Change) -> Self {
        // Factor of a unit such as V/N^2.
        let factor = |unit: &str| -> f64 {
            let of = |name: &str| match name {
                "V" | "um" => change.response,
                "N" | "mm" => change.stimulus,
                _ => 1.0,
            };
            let power = |part: &str| match part.split_once('^') {
                Some((name, power)) => of(name).powi(power.parse().unwrap()),
                None => of(part),
            };
            let mut parts = unit.split('/').map(power);
            let first = parts.next().unwrap();
            parts.fold(first, |all, below| all / below)
        };
        let names: Vec<_> = document.effects.iter().map(|e| (&e.id, &e.laws)).collect();
        let outcome = format!(
            "{:?} {names:?} {:?}",
            document.verdict, document.holdout.outcome
        );
        let mut numbers = Vec::new();
        for p in document.effects.iter().flat_map(|e| &e.parameters) {
            let later = if p.name.starts_with("place") && p.unit == "s" {
                change.later_s
            } else {
                0.0
            };
            let back = |v: f64| v / factor(&p.unit) - later;
            let scale = p
                .interval95
                .iter()
                .map(|v| back(*v).abs())
                .fold(0.0, f64::max);
            let all = [p.value, p.interval95[0], p.interval95[1]];
            numbers.extend(all.map(|v| (p.name.clone(), back(v), scale)));
        }
        let p = document
            .effects
            .iter()
            .map(|e| (format!("ln p of {}", e.id), e.p_value.ln(), e.p_value.ln()));
        numbers.extend(p);
        let of = |e: &HeldOutError| {
            let ends = e
                .interval95
                .iter()
                .flat_map(|(k, v)| v.map(|v| (k.clone(), v)));
            let all = e.rmse.iter().map(|(k, v)| (k.clone(), *v)).chain(ends);
            all.map(|(k, v)| (k, v / change.response, v / change.response))
                .collect::<Vec<_>>()
        };
        numbers.extend(
            [&document.before, &document.after]
                .into_iter()
                .flatten()
                .flat_map(of),
        );
        let repeat = document
            .noise
            .as_ref()
            .unwrap()
            .repeat
            .as_ref()
            .unwrap()
            .value
            / change.response;
        numbers.push(("noise".into(), repeat, repeat));
        for d in &document.detectable {
            let smallest = d.smallest.map_or(0.0, |v| v / factor(&d.unit));
            numbers.push((
                format!("detectable {} {}", d.id, d.status),
                smallest,
                smallest,
            ));
        }
        Self(outcome, numbers)
    }

    /// With predictions and the half widths that they are compared with.
    fn predicting(mut self, values: impl IntoIterator<Item = [f64; 2]>, factor: f64) -> Self {
        self.1.extend(
            values
                .into_iter()
                .map(|[v, half]| ("prediction".into(), v / factor, half / factor)),
        );
        self.1.extend(
            self.1
                .clone()
                .into_iter()
                .filter(|n| n.0 == "prediction")
                .map(|n| ("half".into(), n.2, n.2)),
        );
        self
    }

    /// The first difference beyond a millionth.
    fn difference(&self, other: &Self) -> Option<String> {
        if self.0 != other.0 || self.1.len() != other.1.len() {
            return Some(format!("{}\n{}", self.0, other.0));
        }
        let differs = |((k, a, scale), (l, b, _)): &(&(String, f64, f64), &(String, f64, f64))| {
            k != l || !((a - b).abs() <= 1e-6 * scale.abs())
        };
        self.1
            .iter()
            .zip(&other.1)
            .find(differs)
            .map(|d| format!("{d:?}"))
    }
}

fn request() -> VerifyRequest {
    VerifyRequest {
        search: Options {
            seed: 1,
            draws: 300,
            ..Options::default()
        },
        ..VerifyRequest::default()
    }
}

fn scalar(data: &TransducerData) -> ScalarVerification {
    verify_scalar("simulated", data, Sealed::default(), &request()).unwrap()
}

/// Two cycles of a force with drift, a warming room, a second force and a third column that nothing
/// follows.
fn transducer() -> TransducerData {
    let mut n = Noise::new(11);
    let row = |k: usize| {
        let place = (k % 30) as f64 / 15.0;
        let (stimulus, direction) = if place < 1.0 {
            (10.0 * place, 1.0)
        } else {
            (10.0 * (2.0 - place), -1.0)
        };
        let (t_s, warm, other) = (
            3.0 + 7.0 * k as f64,
            (TAU * k as f64 / 23.0).sin(),
            n.next(),
        );
        let response =
            0.2 + 0.5 * stimulus + 2e-4 * t_s + 0.03 * warm + 0.04 * other + 0.005 * n.next();
        TransducerRow {
            stimulus_sd: None,
            source: "simulated".into(),
            line: k + 2,
            point: k as i64,
            role: Role::Calibration,
            stimulus,
            response,
            t_s: Some(t_s),
            temperature_degc: Some(20.0 + warm),
            direction: Some(direction),
            replicate: None,
            covariates: vec![other, n.next()],
        }
    };
    TransducerData {
        deviation: false,
        reference_sd: 0.0,
        stimulus_unit: "N".into(),
        response_unit: "V".into(),
        model: TransducerModel::Linear,
        covariates: vec!["other".into(), "spare".into()],
        rows: (0..60).map(row).collect(),
    }
}

fn of_transducer(change: Change, make: impl Fn(&mut TransducerData)) -> Answer {
    let mut data = transducer();
    make(&mut data);
    let v = scalar(&data);
    let rows: Vec<_> = v.whole.as_ref().unwrap().frame.rows.clone();
    let at = v.model.as_ref().unwrap().predict(&rows).unwrap();
    Answer::of(&v.document, change)
        .predicting(at.iter().map(|p| [p.value, p.half95]), change.response)
}

/// Three strokes either way of a screw with a period, a reversal and a drift.
fn axis() -> TransducerData {
    let mut n = Noise::new(12);
    let row = |k: usize| {
        let (place, up) = (k % 80, k % 80 < 40);
        let x = 5.0
            * if up {
                place as f64
            } else {
                79.0 - place as f64
            };
        let t_s = 4.0 * k as f64;
        let error_um =
            3.0 * (TAU * x / 24.0).sin() + if up { 0.0 } else { 2.5 } + 0.01 * t_s + 0.2 * n.next();
        TransducerRow {
            source: "simulated".into(),
            line: k + 2,
            point: k as i64,
            role: Role::Calibration,
            stimulus: x,
            response: x + 1e-3 * error_um,
            t_s: Some(t_s),
            direction: Some(if up { 1.0 } else { -1.0 }),
            replicate: None,
            temperature_degc: Some(20.0 + 0.03 * n.next()),
            stimulus_sd: None,
            covariates: Vec::new(),
        }
    };
    TransducerData::axis((0..240).map(row).collect())
}

/// `sign`: of the positions.
fn of_axis(change: Change, sign: f64, make: impl Fn(&mut TransducerRow)) -> Answer {
    let mut data = axis();
    data.rows.iter_mut().for_each(make);
    let v = scalar(&data);
    let rows: Vec<_> = v.whole.as_ref().unwrap().frame.rows.clone();
    let at = v.model.as_ref().unwrap().predict(&rows).unwrap();
    let Answer(outcome, mut numbers) = Answer::of(&v.document, change);
    // Of signed parameters the size is compared; what does not change its sign with the axis is
    // positive here.
    numbers.iter_mut().for_each(|n| n.1 = n.1.abs());
    numbers.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    Answer(outcome, numbers).predicting(
        at.iter().map(|p| [sign * p.value, p.half95]),
        change.response,
    )
}

/// A recorded drift, every fifth reading, without its reference grating: at 20 deg C, steady to
/// some hundredths, which a mismatch shows in both gratings.
fn whisker() -> WhiskerData {
    let mut data = data("recorded/drift");
    data.rows = data.rows.iter().step_by(5).cloned().collect();
    for row in &mut data.rows {
        let warm = 0.03 * (TAU * row.t_s.unwrap() / 700.0).sin();
        row.shift_pm = row.compensated_pm(&data.fbg).map(|s| s + 40.0 * warm);
        (row.reference_shift_pm, row.temperature_degc) = (None, Some(20.0 + warm));
    }
    data.fbg.temperature_compensated = true;
    data
}

fn of_whisker(make: impl Fn(&mut WhiskerData)) -> Answer {
    let mut data = whisker();
    make(&mut data);
    let Verified::Done(v) =
        verify_whisker("drift", &data, Sealed::default(), &[], &[], &request()).unwrap()
    else {
        panic!("refused")
    };
    let path = &v.decision.model().path;
    let inferred = v.decision.calibration().infer(path, None);
    let moments = inferred
        .iter()
        .flat_map(|m| [0, 1].map(|c| [m.moment_nmm[c], NORMAL_95 * m.sd_nmm[c]]));
    Answer::of(&v.document, NONE).predicting(moments, 1.0)
}

/// Seconds from which a clock may count: hours of uptime, Unix time, before the start.
const CLOCKS_S: [f64; 3] = [1e5, 1.7e9, -1e3];

#[test]
fn a_transducers_answer_is_that_of_its_physics() {
    let as_it_is = of_transducer(NONE, |_| {});
    assert!(
        as_it_is.0.contains("drift")
            && as_it_is.0.contains("temperature")
            && as_it_is.0.contains("cross-axis"),
        "{}",
        as_it_is.0
    );
    let rows = |change: Change, f: &dyn Fn(&mut TransducerRow)| {
        of_transducer(change, |d| d.rows.iter_mut().for_each(f))
    };
    let mut told = Vec::new();
    let mut same = |what: &str, answer: Answer| {
        told.extend(as_it_is.difference(&answer).map(|d| format!("{what}: {d}")))
    };
    for later_s in CLOCKS_S {
        let change = Change { later_s, ..NONE };
        same(
            "clock",
            rows(change, &|r| r.t_s = r.t_s.map(|t| t + later_s)),
        );
    }
    same(
        "thermometer",
        rows(NONE, &|r| {
            r.temperature_degc = r.temperature_degc.map(|t| t + 53.0)
        }),
    );
    same("column", rows(NONE, &|r| r.covariates[0] += 1e4));
    same("number", rows(NONE, &|r| r.point += 5000));
    for response in [1e-3, 1e3] {
        same(
            "response",
            rows(Change { response, ..NONE }, &|r| r.response *= response),
        );
    }
    same(
        "stimulus",
        rows(
            Change {
                stimulus: 1e-3,
                ..NONE
            },
            &|r| r.stimulus *= 1e-3,
        ),
    );
    same(
        "columns",
        of_transducer(NONE, |d| {
            d.covariates.reverse();
            d.rows.iter_mut().for_each(|r| r.covariates.reverse());
        }),
    );
    assert!(told.is_empty(), "{told:#?}");
    // Control: a thermometer that was read wrongly once changes the numbers.
    assert!(
        as_it_is
            .difference(&of_transducer(NONE, |d| d.rows[9].temperature_degc = Some(20.5)))
            .is_some()
    );
}

#[test]
fn an_axiss_answer_is_that_of_its_physics() {
    let as_it_is = of_axis(NONE, 1.0, |_| {});
    assert!(
        as_it_is.0.contains("periodic")
            && as_it_is.0.contains("backlash")
            && as_it_is.0.contains("drift"),
        "{}",
        as_it_is.0
    );
    let mut told = Vec::new();
    let mut same = |what: &str, answer: Answer| {
        told.extend(as_it_is.difference(&answer).map(|d| format!("{what}: {d}")))
    };
    for later_s in CLOCKS_S {
        let change = Change { later_s, ..NONE };
        same(
            "clock",
            of_axis(change, 1.0, |r| r.t_s = r.t_s.map(|t| t + later_s)),
        );
    }
    same(
        "thermometer",
        of_axis(NONE, 1.0, |r| {
            r.temperature_degc = r.temperature_degc.map(|t| t - 31.0)
        }),
    );
    let change = Change {
        response: 1e-3,
        stimulus: 1e-3,
        later_s: 0.0,
    };
    same(
        "unit",
        of_axis(change, 1.0, |r| {
            (r.stimulus, r.response) = (1e-3 * r.stimulus, 1e-3 * r.response)
        }),
    );
    assert!(told.is_empty(), "{told:#?}");
    let turned = of_axis(NONE, -1.0, |r| {
        (r.stimulus, r.response) = (-r.stimulus, -r.response);
        r.direction = r.direction.map(|d| -d);
    });
    // Of a mirrored axis the names alone: intervals are by differences to one side, draws and folds
    // by place are not mirrored.
    assert_eq!(as_it_is.0, turned.0);
    // Control: one place a micrometre further.
    assert!(
        as_it_is
            .difference(&of_axis(NONE, 1.0, |r| r.response +=
                if r.point == 7 { 1e-3 } else { 0.0 }))
            .is_some()
    );
}

#[test]
fn a_whiskers_answer_is_that_of_its_physics() {
    let as_it_is = of_whisker(|_| {});
    assert!(
        as_it_is.0.contains("zero-drift") && as_it_is.0.contains("temperature-mismatch"),
        "{}",
        as_it_is.0
    );
    let mut told = Vec::new();
    let mut same = |what: &str, answer: Answer| {
        told.extend(as_it_is.difference(&answer).map(|d| format!("{what}: {d}")))
    };
    for later_s in CLOCKS_S {
        same(
            "clock",
            of_whisker(|d| {
                d.rows
                    .iter_mut()
                    .for_each(|r| r.t_s = r.t_s.map(|t| t + later_s))
            }),
        );
    }
    same(
        "thermometer",
        of_whisker(|d| {
            d.rows
                .iter_mut()
                .for_each(|r| r.temperature_degc = r.temperature_degc.map(|t| t + 61.0))
        }),
    );
    same(
        "number",
        of_whisker(|d| d.rows.iter_mut().for_each(|r| r.point += 5000)),
    );
    assert!(told.is_empty(), "{told:#?}");
    // Control: a clock that runs a thousandth too fast.
    assert!(
        as_it_is
            .difference(&of_whisker(|d| d
                .rows
                .iter_mut()
                .for_each(|r| r.t_s = r.t_s.map(|t| 1.001 * t))))
            .is_some()
    );
}
