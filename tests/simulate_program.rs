//! `wcal simulate` as a user runs it (SIMULATED sweeps).

use std::process::{Command, Output};

fn wcal(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_wcal")).args(args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn a_dataset_is_made_and_a_second_run_finds_it_there() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("sweeps");
    let args = ["simulate", "--object", "can", "--sweeps", "3", "--json", "--out", out.to_str().unwrap()];
    let first = wcal(&args);
    assert_eq!(first.status.code(), Some(0), "{}", text(&first.stderr));
    let json: serde_json::Value = serde_json::from_slice(&first.stdout).unwrap();
    assert_eq!((json["format"].as_str(), json["simulated"].as_bool()), (Some("wcal-sweeps/1"), Some(true)));
    assert_eq!(json["sweeps"], 3);
    assert!(json["samples"].as_u64().unwrap() > 20, "{json}");
    for table in ["sweeps", "samples", "contacts"] {
        assert!(out.join(format!("can-000000.{table}.parquet")).exists());
    }
    assert!(out.join("dataset.json").exists());
    let second: serde_json::Value = serde_json::from_slice(&wcal(&args).stdout).unwrap();
    assert_eq!(second["kept"], json["kept"]);
    assert!(second.get("sweeps_per_core_s").is_none(), "nothing was to be made: {second}");
}

#[test]
fn what_cannot_be_simulated_is_said_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("empty.stl"), b"solid nothing\nendsolid nothing\n").unwrap();
    std::fs::write(path("plan.toml"), "speed_mm_s = [7.0, 3.0]\n").unwrap();
    std::fs::write(path("whisker.toml"), "[whisker]\ndiameter_mm = 0.3\n").unwrap();
    let out = path("out");
    for (args, words) in [
        (vec!["--object", "teapot"], ["built-in object: expected one of ball", "found teapot"]),
        (vec![], ["expected an object", "found none"]),
        (vec!["--object", "can", "--shard", "3/2"], ["--shard: expected i/n", "3/2"]),
        (vec!["--object", "can", "--plan", &path("plan.toml")], ["speed_mm_s: expected", "[7.0, 3.0]"]),
        (vec!["--object", "can", "--whisker", &path("whisker.toml")], ["whisker.toml", "length_mm"]),
        (vec!["--object", "can", "--object", "can"], ["different names", "\"can\" twice"]),
        (vec!["--meshes", &path("empty.stl")], ["expected an object", "triangles, found 0"]),
    ] {
        let mut all = vec!["simulate", "--sweeps", "1", "--out", &out];
        all.extend(args.iter().copied());
        let run = wcal(&all);
        let error = text(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{args:?}: {error}");
        assert!(words.iter().all(|w| error.contains(w)), "{args:?}: {error}");
        assert!(!std::path::Path::new(&out).exists(), "{args:?} left something behind");
    }
    // An object that cannot be used is left out by name; the others are made.
    let run = wcal(&[
        "simulate",
        "--sweeps",
        "1",
        "--out",
        &out,
        "--object",
        "can",
        "--meshes",
        &path("empty.stl"),
    ]);
    assert_eq!(run.status.code(), Some(3), "{}", text(&run.stderr));
    assert!(text(&run.stderr).contains("empty.stl is left out"), "{}", text(&run.stderr));
}
