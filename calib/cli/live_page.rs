//! A page on which a person follows a running command (`--live-page`): 127.0.0.1 alone, read-only.
//!
//! The command leaves its state in a snapshot and waits for nobody. One thread alone speaks to
//! clients, through sockets that never block; a client that is late is dropped.

use anyhow::{Context, Result};
use schemars::JsonSchema;
use serde::Serialize;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use wcal_core::Role;
use wcal_core::files::write_atomic;

/// The style of the reports.
const STYLE: &str = include_str!("../report/src/style.css");
/// A request must have come, and then its answer been taken, within this time.
const DEADLINE: Duration = Duration::from_secs(1);
/// Connections open at once; further ones wait to be accepted.
const CONNECTIONS: usize = 8;
/// Longest request line and longest request, bytes.
const LINE: usize = 4096;
const REQUEST: usize = 16 * 1024;
/// Between two looks at the sockets.
const LOOK: Duration = Duration::from_millis(10);
/// Rows of a trace at most.
const TRACE_ROWS: usize = 1000;

/// What a running command has measured so far.
#[derive(Debug, Clone, Default, Serialize, JsonSchema)]
pub(crate) struct LiveState {
    /// Format and version.
    #[schemars(extend("const" = "wcal-live/1"))]
    pub format: &'static str,
    /// What runs.
    #[schemars(extend("enum" = ["stage-sweep", "track"]))]
    pub command: &'static str,
    /// What it writes to: a session folder or a table.
    pub out: String,
    /// From simulated devices; null until the devices have answered.
    pub simulated: Option<bool>,
    /// How it ended, or that it runs.
    #[schemars(extend("enum" = ["running", "finished", "stopped"]))]
    pub ending: &'static str,
    /// Why it stopped.
    pub cause: Option<String>,
    /// Step of the plan that is carried out, from 0; all of them once finished. null without a plan.
    pub step: Option<usize>,
    /// Settled readings completed, or rows of a track.
    pub readings: usize,
    /// Scans received.
    pub scans: u64,
    /// Scans lost.
    pub lost_scans: u64,
    /// Gaps that they were lost in; null for a track.
    pub gaps: Option<u64>,
    /// Estimated time left, s (of a track by its stream's clock); null where it is not known.
    pub left_s: Option<f64>,
    /// What was lost or is not as it should be.
    pub warnings: Vec<String>,
    /// Status of the newest row, one entry a whisker; empty without a track.
    pub status: Vec<String>,
    /// What is measured, with its unit: the names of the values below.
    pub columns: Vec<String>,
    /// Newest values.
    pub now: Vec<Option<f64>>,
    /// Earlier ones, thinned to at most 1000 rows.
    pub trace: Vec<Vec<Option<f64>>>,
    #[serde(skip)]
    offered: usize,
    #[serde(skip)]
    halvings: u32,
}

impl LiveState {
    /// A command that begins; the columns are separated by spaces.
    pub(crate) fn new(command: &'static str, out: &Path, columns: &str) -> Self {
        let columns: Vec<_> = columns.split(' ').map(str::to_owned).collect();
        Self {
            format: "wcal-live/1",
            command,
            out: out.display().to_string(),
            ending: "running",
            now: vec![None; columns.len()],
            columns,
            ..Self::default()
        }
    }

    /// Takes a row, its time first. A trace that is full keeps every second one, and from then on,
    /// too.
    pub(crate) fn measured(&mut self, row: Vec<Option<f64>>) {
        if self.offered.is_multiple_of(1 << self.halvings) && row[0].is_some() {
            self.trace.push(row.clone());
        }
        self.offered += 1;
        if self.trace.len() > TRACE_ROWS {
            let mut odd = false;
            self.trace.retain(|_| {
                odd = !odd;
                odd
            });
            self.halvings += 1;
        }
        self.now = row;
    }
}

/// A settled reading of the plan: its step, trajectory, depth (mm) and role.
pub(crate) type Planned = (usize, u32, f64, Role);

/// What command and server share.
pub(crate) struct Snapshot {
    state: Mutex<LiveState>,
    /// The page, but for the state in it.
    page: String,
    ended: AtomicBool,
}

impl Snapshot {
    /// Changes the state, unless it is being read right now: the command waits for nobody.
    pub(crate) fn show(&self, change: impl FnOnce(&mut LiveState)) {
        if let Ok(mut state) = self.state.try_lock() {
            change(&mut state);
        }
    }

    fn lock(&self) -> MutexGuard<'_, LiveState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The page; one with a state in it asks for no other.
    fn page(&self, state: Option<&LiveState>) -> String {
        let text = state.map_or_else(|| "null".to_owned(), json);
        self.page.replace("{LAST}", &text.replace('<', "\\u003c"))
    }
}

