//! The live page of a sweep and of a track, as a browser and as clients that behave badly see it
//! (SIMULATED).

#[path = "../../calib/report/tests/headless/mod.rs"]
#[allow(dead_code, reason = "each target uses a part")]
mod headless;

use crate::support::{code_and_messages, not_run, program, repository, text, until};
use serde_json::Value;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

/// A sweep on the bench in its own process, with its page; stopped with the test.
struct Sweep {
    child: Child,
    stderr: BufReader<std::process::ChildStderr>,
    session: PathBuf,
    /// `127.0.0.1:PORT`, and `/KEY/`.
    address: String,
    key: String,
}

/// Rig, plan of some minutes of the bench, and scenario.
fn arguments(folder: &Path, seed: u64, replicates: u32) -> [String; 7] {
    let write = |name: &str, text: &str| {
        std::fs::write(folder.join(name), text).unwrap();
        folder.join(name).display().to_string()
    };
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).unwrap();
    let rig = rig.replace("rate_hz = 2000.0", "rate_hz = 500.0");
    let rig = write("rig.toml", rig.split("[[camera]]").next().unwrap());
    let plan = format!(
        "format = \"wcal-plan/1\"\nname = \"seen\"\n[[block]]\nrole = \"calibration\"\ntrajectories = [1, 5, 9]\n\
         depths_mm = [1.5, 3.0]\nreplicates = {replicates}\n[[block]]\nrole = \"holdout\"\ntrajectories = [2]\ndepths_mm = [2.0]\n"
    );
    let plan = write("plan.toml", &plan);
    let scenario =
        format!("format = \"wcal-scenario/1\"\nseed = {seed}\n[interrogator]\nrate_hz = 500.0\n");
    let scenario = write("scenario.toml", &scenario);
    let words = [
        "--home",
        "--rig",
        &rig,
        "--plan",
        &plan,
        "--scenario",
        &scenario,
    ];
    words.map(str::to_owned)
}

impl Sweep {
    fn start(folder: &Path, seed: u64, replicates: u32) -> Self {
        let session = folder.join(format!("session-{seed}"));
        let mut command = program();
        command
            .arg("stage-sweep")
            .args(arguments(folder, seed, replicates))
            .args(["--live-page", "--json", "--out"])
            .arg(&session);
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stderr = BufReader::new(child.stderr.take().unwrap());
        let mut said = String::new();
        let url = loop {
            let begun = said.len();
            assert!(stderr.read_line(&mut said).unwrap() > 0, "{said}");
            if let Some(url) = said[begun..].strip_prefix("live page: http://") {
                break url.trim().to_owned();
            }
        };
        let (address, key) = url.split_at(url.find('/').unwrap());
        assert!(
            address.starts_with("127.0.0.1:") && key.len() == 34,
            "{url}"
        );
        Self {
            address: address.to_owned(),
            key: key.to_owned(),
            child,
            stderr,
            session,
        }
    }

    /// What the server answers to a request; none where it has gone.
    fn ask(&self, line: &str) -> Option<String> {
        let mut stream = TcpStream::connect(&self.address).ok()?;
        let request = format!("{line} HTTP/1.1\r\nHost: {}\r\n\r\n", self.address);
        stream.write_all(request.as_bytes()).ok()?;
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).ok()?;
        Some(text(&answer)).filter(|answer| !answer.is_empty())
    }

    fn state(&self) -> Option<Value> {
        let answer = self.ask(&format!("GET {}state.json", self.key))?;
        assert!(answer.starts_with("HTTP/1.1 200 OK\r\n"), "{answer}");
        Some(serde_json::from_str(answer.split_once("\r\n\r\n")?.1).unwrap())
    }

    /// Waits for its end; what it printed.
    fn end(&mut self) -> Value {
        let (mut out, mut said) = (String::new(), String::new());
        let printed = self.child.stdout.take().unwrap().read_to_string(&mut out);
        self.stderr.read_to_string(&mut said).unwrap();
        let code = self.child.wait().unwrap().code();
        assert!(printed.is_ok() && code == Some(0), "{code:?}: {said}");
        serde_json::from_str(&out).unwrap()
    }
}

