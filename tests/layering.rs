//! The dependency directions of the design, read from `cargo metadata`.
#![allow(clippy::expect_used, reason = "a test that fails should say where")]

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Which workspace crates a crate may depend on (except dev-dependencies).
fn allowed(name: &str) -> Option<&'static [&'static str]> {
    Some(match name {
        "wcal-core" => &[],
        "wcal-acquisition" => &["wcal-core", "wcal-session"],
        "wcal-session" | "wcal-rod" | "wcal-map" | "wcal-report" | "wcal-vision" => &["wcal-core"],
        "wcal-sim" => &["wcal-core", "wcal-rod"],
        "wcal-mujoco" => &["wcal-core", "wcal-rod", "wcal-sim"],
        // A program: wcal speaks to it, nothing depends on it.
        "wcal-mujoco-engine" => &["wcal-mujoco", "wcal-sim"],
        "wcal-track" => &["wcal-core", "wcal-rod", "wcal-sim", "wcal-map"],
        "wcal-contact" => &[
            "wcal-core",
            "wcal-session",
            "wcal-acquisition",
            "wcal-rod",
            "wcal-trace",
            "wcal-calibration",
            "wcal-sim",
            "wcal-track",
        ],
        "wcal-trace" => &["wcal-core", "wcal-session", "wcal-rod", "wcal-map"],
        // A device needs its entry of the rig, no session.
        "wcal-drivers" => &["wcal-core"],
        "wcal-calibration" => &["wcal-core", "wcal-session", "wcal-map", "wcal-trace"],
        "wcal-plant" => &[],
        "wcal" => &[
            "wcal-core",
            "wcal-session",
            "wcal-acquisition",
            "wcal-drivers",
            "wcal-rod",
            "wcal-map",
            "wcal-trace",
            "wcal-calibration",
            "wcal-report",
            "wcal-vision",
            "wcal-sim",
            "wcal-mujoco",
            "wcal-track",
            "wcal-contact",
            // The virtual bench's wire: physics that shares no code with the fitter.
            "wcal-plant",
        ],
        _ => return None,
    })
}

/// Native libraries, and the one crate that may use each.
const NATIVE: [(&str, &str); 5] = [
    ("opencv", "wcal-vision"),
    ("apriltag-sys", "wcal-vision"),
    ("apriltag", "wcal-vision"),
    ("mujoco-rs", "wcal-mujoco-engine"),
    ("burn", "wcal-track"),
];

fn violations(graph: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut out = Vec::new();
    for (name, uses) in graph {
        let Some(may) = allowed(name) else {
            out.push(format!("{name}: not in the layering table"));
            continue;
        };
        for (used, _) in NATIVE.iter().filter(|(used, owner)| uses.contains(*used) && name != owner) {
            out.push(format!("{name} -> {used}"));
        }
        for used in uses.iter().filter(|u| u.starts_with("wcal") && !may.contains(&u.as_str())) {
            out.push(format!("{name} -> {used}"));
        }
    }
    out
}

fn graph() -> BTreeMap<String, BTreeSet<String>> {
    let out = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata runs");
    let json: serde_json::Value = serde_json::from_slice(&out.stdout).expect("metadata is JSON");
    let packages = json["packages"].as_array().expect("packages");
    packages
        .iter()
        .map(|p| {
            let uses = p["dependencies"].as_array().expect("dependencies").iter();
            let normal = uses.filter(|d| d["kind"].is_null()).filter_map(|d| d["name"].as_str());
            (p["name"].as_str().unwrap_or_default().to_owned(), normal.map(str::to_owned).collect())
        })
        .collect()
}

#[test]
fn dependencies_point_the_way_of_the_design() {
    let graph = graph();
    assert!(graph.contains_key("wcal-core"), "metadata lists the workspace: {:?}", graph.keys());
    assert_eq!(violations(&graph), Vec::<String>::new());
}

#[test]
fn a_wrong_direction_is_seen() {
    let mut graph = graph();
    graph.entry("wcal-core".into()).or_default().insert("wcal-trace".into());
    graph.entry("wcal-drivers".into()).or_default().insert("wcal-session".into());
    graph.entry("wcal-acquisition".into()).or_default().insert("wcal-drivers".into());
    graph.entry("wcal-trace".into()).or_default().insert("wcal-calibration".into());
    graph.entry("wcal-report".into()).or_default().insert("opencv".into());
    graph.entry("wcal-mujoco".into()).or_default().insert("mujoco-rs".into());
    // The simulated world knows no MuJoCo, and neither does what is trained on it.
    graph.entry("wcal-sim".into()).or_default().insert("wcal-mujoco".into());
    graph.entry("wcal-track".into()).or_default().insert("wcal-mujoco".into());
    let found = violations(&graph);
    let expected = [
        "wcal-acquisition -> wcal-drivers",
        "wcal-core -> wcal-trace",
        "wcal-drivers -> wcal-session",
        "wcal-mujoco -> mujoco-rs",
        "wcal-report -> opencv",
        "wcal-sim -> wcal-mujoco",
        "wcal-trace -> wcal-calibration",
        "wcal-track -> wcal-mujoco",
    ];
    assert_eq!(found, expected);
}

