//! `wcal track` on streams, as a user runs it: live from the virtual bench, replayed, and
//! everything that it must refuse or flag. Bench and sweeps are SIMULATED.

use super::moving_base::{Bench, calibrations, for_rows, go, reseal, until_rows};
use crate::support::{program, repository, text};
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};
use wcal_acquisition::recorder::Recorder;
use wcal_acquisition::replay::{Message, read};
use wcal_core::CalibrationFile;
use wcal_core::device::FbgReading;

fn track(arguments: &[&str]) -> Command {
    let mut command = program();
    let model = repository("fixtures/tracker");
    command
        .arg("track")
        .args(arguments)
        .arg("--model")
        .arg(model)
        .arg("--json");
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn document(run: &Output) -> Value {
    serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&run.stderr)))
}

/// Rows of a table by column.
struct Rows {
    names: Vec<String>,
    cells: Vec<Vec<String>>,
}

impl Rows {
    fn read(path: &Path) -> Self {
        let text = std::fs::read_to_string(path).unwrap();
        let mut lines = text
            .lines()
            .map(|l| l.split(',').map(str::to_owned).collect::<Vec<_>>());
        let names = lines.next().unwrap();
        let cells: Vec<_> = lines.collect();
        assert!(cells.iter().all(|c| c.len() == names.len()), "{names:?}");
        Self { names, cells }
    }

    fn column(&self, name: &str) -> Vec<&str> {
        let k = self.names.iter().position(|n| n == name).unwrap();
        self.cells.iter().map(|c| c[k].as_str()).collect()
    }

    fn numbers(&self, name: &str) -> Vec<f64> {
        self.column(name)
            .iter()
            .map(|c| c.parse().unwrap_or(f64::NAN))
            .collect()
    }
}

/// Tracked without loss: 3 and a word about it where contact came in a motion that is not known to
/// be one of training, else 0 and no word.
fn tracked(code: Option<i32>, said: &str) {
    let doubted = said.contains("motion-assumed");
    assert_eq!(code, Some(if doubted { 3 } else { 0 }), "{said}");
}

