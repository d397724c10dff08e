//! Both programs, and the repository's files.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Path of `wcal-lab`.
pub(crate) const PROGRAM: &str = env!("CARGO_BIN_EXE_wcal-lab");

/// A file or folder of the repository.
pub(crate) fn repository(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name)
}

/// `wcal-lab`, not yet started.
pub(crate) fn program() -> Command {
    Command::new(PROGRAM)
}

/// The program that has this command, not yet started: `wcal` lies beside `wcal-lab` in a build of
/// the workspace.
pub(crate) fn program_of(command: &str) -> Command {
    if ["simulate", "train", "evaluate"].contains(&command) {
        return program();
    }
    let wcal = Path::new(PROGRAM).with_file_name("wcal");
    assert!(wcal.is_file(), "{}: build the workspace", wcal.display());
    Command::new(wcal)
}

/// Runs the program that has this command to its end.
pub(crate) fn run(arguments: &[&str]) -> Output {
    program_of(arguments[0]).args(arguments).output().unwrap()
}

/// What a program printed.
pub(crate) fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}
