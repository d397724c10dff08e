//! The commands of `wcal` for Python, as one function; tables and results are the work of
//! `wcal/__init__.py`.

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

/// Time within which Ctrl-C is heard.
const POLL: Duration = Duration::from_millis(100);
/// Stack of the thread that computes, bytes: that of a main thread.
const STACK: usize = 8 << 20;

/// Exit code, error, stdout and stderr.
type Answer = (u8, Option<String>, String, String);

/// Runs a command line of wcal without printing: its exit code, its error (or None), stdout, stderr.
///
/// The GIL is released meanwhile. Ctrl-C returns at once; the computation ends at its next step.
#[pyfunction]
fn run(py: Python<'_>, words: Vec<String>) -> PyResult<Answer> {
    let stop = Arc::<AtomicBool>::default();
    let (heard, (done, mut answer)) = (Arc::clone(&stop), channel::<wcal::Ran>());
    std::thread::Builder::new()
        .name("wcal".to_owned())
        .stack_size(STACK)
        .spawn(move || {
            let words: Vec<&str> = words.iter().map(String::as_str).collect();
            // After Ctrl-C nobody waits for it.
            let _ = done.send(wcal::run_kept(&words, heard));
        })?;
    loop {
        let (back, found) = py.detach(move || {
            let found = answer.recv_timeout(POLL);
            (answer, found)
        });
        answer = back;
        match found {
            Ok(ran) => return Ok((ran.code, ran.error, ran.stdout, ran.stderr)),
            Err(RecvTimeoutError::Timeout) => py
                .check_signals()
                .inspect_err(|_| stop.store(true, Ordering::Relaxed))?,
            Err(RecvTimeoutError::Disconnected) => {
                let said = "expected an answer of wcal, found the end of its thread";
                return Err(PyRuntimeError::new_err(said));
            }
        }
    }
}

/// The commands of `wcal`.
#[pymodule]
mod _wcal {
    #[pymodule_export]
    use super::run;
}
