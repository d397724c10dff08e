//! Runs the program under examination on drawn sessions.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::orders::{Drawn, Order};
use crate::score::{FollowUp, Kind, Outcome, crash, score, score_scalar};
use wcal_plant::PlantError;
use wcal_plant::case::Case;
use wcal_plant::layout::Asked;
use wcal_plant::session::later;

/// A drawn case with its name.
#[derive(Debug, Clone)]
pub struct Paper {
    /// Folder name and id.
    pub name: String,
    /// Session and truth.
    pub case: Drawn,
}

/// How to examine.
#[derive(Debug, Clone)]
pub struct Examiner {
    /// The program; called as `PROGRAM verify SESSION --out DIR --json --seed 1`.
    pub program: PathBuf,
    /// Where sessions and results go.
    pub folder: PathBuf,
    /// Sessions at a time.
    pub jobs: usize,
    /// Seconds before a session counts as a crash.
    pub timeout_s: f64,
    /// Whether the measurement that an ambiguous answer asks for is made and judged.
    pub follow_up: bool,
}

impl Examiner {
    /// Draws, runs and scores all orders; `report` is called with every outcome as it comes.
    ///
    /// Orders that the plant cannot draw come back as errors.
    pub fn examine(
        &self,
        orders: &[Order],
        report: &(dyn Fn(&Outcome) + Sync),
    ) -> Vec<Result<Outcome, PlantError>> {
        let next = AtomicUsize::new(0);
        let done = Mutex::new(Vec::new());
        std::thread::scope(|scope| {
            for _ in 0..self.jobs.max(1) {
                scope.spawn(|| {
                    loop {
                        let i = next.fetch_add(1, Ordering::Relaxed);
                        let Some(order) = orders.get(i) else { break };
                        let outcome = self.one(i, order);
                        if let Ok(o) = &outcome {
                            report(o);
                        }
                        if let Ok(mut done) = done.lock() {
                            done.push((i, outcome));
                        }
                    }
                });
            }
        });
        let mut done = done.into_inner().unwrap_or_default();
        done.sort_by_key(|(i, _)| *i);
        done.into_iter().map(|(_, o)| o).collect()
    }

    fn one(&self, index: usize, order: &Order) -> Result<Outcome, PlantError> {
        let name = format!("case-{:03}", index + 1);
        let case = order.draw()?;
        let session = self.folder.join(&name);
        case.write(&session)?;
        let paper = Paper { name, case };
        let mut outcome = answer(&self.program, &paper, &session, self.timeout_s);
        let known = !matches!(outcome.label.as_str(), "null" | "unknown" | "adversarial");
        if let (true, Drawn::Whisker(case)) = (self.follow_up && known, &paper.case)
            && outcome.verdict == "ambiguous"
        {
            outcome.follow_up = self.follow_up(&paper, case, &session)?;
        }
        Ok(outcome)
    }

    /// Makes the measurement that the answer in `session` asks for, and asks again with it; none
    /// where it asks for no poses.
    fn follow_up(
        &self,
        paper: &Paper,
        case: &Case,
        session: &Path,
    ) -> Result<Option<FollowUp>, PlantError> {
        let text =
            std::fs::read_to_string(session.join("verify-out/verify.json")).unwrap_or_default();
        let Ok(verify) = serde_json::from_str::<serde_json::Value>(&text) else {
            return Ok(None);
        };
        let next = &verify["next_measurement"];
        let asked: Vec<Asked> = serde_json::from_value(next["poses"].clone()).unwrap_or_default();
        if asked.is_empty() {
            return Ok(None);
        }
        let folder = session.with_file_name(format!("{}-later", paper.name));
        later(case, &asked)?.write(&folder)?;
        let second = answer_with(&self.program, paper, session, Some(&folder), self.timeout_s);
        Ok(Some(FollowUp {
            expected_power: next["expected_power"].as_f64().unwrap_or(0.0),
            poses: asked.len(),
            resolved: second.kind == Kind::Right,
            kind: second.kind,
            verdict: second.verdict,
            got: second.got,
            why: second.why,
        }))
    }
}

/// Runs the program on one written session and scores what it left.
pub fn answer(program: &Path, paper: &Paper, session: &Path, timeout_s: f64) -> Outcome {
    answer_with(program, paper, session, None, timeout_s)
}

fn answer_with(
    program: &Path,
    paper: &Paper,
    session: &Path,
    added: Option<&Path>,
    timeout_s: f64,
) -> Outcome {
    let out = session.join(if added.is_some() {
        "verify-later"
    } else {
        "verify-out"
    });
    let start = Instant::now();
    let run = spawn(program, session, added, &out, timeout_s);
    let seconds = start.elapsed().as_secs_f64();
    let (name, case) = (paper.name.as_str(), &paper.case);
    let code = match run {
        Ok(code) => code,
        Err(why) => return crash(name, case, why, seconds, None),
    };
    let verify = match std::fs::read_to_string(out.join("verify.json")) {
        Ok(text) => serde_json::from_str(&text),
        Err(e) => {
            return crash(
                name,
                case,
                format!("reading verify.json: {e} (exit code {code:?})"),
                seconds,
                code,
            );
        }
    };
    match verify {
        Ok(verify) => {
            // A refused session may come without predictions.
            let predictions =
                std::fs::read_to_string(out.join("predictions.csv")).unwrap_or_default();
            match case {
                Drawn::Whisker(case) => score(name, case, &verify, &predictions, seconds, code),
                Drawn::Scalar(case) => {
                    score_scalar(name, case, &verify, &predictions, seconds, code)
                }
            }
        }
        Err(e) => crash(
            name,
            case,
            format!("parsing verify.json: {e}"),
            seconds,
            code,
        ),
    }
}

fn spawn(
    program: &Path,
    session: &Path,
    added: Option<&Path>,
    out: &Path,
    timeout_s: f64,
) -> Result<Option<i32>, String> {
    let log = |name: &str| {
        std::fs::File::create(session.join(name))
            .map(Stdio::from)
            .map_err(|e| format!("making {name}: {e}"))
    };
    let mut child = Command::new(program)
        .arg("verify")
        .arg(session)
        .args(
            added
                .iter()
                .flat_map(|a| [std::ffi::OsStr::new("--add"), a.as_os_str()]),
        )
        .arg("--out")
        .arg(out)
        .args(["--json", "--seed", "1"])
        .stdin(Stdio::null())
        .stdout(log("stdout.txt")?)
        .stderr(log("stderr.txt")?)
        .spawn()
        .map_err(|e| format!("starting {}: {e}", program.display()))?;
    let start = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Ok(status.code()),
            Ok(None) if start.elapsed().as_secs_f64() > timeout_s => {
                // The child is ours; it may have ended between the two calls, which is no fault.
                let _ = child.kill();
                let _ = child.wait();
                return Err(format!("no answer within {timeout_s} s"));
            }
            Ok(None) => std::thread::sleep(Duration::from_millis(10)),
            Err(e) => return Err(format!("waiting for {}: {e}", program.display())),
        }
    }
}
