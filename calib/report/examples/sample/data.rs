//! Invented sessions; every one is labelled as a simulated sample.

use std::collections::BTreeMap;

use wcal_core::data_sheet::{Characteristic, DataSheet, UncertaintyBudget, UncertaintySource};
use wcal_core::verify_document::*;
use wcal_core::{InputFile, Provenance, ResidualRecord};
use wcal_report::*;

#[path = "whisker.rs"]
mod whisker;

pub(crate) use whisker::whisker;

const SAMPLE: &str = "SIMULATED SAMPLE, all numbers invented to show the page";

/// All samples.
pub(crate) fn all() -> Vec<ReportInput> {
    vec![whisker(), transducer(), axis()]
}

/// Repeatable bell-shaped numbers with unit spread.
pub(crate) struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn draw(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A load cell whose curvature was missing.
pub(crate) fn transducer() -> ReportInput {
    let mut verify = document("sample-transducer", "transducer", Verdict::Effect);
    verify.reason = "The response curves: a quadratic term was missing, and nothing is left once it is added (nested leave-one-out).".into();
    verify.effects = vec![NamedEffect {
        id: "nonlinearity-quadratic".into(),
        laws: vec!["power-2".into()],
        class: vec!["nonlinearity-quadratic".into()],
        p_value: 1e-9,
        parameters: vec![parameter("b2", -3.16e-15, "1/kN^2", [-3.26e-15, -3.06e-15])],
        sentence: "The response falls below a straight line by a part in a thousand at full load."
            .into(),
    }];
    verify.alternatives = vec![vec!["nonlinearity-quadratic".into()]];
    verify.noise_floor = NoiseFloor {
        response: Some(2.15e-4),
        source: "replicates".into(),
        ..NoiseFloor::default()
    };
    let error = |value: f64| HeldOutError {
        split: "loo".into(),
        rmse: BTreeMap::from([("response_rmse".into(), value)]),
        interval95: BTreeMap::from([("response_rmse".into(), [0.82 * value, 1.22 * value])]),
        points: 40,
        ..HeldOutError::default()
    };
    verify.before = Some(error(2.21e-3));
    verify.after = Some(error(2.12e-4));
    let mut noise = Noise(3);
    let mut input = ReportInput::new(verify, provenance("sample-transducer"));
    input.simulated_by = Some(SAMPLE.into());
    input.residuals = (0..40)
        .map(|k| {
            let load = 150.0 * f64::from(k % 20 + 1);
            let (line, curve) = (7.3e-4 * load, -3.2e-9 * (load - 400.0) * (load - 2700.0));
            ResidualRecord {
                source: "points.csv".into(),
                line: k as usize + 2,
                point: i64::from(k) + 1,
                role: "calibration".into(),
                group: 0,
                channel: "response".into(),
                unit: "mV/V".into(),
                measured: line + curve + 2.1e-4 * noise.draw(),
                predicted_before: line,
                predicted_after: line + curve,
                noise_sd: 2.15e-4,
                rejected: None,
                covariates: vec![
                    ("stimulus".into(), load),
                    ("replicate".into(), f64::from(k / 20 + 1)),
                ],
            }
        })
        .collect();
    input.verify.data_sheet = Some(data_sheet());
    input
}

/// What is written down of an axis.
fn data_sheet() -> DataSheet {
    DataSheet {
        equation:
            "error y(x) = 0.2 + backlash(reversal: reversal_value = 3.2 um); x in mm, y in um"
                .into(),
        characteristics: vec![Characteristic {
            name: "reversal".into(),
            value: 3.2,
            half95: Some(0.4),
            unit: "um".into(),
            meaning: "largest difference of both directions (ISO 230-2, B)".into(),
        }],
        uncertainty: Some(UncertaintyBudget {
            of: "corrected position".into(),
            expanded: 1.9,
            k: 1.98,
            unit: "um".into(),
            at: 100.0,
            sources: vec![UncertaintySource {
                source: "noise of one reading".into(),
                standard: 0.96,
                is_bound: false,
            }],
        }),
        range: [0.0, 100.0],
        range_unit: "mm".into(),
        conditions: vec!["at 20 degC".into()],
    }
}

/// Pneumatic strokes with something periodic in temperature that nothing explains; many readings,
/// no noise floor.
pub(crate) fn axis() -> ReportInput {
    let mut verify = document("sample-axis", "axis", Verdict::UnknownEffect);
    verify.reason =
        "Something that follows the temperature is left, and nothing in the catalogue explains it."
            .into();
    verify.unknown = Some(UnknownEffect {
        driver: "temperature_degc".into(),
        shape: "sinusoid".into(),
        drivers_ranked: vec!["temperature_degc".into(), "t_s".into(), "order".into()],
        period: Some(0.83),
    });
    verify.noise_floor = NoiseFloor {
        source: "none".into(),
        ..NoiseFloor::default()
    };
    let error = HeldOutError {
        split: "loto".into(),
        rmse: BTreeMap::from([("error_rmse_um".into(), 14.2)]),
        points: 6000,
        ..HeldOutError::default()
    };
    verify.before = Some(error.clone());
    verify.after = Some(error);
    let mut noise = Noise(5);
    let mut input = ReportInput::new(verify, provenance("sample-axis"));
    input.simulated_by = Some(SAMPLE.into());
    input.residuals = (0..6000)
        .map(|k| {
            let t = f64::from(k);
            let (commanded, degc) = (50.0 + 40.0 * (t / 90.0).sin(), 21.0 + t / 2500.0);
            ResidualRecord {
                source: "points.csv".into(),
                line: k as usize + 2,
                point: i64::from(k) + 1,
                role: "verification".into(),
                group: 1 + k as u32 / 600,
                channel: "error".into(),
                unit: "um".into(),
                measured: 20.0 * (degc * 7.57).sin() + 3.0 * noise.draw(),
                predicted_before: 0.0,
                predicted_after: 0.0,
                noise_sd: 3.0,
                rejected: None,
                covariates: vec![
                    ("commanded_mm".into(), commanded),
                    ("direction".into(), (t / 90.0).cos().signum()),
                    ("t_s".into(), t),
                    ("temperature_degc".into(), degc),
                ],
            }
        })
        .collect();
    input
}

/// A document in which nothing was found.
pub(crate) fn document(session: &str, kind: &str, verdict: Verdict) -> VerifyDocument {
    VerifyDocument {
        format: VERIFY_FORMAT.into(),
        session: session.into(),
        simulated: true,
        kind: kind.into(),
        verdict,
        reason: String::new(),
        twin: TwinCheck::default(),
        effects: vec![],
        alternatives: vec![],
        unknown: None,
        noise_floor: NoiseFloor::default(),
        noise: None,
        flagged: Vec::new(),
        before: None,
        after: None,
        after_trimmed: None,
        coverage95: None,
        next_measurement: None,
        detectable: vec![],
        seed: 1,
        inputs: vec![],
        cautions: vec![],
        notes: vec![],
        leave_one_effect_out: vec![],
        calibration: None,
        contact: None,
        groove_tracking: None,
        data_sheet: None,
        holdout: HoldoutJudgement::default(),
        tests: Vec::new(),
    }
}

fn whisker_error(pm: f64, pm95: [f64; 2], nmm: f64, nmm95: [f64; 2]) -> HeldOutError {
    let pair = |a, b| {
        (
            "wavelength_rmse_pm".to_owned(),
            a,
            "moment_rmse_nmm".to_owned(),
            b,
        )
    };
    let (pm_key, pm, nmm_key, nmm_value) = pair(pm, nmm);
    HeldOutError {
        split: "holdout".into(),
        rmse: BTreeMap::from([(pm_key.clone(), pm), (nmm_key.clone(), nmm_value)]),
        moment_rmse_nmm_each: Some([1.13 * nmm, 0.85 * nmm]),
        interval95: BTreeMap::from([(pm_key, pm95), (nmm_key, nmm95)]),
        points: 48,
        expected: BTreeMap::new(),
    }
}

fn parameter(name: &str, value: f64, unit: &str, interval95: [f64; 2]) -> EffectParameter {
    EffectParameter {
        name: name.into(),
        value,
        unit: unit.into(),
        interval95,
    }
}

fn detectable(id: &str, smallest: Option<f64>, unit: &str, status: &str, why: &str) -> Detectable {
    let (id, unit, status, why) = (id.into(), unit.into(), status.into(), why.into());
    let (law, shape) = (None, Default::default());
    Detectable {
        id,
        smallest,
        law,
        shape,
        smallest_without_pictures: None,
        unit,
        status,
        why,
    }
}

fn provenance(session: &str) -> Provenance {
    let file = |path: &str| InputFile {
        purpose: wcal_core::Purpose::Description,
        path: format!("{session}/{path}"),
        sha256: wcal_core::provenance::sha256_hex(path.as_bytes()),
    };
    Provenance {
        program: "wcal 0.1.0".into(),
        command: ["wcal", "verify", session, "--out", "result"]
            .map(str::to_owned)
            .to_vec(),
        created: "2026-01-01T00:00:00Z".into(),
        seed: 1,
        inputs: ["session.toml", "points.csv", "holdout.csv", "twin.csv"]
            .map(file)
            .to_vec(),
        simulated: true,
    }
}
