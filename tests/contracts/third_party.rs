//! What others wrote: under which licence, from where, and that `THIRD-PARTY.md` says so. No LGPL
//! code is in the program.
//!
//! `WCAL_WRITE_DOCS=1 cargo test --workspace --test contracts third_party::` writes the notice
//! anew.

use crate::support::packages::{self, Package};
use crate::support::{PROGRAM, repository};
use std::fmt::Write as _;
use std::fs;

/// `deny.toml`: allowed licences and registries.
struct Rules {
    licences: Vec<String>,
    registries: Vec<String>,
}

impl Rules {
    fn read() -> Self {
        let deny: toml::Table = fs::read_to_string(repository("deny.toml"))
            .unwrap()
            .parse()
            .unwrap();
        let list = |v: &toml::Value| -> Vec<String> {
            v.as_array()
                .unwrap()
                .iter()
                .map(|v| v.as_str().unwrap().to_owned())
                .collect()
        };
        Self {
            licences: list(&deny["licenses"]["allow"]),
            registries: list(&deny["sources"]["allow-registry"]),
        }
    }

    /// Why a package may not be used.
    fn objection(&self, package: &Package) -> Option<String> {
        let who = format!("{} {}", package.name, package.version);
        let Some(licence) = &package.licence else {
            return Some(format!("{who}: no licence"));
        };
        if !allowed(licence, &self.licences) {
            return Some(format!("{who}: {licence}"));
        }
        let from = package.source.as_deref()?;
        let known = self
            .registries
            .iter()
            .any(|r| from == format!("registry+{r}"));
        (!known).then(|| format!("{who}: from {from}"))
    }
}

/// Whether an SPDX expression (or the older "A/B") is met by what is allowed: OR over AND, inner
/// brackets first.
fn allowed(expression: &str, licences: &[String]) -> bool {
    const MET: &str = "met";
    let expression = expression.replace('/', " OR ");
    let known = |name: &str| name == MET || licences.iter().any(|l| l == name);
    let met = |part: &str| {
        part.split(" OR ")
            .any(|all| all.split(" AND ").all(|name| known(name.trim())))
    };
    let Some((before, rest)) = expression.rsplit_once('(') else {
        return met(&expression);
    };
    rest.split_once(')').is_some_and(|(inner, after)| {
        let value = if met(inner) { MET } else { "unmet" };
        allowed(&format!("{before}{value}{after}"), licences)
    })
}

/// Third-party code that Cargo does not know of.
const NATIVE: &str = "\
## Native code

| what | how it comes | licence |
|---|---|---|
| NLopt 2.9.1 without its Luksan solvers (LGPL: left out at build time, `calib/mujoco/without-lgpl.cmake`) | source in the package `nlopt`, linked | MIT |
| AprilTag 3 | source in the package `apriltag-sys`, linked | BSD-2-Clause |
| mimalloc | source in the package `libmimalloc-sys`, linked | MIT |
| OpenCV | Debian's libraries, loaded | Apache-2.0 |
| libudev | Debian's library, loaded | LGPL-2.1-or-later |
| MuJoCo 3.17.0 | its PyPI wheel, fetched into `native/` with its licences, loaded by `wcal-mujoco` | Apache-2.0 |
| CoACD 1.0.14 | as MuJoCo | MIT |
| libgomp | in CoACD's wheel | GPL-3.0-or-later WITH GCC-exception-3.1 |
";

fn notice(packages: &[Package]) -> String {
    let mut out = "# Third parties\n\nWritten by `WCAL_WRITE_DOCS=1 cargo test --workspace --test contracts third_party::` from `Cargo.lock`; the same test compares it. The text of each licence is in the package's \
                   source.\n\n"
        .to_owned();
    out += NATIVE;
    out += "\n## Rust packages in the programs\n\n| package | licence | source |\n|---|---|---|\n";
    for p in packages.iter().filter(|p| p.shipped && p.source.is_some()) {
        let licence = p.licence.as_deref().unwrap_or_default();
        writeln!(
            out,
            "| {} {} | {licence} | {} |",
            p.name,
            p.version,
            p.repository.as_deref().unwrap_or("crates.io")
        )
        .unwrap();
    }
    out
}

