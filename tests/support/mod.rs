//! What the tests of all targets share: the program, the repository's files, a virtual bench.

pub(crate) mod board_pictures;
pub(crate) mod copy;
pub(crate) mod drawn_boards;
pub(crate) mod not_run;
pub(crate) mod packages;
pub(crate) mod recordings;
pub(crate) mod virtual_bench;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Path of the program.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_wcal");

/// A file or folder of the repository.
pub(crate) fn repository(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// A file or folder below `fixtures`.
pub(crate) fn fixture(name: &str) -> PathBuf {
    repository("fixtures").join(name)
}

/// The program, not yet started.
pub(crate) fn program() -> Command {
    Command::new(PROGRAM)
}

/// The program that has this command, not yet started: `wcal-lab` lies beside `wcal` in a build of
/// the workspace.
///
/// # Panics
/// Where `wcal-lab` is asked for and not there.
pub(crate) fn program_of(command: &str) -> Command {
    if !["simulate", "train", "evaluate"].contains(&command) {
        return program();
    }
    let lab = Path::new(PROGRAM).with_file_name("wcal-lab");
    assert!(lab.is_file(), "{}: build the workspace", lab.display());
    Command::new(lab)
}

/// Runs the program to its end.
pub(crate) fn wcal(arguments: &[&str]) -> Output {
    program().args(arguments).output().unwrap()
}

/// Exit code and messages of a run.
///
/// # Panics
/// Where the program did.
pub(crate) fn code_and_messages(arguments: &[&str]) -> (i32, String) {
    let run = wcal(arguments);
    let messages = text(&run.stderr);
    assert!(!messages.contains("panicked"), "{messages}");
    (run.status.code().unwrap(), messages)
}

/// What a program printed.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Waits for what must come, however busy the machine is.
///
/// # Panics
/// Where it does not come within ten minutes: something hangs.
#[track_caller]
pub(crate) fn until(what: &str, mut there: impl FnMut() -> bool) {
    let start = std::time::Instant::now();
    while !there() {
        assert!(start.elapsed().as_secs() < 600, "hangs: {what}");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
}
