//! `wcal track` along a known motion as a user runs it, on a session whose groove is known
//! (SIMULATED).

use crate::support::{text, wcal};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

const SESSION: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/practice/case-004");

/// Readings and motion of three trajectories: time, wavelengths and groove as written, the motion
/// along each from its stage.
struct Record {
    header: Vec<String>,
    rows: Vec<Vec<String>>,
    /// Time and displacement of the object, base frame, mm.
    motion: Vec<(f64, [f64; 3])>,
}

impl Record {
    fn read() -> Self {
        let session: toml::Table = std::fs::read_to_string(format!("{SESSION}/session.toml"))
            .unwrap()
            .parse()
            .unwrap();
        let directions: BTreeMap<i64, Vec<f64>> = session["trajectory"]
            .as_array()
            .unwrap()
            .iter()
            .map(|t| {
                let of = t["direction"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|v| v.as_float().unwrap());
                (t["id"].as_integer().unwrap(), of.collect())
            })
            .collect();
        let table = std::fs::read_to_string(format!("{SESSION}/points.csv")).unwrap();
        let split = |line: &str| line.split(',').map(str::to_owned).collect::<Vec<_>>();
        let header = split(table.lines().next().unwrap());
        let at = |name: &str| header.iter().position(|c| c == name).unwrap();
        let (trajectory, stage, time) = (at("trajectory"), at("stage_mm"), at("t_s"));
        let chosen: Vec<i64> = directions
            .keys()
            .copied()
            .filter(|id| *id < 100)
            .take(3)
            .collect();
        let rows: Vec<Vec<String>> = table
            .lines()
            .skip(1)
            .map(split)
            .filter(|r| chosen.contains(&r[trajectory].parse().unwrap()))
            .collect();
        let motion = rows.iter().map(|r| {
            let id: i64 = r[trajectory].parse().unwrap();
            let way: f64 = r[stage].parse().unwrap();
            // The groove is mounted anew for each trajectory: far away, in no time.
            let d = &directions[&id];
            (
                r[time].parse().unwrap(),
                [0, 1, 2].map(|k| d[k] * way + 1e5 * id as f64),
            )
        });
        let motion = motion.collect();
        Self {
            header,
            rows,
            motion,
        }
    }

    /// The readings without the stage.
    fn write_table(&self, path: &Path, groove: bool, scale: f64) {
        let at = |name: &str| self.header.iter().position(|c| c == name).unwrap();
        let mut names = vec!["point", "t_s", "fbg_ref_nm", "fbg_1_nm", "fbg_2_nm"];
        if groove {
            names.extend([
                "groove_x_mm",
                "groove_y_mm",
                "groove_z_mm",
                "role",
                "speed_mm_s",
            ]);
        }
        let mut out = names.join(",") + "\n";
        let first = &self.rows[0];
        for row in &self.rows {
            let cell = |name: &&str| {
                let (value, zero) = (&row[at(name)], &first[at(name)]);
                if scale == 1.0 || !matches!(*name, "fbg_1_nm" | "fbg_2_nm") {
                    return value.clone();
                }
                let [value, zero]: [f64; 2] = [value, zero].map(|v| v.parse().unwrap());
                (zero + scale * (value - zero)).to_string()
            };
            writeln!(
                out,
                "{}",
                names.iter().map(cell).collect::<Vec<_>>().join(",")
            )
            .unwrap();
        }
        std::fs::write(path, out).unwrap();
    }

