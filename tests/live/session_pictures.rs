//! From a sweep with pictures to shapes in the session, through the program alone: virtual bench,
//! board pictures, `stereo-calibrate`, `stereo-shape SESSION` (SIMULATED). The bench's camera
//! faults and spoilt pictures are the negative controls.

use crate::support::board_pictures::board_pictures;
use crate::support::copy::copy_folder;
use crate::support::virtual_bench::{VirtualBench, rig_at};
use crate::support::{code_and_messages, program, text, until};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Instant;
use wcal_acquisition::replay::completed_steps;
use wcal_core::provenance::sha256_hex;
use wcal_core::shapes_document::{PairDocument, ShapesDocument};

/// Bench seconds per wall second.
const SPEED: f64 = 4.0;
/// Three trajectories, two depths each; one depth of another is sealed.
const PLAN: &str = "format = \"wcal-plan/1\"\nname = \"short\"\nsync_move = false\n\
    [settle]\ngate_pm_per_s = 5.0\nwindow_s = 0.4\n\
    [[block]]\nrole = \"calibration\"\ntrajectories = [1, 5, 9]\ndepths_mm = [2.0, 4.5]\ndwell_s = 0.4\naverage_s = 0.3\n\
    [[block]]\nrole = \"holdout\"\ntrajectories = [9]\ndepths_mm = [3.0, 4.0]\nrest = false\ndwell_s = 0.4\naverage_s = 0.3\n";

/// A running `wcal virtual-bench`, ended with the test.
struct Bench {
    served: VirtualBench,
    folder: tempfile::TempDir,
}

impl Bench {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let scenario = format!(
            "format = \"wcal-scenario/1\"\nseed = 3\nspeed = {SPEED}\n[interrogator]\nrate_hz = 500\n[cameras]\nrate_hz = 5\n"
        );
        std::fs::write(folder.path().join("rig.toml"), rig_at(500.0)).unwrap();
        Self {
            served: VirtualBench::serve(folder.path(), "", &scenario),
            folder,
        }
    }

    fn at(&self, name: &str) -> String {
        self.folder.path().join(name).display().to_string()
    }

    /// Begins a sweep into `session`.
    fn begin(&self, session: &str, plan: &str) -> Child {
        let file = self.at(&format!("{session}.plan.toml"));
        std::fs::write(&file, plan).unwrap();
        program()
            .args([
                "stage-sweep",
                "--home",
                "--rig",
                &self.at("rig.toml"),
                "--plan",
                &file,
            ])
            .args([
                "--bench",
                &self.at("bench.json"),
                "--out",
                &self.at(session),
            ])
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    }

    /// A short sweep; `fault` is typed once `after` steps are done. Exit code and messages.
    fn with_fault(&mut self, session: &str, fault: &str, after: usize) -> (i32, String) {
        let plan = PLAN.replace("[1, 5, 9]", "[5]");
        let plan = plan[..plan.rfind("[[block]]").unwrap()].to_owned();
        let child = self.begin(session, &plan);
        let recording = PathBuf::from(self.at(session)).join("recording.mcap");
        until(session, || {
            completed_steps(&recording).map_or(0, |s| s.len()) >= after
        });
        self.served.type_fault(fault);
        ended(child)
    }
}

fn ended(child: Child) -> (i32, String) {
    let output = child.wait_with_output().unwrap();
    (output.status.code().unwrap(), text(&output.stderr))
}

fn shapes(session: &str, file: &str) -> ShapesDocument {
    serde_json::from_slice(&std::fs::read(Path::new(session).join(file)).unwrap()).unwrap()
}

/// Grooves of a table by point, base frame, mm; at rest none.
fn grooves(session: &str, table: &str) -> Vec<Option<[f64; 3]>> {
    let text = std::fs::read_to_string(Path::new(session).join(table)).unwrap();
    let mut lines = text.lines();
    let first = lines
        .next()
        .unwrap()
        .split(',')
        .position(|c| c == "groove_x_mm")
        .unwrap();
    lines
        .map(|l| {
            let cells: Vec<&str> = l.split(',').skip(first).take(3).collect();
            Some([
                cells[0].parse().ok()?,
                cells[1].parse().ok()?,
                cells[2].parse().ok()?,
            ])
        })
        .collect()
}

/// By pair the greatest distance of the groove from where the stage had it in an axis, mm, and in
/// standard deviations of that axis; the farthest first.
fn distances(pairs: &[PairDocument], truth: &[Option<[f64; 3]>]) -> Vec<[f64; 2]> {
    let of = |pair: &PairDocument| {
        let (at, groove) = (truth[pair.point? as usize]?, pair.groove.as_ref()?);
        let axes = groove.position_mm.iter().zip(at).zip(groove.sd_mm);
        Some(axes.fold([0.0_f64; 2], |worst, ((found, at), sd)| {
            let off = (found - at).abs();
            [worst[0].max(off), worst[1].max(off / sd)]
        }))
    };
    let mut all: Vec<[f64; 2]> = pairs
        .iter()
        .filter(|p| p.status == "ok")
        .filter_map(of)
        .collect();
    all.sort_by(|a, b| b[0].total_cmp(&a[0]));
    println!("distance in mm and in sd, by pair: {all:.4?}");
    all
}

