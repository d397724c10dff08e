//! A test that needs what a machine may lack says that it was not run; in CI it fails.

use std::fmt::Display;
use std::io::Write as _;

/// Says so past the harness, which keeps to itself what passed tests print.
///
/// # Panics
/// Where `CI` is set: there nothing may be left out in silence.
pub(crate) fn not_run(why: impl Display) {
    refuse(std::env::var_os("CI").is_some(), &why);
    let _ = writeln!(std::io::stderr(), "NOT RUN: {why}");
}

fn refuse(ci: bool, why: &impl Display) {
    assert!(!ci, "CI is set, and a test cannot run: {why}");
}

#[test]
#[should_panic(expected = "CI is set, and a test cannot run: no bench")]
fn in_ci_nothing_is_left_out_in_silence() {
    refuse(false, &"no bench");
    refuse(true, &"no bench");
}