    /// The table with the known groove, `lead` readings of the free wire before it, and both
    /// gratings off by `off_nm` throughout.
    fn write_displaced(&self, path: &Path, lead: usize, off_nm: [f64; 2]) {
        let at = |name: &str| self.header.iter().position(|c| c == name).unwrap();
        let table = std::fs::read_to_string(format!("{SESSION}/points.csv")).unwrap();
        let rest: Vec<String> = table
            .lines()
            .map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>())
            .find(|row| row[at("role")] == "rest")
            .unwrap();
        let names = [
            "point",
            "t_s",
            "fbg_ref_nm",
            "fbg_1_nm",
            "fbg_2_nm",
            "groove_x_mm",
            "groove_y_mm",
            "groove_z_mm",
            "stream",
            "mine",
        ];
        let start_s = self.motion[0].0;
        let row = |row: &[String], point: usize, t_s: f64, groove: bool| {
            let cell = |name: &&str| match *name {
                "point" => point.to_string(),
                "t_s" => t_s.to_string(),
                "fbg_1_nm" => (row[at(name)].parse::<f64>().unwrap() + off_nm[0]).to_string(),
                "fbg_2_nm" => (row[at(name)].parse::<f64>().unwrap() + off_nm[1]).to_string(),
                "stream" | "mine" => "ok".to_owned(),
                name if name.starts_with("groove") && !groove => String::new(),
                name => row[at(name)].clone(),
            };
            names.iter().map(cell).collect::<Vec<_>>().join(",")
        };
        let before =
            (0..lead).map(|k| row(&rest, k, start_s - 1.0 - 0.5 * (lead - 1 - k) as f64, false));
        let after = self
            .rows
            .iter()
            .zip(&self.motion)
            .enumerate()
            .map(|(k, (r, m))| row(r, 1000 + k, m.0, true));
        let lines: Vec<String> = std::iter::once(names.join(","))
            .chain(before)
            .chain(after)
            .collect();
        std::fs::write(path, lines.join("\n") + "\n").unwrap();
    }

    fn write_motion(
        &self,
        path: &Path,
        columns: &str,
        row: impl Fn(usize, f64, [f64; 3]) -> String,
    ) {
        let mut out = format!("{columns}\n");
        for (k, (t_s, way)) in self.motion.iter().enumerate() {
            writeln!(out, "{}", row(k, *t_s, *way)).unwrap();
        }
        std::fs::write(path, out).unwrap();
    }
}

/// Columns of a log: the displacement of the object, or poses of the base.
const MM: &str = "t_s,object_x_mm,object_y_mm,object_z_mm";
const POSES: &str = "t_s,base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz";

fn plain(t_s: f64, [x, y, z]: [f64; 3]) -> String {
    format!("{t_s},{x},{y},{z}")
}

/// A run: exit code, what was said, track.json and the rows' status.
struct Run {
    code: Option<i32>,
    said: String,
    summary: serde_json::Value,
    status: Vec<String>,
}

impl Run {
    #[track_caller]
    fn rmse_mm(&self) -> f64 {
        self.summary["known_groove"]["rmse_mm"]
            .as_f64()
            .unwrap_or_else(|| panic!("{}", self.said))
    }

    fn with_status(&self, name: &str) -> usize {
        self.status
            .iter()
            .filter(|s| s.split('|').any(|s| s == name))
            .count()
    }
}

/// What `verify` says of the session, made once for all tests.
fn verified() -> &'static Path {
    static VERIFIED: LazyLock<PathBuf> = LazyLock::new(|| {
        let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("known-motion-verified");
        let run = wcal(&["verify", SESSION, "--out", out.to_str().unwrap()]);
        assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
        out
    });
    &VERIFIED
}

/// The readings as tables of a folder of its own: `table.csv` with the known groove, `blind.csv`
/// without it.
struct Bench {
    folder: tempfile::TempDir,
    record: Record,
}

