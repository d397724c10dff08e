//! `wcal track` on a recording without a model, as a user runs it: a sweep on the virtual bench,
//! its calibration, its own recording (SIMULATED).

use super::moving_base::{Bench, for_rows, go, reseal, until_rows};
use crate::support::{program, repository, text};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use wcal_acquisition::clocks::ClockPair;
use wcal_acquisition::replay::{Message, read};
use wcal_acquisition::rig::Rig;

/// Bench seconds per wall second.
const SPEED: f64 = 4.0;

/// A swept session with its calibration.
struct Swept {
    folder: tempfile::TempDir,
}

/// A run: exit code, what was said, track.json, and cells of the table by column.
struct Run {
    code: Option<i32>,
    said: String,
    summary: Value,
    names: Vec<String>,
    cells: Vec<Vec<String>>,
}

impl Run {
    fn whisker(&self) -> &Value {
        &self.summary["whiskers"][0]
    }

    /// RMS error at the last reading of each contact: at the first depth the arc length is not
    /// known yet.
    #[track_caller]
    fn end_mm(&self) -> f64 {
        self.whisker()["end_rmse_mm"]
            .as_f64()
            .unwrap_or_else(|| panic!("{}", self.said))
    }

    fn column(&self, name: &str) -> Vec<&str> {
        let k = self.names.iter().position(|n| n == name).unwrap();
        self.cells.iter().map(|c| c[k].as_str()).collect()
    }

    fn with_status(&self, name: &str) -> usize {
        self.column("status")
            .iter()
            .filter(|s| s.split('|').any(|s| s == name))
            .count()
    }
}

