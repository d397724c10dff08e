//! MuJoCo, in its own program (`wcal-mujoco`, calib/mujoco/engine) that is spoken to by lines of
//! JSON.
//!
//! MuJoCo ends the process on some errors (a plugin that does not load, an inconsistent model) and
//! its library may be missing: behind a pipe both are errors with a name, and whatever else runs
//! goes on. Units of the protocol are SI, as MuJoCo's; the border is here.

pub mod fluid;
pub mod protocol;

use crate::TwinError;
use protocol::{Frame, LoadedModel, Reply, Request};
use std::io::{BufRead, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

/// Name of the program.
pub const PROGRAM: &str = "wcal-mujoco";
/// Variable that names the program where it lies elsewhere.
pub const VARIABLE: &str = "WCAL_MUJOCO";

/// Variable that says how long an answer is waited for, s.
const WAIT_VARIABLE: &str = "WCAL_MUJOCO_WAIT_S";
/// Longest wait for an answer, s: the longest request is 20,000 steps, some ten seconds on a free
/// core; CoACD takes minutes.
const WAIT_S: f64 = 300.0;
const COACD_WAIT_S: f64 = 1800.0;
/// Tenths of a second that a program may take to end.
const ENDING_TENTHS: u32 = 50;

/// A running engine with at most one model in it.
#[derive(Debug)]
pub struct MujocoEngine {
    child: Child,
    to: ChildStdin,
    /// Lines of the program, read by its own thread: a program that hangs must not hang its reader.
    from: Receiver<String>,
    /// Longest wait for an answer, as [`WAIT_VARIABLE`] says.
    wait_s: Option<f64>,
    /// Version of libmujoco.
    pub version: String,
    /// Processor time of the program at its last frame, s.
    pub core_s: f64,
}

/// Where the program may lie: as the variable says, in the folder of this program (or its parent:
/// tests), or on the path.
fn program() -> Result<PathBuf, TwinError> {
    if let Some(named) = std::env::var_os(VARIABLE) {
        let path = PathBuf::from(named);
        return match path.is_file() {
            true => Ok(path),
            false => Err(TwinError::Engine(format!(
                "{VARIABLE}: expected a program, found nothing at {}",
                path.display()
            ))),
        };
    }
    let own = std::env::current_exe().ok();
    let own = own
        .iter()
        .flat_map(|exe| exe.ancestors().skip(1).take(2))
        .map(PathBuf::from);
    let path = std::env::var_os("PATH").unwrap_or_default();
    own.chain(std::env::split_paths(&path)).map(|folder| folder.join(PROGRAM)).find(|p| p.is_file()).ok_or_else(|| {
        TwinError::Engine(format!(
            "expected {PROGRAM} in the folder of wcal, on PATH or named by {VARIABLE}, found none; `make setup` and `cargo build --release -p wcal-mujoco-engine` make it"
        ))
    })
}

impl MujocoEngine {
    /// Starts the program and hears which MuJoCo it has.
    ///
    /// # Errors
    /// Where the program or its library is missing.
    pub fn start() -> Result<Self, TwinError> {
        let path = program()?;
        let wait_s = wait_s()?;
        let lost =
            |e: std::io::Error| TwinError::Engine(format!("starting {}: {e}", path.display()));
        let mut child = Command::new(&path)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(lost)?;
        let (Some(to), Some(from)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(TwinError::Engine(format!(
                "starting {}: no pipe",
                path.display()
            )));
        };
        let (send, from_program) = channel();
        std::thread::spawn(move || {
            // Ends with the program, or with whoever listened.
            let lines = BufReader::new(from).lines().map_while(Result::ok);
            lines
                .map(|line| send.send(line))
                .take_while(Result::is_ok)
                .for_each(drop);
        });
        let mut engine = Self {
            child,
            to,
            from: from_program,
            wait_s,
            version: String::new(),
            core_s: 0.0,
        };
        match engine.ask(&Request::Hello)? {
            Reply::Hello { mujoco } => engine.version = mujoco,
            other => return Err(unexpected("a greeting", &other)),
        }
        Ok(engine)
    }

    /// Loads a model.
    ///
    /// # Errors
    /// Where MuJoCo refuses it, or the cable plugin is missing.
    pub fn load(&mut self, xml: &str, cable_plugin: bool) -> Result<LoadedModel, TwinError> {
        match self.ask(&Request::Load {
            xml: xml.to_owned(),
            cable_plugin,
        })? {
            Reply::LoadedModel(loaded) => Ok(loaded),
            other => Err(unexpected("a loaded model", &other)),
        }
    }

    /// Moves the model on.
    ///
    /// # Errors
    /// Where the engine refuses or dies; an unstable step is no error but in the frame.
    pub fn frame(&mut self, request: &Request) -> Result<Frame, TwinError> {
        match self.ask(request)? {
            Reply::Frame(frame) => {
                self.core_s = frame.core_s;
                Ok(frame)
            }
            other => Err(unexpected("a frame", &other)),
        }
    }

    /// Runs freely, with the base moment (N mm) at every `every`-th step.
    ///
    /// # Errors
    /// As [`Self::frame`].
    pub fn series(&mut self, steps: u64, every: u64) -> Result<protocol::Series, TwinError> {
        match self.ask(&Request::Series { steps, every })? {
            Reply::Series(series) => Ok(series),
            other => Err(unexpected("a series", &other)),
        }
    }

    /// Convex parts of a closed surface, by CoACD.
    ///
    /// # Errors
    /// Where the library is missing or finds none.
    pub fn convex_parts(
        &mut self,
        request: &protocol::Decompose,
    ) -> Result<Vec<protocol::Part>, TwinError> {
        match self.ask(&Request::Decompose(request.clone()))? {
            Reply::Parts { parts } => Ok(parts),
            other => Err(unexpected("convex parts", &other)),
        }
    }

    fn ask(&mut self, request: &Request) -> Result<Reply, TwinError> {
        let mut line =
            serde_json::to_string(request).map_err(|e| TwinError::Engine(e.to_string()))?;
        line.push('\n');
        if self
            .to
            .write_all(line.as_bytes())
            .and_then(|()| self.to.flush())
            .is_err()
        {
            return Err(self.dead());
        }
        let usual_s = if let Request::Decompose(_) = request {
            COACD_WAIT_S
        } else {
            WAIT_S
        };
        let wait_s = self.wait_s.unwrap_or(usual_s);
        match self.from.recv_timeout(Duration::from_secs_f64(wait_s)) {
            Ok(answer) => match serde_json::from_str(&answer) {
                Ok(Reply::Refused { why }) => Err(TwinError::Engine(why)),
                Ok(reply) => Ok(reply),
                Err(e) => Err(TwinError::Engine(format!(
                    "expected a line of the protocol, found {:?}: {e}",
                    answer.trim()
                ))),
            },
            Err(RecvTimeoutError::Timeout) => {
                // Nothing that it says later would be an answer.
                let _ = self.child.kill();
                let _ = self.child.wait();
                Err(TwinError::EngineDied(format!(
                    "{PROGRAM}: expected an answer within {wait_s} s ({WAIT_VARIABLE}), found none: it hung and was ended"
                )))
            }
            Err(RecvTimeoutError::Disconnected) => Err(self.dead()),
        }
    }

    /// What is known of an engine that answers no more.
    fn dead(&mut self) -> TwinError {
        // It ends on its own, or has closed its output and goes on for ever.
        for _ in 0..ENDING_TENTHS {
            if !matches!(self.child.try_wait(), Ok(None)) {
                break;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
        let _ = self.child.kill();
        let status = self
            .child
            .wait()
            .map_or_else(|e| e.to_string(), |s| s.to_string());
        let mut said = String::new();
        if let Some(mut errors) = self.child.stderr.take() {
            let _ = errors.read_to_string(&mut said);
        }
        TwinError::EngineDied(format!(
            "{PROGRAM} ended ({status}): {}",
            said.trim().lines().next_back().unwrap_or("said nothing")
        ))
    }
}

impl Drop for MujocoEngine {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Seconds of [`WAIT_VARIABLE`], where it is set.
fn wait_s() -> Result<Option<f64>, TwinError> {
    let Ok(text) = std::env::var(WAIT_VARIABLE) else {
        return Ok(None);
    };
    let seconds = text.parse().ok().filter(|s| (1e-3..1e7).contains(s));
    let refuse = || {
        TwinError::value(
            WAIT_VARIABLE,
            "seconds above 0.001 and below 10,000,000",
            format!("{text:?}"),
        )
    };
    seconds.map(Some).ok_or_else(refuse)
}

fn unexpected(expected: &str, found: &Reply) -> TwinError {
    TwinError::Engine(format!("expected {expected}, found {found:?}"))
}