impl Bench {
    fn new() -> Self {
        let bench = Self {
            folder: tempfile::tempdir().unwrap(),
            record: Record::read(),
        };
        bench
            .record
            .write_table(&bench.path("table.csv"), true, 1.0);
        // Nothing but what is measured: no answer can come from the groove, and none is compared
        // with it.
        bench
            .record
            .write_table(&bench.path("blind.csv"), false, 1.0);
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The log that [`Self::along`] tracks by.
    fn write_motion(&self, columns: &str, row: impl Fn(usize, f64, [f64; 3]) -> String) {
        self.record
            .write_motion(&self.path("motion.csv"), columns, row);
    }

    fn track(&self, table: &str, more: &[&str]) -> Run {
        let out = self.path("track.csv");
        let _ = std::fs::remove_file(&out);
        let names = [self.path(table), verified().join("calibration.json"), out];
        let [table, calibration, out] = &names.map(|p| p.to_str().unwrap().to_owned());
        let track = [
            "track",
            table,
            "--calibration",
            calibration,
            "--out",
            out,
            "--json",
        ];
        let run = wcal(&[&track[..], more].concat());
        let rows = std::fs::read_to_string(out).unwrap_or_default();
        let status = rows
            .lines()
            .skip(1)
            .map(|l| l.split(',').nth(17).unwrap().to_owned())
            .collect();
        Run {
            code: run.status.code(),
            said: text(&run.stderr),
            summary: serde_json::from_slice(&run.stdout).unwrap_or_default(),
            status,
        }
    }

    fn along(&self, table: &str, more: &[&str]) -> Run {
        let log = self.path("motion.csv");
        self.track(
            table,
            &[&["--motion", log.to_str().unwrap()][..], more].concat(),
        )
    }
}

/// The calibration's report leads from the map's uncertainty to that of the contact.
#[test]
fn the_uncertainty_of_the_map_becomes_that_of_the_contact() {
    let verified: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(verified().join("verify.json")).unwrap())
            .unwrap();
    let rows = verified["groove_tracking"]["uncertainty"]
        .as_array()
        .unwrap();
    assert!(rows.len() >= 2, "{verified}");
    for row in rows {
        let of = |key: &str| row[key].as_f64().unwrap();
        // The noise of the readings adds to what the map does.
        assert!(
            0.0 < of("contact_u_by_map_mm") && of("contact_u_by_map_mm") < of("contact_u_mm"),
            "{row}"
        );
        assert!(
            0.0 < of("moment_u_nmm") && of("moment_u_nmm") < 0.1 * of("moment_nmm"),
            "{row}"
        );
        println!("{row}");
    }
    let report = std::fs::read_to_string(self::verified().join("report.html")).unwrap();
    assert!(report.contains("Map U to contact U"));
}

/// The table travels with the calibration: sealed, printed at the start of `track`.
#[test]
fn the_calibration_says_what_its_uncertainty_makes_of_a_contact() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let read = |name: &str| -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(verified().join(name)).unwrap()).unwrap()
    };
    let (calibration, document) = (read("calibration.json"), read("verify.json"));
    // What the calibration states comes from its own readings; the sealed ones show whether it is
    // true.
    assert_eq!(
        (
            &calibration["contact_uncertainty"]["split"],
            &document["groove_tracking"]["split"]
        ),
        (&"fit".into(), &"holdout".into())
    );
    let sealed = document["groove_tracking"]["rmse_mm"].as_f64().unwrap();
    let rows = calibration["contact_uncertainty"]["rows"]
        .as_array()
        .unwrap();
    let widest = rows
        .iter()
        .map(|r| r["contact_u_mm"].as_f64().unwrap())
        .fold(0.0, f64::max);
    assert!(sealed < widest, "{sealed} {widest}");
    let track = |calibration: &serde_json::Value| {
        let (file, out) = (path("calibration.json"), path("track.csv"));
        std::fs::write(&file, calibration.to_string()).unwrap();
        let run = wcal(&["track", SESSION, "--calibration", &file, "--out", &out]);
        (run.status.code(), text(&run.stderr))
    };
    let (code, said) = track(&calibration);
    let first = calibration["contact_uncertainty"]["rows"][0].clone();
    let line = format!(
        "contact U (k = 2, motion known) {:.2} mm at {:.0} mm",
        first["contact_u_mm"].as_f64().unwrap(),
        first["arclength_mm"].as_f64().unwrap()
    );
    assert!(code == Some(0) && said.contains(&line), "{line}: {said}");

    // A row that was made smaller; the table taken away.
    let mut changed = calibration.clone();
    changed["contact_uncertainty"]["rows"][0]["contact_u_mm"] = 0.001.into();
    let mut without = calibration.clone();
    without
        .as_object_mut()
        .unwrap()
        .remove("contact_uncertainty");
    for file in [changed, without] {
        let (code, said) = track(&file);
        assert!(
            code == Some(4) && said.contains("the file was changed"),
            "{said}"
        );
    }
}

