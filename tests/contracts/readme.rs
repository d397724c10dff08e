//! Every command of the guide, and so of README.md, as a reader types it, each page in an empty
//! folder that has the repository's `fixtures` and `rigs`.
//!
//! A line is one command, continued by a backslash; it must end with exit code 0, or with N where
//! the line says `# exit N`. What is not run as it stands is listed below with the reason.

use crate::support::{PROGRAM, repository};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

/// Not run, with the reason.
const LEFT_OUT: [(&str, &str); 2] = [
    (
        "wcal-lab train",
        "training: minutes to hours; lab/tests/commands/models.rs runs it on a small set",
    ),
    (
        "wcal-lab evaluate",
        "needs the model of the training above; lab/tests/commands/models.rs runs it",
    ),
];
/// Run with other sizes, with the reason.
const CUT: [(&str, &str, &str); 1] = [(
    "--sweeps 50",
    "--sweeps 2",
    "600 sweeps take minutes in the profile of the tests",
)];
/// Pages of the guide with commands, and how many each has at least. The blocks of README.md are
/// blocks of the guide.
const PAGES: [(&str, usize); 6] = [
    ("docs/src/guide/start.md", 2),
    ("docs/src/guide/own-table.md", 6),
    ("docs/src/guide/whisker.md", 5),
    ("docs/src/guide/bench.md", 10),
    ("docs/src/guide/pictures.md", 6),
    (TRACKING, 5),
];
const TRACKING: &str = "docs/src/guide/tracking.md";
/// Sentence of that page that says what is cut and left out.
const SAID: &str =
    "the test of this page makes 2 sweeps instead of 50 and leaves training and evaluation out";
/// Longest wait for the virtual bench's addresses.
const PATIENCE: Duration = Duration::from_secs(60);

/// Commands of each `sh` block.
fn blocks(page: &str) -> Vec<Vec<String>> {
    let mut blocks = Vec::new();
    for block in page.split("```sh\n").skip(1) {
        let block = block.split("```").next().unwrap().replace("\\\n", " ");
        blocks.push(
            block
                .lines()
                .map(str::trim)
                .filter(|l| !l.is_empty())
                .map(str::to_owned)
                .collect(),
        );
    }
    blocks
}

/// A folder as a reader's, with the repository's data in it.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for name in ["fixtures", "rigs", "examples"] {
        std::os::unix::fs::symlink(repository(name), folder.path().join(name)).unwrap();
    }
    folder
}

fn shell(folder: &Path, command: &str) -> Command {
    let program = Path::new(PROGRAM).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let mut shell = Command::new("sh");
    shell
        .args(["-c", command])
        .current_dir(folder)
        .env("PATH", path);
    shell
}

/// What a block leaves running.
#[derive(Default)]
struct Running {
    bench: Option<Child>,
    background: Vec<(String, Child)>,
}

impl Running {
    /// Ends the block: what runs in the background must end well, the bench ends with its input.
    fn end(self, wrong: &mut Vec<String>) {
        for (command, child) in self.background {
            let output = child.wait_with_output().unwrap();
            judge(&command, 0, output.status.code(), &output.stderr, wrong);
        }
        if let Some(mut bench) = self.bench {
            drop(bench.stdin.take());
            let output = bench.wait_with_output().unwrap();
            judge(
                "wcal virtual-bench",
                0,
                output.status.code(),
                &output.stderr,
                wrong,
            );
        }
    }
}

fn judge(command: &str, expected: i32, code: Option<i32>, stderr: &[u8], wrong: &mut Vec<String>) {
    let said = String::from_utf8_lossy(stderr);
    let recorded = ["wcal stage-sweep", "wcal reduce"]
        .iter()
        .any(|c| command.starts_with(c));
    // The bench itself says where such a machine kept it from running.
    let behind =
        command.starts_with("wcal virtual-bench") && said.contains("fell behind its clock");
    let late = code == Some(3) && (behind || recorded && only_late(&said));
    if code != Some(expected) && !late {
        wrong.push(format!(
            "{command}: expected exit code {expected}, found {code:?}:\n{said}"
        ));
    }
}

/// On a machine that is busy with other things the bench's scans and pictures may come late:
/// whether the warnings say that and nothing else.
fn only_late(said: &str) -> bool {
    /// Poses of a sweep that a busy machine may leave without pictures (3 of 36 were, beside thirty
    /// other processes on two cores).
    const FEW_POSES: u64 = 6;
    let late = |warning: &str| {
        let (count, what) = warning.split_once(' ').unwrap_or(("", warning));
        let count: u64 = count.parse().unwrap_or(u64::MAX);
        what.starts_with("scans late, by up to")
            || (count == 0 && what.starts_with("rows with scans missing and"))
            || (count <= FEW_POSES && what == "poses without pictures")
    };
    let mut warnings = said
        .lines()
        .filter_map(|l| Some(l.split_once("warning: ")?.1))
        .peekable();
    warnings.peek().is_some() && warnings.all(late)
}

