//! The program `wcal`.

use std::process::ExitCode;

fn main() -> ExitCode {
    wcal::main()
}
