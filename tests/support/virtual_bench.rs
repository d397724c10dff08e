//! A running `wcal virtual-bench` (SIMULATED), ended when it is dropped.

use super::{program, repository};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

/// The process and the file with its addresses.
pub(crate) struct VirtualBench {
    child: Child,
    /// What it printed: one line of JSON.
    pub addresses: PathBuf,
}

impl VirtualBench {
    /// Serves a scenario, written as `NAMEscenario.toml` into the folder; the addresses go into
    /// `NAMEbench.json`.
    pub(crate) fn serve(folder: &Path, name: &str, scenario: &str) -> Self {
        let path = |file: &str| folder.join(format!("{name}{file}"));
        std::fs::write(path("scenario.toml"), scenario).unwrap();
        let mut child = program()
            .args(["virtual-bench", "--scenario"])
            .arg(path("scenario.toml"))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut line)
            .unwrap();
        std::fs::write(path("bench.json"), line).unwrap();
        Self {
            child,
            addresses: path("bench.json"),
        }
    }

    /// Types a fault into it.
    pub(crate) fn type_fault(&mut self, line: &str) {
        writeln!(self.child.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// Sends it a signal.
    pub(crate) fn signal(&self, name: &str) {
        let kill = std::process::Command::new("kill")
            .args([name, &self.child.id().to_string()])
            .status();
        assert!(kill.unwrap().success(), "{name}");
    }

    /// Its input closes, and it ends.
    pub(crate) fn end(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.wait();
    }
}

impl Drop for VirtualBench {
    fn drop(&mut self) {
        self.end();
    }
}

/// The virtual bench's rig, its interrogator at another rate.
pub(crate) fn rig_at(rate_hz: f64) -> String {
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    let standard = "rate_hz = 2000.0";
    assert!(rig.contains(standard), "{standard}");
    rig.replace(standard, &format!("rate_hz = {rate_hz:?}"))
}
