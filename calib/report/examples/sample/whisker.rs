//! The invented whisker session.

use super::*;

/// A whisker session with friction in the groove, a rival that survives and two faulty labels.
pub(crate) fn whisker() -> ReportInput {
    let mut verify = document("sample-whisker", "whisker", Verdict::Ambiguous);
    verify.reason = "Friction in the groove explains what was left, but backlash of the stage explains it nearly as well; eight poses on the way back would decide (holdout rows sealed until the end).".into();
    verify.twin.faults = vec![
        TwinFault {
            points: vec![11, 12],
            kind: "branch".into(),
            detail: "The twin's labels lie on the branch after a snap that the rod has not reached at these poses.".into(),
        },
        TwinFault {
            points: vec![25],
            kind: "not-settled".into(),
            detail: "The label changes by 0.06 N mm when the twin is left to settle.".into(),
        },
    ];
    verify.effects = vec![NamedEffect {
        id: "groove-friction".into(),
        laws: vec!["coulomb".into()],
        class: vec!["groove-friction".into()],
        p_value: 0.0005,
        parameters: vec![
            parameter("friction_coefficient", 0.213, "1", [0.184, 0.242]),
            parameter("groove_half_angle_deg", 44.8, "deg", [41.2, 48.9]),
        ],
        sentence: "The wire sticks and slips in the groove: the contact force leans against the sliding by about a fifth of its normal part.".into(),
    }];
    verify.alternatives = vec![
        vec!["groove-friction".into()],
        vec!["stage-backlash".into(), "creep".into()],
    ];
    verify.noise_floor = NoiseFloor {
        wavelength_pm: Some(0.62),
        moment_nmm: Some(0.0081),
        source: "replicates".into(),
        ..NoiseFloor::default()
    };
    verify.before = Some(whisker_error(3.15, [2.81, 3.52], 0.0507, [0.041, 0.0588]));
    verify.after = Some(whisker_error(
        0.648,
        [0.581, 0.724],
        0.00893,
        [0.0074, 0.0102],
    ));
    verify.coverage95 = Some(0.938);
    let error = |rms_mm: f64| TrackError {
        rms_mm,
        interval95: Some([0.8 * rms_mm, 1.3 * rms_mm]),
    };
    let trajectory = |trajectory: u32| TrajectoryContact {
        trajectory,
        arclength_mm: 12.0 + 9.0 * f64::from(trajectory),
        before_mm: 0.5 * f64::from(trajectory),
        after_mm: 0.03 * f64::from(trajectory),
    };
    verify.contact = Some(ContactComparison {
        before: error(1.37),
        after: error(0.08),
        difference_mm: -1.29,
        difference_interval95: Some([-1.7, -0.9]),
        bound_mm: 0.07,
        readings: 640,
        not_located: 3,
        inside95: 611,
        groove_moved_mm: 0.0,
        trajectories: (1..=4).map(trajectory).collect(),
        sealed: None,
    });
    verify.next_measurement = Some(NextMeasurement {
        separates: vec!["groove-friction".into(), "stage-backlash".into()],
        instruction: "Drive trajectory 4 to 5 mm, come back in small steps and read each one settled; friction keeps a share of the moment that grows with depth, backlash a constant one.".into(),
        poses: (0..4)
            .map(|k| NextPose {
                trajectory: 4,
                stage_mm: 4.8 - 0.9 * f64::from(k),
                direction: -1.0,
                speed_mm_s: if k == 3 { 8.0 } else { 0.0 },
                dwell_s: 12.0,
            })
            .collect(),
        expected_power: 0.972,
    });
    verify.detectable = vec![
        detectable("groove-friction", Some(0.031), "1", "testable", ""),
        detectable("stage-backlash", Some(3.7), "um", "testable", ""),
        detectable(
            "stage-scale",
            None,
            "1",
            "absorbed",
            "K takes 99.6 % of its signature",
        ),
        detectable(
            "gravity",
            None,
            "N mm",
            "not-observable",
            "the session gives no gravity direction",
        ),
        detectable(
            "fluid-drag",
            None,
            "N mm",
            "not-observable",
            "the base does not move in a fluid",
        ),
    ];
    verify.notes = vec![
        "holdout.csv was opened once, after the model had been chosen".into(),
        "2 readings rejected as slips".into(),
    ];
    let mut input = ReportInput::new(verify, provenance("sample-whisker"));
    input.simulated_by = Some(SAMPLE.into());
    input.facts = vec![
        Fact::new("wire", "NiTi, 0.3 mm, 60 mm"),
        Fact::new("medium", "air"),
        Fact::new("trajectories", "9"),
        Fact::new("readings", "108 calibration and verification, 48 held out"),
        Fact::new("interrogator", "sm130, 2 kHz"),
    ];
    input.residuals = whisker_residuals();
    input.twin = (1..=9).map(twin).collect();
    input.further_errors = vec![(
        "black-box GP (rival)".into(),
        whisker_error(0.911, [0.80, 1.03], 0.0131, [0.0110, 0.0152]),
    )];
    tracing(&mut input);
    input
}

