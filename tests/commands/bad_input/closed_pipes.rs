//! `wcal ... | head`: a reader that closes its end early ends no command with an error of its own.

use super::*;
use crate::support::copy::copy_folder;
use crate::support::program;
use std::process::Stdio;

/// What the command ends with where nobody reads its outputs.
fn unread(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = program();
    let closed = || {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        Stdio::from(writer)
    };
    command
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(closed())
        .stderr(closed());
    command.output().unwrap()
}

/// Names of the commands.
fn commands() -> Vec<String> {
    let help = wcal(Path::new("."), &["--help"]);
    let text = String::from_utf8_lossy(&help.stdout).into_owned();
    let list = text
        .split("Commands:")
        .nth(1)
        .unwrap()
        .split("Options:")
        .next()
        .unwrap();
    let names: Vec<String> = list
        .lines()
        .filter_map(|line| line.strip_prefix("  ").filter(|l| !l.starts_with(' ')))
        .filter_map(|line| line.split(' ').next().map(str::to_owned))
        .collect();
    assert!(names.len() > 12, "{names:?}");
    names
}

#[test]
fn every_help_ends_quietly_where_nobody_reads() {
    let place = tempfile::tempdir().unwrap();
    for name in commands().into_iter().filter(|name| name != "help") {
        let output = unread(place.path(), &[&name, "--help"]);
        assert_eq!(output.status.code(), Some(0), "{name} --help");
    }
    assert_eq!(unread(place.path(), &["--version"]).status.code(), Some(0));
}

/// A command whose reader left ends as it does with one, and its files are the same.
#[test]
fn every_result_is_complete_where_nobody_reads() {
    let place = tempfile::tempdir().unwrap();
    let repository = Path::new(env!("CARGO_MANIFEST_DIR"));
    let copied = |from: &str, to: &str| {
        copy_folder(&repository.join(from), &place.path().join(to));
    };
    copied("fixtures/nist/pontius", "s");
    copied("rigs/virtual", "rig");
    let write = |name: &str, text: &str| fs::write(place.path().join(name), text).unwrap();
    write("c.json", &calibrations::whisker_calibration().to_string());
    write(
        "t.csv",
        "point,t_s,fbg_1_nm,fbg_2_nm\n1,0,1541.21,1535.81\n",
    );
    write("xy.csv", "x,y\n1,2.5\n2,4.5\n");
    let plan = repository.join("rigs/plans/paper-27.toml");
    let plan = plan.to_str().unwrap();
    let mut ran = 0;
    for arguments in [
        &["verify", "s", "--check"][..],
        &["verify", "s", "--check", "--json"],
        &["verify", "s", "--out", "o", "--json"],
        &[
            "predict",
            "t.csv",
            "--calibration",
            "c.json",
            "--out",
            "o.csv",
        ],
        &[
            "import",
            "xy.csv",
            "--kind",
            "axis",
            "--commanded",
            "x",
            "--measured",
            "y",
            "--out",
            "o",
        ],
        &["stage-sweep", "--rig", "rig", "--plan", plan, "--dry-run"],
        &[
            "stage-sweep",
            "--rig",
            "rig",
            "--plan",
            plan,
            "--dry-run",
            "--json",
        ],
        &["virtual-bench", "--scenario", "rig/scenario.toml"],
        &["verify", "nothing", "--check"],
    ] {
        let run = |run: &dyn Fn(&Path, &[&str]) -> Output| {
            let own = tempfile::tempdir().unwrap();
            copy_folder(place.path(), own.path());
            let code = run(own.path(), arguments).status.code();
            (code, listing(own.path()))
        };
        let read = run(&|folder, arguments| {
            let mut command = program();
            command
                .args(arguments)
                .current_dir(folder)
                .stdin(Stdio::null())
                .output()
                .unwrap()
        });
        assert_eq!(run(&unread), read, "{arguments:?}");
        ran += 1;
    }
    assert_eq!(ran, 9);
}

/// A disk that takes nothing is no reader that left: the program says so.
#[test]
fn a_full_disk_is_an_error() {
    let full = fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let mut command = program();
    let session = Path::new(env!("CARGO_MANIFEST_DIR")).join("fixtures/nist/pontius");
    let output = command
        .arg("verify")
        .arg(session)
        .arg("--check")
        .stdout(full)
        .output()
        .unwrap();
    judge(&output, 1, &["writing to stdout"]).unwrap();
}