#[test]
fn a_sweep_with_pictures_becomes_a_session_with_shapes() {
    let _turn = crate::beside_others();
    let start = Instant::now();
    let said = |what: &str| println!("{:5.1} s  {what}", start.elapsed().as_secs_f64());
    let mut bench = Bench::start();
    let (session, cameras) = (bench.at("session"), bench.at("cameras"));
    let addresses: Value =
        serde_json::from_slice(&std::fs::read(&bench.served.addresses).unwrap()).unwrap();
    let board = bench.folder.path().join("board");
    board_pictures(
        [0, 1].map(|k| addresses["cameras"][k].as_str().unwrap()),
        &board,
        12,
    )
    .unwrap();
    said("board pictured");
    let (code, text) = ended(bench.begin("session", PLAN));
    assert!(code == 0, "{text}");
    said("swept");
    let [left, right] = ["left", "right"].map(|side| board.join(side).display().to_string());
    let (code, text) = code_and_messages(&[
        "stereo-calibrate",
        &left,
        &right,
        "--board",
        "9x6",
        "--square-mm",
        "6",
        "--out",
        &cameras,
    ]);
    assert!(code == 0 || code == 3, "{text}");
    said("calibrated");
    let stereo = format!("{cameras}/stereo.json");
    let (code, text) = code_and_messages(&["stereo-shape", &session, "--cameras", &stereo]);
    assert_eq!(code, 0, "{text}");
    assert!(text.contains("SIMULATED"), "{text}");
    said("shapes");

    // Every pose has its pair, three of them at rest; sealed ones are kept separate.
    let document = shapes(&session, "shapes.json");
    let points: Vec<i64> = document.pairs.iter().map(|p| p.point.unwrap()).collect();
    assert_eq!(points, (0..9).collect::<Vec<i64>>());
    let truth = grooves(&session, "points.csv");
    assert_eq!(truth.iter().flatten().count(), 6);
    let found = distances(&document.pairs, &truth);
    // One pair of a sweep may be poorly seen, and says so: on a busy machine one in some dozens of
    // runs had 0.71 mm with a standard deviation of 0.9.
    assert!(
        found.len() == 6 && found[1][0] < 0.05 && found.iter().all(|f| f[1] < 4.0),
        "{found:?}"
    );
    let sealed = shapes(&session, "shapes-holdout.json");
    assert_eq!(sealed.pairs.len(), 2);
    let of_sealed = distances(&sealed.pairs, &grooves(&session, "holdout.csv"));
    assert!(
        of_sealed.iter().all(|f| f[0] < 0.1 && f[1] < 4.0),
        "{of_sealed:?}"
    );
    // The session names them, what they were made from, and still opens; its other entries stay.
    let toml = || std::fs::read_to_string(Path::new(&session).join("session.toml")).unwrap();
    let table: toml::Table = toml().parse().unwrap();
    assert_eq!(table["files"]["shapes"].as_str(), Some("shapes.json"));
    assert_eq!(
        table["files"]["holdout_shapes"].as_str(),
        Some("shapes-holdout.json")
    );
    let hash = sha256_hex(&std::fs::read(&stereo).unwrap());
    assert_eq!(document.source.cameras_sha256, hash);
    assert_eq!(
        table["provenance"]["cameras_sha256"].as_str(),
        Some(hash.as_str())
    );
    assert_eq!(
        table["provenance"]["shapes_rig_sha256"].as_str(),
        Some(document.source.rig_sha256.as_str())
    );
    assert_eq!(document.source.session.as_deref(), table["id"].as_str());
    wcal_session::load(Path::new(&session)).unwrap();
    // Reducing again keeps what was added, and shapes are replaced by their own kind alone.
    assert_eq!(code_and_messages(&["reduce", &session]).0, 0);
    assert_eq!(toml().parse::<toml::Table>().unwrap(), table);
    std::fs::write(Path::new(&session).join("shapes-holdout.json"), "{}").unwrap();
    let (code, text) = code_and_messages(&["stereo-shape", &session, "--cameras", &stereo]);
    assert!(
        code == 1 && text.contains("shapes-holdout.json") && text.contains("--force"),
        "{text}"
    );
    let (code, text) =
        code_and_messages(&["stereo-shape", &session, "--cameras", &stereo, "--force"]);
    assert_eq!(code, 0, "{text}");
    said("again");
    spoilt_pictures_are_named(&session, &bench.at("spoilt"), &stereo);
    said("spoilt");
    faulty_cameras_are_named(&mut bench, &stereo, &said);
}