/// The same motion in metres, as poses of a base in a turned world, by a clock that is ahead, and
/// as columns of the table.
#[test]
fn a_table_is_tracked_along_a_motion_however_it_is_written() {
    let bench = Bench::new();
    bench.write_motion(MM, |_, t, way| plain(t, way));
    let good = bench.along("table.csv", &[]);
    assert_eq!(good.code, Some(0), "{}", good.said);
    assert!(
        good.rmse_mm() < 0.6 && good.status.iter().all(|s| s == "ok"),
        "{}",
        good.said
    );
    assert_eq!(good.summary["method"], "known-motion");
    assert_eq!(
        good.summary["contacts"].as_array().unwrap().len(),
        3,
        "{}",
        good.summary
    );
    let same = |run: &Run| (run.rmse_mm() - good.rmse_mm()).abs() < 1e-3;

    bench.write_motion("t_s,object_x_m,object_y_m,object_z_m", |_, t, way| {
        plain(t, way.map(|v| 1e-3 * v))
    });
    assert!(same(&bench.along("table.csv", &[])));
    // A quarter turn about z: the base's x is the world's y. The base goes where the object comes
    // from.
    let half = 0.5_f64.sqrt();
    bench.write_motion(POSES, |_, t, [x, y, z]| {
        format!("{t},{},{},{},{half},0,0,{half}", y, -x, -z)
    });
    assert!(same(&bench.along("table.csv", &[])));
    let table = std::fs::read_to_string(bench.path("table.csv")).unwrap();
    let columns = bench
        .record
        .motion
        .iter()
        .map(|(_, [x, y, z])| format!("{x},{y},{z}"));
    let columns = std::iter::once("object_x_mm,object_y_mm,object_z_mm".to_owned()).chain(columns);
    let lines: Vec<String> = table
        .lines()
        .zip(columns)
        .map(|(a, b)| format!("{a},{b}"))
        .collect();
    std::fs::write(bench.path("joined.csv"), lines.join("\n") + "\n").unwrap();
    let joined = bench.track("joined.csv", &[]);
    assert!(
        same(&joined) && !joined.said.contains("not known"),
        "{}",
        joined.said
    );
}

