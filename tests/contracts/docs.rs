//! What the pages say is there: links, pages of the book, commands and their options, files, and
//! the keys of the files that people write.

use crate::support::{program, repository};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Folders that a page's `path` in backticks may begin with.
const ROOTS: [&str; 11] = [
    "calib/",
    "rigs/",
    "tests/",
    "fixtures/",
    "docs/",
    "examples/",
    "firmware-notes/",
    "fuzz/",
    "packaging/",
    "python/",
    ".ci/",
];

/// Files of the repository, by path; what a build writes and what git keeps are none.
fn files() -> Vec<String> {
    let (mut names, mut folders) = (Vec::new(), vec![String::new()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(repository(&folder)).unwrap() {
            let entry = entry.unwrap();
            let name = format!("{folder}{}", entry.file_name().to_string_lossy());
            if !entry.file_type().unwrap().is_dir() {
                names.push(name);
            } else if name == ".ci"
                || !(name.starts_with('.') || ["target", "native"].contains(&name.as_str()))
            {
                folders.push(name + "/");
            }
        }
    }
    names
}

/// Every page by its path in the repository: the book, and what stands beside code and data.
fn pages() -> BTreeMap<String, String> {
    let pages = files().into_iter().filter(|n| n.ends_with(".md"));
    pages
        .map(|n| (n.clone(), fs::read_to_string(repository(&n)).unwrap()))
        .collect()
}

/// The page without its fenced blocks, and those blocks' lines.
fn parts(page: &str) -> (String, Vec<String>) {
    let (mut prose, mut code) = (String::new(), Vec::new());
    for (k, part) in page.split("```").enumerate() {
        if k % 2 == 0 {
            prose.push_str(part)
        } else {
            code.extend(part.replace("\\\n", " ").lines().map(str::to_owned))
        }
    }
    (prose, code)
}

/// The code of a page: its fenced blocks' lines, and what its text has in backticks.
fn code(page: &str) -> impl Iterator<Item = String> {
    let (prose, code) = parts(page);
    let spans: Vec<String> = prose
        .split('`')
        .skip(1)
        .step_by(2)
        .map(str::to_owned)
        .collect();
    code.into_iter().chain(spans)
}

/// No page has anything wrong, and the control has all of this. The changelog tells of what went.
#[track_caller]
fn nothing_wrong(wrong: impl Fn(&str, &str) -> Vec<String>, control: &str, expected: &[&str]) {
    for (name, page) in pages().iter().filter(|p| p.0 != "CHANGELOG.md") {
        assert_eq!(wrong(name, page), Vec::<String>::new(), "{name}");
    }
    assert_eq!(wrong("README.md", control), expected, "negative control");
}

/// Anchors of a page's headings, as the book and GitHub make them.
fn anchors(page: &str) -> BTreeSet<String> {
    let headings = page
        .lines()
        .filter(|l| l.starts_with('#'))
        .map(|l| l.trim_start_matches('#').trim());
    let slug = |h: &str| -> String {
        let kept = h
            .to_lowercase()
            .chars()
            .filter(|c| c.is_alphanumeric() || " -_".contains(*c))
            .collect::<String>();
        kept.replace(' ', "-")
    };
    headings.map(slug).collect()
}

/// Links of a page that lead nowhere.
fn dead_links(name: &str, page: &str) -> Vec<String> {
    let folder = repository(name).parent().unwrap().to_owned();
    let (prose, _) = parts(page);
    let targets = prose
        .split("](")
        .skip(1)
        .filter_map(|t| t.split(')').next())
        .map(str::to_owned);
    let dead = |target: &String| {
        if target.contains("://") {
            return false;
        }
        let (path, anchor) = target
            .split_once('#')
            .map_or((target.as_str(), None), |(p, a)| (p, Some(a)));
        let file = if path.is_empty() {
            repository(name)
        } else {
            folder.join(path)
        };
        let lacks =
            |a: &str| !fs::read_to_string(&file).is_ok_and(|text| anchors(&text).contains(a));
        !file.exists() || anchor.is_some_and(lacks)
    };
    targets.filter(dead).collect()
}

#[test]
fn no_link_is_dead() {
    let changes = fs::read_to_string(repository("CHANGELOG.md")).unwrap();
    assert_eq!(dead_links("CHANGELOG.md", &changes), Vec::<String>::new());
    let bad = "[a](none.md) [b](README.md#nowhere) [c](README.md) [d](https://example.org/x)";
    nothing_wrong(dead_links, bad, &["none.md", "README.md#nowhere"]);
}

#[test]
fn the_book_has_every_page() {
    let summary = fs::read_to_string(repository("docs/src/SUMMARY.md")).unwrap();
    let missing = |all: &[String]| -> Vec<String> {
        let of = |n: &&String| {
            n.strip_prefix("docs/src/")
                .is_some_and(|n| n != "SUMMARY.md" && !summary.contains(&format!("({n})")))
        };
        all.iter().filter(of).cloned().collect()
    };
    let all: Vec<String> = pages().into_keys().collect();
    assert_eq!(missing(&all), Vec::<String>::new());
    assert_eq!(
        missing(&["docs/src/lost.md".to_owned()]),
        ["docs/src/lost.md"],
        "negative control"
    );
}

fn help(arguments: &[&str]) -> String {
    let output = program().args(arguments).output().unwrap();
    String::from_utf8(output.stdout).unwrap()
}

/// The program's commands, each with its help.
fn commands() -> BTreeMap<String, String> {
    let list = help(&["--help"]);
    let list = list
        .split("Commands:")
        .nth(1)
        .unwrap()
        .split("Options:")
        .next()
        .unwrap();
    let names = list
        .lines()
        .filter(|l| l.starts_with("  ") && !l.starts_with("   "));
    names
        .filter_map(|l| l.split_whitespace().next())
        .map(|n| (n.to_owned(), help(&[n, "--help"])))
        .collect()
}

/// Commands and options in code that the program does not have.
fn unknown_commands(page: &str, commands: &BTreeMap<String, String>) -> Vec<String> {
    let mut unknown = Vec::new();
    let code: Vec<String> = code(page).collect();
    for line in code.iter().flat_map(|c| c.split([';', '|'])) {
        let Some(rest) = line.trim().strip_prefix("wcal ") else {
            continue;
        };
        let line = rest.split("    # ").next().unwrap();
        let mut words = line.split_whitespace();
        let Some(name) = words
            .next()
            .filter(|w| w.chars().all(|c| c.is_ascii_lowercase() || c == '-'))
        else {
            continue;
        };
        if name.starts_with("--") {
            continue;
        }
        let Some(help) = commands.get(name) else {
            unknown.push(format!("wcal {name}"));
            continue;
        };
        let options = words.filter_map(|w| w.trim_start_matches('[').strip_prefix("--"));
        let option = |w: &str| w.split(['=', ']']).next().unwrap_or_default().to_owned();
        let lacking = options
            .map(option)
            .filter(|o| !help.contains(&format!("--{o}")) && o != "help");
        unknown.extend(lacking.map(|o| format!("wcal {name} --{o}")));
    }
    unknown
}

#[test]
fn every_command_and_option_that_a_page_names_is_there() {
    let commands = commands();
    assert!(commands.len() > 12, "{:?}", commands.keys());
    let bad = "`wcal verify S --out D` `wcal brew tea`\n```sh\nwcal verify S --sugar 2\n```\n";
    let wrong = |_: &str, page: &str| unknown_commands(page, &commands);
    nothing_wrong(wrong, bad, &["wcal verify --sugar", "wcal brew"]);
}

/// Files and folders of the repository in backticks that are not there.
fn missing_files(page: &str) -> Vec<String> {
    let code: Vec<String> = code(page).collect();
    let of_ours =
        |w: &&str| ROOTS.iter().any(|root| w.starts_with(root)) && !w.contains(['*', '<']);
    let words = code.iter().flat_map(|s| s.split_whitespace());
    words
        .filter(of_ours)
        .map(|w| w.trim_end_matches([',', ';', ':', ')']).to_owned())
        .filter(|p| !repository(p).exists())
        .collect()
}

#[test]
fn every_file_that_a_page_names_is_there() {
    assert!(pages()["docs/src/method.md"].contains("`calib/"));
    let bad = "`calib/nowhere/lib.rs` and `calib/core`";
    nothing_wrong(
        |_, page| missing_files(page),
        bad,
        &["calib/nowhere/lib.rs"],
    );
}

/// Source files that a page names without a folder of `ROOTS`, and that no file of the repository
/// is called by.
fn missing_sources(page: &str, files: &[String]) -> Vec<String> {
    let (prose, _) = parts(page);
    let spans = prose
        .split('`')
        .skip(1)
        .step_by(2)
        .filter_map(|s| s.split([' ', ':']).next());
    let bare = |s: &&str| {
        s.ends_with(".rs") && !s.contains(['*', '<']) && !ROOTS.iter().any(|r| s.starts_with(r))
    };
    let lacking = |s: &&str| {
        let inner = format!("/{s}");
        !files.iter().any(|f| f == s || f.ends_with(&inner))
    };
    spans
        .filter(bare)
        .filter(lacking)
        .map(str::to_owned)
        .collect()
}

#[test]
fn every_source_file_that_a_page_names_by_its_last_part_is_there() {
    let files = files();
    let bad = "`method/fit.rs`, `nowhere/fit.rs`, `lost.rs` and `fit.rs:12`";
    let wrong = |_: &str, page: &str| missing_sources(page, &files);
    nothing_wrong(wrong, bad, &["nowhere/fit.rs", "lost.rs"]);
}

/// Examples, tests, benches and programs of the workspace as `cargo` names them: `--example NAME`
/// and so on, and the modules of a test: `--test NAME MODULE::`.
fn targets() -> BTreeSet<String> {
    let metadata = super::layering::metadata();
    let packages = metadata["packages"].as_array().unwrap().iter();
    let all = packages.flat_map(|p| p["targets"].as_array().unwrap());
    let mut names = BTreeSet::new();
    for target in all {
        let name = format!(
            "--{} {}",
            target["kind"][0].as_str().unwrap(),
            target["name"].as_str().unwrap()
        );
        let folder = Path::new(target["src_path"].as_str().unwrap())
            .parent()
            .unwrap();
        if name.starts_with("--test ") && target["src_path"].as_str().unwrap().ends_with("/main.rs")
        {
            let files = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
            let stems = files.filter_map(|f| Some(f.file_stem()?.to_str()?.to_owned()));
            names.extend(stems.map(|stem| format!("{name} {stem}::")));
        }
        names.insert(name);
    }
    names
}

/// Targets of `cargo` and of the Makefile that a page names and that are not there. A name in
/// capitals stands for any.
fn missing_targets(page: &str, targets: &BTreeSet<String>, make: &BTreeSet<String>) -> Vec<String> {
    let mut missing = Vec::new();
    for line in code(page) {
        let words: Vec<&str> = line.split_whitespace().collect();
        // Programs of ours have options of these names too.
        let of_cargo = words.contains(&"cargo") || line.starts_with("--");
        for pair in words.windows(2).filter(|_| of_cargo) {
            let target = pair.join(" ");
            if ["--example", "--test", "--bench", "--bin"].contains(&pair[0])
                && pair[1].contains(|c: char| c.is_lowercase())
                && !targets.contains(&target)
            {
                missing.push(target);
            }
        }
        let modules = words
            .windows(3)
            .filter(|w| of_cargo && w[0] == "--test" && w[2].contains("::"));
        for three in modules.filter(|w| w[2].contains(|c: char| c.is_lowercase())) {
            let module = three[2].split("::").next().unwrap_or_default();
            let target = format!("--test {} {module}::", three[1]);
            if !targets.contains(&target) {
                missing.push(target);
            }
        }
        if let ["make", target, ..] = words[..]
            && !make.contains(target)
        {
            missing.push(format!("make {target}"));
        }
    }
    missing
}

#[test]
fn every_target_that_a_page_names_is_there() {
    let targets = targets();
    let makefile = fs::read_to_string(repository("Makefile")).unwrap();
    let make: BTreeSet<String> = makefile
        .lines()
        .filter(|l| !l.starts_with([' ', '\t', '#', '.']) && !l.contains('='))
        .filter_map(|l| Some(l.split_once(':')?.0.to_owned()))
        .collect();
    let bad = "`cargo run --example brew_tea -- --draws 2`, `make tea`, `wcal verify --bench bench`\n```sh\ncargo test --test contracts docs:: --bench tea\ncargo test --test contracts tea::leaves\nmake docs\n```\n`--test NAME`";
    let wrong = |_: &str, page: &str| missing_targets(page, &targets, &make);
    let expected = [
        "--bench tea",
        "--test contracts tea::",
        "--example brew_tea",
        "make tea",
    ];
    nothing_wrong(wrong, bad, &expected);
}

/// Keys of a TOML document, those of its tables too.
fn keys(table: &toml::Table, out: &mut BTreeSet<String>) {
    for (key, value) in table {
        out.insert(key.clone());
        let tables = match value {
            toml::Value::Table(inner) => vec![inner],
            toml::Value::Array(items) => items.iter().filter_map(toml::Value::as_table).collect(),
            _ => Vec::new(),
        };
        // What a unit says of itself is the unit's, and where data come from is free.
        if !["devices", "controls", "provenance"].contains(&key.as_str()) {
            tables.into_iter().for_each(|t| keys(t, out));
        }
    }
}

/// Whether the reference has a key or table in backticks.
fn names(reference: &str, key: &str) -> bool {
    [
        format!("`{key}`"),
        format!("`[{key}]`"),
        format!("`[[{key}]]`"),
    ]
    .iter()
    .any(|name| reference.contains(name))
}

/// Keys of a text that the reference does not have.
fn unnamed_keys(text: &str, reference: &str) -> Vec<String> {
    let mut all = BTreeSet::new();
    keys(&text.parse().unwrap(), &mut all);
    all.into_iter().filter(|k| !names(reference, k)).collect()
}

#[test]
fn every_key_of_the_files_that_people_write_stands_in_the_reference() {
    let reference = fs::read_to_string(repository("docs/src/formats.md")).unwrap();
    let files = [
        "examples/templates/session.toml",
        "examples/templates/rig.toml",
        "examples/templates/plan.toml",
        "lab/sweeps.toml",
        "rigs/paper/rig.toml",
        "rigs/virtual/rig.toml",
        "rigs/virtual/scenario.toml",
        "rigs/plans/rich.toml",
        "fixtures/stereo_bench/rig.toml",
        "fixtures/whiskerfbg/session.toml",
        "fixtures/practice/case-004/session.toml",
        "fixtures/nist/pontius/session.toml",
        "fixtures/pneumatic/pk-7bar/session.toml",
    ];
    for file in files {
        let text = fs::read_to_string(repository(file)).unwrap();
        assert_eq!(
            unnamed_keys(&text, &reference),
            Vec::<String>::new(),
            "{file}"
        );
        // Keys that a template only shows in a comment are keys, too.
        let shown = text
            .lines()
            .filter_map(|l| l.strip_prefix("# ")?.split_once(" = "))
            .map(|(key, _)| key);
        let plain = |k: &&str| {
            k.chars()
                .all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_')
        };
        let lacking: Vec<&str> = shown
            .filter(plain)
            .filter(|k| !names(&reference, k))
            .collect();
        assert_eq!(lacking, Vec::<&str>::new(), "{file}, in comments");
    }
    assert_eq!(
        unnamed_keys("[stage]\nshoe_size = 43", &reference),
        ["shoe_size"],
        "negative control"
    );
}