fn json(state: &LiveState) -> String {
    // A state has no map and no number that JSON could not take.
    serde_json::to_string(state).unwrap_or_default()
}

/// The page of a command.
pub(crate) struct LivePage {
    pub(crate) snapshot: Arc<Snapshot>,
    server: JoinHandle<()>,
}

impl LivePage {
    /// Serves the page on a port (0: a free one) and says its address on stderr.
    ///
    /// # Errors
    /// When the port is taken.
    pub(crate) fn open(port: u16, plan: &[Planned], state: LiveState) -> Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).with_context(|| {
            format!(
                "--live-page {port}: expected a free port of 127.0.0.1 (without PORT one is taken)"
            )
        })?;
        listener.set_nonblocking(true)?;
        // Other users of this computer do not know it.
        let key = format!("/{:032x}/", rand::random::<u128>());
        eprintln!("live page: http://{}{key}", listener.local_addr()?);
        // Style and script stand in the page itself: it is read without the program, too.
        let page = include_str!("live_page.html")
            .replace("{STYLE}", STYLE)
            .replace("{SCRIPT}", include_str!("live_page.js"))
            .replace("{PLAN}", &serde_json::to_string(plan)?);
        let snapshot = Arc::new(Snapshot {
            state: Mutex::new(state),
            page,
            ended: AtomicBool::new(false),
        });
        let shared = Arc::clone(&snapshot);
        let server = std::thread::Builder::new().name("live page".to_owned());
        let server = server.spawn(move || serve(&listener, &shared, &key))?;
        Ok(Self { snapshot, server })
    }

    /// The last state: for those who watch, and as a page that stays.
    pub(crate) fn end(self, file: &Path, change: impl FnOnce(&mut LiveState)) {
        self.snapshot.lock().left_s = None;
        change(&mut self.snapshot.lock());
        self.snapshot.ended.store(true, Ordering::SeqCst);
        let last = self.snapshot.lock().clone();
        let page = self.snapshot.page(Some(&last));
        if let Err(e) = write_atomic(file, page.as_bytes()) {
            eprintln!("warning: the live page was not kept: {e}");
        }
        // A server that panicked has said so.
        let _ = self.server.join();
    }
}

/// Speaks to clients until a while after the end: whoever watches hears of it.
fn serve(listener: &TcpListener, snapshot: &Snapshot, key: &str) {
    let (mut clients, mut ended) = (Vec::new(), None::<Instant>);
    let answer = |line: &str| {
        let path = line.strip_prefix("GET ").and_then(|l| l.split(' ').next());
        match path.and_then(|path| path.strip_prefix(key)) {
            Some("") => response("200 OK", "text/html", &snapshot.page(None)),
            Some("state.json") => {
                let state = snapshot.lock().clone();
                response("200 OK", "application/json", &json(&state))
            }
            _ => response("404 Not Found", "text/plain", "not found\n"),
        }
    };
    while ended.is_none_or(|at| at.elapsed() < DEADLINE) {
        while clients.len() < CONNECTIONS
            && let Ok((stream, _)) = listener.accept()
        {
            clients.extend(Client::new(stream));
        }
        clients.retain_mut(|client: &mut Client| client.goes_on(answer));
        std::thread::sleep(LOOK);
        if snapshot.ended.load(Ordering::SeqCst) {
            ended.get_or_insert_with(Instant::now);
        }
    }
}

/// The page runs its own script alone, speaks to this server alone, and hands its address to nobody.
fn response(status: &str, kind: &str, body: &str) -> Vec<u8> {
    format!(
        "HTTP/1.1 {status}\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {}\r\nConnection: close\r\n\
         Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\n\
         Content-Security-Policy: default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; \
         connect-src 'self'; img-src data:; frame-ancestors 'none'\r\n\r\n{body}",
        body.len()
    )
    .into_bytes()
}

/// A connection: its request as far as it has come, then its answer as far as it was taken.
struct Client {
    stream: TcpStream,
    until: Instant,
    request: Vec<u8>,
    answer: Vec<u8>,
    sent: usize,
}

impl Client {
    fn new(stream: TcpStream) -> Option<Self> {
        stream.set_nonblocking(true).ok()?;
        Some(Self {
            stream,
            until: Instant::now() + DEADLINE,
            request: Vec::new(),
            answer: Vec::new(),
            sent: 0,
        })
    }

