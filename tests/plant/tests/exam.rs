//! The scorer: marks, held-out errors, bounds, and the whole run with a stand-in program.
#![allow(clippy::unwrap_used, reason = "a test may panic")]

use serde_json::{Value, json};
use wcal_plant::exam::{Examiner, Mark, clopper_pearson, score, summarise};
use wcal_plant::{Case, Design, Kind, Make, Noise, Order, Request, Want, draw};

fn case(want: Want) -> Case {
    draw(&Request { seed: 21, design: Design::Paper, want, target_sigma: 12.0, rivals: false }).unwrap()
}

fn mark(case: &Case, verdict: &str, effects: Value, alternatives: Value) -> Mark {
    let document = json!({"verdict": verdict, "effects": effects, "alternatives": alternatives});
    score("case-001", case, &document, "", 0.0, Some(0)).kind
}

#[test]
fn marks_follow_the_practice_scorer() {
    let null = case(Want::Null);
    assert_eq!(mark(&null, "adequate", json!([]), json!([])), Mark::Right);
    assert_eq!(mark(&null, "effect", json!([{"id": "creep"}]), json!([])), Mark::False);
    assert_eq!(mark(&null, "unknown-effect", json!([]), json!([])), Mark::False);

    let single = case(Want::Effects(vec![Kind::DriftLinear]));
    let drift = json!([{"id": "zero-drift", "class": ["zero-drift"]}]);
    let in_class = json!([{"id": "creep", "class": ["creep", "zero-drift"]}]);
    assert_eq!(mark(&single, "effect", drift.clone(), json!([])), Mark::Right);
    assert_eq!(mark(&single, "effect", in_class, json!([])), Mark::Right);
    assert_eq!(
        mark(&single, "effect", json!([{"id": "zero-drift"}, {"id": "creep"}]), json!([])),
        Mark::Part
    );
    assert_eq!(mark(&single, "effect", json!([{"id": "creep"}]), json!([])), Mark::Wrong);
    assert_eq!(mark(&single, "ambiguous", json!([]), json!([["creep"], ["zero-drift"]])), Mark::AmbiguousIn);
    assert_eq!(mark(&single, "ambiguous", json!([]), json!([["creep"], ["dead-zone"]])), Mark::Wrong);
    assert_eq!(mark(&single, "adequate", json!([]), json!([])), Mark::Missed);
    assert_eq!(mark(&single, "unknown-effect", json!([]), json!([])), Mark::Unknown);
    assert_eq!(mark(&single, "refused", json!([]), json!([])), Mark::Refused);

    let unknown = case(Want::Effects(vec![Kind::UnknownStepTime]));
    assert_eq!(mark(&unknown, "unknown-effect", json!([]), json!([])), Mark::Right);
    assert_eq!(mark(&unknown, "effect", drift, json!([])), Mark::Wrong);
    let document = json!({"verdict": "unknown-effect", "unknown": {"driver": "t_s"}});
    assert_eq!(score("c", &unknown, &document, "", 0.0, None).driver_right, Some(true));
    let document = json!({"verdict": "unknown-effect", "unknown": {"driver": "direction"}});
    assert_eq!(score("c", &unknown, &document, "", 0.0, None).driver_right, Some(false));
}

#[test]
fn held_out_errors_are_those_put_in() {
    let case = case(Want::Null);
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
    let o = score("c", &case, &document, &predictions(0.01, 0.006, 0), 0.0, Some(0));
    let k = case.truth.k;
    let floor = case.truth.new_pose_noise_pm / (k[0][0] * k[1][1] - k[0][1] * k[1][0]).abs().sqrt();
    assert!((o.after_ratio.unwrap() * floor - 0.01).abs() < 1e-9);
    assert!((o.before_ratio.unwrap() * floor - 0.02).abs() < 1e-9);
    assert_eq!(o.covered, Some((84, 84)));
    assert_eq!(score("c", &case, &document, &predictions(0.01, 0.005, 0), 0.0, None).covered, Some((0, 84)));
    // A table that lacks a row, or is none at all, gives no ratio.
    assert_eq!(score("c", &case, &document, &predictions(0.01, 0.006, 3), 0.0, None).after_ratio, None);
    assert_eq!(score("c", &case, &document, "no,table\nhere,1\n", 0.0, None).after_ratio, None);
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
    // Says "adequate" to every session but the second, of which it leaves nothing, and is slow on the third.
    std::fs::write(
        &program,
        "#!/bin/sh\nmkdir -p \"$4\"\ncase \"$2\" in *case-002) exit 1;; *case-003) exec sleep 30;; esac\n\
         echo '{\"verdict\":\"adequate\",\"effects\":[],\"alternatives\":[]}' > \"$4/verify.json\"\n",
    )
    .unwrap();
    std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
    let examiner =
        Examiner { program, folder: folder.path().join("exam"), jobs: 2, timeout_s: 2.0, follow_up: false };
    let orders: Vec<Order> = [Want::Null, Want::Null, Want::Null, Want::Effects(vec![Kind::DriftLinear])]
        .into_iter()
        .enumerate()
        .map(|(i, want)| {
            let seed = i as u64;
            let request = Request { seed, design: Design::Paper, want, target_sigma: 12.0, rivals: false };
            Order::Whisker(request, Noise::Gaussian, Make::Usual)
        })
        .collect();
    let outcomes: Vec<_> = examiner.examine(&orders, &|_| {}).into_iter().map(Result::unwrap).collect();
    let marks: Vec<Mark> = outcomes.iter().map(|o| o.kind).collect();
    assert_eq!(marks, [Mark::Right, Mark::Crash, Mark::Crash, Mark::Missed]);
    assert!(outcomes[1].why.contains("verify.json") && outcomes[2].why.contains("no answer"));
    let table = summarise(&outcomes);
    let line = |name: &str| table.iter().find(|g| g.score == name).unwrap();
    assert_eq!(line("crashes").counts, (2, 4));
    assert_eq!(line("crashes").met, Some(false));
    // Three nulls cannot show a rate below 5 %.
    assert_eq!(line("false attribution on nulls").met, Some(false));
}
