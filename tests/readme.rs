//! Every command of README.md as a reader types it, in an empty folder that has the repository's `fixtures` and `rigs`.
//!
//! A line is one command, continued by a backslash; it must end with exit code 0, or with N where the line says `# exit N`. What is not run
//! as it stands is listed below with the reason.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that fails should say where")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Not run, with the reason.
const LEFT_OUT: [(&str, &str); 2] = [
    ("wcal train", "training: minutes to hours; track_program runs it on a small set"),
    ("wcal evaluate", "needs the model of the training above; track_program runs it"),
];
/// Run with other sizes, with the reason.
const CUT: [(&str, &str, &str); 1] =
    [("--sweeps 50", "--sweeps 2", "600 sweeps take minutes in the profile of the tests")];
/// Sentence of the README that says so.
const SAID: &str =
    "the test of this page makes 2 sweeps instead of 50 and leaves training and evaluation out";
/// Longest wait for the virtual bench's addresses.
const PATIENCE: Duration = Duration::from_secs(60);

fn repository(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// Commands of each `sh` block.
fn blocks(page: &str) -> Vec<Vec<String>> {
    let mut blocks = Vec::new();
    for block in page.split("```sh\n").skip(1) {
        let block = block.split("```").next().unwrap().replace("\\\n", " ");
        blocks.push(block.lines().map(str::trim).filter(|l| !l.is_empty()).map(str::to_owned).collect());
    }
    blocks
}

/// A folder as a reader's, with the repository's data in it.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["fixtures", "rigs"] {
        std::os::unix::fs::symlink(repository(name), folder.path().join(name)).unwrap();
    }
    folder
}

