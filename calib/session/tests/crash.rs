//! kill -9 while recording: less than a second is lost, the file opens, and what it holds is whole.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use wcal_core::device::{Clocks, FbgReading};
use wcal_session::recording::message::Scan;
use wcal_session::recording::recorder::Recorder;
use wcal_session::recording::replay::{End, Message, read};

const RATE_HZ: f64 = 2000.0;

fn scan(serial: u64) -> FbgReading {
    let t = serial as f64 / RATE_HZ;
    FbgReading {
        serial,
        peaks_nm: vec![vec![1535.8, 1537.3, 1541.2]],
        clocks: Clocks { host_s: 1e9 + t, device_s: Some(t) },
        ..FbgReading::default()
    }
}

/// Not a test of its own: the process that is killed.
#[test]
#[ignore = "run by the test below"]
fn child_that_records() {
    let Ok(path) = std::env::var("WCAL_CRASH_FILE") else { return };
    let recorder = Recorder::create(Path::new(&path), Default::default()).unwrap();
    let (start, mut serial) = (Instant::now(), 0);
    loop {
        while (serial as f64) < start.elapsed().as_secs_f64() * RATE_HZ {
            recorder.scan(&scan(serial)).unwrap();
            serial += 1;
        }
        println!("at {serial}");
        std::io::stdout().flush().unwrap();
        std::thread::sleep(Duration::from_millis(5));
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

#[test]
fn kill_9_at_any_moment_loses_less_than_a_second() {
    let dir = tempfile::tempdir().unwrap();
    let mut worst_s: f64 = 0.0;
    for (k, wait_ms) in [350, 777, 1203, 1640, 2111].into_iter().enumerate() {
        let path = dir.path().join(format!("{k}.mcap"));
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "child_that_records", "--ignored", "--nocapture"])
            .env("WCAL_CRASH_FILE", &path)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let reader = std::thread::spawn(move || {
            lines.map_while(Result::ok).filter_map(|l| l.strip_prefix("at ")?.parse::<u64>().ok()).last()
        });
        std::thread::sleep(Duration::from_millis(wait_ms));
        child.kill().unwrap();
        child.wait().unwrap();
        // Killed before its first scan: nothing to lose.
        let Some(written) = reader.join().unwrap() else { continue };
        let (found, end) = serials(&path);
        assert!(matches!(end, End::CutOff(_)));
        assert_eq!(found, (0..found.len() as u64).collect::<Vec<_>>(), "whole up to the end");
        // What was written after the last line that was read may be in the file as well.
        worst_s = worst_s.max(written.saturating_sub(found.len() as u64) as f64 / RATE_HZ);
    }
    println!("largest loss {:.3} s", worst_s);
    assert!(worst_s < 1.0, "{worst_s} s lost");
}

#[test]
fn a_file_cut_anywhere_is_read_up_to_the_cut_and_damage_is_seen() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("whole.mcap");
    let recorder = Recorder::create(&path, Default::default()).unwrap();
    for serial in 0..3000 {
        recorder.scan(&scan(serial)).unwrap();
        if serial % 500 == 0 {
            recorder.flush().unwrap();
        }
    }
    recorder.finish().unwrap();
    let (all, end) = serials(&path);
    assert_eq!((all.len(), end), (3000, End::Closed));
    let bytes = std::fs::read(&path).unwrap();
    let cut = dir.path().join("cut.mcap");
    let mut last = 0;
    for k in 1..40 {
        std::fs::write(&cut, &bytes[..bytes.len() * k / 40]).unwrap();
        let (found, end) = serials(&cut);
        assert!(matches!(end, End::CutOff(_)) && found.len() >= last, "cut {k}");
        assert_eq!(found, (0..found.len() as u64).collect::<Vec<_>>());
        last = found.len();
    }
    assert!(last > 1000);
    // A wrong bit in a chunk must not pass as data.
    let mut damaged = bytes.clone();
    let middle = bytes.len() / 3;
    damaged[middle] ^= 0x10;
    std::fs::write(&cut, &damaged).unwrap();
    let (found, end) = serials(&cut);
    assert!(matches!(end, End::CutOff(_)) && found.len() < 3000);
    std::fs::write(&cut, b"not a recording at all, just text").unwrap();
    assert!(read(&cut, |_| {}).is_err());
    // Killed before its first flush: nothing recorded, and `--resume` goes on.
    std::fs::write(&cut, b"").unwrap();
    let (none, end) = serials(&cut);
    assert!(none.is_empty() && matches!(end, End::CutOff(_)));
}
