//! The stage maker's own client (zaber-motion, from PyPI, in a virtual environment of its own)
//! against the virtual stage.

use crate::common::start;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use wcal_drivers::bench::faults;

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../..")
        .join(path)
}

/// The environment's interpreter; made on first use.
fn python() -> PathBuf {
    let environment = repository("tests/peers/.venv-zaber");
    let python = environment.join("bin/python");
    let good =
        |command: &mut Command| assert!(command.status().expect("runs").success(), "{command:?}");
    if !python.exists() {
        good(
            Command::new("python3")
                .args(["-m", "venv"])
                .arg(&environment),
        );
    }
    good(Command::new(&python).args(["-m", "pip", "install", "-q", "zaber-motion"]));
    python
}

/// TCP and PTY, with and without checksums; a lost reply as negative control. The client is told
/// the addresses and asks for faults on its output.
#[test]
#[ignore = "fetches zaber-motion from PyPI; `make peers` runs it"]
fn the_makers_client_works_against_the_virtual_stage() {
    use std::io::{BufRead, BufReader, Write};
    let scenario = "format = \"wcal-scenario/1\"\nspeed = 10\n[cameras]\ncount = 0\n";
    let bench = start(scenario);
    let mut client = Command::new(python())
        .arg(repository("tests/peers/zaber_motion_session.py"))
        .arg(serde_json::to_string(bench.addresses()).unwrap())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut answers = client.stdin.take().unwrap();
    let mut rows = Vec::new();
    for line in BufReader::new(client.stdout.take().unwrap())
        .lines()
        .map_while(Result::ok)
    {
        match line.strip_prefix("inject ") {
            Some(fault) => {
                bench.inject(faults::parse(fault).unwrap());
                writeln!(answers, "done").unwrap();
            }
            None => rows.push(line),
        }
    }
    println!("{}", rows.join("\n"));
    assert!(client.wait().unwrap().success());
    assert!(
        rows.len() > 50 && rows.iter().all(|r| r.starts_with("ok")),
        "{rows:?}"
    );
}