/// What `make peers` runs is there: scripts, packages and examples; an example that was deleted stopped it at its first row once.
#[test]
fn every_command_of_the_peers_refers_to_something_that_exists() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let run = |arguments: &[&str]| {
        let mut command = std::process::Command::new("python3");
        command.current_dir(root.join("tests/peers")).args(arguments).output().expect("python3 runs")
    };
    let listed = run(&["run_all.py", "--list", "--ycb", "meshes"]);
    assert!(listed.status.success(), "{}", String::from_utf8_lossy(&listed.stderr));
    let all: serde_json::Value = serde_json::from_slice(&listed.stdout).expect("JSON");
    let all: std::collections::BTreeMap<String, Vec<Vec<String>>> =
        serde_json::from_value(all).expect("commands");
    let manifests: Vec<std::path::PathBuf> = ["calib", "rigs", "tests", "calib/mujoco"]
        .iter()
        .flat_map(|d| std::fs::read_dir(root.join(d)).expect("a folder"))
        .map(|entry| entry.expect("an entry").path())
        .chain([root.to_owned()])
        .filter(|folder| folder.join("Cargo.toml").exists())
        .collect();
    let example = |name: &str| manifests.iter().any(|m| m.join(format!("examples/{name}.rs")).exists());
    let package = |name: &str| {
        let line = format!("name = {name:?}");
        let text =
            |m: &std::path::PathBuf| std::fs::read_to_string(m.join("Cargo.toml")).expect("a manifest");
        manifests.iter().any(|m| text(m).lines().any(|l| l == line))
    };
    let (mut examples, mut scripts) = (0, 0);
    for command in all.values().flatten() {
        for pair in command.windows(2) {
            match pair[0].as_str() {
                "--example" => assert!(example(&pair[1]), "example {}", pair[1]),
                "-p" | "--bin" => assert!(package(&pair[1]), "package or program {}", pair[1]),
                "--test" => assert!(root.join(format!("rigs/drivers/tests/{}.rs", pair[1])).exists()),
                _ => {}
            }
            examples += usize::from(pair[0] == "--example");
        }
        for word in command.iter().filter(|w| w.ends_with(".py")) {
            assert!(std::path::Path::new(word).exists(), "{word}");
            scripts += 1;
        }
    }
    assert!(all.len() >= 10 && examples >= 6 && scripts >= 9, "{examples} examples, {scripts} scripts");
    assert!(!example("deleted") && !package("deleted"), "control");
    // One that fails is noted, and the next one runs.
    let folder = tempfile::tempdir().expect("temporary folder");
    let program = format!(
        "import sys, pathlib, run_all\nsys.argv = ['x']\nrun_all.ROOT = pathlib.Path({:?})\n\
         run_all.comparisons = lambda ycb: iter([('bad', [['sh', '-c', 'echo torn >&2; exit 7']]), ('good', [['true']])])\n\
         sys.exit(run_all.main())",
        folder.path()
    );
    let failed = run(&["-c", &program]);
    assert_eq!(failed.status.code(), Some(1), "{}", String::from_utf8_lossy(&failed.stderr));
    let said = String::from_utf8_lossy(&failed.stdout).into_owned();
    assert!(said.contains("== good"), "{said}");
    let noted = std::fs::read_to_string(folder.path().join("peers-bad.json")).expect("its JSON");
    assert!(noted.contains("exit status 7: torn") && noted.contains("\"met\": false"), "{noted}");
    assert!(!folder.path().join("peers-good.json").exists());
}

/// Calls that open a file by a path. `wcal_core::files` does so for everybody: a pipe would hang the program, a device fill the memory.
const OPENS: [&str; 4] = ["fs::read(", "fs::read_to_string(", "File::open(", "stl_io::read"];

/// Lines of a source that open a file on their own; what stands below `#[cfg(test)]` may.
fn opened(source: &str) -> Vec<&str> {
    let program = source.split("#[cfg(test)]").next().unwrap_or_default();
    program.lines().filter(|line| OPENS.iter().any(|call| line.contains(call))).collect()
}

#[test]
fn every_path_is_opened_in_one_place() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![root.join("calib"), root.join("rigs/drivers/src")];
    let (mut seen, mut wrong) = (0, Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of sources") {
            let path = entry.expect("an entry").path();
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if path.is_dir() {
                // A program of its own, which opens no path of a person.
                if !["tests", "examples", "benches", "engine"].contains(&name.as_str()) {
                    folders.push(path);
                }
            } else if name.ends_with(".rs") && name != "tests.rs" && !path.ends_with("core/src/files.rs") {
                let text = std::fs::read_to_string(&path).expect("a source");
                wrong.extend(opened(&text).iter().map(|line| format!("{}: {}", path.display(), line.trim())));
                seen += 1;
            }
        }
    }
    assert!(seen > 300, "{seen} sources");
    assert_eq!(wrong, Vec::<String>::new());
    assert_eq!(
        opened("let a = std::fs::read(path)?;\n#[cfg(test)]\nstd::fs::read(path)").len(),
        1,
        "control"
    );
}
