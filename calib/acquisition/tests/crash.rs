//! kill -9 while recording: a quarter of a second is lost at most, the file opens, and what it
//! holds is whole.
#![allow(clippy::unwrap_used, reason = "a test that fails should say where")]

use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use wcal_acquisition::message::Scan;
use wcal_acquisition::recorder::Recorder;
use wcal_acquisition::replay::{End, Message, read};
use wcal_core::deadline::Deadline;
use wcal_core::device::{Clocks, FbgReading, StageReading};

const RATE_HZ: f64 = 2000.0;
/// Time after which the recorder passes on what it holds, s.
const FLUSH_S: f64 = 0.25;

fn scan(serial: u64) -> FbgReading {
    let t = serial as f64 / RATE_HZ;
    FbgReading {
        serial,
        peaks_nm: vec![vec![1535.8, 1537.3, 1541.2]],
        clocks: Clocks {
            host_s: 1e9 + t,
            device_s: Some(t),
        },
        ..FbgReading::default()
    }
}

/// Not a test of its own: the process that is killed. It prints each scan's number and, in seconds,
/// when it gave it to the recorder.
#[test]
#[ignore = "run by the test below"]
fn child_that_records() {
    let Ok(path) = std::env::var("WCAL_CRASH_FILE") else {
        return;
    };
    let recorder = Recorder::create(Path::new(&path), Default::default()).unwrap();
    let start = Instant::now();
    for serial in 0.. {
        let given_s = start.elapsed().as_secs_f64();
        recorder.scan(&scan(serial)).unwrap();
        println!("at {serial} {given_s}");
        std::io::stdout().flush().unwrap();
        std::thread::sleep(Duration::from_secs_f64(1.0 / RATE_HZ));
    }
}

fn serials(path: &Path) -> (Vec<u64>, End) {
    let mut found = Vec::new();
    let end = read(path, |m| {
        if let Message::Scan(Scan { serial, .. }) = m {
            found.push(serial);
        }
    });
    (found, end.unwrap())
}

/// Time over which the scans were given that the file lacks, s. By the writer's own clock a loss is
/// what came within one flush, however often the machine made the writer wait.
fn lost_s(given_s: &[f64], found: &[u64]) -> f64 {
    given_s
        .get(found.len())
        .map_or(0.0, |first| given_s[given_s.len() - 1] - first)
}

#[test]
fn kill_9_at_any_moment_loses_no_more_than_a_flush() {
    let dir = tempfile::tempdir().unwrap();
    let mut worst_s: f64 = 0.0;
    for scans in [300, 777, 1203, 1640, 2111] {
        let path = dir.path().join(format!("{scans}.mcap"));
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "child_that_records", "--ignored", "--nocapture"])
            .env("WCAL_CRASH_FILE", &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap())
            .lines()
            .map_while(Result::ok);
        let mut given = lines.filter_map(|l| {
            l.strip_prefix("at ")?
                .split_once(' ')?
                .1
                .parse::<f64>()
                .ok()
        });
        let mut given_s: Vec<f64> = given.by_ref().take(scans).collect();
        child.kill().unwrap();
        child.wait().unwrap();
        given_s.extend(given);
        let (found, end) = serials(&path);
        assert!(end.cut_off.is_some());
        assert_eq!(
            found,
            (0..found.len() as u64).collect::<Vec<_>>(),
            "whole up to the end"
        );
        worst_s = worst_s.max(lost_s(&given_s, &found));
        // Control: half of the file lacks more.
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
        let (half, _) = serials(&path);
        assert!(
            scans < 1000 || lost_s(&given_s, &half) > FLUSH_S,
            "{scans}: {} of {}",
            half.len(),
            found.len()
        );
    }
    println!("largest loss {worst_s:.3} s");
    assert!(worst_s <= FLUSH_S, "{worst_s} s lost");
}

/// A closed recording of 3000 scans in several chunks.
fn recorded(folder: &Path) -> PathBuf {
    let path = folder.join("whole.mcap");
    let recorder = Recorder::create(&path, Default::default()).unwrap();
    for serial in 0..3000 {
        recorder.scan(&scan(serial)).unwrap();
        if serial % 500 == 0 {
            recorder.flush().unwrap();
        }
    }
    recorder.finish().unwrap();
    path
}