impl Drop for Sweep {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The state within a page that was kept.
fn kept(page: &str) -> Value {
    let state = page.split("id=\"last\">").nth(1).unwrap();
    serde_json::from_str(state.split("</script>").next().unwrap()).unwrap()
}

/// Lines of a session's tables of readings, without their heads.
fn rows(session: &Path) -> Vec<String> {
    let of = |name: &str| {
        let table = std::fs::read_to_string(session.join(name)).unwrap();
        let lines: Vec<String> = table.lines().skip(1).map(str::to_owned).collect();
        lines
    };
    [of("points.csv"), of("holdout.csv")].concat()
}

/// What is wrong with the last state of a sweep, held against what was written.
fn disagreements(state: &Value, printed: &Value, rows: usize) -> Vec<&'static str> {
    let both = [
        "scans",
        "lost_scans",
        "gaps",
        "simulated",
        "ending",
        "warnings",
    ];
    let mut wrong: Vec<_> = both
        .into_iter()
        .filter(|key| state[key] != printed[key])
        .collect();
    if state["readings"] != rows {
        wrong.push("readings");
    }
    wrong
}

#[test]
fn a_sweep_is_seen_while_it_runs_and_its_counts_are_those_of_the_session() {
    let folder = tempfile::tempdir().unwrap();
    let mut sweep = Sweep::start(folder.path(), 3, 20);
    let page = sweep.ask(&format!("GET {}", sweep.key)).unwrap();
    let all = page.matches("\"calibration\"]").count() + page.matches("\"rest\"]").count();
    assert!(
        page.contains("Content-Security-Policy: default-src 'none'"),
        "{page}"
    );
    assert!(kept(&page).is_null(), "a served page asks for its state");
    // Whatever else is asked for is not there, and the sweep goes on.
    let key = sweep.key.clone();
    let long = format!("GET {key}{}", "x".repeat(5000));
    for line in [
        "GET /".to_owned(),
        format!("GET /{}/state.json", "0".repeat(32)),
        format!("GET {}", key.trim_end_matches('/')),
        format!("GET {key}run.json"),
        format!("GET {key}../state.json"),
        format!("POST {key}state.json"),
        format!("HEAD {key}"),
        String::new(),
    ] {
        let answer = sweep.ask(&line).unwrap();
        assert!(answer.starts_with("HTTP/1.1 404 "), "{line}: {answer}");
    }
    // Refused before all of it was read: the connection may be reset with the answer on its way.
    assert!(
        sweep
            .ask(&long)
            .is_none_or(|a| a.starts_with("HTTP/1.1 404 ")),
        "{long}"
    );
    let mut seen = Vec::new();
    while let Some(state) = sweep.state() {
        seen.push(state);
        if seen.last().unwrap()["ending"] != "running" {
            break;
        }
    }
    let printed = sweep.end();
    let rows = rows(&sweep.session).len();
    // While it ran, counts and steps rose, and never beyond what was written in the end.
    let running: Vec<&Value> = seen.iter().filter(|s| s["ending"] == "running").collect();
    assert!(running.len() > 1, "{} states", running.len());
    for key in ["scans", "readings", "step"] {
        let counts: Vec<u64> = running.iter().filter_map(|s| s[key].as_u64()).collect();
        assert!(
            counts.is_sorted() && counts[0] < counts[counts.len() - 1],
            "{key}: {counts:?}"
        );
    }
    let last = running[running.len() - 1];
    assert!(last["scans"].as_u64() <= printed["scans"].as_u64());
    assert!(
        last["simulated"] == true && last["now"][2].as_f64() > Some(1536.0),
        "{last}"
    );
    assert_eq!(all + 1, rows, "the page has every reading of the plan");
    // The page that stays has the last state, and it agrees with the session.
    let state = kept(&std::fs::read_to_string(sweep.session.join("live.html")).unwrap());
    assert_eq!(
        disagreements(&state, &printed, rows),
        Vec::<&str>::new(),
        "{state}"
    );
    assert_eq!(
        state["trace"][0].as_array().unwrap().len(),
        state["columns"].as_array().unwrap().len()
    );
    // Controls: a state from its middle, and another number of rows.
    assert!(disagreements(running[0], &printed, rows).contains(&"scans"));
    assert!(disagreements(&state, &printed, rows + 1) == ["readings"]);
}