/// Runs a page's blocks in one folder; what went wrong.
fn run(page: &str, folder: &Path) -> Vec<String> {
    let mut wrong = Vec::new();
    for block in blocks(page) {
        let mut running = Running::default();
        for line in block {
            let (command, remark) = line.split_once("    # ").unwrap_or((&line, ""));
            let expected = remark
                .strip_prefix("exit ")
                .map_or(0, |code| code.trim().parse().unwrap());
            if LEFT_OUT.iter().any(|(start, _)| command.starts_with(start)) {
                continue;
            }
            let command = CUT.iter().fold(command.to_owned(), |c, (long, short, _)| {
                c.replace(long, short)
            });
            if command.starts_with("wcal virtual-bench") {
                running.bench = Some(bench(folder, &command));
            } else if let Some(command) = command.strip_suffix('&') {
                let child = shell(folder, command)
                    .stdin(Stdio::null())
                    .stderr(Stdio::piped())
                    .spawn();
                running
                    .background
                    .push((command.to_owned(), child.unwrap()));
            } else {
                let output = shell(folder, &command)
                    .stdin(Stdio::null())
                    .output()
                    .unwrap();
                judge(
                    &command,
                    expected,
                    output.status.code(),
                    &output.stderr,
                    &mut wrong,
                );
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
    let child = shell(folder, command)
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while !fs::read_to_string(&addresses).is_ok_and(|text| text.ends_with('\n')) {
        assert!(
            start.elapsed() < PATIENCE,
            "{command}: no addresses within {PATIENCE:?}"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
    child
}

fn page(name: &str) -> String {
    fs::read_to_string(repository(name)).unwrap()
}

/// Runs a page; the folder with what its commands left.
pub(crate) fn after(name: &str) -> tempfile::TempDir {
    let (page, folder) = (page(name), folder());
    let least = PAGES.iter().find(|p| p.0 == name).unwrap().1;
    let all: Vec<String> = blocks(&page).concat();
    assert!(all.len() >= least, "{name}: the blocks are found: {all:?}");
    let wrong = run(&page, folder.path());
    assert!(wrong.is_empty(), "{name}: {}", wrong.join("\n"));
    folder
}

pub(crate) fn json(folder: &Path, name: &str) -> serde_json::Value {
    serde_json::from_slice(&fs::read(folder.join(name)).unwrap()).unwrap()
}

/// The numbers of a page, to the digits that it gives.
fn near(document: &serde_json::Value, side: &str, said: f64, digits: f64) {
    let found = document[side]["response_rmse"].as_f64().unwrap();
    assert!((found - said).abs() <= digits, "{found}, {said}");
}

pub(crate) fn marked(folder: &Path, report: &str) -> bool {
    fs::read_to_string(folder.join(report))
        .unwrap()
        .contains("SIMULATED")
}

#[test]
fn every_page_with_commands_is_run_and_says_what_is_not() {
    let listed: Vec<&str> = PAGES.iter().map(|p| p.0).collect();
    for entry in fs::read_dir(repository("docs/src/guide")).unwrap() {
        let name = format!(
            "docs/src/guide/{}",
            entry.unwrap().file_name().to_string_lossy()
        );
        assert_eq!(
            listed.contains(&name.as_str()),
            !blocks(&page(&name)).is_empty(),
            "{name} has commands, and is listed"
        );
    }
    let tracking = page(TRACKING);
    for what in LEFT_OUT.iter().map(|l| l.0).chain(CUT.iter().map(|c| c.0)) {
        assert!(
            blocks(&tracking).concat().iter().any(|l| l.contains(what)),
            "{what} is listed here and not in {TRACKING}"
        );
        let others = listed.iter().filter(|n| **n != TRACKING);
        others.for_each(|n| {
            assert!(
                !blocks(&page(n)).concat().iter().any(|l| l.contains(what)),
                "{what} in {n}"
            )
        });
    }
    assert!(
        tracking.replace('\n', " ").contains(SAID),
        "the page says what the test leaves out"
    );
}

/// Blocks of a page that no page of the guide has line for line.
fn own_blocks(page_text: &str) -> Vec<Vec<String>> {
    let guide: Vec<Vec<String>> = PAGES.iter().flat_map(|p| blocks(&page(p.0))).collect();
    blocks(page_text)
        .into_iter()
        .filter(|block| !guide.contains(block))
        .collect()
}

#[test]
fn every_block_of_the_readme_is_one_of_the_guide_which_is_run() {
    let readme = page("README.md");
    assert_eq!(own_blocks(&readme), Vec::<Vec<String>>::new());
    // A new user meets the bench without --force first, then a contact, then a table of his own.
    let commands = blocks(&readme).concat();
    let place = |start: &str| commands.iter().position(|c| c.starts_with(start));
    let order = [
        "wcal virtual-bench",
        "wcal stage-sweep",
        "wcal track",
        "wcal import fixtures/nist",
        "wcal verify cell",
    ]
    .map(|start| place(start).unwrap_or_else(|| panic!("README.md has no {start}")));
    assert!(order.is_sorted(), "{commands:?}");
    assert!(
        !commands.iter().any(|c| c.contains("--force")),
        "{commands:?}"
    );
    assert!(
        commands
            .iter()
            .any(|c| c.contains("--calibration verify/calibration.json"))
    );
    assert_eq!(
        own_blocks("```sh\nwcal verify cell --out elsewhere\n```\n").len(),
        1,
        "negative control"
    );
}

#[test]
fn the_first_run_runs() {
    let folder = after("docs/src/guide/start.md");
    let page = |place: &str| {
        fs::read_to_string(folder.path().join(format!("demo-out/{place}report.html"))).unwrap()
    };
    for place in ["practice-004/", "pontius/", "whiskerfbg/"] {
        assert!(page(place).contains("<svg"), "{place}");
    }
    assert!(page("").contains("error of a contact"));
}

#[test]
fn your_own_table_runs_and_gives_what_the_page_says() {
    let folder = after("docs/src/guide/own-table.md");
    let of = |name: &str| json(folder.path(), name);
    let (cell, strokes) = (
        of("cell-verified/verify.json"),
        of("strokes-verified/verify.json"),
    );
    near(&cell, "before", 2.4e-3, 0.05e-3);
    near(&cell, "after", 2.1e-4, 0.05e-4);
    near(&strokes, "before", 10.2, 0.05);
    near(&strokes, "after", 0.16, 0.005);
    assert_eq!(
        (&cell["simulated"], &strokes["verdict"]),
        (&false.into(), &"unknown-effect".into())
    );
    assert!(
        !folder
            .path()
            .join("strokes-verified/calibration.json")
            .exists()
    );
    assert!(!marked(folder.path(), "cell-verified/report.html"));
}

#[test]
fn the_whisker_runs() {
    after("docs/src/guide/whisker.md");
}

#[test]
fn the_pictures_run_and_mark_what_they_leave() {
    let folder = after("docs/src/guide/pictures.md");
    for name in ["cameras/stereo.json", "shapes/shapes.json"] {
        assert_eq!(
            json(folder.path(), name)["provenance"]["simulated"],
            true,
            "{name}"
        );
    }
    assert!(marked(folder.path(), "shapes/report.html"));
}

#[test]
fn the_sweeps_run_and_mark_what_they_leave() {
    let folder = after(TRACKING);
    assert_eq!(
        json(folder.path(), "sweeps/dataset.json")["simulated"],
        true
    );
}

#[test]
fn a_command_that_fails_or_ends_otherwise_is_noticed() {
    let folder = folder();
    let page = "```sh\nwcal verify nothing\ntrue    # exit 4\nwcal verify fixtures/whiskerfbg \\\n    --out a    # exit 4\n```\n";
    let wrong = run(page, folder.path());
    assert_eq!(wrong.len(), 2, "{wrong:?}");
    assert!(wrong[0].starts_with("wcal verify nothing") && wrong[1].contains("code 4"));
    // Exit code 3 of a sweep is taken for late scans alone.
    let of = |command: &str, said: &str| {
        let mut wrong = Vec::new();
        judge(command, 0, Some(3), said.as_bytes(), &mut wrong);
        wrong.is_empty()
    };
    let judged = |said: &str| of("wcal stage-sweep --out s", said);
    let late = "stage-sweep: warning: 12 scans late, by up to 0.4 s of the bench's time: the bench or this computer fell behind\n\
                stage-sweep: warning: 0 rows with scans missing and 2 with late scans or clocks that cannot be aligned, marked in the column `stream`\n";
    assert!(judged(late));
    for more in [
        "3 scans lost in 1 gaps",
        "1 windows whose signal did not settle",
        "1 rows with scans missing and 2 with late scans",
        "7 poses without pictures",
    ] {
        assert!(
            !judged(&format!("{late}stage-sweep: warning: {more}\n")),
            "{more}"
        );
    }
    assert!(judged("stage-sweep: warning: 3 poses without pictures\n"));
    assert!(!judged("") && !judged("stage-sweep: warning: 2 camera pairs refused"));
    // And of the bench for a computer that kept it from running.
    let behind = "virtual-bench: warning: fell behind its clock by 0.3 s of bench time";
    assert!(of("wcal virtual-bench", behind) && !of("wcal virtual-bench", ""));
    assert!(!of("wcal verify s", behind));
}