/// Where the chunks of a recording begin (their operation code), and how long each is with code and
/// length.
fn chunks(bytes: &[u8]) -> Vec<(usize, usize)> {
    let (mut at, mut found) = (8, Vec::new());
    while at + 9 <= bytes.len() {
        let length = 9 + u64::from_le_bytes(bytes[at + 1..at + 9].try_into().unwrap()) as usize;
        // 6: a chunk; 2: the footer.
        match bytes[at] {
            6 => found.push((at, length)),
            2 => break,
            _ => {}
        }
        at += length;
    }
    found
}

#[test]
fn a_file_cut_anywhere_is_read_up_to_the_cut_and_damage_is_seen() {
    let dir = tempfile::tempdir().unwrap();
    let path = recorded(dir.path());
    let (all, end) = serials(&path);
    assert_eq!((all.len(), end), (3000, End::default()));
    let bytes = std::fs::read(&path).unwrap();
    let cut = dir.path().join("cut.mcap");
    let mut last = 0;
    for k in 1..40 {
        std::fs::write(&cut, &bytes[..bytes.len() * k / 40]).unwrap();
        let (found, end) = serials(&cut);
        assert!(end.cut_off.is_some() && found.len() >= last, "cut {k}");
        assert_eq!(found, (0..found.len() as u64).collect::<Vec<_>>());
        last = found.len();
    }
    assert!(last > 1000);
    std::fs::write(&cut, b"not a recording at all, just text").unwrap();
    assert!(read(&cut, |_| {}).is_err());
    // Killed before its first flush: nothing recorded, and `--resume` goes on.
    std::fs::write(&cut, b"").unwrap();
    let (none, end) = serials(&cut);
    assert!(none.is_empty() && end.cut_off.is_some());
}

/// A wrong bit costs its chunk, no more: what follows is read, and the loss is counted.
#[test]
fn a_damaged_chunk_is_left_out_and_those_behind_it_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(recorded(dir.path())).unwrap();
    let (path, chunks) = (dir.path().join("damaged.mcap"), chunks(&bytes));
    let (at, length) = chunks[chunks.len() / 2];
    let mut damaged = bytes.clone();
    damaged[at + length - 20] ^= 0x10;
    std::fs::write(&path, &damaged).unwrap();
    let (found, end) = serials(&path);
    assert_eq!(
        end,
        End {
            damaged_chunks: 1,
            ..End::default()
        }
    );
    let missing: Vec<u64> = (0..3000).filter(|k| !found.contains(k)).collect();
    assert!(
        !missing.is_empty() && missing.len() < 1000,
        "{} missing",
        missing.len()
    );
    assert!(
        missing.windows(2).all(|p| p[1] == p[0] + 1) && found.contains(&0) && found.contains(&2999)
    );
    assert!(
        end.to_string().contains("1 damaged chunks left out"),
        "{end}"
    );
}

