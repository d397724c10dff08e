//! Runs of the program under limits: a minute of processor time, ten by the clock, and 8 GB of
//! address space. What goes past them would stop a bench or a machine.

use super::*;
use std::ffi::OsStr;

/// `wcal ARGUMENTS` under the limits, nothing on its input. Exit code 124: by the clock; a signal:
/// by the processor's time. The clock's limit is wide: what waits takes no time of a processor, and
/// a busy machine makes everything long.
pub(crate) fn limited(folder: &Path, arguments: &[&str]) -> Output {
    let script = "ulimit -v 8000000; ulimit -t 60; exec timeout 600 \"$0\" \"$@\" < /dev/null";
    let program = program_of(arguments[0]);
    let script = [OsStr::new("-c"), script.as_ref(), program.get_program()];
    Command::new("sh")
        .args(script)
        .args(arguments)
        .current_dir(folder)
        .output()
        .unwrap()
}

/// Both outputs, and why the run is none that a user may meet: a signal, a panic, a hang, no
/// memory.
pub(crate) fn sound(output: &Output) -> Result<String, String> {
    let text = format!(
        "{}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    let end: String = text
        .chars()
        .rev()
        .take(600)
        .collect::<Vec<_>>()
        .into_iter()
        .rev()
        .collect();
    match output.status.code() {
        _ if text.contains("panicked") => Err(format!("a panic: {end}")),
        Some(0 | 1 | 3 | 4) => Ok(text),
        Some(124) => Err(format!("longer than ten minutes: {end}")),
        None => Err(format!(
            "ended by a signal (a minute of processor time, memory): {end}"
        )),
        other => Err(format!("exit code {other:?}: {end}")),
    }
}

/// Works through cases with the machine's processors; the faults that were found.
pub(crate) fn in_parallel<T: Sync>(
    cases: &[T],
    judge: impl Fn(&T) -> Result<(), String> + Sync,
) -> Vec<String> {
    let next = std::sync::atomic::AtomicUsize::new(0);
    let wrong = std::sync::Mutex::new(Vec::new());
    let workers = std::thread::available_parallelism().map_or(2, usize::from);
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(case) =
                    cases.get(next.fetch_add(1, std::sync::atomic::Ordering::Relaxed))
                {
                    if let Err(why) = judge(case) {
                        wrong.lock().unwrap().push(why);
                    }
                }
            });
        }
    });
    let mut wrong = wrong.into_inner().unwrap();
    wrong.sort();
    wrong
}
