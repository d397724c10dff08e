//! Recordings with gaps or damage, reduced as far as they can be read.

use super::*;
use wcal_acquisition::message::SweepEvent;
use wcal_acquisition::recorder::Recorder;
use wcal_core::device::{Clocks, FbgReading, StageReading};

/// A folder with a recording of 60 s: scans are missing around 20 s and for an instant at 40 s, and
/// come 20 s late around 30 s; a settled window of one second each at 10, 20, 30 and 40 s.
fn recorded_with_gaps(folder: &Path) {
    folder_of_a_sweep(folder);
    let recorder =
        Recorder::create(&folder.join("recording.mcap"), Default::default()).expect("recorder");
    for serial in 0..6000_u64 {
        let t_s = serial as f64 / RATE_HZ;
        if (20.3..20.6).contains(&t_s) || (40.30..40.34).contains(&t_s) {
            continue;
        }
        let late_s = if (29.5..31.5).contains(&t_s) {
            20.0
        } else {
            0.0
        };
        record(&recorder, serial, t_s + late_s, t_s);
    }
    record_windows(&recorder, 0.0);
    recorder.finish().expect("closed");
}

const RATE_HZ: f64 = 100.0;

/// Rig and run file.
fn folder_of_a_sweep(folder: &Path) {
    let rig = std::fs::read_to_string(repository("rigs/virtual/rig.toml")).expect("rig");
    std::fs::write(folder.join("rig.toml"), rig).expect("written");
    let run = serde_json::json!({
        "format": "wcal-run/1", "id": "gaps", "medium": "air", "created": "2026-01-01T00:00:00Z", "program": "wcal", "command": [],
        "rig_sha256": "", "plan_sha256": "", "devices": {}, "clock_scale": 4.0,
    });
    std::fs::write(folder.join("run.json"), run.to_string()).expect("written");
}

/// A scan that came at `host_s` and states `device_s`, and every tenth time where the stage was.
fn record(recorder: &Recorder, serial: u64, host_s: f64, device_s: f64) {
    let nm = |base: f64| base + 1e-3 * ((serial * 37 % 101) as f64 / 50.0 - 1.0);
    let reading = FbgReading {
        serial,
        peaks_nm: vec![vec![nm(1535.8), nm(1537.3), nm(1541.2)]],
        clocks: Clocks {
            host_s: 1e9 + host_s,
            device_s: Some(device_s),
        },
        ..FbgReading::default()
    };
    recorder.scan(&reading).expect("recorded");
    if serial.is_multiple_of(500) {
        recorder.flush().expect("flushed");
    }
    if serial.is_multiple_of(10) {
        let t_s = serial as f64 / RATE_HZ;
        let clocks = Clocks {
            host_s: 1e9 + t_s,
            device_s: None,
        };
        let measured_mm = 20.0 + (t_s / 10.0).floor();
        recorder
            .stage(&StageReading {
                measured_mm,
                clocks,
                ..StageReading::default()
            })
            .expect("recorded");
    }
}

/// A settled window of one second each at 10, 20, 30 and 40 s; `step_s`: of the device's clock
/// between the second and the third.
fn record_windows(recorder: &Recorder, step_s: f64) {
    for (step, begin_s) in [10.0, 20.0, 30.0, 40.0].into_iter().enumerate() {
        let own_s = begin_s + if step > 1 { step_s } else { 0.0 };
        let event = SweepEvent {
            kind: "window".to_owned(),
            step: step as u32,
            role: "calibration".to_owned(),
            trajectory: 1,
            replicate: 1,
            target_mm: 1.0 + step as f64,
            direction: 1,
            begin_s: own_s,
            end_s: own_s + 1.0,
            arrived_s: own_s - 1.0,
            settled: true,
            ..SweepEvent::default()
        };
        recorder.event(1e9 + begin_s, &event).expect("recorded");
    }
}

fn reduce(session: &Path) -> Output {
    program()
        .arg("reduce")
        .arg(session)
        .arg("--json")
        .output()
        .expect("wcal runs")
}

/// Column of points.csv.
fn column(session: &Path, name: &str) -> Vec<String> {
    let table = std::fs::read_to_string(session.join("points.csv")).expect("points.csv");
    let at = table
        .lines()
        .next()
        .expect("a header")
        .split(',')
        .position(|c| c == name)
        .expect("the column");
    table
        .lines()
        .skip(1)
        .map(|l| l.split(',').nth(at).expect("a cell").to_owned())
        .collect()
}