/// No stated length is believed: none asks for more memory than the file has, and what can be read
/// is.
#[test]
fn corrupt_lengths_neither_abort_nor_hide_what_is_readable() {
    let dir = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(recorded(dir.path())).unwrap();
    let (path, chunks) = (dir.path().join("damaged.mcap"), chunks(&bytes));
    let (at, _) = chunks[chunks.len() - 1];
    let read = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut damaged = bytes.clone();
        change(&mut damaged);
        std::fs::write(&path, &damaged).unwrap();
        serials(&path)
    };
    // In a chunk: uncompressed size at 16, checksum at 24, length of the compression's name at 28,
    // size of the records at 32.
    for length in [u64::MAX, u64::MAX - 8, 1 << 62, 1 << 40, bytes.len() as u64] {
        let put = |b: &mut Vec<u8>, at: usize| b[at..at + 8].copy_from_slice(&length.to_le_bytes());
        let (found, end) = read(&|b| put(b, at + 1));
        assert!(
            end.cut_off.is_some() && found.len() > 1000 && found.len() < 3000,
            "record {length}: {end}"
        );
        let (found, end) = read(&|b| put(b, at + 9 + 32));
        assert!(
            end.damaged_chunks == 1 && found.len() > 1000 && found.len() < 3000,
            "records {length}: {end}"
        );
        // Without a checksum a record's own length is all there is to go by.
        let (found, end) = read(&|b| {
            b[at + 9 + 24..at + 9 + 28].fill(0);
            put(b, at + 9 + 40 + 1);
        });
        assert!(
            end.damaged_chunks == 1 && found.len() > 1000 && found.len() < 3000,
            "message {length}: {end}"
        );
    }
    let (_, end) = read(&|b| b[at + 9 + 28..at + 9 + 32].fill(0xff));
    assert_eq!(end.damaged_chunks, 1);
    // Anywhere: only scans that were recorded, in their order, and never a panic.
    for k in 0..400 {
        let place = 8 + (bytes.len() - 16) * k / 400;
        let (found, _) = read(&|b| b[place..place + 8].fill(0xff));
        assert!(
            found.windows(2).all(|p| p[1] > p[0]) && found.iter().all(|s| *s < 3000),
            "at {place}"
        );
    }
    // Control: unchanged it is whole.
    assert_eq!(read(&|_| {}).1, End::default());
}

/// The same file with another number in place of one, and no checksums of chunks.
fn with_number(bytes: &[u8], from: f64, to: f64) -> Vec<u8> {
    let mut changed = bytes.to_vec();
    for (at, _) in chunks(bytes) {
        changed[at + 9 + 24..at + 9 + 28].fill(0);
    }
    let place = bytes
        .windows(8)
        .position(|b| b == from.to_le_bytes())
        .unwrap();
    changed[place..place + 8].copy_from_slice(&to.to_le_bytes());
    changed
}

/// What the reader refuses the recorder does not write; where it stands in a file all the same, it
/// costs itself alone.
#[test]
fn an_odd_number_of_a_device_costs_its_own_message() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("odd.mcap");
    let odd = |serial: u64| -> FbgReading {
        let mut reading = scan(serial);
        match serial {
            10 => reading.peaks_nm[0][1] = f64::INFINITY,
            20 => reading.peaks_nm[0][0] = 1e30,
            30 => reading.clocks.device_s = Some(1e300),
            // What a unit sends in place of a peak that it does not have.
            40 => reading.peaks_nm[0][2] = f64::NAN,
            50 => reading.peaks_nm[0][1] = 1537.25,
            _ => {}
        }
        reading
    };
    let recorder = Recorder::create(&path, Default::default()).unwrap();
    let written = (0..100)
        .filter(|serial| recorder.scan(&odd(*serial)).unwrap())
        .count();
    let far = StageReading {
        measured_mm: 1e20,
        ..StageReading::default()
    };
    assert!(!recorder.stage(&far).unwrap() && recorder.stage(&StageReading::default()).unwrap());
    let said = recorder.refused().text().unwrap();
    assert!(
        said.starts_with("4 messages") && said.contains("/fbg/scan: peaks_nm: expected"),
        "{said}"
    );
    recorder.finish().unwrap();
    let (found, end) = serials(&path);
    let without =
        |odd: &[u64]| -> Vec<u64> { (0..100).filter(|serial| !odd.contains(serial)).collect() };
    assert_eq!(
        (written, &found, &end),
        (97, &without(&[10, 20, 30]), &End::default())
    );
    // Another program wrote it.
    let bytes = std::fs::read(&path).unwrap();
    std::fs::write(&path, with_number(&bytes, 1537.25, f64::INFINITY)).unwrap();
    let (found, end) = serials(&path);
    assert_eq!(found, without(&[10, 20, 30, 50]));
    let said = end.to_string();
    assert!(
        !end.is_whole() && said.contains("1 messages") && said.contains("/fbg/scan: peaks_nm"),
        "{said}"
    );
    // Negative control: a number that the field may have.
    std::fs::write(&path, with_number(&bytes, 1537.25, 1537.26)).unwrap();
    assert_eq!(serials(&path), (without(&[10, 20, 30]), End::default()));
}