    /// Does what can be done at once; whether the connection stays open.
    fn goes_on(&mut self, answer: impl Fn(&str) -> Vec<u8>) -> bool {
        let waits =
            |e: io::Error| matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted);
        let over = Instant::now() > self.until;
        self.advance(answer).is_err_and(waits) && !over
    }

    /// Ends with `Ok` when the connection does.
    fn advance(&mut self, answer: impl Fn(&str) -> Vec<u8>) -> io::Result<()> {
        while self.answer.is_empty() {
            let mut piece = [0; 1024];
            let count = self.stream.read(&mut piece)?;
            self.request.extend(&piece[..count]);
            let mut lines = self.request.split(|b| *b == b'\n');
            let line = lines.next().unwrap_or_default();
            if line.len() > LINE {
                self.answer = answer("");
            } else if self.request.windows(4).any(|w| w == b"\r\n\r\n") {
                self.answer = answer(&String::from_utf8_lossy(line));
            } else if count == 0 || self.request.len() > REQUEST {
                return Ok(());
            }
            if !self.answer.is_empty() {
                self.until = Instant::now() + DEADLINE;
            }
        }
        while self.sent < self.answer.len() {
            self.sent += self.stream.write(&self.answer[self.sent..])?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn page(cause: String) -> (LivePage, String, String) {
        let state = LiveState {
            cause: Some(cause),
            ..LiveState::new("track", Path::new("t.csv"), "t_s x_mm")
        };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let (address, key) = (listener.local_addr().unwrap().to_string(), "/key/");
        listener.set_nonblocking(true).unwrap();
        let snapshot = Arc::new(Snapshot {
            state: Mutex::new(state),
            page: "{LAST}".to_owned(),
            ended: AtomicBool::new(false),
        });
        let shared = Arc::clone(&snapshot);
        let server = std::thread::spawn(move || serve(&listener, &shared, key));
        (LivePage { snapshot, server }, address, key.to_owned())
    }

    fn asking(address: &str, line: &str) -> TcpStream {
        let mut stream = TcpStream::connect(address).unwrap();
        write!(stream, "{line} HTTP/1.1\r\n\r\n").unwrap();
        stream
    }

    /// What comes until the connection ends.
    fn taken(mut stream: TcpStream) -> Vec<u8> {
        let mut answer = Vec::new();
        // A connection that is reset has ended, too.
        let _ = stream.read_to_end(&mut answer);
        answer
    }

    #[test]
    fn who_takes_no_answer_is_cut_off_and_others_are_served() {
        const LARGE: usize = 16 << 20;
        let (live, address, key) = page("x".repeat(LARGE));
        let line = format!("GET {key}state.json");
        // Every place is taken, by answers larger than any buffer of a socket.
        let stalled: Vec<_> = (0..CONNECTIONS).map(|_| asking(&address, &line)).collect();
        // One that waits for a place gets it: without a deadline it would wait for ever.
        assert!(taken(asking(&address, "GET /")).starts_with(b"HTTP/1.1 404"));
        // The place was that of the first: of its answer it has what the sockets held.
        assert!(
            stalled
                .into_iter()
                .next()
                .is_some_and(|s| taken(s).len() < LARGE)
        );
        // Control: who reads gets all of it, and so does the page that stays.
        live.snapshot.lock().cause = Some("x".repeat(LARGE / 16));
        assert!(taken(asking(&address, &line)).len() > LARGE / 16);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("live.html");
        live.end(&file, |state| state.ending = "finished");
        assert!(std::fs::read_to_string(&file).unwrap().contains("finished"));
        assert!(
            TcpStream::connect(&address).is_err(),
            "the server has ended"
        );
    }

    #[test]
    fn a_command_does_not_wait_for_a_reader_of_its_state() {
        let (live, ..) = page(String::new());
        let held = live.snapshot.lock();
        live.snapshot.show(|state| state.readings = 7);
        assert_eq!(held.readings, 0);
        drop(held);
        // Control: where nobody reads, it is shown.
        live.snapshot.show(|state| state.readings = 7);
        assert_eq!(live.snapshot.lock().readings, 7);
    }

    #[test]
    fn a_trace_is_thinned_and_keeps_its_beginning_and_order() {
        let mut state = LiveState::new("track", Path::new("t.csv"), "t_s x_mm");
        (0..10_000).for_each(|k| state.measured(vec![Some(f64::from(k)), None]));
        state.measured(vec![None, Some(1.0)]);
        let times: Vec<f64> = state.trace.iter().filter_map(|row| row[0]).collect();
        assert!(times.len() == state.trace.len() && times.len() <= TRACE_ROWS);
        assert!(times.is_sorted() && times[0] == 0.0 && times[times.len() - 1] > 9_900.0);
        let step = times[1] - times[0];
        assert!(
            times.windows(2).all(|pair| pair[1] - pair[0] == step),
            "evenly"
        );
        assert_eq!(
            state.now,
            [None, Some(1.0)],
            "control: the newest row is the last one"
        );
    }

    #[test]
    fn markup_in_a_state_cannot_end_the_script_that_holds_it() {
        let (live, ..) = page("</script><b>".to_owned());
        let state = live.snapshot.lock().clone();
        assert!(json(&state).contains("</script>"), "control");
        assert!(!live.snapshot.page(Some(&state)).contains('<'));
    }
}