#[test]
fn clients_that_stall_are_dropped_and_cost_a_sweep_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let plain = |seed: u64| {
        let session = folder.path().join(format!("plain-{seed}"));
        let out = ["--out".to_owned(), session.display().to_string()];
        let words = [
            vec!["stage-sweep".to_owned()],
            arguments(folder.path(), seed, 6).to_vec(),
            out.to_vec(),
        ];
        let words = words.concat();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let (code, said) = code_and_messages(&words);
        assert_eq!(code, 0, "{said}");
        without_time(&session)
    };
    let (without, other) = (plain(3), plain(4));
    let mut sweep = Sweep::start(folder.path(), 3, 6);
    let request = format!("GET {} HTTP/1.1\r\n\r\n", sweep.key);
    // More than may be open at once: some say nothing, some half a line, some take no answer.
    let mut stalled: Vec<TcpStream> = Vec::new();
    for k in 0..24 {
        let mut stream = TcpStream::connect(&sweep.address).unwrap();
        stream.set_nonblocking(true).unwrap();
        let _ = stream.write_all(["", "GET /", &request][k % 3].as_bytes());
        stalled.push(stream);
    }
    let printed = sweep.end();
    assert_eq!(
        (&printed["lost_scans"], &printed["gaps"]),
        (&0.into(), &0.into()),
        "{printed}"
    );
    assert_eq!(without_time(&sweep.session), without);
    // Control: other noise is other rows.
    assert_ne!(other, without);
    drop(stalled);
}

/// Rows of a session but for the time at which they were taken.
fn without_time(session: &Path) -> Vec<String> {
    let cut = |line: String| {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells.remove(4);
        cells.join(",")
    };
    rows(session).into_iter().map(cut).collect()
}

#[test]
fn a_silent_client_is_dropped_while_others_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    let sweep = Sweep::start(folder.path(), 5, 400);
    let silent = || {
        let stream = TcpStream::connect(&sweep.address).unwrap();
        stream.set_nonblocking(true).unwrap();
        stream
    };
    let mut few: Vec<TcpStream> = (0..7).map(|_| silent()).collect();
    // The eighth connection is free, and answered though the others stall.
    assert_eq!(sweep.state().unwrap()["ending"], "running");
    let mut byte = [0];
    let waits = |stream: &mut TcpStream, byte: &mut [u8]| matches!(stream.read(byte), Err(e) if e.kind() == ErrorKind::WouldBlock);
    for stream in &mut few {
        until("a silent client is dropped", || !waits(stream, &mut byte));
    }
    assert_eq!(sweep.state().unwrap()["ending"], "running");
    // Control: nothing comes, and no end, where nobody looks at the connection.
    let idle = TcpListener::bind("127.0.0.1:0").unwrap();
    let mut stream = TcpStream::connect(idle.local_addr().unwrap()).unwrap();
    stream.set_nonblocking(true).unwrap();
    assert!(waits(&mut stream, &mut byte));
}

#[test]
fn a_port_that_is_taken_is_an_error_before_anything_opens() {
    let folder = tempfile::tempdir().unwrap();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let session = folder.path().join("session").display().to_string();
    let words = arguments(folder.path(), 3, 1);
    let sweep = ["stage-sweep", "--live-page", &port, "--out", &session];
    let all = [&sweep[..], &words.each_ref().map(String::as_str)].concat();
    let (code, said) = code_and_messages(&all);
    assert_eq!(code, 1, "{said}");
    assert!(
        said.contains(&format!("--live-page {port}: expected a free port")),
        "{said}"
    );
    assert!(!Path::new(&session).exists());
    // Control: free again, it serves.
    drop(taken);
    let (code, said) = code_and_messages(&all);
    assert!(
        code == 0 && said.contains(&format!("live page: http://127.0.0.1:{port}/")),
        "{code}: {said}"
    );
}

