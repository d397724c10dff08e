//! The dependency directions of the design, read from `cargo metadata`.

use crate::support::repository;
use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Which workspace crates a crate may depend on (except dev-dependencies).
fn allowed(name: &str) -> Option<&'static [&'static str]> {
    Some(match name {
        "wcal-core" => &[],
        "wcal-acquisition" => &["wcal-core", "wcal-session"],
        "wcal-session" | "wcal-rod" | "wcal-gpr" | "wcal-report" | "wcal-vision" => &["wcal-core"],
        "wcal-mesh" => &["wcal-core"],
        "wcal-lab-sweeps" => &["wcal-core", "wcal-mujoco", "wcal-rod", "wcal-mesh"],
        "wcal-mujoco" => &["wcal-core", "wcal-rod", "wcal-mesh"],
        // A program: wcal speaks to it, nothing depends on it.
        "wcal-mujoco-engine" => &["wcal-mujoco"],
        "wcal-network" => &["wcal-core", "wcal-rod"],
        "wcal-track" => &[
            "wcal-core",
            "wcal-session",
            "wcal-acquisition",
            "wcal-rod",
            "wcal-verify",
            "wcal-calibration",
            "wcal-mesh",
            "wcal-network",
        ],
        "wcal-verify" => &["wcal-core", "wcal-session", "wcal-rod", "wcal-gpr"],
        // A device needs its entry of the rig, no session.
        "wcal-drivers" => &["wcal-core"],
        "wcal-calibration" => &["wcal-core", "wcal-session", "wcal-gpr", "wcal-verify"],
        // The virtual bench's wire: physics that shares no code with the fitter.
        "wcal-bench" => &[],
        // Test support: nothing that ships has it.
        "wcal-plant" => &["wcal-bench"],
        "wcal-exam" => &["wcal-plant"],
        // The second program: nothing depends on it.
        "wcal-lab" => &[
            "wcal",
            "wcal-core",
            "wcal-session",
            "wcal-acquisition",
            "wcal-calibration",
            "wcal-track",
            "wcal-gpr",
            "wcal-mujoco",
            "wcal-lab-sweeps",
            "wcal-mesh",
            "wcal-network",
            "wcal-plant",
            "wcal-exam",
        ],
        "wcal" => &[
            "wcal-core",
            "wcal-session",
            "wcal-acquisition",
            "wcal-drivers",
            "wcal-rod",
            "wcal-gpr",
            "wcal-verify",
            "wcal-calibration",
            "wcal-report",
            "wcal-vision",
            "wcal-mesh",
            "wcal-mujoco",
            "wcal-network",
            "wcal-track",
            "wcal-bench",
        ],
        _ => return None,
    })
}

/// Native and heavy libraries, and the one crate that may use each.
const NATIVE: [(&str, &str); 6] = [
    ("opencv", "wcal-vision"),
    ("apriltag-sys", "wcal-vision"),
    ("apriltag", "wcal-vision"),
    ("mujoco-rs", "wcal-mujoco-engine"),
    ("burn", "wcal-lab"),
    ("parquet", "wcal-lab"),
];

fn violations(graph: &BTreeMap<String, BTreeSet<String>>) -> Vec<String> {
    let mut out = Vec::new();
    for (name, uses) in graph {
        let Some(may) = allowed(name) else {
            out.push(format!("{name}: not in the layering table"));
            continue;
        };
        for (used, _) in NATIVE
            .iter()
            .filter(|(used, owner)| uses.contains(*used) && name != owner)
        {
            out.push(format!("{name} -> {used}"));
        }
        for used in uses
            .iter()
            .filter(|u| u.starts_with("wcal") && !may.contains(&u.as_str()))
        {
            out.push(format!("{name} -> {used}"));
        }
    }
    out
}

pub(crate) fn metadata() -> serde_json::Value {
    let out = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--no-deps"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("cargo metadata runs");
    serde_json::from_slice(&out.stdout).expect("metadata is JSON")
}

fn graph() -> BTreeMap<String, BTreeSet<String>> {
    let json = metadata();
    let packages = json["packages"].as_array().expect("packages");
    packages
        .iter()
        .map(|p| {
            let uses = p["dependencies"].as_array().expect("dependencies").iter();
            let normal = uses
                .filter(|d| d["kind"].is_null())
                .filter_map(|d| d["name"].as_str());
            (
                p["name"].as_str().unwrap_or_default().to_owned(),
                normal.map(str::to_owned).collect(),
            )
        })
        .collect()
}

#[test]
fn dependencies_point_the_way_of_the_design() {
    let graph = graph();
    assert!(
        graph.contains_key("wcal-core"),
        "metadata lists the workspace: {:?}",
        graph.keys()
    );
    assert_eq!(violations(&graph), Vec::<String>::new());
}