#[test]
fn licences_and_sources_are_those_that_deny_toml_allows() {
    let (rules, packages) = (Rules::read(), packages::resolved());
    assert!(packages.len() > 300, "{}", packages.len());
    let objections: Vec<String> = packages.iter().filter_map(|p| rules.objection(p)).collect();
    assert_eq!(objections, Vec::<String>::new());
    // Negative controls: a licence that is not allowed alone, with another, and one from elsewhere.
    let base = packages.iter().find(|p| p.source.is_some()).unwrap();
    let with = |licence: &str| {
        rules.objection(&Package {
            licence: Some(licence.to_owned()),
            ..base.clone()
        })
    };
    assert!(with("LGPL-2.1-or-later").is_some() && with("MIT AND GPL-3.0-only").is_some());
    assert!(
        with("(MIT OR GPL-3.0-only) AND ISC").is_none()
            && with("(MIT OR ISC) AND GPL-3.0-only").is_some()
    );
    assert!(
        with("MIT/Apache-2.0").is_none()
            && with("MIT OR GPL-3.0-only").is_none()
            && with("MIT (").is_some()
    );
    let git = Package {
        source: Some("git+https://example.org/x#1".to_owned()),
        ..base.clone()
    };
    assert!(rules.objection(&git).is_some());
    let silent = Package {
        name: "silent".to_owned(),
        licence: None,
        ..base.clone()
    };
    assert!(rules.objection(&silent).is_some());
}

#[test]
fn the_notice_of_third_parties_is_current() {
    let packages = packages::resolved();
    let (page, found) = (repository("THIRD-PARTY.md"), notice(&packages));
    if std::env::var_os("WCAL_WRITE_DOCS").is_some() {
        fs::write(&page, &found).unwrap();
    }
    assert!(
        fs::read_to_string(&page).unwrap_or_default() == found,
        "THIRD-PARTY.md: write it anew with WCAL_WRITE_DOCS=1"
    );
    // What the table of native code says of NLopt: its version is that of the source in the
    // package.
    let nlopt = packages.iter().find(|p| p.name == "nlopt").unwrap();
    assert_eq!(
        nlopt.version, "0.8.1",
        "another package of NLopt: look at its version and licence, then at NATIVE"
    );
    // Negative control: a package that is left out.
    assert!(notice(&packages[..packages.len() / 2]) != found);
}

/// Whether the program holds a text.
fn holds(text: &str) -> bool {
    let search = std::process::Command::new("grep")
        .args(["-qaF", text, PROGRAM])
        .status();
    search.unwrap().success()
}

#[test]
fn no_lgpl_solver_is_in_the_program() {
    // NLopt is there with its names: the search would find those of the solvers.
    assert!(holds("bobyqa") && holds("nlopt_optimize"));
    assert!(
        !holds("luksan_"),
        "NLopt was built with its LGPL part, before .cargo/config.toml said otherwise: cargo clean -p nlopt"
    );
}

/// The last line of `.ci/run` where `make` does nothing, with and without `cargo-deny`.
fn last_line_of_ci(with_deny: bool) -> String {
    let place = tempfile::tempdir().unwrap();
    let stub = |name: &str| {
        let path = place.path().join(name);
        fs::write(&path, "#!/bin/sh\nexit 0\n").unwrap();
        assert!(
            std::process::Command::new("chmod")
                .arg("+x")
                .arg(path)
                .status()
                .unwrap()
                .success()
        );
    };
    stub("make");
    if with_deny {
        stub("cargo-deny");
    }
    // Where the shell's own tools are, and nothing of cargo.
    let path = format!("{}:/usr/bin:/bin", place.path().display());
    let run = std::process::Command::new("bash")
        .arg(repository(".ci/run"))
        .env("PATH", path)
        .output()
        .unwrap();
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    String::from_utf8_lossy(&run.stdout)
        .lines()
        .next_back()
        .unwrap_or_default()
        .to_owned()
}

#[test]
fn the_last_line_of_ci_says_whether_known_vulnerabilities_were_looked_up() {
    let [with, without] = [true, false].map(last_line_of_ci);
    assert!(
        with.contains("looked up") && !with.contains("NOT"),
        "{with}"
    );
    assert!(
        without.contains("NOT looked up") && without.contains("cargo-deny"),
        "{without}"
    );
}
