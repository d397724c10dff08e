//! A command inside another program: what it prints is kept as text, and who runs it can ask for
//! its end. Of the thread that runs the command alone.

use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Set where nobody waits for the rest.
pub(crate) type Stop = Arc<AtomicBool>;

/// Where a text would have gone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stream {
    Out,
    Err,
}

/// What a command printed.
#[derive(Debug, Default)]
pub(crate) struct Printed {
    pub(crate) stdout: String,
    pub(crate) stderr: String,
}

struct Kept {
    words: Vec<String>,
    printed: Printed,
    stop: Stop,
}

thread_local! {
    static KEPT: RefCell<Option<Kept>> = const { RefCell::new(None) };
}

/// Does the work of a command line; its texts are kept, and `stop` is heard. The work does not
/// unwind.
pub(crate) fn keep<T>(words: &[&str], stop: Stop, work: impl FnOnce() -> T) -> (T, Printed) {
    KEPT.set(Some(Kept {
        words: words.iter().map(|w| (*w).to_owned()).collect(),
        printed: Printed::default(),
        stop,
    }));
    let done = work();
    let kept = KEPT.take().map(|kept| kept.printed);
    (done, kept.unwrap_or_default())
}

/// Whether a text was kept; where it was not, it is to be printed.
pub(crate) fn take(stream: Stream, text: std::fmt::Arguments<'_>) -> bool {
    KEPT.with_borrow_mut(|kept| match kept {
        None => false,
        Some(Kept { printed, .. }) => {
            let to = match stream {
                Stream::Out => &mut printed.stdout,
                Stream::Err => &mut printed.stderr,
            };
            to.push_str(&text.to_string());
            true
        }
    })
}

/// How an end is asked for; none where the command runs in its own program.
pub(crate) fn stop() -> Option<Stop> {
    KEPT.with_borrow(|kept| Some(kept.as_ref()?.stop.clone()))
}

/// The command line, for what states which one made it.
pub(crate) fn command() -> Vec<String> {
    let kept = KEPT.with_borrow(|kept| Some(kept.as_ref()?.words.clone()));
    kept.unwrap_or_else(|| std::env::args().collect())
}