#[test]
fn rows_whose_scans_are_missing_or_late_are_marked_and_said() {
    let folder = tempfile::tempdir().expect("temporary folder");
    recorded_with_gaps(folder.path());
    let run = reduce(folder.path());
    let message = text(&run.stderr);
    assert_eq!(run.status.code(), Some(3), "{message}");
    // The last window misses four scans of a hundred: no reason to doubt its mean.
    assert_eq!(
        column(folder.path(), "stream"),
        ["ok", "lost", "late", "ok"]
    );
    for expected in [
        "34 scans lost in 2 gaps",
        "200 scans late, by up to 20.0 s",
        "1 rows with scans missing and 1 with late scans",
    ] {
        assert!(message.contains(expected), "{expected}: {message}");
    }
    // Where the stage was follows the clocks, which the late scans do not move.
    let depths: Vec<f64> = column(folder.path(), "stage_mm")
        .iter()
        .map(|s| s.parse().expect("mm"))
        .collect();
    assert_eq!(depths, [1.0, 2.0, 3.0, 4.0]);
    let session: toml::Table = std::fs::read_to_string(folder.path().join("session.toml"))
        .expect("session.toml")
        .parse()
        .expect("TOML");
    // Each window is a second long, and its mean is of its middle.
    assert_eq!(column(folder.path(), "average_s"), ["1.0000"; 4]);
    let stream = &session["devices"]["stream"];
    assert_eq!(
        (&stream["lost_scans"], &stream["late_scans"]),
        (&34.into(), &200.into())
    );
    assert_eq!(
        stream["warnings"].as_array().map(Vec::len),
        Some(3),
        "{stream}"
    );
    let loaded = wcal_session::load(folder.path()).expect("loads");
    let own_s = |loaded: &wcal_session::LoadedSession| {
        let wcal_core::observation::SessionData::Whisker(data) = &loaded.data else {
            unreachable!("a whisker")
        };
        let own =
            |r: &wcal_core::observation::WhiskerRow| (r.t_s.expect("s"), r.dwell_s.expect("s"));
        data.rows.iter().map(own).collect::<Vec<_>>()
    };
    let written = |name: &str| -> Vec<f64> {
        column(folder.path(), name)
            .iter()
            .map(|s| s.parse().expect("s"))
            .collect()
    };
    let written: Vec<(f64, f64)> = written("t_s").into_iter().zip(written("dwell_s")).collect();
    assert_eq!(
        own_s(&loaded),
        written
            .iter()
            .map(|(t, d)| (t - 0.5, d - 0.5))
            .collect::<Vec<_>>()
    );
    // Control: a row in motion has its time already.
    let points = folder.path().join("points.csv");
    let table = std::fs::read_to_string(&points).expect("points.csv");
    std::fs::write(&points, table.replace(",0.0000,2.0000,", ",1.0000,2.0000,")).expect("written");
    assert_eq!(
        own_s(&wcal_session::load(folder.path()).expect("loads")),
        written
    );
    for expected in [
        "points 1: scans are missing in the averaging window",
        "points 2: scans came late",
    ] {
        assert!(
            loaded
                .warnings
                .iter()
                .any(|w| w.to_string().contains(expected)),
            "{expected}: {:?}",
            loaded.warnings
        );
    }
}

#[test]
fn a_damaged_recording_is_reduced_as_far_as_it_can_be_read() {
    let folder = tempfile::tempdir().expect("temporary folder");
    recorded_with_gaps(folder.path());
    let recording = folder.path().join("recording.mcap");
    let bytes = std::fs::read(&recording).expect("recording");
    // Chunks have operation code 6, then their length.
    let length = |at: usize| u64::from_le_bytes(bytes[at + 1..at + 9].try_into().expect("8 bytes"));
    let (mut at, mut chunks) = (8, Vec::new());
    while bytes[at] != 2 {
        chunks.extend((bytes[at] == 6).then_some(at));
        at += 9 + length(at) as usize;
    }
    let (at, all) = (
        *chunks.last().expect("chunks"),
        document(&reduce(folder.path())),
    );
    let damaged = |change: &dyn Fn(&mut Vec<u8>)| {
        let mut copy = bytes.clone();
        change(&mut copy);
        std::fs::write(&recording, copy).expect("written");
        reduce(folder.path())
    };
    let long = damaged(&|b| b[at + 1..at + 9].copy_from_slice(&(1_u64 << 44).to_le_bytes()));
    assert_eq!(long.status.code(), Some(3), "{}", text(&long.stderr));
    assert!(
        text(&long.stderr).contains("cut off"),
        "{}",
        text(&long.stderr)
    );
    let middle = chunks[chunks.len() / 2];
    let bit = damaged(&|b| b[middle + length(middle) as usize / 2] ^= 1);
    assert_eq!(bit.status.code(), Some(3), "{}", text(&bit.stderr));
    assert!(
        text(&bit.stderr).contains("1 damaged"),
        "{}",
        text(&bit.stderr)
    );
    let (bit, long) = (document(&bit), document(&long));
    assert!(
        long["scans"].as_u64() > Some(0) && long["scans"].as_u64() <= all["scans"].as_u64(),
        "{long}"
    );
    assert!(
        bit["scans"].as_u64() > Some(3000) && bit["scans"].as_u64() < all["scans"].as_u64(),
        "{bit}"
    );
    assert_eq!(
        (&bit["damaged_chunks"], &bit["cut_off"]),
        (&1.into(), &0.into())
    );
    // Control: put back as it was, nothing but the gaps is said.
    let whole = damaged(&|_| {});
    assert!(!text(&whole.stderr).contains("damaged") && !text(&whole.stderr).contains("cut off"));
}