#[test]
fn a_live_stream_becomes_contacts_and_replays_to_the_same_rows() {
    let _turn = crate::alone();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let [raw, good] = calibrations(folder.path()).map(|p| p.to_str().unwrap().to_owned());
    const SPEED: f64 = 3.0;
    let mut bench = Bench::start(folder.path(), SPEED, 2000.0);
    let (rig, addresses) = (
        bench.rig.to_str().unwrap().to_owned(),
        bench.addresses.to_str().unwrap().to_owned(),
    );
    let mut stage = bench.stage(SPEED);

    // Live: the stage presses the wire and lets it go, after the prefix.
    let (live_csv, recording) = (path("live.csv"), path("live.mcap"));
    let live = [
        "--rig",
        &rig,
        "--bench",
        &addresses,
        "--calibration",
        &good,
        "--out",
        &live_csv,
    ];
    let more = ["--mcap", &recording, "--seconds", "14"];
    let child = track(&[&live[..], &more].concat()).spawn().unwrap();
    press(stage.as_mut(), &live_csv);
    let run = child.wait_with_output().unwrap();
    tracked(run.status.code(), &text(&run.stderr));
    let summary = document(&run);
    assert_eq!(
        (&summary["format"], &summary["lag_s"]),
        (&"wcal-track/2".into(), &0.1.into()),
        "{summary}"
    );
    assert_eq!(
        (&summary["dropped_scans"], &summary["lost_scans"]),
        (&0.into(), &0.into()),
        "{summary}"
    );
    assert!(Path::new(&path("live.json")).exists());
    let rows = Rows::read(Path::new(&live_csv));
    let (t_s, status) = (rows.numbers("t_s"), rows.column("status"));
    assert!((130..=141).contains(&t_s.len()), "{} rows", t_s.len());
    assert!(
        status[..2].iter().all(|s| *s == "filling")
            && status[2..]
                .iter()
                .all(|s| ["ok", "motion-assumed"].contains(s)),
        "{status:?}"
    );
    // The stage presses toward the wire and holds: no motion that a model was trained on.
    assert!(status.contains(&"motion-assumed"), "{status:?}");
    assert!(
        t_s.windows(2)
            .skip(2)
            .all(|w| (w[1] - w[0] - 0.1).abs() < 1e-3)
    );
    // A moment and a probable contact where the stage presses, and only there.
    let (m, p) = (
        rows.numbers("moment_1_nmm"),
        rows.numbers("contact_probability"),
    );
    let pressed: Vec<usize> = (0..m.len()).filter(|k| m[*k].abs() > 0.1).collect();
    assert!(pressed.len() > 5, "{m:?}");
    // The readings in which the touch begins and ends are half free.
    let whole = &pressed[1..pressed.len() - 1];
    assert!(whole.iter().all(|k| p[*k] > 0.5), "{pressed:?} {p:?}");
    let free = (0..m.len()).filter(|k| p[*k] < 0.5).count();
    assert!(free > 50, "{p:?}");
    // World frame: 100 mm to the side, carried along z by the stage.
    let (world, base) = (rows.numbers("world_z_mm"), rows.numbers("contact_z_mm"));
    let carried: Vec<f64> = pressed
        .iter()
        .map(|k| world[*k] - base[*k])
        .filter(|x| x.is_finite())
        .collect();
    assert!(
        carried.iter().all(|way| (-2.1..2.1).contains(way)),
        "{carried:?}"
    );
    assert!(carried.iter().any(|way| *way > 1.0), "{carried:?}");
    // The recording holds the raw streams; replayed it gives the same rows, at once.
    let replayed = path("replayed.csv");
    let replay = [
        &recording,
        "--rig",
        &rig,
        "--calibration",
        &good,
        "--out",
        &replayed,
        "--seconds",
        "14",
    ];
    let run = track(&replay).output().unwrap();
    tracked(run.status.code(), &text(&run.stderr));
    let read_text = |p: &str| std::fs::read_to_string(p).unwrap();
    assert_eq!(read_text(&live_csv), read_text(&replayed));
    // Control: through another calibration it is another track.
    let turned = path("turned.json");
    reseal(Path::new(&good), Path::new(&turned), |c| {
        let nominal = c.model.pointer_mut("/fbg/nominal_nm/0").unwrap();
        *nominal = (nominal.as_f64().unwrap() + 1e-3).into();
    });
    let other = [
        &recording,
        "--rig",
        &rig,
        "--calibration",
        &turned,
        "--out",
        &replayed,
        "--seconds",
        "14",
    ];
    let run = track(&other).output().unwrap();
    tracked(run.status.code(), &text(&run.stderr));
    assert_ne!(read_text(&live_csv), read_text(&replayed));

    let most = m.iter().copied().map(f64::abs).fold(0.0, f64::max);
    a_hyperion_gives_the_same(&bench, stage.as_mut(), &good, most, &path);
    faults_are_flagged(&mut bench, &live, &path);
    refusals(&recording, &rig, [&raw, &good], &path);
    several_whiskers(&recording, &rig, &good, &path);
}

/// Presses the wire and lets it go: 4 s of prefix and 1 s more before, by the rows of the run.
fn press(stage: &mut dyn wcal_core::device::Stage, table: &str) {
    until_rows(Path::new(table), 50);
    go(stage, 22.0);
    for_rows(Path::new(table), 20);
    go(stage, 18.0);
}

/// The same press on the bench's other interrogator, whose largest moment was `most`, N mm.
fn a_hyperion_gives_the_same(
    bench: &Bench,
    stage: &mut dyn wcal_core::device::Stage,
    good: &str,
    most: f64,
    path: &dyn Fn(&str) -> String,
) {
    let rig = std::fs::read_to_string(&bench.rig).unwrap();
    assert!(rig.contains("driver = \"sm130\""), "{rig}");
    let (file, csv) = (path("hyperion.toml"), path("hyperion.csv"));
    std::fs::write(
        &file,
        rig.replace("driver = \"sm130\"", "driver = \"hyperion\""),
    )
    .unwrap();
    let addresses = bench.addresses.to_str().unwrap();
    let live = [
        "--rig",
        &file,
        "--bench",
        addresses,
        "--calibration",
        good,
        "--out",
        &csv,
    ];
    let child = track(&[&live[..], &["--seconds", "14"]].concat())
        .spawn()
        .unwrap();
    press(stage, &csv);
    let run = child.wait_with_output().unwrap();
    tracked(run.status.code(), &text(&run.stderr));
    let summary = document(&run);
    assert_eq!(
        (&summary["dropped_scans"], &summary["lost_scans"]),
        (&0.into(), &0.into()),
        "{summary}"
    );
    let m = Rows::read(Path::new(&csv)).numbers("moment_1_nmm");
    let own = m.iter().copied().map(f64::abs).fold(0.0, f64::max);
    assert!((own / most - 1.0).abs() < 0.03, "{own} {most}");
}

