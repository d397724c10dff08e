//! The dependency directions of the design, read from `cargo metadata`.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Which workspace crates a crate may depend on (dev-dependencies apart).
fn allowed(name: &str) -> Option<&'static [&'static str]> {
    Some(match name {
        "wcal-core" => &[],
        "wcal-session" | "wcal-rod" | "wcal-map" | "wcal-report" | "wcal-vision" => &["wcal-core"],
        "wcal-mujoco" => &["wcal-core", "wcal-rod"],
        // A program: wcal speaks to it, nothing depends on it.
        "wcal-mujoco-engine" => &["wcal-mujoco"],
        "wcal-track" => &["wcal-core", "wcal-rod", "wcal-mujoco"],
        "wcal-trace" => &["wcal-core", "wcal-session", "wcal-rod", "wcal-map"],
        "wcal-drivers" => &["wcal-core", "wcal-session"],
        "wcal-plant" => &[],
        "wcal" => &[
            "wcal-core",
            "wcal-session",
            "wcal-drivers",
            "wcal-rod",
            "wcal-map",
            "wcal-trace",
            "wcal-report",
            "wcal-vision",
            "wcal-mujoco",
            "wcal-track",
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
    graph.entry("wcal-report".into()).or_default().insert("opencv".into());
    graph.entry("wcal-mujoco".into()).or_default().insert("mujoco-rs".into());
    let found = violations(&graph);
    assert_eq!(found, ["wcal-core -> wcal-trace", "wcal-mujoco -> mujoco-rs", "wcal-report -> opencv"]);
}
