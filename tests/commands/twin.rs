//! `wcal twin --engine mujoco` as a user runs it, on two released poses (SIMULATED labels).

use crate::support::not_run::not_run;
use crate::support::{PROGRAM, fixture, program};
use std::process::Command;

#[test]
fn the_twin_tells_a_pose_without_a_certain_moment_without_its_label() {
    let engine = std::path::Path::new(PROGRAM).with_file_name("wcal-mujoco");
    let hello = Command::new("sh")
        .args([
            "-c",
            "echo '{\"do\":\"hello\"}' | \"$0\"",
            engine.to_str().unwrap(),
        ])
        .output();
    if !hello.is_ok_and(|o| String::from_utf8_lossy(&o.stdout).contains("mujoco")) {
        not_run(format!("{} has no MuJoCo", engine.display()));
        return;
    }
    let fixture = fixture("whiskerfbg");
    let folder = tempfile::tempdir().unwrap();
    for name in ["session.toml", "rest_shape.csv", "points.csv", "twin.csv"] {
        let text = std::fs::read_to_string(fixture.join(name)).unwrap();
        // Two poses of one trajectory: a sure one and one whose wire still swings when the moment
        // is read.
        let kept = |line: &&str| {
            !name.ends_with("s.csv") && name != "twin.csv"
                || line.starts_with("point")
                || ["9,", "11,"].iter().any(|p| line.starts_with(p))
        };
        let text: Vec<&str> = text.lines().filter(kept).collect();
        std::fs::write(folder.path().join(name), text.join("\n") + "\n").unwrap();
    }
    let out = folder.path().join("out.csv");
    let run = |labels: bool| {
        if !labels {
            let path = folder.path().join("session.toml");
            let text = std::fs::read_to_string(&path).unwrap();
            let without: Vec<&str> = text.lines().filter(|l| !l.starts_with("twin")).collect();
            std::fs::write(&path, without.join("\n")).unwrap();
        }
        let args = [
            "twin",
            folder.path().to_str().unwrap(),
            "--engine",
            "mujoco",
            "--preset",
            "released",
            "--out",
        ];
        let done = program()
            .args(args)
            .arg(&out)
            .env("WCAL_MUJOCO", &engine)
            .output()
            .unwrap();
        (
            done.status.code(),
            String::from_utf8_lossy(&done.stderr).into_owned(),
        )
    };
    let (code, said) = run(true);
    assert_eq!(code, Some(3), "{said}");
    for words in [
        "point 11: no certain moment: come to straight from the start it is free",
        "1 of 2 poses have no certain moment: 11",
        "1 labels of the session, at poses with a certain moment: within",
    ] {
        assert!(said.contains(words), "{words}: {said}");
    }
    let table = std::fs::read_to_string(&out).unwrap();
    let row = |point: &str| {
        table
            .lines()
            .find(|l| l.starts_with(point))
            .unwrap()
            .to_owned()
    };
    assert!(
        row("9,").contains(",held,true") && row("11,").contains(",several,"),
        "{table}"
    );
    // The same without any label.
    let (code, said) = run(false);
    assert!(code == Some(3) && said.contains("1 of 2 poses"), "{said}");
    assert!(!said.contains("labels of the session,"), "{said}");
}