/// A gap and a lost peak: flagged rows, counts, exit code 3.
fn faults_are_flagged(bench: &mut Bench, live: &[&str], path: &dyn Fn(&str) -> String) {
    let csv = path("faults.csv");
    let live: Vec<&str> = live[..live.len() - 1]
        .iter()
        .copied()
        .chain([csv.as_str()])
        .collect();
    let child = track(&[&live[..], &["--seconds", "18"]].concat())
        .spawn()
        .unwrap();
    until_rows(Path::new(&csv), 1);
    bench.type_fault("{\"kind\":\"lost-samples\",\"count\":300}");
    for_rows(Path::new(&csv), 9);
    bench.type_fault("{\"kind\":\"peak-lost\",\"grating\":1,\"on\":true}");
    for_rows(Path::new(&csv), 20);
    bench.type_fault("{\"kind\":\"peak-lost\",\"grating\":1,\"on\":false}");
    let run = child.wait_with_output().unwrap();
    assert_eq!(run.status.code(), Some(3), "{}", text(&run.stderr));
    let summary = document(&run);
    assert_eq!(
        (&summary["lost_scans"], &summary["gaps"]),
        (&300.into(), &1.into()),
        "{summary}"
    );
    assert!(
        summary["whiskers"][0]["unusable_scans"].as_u64() > Some(100),
        "{summary}"
    );
    let rows = Rows::read(Path::new(&csv));
    let (status, moment) = (rows.column("status"), rows.column("moment_1_nmm"));
    assert!(
        status.iter().any(|s| s.contains("gap")) && status.iter().any(|s| s.contains("peak-lost"))
    );
    assert!(
        (0..status.len()).all(|k| moment[k].is_empty() == status[k].contains("filling")),
        "{status:?}"
    );

    a_clock_that_steps_or_stands_still_is_named(bench, &live);
}

