//! The scorer: marks, held-out errors, bounds, and the whole run with a stand-in program.

use serde_json::{Value, json};
use wcal_exam::{
    Examiner, Goal, Mark, Order, Outcome, by_noise, clopper_pearson, score, score_scalar, summarise,
};
use wcal_plant::scalar;
use wcal_plant::{
    Case, CaseKind, Design, EffectSize, Kind, Make, Noise, Request, ScalarEffect, ScalarNoise,
    ScalarRequest, draw, draw_under,
};

fn case(want: CaseKind) -> Case {
    draw(&Request {
        seed: 21,
        design: Design::Paper,
        want,
        target_sigma: 12.0,
        rivals: false,
    })
    .unwrap()
}

fn mark(case: &Case, verdict: &str, effects: Value, alternatives: Value) -> Mark {
    let document = json!({"verdict": verdict, "effects": effects, "alternatives": alternatives});
    score("case-001", case, &document, "", 0.0, Some(0)).kind
}

#[test]
fn marks_follow_the_practice_scorer() {
    let null = case(CaseKind::Null);
    assert_eq!(mark(&null, "adequate", json!([]), json!([])), Mark::Right);
    assert_eq!(
        mark(&null, "effect", json!([{"id": "creep"}]), json!([])),
        Mark::False
    );
    assert_eq!(
        mark(&null, "unknown-effect", json!([]), json!([])),
        Mark::False
    );

    let single = case(CaseKind::Effects(vec![Kind::DriftLinear]));
    let drift = json!([{"id": "zero-drift", "class": ["zero-drift"]}]);
    let in_class = json!([{"id": "creep", "class": ["creep", "zero-drift"]}]);
    assert_eq!(
        mark(&single, "effect", drift.clone(), json!([])),
        Mark::Right
    );
    assert_eq!(mark(&single, "effect", in_class, json!([])), Mark::Right);
    assert_eq!(
        mark(
            &single,
            "effect",
            json!([{"id": "zero-drift"}, {"id": "creep"}]),
            json!([])
        ),
        Mark::Part
    );
    assert_eq!(
        mark(&single, "effect", json!([{"id": "creep"}]), json!([])),
        Mark::Wrong
    );
    assert_eq!(
        mark(
            &single,
            "ambiguous",
            json!([]),
            json!([["creep"], ["zero-drift"]])
        ),
        Mark::AmbiguousIn
    );
    assert_eq!(
        mark(
            &single,
            "ambiguous",
            json!([]),
            json!([["creep"], ["dead-zone"]])
        ),
        Mark::Wrong
    );
    assert_eq!(
        mark(&single, "adequate", json!([]), json!([])),
        Mark::Missed
    );
    assert_eq!(
        mark(&single, "unknown-effect", json!([]), json!([])),
        Mark::Unknown
    );
    assert_eq!(
        mark(&single, "refused", json!([]), json!([])),
        Mark::Refused
    );

    let unknown = case(CaseKind::Effects(vec![Kind::UnknownStepTime]));
    assert_eq!(
        mark(&unknown, "unknown-effect", json!([]), json!([])),
        Mark::Right
    );
    assert_eq!(mark(&unknown, "effect", drift, json!([])), Mark::Wrong);
    let document = json!({"verdict": "unknown-effect", "unknown": {"driver": "t_s"}});
    assert_eq!(
        score("c", &unknown, &document, "", 0.0, None).driver_right,
        Some(true)
    );
    let document = json!({"verdict": "unknown-effect", "unknown": {"driver": "direction"}});
    assert_eq!(
        score("c", &unknown, &document, "", 0.0, None).driver_right,
        Some(false)
    );
}