fn shell(folder: &Path, command: &str) -> Command {
    let program = Path::new(env!("CARGO_BIN_EXE_wcal")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let mut shell = Command::new("sh");
    shell.args(["-c", command]).current_dir(folder).env("PATH", path);
    shell
}

/// What a block leaves running.
#[derive(Default)]
struct Running {
    bench: Option<Child>,
    beside: Vec<(String, Child)>,
}

impl Running {
    /// Ends the block: what runs beside must end well, the bench ends with its input.
    fn end(self, wrong: &mut Vec<String>) {
        for (command, child) in self.beside {
            let output = child.wait_with_output().unwrap();
            judge(&command, 0, output.status.code(), &output.stderr, wrong);
        }
        if let Some(mut bench) = self.bench {
            drop(bench.stdin.take());
            judge("wcal virtual-bench", 0, bench.wait().unwrap().code(), b"", wrong);
        }
    }
}

fn judge(command: &str, expected: i32, code: Option<i32>, stderr: &[u8], wrong: &mut Vec<String>) {
    let said = String::from_utf8_lossy(stderr);
    // On a machine that is busy with other things the bench's scans may come late; the program says so.
    let late = command.contains("stage-sweep") && code == Some(3) && said.contains("warning:");
    if code != Some(expected) && !late {
        wrong.push(format!("{command}: expected exit code {expected}, found {code:?}:\n{said}"));
    }
}

/// Runs a page's blocks in one folder; what went wrong.
fn run(page: &str, folder: &Path) -> Vec<String> {
    let mut wrong = Vec::new();
    for block in blocks(page) {
        let mut running = Running::default();
        for line in block {
            let (command, remark) = line.split_once("    # ").unwrap_or((&line, ""));
            let expected = remark.strip_prefix("exit ").map_or(0, |code| code.trim().parse().unwrap());
            if LEFT_OUT.iter().any(|(start, _)| command.starts_with(start)) {
                continue;
            }
            let command = CUT.iter().fold(command.to_owned(), |c, (long, short, _)| c.replace(long, short));
            if command.starts_with("wcal virtual-bench") {
                running.bench = Some(bench(folder, &command));
            } else if let Some(command) = command.strip_suffix('&') {
                let child = shell(folder, command).stdin(Stdio::null()).stderr(Stdio::piped()).spawn();
                running.beside.push((command.to_owned(), child.unwrap()));
            } else {
                let output = shell(folder, &command).stdin(Stdio::null()).output().unwrap();
                judge(&command, expected, output.status.code(), &output.stderr, &mut wrong);
            }
        }
        running.end(&mut wrong);
    }
    wrong
}

/// Starts the bench of a terminal of its own, and waits until it says where it is.
fn bench(folder: &Path, command: &str) -> Child {
    let addresses = folder.join(command.rsplit('>').next().unwrap().trim());
    let _ = fs::remove_file(&addresses);
    let child = shell(folder, command).stdin(Stdio::piped()).spawn().unwrap();
    let start = Instant::now();
    while !fs::read_to_string(&addresses).is_ok_and(|text| text.ends_with('\n')) {
        assert!(start.elapsed() < PATIENCE, "{command}: no addresses within {PATIENCE:?}");
        std::thread::sleep(Duration::from_millis(50));
    }
    child
}

#[test]
fn every_command_of_the_page_runs_and_leaves_what_the_page_says() {
    let page = fs::read_to_string(repository("README.md")).unwrap();
    let all: Vec<String> = blocks(&page).concat();
    assert!(all.len() > 12, "the blocks are found: {all:?}");
    for what in LEFT_OUT.iter().map(|l| l.0).chain(CUT.iter().map(|c| c.0)) {
        assert!(all.iter().any(|line| line.contains(what)), "{what} is listed here and not in README.md");
    }
    assert!(page.replace('\n', " ").contains(SAID), "the page says what the test leaves out");
    let folder = folder();
    let wrong = run(&page, folder.path());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));

    let json = |name: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(folder.path().join(name)).unwrap()).unwrap()
    };
    let of = |name: &str, side: &str| json(name)[side]["response_rmse"].as_f64().unwrap();
    // The numbers of the page, to the digits that it gives.
    let near =
        |found: f64, said: f64, digits: f64| assert!((found - said).abs() <= digits, "{found}, {said}");
    near(of("cell-verified/verify.json", "before"), 2.4e-3, 0.05e-3);
    near(of("cell-verified/verify.json", "after"), 2.1e-4, 0.05e-4);
    near(of("strokes-verified/verify.json", "before"), 10.0, 0.1);
    near(of("strokes-verified/verify.json", "after"), 0.14, 0.005);
    assert_eq!(json("strokes-verified/verify.json")["verdict"], "unknown-effect");
    assert!(!folder.path().join("strokes-verified/calibration.json").exists());
    // What comes from the bench and from rendered pictures says so, what was measured does not.
    for name in ["session/run.json", "verify/verify.json", "track.json"] {
        assert_eq!(json(name)["simulated"], true, "{name}");
    }
    for name in ["fit/calibration.json", "cameras/stereo.json", "shapes/shapes.json"] {
        assert_eq!(json(name)["provenance"]["simulated"], true, "{name}");
    }
    assert_eq!(json("cell-verified/verify.json")["simulated"], false);
    for (name, marked) in [("verify", true), ("shapes", true), ("sweeps", true), ("cell-verified", false)] {
        let page = fs::read_to_string(folder.path().join(name).join("report.html")).unwrap();
        assert_eq!(page.contains("SIMULATED"), marked, "{name}/report.html");
    }
    // The stage moved: contacts came and went.
    let track = fs::read_to_string(folder.path().join("track.csv")).unwrap();
    let probabilities: Vec<f64> =
        track.lines().skip(1).filter_map(|l| l.split(',').nth(6)?.parse().ok()).collect();
    assert!(probabilities.iter().any(|p| *p > 0.9) && probabilities.iter().any(|p| *p < 0.5));
}

#[test]
fn a_command_that_fails_or_ends_otherwise_is_noticed() {
    let folder = folder();
    let page = "```sh\nwcal verify nothing\ntrue    # exit 4\nwcal verify fixtures/whiskerfbg \\\n    --out a    # exit 4\n```\n";
    let wrong = run(page, folder.path());
    assert_eq!(wrong.len(), 2, "{wrong:?}");
    assert!(wrong[0].starts_with("wcal verify nothing") && wrong[1].contains("expected exit code 4"));
}

#[test]
fn pictures_and_files_that_the_page_names_are_there() {
    let page = fs::read_to_string(repository("README.md")).unwrap();
    let named: Vec<&str> = page.split('`').skip(1).step_by(2).chain(page.split("](").skip(1)).collect();
    let paths = named.iter().map(|n| n.split([')', ' ', '\n']).next().unwrap());
    let kept = |p: &&str| ["fixtures/", "rigs/", "docs/", "calib/"].iter().any(|root| p.starts_with(root));
    let paths: Vec<&str> = paths.filter(kept).collect();
    assert!(paths.len() > 8, "{paths:?}");
    for path in paths {
        assert!(repository(path).exists(), "README.md names {path}");
    }
}