/// A zero that has moved since the calibration: `--tare-s` takes it off a table with a motion, as
/// it does off a stream.
#[test]
fn the_zero_of_a_table_with_a_motion_is_set_anew() {
    const LEAD: usize = 12;
    let bench = Bench::new();
    bench.write_motion(MM, |_, t, way| plain(t, way));
    let good = bench.along("table.csv", &[]);
    // Some seconds of the free wire before the first contact, and both gratings off by a tenth of
    // what contacts do.
    let (lead_s, off_nm) = (0.5 * LEAD as f64, [0.02, -0.015]);
    bench
        .record
        .write_displaced(&bench.path("off.csv"), LEAD, off_nm);
    let start = bench.record.motion[0];
    let log: Vec<String> = (0..LEAD)
        .map(|k| plain(start.0 - 1.0 - 0.5 * (LEAD - 1 - k) as f64, start.1))
        .chain(bench.record.motion.iter().map(|(t, way)| plain(*t, *way)))
        .collect();
    std::fs::write(
        bench.path("motion.csv"),
        format!("{MM}\n{}\n", log.join("\n")),
    )
    .unwrap();
    let tared = bench.along("off.csv", &["--tare-s", &lead_s.to_string()]);
    assert_eq!(
        tared.summary["tare_s"].as_f64(),
        Some(lead_s),
        "{}",
        tared.said
    );
    assert!(
        (tared.rmse_mm() - good.rmse_mm()).abs() < 0.15,
        "{} {}: {}",
        tared.rmse_mm(),
        good.rmse_mm(),
        tared.said
    );
    // A column of the program's own is none that nobody knows.
    assert!(
        !tared.said.contains("stream is not known"),
        "{}",
        tared.said
    );
    assert!(
        tared.said.contains("mine is not known"),
        "negative control: {}",
        tared.said
    );
    // Negative control: with the calibration's own zero the contacts are elsewhere, or do not
    // belong to the motion.
    let own = bench.along("off.csv", &[]);
    let far = own.summary["known_groove"]["rmse_mm"]
        .as_f64()
        .is_none_or(|mm| mm > 2.0 * good.rmse_mm());
    assert!(
        far || own.with_status("motion-disagrees") > 20,
        "{}",
        own.said
    );
    assert_eq!(own.summary["tare_s"], 0.0);
    // By the moments alone, too: the free wire is loaded by its wrong zero, and not by the right
    // one.
    let free = |run: &Run| run.status[..LEAD].iter().filter(|s| *s == "ok").count();
    let [wrong, right] = [&[][..], &["--tare-s", "5.75"]].map(|more| bench.track("off.csv", more));
    assert_eq!(
        (free(&wrong), free(&right)),
        (0, LEAD),
        "{} {}",
        wrong.said,
        right.said
    );
    assert_eq!(right.summary["tare_s"], 5.75);
    // What is no time, and a session, whose rest readings are its zero.
    let run = bench.along("off.csv", &["--tare-s=-1"]);
    assert!(
        run.code != Some(0) && run.said.contains("--tare-s"),
        "{}",
        run.said
    );
    let calibration = verified().join("calibration.json");
    let out = bench.path("session.csv");
    let run = wcal(&[
        "track",
        SESSION,
        "--tare-s",
        "1",
        "--calibration",
        calibration.to_str().unwrap(),
        "--out",
        out.to_str().unwrap(),
    ]);
    assert_eq!(run.status.code(), Some(1));
    assert!(
        text(&run.stderr).contains("--tare-s") && !out.exists(),
        "{}",
        text(&run.stderr)
    );
}

/// Without any motion there is an arc for each loaded reading, wide and never "ok"; the groove lies
/// on it.
#[test]
fn without_a_motion_every_loaded_reading_has_an_arc() {
    let bench = Bench::new();
    let none = bench.track("table.csv", &[]);
    assert_eq!(
        (none.code, &none.summary["method"]),
        (Some(3), &"moments-alone".into()),
        "{}",
        none.said
    );
    let groove = &none.summary["known_groove"];
    let loaded = none.with_status("motion-lost");
    assert!(
        loaded as u64 >= groove["compared"].as_u64().unwrap() && loaded > 80,
        "{}",
        none.said
    );
    assert!(
        groove["coverage95"].as_f64().unwrap() > 0.9 && none.rmse_mm() > 3.0,
        "{}",
        none.said
    );
}