/// Files are merged with copies of themselves: message by message, chunk by chunk, or one behind
/// the other.
#[test]
fn a_message_that_a_file_holds_again_is_given_once() {
    let dir = tempfile::tempdir().unwrap();
    let (path, bytes) = (
        dir.path().join("merged.mcap"),
        std::fs::read(recorded(dir.path())).unwrap(),
    );
    let own = chunks(&bytes);
    let (first, (last, length)) = (own[0].0, own[own.len() - 1]);
    let all: Vec<u64> = (0..3000).collect();
    let merged = |parts: Vec<&[u8]>| {
        std::fs::write(&path, parts.concat()).unwrap();
        serials(&path)
    };
    let (head, body, tail) = (
        &bytes[..first],
        &bytes[first..last + length],
        &bytes[last + length..],
    );
    let each_twice = own
        .iter()
        .flat_map(|(at, length)| [&bytes[*at..at + length]; 2]);
    let (found, end) = merged([head].into_iter().chain(each_twice).chain([tail]).collect());
    assert_eq!((&found, end.repeated), (&all, 3000));
    // A copy that lacks a chunk, and the whole one behind it.
    let (at, gone) = own[1];
    let (found, end) = merged(vec![
        head,
        &bytes[first..at],
        &bytes[at + gone..last + length],
        body,
        tail,
    ]);
    assert_eq!(
        found.iter().copied().collect::<BTreeSet<u64>>().len(),
        found.len()
    );
    assert!(
        found.len() == 3000 && (1000..3000).contains(&end.repeated),
        "{end:?}"
    );
    // Negative controls: once; and a unit that was started again counts from 0 again, later.
    assert_eq!(merged(vec![head, body, tail]), (all, End::default()));
    let again = dir.path().join("again.mcap");
    let recorder = Recorder::create(&again, Default::default()).unwrap();
    for k in 0..600 {
        let mut reading = scan(k % 300);
        reading.clocks.host_s = 1e9 + k as f64 / RATE_HZ;
        recorder.scan(&reading).unwrap();
    }
    recorder.finish().unwrap();
    assert_eq!(
        (serials(&again).0.len(), serials(&again).1),
        (600, End::default())
    );
}

/// Not a test of its own: the process that is stopped. It waits for what never comes, and says how
/// long it did.
#[test]
#[ignore = "run by the test below"]
fn child_that_waits() {
    if std::env::var("WCAL_WAITS").is_err() {
        return;
    }
    let deadline = Deadline::uninterruptible(Duration::from_secs(2));
    let start = Instant::now();
    println!("at begin");
    std::io::stdout().flush().unwrap();
    while !deadline.is_over() {
        std::thread::sleep(Duration::from_millis(20));
    }
    println!("at {}", start.elapsed().as_secs_f64());
}

/// A program that was stopped did not wait for a device meanwhile: its wait has what was left of it
/// when it goes on.
#[test]
fn a_wait_goes_on_where_the_program_was_stopped() {
    let waited_s = |stopped: Option<Duration>| -> f64 {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "child_that_waits", "--ignored", "--nocapture"])
            .env("WCAL_WAITS", "1")
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap())
            .lines()
            .map_while(Result::ok);
        let mut said = lines.filter_map(|line| line.strip_prefix("at ").map(str::to_owned));
        assert_eq!(said.next().as_deref(), Some("begin"));
        if let Some(stopped) = stopped {
            let signal = |name: &str| {
                let id = child.id().to_string();
                assert!(
                    Command::new("kill")
                        .args([name, &id])
                        .status()
                        .unwrap()
                        .success()
                );
            };
            signal("-STOP");
            std::thread::sleep(stopped);
            signal("-CONT");
        }
        let waited_s = said.next().unwrap().parse().unwrap();
        child.wait().unwrap();
        waited_s
    };
    let stopped = waited_s(Some(Duration::from_secs(4)));
    assert!(stopped > 5.5, "{stopped} s, of which 4 were no wait");
    // Negative control: who is not stopped waits no longer than was allowed.
    let plain = waited_s(None);
    assert!((2.0..3.5).contains(&plain), "{plain} s");
}
