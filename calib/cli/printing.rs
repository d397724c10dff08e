//! What the commands print: `println!` and its siblings, for every file of the program.
//!
//! A reader that has seen enough (`wcal ... | head`) closes the pipe. What remains to print is
//! dropped then, and the command goes on: its result lies in files, and a stage that moves must be
//! brought to rest. A full disk is no such reader: the program says so at its end.

use crate::kept::{Stream, take};
use std::fmt::Arguments;
use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;
use std::sync::OnceLock;

/// The first error of a write that mattered.
static FAILED: OnceLock<String> = OnceLock::new();

/// Writes to stdout.
pub fn to_stdout(text: Arguments<'_>) {
    if take(Stream::Out, text) {
        return;
    }
    let written = write(&mut io::stdout().lock(), text);
    if let Err(e) = written {
        let _ = FAILED.set(format!("writing to stdout: {e}"));
    }
}

/// Writes to stderr; where that takes nothing there is nobody to tell.
pub fn to_stderr(text: Arguments<'_>) {
    if !take(Stream::Err, text) {
        let _ = write(&mut io::stderr().lock(), text);
    }
}

/// What could not be written, if anything.
pub fn failed() -> Option<&'static str> {
    FAILED.get().map(String::as_str)
}

fn write(to: &mut impl Write, text: Arguments<'_>) -> io::Result<()> {
    match to.write_fmt(text).and_then(|()| to.flush()) {
        Err(e) if e.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// As of the standard library, without the panic where nobody reads.
#[macro_export]
macro_rules! print {
    ($($text:tt)*) => { $crate::printing::to_stdout(format_args!($($text)*)) };
}

/// See [`print!`].
#[macro_export]
macro_rules! println {
    () => { $crate::printing::to_stdout(format_args!("\n")) };
    ($($text:tt)*) => { $crate::printing::to_stdout(format_args!("{}\n", format_args!($($text)*))) };
}

/// See [`print!`].
#[macro_export]
macro_rules! eprintln {
    () => { $crate::printing::to_stderr(format_args!("\n")) };
    ($($text:tt)*) => { $crate::printing::to_stderr(format_args!("{}\n", format_args!($($text)*))) };
}

/// The exit code of a result: 3 where something about it matters.
pub(crate) fn exit_code(clean: bool) -> ExitCode {
    ExitCode::from(if clean { 0 } else { 3 })
}

#[cfg(test)]
mod tests {
    use super::write;
    use std::io::{Error, ErrorKind, Result, Write};

    struct Full(ErrorKind);

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> Result<usize> {
            Err(Error::from(self.0))
        }

        fn flush(&mut self) -> Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_reader_that_left_is_no_error_and_a_full_disk_is_one() {
        assert!(write(&mut Full(ErrorKind::BrokenPipe), format_args!("x")).is_ok());
        assert!(write(&mut Full(ErrorKind::StorageFull), format_args!("x")).is_err());
    }
}