/// A step of the clock neither ends nor prolongs a run, and is said; a clock that stands still ends
/// it.
fn a_clock_that_steps_or_stands_still_is_named(bench: &mut Bench, live: &[&str]) {
    let csv = *live.last().unwrap();
    let run = |bench: &mut Bench, fault: &str| {
        let _ = std::fs::remove_file(csv);
        let mut child = track(&[live, &["--seconds", "9"]].concat())
            .spawn()
            .unwrap();
        let start = Instant::now();
        until_rows(Path::new(csv), 1);
        bench.type_fault(fault);
        while child.try_wait().unwrap().is_none() {
            if start.elapsed() > Duration::from_secs(240) {
                child.kill().unwrap();
                panic!("hangs after {fault}");
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        let run = child.wait_with_output().unwrap();
        (run.status.code(), text(&run.stderr))
    };
    let (code, said) = run(bench, "{\"kind\":\"clock-step\",\"seconds\":-3600}");
    assert!(
        code == Some(3) && said.contains("a clock step: 3600.0"),
        "{code:?} {said}"
    );
    let (code, said) = run(bench, "{\"kind\":\"clock-stop\",\"on\":true}");
    assert!(
        code == Some(1) && said.contains("a stopped clock"),
        "{code:?} {said}"
    );
    // Control: it goes on, and nothing is said of it.
    bench.type_fault("{\"kind\":\"clock-stop\",\"on\":false}");
    let (code, said) = run(bench, "plug-interrogator");
    assert!(
        code != Some(1) && !said.contains("clock"),
        "{code:?} {said}"
    );
}

/// What must not be tracked, or only with --force and then with a word in every row.
fn refusals(recording: &str, rig: &str, [raw, good]: [&str; 2], path: &dyn Fn(&str) -> String) {
    let out = path("refused.csv");
    let run = |rig: &str, calibration: &str, more: &[&str]| {
        let _ = std::fs::remove_file(&out);
        let arguments = [
            recording,
            "--rig",
            rig,
            "--calibration",
            calibration,
            "--out",
            &out,
            "--seconds",
            "3",
        ];
        track(&[&arguments[..], more].concat()).output().unwrap()
    };
    let changed = |name: &str, change: &dyn Fn(&mut CalibrationFile<Value>)| {
        let file = path(name);
        reseal(Path::new(good), Path::new(&file), change);
        file
    };
    let expired = changed("expired.json", &|c| {
        c.expires = Some("2001-01-01T00:00:00Z".to_owned())
    });
    let failed = changed("failed.json", &|c| {
        c.verification = wcal_core::VerificationStatus::Failed
    });
    let other = changed("other.json", &|c| {
        c.whisker.as_mut().unwrap().diameter_mm = 0.25
    });
    let tampered = path("tampered.json");
    let text_of = std::fs::read_to_string(good).unwrap();
    std::fs::write(
        &tampered,
        text_of.replace("\"session\": \"", "\"session\": \"x"),
    )
    .unwrap();
    for (calibration, code) in [
        (raw, "unverified"),
        (&expired, "expired"),
        (&failed, "failed"),
        (&other, "other-whisker"),
        (&tampered, "changed"),
    ] {
        let refused = run(rig, calibration, &[]);
        assert_eq!(
            refused.status.code(),
            Some(4),
            "{code}: {}",
            text(&refused.stderr)
        );
        assert!(
            text(&refused.stderr).contains("refused") && !Path::new(&out).exists(),
            "{code}"
        );
        // Each takes some seconds to load the model; the word in the rows is made in one place.
        if ["expired", "failed", "other-whisker"].contains(&code) {
            continue;
        }
        let forced = run(rig, calibration, &["--force"]);
        tracked(forced.status.code(), &text(&forced.stderr));
        let rows = Rows::read(Path::new(&out));
        assert!(
            rows.cells.len() > 20 && rows.column("doubts").iter().all(|d| *d == code),
            "{code}"
        );
        assert!(
            rows.column("calibration_doubtful")
                .iter()
                .all(|d| *d == "1"),
            "{code}"
        );
    }
    // Streams that are not what rig and calibration say: one named error.
    let rig_text = std::fs::read_to_string(rig).unwrap();
    for (name, change, expected) in [
        (
            "slow.toml",
            &|t: &str| t.replace("rate_hz = 2000.0", "rate_hz = 1000.0") as String,
            "1000 scans a second",
        ),
        (
            "dark.toml",
            &|t: &str| {
                t.replace(
                    "channel = 1, nominal_nm = 1541.2",
                    "channel = 2, nominal_nm = 1541.2",
                )
            },
            "channel map",
        ),
        (
            "cold.toml",
            &|t: &str| t.replace("\"fbg_ref\"", "\"fbg_other\""),
            "fbg_ref",
        ),
        (
            "swapped.toml",
            &|t: &str| {
                t.replace("\"fbg_1\"", "\"x\"")
                    .replace("\"fbg_2\"", "\"fbg_1\"")
                    .replace("\"x\"", "\"fbg_2\"")
            },
            "fbg_1",
        ),
    ] as [(&str, &dyn Fn(&str) -> String, &str); 4]
    {
        let file = path(name);
        std::fs::write(&file, change(&rig_text)).unwrap();
        let refused = run(&file, good, &[]);
        let message = text(&refused.stderr);
        assert_eq!(refused.status.code(), Some(1), "{name}: {message}");
        assert!(
            message.contains(expected) && message.contains(name),
            "{name}: {message}"
        );
    }
    let no_rig = track(&[recording, "--calibration", good, "--out", &out])
        .output()
        .unwrap();
    assert!(
        no_rig.status.code() == Some(1) && text(&no_rig.stderr).contains("--rig"),
        "{}",
        text(&no_rig.stderr)
    );
    // A recording that was cut off is tracked to there; one without scans is no stream.
    let (cut, empty) = (path("cut.mcap"), path("empty.mcap"));
    let bytes = std::fs::read(recording).unwrap();
    std::fs::write(&cut, &bytes[..bytes.len() / 2]).unwrap();
    Recorder::create(Path::new(&empty), Default::default())
        .unwrap()
        .finish()
        .unwrap();
    for (file, code, expected) in [(&cut, 3, "cut off"), (&empty, 1, "expected scans")] {
        let run = track(&[file, "--rig", rig, "--calibration", good, "--out", &out])
            .output()
            .unwrap();
        assert_eq!(run.status.code(), Some(code), "{}", text(&run.stderr));
        assert!(
            text(&run.stderr).contains(expected),
            "{}",
            text(&run.stderr)
        );
    }
    // Control: rig and calibration as they are, faster than the four host seconds a wall second of
    // the rig file.
    let run = run(rig, good, &[]);
    tracked(run.status.code(), &text(&run.stderr));
    let pace = document(&run)["time"]["times_real_time"].as_f64().unwrap();
    assert!(pace > 4.1, "{pace}");
}

/// A second whisker on the fibre, 20 nm higher: the same rows as the first.
fn several_whiskers(recording: &str, rig: &str, good: &str, path: &dyn Fn(&str) -> String) {
    const APART_NM: f64 = 20.0;
    let (two, rig_two, out) = (path("two.mcap"), path("two.toml"), path("two.csv"));
    let recorder = Recorder::create(Path::new(&two), Default::default()).unwrap();
    read(Path::new(recording), |m| {
        if let Message::Scan(scan) = m {
            let mut reading: FbgReading = scan.reading();
            let more: Vec<f64> = reading.peaks_nm[0].iter().map(|nm| nm + APART_NM).collect();
            reading.peaks_nm[0].extend(more);
            recorder.scan(&reading).unwrap();
        }
    })
    .unwrap();
    recorder.finish().unwrap();
    let text_of = std::fs::read_to_string(rig).unwrap();
    let mut more = String::new();
    for (name, nm) in [("fbg_ref", 1537.3), ("fbg_1", 1541.2), ("fbg_2", 1535.8)] {
        let window = if name == "fbg_1" { 1.5 } else { 0.7 };
        more += &format!(
            "  {{ name = \"{name}\", channel = 1, nominal_nm = {}, window_nm = {window}, whisker = \"b\" }},\n",
            nm + APART_NM
        );
    }
    std::fs::write(
        &rig_two,
        text_of.replacen("]\n\n[fbg]", &format!("{more}]\n\n[fbg]"), 1),
    )
    .unwrap();
    let second = path("second.json");
    reseal(Path::new(good), Path::new(&second), |c| {
        for key in [
            "/fbg/nominal_nm/0",
            "/fbg/nominal_nm/1",
            "/fbg/reference_nominal_nm",
        ] {
            let value = c.model.pointer_mut(key).unwrap();
            *value = (value.as_f64().unwrap() + APART_NM).into();
        }
    });
    let b = format!("b={second}");
    let arguments = [
        &two,
        "--rig",
        &rig_two,
        "--calibration",
        good,
        "--calibration",
        &b,
        "--out",
        &out,
        "--seconds",
        "9",
    ];
    let run = track(&arguments).output().unwrap();
    tracked(run.status.code(), &text(&run.stderr));
    let rows = Rows::read(Path::new(&out));
    let (names, m) = (rows.column("whisker"), rows.numbers("moment_1_nmm"));
    let of = |name: &str| -> Vec<f64> {
        (0..m.len())
            .filter(|k| names[*k] == name)
            .map(|k| m[k])
            .collect()
    };
    let (first, second) = (of(""), of("b"));
    assert!(first.len() > 80 && first.len() == second.len());
    let off = first
        .iter()
        .zip(&second)
        .filter(|(a, _)| a.is_finite())
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    assert!(off < 1e-4 && first.iter().any(|x| x.abs() > 0.1), "{off}");
    // Control: without a calibration for b nothing is tracked with that of the first.
    let lacking = [
        &two,
        "--rig",
        &rig_two,
        "--calibration",
        good,
        "--out",
        &out,
    ];
    let refused = track(&lacking).output().unwrap();
    assert_eq!(refused.status.code(), Some(1), "{}", text(&refused.stderr));
    assert!(
        text(&refused.stderr).contains("of whisker b"),
        "{}",
        text(&refused.stderr)
    );
}