fn tracing(input: &mut ReportInput) {
    input.gate = vec![
        GateTest {
            name: "lack of fit F".into(),
            statistic: Some(24.7),
            p_value: Some(2e-6),
            detail: "48 and 36 degrees of freedom".into(),
        },
        GateTest {
            name: "runs along sweeps".into(),
            statistic: Some(-3.9),
            p_value: Some(0.0007),
            detail: String::new(),
        },
    ];
    let row = |effects: &[&str], law: &str, chi2_gain, log_likelihood_ratio, p_value| EvidenceRow {
        effects: effects.iter().map(|e| (*e).to_owned()).collect(),
        law: law.to_owned(),
        chi2_gain,
        degrees_of_freedom: effects.len(),
        log_likelihood_ratio,
        p_value,
        survives: p_value > 0.05,
    };
    input.evidence = vec![
        row(
            &["groove-friction"],
            "|F·t| ≤ µ N against sliding",
            812.0,
            0.0,
            1.0,
        ),
        row(
            &["stage-backlash", "creep"],
            "position lags by b after a reversal + m + a · relaxed(m, τ)",
            808.2,
            -1.9,
            0.17,
        ),
        row(
            &["stage-backlash"],
            "position lags by b after a reversal",
            804.4,
            -3.8,
            0.012,
        ),
        row(&["hysteresis"], "play operators", 789.6, -11.2, 0.0005),
        row(&[], "", 0.0, -406.0, 0.0005),
    ];
}

fn twin(id: u32) -> TwinTrajectory {
    let lean = f64::from(id) * 0.7;
    let moment = |s: f64| {
        [
            -0.21 * s * (1.0 + 0.06 * s) * lean.cos(),
            0.17 * s * (1.0 + 0.03 * s) * lean.sin(),
        ]
    };
    let stages: Vec<f64> = (0..=40).map(|k| 0.1 * f64::from(k)).collect();
    let labels = (0..3)
        .map(|k| {
            let point = i64::from(3 * (id - 1) + k + 1);
            let stage_mm = 4.0 / 3.0 * f64::from(k + 1);
            let factor = match point {
                11 | 12 => 0.55,
                25 => 1.25,
                _ => 1.002,
            };
            TwinMark {
                point,
                stage_mm,
                moment_nmm: moment(stage_mm).map(|m| factor * m),
            }
        })
        .collect();
    let moment_nmm = stages.iter().map(|s| moment(*s)).collect();
    TwinTrajectory {
        id,
        stage_mm: stages,
        moment_nmm,
        labels,
    }
}

fn whisker_residuals() -> Vec<ResidualRecord> {
    let mut noise = Noise(7);
    let mut out = Vec::new();
    for row in 0..156usize {
        let (trajectory, k) = (1 + row as u32 / 12 % 9, row % 12);
        let direction = if k < 6 { 1.0 } else { -1.0 };
        let stage = if k < 6 {
            0.7 * (k + 1) as f64
        } else {
            0.7 * (12 - k) as f64
        };
        let lean = f64::from(trajectory) * 0.7;
        let moment = [-0.21 * stage * lean.cos(), 0.17 * stage * lean.sin()];
        for (channel, m) in moment.iter().enumerate() {
            let truth = 78.0 * m + 9.0 * moment[1 - channel];
            let left = 4.4 * m * direction + 0.4;
            let slip = row == 40 || row == 101;
            out.push(ResidualRecord {
                source: if row < 108 {
                    "points.csv"
                } else {
                    "holdout.csv"
                }
                .into(),
                line: 2 + if row < 108 { row } else { row - 108 },
                point: row as i64 + 1,
                role: if row < 108 { "calibration" } else { "holdout" }.into(),
                group: trajectory,
                channel: format!("fbg_{}", channel + 1),
                unit: "pm".into(),
                measured: truth + left + 0.62 * noise.draw() + if slip { 31.0 } else { 0.0 },
                predicted_before: truth,
                predicted_after: truth + left,
                noise_sd: 0.62,
                rejected: slip.then(|| "slip: wire out of the groove's vertex".into()),
                covariates: [
                    ("stage_mm", stage),
                    ("direction", direction),
                    (
                        "speed_mm_s",
                        if row % 4 == 3 {
                            4.0 + (row % 3) as f64
                        } else {
                            0.0
                        },
                    ),
                    ("t_s", 31.0 * row as f64),
                    ("dwell_s", 12.0),
                    ("temperature_degc", 22.4 + 0.3 * (row as f64 / 40.0).sin()),
                    ("moment_1_nmm", moment[0]),
                    ("moment_2_nmm", moment[1]),
                    ("order", row as f64 + 1.0),
                    (
                        "contact_arclength_mm",
                        34.0 + 2.0 * lean.sin() - 0.4 * stage,
                    ),
                ]
                .map(|(name, value)| (name.to_owned(), value))
                .to_vec(),
            });
        }
    }
    out
}