/// Metres stated as millimetres, a reversed motion, another clock rate, another calibration's
/// moments.
#[test]
fn a_motion_that_is_not_the_moments_is_marked_row_by_row() {
    let bench = Bench::new();
    let doubted = |run: &Run, name: &str| {
        assert_eq!(run.code, Some(3), "{name}: {}", run.said);
        assert!(
            run.with_status("motion-disagrees") > 20,
            "{name}: {}",
            run.said
        );
    };
    bench.write_motion(MM, |_, t, way| plain(t, way.map(|v| 1e-3 * v)));
    doubted(&bench.along("blind.csv", &[]), "metres");
    bench.write_motion(MM, |_, t, way| plain(t, way.map(|v| -v)));
    doubted(&bench.along("blind.csv", &[]), "reversed");
    let start = bench.record.motion[0].0;
    bench.write_motion(MM, |_, t, way| plain(start + 1.05 * (t - start), way));
    let slow = bench.along("blind.csv", &[]);
    assert!(
        slow.code == Some(3) && slow.with_status("motion-disagrees") > 20,
        "{}",
        slow.said
    );

    bench.write_motion(MM, |_, t, way| plain(t, way));
    let own = bench.along("blind.csv", &[]);
    assert_eq!(
        own.with_status("motion-disagrees"),
        0,
        "control: {}",
        own.said
    );
    // All three visits count: out and back says more of the point than out alone.
    let contacts = own.summary["contacts"].as_array().unwrap();
    assert!(
        contacts
            .iter()
            .all(|c| c["weights"]["fixed"].as_f64().unwrap() > 0.8),
        "{}",
        own.summary
    );
    // Twice the moments: a point that holds the wire does not explain them, a contact that slides
    // out and back does. Which it is cannot be told.
    bench
        .record
        .write_table(&bench.path("other.csv"), false, 2.0);
    let other = bench.along("other.csv", &[]);
    let doubted_rows =
        |run: &Run| run.with_status("motion-disagrees") + run.with_status("sliding-assumed");
    assert!(
        other.code != Some(0) && doubted_rows(&other) > 100,
        "{}",
        other.said
    );
    assert!(doubted_rows(&own) < 10, "control: {}", own.said);
    // Whatever is not 0 says why in the last line.
    for run in [&slow, &other] {
        let last = run.said.trim_end().lines().last().unwrap_or_default();
        assert!(
            last.starts_with(&format!("track: exit code {}: ", run.code.unwrap())),
            "{}",
            run.said
        );
    }
}

/// A pose that is lost, and a jump within a contact: rows that are marked, contacts that are
/// parted.
#[test]
fn gaps_and_jumps_of_the_motion_are_marked_and_part_contacts() {
    let bench = Bench::new();
    assert!(bench.record.motion.len() > 60);
    bench.write_motion(MM, |k, t, way| {
        if (10..30).contains(&k) {
            format!("{t},,,")
        } else {
            plain(t, way)
        }
    });
    let lost = bench.along("blind.csv", &[]);
    assert_eq!(
        (lost.code, lost.with_status("motion-lost")),
        (Some(3), 20),
        "{}",
        lost.said
    );
    assert_eq!(
        lost.summary["motion"]["lost_rows"]["gap"], 20,
        "{}",
        lost.summary
    );
    bench.write_motion(MM, |k, t, way| {
        plain(t, if k < 20 { way } else { way.map(|v| v + 3e4) })
    });
    let jumped = bench.along("blind.csv", &[]);
    let contacts = jumped.summary["contacts"].as_array().unwrap().len();
    assert!(
        contacts > 3 && jumped.said.contains("line 22: "),
        "{}",
        jumped.said
    );
}

/// A network asked for what it was not trained for: a base faster than any sweep, and poses that
/// are no numbers.
#[test]
fn a_network_says_so_of_a_base_that_is_too_fast_and_of_poses_that_are_no_numbers() {
    const MODEL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/tracker_small");
    let bench = Bench::new();
    // The session's readings come slower than the network's: said in every row, and let pass here.
    let by_network = |more: &[&str]| {
        bench.track(
            "blind.csv",
            &[&["--model", MODEL, "--force"][..], more].concat(),
        )
    };
    let fast = by_network(&["--base-mm-s", "60"]);
    let rows = fast.summary["motion_assumed_rows"].as_u64().unwrap_or(0);
    assert!(
        rows > 20 && fast.with_status("motion-assumed") as u64 == rows,
        "{}",
        fast.said
    );
    assert!(fast.said.contains("marked motion-assumed"), "{}", fast.said);
    // Control: a speed of training.
    let slow = by_network(&["--base-mm-s", "8"]);
    assert_eq!(slow.summary["motion_assumed_rows"], 0, "{}", slow.said);

    let table = std::fs::read_to_string(bench.path("blind.csv")).unwrap();
    let posed = |bad: &str| -> String {
        let line = |(k, line): (usize, &str)| match k {
            0 => format!("{line},base_x_mm,base_y_mm,base_z_mm,base_qw,base_qx,base_qy,base_qz\n"),
            4 => format!("{line},{bad},0,0,1,0,0,0\n"),
            _ => format!("{line},0,0,{},1,0,0,0\n", 0.1 * k as f64),
        };
        table.lines().enumerate().map(line).collect()
    };
    std::fs::write(bench.path("posed.csv"), posed("nan")).unwrap();
    let run = bench.track("posed.csv", &["--model", MODEL, "--force"]);
    assert_eq!(run.code, Some(1), "{}", run.said);
    assert!(
        ["base_x_mm", "a finite number", "line 5"]
            .iter()
            .all(|s| run.said.contains(s)),
        "{}",
        run.said
    );
    assert!(!bench.path("track.csv").exists(), "nothing is half-written");
    std::fs::write(bench.path("posed.csv"), posed("0")).unwrap();
    let good = bench.track("posed.csv", &["--model", MODEL, "--force"]);
    assert!(good.code != Some(1), "control: {}", good.said);
}

