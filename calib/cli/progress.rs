//! Progress on stderr for whatever takes over two seconds: stage, part done, time left. Redrawn in
//! place on a terminal, plain lines elsewhere; never on stdout. Inside another program it is silent,
//! and the work ends at the next report after its end was asked for.

use crate::kept::{self, Stop};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// What is over sooner needs no progress.
const SILENT: Duration = Duration::from_secs(2);
/// Time between plain lines.
const LINES: Duration = Duration::from_secs(10);
/// Time between redraws on a terminal.
const REDRAWN: Duration = Duration::from_millis(200);
/// Part done below which the time left is a guess.
const MIN_DONE: f64 = 0.02;
/// Steps done below which it is one, too: the first may be short.
const MIN_STEPS: usize = 2;

/// Where a piece of work is.
#[derive(Debug, Clone)]
struct State {
    stage: String,
    done: Option<f64>,
    /// When this count of parts began.
    since: Instant,
    /// Steps that it has made.
    steps: usize,
}

impl State {
    /// See [`Progress::at`].
    fn at(&mut self, stage: &str, done: f64) {
        if self.done.is_none_or(|before| done < 0.5 * before) {
            (self.since, self.steps) = (Instant::now(), 0);
        }
        self.steps += usize::from(self.done.is_some_and(|before| done > before));
        stage.clone_into(&mut self.stage);
        self.done = Some(done.clamp(0.0, 1.0));
    }
}

/// Shows where a piece of work is until it is dropped. Shared by reference among threads.
pub struct Progress {
    state: Arc<Mutex<State>>,
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
    stopped: Option<Stop>,
}

/// What the work unwinds with after its end was asked for.
#[derive(Debug)]
pub(crate) struct Interrupted;

fn locked(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Progress {
    /// Of a command; its part done is not known before the first `at`.
    pub fn new(what: &str) -> Self {
        let state = Arc::new(Mutex::new(State {
            stage: String::new(),
            done: None,
            since: Instant::now(),
            steps: 0,
        }));
        let (stop, stopped) = channel();
        let (own, what) = (Arc::clone(&state), what.to_owned());
        let asked = kept::stop();
        let show = move || {
            let begun = Instant::now();
            let mut bar = None;
            let terminal = std::io::stderr().is_terminal();
            let mut wait = SILENT;
            while stopped.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) {
                let line = line(&what, &locked(&own), begun.elapsed(), Instant::now());
                if terminal {
                    bar.get_or_insert_with(spinner).set_message(line);
                } else {
                    // A line that cannot be shown must not stop the work.
                    let _ = writeln!(std::io::stderr(), "{line}");
                }
                wait = if terminal { REDRAWN } else { LINES };
            }
            if let Some(bar) = bar {
                bar.finish_and_clear();
            }
        };
        Self {
            state,
            stop: Some(stop),
            thread: asked.is_none().then(|| std::thread::spawn(show)),
            stopped: asked,
        }
    }

    /// Says which stage runs and how much of the work is done, 0 to 1. A much smaller part than
    /// before begins to count anew; threads may report a little out of order.
    pub fn at(&self, stage: &str, done: f64) {
        locked(&self.state).at(stage, done);
    }

    /// Says which stage runs where its part of the work is not known.
    pub fn stage(&self, stage: &str) {
        stage.clone_into(&mut locked(&self.state).stage);
    }

    /// [`Self::at`] for a library's callback.
    pub(crate) fn reporter(&self) -> impl Fn(&str, f64) + Send + Sync + use<> {
        let (state, stopped) = (Arc::clone(&self.state), self.stopped.clone());
        move |stage, done| {
            // Nobody waits for the rest; without the panic hook's message.
            if stopped.as_ref().is_some_and(|s| s.load(Ordering::Relaxed)) {
                std::panic::resume_unwind(Box::new(Interrupted));
            }
            locked(&state).at(stage, done);
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    if let Ok(style) = ProgressStyle::with_template("{spinner} {msg}") {
        bar.set_style(style);
    }
    bar.enable_steady_tick(REDRAWN);
    bar
}

/// `evaluate: virtual bench, 34 %, about 1 min 10 s left`.
fn line(what: &str, state: &State, elapsed: Duration, now: Instant) -> String {
    let stage = if state.stage.is_empty() {
        String::new()
    } else {
        format!(" {},", state.stage)
    };
    match state.done {
        Some(done) if done >= MIN_DONE && state.steps >= MIN_STEPS => {
            let left_s = now.duration_since(state.since).as_secs_f64() * (1.0 - done) / done;
            format!(
                "{what}:{stage} {:.0} %, about {} left",
                100.0 * done,
                duration(left_s)
            )
        }
        _ => format!(
            "{what}:{stage} running for {}",
            duration(elapsed.as_secs_f64())
        ),
    }
}

/// `45 s`, `3 min 20 s`, `2 h 5 min`.
fn duration(seconds: f64) -> String {
    let s = seconds.round().max(0.0) as u64;
    match (s / 3600, s / 60 % 60, s % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, min, s) => format!("{min} min {s} s"),
        (h, min, _) => format!("{h} h {min} min"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_states_stage_part_and_time_left() {
        let since = Instant::now();
        let at = |done| State {
            stage: "tables".to_owned(),
            done,
            since,
            steps: 2,
        };
        let shown = |done, s| {
            line(
                "evaluate",
                &at(done),
                Duration::from_secs(s),
                since + Duration::from_secs(s),
            )
        };
        assert_eq!(
            shown(Some(0.25), 30),
            "evaluate: tables, 25 %, about 1 min 30 s left"
        );
        // Nothing is extrapolated from next to nothing, nor from a single step.
        let first = State {
            steps: 1,
            ..at(Some(0.25))
        };
        let said = line(
            "evaluate",
            &first,
            Duration::from_secs(30),
            since + Duration::from_secs(30),
        );
        assert_eq!(said, "evaluate: tables, running for 30 s");
        assert_eq!(shown(Some(0.001), 30), "evaluate: tables, running for 30 s");
        assert_eq!(shown(None, 7300), "evaluate: tables, running for 2 h 1 min");
    }

    #[test]
    fn a_stage_that_begins_anew_is_timed_anew() {
        let progress = Progress::new("verify");
        progress.at("a", 0.9);
        let before = locked(&progress.state).since;
        std::thread::sleep(Duration::from_millis(5));
        progress.at("b", 0.95);
        assert_eq!(locked(&progress.state).since, before);
        progress.at("c", 0.1);
        assert!(locked(&progress.state).since > before);
    }
}
