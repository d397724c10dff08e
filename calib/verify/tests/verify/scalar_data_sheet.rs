//! What is written down of an instrument: against what was put into it, and the GUM's example H.3.

use super::Noise;
use super::scalar_simulated::{run, transducer, triangles};
use wcal_core::data_sheet::{Characteristic, DataSheet, UncertaintySource};
use wcal_core::observation::{Role, TransducerData, TransducerModel, TransducerRow};
use wcal_core::verify_document::Verdict;

fn named<'a>(sheet: &'a DataSheet, name: &str) -> &'a Characteristic {
    let found = sheet.characteristics.iter().find(|c| c.name == name);
    found.unwrap_or_else(|| panic!("{name}: {:?}", sheet.characteristics))
}

#[test]
fn a_load_cell_has_the_characteristics_that_were_put_into_it() {
    let mut rng = Noise::new(4);
    let sweep = triangles(6, 20, &mut rng);
    let data = transducer(&sweep, TransducerModel::Linear, |r| {
        let looped = 0.02 * r.direction * (1.0 - (0.2 * r.x - 1.0).powi(2));
        0.1 + 0.2 * r.x + looped + 1e-3 * r.rise + 2e-3 * rng.next()
    });
    let v = run(&data, 4);
    assert_eq!(v.document.verdict, Verdict::Effect, "{}", v.document.reason);
    let sheet = v.model.as_ref().unwrap().data_sheet().unwrap();
    println!("{:#?}", sheet.lines());
    let within = |name: &str, truth: f64| {
        let c = named(&sheet, name);
        let half = c.half95.unwrap();
        assert!((c.value - truth).abs() < 1.5 * half, "{name}: {c:?}");
        assert!(half < 0.02 * truth.abs(), "{name}: {c:?}");
    };
    within("sensitivity", 0.2);
    within("zero", 0.1);
    // The full scale is 2 V: a loop of 0.04 V in the middle, and noise of 2 mV.
    let near = |name: &str, truth: f64, by: f64| {
        let value = named(&sheet, name).value;
        assert!((value / truth - 1.0).abs() < by, "{name}: {value}");
    };
    near("hysteresis", 2.0, 0.1);
    near("repeatability", 0.2, 0.2);
    near("temperature, zero", 0.05, 0.2);
    // Half the loop in the middle, a tenth of a newton, and twice the noise of a hundredth.
    let u = sheet.uncertainty.as_ref().unwrap();
    assert!((u.expanded - 0.12).abs() < 0.01, "{u:?}");
    // The budget adds up to what is stated.
    let squares = u.sources.iter().filter(|s| !s.is_bound);
    let root = squares.map(|s| s.standard.powi(2)).sum::<f64>().sqrt();
    let bounds: f64 = u
        .sources
        .iter()
        .filter(|s| s.is_bound)
        .map(|s| s.standard)
        .sum();
    let sum = u.k * root + bounds;
    assert!((sum / u.expanded - 1.0).abs() < 0.01, "{sum} {u:?}");
    // A reference that is uncertain by 0.02 N: its part stands beside noise and fit, not in them.
    let mut model = v.model.unwrap();
    model.reference_sd = 0.02;
    let stated = model.data_sheet().unwrap().uncertainty.unwrap();
    let wider = (u.k * root).hypot(u.k * 0.02) + bounds;
    assert!((wider / u.expanded - 1.0).abs() > 0.1, "control: {u:?}");
    assert!(
        (stated.expanded / wider - 1.0).abs() < 0.01,
        "{wider} {stated:?}"
    );
    let named = |s: &&UncertaintySource| s.source == "reference";
    assert_eq!(stated.sources.iter().find(named).unwrap().standard, 0.02);
    // Control: without its largest part it does not.
    assert!(((sum - bounds) / u.expanded - 1.0).abs() > 0.5, "{u:?}");
    assert!(sheet.equation.starts_with("y = 0.1"), "{}", sheet.equation);
}

/// JCGM 100:2008, H.3: eleven corrections of a thermometer.
const GUM_H3: [[f64; 2]; 11] = [
    [21.521, -0.171],
    [22.012, -0.169],
    [22.512, -0.166],
    [23.003, -0.159],
    [23.507, -0.164],
    [23.999, -0.165],
    [24.513, -0.156],
    [25.002, -0.157],
    [25.503, -0.159],
    [26.010, -0.161],
    [26.511, -0.160],
];

#[test]
fn the_thermometer_of_the_gum_has_its_line_and_uncertainties() {
    let row = |(k, [t, b]): (usize, &[f64; 2])| TransducerRow {
        stimulus_sd: None,
        source: "gum".into(),
        line: k + 2,
        point: k as i64,
        role: Role::Calibration,
        stimulus: *t,
        response: *b,
        t_s: None,
        temperature_degc: None,
        direction: None,
        replicate: None,
        covariates: Vec::new(),
    };
    let data = TransducerData {
        deviation: true,
        reference_sd: 0.0,
        stimulus_unit: "degC".into(),
        response_unit: "degC".into(),
        model: TransducerModel::Linear,
        covariates: Vec::new(),
        rows: GUM_H3.iter().enumerate().map(row).collect(),
    };
    let v = run(&data, 1);
    assert_eq!(
        v.document.verdict,
        Verdict::Adequate,
        "{}",
        v.document.reason
    );
    let model = v.model.unwrap();
    let sheet = model.data_sheet().unwrap();
    println!("{:#?}", sheet.lines());
    let slope = named(&sheet, "sensitivity");
    let k = sheet.uncertainty.as_ref().map_or(2.262, |u| u.k);
    // Student's t of 9 degrees of freedom.
    assert!((k - 2.262).abs() < 1e-3, "{k}");
    assert!((slope.value - 0.00218).abs() < 5e-6, "{slope:?}");
    assert!(
        (slope.half95.unwrap() / k - 0.00067).abs() < 5e-6,
        "{slope:?}"
    );
    // The correction at 20 and at 30 degC, and their standard uncertainties without the noise of a
    // further reading (0.0035).
    let at = |t: f64| {
        let mut rows = wcal_verify::scalar::Declared::Polynomial(1).rows(&data.rows);
        rows.truncate(1);
        rows[0].x = t;
        let p = model.predict(&rows).unwrap()[0];
        (p.value, ((p.half95 / k).powi(2) - model.variance).sqrt())
    };
    let ((b20, u20), (b30, u30)) = (at(20.0), at(30.0));
    assert!(
        (b20 + 0.1712).abs() < 5e-5 && (u20 - 0.0029).abs() < 5e-5,
        "{b20} {u20}"
    );
    assert!(
        (b30 + 0.1494).abs() < 1e-4 && (u30 - 0.0041).abs() < 5e-5,
        "{b30} {u30}"
    );
    assert!(
        (model.variance.sqrt() - 0.0035).abs() < 5e-5,
        "{}",
        model.variance
    );
}