#[test]
fn bad_logs_are_refused_by_name() {
    let bench = Bench::new();
    let refused = |name: &str| {
        let run = bench.along("blind.csv", &[]);
        assert!(
            run.code == Some(1) && run.said.contains(name),
            "{name}: {}",
            run.said
        );
    };
    bench.write_motion(MM, |_, t, way| plain(t + 1e6, way));
    refused("overlap");
    bench.write_motion(MM, |_, t, way| plain(1e3 * t, way));
    refused("expected seconds");
    bench.write_motion(MM, |k, t, way| {
        if k == 5 {
            format!("{t},nan,0,0")
        } else {
            plain(t, way)
        }
    });
    refused("line 7");
    bench.write_motion(MM, |k, t, way| plain(if k == 5 { t - 1e4 } else { t }, way));
    refused("expected a later time");
    bench.write_motion("t_s,x,y,z", |_, t, way| plain(t, way));
    refused("object_x_mm");
    bench.write_motion(POSES, |_, t, [x, y, z]| format!("{t},{x},{y},{z},1,1,0,0"));
    refused("unit quaternion");
    std::fs::write(bench.path("motion.csv"), format!("{MM}\n1,0,0,0\n")).unwrap();
    refused("at least two rows");
}

/// Negative control of the comparison with the groove: the same readings, the groove said to be 5
/// mm farther out.
#[test]
fn a_groove_that_is_not_where_the_session_says_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let calibration = verified()
        .join("calibration.json")
        .to_str()
        .unwrap()
        .to_owned();
    let track = |session: &str| {
        let run = wcal(&[
            "track",
            session,
            "--calibration",
            &calibration,
            "--out",
            &path("track.csv"),
            "--json",
        ]);
        let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap_or_default();
        (
            run.status.code(),
            text(&run.stderr),
            summary["groove_tracking"].clone(),
        )
    };
    let (code, said, true_groove) = track(SESSION);
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(
        true_groove["trajectories_held"], true_groove["trajectories"],
        "{said}"
    );

    let shifted = folder.path().join("shifted");
    std::fs::create_dir(&shifted).unwrap();
    for file in ["session.toml", "holdout.csv"] {
        std::fs::copy(format!("{SESSION}/{file}"), shifted.join(file)).unwrap();
    }
    let table = std::fs::read_to_string(format!("{SESSION}/points.csv")).unwrap();
    let x = table
        .lines()
        .next()
        .unwrap()
        .split(',')
        .position(|c| c == "groove_x_mm")
        .unwrap();
    let shift = |(k, line): (usize, &str)| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        if k > 0 {
            cells[x] = (cells[x].parse::<f64>().unwrap() + 5.0).to_string();
        }
        cells.join(",")
    };
    let table: Vec<String> = table.lines().enumerate().map(shift).collect();
    std::fs::write(shifted.join("points.csv"), table.join("\n") + "\n").unwrap();
    let (code, said, groove) = track(shifted.to_str().unwrap());
    assert_eq!(code, Some(4), "{said}");
    assert_eq!(groove["trajectories_held"], 0, "{said}");
    let rmse_mm = groove["rmse_mm"].as_f64().unwrap();
    assert!((rmse_mm - 5.0).abs() < 0.5, "{said}");
}