/// What is reached from these by dependencies of the programs.
fn reached(graph: &BTreeMap<String, BTreeSet<String>>, from: &[String]) -> BTreeSet<String> {
    let (mut seen, mut to_do) = (BTreeSet::new(), from.to_vec());
    while let Some(name) = to_do.pop() {
        if seen.insert(name.clone()) {
            to_do.extend(graph.get(&name).into_iter().flatten().cloned());
        }
    }
    seen
}

/// `cargo build` makes what a user of a bench runs: no tensor library, no Parquet, no test support.
#[test]
fn the_default_build_has_nothing_of_the_lab() {
    let (graph, json) = (graph(), metadata());
    let packages = json["packages"].as_array().expect("packages");
    let members = json["workspace_default_members"]
        .as_array()
        .expect("default members");
    let names = packages
        .iter()
        .filter(|p| members.contains(&p["id"]))
        .filter_map(|p| p["name"].as_str());
    let mut names: Vec<String> = names.map(str::to_owned).collect();
    names.sort_unstable();
    assert_eq!(names, ["wcal", "wcal-mujoco-engine"]);
    let foreign = [
        "wcal-lab",
        "wcal-lab-sweeps",
        "wcal-plant",
        "wcal-exam",
        "burn",
        "parquet",
    ];
    let of = |names: &[String]| {
        let all = reached(&graph, names);
        foreign
            .into_iter()
            .filter(|name| all.contains(*name))
            .collect::<Vec<_>>()
    };
    assert_eq!(of(&names), Vec::<&str>::new());
    assert_eq!(of(&["wcal-lab".to_owned()]), foreign, "negative control");
}

#[test]
fn a_wrong_direction_is_seen() {
    let mut graph = graph();
    graph
        .entry("wcal-core".into())
        .or_default()
        .insert("wcal-verify".into());
    graph
        .entry("wcal-drivers".into())
        .or_default()
        .insert("wcal-session".into());
    graph
        .entry("wcal-acquisition".into())
        .or_default()
        .insert("wcal-drivers".into());
    graph
        .entry("wcal-verify".into())
        .or_default()
        .insert("wcal-calibration".into());
    graph
        .entry("wcal-report".into())
        .or_default()
        .insert("opencv".into());
    graph
        .entry("wcal-mujoco".into())
        .or_default()
        .insert("mujoco-rs".into());
    // The simulated world knows no MuJoCo, and neither does what is trained on it.
    graph
        .entry("wcal-mesh".into())
        .or_default()
        .insert("wcal-mujoco".into());
    graph
        .entry("wcal-network".into())
        .or_default()
        .insert("wcal-mujoco".into());
    let found = violations(&graph);
    let expected = [
        "wcal-acquisition -> wcal-drivers",
        "wcal-core -> wcal-verify",
        "wcal-drivers -> wcal-session",
        "wcal-mesh -> wcal-mujoco",
        "wcal-mujoco -> mujoco-rs",
        "wcal-network -> wcal-mujoco",
        "wcal-report -> opencv",
        "wcal-verify -> wcal-calibration",
    ];
    assert_eq!(found, expected);
}

/// Crates that a command may use, by itself or through other files of the program: what a reader
/// of the command has to know.
const OF_COMMANDS: [(&str, &[&str]); 14] = [
    ("reduce", &["acquisition"]),
    ("import", &["core", "mesh", "session"]),
    ("twin", &["core", "mujoco", "rod", "session"]),
    ("stage_sweep", &["acquisition", "bench", "core", "drivers"]),
    ("stereo_calibrate", &["core", "vision"]),
    (
        "stereo_shape",
        &["acquisition", "core", "report", "session", "vision"],
    ),
    (
        "fit_whisker",
        &["core", "mujoco", "rod", "session", "vision"],
    ),
    (
        "fit_gpr",
        &["calibration", "core", "gpr", "session", "verify"],
    ),
    ("predict", &["calibration", "core", "session"]),
    (
        "check",
        &["calibration", "core", "report", "session", "verify"],
    ),
    ("calibrate", &["acquisition", "core", "report"]),
    ("export", &["calibration", "core"]),
    (
        "verify",
        &[
            "calibration",
            "core",
            "report",
            "session",
            "track",
            "verify",
        ],
    ),
    (
        "track",
        &[
            "acquisition",
            "bench",
            "calibration",
            "core",
            "drivers",
            "mesh",
            "network",
            "session",
            "track",
            "verify",
        ],
    ),
];