impl Swept {
    fn new() -> Self {
        let swept = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        let bench = Bench::start(swept.folder.path(), SPEED, 500.0);
        // The stage of a sweep carries the groove, not the base.
        let rig = std::fs::read_to_string(&bench.rig).unwrap();
        let (plain, _) = rig.split_once("[base]").unwrap();
        std::fs::write(swept.path("rig.toml"), plain).unwrap();
        let sweep = program()
            .args(["stage-sweep", "--home", "--json", "--rig"])
            .arg(swept.path("rig.toml"))
            .arg("--plan")
            .arg(repository("rigs/plans/paper-27.toml"))
            .arg("--bench")
            .arg(&bench.addresses)
            .arg("--out")
            .arg(swept.path("session"))
            .output()
            .unwrap();
        assert_eq!(sweep.status.code(), Some(0), "{}", text(&sweep.stderr));
        drop(bench);
        let verify = program()
            .arg("verify")
            .arg(swept.path("session"))
            .arg("--out")
            .arg(swept.path("verify"))
            .output()
            .unwrap();
        println!(
            "verify: {:?} {}",
            verify.status.code(),
            text(&verify.stderr)
        );
        assert!(
            swept.path("verify/calibration.json").is_file(),
            "{}",
            text(&verify.stderr)
        );
        // The bench is without effects; a verdict that chance makes another does not matter here.
        reseal(
            &swept.path("verify/calibration.json"),
            &swept.path("good.json"),
            |c| {
                c.verification = wcal_core::VerificationStatus::Verified;
            },
        );
        swept
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn track(&self, rig: &str, calibration: &str, more: &[&str]) -> Run {
        let out = self.path("track.csv");
        let _ = std::fs::remove_file(&out);
        let run = program()
            .arg("track")
            .arg(self.path("session/recording.mcap"))
            .arg("--rig")
            .arg(self.path(rig))
            .arg("--calibration")
            .arg(self.path(calibration))
            .arg("--out")
            .arg(&out)
            .arg("--json")
            .args(more)
            .output()
            .unwrap();
        let table = std::fs::read_to_string(&out).unwrap_or_default();
        let mut lines = table
            .lines()
            .map(|l| l.split(',').map(str::to_owned).collect::<Vec<_>>());
        Run {
            code: run.status.code(),
            said: text(&run.stderr),
            summary: serde_json::from_slice(&run.stdout).unwrap_or_default(),
            names: lines.next().unwrap_or_default(),
            cells: lines.collect(),
        }
    }

    /// The groove's displacement as the recording has it: by the interrogator's clock, s since the
    /// first scan, each trajectory far from the one before.
    fn motion(&self) -> Vec<(f64, [f64; 3])> {
        let rig = std::fs::read_to_string(self.path("rig.toml")).unwrap();
        let rig = Rig::parse("rig.toml", &rig).unwrap();
        let directions: BTreeMap<u32, [f64; 3]> =
            rig.trajectory.iter().map(|t| (t.id, t.direction)).collect();
        let (mut clocks, mut origin, mut mounted, mut rows) =
            (ClockPair::default(), None, None, Vec::new());
        read(
            &self.path("session/recording.mcap"),
            |message| match message {
                Message::Scan(scan) => {
                    origin.get_or_insert(scan.device_s);
                    clocks.add(scan.host_s, scan.device_s);
                }
                Message::Event(event) if event.kind == "mount" => mounted = Some(event.trajectory),
                Message::Stage(position) => {
                    if let (Some(id), Some(origin), Some(at)) =
                        (mounted, origin, clocks.device_s(position.host_s))
                    {
                        let way = position.measured_mm - rig.stage.zero_mm;
                        let moved = directions[&id].map(|d: f64| d * way + 1e3 * f64::from(id));
                        if rows.last().is_none_or(|(t, _)| at - origin > *t) {
                            rows.push((at - origin, moved));
                        }
                    }
                }
                _ => {}
            },
        )
        .unwrap();
        rows
    }
}

fn write_log(path: &Path, rows: &[(f64, [f64; 3])], cell: impl Fn(usize, f64) -> String) {
    let mut out = "t_s,object_x_mm,object_y_mm,object_z_mm\n".to_owned();
    for (k, (t_s, [x, y, z])) in rows.iter().enumerate() {
        writeln!(out, "{},{x},{y},{z}", cell(k, *t_s)).unwrap();
    }
    std::fs::write(path, out).unwrap();
}

#[test]
fn a_recording_of_a_sweep_is_tracked_by_its_own_stage() {
    let _turn = crate::alone();
    let swept = Swept::new();
    let run = swept.track("rig.toml", "good.json", &[]);
    println!(
        "{} {} contacts",
        run.said,
        run.whisker()["contacts"].as_array().map_or(0, Vec::len)
    );
    assert!(
        matches!(run.code, Some(0 | 3)),
        "{:?}: {}",
        run.code,
        run.said
    );
    let (whisker, groove) = (run.whisker(), &run.whisker()["known_groove"]);
    assert_eq!(
        (&whisker["method"], &run.summary["stream_motion"]["source"]),
        (&"known-motion".into(), &"stage carries the groove".into())
    );
    // Nine trajectories, and the sync move before them.
    let contacts = whisker["contacts"].as_array().unwrap().len();
    // A busy computer asks the stage late: a loss of more than a second ends a contact.
    let most = if run.with_status("motion-lost") == 0 {
        10
    } else {
        13
    };
    assert!((10..=most).contains(&contacts), "{contacts}: {}", run.said);
    assert!(groove["compared"].as_u64() >= Some(25), "{groove}");
    assert!(
        run.end_mm() < 0.5 && groove["median_mm"].as_f64() < Some(0.5),
        "{groove}"
    );
    assert!(groove["coverage95"].as_f64() > Some(0.8), "{groove}");
    assert!(
        run.with_status("motion-disagrees") * 20 <= run.cells.len(),
        "{}",
        run.said
    );
    // In contact each row has its regions.
    let (p, regions) = (
        run.column("contact_probability"),
        run.column("arclength_regions95"),
    );
    let touched = |k: &usize| p[*k].parse::<f64>().is_ok_and(|p| p > 0.9);
    assert!(
        (0..p.len())
            .filter(touched)
            .all(|k| regions[k].contains('@'))
    );

    // A busy computer may leave rows without the stage's position; nothing else is in doubt.
    let doubted = run.with_status("motion-lost") + run.with_status("motion-disagrees");
    assert_eq!(run.code == Some(0), doubted == 0, "{}", run.said);

    controls(&swept, &run);
    logs(&swept, &run);
    live(&swept);
}

/// Live, with a base that the stage carries past the groove: one contact, and the motion is doubted
/// where the base goes the other way.
fn live(swept: &Swept) {
    let bench = Bench::start(swept.folder.path(), SPEED, 500.0);
    let rig = std::fs::read_to_string(&bench.rig).unwrap();
    // On this bench the groove goes along +z of trajectory 1, as if the base went along -z.
    let right = rig.replace("carried_along = [0, 0, 1]", "carried_along = [0, 0, -1]");
    assert_ne!(right, rig);
    let mut stage = bench.stage(SPEED);
    for (name, rig, agrees) in [("right", right, true), ("wrong", rig, false)] {
        std::fs::write(swept.path("live.toml"), rig).unwrap();
        let _ = std::fs::remove_file(swept.path("live.csv"));
        let child = program()
            .args(["track", "--json", "--seconds", "20", "--rig"])
            .arg(swept.path("live.toml"))
            .arg("--bench")
            .arg(&bench.addresses)
            .arg("--calibration")
            .arg(swept.path("good.json"))
            .arg("--out")
            .arg(swept.path("live.csv"))
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        // The prefix, then two depths.
        until_rows(&swept.path("live.csv"), 55);
        for depth_mm in [22.0, 24.0, 18.0] {
            go(stage.as_mut(), depth_mm);
            for_rows(&swept.path("live.csv"), 12);
        }
        let run = child.wait_with_output().unwrap();
        let (said, summary) = (
            text(&run.stderr),
            serde_json::from_slice::<Value>(&run.stdout).unwrap(),
        );
        println!(
            "live, {name}: {:?} {said} {}",
            run.status.code(),
            summary["whiskers"][0]["contacts"]
        );
        assert_eq!(summary["stream_motion"]["source"], "stage carries the base");
        let contacts = summary["whiskers"][0]["contacts"].as_array().unwrap();
        assert_eq!(contacts.len(), 1, "{said}");
        assert_eq!(
            contacts[0]["disagreement"].is_null(),
            agrees,
            "{name}: {said}"
        );
        assert!(agrees || run.status.code() == Some(3), "{name}: {said}");
        // A region of 95 % misses one contact in twenty; widened by half of itself on either side,
        // four standard deviations, none. Where motion and moments disagree, it may lie anywhere.
        let regions = contacts[0]["regions"].as_array().unwrap();
        let holds = |r: &&Value| {
            let [from, to] = ["from_mm", "to_mm"].map(|end| r[end].as_f64().unwrap());
            (1.5 * from - 0.5 * to..=1.5 * to - 0.5 * from).contains(&18.0)
        };
        let held: f64 = regions
            .iter()
            .filter(holds)
            .filter_map(|r| r["probability"].as_f64())
            .sum();
        assert!(held > 0.5 || !agrees, "{name}: {regions:?}");
    }
}

/// The groove the other way, and another calibration, are named.
fn controls(swept: &Swept, good: &Run) {
    let rig = std::fs::read_to_string(swept.path("rig.toml")).unwrap();
    let turned: Vec<String> = rig
        .lines()
        .map(|line| {
            match line
                .strip_prefix("direction = [")
                .and_then(|l| l.strip_suffix(']'))
            {
                Some(numbers) => {
                    let turned: Vec<String> = numbers
                        .split(',')
                        .map(|n| (-n.trim().parse::<f64>().unwrap()).to_string())
                        .collect();
                    // A whole number is no float in TOML.
                    let turned: Vec<String> = turned
                        .into_iter()
                        .map(|n| if n.contains('.') { n } else { format!("{n}.0") })
                        .collect();
                    format!("direction = [{}]", turned.join(", "))
                }
                None => line.to_owned(),
            }
        })
        .collect();
    std::fs::write(swept.path("turned.toml"), turned.join("\n")).unwrap();
    let run = swept.track("turned.toml", "good.json", &[]);
    println!("turned: {:?} {}", run.code, run.said);
    assert!(
        run.with_status("motion-disagrees") > 10 * good.with_status("motion-disagrees").max(1),
        "{}",
        run.said
    );
    assert!(
        matches!(run.code, Some(3 | 4)) && run.said.contains("reversed"),
        "{}",
        run.said
    );

    // A wire twice as sensitive.
    reseal(&swept.path("good.json"), &swept.path("other.json"), |c| {
        let coefficients = c.model["coefficients"].as_array_mut().unwrap();
        for value in coefficients[1..3]
            .iter_mut()
            .flat_map(|c| c.as_array_mut().unwrap())
        {
            *value = (value.as_f64().unwrap() * 2.0).into();
        }
    });
    let run = swept.track("rig.toml", "other.json", &[]);
    println!("other calibration: {:?} {}", run.code, run.said);
    assert!(matches!(run.code, Some(3 | 4)), "{}", run.said);
    assert!(run.end_mm() > 5.0 * good.end_mm(), "{}", run.said);
}

/// The same motion as a log of its own, and logs that cannot be used.
fn logs(swept: &Swept, by_stage: &Run) {
    let rows = swept.motion();
    let log = swept.path("motion.csv");
    let along = |more: &[&str]| {
        let log = log.to_str().unwrap();
        swept.track(
            "rig.toml",
            "good.json",
            &[&["--motion", log][..], more].concat(),
        )
    };
    write_log(&log, &rows, |_, t| t.to_string());
    let run = along(&[]);
    println!("log: {:?} {}", run.code, run.said);
    assert!(
        matches!(run.code, Some(0 | 3)) && run.said.contains("jumps"),
        "{}",
        run.said
    );
    assert_eq!(run.summary["stream_motion"]["source"], "log");
    assert!(
        run.end_mm() < 2.0 * by_stage.end_mm() + 0.2,
        "{} {}",
        run.end_mm(),
        by_stage.end_mm()
    );
    // Refused by name, and nothing is written.
    let refused = |what: &str, cell: &dyn Fn(usize, f64) -> String| {
        write_log(&log, &rows, cell);
        let run = along(&[]);
        assert_eq!(
            (run.code, run.cells.len()),
            (Some(1), 0),
            "{what}: {}",
            run.said
        );
        assert!(run.said.contains(what), "{what}: {}", run.said);
    };
    refused("overlap", &|_, t| (t + 1e6).to_string());
    refused("seconds", &|_, t| (t * 1e3).to_string());
    refused("line 5", &|k, t| {
        if k == 3 {
            "nan".to_owned()
        } else {
            t.to_string()
        }
    });
    // A log of the first half alone: the contacts after it have no motion.
    let half = &rows[..rows.len() / 2];
    write_log(&log, half, |_, t| t.to_string());
    let run = along(&[]);
    println!("half a log: {:?} {}", run.code, run.said);
    assert!(run.with_status("motion-lost") > 20, "{}", run.said);
    assert!(
        matches!(run.code, Some(3 | 4)) && run.said.contains("outside"),
        "{}",
        run.said
    );
    let regions = run.column("arclength_regions95");
    let lost = |k: &usize| run.column("status")[*k].contains("motion-lost");
    assert!(
        (0..regions.len())
            .filter(lost)
            .all(|k| regions[k].contains('@'))
    );
}