#[test]
fn the_page_of_a_track_has_its_rows_and_goes_with_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut sweep = Sweep::start(folder.path(), 3, 2);
    sweep.end();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let (session, fit, out) = (
        sweep.session.display().to_string(),
        at("fit"),
        at("track.csv"),
    );
    let (code, said) = code_and_messages(&["fit-gpr", &session, "--out", &fit]);
    assert_eq!(code, 0, "{said}");
    let (recording, calibration) = (
        format!("{session}/recording.mcap"),
        format!("{fit}/calibration.json"),
    );
    let rig = at("rig.toml");
    let words = [
        "track",
        &recording,
        "--rig",
        &rig,
        "--calibration",
        &calibration,
        "--force",
        "--out",
        &out,
    ];
    let (code, said) = code_and_messages(&[&words[..], &["--live-page"]].concat());
    assert!(
        [0, 3].contains(&code) && said.contains("live page: http://127.0.0.1:"),
        "{said}"
    );
    let page = at("track.live.html");
    let state = kept(&std::fs::read_to_string(&page).unwrap());
    let table = std::fs::read_to_string(&out).unwrap();
    let summary: Value = serde_json::from_slice(&std::fs::read(at("track.json")).unwrap()).unwrap();
    assert_eq!(state["readings"], table.lines().count() - 1, "{state}");
    assert!(
        state["ending"] == "finished" && state["simulated"] == true,
        "{state}"
    );
    // Shown row by row: at most the scans since the newest one are not counted yet.
    let (shown, all) = (
        state["scans"].as_u64().unwrap(),
        summary["scans"].as_u64().unwrap(),
    );
    assert!(shown <= all && all < shown + 500, "{shown} of {all}");
    let last: Vec<&str> = table.lines().last().unwrap().split(',').collect();
    let newest_s: f64 = last[1].parse().unwrap();
    assert!(
        (state["now"][0].as_f64().unwrap() - newest_s).abs() < 1e-5,
        "{last:?}"
    );
    assert_eq!(state["status"][0], last[17], "{last:?}");
    // A place is shown where there is contact (the groove pressed), and nowhere else.
    let rows = state["trace"].as_array().unwrap();
    let touches = |row: &&Value| row[4].as_f64() > Some(0.5);
    assert!(rows.iter().filter(touches).all(|row| row[1].is_number()));
    assert!(
        rows.iter().any(|row| touches(&row))
            && rows.iter().any(|row| !touches(&row) && row[1].is_null())
    );
    // Control: tracked again without a page, none of the earlier track stays.
    assert!([0, 3].contains(&code_and_messages(&words).0) && !Path::new(&page).exists());
    // A page of somebody else is not written over, and a table needs none.
    std::fs::remove_file(&out).unwrap();
    std::fs::write(&page, "mine").unwrap();
    let foreign = [
        "track",
        &recording,
        "--rig",
        &rig,
        "--calibration",
        &calibration,
        "--out",
        &out,
        "--live-page",
    ];
    let (code, said) = code_and_messages(&foreign);
    assert!(
        code == 1 && said.contains("track.live.html: expected no file"),
        "{said}"
    );
    let table = [
        "track",
        &session,
        "--calibration",
        &calibration,
        "--out",
        &at("other.csv"),
        "--live-page",
    ];
    let (code, said) = code_and_messages(&table);
    assert!(
        code == 1 && said.contains("--live-page: expected a stream"),
        "{said}"
    );
}

#[test]
fn the_kept_page_shows_the_number_of_readings_in_a_browser() {
    let Some(browser) = headless::browser() else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let mut sweep = Sweep::start(folder.path(), 3, 2);
    sweep.end();
    let place = sweep.session.join("live.html");
    let count = rows(&sweep.session).len();
    let shown = format!("<dt>readings</dt><dd>{count} of {count}</dd>");
    let visit = headless::visit(&browser, &place, 1280);
    assert!(visit.console.is_empty(), "{:?}", visit.console);
    assert!(visit.dom.contains(&shown), "{}", visit.dom);
    let page = std::fs::read_to_string(&place).unwrap();
    assert!(headless::content_width(&browser, &page, 400) <= 400);
    // Control: without its state the page has nothing to show, and says so.
    let (head, rest) = page.split_once("id=\"last\">").unwrap();
    let tail = rest.split_once("</script>").unwrap().1;
    std::fs::write(&place, format!("{head}id=\"last\">null</script>{tail}")).unwrap();
    let visit = headless::visit(&browser, &place, 1280);
    assert!(
        !visit.dom.contains(&shown) && visit.dom.contains("wcal"),
        "{}",
        visit.dom
    );
}