/// Text of a file of the program and of those in its folder, without tests and comments; empty
/// where there is none.
fn program_text(module: &str) -> String {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("calib/cli");
    let mut files = vec![root.join(format!("{module}.rs"))];
    let folder = std::fs::read_dir(root.join(module)).into_iter().flatten();
    files.extend(folder.map(|entry| entry.expect("a readable folder").path()));
    let texts = files
        .iter()
        .map(|file| std::fs::read_to_string(file).unwrap_or_default());
    let code = |text: String| {
        let product = text.split("#[cfg(test)]").next().unwrap_or_default();
        let lines = product
            .lines()
            .filter(|l| !l.trim_start().starts_with("//"));
        lines.collect::<Vec<_>>().join("\n")
    };
    texts.map(code).collect::<Vec<_>>().join("\n")
}

/// Names that follow `prefix` as paths, in groups, too: `crate::{a, b::c}`.
fn named(text: &str, prefix: &str) -> BTreeSet<String> {
    let word = |part: &str| {
        let end = part.find(|c: char| !c.is_alphanumeric() && c != '_');
        part[..end.unwrap_or(part.len())].to_owned()
    };
    let of = |(at, _): (usize, &str)| {
        let rest = &text[at + prefix.len()..];
        match rest.strip_prefix('{') {
            Some(group) => {
                let group = &group[..group.find('}').unwrap_or(group.len())];
                group.split(',').map(|part| word(part.trim())).collect()
            }
            None => vec![word(rest)],
        }
    };
    text.match_indices(prefix).flat_map(of).collect()
}

/// Crates that `text` and the files of the program that it leads to use.
fn crates_of(text: String) -> BTreeSet<String> {
    let (mut seen, mut to_do, mut crates) = (BTreeSet::new(), vec![text], BTreeSet::new());
    while let Some(text) = to_do.pop() {
        crates.extend(named(&text, "wcal_"));
        for module in named(&text, "crate::") {
            if seen.insert(module.clone()) {
                to_do.push(program_text(&module));
            }
        }
    }
    crates
}

#[test]
fn a_command_uses_the_crates_of_its_own_part() {
    for (command, may) in OF_COMMANDS {
        let found = crates_of(program_text(command));
        let found: Vec<&str> = found.iter().map(String::as_str).collect();
        assert_eq!(found, may, "{command}");
    }
    // Control: a file that an import should not read brings its crates along.
    let longer = program_text("import") + "\nuse crate::{input, labels};";
    assert!(crates_of(longer).contains("verify"));
}

/// What `make peers` runs is there: scripts, packages and examples; an example that was deleted
/// stopped it at its first row once.
#[test]
fn every_command_of_the_peers_refers_to_something_that_exists() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let run = |arguments: &[&str]| {
        let mut command = std::process::Command::new("python3");
        command
            .current_dir(root.join("tests/peers"))
            .args(arguments)
            .output()
            .expect("python3 runs")
    };
    let listed = run(&["run_all.py", "--list", "--ycb", "meshes"]);
    assert!(
        listed.status.success(),
        "{}",
        String::from_utf8_lossy(&listed.stderr)
    );
    let all: serde_json::Value = serde_json::from_slice(&listed.stdout).expect("JSON");
    let all: std::collections::BTreeMap<String, Vec<Vec<String>>> =
        serde_json::from_value(all).expect("commands");
    let manifests: Vec<std::path::PathBuf> = ["calib", "rigs", "tests", "calib/mujoco", "lab", "."]
        .iter()
        .flat_map(|d| std::fs::read_dir(root.join(d)).expect("a folder"))
        .map(|entry| entry.expect("an entry").path())
        .chain([root.to_owned()])
        .filter(|folder| folder.join("Cargo.toml").exists())
        .collect();
    let example = |name: &str| {
        manifests
            .iter()
            .any(|m| m.join(format!("examples/{name}.rs")).exists())
    };
    let test = |name: &str| {
        manifests
            .iter()
            .any(|m| m.join(format!("tests/{name}/main.rs")).exists())
    };
    let (mut examples, mut scripts) = (0, 0);
    for command in all.values().flatten() {
        // Another selection of packages would compile all third-party code anew.
        assert!(
            command[0] != "cargo" || command.contains(&"--workspace".to_owned()),
            "{command:?}"
        );
        for pair in command.windows(2).filter(|pair| pair[0] == "--test") {
            assert!(test(&pair[1]), "test {}", pair[1]);
        }
        for name in command
            .iter()
            .filter_map(|word| word.strip_prefix("target/release/examples/"))
        {
            assert!(example(name), "example {name}");
            examples += 1;
        }
        for word in command.iter().filter(|w| w.ends_with(".py")) {
            assert!(std::path::Path::new(word).exists(), "{word}");
            scripts += 1;
        }
    }
    assert!(
        all.len() >= 10 && examples >= 6 && scripts >= 9,
        "{examples} examples, {scripts} scripts"
    );
    assert!(!example("deleted") && !test("deleted"), "control");
    // One that fails is noted, and the next one runs.
    let folder = tempfile::tempdir().expect("temporary folder");
    let program = format!(
        "import sys, pathlib, run_all\nsys.argv = ['x']\nrun_all.ROOT = pathlib.Path({:?})\n\
         run_all.comparisons = lambda ycb: iter([('bad', [['sh', '-c', 'echo torn >&2; exit 7']]), ('good', [['true']])])\n\
         sys.exit(run_all.main())",
        folder.path()
    );
    let failed = run(&["-c", &program]);
    assert_eq!(
        failed.status.code(),
        Some(1),
        "{}",
        String::from_utf8_lossy(&failed.stderr)
    );
    let said = String::from_utf8_lossy(&failed.stdout).into_owned();
    assert!(said.contains("== good"), "{said}");
    let noted = std::fs::read_to_string(folder.path().join("peers-bad.json")).expect("its JSON");
    assert!(
        noted.contains("7: torn") && noted.contains("\"met\": false"),
        "{noted}"
    );
    assert!(!folder.path().join("peers-good.json").exists());
}