#[test]
fn held_out_errors_are_those_put_in() {
    let case = case(CaseKind::Null);
    let predictions = |off: f64, sd: f64, drop: usize| {
        let mut text = String::from(
            "source,point,role,moment_1_nmm_before,moment_2_nmm_before,moment_1_nmm_after,moment_2_nmm_after,moment_1_sd_nmm,moment_2_sd_nmm\n",
        );
        let rows = case.readings.iter().filter(|r| r.planned.holdout);
        for (r, m) in rows.zip(&case.truth.holdout_moments_nmm).skip(drop) {
            text += &format!(
                "holdout.csv,{},{},{},{},{},{},{sd},{sd}\n",
                r.point,
                r.planned.role,
                m[0] + 2.0 * off,
                m[1] + 2.0 * off,
                m[0] + off,
                m[1] - off
            );
        }
        text
    };
    let document = json!({"verdict": "adequate"});
    let o = score(
        "c",
        &case,
        &document,
        &predictions(0.01, 0.006, 0),
        0.0,
        Some(0),
    );
    let k = case.truth.k;
    let floor = case.truth.new_pose_noise_pm / (k[0][0] * k[1][1] - k[0][1] * k[1][0]).abs().sqrt();
    assert!((o.after_ratio.unwrap() * floor - 0.01).abs() < 1e-9);
    assert!((o.before_ratio.unwrap() * floor - 0.02).abs() < 1e-9);
    assert_eq!(o.covered, Some((84, 84)));
    assert_eq!(
        score(
            "c",
            &case,
            &document,
            &predictions(0.01, 0.005, 0),
            0.0,
            None
        )
        .covered,
        Some((0, 84))
    );
    // A table that lacks a row, or is none at all, gives no ratio.
    assert_eq!(
        score(
            "c",
            &case,
            &document,
            &predictions(0.01, 0.006, 3),
            0.0,
            None
        )
        .after_ratio,
        None
    );
    assert_eq!(
        score("c", &case, &document, "no,table\nhere,1\n", 0.0, None).after_ratio,
        None
    );
}

#[test]
fn exact_bounds_of_shares() {
    // Rule of three, and Clopper and Pearson's table for 5 of 10.
    let (low, high) = clopper_pearson(0, 300);
    assert!(low == 0.0 && (high - 0.01222).abs() < 1e-4, "{high}");
    let (low, high) = clopper_pearson(5, 10);
    assert!((low - 0.1871).abs() < 1e-4 && (high - 0.8129).abs() < 1e-4);
    assert_eq!(clopper_pearson(4, 4).1, 1.0);
}

#[cfg(unix)]
#[test]
fn exam_runs_a_program_and_sums_up() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("stand-in");
    // Says "adequate" to every session but the second, of which it leaves nothing, and is slow on
    // the third.
    std::fs::write(
        &program,
        "#!/bin/sh\nmkdir -p \"$4\"\ncase \"$2\" in *case-002) exit 1;; *case-003) exec sleep 30;; esac\n\
         echo '{\"verdict\":\"adequate\",\"effects\":[],\"alternatives\":[]}' > \"$4/verify.json\"\n",
    )
    .unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let examiner = Examiner {
        program,
        folder: folder.path().join("exam"),
        jobs: 2,
        timeout_s: 2.0,
        follow_up: false,
    };
    let orders: Vec<Order> = [
        CaseKind::Null,
        CaseKind::Null,
        CaseKind::Null,
        CaseKind::Effects(vec![Kind::DriftLinear]),
    ]
    .into_iter()
    .enumerate()
    .map(|(i, want)| {
        let seed = i as u64;
        let request = Request {
            seed,
            design: Design::Paper,
            want,
            target_sigma: 12.0,
            rivals: false,
        };
        Order::Whisker(request, Noise::Gaussian, Make::Usual)
    })
    .collect();
    let outcomes: Vec<_> = examiner
        .examine(&orders, &|_| {})
        .into_iter()
        .map(Result::unwrap)
        .collect();
    let marks: Vec<Mark> = outcomes.iter().map(|o| o.kind).collect();
    assert_eq!(marks, [Mark::Right, Mark::Crash, Mark::Crash, Mark::Missed]);
    assert!(outcomes[1].why.contains("verify.json") && outcomes[2].why.contains("no answer"));
    let table = summarise(&outcomes);
    let line = |name: &str| table.iter().find(|g| g.score == name).unwrap();
    assert_eq!(line("crashes").counts, (2, 4));
    assert_eq!(line("crashes").met, Some(false));
    // Three nulls cannot show a rate below 5 %, nor one right answer of one a rate above 93 %.
    let open = line("false attribution on nulls");
    assert!(open.met.is_none() && open.open(), "{open:?}");
}