/// Scans of 60 s whose clock is set at 25 s, and the windows; the events come where they came in
/// time.
fn recorded_with_a_step(folder: &Path, step_s: f64) {
    folder_of_a_sweep(folder);
    let recorder =
        Recorder::create(&folder.join("recording.mcap"), Default::default()).expect("recorder");
    let scans = |range: std::ops::Range<u64>| {
        for serial in range {
            let t_s = serial as f64 / RATE_HZ;
            // As late as a busy computer is.
            let delay_s = (serial * 7919 % 97) as f64 / 97.0 * 0.3;
            record(
                &recorder,
                serial,
                t_s + delay_s,
                t_s + if t_s > 25.0 { step_s } else { 0.0 },
            );
        }
    };
    scans(0..6000);
    record_windows(&recorder, step_s);
    recorder.finish().expect("closed");
}

#[test]
fn a_clock_step_in_a_recording_is_named_and_rows_after_it_are_marked() {
    for step_s in [-3600.0, 3600.0] {
        let folder = tempfile::tempdir().expect("temporary folder");
        recorded_with_a_step(folder.path(), step_s);
        let run = reduce(folder.path());
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(3), "{said}");
        assert!(said.contains(": 3600.000 s"), "{said}");
        assert!(
            said.contains("at scan 2501")
                && !said.contains("fell behind")
                && !said.contains("drifts"),
            "{said}"
        );
        assert_eq!(
            column(folder.path(), "stream")[..2],
            ["ok", "ok"],
            "{step_s}"
        );
        assert!(
            column(folder.path(), "stream")[2..]
                .iter()
                .all(|s| s == "late"),
            "{step_s}"
        );
        // Where the stage was before the step follows the clocks before it.
        let depths = column(folder.path(), "stage_mm");
        assert_eq!(depths[..2], ["1.000000", "2.000000"], "{step_s}");
    }
    // Control: the same without a step.
    let folder = tempfile::tempdir().expect("temporary folder");
    recorded_with_a_step(folder.path(), 0.0);
    let run = reduce(folder.path());
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    assert_eq!(column(folder.path(), "stream"), ["ok"; 4]);
}

#[test]
fn a_recording_without_content_or_without_events_is_refused_and_the_tables_stay() {
    let folder = tempfile::tempdir().expect("temporary folder");
    recorded_with_gaps(folder.path());
    assert_eq!(reduce(folder.path()).status.code(), Some(3));
    let files = ["points.csv", "session.toml", "compensation.csv"];
    let tables = || files.map(|name| std::fs::read(folder.path().join(name)).expect("a table"));
    let before = tables();
    let first = folder.path().join("recording.mcap");
    let good = std::fs::read(&first).expect("recording");
    let refused = |name: &str, word: &str| {
        let run = reduce(folder.path());
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{name}: {said}");
        assert!(said.contains(name) && said.contains(word), "{said}");
        assert!(tables() == before, "{name}: the tables are as they were");
    };
    // A copy that was interrupted, and a disk that was full.
    std::fs::write(&first, "").expect("written");
    refused("recording.mcap", "0 bytes");
    std::fs::write(&first, &good).expect("written");
    let second = folder.path().join("recording-2.mcap");
    std::fs::write(&second, "").expect("written");
    refused("recording-2.mcap", "0 bytes");
    std::fs::remove_file(&second).expect("removed");
    // A recording of another program, or of `track`: scans, and nothing that says what they belong
    // to.
    std::fs::remove_file(&first).expect("removed");
    let recorder = Recorder::create(&first, Default::default()).expect("recorder");
    (0..1000).for_each(|serial| {
        record(
            &recorder,
            serial,
            serial as f64 / RATE_HZ,
            serial as f64 / RATE_HZ,
        )
    });
    recorder.finish().expect("closed");
    refused(
        "recording.mcap",
        "events of a sweep (/sweep/event), found none among 1000 scans",
    );
    // A sweep that stopped before its first reading.
    std::fs::remove_file(&first).expect("removed");
    let recorder = Recorder::create(&first, Default::default()).expect("recorder");
    (0..1000).for_each(|serial| {
        record(
            &recorder,
            serial,
            serial as f64 / RATE_HZ,
            serial as f64 / RATE_HZ,
        )
    });
    let start = SweepEvent {
        kind: "start".to_owned(),
        ..SweepEvent::default()
    };
    recorder.event(1e9, &start).expect("recorded");
    recorder.finish().expect("closed");
    refused("recording.mcap", "expected a reading");
    // Nothing: cut off behind its first bytes.
    std::fs::write(&first, &good[..8]).expect("written");
    refused("recording.mcap", "found none among 0 scans");
    // Control: the recording as it was.
    std::fs::write(&first, &good).expect("written");
    assert_eq!(reduce(folder.path()).status.code(), Some(3));
    assert!(tables() == before, "the same tables");
}
