//! A stage that does not end its move, a line that carries everything but the reply, signals, and
//! two masters: named, safe, nothing lost.

use super::*;
use std::net::TcpListener;
use std::time::Instant;

/// Two trajectories of two depths and the rests between: some seconds.
const PLAN: &str = r#"
format = "wcal-plan/1"
name = "short"
[settle]
gate_pm_per_s = 3.0
window_s = 0.5
timeout_s = 3.0
[[block]]
role = "calibration"
trajectories = [1, 5]
depths_mm = [1.5, 3.0]
dwell_s = 0.5
average_s = 0.5
"#;
/// A run that lasts this long hangs: the longest wait of the program is a tenth of it.
const HANGS: Duration = Duration::from_secs(600);

impl Bench {
    /// `wcal stage-sweep` with the short plan.
    pub(crate) fn short(&self, arguments: &[&str]) -> Command {
        let plan = self.folder.path().join("short.toml");
        std::fs::write(&plan, PLAN).expect("plan");
        let mut command = program();
        command
            .arg("stage-sweep")
            .arg("--rig")
            .arg(&self.rig)
            .arg("--plan")
            .arg(plan);
        command
            .arg("--bench")
            .arg(&self.served.addresses)
            .args(["--home", "--json"])
            .args(arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub(crate) fn run_short(&self, how: &str) -> Output {
        let session = self.session().display().to_string();
        ended(self.short(&[how, &session]).spawn().expect("wcal runs"))
    }

    /// A sweep by the short plan that is past its first rest, so that there is a row to keep.
    pub(crate) fn begun_short(&self) -> Child {
        let session = self.session().display().to_string();
        let child = self.short(&["--out", &session]).spawn().expect("wcal runs");
        until_done(&self.session(), 3);
        child
    }
}

/// The end of a run, which must come.
pub(crate) fn ended(mut child: Child) -> Output {
    let start = Instant::now();
    while child.try_wait().expect("a child").is_none() {
        if start.elapsed() > HANGS {
            child.kill().expect("killed");
            let run = child.wait_with_output().expect("ends");
            panic!("hangs: {}{}", text(&run.stdout), text(&run.stderr));
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    child.wait_with_output().expect("ends")
}

fn kill(child: &Child, signal: &str) {
    let id = child.id().to_string();
    assert!(
        Command::new("kill")
            .args([signal, &id])
            .status()
            .expect("kill")
            .success()
    );
}

/// Kind and text of the cause, and whether the stage was known to stand.
pub(crate) fn cause(run: &Output) -> (String, String, bool) {
    let sweep = document(run);
    let said = sweep["cause"]["text"].as_str().expect("text");
    let by_signal = [("by Ctrl-C", 130), ("by SIGTERM", 143), ("by SIGHUP", 129)];
    let code = by_signal
        .iter()
        .find(|(name, _)| said.contains(name))
        .map_or(1, |signal| signal.1);
    assert_eq!(run.status.code(), Some(code), "{}", text(&run.stderr));
    assert_eq!(sweep["ending"], "stopped", "{sweep}");
    assert!(sweep["rows"].as_u64() > Some(0), "{sweep}");
    let word = |v: &Value| v.as_str().expect("text").to_owned();
    (
        word(&sweep["cause"]["kind"]),
        word(&sweep["cause"]["text"]),
        sweep["stage_stopped"] == true,
    )
}

/// Finished, and nothing said but that this computer was busy.
pub(crate) fn finished(run: &Output, rows: u64) {
    let sweep = document(run);
    assert_eq!(
        (&sweep["ending"], &sweep["rows"]),
        (&"finished".into(), &rows.into()),
        "{sweep}"
    );
    let warnings = sweep["warnings"].as_array().expect("warnings");
    // At 20 times real time a busy computer makes scans late, or a clock seem to drift.
    let busy = |w: &Value| {
        let said = w.as_str().unwrap_or_default();
        said.contains(" late") || said.contains("clock drifts")
    };
    assert!(warnings.iter().all(busy), "{sweep}");
    assert_eq!(
        run.status.code(),
        Some(if warnings.is_empty() { 0 } else { 3 }),
        "{sweep}"
    );
}

#[test]
fn a_stage_that_stays_busy_is_stopped_named_and_the_sweep_goes_on_later() {
    let mut bench = Bench::start("");
    let child = bench.begun_short();
    bench.type_fault("busy-for-ever");
    let (kind, said, stopped) = cause(&ended(child));
    assert!(
        kind == "timeout" && said.contains("BUSY") && said.contains("expected standstill"),
        "{said}"
    );
    assert!(stopped, "{said}");
    assert_ne!(check(&bench.session()), 1);
    finished(&bench.run_short("--resume"), 6);
}

/// Stopped for longer than it waits for any device, as a laptop that sleeps is: what comes of it is
/// no fault of the interrogator.
#[test]
fn a_sweep_that_was_itself_paused_does_not_blame_the_interrogator() {
    let bench = Bench::start("");
    let child = bench.begun_short();
    kill(&child, "-STOP");
    std::thread::sleep(Duration::from_secs(6));
    kill(&child, "-CONT");
    let run = ended(child);
    let sweep = document(&run);
    if sweep["ending"] == "finished" {
        assert_eq!(sweep["rows"], 6, "{sweep}");
        return;
    }
    // The bench may have given up meanwhile: then the pause is what is said.
    let said = sweep["cause"]["text"].as_str().expect("text");
    assert!(
        said.contains("this program") && said.contains("stood still"),
        "{said}"
    );
    finished(&bench.run_short("--resume"), 6);
}

/// The bench itself does not get to run, as on a busy computer: the time stands for all, and the
/// sweep ends.
#[test]
fn a_bench_that_does_not_run_is_waited_for() {
    let bench = Bench::start("");
    let stopped_for_a_while = |child: Child| {
        bench.served.signal("-STOP");
        std::thread::sleep(Duration::from_secs(8));
        bench.served.signal("-CONT");
        ended(child)
    };
    finished(&stopped_for_a_while(bench.begun_short()), 6);
    // Whether rows are marked as late is not asked: one in four such sweeps takes 50 ms of the
    // computer for a drift of the unit's clock. Control: who is not told the bench's time names the
    // device that is silent, as with a real one.
    let mut addresses = document_of(&bench.served.addresses);
    addresses
        .as_object_mut()
        .and_then(|a| a.remove("clock"))
        .expect("the bench's clock");
    std::fs::write(&bench.served.addresses, addresses.to_string()).expect("written");
    let session = bench.folder.path().join("untold");
    let child = bench
        .short(&["--out", &session.display().to_string()])
        .spawn()
        .expect("wcal runs");
    until_done(&session, 3);
    let (kind, said, _) = cause(&stopped_for_a_while(child));
    assert_eq!(kind, "timeout", "{said}");
}

#[test]
fn a_flood_without_a_reply_is_named_and_the_sweep_goes_on_when_it_is_over() {
    let mut bench = Bench::start("");
    for (k, (flood, word)) in [
        ("alert-flood", "alerts"),
        ("foreign-flood", "replies of other units"),
    ]
    .into_iter()
    .enumerate()
    {
        let child = match k {
            0 => bench.begun_short(),
            _ => {
                let session = bench.session().display().to_string();
                bench
                    .short(&["--resume", &session])
                    .spawn()
                    .expect("wcal runs")
            }
        };
        if k > 0 {
            // The second recording has its first scans: the stage is open.
            let part = bench.session().join("recording-2.mcap");
            until("second recording", || part.exists());
        }
        bench.type_fault(&format!("{{\"kind\":\"{flood}\",\"on\":true}}"));
        let (kind, said, stopped) = cause(&ended(child));
        assert!(
            kind == "timeout" && said.contains("none among") && said.contains(word),
            "{said}"
        );
        // Its command was sent; without a reply nobody knows, and the user is told.
        assert!(!stopped);
        bench.type_fault(&format!("{{\"kind\":\"{flood}\",\"on\":false}}"));
    }
    finished(&bench.run_short("--resume"), 6);
}

#[test]
fn late_and_foreign_replies_and_info_lines_cost_nothing() {
    let mut bench = Bench::start("");
    let child = bench.begun_short();
    for fault in ["late-reply", "foreign-reply", "info-lines", "late-reply"] {
        bench.type_fault(fault);
        std::thread::sleep(Duration::from_millis(100));
    }
    finished(&ended(child), 6);
}

/// An address at which nobody answers, and one that refuses: named, and nothing is left that would
/// refuse the same `--out`.
#[test]
fn a_device_that_cannot_be_opened_leaves_no_folder_behind() {
    let mut bench = Bench::start("");
    bench.type_fault("{\"kind\":\"never-accept\",\"on\":true}");
    // Until the queue of its port is full, connections are made and not answered.
    let address = document_of(&bench.served.addresses)["stage_tcp"]
        .as_str()
        .expect("address")
        .to_owned();
    let address = address.parse().expect("an address");
    let answers =
        || std::net::TcpStream::connect_timeout(&address, Duration::from_millis(300)).is_ok();
    until("a port that does not answer", || !answers());
    let refused = |run: Output, word: &str| {
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{said}");
        assert!(said.contains(word), "{said}");
        assert!(!bench.session().exists(), "{said}");
    };
    refused(bench.run_short("--out"), "no answer from this address");
    // The stage is there, the interrogator is not.
    let closed = TcpListener::bind("127.0.0.1:0")
        .expect("a port")
        .local_addr()
        .expect("an address");
    let mut addresses = document_of(&bench.served.addresses);
    let good = addresses.clone();
    addresses["sm130"] = closed.to_string().into();
    bench.type_fault("{\"kind\":\"never-accept\",\"on\":false}");
    std::fs::write(&bench.served.addresses, addresses.to_string()).expect("written");
    let refused = |run: Output, word: &str| {
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{said}");
        assert!(said.contains(word), "{said}");
        assert!(!bench.session().exists(), "{said}");
    };
    refused(bench.run_short("--out"), "a listening unit");
    std::fs::write(&bench.served.addresses, good.to_string()).expect("written");
    // Control: the same order with devices that answer.
    finished(&bench.run_short("--out"), 6);
}

fn document_of(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).expect("read")).expect("JSON")
}

#[test]
fn sigterm_and_sighup_make_safe_as_ctrl_c_does_and_nohup_is_respected() {
    let bench = Bench::start("");
    let session = bench.session().display().to_string();
    let child = bench.begun_short();
    kill(&child, "-TERM");
    let (kind, said, stopped) = cause(&ended(child));
    assert!(
        kind == "interrupted" && said.contains("SIGTERM") && stopped,
        "{said}"
    );
    // Whatever started the tests may ignore SIGHUP: the sweep begins with the signal's default.
    let resume = || {
        let plain = bench.short(&["--resume", &session]);
        let mut command = Command::new("env");
        command
            .arg("--default-signal=HUP")
            .arg(plain.get_program())
            .args(plain.get_args());
        command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("env runs")
    };
    // The second recording begins when everything is open.
    let recorded = |number: usize| {
        until("recording", || {
            bench
                .session()
                .join(format!("recording-{number}.mcap"))
                .exists()
        });
    };
    let child = resume();
    recorded(2);
    kill(&child, "-HUP");
    let (kind, said, stopped) = cause(&ended(child));
    assert!(
        kind == "interrupted" && said.contains("SIGHUP") && stopped,
        "{said}"
    );
    // A sweep that is to outlive its terminal.
    let plain = bench.short(&["--resume", &session]);
    let mut outlives = Command::new("sh");
    outlives
        .args(["-c", "trap '' HUP; exec \"$0\" \"$@\""])
        .arg(plain.get_program())
        .args(plain.get_args());
    let child = outlives
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("sh runs");
    recorded(3);
    kill(&child, "-HUP");
    finished(&ended(child), 6);
}

/// An interrogator that takes the connection and never says a word: a signal is heard while its
/// reply is waited for.
#[test]
fn a_signal_is_heard_while_a_device_hangs() {
    let bench = Bench::start("");
    let silent = TcpListener::bind("127.0.0.1:0").expect("a port");
    let mut addresses = document_of(&bench.served.addresses);
    addresses["sm130"] = silent.local_addr().expect("an address").to_string().into();
    std::fs::write(&bench.served.addresses, addresses.to_string()).expect("written");
    let session = bench.session().display().to_string();
    let begin = || {
        let child = bench
            .short(&["--out", &session])
            .spawn()
            .expect("wcal runs");
        // It has connected, and asks.
        let held = silent.accept().expect("a client");
        (child, held)
    };
    let (child, _held) = begin();
    kill(&child, "-TERM");
    let run = ended(child);
    let said = text(&run.stderr);
    assert!(
        run.status.code() == Some(1) && said.contains("SIGTERM"),
        "{said}"
    );
    assert!(!bench.session().exists(), "{said}");
    // Control: without a signal the wait ends by itself.
    let (child, _held) = begin();
    let said = text(&ended(child).stderr);
    assert!(said.contains("[timeout]"), "{said}");
}

#[test]
fn a_session_and_a_stage_have_one_sweep_at_a_time() {
    let bench = Bench::start("");
    let first = bench.begun_short();
    let me = format!("process {}", first.id());
    let beside = bench.run_short("--resume");
    let said = text(&beside.stderr);
    assert_eq!(beside.status.code(), Some(1), "{said}");
    assert!(
        said.contains(&me) && said.contains("a session that no sweep records now"),
        "{said}"
    );
    let other = bench.folder.path().join("other");
    // Whatever its environment says: temporary files elsewhere are no other machine.
    let mut elsewhere = bench.short(&["--out", &other.display().to_string()]);
    let run = elsewhere
        .env("TMPDIR", bench.folder.path())
        .spawn()
        .expect("wcal runs");
    let run = ended(run);
    let said = text(&run.stderr);
    assert_eq!(run.status.code(), Some(1), "{said}");
    assert!(
        said.contains(&me) && said.contains("a stage that no other program drives"),
        "{said}"
    );
    assert!(!other.exists(), "{said}");
    // Control: neither disturbed the first, and afterwards both are free.
    finished(&ended(first), 6);
    let left: Vec<_> = std::fs::read_dir(bench.session())
        .expect("a folder")
        .collect();
    assert!(
        !left
            .iter()
            .flatten()
            .any(|e| e.file_name().to_string_lossy().contains("tmp")),
        "{left:?}"
    );
    let run = bench
        .short(&["--out", &other.display().to_string()])
        .spawn()
        .expect("wcal runs");
    finished(&ended(run), 6);
}

/// What a user of the virtual bench meets first: it has ended, its addresses were never filled in,
/// or its input was closed from the start.
#[test]
fn a_bench_that_is_not_there_says_what_to_do() {
    let refused = |mut command: Command| {
        let run = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .output()
            .expect("wcal runs");
        assert_eq!(run.status.code(), Some(1), "{}", text(&run.stderr));
        text(&run.stderr)
    };
    let mut bench = Bench::start("");
    let session = bench.session().display().to_string();
    finished(&bench.run_short("--out"), 6);
    // Its input closes, and it ends.
    bench.served.end();
    let new = bench.folder.path().join("new").display().to_string();
    let said = refused(bench.short(&["--out", &new]));
    assert!(said.contains("127.0.0.1:"), "{said}");
    assert!(said.contains("`wcal virtual-bench`"), "{said}");
    assert!(!Path::new(&new).exists() && Path::new(&session).exists());
    // Without --bench the rig has a word where its port belongs.
    let mut plain = program();
    plain
        .arg("stage-sweep")
        .arg("--rig")
        .arg(&bench.rig)
        .args(["--home", "--out", &new]);
    plain
        .arg("--plan")
        .arg(bench.folder.path().join("short.toml"));
    let said = refused(plain);
    assert!(said.contains("127.0.0.1:PORT: `--bench"), "{said}");
    let alone = |input: Stdio| {
        let mut command = program();
        command
            .args(["virtual-bench", "--scenario"])
            .arg(bench.folder.path().join("scenario.toml"));
        command
            .stdin(input)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("wcal runs")
    };
    let closed = ended(alone(Stdio::null()));
    assert!(text(&closed.stderr).contains("input closed"), "{closed:?}");
    // Control: with an input that stays open it runs on.
    let mut open = alone(Stdio::piped());
    std::thread::sleep(Duration::from_secs(2));
    assert!(open.try_wait().expect("a child").is_none());
    open.kill().expect("killed");
    let said = text(&open.wait_with_output().expect("ends").stderr);
    assert!(!said.contains("input closed"), "{said}");
}

/// A bench in the sweep's own process ends with it: what is said goes on with another one, later by
/// its clock.
#[test]
fn ctrl_c_ends_a_sweep_in_this_process_and_what_is_said_goes_on() {
    let folder = tempfile::tempdir().expect("temporary folder");
    let (session, plan) = (
        folder.path().join("s"),
        repository("rigs/plans/paper-27.toml"),
    );
    let sweep = |option: &str| {
        let mut command = program();
        command
            .arg("stage-sweep")
            .arg("--rig")
            .arg(repository("rigs/virtual"))
            .arg("--plan")
            .arg(&plan);
        command
            .arg("--scenario")
            .arg(repository("rigs/virtual/scenario.toml"))
            .arg("--home");
        command
            .arg(option)
            .arg(&session)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        command
    };
    let child = sweep("--out").spawn().expect("wcal runs");
    super::until_done(&session, 8);
    kill(&child, "-INT");
    let run = ended(child);
    let said = text(&run.stderr);
    assert_eq!(run.status.code(), Some(130), "{said}");
    assert!(said.contains("--home and --resume"), "{said}");
    let run = sweep("--resume").output().expect("wcal runs");
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let table = std::fs::read_to_string(session.join("points.csv")).expect("points.csv");
    let times = table.lines().skip(1).map(|line| {
        line.split(',')
            .nth(4)
            .expect("t_s")
            .parse::<f64>()
            .expect("s")
    });
    let times: Vec<f64> = times.collect();
    assert!(times.len() == 36 && times.is_sorted(), "{times:?}");
}