/// Sweeps with too much light, with a camera that was knocked, and with one that is lost.
fn faulty_cameras_are_named(bench: &mut Bench, stereo: &str, said: &dyn Fn(&str)) {
    // From here on the white of the tags saturates: those poses are named, the others used.
    let (code, text) = bench.with_fault("bright", "{\"kind\":\"exposure\",\"factor\":3}", 2);
    assert!(
        code == 0 || (code == 3 && text.contains("clock drifts")),
        "{code} {text}"
    );
    let bright = bench.at("bright");
    let (code, text) = code_and_messages(&["stereo-shape", &bright, "--cameras", stereo]);
    assert!(code == 3 && text.contains("saturated"), "{text}");
    let used = shapes(&bright, "shapes.json")
        .pairs
        .iter()
        .filter(|p| p.status == "ok")
        .count();
    assert!((1..3).contains(&used), "{text}");
    bench
        .served
        .type_fault("{\"kind\":\"exposure\",\"factor\":1}");
    said("overexposed");

    // Somebody knocked a camera: what it shows is not where the stage has the groove, by far more
    // than stated.
    let knock = "{\"kind\":\"camera-moved\",\"mm\":[0.3,0,0],\"deg\":[0,0.1,0]}";
    bench.served.type_fault(knock);
    // On a busy machine pictures come late, and the sweep says that the camera's clock drifts (exit
    // code 3).
    let (code, text) = bench.with_fault("moved", knock, 0);
    assert!(
        code == 0 || (code == 3 && text.contains("clock drifts")),
        "{code} {text}"
    );
    let moved = bench.at("moved");
    let (code, text) = code_and_messages(&["stereo-shape", &moved, "--cameras", stereo]);
    if code != 1 {
        let off = distances(
            &shapes(&moved, "shapes.json").pairs,
            &grooves(&moved, "points.csv"),
        );
        assert!(off.iter().any(|o| o[1] > 8.0), "{off:?} {text}");
    }
    bench
        .served
        .type_fault("{\"kind\":\"camera-moved\",\"mm\":[0,0,0],\"deg\":[0,0,0]}");
    said("moved");

    // A camera that is lost ends the sweep; what was pictured until then is used.
    let (code, text) = bench.with_fault("lost", "{\"kind\":\"lost-frames\",\"count\":100000}", 2);
    assert!(
        code == 1 && text.contains("camera") && text.contains("--resume"),
        "{text}"
    );
    let lost = bench.at("lost");
    let (code, text) = code_and_messages(&["stereo-shape", &lost, "--cameras", stereo]);
    assert!(code == 0 || code == 3, "{text}");
    assert!(
        (1..3).contains(&shapes(&lost, "shapes.json").pairs.len()),
        "{text}"
    );
    said("lost");
}

/// A copy of the session in which one pose's pictures each are without tag, unpaired, of another
/// session, and of another time.
fn spoilt_pictures_are_named(session: &str, to: &str, stereo: &str) {
    let place = Path::new(to);
    copy_folder(Path::new(session), place);
    let list = place.join("pictures/pictures.csv");
    let mut table = std::fs::read_to_string(&list).unwrap();
    // Pictures of the board as those of a pose, with hashes of their own: nobody exchanged the
    // files, and no tag is in them.
    for side in ["left", "right"] {
        let board = Path::new(session)
            .with_file_name("board")
            .join(side)
            .join("03.png");
        let board = std::fs::read(board).unwrap();
        let own = place.join(format!("pictures/{side}/00001.png"));
        table = table.replace(
            &sha256_hex(&std::fs::read(&own).unwrap()),
            &sha256_hex(&board),
        );
        std::fs::write(&own, board).unwrap();
    }
    std::fs::remove_file(place.join("pictures/right/00002.png")).unwrap();
    let change = |table: String, line: &str, cell: usize, to: &dyn Fn(&str) -> String| -> String {
        let lines = table.lines().map(|text| {
            let mut cells: Vec<String> = text.split(',').map(str::to_owned).collect();
            if text.starts_with(line) {
                cells[cell] = to(&cells[cell]);
            }
            cells.join(",")
        });
        lines.collect::<Vec<_>>().join("\n")
    };
    table = change(table, "4,right,", 6, &|_| "\"another\"".to_owned());
    table = change(table, "5,left,", 3, &|t_s| {
        format!("{}", t_s.parse::<f64>().unwrap() + 30.0)
    });
    std::fs::write(&list, table).unwrap();
    let (code, text) = code_and_messages(&["stereo-shape", to, "--cameras", stereo]);
    assert_eq!(code, 3, "{text}");
    let document = shapes(to, "shapes.json");
    for (point, why) in [
        (1, "expected the base tag"),
        (2, "the right picture is missing"),
        (4, "a picture of session \"another\""),
        (5, "clocks that disagree"),
    ] {
        let pair = &document.pairs[point];
        assert!(
            pair.status == "rejected" && pair.why.contains(why),
            "{point}: {} {}",
            pair.status,
            pair.why
        );
        assert!(text.contains(why), "{text}");
    }
    for point in [0, 3, 6, 7, 8] {
        assert_eq!(
            document.pairs[point].status, "ok",
            "{point}: {}",
            document.pairs[point].why
        );
    }
    let found: Value = serde_json::to_value(&document.source).unwrap();
    assert_eq!(
        found["session"],
        serde_json::to_value(&shapes(session, "shapes.json").source).unwrap()["session"]
    );
}
