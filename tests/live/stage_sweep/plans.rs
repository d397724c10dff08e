//! What is said of a plan before anything moves.

use super::*;

fn dry_run(rig: &Path, plan: &Path, json: bool) -> Output {
    let mut command = program();
    command
        .arg("stage-sweep")
        .arg("--dry-run")
        .arg("--rig")
        .arg(rig)
        .arg("--plan")
        .arg(plan);
    command
        .args(json.then_some("--json"))
        .output()
        .expect("wcal runs")
}

#[test]
fn a_dry_run_says_what_the_plan_reads_and_checks_the_limits() {
    let (rig, plan) = (
        repository("rigs/paper"),
        repository("rigs/plans/paper-27.toml"),
    );
    let said = dry_run(&rig, &plan, false);
    assert_eq!(said.status.code(), Some(0), "{}", text(&said.stderr));
    let lines = text(&said.stdout);
    assert!(
        lines.starts_with("36 settled readings") && lines.contains("\ntime-lag "),
        "{lines}"
    );
    let listed = document(&dry_run(&rig, &plan, true));
    assert_eq!(
        (&listed["format"], &listed["readings"]),
        (&"wcal-path/1".into(), &36.into())
    );
    // Controls: a depth outside the limits, a file that is no plan, a file that is missing, and
    // usage.
    let folder = tempfile::tempdir().expect("temporary folder");
    let broken = |name: &str, from: &str, to: &str| {
        let path = folder.path().join(name);
        let content = std::fs::read_to_string(&plan).expect("plan");
        assert!(content.contains(from));
        std::fs::write(&path, content.replace(from, to)).expect("written");
        let run = dry_run(&rig, &path, false);
        assert_eq!(run.status.code(), Some(1));
        let message = text(&run.stderr);
        assert_eq!(message.lines().count(), 1, "one clear error: {message}");
        message
    };
    let far = broken("far.toml", "5.0]", "45.0]");
    assert!(far.contains("5.000..40.000 mm, found 65.000 mm"), "{far}");
    let format = broken("format.toml", "wcal-plan/1", "wcal-plan/9");
    assert!(
        format.contains("wcal-plan/1, found wcal-plan/9"),
        "{format}"
    );
    let missing = dry_run(&rig, &folder.path().join("none.toml"), false);
    assert!(missing.status.code() == Some(1) && text(&missing.stderr).contains("none.toml"));
    let usage = program().arg("stage-sweep").output().expect("wcal runs");
    assert_eq!(usage.status.code(), Some(2));
}

#[test]
fn a_plan_says_beforehand_what_it_cannot_tell_apart() {
    let check = |plan: &str| {
        document(&dry_run(
            &repository("rigs/virtual"),
            &repository(plan),
            true,
        ))["shows"]
            .clone()
    };
    let poor = check("rigs/plans/paper-27.toml");
    let of = |found: &Value, id: &str| {
        let all = found["effects"].as_array().expect("effects").clone();
        all.into_iter().find(|e| e["id"] == id).unwrap_or_default()
    };
    // Nothing moves while it is read, so no lag can show; readings while passing would show it.
    assert_eq!(of(&poor, "time-lag")["status"], "not-observable");
    let additions = poor["additions"].as_array().expect("additions");
    let passing = additions
        .iter()
        .find(|a| a["what"].as_str().is_some_and(|w| w.contains("passing")));
    assert!(
        passing.is_some_and(|a| a["testable"].to_string().contains("time-lag")),
        "{additions:?}"
    );
    // A reversal is never made: backlash is an offset like a periodic error's.
    assert!(
        of(&poor, "stage-backlash")["never_apart"]
            .to_string()
            .contains("stage-periodic"),
        "{poor}"
    );
    // Negative control: a plan with both directions, speeds and dwells.
    let rich = check("rigs/plans/rich.toml");
    assert_eq!(of(&rich, "time-lag")["status"], "testable");
    assert_eq!(
        of(&rich, "stage-backlash")["never_apart"],
        Value::Array(Vec::new())
    );
}

#[test]
fn the_templates_are_a_rig_and_a_plan_that_fit() {
    let templates = repository("examples/templates");
    let run = dry_run(&templates, &templates.join("plan.toml"), true);
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    for plan in ["rigs/plans/paper-27.toml", "rigs/plans/rich.toml"] {
        for rig in ["rigs/paper", "rigs/virtual"] {
            let run = dry_run(&repository(rig), &repository(plan), true);
            assert_eq!(
                run.status.code(),
                Some(0),
                "{rig} {plan}: {}",
                text(&run.stderr)
            );
        }
    }
}

#[test]
fn a_plan_of_one_or_two_readings_is_checked_and_shows_nothing() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let plan = folder.path().join("plan.toml");
    let said = |depths: &str, rest: bool| {
        let block = format!("trajectories = [1]\ndepths_mm = {depths}\nrest = {rest}");
        let head = "format = \"wcal-plan/1\"\nname = \"few\"\n[[block]]\nrole = \"calibration\"";
        std::fs::write(&plan, format!("{head}\n{block}\n")).expect("written");
        let run = dry_run(&repository("rigs/virtual"), &plan, false);
        assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
        assert!(
            text(&run.stdout).contains("limits hold"),
            "{}",
            text(&run.stdout)
        );
        text(&run.stderr)
    };
    for (depths, rest) in [("[1.0]", false), ("[1.0]", true), ("[1.0, 2.0]", false)] {
        assert!(
            said(depths, rest).contains("so few readings show no effect"),
            "{depths} {rest}"
        );
    }
    // Negative control.
    assert!(!said("[1.0, 2.0]", true).contains("so few"));
}

#[test]
fn a_rig_of_another_rate_than_the_scenario_is_named_before_anything_opens() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let scenario = folder.path().join("scenario.toml");
    let run = |rate_hz: u32| {
        let text = format!("format = \"wcal-scenario/1\"\n[interrogator]\nrate_hz = {rate_hz}\n");
        std::fs::write(&scenario, text).expect("written");
        let mut command = program();
        command
            .arg("stage-sweep")
            .arg("--dry-run")
            .arg("--rig")
            .arg(repository("rigs/virtual"));
        command
            .arg("--plan")
            .arg(repository("rigs/plans/paper-27.toml"))
            .arg("--scenario")
            .arg(&scenario);
        command.output().expect("wcal runs")
    };
    let (other, message) = (run(500), text(&run(500).stderr));
    assert_eq!(other.status.code(), Some(1), "{message}");
    assert!(message.contains("500 Hz, found 2000"), "{message}");
    assert_eq!(run(2000).status.code(), Some(0), "negative control");
}
