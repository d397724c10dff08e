//! Every law of both catalogues at and beyond the ends of its parameters, on odd stimuli: a design
//! of finite numbers or none, and never a panic.

use super::whisker_stages::data;
use wcal_core::observation::{Role, TransducerRow};
use wcal_verify::MeasurementModel;
use wcal_verify::effect::EffectTerm;
use wcal_verify::scalar::{Declared, Frame, ScalarRow, ScalarSystem, Scaling};
use wcal_verify::whisker::WhiskerSystem;

/// Values of a parameter that are tried: at the ends of its range, a rounding beside them, in the
/// middle, nothing, and none.
fn values([low, high]: [f64; 2]) -> [f64; 8] {
    let hair = 1e-12 * (high - low);
    [
        low,
        low + hair,
        0.5 * (low + high),
        high - hair,
        high,
        0.0,
        f64::NAN,
        f64::INFINITY,
    ]
}

/// Designs of every law of `system` with finite values, of those that were tried.
fn designs(system: &dyn MeasurementModel, what: &str) -> [usize; 2] {
    let (mut made, mut tried) = (0, 0);
    for (effect, e) in system.catalogue().iter().enumerate() {
        for (law, form) in e.laws.iter().chain(&e.refinements).enumerate() {
            let middle: Vec<f64> = form
                .parameters
                .iter()
                .map(|p| 0.5 * (p.range[0] + p.range[1]))
                .collect();
            let one = |k: usize, v: f64| {
                let mut values = middle.clone();
                values[k] = v;
                EffectTerm {
                    effect,
                    law,
                    values,
                }
            };
            let each =
                (0..middle.len()).flat_map(|k| values(form.parameters[k].range).map(|v| one(k, v)));
            for term in each.chain([EffectTerm {
                effect,
                law,
                values: middle.clone(),
            }]) {
                // Alone, and upon itself.
                for terms in [vec![term.clone()], vec![term.clone(); 2]] {
                    tried += 1;
                    let Some(design) = system.design(&terms) else {
                        continue;
                    };
                    made += 1;
                    let said = || format!("{what}: {} {} {:?}", e.id, form.name, term.values);
                    assert!(design.iter().all(|v| v.is_finite()), "{}", said());
                    assert!(term.values.iter().all(|v| v.is_finite()), "{}", said());
                }
            }
        }
    }
    [made, tried]
}

fn scalar(stimuli: &[f64], declared: Declared) -> ScalarSystem {
    let row = |(k, x): (usize, &f64)| TransducerRow {
        stimulus_sd: None,
        source: "simulated".into(),
        line: k + 2,
        point: k as i64,
        role: Role::Calibration,
        stimulus: *x,
        response: x.abs().min(1e3) + (k % 3) as f64,
        t_s: Some(2.0 * (k / 2) as f64),
        temperature_degc: Some(20.0 + (k % 5) as f64),
        direction: Some(if k % 2 == 0 { 1.0 } else { -1.0 }),
        replicate: Some((k / 8) as u32),
        covariates: vec![(k % 7) as f64],
    };
    let rows: Vec<ScalarRow> = stimuli
        .iter()
        .enumerate()
        .map(|at| (&row(at)).into())
        .collect();
    let of = |declared| Scaling::of_session(&rows, declared, "degC", rows.len());
    let transducer = match declared {
        Declared::Axis => Declared::Polynomial(0),
        Declared::Polynomial(_) => declared,
    };
    let scaling = Scaling {
        places: of(Declared::Axis).places,
        ..of(transducer)
    };
    ScalarSystem::new(
        Frame::new(rows, &scaling, declared, false),
        &["other".to_owned()],
    )
}

#[test]
fn a_design_is_finite_or_none() {
    let to = |n: usize, f: &dyn Fn(f64) -> f64| (0..n).map(|k| f(k as f64)).collect::<Vec<f64>>();
    let odd: [(&str, Vec<f64>); 10] = [
        ("triangles", to(32, &|k| (k % 8.0 - 4.0).abs())),
        ("one value", to(16, &|_| 3.0)),
        ("two values", to(16, &|k| k % 2.0)),
        ("falling below zero", to(16, &|k| -k)),
        ("huge", to(16, &|k| 1e300 * k)),
        (
            "beyond what can be written",
            to(16, &|k| 1.7e308 * (k % 3.0 - 1.0)),
        ),
        ("tiny", to(16, &|k| 1e-300 * k)),
        ("subnormal", to(16, &|k| 5e-324 * k)),
        ("one far away", to(16, &|k| if k == 7.0 { 1e12 } else { k })),
        (
            "not a number",
            to(16, &|k| if k == 5.0 { f64::NAN } else { k }),
        ),
    ];
    for (name, stimuli) in odd {
        for declared in [
            Declared::Polynomial(0),
            Declared::Polynomial(1),
            Declared::Polynomial(2),
            Declared::Axis,
        ] {
            let [made, tried] = designs(
                &scalar(&stimuli, declared),
                &format!("{name}, {declared:?}"),
            );
            // Control: ordinary stimuli have designs.
            assert!(name != "triangles" || made > tried / 3, "{made} of {tried}");
        }
    }
    for folder in ["recorded/drift", "whiskerfbg"] {
        let mut data = data(folder);
        data.rows = data
            .rows
            .iter()
            .step_by(1 + data.rows.len() / 60)
            .cloned()
            .collect();
        let system = WhiskerSystem::new(&data, &[]).unwrap();
        let [made, tried] = designs(&system, folder);
        assert!(made > tried / 3, "{folder}: {made} of {tried}");
    }
}
