//! Progress on stderr for whatever takes over two seconds: stage, part done, time left. Redrawn in
//! place on a terminal, plain lines elsewhere; never on stdout. Inside another program it is silent,
//! and the work ends at the next report after its end was asked for.
//!
//! ```text
//! left = (1 - d) (t - t_h) / (d - d_h) - time since t        t, d: last step; t_h, d_h: where half of d was done
//! ```

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
    /// When each step of this count of parts ended, and the part done then.
    steps: Vec<(Instant, f64)>,
}

impl State {
    /// See [`Progress::at`].
    fn at(&mut self, stage: &str, done: f64) {
        if self.done().is_some_and(|before| done < 0.5 * before) {
            self.steps.clear();
        }
        if self.done().is_none_or(|before| done > before) {
            self.steps.push((Instant::now(), done.clamp(0.0, 1.0)));
        }
        stage.clone_into(&mut self.stage);
    }

    fn done(&self) -> Option<f64> {
        self.steps.last().map(|step| step.1)
    }

    /// Time left, s; none before the rate of two steps is known, and while a step takes longer than
    /// it lets expect.
    fn left_s(&self, now: Instant) -> Option<f64> {
        let (at, done) = *self.steps.last()?;
        let half = self.steps.partition_point(|step| step.1 < 0.5 * done);
        let (since, before) = *self.steps.get(half)?;
        // The rate of the later half: early steps may be shorter than late ones.
        let known = self.steps.len() - half > MIN_STEPS && done >= MIN_DONE;
        let rate = (done - before) / at.duration_since(since).as_secs_f64();
        let left_s = (1.0 - done) / rate - now.duration_since(at).as_secs_f64();
        (known && left_s > 0.0).then_some(left_s)
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
            steps: Vec::new(),
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
        let mut state = locked(&self.state);
        stage.clone_into(&mut state.stage);
        state.steps.clear();
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
    let time = match state.left_s(now) {
        Some(left_s) => format!("about {} left", duration(left_s)),
        None => format!("running for {}", duration(elapsed.as_secs_f64())),
    };
    match state.done() {
        Some(done) if done >= MIN_DONE => format!("{what}:{stage} {:.0} %, {time}", 100.0 * done),
        _ => format!("{what}:{stage} {time}"),
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
    fn the_time_left_follows_the_last_steps_and_never_grows_within_one() {
        let start = Instant::now();
        let after = |s: u64| start + Duration::from_secs(s);
        // Parts done and when, s.
        let shown = |steps: &[(f64, u64)], s: u64| {
            let steps = steps.iter().map(|(done, s)| (after(*s), *done)).collect();
            let stage = "tables".to_owned();
            line(
                "verify",
                &State { stage, steps },
                Duration::from_secs(s),
                after(s),
            )
        };
        let steps = [(0.0, 0), (0.1, 1), (0.2, 2), (0.3, 12), (0.4, 22)];
        assert_eq!(
            shown(&steps, 22),
            "verify: tables, 40 %, about 1 min 0 s left"
        );
        assert_eq!(shown(&steps, 32), "verify: tables, 40 %, about 50 s left");
        // A step that takes longer than its rate lets expect tells no time.
        assert_eq!(
            shown(&steps, 90),
            "verify: tables, 40 %, running for 1 min 30 s"
        );
        // Nothing is extrapolated from one step, nor from next to nothing.
        assert_eq!(
            shown(&steps[..2], 2),
            "verify: tables, 10 %, running for 2 s"
        );
        let little = [(0.001, 0), (0.002, 1), (0.003, 2), (0.004, 3)];
        assert_eq!(shown(&little, 3), "verify: tables, running for 3 s");
        assert_eq!(shown(&[], 7300), "verify: tables, running for 2 h 1 min");
    }

    #[test]
    fn a_stage_that_begins_anew_is_timed_anew() {
        let progress = Progress::new("verify");
        let steps = || locked(&progress.state).steps.len();
        progress.at("a", 0.8);
        progress.at("a", 0.9);
        progress.at("b", 0.85);
        assert_eq!(steps(), 2, "threads report a little out of order");
        progress.at("c", 0.1);
        assert_eq!(steps(), 1);
        progress.stage("d");
        assert_eq!(steps(), 0);
    }
}