#[test]
fn a_goal_is_met_by_its_bound_and_not_by_one_of_one() {
    let case = draw_under(
        &Request {
            seed: 1,
            design: Design::Rich,
            want: CaseKind::Null,
            target_sigma: 12.0,
            rivals: false,
        },
        Noise::Gaussian,
        Make::Usual,
    )
    .unwrap();
    let adequate = serde_json::json!({"verdict": "adequate", "effects": [], "alternatives": []});
    let right = score("null", &case, &adequate, "", 1.0, None);
    assert_eq!(right.kind, Mark::Right);
    let named = |hits: usize, of: usize| -> Goal {
        let kind = |k: usize| if k < hits { Mark::False } else { Mark::Right };
        let outcomes: Vec<_> = (0..of)
            .map(|k| Outcome {
                kind: kind(k),
                ..right.clone()
            })
            .collect();
        summarise(&outcomes)
            .into_iter()
            .find(|g| g.score == "false attribution on nulls")
            .unwrap()
    };
    for (hits, of, met) in [
        (0, 1, None),
        (0, 40, None),
        (0, 100, Some(true)),
        (2, 100, None),
        (50, 100, Some(false)),
    ] {
        let goal = named(hits, of);
        assert_eq!(
            (goal.met, goal.open()),
            (met, met.is_none()),
            "{hits} of {of}: {goal:?}"
        );
    }
    // Quantiles are bounded by order statistics: a few values bound none.
    let ratios = |ratio: f64, of: usize| -> Goal {
        let outcomes: Vec<_> = (0..of)
            .map(|_| Outcome {
                after_ratio: Some(ratio),
                ..right.clone()
            })
            .collect();
        summarise(&outcomes)
            .into_iter()
            .find(|g| g.score == "held-out error after / floor, 95th percentile")
            .unwrap()
    };
    assert_eq!((ratios(1.0, 1).met, ratios(1.0, 20).met), (None, None));
    assert_eq!(
        (ratios(1.0, 200).met, ratios(1.5, 200).met),
        (Some(true), Some(false))
    );
}

