//! `wcal-lab simulate --engine mujoco` as a user runs it (SIMULATED sweeps); without libmujoco they
//! say so, and fail in CI.

use crate::not_run::not_run;
use crate::support::{PROGRAM, program, run as wcal, text};
use std::process::Command;

/// MuJoCo's program in the folder of wcal; none where it was built without libmujoco or not at all.
fn mujoco() -> Option<std::path::PathBuf> {
    let path = std::path::Path::new(PROGRAM).with_file_name("wcal-mujoco");
    let asked = Command::new("sh")
        .args(["-c", "echo '{\"do\":\"hello\"}' | \"$0\"", path.to_str()?])
        .output()
        .ok()
        .filter(|o| text(&o.stdout).contains("mujoco"));
    if asked.is_none() {
        not_run(format!(
            "{} has no MuJoCo (`make setup` and a build of the workspace)",
            path.display()
        ));
    }
    asked.map(|_| path)
}

/// Both engines on the same sweeps: printed and in JSON; an engine that dies is counted and its
/// sweeps made again.
#[test]
fn mujoco_is_compared_with_the_rod_and_may_die() {
    let Some(engine) = mujoco() else { return };
    let folder = tempfile::tempdir().unwrap();
    let plan = folder.path().join("plan.toml");
    std::fs::write(
        &plan,
        "most_mm = 24.0\nrate_hz = 2.0\nspeed_mm_s = [4.0, 6.0]\ngap_mm = [25.0, 35.0]\n",
    )
    .unwrap();
    let out = folder.path().join("out");
    let run = |engine: &std::path::Path, more: &[&str]| {
        let mut command = program();
        command.args([
            "simulate", "--engine", "mujoco", "--object", "block", "--sweeps", "4",
        ]);
        command
            .args([
                "--plan",
                plan.to_str().unwrap(),
                "--out",
                out.to_str().unwrap(),
            ])
            .args(more);
        command
            .env("WCAL_MUJOCO", engine)
            .env("RAYON_NUM_THREADS", "1")
            .output()
            .unwrap()
    };
    // Ends after some requests, as a killed program does.
    let dying = folder.path().join("dying.sh");
    std::fs::write(
        &dying,
        format!("#!/bin/sh\nsed -u 9q | '{}'\n", engine.display()),
    )
    .unwrap();
    std::fs::set_permissions(&dying, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let dead = run(&dying, &["--json"]);
    let json: serde_json::Value = serde_json::from_slice(&dead.stdout).unwrap();
    let died = json["verdicts"]["engine-died"].as_u64().unwrap_or(0);
    assert!(
        dead.status.code() == Some(3) && died > 0,
        "{} {json}",
        text(&dead.stderr)
    );
    assert!(
        text(&dead.stderr).contains(&format!("the engine died in {died} sweeps")),
        "{}",
        text(&dead.stderr)
    );
    // One that greets and then says nothing more: ended after the wait, named and counted, and the
    // run goes on.
    let hanging = folder.path().join("hanging.sh");
    std::fs::write(
        &hanging,
        "#!/bin/sh\nread line\necho '{\"is\":\"hello\",\"mujoco\":\"0\"}'\nexec sleep 60\n",
    )
    .unwrap();
    std::fs::set_permissions(
        &hanging,
        std::os::unix::fs::PermissionsExt::from_mode(0o755),
    )
    .unwrap();
    let other = folder.path().join("hung");
    let hung = program()
        .args([
            "simulate", "--engine", "mujoco", "--object", "block", "--sweeps", "2", "--json",
            "--out",
        ])
        .arg(&other)
        .envs([
            ("WCAL_MUJOCO", hanging.as_os_str()),
            ("WCAL_MUJOCO_WAIT_S", "0.5".as_ref()),
        ])
        .output()
        .unwrap();
    let json: serde_json::Value = serde_json::from_slice(&hung.stdout).unwrap();
    assert!(
        hung.status.code() == Some(3) && json["verdicts"]["no-convex-parts"] == 2,
        "{json}"
    );
    let said = text(&hung.stderr);
    assert!(
        said.contains("block: ") && said.contains("within 0.5 s") && said.contains("hung"),
        "{said}"
    );
    // The second run makes them again (negative control: nothing dies).
    let second = run(&engine, &["--json"]);
    let json: serde_json::Value = serde_json::from_slice(&second.stdout).unwrap();
    assert_eq!(
        second.status.code(),
        Some(0),
        "{} {json}",
        text(&second.stderr)
    );
    assert!(
        json["verdicts"]["engine-died"].is_null() && json["sweeps"] == 4,
        "{json}"
    );
    let table = &json["against_rod"];
    let rows = table["by_speed"].as_array().unwrap();
    assert_eq!(rows.len(), 2, "4 to 5 and 5 to 6 mm/s: {table}");
    let samples: u64 = rows.iter().map(|r| r["samples"].as_u64().unwrap()).sum();
    assert!(
        samples > 5 && table["kept"][0].as_u64().unwrap() > 0,
        "{table}"
    );
    for row in rows.iter().filter(|r| r["samples"].as_u64() > Some(3)) {
        let [off, own] = [0, 1].map(|k| row["moment_rms_nmm"][k].as_f64().unwrap());
        assert!(
            off > 1e-6 && off < 0.3 * own,
            "the engines differ, but not by much: {row}"
        );
        assert!(row["contact_rms_mm"].as_f64().unwrap() < 3.0, "{row}");
    }
    assert!(
        json["convex"]["block"]["hausdorff_mm"].as_f64().unwrap() < 0.01,
        "{json}"
    );
    // All is there: the summary for a person says the same without another sweep.
    let printed = text(&run(&engine, &[]).stdout);
    for words in ["block: 1 convex parts; Hausdorff", "4.0-5.0", "both kept"] {
        assert!(printed.contains(words), "{words}: {printed}");
    }
    // Negative control: the rod alone is compared with nothing.
    let rod = out.with_file_name("rod");
    let rod = wcal(&[
        "simulate",
        "--object",
        "block",
        "--sweeps",
        "2",
        "--json",
        "--out",
        rod.to_str().unwrap(),
    ]);
    let json: serde_json::Value = serde_json::from_slice(&rod.stdout).unwrap();
    assert!(
        json.get("against_rod").is_none() && json.get("convex").is_none(),
        "{json}"
    );
}

#[test]
fn softening_is_refused_by_mujoco_with_the_reason() {
    let Some(engine) = mujoco() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(
        at("plan.toml"),
        "[physics]\nsoftening_onset_per_m = [30.0, 40.0]\n",
    )
    .unwrap();
    let args = [
        "simulate",
        "--engine",
        "mujoco",
        "--object",
        "block",
        "--sweeps",
        "1",
        "--plan",
        &at("plan.toml"),
        "--out",
        &at("out"),
    ];
    let run = program()
        .args(args)
        .env("WCAL_MUJOCO", engine)
        .output()
        .unwrap();
    let error = text(&run.stderr);
    assert!(
        run.status.code() == Some(1) && error.contains("softening_onset_per_m"),
        "{error}"
    );
    assert!(
        !std::path::Path::new(&at("out")).exists(),
        "nothing is left behind"
    );
}

/// Damping and contact of `wcal fit-whisker --dynamics` are what MuJoCo's wire then has.
#[test]
fn the_dynamics_of_a_fitted_whisker_are_used() {
    let Some(engine) = mujoco() else { return };
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(at("plan.toml"), "most_mm = 12.0\nrate_hz = 2.0\nspeed_mm_s = [6.0, 6.0]\ngap_mm = [25.0, 30.0]\nlead_mm = [1.0, 2.0]\n")
        .unwrap();
    let whisker = "[whisker]\ndiameter_mm = 0.3\nlength_mm = 60.0\nstraight_mm = 30.0\narc_radius_mm = 20.0\n";
    let run = |name: &str, dynamics: &str| {
        let toml = at(&format!("{name}.toml"));
        std::fs::write(&toml, format!("{whisker}{dynamics}")).unwrap();
        let out = at(name);
        let args = [
            "simulate", "--engine", "mujoco", "--object", "block", "--sweeps", "1", "--seed", "3",
        ];
        let done = program()
            .args(args)
            .args([
                "--whisker",
                &toml,
                "--plan",
                &at("plan.toml"),
                "--out",
                &out,
            ])
            .env("WCAL_MUJOCO", &engine)
            .output()
            .unwrap();
        let table = std::fs::read(format!("{out}/block-000000.samples.parquet")).ok();
        (done.status.code(), table, text(&done.stderr))
    };
    let dynamics = |damping_s: f64| {
        format!(
            "[dynamics]\ndamping_s = {damping_s}\narmature_s2 = 1e-6\ncontact_time_s = 2e-3\nwidth_mm = 0.1\nimpedance = [0.95, 0.99]\n"
        )
    };
    let (code, usual, said) = run("usual", "");
    assert!(matches!(code, Some(0 | 3)) && usual.is_some(), "{said}");
    assert!(run("slow", &dynamics(0.3)).1.unwrap() != *usual.as_ref().unwrap());
    // Negative control: the usual ones, written out, are no change.
    assert!(run("same", &dynamics(0.02)).1 == usual);
    let (code, table, said) = run("broken", "[dynamics]\ndamping_s = 0.02\n");
    assert!(
        code == Some(1) && table.is_none() && said.contains("`armature_s2`"),
        "{said}"
    );
}