/// Calls that open a file by a path. `wcal_core::files` does so for everybody: a pipe would hang
/// the program, a device fill the memory.
const OPENS: [&str; 4] = [
    "fs::read(",
    "fs::read_to_string(",
    "File::open(",
    "stl_io::read",
];

/// Lines of a source that open a file on their own; what stands below `#[cfg(test)]` may.
fn opened(source: &str) -> Vec<&str> {
    let program = source.split("#[cfg(test)]").next().unwrap_or_default();
    program
        .lines()
        .filter(|line| OPENS.iter().any(|call| line.contains(call)))
        .collect()
}

#[test]
fn every_path_is_opened_in_one_place() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = ["calib", "lab/src", "rigs/drivers/src"]
        .map(|d| root.join(d))
        .to_vec();
    let (mut seen, mut wrong) = (0, Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of sources") {
            let path = entry.expect("an entry").path();
            let name = path
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned();
            if path.is_dir() {
                // A program of its own, which opens no path of a person.
                if !["tests", "examples", "benches", "engine"].contains(&name.as_str()) {
                    folders.push(path);
                }
            } else if name.ends_with(".rs")
                && name != "tests.rs"
                && !path.ends_with("core/src/files.rs")
            {
                let text = std::fs::read_to_string(&path).expect("a source");
                wrong.extend(
                    opened(&text)
                        .iter()
                        .map(|line| format!("{}: {}", path.display(), line.trim())),
                );
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

/// Targets of tests that have a module `keeps_time`, by the folder of their `main.rs`.
fn targets_that_keep_time() -> BTreeSet<String> {
    let (mut found, mut folders) = (
        BTreeSet::new(),
        ["calib", "lab", "rigs", "tests"].map(repository).to_vec(),
    );
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let text = std::fs::read_to_string(&path).expect("a source file");
                if text
                    .lines()
                    .any(|l| l.trim_start().starts_with("mod keeps_time"))
                {
                    assert!(
                        path.ends_with("main.rs"),
                        "{}: `make test` would leave it out",
                        path.display()
                    );
                    found.insert(
                        folder
                            .file_name()
                            .expect("a name")
                            .to_string_lossy()
                            .into_owned(),
                    );
                }
            }
        }
    }
    found
}

/// `make test` runs tests that keep time by their targets, and all tests but these by the name of
/// their module, those in documentation with them. Targets of these that the script's run of what
/// keeps time does not name.
fn left_out(script: &str, keep_time: &BTreeSet<String>) -> Vec<String> {
    for needed in [
        "printf -- '--test %s ' $half",
        "--lib --bins $(printf -- '--test %s ' $rest)",
        "$tests --doc",
    ] {
        assert!(script.contains(needed), "{needed}");
    }
    assert_eq!(script.matches("-- --skip keeps_time::").count(), 2);
    let timed = script
        .lines()
        .find(|l| l.ends_with("-- keeps_time::"))
        .expect("the run of what keeps time");
    keep_time
        .iter()
        .filter(|name| !timed.contains(&format!("--test {name}")))
        .cloned()
        .collect()
}

#[test]
fn make_test_leaves_no_test_out() {
    let read =
        |name: &str| std::fs::read_to_string(repository(name)).expect("a file of the repository");
    assert!(read("Makefile").contains("\ttests/run.sh\n"));
    let (script, keep_time) = (read("tests/run.sh"), targets_that_keep_time());
    assert!(
        keep_time.contains("live") && keep_time.contains("drivers"),
        "{keep_time:?}"
    );
    assert_eq!(left_out(&script, &keep_time), Vec::<String>::new());
    let more = keep_time.into_iter().chain(["tea".to_owned()]).collect();
    assert_eq!(left_out(&script, &more), ["tea"], "negative control");
}