#[test]
fn answers_on_noise_are_scored_by_what_was_put_in() {
    let noisy = |noise: Noise, seed: u64| {
        let design = if noise == Noise::Pose {
            Design::Repeats
        } else {
            Design::Paper
        };
        let request = Request {
            seed,
            design,
            want: CaseKind::Null,
            target_sigma: 12.0,
            rivals: false,
        };
        draw_under(&request, noise, Make::Usual).unwrap()
    };
    let judge = |case: &Case, document: Value| score("c", case, &document, "", 0.0, Some(0));
    // A gross reading: marked alone, by the list or by the note, or named as an outlier; not
    // missed, not with others.
    let gross = (0..)
        .map(|s| noisy(Noise::OneGross, s))
        .find(|c| c.truth.flagged[0].source == "points.csv");
    let gross = gross.unwrap();
    let point = gross.truth.flagged[0].point;
    let list = json!([{"source": "points.csv", "point": point}]);
    let note = json!([format!(
        "Readings marked and left out of the fit (kept in the table): points {point}."
    )]);
    let outliers = json!([{"id": "slip-outliers", "class": ["slip-outliers"]}]);
    for (document, kind, flags) in [
        (
            json!({"verdict": "adequate", "flagged": list}),
            Mark::Right,
            true,
        ),
        (
            json!({"verdict": "adequate", "notes": note}),
            Mark::Right,
            true,
        ),
        (
            json!({"verdict": "effect", "effects": outliers, "flagged": list}),
            Mark::Right,
            true,
        ),
        (json!({"verdict": "adequate"}), Mark::Missed, false),
        (
            json!({"verdict": "effect", "effects": [{"id": "creep"}], "flagged": list}),
            Mark::False,
            true,
        ),
        (
            json!({"verdict": "adequate", "flagged": [list[0], {"source": "points.csv", "point": point + 1}]}),
            Mark::Right,
            false,
        ),
        (
            json!({"verdict": "adequate", "flagged": [{"source": "holdout.csv", "point": point}]}),
            Mark::Right,
            false,
        ),
    ] {
        let o = judge(&gross, document.clone());
        assert_eq!((o.kind, o.flags_right), (kind, Some(flags)), "{document}");
    }
    let plain = noisy(Noise::Gaussian, 3);
    assert_eq!(
        judge(&plain, json!({"verdict": "effect", "effects": outliers})).kind,
        Mark::False
    );
    assert_eq!(
        judge(&plain, json!({"verdict": "adequate", "flagged": list})).flags_right,
        Some(false)
    );

    // Parts and floor: as objects with intervals, bare, or not stated.
    let pose = noisy(Noise::Pose, 4);
    let t = &pose.truth;
    let said = |factor: f64| {
        let value = factor * t.noise.pose_pm;
        json!({"verdict": "adequate", "noise_floor": {"wavelength_pm": t.new_pose_noise_pm}, "noise": {
            "repeat": t.repeat_noise_pm, "pose": {"value": value, "interval95": [0.9 * value, 1.1 * value]}, "correlated": null}})
    };
    for (factor, near, inside) in [
        (1.05, true, true),
        (1.25, true, false),
        (1.4, false, false),
        (0.7, false, false),
    ] {
        let o = judge(&pose, said(factor));
        let part = o.parts.iter().find(|p| p.name == "pose").unwrap();
        assert_eq!(
            (part.within(1.3), part.inside),
            (near, Some(inside)),
            "{factor}"
        );
        assert!(
            o.parts
                .iter()
                .any(|p| p.name == "repeat" && p.within(1.001) && p.inside.is_none())
        );
        assert!((o.floor_ratio.unwrap() - 1.0).abs() < 1e-9);
    }
    assert!((t.new_pose_noise_pm / t.noise.pose_pm.hypot(t.noise.repeat_pm) - 1.0).abs() < 0.01);
    let silent = judge(&pose, json!({"verdict": "unknown-effect"}));
    assert!(silent.floor_ratio.is_none() && silent.parts.iter().all(|p| !p.within(1.3)));

    let rows = by_noise(&[
        judge(&pose, said(1.0)),
        judge(&pose, said(2.0)),
        silent,
        judge(&plain, outliers_named()),
    ]);
    let row = |name: &str| rows.iter().find(|r| r.noise == name).unwrap();
    assert_eq!(row("pose").adequate, (2, 3));
    assert_eq!(
        (row("pose").unknown, row("pose").false_names),
        ((1, 3), (0, 3))
    );
    let (_, near, inside) = row("pose").parts.iter().find(|p| p.0 == "pose").unwrap();
    assert_eq!((*near, *inside), ((1, 3), (1, 2)));
    assert_eq!(row("gaussian").false_names, (1, 1));
    // What is named beside "unknown effect" is named.
    let beside = json!({"verdict": "unknown-effect", "effects": [{"id": "creep"}]});
    let row = &by_noise(&[judge(&plain, beside)])[0];
    assert_eq!((row.false_names, row.unknown), ((1, 1), (1, 1)));
}

fn outliers_named() -> Value {
    json!({"verdict": "effect", "effects": [{"id": "slip-outliers"}]})
}

