//! The packages that a build of this workspace uses, as Cargo resolved them.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use serde_json::Value;
use std::collections::BTreeSet;
use std::process::Command;

/// One package.
#[allow(
    dead_code,
    reason = "not every test that includes this file reads all of it"
)]
#[derive(Debug, Clone)]
pub(crate) struct Package {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
    /// SPDX expression of its manifest.
    pub licence: Option<String>,
    /// Where its source is kept.
    pub repository: Option<String>,
    /// Registry or repository that Cargo takes it from; none: this workspace.
    pub source: Option<String>,
    /// Oldest compiler that it states.
    pub rust_version: Option<String>,
    /// Whether a program of ours carries it: reached without development and build dependencies.
    pub shipped: bool,
}

/// What cargo prints. Offline: what is tested was built, so it is here.
fn cargo(arguments: &[&str]) -> String {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .args(arguments)
        .args(["--locked", "--offline"])
        .current_dir(env!("CARGO_MANIFEST_DIR"));
    let out = cargo.output().unwrap();
    assert!(
        out.status.success(),
        "{}",
        String::from_utf8_lossy(&out.stderr)
    );
    String::from_utf8(out.stdout).unwrap()
}

/// Platform that the programs are built for.
const PLATFORM: &str = "x86_64-unknown-linux-gnu";

/// Name and version of each package that the workspace reaches over such edges.
fn tree(edges: &str) -> BTreeSet<String> {
    cargo(&[
        "tree",
        "--workspace",
        "-e",
        edges,
        "--prefix",
        "none",
        "--format",
        "{p}",
        "--target",
        PLATFORM,
    ])
    .lines()
    .filter_map(|line| {
        let mut words = line.split(' ');
        Some(format!(
            "{} {}",
            words.next()?,
            words.next()?.trim_start_matches('v')
        ))
    })
    .collect()
}

/// Every package that this platform builds or tests with, by name and version.
pub(crate) fn resolved() -> Vec<Package> {
    let used = tree("normal,build,dev");
    let shipped = tree("normal");
    let all: Value = serde_json::from_str(&cargo(&[
        "metadata",
        "--format-version",
        "1",
        "--filter-platform",
        PLATFORM,
    ]))
    .unwrap();
    let text = |v: &Value| v.as_str().map(str::to_owned);
    let mut packages: Vec<Package> = all["packages"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|p| {
            let [name, version] = ["name", "version"].map(|key| text(&p[key]).unwrap());
            let id = format!("{name} {version}");
            used.contains(&id).then(|| Package {
                shipped: shipped.contains(&id),
                name,
                version,
                licence: text(&p["license"]),
                repository: text(&p["repository"]),
                source: text(&p["source"]),
                rust_version: text(&p["rust_version"]),
            })
        })
        .collect();
    packages.sort_by(|a, b| (&a.name, &a.version).cmp(&(&b.name, &b.version)));
    packages
}