#[test]
fn held_out_scores_leave_gross_readings_out() {
    let request = |seed| Request {
        seed,
        design: Design::Paper,
        want: CaseKind::Null,
        target_sigma: 12.0,
        rivals: false,
    };
    let held_out = |c: &Case| {
        let off = &c.truth.flagged[0];
        c.readings.iter().any(|r| {
            off.source == "holdout.csv"
                && r.planned.role == "holdout"
                && r.planned.holdout
                && r.point == off.point
        })
    };
    let mut draws = (0..).map(|s| draw_under(&request(s), Noise::OneGross, Make::Usual).unwrap());
    let case = draws.find(held_out).unwrap();
    let mut text = String::from(
        "source,point,role,moment_1_nmm_before,moment_2_nmm_before,moment_1_nmm_after,moment_2_nmm_after,moment_1_sd_nmm,moment_2_sd_nmm\n",
    );
    for (r, m) in case
        .readings
        .iter()
        .filter(|r| r.planned.holdout)
        .zip(&case.truth.holdout_moments_nmm)
    {
        let off = if r.point == case.truth.flagged[0].point {
            9.0
        } else {
            0.0
        };
        let [a, b] = [m[0] + off, m[1]];
        text += &format!(
            "holdout.csv,{},{},{a},{b},{a},{b},0.01,0.01\n",
            r.point, r.planned.role
        );
    }
    let o = score(
        "c",
        &case,
        &json!({"verdict": "adequate"}),
        &text,
        0.0,
        Some(0),
    );
    assert_eq!(o.covered, Some((82, 82)));
    assert!(o.after_ratio.unwrap() < 1e-6);
}

#[test]
fn answers_on_lines_are_scored() {
    let draw = |effect| {
        let noise = ScalarNoise::Correlated;
        scalar::draw(&ScalarRequest {
            seed: 2,
            axis: false,
            noise,
            effect,
            size: EffectSize::Noises(12.0),
            layout: None,
            noise_seed: None,
        })
    };
    let (null, drift) = (draw(None), draw(Some(ScalarEffect::Drift)));
    let mark = |case, document: Value| score_scalar("c", case, &document, "", 0.0, Some(0)).kind;
    assert_eq!(mark(&null, json!({"verdict": "adequate"})), Mark::Right);
    let periodic = json!({"verdict": "effect", "effects": [{"id": "periodic"}]});
    assert_eq!(mark(&null, periodic.clone()), Mark::False);
    assert_eq!(mark(&drift, periodic), Mark::Wrong);
    assert_eq!(
        mark(
            &drift,
            json!({"verdict": "effect", "effects": [{"id": "drift"}]})
        ),
        Mark::Right
    );
    let both = json!({"verdict": "effect", "effects": [{"id": "drift"}, {"id": "periodic"}]});
    assert_eq!(mark(&drift, both), Mark::Part);
    assert_eq!(
        mark(
            &drift,
            json!({"verdict": "ambiguous", "alternatives": [["step"], ["drift"]]})
        ),
        Mark::AmbiguousIn
    );
    assert_eq!(mark(&drift, json!({"verdict": "adequate"})), Mark::Missed);
    let sd = null.truth.noise_sd;
    let stated = json!({"verdict": "adequate", "noise_floor": {"response": sd}, "noise": {"correlated": {"sd": {"value": sd}}}});
    let o = score_scalar("c", &null, &stated, "", 0.0, None);
    assert_eq!(o.floor_ratio, Some(1.0));
    assert!(
        o.parts
            .iter()
            .any(|p| p.name == "correlated.sd" && p.within(1.01))
    );
    // Held-out readings inside the stated deviations.
    let with_holdout = (0..).map(|seed| {
        let noise = ScalarNoise::White;
        scalar::draw(&ScalarRequest {
            seed,
            axis: true,
            noise,
            effect: None,
            size: EffectSize::Noises(12.0),
            layout: None,
            noise_seed: None,
        })
    });
    let case = with_holdout
        .into_iter()
        .find(|c| c.readings.iter().any(|r| r.holdout))
        .unwrap();
    let table = |off: f64| {
        let rows = case.readings.iter().filter(|r| r.holdout);
        let lines: Vec<String> = rows
            .map(|r| {
                format!(
                    "holdout.csv,{},holdout,{},0,{},1.0,",
                    r.point,
                    r.y,
                    r.y + off
                )
            })
            .collect();
        format!(
            "source,point,role,error_um_measured,error_um_before,error_um_after,error_um_sd,rejected\n{}\n",
            lines.join("\n")
        )
    };
    let n = case.readings.iter().filter(|r| r.holdout).count();
    let covered = |off| {
        score_scalar(
            "c",
            &case,
            &json!({"verdict": "adequate"}),
            &table(off),
            0.0,
            None,
        )
        .covered
    };
    assert_eq!((covered(1.9), covered(2.0)), (Some((n, n)), Some((0, n))));
}
